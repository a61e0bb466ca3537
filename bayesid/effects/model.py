"""What instruments read of a robot with effects: exact readings and their derivatives.

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

from bayesid.effects.effect import Effect, Scene, Term, sense
from bayesid.effects.flexible import link_motion, splines
from bayesid.effects.forces import LOADS, Loads, body_of, rotor_couple
from bayesid.effects.kinematics import (
    P,
    R,
    body_wrenches,
    channel_twists,
    is_wrench,
    link_columns,
    link_states,
    project,
    transform_matrix,
)  # fmt: skip
from bayesid.effects.mount import mount_motion
from bayesid.effects.sensor import DRIVE, SENSOR, SensorChain, delayed, inside_joint, sensor_chain
from bayesid.errors import InputError
from bayesid.momentum import Channels, torque_channels
from bayesid.robot import Robot

#: Effects that differentiate a load again; encoders' errors pass through them much enlarged.
SOFT = ("joint_flexibility", "base_compliance")
_BODIES = ("payload", "inertia_error")
#: A joint's torque is differentiated twice where the joint gives: smoothed to this share of the bandwidth, unless its scene says
#: up to where it is clear.
SOFT_BANDWIDTH = 0.7
_KEPT = 6  # results kept with a scene

#: Steps of central differences, by parameter; relative to the value where that is larger.
_STEPS = {
    "delay": 1e-4, "angle": 1e-4, "compliance": 1e-6, "resonance": 0.01, "damping": 1e-3, "rest_length": 1e-4, "start": 1e-3,
    "end": 1e-3, "velocity": 1e-3, "periods": 1e-3, "phase": 1e-3,
}  # fmt: skip
_STEP = 1e-4


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

    # -- what the model consists of

    def _of(self, *names: str) -> list[Term]:
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
        return _tilted(self.robot, self._of("base_tilt"))

    @cached_property
    def bodies(self) -> np.ndarray:
        """All bodies' parameters in their joints' frames, the root's last (b + 1, 10)."""
        robot = self.robot
        out = np.vstack([self.links, robot.static_nominal])
        for body in range(robot.n, len(robot.body_names)):
            out[body] = _split(robot, body) @ out[body]
        for term in self._of(*_BODIES):
            out[body_of(robot, term.effect.joint)] += term.values
        return out

    # -- the motion

    @cached_property
    def motor(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True joint positions on the motors' side, velocities, accelerations."""
        scene = self.scene
        shift = np.zeros(self.robot.n)
        for term in self._of("encoder_offset"):
            shift[term.effect.joint] += term.values[0]
        return scene.positions - shift, scene.velocities, scene.accelerations

    @cached_property
    def _key(self) -> tuple:
        """What the links' motion depends on."""
        pose = tuple(sorted((t.effect.joint, t.values) for t in self._of("encoder_offset")))
        if not self._of(*SOFT):
            return (id(self.robot), pose)
        physical = tuple((t.effect, t.values) for t in self.terms if t.effect.name not in (*SENSOR, *DRIVE))
        return (id(self.robot), pose, self.links.tobytes(), physical)

    @cached_property
    def states(self) -> np.ndarray:
        """Poses and rates of the links, `bayesid.effects.kinematics`."""
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
        soft = self._of("joint_flexibility")
        if soft:
            q, v, a = self._flexed(q, v, a, soft)
        root = None
        for term in self._of("base_compliance"):

            def moment(states):
                wrench = body_wrenches(states, self.row_of, self.bodies, self.gravity)
                total = wrench.sum(axis=1)
                for _, force in self._loads(states):
                    total -= force
                for rotor in self._of("rotor_momentum"):
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
        for term in self._of(*LOADS):
            out += LOADS[term.effect.name](self.robot, self.scene, states, term)
        return out

    def _rotor(self, states: np.ndarray, term: Term):
        assert term.effect.joint is not None
        q, v, a = self.motor
        joint = term.effect.joint
        if self.scene.still:
            return rotor_couple(self.robot, states, joint, np.zeros(len(q)), np.zeros(len(q)))
        return rotor_couple(self.robot, states, joint, v[:, joint], a[:, joint])

    def _rotor_reading(self, channels: Channels, carries, states, twists, term: Term) -> np.ndarray:
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
        if own or not self._of(*SOFT, *LOADS, "rotor_momentum"):
            wrench = body_wrenches(states, self.row_of, self.bodies, self.gravity)
        else:
            wrench = self._wrenches.copy()
        for body, force in self._loads(states):
            wrench[:, body] -= force
        out = project(twists, wrench, carries)
        for term in self._of("rotor_momentum"):
            out += term.values[0] * self._rotor_reading(channels, carries, states, twists, term)
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
        return sensor_chain(self.robot, self.channels, self.wrench, self._of(*SENSOR))

    @cached_property
    def torque_gain(self) -> np.ndarray:
        """1 + gain of each channel (c,)."""
        gain = np.ones(len(self.channels))
        for term in self._of("torque_gain"):
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
        for term in self._of(*DRIVE):
            if term.effect.joint in self.joints:
                k = self.joints[term.effect.joint]
                out[:, k] += inside_joint(self.scene, self.motor, self.true[:, k], term)
        return out * self.torque_gain

    def tangent(self, change: np.ndarray) -> np.ndarray:
        """Change of the readings with a change of the true wrench and torques, (N, c, k)."""
        if not self._of(*SENSOR, "load_friction", "torque_gain"):
            return change
        out = np.array(change)
        if len(self.wrench) and self._of(*SENSOR):
            out[:, self.wrench] = self.chain.linear(self.scene, change[:, self.wrench])
        for term in self._of("load_friction"):
            if term.effect.joint in self.joints:
                k = self.joints[term.effect.joint]
                share = term.values[0] * np.sign(self.true[:, k]) * sense(self.scene.velocities[:, term.effect.joint])
                out[:, k] += share[:, None] * change[:, k]
        return out * self.torque_gain[:, None] if self._of("torque_gain") else out

    def rigid_columns(self) -> np.ndarray:
        """Derivative of the readings with respect to the links' parameters at the links' motion, (N, c, 10 b)."""
        robot, b = self.robot, len(self.robot.body_names)
        out = link_columns(self.states, self.twists, self.row_of[:b], self.carries[:, :b], self.gravity)
        for body in range(robot.n, b):
            part = slice(10 * body, 10 * body + 10)
            out[:, :, part] = out[:, :, part] @ _split(robot, body)
        return self.tangent(out)

    # -- derivatives with respect to an effect's parameters

    def columns(self, effect: Effect) -> np.ndarray:
        """Derivative of the readings with respect to the parameters of one of the terms, (N, c, k)."""
        here = [t for t in self.terms if t.effect == effect]
        name, scene = effect.name, self.scene
        count, channels = len(effect.kind.parameters), len(self.channels)
        out = np.zeros((len(scene.times), channels, count))
        if not any(effect.kind.acts_on(c) for c in self.channels.names):
            return out
        term = here[0]
        if name in SENSOR:
            out[:, self.wrench] = self._sensor_columns(term)
            return out
        if name in DRIVE:
            if effect.joint in self.joints:
                out[:, self.joints[effect.joint]] = self._drive_columns(term)
            return out
        if name in _BODIES:
            body = body_of(self.robot, effect.joint)
            carried = self.carries[:, body : body + 1]
            return self.tangent(link_columns(self.states, self.twists, self.row_of[body : body + 1], carried, self.gravity))
        if name == "rotor_momentum":
            return self.tangent(self._rotor_reading(self.channels, self.carries, self.states, self.twists, term)[:, :, None])
        if name in LOADS:
            return self.tangent(self._difference(term, self._load_reading))
        if name == "base_tilt" and not self._of(*SOFT):
            return self.tangent(self._difference(term, self._tilt_reading))
        return self._difference(term, lambda t: self._with(t).readings)

    def _with(self, term: Term) -> Model:
        """The model with other values of one term."""
        terms = tuple(term if t.effect == term.effect else t for t in self.terms)
        return Model(self.robot, self.channels, self.scene, self.links, terms)

    def _difference(self, term: Term, reading) -> np.ndarray:
        """Central differences with respect to the parameters of a term."""
        out = []
        for k, key in enumerate(term.effect.kind.parameters):
            step = max(_STEPS.get(key, _STEP), 1e-4 * abs(term.values[k]))
            ends = []
            for sign in (1.0, -1.0):
                values = list(term.values)
                values[k] += sign * step
                ends.append(reading(Term(term.effect, tuple(values))))
            out.append((ends[0] - ends[1]) / (2.0 * step))
        return np.stack(out, axis=-1)

    def _load_reading(self, term: Term) -> np.ndarray:
        out = np.zeros((len(self.scene.times), len(self.channels)))
        for body, force in LOADS[term.effect.name](self.robot, self.scene, self.states, term):
            out -= np.einsum("nck,nk->nc", self.twists, force) * self.carries[:, body]
        return out

    def _tilt_reading(self, term: Term) -> np.ndarray:
        """Weight of all bodies under the tilted gravity."""
        others = [t for t in self._of("base_tilt") if t.effect != term.effect]
        gravity = _tilted(self.robot, [*others, term])
        x = self.states[:, self.row_of]
        rotation = x[:, :, R : R + 9].reshape(*x.shape[:2], 3, 3)
        mass = self.bodies[:, 0]
        first = mass[:, None] * x[:, :, P : P + 3] + np.einsum("nbij,bj->nbi", rotation, self.bodies[:, 1:4])
        force = np.broadcast_to(-mass[:, None] * gravity, first.shape)
        return project(self.twists, np.concatenate([force, -np.cross(first, gravity)], axis=2), self.carries)

    def _sensor_columns(self, term: Term) -> np.ndarray:
        scene, chain, true = self.scene, self.chain, self.true[:, self.wrench]
        name, axes = term.effect.name, term.effect.axes
        if name in ("sensor_offset", "sensor_drift"):
            size = np.ones(len(scene.times)) if name == "sensor_offset" else scene.times
            return size[:, None, None] * np.eye(6)
        if name in ("sensor_gain", "sensor_crosstalk"):
            out = np.zeros((len(scene.times), 6, 1))
            out[:, axes[-1], 0] = chain.sensed(scene, true[:, :, None])[:, axes[0], 0]
            return out
        terms = [t for t in self._of(*SENSOR) if t.effect != term.effect]
        if name == "sensor_translation":
            # Linear, but its slope is wanted at the turned and delayed axes: one step of it, from zero.
            zero = sensor_chain(self.robot, self.channels, self.wrench, [*terms, Term(term.effect, (0.0,) * 3)])
            parts = []
            for unit in np.eye(3):
                shifted = sensor_chain(self.robot, self.channels, self.wrench, [*terms, Term(term.effect, tuple(unit))])
                moved = np.einsum("ij,nj->ni", shifted.pose - zero.pose, true)
                moved = moved if zero.delay == 0.0 or scene.still else delayed(scene.times, moved, zero.delay)
                parts.append(moved @ zero.mix.T)
            return np.stack(parts, axis=-1)
        if name == "sensor_delay" and scene.still:
            return np.zeros((len(scene.times), 6, 1))

        def reading(changed: Term) -> np.ndarray:
            chain = sensor_chain(self.robot, self.channels, self.wrench, [*terms, changed])
            return chain.linear(scene, true[:, :, None])[:, :, 0]

        return self._difference(term, reading)

    def _drive_columns(self, term: Term) -> np.ndarray:
        joint = term.effect.joint
        assert joint is not None
        k = self.joints[joint]
        true = self.true[:, k]
        if term.effect.name == "torque_gain":
            inside = [inside_joint(self.scene, self.motor, true, t) for t in self._of(*DRIVE) if t.effect.joint == joint]
            return (true + sum(inside))[:, None]
        change = self._difference(term, lambda t: inside_joint(self.scene, self.motor, true, t))
        return change * self.torque_gain[k]


def _tilted(robot: Robot, terms: Sequence[Term]) -> np.ndarray:
    gravity = robot.gravity
    for term in terms:
        gravity = Rotation.from_euler("xy", term.values).as_matrix() @ gravity
    return np.asarray(gravity, float)


def _split(robot: Robot, body: int) -> np.ndarray:
    """From a split body's parameters to those in its joint's frame (10, 10)."""
    return transform_matrix(robot.body_rotation[body], robot.body_translation[body])


def _model(robot: Robot, channels: Channels, scene: Scene, links: np.ndarray, terms: Sequence[Term]) -> Model:
    links = np.ascontiguousarray(np.asarray(links, float).reshape(-1, 10))
    if links.shape != robot.nominal.shape:
        raise InputError(f"links have shape {links.shape}; give {robot.nominal.shape}, ten parameters a body")
    return Model(robot, channels, scene, links, tuple(terms))


def _at_rest(terms: Sequence[Term]) -> tuple[Term, ...]:
    """The effects that a static run of the same positions has too; a sensor drifts on between the two."""
    return tuple(t for t in terms if t.effect.name not in ("sensor_drift", "external_contact"))


def readings(
    robot: Robot, channels: Channels, scene: Scene, links: np.ndarray, terms: Sequence[Term] = (), *, gravity: bool = True
) -> np.ndarray:
    """What the channels read, everything included: a base sensor's load of the root link, too.

    Parameters
    ----------
    robot, channels
        What moves and what is measured.
    scene
        How it moves.
    links
        Ten parameters a body (b, 10) or (10 b,).
    terms
        The effects with their values.
    gravity
        False: less what the same positions read at rest (equation 21 of [Liu1998]_), free of offset and weight.

    Returns
    -------
    readings
        (N, c) [N, N m].

    Raises
    ------
    InputError
        Links of the wrong shape.
    """
    moving = _model(robot, channels, scene, links, terms).readings
    if gravity:
        return moving
    return moving - _model(robot, channels, scene.at_rest, links, _at_rest(terms)).readings


def rigid_columns(
    robot: Robot, channels: Channels, scene: Scene, links: np.ndarray, terms: Sequence[Term] = (), *, gravity: bool = True
) -> np.ndarray:
    """Derivative of `readings` with respect to the links' parameters, (N, c, 10 b).

    The links' motion is held: how a flexible joint or mount gives way to a change of the links is not part of it.

    Parameters and errors are those of `readings`.
    """
    moving = _model(robot, channels, scene, links, terms).rigid_columns()
    if gravity:
        return moving
    return moving - _model(robot, channels, scene.at_rest, links, _at_rest(terms)).rigid_columns()


def columns(
    robot: Robot,
    channels: Channels,
    scene: Scene,
    links: np.ndarray,
    terms: Sequence[Term],
    effect: Effect,
    values: Sequence[float] | None = None,
    *,
    gravity: bool = True,
) -> np.ndarray:
    """Derivative of `readings` with respect to an effect's parameters, (N, c, k).

    Parameters
    ----------
    robot, channels, scene, links, terms, gravity
        As in `readings`.
    effect
        One of the terms' or another.
    values
        Where to take the derivative; default the term's own values, or the catalogue's for an effect that is no
        term yet.
    """
    own = next((t.values for t in terms if t.effect == effect), effect.kind.starts)
    here = Term(effect, tuple(own if values is None else values))
    full = (*(t for t in terms if t.effect != effect), here)
    moving = _model(robot, channels, scene, links, full).columns(effect)
    if gravity:
        return moving
    rest = _at_rest(full)
    if here not in rest:
        return moving
    return moving - _model(robot, channels, scene.at_rest, links, rest).columns(effect)
