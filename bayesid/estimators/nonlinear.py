"""Effects that readings are not linear in: Gauss-Newton around any estimator.

The readings are linearised at a point, estimated, and linearised again at the estimate, until it no longer moves.
A step that makes the residual larger is halved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.dynamics.nearest_links import nearest_links
from bayesid.effects import Point, moved
from bayesid.errors import InputError
from bayesid.estimators import DEFAULT_METHOD, Estimate, Estimator, Huber, Physical, Student, estimator, fit
from bayesid.estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from bayesid.regression.gauss_newton import Linearised, StepControl, minimise
from bayesid.regression.problem import Problem, relinearised
from bayesid.regression.structure import absorbed_offset

#: The effects' parameters have settled when a step is this small against their standard deviations.
SETTLED = 0.05
#: Estimators whose values do not depend on what is known of encoder errors, only their covariance does.
_COVARIANCE_ALONE = (LeastSquares, Ridge, TruncatedSVD, Huber, Student, Physical)
#: Shares of a step are tried until one makes the residual no larger; the next step is tried whole again.
_CONTROL = StepControl(
    steps=15, trials=6, first=1.0, refused=lambda share: 0.5 * share, accepted=lambda _: 1.0, tolerance=lambda cost: 1e-9 * cost
)


def solve(problem: Problem, method: str | Estimator = DEFAULT_METHOD) -> tuple[Problem, Estimate]:
    """Estimate, with the model linearised where the estimate is.

    Parameters
    ----------
    problem
        From `bayesid.regression.problem.prepare`.
    method
        The estimator.

    Returns
    -------
    problem, estimate
        The problem, linearised at the estimate; the same where nothing has to be.

    Raises
    ------
    InputError
        Readings are not finite where the effects start.
    """
    if problem.row_model.point is None:
        return problem, fit(problem.regression, method)
    found = _minimised(problem, method)
    return found.problem, found.estimate if found.whole else fit(found.problem.regression, method)


def _minimised(problem: Problem, method: str | Estimator) -> Fitted:
    if not all(np.isfinite(block.rows).all() for block in problem.regression.blocks()):
        raise InputError(f"readings are not finite where {_specs(problem)} start; state other values in [model.values]")
    return minimise(Fitted(problem, method), Fitted.linearised, _CONTROL)


def _specs(problem: Problem) -> str:
    return ", ".join(e.spec for e in problem.row_model.effects)


@dataclass(frozen=True)
class Fitted:
    """A problem linearised at a point, with its estimate."""

    problem: Problem
    method: str | Estimator

    @cached_property
    def estimate(self) -> Estimate:
        """The estimate of the linearised problem; made when asked for, as states that are refused need none."""
        regression = self.problem.regression
        return fit(regression if self.whole else replace(regression, regressor_noise=None), self.method)

    @property
    def whole(self) -> bool:
        """Whether the covariance counts encoder errors; where values do not depend on them, steps do not wait for that."""
        return self.problem.regression.regressor_noise is None or not isinstance(estimator(self.method), _COVARIANCE_ALONE)

    def linearised(self) -> Linearised[Fitted] | None:
        """Steps towards the estimate; None where it is at the point already."""
        problem, estimate = self.problem, self.estimate
        here = problem.row_model.point
        assert here is not None
        others, now = slice(problem.row_model.base.rank, None), here.values[here.free]
        step = np.where(estimate.undetermined[others], 0.0, estimate.solution[others] - now)
        std = estimate.full_std[others]
        small = np.abs(step) <= np.where(np.isfinite(std) & (std > 0), SETTLED * std, 1e-6 + 1e-6 * np.abs(now))
        if small.all():
            return None

        def trial(share: float) -> tuple[Fitted, float]:
            there = _stepped(problem, here, estimate, step, share)
            moved_problem = relinearised(problem, there)
            return Fitted(moved_problem, self.method), _cost(moved_problem, there, estimate)

        # In units of the present noise: while the point is far off, model error counts as noise, too.
        return Linearised(_cost(problem, here, estimate), trial)


def settled(problem: Problem) -> Problem:
    """The problem linearised at its least-squares estimate; the same where nothing has to be."""
    return problem if problem.row_model.point is None else _minimised(problem, DEFAULT_METHOD).problem


def _stepped(problem: Problem, here: Point, estimate: Estimate, step: np.ndarray, share: float) -> Point:
    """The point a share of the way towards the estimate, within what is plausible."""
    row_model = problem.row_model
    low = np.array([v for e in row_model.effects for v in e.lower])[here.free]
    high = np.array([v for e in row_model.effects for v in e.upper])[here.free]
    # A shape that cannot be negative shrinks by steps: none jumps to its limit, where nothing moves any more.
    shape = np.array([key in e.shape for e in row_model.effects for key in e.parameters])[here.free]
    now = here.values[here.free]
    low = np.where(shape & (low >= 0.0), np.maximum(low, 0.4 * now), low)
    values = here.values.copy()
    values[here.free] = np.clip(values[here.free] + share * step, low, high)
    seen = ~estimate.undetermined[: row_model.base.rank]
    wanted = here.base + share * np.where(seen, estimate.values - here.base, 0.0)
    links = nearest_links(row_model.robot, row_model.base, wanted, seen)
    absorbed = absorbed_offset(row_model.base, links)
    return moved(here, links.reshape(-1, 10), row_model.base.matrix @ links, values, absorbed)


def _cost(problem: Problem, point: Point, estimate: Estimate) -> float:
    """Mean square of the rows' residual at the point, in units of the noise."""
    solution = np.concatenate([point.base, point.values[point.free]])
    power, count = 0.0, 0
    for block in problem.regression.blocks():
        noise = estimate.noise.get(block.group) or next(iter(estimate.noise.values()))
        power += float(np.sum(((block.target - block.matrix @ solution) / noise.std) ** 2))
        count += block.target.size
    return power / max(count, 1)
