"""Effects that readings are not linear in: Gauss-Newton around any estimator.

The readings are linearised at a point, estimated, and linearised again at the estimate, until it no longer moves.
A step that makes the residual larger is halved.

From afar, a mount that rings looks stiff: the cost of a resonance has a valley as narrow as the resonance is sharp, and
Gauss-Newton finds the bottom of the one that it starts in. So where no starting value of an effect that rings is stated, each
of its own trials (`bayesid.effects.Effect.trials`) is held in turn, everything linear is fitted, and the one that leaves least
is the start: least in ``sum_c log s_c``, s_c what channel c leaves, the likelihood of noise of unknown sizes.

The steps have step control, for any model that can be linearised at a point. A step is tried, and tried again more cautiously
while it makes the cost larger or not a number (the trial diverged); when no caution helps, the fit stops where it is. What
caution means is the model's: a share of the step [Deuflhard2011]_, or damping [Levenberg1944]_, [Marquardt1963]_.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Generic, TypeVar

import numpy as np

from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects import Effect, Point, Surroundings, moved
from bayesid.effects.surroundings import surroundings_of
from bayesid.errors import InputError
from bayesid.estimators import DEFAULT_METHOD, Estimate, Estimator, Huber, Physical, Student, estimator, fit
from bayesid.estimators.factor import Pilot
from bayesid.estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from bayesid.regression.linalg import solve as least_squares
from bayesid.regression.problem import Problem, chosen_again, relinearised
from bayesid.regression.structure import absorbed_offset

State = TypeVar("State")


@dataclass(frozen=True)
class Linearised(Generic[State]):
    """A model linearised at a state."""

    cost: float  # what is minimised, at the state
    #: From the caution: the state after a step, and its cost. States are new objects: a refused one leaves no trace.
    trial: Callable[[float], tuple[State, float]]


@dataclass(frozen=True)
class StepControl:
    """How steps are accepted, and how cautious the next one is."""

    #: At most so many steps, and trials of each.
    steps: int
    trials: int
    first: float  # caution of the first trial
    #: From the caution of a trial that was refused, or accepted: that of the next.
    refused: Callable[[float], float]
    accepted: Callable[[float], float]
    tolerance: Callable[[float], float]  # from the cost at the state: a trial may be larger by this
    settled: float = float("-inf")  # stop after an accepted step that gains less than this


def minimise(state: State, linearise: Callable[[State], Linearised[State] | None], control: StepControl) -> State:
    """Step from a state until nothing is gained any more.

    ``linearise`` gives None where no step is worth taking: the model has settled, or cannot be linearised.
    """
    caution = control.first
    for _ in range(control.steps):
        model = linearise(state)
        if model is None:
            break
        limit = model.cost + control.tolerance(model.cost)
        for _ in range(control.trials):
            trial, cost = model.trial(caution)
            if cost <= limit:
                break
            caution = control.refused(caution)
        else:
            break
        state, caution = trial, control.accepted(caution)
        if model.cost - cost < control.settled:
            break
    return state


#: The effects' parameters have settled when a step is this small against their standard deviations.
SETTLED = 0.05
#: Rounds of weighting channels by what a start leaves in them.
_STARTING_PASSES = 3
#: Times that the bandwidth is chosen again, at most: two choices may follow each other for ever.
_ROUNDS = 3
#: Estimators whose values do not depend on what is known of encoder errors, only their covariance does.
_COVARIANCE_ALONE = (LeastSquares, Ridge, TruncatedSVD, Huber, Student, Physical)
#: Shares of a step are tried until one makes the residual no larger; the next step is tried whole again.
_CONTROL = StepControl(
    steps=15, trials=6, first=1.0, refused=lambda share: 0.5 * share, accepted=lambda _: 1.0, tolerance=lambda cost: 1e-9 * cost
)


def solve(
    problem: Problem, method: str | Estimator = DEFAULT_METHOD, rows_made: Callable[[], None] | None = None
) -> tuple[Problem, Estimate]:
    """Estimate, with the model linearised where the estimate is.

    The problem is that linearised one, the same where nothing has to be. ``rows_made`` is called once the first rows are there.
    An `InputError` where readings are not finite at the start of the effects.
    """
    if rows_made is not None:
        problem.regression.pilot()  # of rows that fit in memory, all are made for it
        rows_made()
    if problem.row_model.point is None:
        return problem, fit(problem.regression, method)
    found = _found(problem, method)
    return found.problem, found.estimate if found.whole else fit(found.problem.regression, method)


def _found(problem: Problem, method: str | Estimator) -> Fitted:
    """The minimum, from the best start, with the bandwidth chosen again where the effects are known."""
    found = _minimised(_started(problem), method)
    for _ in range(_ROUNDS):
        again = chosen_again(found.problem)
        if again.smoother.bandwidth == found.problem.smoother.bandwidth:
            break
        found = _minimised(again, method)
    return found


def _started(problem: Problem) -> Problem:
    """The problem linearised where the best trial of effects that ring is; the same where a value is stated or found already."""
    for effect in problem.row_model.effects:
        if effect.settling > 0.0 and _at_start(problem, effect):
            problem = _best(problem, effect)
    return problem


def _place(problem: Problem, effect: Effect) -> slice:
    """Indices of its parameters among those of all effects."""
    before = problem.row_model.effects[: problem.row_model.effects.index(effect)]
    first = sum(len(e.parameters) for e in before)
    return slice(first, first + len(effect.parameters))


def _at_start(problem: Problem, effect: Effect) -> bool:
    """Whether all its parameters are estimated and stand where they start if nothing is stated."""
    point, own = problem.row_model.point, _place(problem, effect)
    return point is not None and bool(point.free[own].all()) and tuple(point.values[own]) == effect.starts


def _best(problem: Problem, effect: Effect) -> Problem:
    point, own = problem.row_model.point, _place(problem, effect)
    assert point is not None
    tried = [problem]
    for values in effect.trials(_surroundings(problem)):
        there = point.values.copy()
        there[own] = values
        tried.append(relinearised(problem, replace(point, values=there)))
    return min(tried, key=partial(_left, held=own))


def _left(problem: Problem, held: slice) -> float:
    """``sum_c log s_c`` with some of the effects' parameters held; infinite where readings are not finite."""
    point = problem.row_model.point
    assert point is not None
    at = np.zeros(len(point.values), bool)
    at[held] = True
    at = np.concatenate([np.zeros(len(point.base), bool), at[point.free]])
    solution, scale = np.concatenate([point.base, point.values[point.free]]), np.ones(len(problem.row_model.channels))
    blocks = problem.regression.pilot()
    if not all(np.isfinite(b.rows).all() for b in blocks):
        return np.inf
    pilot = Pilot.of(blocks)
    for _ in range(_STARTING_PASSES):
        factor = pilot.weighted(scale)
        solution[~at] = least_squares(factor.matrix[:, ~at], factor.target - factor.matrix[:, at] @ solution[at])
        residual = np.concatenate([b.residual(solution) for b in blocks])
        scale = np.sqrt(np.mean(residual**2, axis=0))
        scale = np.maximum(scale, 1e-9 * max(float(scale.max()), 1e-300))
    return float(np.sum(np.log(scale)))


def _surroundings(problem: Problem) -> Surroundings:
    row_model, experiment = problem.row_model, problem.experiment
    robot, sensor = row_model.robot, experiment.sensor
    segments = [s for name in problem.fitted for s in problem.segments[name]]
    motions = [row_model.state(s, 0, len(s.times)) for s in segments]
    return surroundings_of(
        robot, motions, robot.nominal.ravel(), problem.channel, sensor is not None and sensor.joint is None,
        static_run=problem.static != "none", links_known=experiment.inertia_rel_std is not None,
    )  # fmt: skip


def _minimised(problem: Problem, method: str | Estimator) -> Fitted:
    if not all(np.isfinite(block.rows).all() for block in problem.regression.blocks()):
        specs = ", ".join(e.spec for e in problem.row_model.effects)
        raise InputError(f"readings are not finite where {specs} start; state other values in [model.values]")
    return minimise(Fitted(problem, method), Fitted.linearised, _CONTROL)


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
        law = self.problem.regression.regressor_noise
        return law is None or law.rung or not isinstance(estimator(self.method), _COVARIANCE_ALONE)

    def linearised(self) -> Linearised[Fitted] | None:
        """Steps towards the estimate; None where it is at the point already."""
        problem = self.problem
        here = problem.row_model.point
        assert here is not None
        estimate = _within_bounds(problem, here, self.estimate)
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


def default_method(problem: Problem) -> str:
    """`DEFAULT_METHOD`; ``gls`` where something rings: weights by channel alone would let it follow the noise."""
    return "gls" if problem.row_model.rings else DEFAULT_METHOD


def settled(problem: Problem) -> Problem:
    """The problem linearised at its least-squares estimate; the same where nothing has to be."""
    return problem if problem.row_model.point is None else _found(problem, default_method(problem)).problem


def _bounds(problem: Problem, here: Point) -> tuple[np.ndarray, np.ndarray]:
    """Plausible ranges of the effects' parameters that are estimated."""
    effects = problem.row_model.effects
    low, high = ([v for e in effects for v in getattr(e, side)] for side in ("lower", "upper"))
    return np.array(low)[here.free], np.array(high)[here.free]


def _within_bounds(problem: Problem, here: Point, estimate: Estimate) -> Estimate:
    """The estimate with parameters held at a bound where they stand at one and would go beyond.

    What the others become is their mean given those held, ``x + C_xh C_hh^-1 (h - x_h)``: their own steps fit those that the held
    ones would take, and lead nowhere without them.
    """
    if estimate.full_covariance is None:
        return estimate
    rank = problem.row_model.base.rank
    (low, high), now = _bounds(problem, here), here.values[here.free]
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


def _stepped(problem: Problem, here: Point, estimate: Estimate, step: np.ndarray, share: float) -> Point:
    """The point a share of the way towards the estimate, within what is plausible."""
    row_model = problem.row_model
    low, high = _bounds(problem, here)
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
