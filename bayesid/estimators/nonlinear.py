"""Effects that readings are not linear in: Gauss-Newton around any estimator.

The readings are linearised at a point, estimated, and linearised again at the estimate, until it no longer moves.
A step that makes the residual larger is halved.
"""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.nearest_links import nearest_links
from bayesid.effects import Point, moved
from bayesid.estimators import DEFAULT_METHOD, Estimate, Estimator, fit
from bayesid.regression.problem import Problem, absorbed_offset, relinearised

_ITERATIONS = 15
_HALVINGS = 6
#: The effects' parameters have settled when a step is this small against their standard deviations.
SETTLED = 0.05


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
    """
    estimate = fit(problem.regression, method)
    point = problem.row_model.point
    if point is None:
        return problem, estimate
    for _ in range(_ITERATIONS):
        here = problem.row_model.point
        assert here is not None
        # In units of the present noise: while the point is far off, model error counts as noise, too.
        cost = _cost(problem, here, estimate)
        others, now = slice(problem.row_model.base.rank, None), here.values[here.free]
        step = np.where(estimate.undetermined[others], 0.0, estimate.solution[others] - now)
        std = estimate.full_std[others]
        small = np.abs(step) <= np.where(np.isfinite(std) & (std > 0), SETTLED * std, 1e-6 + 1e-6 * np.abs(now))
        if small.all():
            break
        share, trial, new = 1.0, problem, np.inf
        for _ in range(_HALVINGS):
            there = _stepped(problem, here, estimate, step, share)
            trial = relinearised(problem, there)
            new = _cost(trial, there, estimate)
            if new <= cost * (1.0 + 1e-9):
                break
            share *= 0.5
        if not new <= cost * (1.0 + 1e-9):
            break
        problem = trial
        estimate = fit(problem.regression, method)
    return problem, estimate


def settled(problem: Problem) -> Problem:
    """The problem linearised at its least-squares estimate; the same where nothing has to be."""
    return problem if problem.row_model.point is None else solve(problem)[0]


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
