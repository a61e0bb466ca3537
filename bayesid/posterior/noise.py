"""The law of whitened rows: priors of its scales and degrees of freedom, and Student's t for whole instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, gammaln

NOISES = ("gaussian", "student")


@dataclass(frozen=True)
class ScalePrior:
    """Inverse gamma law of every squared scale, ``s^2 ~ IG(shape, rate)``; (0, 0) is Jeffreys' ``1 / s``.

    Attributes
    ----------
    known
        Whether scales are held at one instead.
    """

    shape: float = 0.0
    rate: float = 0.0
    known: bool = False

    def log_density(self, log_scales: np.ndarray) -> np.ndarray:
        """Of the logarithms of the scales (..., k), up to a constant (...,)."""
        return np.sum(-2.0 * self.shape * log_scales - self.rate * np.exp(-2.0 * log_scales), axis=-1)

    def slope(self, log_scales: np.ndarray) -> np.ndarray:
        """Derivative of `log_density` by the logarithms of the scales (..., k)."""
        return -2.0 * self.shape + 2.0 * self.rate * np.exp(-2.0 * log_scales)


@dataclass(frozen=True)
class DofPrior:
    """Gamma law of Student's degrees of freedom, or their fixed value; the default is that of [Juarez2010]_."""

    shape: float = 2.0
    rate: float = 0.1
    fixed: float | None = None

    def log_density(self, dof: np.ndarray) -> np.ndarray:
        """Log density of the degrees of freedom, up to a constant."""
        return (self.shape - 1.0) * np.log(dof) - self.rate * dof


def log_student(squares: np.ndarray, channels: int, dof: float | np.ndarray) -> np.ndarray:
    """Log density of multivariate t at unit scale for squared lengths (...,)."""
    half = 0.5 * (dof + channels)
    constant = gammaln(half) - gammaln(0.5 * dof) - 0.5 * channels * np.log(dof * np.pi)
    return constant - half * np.log1p(squares / dof)


def student_log_likelihood(white: Sequence[np.ndarray], columns: np.ndarray, scales: np.ndarray, dof: float) -> float:
    """Log likelihood of all rows.

    Parameters
    ----------
    white
        Whitened rows [X y] of each group (N, channels, p + 1).
    columns
        Parameters of the columns (p,).
    scales
        Of all channels, group by group (k,).
    dof
        Degrees of freedom nu.
    """
    total = 0.0
    for rows, s in zip(white, np.split(scales, len(white)), strict=True):
        squares = np.sum(((rows[:, :, -1] - rows[:, :, :-1] @ columns) / s) ** 2, axis=1)
        total += np.sum(log_student(squares, len(s), dof)) - len(rows) * np.sum(np.log(s))
    return float(total)


def student_slopes(
    white: Sequence[np.ndarray], columns: np.ndarray, scales: np.ndarray, dof: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Derivatives of `student_log_likelihood` by the columns' parameters (p,), the log scales (k,) and dof.

    With residuals r, ``q_t = sum_c (r_tc / s_c)^2`` and weights ``w_t = (nu + C) / (nu + q_t)``

        d/d beta = sum_t w_t X_t' S^-2 r_t,      d/d log s_c = -N + sum_t w_t (r_tc / s_c)^2,
        d/d nu = 1/2 sum_t [psi((nu + C) / 2) - psi(nu / 2) - C / nu - log(1 + q_t / nu) + w_t q_t / nu].
    """
    by_columns, by_scales, by_dof = np.zeros(len(columns)), [], 0.0
    for rows, s in zip(white, np.split(scales, len(white)), strict=True):
        channels = len(s)
        unit = (rows[:, :, -1] - rows[:, :, :-1] @ columns) / s
        squares = np.sum(unit**2, axis=1)
        weight = (dof + channels) / (dof + squares)
        by_columns += np.einsum("tcp,tc->p", rows[:, :, :-1], weight[:, None] * unit / s)
        by_scales.append(weight @ unit**2 - len(rows))
        constant = digamma(0.5 * (dof + channels)) - digamma(0.5 * dof) - channels / dof
        by_dof += 0.5 * float(np.sum(constant - np.log1p(squares / dof) + weight * squares / dof))
    return by_columns, np.concatenate(by_scales), by_dof
