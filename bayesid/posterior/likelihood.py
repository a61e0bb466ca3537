"""The likelihood on factors, one triangular factor a whitened channel whatever the number of rows, and the law of its rows.

After whitening (`bayesid.signals.noise`), row t of channel c is

    y_c(t) = x_c(t)' beta + s_c u_c(t),

with u of unit variance and one unknown scale s_c a channel, near one. With Gaussian u everything that the rows
say about (beta, s) is in the factors R_c of [X_c y_c] and their numbers of rows,

    log p(y | beta, s) = -sum_c [ n_c log s_c + |R_c (beta; -1)|^2 / (2 s_c^2) ] + constant.

Whitened rows are linearly transformed about their least-squares fit b so that the curvature of the likelihood is the inverse of
its sandwich covariance V [Ribatet2012]_, which holds the colour that whitening leaves and encoder errors where they matter
(`bayesid.estimators.covariance`):

    y + X (C - 1) b = X C beta + s u,   C' (X'X) C = V^-1.

Where the model lacks something (`Weights.complete`), whitening would give most weight to what has little noise, and so would
unknown scales: the channel that a flexible model fits best would gain weight until little else is fitted. Rows are then weighted
as those of ``wls``, ``X_c / std_c`` (where the model rings with the encoders' errors, whose noise is not learned from residuals
alone, still as those of ``gls``), and what they say is b and its covariance V, no more. V is itself an estimate, from how far
eight parts of the recording disagree, so that b is Student's t with seven degrees of freedom about the truth:

    log p(b | beta, s) = -n log s - |S (beta - b)|^2 / (2 s^2),   S'S = V^-1,   s^2 ~ IG(7/2, 7/2),

with n determined combinations and one scale s. What contradicts a prior that is trusted widens s, and with it the posterior.

Student's t takes the instant as the unit: a tap or a contact strikes all channels together, so all channels of an
instant share one weight w ~ Gamma(nu/2, nu/2), u = N(0, 1) / sqrt(w) [Lange1989]_.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, gammaln

from bayesid.estimators.conic.links import compressed
from bayesid.estimators.covariance import covariance_middle
from bayesid.estimators.factor import Factor, reduce_scaled, reduce_whitened, stack, whitened
from bayesid.estimators.least_squares import likelihood_weights
from bayesid.estimators.weights import Weights, learn_weights
from bayesid.regression.linalg import pseudo_inverse, solve
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel

NOISES = ("gaussian", "student")
_PANEL, _PASSES = 4096, 2


@dataclass(frozen=True)
class ScalePrior:
    """Inverse gamma law of every squared scale, ``s^2 ~ IG(shape, rate)``; (0, 0) is Jeffreys' ``1 / s``."""

    #: One for all scales, or one for each (k,).
    shape: float | np.ndarray = 0.0
    rate: float | np.ndarray = 0.0
    known: bool = False  # whether scales are held at one instead

    def log_density(self, log_scales: np.ndarray) -> np.ndarray:
        """Log density of the logarithms of the scales (..., k), up to a constant (...,)."""
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
    """Log likelihood of whitened rows [X y] of each group (N, channels, p + 1), with one scale a channel, group by group (k,)."""
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


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Whitened rows, reduced channel by channel."""

    factors: np.ndarray  # triangular factor of each channel's [X y] (k, p + 1, p + 1), channels of one group after the other
    counts: np.ndarray  # rows of each (k,)
    names: tuple[str, ...]  # of the scales (k,): the channel, with its group where there are several
    groups: tuple[str, ...] = ("trajectory",)  # in the order of the factors
    white: tuple[np.ndarray, ...] = ()  # whitened rows of each group (N, channels, p + 1); kept for Student's t alone
    noise: dict[str, NoiseModel] | None = None  # what they were whitened with, by group
    adjust: np.ndarray | None = None  # what whitened rows [X y] were then multiplied by (p + 1, p + 1)
    complete: bool = True  # false where the fit that the noise was learned from said that something is missing in the model
    dispersion: float = 1.0  # factor of the covariance for the scatter between parts of the recording
    estimate_only: bool = False  # whether the rows say an estimate and its covariance only: one factor, of these, and one scale
    factor: Factor | None = None  # of all weighted rows as they are; None where the likelihood was made from factors

    @classmethod
    def of(cls, regression: Regression, weights: Weights | None = None, *, keep_rows: bool = False) -> Likelihood:
        """Whiten and reduce a regression, which is read once, by default with the noise learned for generalised least squares."""
        weights = learn_weights(regression) if weights is None else weights
        columns, channels = len(regression.column_names) + 1, len(regression.channel_names)
        noise, scale, factor = _weighted(regression, weights, 0 if not keep_rows else _PASSES)
        middle = covariance_middle(regression, weights, scale, factor)
        adjust, wanted = _adjusted(factor, middle.matrix, shrink=not (weights.complete or keep_rows))
        if not (weights.complete or keep_rows):
            one = np.zeros((1, columns, columns))
            one[0, : len(wanted)] = wanted
            return cls(
                one, np.array([len(wanted)]), ("estimate",), tuple(noise), noise=noise, adjust=adjust, complete=False,
                dispersion=middle.dispersion, estimate_only=True, factor=factor,
            )  # fmt: skip
        factors: dict[str, list[np.ndarray]] = {}
        counts: dict[str, int] = {}
        rows: dict[str, list[np.ndarray]] = {}
        for block, plain in whitened(regression.rows.blocks(), noise):
            white = plain @ adjust
            own = factors.setdefault(block.group, [np.zeros((columns, columns))] * channels)
            for a in range(0, len(white), _PANEL):
                own = [stack(r, white[a : a + _PANEL, c]) for c, r in enumerate(own)]
            factors[block.group] = own
            counts[block.group] = counts.get(block.group, 0) + len(white)
            if keep_rows:
                rows.setdefault(block.group, []).append(white)
        names = [f"{c} ({g})" if len(factors) > 1 else c for g in factors for c in regression.channel_names]
        return cls(
            np.concatenate([np.stack(own) for own in factors.values()]),
            np.repeat(list(counts.values()), channels),
            tuple(names),
            tuple(factors),
            tuple(np.concatenate(parts) for parts in rows.values()),
            noise,
            adjust,
            weights.complete,
            middle.dispersion,
            factor=factor,
        )

    @property
    def rows(self) -> int:
        """How many scalar rows it was made from."""
        return int(self.counts.sum()) if self.factor is None else self.factor.rows


def _white(regression: Regression, group: str, solution: np.ndarray) -> NoiseModel:
    """White noise with the power of a fit's residuals."""
    residual = np.concatenate([b.target - b.matrix @ solution for b in regression.rows.pilot() if b.group == group])
    power = np.mean(residual**2, axis=0)
    return NoiseModel(np.ones((len(power), 1)), np.diag(np.maximum(power, 1e-20 * max(float(power.max()), 1e-200))))


def _adjusted(factor: Factor, middle: np.ndarray | None, *, shrink: bool) -> tuple[np.ndarray, np.ndarray]:
    """What weighted rows are multiplied by for a curvature of V^-1 (p + 1, p + 1), and its factor [S S b] (n, p + 1).

    With ``shrink`` what the fit b leaves of the rows is shrunk, too, so that all rows together pull by what V says: as many of
    them count for one as scatter together. Of unknown scales it would take the meaning.
    """
    # R b with R'R = X'X, and S b with S'S = V^-1, so that S = R C.
    plain, rotated = compressed(factor.matrix, factor.target, None)
    out = np.eye(factor.matrix.shape[1] + 1)
    if middle is None:
        return out, np.column_stack([plain, rotated])
    wanted, target = compressed(factor.matrix, factor.target, middle)
    plain, rotated = plain[: len(wanted)], rotated[: len(wanted)]  # weaker directions are hidden by rounding in the second
    back = pseudo_inverse(plain)
    fit = back @ rotated
    out[:-1, :-1] += back @ (wanted - plain)  # C
    if shrink:
        out[-1, -1] = (np.trace(back.T @ middle @ back) / len(plain)) ** -0.5
    out[:-1, -1] = out[:-1, :-1] @ fit - out[-1, -1] * fit
    return out, np.column_stack([wanted, target])


def _weighted(
    regression: Regression, weights: Weights, passes: int
) -> tuple[dict[str, NoiseModel], dict[str, np.ndarray] | None, Factor]:
    """Noise that rows are whitened with, what channels were weighted with instead (see `covariance_middle`), and the factor.

    Where the model is incomplete, and does not ring, the noise is white by channel: of no ``passes`` as large as that of the
    weights. Unknown scales must be those of the fit's own residuals: where a channel's scale is not one, its posterior moves the
    fit away from least squares, and by as much more as the curvature is smaller.
    """
    if likelihood_weights(weights) == "noise":
        return weights.noise, None, reduce_whitened(regression.rows.blocks(), weights.noise)
    noise = {group: model.uncoloured() for group, model in weights.noise.items()}
    solution = weights.solution
    for _ in range(passes):
        white = {group: _white(regression, group, solution) for group in noise}
        factor = reduce_scaled(regression.rows, {group: 1.0 / model.std for group, model in white.items()})
        solution = solve(factor.matrix, factor.target)
    if passes:
        noise = {group: _white(regression, group, solution) for group in noise}
    scale = {group: 1.0 / model.std for group, model in noise.items()}
    return noise, scale, reduce_scaled(regression.rows, scale)
