"""Distances between the robot's bodies, and to the ground, from the collision geometry that its URDF has.

Distances, nearest points and normals are those of Pinocchio and Coal [Pan2012]_. With the normal m from body 1 to body 2 and the
nearest points x1, x2, the distance ``d = m' (x2 - x1)`` changes with the joints as ``m' (J2(x2) - J1(x1))``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from bayesid.dynamics.kinematics import P, R, W, link_states
from bayesid.effects.segment import Results
from bayesid.robot.robot import Robot

#: Pairs that touch in more than this share of random positions are taken for neighbours, as planners do.
_NEIGHBOURS, _TRIED = 0.95, 100
#: Side of the box that stands for the ground [m].
_GROUND = 20.0


@dataclass(frozen=True, eq=False)
class Clearance:
    """Bodies that must not come nearer to each other than a margin."""

    robot: Robot  # what moves
    names: tuple[str, ...]  # the pairs' names
    carriers: np.ndarray  # joint that carries each of the two bodies of a pair, -1 for what does not move (p, 2)
    #: Least distance of each pair (p,) [m]; distance that changes a ratio by one [m].
    margins: np.ndarray
    scale: float
    _collisions: _Collisions

    def __repr__(self) -> str:
        return f"<Clearance: {len(self.names)} pairs of bodies, {self.margins.max():g} m>"

    def distances(self, positions: np.ndarray) -> np.ndarray:
        """Distance of every pair at joint positions (N, n): (N, p) [m], negative where bodies overlap."""
        return self._witnesses(positions)[0]

    def ratios(self, positions: np.ndarray) -> np.ndarray:
        """``1 + (margin - distance) / scale``, zero for bodies far apart (N, p): above one where they come too near."""
        return np.maximum(1.0 + (self.margins - self.distances(positions)) / self.scale, 0.0)

    def gradient(self, positions: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Derivatives (N, n) of ``sum(weights * ratios)`` with respect to the joint positions."""
        distance, normal, points = self._witnesses(positions)
        still = np.zeros_like(positions)
        states = link_states(self.robot, positions, still, still)[:, : self.robot.n]
        rotation = states[..., R:P].reshape(*states.shape[:2], 3, 3)
        axis, origin = np.einsum("sjab,jb->sja", rotation, self.robot.axis), states[..., P:W]
        slope = np.where(distance < self.margins + self.scale, -weights / self.scale, 0.0)
        moves = np.vstack([self.robot.moves_with[:, : self.robot.n].T, np.zeros((1, self.robot.n), bool)])  # the last: the root
        out = np.zeros_like(positions)
        for side, sign in ((0, -1.0), (1, 1.0)):
            carried = moves[self.carriers[:, side]]  # (p, n)
            force = sign * slope[:, :, None] * normal  # (s, p, 3)
            total = np.einsum("spa,pj->sja", force, carried)
            moment = np.einsum("spa,pj->sja", np.cross(points[:, :, side], force), carried)
            turning = np.einsum("sja,sja->sj", axis, moment - np.cross(origin, total))
            out += np.where(self.robot.prismatic, np.einsum("sja,sja->sj", axis, total), turning)
        return out

    def _witnesses(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (N, p), normals from the first to the second body (N, p, 3), nearest points (N, p, 2, 3)."""
        return self._collisions.kept.get(positions.tobytes(), lambda: self._collisions.witnesses(positions))


class _Collisions:
    """Pinocchio's geometry of a robot whose other joints are locked."""

    def __init__(self, model: Any, geometry: Any, robot: Robot, locked: Mapping[str, float]):
        self.model, self.geometry, self.data = model, geometry, model.createData()
        self.frames = geometry.createData()
        self.columns = [model.joints[model.getJointId(name)].idx_v for name in robot.joint_names]
        self.still = np.zeros(model.nv)
        for name, angle in locked.items():
            self.still[model.joints[model.getJointId(name)].idx_v] = angle
        self.neutral = pin.neutral(model)
        self.kept = Results(1)  # the gradient follows the ratios at the same positions

    def witnesses(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same as `Clearance._witnesses`; Coal has no call for many positions at once."""
        pairs = len(self.geometry.collisionPairs)
        distance, normal, points = np.empty((len(positions), pairs)), *np.empty((2, len(positions), pairs, 2, 3))
        turn = self.still.copy()
        for s, q in enumerate(positions):
            turn[self.columns] = q
            here = pin.integrate(self.model, self.neutral, turn)
            pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.frames, here)
            pin.computeDistances(self.geometry, self.frames)
            for p, found in enumerate(self.frames.distanceResults):
                distance[s, p], normal[s, p, 0] = found.min_distance, found.normal
                points[s, p, 0], points[s, p, 1] = found.getNearestPoint1(), found.getNearestPoint2()
        return distance, normal[:, :, 0], points


def clearance(
    robot: Robot, locked: Mapping[str, float], margin: float, ground: float | None = None, seed: int = 0
) -> tuple[Clearance | None, tuple[str, ...]]:
    """Pairs of bodies that a motion must keep apart by ``margin`` [m], and notes of what was left out.

    ``locked`` are positions of joints that do not move [rad or m], ``ground`` is its height in the base frame [m], and ``seed``
    that of the positions that neighbours are found by. None without two bodies that can meet.
    """
    xml, notes = _with_geometry(robot)
    model = pin.buildModelFromXML(robot.description.for_pinocchio())
    geometry = pin.buildGeomFromUrdfString(model, xml, pin.GeometryType.COLLISION)
    carrier = _carriers(model, robot)
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):  # distances of hulls have a gradient, and are quick
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    bodies = [(shape.name.rsplit("_", 1)[0], int(carrier[shape.parentJoint])) for shape in geometry.geometryObjects]
    if ground is not None:
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, ground - 0.5]))
        geometry.addGeometryObject(pin.GeometryObject("ground_0", 0, placement, coal.Box(_GROUND, _GROUND, 1.0)))
        bodies.append(("ground", -2))
    chosen = [(a, b) for b in range(len(bodies)) for a in range(b) if not _adjacent(robot, bodies[a][1], bodies[b][1])]
    if not chosen:
        return None, notes
    for a, b in chosen:
        geometry.addCollisionPair(pin.CollisionPair(a, b))
    collisions = _Collisions(model, geometry, robot, locked)
    rng = np.random.default_rng(seed)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    tried = collisions.witnesses(rng.uniform(low, high, (_TRIED, robot.n)))[0]
    # Some shapes never are a margin apart: then they are to keep half of what they can.
    margins = np.where(np.mean(tried <= margin, axis=0) > _NEIGHBOURS, np.minimum(margin, 0.5 * tried.max(axis=0)), margin)
    for k in np.flatnonzero(np.mean(tried <= 0.0, axis=0) > _NEIGHBOURS)[::-1].tolist():
        a, b = chosen.pop(k)
        margins = np.delete(margins, k)
        geometry.removeCollisionPair(pin.CollisionPair(a, b))
        notes = (*notes, f"{bodies[a][0]} and {bodies[b][0]} overlap nearly everywhere: this pair is not checked")
    if not chosen:
        return None, notes
    collisions = _Collisions(model, geometry, robot, locked)
    names = tuple(f"{bodies[a][0]} and {bodies[b][0]}" for a, b in chosen)
    carriers = np.maximum(np.array([(bodies[a][1], bodies[b][1]) for a, b in chosen]), -1)
    narrow = [f"{name} ({1000 * m:.1f} mm)" for name, m in zip(names, margins, strict=True) if m < margin]
    if narrow:
        notes = (*notes, f"Nearly everywhere nearer to each other than the margin, and kept apart by less: {', '.join(narrow)}.")
    return Clearance(robot, names, carriers, margins, max(4.0 * margin, 0.05), collisions), notes


def _adjacent(robot: Robot, one: int, other: int) -> bool:
    """Whether two bodies never move against each other, or are neighbours at a joint; -1: the root, -2: the ground."""
    if -2 in (one, other):
        return one < 0 and other < 0

    def up(k: int) -> int:
        return -1 if k < 0 else int(robot.parent[k])

    return one == other or (one >= 0 and up(one) == other) or (other >= 0 and up(other) == one)


def _carriers(model: Any, robot: Robot) -> np.ndarray:
    """Index of the moving joint that carries what hangs on each of Pinocchio's joints, -1 for none."""
    index = {name: k for k, name in enumerate(robot.joint_names)}
    out = np.full(model.njoints, -1)
    for j in range(1, model.njoints):
        out[j] = index.get(str(model.names[j]), out[int(model.parents[j])])
    return out


def _with_geometry(robot: Robot) -> tuple[str, tuple[str, ...]]:
    """The URDF as text with absolute paths of meshes, without those that are not there; and a note of these."""
    root, urdf = robot.description.root, robot.urdf
    missing = []
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for shape in link.findall("collision"):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            path = _mesh_file(urdf.parent, mesh.get("filename", ""))
            if path is None:
                link.remove(shape)
                missing.append(str(link.get("name")))
            else:
                mesh.set("filename", str(path))
    notes = ()
    if missing:
        shown = ", ".join(dict.fromkeys(missing))
        notes = (f"{urdf.name}: collision meshes of {shown} are not there: these links are not checked for collisions",)
    return ET.tostring(root, encoding="unicode"), notes


def _mesh_file(folder: Path, name: str) -> Path | None:
    """Where a mesh is: beside the URDF or above it, by the longest part of its path that is there."""
    parts = Path(name.split("://", 1)[-1]).parts
    for skip in range(len(parts)):
        tail = Path(*parts[skip:])
        for place in [folder, *folder.absolute().parents[:3]]:
            if not tail.is_absolute() and (place / tail).is_file():
                return (place / tail).absolute()
    path = Path(name.split("://", 1)[-1])
    return path if path.is_absolute() and path.is_file() else None
