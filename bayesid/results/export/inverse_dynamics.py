"""Joint torques of an identified robot as code without dependencies: one C++ header, one NumPy module.

The torques are those of rigid bodies, by the recursion of [Luh1980]_ over the tree in each joint's own frame, and of what acts
inside the joints. Bodies are given by the base parameters alone: links that have them in the kept columns and nothing elsewhere
move as the robot does. The torques' standard deviation is ``sqrt(y' C y)`` with C the covariance of base and effect parameters
and y the row of the regressor, which the same recursion gives, column by column.

The laws of what acts inside a joint are text that is C++ and Python alike. Each says what the class of the same name in
`bayesid.effects` computes; a test compares the two.
"""

from __future__ import annotations

import functools
import json
import re
from dataclasses import dataclass

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from scipy.stats import norm

from bayesid.dynamics.base_parameters import spanned, structural_base
from bayesid.dynamics.channels import torque_channels
from bayesid.effects.built_in import CLASSES
from bayesid.effects.families import SensorEffect
from bayesid.effects.segment import REST_SPEED
from bayesid.regression.linalg import SHARE_OF_CHANGE, SHARE_OF_ROW, unshown
from bayesid.results.export.identified import IdentifiedRobot
from bayesid.robot import inertia
from bayesid.robot.robot import Robot
from bayesid.rounding import LEVEL

#: Torque [N m or N], then its derivatives with respect to the parameters, in the order of the effect's own: ``q, v, a`` are
#: of the joint, ``s`` is the velocity's sign with a narrow ramp, ``l`` the torque that moves and carries the links, ``p0 ...``
#: are the parameters.
LAWS: dict[str, tuple[str, ...]] = {
    "viscous_friction": ("p0 * v", "v"),
    "directional_friction": ("p0 * abs(v)", "abs(v)"),
    "coulomb_friction": ("p0 * s", "s"),
    "posture_friction": ("(p0 * cos(q) + p1 * sin(q)) * s", "cos(q) * s", "sin(q) * s"),
    "stribeck_friction": (
        "p0 * exp(-(v / p1) * (v / p1)) * s",
        "exp(-(v / p1) * (v / p1)) * s",
        "p0 * exp(-(v / p1) * (v / p1)) * s * 2.0 * (v / p1) * (v / p1) / p1",
    ),
    "load_friction": ("p0 * abs(l) * s", "abs(l) * s"),
    "torque_offset": ("p0", "1.0"),
    "rotor_inertia": ("p0 * a", "a"),
    "torque_ripple": ("p0 * sin(p1 * q + p2)", "sin(p1 * q + p2)", "p0 * q * cos(p1 * q + p2)", "p0 * cos(p1 * q + p2)"),
    "spring": ("p0 * (q - p1)", "q - p1", "-p0"),
}
#: Derivatives of the torque with respect to ``l``, where it depends on it; ``sign`` is 0 at 0.
PER_LOAD = {"load_friction": "p0 * sign(l) * s"}
#: Speed at which the ramp of ``s`` ends [rad/s or m/s].
RAMP = REST_SPEED
#: Stribeck velocity below which there is none [rad/s or m/s]: it is divided by.
_SLOWEST = 1e-9


@dataclass(frozen=True)
class JointLaw:
    """An effect inside a joint with its values."""

    spec: str  # ``name@where``
    name: str  # a key of `LAWS`
    joint: int  # index of the joint
    values: tuple[float, ...]  # of the effect's parameters (k,)
    columns: tuple[int | None, ...]  # where each of them stands among the estimated parameters; None: it is fixed (k,)

    @property
    def torque(self) -> str:
        """Write its torque as an expression of ``q, v, a, s, l``."""
        return self._filled(LAWS[self.name][0])

    @property
    def per_load(self) -> str | None:
        """Its derivative with respect to the links' torque; None where it does not depend on that."""
        return self._filled(PER_LOAD[self.name]) if self.name in PER_LOAD else None

    @property
    def derivatives(self) -> list[tuple[int, str]]:
        """Column and derivative of each parameter that was estimated."""
        texts = zip(self.columns, LAWS[self.name][1:], strict=True)
        return [(column, self._filled(text)) for column, text in texts if column is not None]

    def _filled(self, text: str) -> str:
        values = list(self.values)
        if self.name == "stribeck_friction":
            values[1] = max(values[1], _SLOWEST)
        return re.sub(r"\bp(\d)\b", lambda found: f"({float(values[int(found[1])])!r})", text)


#: Effects of the force/torque sensor, which no torque holds.
_SENSOR = {kind.name for kind in CLASSES if issubclass(kind, SensorEffect)}
_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Torques of all joints, linear in parameters."""

    robot: Robot  # kinematics
    #: The joint whose link each of the first r columns belongs to (r,), and its ten parameters in that joint's frame (r, 10).
    bodies: tuple[np.ndarray, np.ndarray]
    laws: tuple[JointLaw, ...]  # what acts inside the joints, whose estimated parameters have the other columns
    names: tuple[str, ...]  # of the parameters (k,)
    #: Of the parameters (k,), (k, k); None where there is none.
    values: np.ndarray
    covariance: np.ndarray | None
    hidden: np.ndarray  # changes of the parameters, of unit length, that the data do not show (k, m)
    left_out: tuple[str, ...]  # effects of the model that are not in it, ``name@where``
    foreign: int = 0  # how many of the r are no combination of what was identified


def inverse_dynamics(found: IdentifiedRobot) -> InverseDynamics:
    """The model of the joints' torques behind an estimate, whichever readings it is from.

    Base parameters b of the torques follow from those identified by ``b = T beta``, their covariance by ``T C T'``. Where one is
    no such combination, the value is that of the links of ``identified.urdf`` and nothing is said of its uncertainty.
    """
    robot = found.robot
    base = structural_base(robot, torque_channels(robot))
    through, inside = spanned(base.matrix, found.base.matrix)
    foreign = ~inside
    through[np.abs(through) < 1e-12 * np.abs(through).max(axis=1, keepdims=True, initial=0.0)] = 0.0
    laws, columns, left_out = _laws(found, base.rank)
    whole = np.zeros((base.rank + len(columns), len(found.solution)))
    whole[: base.rank, : found.base.rank] = through
    whole[base.rank + np.arange(len(columns)), columns] = 1.0
    values = whole @ found.solution
    if foreign.any():
        values[: base.rank][foreign] = 0.0 if found.links is None else (base.matrix @ found.links)[foreign]
    covariance, hidden = None, np.zeros((len(values), 0))
    if found.covariance is not None:
        own = np.where(np.isfinite(found.covariance), found.covariance, 0.0)
        covariance, left_open = whole @ own @ whole.T, whole @ unshown(own, found.undetermined)
        left_open = left_open[:, np.linalg.norm(left_open, axis=0) > _NOTHING]  # no torque holds a sensor's offset
        hidden = np.hstack([left_open / np.linalg.norm(left_open, axis=0), np.eye(len(values))[:, : base.rank][:, foreign]])
    names = (*base.names, *(found.effect_names[c - found.base.rank] for c in columns))
    return InverseDynamics(
        robot, _bodies(robot, base.independent), laws, names, values, covariance, hidden, left_out,
        int(foreign.sum()),
    )  # fmt: skip


def _laws(found: IdentifiedRobot, rank: int) -> tuple[tuple[JointLaw, ...], list[int], tuple[str, ...]]:
    """Laws inside the joints, the columns of the solution that they take, and effects that have no law."""
    laws, columns, left_out = [], [], []
    for effect in found.effects:
        if effect.joint is None or effect.name not in LAWS:
            left_out += [effect.spec] * (effect.name not in _SENSOR)
            continue
        own: list[int | None] = []
        for key in effect.parameters:
            column = found.effect_columns.get(f"{effect.spec}.{key}")
            own.append(None if column is None else rank + len(columns))
            columns += [] if column is None else [column]
        values = tuple(value for value, _ in effect.parameters.values())
        laws.append(JointLaw(effect.spec, effect.name, effect.joint, values, tuple(own)))
    return tuple(laws), columns, tuple(left_out)


def _bodies(robot: Robot, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which joint moves the body of each of some columns, and the ten parameters of a unit of it in that joint's frame."""
    body = columns // 10
    units = np.eye(10)[columns % 10]
    placed = [
        inertia.transform(unit, robot.body_rotation[b], robot.body_translation[b]) if b >= robot.n else unit
        for b, unit in zip(body.tolist(), units, strict=True)
    ]
    return robot.body_joint[body], np.array(placed).reshape(-1, 10)


def source_code(file: str, found: IdentifiedRobot, model: InverseDynamics) -> str:
    """Torques, their standard deviations and the 95 % band as source code, by the name of its file.

    A self-contained C++17 header, ``inverse_dynamics.hpp``, or a Python module that needs NumPy alone, ``inverse_dynamics.py``.
    """
    robot = model.robot
    joint, ten = model.bodies
    links = np.zeros((robot.n, 10))
    np.add.at(links, joint, model.values[: len(joint), None] * ten)
    return _environment().get_template(f"{file}.txt").render(
        found=found, model=model, robot=robot, n=robot.n, count=len(model.values), rank=len(joint), order=robot.order,
        body_joint=joint, body_ten=ten, links=links, covariance=model.covariance, half=float(norm.ppf(0.5 * (1.0 + LEVEL))),
        loaded=any(law.per_load for law in model.laws), level=LEVEL, ramp=RAMP,
        share_of_change=SHARE_OF_CHANGE, share_of_row=SHARE_OF_ROW,
    )  # fmt: skip


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("bayesid.results.export", "templates"), autoescape=False, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {
        "braces": lambda a: _nested(a, "{", "}"), "brackets": lambda a: _nested(a, "[", "]"), "cpp": _cpp,
        "quoted": json.dumps, "plain": _plain,
    }  # fmt: skip
    return environment


def _plain(text: str) -> str:
    """A name as it may stand in a comment of either language."""
    return re.sub(r'[\\"]', "'", "".join(c if c.isprintable() else " " for c in text))


def _cpp(law: str, joint: int) -> str:
    """A law of one joint with what it takes from the arrays of all joints."""
    return re.sub(r"\b[qva]\b", lambda found: f"{found[0]}[{joint}]", re.sub(r"\b([sl])\b", r"\1_", law))


def _nested(array: np.ndarray, opening: str, closing: str) -> str:
    """Numbers with all their digits, between braces or brackets; one line a row."""
    array = np.asarray(array)
    if array.ndim > 1:
        return opening + "\n    " + ",\n    ".join(_nested(row, opening, closing) for row in array) + closing
    texts = [str(int(x)) if array.dtype.kind in "bi" else repr(float(x)) for x in array]
    return opening + ", ".join(texts) + closing
