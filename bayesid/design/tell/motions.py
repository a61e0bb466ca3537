"""Motions that are tried: periodic paths run through in different ways, each within the robot's limits, at rest at both ends.

A path is a Fourier series ``p(s) = centre + sum_k a_k sin(2 pi k f s + phase_k)`` in a parameter s, and a pace says how s
goes with time: at once, in steps of speed, forth and back, with stops. So ``v = p' s'`` and ``a = p'' s'^2 + p' s''`` are exact,
and speeds stay within the path's while ``|s'| <= 1``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.excitation.limits import Limits
from bayesid.simulation.trajectories import Trajectory

#: Points in time at which limits are checked, a second, and what is kept free for the times between.
_CHECKED, _GUARD = 50.0, 0.98
#: Factors on the speed of a motion that takes too much and on the size of one that comes too near, and how often they are tried.
_SLOWER, _SMALLER, _TRIALS = 0.8, 0.7, 8


@dataclass(frozen=True)
class Pace:
    """How the path's parameter goes with time: speeds from given times on, each reached within a ramp."""

    starts: tuple[float, ...]  # times at which a ramp to the next speed begins (k,) [s]
    speeds: tuple[float, ...]  # speeds reached (k,), the last zero; before the first, zero
    ramp: float  # time that a change of speed takes [s]
    label: str  # what it is called

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The parameter and its first two derivatives (N,) each; the third is continuous, too.

        A change of speed is ``6 x^5 - 15 x^4 + 10 x^3`` of the share x of its ramp.
        """
        steps = np.diff(np.concatenate([[0.0], self.speeds]))
        late = (times[:, None] - np.array(self.starts)) / self.ramp
        x = np.clip(late, 0.0, 1.0)
        s = self.ramp * (x**6 - 3.0 * x**5 + 2.5 * x**4 + np.maximum(late - 1.0, 0.0)) @ steps
        return s, (6.0 * x**5 - 15.0 * x**4 + 10.0 * x**3) @ steps, (30.0 * x**4 - 60.0 * x**3 + 30.0 * x**2) @ steps / self.ramp


def paces(duration: float) -> tuple[Pace, ...]:
    """Ways to run through a path in a time [s]."""
    ramp = min(1.0, duration / 12.0)
    end, third, half = duration - ramp, duration / 3.0, 0.5 * duration - 0.5 * ramp
    stops = np.arange(0.0, end - 2.0 * ramp, 4.0 * ramp)
    pulses = tuple(float(x) for t in stops for x in (t, t + 2.0 * ramp))
    return (
        Pace((0.0, end), (1.0, 0.0), ramp, "at one speed"),
        Pace((0.0, third, 2.0 * third, end), (0.25, 0.5, 1.0, 0.0), ramp, "at a quarter, half and full speed"),
        Pace((0.0, half, end), (1.0, -1.0, 0.0), ramp, "forth and back"),
        Pace(pulses, (1.0, 0.0) * len(stops), ramp, "with stops"),
    )


@dataclass(frozen=True, eq=False)
class Planned:
    """A motion that could be made."""

    centre: np.ndarray  # (n,) [rad or m]
    #: Of the path (h, n).
    amplitudes: np.ndarray
    phases: np.ndarray
    fundamental: float  # f [Hz]
    pace: Pace  # how it is run through
    duration: float  # [s]

    @property
    def label(self) -> str:
        """What the motion is, in words."""
        moved = np.flatnonzero(self.amplitudes.any(axis=0))
        who = "all joints" if len(moved) == self.amplitudes.shape[1] else ", ".join(f"joint {j + 1}" for j in moved)
        return f"{who} {self.pace.label}"

    def _path(self, s: np.ndarray, derivative: int) -> np.ndarray:
        """The path less its centre, or a derivative, at parameters (N,) -> (N, n)."""
        omega = 2.0 * np.pi * self.fundamental * np.arange(1, len(self.amplitudes) + 1)
        angle = s[:, None, None] * omega[:, None] + self.phases + derivative * np.pi / 2
        return np.sum(omega[:, None] ** derivative * self.amplitudes * np.sin(angle), axis=1)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations (N, n) each."""
        s, rate, change = (x[:, None] for x in self.pace.at(times))
        first, second = self._path(s[:, 0], 1), self._path(s[:, 0], 2)
        return self.centre + self._path(s[:, 0], 0), first * rate, second * rate**2 + first * change

    def trajectory(self, name: str, rate: float) -> Trajectory:
        """Sample the motion, so many times a second."""
        times = np.arange(int(round(self.duration * rate)) + 1) / rate
        return Trajectory(name, "identification", times, *self.at(times))


def within_limits(motion: Planned, limits: Limits, share: float = 1.0) -> Planned | None:
    """The motion made to keep the limits: smaller, slower, elsewhere; None where that does not help.

    ``share`` is that of the speed limits which is used.
    """
    times = np.linspace(0.0, motion.duration, int(_CHECKED * motion.duration) + 1)
    for _ in range(_TRIALS):
        q, v, _ = replace(motion, centre=np.zeros(len(motion.centre))).at(times)
        span, peak = np.ptp(q, axis=0), np.abs(v).max(axis=0)
        room = np.minimum(
            _GUARD * 2.0 * limits.reach / np.maximum(span, 1e-9), _GUARD * share * limits.speed / np.maximum(peak, 1e-9)
        )
        scale = np.minimum(room, 1.0)
        least, most = limits.lower - scale * q.min(axis=0), limits.upper - scale * q.max(axis=0)
        edge = 0.5 * (1.0 - _GUARD) * np.minimum(scale * span, most - least)
        motion = replace(motion, amplitudes=scale * motion.amplitudes, centre=np.clip(motion.centre, least + edge, most - edge))
        _, _, *forced = limits.ratios(motion.at(times))
        near = forced.pop() if limits.clearance is not None else np.zeros(1)
        if max(float(np.abs(r).max(initial=0.0)) for r in forced) > _GUARD:
            motion = replace(motion, fundamental=_SLOWER * motion.fundamental)
        elif float(near.max(initial=0.0)) > 1.0:
            motion = replace(motion, amplitudes=_SMALLER * motion.amplitudes)
        else:
            return motion
    return None


def pool(limits: Limits, duration: float, count: int, seed: int) -> Iterator[Planned]:
    """About ``count`` motions of ``duration`` [s] within limits: random series of different speed and size, and single joints."""
    rng = np.random.default_rng(seed)
    n, range_ = len(limits.lower), 2.0 * limits.reach
    moving = np.isin(np.arange(n), limits.moving)
    ways = paces(duration)
    for k in range(count):
        harmonics = 5
        amplitudes = rng.normal(1.0, 0.4, (harmonics, n)) / np.arange(1, harmonics + 1)[:, None] * range_
        amplitudes = amplitudes * rng.uniform(0.1, 0.5, n) * moving
        if k % 4 == 3:  # one motion in four is of one joint alone
            amplitudes = amplitudes * (np.arange(n) == limits.moving[(k // 4) % len(limits.moving)])
        pace = ways[0] if k % 4 < 2 else ways[1 + (k // 4) % (len(ways) - 1)]
        frequency = float(np.exp(rng.uniform(np.log(1.0 / duration), np.log(0.5))))
        centre = np.where(moving, rng.uniform(limits.lower, limits.upper), limits.middle)
        motion = Planned(centre, amplitudes, rng.uniform(0, 2 * np.pi, (harmonics, n)), frequency, pace, duration)
        share = 1.0 if k % 2 == 0 else float(rng.uniform(0.2, 1.0))
        if (fitted := within_limits(motion, limits, share)) is not None:
            yield fitted


def prolonged(motion: Planned) -> Planned:
    """The same path at the same pace for twice as long."""
    duration = 2.0 * motion.duration
    pace = next(p for p in paces(duration) if p.label == motion.pace.label)
    return replace(motion, pace=pace, duration=duration)


def varied(motion: Planned, limits: Limits, size: float, rng: np.random.Generator) -> Planned | None:
    """A motion near another within limits, or None; ``size`` is the relative change of amplitudes and frequency."""
    shape = motion.amplitudes.shape
    changed = replace(
        motion,
        amplitudes=motion.amplitudes * np.exp(size * rng.normal(size=shape)) * np.exp(size * rng.normal(size=shape[1])),
        phases=motion.phases + size * rng.normal(size=shape),
        centre=motion.centre + 0.6 * size * limits.reach * rng.normal(size=shape[1]) * motion.amplitudes.any(axis=0),
        fundamental=motion.fundamental * float(np.exp(0.5 * size * rng.normal())),
    )
    return within_limits(changed, limits)
