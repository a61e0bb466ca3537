"""The two TOML files a user writes, experiment.toml and model.toml: what they may hold, and one line when they do not.

Nothing here reads a table or a robot: these models know keys, types and ranges only.
"""

from __future__ import annotations

import difflib
import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from bayesid.errors import InputError

EffectParameters = dict[str, dict[str, float | bool]]  # "tether@joint3" -> {"stiffness": 40.0, "fixed": True}

NonNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
FilePath = Annotated[str, Field(min_length=1)]


def _plain_name(text: str) -> str:
    """Refuse a name that cannot be a folder name or an item of a comma-separated option."""
    if not text.strip() or text.startswith(".") or any(c in '/\\,"' or not c.isprintable() for c in text):
        raise ValueError('write a name without / \\ , " and line breaks, not starting with a dot')
    return text


Name = Annotated[str, AfterValidator(_plain_name)]


def _effect(text: str) -> str:
    """Refuse what is not ``name`` or ``name@where``; which names exist is the effects' business, not the folder's."""
    name, at, where = text.partition("@")
    if not name.strip() or (at and not where.strip()) or text != text.strip():
        raise ValueError('write "name" or "name@where", as in "viscous_friction" or "tether@joint3"')
    return text


EffectName = Annotated[str, AfterValidator(_effect)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class RobotSection(_Section):
    """``[robot]``: the kinematics and what is known beforehand; angles in rad, gravity in m/s^2."""

    urdf: FilePath
    joints: Annotated[list[str], Field(min_length=1)]
    locked: dict[str, float] = {}
    gravity: Vector3 = [0.0, 0.0, -9.81]
    inertia_rel_std: NonNegative | None = None
    position_resolution: NonNegative | None = None
    position_std: NonNegative | None = None
    gear_ratio: dict[str, Positive] = {}


class SensorSection(_Section):
    """``[sensor]``: where the force/torque sensor is (m, rad) and its noise (N, N m)."""

    joint: str | None = None
    translation: Vector3 = [0.0, 0.0, 0.0]
    rpy: Vector3 = [0.0, 0.0, 0.0]
    force_std: NonNegative | None = None
    torque_std: NonNegative | None = None


class EffectValues(_Section):
    """``[model.values."effect@where"]``: starting values by parameter name; ``fixed`` keeps them."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)
    __pydantic_extra__: dict[str, float]  # pyright: ignore[reportIncompatibleVariableOverride]

    fixed: bool = False


class ModelSection(_Section):
    """``[model]``: effects the user's model already has."""

    effects: list[EffectName] = []
    values: dict[EffectName, EffectValues] = {}


class MotionSection(_Section):
    """``[[motion]]``: one recording; times in s."""

    name: Name
    role: Literal["identification", "validation"]
    kind: Literal["trajectory", "poses"] = "trajectory"
    table: FilePath
    static: FilePath | None = None
    period: Positive | None = None
    parked: list[Interval] = []


class ExperimentFile(_Section):
    """The whole of experiment.toml."""

    format: Literal[1]
    name: Name
    robot: RobotSection
    sensor: SensorSection | None = None
    model: ModelSection = ModelSection()
    motion: Annotated[list[MotionSection], Field(min_length=1)]


class ModelFile(_Section):
    """The whole of model.toml, which stands in for ``[model]`` of an experiment."""

    format: Literal[1] = 1
    model: ModelSection


File = TypeVar("File", ExperimentFile, ModelFile)

# The keys a section may have, by the path to it without list indices: for suggestions only.
_KEYS: dict[tuple[str, ...], Iterable[str]] = {
    ("robot",): RobotSection.model_fields,
    ("sensor",): SensorSection.model_fields,
    ("model",): ModelSection.model_fields,
    ("motion",): MotionSection.model_fields,
}


def read_file(path: Path, kind: type[File]) -> File:
    """Read a TOML file into its model.

    Parameters
    ----------
    path
        The file.
    kind
        `ExperimentFile` or `ModelFile`.

    Raises
    ------
    InputError
        When the file is absent, unreadable, not UTF-8, not TOML, or holds a wrong key or value.
    """
    try:
        data = tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a model.toml, which holds a [model] table") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path.name}: line {line}: byte 0x{error.object[error.start]:02x} is not UTF-8; save the file as UTF-8"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name}: not valid TOML: {_one_line(str(error))}; correct it there") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file") from None
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        # A misspelt key often shows twice, as an unknown key and as a missing one: the first says more.
        details = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
        raise InputError(f"{path.name}: {_describe(details[0], kind)}") from None


def suggest(word: str, known: Iterable[str], are: str = "known") -> str:
    """Return ``did you mean "x"?`` for the nearest known word, or the list of them when none is near."""
    known = [str(k) for k in known]
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if near:
        return f'did you mean "{near[0]}"?'
    return f"{are}: {', '.join(known)}"


def read_model(path: str | Path) -> tuple[tuple[str, ...], EffectParameters]:
    """Read a model.toml, which stands in for ``[model]``: the effects and their starting values.

    Raises
    ------
    InputError
        The file is absent or holds anything else.
    """
    section = read_file(Path(path), ModelFile).model
    check_effects(section.effects, Path(path).name)
    return model_parts(section)


def write_model(effects: Iterable[str], values: EffectParameters, path: str | Path) -> None:
    """Write a model.toml for `read_model`."""
    Path(path).write_text(tomli_w.dumps({"model": dump_model(effects, values)}), encoding="utf-8")


def check_keys(file: ExperimentFile) -> list[str]:
    """Check what experiment.toml says by itself, beyond types: names that repeat or contradict each other.

    Returns
    -------
    warnings
        One line each.

    Raises
    ------
    InputError
        For the first contradiction.
    """
    robot = file.robot
    for name in robot.joints:
        if robot.joints.count(name) > 1:
            raise InputError(f'experiment.toml: [robot] joints: "{name}" is listed twice; list each joint once')
        if name in robot.locked:
            raise InputError(f'experiment.toml: [robot] locked: "{name}" is in joints too; a joint moves or is locked')
    names = [motion.name for motion in file.motion]
    for index, motion in enumerate(file.motion):
        if motion.name in names[:index]:
            raise InputError(f'experiment.toml: [motion.{index}] name: "{motion.name}" is taken; give each its own name')
        if motion.kind == "poses" and (motion.period is not None or motion.parked):
            key = "parked" if motion.period is None else "period"
            raise InputError(f'experiment.toml: [motion.{index}] {key}: kind = "poses" has no times; remove it')
    if not any(motion.role == "identification" for motion in file.motion):
        raise InputError(
            'experiment.toml: [motion.0] role: no motion has role "identification"; '
            'write role = "identification" for the motions to fit'
        )
    check_effects(file.model.effects, "experiment.toml")
    warnings = []
    strength = math.hypot(*robot.gravity)
    if not 9.7 < strength < 9.9:
        warnings.append(f"experiment.toml: [robot] gravity: {strength:.4g} m/s^2 is not the Earth's; is that so?")
    listed = {effect.partition("@")[0] for effect in file.model.effects if "@" not in effect} | set(file.model.effects)
    for effect in file.model.values:
        if effect not in listed and effect.partition("@")[0] not in listed:
            warnings.append(
                f'experiment.toml: [model.values."{effect}"]: effects does not list it; used only where --effects does'
            )
    return warnings


def check_effects(effects: list[str], source: str) -> None:
    """Refuse an effect that is listed twice."""
    for effect in effects:
        if effects.count(effect) > 1:
            raise InputError(f'{source}: [model] effects: "{effect}" is listed twice; list it once')


def dump_model(effects: Iterable[str], values: Mapping[str, Mapping[str, float | bool]]) -> dict[str, Any]:
    """Return the ``[model]`` table, ready for a TOML writer."""
    table: dict[str, Any] = {"effects": list(effects)}
    if values:
        table["values"] = {effect: dict(parameters) for effect, parameters in values.items()}
    return table


def model_parts(section: ModelSection) -> tuple[tuple[str, ...], EffectParameters]:
    """Return the effects and their starting values; ``fixed`` is there only where it is true."""
    values: EffectParameters = {}
    for effect, given in section.values.items():
        values[effect] = {k: float(v) for k, v in (given.__pydantic_extra__ or {}).items()}
        if given.fixed:
            values[effect]["fixed"] = True
    return tuple(section.effects), values


def _describe(error: ErrorDetails, kind: type[BaseModel]) -> str:
    """Return ``[section] key: what is wrong; what to write`` for one pydantic error."""
    where = [part for part in error["loc"] if part != "[key]"]
    # Trailing indices belong to the value (joints[2]), not to the section.
    cut = len(where)
    while cut and isinstance(where[cut - 1], int) and cut > 2:
        cut -= 1
    index = "".join(f"[{i}]" for i in where[cut:])
    key = f"{where[cut - 1]}{index}" if cut else "the file"
    names = tuple(part for part in where[: cut - 1] if isinstance(part, str))
    section = ".".join(str(part) if str(part).replace("_", "").isalnum() else f'"{part}"' for part in where[: cut - 1])
    if cut == 2 and isinstance(where[1], int):  # the motion itself is not a table
        section, key = "", f"motion[{where[1]}]"
    place = f"[{section}] {key}" if section else key
    known = _KEYS.get(names, kind.model_fields)
    return _one_line(f"{place}: {_fault(error, str(where[-1]) if where else '', known)}")


def _fault(error: ErrorDetails, key: str, known: Iterable[str]) -> str:
    """Return what is wrong with one value and what to write instead."""
    given, context = _shown(error["input"]), error.get("ctx", {})
    match error["type"]:
        case "missing":
            return "is missing; write it"
        case "extra_forbidden":
            return f"unknown key; {suggest(key, known)}"
        case "literal_error":
            options = str(context["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
            if len(options) == 1:
                return f"{given} is not supported; write {options[0]}"
            hint = f'write "{options[0]}"' if isinstance(error["input"], str) else f"write {options[0]}"
            near = difflib.get_close_matches(str(error["input"]), options, n=1, cutoff=0.5)
            return f"{given} is not one of {', '.join(options)}; " + (f'did you mean "{near[0]}"?' if near else hint)
        case "too_short" | "too_long" if "max_length" in context or context.get("min_length", 0) > 1:
            length = context.get("min_length", context.get("max_length"))
            return f"{given} has {context['actual_length']} numbers; write {length}"
        case "too_short" | "string_too_short":
            return "is empty; write at least one"
        case "value_error":
            return f"{given} will not do; {context['error']}"
        case "greater_than" | "greater_than_equal":
            limit = "above 0" if error["type"] == "greater_than" else "0 or more"
            return f"{given} is out of range; write a number {limit}, or leave the key out if it is not known"
        case "finite_number":
            return f"{given} is not finite; write a number"
        case kind if kind.endswith("_type") or kind.endswith("_parsing"):
            wanted = {
                "float": "a number", "int": "a whole number", "string": "a text in quotes", "list": "a list [...]",
                "bool": "true or false",
            }.get(kind.split("_")[0], "a table")  # fmt: skip
            return f"{given} is not {wanted}; write {wanted}"
        case _:
            return f"{given}: {error['msg']}"


def _shown(value: object) -> str:
    """Return a value as it stands in TOML, shortened."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _one_line(text: str) -> str:
    return " ".join(text.split())
