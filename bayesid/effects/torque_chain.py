"""What is read of the torques that joints take: motors give them through their transmissions, at another time, times a gain.

What comes on top inside a joint, friction and the like, is that of the motor at the time that is read (`bayesid.effects.model`).

Coupled transmissions have motors at m = (1 + C) q of their gears' outputs and joints at q. Where no power is lost, ``tau' dq =
tau_m' dm``, the motors give ``tau_m = (1 + C)'^-1 tau`` for the joints' torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.effects.effect import Term
from bayesid.effects.families import JointMotion, TransmissionEffect
from bayesid.effects.flexible import MotionArrays
from bayesid.effects.segment import MotionSegment
from bayesid.errors import InputError
from bayesid.robot.robot import Robot


def coupling_matrix(robot: Robot, coupled: Sequence[tuple[TransmissionEffect, Sequence[float]]]) -> np.ndarray:
    """Map from joint positions to the motors', 1 + C (n, n)."""
    out = np.eye(robot.n)
    for effect, values in coupled:
        out[effect.joint, effect.driver] += effect.coupling(values)
    return out


@dataclass(frozen=True, eq=False)
class TorqueChain:
    """Steps from the joints' torques to readings, in channels of which some are torques."""

    joints: Mapping[int | None, int]  # channel that reads each joint's torque
    #: From the motors' positions to the joints', (1 + C)^-1 (n, n); None where no transmissions are coupled.
    transmission: np.ndarray | None
    #: How long ago torques are read, by joint [s], where that is another time than that of the positions.
    delays: Mapping[int | None, float]
    gain: np.ndarray  # 1 + gain of each channel (c,)

    def at_motors(self, true: np.ndarray) -> np.ndarray:
        """True wrench and joint torques, or changes of them (N, c, ...), with what the motors give for the torques instead.

        An `InputError` where a motor gives a part of a torque that no channel reads.
        """
        if self.transmission is None or not self.joints:
            return true
        read = [j for j in range(len(self.transmission)) if j in self.joints]
        taken = np.flatnonzero(np.any(self.transmission[:, read] != 0.0, axis=1)).tolist()
        if not self.joints.keys() >= {*taken}:
            lacking = ", ".join(f"tau{k + 1}" for k in taken if k not in self.joints)
            raise InputError(f"coupled transmissions take {lacking} into other torques; record it, or leave that coupling out")
        out, order = np.array(true), [self.joints[j] for j in read]
        out[:, order] = np.einsum("kj,nk...->nj...", self.transmission[np.ix_(read, read)], true[:, order])
        return out

    def late(self, segment: MotionSegment, values: np.ndarray, column: Mapping | None = None) -> np.ndarray:
        """What smooth values (N, c, ...) were at the times that torques are read for, by joint's column, default its channel."""
        if not self.delays:
            return values
        out, column = np.array(values), column or self.joints
        for delay in set(self.delays.values()):
            at = [column[joint] for joint, own in self.delays.items() if own == delay]
            out[:, at] = segment.late(out[:, at], delay)
        return out

    def late_motion(self, segment: MotionSegment, motion: MotionArrays, pose: tuple[Term, ...]) -> MotionArrays:
        """The joints' positions, velocities and accelerations (N, n) at these times; ``pose`` is what they differ by else."""

        def made() -> MotionArrays:
            q, v, a = (self.late(segment, x, {joint: joint for joint in self.joints}) for x in motion)
            return q, v, a

        key = ("late", tuple(self.delays.items()), tuple(self.joints), pose)
        return segment.results.get(key, made) if self.delays else motion

    def at_joint(self, segment: MotionSegment, late: MotionArrays, joint: int, load: np.ndarray | None) -> JointMotion:
        """What happens at one joint when its torque is read, from `late_motion` and the load then.

        With a delay, friction that reverses within a sample's time is its mean there: of a sign that jumps at a sample there is
        no derivative to estimate a delay by.
        """
        times, cell = segment.times, segment.cell
        if joint in self.delays and not segment.still:
            times, cell = times - self.delays[joint], cell or float(np.ptp(times)) / max(len(times) - 1, 1)
        q, v, a = (np.ascontiguousarray(x[:, joint]) for x in late)
        return JointMotion(times, q, v, a, load, cell)
