"""What instruments read of a robot with effects, exactly.

In this order:

1. the joints: a motor is at the encoder's reading less its offset, and joints are at (1 + C)^-1 of it where C couples their
   transmissions; a link leans to one side of its gear's play, and a flexible joint's is at that less compliance x torque;
2. the mount: a compliant base turns under the robot (`bayesid.effects.mount`);
3. the bodies: links, payload and inertia errors under a gravity turned by the base's tilt; what pulls or pushes
   them from outside; rotors. A channel with twist S reads ``S . sum (w_i - f_i)`` over the bodies that it carries,
   w_i what body i's motion and weight take and f_i what acts on it from outside;
4. the sensor: pose, delay, gains and cross-talk, offset and drift;
5. the motors: what they give for the joints' torques, (1 + C)'^-1 of these, and for friction, springs and rotors inside the
   joints, at the time that a torque is read for; what else comes on top of a reading; then the torque's gain.

What an effect does in its step is a method of its class (`bayesid.effects.families`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeVar, cast

import numpy as np

from bayesid.dynamics.channels import Channels, torque_channels
from bayesid.dynamics.kinematics import body_wrenches, channel_twists, is_wrench, link_states, project, readings_of_bodies
from bayesid.effects import families
from bayesid.effects.bodies import body_of, rotor_couple, split_matrix
from bayesid.effects.effect import Effect, Term
from bayesid.effects.families import JointMotion, Loads, Readout
from bayesid.effects.flexible import MotionArrays, link_motion, own_inertia
from bayesid.effects.mount import RigidMountLoad, mount_motion
from bayesid.effects.play import Behind, Fitting, Recorded, leaning_poses
from bayesid.effects.segment import MotionSegment
from bayesid.effects.sensor_chain import SensorChain
from bayesid.effects.torque_chain import TorqueChain, coupling_matrix
from bayesid.errors import InputError
from bayesid.robot.robot import Robot
from bayesid.signals.smoothing import Splines

Family = TypeVar("Family", bound=Effect)


#: Share of the bandwidth that a flexible joint's torque is smoothed to, to be differentiated twice, unless `clear` is known.
FLEXIBLE_BANDWIDTH = 0.7


@lru_cache(maxsize=64)
def _torques_of(robot: Robot, joints: tuple[int, ...]) -> tuple[Channels, np.ndarray]:
    """Channels of the torques of some joints, and which bodies each carries, the root last (k, b + 1)."""
    channels = torque_channels(robot).only(joints)
    return channels, np.hstack([channels.bodies, np.zeros((len(channels), 1), bool)])


@dataclass(frozen=True, eq=False)
class Model:
    """A robot with effects in one motion segment; results are made when they are asked for, and kept with the segment."""

    #: What moves, what is measured, and when.
    robot: Robot
    channels: Channels
    segment: MotionSegment
    links: np.ndarray  # ten parameters a body (b, 10)
    terms: tuple[Term, ...]
    near: Model | None = None  # one that this is a small change of: what has more than one solution then follows that one's

    @classmethod
    def of(cls, robot: Robot, channels: Channels, segment: MotionSegment, links: np.ndarray, terms: Sequence[Term]) -> Model:
        """The model of links (b, 10) or (10 b,); InputError for another shape."""
        links = np.ascontiguousarray(np.asarray(links, float).reshape(-1, 10))
        if links.shape != robot.nominal.shape:
            raise InputError(f"links have shape {links.shape}; give {robot.nominal.shape}, ten parameters a body")
        return cls(robot, channels, segment, links, tuple(terms))

    def changed(self, term: Term) -> Model:
        """The model with slightly other values of one term, to be differentiated."""
        terms = tuple(term if t.effect == term.effect else t for t in self.terms)
        return Model(self.robot, self.channels, self.segment, self.links, terms, self)

    def of_family(self, family: type[Family]) -> list[tuple[Family, tuple[float, ...]]]:
        """The effects of one family with their values."""
        return cast("list[tuple[Family, tuple[float, ...]]]", [(t.effect, t.values) for t in self._by_family.get(family, ())])

    @cached_property
    def _by_family(self) -> dict[type, list[Term]]:
        """Terms by every class of their effects: fits ask a million times, and `isinstance` of an abstract class is slow."""
        out: dict[type, list[Term]] = {}
        for term in self.terms:
            for family in type(term.effect).__mro__:
                out.setdefault(family, []).append(term)
        return out

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
        for effect, values in self.of_family(families.GravityEffect):
            gravity = effect.turned(gravity, values)
        return np.asarray(gravity, float)

    @cached_property
    def bodies(self) -> np.ndarray:
        """All bodies' parameters in their joints' frames, the root's last (b + 1, 10)."""
        robot = self.robot
        out = np.vstack([self.links, robot.static_nominal])
        for body in range(robot.n, len(robot.body_names)):
            out[body] = split_matrix(robot, body) @ out[body]
        for effect, values in self.of_family(families.BodyEffect):
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
        for effect, values in self.of_family(families.EncoderEffect):
            shift[effect.joint] += effect.shift(values)
        return shift

    @cached_property
    def transmission(self) -> np.ndarray | None:
        """Map from the motors' positions to the joints', (1 + C)^-1 (n, n); None where no transmissions are coupled."""
        coupled = self.of_family(families.TransmissionEffect)
        return np.linalg.inv(coupling_matrix(self.robot, coupled)) if coupled else None

    def _at_joints(self, motors: np.ndarray) -> np.ndarray:
        """What joints do (N, n) where motors do this."""
        return motors if self.transmission is None else motors @ self.transmission.T

    @cached_property
    def joint_motion_of_motors(self) -> MotionArrays:
        """Where motors hold the joints: positions, velocities, accelerations."""
        q, v, a = (self._at_joints(x) for x in self.motor)
        return q, v, a

    @cached_property
    def _physical(self) -> tuple[Term, ...]:
        """Effects that change what there is to read, not how it is read."""
        return tuple(t for t in self.terms if families.InstrumentEffect not in type(t.effect).__mro__)

    # -- the motion

    @property
    def _pose(self) -> tuple[Term, ...]:
        """What changes where encoders are understood to say that joints are."""
        return (*self._by_family.get(families.EncoderEffect, ()), *self._by_family.get(families.TransmissionEffect, ()))

    @cached_property
    def _key(self) -> tuple:
        """What the links' motion depends on."""
        if not any(t.effect.amplifies_encoder_errors for t in self._physical):
            return (self.robot.fingerprint, self._pose)
        return (self.robot.fingerprint, self._pose, self.links.tobytes(), self._physical, self._followed)

    @property
    def _followed(self) -> tuple | None:
        """The motion that links with play follow, of more than one that there may be."""
        return None if self.near is None or not self.of_family(families.PlayEffect) else self.near._key

    @cached_property
    def states(self) -> np.ndarray:
        """Poses and rates of the links, `bayesid.dynamics.kinematics`."""
        return self.segment.results.get(("states", self._key), self._states)

    def _states(self) -> np.ndarray:
        robot, segment = self.robot, self.segment
        q, v, a = self.held_by_motors
        if self.of_family(families.PlayEffect) or self.of_family(families.FlexibleJointEffect):
            q, v, a = self.link_side(q, v, a)
        root = None
        for effect, values in self.of_family(families.MountEffect):
            key = ("mount load", self._key_without(families.MountEffect), self._followed)
            load = segment.joints.get(
                key, lambda: RigidMountLoad.of(robot, segment, (q, v, a), self.row_of, self.bodies, self.gravity, self._moment)
            )
            root = mount_motion(robot, segment, (q, v, a), load, *effect.resonance(values), self._moment)
        return link_states(robot, q, v, a, root)

    @cached_property
    def held_by_motors(self) -> MotionArrays:
        """Where motors hold the joints: positions, velocities, accelerations (N, n) each; poses at rest do not move."""
        q, v, a = self.joint_motion_of_motors
        return (q, np.zeros_like(q), np.zeros_like(q)) if self.segment.still else (q, v, a)

    def _moment(self, states: np.ndarray) -> np.ndarray:
        """Moment about the base origin that moves and holds all that a mount carries (N, 3)."""
        total = body_wrenches(states, self.row_of, self.bodies, self.gravity).sum(axis=1)
        for _, force in self._loads(states):
            total -= force
        for rotor, size in self.of_family(families.RotorEffect):
            total += rotor.inertia(size) * self._rotor(states, rotor)[1]
        return total[:, 3:]

    def link_side(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Link-side motion of joints with play or that give, from the motors'."""
        segment, poses = self.segment, self.segment.still or len(q) < 8
        if play := self.of_family(families.PlayEffect):
            motor = q, v, a
            q, v, a = (
                leaning_poses(motor, play, self.link_torque) if poses else self._recorded.leaning_motion(motor, self._behind)
            )
        compliance, felt = np.zeros(self.robot.n), np.zeros_like(q)
        for effect, values in self.of_family(families.FlexibleJointEffect):
            compliance[effect.joint] += effect.compliance(values)
        for joint in map(int, np.flatnonzero(compliance)):
            felt[:, joint] = own_inertia(self.link_torque, q, joint) if play else self._felt(joint)
        cutoff = FLEXIBLE_BANDWIDTH * segment.bandwidth if segment.clear is None else segment.clear
        if poses or not felt.any():
            return link_motion((q, v, a), self.link_torque, compliance, felt, None) if felt.any() else (q, v, a)
        splines = segment.basis.get(("splines", cutoff), lambda: Splines.over(segment.times, cutoff))
        stiff = None if play else np.stack([self._stiff(int(joint)) for joint in np.flatnonzero(compliance)], axis=1)
        return link_motion((q, v, a), self.link_torque, compliance, felt, splines, stiff)

    def _felt(self, joint: int) -> np.ndarray:
        """Inertia (N,) that a joint feels where motors hold the joints [kg m^2 or kg]."""
        key, motors = ("felt", joint, self._key_without(families.FlexibleJointEffect)), self.joint_motion_of_motors[0]
        return self.segment.joints.get(key, lambda: own_inertia(self.link_torque, motors, joint))

    def _stiff(self, joint: int) -> np.ndarray:
        """Torque (N,) that a joint takes if links are where motors hold the joints [N m or N]."""
        key, motors = ("stiff", joint, self._key_without(families.FlexibleJointEffect)), self.joint_motion_of_motors
        return self.segment.joints.get(key, lambda: self.link_torque(motors, np.array([joint]))[:, 0])

    def _key_without(self, family: type[Effect]) -> tuple:
        """What torques depend on but for the effects of a family."""
        others = tuple(t for t in self._physical if family not in type(t.effect).__mro__)
        return (self.robot.fingerprint, self._pose, self.links.tobytes(), others)

    def link_torque(self, link: MotionArrays, joints: np.ndarray) -> np.ndarray:
        """Torques (N, k) [N m or N] that a link motion takes of some joints (k,)."""
        return self.taken(*_torques_of(self.robot, tuple(map(int, joints))), link)

    def taken(self, channels: Channels, carries: np.ndarray, link: MotionArrays) -> np.ndarray:
        """True wrench and link-side torques of some channels (N, c) if links moved so, (N, n) each, on a root at rest."""
        if not (self.of_family(families.RotorEffect) or self.of_family(families.LoadEffect)):
            return readings_of_bodies(self.robot, channels, link, self.row_of, self.bodies, self.gravity, carries)
        states = link_states(self.robot, *link)
        return self._true(channels, carries, states, channel_twists(self.robot, channels, states), own=True)

    def little_play(self, joint: int, lean: Callable[[np.ndarray], np.ndarray]) -> tuple[MotionArrays, ...]:
        """How the first bit of play moves the link of a joint that has none, by the torque of the motion without it.

        ``lean`` takes the joint's torque (M,) [N m or N] to the ways in which its link leans (M, k) [rad or m]; for each way,
        the change of the joint's position, velocity and acceleration is returned, (N,) each.
        """
        if self.segment.still or len(self.segment.times) < 8:  # as poses lean
            behind = lean(self.link_torque(self.held_by_motors, np.array([joint]))[:, 0])
            return tuple((-each, 0.0 * each, 0.0 * each) for each in behind.T)
        key = ("slow torque", joint, self._key_without(families.PlayEffect))
        behind = lean(self.segment.joints.get(key, lambda: self._recorded.slow_torque(joint)))
        fitting = self._recorded.fitting
        moved = fitting.wanted.motion(fitting.whole.nearest(behind))  # smoothed as positions are
        return tuple((-moved[0][:, k], -moved[1][:, k], -moved[2][:, k]) for k in range(behind.shape[1]))

    @cached_property
    def _behind(self) -> dict[int, Behind]:
        """How far links with play are behind their motors at the encoders' samples, by joint."""
        start = {} if self.near is None else self.near._behind
        return self.segment.joints.get(
            ("behind", self._key), lambda: self._recorded.behind(self.of_family(families.PlayEffect), start)
        )

    @cached_property
    def _recorded(self) -> Recorded:
        """What encoders say of the joints at their own samples."""
        at = Model(self.robot, self.channels, self.segment.at_encoders, self.links, self.terms)
        read = at.segment.positions if at.segment.encoders is None else at.segment.encoders[1]
        times, segment = at.segment.times, self.segment
        fitting = segment.basis.get(
            ("fitting", segment.bandwidth), lambda: Fitting.of(times, read, segment.bandwidth, segment.times)
        )
        motors = at.joint_motion_of_motors

        def inertia(joint: int) -> np.ndarray:
            key = ("inertia", joint, self._key_without(families.PlayEffect))
            return segment.joints.get(key, lambda: own_inertia(at.link_torque, motors[0], joint))

        return Recorded(at._at_joints(read - self._encoder_shift), motors, at.link_torque, inertia, fitting)

    # -- the true wrench and torques

    def _loads(self, states: np.ndarray) -> Loads:
        out: Loads = []
        for effect, values in self.of_family(families.LoadEffect):
            out += effect.loads(self.robot, self.segment, states, values)
        return out

    def _rotor(self, states: np.ndarray, effect: families.RotorEffect):
        joint, turns, (_, v, a) = effect.joint or 0, float(not self.segment.still), self.motor
        return rotor_couple(self.robot, states, joint, turns * v[:, joint], turns * a[:, joint])

    def rotor_reading(self, channels: Channels, carries, states, twists, effect: families.RotorEffect) -> np.ndarray:
        """What a rotor of unit inertia adds to each channel (N, c)."""
        body, couple, own = self._rotor(states, effect)
        joint = effect.joint or 0
        # Of the root a sensor under one branch carries no more than what that branch hangs on.
        out = np.einsum("nck,nk->nc", twists, couple) * (carries[:, body] & carries[:, joint])
        if (name := f"tau{joint + 1}") in channels.names:
            rate = 0.0 if self.segment.still or effect.ratio is None else effect.ratio * self.motor[2][:, joint]
            out[:, channels.names.index(name)] += own + rate
        return out

    def _true(self, channels: Channels, carries, states, twists, own: bool = False) -> np.ndarray:
        """True wrench and link-side torques of some channels (N, c)."""
        rotors, loads = self.of_family(families.RotorEffect), self.of_family(families.LoadEffect)
        if own or not (rotors or loads or any(t.effect.amplifies_encoder_errors for t in self._physical)):
            out = self._carried(twists, states, carries)
        else:
            out = self._of_bodies.copy()
        for body, force in self._loads(states):
            out -= np.matmul(twists, force[:, :, None])[:, :, 0] * carries[:, body]
        for effect, values in rotors:
            out += effect.inertia(values) * self.rotor_reading(channels, carries, states, twists, effect)
        return out

    @cached_property
    def _of_bodies(self) -> np.ndarray:
        """True wrench and link-side torques without what acts from outside and rotors (N, c)."""
        key = ("bodies", self._key, self.channels.fingerprint, self.bodies.tobytes(), self.gravity.tobytes())

        def made() -> np.ndarray:
            return self._carried(self.twists, self.states, self.carries)

        return self.segment.results.get(key, made)

    def _carried(self, twists: np.ndarray, states: np.ndarray, carries: np.ndarray) -> np.ndarray:
        """Readings (N, c) of what the bodies' motion and weight take, of those that any channel carries (c, b + 1)."""
        some = carries.any(axis=0)
        wrenches = body_wrenches(states, self.row_of[some], self.bodies[some], self.gravity)
        return project(twists, wrenches, np.ascontiguousarray(carries[:, some]))

    @cached_property
    def twists(self) -> np.ndarray:
        """Twists of the channels about the base origin (N, c, 6)."""
        key = ("twists", self._key, self.channels.fingerprint)
        return self.segment.results.get(key, lambda: channel_twists(self.robot, self.channels, self.states))

    @cached_property
    def true(self) -> np.ndarray:
        """True wrench and link-side torques (N, c)."""
        key = ("true", self._key, self.channels.fingerprint, self.links.tobytes(), self._physical)
        return self.segment.results.get(key, lambda: self._true(self.channels, self.carries, self.states, self.twists))

    # -- the instruments

    def chain(self, *, without: Effect | None = None) -> SensorChain:
        """The sensor, with all its effects or all but one."""
        chain = SensorChain.of(self.robot, self.channels, self.wrench)
        for effect, values in self.of_family(families.SensorEffect):
            if effect != without:
                chain = effect.applied(chain, values)
        return chain

    @cached_property
    def torque_chain(self) -> TorqueChain:
        """What is read of the torques that joints take."""
        late: dict[int | None, float] = {}
        for effect, values in self.of_family(families.JointDelayEffect):
            for joint in self.joints if effect.joint is None else {effect.joint} & self.joints.keys():
                late[joint] = late.get(joint, 0.0) + effect.delay(values)
        gain = np.ones(len(self.channels))
        for effect, values in self.of_family(families.JointGainEffect):
            if effect.joint in self.joints:
                gain[self.joints[effect.joint]] += effect.gain(values)
        return TorqueChain(self.joints, self.transmission, late, gain)

    @cached_property
    def readout(self) -> Readout:
        """What the instruments are given to read."""
        return Readout(self.channels.names, self.segment, *self.motor, self.torque_chain.at_motors(self.true))

    @cached_property
    def given(self) -> np.ndarray:
        """True wrench, and what motors give for the joints' torques at the times that these are read for (N, c)."""
        return self.torque_chain.late(self.segment, self.readout.true)

    def joint_motion(self, effect: families.JointTorqueEffect) -> JointMotion:
        """What happens at the joint of an effect when its torque is read."""
        joint, chain, pose = effect.joint, self.torque_chain, tuple(self._by_family.get(families.EncoderEffect, ()))
        assert joint is not None

        def made(load: np.ndarray | None = None) -> JointMotion:
            return chain.at_joint(self.segment, chain.late_motion(self.segment, self.motor, pose), joint, load)

        if effect.uses_load:
            return made(self.given[:, self.joints[joint]])
        return self.segment.joints.get(("motion", joint, tuple(chain.delays.items()), pose), made)

    @cached_property
    def ungained(self) -> np.ndarray:
        """What the instruments read (N, c) but for the torques' gain."""
        out = np.array(self.given)
        if len(self.wrench):
            out[:, self.wrench] = self.chain().reading(self.segment, self.true[:, self.wrench])
        for effect, values in self.of_family(families.JointTorqueEffect):
            if effect.joint in self.joints:
                out[:, self.joints[effect.joint]] += effect.torque(self.joint_motion(effect), values)
        for effect, values in self.of_family(families.ReadingEffect):
            out += self.torque_chain.late(self.segment, effect.added(self.readout, values))
        return out

    @cached_property
    def readings(self) -> np.ndarray:
        """What the instruments read (N, c)."""
        return self.ungained * self.torque_chain.gain
