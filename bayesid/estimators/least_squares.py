"""Least squares with different weights, ridge regression and truncated singular values.

All minimise ``||W (y - X b)||`` for rows y = X b + e with cov e = Sigma:

* ``ols``: W = 1. Covariance from the noise as it is, ``(X'X)^-1 X' Sigma X (X'X)^-1``: the sandwich, which
  allows for the colour that filters give, and for encoder errors where they matter (`bayesid.estimators.covariance`).
* ``wls``: W = 1 / the standard deviation of each channel. The same sandwich.
* ``gls``: W'W = Sigma^-1, the efficient one; the sandwich with what whitening leaves of the noise's colour
  (the same module), ``(X' Sigma^-1 X)^-1`` where the noise is stated. It gives most weight to what has
  little noise, so where the model lacks something it is biased: then W is that of ``wls``, the estimate is that of ``wls``
  to the last digit, and it says so.
* ``ridge``, ``tsvd``: biased towards the nominal model, or zero without one; no interval would hold for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import fminbound

from bayesid.argument_types import explains_types
from bayesid.errors import InputError, require_one_of
from bayesid.estimators.covariance import covariance_middle
from bayesid.estimators.estimator import Details, Estimate, largest_autocorrelation
from bayesid.estimators.factor import Factor, reduce_in_coordinates, reduce_whitened, whitened
from bayesid.estimators.weights import Weights, learn_weights
from bayesid.regression.blocks import residual_of
from bayesid.regression.linalg import UNSEEN, column_lengths, condition_number, solve, standard_deviations
from bayesid.regression.regression import Regression

_WEIGHTS = ("none", "channel", "noise")
#: What an estimator that weights by the noise says where it weights by channel instead.
CHANNEL_INSTEAD = (
    "{} is the same as wls here, to the last digit: something is missing in the model, and weights by the colour of the noise "
    "would give most weight to whatever frequency is quiet, model error or not. So rows are weighted by channel. "
    "`bayesid.diagnose` looks for what is missing."
)


@dataclass(frozen=True, kw_only=True)
class LeastSquaresDetails(Details):
    """How the rows were weighted: ``none``, ``channel`` or ``noise``, as in `LeastSquares`."""

    weights: str


@explains_types
@dataclass(frozen=True)
class LeastSquares:
    """Least squares: ``weights`` is ``none`` (ols), ``channel`` (wls) or ``noise`` (gls)."""

    name: str
    weights: str

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with the covariance that belongs to these weights."""
        weights = learn_weights(regression)
        kind = likelihood_weights(weights) if self.weights == "noise" else self.weights
        factor, scale = weighted_factor(regression, weights, kind)
        bread = factor.inverse @ factor.inverse.T
        middle = covariance_middle(regression, weights, scale, factor)
        covariance = bread if middle.matrix is None else bread @ middle.matrix @ bread
        estimate = make_estimate(self.name, regression, weights, factor, solved(regression, factor), covariance)
        warnings = () if kind == self.weights else (CHANNEL_INSTEAD.format(self.name),)
        said = completeness(weights, middle.dispersion)
        return replace(estimate, details=LeastSquaresDetails(**said, weights=kind, warnings=warnings))


@dataclass(frozen=True, kw_only=True)
class RidgeDetails(Details):
    """Strength of the penalty, and the rule that it comes from."""

    strength: float
    rule: str


@dataclass(frozen=True, kw_only=True)
class TruncationDetails(Details):
    """Number of directions kept and of all, and the rule that it comes from."""

    kept: int
    of: int
    rule: str


@explains_types
@dataclass(frozen=True)
class Ridge:
    """Ridge regression towards the nominal parameters, or zero without a nominal model.

    Attributes
    ----------
    strength
        Penalty on columns of unit length relative to the largest singular value squared; None: by
        generalised cross-validation [Golub1979]_, ``GCV = RSS / (N - trace)^2``.
    weights
        As in `LeastSquares`.
    """

    name: str = "ridge"
    strength: float | None = None
    weights: str = "none"

    def fit(self, regression: Regression) -> Estimate:
        """Estimate; effects are not penalised."""
        if self.strength is not None and not self.strength >= 0:
            raise InputError(f"ridge strength = {self.strength}: give a number of at least 0")
        weights = learn_weights(regression)
        factor, _ = weighted_factor(regression, weights, self.weights)
        values, chosen = _shrink(regression, factor, self.strength, lambda s, k: s / (s**2 + k * s[0] ** 2), continuous=True)
        details = RidgeDetails(**completeness(weights), strength=chosen, rule=_rule(self.strength is None))
        return _biased(self.name, regression, weights, factor, values, details, "ridge regression is biased towards its prior")


@explains_types
@dataclass(frozen=True)
class TruncatedSVD:
    """Least squares in the directions of the largest singular values; the others stay nominal (or zero).

    Attributes
    ----------
    rank
        Number of directions kept; None: by generalised cross-validation.
    weights
        As in `LeastSquares`.
    """

    name: str = "tsvd"
    rank: int | None = None
    weights: str = "none"

    def fit(self, regression: Regression) -> Estimate:
        """Estimate; effects are not truncated."""
        r = regression.base.rank
        if self.rank is not None and not (0 <= self.rank <= r and self.rank == int(self.rank)):
            raise InputError(f"tsvd rank = {self.rank}: give a whole number, 0 to {r}")
        weights = learn_weights(regression)
        factor, _ = weighted_factor(regression, weights, self.weights)

        def keep(s: np.ndarray, k: float) -> np.ndarray:
            return np.where((np.arange(len(s)) < k) & (s > 0), 1.0 / np.where(s > 0, s, 1.0), 0.0)

        values, chosen = _shrink(regression, factor, self.rank, keep, continuous=False)
        details = TruncationDetails(**completeness(weights), kept=int(chosen), of=r, rule=_rule(self.rank is None))
        if self.rank == r:
            reason = "tsvd states none; with all directions kept it is least squares, as ols is, which states them"
        elif chosen == r:
            reason = "the rule looked at the data to choose how many directions to keep"
        else:
            reason = "truncated directions keep their prior value, which biases the estimate"
        return _biased(self.name, regression, weights, factor, values, details, reason)


def _rule(automatic: bool) -> str:
    return "generalised cross-validation" if automatic else "as given"


def likelihood_weights(weights: Weights) -> str:
    """How rows are weighted where they stand for a likelihood: ``noise``, or ``channel`` where the model lacks something."""
    return "noise" if weights.complete or weights.by_noise else "channel"


def weighted_factor(regression: Regression, weights: Weights, kind: str) -> tuple[Factor, dict[str, np.ndarray] | None]:
    """Factor of weighted rows, and what each channel (c,) of a group of rows was weighted with; None: rows were whitened.

    The kind is ``none``, ``channel`` or ``noise``, as in `LeastSquares`; an `InputError` for any other.
    """
    require_one_of(kind, _WEIGHTS, f"weights '{kind}'")
    if kind == "noise":
        return reduce_whitened(regression.rows.blocks(), weights.noise), None
    channels = len(regression.channel_names)
    scale = {g: (1.0 / m.std if kind == "channel" else np.ones(channels)) for g, m in weights.noise.items()}
    return reduce_in_coordinates(regression.rows, scale), scale


def nominal_start(regression: Regression, p: int) -> np.ndarray:
    """Where directions without information stay (p,): nominal base parameters, zero effects."""
    start = np.zeros(p)
    if regression.nominal is not None:
        start[: regression.base.rank] = regression.nominal
    return start


def solved(regression: Regression, factor: Factor) -> np.ndarray:
    """Least squares of weighted rows (p,), by way of the nominal parameters."""
    step = solve(factor.matrix, target_from_nominal(regression, factor), UNSEEN)
    return step + nominal_start(regression, factor.matrix.shape[1])


def target_from_nominal(regression: Regression, factor: Factor) -> np.ndarray:
    """Rotated target (p,) relative to the nominal parameters, of which `nominal_start` is the other part."""
    return factor.target - factor.matrix @ nominal_start(regression, factor.matrix.shape[1])


def _shrink(regression, factor: Factor, given, inverse, *, continuous: bool) -> tuple[np.ndarray, float]:
    """Filtered singular-value solution with one knob, chosen by generalised cross-validation if not given.

    Effect columns are eliminated first (they are not shrunk), base columns brought to unit length.
    """
    r = regression.base.rank
    effects, matrix = factor.matrix[:, r:], factor.matrix[:, :r]
    target = target_from_nominal(regression, factor)
    basis, shown, _ = np.linalg.svd(effects / column_lengths(effects), full_matrices=False)
    basis = basis[:, shown > UNSEEN * shown.max(initial=0.0)]  # an effect that never acts takes no direction from the others
    project = np.eye(len(target)) - basis @ basis.T
    length = column_lengths(project @ matrix, 1e-13)
    u, s, vt = np.linalg.svd(project @ matrix / length, full_matrices=False)
    seen = s > UNSEEN * s.max(initial=0.0)
    u, s, vt = u[:, seen], s[seen], vt[seen]
    rotated = u.T @ project @ target
    floor = factor.least_squares + max(float(np.sum((project @ target) ** 2) - rotated @ rotated), 0.0)

    def gcv(k: float) -> float:
        kept = inverse(s, k) * s
        rss = floor + np.sum(((1.0 - kept) * rotated) ** 2)
        left = factor.rows - basis.shape[1] - kept.sum()
        return float(rss / left**2) if left > 0.0 else np.inf

    if given is not None:
        chosen = float(given)
    elif continuous:
        grid = np.linspace(-12.0, 0.0, 49)
        best = grid[int(np.argmin([gcv(10.0**x) for x in grid]))]
        chosen = float(10.0 ** fminbound(lambda x: gcv(10.0**x), best - 0.25, best + 0.25, full_output=True)[0])
    else:
        chosen = float(np.argmin([gcv(k) for k in range(len(s) + 1)]))
    base = (vt.T @ (inverse(s, chosen) * rotated)) / length
    rest = solve(effects, target - matrix @ base) if effects.shape[1] else np.zeros(0)
    return np.concatenate([base, rest]) + nominal_start(regression, factor.matrix.shape[1]), chosen


def _biased(name, regression, weights, factor, values, details, reason) -> Estimate:
    estimate = make_estimate(name, regression, weights, factor, values, None)
    return replace(estimate, interval="none", interval_reason=reason, details=details)


def completeness(weights: Weights, dispersion: float | None = None) -> dict[str, Any]:
    """What every estimator says of the model, as keywords of its `Details`; its dispersion by default that of `Weights`."""
    return {
        "model_complete": weights.complete, "agreement_of_gls_and_wls": weights.agreement,
        "dispersion": weights.dispersion if dispersion is None else dispersion,
        "dispersion_by_channel": weights.dispersion_by_channel,
    }  # fmt: skip


def make_estimate(
    name: str, regression: Regression, weights: Weights, factor: Factor, solution: np.ndarray, covariance: np.ndarray | None
) -> Estimate:
    """An estimate with what every one says of itself: residuals in units of the noise, whiteness, weak parameters.

    ``factor`` is of the rows as they were weighted; base and effect parameters (p,) have a covariance (p, p), or None. Without a
    residual to learn the noise from, none is honest.
    """
    exact = regression.noise_std is None and factor.rows <= np.linalg.matrix_rank(factor.matrix / column_lengths(factor.matrix))
    covariance = None if exact else covariance
    white = [residual_of(rows, solution) for _, rows in whitened(regression.rows.pilot(), weights.noise)]
    count = sum(w.size for w in white)
    rms = float(np.sqrt(sum(np.sum(w**2) for w in white) / max(count - len(solution), 1)))
    weak = np.zeros(len(solution), bool)
    if covariance is not None:
        std = standard_deviations(covariance)[: regression.base.rank]
        size = regression.nominal_scale if regression.nominal_scale is not None else np.abs(solution[: regression.base.rank])
        weak[: regression.base.rank] = std > size
    return Estimate(
        method=name,
        base=regression.base,
        effect_names=regression.effect_names,
        effect_units=regression.effect_units,
        solution=solution,
        full_covariance=covariance,
        undetermined=factor.undetermined,
        weak=weak,
        interval="none" if exact else "confidence",
        interval_reason=f"{factor.rows} numbers leave no residual to tell the noise by; record longer, or more poses"
        if exact
        else "",
        noise=weights.noise,
        rows=factor.rows,
        condition_number=condition_number(factor.matrix),
        residual_rms=rms,
        whiteness=largest_autocorrelation(white),
        details=Details(**completeness(weights)),
    )
