"""Families of effects: where on the way from the motion to the reading an effect acts, and the method that says how.

In this order (`bayesid.effects.model`):

1. `EncoderEffect`: the true joint position is the encoder's less a shift; `TransmissionEffect`: another joint's motion turns
   the motor, too; `PlayEffect`, `FlexibleJointEffect`: the link lags the motor;
2. `MountEffect`: the base turns under the robot;
3. `BodyEffect`, `GravityEffect`, `LoadEffect`, `RotorEffect`: bodies, their weight, what pulls or pushes them, what spins;
4. the instruments: `JointTorqueEffect` inside a joint, `SensorEffect` in the force/torque sensor, `ReadingEffect` on top of
   any reading, `JointGainEffect`, and last `JointDelayEffect`.

An effect of one's own derives from one of these and writes one method; derivatives come from differences where the class
does not say them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, TypeGuard

import numpy as np

from bayesid.effects.effect import Effect
from bayesid.effects.segment import MotionSegment, direction
from bayesid.effects.sensor_chain import SensorChain
from bayesid.errors import InputError
from bayesid.robot.robot import Robot

#: Bodies by index, with the wrench (N, 6) about the base origin on each.
Loads = list[tuple[int, np.ndarray]]


@dataclass(frozen=True, eq=False)
class JointMotion:
    """What happens at one joint."""

    time: np.ndarray  # (N,) [s]
    #: Of the motor's side (N,).
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    link_torque: np.ndarray | None  # that moves and carries the links (N,); None for effects that do not say ``uses_load``
    cell: float  # time that a sample stands for [s]

    @property
    def load(self) -> np.ndarray:
        """Torque that moves and carries the links (N,)."""
        if self.link_torque is None:
            raise InputError("an effect inside a joint takes the joint's load; write uses_load = True in its class")
        return self.link_torque

    @cached_property
    def direction(self) -> np.ndarray:
        """Sign of the velocity (N,); see `bayesid.effects.segment.direction`."""
        return direction(self.velocity, self.acceleration, self.cell)

    @cached_property
    def ways(self) -> np.ndarray:
        """Signed ways (2 (N - 1),), two between samples, for a velocity that is straight there and may reverse."""
        step, speed, sign = np.diff(self.time), np.abs(self.velocity), np.sign(self.velocity)
        turns = sign[:-1] * sign[1:] < 0.0
        both = np.where(turns, speed[:-1] + speed[1:], 1.0)
        first, second = (0.5 * step * s * np.where(turns, s / both, 1.0) for s in (speed[:-1], speed[1:]))
        return np.column_stack([first * sign[:-1], second * sign[1:]]).ravel()


@dataclass(frozen=True, eq=False)
class Readout:
    """What the instruments are given to read."""

    names: tuple[str, ...]  # of the channels (c,)
    segment: MotionSegment  # the recording's motion
    #: Of the motors (N, n).
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    true: np.ndarray  # true wrench and what the motors give for the joints' torques (N, c)


def differences(effect: Effect, values: Sequence[float], reading: Callable[[tuple[float, ...]], np.ndarray]) -> np.ndarray:
    """Central differences of a reading (N, ...) with respect to an effect's parameters, (N, ..., k)."""
    out = []
    for k, parameter in enumerate(effect.quantities):
        step = max(parameter.step, 1e-4 * abs(values[k]))
        ends = []
        for sign in (1.0, -1.0):
            moved = list(values)
            moved[k] += sign * step
            ends.append(reading(tuple(moved)))
        out.append((ends[0] - ends[1]) / (2.0 * step))
    return np.stack(out, axis=-1)


# -- the motion


class EncoderEffect(Effect):
    """An encoder reads something else than its joint's position."""

    at = "joint"
    along_joint = True

    @abstractmethod
    def shift(self, values: Sequence[float]) -> float:
        """What the encoder reads beyond the true position [rad or m]."""


class TransmissionEffect(Effect):
    """The motion of one joint, the effect's ``driver``, turns the motor of another joint, too.

    The motor of joint k, where position and torque are measured, is at ``m = q_k + c q_driver`` of its gear's output. No power
    is lost between motors and joints (``m = (1 + C) q`` and ``tau' dq = tau_m' dm``), so the motors' torques are
    ``(1 + C)'^-1 tau``: that of the driver lacks c times what joint k takes.
    """

    at = "joint->joint"

    @abstractmethod
    def coupling(self, values: Sequence[float]) -> float:
        """c: how far the motor turns with its driver, in units of its gear's output."""

    def predictable(self, channels):
        """Whether with the driver's torque that of the joint itself is read."""
        driver, own = (None if k is None else f"tau{k + 1}" for k in (self.driver, self.joint))
        return own in channels or driver not in channels


class FlexibleJointEffect(Effect):
    """The link is not where the motor is (`bayesid.effects.flexible`)."""

    at = "joint"
    along_joint = True
    amplifies_encoder_errors = True

    @abstractmethod
    def compliance(self, values: Sequence[float]) -> float:
        """How far the link gives under the joint's torque [rad/(N m) or m/N]."""


class PlayEffect(Effect):
    """The link leans to one side of some play behind the motor (`bayesid.effects.play`)."""

    at = "joint"
    along_joint = True
    amplifies_encoder_errors = True

    @abstractmethod
    def teeth(self, values: Sequence[float]) -> tuple[float, float]:
        """How far the link stays behind the motor at most [rad or m], and the torque at which teeth are firm [N m or N]."""

    def lean(self, torque: np.ndarray, values: Sequence[float]) -> np.ndarray:
        """How far the link stays behind the motor (N,) [rad or m] under the joint's torque (N,)."""
        most, firm = self.teeth(values)
        return most * np.tanh(torque / firm)


class MountEffect(Effect):
    """The base turns on a compliant, damped mount (`bayesid.effects.mount`)."""

    at = "base"
    amplifies_encoder_errors = True

    @abstractmethod
    def resonance(self, values: Sequence[float]) -> tuple[float, float]:
        """Frequency [Hz] and damping ratio."""


# -- bodies and what acts on them


class BodyEffect(Effect):
    """A body, or part of one, more or less on a link."""

    at = "joint"
    changes_link = True

    def body(self, values: Sequence[float]) -> np.ndarray:
        """Ten parameters in the joint's frame (10,); unless the class says otherwise, those of the effect."""
        return np.array(values, float)


class GravityEffect(Effect):
    """Gravity is not what is stated."""

    at = "base"

    @abstractmethod
    def turned(self, gravity: np.ndarray, values: Sequence[float]) -> np.ndarray:
        """Gravity in the base frame (3,) [m/s^2]."""


class LoadEffect(Effect):
    """Something pulls or pushes links from outside."""

    at = "joint"

    @abstractmethod
    def loads(self, robot: Robot, segment: MotionSegment, states: np.ndarray, values: Sequence[float]) -> Loads:
        """Wrenches on bodies about the base origin, by states of the links (N, n + 1, 24), see `bayesid.dynamics.kinematics`."""

    def load_columns(self, robot: Robot, segment: MotionSegment, states: np.ndarray, values: Sequence[float]) -> Loads:
        """Derivatives of `loads` with respect to the parameters, (N, 6, k) each; a class may have them in closed form."""

        def wrenches(v: Sequence[float]) -> np.ndarray:
            return np.stack([wrench for _, wrench in self.loads(robot, segment, states, v)])

        bodies = [body for body, _ in self.loads(robot, segment, states, values)]
        return list(zip(bodies, differences(self, values, wrenches), strict=True)) if bodies else []


class RotorEffect(Effect):
    """Angular momentum of a spinning rotor."""

    at = "joint"
    needs_gear_ratio = True

    def inertia(self, values: Sequence[float]) -> float:
        """Gear ratio x rotor inertia [kg m^2]."""
        return float(values[0])


# -- the instruments


class InstrumentEffect(Effect):
    """Changes readings, not what is read: neither motion nor loads depend on it."""


class JointTorqueEffect(InstrumentEffect):
    """Friction, springs, motors: what something inside a joint adds to its torque."""

    channels = ("torque",)
    at = "joint"
    along_joint = True
    #: Whether it depends on the torque that moves and carries the links.
    uses_load: ClassVar[bool] = False
    #: Whether it depends on the time or on the motion before, so that the state at a moment does not say it.
    remembers: ClassVar[bool] = False

    @abstractmethod
    def torque(self, motion: JointMotion, values: Sequence[float]) -> np.ndarray:
        """Torque that the effect adds (N,) [N m or N]."""

    def per_load(self, motion: JointMotion, values: Sequence[float]) -> np.ndarray:
        """Derivative of `torque` with respect to the load (N,), for effects that use it."""
        step = 1e-6 * max(float(np.abs(motion.load).max(initial=0.0)), 1.0)
        ends = [self.torque(replace(motion, link_torque=motion.load + s * step), values) for s in (1.0, -1.0)]
        return (ends[0] - ends[1]) / (2.0 * step)

    @property
    def from_motion_alone(self) -> bool:
        """Where it is linear and does not use the load."""
        return not self.shape and not self.uses_load

    def motion_columns(self, segment: MotionSegment, channels: Sequence[str]) -> np.ndarray:
        """Derivatives of the readings with respect to the parameters (N, channels, k).

        An `InputError` where `torque` returns no number a sample, or is not linear in its parameters.
        """
        out = np.zeros((len(segment.times), len(channels), len(self.parameters)))
        joint = -1 if self.joint is None else self.joint
        if (name := f"tau{joint + 1}") in channels:
            q, v, a = (x[:, joint] for x in (segment.positions, segment.velocities, segment.accelerations))
            motion = JointMotion(segment.times, q, v, a, None, segment.cell)
            columns = np.stack([self._numbers(motion, unit) for unit in np.eye(len(self.parameters))], axis=1)
            doubled = self._numbers(motion, np.full(len(self.parameters), 2.0))
            if np.abs(doubled - 2.0 * columns.sum(axis=1)).max(initial=0.0) > 1e-6 * np.abs(doubled).max(initial=0.0):
                raise InputError(
                    f"effect '{self.name}': torque is not linear in {', '.join(self.parameters)}; declare each that it is not "
                    "linear in with linear=False and a start, and add nothing that no parameter multiplies"
                )
            out[:, channels.index(name)] = columns
        return out

    def _numbers(self, motion: JointMotion, values: np.ndarray) -> np.ndarray:
        """What `torque` returns, as finite numbers (N,)."""
        try:
            given = np.asarray(self.torque(motion, tuple(values)), float)
        except (TypeError, ValueError, IndexError, AttributeError, NameError) as error:
            raise InputError(f"effect '{self.name}': torque ends in {type(error).__name__}: {error}; mend it") from error
        if given.shape not in ((), motion.position.shape):
            raise InputError(
                f"effect '{self.name}': torque has shape {given.shape} for {len(motion.time)} samples; return one each"
            )
        if not np.isfinite(given).all():
            raise InputError(f"effect '{self.name}': torque has no finite value somewhere in this motion; mend it")
        return np.broadcast_to(given, motion.position.shape)


def needs_no_load(effect: Effect) -> TypeGuard[JointTorqueEffect]:
    """Whether an effect is a torque inside a joint that neither links nor effects elsewhere have a part in."""
    return isinstance(effect, JointTorqueEffect) and not effect.uses_load


def comes_on_top(effect: Effect) -> bool:
    """Whether what an effect adds to readings is the same whatever the links are, and theirs is the same whatever it is."""
    return needs_no_load(effect) or isinstance(effect, (BodyEffect, LoadEffect, RotorEffect))


class JointGainEffect(InstrumentEffect):
    """A joint's torque is read larger or smaller than it is, all that is inside the joint included."""

    channels = ("torque",)
    at = "joint"

    def gain(self, values: Sequence[float]) -> float:
        """What of the torque is read too much, as a share."""
        return float(values[0])


class JointDelayEffect(InstrumentEffect):
    """A joint's torque, or that of all joints, is read at another time than its position."""

    channels = ("torque",)
    at = "joint|robot"

    def delay(self, values: Sequence[float]) -> float:
        """How long ago what is read was [s]."""
        return float(values[0])


class SensorEffect(InstrumentEffect):
    """A step of the force/torque sensor's chain."""

    channels = ("wrench",)
    at = "sensor"

    @abstractmethod
    def applied(self, chain: SensorChain, values: Sequence[float]) -> SensorChain:
        """The chain with this effect."""

    def columns(self, chain: SensorChain, segment: MotionSegment, true: np.ndarray, values: Sequence[float]) -> np.ndarray:
        """Derivative of the reading (N, 6, k) at its values; ``chain`` is without it, ``true`` the wrench (N, 6)."""
        return differences(self, values, lambda v: self.applied(chain, v).reading(segment, true))


def only_read(effect: Effect) -> bool:
    """Whether an effect is an error of a sensor or of a drive's reading, and no torque or wrench that acts."""
    return isinstance(effect, (JointGainEffect, JointDelayEffect, SensorEffect))


class ReadingEffect(InstrumentEffect):
    """Something that comes on top of any channels' readings."""

    @abstractmethod
    def added(self, readout: Readout, values: Sequence[float]) -> np.ndarray:
        """What is read beside the truth (N, c)."""

    def tangent(self, readout: Readout, values: Sequence[float], change: np.ndarray) -> np.ndarray | None:
        """Change of `added` with a change of the true readings (N, c, k); None: it does not depend on them."""
        return None
