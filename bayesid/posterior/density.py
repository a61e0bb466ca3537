"""The posterior's density in unconstrained coordinates, with its gradient: for samplers of one's own.

Coordinates theta are, in this order: for every body its log-Cholesky parameters (`bayesid.posterior.coordinates`; with a flat
prior the base parameters instead), effect parameters, logarithms of those that cannot be negative, logarithms of the scales,
and that of Student's degrees of freedom.
"""

from __future__ import annotations

import numpy as np

from bayesid.posterior import coordinates
from bayesid.posterior.likelihood import student_slopes
from bayesid.posterior.model import PosteriorModel


def theta_names(model: PosteriorModel) -> tuple[str, ...]:
    """Names of the coordinates (q,)."""
    linear = [f"log {n}" if k in model.bounded else n for k, n in enumerate(model.linear_names)]
    if model.bodies:
        bodies = [model.linear_names[10 * k].rpartition(".")[0] for k in range(model.bodies)]
        linear[: 10 * model.bodies] = [f"{b}.{n}" for b in bodies for n in coordinates.NAMES]
    return (*linear, *(f"log scale {n}" for n in model.scale_names), *(("log nu",) if model.dof_free else ()))


def log_density(model: PosteriorModel, theta: np.ndarray) -> np.ndarray:
    """Logarithm of the posterior density at ``theta`` (..., q), all Jacobians included, up to a constant (...,).

    With Gaussian noise a call costs the same for any number of rows.
    """
    return _density(model, np.asarray(theta, float))[0]


def _density(model: PosteriorModel, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Log density (...,), linear parameters, scales and degrees of freedom."""
    d, k = len(model.linear_names), len(model.scale_names)
    x, jacobian = theta[..., :d].copy(), np.zeros(theta.shape[:-1])
    if model.bodies:
        part = theta[..., : 10 * model.bodies].reshape(*theta.shape[:-1], model.bodies, 10)
        entries, logs = coordinates.from_log_cholesky(part)
        x[..., : 10 * model.bodies] = entries.reshape(*theta.shape[:-1], -1)
        jacobian = jacobian + logs.sum(axis=-1) + np.linalg.slogdet(model.from_entries)[1]
    x[..., model.bounded] = np.exp(theta[..., model.bounded])
    jacobian = jacobian + theta[..., model.bounded].sum(axis=-1)
    linear = x @ model.from_entries.T
    shape = theta.shape[:-1]
    scales = np.exp(theta[..., d : d + k]) if k else np.ones((*shape, len(model.likelihood.names)))
    fixed = np.inf if model.noise == "gaussian" else model.dof_prior.fixed or 0.0
    dof = np.exp(theta[..., -1]) if model.dof_free else np.full(shape, fixed)
    if model.dof_free:
        jacobian = jacobian + theta[..., -1]
    return model.log_joint(linear, scales, dof) + jacobian, linear, scales, dof


def log_density_gradient(model: PosteriorModel, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`log_density` and its gradient in ``theta``, (...,) and (..., q)."""
    theta = np.asarray(theta, float)
    density, linear, scales, dof = _density(model, theta)
    slopes = _gaussian_slopes if model.noise == "gaussian" else _student_slopes
    by_linear, by_scales, by_dof = slopes(model, linear, scales, dof)
    d, k = len(model.linear_names), len(model.scale_names)
    out = np.empty_like(theta)
    in_x = by_linear @ model.from_entries
    out[..., :d] = in_x
    if model.bodies:
        shape = (*theta.shape[:-1], model.bodies, 10)
        end = 10 * model.bodies
        bodies = coordinates.pull_back(theta[..., :end].reshape(shape), in_x[..., :end].reshape(shape))
        out[..., :end] = bodies.reshape(*theta.shape[:-1], end)
    out[..., model.bounded] = in_x[..., model.bounded] * np.exp(theta[..., model.bounded]) + 1.0
    if k:
        out[..., d : d + k] = by_scales + model.scale_prior.slope(np.log(scales))
    if model.dof_free:
        out[..., -1] = by_dof * dof + model.dof_prior.shape - model.dof_prior.rate * dof
    return density, out


def _gaussian_slopes(
    model: PosteriorModel, linear: np.ndarray, scales: np.ndarray, dof: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives of likelihood and normal priors by linear parameters (..., d), log scales (..., k) and dof (...,)."""
    q = model.quadratic
    z = np.linalg.solve(q.root, (linear - q.centre)[..., None])[..., 0]
    weights = np.concatenate([scales**-2, np.ones((*scales.shape[:-1], 1))], axis=-1)
    slope = np.einsum("...k,kj->...j", weights, q.linear) - np.einsum("...k,kij,...j->...i", weights, q.gram, z)
    by_linear = np.linalg.solve(q.root.T, slope[..., None])[..., 0]
    return by_linear, q.squares(z)[..., :-1] / scales**2 - model.likelihood.counts, np.zeros_like(dof)


def _student_slopes(
    model: PosteriorModel, linear: np.ndarray, scales: np.ndarray, dof: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same for Student's t, point by point."""
    q, to_columns, white = model.quadratic, model.to_columns, model.likelihood.white
    z = np.linalg.solve(q.root, (linear - q.centre)[..., None])[..., 0]
    slope = q.linear[-1] - z @ q.gram[-1].T
    by_linear = np.linalg.solve(q.root.T, slope[..., None])[..., 0]  # of the normal priors
    by_scales, by_dof = np.empty_like(scales), np.empty_like(dof)
    for at in np.ndindex(linear.shape[:-1]):
        columns, by_scales[at], by_dof[at] = student_slopes(white, to_columns @ linear[at], scales[at], float(dof[at]))
        by_linear[at] += to_columns.T @ columns
    return by_linear, by_scales, by_dof


def to_theta(model: PosteriorModel, draws: np.ndarray) -> np.ndarray:
    """Coordinates (..., q) of draws as in ``model.names``."""
    linear, scales, dof = model.split(draws)
    x = linear @ model.entries.T
    if model.bodies:
        part = x[..., : 10 * model.bodies].reshape(*x.shape[:-1], model.bodies, 10)
        x[..., : 10 * model.bodies] = coordinates.to_log_cholesky(part).reshape(*x.shape[:-1], -1)
    x[..., model.bounded] = np.log(x[..., model.bounded])
    parts = [x] + ([np.log(scales)] if model.scale_names else []) + ([np.log(dof)[..., None]] if model.dof_free else [])
    return np.concatenate(parts, axis=-1)
