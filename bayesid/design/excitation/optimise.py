"""The best motion within limits: many random starts, the best of them improved by an augmented Lagrangian.

Minimise f(x) subject to g_i(x) <= 0, the ratios of `bayesid.design.excitation.limits` less one at N samples of a period, by
minimising

    f(x) + 1/N sum_i [ max(0, l_i + r g_i(x))^2 - l_i^2 ] / (2 r)

over x with L-BFGS and raising ``l_i <- max(0, l_i + r g_i)`` in turn ([Nocedal2006]_, chapter 17). Both f and the sum have
analytic gradients that cost a few regressors, whatever the number of limits. What still exceeds a limit is taken
back; every round's motion is then scaled to fit all limits on fine samples, and the best of those is kept: whatever the
optimiser does, what comes out is feasible.

A motion that exceeds limits a little is moved to the nearest one that keeps them. With the Jacobian J of the ratios g along the
optimiser's numbers x, each step is the smallest one that meets all limits to first order, less a margin,

    min |d|^2   subject to   sign(g) (g + J d) <= 1 - margin  where |g| is near one:

a least distance problem, which non-negative least squares solves ([Lawson1974]_, chapter 23). Positions, velocities and
accelerations are linear in x, so that only torques, wrenches and distances need more than one step.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.optimize import minimize, nnls

from bayesid.design.excitation.information import Criterion, Information, JudgedQuantity
from bayesid.design.excitation.limits import Limits
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.series import Coordinates, FourierSeries
from bayesid.effects.flexible import MotionArrays
from bayesid.tasks import map_tasks, on_cluster

#: What is left of every limit for what lies between samples of torques, wrenches and distances.
GUARD = 1e-3
_HALVINGS, _COARSE = 14, 250
#: Motions drawn until one is within the limits.
_TRIES = 50
#: Smallest step by which a motion that fits coarse samples is made to fit fine ones.
_SHRINK = 0.002
#: A motion that must shrink to less than this share of what its joints could do goes round something: another is better.
_SMALLEST = 0.02


def scaled_to_fit(series: FourierSeries, limits: Limits, samples: int, largest: float = np.inf) -> FourierSeries | None:
    """The motion with amplitudes as large as all limits allow; None where even a small one about its centre breaks one.

    Amplitudes are first scaled to the joints' own limits, exactly, by ``largest`` at most; then, where loads or distances do
    not fit, all by one factor, found by halving on coarse samples and made smaller until it fits the fine ones.
    """
    room = limits.kinematic_room(series, max(samples, 20 * series.harmonics))
    factor = min(float(room.min(initial=np.inf)) * (1.0 - 1e-9), largest)

    def excess(share: float, at: int) -> float:
        found = limits.worst_loads(series.scaled(share * factor), at)
        return max((float(worst.max(initial=0.0)) for worst in found.values()), default=0.0) - (1.0 - GUARD)

    coarse = min(samples, max(_COARSE, 20 * series.harmonics))
    share = 1.0
    if excess(1.0, coarse) > 0.0:
        if excess(_SMALLEST, coarse) > 0.0:
            return None
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle, coarse) <= 0.0 else (low, middle)
        share = low
    while share >= _SMALLEST:
        over = excess(share, samples)
        if over <= 0.0:
            return series.scaled(share * factor)
        share *= 1.0 - max(2.0 * over, _SHRINK)
    return None


def random_series(coordinates: Coordinates, limits: Limits, rng: np.random.Generator) -> FourierSeries:
    """A random motion: every joint takes a random share of what its own limits allow, about a random place in its range."""
    x = rng.normal(size=coordinates.count)
    series = coordinates.series(x)
    m = limits.moving
    place = rng.uniform(-0.7, 0.7, len(m))
    series.centre[m] = limits.middle[m] + place * limits.reach[m]
    share = np.zeros(len(series.centre))
    share[m] = limits.kinematic_room(series, 20 * series.harmonics) * rng.uniform(0.5, 1.0, len(m))
    return series.scaled(share)


def random_feasible(coordinates: Coordinates, limits: Limits, rng: np.random.Generator, samples: int) -> FourierSeries | None:
    """A random motion within all limits, scaled as large as they allow; None where none was found in so many tries."""
    for _ in range(_TRIES):
        found = scaled_to_fit(random_series(coordinates, limits, rng), limits, samples)
        if found is not None:
            return found
    return None


#: Samples below this share of a limit do not count in a step; a step's length at most, so that what is left out stays within.
_NEAR, _LONGEST, _STEPS = 0.9, 0.5, 8


def restored(limits: Limits, coordinates: Coordinates, x: np.ndarray, margin: float) -> np.ndarray | None:
    """Numbers near x whose motion keeps all limits at the samples, less half a margin; None where none was found.

    ``margin`` is the share of every limit that is kept free.
    """
    for _ in range(_STEPS):
        motion = coordinates.motion(x)
        ratios = limits.ratios(motion)
        if max(float(np.abs(part).max(initial=0.0)) for part in ratios) <= 1.0 - 0.5 * margin:
            return x
        rows, room = _active(limits, coordinates, motion, ratios, margin)
        step = _least_distance(-rows, -room)
        if step is None:
            return None
        x = x + step * min(1.0, _LONGEST / max(float(np.linalg.norm(step)), 1e-300))
    return None


def _active(
    limits: Limits, coordinates: Coordinates, motion: MotionArrays, ratios: list[np.ndarray], margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the Jacobian (k, count) of ratios near their limits, signed so that they must not grow, and the room left (k,)."""
    rows, room = [], []
    for p, part in enumerate(ratios):
        for c in range(part.shape[1]):
            near = np.flatnonzero(np.abs(part[:, c]) > _NEAR)
            if not len(near):
                continue
            weights = [np.zeros_like(other) for other in ratios]
            weights[p][:, c] = np.sign(part[:, c])
            rows.append(coordinates.jacobian(*limits.gradient(motion, weights), near))
            room.append(1.0 - margin - np.abs(part[near, c]))
    return np.concatenate(rows), np.concatenate(room)


def _least_distance(matrix: np.ndarray, least: np.ndarray) -> np.ndarray | None:
    """The smallest d with ``matrix d >= least``; None where there is none."""
    stacked = np.vstack([matrix.T, least])
    target = np.zeros(len(stacked))
    target[-1] = 1.0
    try:
        dual, _ = nnls(stacked, target, maxiter=20 * len(stacked))
    except RuntimeError:  # no solution in so many steps
        return None
    rest = stacked @ dual - target
    if abs(rest[-1]) < 1e-10:
        return None
    return -rest[:-1] / rest[-1]


_ROUNDS, _ITERATIONS, _STEEPNESS, _STEEPER, _FASTER = 12, 100, 10.0, 3.0, 0.3
#: Share of the time that random motions may take.
_FOR_RANDOMS = 0.4
#: Share of amplitudes above which scaling to fit was hardly needed.
_HARDLY = 0.995
#: A round that exceeds limits by less, and gains less, is the last.
_VIOLATION, _GAIN = 2e-3, 1e-4
#: Margins to limits at the optimiser's samples, one after the other, for what lies between them.
_MARGINS = (0.003, 0.01, 0.03)


@dataclass(frozen=True, eq=False)
class Task:
    """What the search for a motion optimises."""

    #: What a motion tells, how that is judged, and what it must keep to.
    information: Information
    criterion: Criterion
    limits: Limits
    #: The motions that are searched, and the same with more samples of a period, for their limits.
    coordinates: Coordinates
    dense: Coordinates
    recorded: float  # samples that will be recorded in all
    fine: int  # even samples of a period on which limits are tested
    rank: int  # how many base parameters the richest motion of these joints would determine
    quantities: tuple[JudgedQuantity, ...] = ()  # quantities that are reported as well

    @property
    def step(self) -> float:
        """Time between the optimiser's samples [s]."""
        return self.coordinates.period / len(self.coordinates.times)

    def judged(self, series: FourierSeries) -> float:
        """Value of the criterion; smaller is better."""
        return self.criterion(self.matrix(series))[0]

    def matrix(self, series: FourierSeries) -> np.ndarray:
        """Scaled information matrix (r, r)."""
        return self.information.matrix(series.at(self.coordinates.times), self.recorded, self.step)

    def offer(self, series: FourierSeries, found: TrajectorySearch) -> FourierSeries | None:
        """Offer a motion, made smaller where that is needed to fit; returns it, or None where that does not help."""
        fitted = scaled_to_fit(series, self.limits, self.fine, largest=1.0)
        if fitted is not None:
            found.offer(fitted, self.judged(fitted))
        return fitted

    def quantity_stds(self, series: FourierSeries) -> tuple[float, ...]:
        """Expected standard deviations of the quantities."""
        motion = series.at(self.coordinates.times)
        return tuple(q.std(q.information.matrix(motion, self.recorded, self.step)) for q in self.quantities)


@dataclass
class TrajectorySearch:
    """The best motion so far, and how it came about; kept while the search runs, so that it can be stopped at any time."""

    #: The best feasible motion, and its criterion.
    best: FourierSeries | None = None
    value: float = np.inf
    random: list[float] = field(default_factory=list)  # criterion of every random feasible motion
    finalists: list[tuple[float, FourierSeries]] = field(default_factory=list)  # criterion and motion of the best of each start
    history: list[tuple[float, float]] = field(default_factory=list)  # (seconds, criterion of the best so far)
    _local: tuple[float, FourierSeries] | None = None
    interrupted: bool = False  # whether somebody stopped the search
    _since: float = field(default_factory=time.perf_counter)

    def offer(self, series: FourierSeries, value: float) -> None:
        """Take a feasible motion if it is better."""
        if self._local is None or value < self._local[0]:
            self._local = value, series
        if value < self.value:
            self.best, self.value = series, value
            self.history.append((self.seconds, value))

    def close(self) -> None:
        """End a start: its best motion is a finalist."""
        if self._local is not None:
            self.finalists.append(self._local)
        self._local = None

    def join(self, start: TrajectorySearch) -> None:
        """Take what a start has found elsewhere."""
        self.finalists += start.finalists
        for value, series in start.finalists:
            self.offer(series, value)
        self._local = None

    @property
    def seconds(self) -> float:
        """Time since the search began [s]."""
        return time.perf_counter() - self._since


def search(
    task: Task, options: ExcitationOptions, warm: FourierSeries | None, seed: int, tell: Callable[[str], None]
) -> TrajectorySearch:
    """Find the best motion; an interrupt (Ctrl-C) ends the search, not the program.

    Random feasible motions are judged, and the best of them, and ``warm``, are improved: of both as many as the options say, and
    no further improvement begins after so many seconds. ``best`` is None where no feasible motion was found.
    """
    randoms, starts, seconds = options.randoms, options.starts, options.seconds
    found, rng = TrajectorySearch(), np.random.default_rng(seed)
    pool: list[tuple[float, FourierSeries]] = []
    try:
        if warm is not None and (fitted := task.offer(warm, found)) is not None:
            pool.append((-np.inf, fitted))
        for k in range(randoms):
            if pool and found.seconds > _FOR_RANDOMS * seconds:
                break
            tell(f"random motions {k + 1} of {randoms}")
            series = random_feasible(task.coordinates, task.limits, rng, len(task.coordinates.times))
            if series is None:
                break
            value = task.judged(series)
            found.random.append(value)
            pool.append((value, series))
        pool.sort(key=lambda pair: pair[0])
        improved = pool[: starts + (warm is not None)]
        if on_cluster():
            jobs = partial(_improved, task, seconds - found.seconds)
            for k, own in enumerate(map_tasks(jobs, [start for _, start in improved])):
                tell(f"start {k + 1} of {len(improved)}")
                found.join(own)
            improved = []
        for k, (_, start) in enumerate(improved):
            if found.seconds > seconds and found.best is not None:
                break
            improve(task, start, found, seconds, lambda text, k=k: tell(f"start {k + 1} of {min(starts, len(pool))}, {text}"))
            found.close()
    except KeyboardInterrupt:
        found.interrupted = True
        if found.best is None and pool:
            task.offer(min(pool, key=lambda pair: pair[0])[1], found)
    found.close()
    return found


def _improved(task: Task, seconds: float, start: FourierSeries) -> TrajectorySearch:
    """What one start finds on its own."""
    found = TrajectorySearch()
    improve(task, start, found, seconds, lambda _: None)
    found.close()
    return found


def improve(task: Task, start: FourierSeries, found: TrajectorySearch, seconds: float, tell: Callable[[str], None]) -> None:
    """Improve a motion, and offer what fits of every round."""
    x = task.coordinates.numbers(start)
    multipliers: list[np.ndarray] | None = None
    steepness, before, gap_before = _STEEPNESS, np.inf, np.inf

    def in_time(_: np.ndarray) -> None:
        if found.seconds > seconds and found.best is not None:
            raise StopIteration  # ends the minimisation, not the program

    for number in range(_ROUNDS):
        ratios = task.limits.ratios(task.coordinates.motion(x))
        if multipliers is None:
            multipliers = [np.zeros_like(part) for part in ratios]
        done = minimize(
            _penalty, x, (task, multipliers, steepness), "L-BFGS-B", jac=True, callback=in_time,
            options={"maxiter": _ITERATIONS, "maxcor": 20},
        )  # fmt: skip
        x = done.x
        ratios = task.limits.ratios(task.coordinates.motion(x))
        gap = max(float(np.abs(part).max(initial=0.0)) for part in ratios) - 1.0
        _offer_within(task, x, found)
        tell(f"round {number + 1}: criterion {-found.value:.4g}")
        settled = abs(before - done.fun) < _GAIN and gap < _VIOLATION
        if settled or (found.seconds > seconds and found.best is not None):
            return
        multipliers = [np.maximum(m + steepness * (np.abs(part) - 1.0), 0.0) for m, part in zip(multipliers, ratios, strict=True)]
        steepness *= _STEEPER if gap > _FASTER * gap_before else 1.0
        before, gap_before = done.fun, gap


def _offer_within(task: Task, x: np.ndarray, found: TrajectorySearch) -> None:
    """Offer a motion near to one that exceeds limits a little."""
    for margin in _MARGINS:
        inside = restored(task.limits, task.dense, x, margin)
        near = task.coordinates.series(x if inside is None else inside)
        fitted = task.offer(near, found)
        if fitted is not None and np.abs(fitted.sine).max() > _HARDLY * np.abs(near.sine).max():
            return  # a larger margin would gain nothing
        if inside is None:
            return


def _penalty(x: np.ndarray, task: Task, multipliers: list[np.ndarray], steepness: float) -> tuple[float, np.ndarray]:
    """The augmented Lagrangian and its gradient."""
    motion = task.coordinates.motion(x)
    value, gradient = task.information.judged(motion, task.recorded, task.step, task.criterion)
    share, weights = 1.0 / len(motion[0]), []
    for part, multiplier in zip(task.limits.ratios(motion), multipliers, strict=True):
        push = np.maximum(multiplier + steepness * (np.abs(part) - 1.0), 0.0)
        value += share * float(np.sum(push**2 - multiplier**2)) / (2.0 * steepness)
        weights.append(share * push * np.sign(part))
    pushed = task.limits.gradient(motion, weights)
    return value, task.coordinates.gradient(*(a + b for a, b in zip(gradient, pushed, strict=True)))
