"""What a robot with effects consists of, and where its motors hold the joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self, TypeVar, cast

import numpy as np

from bayesid.dynamics.channels import Channels
from bayesid.dynamics.kinematics import is_wrench
from bayesid.effects.bodies import body_of, split_matrix
from bayesid.effects.effect import Effect, Term, by_class
from bayesid.effects.families import BodyEffect, EncoderEffect, GravityEffect, InstrumentEffect, TransmissionEffect
from bayesid.effects.flexible import Motion
from bayesid.effects.segment import MotionSegment
from bayesid.effects.transmission import coupling_matrix
from bayesid.robot.robot import Robot

Family = TypeVar("Family", bound=Effect)


@dataclass(frozen=True, eq=False)
class Parts:
    """A robot with effects in one motion segment.

    Attributes
    ----------
    robot, channels, segment
        What moves, what is measured, and when.
    links
        Ten parameters a body (b, 10).
    terms
        The effects.
    near
        A model that this one is a small change of: what has more than one solution then follows that one's.
    """

    robot: Robot
    channels: Channels
    segment: MotionSegment
    links: np.ndarray
    terms: tuple[Term, ...]
    near: Self | None = None

    def of_family(self, family: type[Family]) -> list[tuple[Family, tuple[float, ...]]]:
        """The effects of one family with their values."""
        return cast("list[tuple[Family, tuple[float, ...]]]", [(t.effect, t.values) for t in self._by_family.get(family, ())])

    @cached_property
    def _by_family(self) -> dict[type, list[Term]]:
        return by_class(self.terms)

    @cached_property
    def wrench(self) -> np.ndarray:
        """Indices of the sensor's channels."""
        return np.flatnonzero(is_wrench(self.channels))

    @cached_property
    def joints(self) -> dict[int | None, int]:
        """Channel that reads each joint's torque."""
        sensor = is_wrench(self.channels)
        return {int(name[3:]) - 1: k for k, name in enumerate(self.channels.names) if not sensor[k]}

    @cached_property
    def row_of(self) -> np.ndarray:
        """Row of the state that each body and the root moves with (b + 1,)."""
        return np.append(self.robot.body_joint, self.robot.n)

    @cached_property
    def carries(self) -> np.ndarray:
        """Which bodies each channel carries, the root last (c, b + 1)."""
        root = is_wrench(self.channels) & (self.channels.joint < 0)
        return np.hstack([self.channels.bodies, root[:, None]])

    @cached_property
    def gravity(self) -> np.ndarray:
        """Gravity in the base frame, turned by the base's tilt (3,)."""
        gravity = self.robot.gravity
        for effect, values in self.of_family(GravityEffect):
            gravity = effect.turned(gravity, values)
        return np.asarray(gravity, float)

    @cached_property
    def bodies(self) -> np.ndarray:
        """All bodies' parameters in their joints' frames, the root's last (b + 1, 10)."""
        robot = self.robot
        out = np.vstack([self.links, robot.static_nominal])
        for body in range(robot.n, len(robot.body_names)):
            out[body] = split_matrix(robot, body) @ out[body]
        for effect, values in self.of_family(BodyEffect):
            out[body_of(robot, effect.joint)] += effect.body(values)
        return out

    @cached_property
    def motor(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True joint positions on the motors' side, velocities, accelerations."""
        return self.segment.positions - self._encoder_shift, self.segment.velocities, self.segment.accelerations

    @cached_property
    def _encoder_shift(self) -> np.ndarray:
        """What encoders read too much (n,)."""
        shift = np.zeros(self.robot.n)
        for effect, values in self.of_family(EncoderEffect):
            shift[effect.joint] += effect.shift(values)
        return shift

    @cached_property
    def transmission(self) -> np.ndarray | None:
        """From the motors' positions to the joints', (1 + C)^-1 (n, n); None where no transmissions are coupled."""
        coupled = self.of_family(TransmissionEffect)
        return np.linalg.inv(coupling_matrix(self.robot, coupled)) if coupled else None

    def _at_joints(self, motors: np.ndarray) -> np.ndarray:
        """What joints do (N, n) where motors do this."""
        return motors if self.transmission is None else motors @ self.transmission.T

    @cached_property
    def joint_motion_of_motors(self) -> Motion:
        """Where motors hold the joints: positions, velocities, accelerations."""
        q, v, a = (self._at_joints(x) for x in self.motor)
        return q, v, a

    @cached_property
    def _physical(self) -> tuple[Term, ...]:
        """Effects that change what there is to read, not how it is read."""
        return tuple(t for t in self.terms if InstrumentEffect not in type(t.effect).__mro__)
