"""Which column of a log is which, and in which unit: what a user states of files of another tool."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, suggest
from bayesid.recordings.importing.units import UNITS, check_unit
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.recordings.toml_file import Keys, Number, Section, read_toml

#: Quantities of one number a joint, and those of the wrench, of three or six.
JOINT_QUANTITIES = ("q", "v", "qr", "tau")
AXES = {"wrench": WRENCH_COLUMNS, "f": WRENCH_COLUMNS[:3], "m": WRENCH_COLUMNS[3:]}
_LONGEST_SHIFT = 1e6  # [s]
_ONE = re.compile(r"(qr|q|v|tau)([1-9]\d*)")


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
        for key in self.columns:
            if key not in ("t", *JOINT_QUANTITIES, *AXES, *WRENCH_COLUMNS) and not _ONE.fullmatch(key):
                raise InputError(
                    f'"{cut(key)}" is no column of ours', file=self.file, key="columns", value=key,
                    remedy=suggest(key, ("t", "q", "v", "qr", "tau", "wrench", "q1", "tau1", *WRENCH_COLUMNS), "write one of"),
                )  # fmt: skip
        for key, by in self.scale.items():
            if not (math.isfinite(by) and by):
                problem = f"{cut(key)} = {by:g} is no factor"
                raise InputError(problem, file=self.file, key="units.scale", value=by, remedy="write a number but 0")
        for key, by in self.shift.items():
            if key not in (*JOINT_QUANTITIES, "wrench") or not abs(by) <= _LONGEST_SHIFT:
                raise InputError(
                    f"{cut(key)} = {by:g} is no shift of a quantity", file=self.file, key="shift", value=by,
                    remedy=f"write seconds, up to {_LONGEST_SHIFT:g}, by q, v, qr, tau or wrench",
                )  # fmt: skip
        checked = {}
        for key, unit in self.units.items():
            quantity = quantity_of(key)
            if not quantity:
                raise InputError(
                    f'"{cut(key)}" is no quantity or column of ours', file=self.file, key="units", value=key,
                    remedy=suggest(key, UNITS, "write one of"),
                )  # fmt: skip
            checked[key] = check_unit(quantity, unit, self.file, f"units {key}")
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

    def names_of(self, joints: Sequence[str]) -> list[str]:
        """The log's names of joints."""
        return [self.joints.get(joint, joint) for joint in joints]

    def check_joints(self, joints: Sequence[str]) -> None:
        """Refuse names of what is no joint, and factors of what is neither a quantity, a column nor a joint."""
        for joint in self.joints:
            if joint not in joints:
                raise InputError(
                    f'"{cut(joint)}" is no moving joint of the URDF', file=self.file, key="joints", value=joint,
                    remedy=suggest(joint, joints, "write one of"),
                )  # fmt: skip
        for key in self.scale:
            if not quantity_of(key) and key not in joints:
                raise InputError(
                    f'"{cut(key)}" is neither a column nor a joint', file=self.file, key="units.scale", value=key,
                    remedy=suggest(key, (*joints, "tau1", *UNITS), "write one of"),
                )  # fmt: skip


def quantity_of(column: str) -> str:
    """The quantity, a key of `UNITS`, of a column or quantity of ours; empty where it is neither."""
    if column in UNITS:
        return column
    if column in WRENCH_COLUMNS:
        return column[0]
    one = _ONE.fullmatch(column)
    return one[1] if one else ""


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
