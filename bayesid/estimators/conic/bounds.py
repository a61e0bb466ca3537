"""What is known of bodies for sure: masses, centres of mass, and the space they fill, as linear bounds.

With the pseudo-inertia P of a body, the second moment of its mass in homogeneous coordinates, whatever quadratic form q is
positive on the space that the body fills, ``q(x) = [x; 1]' Q [x; 1] >= 0``, gives the linear bound ``tr(Q P) >= 0``, its mean
over the mass [Wensing2018]_. Together with P >= 0

* for an ellipsoid, the one form ``1 - (x - c)' S^-1 (x - c)`` is all there is: necessary and sufficient [Wensing2018]_;
* for a box, the products of any two of ``x_k - low_k`` and ``high_k - x_k``: necessary, and sufficient for every pair of axes
  [Anstreicher2010]_; it contains the bound on the centre of mass.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.argument_types import explains_types
from bayesid.errors import InputError, did_you_mean
from bayesid.estimators.conic.problem import Linear
from bayesid.robot import inertia
from bayesid.robot.robot import Robot


def collision_boxes(robot: Robot, locked: Mapping[str, float] | None = None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Box along its frame's axes that holds each body with collision geometry, for `Bounds.box` [m].

    The robot is loaded from a URDF with ``<collision>`` elements, ``locked`` are positions of locked joints as for
    `bayesid.load_robot`; a split sensor link has no box. An `InputError` where there is no geometry, or it cannot be read.
    """
    model = pin.buildModelFromXML(robot.description.text)
    try:
        folder = str(robot.urdf.parent)
        shapes = pin.buildGeomFromUrdfString(model, robot.description.text, pin.GeometryType.COLLISION, package_dirs=folder)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{robot.urdf.name}: collision geometry cannot be read ({reason}); give boxes in numbers") from None
    data, q = model.createData(), pin.neutral(model)
    for name, position in (locked or {}).items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [position] if joint.nq == 1 else [np.cos(position), np.sin(position)]
    pin.forwardKinematics(model, data, q)
    ids = {model.getJointId(name): name for name in robot.joint_names if name in robot.body_names}
    out: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for shape in shapes.geometryObjects:
        joint = int(shape.parentJoint)
        while joint and joint not in ids:
            joint = int(model.parents[joint])
        if not joint:
            continue
        placement = data.oMi[joint].inverse() * data.oMi[shape.parentJoint] * shape.placement
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        low, high = np.asarray(box.min_).reshape(3), np.asarray(box.max_).reshape(3)
        corners = np.array(list(product(*zip(low, high, strict=True))))
        corners = corners @ placement.rotation.T + placement.translation
        name = ids[joint]
        before = out.get(name, (corners[0], corners[0]))
        out[name] = np.minimum(before[0], corners.min(axis=0)), np.maximum(before[1], corners.max(axis=0))
    if not out:
        raise InputError(f"{robot.urdf.name} has no <collision> geometry on moving links; give boxes in numbers")
    return out


Range = tuple[float, float]
Corner = Sequence[float] | np.ndarray
Rotation = Sequence[float] | Sequence[Sequence[float]] | np.ndarray


@explains_types
@dataclass(frozen=True)
class Bounds:
    """Bounds on bodies by their names; frames are the bodies' (their joints'), as everywhere.

    Attributes
    ----------
    total_mass
        Of all moving bodies together (low, high) [kg]; infinite where there is none.
    mass
        Of a body (low, high) [kg].
    com
        Box that holds a body's centre of mass: lower and upper corner (3,), (3,) [m].
    ellipsoid
        Ellipsoid that a body's mass is in: centre (3,) and half axes (3,) [m], and where these are not along the body's frame,
        third, what turns them from there: a rotation matrix (3, 3), or roll, pitch and yaw (3,) [rad] as in a URDF.
    box
        Box that a body's mass is in: lower and upper corner (3,), (3,) [m]; see `collision_boxes`.
    """

    total_mass: Range | None = None
    mass: Mapping[str, Range] = field(default_factory=dict)
    com: Mapping[str, tuple[Corner, Corner]] = field(default_factory=dict)
    ellipsoid: Mapping[str, tuple[Corner, Corner] | tuple[Corner, Corner, Rotation]] = field(default_factory=dict)
    box: Mapping[str, tuple[Corner, Corner]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        total = {} if self.total_mass is None else {"total_mass": self.total_mass}
        for key, given in {**total, **_keys("mass", self.mass)}.items():
            if np.shape(given) != (2,):
                raise InputError(f"bounds: {key} = {given}: give [low, high]")
            low, high = given
            if not (float(low) <= float(high) and float(high) >= 0):
                raise InputError(f"bounds: {key} = [{low}, {high}]: give the lower bound, then the upper one")
        for key, (low, high) in {**_keys("com", self.com), **_keys("box", self.box)}.items():
            a, b = np.asarray(low, float), np.asarray(high, float)
            if a.shape != (3,) or b.shape != (3,) or not (a <= b).all():
                raise InputError(f"bounds: {key}: give the lower and the upper corner, three numbers each [m]")
            if key.startswith("box.") and not np.isfinite([a, b]).all():
                raise InputError(f"bounds: {key}: give finite corners, or bound the centre of mass only (com)")
        for key, (centre, axes, *turned) in _keys("ellipsoid", self.ellipsoid).items():
            c, h = np.asarray(centre, float), np.asarray(axes, float)
            if c.shape != (3,) or h.shape != (3,) or not (h > 0).all() or not np.isfinite([c, h]).all():
                raise InputError(f"bounds: {key}: give the centre and the three half axes above 0, three numbers each [m]")
            if len(turned) > 1 or not all(_is_rotation(r) for r in turned):
                raise InputError(
                    f"bounds: {key}: the third entry turns the half axes: give roll, pitch and yaw [rad], or a rotation matrix"
                )

    def __repr__(self) -> str:
        known = {f.name: getattr(self, f.name) for f in fields(self)}
        return f"Bounds({', '.join(f'{key}={value}' for key, value in known.items() if value)})"

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Bounds:
        """Bounds from a table such as a TOML file's.

        Parameters
        ----------
        table
            ``total_mass = [low, high]``, and tables ``mass``, ``com``, ``ellipsoid`` and ``box`` with one entry a body.

        Raises
        ------
        InputError
            A key is unknown or a value has another form.
        """
        known = [f.name for f in fields(cls)]
        for key in table:
            if key not in known:
                raise InputError(f"bounds: key '{key}' is unknown; {did_you_mean(key, known)}")
        out: dict[str, Any] = {}
        for key, value in table.items():
            entries = {key: value} if key == "total_mass" else value
            if not isinstance(entries, Mapping):
                raise InputError(f"bounds: {key} has to be a table with one entry a body")
            for name, pair in entries.items():
                nested = key not in ("total_mass", "mass")
                corners = pair[:2] if key == "ellipsoid" and isinstance(pair, list | tuple) and len(pair) == 3 else pair
                if not (_is_pair(corners, nested) and (corners is pair or _is_turn(pair[2]))):
                    form = "[[x, y, z], [x, y, z]]" if nested else "[low, high]"
                    form += ", or with [roll, pitch, yaw] third" if key == "ellipsoid" else ""
                    raise InputError(f"bounds: {key}{'' if key == 'total_mass' else f'.{name}'} = {pair}: give {form}")
            out[key] = tuple(value) if key == "total_mass" else {k: tuple(v) for k, v in value.items()}
        return cls(**out)

    def linear(self, names: Sequence[str], bodies: Sequence[Sequence[int]], columns: int) -> tuple[Linear, ...]:
        """The bounds as rows over so many columns, ten of each named body; an `InputError` where a bound names none."""
        where = dict(zip(names, bodies, strict=True))
        for name in [*self.mass, *self.com, *self.ellipsoid, *self.box]:
            if name not in where:
                raise InputError(f"bounds: there is no body '{name}'; {did_you_mean(name, names)}")
        out = []
        if self.total_mass is not None:
            total = np.zeros((1, columns))
            total[0, [b[0] for b in bodies]] = 1.0
            out.append(_between("total mass", total, *self.total_mass))
        for name, limits in self.mass.items():
            row = np.zeros((1, columns))
            row[0, where[name][0]] = 1.0
            out.append(_between(f"mass of {name}", row, *limits))
        for kind, regions, forms in (
            ("centre of mass", self.com, _com_forms),
            ("ellipsoid", self.ellipsoid, _ellipsoid_forms),
            ("box", self.box, _box_forms),
        ):
            for name, pair in regions.items():
                form = forms(*(np.asarray(part, float) for part in pair))
                rows = np.zeros((len(form), columns))
                # tr(Q P) is linear in the ten parameters.
                rows[:, list(where[name])] = np.einsum("qij,kij->qk", form, inertia.BASIS)
                out.append(Linear(f"{kind} of {name} {_text(kind, pair)}", rows, np.zeros(len(form))))
        return tuple(group for group in out if len(group.low))


@explains_types
def load_bounds(path: str | Path, robot: Robot | None = None, locked: Mapping[str, float] | None = None) -> Bounds:
    """Bounds from a TOML file; see `Bounds.from_dict`.

    Parameters
    ----------
    path
        The file.
    robot, locked
        For ``box = "collision"``: whose collision geometry, see `bayesid.estimators.conic.bounds.collision_boxes`.

    Raises
    ------
    InputError
        The file cannot be read, or its content is refused.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read as TOML: {error}") from None
    try:
        if table.get("box") == "collision":
            if robot is None:
                raise InputError('bounds: box = "collision" takes the robot\'s geometry: give load_bounds the robot, too')
            table["box"] = {name: [low.tolist(), high.tolist()] for name, (low, high) in collision_boxes(robot, locked).items()}
        return Bounds.from_dict(table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _keys(kind: str, table: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{kind}.{name}": value for name, value in table.items()}


def _is_pair(value: Any, nested: bool) -> bool:
    if not isinstance(value, list | tuple) or len(value) != 2:
        return False
    numbers = [n for part in value for n in part] if nested and all(isinstance(p, list | tuple) for p in value) else value
    return all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)


def _is_turn(value: Any) -> bool:
    """Whether a table's entry has the form of roll, pitch and yaw, or of a matrix."""
    rows = value if isinstance(value, list | tuple) and all(isinstance(p, list | tuple) for p in value) else [value]
    return all(_is_pair([row, row], True) for row in rows)


def _is_rotation(value: Any) -> bool:
    """Whether numbers are roll, pitch and yaw, or a rotation matrix."""
    r = np.asarray(value, float)
    if not np.isfinite(r).all() or r.shape not in ((3,), (3, 3)):
        return False
    return r.shape == (3,) or bool(np.abs(r @ r.T - np.eye(3)).max() < 1e-6 and np.linalg.det(r) > 0)


def _between(name: str, row: np.ndarray, low: float, high: float) -> Linear:
    keep = np.isfinite([low, high])
    text = f"in [{low:g}, {high:g}] kg" if keep.all() else f">= {low:g} kg" if keep[0] else f"<= {high:g} kg"
    return Linear(f"{name} {text}", np.concatenate([row, -row])[keep], np.array([low, -high])[keep])


def _text(kind: str, pair: Sequence[Any]) -> str:
    first, second = ("(" + ", ".join(f"{v:g}" for v in part) + ")" for part in pair[:2])
    turned = ", turned" if len(pair) > 2 else ""
    return f"with centre {first} and half axes {second} m{turned}" if kind == "ellipsoid" else f"between {first} and {second} m"


def _com_forms(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Faces of the box, ``m low <= h <= m high``; infinite corners bound nothing."""
    forms = []
    for k in range(3):
        for sign, value in ((1.0, low[k]), (-1.0, high[k])):
            if np.isfinite(value):
                forms.append(_form(sign * np.eye(3)[k], -sign * value, np.zeros(3), 1.0))
    return np.array(forms).reshape(-1, 4, 4)


def _ellipsoid_forms(centre: np.ndarray, axes: np.ndarray, rotation: np.ndarray | None = None) -> np.ndarray:
    """The form ``1 - (x - c)' S^-1 (x - c)`` with ``S = R diag(axes)^2 R'``."""
    inverse = np.diag(1.0 / axes**2)
    if rotation is not None:
        turn = rotation if rotation.ndim == 2 else pin.rpy.rpyToMatrix(*map(float, rotation))
        inverse = turn @ inverse @ turn.T
    out = np.zeros((1, 4, 4))
    out[0, :3, :3] = -inverse
    out[0, :3, 3] = out[0, 3, :3] = inverse @ centre
    out[0, 3, 3] = 1.0 - centre @ inverse @ centre
    return out


def _box_forms(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Products ``(x_k - low_k)(high_k - x_k)``, and those of the faces of different axes."""
    faces = [[(np.eye(3)[k], -low[k]), (-np.eye(3)[k], high[k])] for k in range(3)]
    forms = [_form(*faces[k][0], *faces[k][1]) for k in range(3)]
    forms += [_form(*f, *g) for i in range(3) for j in range(i) for f in faces[i] for g in faces[j]]
    return np.array(forms)


def _form(a: np.ndarray, a0: float, b: np.ndarray, b0: float) -> np.ndarray:
    """The symmetric matrix of the product ``(a'x + a0)(b'x + b0)``."""
    first, second = np.append(a, a0), np.append(b, b0)
    return 0.5 * (np.outer(first, second) + np.outer(second, first))
