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
from bayesid.effects.flexible import MotionArrays
from bayesid.effects.segment import REST_SPEED
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
#: Time in which no encoder moves, for a rest [s].
_REST = 0.1
#: Turns for poses, whose weight hardly changes with the play.
_POSE_TURNS = 3
#: Rounds over the joints, where several have play.
_ROUNDS = 2
#: From motion and joints to the torques (N, k) that it takes of these (k,).
Torque = Callable[[MotionArrays, np.ndarray], np.ndarray]


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
    smooth: MotionArrays  # that smoothed (M, n)
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
            return _JointFit.of(
                self, link, joint, *next(effect.teeth(values) for effect, values in play if effect.joint == joint)
            )

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
        fit = _JointFit.of(self, self.smooth, joint)
        slowest = self.fitting.splines[0]
        return fit.torque(slowest.motion(slowest.nearest(fit.encoders)))

    def leaning_motion(self, motor: MotionArrays, behind: Mapping[int, Behind]) -> MotionArrays:
        """Link-side positions, velocities and accelerations, (N, n) each, of motors' where they are wanted, (N, n) each."""
        link = [part.copy() for part in motor]
        for joint, own in behind.items():
            self._follow(link, motor, self.fitting.wanted, joint, own.values)
        return link[0], link[1], link[2]

    def _follow(self, link: list[np.ndarray], motor: MotionArrays, splines: Splines, joint: int, behind: np.ndarray) -> None:
        """Let a link be where its motor is, less how far it is behind at the samples, smoothed as positions are."""
        change = splines.motion(self.fitting.whole.nearest(behind))
        for mine, old, part in zip(link, motor, change, strict=True):
            mine[:, joint] = old[:, joint] - part


def leaning_poses(motor: MotionArrays, play: Sequence[tuple[PlayEffect, Sequence[float]]], torque: Torque) -> MotionArrays:
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

    most: float  # how far the link is behind the motor at most [rad or m]
    firm: float  # torque at which teeth are firm [N m or N]
    fitting: Fitting  # what the encoders' samples are fitted with
    encoders: np.ndarray  # the joint's own (M,)
    torque: Callable[[Sequence[np.ndarray]], np.ndarray]  # the joint's (M,) along a motion of its link, three times (M,)
    inertia: np.ndarray  # that it feels, zero while it is at rest (M,)

    @classmethod
    def of(cls, recorded: Recorded, link: Sequence[np.ndarray], joint: int, most: float = 0.0, firm: float = 1.0) -> _JointFit:
        """The fit of a joint while others move as they do."""
        only, still, torque = np.array([joint]), recorded.fitting.still, recorded.torque
        held = torque((link[0], 0.0 * link[1], 0.0 * link[2]), only)[:, 0] if still.any() else 0.0

        def taken(own: Sequence[np.ndarray]) -> np.ndarray:
            moved = [part.copy() for part in link]
            for mine, part in zip(moved, own, strict=True):
                mine[:, joint] = part
            return np.where(still, held, torque((moved[0], moved[1], moved[2]), only)[:, 0])

        felt = np.where(still, 0.0, recorded.inertia(joint))
        return cls(most, firm, recorded.fitting, np.ascontiguousarray(recorded.encoders[:, joint]), taken, felt)

    def lean(self, torque: np.ndarray) -> np.ndarray:
        """How far the link is behind (M,) under torques (M,)."""
        return self.most * np.tanh(torque / self.firm)

    @cached_property
    def tried(self) -> tuple[np.ndarray, np.ndarray]:
        """Torques that are tried at each sample, from small to large (k,), and how far the link is behind at each (k,)."""
        torques = self.firm * np.concatenate([-_FAR[::-1], _CLOSE, _FAR])
        return torques, self.lean(torques)

    @cached_property
    def left(self) -> np.ndarray:
        """What the finest splines leave of the encoder (M,) [rad or m]."""
        return self.fitting.splines[-1].remainder(self.encoders)

    @cached_property
    def noise(self) -> float:
        """Error of a sample of the encoder [rad or m], whatever the play: crossings are few.

        An encoder that stands still shows none.
        """
        moves = _spread(self.encoders, _samples(self.fitting.step)) > 0.0
        return float(np.median(np.abs(self.left[moves]))) / _MEDIAN if moves.any() else 0.0

    @cached_property
    def slow(self) -> PlayFit:
        """The slowest motion."""
        return self._rough(0, self.encoders, np.inf, 1.0)[0]

    def is_located(self, start: Behind | None) -> bool:
        """Whether encoders can show where the play is crossed; a start says how far the link is behind without a fit."""
        behind = self.lean(self.slow.torque) if start is None else start.values
        return bool(np.abs(behind).max() > _LOCATED * np.std(self.left))

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
        if not self.most:
            return PlayFit(at, self.torque(splines.motion(at)), np.inf)
        error = max(error, _NONE * self.most)
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

        The torque that teeth feel is the best one at each sample.
        """
        sharp, sure, teeth = 1.0 / error**2, 1.0 / doubt**2, (self.most, self.firm)

        def tried(coefficients: np.ndarray, start: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
            gone, torque = _apart(self.encoders, held, self.inertia, splines.first, splines.values, coefficients)
            felt = _best_tried(gone, torque, self.lean(torque), sharp, sure, *self.tried) if start is None else start
            share, left = np.tanh(felt / self.firm), np.zeros(0)
            for _ in range(_NEWTON):
                new = _next_torque(gone, torque, sharp, sure, *teeth, felt, share)
                felt, share, left = _better(gone, torque, sharp, sure, self.most, felt, share, new, np.tanh(new / self.firm))
            return gone, felt, share, float(np.sum(left))

        follows = felt is not None
        (gone, felt, share, left), damping = tried(at, felt), 0.0
        for _ in range(steps):
            step = splines.newton_step(*_curvature(gone, sharp, sure, self.inertia, *teeth, share))
            for _ in range(_DAMPED):
                new = at + step(damping)
                after = tried(new, felt if follows else None)
                if after[-1] < left:
                    break
                damping = max(_MORE_DAMPING * damping, _DAMPING)
            else:
                break
            at, before, (gone, felt, share, left) = new, left, after
            damping = damping / _MORE_DAMPING if damping > 1e-3 * _DAMPING else 0.0
            if left > (1.0 - settled) * before:
                break
        return PlayFit(at, felt, left)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _apart(encoders, held, inertia, first, values, coefficients):
    """How far encoders are from a spline (M,), and the torque that its motion takes (M,)."""
    gone, torque = np.empty(len(first)), np.empty(len(first))
    for sample in range(len(first)):
        c, q, a = coefficients[first[sample] : first[sample] + 6], values[0, sample], values[2, sample]
        gone[sample] = encoders[sample] - ((q[0] * c[0] + q[2] * c[2] + q[4] * c[4]) + (q[1] * c[1] + q[3] * c[3] + q[5] * c[5]))
        bend = (a[0] * c[0] + a[2] * c[2] + a[4] * c[4]) + (a[1] * c[1] + a[3] * c[3] + a[5] * c[5])
        torque[sample] = held[sample] + inertia[sample] * bend
    return gone, torque


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _best_tried(gone, torque, leaning, sharp, sure, tried, lean):
    """Of torques that are tried (k,) and the spline's own, by how far each makes a link lean, the best at each sample (M,).

    From the spline's own to either side, as far as a torque's distance from that alone does not make it worse.
    """
    out, near = torque.copy(), 0
    for sample in range(len(gone)):
        here, apart, weight, best = torque[sample], gone[sample], sure[sample], -1
        least = sharp * (apart - leaning[sample]) ** 2
        while near > 0 and tried[near - 1] >= here:
            near -= 1
        while near < len(tried) and tried[near] < here:
            near += 1
        for side in range(2):
            k = near if side else near - 1
            while 0 <= k < len(tried):
                wrong, off = tried[k] - here, apart - lean[k]
                far = weight * wrong * wrong
                if not far <= least:
                    break
                left = sharp * off * off + far
                if left < least:
                    least, best = left, k
                k += 2 * side - 1
        if best >= 0:
            out[sample] = tried[best]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bent(off, sharp, most, firm, share):
    """Slope of the lean at a share of the most, and what its bend adds to the second derivative of the sum, if positive."""
    slope = most / firm * (1.0 - share * share)
    return slope, max(2.0 * sharp * off / firm * share * slope, 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _next_torque(gone, torque, sharp, sure, most, firm, felt, share):
    """Torque that teeth feel at each sample after a Newton step (M,), from one at which they give this share of the play (M,)."""
    out = np.empty(len(gone))
    for k in range(len(gone)):
        off = gone[k] - most * share[k]
        slope, more = _bent(off, sharp, most, firm, share[k])
        out[k] = felt[k] + (sharp * slope * off - sure[k] * (felt[k] - torque[k])) / (sharp * slope**2 + sure[k] + more)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _better(gone, torque, sharp, sure, most, felt, share, new, moved):
    """Of two torques that teeth may feel at each sample, with their shares, the better one, its share and what it leaves (M,)."""
    felt, share, left = felt.copy(), share.copy(), np.empty(len(gone))
    for k in range(len(gone)):
        left[k] = sharp * (gone[k] - most * share[k]) ** 2 + sure[k] * (felt[k] - torque[k]) ** 2
        now = sharp * (gone[k] - most * moved[k]) ** 2 + sure[k] * (new[k] - torque[k]) ** 2
        if now < left[k]:
            left[k], felt[k], share[k] = now, new[k], moved[k]
    return felt, share, left


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _curvature(gone, sharp, sure, inertia, most, firm, share):
    """Second derivatives of the sum with respect to where the link is and to its acceleration (3, M), and the first ones (2, M).

    Signs are as `Splines.newton_step` takes them. The torque that teeth feel stays the best one.
    """
    bent, pull = np.empty((3, len(gone))), np.empty((2, len(gone)))
    for k in range(len(gone)):
        off, felt = gone[k] - most * share[k], inertia[k]
        slope, more = _bent(off, sharp, most, firm, share[k])
        own = sharp * slope**2
        part = sure[k] / (own + sure[k] + more)
        bent[0, k] = sharp * (sure[k] + more) / (own + sure[k] + more)
        bent[1, k] = sharp * slope * felt * part
        bent[2, k] = (own + more) * felt**2 * part
        pull[0, k], pull[1, k] = sharp * off, sharp * off * slope * felt
    return bent, pull
