"""What a sensor and a drive read when hidden effects act: the plant behind the blind set.

`respond` takes the motion of the links as it is and gives every reading without noise. The effects' names, parameters
and signs are those of the experiment format; the equations are written here anew.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from arms import GRAVITY, Arm, Frames, frames, inverse_dynamics, rocked, rods
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
LINK = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
RAMP = 0.2  # a contact's force comes and goes within [s]
PRESLIDING = 2e-5  # a joint's friction has turned over after [rad]
CREEP = 0.15, 1e-3  # a standing joint's friction fades with [s], below [rad/s]: at rest it is whatever is left
UNLISTED = ("quadratic_friction", "cubic_moment", "saturation", "hysteresis", "thermal", "vibration")


@dataclass(frozen=True)
class Effect:
    """A hidden effect: its name, its place and its parameters' values."""

    name: str
    where: str
    values: dict[str, float]

    @property
    def joint(self) -> int:
        """0-based joint of a place ``jointK``."""
        return int(self.where.removeprefix("joint")) - 1

    def vector(self, *keys: str) -> np.ndarray:
        """Values by key, 0 where absent."""
        return np.array([self.values.get(key, 0.0) for key in keys])


@dataclass(frozen=True, eq=False)
class Motion:
    """How the links move: times (N,), positions, velocities, accelerations (N, n), and what the sampling needs.

    Attributes
    ----------
    first, every, count
        Row of the first sample, rows a sample, number of samples.
    contact
        Whether an outside contact may happen in this motion.
    home
        Pose whose tilting inertia a mount's resonance is stated for; absent: the motion's middle row.
    """

    name: str
    role: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    first: int = 0
    every: int = 1
    count: int = 0
    contact: bool = True
    home: np.ndarray | None = None

    def sampled(self, every: int = 1) -> Motion:
        """The same motion at the sampling instants only, or at one of so many."""
        rows = slice(self.first, self.first + self.count * self.every, self.every * every)
        t = self.t[rows]
        return replace(self, t=t, q=self.q[rows], v=self.v[rows], a=self.a[rows], first=0, every=1, count=len(t))

    def still(self) -> Motion:
        """The same poses at rest, row by row."""
        return replace(self, v=0 * self.v, a=0 * self.a)


@dataclass(frozen=True, eq=False)
class Sensor:
    """Stated pose of the sensor frame in the base frame."""

    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rpy: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def read(self, wrench: np.ndarray) -> np.ndarray:
        """Wrench about the base origin in base axes -> about the sensor origin in sensor axes, (N, 6)."""
        turn = Rotation.from_euler("xyz", self.rpy).as_matrix()
        moment = wrench[:, 3:] - np.cross(self.translation, wrench[:, :3])
        return np.hstack([wrench[:, :3] @ turn, moment @ turn])


@dataclass(frozen=True, eq=False)
class Response:
    """Readings without noise: wrench (N, 6), motor torques (N, n), and encoder minus link position (N, n)."""

    wrench: np.ndarray
    torques: np.ndarray
    shift: np.ndarray


def respond(
    arm: Arm,
    sensor: Sensor,
    motion: Motion,
    effects: tuple[Effect, ...] = (),
    rigid: tuple[np.ndarray, np.ndarray] | None = None,
    still: bool = False,
) -> Response:
    """What is read along a motion.

    Parameters
    ----------
    arm, sensor
        The true robot without the hidden effects, and the stated sensor pose.
    motion
        Motion of the links.
    effects
        What acts on top.
    rigid
        Base wrench and torques of the arm along the motion, where they are known already.
    still
        The rows are separate poses at rest: nothing that needs time acts.
    """
    wrench, torques = _rigid(arm, motion, effects, rigid)
    wrench, torques = wrench.copy(), torques.copy()
    where: Frames | None = None
    for effect in effects:
        if effect.name in ("tether", "fluid_drag", "external_contact", "rotor_momentum"):
            where = where or frames(arm, motion.q, motion.v)
            if effect.name == "rotor_momentum":
                _rotor(arm, motion, where, effect, wrench, torques)
            elif not (still and effect.name != "tether"):
                _push(arm, motion, where, effect, wrench, torques)
    load = torques.copy()
    for effect in effects:
        torques = torques + _drive(motion, effect, load)
    for effect in effects:
        if effect.name == "torque_gain":
            torques[:, effect.joint] *= 1 + effect.values["gain"]
        elif effect.name == "torque_offset":
            torques[:, effect.joint] += effect.values["offset"]
        elif effect.name == "torque_ripple":
            amplitude, periods, phase = effect.vector("amplitude", "periods", "phase")
            torques[:, effect.joint] += amplitude * np.sin(periods * motion.q[:, effect.joint] + phase)
    for effect in effects:
        if effect.name == "torque_delay" and not still:
            late = np.maximum(motion.t - effect.values["delay"], motion.t[0])
            torques = CubicSpline(motion.t, torques)(late)
    shift = np.zeros_like(motion.q)
    for effect in effects:
        if effect.name == "encoder_offset":
            shift[:, effect.joint] += effect.values["angle"]
        elif effect.name == "joint_flexibility":
            shift[:, effect.joint] += effect.values["compliance"] * load[:, effect.joint]
        elif effect.name == "backlash":
            gap, firm = effect.vector("gap", "firm")
            shift[:, effect.joint] += gap / 2 * np.tanh(load[:, effect.joint] / firm)
    return Response(_sense(sensor, motion, effects, wrench, still), torques, shift)


def _rigid(
    arm: Arm, motion: Motion, effects: tuple[Effect, ...], known: tuple[np.ndarray, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray]:
    changes: dict[int, np.ndarray] = {}
    gravity, mount = GRAVITY, None
    for effect in effects:
        if effect.name in ("payload", "inertia_error"):
            changes[effect.joint] = changes.get(effect.joint, 0.0) + effect.vector(*LINK)
        elif effect.name == "base_tilt":
            x, y = effect.vector("x", "y")
            # rotations about base x, then y: both about fixed axes
            gravity = (Rotation.from_rotvec([0, y, 0]) * Rotation.from_rotvec([x, 0, 0])).apply(GRAVITY)
        elif effect.name == "base_compliance":
            mount = effect
    if not changes and gravity is GRAVITY and mount is None and known is not None:
        return known
    model = arm.changed(changes, gravity) if changes or gravity is not GRAVITY else arm
    if mount is None:
        return inverse_dynamics(model, motion.q, motion.v, motion.a)
    home = motion.q[len(motion.q) // 2] if motion.home is None else motion.home
    wrench, torques, _ = rocked(model, motion.t, motion.q, motion.v, motion.a, home, *mount.vector("resonance", "damping"))
    return wrench, torques


def contact_shape(t: np.ndarray, start: float, end: float) -> np.ndarray:
    """Share of a contact's force at a time: 1 within [start, end], ramps inside it."""
    return np.clip(np.minimum(t - start, end - t) / RAMP, 0.0, 1.0)


def _push(arm: Arm, motion: Motion, where: Frames, effect: Effect, wrench: np.ndarray, torques: np.ndarray) -> None:
    """Add forces of the surroundings on links: the ground and the joints hold against them."""
    if effect.name == "fluid_drag":
        linear, quadratic = effect.vector("linear", "quadratic")
        nodes, weights = np.polynomial.legendre.leggauss(5)
        for joint, start, end in rods(arm):
            length = np.linalg.norm(end - start)
            if length < 1e-9:
                continue
            for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
                arm_of = np.einsum("kab,b->ka", where.rotation[:, joint], start + node * (end - start))
                velocity = where.velocity[:, joint] + np.cross(where.omega[:, joint], arm_of)
                speed = np.linalg.norm(velocity, axis=1)[:, None]
                force = -(linear + quadratic * speed) * velocity * length * weight
                _hold(joint, where.origin[:, joint] + arm_of, force, where, wrench, torques)
        return
    point = np.einsum("kab,b->ka", where.rotation[:, effect.joint], effect.vector("point_x", "point_y", "point_z"))
    point += where.origin[:, effect.joint]
    if effect.name == "tether":
        pull = effect.vector("anchor_x", "anchor_y", "anchor_z") - point
        length = np.linalg.norm(pull, axis=1)[:, None]
        force = effect.values["stiffness"] * np.maximum(length - effect.values["rest_length"], 0.0) * pull / length
    else:
        share = contact_shape(motion.t, effect.values["start"], effect.values["end"]) * motion.contact
        force = share[:, None] * effect.vector("fx", "fy", "fz")
    _hold(effect.joint, point, force, where, wrench, torques)


def _hold(joint: int, point: np.ndarray, force: np.ndarray, where: Frames, wrench: np.ndarray, torques: np.ndarray) -> None:
    wrench[:, :3] -= force
    wrench[:, 3:] -= np.cross(point, force)
    for j in range(joint + 1):
        torques[:, j] -= np.einsum("ka,ka->k", where.axis[:, j], np.cross(point - where.origin[:, j], force))


def _rotor(arm: Arm, motion: Motion, where: Frames, effect: Effect, wrench: np.ndarray, torques: np.ndarray) -> None:
    """Gyrostat: momentum J qd z of a rotor about joint's axis; the joints below feel its rate of change."""
    j, spin = effect.joint, effect.values["inertia"]
    axis = where.axis[:, j]
    rate = spin * (motion.a[:, j, None] * axis + motion.v[:, j, None] * np.cross(where.omega[:, j], axis))
    wrench[:, 3:] += rate
    for i in range(j):
        torques[:, i] += np.einsum("ka,ka->k", where.axis[:, i], rate)
    if j:  # the turning of the link that carries it, seen through the gear
        torques[:, j] += spin * np.gradient(np.einsum("ka,ka->k", axis, where.omega[:, j - 1]), motion.t)


def bristle(dq: np.ndarray, presliding: float) -> np.ndarray:
    """Dahl's bristle: friction over its level for steps dq (N,); d z = (sign dq - z) |dq| / presliding."""
    keep = np.exp(-np.abs(dq) / presliding)
    push = (1 - keep) * np.sign(dq)
    out, state = np.empty_like(dq), 0.0
    for k, (stay, forward) in enumerate(zip(keep.tolist(), push.tolist(), strict=True)):
        state = stay * state + forward
        out[k] = state
    return out


def friction_sign(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Dry friction over its level along a motion: the sign of the velocity, fading while the joint stands still."""
    steps = np.diff(q, prepend=q[:1])
    fade = np.where(np.abs(v) < CREEP[1], np.exp(-(t[1] - t[0]) / CREEP[0]), 1.0)
    keep = np.exp(-np.abs(steps) / PRESLIDING)
    push = (1 - keep) * np.sign(steps)
    out, state = np.empty_like(q), 0.0
    for k, (stay, forward, left) in enumerate(zip(keep.tolist(), push.tolist(), fade.tolist(), strict=True)):
        state = left * (stay * state + forward)
        out[k] = state
    return out


def _steps(motion: Motion, joint: int) -> np.ndarray:
    q = motion.q[:, joint]
    return np.diff(q, prepend=q[:1])


def _drive(motion: Motion, effect: Effect, load: np.ndarray) -> np.ndarray:
    """Torque that a motor needs beyond what its link takes."""
    extra = np.zeros_like(load)
    if effect.name not in (
        "viscous_friction", "coulomb_friction", "stribeck_friction", "load_friction", "rotor_inertia", "spring",
        "rotor_momentum", "dahl_friction", "directional_friction", "posture_friction", "warming_friction", "quadratic_friction",
    ):  # fmt: skip
        return extra
    j, values = effect.joint, effect.values
    v = motion.v[:, j]
    if effect.name == "viscous_friction":
        extra[:, j] = values["coefficient"] * v
    elif effect.name == "rotor_inertia":
        extra[:, j] = values["inertia"] * motion.a[:, j]
    elif effect.name == "rotor_momentum":  # the same rotor behind its gear
        extra[:, j] = values["inertia"] * values.get("gear_ratio", 0.0) * motion.a[:, j]
    elif effect.name == "spring":
        extra[:, j] = values["stiffness"] * (motion.q[:, j] - values["rest"])
    elif effect.name == "dahl_friction":
        extra[:, j] = values["level"] * bristle(_steps(motion, j), values["distance"])
    elif effect.name == "directional_friction":
        extra[:, j] = values["difference"] * np.abs(v)
    elif effect.name == "quadratic_friction":
        extra[:, j] = values["coefficient"] * v * np.abs(v)
    else:
        sign = friction_sign(motion.t, motion.q[:, j], v)
        time = values.get("time", 1.0)
        warmth = -time * (1 - np.exp(-np.maximum(motion.t, 0.0) / time))
        size = {
            "coulomb_friction": lambda: values["level"],
            "stribeck_friction": lambda: values["level"] * np.exp(-((v / values["velocity"]) ** 2)),
            "load_friction": lambda: values["coefficient"] * np.abs(load[:, j]),
            "posture_friction": lambda: effect.vector("cosine", "sine") @ [np.cos(motion.q[:, j]), np.sin(motion.q[:, j])],
            "warming_friction": lambda: values.get("level", 0.0) * warmth,
        }[effect.name]()
        extra[:, j] = size * sign
        if effect.name == "warming_friction":
            extra[:, j] += values.get("coefficient", 0.0) * v * warmth
    return extra


def _sense(sensor: Sensor, motion: Motion, effects: tuple[Effect, ...], wrench: np.ndarray, still: bool) -> np.ndarray:
    by_name = {effect.name: effect for effect in effects}
    turned = sensor
    if "sensor_translation" in by_name:
        turned = replace(sensor, translation=sensor.translation + by_name["sensor_translation"].vector("x", "y", "z"))
    out = turned.read(wrench)
    if "sensor_rotation" in by_name:
        turn = Rotation.from_rotvec(by_name["sensor_rotation"].vector("rx", "ry", "rz")).as_matrix()
        out = np.hstack([out[:, :3] @ turn, out[:, 3:] @ turn])
    if "vibration" in by_name and not still:
        values = by_name["vibration"].values
        wave = np.sin(2 * np.pi * values["frequency"] * motion.t + values["phase"])
        out = out + wave[:, None] * by_name["vibration"].vector(*AXES)
    truth = out.copy()
    for effect in effects:
        if effect.name == "sensor_gain":
            axis = AXES.index(effect.where)
            out[:, axis] += effect.values["gain"] * truth[:, axis]
        elif effect.name == "sensor_crosstalk":
            source, reading = (AXES.index(axis) for axis in effect.where.split("->"))
            out[:, reading] += effect.values["coefficient"] * truth[:, source]
        elif effect.name == "cubic_moment":
            axis = AXES.index(effect.where)
            out[:, axis] += effect.values["coefficient"] * truth[:, axis] ** 3
        elif effect.name == "saturation":
            axis, (low, high) = AXES.index(effect.where), effect.vector("low", "high")
            out[:, axis] = np.clip(truth[:, axis], low, high)
        elif effect.name == "hysteresis" and not still:
            axis, (level, width) = AXES.index(effect.where), effect.vector("level", "width")
            out[:, axis] += level * bristle(np.diff(truth[:, axis], prepend=truth[:1, axis]), width)
    if "sensor_delay" in by_name and not still:
        late = np.maximum(motion.t - by_name["sensor_delay"].values["delay"], motion.t[0])
        out = CubicSpline(motion.t, out)(late)
    for effect in effects:
        if effect.name == "sensor_offset":
            out = out + effect.vector(*AXES)
        elif effect.name == "sensor_drift":
            out = out + motion.t[:, None] * effect.vector(*AXES)
        elif effect.name == "thermal":
            out = out + (1 - np.exp(-np.maximum(motion.t, 0.0) / effect.values["time"]))[:, None] * effect.vector(*AXES)
    return out


def averaged(values: np.ndarray, motion: Motion) -> np.ndarray:
    """Mean over one sample interval centred on each sample's time, trapezoidal on the fine grid; (count, ...)."""
    half = motion.every // 2
    total = np.vstack([np.zeros((1, values.shape[1])), np.cumsum((values[1:] + values[:-1]) / 2, axis=0)])
    rows = motion.first + motion.every * np.arange(motion.count)
    return (total[rows + half] - total[rows - half]) / (2 * half)
