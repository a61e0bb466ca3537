"""Coordinates of the posterior: bodies as matrices near the unit matrix, and without any bounds as log-Cholesky.

Each body's pseudo-inertia P is measured by the nominal one, ``M = N P N'`` with ``N P0 N' = 1`` (P0 is solid, see
`bayesid.robot.inertia.solid`), and the sampler's coordinates are the ten entries of M. The unconstrained ones are

    M = U U',   U upper triangular,   theta = (log u_kk, u_ij),

which covers exactly the bodies that can exist [Rucker2022]_; ``log |dM / dtheta| = 4 log 2 + sum_k (k + 1) log u_kk``,
k = 1 ... 4, since column k of U has k entries.
"""

from __future__ import annotations

import numpy as np

from bayesid.posterior.trajectory import COLUMN, ROW
from bayesid.robot import inertia

#: Positions of theta in U: four logarithms of the diagonal, then the entries above it by rows.
_DIAGONAL = np.arange(4)
_ABOVE = (np.array([0, 0, 0, 1, 1, 2]), np.array([1, 2, 3, 2, 3, 3]))
_POWERS = np.array([2.0, 3.0, 4.0, 5.0])
NAMES = ("log_u11", "log_u22", "log_u33", "log_u44", "u12", "u13", "u14", "u23", "u24", "u34")


def normaliser(body: np.ndarray) -> np.ndarray:
    """N (4, 4) with ``N P0 N' = 1`` for the solid neighbour P0 of a nominal body (10,).

    N serves numbers near one only: it changes no density.
    """
    return np.linalg.inv(np.linalg.cholesky(inertia.solid(body)))


def entries_map(body: np.ndarray) -> np.ndarray:
    """Matrix (10, 10) from a body's ten parameters to the entries of M."""
    n = normaliser(body)
    return (n @ inertia.BASIS @ n.T)[:, ROW, COLUMN].T


def matrices(entries: np.ndarray) -> np.ndarray:
    """Symmetric matrices (..., 4, 4) of their entries (..., 10)."""
    out = np.empty((*entries.shape[:-1], 4, 4))
    out[..., ROW, COLUMN] = entries
    out[..., COLUMN, ROW] = entries
    return out


def triangular(theta: np.ndarray) -> np.ndarray:
    """U (..., 4, 4) of log-Cholesky parameters (..., 10)."""
    u = np.zeros((*theta.shape[:-1], 4, 4))
    u[..., _DIAGONAL, _DIAGONAL] = np.exp(theta[..., :4])
    u[(..., *_ABOVE)] = theta[..., 4:]
    return u


def from_log_cholesky(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of M (..., 10) and the logarithm of the Jacobian ``|dM / dtheta|`` (...,)."""
    u = triangular(theta)
    m = u @ np.swapaxes(u, -1, -2)
    return m[..., ROW, COLUMN], 4.0 * np.log(2.0) + theta[..., :4] @ _POWERS


def to_log_cholesky(entries: np.ndarray) -> np.ndarray:
    """The inverse (..., 10); a `numpy.linalg.LinAlgError` where a matrix is not positive definite."""
    flipped = np.linalg.cholesky(matrices(entries)[..., ::-1, ::-1])
    u = flipped[..., ::-1, ::-1]
    return np.concatenate([np.log(u[..., _DIAGONAL, _DIAGONAL]), u[(..., *_ABOVE)]], axis=-1)


def pull_back(theta: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Gradient in theta (..., 10) of a function whose gradient in the entries of M is given, Jacobian's included."""
    u = triangular(theta)
    g = np.zeros((*gradient.shape[:-1], 4, 4))
    # An off-diagonal entry stands for two places of M.
    half = np.where(ROW == COLUMN, 1.0, 0.5) * gradient
    g[..., ROW, COLUMN] = half
    g[..., COLUMN, ROW] = half
    slope = 2.0 * g @ u
    out = np.empty_like(theta)
    out[..., :4] = slope[..., _DIAGONAL, _DIAGONAL] * u[..., _DIAGONAL, _DIAGONAL] + _POWERS
    out[..., 4:] = slope[(..., *_ABOVE)]
    return out
