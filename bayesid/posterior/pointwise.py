"""The log likelihood in independent terms, as leave-one-out cross-validation [Vehtari2017]_ needs it.

Rows that scatter together count as one. Where the model is complete, whitened instants are independent and a term is one
instant. Where it is not, the likelihood counts all rows as an estimate b with covariance V (`bayesid.posterior.likelihood`), and
g instants for one, where ``g = trace(A^-1 M) / n`` is how much larger V is than rows on their own would make it: a term is that
many neighbouring instants of one channel. With residuals r(beta) of the adjusted rows

    term = -(|r(beta)|^2 - |r(b)|^2) / (2 s^2) - |r(b)|^2 / 2 - n log(s) / terms,

which add up to the likelihood that is sampled. Of long recordings, several terms that follow each other are taken together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from bayesid.estimators.factor import whitened
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.noise import log_student
from bayesid.posterior.result import Posterior
from bayesid.regression.blocks import Block

#: Terms at most, whatever the length of the recording.
TERMS = 1000
_LOG_2PI = float(np.log(2.0 * np.pi))


def log_likelihood_terms(posterior: Posterior, blocks: Iterable[Block]) -> np.ndarray:
    """Logarithm of the likelihood of every draw in independent terms (chains, draws, terms), up to a constant in all.

    Parameters
    ----------
    posterior
        The draws.
    blocks
        The rows that were fitted.
    """
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
    """Of an estimate (p,) and its covariance, but for the logarithm of its scale (draws,)."""
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
