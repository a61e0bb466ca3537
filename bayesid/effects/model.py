"""What instruments read of a robot with effects, exactly.

In this order:

1. the joints: true position = encoder - offset; a flexible joint's link is at that less compliance x torque;
2. the mount: a compliant base turns under the robot (`bayesid.effects.mount`);
3. the bodies: links, payload and inertia errors under a gravity turned by the base's tilt; what pulls or pushes
   them from outside; rotors. A channel with twist S reads ``S . sum (w_i - f_i)`` over the bodies that it carries,
   w_i what body i's motion and weight take and f_i what acts on it from outside;
4. inside the joints: friction, springs, rotors, then the torque's gain;
5. the sensor: pose, delay, gains and cross-talk, offset and drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import Channels, torque_channels
from bayesid.dynamics.kinematics import body_wrenches, channel_twists, is_wrench, link_states, project, transform_matrix
from bayesid.effects.effect import Scene, Term
from bayesid.effects.flexible import link_motion, splines
from bayesid.effects.forces import LOADS, Loads, body_of, rotor_couple
from bayesid.effects.mount import mount_motion
from bayesid.effects.sensor import DRIVE, SENSOR, SensorChain, inside_joint, sensor_chain
from bayesid.errors import InputError
from bayesid.robot.robot import Robot

#: Effects that differentiate a load again; encoders' errors pass through them much enlarged.
SOFT = ("joint_flexibility", "base_compliance")
#: Effects that are bodies or parts of bodies.
BODIES = ("payload", "inertia_error")
#: A joint's torque is differentiated twice where the joint gives: smoothed to this share of the bandwidth, unless its scene says
#: up to where it is clear.
SOFT_BANDWIDTH = 0.7
_KEPT = 6  # results kept with a scene


@dataclass(frozen=True, eq=False)
class Model:
    """A robot with effects in one scene; results are made when they are asked for, and kept.

    Attributes
    ----------
    robot, channels, scene
        What moves, what is measured, and when.
    links
        Ten parameters a body (b, 10).
    terms
        The effects.
    """

    robot: Robot
    channels: Channels
    scene: Scene
    links: np.ndarray
    terms: tuple[Term, ...]

    @classmethod
    def of(cls, robot: Robot, channels: Channels, scene: Scene, links: np.ndarray, terms: Sequence[Term]) -> Model:
        """The model of links (b, 10) or (10 b,); InputError for another shape."""
        links = np.ascontiguousarray(np.asarray(links, float).reshape(-1, 10))
        if links.shape != robot.nominal.shape:
            raise InputError(f"links have shape {links.shape}; give {robot.nominal.shape}, ten parameters a body")
        return cls(robot, channels, scene, links, tuple(terms))

    def replaced(self, term: Term) -> Model:
        """The model with other values of one term."""
        terms = tuple(term if t.effect == term.effect else t for t in self.terms)
        return Model(self.robot, self.channels, self.scene, self.links, terms)

    # -- what the model consists of

    def named(self, *names: str) -> list[Term]:
        """The terms with one of these names."""
        return [t for t in self.terms if t.effect.name in names]

    @cached_property
    def wrench(self) -> np.ndarray:
        """Indices of the sensor's channels."""
        return np.flatnonzero(is_wrench(self.channels))

    @cached_property
    def joints(self) -> dict[int, int]:
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
        return tilted(self.robot, self.named("base_tilt"))

    @cached_property
    def bodies(self) -> np.ndarray:
        """All bodies' parameters in their joints' frames, the root's last (b + 1, 10)."""
        robot = self.robot
        out = np.vstack([self.links, robot.static_nominal])
        for body in range(robot.n, len(robot.body_names)):
            out[body] = split_matrix(robot, body) @ out[body]
        for term in self.named(*BODIES):
            out[body_of(robot, term.effect.joint)] += term.values
        return out

    # -- the motion

    @cached_property
    def motor(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True joint positions on the motors' side, velocities, accelerations."""
        scene = self.scene
        shift = np.zeros(self.robot.n)
        for term in self.named("encoder_offset"):
            shift[term.effect.joint] += term.values[0]
        return scene.positions - shift, scene.velocities, scene.accelerations

    @cached_property
    def _key(self) -> tuple:
        """What the links' motion depends on."""
        pose = tuple(sorted((t.effect.joint, t.values) for t in self.named("encoder_offset")))
        if not self.named(*SOFT):
            return (id(self.robot), pose)
        physical = tuple((t.effect, t.values) for t in self.terms if t.effect.name not in (*SENSOR, *DRIVE))
        return (id(self.robot), pose, self.links.tobytes(), physical)

    @cached_property
    def states(self) -> np.ndarray:
        """Poses and rates of the links, `bayesid.dynamics.kinematics`."""
        return self._keep(("states", self._key), self._states)[1]

    def _keep(self, key, make):
        """From the scene's cache; robot and channels are held so that their identity stays theirs."""
        cache = self.scene.cache.setdefault("kept", {})
        if key not in cache:
            while len(cache) >= _KEPT:
                cache.pop(next(iter(cache)), None)
            cache[key] = ((self.robot, self.channels), make())
        return cache[key]

    def _states(self) -> np.ndarray:
        robot, scene = self.robot, self.scene
        q, v, a = self.motor
        if scene.still:
            v = a = np.zeros_like(q)
        soft = self.named("joint_flexibility")
        if soft:
            q, v, a = self._flexed(q, v, a, soft)
        root = None
        for term in self.named("base_compliance"):

            def moment(states):
                wrench = body_wrenches(states, self.row_of, self.bodies, self.gravity)
                total = wrench.sum(axis=1)
                for _, force in self._loads(states):
                    total -= force
                for rotor in self.named("rotor_momentum"):
                    total += rotor.values[0] * self._rotor(states, rotor)[1]
                return total[:, 3:]

            root = mount_motion(
                robot, scene, (q, v, a), self.row_of, self.bodies, self.gravity, term.values[0], term.values[1], moment
            )
        return link_states(robot, q, v, a, root)

    def _flexed(self, q, v, a, soft: list[Term]):
        """Link-side motion of flexible joints."""
        robot, scene = self.robot, self.scene
        channels = torque_channels(robot)
        carries = np.hstack([channels.bodies, np.zeros((robot.n, 1), bool)])
        compliance = np.zeros(robot.n)
        for term in soft:
            compliance[term.effect.joint] += term.values[0]

        def torque(link):
            states = link_states(robot, *link)
            return self._true(channels, carries, states, channel_twists(robot, channels, states), own=True)

        def inertia(joint: int) -> np.ndarray:
            if not compliance[joint]:
                return np.zeros(len(q))
            states = link_states(robot, q, np.zeros_like(q), np.broadcast_to(np.eye(robot.n)[joint], q.shape))
            wrench = body_wrenches(states, self.row_of, self.bodies, np.zeros(3))
            return project(channel_twists(robot, channels, states), wrench, carries)[:, joint]

        if not compliance.any():
            return q, v, a
        if scene.still or len(q) < 8:
            return link_motion((q, v, a), torque, compliance, np.zeros_like(q), None)
        felt = np.stack([inertia(j) for j in range(robot.n)], axis=1)
        cutoff = SOFT_BANDWIDTH * scene.bandwidth if scene.clear is None else scene.clear
        if "splines" not in scene.cache:
            scene.cache["splines"] = splines(scene.times, cutoff)
        return link_motion((q, v, a), torque, compliance, felt, scene.cache["splines"])

    # -- the true wrench and torques

    def _loads(self, states: np.ndarray) -> Loads:
        out: Loads = []
        for term in self.named(*LOADS):
            out += LOADS[term.effect.name](self.robot, self.scene, states, term)
        return out

    def _rotor(self, states: np.ndarray, term: Term):
        assert term.effect.joint is not None
        q, v, a = self.motor
        joint = term.effect.joint
        if self.scene.still:
            return rotor_couple(self.robot, states, joint, np.zeros(len(q)), np.zeros(len(q)))
        return rotor_couple(self.robot, states, joint, v[:, joint], a[:, joint])

    def rotor_reading(self, channels: Channels, carries, states, twists, term: Term) -> np.ndarray:
        """What a rotor of unit inertia adds to each channel (N, c)."""
        body, couple, own = self._rotor(states, term)
        out = np.einsum("nck,nk->nc", twists, couple) * carries[:, body]
        joint = term.effect.joint
        name = f"tau{(-1 if joint is None else joint) + 1}"
        if name in channels.names and joint is not None:
            ratio = term.effect.ratio
            rate = 0.0 if self.scene.still or ratio is None else ratio * self.motor[2][:, joint]
            out[:, channels.names.index(name)] += own + rate
        return out

    def _true(self, channels: Channels, carries, states, twists, own: bool = False) -> np.ndarray:
        """True wrench and link-side torques of some channels (N, c)."""
        if own or not self.named(*SOFT, *LOADS, "rotor_momentum"):
            wrench = body_wrenches(states, self.row_of, self.bodies, self.gravity)
        else:
            wrench = self._wrenches.copy()
        for body, force in self._loads(states):
            wrench[:, body] -= force
        out = project(twists, wrench, carries)
        for term in self.named("rotor_momentum"):
            out += term.values[0] * self.rotor_reading(channels, carries, states, twists, term)
        return out

    @cached_property
    def _wrenches(self) -> np.ndarray:
        key = ("wrenches", self._key, self.bodies.tobytes(), self.gravity.tobytes())
        return self._keep(key, lambda: body_wrenches(self.states, self.row_of, self.bodies, self.gravity))[1]

    @cached_property
    def twists(self) -> np.ndarray:
        """Twists of the channels about the base origin (N, c, 6)."""
        key = ("twists", self._key, id(self.channels))
        return self._keep(key, lambda: channel_twists(self.robot, self.channels, self.states))[1]

    @cached_property
    def true(self) -> np.ndarray:
        """True wrench and link-side torques (N, c)."""
        physical = tuple((t.effect, t.values) for t in self.terms if t.effect.name not in (*SENSOR, *DRIVE))
        key = ("true", self._key, id(self.channels), self.links.tobytes(), physical)
        return self._keep(key, lambda: self._true(self.channels, self.carries, self.states, self.twists))[1]

    # -- the instruments

    @cached_property
    def chain(self) -> SensorChain:
        """The sensor's own effects."""
        return sensor_chain(self.robot, self.channels, self.wrench, self.named(*SENSOR))

    @cached_property
    def torque_gain(self) -> np.ndarray:
        """1 + gain of each channel (c,)."""
        gain = np.ones(len(self.channels))
        for term in self.named("torque_gain"):
            if term.effect.joint in self.joints:
                gain[self.joints[term.effect.joint]] += term.values[0]
        return gain

    @cached_property
    def readings(self) -> np.ndarray:
        """What the instruments read (N, c)."""
        out = self.true.copy()
        if len(self.wrench):
            out[:, self.wrench] = self.chain.reading(self.scene, self.true[:, self.wrench])
        return self._with_drives(out)

    def _with_drives(self, out: np.ndarray) -> np.ndarray:
        for term in self.named(*DRIVE):
            if term.effect.joint in self.joints:
                k = self.joints[term.effect.joint]
                out[:, k] += inside_joint(self.scene, self.motor, self.true[:, k], term)
        return out * self.torque_gain


def tilted(robot: Robot, terms: Sequence[Term]) -> np.ndarray:
    """Gravity in the base frame (3,), turned by one tilt after the other."""
    gravity = robot.gravity
    for term in terms:
        gravity = Rotation.from_euler("xy", term.values).as_matrix() @ gravity
    return np.asarray(gravity, float)


def split_matrix(robot: Robot, body: int) -> np.ndarray:
    """From a split body's parameters to those in its joint's frame (10, 10)."""
    return transform_matrix(robot.body_rotation[body], robot.body_translation[body])
