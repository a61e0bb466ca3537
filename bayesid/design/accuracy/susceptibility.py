"""Bias susceptibility [Armstrong1989]_: what effects that are left out of the model do to the estimate, in standard deviations.

With the rows ``y = X b + z + e``, z the exact action of an effect of usual size and X without it, a fit with weights W is off by

    d = (X'W'W X)^-1 X'W'W z,

which is exact for least squares with given weights and of first order for others. Weights by channel are learned from residuals,
which the effect enlarges: W is that of noise and what the fit leaves of z together. The bias is given in standard deviations of
the estimate, and by what it does to predictions of a motion that was not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.accuracy.bench import Bench, missing_effects
from bayesid.design.accuracy.fits import prediction_error
from bayesid.effects import Effect, MotionSegment, Term
from bayesid.errors import InputError
from bayesid.estimators.least_squares import LeastSquares, likelihood_weights, weighted_factor
from bayesid.estimators.weights import Weights, learn_weights
from bayesid.regression.linalg import solve
from bayesid.regression.parallel import in_order
from bayesid.regression.problem import restrict
from bayesid.regression.regression import Regression
from bayesid.regression.row_cache import MotionRows
from bayesid.regression.segment import Segment
from bayesid.signals.noise import NoiseModel
from bayesid.simulation.simulation import plant_readings
from bayesid.tasks import map_tasks

#: Fits with weights that were learned from the last one.
_REWEIGHTED = 3


@dataclass(frozen=True, eq=False)
class Susceptibility:
    """What one effect, left out of the model, does to an estimate."""

    effect: Effect  # which, and where
    values: tuple[float, ...]  # its size, one number a parameter
    bias: np.ndarray  # estimate with it less estimate without it, of the base parameters (r,)
    sigmas: np.ndarray  # the same in standard deviations of the estimate (r,); nan where there is none
    prediction: float  # error of predictions that this bias makes, as a share of the signal

    @property
    def largest(self) -> float:
        """Largest bias in standard deviations; 0 where nothing is known."""
        return float(np.nanmax(np.abs(self.sigmas))) if np.isfinite(self.sigmas).any() else 0.0

    @property
    def most_biased(self) -> int:
        """Index of the base parameter that it belongs to."""
        return int(np.nanargmax(np.abs(self.sigmas))) if np.isfinite(self.sigmas).any() else 0


def susceptibility(
    bench: Bench, std: np.ndarray, terms: tuple[Term, ...] | None = None, tell: Callable[[str], object] = lambda _: None
) -> tuple[Susceptibility, ...]:
    """Bias of the user's estimate, with standard deviations (r,), for each effect, default `missing_effects`, largest first."""
    problem = bench.problem
    terms = missing_effects(bench.experiment, problem.row_model) if terms is None else terms
    motions = [(s, bench.smoothed(s, problem.row_model)) for s in problem.fitted_segments]
    weights = learn_weights(problem.regression)
    start = _fitted(bench, [_read(bench, segment, states, ()) for segment, states in motions], weights)

    def off(term: Term) -> np.ndarray | None:
        try:
            with np.errstate(all="ignore"):
                read = [_read(bench, segment, states, (term,)) for segment, states in motions]
        except InputError:  # of this size there is no such effect, such as a joint too soft to carry its links
            return None
        return _fitted(bench, read, weights) - start

    out = []
    for k, (term, error) in enumerate(zip(terms, map_tasks(off, terms, locally=in_order), strict=True)):
        tell(f"effects left out: {k + 1} of {len(terms)}")
        if error is not None:
            base = error[: bench.rank]
            sigmas = np.where(np.isfinite(std) & (std > 0), base / np.where(std > 0, std, 1.0), np.nan)
            out.append(Susceptibility(term.effect, term.values, base, sigmas, prediction_error(bench, error)))
    return tuple(sorted(out, key=lambda s: -s.largest))


def _read(bench: Bench, segment: Segment, states: MotionSegment, more: tuple[Term, ...]) -> tuple[str, Segment]:
    """The segment with exact readings of the plant and further effects, and of its static run where that is subtracted."""
    robot, channels = bench.experiment.robot, bench.problem.row_model.channels
    terms = (*bench.terms, *more)
    readings, known = plant_readings(robot, channels, states, bench.links, terms), segment.known
    if not segment.gravity:
        known = plant_readings(robot, channels, states.at_rest, bench.links, terms)
    return bench.problem.regression.motion_names[segment.motion], replace(segment, readings=readings, known=known)


def _fitted(bench: Bench, read: Sequence[tuple[str, Segment]], weights: Weights) -> np.ndarray:
    """Least squares of exact readings (p,), with weights that know the noise and what the fit leaves."""
    segments = {name: [s for n, s in read if n == name] for name in bench.problem.fitted}
    rows = MotionRows(bench.problem.row_model, segments, bench.problem.fitted)
    regression = restrict(bench.problem, bench.problem.fitted, rows).regression
    kind = bench.method.weights if isinstance(bench.method, LeastSquares) else "channel"
    kind = likelihood_weights(weights) if kind == "noise" else kind
    solution = _solution(regression, weights, kind)
    for _ in range(_REWEIGHTED if kind == "channel" else 0):
        solution = _solution(regression, replace(weights, noise=_with_leftover(regression, solution, weights.noise)), kind)
    return solution


def _solution(regression: Regression, weights: Weights, kind: str) -> np.ndarray:
    factor, _ = weighted_factor(regression, weights, kind)
    return solve(factor.matrix, factor.target)


def _with_leftover(regression: Regression, solution: np.ndarray, noise: dict[str, NoiseModel]) -> dict[str, NoiseModel]:
    """Noise of each group of rows, its channels as large as noise and what a fit leaves of exact rows together."""
    power = {group: np.zeros(len(regression.channel_names)) for group in noise}
    count = dict.fromkeys(noise, 0)
    for block in regression.rows.blocks():
        power[block.group] += np.sum(block.residual(solution) ** 2, axis=0)
        count[block.group] += len(block.rows)
    return {group: m.scaled(1.0 + power[group] / max(count[group], 1) / m.std**2) for group, m in noise.items()}
