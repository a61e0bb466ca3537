"""Where the link is behind gear teeth with play [Nordin2002]_: q_motor = q_link + lean(torque(q_link)).

The torque depends on the link's acceleration, and where it is small the link crosses the play within milliseconds, at times that
smoothed positions do not show. So the link's motion is a spline in time, fitted to what the encoders read, sample by sample. The
torque u that teeth feel is the spline's own but for an error, by which the spline's acceleration may be wrong:

    sum_k ((q_motor(t_k) - q_link(t_k) - lean(u_k)) / e)^2 + ((u_k - torque(t_k)) / (I(t_k) e a))^2 -> min

with the error e of a sample, I the joint's own inertia, and a the acceleration that an error of a unit makes. At each sample the
best u is sought on both sides of the play: of a crossing that is assumed at a wrong time, the sum then grows with the torque that
would have to be there, which says where the crossing belongs, while behind firm teeth the play itself says nothing. The splines
move by Gauss-Newton steps, in which a change d of the link's motion changes the torque by the inertia times d''. Splines that can
do little more than the slow motion find the crossings roughly, for what they leave makes e large, finer ones from there to the
sample. As a crossing may still be missed on the way, this is done with two sizes of the error, and what leaves less is taken.
While no encoder moves, links stand still: they lean with the weight that they hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from bayesid.effects.families import PlayEffect
from bayesid.effects.flexible import Motion
from bayesid.effects.segment import REST_SPEED
from bayesid.signals.arrays import kernel_input
from bayesid.signals.smoothing import Splines

#: Highest bandwidth of the splines [Hz]: links of arms hardly move faster, and splines that can, imitate the steps.
FASTEST = 8.0
#: The slowest splines' bandwidth as a share of the fastest ones', and how many levels there are.
_SLOWEST, _LEVELS = 1.0 / 8.0, 10
#: Errors of the torque that a fit descends with, over those by which a level's splines miss the encoders at its bandwidth.
_SHARES = (1.0, 2.0)
#: Those that it ends with, over what noise makes of them: with smaller ones it is caught between crossings on the way.
_LAST = 2.0
#: Play that is less than this share of the encoders' errors cannot be located in them: the slow motion's torque says where it is.
_LOCATED = 0.3
#: Turns with another torque, Gauss-Newton steps at most in each, and the relative change of the sum that ends both: on a level,
#: which is to find crossings only roughly, and on the last one.
_ROUGHLY, _WELL = (1, 12, 1e-3), (6, 20, 1e-6)
#: A step that makes the sum larger is damped, so often at most, more each time.
_DAMPED, _DAMPING, _MORE_DAMPING = 6, 1e-3, 4.0
#: Torques that are tried at each sample, over the one at which teeth are firm: close to zero, and far from it on either side.
_CLOSE, _FAR = np.linspace(-1.5, 1.5, 25), np.geomspace(1.6, 40.0, 12)
#: Newton steps from the best of them.
_NEWTON = 2
#: Median of the size of normal numbers, over their standard deviation.
_MEDIAN = 0.6745
#: Errors that are none: of a torque, over the one at which teeth are firm, and of an encoder, over the play.
_EXACT, _NONE = 1e-3, 1e-6
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

    cutoffs: np.ndarray  # bandwidth of each level [Hz]
    splines: Sequence[Splines]  # of each level, at the samples (M,)
    whole: Splines  # those that positions are smoothed to
    wanted: Splines  # the same where the link's motion is wanted (N,)
    still: np.ndarray  # whether no encoder moves (M,)
    step: float  # time between samples [s]

    @classmethod
    def of(cls, times: np.ndarray, encoders: np.ndarray, bandwidth: float, wanted: np.ndarray) -> Fitting:
        """Splines for readings (M, n) at times (M,) [s] that are smoothed to a bandwidth [Hz], and times (N,) within them."""
        top = min(FASTEST, bandwidth)
        cutoffs = top * np.geomspace(_SLOWEST, 1.0, _LEVELS)
        splines = [Splines.over(times, cutoff) for cutoff in cutoffs]
        whole, there = Splines.over(times, bandwidth), Splines.over(times, bandwidth, wanted)
        return cls(cutoffs, splines, whole, there, _rests(times, encoders), float(np.median(np.diff(times))))


@dataclass(frozen=True, eq=False)
class Behind:
    """How far a link is behind its motor at the encoders' samples."""

    values: np.ndarray  # (M,) [rad or m]
    solution: PlayFit | None = None  # what that follows from; None where encoders cannot show it


@dataclass(frozen=True, eq=False)
class PlayFit:
    """A link's motion between its encoder and its torque."""

    coefficients: np.ndarray  # of the splines (k,)
    torque: np.ndarray  # that teeth feel (M,) [N m or N]
    left: float  # sum of squares over the errors


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
            out[joint] = found.best(start.get(joint)) if joint in located else Behind(found.lean(found.slow.torque))
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
    from scipy.ndimage import maximum_filter1d

    size = _samples(float(np.median(np.diff(times))))
    if size < 3 or size > len(times):
        return np.zeros(len(times), bool)
    middles = (_spread(encoders, size) <= 1.0001 * REST_SPEED * _REST).all(axis=1)
    return maximum_filter1d(middles, size)


def _samples(step: float) -> int:
    """How many samples that are so far apart [s] a rest takes."""
    return 2 * int(0.5 * _REST / step) + 1


def _spread(encoders: np.ndarray, size: int) -> np.ndarray:
    """How far encoders (M, ...) move among so many samples about each."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    return maximum_filter1d(encoders, size, axis=0) - minimum_filter1d(encoders, size, axis=0)


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

    def lean(self, torque: np.ndarray) -> np.ndarray:
        return sum((effect.lean(torque, values) for effect, values in self.play), np.zeros(len(torque)))

    def slope(self, torque: np.ndarray) -> np.ndarray:
        return sum((effect.slope(torque, values) for effect, values in self.play), np.zeros(len(torque)))

    @cached_property
    def firm(self) -> float:
        """Torque [N m or N] that would bring teeth through the play if they stayed as soft as without load; 0 without play."""
        (most,), (slope,) = self.lean(np.array([LARGE])), self.slope(np.zeros(1))
        return float(most / slope) if slope > 0.0 else 0.0

    @cached_property
    def tried(self) -> tuple[np.ndarray, np.ndarray]:
        """Torques that are tried at each sample (k,), and how far the link is behind at each (k,)."""
        torques = self.firm * np.concatenate([-_FAR[::-1], _CLOSE, _FAR])
        return kernel_input(torques), kernel_input(self.lean(torques))

    @cached_property
    def noise(self) -> float:
        """Error of a sample of the encoder [rad or m], whatever the play: crossings are few.

        An encoder that stands still shows none.
        """
        left = np.abs(self.fitting.splines[-1].remainder(self.encoders))
        moves = _spread(self.encoders, _samples(self.fitting.step)) > 0.0
        return float(np.median(left[moves])) / _MEDIAN if moves.any() else 0.0

    @cached_property
    def slow(self) -> PlayFit:
        """The slowest motion."""
        return self._rough(0, self.encoders, np.inf, 1.0)[0]

    def is_located(self, start: Behind | None) -> bool:
        """Whether encoders can show where the play is crossed; a start says how far the link is behind without a fit."""
        finest = self.fitting.splines[-1]
        noise = np.std(self.encoders - finest.motion(finest.nearest(self.encoders))[0])
        behind = self.lean(self.slow.torque) if start is None else start.values
        return bool(np.abs(behind).max() > _LOCATED * noise)

    def best(self, start: Behind | None) -> Behind:
        """How far the link is behind, from the splines of one level after the other, or of the last one from a start."""
        if start is not None and start.solution is not None:
            found = self._finest(start.solution, follows=True)
        else:
            found = min((self._finest(self._descended(share)) for share in _SHARES), key=lambda end: end.left)
        return Behind(self.lean(found.torque), found)

    def _descended(self, share: float) -> PlayFit:
        """The link's motion from level to level, with so many times the torque's error."""
        now, error = self.slow, np.inf
        for level in range(1, len(self.fitting.splines)):
            now, error = self._rough(level, self.encoders - self.lean(now.torque), error, share)
        return now

    def _rough(self, level: int, link: np.ndarray, most: float, share: float) -> tuple[PlayFit, float]:
        """The link's motion on a level from where it is about (M,), and what the splines leave of that, ``most`` at most."""
        splines, rate = self.fitting.splines[level], (2.0 * np.pi * self.fitting.cutoffs[level]) ** 2
        start = splines.nearest(link)
        error = min(float(np.std(link - splines.motion(start)[0])), most)
        return self._fitted(splines, start, None, error, share * rate * error, *_ROUGHLY), error

    def _finest(self, start: PlayFit, follows: bool = False) -> PlayFit:
        """The link's motion on the last level, where torques are wrong by little more than noise makes of them.

        Where it ``follows`` the start, no teeth are tried but those that it rests on.
        """
        splines, cutoff = self.fitting.splines[-1], self.fitting.cutoffs[-1]
        # Acceleration that white noise leaves up to the bandwidth: the integral of (2 pi f)^4 over the share of the frequencies.
        rate = (2.0 * np.pi * cutoff) ** 2 * np.sqrt(2.0 * cutoff * self.fitting.step / 5.0)
        felt = start.torque if follows else None
        return self._fitted(splines, start.coefficients, felt, self.noise, _LAST * rate * self.noise, *_WELL)

    def _fitted(
        self, splines: Splines, at: np.ndarray, felt: np.ndarray | None, error: float, rate: float, turns: int, steps: int,
        settled: float,
    ) -> PlayFit:  # fmt: skip
        """The link's motion on one level from coefficients (k,), with errors of samples and of accelerations.

        The link's place hardly matters to inertia and weight: while the fit descends, the torque changes by the inertia times
        the acceleration, and it is computed anew in each turn. The torque that teeth feel (M,) stays close to ``felt``, if given.
        """
        if not self.firm:
            return PlayFit(at, self.torque(splines.motion(at)), np.inf)
        error = max(error, _NONE * float(self.lean(np.array([LARGE]))[0]))
        doubt, found = np.maximum(self.inertia * rate, _EXACT * self.firm), PlayFit(at, np.zeros(0), np.inf)
        for _ in range(turns):
            own = splines.motion(found.coefficients)
            held, before = self.torque(own) - self.inertia * own[2], found.left
            found = self._stepped(splines, found.coefficients, felt, held, error, doubt, steps, settled)
            felt = None if felt is None else found.torque
            if abs(found.left - before) <= settled * found.left:
                break
        return found

    def _stepped(
        self, splines: Splines, at: np.ndarray, felt: np.ndarray | None, held: np.ndarray, error: float, doubt: np.ndarray,
        steps: int, settled: float,
    ) -> PlayFit:  # fmt: skip
        """The link's motion after Gauss-Newton steps, with a torque ``held + inertia acceleration`` (M,) and its error (M,).

        With the torque that teeth feel as it is best at each sample, the second derivatives with respect to how far the link is
        behind and to the spline's torque are a 2 by 2 matrix L L', and the rows are those of L'.
        """
        twice, follows = splines.repeated(2), felt is not None
        sharp, firm = 1.0 / error**2, 1.0 / doubt**2
        along = self.inertia[:, None] * splines.values[2]

        def tried(coefficients: np.ndarray, felt: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
            position, _, acceleration = splines.motion(coefficients)
            gone, torque = self.encoders - position, held + self.inertia * acceleration
            found, costs = self._felt(gone, torque, felt, sharp, firm)
            return gone, found, float(np.sum(costs))

        (gone, found, left), damping = tried(at, felt), 0.0
        for _ in range(steps):
            off = gone - self.lean(found)
            slope, bent = self._curved(found, off, sharp)
            whole = sharp * slope**2 + firm + bent
            one = np.sqrt(sharp * (firm + bent) / whole)
            other, two = -sharp * slope * firm / (whole * one), np.sqrt(firm * bent / (firm + bent))
            rows = np.concatenate([-one[:, None] * splines.values[0] + other[:, None] * along, two[:, None] * along])
            pull = sharp * off
            right = np.concatenate([-pull / one, slope * pull * np.sqrt(bent / (firm * (firm + bent)))])
            for _ in range(_DAMPED):
                new = at + twice.solved(rows, right, damping)
                after = tried(new, found if follows else None)
                if after[2] < left:
                    break
                damping = max(_MORE_DAMPING * damping, _DAMPING)
            else:
                break
            at, before, (gone, found, left) = new, left, after
            damping = damping / _MORE_DAMPING if damping > 1e-3 * _DAMPING else 0.0
            if left > (1.0 - settled) * before:
                break
        return PlayFit(at, found, left)

    def _felt(
        self, gone: np.ndarray, torque: np.ndarray, felt: np.ndarray | None, sharp: float, firm: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torque that teeth feel at each sample (M,), close to ``felt`` if given, and what is left there (M,)."""
        at = felt
        if at is None:
            one, other = kernel_input(torque), kernel_input(self.lean(torque))
            at = np.asarray(_best_tried(kernel_input(gone), one, other, sharp, kernel_input(firm), *self.tried))
        off = gone - self.lean(at)
        left = sharp * off**2 + firm * (at - torque) ** 2
        for _ in range(_NEWTON):
            slope, bent = self._curved(at, off, sharp)
            new = at + (sharp * slope * off - firm * (at - torque)) / (sharp * slope**2 + firm + bent)
            beyond = gone - self.lean(new)
            now = sharp * beyond**2 + firm * (new - torque) ** 2
            better = now < left
            at, off, left = np.where(better, new, at), np.where(better, beyond, off), np.where(better, now, left)
        return at, left

    def _curved(self, torque: np.ndarray, off: np.ndarray, sharp: float) -> tuple[np.ndarray, np.ndarray]:
        """Slope of the lean (M,), and what its bend adds to the second derivative of the sum, where that is positive (M,)."""
        step = 1e-3 * self.firm
        above, below = self.slope(torque + step), self.slope(torque - step)
        return 0.5 * (above + below), np.maximum(-sharp * off * (above - below) / (2.0 * step), 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _best_tried(gone, torque, leaning, sharp, firm, tried, lean):
    """Of torques that are tried (k,) and the spline's own, by how far each makes a link lean, the best at each sample (M,)."""
    out = torque.copy()
    for sample in range(len(gone)):
        least = sharp * (gone[sample] - leaning[sample]) ** 2
        for k in range(len(tried)):
            off, wrong = gone[sample] - lean[k], tried[k] - torque[sample]
            left = sharp * off * off + firm[sample] * wrong * wrong
            if left < least:
                least, out[sample] = left, tried[k]
    return out
