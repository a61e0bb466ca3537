"""Effects that readings are not linear in: Gauss-Newton around any estimator.

The readings are linearised at a point, estimated, and linearised again at the estimate, until it no longer moves. A step that
makes the residual larger, or not a number, is halved [Deuflhard2011]_; where that does not help, the fit stops where it is.
A step that turns back, as those of the speed at which Stribeck friction falls often do, goes to the mean of the last two
estimates from which no step would be left, were steps linear in the point [Anderson1965]_. The estimate may then still point far
away, along what the motions do not tell from other parameters, to where its linearisation says nothing. Then a descent within
trust regions (`bayesid.estimators.exact_rows`) shows whether there is a minimum after all: of cables tied to any place,
Gauss-Newton ran away with half. Parameters that readings are not linear in are held where the fit stopped, if it still points
further away than their standard deviations, and the others are fitted beside them.

From afar, a mount that rings looks stiff: the cost of a resonance has a valley as narrow as the resonance is sharp, and
Gauss-Newton finds the bottom of the one that it starts in; and so with where a cable is tied. So where no starting value of
such an effect is stated, each of its own trials (`bayesid.effects.Effect.starts_tried`) is held in turn, everything linear is
fitted, and the one that leaves least is the start: least in ``sum_c log s_c``, s_c what channel c leaves, the likelihood of
noise of unknown sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from bayesid.effects import Point, Surroundings, with_places
from bayesid.effects.surroundings import surroundings_of
from bayesid.errors import InputError
from bayesid.estimators import DEFAULT_METHOD, Estimate, Estimator, Huber, Physical, Student, estimator, fit
from bayesid.estimators.exact_rows import ExactRows, plausible, point_of, point_with, shapes
from bayesid.estimators.factor import Factor, Pilot, whitened
from bayesid.estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from bayesid.regression.blocks import Block, residual_of
from bayesid.regression.linalg import solve as least_squares
from bayesid.regression.problem import Problem, chosen_again, pilot_pieces, relinearised
from bayesid.regression.segment import LongSegment

#: The effects' parameters have settled when a step is this small against their standard deviations.
SETTLED = 0.05
#: Rounds of weighting channels by what a start leaves in them.
_STARTING_PASSES = 3
#: Estimators whose values do not depend on what is known of encoder errors, only their covariance does.
COVARIANCE_ALONE = (LeastSquares, Ridge, TruncatedSVD, Huber, Student, Physical)
#: Standard deviations beyond which a value is out of what is plausible.
_CERTAIN = 3.0
#: Steps of a descent within trust regions at most, and the share of the sum of squares by which its last one is for the better.
_DESCENT, _NEARLY = 40, 1e-4
#: Steps at most, and how often each is halved until it makes the residual no larger; the next one is tried whole again.
_STEPS, _HALVED = 15, 5


def solve(
    problem: Problem, method: str | Estimator = DEFAULT_METHOD, rows_made: Callable[[], None] | None = None
) -> tuple[Problem, Estimate]:
    """Estimate, with the model linearised where the estimate is.

    The problem is that linearised one, the same where nothing has to be. ``rows_made`` is called once the first rows are there.
    An `InputError` where readings are not finite at the start of the effects.
    """
    if rows_made is not None:
        problem.regression.rows.pilot()  # of rows that fit in memory, all are made for it
        rows_made()
    if problem.row_model.point is None:
        return problem, fit(problem.regression, method)
    found = _found(problem, method)
    return found.problem, found.estimate if found.whole else fit(found.problem.regression, method)


def _found(problem: Problem, method: str | Estimator) -> Fitted:
    """The minimum, from the best start, with the bandwidth chosen again where the effects are known."""
    found, chosen = _minimised(_started(problem), method), {problem.smoother.bandwidth}
    # Two choices may follow each other for ever.
    while (again := chosen_again(found.problem)).smoother.bandwidth not in chosen:
        found = _minimised(again, method)
        chosen.add(again.smoother.bandwidth)
    return found


def _started(problem: Problem) -> Problem:
    """The problem linearised at the best start of its effects, all that is linear fitted beside their shapes.

    Effects of which a value is stated, or found already, start there.
    """
    for effect, own in with_places(problem.row_model.effects):
        point = point_of(problem)
        if effect.tries_starts and point.free[own].all() and tuple(point.values[own]) == effect.starts:
            held = shapes(problem)
            held[: own.start] = held[own.stop :] = False
            tried = [problem]
            for values in effect.starts_tried(_surroundings(problem)):
                there = point.values.copy()
                there[own] = values
                tried.append(relinearised(problem, replace(point, values=there)))
            problem = min(tried, key=partial(_left, held=held))
    return _linear_fitted(problem)


def _left(problem: Problem, held: np.ndarray) -> float:
    """``sum_c log s_c`` of a few rows with some of the effects' parameters held (e,); infinite where readings are not finite."""
    found = _linear_fit(problem, problem.regression.rows.few(), held)
    return np.inf if found is None else float(np.sum(np.log(found.scale)))


class LinearFit(NamedTuple):
    """A fit to linearised rows with some of the effects' parameters held."""

    solution: np.ndarray  # (p,)
    scale: np.ndarray  # what it leaves, root mean square by channel (c,)
    factor: Factor  # of the rows, weighted by what the pass before left


def _linear_fit(problem: Problem, blocks: Sequence[Block], held: np.ndarray) -> LinearFit | None:
    """The fit to some blocks with those parameters held (e,); None where readings are not finite."""
    point = point_of(problem)
    if not all(np.isfinite(b.rows).all() for b in blocks):
        return None
    at = np.append(np.zeros(len(point.base), bool), held[point.free])
    solution, scale = np.concatenate([point.base, point.values[point.free]]), np.ones(len(problem.row_model.channels))
    pilot = Pilot.of(blocks)
    factor = pilot.weighted(scale)
    for more in reversed(range(_STARTING_PASSES)):
        solution[~at] = least_squares(factor.matrix[:, ~at], factor.target - factor.matrix[:, at] @ solution[at])
        residual = np.concatenate([b.residual(solution) for b in blocks])
        scale = np.sqrt(np.mean(residual**2, axis=0))
        scale = np.maximum(scale, 1e-9 * max(float(scale.max()), 1e-300))
        factor = pilot.weighted(scale) if more else factor
    return LinearFit(solution, scale, factor)


def _linear_fitted(problem: Problem) -> Problem:
    """The problem linearised where all that readings are linear in suits the shapes; effects that would be impossible stay.

    From nominal links most steps are for the better, also those that lead shapes astray.
    """
    here, held = point_of(problem), shapes(problem)
    if not (held & here.free).any() or (found := _linear_fit(problem, problem.regression.rows.pilot(), held)) is None:
        return problem
    rank, (low, high), seen = problem.row_model.base.rank, plausible(problem), ~found.factor.undetermined
    fitted, values = found.solution[rank:], here.values.copy()
    values[here.free] = np.where((fitted > low) & (fitted < high) & seen[rank:], fitted, values[here.free])
    return relinearised(problem, point_with(problem, found.solution[:rank], values, seen[:rank]))


def _surroundings(problem: Problem) -> Surroundings:
    row_model, experiment = problem.row_model, problem.experiment
    robot, sensor = row_model.robot, experiment.sensor
    own = problem.fitted_segments
    pieces = [p for s in own for p in (pilot_pieces(row_model, [s]) if isinstance(s, LongSegment) else (s,))]
    motions = [row_model.state(p, 0, p.count) for p in pieces]
    return surroundings_of(
        robot, motions, robot.nominal.ravel(), problem.channel, sensor is not None and sensor.joint is None,
        static_run=problem.static != "none", links_known=experiment.inertia_rel_std is not None,
    )  # fmt: skip


def _minimised(problem: Problem, method: str | Estimator) -> Fitted:
    """The minimum near where a problem is linearised; shapes that run away are held."""
    if not all(np.isfinite(block.rows).all() for block in problem.regression.rows.blocks()):
        specs = ", ".join(e.spec for e in problem.row_model.effects)
        raise InputError(f"readings are not finite where {specs} start; state other values in [model.values]")
    now = _stepped_to_end(problem, method)
    if np.any(_far(now.problem, now.estimate) > 1.0) and not problem.row_model.rings:
        other = _stepped_to_end(_descended(problem), method)
        # Friction that runs away from there as well is not told by the rows: the descent led it to where it does nothing.
        still, effects = _far(other.problem, other.estimate) > 1.0, problem.row_model.effects
        now = now if any(still[own].any() for e, own in with_places(effects) if not e.tries_starts) else other
    while np.any((far := _far(now.problem, now.estimate)) > 1.0):
        # One effect at a time: without the one that ran furthest the others may settle.
        point = point_of(now.problem)
        furthest = (far == far.max()) & point.free & shapes(now.problem)
        unsettled = furthest if point.unsettled is None else point.unsettled | furthest
        now = _stepped_to_end(relinearised(now.problem, replace(point, free=point.free & ~furthest, unsettled=unsettled)), method)
    return now


def _stepped_to_end(problem: Problem, method: str | Estimator) -> Fitted:
    """Where steps of Gauss-Newton end."""
    now = Fitted(problem, method)
    for _ in range(_STEPS):
        if (then := now.next()) is None:
            break
        now = then
    return now


def _descended(problem: Problem) -> Problem:
    """The problem linearised where a descent within trust regions ends, with channels weighted by what the start leaves."""
    found = _linear_fit(problem, problem.regression.rows.pilot(), shapes(problem))
    if found is None:
        return problem
    exact = ExactRows(problem, dict.fromkeys(("trajectory", "poses"), found.scale))
    return exact.at(exact.least(exact.start, tolerance=_NEARLY, most=_DESCENT)[0])


def ran_away(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Which of all effects' parameters are shapes of effects that an estimate has far from where it is linearised (e,)."""
    point = problem.row_model.point
    return np.zeros(len(problem.row_model.free), bool) if point is None else (_far(problem, estimate) > 1.0) & shapes(problem)


def _far(problem: Problem, estimate: Estimate) -> np.ndarray:
    """How far an estimate has effects with shapes from where they are linearised, the furthest of each one's parameters (e,).

    In standard deviations; infinitely far where it is out of what is plausible for certain, and zero where no shape is estimated.
    """
    row_model, point = problem.row_model, problem.row_model.point
    out = np.zeros(len(row_model.free))
    if point is None:
        return out
    (low, high), now = plausible(problem), point.values[point.free]
    values, std = estimate.solution[row_model.base.rank :], estimate.full_std[row_model.base.rank :]
    known = np.isfinite(std) & (std > 0.0)
    outside = np.maximum(low - values, values - high) > _CERTAIN * np.where(known, std, 0.0)
    out[point.free] = np.where(outside, np.inf, np.abs(values - now) / np.where(known, std, np.inf))
    held = shapes(problem) & point.free
    for _, own in with_places(row_model.effects):
        out[own] = out[own].max() if held[own].any() else 0.0
    return out


@dataclass(frozen=True)
class Fitted:
    """A problem linearised at a point, with its estimate."""

    problem: Problem
    method: str | Estimator
    before: tuple[np.ndarray, np.ndarray] | None = None  # where the step to it began, and the estimate there (p,)

    @cached_property
    def estimate(self) -> Estimate:
        """The estimate of the linearised problem; made when asked for, as states that are refused need none."""
        regression = self.problem.regression
        return fit(regression if self.whole else replace(regression, regressor_noise=None), self.method)

    @property
    def whole(self) -> bool:
        """Whether the covariance counts encoder errors; where values do not depend on them, steps do not wait for that."""
        law = self.problem.regression.regressor_noise
        return law is None or law.rung or not isinstance(estimator(self.method), COVARIANCE_ALONE)

    def next(self) -> Fitted | None:
        """A step towards the estimate; None where it is at the point already, or no share of the step is for the better."""
        problem = self.problem
        here = point_of(problem)
        estimate = _within_bounds(problem, here, self.estimate)
        others, now = slice(problem.row_model.base.rank, None), here.values[here.free]
        step = np.where(estimate.undetermined[others], 0.0, estimate.solution[others] - now)
        std = estimate.full_std[others]
        small = np.abs(step) <= np.where(np.isfinite(std) & (std > 0), SETTLED * std, 1e-6 + 1e-6 * np.abs(now))
        if small.all():
            return None
        # In units of the present noise: while the point is far off, model error counts as noise, too.
        cost, at = _cost(problem, here, estimate), np.concatenate([here.base, here.values[here.free]])
        aim = estimate if self.before is None else where_no_step_is_left(at, estimate, *self.before)
        for halved in range(_HALVED + 1):
            there = _stepped(problem, here, aim, 0.5**halved)
            moved_problem = relinearised(problem, there)
            if _cost(moved_problem, there, estimate) <= cost + 1e-9 * cost:
                return Fitted(moved_problem, self.method, (at, estimate.solution))
        return None


def where_no_step_is_left(at: np.ndarray, estimate: Estimate, at_before: np.ndarray, before: np.ndarray) -> Estimate:
    """The estimate of a problem linearised at ``at`` (p,), or its mean with the one ``before`` where the step turns back.

    Steps are in standard deviations; the mean's is the least, where steps are linear in the point.
    """
    known = ~estimate.undetermined & np.isfinite(estimate.full_std) & (estimate.full_std > 0.0)
    size = np.where(known, estimate.full_std, np.inf)
    step, last = (estimate.solution - at) / size, (before - at_before) / size
    if step @ last >= 0.0:
        return estimate
    share = step @ (step - last) / np.sum((step - last) ** 2)
    return replace(estimate, solution=estimate.solution + share * (before - estimate.solution))


def default_method(problem: Problem) -> str:
    """`DEFAULT_METHOD`; ``gls`` where something rings: weights by channel alone would let it follow the noise."""
    return "gls" if problem.row_model.rings else DEFAULT_METHOD


def settled(problem: Problem, method: str | Estimator | None = None) -> Problem:
    """The problem linearised at its estimate, by default that of least squares; the same where nothing has to be."""
    return problem if problem.row_model.point is None else _found(problem, method or default_method(problem)).problem


def _within_bounds(problem: Problem, here: Point, estimate: Estimate) -> Estimate:
    """The estimate with parameters held at a bound where they stand at one and would go beyond.

    What the others become is their mean given those held, ``x + C_xh C_hh^-1 (h - x_h)``: their own steps fit those that the held
    ones would take, and lead nowhere without them.
    """
    if estimate.full_covariance is None:
        return estimate
    rank = problem.row_model.base.rank
    (low, high), now = plausible(problem), here.values[here.free]
    solution, covariance = estimate.solution, estimate.full_covariance
    held = np.zeros(len(solution), bool)
    for _ in range(len(now)):
        out = ((now <= low) & (solution[rank:] < low)) | ((now >= high) & (solution[rank:] > high))
        out &= ~held[rank:] & ~estimate.undetermined[rank:]
        if not out.any():
            break
        held[rank:] |= out
        at = now - estimate.solution[rank:]
        across = covariance[:, held] @ np.linalg.pinv(covariance[np.ix_(held, held)])
        solution = estimate.solution + across @ at[held[rank:]]
        solution[rank:][held[rank:]] = now[held[rank:]]
    return replace(estimate, solution=solution) if held.any() else estimate


def _stepped(problem: Problem, here: Point, estimate: Estimate, share: float) -> Point:
    """The point a share of the way towards the estimate, within what is plausible."""
    rank = problem.row_model.base.rank
    low, high = plausible(problem)
    # A shape that cannot be negative shrinks by steps: none jumps to its limit, where nothing moves any more.
    shape = shapes(problem)[here.free]
    now = here.values[here.free]
    low = np.where(shape & (low >= 0.0), np.maximum(low, 0.4 * now), low)
    values, step = here.values.copy(), np.where(estimate.undetermined[rank:], 0.0, estimate.solution[rank:] - now)
    values[here.free] = np.clip(now + share * step, low, high)
    wanted = here.base + share * (estimate.values - here.base)
    return point_with(problem, wanted, values, ~estimate.undetermined[:rank])


def _cost(problem: Problem, point: Point, estimate: Estimate) -> float:
    """Mean square of the rows' residual at the point, in units of the noise.

    Where something rings, of whitened rows, as they are fitted (`bayesid.estimators.weights`): by channel alone, every step to
    less damping is for the worse, for then the encoders' errors ring louder.
    """
    solution, blocks = np.concatenate([point.base, point.values[point.free]]), problem.regression.rows.blocks()
    any_noise = next(iter(estimate.noise.values()))
    noise = {group: estimate.noise.get(group, any_noise) for group in ("trajectory", "poses")}
    if problem.row_model.rings:
        left = (residual_of(rows, solution) for _, rows in whitened(blocks, noise))
    else:
        left = (b.residual(solution) / noise[b.group].std for b in blocks)
    power, count = np.sum([(np.sum(x**2), x.size) for x in left], axis=0)
    return float(power / max(count, 1))
