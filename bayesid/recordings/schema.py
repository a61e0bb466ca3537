"""The two TOML files a user writes, experiment.toml and model.toml: what they may hold, and one line when they do not.

Nothing here reads a table or a robot: these models know keys, types and ranges only.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal, TypeVar

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, describe, one_line

Expressions = dict[str, dict[str, Any]]  # "cogging" -> {"tau2": "c * sin(3 * q2)", "parameters": {"c": {"unit": "N m"}}}
EffectParameters = dict[str, dict[str, float | bool]]  # "tether@joint3" -> {"stiffness": 40.0, "fixed": True}

#: No quantity of a robot in SI units is larger, and no size smaller without being zero: squares of both stay numbers.
LARGEST, SMALLEST = 1e12, 1e-15
_LONGEST_NAME, _LONGEST_PATH = 100, 1000


def _bearable(value: float) -> float:
    """Refuse a number that no robot needs: arithmetic with it overflows later, where nothing can be said about it."""
    if abs(value) > LARGEST:
        raise ValueError(f"write a number up to {LARGEST:g}, in SI units")
    return value


def _a_size(value: float) -> float:
    """Refuse a size that is next to nothing, but not zero."""
    if 0.0 < abs(value) < SMALLEST:
        raise ValueError(f"write 0, or at least {SMALLEST:g}, in SI units")
    return value


def _inside(text: str) -> str:
    """Refuse a path that leaves the experiment folder: folders come from others, and name only their own files."""
    windows = PureWindowsPath(text)
    if PurePosixPath(text).is_absolute() or windows.drive or windows.root or ".." in windows.parts:
        raise ValueError("name a file inside the experiment folder: no absolute path, no ..")
    if len(text) > _LONGEST_PATH or max(map(len, windows.parts), default=0) > 255 or not text.isprintable():
        raise ValueError("write a file's name that the system can have")
    return text


Number = Annotated[float, AfterValidator(_bearable)]
NonNegative = Annotated[Number, AfterValidator(_a_size), Field(ge=0.0)]
Positive = Annotated[Number, AfterValidator(_a_size), Field(gt=0.0)]
Vector3 = Annotated[list[Number], Field(min_length=3, max_length=3)]
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
FilePath = Annotated[str, Field(min_length=1), AfterValidator(_inside)]


def _plain_name(text: str) -> str:
    """Refuse a name that cannot be a folder name or an item of a comma-separated option."""
    if not text.strip() or text.startswith(".") or any(c in '/\\,"' or not c.isprintable() for c in text):
        raise ValueError('write a name without / \\ , " and line breaks, not starting with a dot')
    if len(text.encode("utf-8")) > _LONGEST_NAME:
        raise ValueError(f"write at most {_LONGEST_NAME} characters")
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
    locked: dict[str, Number] = {}
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
    __pydantic_extra__: dict[str, Number]  # pyright: ignore[reportIncompatibleVariableOverride]

    fixed: bool = False


class ExpressionParameter(_Section):
    """``[model.expressions.NAME.parameters.KEY]``: one number in a user's formula."""

    unit: str = "1"
    lower: Number | None = None
    upper: Number | None = None
    start: Number | None = None
    typical: Number | None = None
    tried: list[Number] = []


class ExpressionSection(_Section):
    """``[model.expressions.NAME]``: an effect of the user's own, as formulas by the reading that they add to."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)
    __pydantic_extra__: dict[str, str]  # pyright: ignore[reportIncompatibleVariableOverride]

    summary: str = ""
    parameters: dict[str, ExpressionParameter] = {}


class ModelSection(_Section):
    """``[model]``: effects the user's model already has, and formulas of the user's own."""

    effects: list[EffectName] = []
    values: dict[EffectName, EffectValues] = {}
    expressions: dict[str, ExpressionSection] = {}


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
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no file; give the path of a TOML file")
        data = tomllib.loads(path.read_bytes().decode("utf-8-sig"))  # Windows' editors begin files with a mark
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a model.toml, which holds a [model] table") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path.name}: line {line}: byte 0x{error.object[error.start]:02x} is not UTF-8; save the file as UTF-8"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name}: not valid TOML: {cut(one_line(str(error)), 160)}; correct it there") from None
    except RecursionError:
        raise InputError(f"{path.name}: not valid TOML: brackets are nested too deep; write it flatter") from None
    except ValueError:  # Python reads integers up to a number of digits
        raise InputError(f"{path.name}: not valid TOML: a number has thousands of digits; write 1e9 and the like") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file") from None
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        # A misspelt key often shows twice, as an unknown key and as a missing one: the first says more.
        details = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
        raise InputError(f"{path.name}: {describe(details[0], _KEYS, kind.model_fields)}") from None


def read_model(path: str | Path) -> tuple[tuple[str, ...], EffectParameters, Expressions]:
    """Read a model.toml, which stands in for ``[model]``: the effects, their starting values, and the user's formulas.

    Raises
    ------
    InputError
        The file is absent or holds anything else.
    """
    section = read_file(Path(path), ModelFile).model
    check_effects(section.effects, Path(path).name)
    return model_parts(section)


def write_model(
    effects: Iterable[str], values: EffectParameters, path: str | Path, expressions: Expressions | None = None
) -> None:
    """Write a model.toml for `read_model`."""
    Path(path).write_text(tomli_w.dumps({"model": dump_model(effects, values, expressions or {})}), encoding="utf-8")


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
    if not any(motion.role == "identification" for motion in file.motion):
        raise InputError(
            'experiment.toml: [motion.0] role: no motion has role "identification"; '
            'write role = "identification" for the motions to fit'
        )
    check_effects(file.model.effects, "experiment.toml")
    warnings = []
    strength = math.hypot(*robot.gravity)
    if not 9.7 < strength < 9.9:
        warnings.append(f"experiment.toml: [robot] gravity: {strength:.4g} m/s^2 is not the Earth's; correct it unless meant")
    warnings += _sizes(file)
    listed = {effect.partition("@")[0] for effect in file.model.effects if "@" not in effect} | set(file.model.effects)
    for effect in file.model.values:
        if effect not in listed and effect.partition("@")[0] not in listed:
            warnings.append(
                f'experiment.toml: [model.values."{effect}"]: effects does not list it; add it there, unless --effects is to'
            )
    return warnings


def _sizes(file: ExperimentFile) -> list[str]:
    """Numbers that look like another unit."""
    out = []
    trust = file.robot.inertia_rel_std
    if trust is not None and trust > 1.0:
        out.append(
            f"experiment.toml: [robot] inertia_rel_std: {trust:g} says that nothing is known of the links; it is a share, "
            "0.1 for ten per cent: correct it, or leave it out"
        )
    if file.sensor is not None and max(map(abs, file.sensor.translation)) > 10.0:
        out.append(f"experiment.toml: [sensor] translation: {file.sensor.translation} m is far; in millimetres? write metres")
    if file.sensor is not None and max(map(abs, file.sensor.rpy)) > 2.0 * math.pi:
        out.append(f"experiment.toml: [sensor] rpy: {file.sensor.rpy} rad is more than a turn; is it in degrees? write radians")
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
