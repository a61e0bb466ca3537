"""Where the link is behind gear teeth with play [Nordin2002]_: q_motor = q_link + lean(torque(q_link)).

The torque depends on the link's acceleration, and where it is small the link crosses the play within milliseconds, at times that
smoothed positions do not show. So the link's motion is a spline in time, fitted to what the encoders read, sample by sample:

    sum_k (q_motor(t_k) - q_link(t_k) - lean(torque(t_k)))^2 -> min

by Gauss-Newton steps, in which a change d of the link's motion changes the torque by the joint's own inertia times d''. The sum
has a minimum wherever a crossing is assumed at a wrong time, and one in which the link chatters between the teeth instead of
resting on them. Splines that can do little more than the slow motion find the crossings roughly, finer ones from there to the
sample. While no encoder moves, links stand still: they lean with the weight that they hold.

In intervals in which the finest splines miss the readings by far more than their errors, a crossing went wrong on the way. There,
at most two crossings at any times, from any side to any other, are tried, the rest of the motion as it was: with splines B that
the link moves by, a change s of how far it is behind leaves ``|(1 - P)(r - s)|^2`` of the readings r, P projecting on B. The best
is taken if it leaves less, and not much more than elsewhere: where there is next to no torque, the side follows from the encoder,
not from the splines' own torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from bayesid.effects.families import PlayEffect
from bayesid.effects.flexible import Motion
from bayesid.effects.segment import REST_SPEED
from bayesid.signals.arrays import runs
from bayesid.signals.smoothing import Splines

#: Where the root mean square over so many seconds is so many times its median, a crossing may be at a wrong time.
_SMOOTHED, _STANDS_OUT = 0.25, 2.0
#: Two crossings cannot be all of a longer interval [s].
_LONGEST = 3.0
#: Crossings that are right leave no more than so many times the usual; one sample on the wrong side of a wide play makes ten.
_EXPLAINED = 15.0
#: Seconds around an interval that are looked at with it, for splines reach beyond it.
_AROUND = 1.0
#: Times tried in an interval, before every sample about the best of them is.
_TRIED = 250


def local_energy(left: np.ndarray, step: float) -> np.ndarray:
    """Mean square about each sample (M,) of what is left of readings (M,) that are so far apart [s]."""
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(left**2, max(int(round(_SMOOTHED / step)), 1))


def intervals_that_stand_out(energy: np.ndarray) -> list[tuple[int, int]]:
    """First sample of each, and the one after the last, by the mean square about each sample (M,)."""
    return runs(energy > _STANDS_OUT**2 * np.median(energy))


def crossed_anew(
    encoders: np.ndarray,
    behind: np.ndarray,
    sides: np.ndarray,
    splines: Splines,
    still: np.ndarray,
    step: float,
    intervals: list[tuple[int, int]],
) -> np.ndarray:
    """Side of the link in each interval (M,), -1 elsewhere, with the crossings that leave least of the readings.

    ``encoders`` are readings (M,) [rad or m], ``behind`` how far the link is behind by the fit (M,), ``sides`` how far it may
    be (k,), ``splines`` what it moves by, at the samples; ``still`` says where it is known, as nothing moves (M,), ``step`` is
    in s, and ``intervals`` are the first sample of each and the one after its last.
    """
    if not intervals:
        return np.full(len(behind), -1)
    usual = np.median(local_energy(splines.remainder(encoders - behind), step))
    out, found, around = behind.copy(), np.full(len(behind), -1), int(round(_AROUND / step))
    for a, b in intervals:
        if (b - a) * step > _LONGEST:
            continue
        near = slice(max(a - around, 0), min(b + around, len(encoders)))
        samples, some = np.arange(near.start, near.stop), splines.part(near)
        inside = (samples >= a) & (samples < b) & ~still[near]
        now = some.remainder(encoders[near] - out[near])
        outside = some.remainder(encoders[near] - np.where(inside, 0.0, out[near]))
        every = int(np.ceil((b - a) / _TRIED))
        times = np.append(np.arange(a, b, every), b)
        while True:
            until = some.remainder((inside[:, None] & (samples[:, None] < times)).astype(float))
            energy, (one, two, three), i, j = _least(until, outside, sides)
            if every == 1:
                break
            # Then every sample about those.
            close = [np.arange(max(times[k] - every, a), min(times[k] + every, b) + 1) for k in (i, j)]
            times, every = np.unique(np.concatenate([*close, [a, b]])), 1
        crossed = np.where(samples < times[i], one, np.where(samples < times[j], two, three))
        left = some.remainder(encoders[near] - np.where(inside, sides[crossed], out[near]))
        if energy < now @ now and local_energy(left, step)[inside].max(initial=0.0) < _EXPLAINED**2 * usual:
            found[near] = np.where(inside, crossed, found[near])
            out[near] = np.where(inside, sides[crossed], out[near])
    return found


def _least(until: np.ndarray, outside: np.ndarray, sides: np.ndarray) -> tuple[float, tuple[int, ...], int, int]:
    """The least sum of squares, which its three sides are, and which of the times the two crossings between them are.

    ``until`` (M, k) is what the splines leave of a unit step from the interval's start to each time, the last one its end, and
    ``outside`` (M,) what they leave of the readings if the link is not behind in the interval.
    """
    gram, along, alone = until.T @ until, until.T @ outside, outside @ outside
    own, whole = np.diag(gram), gram[:, -1]
    in_order = np.triu(np.ones(gram.shape, bool))
    found: tuple[float, tuple[int, ...], int, int] = (np.inf, (0, 0, 0), 0, 0)
    for which in product(range(len(sides)), repeat=3):
        if which[0] == which[1] or which[1] == which[2]:  # as one crossing less, at the interval's start or end
            continue
        one, two, three = sides[list(which)]
        x, y = one - two, two - three  # ``x until_i + y until_j + three until_end``
        first = x * (x * own + 2.0 * three * whole - 2.0 * along)
        second = y * (y * own + 2.0 * three * whole - 2.0 * along)
        energy = first[:, None] + second[None, :] + 2.0 * x * y * gram
        i, j = np.unravel_index(int(np.argmin(np.where(in_order, energy, np.inf))), energy.shape)
        total = float(energy[i, j] + three * (three * own[-1] - 2.0 * along[-1]) + alone)
        if total < found[0]:
            found = total, which, int(i), int(j)
    return found


#: Highest bandwidth of the splines [Hz]: links of arms hardly move faster, and splines that can, imitate the steps.
FASTEST = 8.0
#: The slowest splines' bandwidth as a share of the fastest ones', and how many levels there are.
_SLOWEST, _LEVELS = 1.0 / 8.0, 5
#: Play that is less than this share of the encoders' errors cannot be located in them: the slow motion's torque says where it is.
_LOCATED = 0.3
#: Turns with another torque, Gauss-Newton steps at most in each, and the relative change of the sum that ends both: on a level,
#: which is to find crossings only roughly, and on the last one.
_ROUGHLY, _WELL = (1, 5, 1e-2), (6, 20, 1e-6)
#: A step that makes the sum larger is damped, so often at most, more each time.
_DAMPED, _DAMPING, _MORE_DAMPING = 6, 1e-3, 4.0
#: A torque that presses any teeth together [N m or N].
LARGE = 1e9
#: Time in which no encoder moves, for a rest [s].
_REST = 0.1
#: Turns for poses, whose weight hardly changes with the play.
_POSE_TURNS = 3
#: Rounds over the joints, where several have play.
_ROUNDS = 2
#: From motion and joints to the torques (N, k) that it takes of these (k,).
Torque = Callable[[Motion, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Fitting:
    """What encoders' samples are fitted with, and when."""

    splines: Sequence[Splines]  # of each level, at the samples (M,)
    whole: Splines  # those that positions are smoothed to
    wanted: Splines  # the same where the link's motion is wanted (N,)
    still: np.ndarray  # whether no encoder moves (M,)
    step: float  # time between samples [s]

    @classmethod
    def of(cls, times: np.ndarray, encoders: np.ndarray, bandwidth: float, wanted: np.ndarray) -> Fitting:
        """Splines for readings (M, n) at times (M,) [s] that are smoothed to a bandwidth [Hz], and times (N,) within them."""
        top = min(FASTEST, bandwidth)
        splines = [Splines.over(times, cutoff) for cutoff in top * np.geomspace(_SLOWEST, 1.0, _LEVELS)]
        whole, there = Splines.over(times, bandwidth), Splines.over(times, bandwidth, wanted)
        return cls(splines, whole, there, _rests(times, encoders), float(np.median(np.diff(times))))


@dataclass(frozen=True, eq=False)
class Behind:
    """How far a link is behind its motor at the encoders' samples."""

    values: np.ndarray  # (M,) [rad or m]
    side: np.ndarray  # which side of the play it is on where crossings were sought anew (M,), -1 elsewhere


@dataclass(frozen=True, eq=False)
class Recorded:
    """What is known of the joints at the encoders' own samples."""

    encoders: np.ndarray  # where motors hold the joints, as the encoders read it (M, n) [rad or m]
    smooth: Motion  # that smoothed: positions, velocities and accelerations, (M, n) each [rad or m and per second (squared)]
    torque: Torque  # that motions at these samples take [N m or N]
    inertia: Callable[[int], np.ndarray]  # that a joint feels (M,) [kg m^2 or kg]
    fitting: Fitting  # what they are fitted with

    def behind(self, play: Sequence[tuple[PlayEffect, Sequence[float]]], start: Mapping[int, Behind]) -> dict[int, Behind]:
        """How far the links of joints with play are behind their motors at the samples.

        ``start`` is the same where it is nearly known, so that crossings stay in the order that they have there.
        """
        which = sorted({effect.joint or 0 for effect, _ in play})
        link, out = [part.copy() for part in self.smooth], {}

        def fit(joint: int) -> _JointFit:
            return _JointFit.of(self, link, joint, [(effect, values) for effect, values in play if effect.joint == joint])

        fits = {joint: fit(joint) for joint in which}
        located = [joint for joint in which if fits[joint].is_located(start.get(joint))]
        rounds = _ROUNDS if len(located) > 1 else 1
        for joint in [*(located * rounds), *(j for j in which if j not in located)]:
            found = fit(joint) if out else fits[joint]  # anew where other links have moved
            out[joint] = found.best(start.get(joint)) if joint in located else Behind(found.slow, np.full(len(found.slow), -1))
            self._follow(link, self.smooth, self.fitting.whole, joint, out[joint].values)
        return out

    def slow_torque(self, joint: int) -> np.ndarray:
        """The torque (M,) that a joint without play takes of its slow motion, by which play too small to be located leans."""
        fit = _JointFit.of(self, self.smooth, joint, ())
        slowest = self.fitting.splines[0]
        return fit.torque(slowest.motion(slowest.nearest(fit.encoders)))

    def leaning_motion(self, motor: Motion, behind: Mapping[int, Behind]) -> Motion:
        """Link-side positions, velocities and accelerations, (N, n) each, of motors' where they are wanted, (N, n) each."""
        link = [part.copy() for part in motor]
        for joint, own in behind.items():
            self._follow(link, motor, self.fitting.wanted, joint, own.values)
        return link[0], link[1], link[2]

    def _follow(self, link: list[np.ndarray], motor: Motion, splines: Splines, joint: int, behind: np.ndarray) -> None:
        """Let a link be where its motor is, less how far it is behind at the samples, smoothed as positions are."""
        change = splines.motion(self.fitting.whole.nearest(behind))
        for mine, old, part in zip(link, motor, change, strict=True):
            mine[:, joint] = old[:, joint] - part


def leaning_poses(motor: Motion, play: Sequence[tuple[PlayEffect, Sequence[float]]], torque: Torque) -> Motion:
    """Link-side positions, velocities and accelerations, (N, n) each, where every sample is a pose at rest."""
    behind = np.zeros_like(motor[0])
    for _ in range(_POSE_TURNS):
        link = motor[0] - behind, motor[1], motor[2]
        behind = np.zeros_like(motor[0])
        for effect, values in play:
            joint = effect.joint or 0
            behind[:, joint] += effect.lean(torque(link, np.array([joint]))[:, 0], values)
    return motor[0] - behind, motor[1], motor[2]


def _rests(times: np.ndarray, encoders: np.ndarray) -> np.ndarray:
    """Samples (M,) of intervals in which no encoder moves faster than a crawl."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    size = 2 * int(0.5 * _REST / np.median(np.diff(times))) + 1
    if size < 3 or size > len(times):
        return np.zeros(len(times), bool)
    spread = maximum_filter1d(encoders, size, axis=0) - minimum_filter1d(encoders, size, axis=0)
    middles = (spread <= 1.0001 * REST_SPEED * _REST).all(axis=1)
    return maximum_filter1d(middles, size)


@dataclass(frozen=True, eq=False)
class _JointFit:
    """The fit of one joint's link motion."""

    play: Sequence[tuple[PlayEffect, Sequence[float]]]  # what the joint has of it
    fitting: Fitting  # what the encoders' samples are fitted with
    encoders: np.ndarray  # the joint's own (M,)
    torque: Callable[[Sequence[np.ndarray]], np.ndarray]  # the joint's (M,) along a motion of its link, three times (M,)
    inertia: np.ndarray  # that it feels, zero while it is at rest (M,)

    @classmethod
    def of(cls, recorded: Recorded, link: Sequence[np.ndarray], joint: int, play) -> _JointFit:
        """The fit of a joint while others move as they do."""
        only, still, torque = np.array([joint]), recorded.fitting.still, recorded.torque
        held = torque((link[0], 0.0 * link[1], 0.0 * link[2]), only)[:, 0] if still.any() else 0.0

        def taken(own: Sequence[np.ndarray]) -> np.ndarray:
            moved = [part.copy() for part in link]
            for mine, part in zip(moved, own, strict=True):
                mine[:, joint] = part
            return np.where(still, held, torque((moved[0], moved[1], moved[2]), only)[:, 0])

        felt = np.where(still, 0.0, recorded.inertia(joint))
        return cls(play, recorded.fitting, recorded.encoders[:, joint], taken, felt)

    @cached_property
    def sides(self) -> np.ndarray:
        """How far the link is behind under a large torque one way, none, and a large one the other way (3,)."""
        return self.lean(np.array([-LARGE, 0.0, LARGE]))

    def lean(self, torque: np.ndarray, side: np.ndarray | None = None) -> np.ndarray:
        free = sum((effect.lean(torque, values) for effect, values in self.play), np.zeros(len(torque)))
        return free if side is None else np.where(side >= 0, self.sides[side], free)

    def slope(self, torque: np.ndarray, side: np.ndarray | None = None) -> np.ndarray:
        free = sum((effect.slope(torque, values) for effect, values in self.play), np.zeros(len(torque)))
        return free if side is None else np.where(side >= 0, 0.0, free)

    @cached_property
    def slow(self) -> np.ndarray:
        """How far the link is behind (M,) by the torque of its slow motion."""
        return self._level(self.fitting.splines[0], np.zeros(len(self.encoders)), *_ROUGHLY)

    def is_located(self, start: Behind | None) -> bool:
        """Whether encoders can show where the play is crossed; a start says how far the link is behind without a fit."""
        finest = self.fitting.splines[-1]
        noise = np.std(self.encoders - finest.motion(finest.nearest(self.encoders))[0])
        return bool(np.abs(self.slow if start is None else start.values).max() > _LOCATED * noise)

    def best(self, start: Behind | None) -> Behind:
        """How far the link is behind, from the splines of one level after the other, or of the last one from a start.

        Where crossings were sought anew, they stay as they are, in the start's as well.
        """
        finest = self.fitting.splines[-1]
        if start is not None:
            return Behind(self._level(finest, start.values, *_WELL, start.side), start.side)
        behind = self.slow
        for splines in self.fitting.splines[1:]:
            behind = self._level(splines, behind, *(_WELL if splines is finest else _ROUGHLY))
        where = intervals_that_stand_out(local_energy(finest.remainder(self.encoders - behind), self.fitting.step))
        side = crossed_anew(self.encoders, behind, self.sides, finest, self.fitting.still, self.fitting.step, where)
        tried = [np.where(side >= 0, self.sides[side], behind)]
        if np.any(side >= 0):  # around them the fit is another one then, but not always a better one
            tried.append(self._level(finest, tried[0], *_WELL, side))
        return Behind(min(tried, key=lambda b: float(np.sum(finest.remainder(self.encoders - b) ** 2))), side)

    def _level(
        self, splines: Splines, behind: np.ndarray, turns: int, steps: int, settled: float, side: np.ndarray | None = None
    ) -> np.ndarray:
        """How far the link is behind (M,) on one level, from a guess, on known sides where these are not negative (M,).

        The link's place hardly matters to inertia and weight: while the fit descends, the torque changes by the inertia times
        the acceleration, and it is computed anew in each turn.
        """
        at, before = splines.nearest(self.encoders - behind), 0.0
        own = splines.motion(at)
        torque = self.torque(own)
        for _ in range(turns):
            left = self.encoders - own[0] - self.lean(torque, side)
            if abs(left @ left - before) <= settled * before:
                break
            at, before = self._descended(splines, at, torque - self.inertia * own[2], steps, settled, side)
            own = splines.motion(at)
            torque = self.torque(own)
        return self.lean(torque, side)

    def _descended(
        self, splines: Splines, at: np.ndarray, held: np.ndarray, steps: int, settled: float, side: np.ndarray | None
    ) -> tuple[np.ndarray, float]:
        """Coefficients (k,) after Gauss-Newton steps, and the sum that is left, with a torque ``held + inertia acceleration``."""

        def left(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            position, _, acceleration = splines.motion(coefficients)
            torque = held + self.inertia * acceleration
            return self.encoders - position - self.lean(torque, side), torque

        (remainder, torque), damping = left(at), 0.0
        for _ in range(steps):
            rows = splines.values[0] + (self.slope(torque, side) * self.inertia)[:, None] * splines.values[2]
            before = remainder @ remainder
            for _ in range(_DAMPED):
                new = at + splines.solved(rows, remainder, damping)
                tried = left(new)
                if tried[0] @ tried[0] < before:
                    break
                damping = max(_MORE_DAMPING * damping, _DAMPING)
            else:
                break
            at, (remainder, torque) = new, tried
            damping = damping / _MORE_DAMPING if damping > 1e-3 * _DAMPING else 0.0
            if remainder @ remainder > (1.0 - settled) * before:
                break
        return at, float(remainder @ remainder)
