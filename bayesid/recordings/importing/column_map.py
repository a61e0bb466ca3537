"""Which column of a log is which, and in which unit: what a user states of files of another tool."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, suggest
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.recordings.toml_file import Keys, Number, Section, read_toml

#: Quantities of one number a joint, and those of the wrench, of three or six.
JOINT_QUANTITIES = ("q", "v", "qr", "tau")
AXES = {"wrench": WRENCH_COLUMNS, "f": WRENCH_COLUMNS[:3], "m": WRENCH_COLUMNS[3:]}
_LONGEST_SHIFT = 1e6  # [s]
_ONE = re.compile(r"(qr|q|v|tau)([1-9]\d*)")
_TURN = 2.0 * math.pi
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "turn": _TURN}
_LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
_RATE = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "turn/s": _TURN, "rpm": _TURN / 60.0}
_SPEED = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2}
_FORCE, _MOMENT = {"N": 1.0, "kN": 1e3, "mN": 1e-3}, {"N m": 1.0, "N mm": 1e-3, "N cm": 1e-2, "mN m": 1e-3, "kN m": 1e3}
#: Units of readings that say nothing of a torque without a constant of the joint.
NEED_CONSTANT = {"A": 1.0, "mA": 1e-3, "V": 1.0, "counts": 1.0, "%": 1.0}
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Units of a quantity: the first is the one that bayesid computes in.
UNITS: dict[str, dict[str, float]] = {
    "t": {**_TIME, "iso": math.nan}, "q": {**_ANGLE, **_LENGTH}, "v": {**_RATE, **_SPEED}, "qr": {**_ANGLE, **_LENGTH},
    "tau": {**_MOMENT, **_FORCE, **NEED_CONSTANT}, "f": _FORCE, "m": _MOMENT,
}  # fmt: skip
#: Those of a joint's quantity, if it turns and if it slides.
_OF_JOINT = {"q": (_ANGLE, _LENGTH), "v": (_RATE, _SPEED), "qr": (_ANGLE, _LENGTH), "tau": (_MOMENT, _FORCE)}
_SPELT = {"nm": "N m", "degree": "deg", "degrees": "deg", "°": "deg", "°/s": "deg/s", "radians": "rad", "radian": "rad",
          "sec": "s", "seconds": "s", "second": "s", "msec": "ms", "milliseconds": "ms", "µs": "us", "μs": "us", "usec": "us",
          "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "newton": "N", "rev": "turn", "rev/s": "turn/s",
          "amps": "A", "ampere": "A", "rads": "rad/s", "degs": "deg/s"}  # fmt: skip
#: Words of each quantity; a joint's name or number stands beside them.
_WORDS = {
    "q": ("q", "pos", "position", "positions", "angle", "angles", "theta", "actual_q", "joint_pos", "joint_position",
          "joint_positions", "qpos"),
    "v": ("v", "qd", "dq", "qdot", "vel", "velocity", "velocities", "actual_qd", "joint_vel", "joint_velocity",
          "joint_velocities", "qvel"),
    "qr": ("qr", "q_ref", "q_des", "q_d", "q_desired", "q_cmd", "target_q", "position_command", "commanded"),
    "tau": ("tau", "eff", "effort", "efforts", "torque", "torques", "tau_j", "joint_torque", "joint_torques", "qfrc"),
}  # fmt: skip
#: The quantity of each word.
QUANTITY_OF_WORD = {word: quantity for quantity, words in _WORDS.items() for word in words}
#: A unit in brackets at the end of a name.
UNIT_OF_NAME = re.compile(r"\s*[\[(]\s*([^\[\]()]+?)\s*[\])]$")


class UnitSection(Section):
    """``[units]``: a unit by quantity or column, and factors in ``[units.scale]``."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    scale: dict[str, Number] = {}


def _name_or_names(value: Any) -> str | list[str]:
    if isinstance(value, str) or (isinstance(value, list) and all(isinstance(part, str) for part in value)):
        return value
    raise ValueError('write a column\'s name, "Time", or a list of them')


Columns = dict[str, Annotated[Any, AfterValidator(_name_or_names)]]


class _MapFile(Section):
    columns: Columns = {}
    units: UnitSection = UnitSection()
    joints: dict[str, str] = {}
    shift: dict[str, Number] = {}


_KEYS: Keys = {(): ("columns", "units", "joints", "shift"), ("units",): ("scale", *UNITS)}


@dataclass(frozen=True)
class ColumnMap:
    """Names and units of a log's columns."""

    #: The log's names by ours: of ``t`` (a list: one for each of several files), of one column (``q1``, ``tau3``, ``fx``), or
    #: of a quantity (``q``, ``v``, ``qr``, ``tau``, ``wrench``, ``f``, ``m``): a list, an array (``"state[0:6]"``) or a pattern
    #: with ``{joint}``, ``{1}`` or ``{0}``, which stand for the joint's name and for its number counted from one or from zero.
    #: ``{file}`` stands for the recording's name, after which numbers without names are called.
    columns: Mapping[str, str | Sequence[str]] = field(default_factory=dict)
    #: By quantity (``t``, ``q``, ``v``, ``qr``, ``tau``, ``f``, ``m``) or column.
    units: Mapping[str, str] = field(default_factory=dict)
    #: Factors that columns are multiplied with after their unit, by quantity, column, or joint's name (of its torque).
    scale: Mapping[str, float] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)  # the log's names of joints by the URDF's, where they differ
    #: What is added to the times of a quantity [s], by ``q``, ``v``, ``qr``, ``tau`` or ``wrench``: -0.03 where it is 30 ms
    #: late.
    shift: Mapping[str, float] = field(default_factory=dict)
    file: str = ""  # where they were stated, for messages

    def __post_init__(self) -> None:
        """Check the keys and units; names of joints and of columns are the robot's and the log's business."""
        wrong = partial(InputError, file=self.file)
        for key in self.columns:
            if key not in ("t", *JOINT_QUANTITIES, *AXES, *WRENCH_COLUMNS) and not _ONE.fullmatch(key):
                remedy = suggest(key, ("t", "q", "v", "qr", "tau", "wrench", "q1", "tau1", *WRENCH_COLUMNS), "write one of")
                raise wrong(f'"{cut(key)}" is no column of ours', key="columns", value=key, remedy=remedy)
        for key, by in self.scale.items():
            if not (math.isfinite(by) and by):
                raise wrong(f"{cut(key)} = {by:g} is no factor", key="units.scale", value=by, remedy="write a number but 0")
        for key, by in self.shift.items():
            if key not in (*JOINT_QUANTITIES, "wrench") or not abs(by) <= _LONGEST_SHIFT:
                remedy = f"write seconds, up to {_LONGEST_SHIFT:g}, by q, v, qr, tau or wrench"
                raise wrong(f"{cut(key)} = {by:g} is no shift of a quantity", key="shift", value=by, remedy=remedy)
        checked = {}
        for key, text in self.units.items():
            quantity = quantity_of(key)
            if not quantity:
                remedy = suggest(key, UNITS, "write one of")
                raise wrong(f'"{cut(key)}" is no quantity or column of ours', key="units", value=key, remedy=remedy)
            checked[key] = known_unit(quantity, text)
            if checked[key] is None:
                remedy = suggest(text, UNITS[quantity], "write one of")
                raise wrong(f'"{cut(text)}" is no unit here', key=f"units {key}", value=text, remedy=remedy)
        object.__setattr__(self, "units", checked)

    def unit(self, column: str) -> str | None:
        """The unit stated for one of our columns; None where none is."""
        return self.units.get(column, self.units.get(quantity_of(column)))

    def factor(self, column: str, joint: str = "") -> float | None:
        """The factor stated for one of our columns; None where none is."""
        found = [self.scale[key] for key in (column, quantity_of(column)) if key in self.scale]
        if column.startswith("tau") and joint in self.scale:
            found.insert(0, self.scale[joint])
        return found[0] if found else None

    def names(self) -> list[str]:
        """Every name of a column of the log, or of an array or pattern of them."""
        return [text for given in self.columns.values() for text in ([given] if isinstance(given, str) else given)]

    def of_file(self, name: str) -> ColumnMap:
        """The same with a recording's name where ``{file}`` stands for it."""

        def named(given: str | Sequence[str]) -> str | list[str]:
            return given.replace("{file}", name) if isinstance(given, str) else [one.replace("{file}", name) for one in given]

        return replace(self, columns={key: named(given) for key, given in self.columns.items()})

    def names_of(self, joints: Sequence[str]) -> list[str]:
        """The log's names of joints."""
        return [self.joints.get(joint, joint) for joint in joints]

    def check_joints(self, joints: Sequence[str]) -> None:
        """Refuse names of what is no joint, and factors of what is neither a quantity, a column nor a joint."""
        wrong = partial(InputError, file=self.file)
        for joint in self.joints:
            if joint not in joints:
                remedy = suggest(joint, joints, "write one of")
                raise wrong(f'"{cut(joint)}" is no moving joint of the URDF', key="joints", value=joint, remedy=remedy)
        for key in self.scale:
            if not quantity_of(key) and key not in joints:
                remedy = suggest(key, (*joints, "tau1", *UNITS), "write one of")
                raise wrong(f'"{cut(key)}" is neither a column nor a joint', key="units.scale", value=key, remedy=remedy)

    def check_numbers(self, joints: int) -> None:
        """Refuse what is stated of a column of more joints than there are."""
        for section, keys in (("columns", self.columns), ("units", self.units), ("units.scale", self.scale)):
            for key in keys:
                if (one := _ONE.fullmatch(key)) and int(one[2]) > joints:
                    problem = f"there {'is' if joints == 1 else 'are'} {joints} joint{'s' * (joints != 1)}"
                    raise InputError(
                        problem, file=self.file, key=f"{section} {key}", value=key, remedy=f"write one up to {one[1]}{joints}"
                    )


def quantity_of(column: str) -> str:
    """The quantity, a key of `UNITS`, of a column or quantity of ours; empty where it is neither."""
    if column in UNITS:
        return column
    if column in WRENCH_COLUMNS:
        return column[0]
    one = _ONE.fullmatch(column)
    return one[1] if one else ""


def unit_of_joint(quantity: str, unit: str | None, slides: bool) -> str | None:
    """The unit of a quantity, as it is stated for all joints, for one that turns or slides; None where it can be none of it.

    Where none is stated, or the other kind's unit that is 1 (rad for m), it is the one that bayesid computes in.
    """
    own = _OF_JOINT[quantity][slides] if quantity in _OF_JOINT else UNITS[quantity]
    if unit is None or (unit not in own and unit not in NEED_CONSTANT and UNITS[quantity][unit] == 1.0):
        return next(iter(own))
    return unit if unit in own or unit in NEED_CONSTANT else None


def foreign_unit(quantity: str, column: str) -> str | None:
    """The unit that a column's name states, where it is one of other quantities only; else None."""
    match = UNIT_OF_NAME.search(column)
    if match is None or match[1].isdigit() or known_unit(quantity, match[1]) is not None:
        return None
    return next((unit for other in UNITS if (unit := known_unit(other, match[1])) is not None), None)


def known_unit(quantity: str, text: str) -> str | None:
    """The unit of a quantity (a key of `UNITS`) that is meant by a text, in the spelling of `UNITS`; None where it is none."""
    plain = re.sub(r"[\s·*.-]", "", text)
    spelt = {re.sub(r"\s", "", unit): unit for unit in UNITS[quantity]}
    if plain in spelt:
        return spelt[plain]
    meant = _SPELT.get(plain.lower())
    if meant is None:
        meant = {key.lower(): unit for key, unit in spelt.items()}.get(plain.lower())
    return meant if meant in UNITS[quantity] else None


def load_column_map(path: str | Path) -> ColumnMap:
    """Read a TOML file with sections ``[columns]``, ``[units]``, ``[units.scale]``, ``[joints]`` and ``[shift]``."""
    path = Path(path)
    given = read_toml(path, _MapFile, _KEYS, "a TOML file with [columns] and [units]")
    return replace(column_map(given.columns, given.units, given.joints, path.name), shift=given.shift)


def column_map(columns: Columns, units: UnitSection, joints: Mapping[str, str], file: str) -> ColumnMap:
    """What sections of a TOML file state; an `InputError` where a key is none of ours, or a unit is unknown."""
    given = dict(units.__pydantic_extra__ or {})
    for key, unit in given.items():
        if not isinstance(unit, str):
            raise InputError(f"{cut(str(unit))} is not a text", file=file, key=f"[units] {key}", value=unit, remedy='write "deg"')
    return ColumnMap(columns, given, units.scale, joints, file=file)


#: A column that ends in a number, which may stand in brackets.
NUMBERED = re.compile(r"(.*?)[\s_./\-\[(]*(\d+)[\])]?")


def without_unit(column: str) -> str:
    """A column's name without the unit that it states."""
    match = UNIT_OF_NAME.search(column)
    unit = match and not match[1].isdigit() and any(known_unit(quantity, match[1]) for quantity in UNITS)
    return column[: match.start()] if match and unit else column


def numbered(name: str) -> tuple[str, int] | None:
    """The quantity and the number of a column that is a word of a quantity with a number (``torque2``: tau, 2), else None."""
    match = NUMBERED.fullmatch(without_unit(name))
    quantity = QUANTITY_OF_WORD.get(match[1].lower()) if match else None
    return (quantity, int(match[2])) if match and quantity else None
