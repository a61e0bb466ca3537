"""Limits of a motion, each as a ratio of what the motion takes to what it may take: feasible where no ratio exceeds one.

Positions, velocities and accelerations are known exactly between samples, too (`FourierSeries.extremes`). Joint torques and the
wrench under the sensor are those of the nominal links: of the sensor, with the robot's weight on it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bayesid.design.excitation.collision import Clearance
from bayesid.design.excitation.series import FourierSeries
from bayesid.dynamics.channels import Channels
from bayesid.dynamics.regressor_gradient import regressor_gradient
from bayesid.dynamics.regressors import Kernel
from bayesid.effects.flexible import MotionArrays

_BLOCK = 4096


@dataclass(frozen=True, eq=False)
class LoadLimit:
    """Readings that must not become too large."""

    kind: str  # ``torque`` or ``wrench``
    channels: Channels  # what is read
    most: np.ndarray  # largest magnitude of each channel (c,), infinite where there is no limit
    links: np.ndarray  # ten parameters a body (b, 10)
    kernel: Kernel  # the regressor's, of all link parameters

    def ratios(self, motion: MotionArrays) -> np.ndarray:
        """Readings as shares of their largest magnitude (N, c), with their signs."""
        return (self.kernel.readings(*motion, self.links) + self.channels.static_wrench) / self.most

    def gradient(self, motion: MotionArrays, weights: np.ndarray) -> MotionArrays:
        """Derivatives of ``sum(weights * ratios)`` with respect to the motion."""
        scaled = (weights / self.most)[:, :, None] * self.links.ravel()
        return regressor_gradient(self.kernel, *motion, scaled)


@dataclass(frozen=True, eq=False)
class Limits:
    """What a motion must keep to."""

    #: Positions (n,) [rad or m].
    lower: np.ndarray
    upper: np.ndarray
    #: Largest of each joint (n,) [per second (squared)]; infinite where there is none.
    speed: np.ndarray
    acceleration: np.ndarray
    loads: tuple[LoadLimit, ...] = ()  # joint torques and wrenches
    clearance: Clearance | None = None  # bodies that must not meet, or None
    moving: np.ndarray = field(default_factory=lambda: np.zeros(0, int))  # joints that move

    @property
    def middle(self) -> np.ndarray:
        """The middle of each joint's range (n,)."""
        return 0.5 * (self.lower + self.upper)

    @property
    def reach(self) -> np.ndarray:
        """Half of the joints' ranges (n,)."""
        return 0.5 * (self.upper - self.lower)

    def ratios(self, motion: MotionArrays) -> list[np.ndarray]:
        """Ratios of samples, signed: positions, velocities, accelerations (N, n), then loads and distances (N, ...)."""
        q, v, a = motion
        m = self.moving
        out = [(q[:, m] - self.middle[m]) / self.reach[m], v[:, m] / self.speed[m], a[:, m] / self.acceleration[m]]
        out += [load.ratios(motion) for load in self.loads]
        if self.clearance is not None:
            out.append(self.clearance.ratios(q))
        return out

    def gradient(self, motion: MotionArrays, weights: list[np.ndarray]) -> MotionArrays:
        """Derivatives of ``sum(weights * ratios)`` with respect to the motion."""
        m = self.moving
        out = [np.zeros_like(part) for part in motion]
        for total, weight, unit in zip(out, weights[:3], (self.reach, self.speed, self.acceleration), strict=True):
            total[:, m] = weight / unit[m]
        for load, weight in zip(self.loads, weights[3:], strict=False):
            if weight.any():
                for total, part in zip(out, load.gradient(motion, weight), strict=True):
                    total += part
        if self.clearance is not None and weights[-1].any():
            out[0] += self.clearance.gradient(motion[0], weights[-1])
        return out[0], out[1], out[2]

    def kinematic_room(self, series: FourierSeries, samples: int) -> np.ndarray:
        """Factor on the amplitudes of each moving joint by which it meets its first limit (n moving,)."""
        m, tiny = self.moving, 1e-12
        low, high, speed, acceleration = (part[m] for part in series.extremes(samples))
        centre = series.centre[m]
        above = (self.upper[m] - centre) / np.maximum(high - centre, tiny)
        below = (centre - self.lower[m]) / np.maximum(centre - low, tiny)
        room = [above, below, self.speed[m] / np.maximum(speed, tiny), self.acceleration[m] / np.maximum(acceleration, tiny)]
        return np.maximum(np.min(room, axis=0), 0.0)

    def worst(self, series: FourierSeries, samples: int) -> dict[str, np.ndarray]:
        """Largest ratio by kind, for each joint, channel or pair.

        Those of positions, velocities and accelerations hold for all times, those of loads and distances at even samples of a
        period.
        """
        m = self.moving
        low, high, speed, acceleration = (part[m] for part in series.extremes(samples))
        position = np.maximum(high - self.middle[m], self.middle[m] - low) / self.reach[m]
        found = {"position": position, "velocity": speed / self.speed[m], "acceleration": acceleration / self.acceleration[m]}
        return found | self.worst_loads(series, samples)

    def worst_loads(self, series: FourierSeries, samples: int) -> dict[str, np.ndarray]:
        """Largest ratio of torques, wrench and distances over even samples of a period."""
        parts: dict[str, list[np.ndarray]] = {}
        times = np.arange(samples) * (series.period / samples)
        for first in range(0, samples, _BLOCK):
            motion = series.at(times[first : first + _BLOCK])
            for load in self.loads:
                parts.setdefault(load.kind, []).append(np.abs(load.ratios(motion)).max(axis=0))
            if self.clearance is not None:
                parts.setdefault("collision", []).append(self.clearance.ratios(motion[0]).max(axis=0))
        return {kind: np.max(found, axis=0) for kind, found in parts.items()}
