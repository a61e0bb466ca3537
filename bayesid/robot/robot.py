"""The robot: a URDF reduced to the joints that move, with bodies, names and nominal parameters.

Locked and fixed joints merge their links into the parent link. A sensor in a fixed or locked joint splits
the link it is in; the far part becomes a body of its own, after all joints' bodies.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from hashlib import blake2b
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.arguments import names as as_names
from bayesid.errors import InputError, did_you_mean
from bayesid.robot import inertia
from bayesid.robot.urdf_file import UrdfFile, read_urdf


def fingerprint(holder: Any) -> bytes:
    """Digest (16 bytes) of all fields of a dataclass instance: the same for equal arrays and texts, wherever they are kept."""
    digest = blake2b(digest_size=16)
    for item in fields(holder):
        value = getattr(holder, item.name)
        if isinstance(value, np.ndarray):
            digest.update(repr((item.name, value.dtype.str, value.shape)).encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(repr((item.name, value)).encode())
    return digest.digest()


@dataclass(frozen=True)
class SensorPlace:
    """Place of the sensor in the tree."""

    parent: int  # the moving joint whose frame it moves with; -1: the root
    placement: Any  # of the sensor joint's child link in that joint's frame
    bodies: np.ndarray  # which bodies it carries
    far: Any | None  # inertia of a split link's far part, in the sensor joint's child frame; None where no link is split
    beyond: frozenset[int] = frozenset()  # the model's frames beyond it, where a link may be split


def locate_sensor(urdf: Path, model, name: str, index, parent, anchor, frame) -> SensorPlace:
    """Find the sensor's joint; an `InputError` where the URDF has no such joint.

    ``index`` and ``parent`` are the moving joints' own, by name, and the moving joint before each, -1 for the root (n,);
    ``anchor`` and ``frame`` are the moving joint that carries each of the model's joints, and that joint's frame in it.
    """
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    found = [k for k, f in enumerate(model.frames) if f.name == name and f.type in kinds]
    if not found:
        known = [f.name for f in model.frames if f.type in kinds and f.name != "universe"]
        hint = did_you_mean(name, known, f"its joints are: {', '.join(known)}")
        raise InputError(f"sensor joint '{name}' is not in {urdf.name}; {hint}")
    n = len(parent)
    if name in index:
        i = index[name]
        return SensorPlace(i, pin.SE3.Identity(), _movers(parent)[i], None)
    # The sensor sits in a fixed or locked joint: all frames beyond it, through fixed or locked joints, are
    # its far part; moving joints beyond it keep their own bodies.
    here = found[0]
    beyond = [here]
    for k in range(here + 1, len(model.frames)):  # a frame comes after its parent
        if int(model.frames[k].parentFrame) in beyond:
            beyond.append(k)
    own_joint = int(model.frames[here].parentJoint)
    mover = anchor[own_joint]
    placement = frame[own_joint] * model.frames[here].placement
    far, bodies = pin.Inertia.Zero(), np.zeros(n + (mover >= 0), bool)
    joints_beyond = {int(model.frames[k].parentJoint) for k in beyond} - {own_joint}
    if model.frames[here].type == pin.FrameType.JOINT:  # a locked joint carries its whole own link
        joints_beyond.add(own_joint)
    else:
        for k in beyond:
            f = model.frames[k]
            if int(f.parentJoint) == own_joint:
                far = far + (placement.inverse() * frame[own_joint] * f.placement).act(f.inertia)
    for j in joints_beyond:
        if anchor[j] == mover:
            far = far + (placement.inverse() * frame[j]).act(model.inertias[j])
        else:
            bodies[:n] |= _movers(parent)[anchor[j]]
    bodies[n:] = True
    return SensorPlace(mover, placement, bodies, far, frozenset(beyond))


def joint_rods(model, anchor, frame, sensor: SensorPlace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines between the origins of neighbouring joints of moving links, none on the root.

    Their joints (r,), ends (r, 2, 3), and the bodies that they are parts of (r,): of a split link one on either side.
    """
    joint, ends, body = [], [], []
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    for k, child in enumerate(model.frames):
        if child.type not in kinds or k == 0:
            continue
        up = int(child.parentFrame)
        while up and model.frames[up].type not in kinds:
            up = int(model.frames[up].parentFrame)
        # A joint's own frame sits in that joint; the line to it belongs to the link before.
        holder = model.frames[up]
        mover = int(holder.parentJoint)
        if anchor[mover] < 0:
            continue
        if child.type == pin.FrameType.JOINT:
            tip = frame[mover] * model.jointPlacements[int(child.parentJoint)].translation
        else:
            tip = frame[mover] * child.placement.translation
        joint.append(anchor[mover])
        ends.append([frame[mover] * holder.placement.translation, tip])
        body.append(len(sensor.bodies) - 1 if anchor[mover] == sensor.parent and up in sensor.beyond else anchor[mover])
    return np.array(joint, int), np.array(ends, float).reshape(-1, 2, 3), np.array(body, int)


def _movers(parent: np.ndarray) -> np.ndarray:
    """Whether joint i moves joint k, as it does itself (n, n)."""
    table = np.zeros((len(parent), len(parent)), bool)
    for k in range(len(parent)):
        joint = k
        while joint >= 0:
            table[joint, k] = True
            joint = int(parent[joint])
    return table


_STANDARD_GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True, eq=False)
class Robot:
    """Kinematics and nominal inertias of a tree of ``n`` one-degree-of-freedom joints on a fixed root.

    Attributes
    ----------
    name
        As its file says.
    description
        What was read, as a URDF.
    joint_names
        Joints in the order of q1 ... qn.
    parent
        Index of the joint that moves each joint's parent link, -1 for the root, (n,).
    rotation, translation
        Placement of each joint's frame at position zero in its parent's frame, (n, 3, 3), (n, 3) [m].
    axis, prismatic
        Joint axis in its own frame (n, 3) (unit length) and whether it slides instead of turning (n,).
    lower, upper, velocity_limit, effort_limit
        Limits from the URDF (n,) [rad or m, per second, N m or N]; infinite where it states none.
    gravity
        In the base frame (3,) [m/s^2].
    body_names, body_joint
        One body a joint, then a split sensor link's far part; the joint that moves each body (b,).
    nominal
        Ten nominal parameters a body (b, 10), about its joint's frame (the far part: the sensor joint's).
    body_rotation, body_translation
        Placement of each body's frame in the frame of the joint that moves it (b, 3, 3), (b, 3).
    locked
        Position of every other moving joint that does not stand at zero [rad or m].
    sensor_joint
        Joint in which the sensor sits, None for one under the base.
    sensor_parent
        Joint whose frame the sensor moves with, -1 for a sensor on the root.
    sensor_rotation, sensor_translation
        Placement of the sensor joint's child link in that frame (3, 3), (3,); identity for a base sensor.
    sensor_bodies
        Which bodies the sensor carries (b,).
    static_nominal
        Nominal parameters of what does not move but is carried by a base sensor, about the root (10,).
    rod_joint, rods, rod_body
        Straight lines from the origin of each moving link to those of its child joints, fixed and locked ones
        included: the joint whose frame each moves with (r,), its two ends in that frame (r, 2, 3) [m], its body (r,).
    """

    name: str
    description: UrdfFile
    joint_names: tuple[str, ...]
    parent: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    axis: np.ndarray
    prismatic: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity_limit: np.ndarray
    effort_limit: np.ndarray
    gravity: np.ndarray
    body_names: tuple[str, ...]
    body_joint: np.ndarray
    nominal: np.ndarray
    body_rotation: np.ndarray
    body_translation: np.ndarray
    sensor_parent: int
    sensor_rotation: np.ndarray
    sensor_translation: np.ndarray
    sensor_bodies: np.ndarray
    static_nominal: np.ndarray
    rod_joint: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    rods: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))
    rod_body: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    locked: Mapping[str, float] = field(default_factory=dict)
    sensor_joint: str | None = None

    def __repr__(self) -> str:
        return f"<Robot {self.name}: {self.n} joints, {len(self.body_names)} bodies>"

    @property
    def urdf(self) -> Path:
        """The file that it was read from."""
        return self.description.path

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.joint_names)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """``joint1.m, joint1.mcx, ...``: ten names a body."""
        return tuple(f"{body}.{p}" for body in self.body_names for p in inertia.PARAMETERS)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return inertia.UNITS * len(self.body_names)

    @property
    def moves_with(self) -> np.ndarray:
        """Whether joint i moves body k (n, b)."""
        return _movers(self.parent)[:, self.body_joint]

    @cached_property
    def fingerprint(self) -> bytes:
        """Digest of all that it holds, the same for equal robots."""
        return fingerprint(self)

    @property
    def order(self) -> np.ndarray:
        """Joint indices with every parent before its children (n,)."""
        return np.argsort(_movers(self.parent).sum(axis=0), kind="stable")


def joint_index(name: str, joints: Sequence[str]) -> int | None:
    """Index of one of the joints by its place among them, ``joint1`` ..., or else by its own name; None where it is neither.

    A place goes before a name: effects are listed by place, and a file with such a list is read again.
    """
    place = re.fullmatch(r"joint([1-9]\d{0,8})", name)
    if place and int(place[1]) <= len(joints):
        return int(place[1]) - 1
    return list(joints).index(name) if name in joints else None


@explains_types
def load_robot(
    urdf: str | Path | UrdfFile,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
    gravity: Sequence[float] = _STANDARD_GRAVITY,
    sensor_joint: str | None = None,
) -> Robot:
    """Read a robot and reduce it to the listed joints.

    Parameters
    ----------
    urdf
        Path of a URDF, a xacro file (``"FILE name:=value"`` with arguments) or an MJCF file, or ``"robot_descriptions:NAME"``.
    joints
        Moving joints in the order of q1 ... qn; default: every moving joint that is not locked, in the file's order, each after
        the one that it hangs on.
    locked
        Position [rad or m] of every other moving joint; default 0.
    gravity
        In the base frame (3,) [m/s^2].
    sensor_joint
        Joint in which a force/torque sensor sits; default: between the world and the base.

    Raises
    ------
    InputError
        The file cannot be read as a robot, a joint is unknown or of a kind with more than one degree of
        freedom; or a package is missing that the format needs.
    """
    file = urdf if isinstance(urdf, UrdfFile) else read_urdf(urdf)
    urdf, model = file.path, _read(file)
    locked = {} if locked is None else dict(locked)
    moving = _listed(file, model)
    joints = [name for name in moving if name not in locked] if joints is None else list(map(str, as_names(joints) or ()))
    for name in [*joints, *locked]:
        if name not in moving:
            raise InputError(_unknown_joint(urdf, model, name, moving))
    for name in joints:
        if joints.count(name) > 1:
            raise InputError(f"joint '{name}' is listed twice; list each joint once ({argument('joints')})")
    for name, position in locked.items():
        if name in joints:
            raise InputError(f"joint '{name}' is one of joints and locked, too; it moves or is locked ({argument('locked')})")
        if not isinstance(position, (int, float, np.number)) or not np.isfinite(position):
            raise InputError(f"joint '{name}' is locked at {position}; write where it stands [rad or m] ({argument('locked')})")
    if np.shape(gravity) != (3,) or not np.isfinite(gravity).all():
        given = gravity if np.ndim(gravity) == 0 else list(gravity)
        raise InputError(f"{argument('gravity')}: {given} will not do; give three numbers [m/s^2]")
    index = {name: k for k, name in enumerate(joints)}
    n = len(joints)

    parent = np.full(n, -1)
    rotation, translation = np.zeros((n, 3, 3)), np.zeros((n, 3))
    axis, prismatic = np.zeros((n, 3)), np.zeros(n, bool)
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    velocity_limit, effort_limit = np.full(n, np.inf), np.full(n, np.inf)
    anchor = [-1] * model.njoints  # moving joint that carries each URDF joint's frame
    frame = [pin.SE3.Identity() for _ in range(model.njoints)]  # that frame in the moving joint's
    merged: list[Any] = [pin.Inertia.Zero() for _ in range(n)]
    static = model.inertias[0]
    for j in range(1, model.njoints):
        name, up = str(model.names[j]), int(model.parents[j])
        direction, slides = _axis(urdf, model.joints[j], name)
        placement = frame[up] * model.jointPlacements[j]
        if name in index:
            i = index[name]
            parent[i], anchor[j] = anchor[up], i
            rotation[i], translation[i] = placement.rotation, placement.translation
            axis[i], prismatic[i] = direction, slides
            lower[i], upper[i], velocity_limit[i], effort_limit[i] = _limits(model, j)
        else:
            anchor[j] = anchor[up]
            moved = locked.get(name, 0.0) * direction
            frame[j] = placement * (pin.SE3(np.eye(3), moved) if slides else pin.SE3(pin.exp3(moved), np.zeros(3)))
        if anchor[j] >= 0:
            merged[anchor[j]] = merged[anchor[j]] + frame[j].act(model.inertias[j])
        else:
            static = static + frame[j].act(model.inertias[j])

    nominal = np.array([body.toDynamicParameters() for body in merged]).reshape(n, 10)
    sensor = SensorPlace(-1, pin.SE3.Identity(), np.ones(n, bool), None)
    if sensor_joint is not None:
        sensor = locate_sensor(urdf, model, sensor_joint, index, parent, anchor, frame)
    names, body_joint = tuple(joints), np.arange(n)
    body_rotation, body_translation = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    far = np.zeros(10) if sensor.far is None else sensor.placement.act(sensor.far).toDynamicParameters()
    if sensor.far is not None and sensor.parent >= 0:
        nominal[sensor.parent] -= far
        nominal = np.vstack([nominal, sensor.far.toDynamicParameters()])
        names, body_joint = (*names, str(sensor_joint)), np.append(body_joint, sensor.parent)
        body_rotation = np.concatenate([body_rotation, sensor.placement.rotation[None]])
        body_translation = np.vstack([body_translation, sensor.placement.translation])
    # Only what hangs on the far side of a sensor in a joint loads it; on the root that part does not move.
    static_nominal = static.toDynamicParameters() if sensor_joint is None else far if sensor.parent < 0 else np.zeros(10)
    rod_joint, rods, rod_body = joint_rods(model, anchor, frame, sensor)
    arrays = dict(
        rod_joint=rod_joint, rods=rods, rod_body=rod_body,
        parent=parent, rotation=rotation, translation=translation, axis=axis, prismatic=prismatic, lower=lower,
        upper=upper, velocity_limit=velocity_limit, effort_limit=effort_limit,
        gravity=np.asarray(gravity, float), body_joint=body_joint, nominal=nominal, body_rotation=body_rotation,
        body_translation=body_translation, sensor_rotation=sensor.placement.rotation.copy(),
        sensor_translation=sensor.placement.translation.copy(), sensor_bodies=sensor.bodies,
        static_nominal=static_nominal,
    )  # fmt: skip
    for array in arrays.values():
        array.setflags(write=False)
    return Robot(
        name=str(model.name), description=file, joint_names=tuple(joints), body_names=names, sensor_parent=sensor.parent,
        locked={name: float(locked[name]) for name in sorted(locked) if locked[name]}, sensor_joint=sensor_joint, **arrays,
    )  # fmt: skip


def _listed(file: UrdfFile, model) -> list[str]:
    """Moving joints as the file lists them, but each after the one before it in its chain: Pinocchio sorts branches by name."""
    place = {name: k for k, name in enumerate(file.joints)}
    below: dict[int, list[tuple[int, int]]] = {}
    for j in range(1, model.njoints):
        below.setdefault(int(model.parents[j]), []).append((place[str(model.names[j])], j))
    ready, out = sorted(below.get(0, [])), []
    while ready:
        _, j = heappop(ready)
        out.append(str(model.names[j]))
        for child in below.get(j, ()):
            heappush(ready, child)
    return out


def _read(urdf: UrdfFile):
    try:
        return pin.buildModelFromXML(urdf.for_pinocchio())
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200] or "not a valid URDF"
        raise InputError(
            f"cannot be read as a URDF ({reason})", file=urdf.path.name, remedy="check it with a URDF viewer"
        ) from None


def _unknown_joint(urdf: Path, model, name: str, moving: list[str]) -> str:
    kind = "is fixed in" if model.existFrame(name) else "is not in"
    hint = did_you_mean(name, moving, f"its moving joints are: {', '.join(moving)}")
    return f"joint '{name}' {kind} {urdf.name}; {hint}"


def _axis(urdf: Path, joint, name: str) -> tuple[np.ndarray, bool]:
    """Axis of a joint in its own frame, and whether it slides."""
    if joint.nv != 1:
        raise InputError(
            f"{urdf}: joint '{name}' has {joint.nv} degrees of freedom; "
            'only revolute, continuous, prismatic and fixed joints are supported: write type="fixed", if it does not move'
        )
    data = joint.createData()
    joint.calc(data, np.zeros(1) if joint.nq == 1 else np.array([1.0, 0.0]))  # at zero: its angle, or cosine and sine
    subspace = np.asarray(data.S).reshape(6)
    slides = not subspace[3:].any()
    return (subspace[:3] if slides else subspace[3:]), slides


def _limits(model, j: int) -> tuple[float, float, float, float]:
    """Position, speed and effort limits; URDF's zeros and Pinocchio's huge numbers mean none."""
    i, k = model.joints[j].idx_q, model.joints[j].idx_v
    lower, upper = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
    if model.joints[j].nq != 1 or not lower < upper or max(abs(lower), abs(upper)) > 1e6:
        lower, upper = -np.inf, np.inf
    velocity, effort = float(model.velocityLimit[k]), float(model.effortLimit[k])
    return lower, upper, velocity if 0 < velocity < 1e6 else np.inf, effort if 0 < effort < 1e6 else np.inf


def motion_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower and upper positions and the largest speed (n,), all finite: those of a small arm where none are stated."""
    reach, speed = np.where(robot.prismatic, 0.25, np.pi / 2), np.where(robot.prismatic, 0.3, 1.5)
    free = ~(np.isfinite(robot.lower) & np.isfinite(robot.upper))
    fastest = np.where(np.isfinite(robot.velocity_limit), robot.velocity_limit, speed)
    return np.where(free, -reach, robot.lower), np.where(free, reach, robot.upper), fastest
