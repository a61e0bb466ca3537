"""Arms of the blind set: URDF texts with drawn inertias, and their rigid-body dynamics by Pinocchio.

Every model has a free-flyer under the base, so one recursive Newton-Euler pass gives the base wrench and all joint
torques, and the base may rock. Nothing of bayesid's own dynamics is used: that is what the set judges.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests import robots

GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Kind:
    """An arm as it is recorded: URDF text, active joints, locked joints, home pose, noise of a good torque sensor."""

    urdf: str
    joints: tuple[str, ...]
    home: np.ndarray
    locked: dict[str, float]


def kinds() -> dict[str, Kind]:
    """The four arms by name."""
    puma = tuple(f"joint{j}" for j in range(1, 7))
    ur5 = tuple(f"{part}_joint" for part in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
    panda = tuple(f"panda_joint{j}" for j in range(1, 8))
    locked = {"joint3": -2.48, "joint4": 0.0, "joint5": 0.0, "joint6": 0.0}
    return {
        "puma560": Kind(robots.puma560(), puma, np.array([0.0, -1.2, 1.3, 0.2, 0.3, 0.0]), {}),
        "puma2": Kind(robots.puma560(), puma[:2], np.array([0.0, -0.9]), locked),
        "ur5": Kind(robots.ur5(), ur5, np.array([0.2, -1.2, 1.4, -1.0, -1.3, 0.0]), {}),
        "panda": Kind(robots.panda(), panda, np.array([0.0, -0.1, 0.0, -1.8, 0.0, 1.9, 0.6]), {}),
    }


@dataclass(frozen=True, eq=False)
class Arm:
    """A Pinocchio model with a free-flyer under the base; active joint j (0-based) is joint j + 2 of the model."""

    model: pin.Model
    n: int
    tree: tuple[tuple[str, str], ...] = ()  # every joint, locked and fixed ones included, and the joint before it

    @property
    def links(self) -> np.ndarray:
        """Ten parameters of each active joint's link about its joint frame (n, 10)."""
        return np.array([self.model.inertias[j + 2].toDynamicParameters() for j in range(self.n)])

    def changed(self, changes: dict[int, np.ndarray], gravity: np.ndarray = GRAVITY) -> Arm:
        """The arm with ten parameters added to links (0-based joint) and another gravity."""
        model = self.model.copy()
        for joint, change in changes.items():
            total = model.inertias[joint + 2].toDynamicParameters() + change
            model.inertias[joint + 2] = pin.Inertia.FromDynamicParameters(total)
        model.gravity.linear = gravity
        return Arm(model, self.n, self.tree)


def load(urdf: str, joints: tuple[str, ...], locked: dict[str, float]) -> Arm:
    """Model of a URDF text, joints that are not active locked at their angles (0 unless given)."""
    model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    tree = tuple(_joint_pairs(model))
    still = [model.getJointId(name) for name in list(model.names)[2:] if name not in joints]
    reference = pin.neutral(model)
    for name, angle in locked.items():
        reference[model.joints[model.getJointId(name)].idx_q] = angle
    if still:
        model = pin.buildReducedModel(model, still, reference)
    if tuple(model.names)[2:] != tuple(joints):
        raise ValueError(f"joints {tuple(model.names)[2:]} are not in the order {joints}")
    model.gravity.linear = GRAVITY
    return Arm(model, len(joints), tree)


def _joint_pairs(model: pin.Model) -> list[tuple[str, str]]:
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    pairs = []
    for frame in model.frames:
        if frame.type not in kinds or not frame.parentFrame:
            continue
        before = model.frames[frame.parentFrame]
        while before.type not in kinds:
            before = model.frames[before.parentFrame]
        if before.name != "root_joint":
            pairs.append((frame.name, before.name))
    return pairs


def pseudo_inertia(links: np.ndarray) -> np.ndarray:
    """Pseudo-inertia (4, 4) of ten parameters."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = links
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    result = np.empty((4, 4))
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = x, y, z
    result[3, 3] = m
    return result


def parameters(pseudo: np.ndarray) -> np.ndarray:
    """Ten parameters of a pseudo-inertia."""
    inertia = np.trace(pseudo[:3, :3]) * np.eye(3) - pseudo[:3, :3]
    (xx, xy, xz), (_, yy, yz), zz = inertia[0], inertia[1], inertia[2, 2]
    return np.array([pseudo[3, 3], *pseudo[:3, 3], xx, xy, yy, xz, yz, zz])


def warped(links: np.ndarray, rel_std: float, rng: np.random.Generator) -> np.ndarray:
    """Another possible body at a relative distance: scaled as a whole, its mass distribution warped."""
    values, vectors = np.linalg.eigh(pseudo_inertia(links))
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    noise = rng.normal(size=(4, 4))
    symmetric = rel_std * (np.tril(noise) + np.tril(noise, -1).T) + 0.6 * rel_std * rng.normal() * np.eye(4)
    symmetric[3, 3] *= 0.6
    grown, axes = np.linalg.eigh(symmetric)
    return parameters(root @ (axes * np.exp(grown) @ axes.T) @ root)


def warped_urdf(urdf: str, rel_std: float, rng: np.random.Generator) -> str:
    """The URDF text with every inertia but the root link's warped."""
    tree = ET.fromstring(urdf)
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    for link in tree.iter("link"):
        inertial = link.find("inertial")
        if inertial is None or link.get("name") not in children:
            continue
        origin, mass, matrix = (inertial.find(tag) for tag in ("origin", "mass", "inertia"))
        place = pin.SE3(pin.rpy.rpyToMatrix(_numbers(origin, "rpy")), _numbers(origin, "xyz"))
        xx, xy, xz, yy, yz, zz = (float(matrix.get(key)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = place.act(pin.Inertia(float(mass.get("value")), np.zeros(3), about))
        new = pin.Inertia.FromDynamicParameters(warped(body.toDynamicParameters(), rel_std, rng))
        origin.set("xyz", " ".join(f"{x:.12g}" for x in new.lever))
        origin.set("rpy", "0 0 0")
        mass.set("value", f"{new.mass:.12g}")
        for key, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), new.inertia[np.triu_indices(3)], strict=True):
            matrix.set(key, f"{value:.12g}")
    return '<?xml version="1.0"?>\n' + ET.tostring(tree, encoding="unicode") + "\n"


def _numbers(element: ET.Element, key: str) -> np.ndarray:
    return np.array([float(x) for x in (element.get(key) or "0 0 0").split()])


def states(n: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Configuration, velocity and acceleration with the base at rest, (N, 7 + n), (N, 6 + n), (N, 6 + n)."""
    big = np.zeros((len(q), 7 + n)), np.zeros((len(q), 6 + n)), np.zeros((len(q), 6 + n))
    big[0][:, 6] = 1.0
    big[0][:, 7:], big[1][:, 6:], big[2][:, 6:] = q, v, a
    return big


def inverse_dynamics(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wrench of the ground on the base (force, moment at the base origin, base axes) (N, 6) and joint torques (N, n)."""
    return _passes(arm, *states(arm.n, q, v, a))


def _passes(arm: Arm, big_q: np.ndarray, big_v: np.ndarray, big_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    model, data = arm.model, arm.model.createData()
    out = np.empty((len(big_q), 6 + arm.n))
    for k in range(len(big_q)):
        out[k] = pin.rnea(model, data, big_q[k], big_v[k], big_a[k])
    return out[:, :6], out[:, 6:]


def regressor(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Wrench and torques per link parameter (N, 6 + n, 10 n), the root link's left out."""
    model, data = arm.model, arm.model.createData()
    big = states(arm.n, q, v, a)
    return np.array([pin.computeJointTorqueRegressor(model, data, *one)[:, 10:].copy() for one in zip(*big, strict=True)])


@dataclass(frozen=True, eq=False)
class Frames:
    """Joint frames along a motion, base axes: rotation (N, n, 3, 3), origin, angular velocity, velocity, axis (N, n, 3)."""

    rotation: np.ndarray
    origin: np.ndarray
    omega: np.ndarray
    velocity: np.ndarray
    axis: np.ndarray


def frames(arm: Arm, q: np.ndarray, v: np.ndarray) -> Frames:
    """Where the joint frames of a serial arm are and how they move; the base at rest."""
    n, rotation = arm.n, np.empty((len(q), arm.n, 3, 3))
    origin, omega, velocity, axis = np.empty((4, len(q), n, 3))
    for j in range(n):
        place, own = arm.model.jointPlacements[j + 2], _axis(arm.model, j + 2)
        turn = place.rotation @ Rotation.from_rotvec(q[:, j, None] * own).as_matrix()
        if j == 0:
            rotation[:, 0], origin[:, 0] = turn, place.translation
            omega[:, 0] = velocity[:, 0] = 0.0
        else:
            rotation[:, j] = rotation[:, j - 1] @ turn
            reach = rotation[:, j - 1] @ place.translation
            origin[:, j] = origin[:, j - 1] + reach
            omega[:, j] = omega[:, j - 1]
            velocity[:, j] = velocity[:, j - 1] + np.cross(omega[:, j - 1], reach)
        axis[:, j] = rotation[:, j] @ own
        omega[:, j] += v[:, j, None] * axis[:, j]
    return Frames(rotation, origin, omega, velocity, axis)


def _axis(model: pin.Model, joint: int) -> np.ndarray:
    data = model.createData()
    velocity = np.zeros(model.nv)
    velocity[model.joints[joint].idx_v] = 1.0
    pin.forwardKinematics(model, data, pin.neutral(model), velocity)
    return (data.v[joint] - data.liMi[joint].actInv(data.v[model.parents[joint]])).angular


def rods(arm: Arm) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Rods (active joint that moves it, two ends in its frame) from each moving link's joint origin to each child joint's."""
    model, found = arm.model, []
    for name, before in arm.tree:
        start, frame = (model.frames[model.getFrameId(x)] for x in (before, name))
        mover = start.parentJoint
        if mover < 2:  # behind a joint that is fixed to the root
            continue
        end = frame.placement if frame.parentJoint == mover else model.jointPlacements[frame.parentJoint]
        found.append((mover - 2, np.array(start.placement.translation), np.array(end.translation)))
    return found


def rocked(
    arm: Arm, times: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray, home: np.ndarray, resonance: float, damping: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wrench, torques and tilts (N, 2) with the base on springs and dampers about base x and y; wrench in its own axes.

    The joint motion is given, `home` is the pose whose mean tilting inertia the resonance is for; the two tilts
    follow from their own equations, by Runge-Kutta over pairs of samples.
    """
    model, data = arm.model, arm.model.createData()
    big_q, big_v, big_a = states(arm.n, q, v, a)
    middle = pin.crba(model, data, np.concatenate([[0, 0, 0, 0, 0, 0, 1], home])).copy()
    inertia = (middle[3, 3] + middle[4, 4]) / 2
    stiffness = inertia * (2 * np.pi * resonance) ** 2
    damper = 2 * damping * inertia * 2 * np.pi * resonance
    masses = np.empty((len(q), 2, 2))
    for k in range(len(q)):
        masses[k] = pin.crba(model, data, big_q[k])[3:5, 3:5]
    masses[:, 1, 0] = masses[:, 0, 1]
    inverse = np.linalg.inv(masses)

    def put(k: int, tilt: np.ndarray, rate: np.ndarray) -> None:
        half = 0.5 * np.hypot(*tilt)
        scale = 0.5 * np.sinc(half / np.pi)
        big_q[k, 3:5], big_q[k, 6] = scale * tilt, np.cos(half)
        big_v[k, 3:5] = rate

    def slope(k: int, tilt: np.ndarray, rate: np.ndarray) -> np.ndarray:
        put(k, tilt, rate)
        bias = pin.rnea(model, data, big_q[k], big_v[k], big_a[k])[3:5]
        return inverse[k] @ (-stiffness * tilt - damper * rate - bias)

    tilt, rate = np.zeros(2), np.zeros(2)
    for _ in range(8):  # rest under the weight
        put(0, tilt, rate)
        tilt = -pin.rnea(model, data, big_q[0], 0 * big_v[0], 0 * big_a[0])[3:5] / stiffness
    step = times[2] - times[0]
    tilts, rates = np.zeros((len(q), 2)), np.zeros((len(q), 2))
    tilts[0], rates[0] = tilt, rate
    for k in range(0, len(q) - 2, 2):
        a1 = slope(k, tilt, rate)
        a2 = slope(k + 1, tilt + step / 2 * rate, rate + step / 2 * a1)
        a3 = slope(k + 1, tilt + step / 2 * rate + step**2 / 4 * a1, rate + step / 2 * a2)
        a4 = slope(k + 2, tilt + step * rate + step**2 / 2 * a2, rate + step * a3)
        tilt = tilt + step * rate + step**2 / 6 * (a1 + a2 + a3)
        rate = rate + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        tilts[k + 2], rates[k + 2] = tilt, rate
    if len(q) % 2 == 0:
        tilts[-1], rates[-1] = tilts[-2], rates[-2]
    # Between Runge-Kutta points: the cubic that matches both ends' tilt and rate.
    odd = np.arange(1, len(q) - 1, 2)
    before, after = odd - 1, odd + 1
    tilts[odd] = (tilts[before] + tilts[after]) / 2 + step / 8 * (rates[before] - rates[after])
    rates[odd] = 1.5 * (tilts[after] - tilts[before]) / step - (rates[before] + rates[after]) / 4
    for k in range(len(q)):
        big_a[k, 3:5] = slope(k, tilts[k], rates[k])
    return *_passes(arm, big_q, big_v, big_a), tilts
