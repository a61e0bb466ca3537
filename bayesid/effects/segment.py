"""One gap-free segment of joint motion, and results that are kept with it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from bayesid.signals.smoothing import smooth

#: Speed below which a joint counts as nearly at rest and friction as partly mobilised [rad/s or m/s].
REST_SPEED = 1e-3
_KEPT, _KEPT_OF_TIMES, _KEPT_OF_JOINTS = 6, 12, 60  # the last are small, and each takes long
#: From here on the slope of a drift is lost in its size at the start [s]: a day.
_LATE = 1e5
_SPLINE = 5  # degree of the interpolation that a delay is made with


class Results:
    """The last few results by what they were made from; threads may share it.

    Keys say by value all that a result depends on; none is an object's identity. Of more results than ``most`` the one that was
    longest not asked for goes first.
    """

    def __init__(self, most: int = _KEPT):
        self._most = most
        self._kept: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

    def __reduce__(self):
        """A copy begins empty."""
        return Results, (self._most,)

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The result of this key; made, outside the lock, where it is not there. Of two made at once the first stays."""
        with self._lock:
            if key in self._kept:
                self._kept[key] = self._kept.pop(key)  # to the end: asked for last
                return self._kept[key]
        made = make()
        with self._lock:
            if key not in self._kept:
                while len(self._kept) >= self._most:
                    del self._kept[next(iter(self._kept))]
                self._kept[key] = made
            return self._kept[key]


@dataclass(frozen=True, eq=False)
class MotionSegment:
    """One gap-free segment of joint motion, smoothed."""

    times: np.ndarray  # (N,) [s]
    #: What the encoders say, (N, n) each [rad or m and per second (squared)].
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    still: bool = False  # whether every sample is a pose at rest of its own
    bandwidth: float = 10.0  # of the joint motion [Hz]
    middle: np.ndarray | None = None  # joint positions at the middle of the motion (n,); default `middle_of` this segment
    #: Up to where motion stands out of the encoders' noise [Hz]: what is differentiated again is smoothed to this, default a
    #: share of the bandwidth.
    clear: float | None = None
    cell: float = 0.0  # time that a sample stands for [s]: friction that reverses in it is its mean there; 0: that at the sample
    encoders: tuple[np.ndarray, np.ndarray] | None = None  # times (M,) [s] and joint positions (M, n) that were smoothed
    in_turn: bool = False  # whether poses at rest were read one after another, so that time counts between them
    #: Link states and readings made lately, what depends on times and encoders' readings alone, and what stays the same while a
    #: play, a compliance or a mount is varied.
    results: Results = field(default_factory=Results, init=False, repr=False)
    basis: Results = field(default_factory=partial(Results, _KEPT_OF_TIMES), init=False, repr=False)
    joints: Results = field(default_factory=partial(Results, _KEPT_OF_JOINTS), init=False, repr=False)

    @property
    def middle_positions(self) -> np.ndarray:
        """Joint positions at the middle of the motion (n,)."""
        if self.middle is not None:
            return np.asarray(self.middle, float)
        return middle_of(self.positions)

    @property
    def elapsed(self) -> np.ndarray:
        """Time that things change with (N,) [s]; zero in a static run, before which a sensor is re-zeroed."""
        return np.zeros_like(self.times) if self.still and not self.in_turn else self.times

    @property
    def at_rest(self) -> MotionSegment:
        """The same positions, each held."""

        def held() -> MotionSegment:
            zero = np.zeros_like(self.positions)
            still = replace(self, velocities=zero, accelerations=zero, still=True, in_turn=False, encoders=None)
            return replace(still, middle=self.middle_positions)

        return self.basis.get("at rest", held)

    @property
    def at_encoders(self) -> MotionSegment:
        """The same motion at the encoders' own samples."""
        if self.encoders is None or self.encoders[0] is self.times:
            return self
        times, read = self.encoders

        def sampled() -> MotionSegment:
            state = smooth(times, read, self.bandwidth)
            return replace(
                self, times=times, positions=state[0], velocities=state[1], accelerations=state[2],
                middle=self.middle_positions, encoders=(times, read),
            )  # fmt: skip

        return self.basis.get(("at encoders", self.bandwidth), sampled)

    def late(self, values: np.ndarray, delay: float) -> np.ndarray:
        """What smooth values (N, ...) were a delay ago [s]; poses at rest are what they are at any time."""
        return values if delay == 0.0 or self.still else delayed(self.times, values, delay)


def middle_of(positions: np.ndarray) -> np.ndarray:
    """Joint positions at the middle of a motion (n,).

    Where it starts and ends, if that is one place, else half-way between the extremes: a periodic motion goes around
    the place that it starts from and comes back to.
    """
    first, last = positions[0], positions[-1]
    closed = np.abs(last - first) < 0.02 * np.maximum(np.ptp(positions, axis=0), 1e-9)
    return first if closed.all() else 0.5 * (positions.min(axis=0) + positions.max(axis=0))


def direction(velocity: np.ndarray, acceleration: np.ndarray, cell: float) -> np.ndarray:
    """Sign of a velocity (N,), or its mean over the time that a sample stands for, in which the velocity is ``v + a t``.

    Nearly at rest the sign is noise and the joint may stick, and a narrow ramp says so.
    """
    return np.clip(velocity / np.maximum(REST_SPEED, 0.5 * cell * np.abs(acceleration)), -1.0, 1.0)


def delayed(times: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """Values at ``t - delay``: a spline through the samples, its ends prolonged straight."""
    if len(times) <= _SPLINE:
        return values
    from scipy.interpolate import make_interp_spline  # takes long to import, and few experiments have delays

    flat = values.reshape(len(times), -1)
    spline = make_interp_spline(times, flat, k=_SPLINE)
    at = times - delay
    out = spline(np.clip(at, times[0], times[-1]))
    beyond = (at < times[0]) | (at > times[-1])
    if beyond.any():
        ends = np.clip(at[beyond], times[0], times[-1])
        out[beyond] += (at[beyond] - ends)[:, None] * spline(ends, 1)
    return out.reshape(values.shape)


def late_start(start: float) -> list[str]:
    """That the slope of what grows with time is lost in its size where tables start [s], if they start so late."""
    if start < _LATE:
        return []
    return [
        f"Times start at {start:.3g} s. A drift and a drive's warming count from time zero, so that they look constant here; "
        "subtract the start."
    ]
