"""What the posterior says of rows: replicated readings, and how likely the measured ones are.

The log likelihood comes in independent terms, as leave-one-out cross-validation [Vehtari2017]_ needs it. Rows that scatter
together count as one. Where the model is complete, whitened instants are independent and a term is one instant. Where it is
not, the likelihood counts all rows as an estimate b with covariance V (`bayesid.posterior.likelihood`), and g instants for one,
where ``g = trace(A^-1 M) / n`` is how much larger V is than rows on their own would make it: a term is that many neighbouring
instants of one channel. With residuals r(beta) of the adjusted rows

    term = -(|r(beta)|^2 - |r(b)|^2) / (2 s^2) - |r(b)|^2 / 2 - n log(s) / terms,

which add up to the likelihood that is sampled. Of long recordings, several terms that follow each other are taken together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import cholesky
from scipy.signal import lfilter

from bayesid.estimators.factor import whitened
from bayesid.posterior.convert import Groups
from bayesid.posterior.likelihood import Likelihood, log_student
from bayesid.posterior.result import Posterior
from bayesid.regression.blocks import Block
from bayesid.signals.noise import noise_of_group

#: Terms at most, whatever the length of the recording.
TERMS = 1000
_LOG_2PI = float(np.log(2.0 * np.pi))


def log_likelihood_terms(posterior: Posterior, blocks: Iterable[Block]) -> np.ndarray:
    """Logarithm of the likelihood of every draw in independent terms (chains, draws, terms), up to a constant in all."""
    likelihood = posterior.model.likelihood
    chains, draws = posterior.columns.shape[:2]
    centre = np.zeros(0)
    if likelihood.estimate_only:
        factor = likelihood.factors[0]
        centre = np.linalg.lstsq(factor[:, :-1], factor[:, -1], rcond=None)[0]
    at = np.concatenate([-posterior.columns.reshape(chains * draws, -1).T, np.ones((1, chains * draws))])
    terms = [
        _student(posterior, group, rows, at)
        if posterior.model.noise == "student"
        else _together(posterior, rows, at, centre)
        if likelihood.estimate_only
        else _by_channel(posterior, group, rows, at)
        for group, rows in _terms(likelihood, blocks)
    ]
    out = np.stack(terms, axis=-1)
    if likelihood.estimate_only:
        scale = posterior.scales.reshape(-1)
        out -= (likelihood.counts[0] * np.log(scale) / len(terms))[:, None]
    return out.reshape(chains, draws, -1).astype(np.float32)


def _terms(likelihood: Likelihood, blocks: Iterable[Block]) -> Iterator[tuple[str, np.ndarray]]:
    """Group and adjusted rows (instants, channels, p + 1) of every term."""
    assert likelihood.noise is not None and likelihood.adjust is not None
    channels = len(next(iter(likelihood.noise.values())).std)
    together = likelihood.adjust[-1, -1] ** -2.0
    # Instants in a term; where each channel has terms of its own, as many more.
    size = max(together, likelihood.rows / TERMS / (1 if likelihood.estimate_only else channels))
    for block, white in whitened(blocks, likelihood.noise):
        if len(white):
            for rows in np.array_split(white @ likelihood.adjust, max(round(len(white) / size), 1)):
                if likelihood.estimate_only:
                    yield from ((block.group, rows[:, c : c + 1]) for c in range(channels))
                else:
                    yield block.group, rows


def _part(likelihood: Likelihood, group: str, channels: int) -> slice:
    first = likelihood.groups.index(group) * channels
    return slice(first, first + channels)


def _by_channel(posterior: Posterior, group: str, rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Gaussian, a scale a channel (draws,)."""
    count, channels, _ = rows.shape
    scales = posterior.noise_scales.reshape(at.shape[1], -1)[:, _part(posterior.model.likelihood, group, channels)]
    squares = np.stack([_squares(rows[:, c], at) for c in range(channels)], axis=1)
    return np.sum(-0.5 * squares / scales**2 - count * (np.log(scales) + 0.5 * _LOG_2PI), axis=1)


def _together(posterior: Posterior, rows: np.ndarray, at: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Log density of an estimate (p,) with its covariance, but for the logarithm of its scale (draws,)."""
    flat = rows.reshape(-1, rows.shape[-1])
    best = float(np.sum((flat @ np.append(-centre, 1.0)) ** 2))
    scale = posterior.scales.reshape(-1)
    return -0.5 * (_squares(flat, at) - best) / scale**2 - 0.5 * best - 0.5 * len(flat) * _LOG_2PI


def _student(posterior: Posterior, group: str, rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Student's t of whole instants (draws,)."""
    channels = rows.shape[1]
    scales = posterior.noise_scales.reshape(at.shape[1], -1)[:, _part(posterior.model.likelihood, group, channels)]
    dof = posterior.model.split(posterior.chains.draws)[2].reshape(-1)
    squares = np.sum((rows @ at / scales.T) ** 2, axis=1)
    return np.sum(log_student(squares, channels, dof), axis=0) - len(rows) * np.sum(np.log(scales), axis=1)


def _squares(rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Sum of squares of rows [X y] (k, p + 1) at columns (p + 1, draws) of parameters (draws,)."""
    if len(rows) > rows.shape[1]:
        rows = np.asarray(np.linalg.qr(rows, mode="r"))
    return np.sum((rows @ at) ** 2, axis=0)


#: Draws that readings are replicated for, rows that are kept of them, and rows looked at before thinning.
DRAWS, ROWS, CONSIDERED = 200, 400, 4096
#: Rows after which the noise has forgotten how it started.
_RUN_IN = 200


def predictive_groups(
    posterior: Posterior, rows: Iterable[Block], fitted: Iterable[Block], validation: Iterable[Block], channels: tuple[str, ...]
) -> Groups:
    """Groups ``posterior_predictive``, ``log_likelihood`` (of the fitted rows) and ``observed_data``.

    ``rows`` are all that were fitted; of ``fitted`` and ``validation`` at most 4096 each are looked at and about 400 kept.
    """
    rng = np.random.default_rng([posterior.seed, 1])
    groups: dict[str, dict[str, np.ndarray]] = {"posterior_predictive": {}, "log_likelihood": {}, "observed_data": {}}
    coordinates: dict[str, Any] = {"channel": list(channels)}
    dimensions: dict[str, list[str]] = {}
    for name, blocks in (("fitted", _first_rows(fitted)), ("validation", _first_rows(validation))):
        if not blocks:
            continue
        step = max(-(-sum(len(b.rows) for b in blocks) // ROWS), 1)
        keep = [np.arange(0, len(b.rows), step) for b in blocks]
        groups["posterior_predictive"][name] = np.concatenate(
            [_replicated(posterior, b, rng)[:, :, k].astype(np.float32) for b, k in zip(blocks, keep, strict=True)], axis=2
        )
        groups["observed_data"][name] = np.concatenate([b.target[k] for b, k in zip(blocks, keep, strict=True)])
        coordinates[f"{name}_row"] = list(range(sum(map(len, keep))))
        dimensions[name] = [f"{name}_row", "channel"]
    groups["log_likelihood"]["rows"] = log_likelihood_terms(posterior, rows)
    coordinates["term"] = list(range(groups["log_likelihood"]["rows"].shape[2]))
    dimensions["rows"] = ["term"]
    return Groups({name: arrays for name, arrays in groups.items() if arrays}, coordinates, dimensions)


def _first_rows(blocks: Iterable[Block]) -> list[Block]:
    out, total = [], 0
    for block in blocks:
        if total >= CONSIDERED:
            break
        count = min(len(block.rows), CONSIDERED - total)
        out.append(replace(block, rows=block.rows[:count], times=block.times[:count]))
        total += count
    return out


def _replicated(posterior: Posterior, block: Block, rng: np.random.Generator) -> np.ndarray:
    """Readings with fresh noise (chains, draws, rows, channels) for a few draws."""
    chains, draws = posterior.columns.shape[:2]
    at = np.unique(np.linspace(0, draws - 1, max(DRAWS // chains, 1)).astype(int))
    likelihood = posterior.model.likelihood
    assert likelihood.noise is not None
    noise = noise_of_group(likelihood.noise, block.group)
    part = _part(likelihood, block.group if block.group in likelihood.groups else likelihood.groups[0], len(noise.std))
    columns, scales = posterior.columns[:, at], posterior.noise_scales[:, at, part]
    mean = np.einsum("tcp,nmp->nmtc", block.matrix, columns, optimize=True)
    run_in = 0 if noise.from_zero or noise.order == 0 else _RUN_IN
    shape = (*mean.shape[:2], len(block.rows) + run_in, mean.shape[3])
    innovations = rng.normal(size=shape) * scales[:, :, None]
    dof = posterior.model.split(posterior.chains.draws)[2][:, at]
    if posterior.model.noise == "student":
        half = 0.5 * dof[:, :, None]
        innovations /= np.sqrt(rng.gamma(half, size=shape[:3]) / half)[..., None]
    innovations = innovations @ cholesky(noise.innovation, lower=True).T
    for c, polynomial in enumerate(noise.coefficients):
        mean[..., c] += np.asarray(lfilter([1.0], polynomial, innovations[..., c], axis=2))[:, :, run_in:]
    return mean
