"""The two TOML files a user writes, experiment.toml and model.toml: what they may hold, and one line when they do not.

Nothing here reads a table or a robot: these models know keys, types and ranges only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, ConfigDict, Field

from bayesid.arguments import argument
from bayesid.effects.library import by_number
from bayesid.errors import InputError
from bayesid.recordings.importing.column_map import UNITS, Columns, UnitSection
from bayesid.recordings.toml_file import File, Keys, Name, NonNegative, Number, Positive, Section, Vector3, as_file, read_toml
from bayesid.robot.robot import joint_index

Expressions = dict[str, dict[str, Any]]  # "cogging" -> {"tau2": "c * sin(3 * q2)", "parameters": {"c": {"unit": "N m"}}}
EffectParameters = dict[str, dict[str, float | bool]]  # "tether@joint3" -> {"stiffness": 40.0, "fixed": True}

_LONGEST_PATH = 1000


def _inside(text: str) -> str:
    """Refuse a path that leaves the experiment folder: folders come from others, and name only their own files."""
    windows = PureWindowsPath(text)
    if PurePosixPath(text).is_absolute() or windows.drive or windows.root or ".." in windows.parts:
        raise ValueError("name a file inside the experiment folder: no absolute path, no ..")
    if len(text) > _LONGEST_PATH or max(map(len, windows.parts), default=0) > 255 or not text.isprintable():
        raise ValueError("write a file's name that the system can have")
    return text


Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
FilePath = Annotated[str, Field(min_length=1), AfterValidator(_inside)]


def _effect(text: str) -> str:
    """Refuse what is not ``name`` or ``name@where``; which names exist is the effects' business, not the folder's."""
    name, at, where = text.partition("@")
    if not name.strip() or (at and not where.strip()) or text != text.strip():
        raise ValueError('write "name" or "name@where", as in "viscous_friction" or "tether@joint3"')
    return text


EffectName = Annotated[str, AfterValidator(_effect)]


class RobotSection(Section):
    """``[robot]``: the kinematics and what is known beforehand; angles in rad, gravity in m/s^2."""

    urdf: FilePath
    joints: Annotated[list[str], Field(min_length=1)]
    locked: dict[str, Number] = {}
    gravity: Vector3 = [0.0, 0.0, -9.81]
    inertia_rel_std: NonNegative | None = None
    position_resolution: NonNegative | None = None
    position_std: NonNegative | None = None
    gear_ratio: dict[str, Positive] = {}


class SensorSection(Section):
    """``[sensor]``: where the force/torque sensor is (m, rad) and its noise (N, N m)."""

    joint: str | None = None
    translation: Vector3 = [0.0, 0.0, 0.0]
    rpy: Vector3 = [0.0, 0.0, 0.0]
    force_std: NonNegative | None = None
    torque_std: NonNegative | None = None


class EffectValues(Section):
    """``[model.values."effect@where"]``: starting values by parameter name; ``fixed`` keeps them."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)
    if not TYPE_CHECKING:  # what pydantic reads is narrower than what its own class declares
        __pydantic_extra__: dict[str, Number]

    fixed: bool = False


class ExpressionParameter(Section):
    """``[model.expressions.NAME.parameters.KEY]``: one number in a user's formula."""

    unit: str = "1"
    lower: Number | None = None
    upper: Number | None = None
    start: Number | None = None
    typical: Number | None = None
    tried: list[Number] = []


class ExpressionSection(Section):
    """``[model.expressions.NAME]``: an effect of the user's own, as formulas by the reading that they add to."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)
    if not TYPE_CHECKING:  # as above
        __pydantic_extra__: dict[str, str]

    summary: str = ""
    parameters: dict[str, ExpressionParameter] = {}


class ModelSection(Section):
    """``[model]``: effects the user's model already has, and formulas of the user's own."""

    effects: list[EffectName] = []
    values: dict[EffectName, EffectValues] = {}
    expressions: dict[str, ExpressionSection] = {}


class MotionSection(Section):
    """``[[motion]]``: one recording; times in s."""

    name: Name
    role: Literal["identification", "validation"]
    kind: Literal["trajectory", "poses"] = "trajectory"
    table: FilePath
    static: FilePath | None = None
    period: Positive | None = None
    parked: list[Interval] = []
    chunked: bool | None = None


class ExperimentFile(Section):
    """The whole of experiment.toml."""

    format: Literal[1]
    name: Name
    robot: RobotSection
    sensor: SensorSection | None = None
    columns: Columns = {}
    units: UnitSection = UnitSection()
    model: ModelSection = ModelSection()
    motion: list[MotionSection] = []  # a setup for which motions are planned has none yet


class ModelFile(Section):
    """The whole of model.toml, which stands in for ``[model]`` of an experiment."""

    format: Literal[1] = 1
    model: ModelSection


# For suggestions only.
_KEYS: Keys = {
    ("robot",): RobotSection.model_fields,
    ("sensor",): SensorSection.model_fields,
    ("units",): ("scale", *UNITS),
    ("model",): ModelSection.model_fields,
    ("motion",): MotionSection.model_fields,
}


def read_file(path: Path, kind: type[File]) -> File:
    """Read an experiment.toml (`ExperimentFile`) or model.toml (`ModelFile`); InputError as `bayesid.recordings.toml_file`."""
    return read_toml(path, kind, _KEYS, "a model.toml, which holds a [model] table")


def read_model(path: str | Path) -> tuple[tuple[str, ...], EffectParameters, Expressions]:
    """Read a model.toml, which stands in for ``[model]``: the effects, their starting values, and the user's formulas."""
    section = read_file(Path(path), ModelFile).model
    check_effects(section.effects, Path(path).name)
    return model_parts(section)


def check_document(document: Mapping[str, Any]) -> None:
    """Refuse what is to be written as an experiment.toml and could not be read again."""
    as_file(document, ExperimentFile, _KEYS, "experiment.toml")


def write_model(
    effects: Iterable[str], values: EffectParameters, path: str | Path, expressions: Expressions | None = None
) -> None:
    """Write a model.toml for `read_model`."""
    Path(path).write_text(tomli_w.dumps({"model": dump_model(effects, values, expressions or {})}), encoding="utf-8")


def check_keys(file: ExperimentFile) -> list[str]:
    """Warnings of what experiment.toml says by itself, beyond types; an `InputError` where names contradict each other."""
    robot = file.robot
    for name in robot.joints:
        if robot.joints.count(name) > 1:
            raise InputError(f'experiment.toml: [robot] joints: "{name}" is listed twice; list each joint once')
        if name in robot.locked:
            raise InputError(f'experiment.toml: [robot] locked: "{name}" is in joints too; a joint moves or is locked')
    names = [motion.name for motion in file.motion]
    tables = {PurePosixPath(motion.table): motion.name for motion in file.motion}
    for index, motion in enumerate(file.motion):
        if motion.static is not None and PurePosixPath(motion.static) in tables:
            raise InputError(
                f'"{motion.static}" is the table of motion "{tables[PurePosixPath(motion.static)]}", in which the robot moves',
                file="experiment.toml", key=f"[motion.{index}] static", value=motion.static,
                remedy="name readings of the robot at rest, or remove it",
            )  # fmt: skip
        if motion.name in names[:index]:
            raise InputError(f'experiment.toml: [motion.{index}] name: "{motion.name}" is taken; give each its own name')
        if motion.kind == "poses" and (motion.period is not None or motion.parked):
            key = "parked" if motion.period is None else "period"
            raise InputError(f'experiment.toml: [motion.{index}] {key}: kind = "poses" has no times; remove it')
    if file.motion and not any(motion.role == "identification" for motion in file.motion):
        raise InputError(
            'experiment.toml: [motion.0] role: no motion has role "identification"; '
            'write role = "identification" for the motions to fit'
        )
    check_effects(file.model.effects, "experiment.toml")
    warnings = []
    strength = math.hypot(*robot.gravity)
    if not 9.7 < strength < 9.9:
        warnings.append(f"experiment.toml: [robot] gravity: {strength:.4g} m/s^2 is not the Earth's; correct it unless meant")
    rel_std = robot.inertia_rel_std
    if rel_std is not None and rel_std > 1.0:
        warnings.append(
            f"experiment.toml: [robot] inertia_rel_std: {rel_std:g} says that nothing is known of the links; it is a share, "
            "0.1 for ten per cent: correct it, or leave it out"
        )
    sensor = file.sensor
    if sensor is not None and max(map(abs, sensor.translation)) > 10.0:
        warnings.append(f"experiment.toml: [sensor] translation: {sensor.translation} m is far; in millimetres? write metres")
    if sensor is not None and max(map(abs, sensor.rpy)) > 2.0 * math.pi:
        warnings.append(f"experiment.toml: [sensor] rpy: {sensor.rpy} rad is more than a turn; is it in degrees? write radians")
    return warnings


def unlisted_values(effects: Iterable[str], values: Iterable[str], joints: Sequence[str]) -> list[str]:
    """Warnings of values that are of no effect of the model, listed by number or name of its joint, or for all of its kind."""
    listed = {by_number(effect, joints) for effect in effects}
    names = {effect.partition("@")[0] for effect in listed}
    return [
        f'experiment.toml: [model.values."{value}"]: effects does not list it; add it there, unless {argument("effects")} is to'
        for value in values
        if not ({by_number(value, joints), value.partition("@")[0]} & listed or value in names)
    ]


def joints_by_place(specs: Iterable[str], joints: Sequence[str]) -> list[str]:
    """Warnings of effects at a joint whose name in the URDF is the place of another in ``joints``, which it stands for."""
    out = []
    for spec in dict.fromkeys(specs):
        for name in spec.partition("@")[2].split("->"):
            at = joint_index(name, joints)
            if at is not None and name in joints and joints[at] != name:
                out.append(
                    f'experiment.toml: [model] "{spec}": {name} is place {at + 1} of joints, {joints[at]}, and not the URDF\'s '
                    f"{name}; write joint{joints.index(name) + 1}, if that is meant"
                )
    return out


def check_effects(effects: list[str], source: str) -> None:
    """Refuse an effect that is listed twice."""
    for effect in effects:
        if effects.count(effect) > 1:
            raise InputError(f'{source}: [model] effects: "{effect}" is listed twice; list it once')


def dump_model(
    effects: Iterable[str], values: Mapping[str, Mapping[str, float | bool]], expressions: Expressions
) -> dict[str, Any]:
    """Return the ``[model]`` table, ready for a TOML writer."""
    table: dict[str, Any] = {"effects": list(effects)}
    if values:
        table["values"] = {effect: dict(parameters) for effect, parameters in values.items()}
    if expressions:
        table["expressions"] = expressions
    return table


def model_parts(section: ModelSection) -> tuple[tuple[str, ...], EffectParameters, Expressions]:
    """Return the effects, their starting values (``fixed`` is there only where it is true) and the user's formulas."""
    values: EffectParameters = {}
    for effect, given in section.values.items():
        values[effect] = {k: float(v) for k, v in (given.__pydantic_extra__ or {}).items()}
        if given.fixed:
            values[effect]["fixed"] = True
    formulas = {name: given.model_dump(exclude_unset=True, exclude_none=True) for name, given in section.expressions.items()}
    return tuple(section.effects), values, formulas
