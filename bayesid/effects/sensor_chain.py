"""What a force/torque sensor makes of the wrench that it feels.

A wrench is read about the shifted origin, turned by exp([r])', a moment ago; gains and cross-talk mix that, offset
and drift come on top.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from bayesid.dynamics.channels import Channels
from bayesid.effects.segment import MotionSegment
from bayesid.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class SensorChain:
    """Steps from the true wrench to the reading."""

    shift_axes: np.ndarray  # from a shift in base axes, or in those of the sensor's link, to the sensor's axes (3, 3)
    #: Of the sensor against its stated pose (3,) [m], and its rotation vector (3,) [rad].
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    delay: float = 0.0  # [s]
    mix: np.ndarray = field(default_factory=lambda: np.eye(6))  # gains and cross-talk (6, 6)
    #: (6,) [N, N m], [.../s].
    offset: np.ndarray = field(default_factory=lambda: np.zeros(6))
    drift: np.ndarray = field(default_factory=lambda: np.zeros(6))

    @classmethod
    def of(cls, robot: Robot, channels: Channels, wrench: np.ndarray) -> SensorChain:
        """A faultless sensor; ``wrench`` holds the indices of its six axes in the channels."""
        if not len(wrench):
            return cls(np.eye(3))
        # The axes of the sensor in its joint's frame, or in the base frame, are the twists of its force channels.
        axes = channels.twist[wrench[:3], :3]
        if channels.joint[wrench[0]] < 0:
            axes = axes @ channels.reference_rotation.T
        return cls(axes @ robot.sensor_rotation)

    @cached_property
    def pose(self) -> np.ndarray:
        """Map of a shifted origin and turned axes (6, 6)."""
        pose = np.eye(6)
        d = self.shift_axes @ self.shift
        pose[3:, :3] = -np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])
        back = pin.exp3(np.asarray(self.turn, float)).T
        return np.kron(np.eye(2), back) @ pose

    def sensed(self, segment: MotionSegment, wrench: np.ndarray) -> np.ndarray:
        """Wrenches (N, 6, k) before gains and cross-talk."""
        return segment.late(_mixed(self.pose, wrench), self.delay)

    def linear(self, segment: MotionSegment, wrench: np.ndarray) -> np.ndarray:
        """All but offset and drift, (N, 6, k)."""
        return _mixed(self.mix, self.sensed(segment, wrench))

    def reading(self, segment: MotionSegment, wrench: np.ndarray) -> np.ndarray:
        """What the sensor reads (N, 6)."""
        return self.linear(segment, wrench[:, :, None])[:, :, 0] + self.offset + segment.elapsed[:, None] * self.drift


def _mixed(matrix: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """A matrix (6, 6) times wrenches (N, 6, k)."""
    if np.array_equal(matrix, np.eye(6)):
        return wrench
    return np.einsum("ij,njk->nik", matrix, wrench) if wrench.shape[2] < 4 else np.matmul(matrix, wrench)
