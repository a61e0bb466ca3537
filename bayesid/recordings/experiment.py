"""The experiment folder: read it and check it. docs/reference/experiment.md describes it."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from bayesid.argument_types import explains_types
from bayesid.arguments import argument, call
from bayesid.drawing import Plots
from bayesid.effects.effect import Effect
from bayesid.effects.library import EffectLibrary
from bayesid.errors import InputError
from bayesid.recordings.complaints import Finding, columns_of, listed
from bayesid.recordings.examination import examine
from bayesid.recordings.importing.column_map import ColumnMap, column_map
from bayesid.recordings.importing.recording import read_stated
from bayesid.recordings.importing.stream import kind_of
from bayesid.recordings.parts import Motion, Sensor, as_table, check_kinds, listed_effects
from bayesid.recordings.robot_section import check_knowledge, check_loaded, read_robot, robot_doubts, with_stated_effects
from bayesid.recordings.schema import (
    EffectParameters,
    ExperimentFile,
    MotionSection,
    check_keys,
    joints_by_place,
    model_parts,
    read_file,
    read_model,
    unlisted_values,
)
from bayesid.recordings.stored import StoredTable, stored_table
from bayesid.recordings.table import WRENCH_COLUMNS, Table
from bayesid.recordings.table_reader import read_table
from bayesid.robot.robot import Robot, load_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


class _Named(Protocol):
    @property
    def name(self) -> str: ...


M = TypeVar("M", bound=_Named)

_GRAVITY = (0.0, 0.0, -9.81)
_UNVALIDATED = 'no motion has role "validation"'

__all__ = ["WRENCH_COLUMNS", "Experiment", "Motion", "Sensor", "Table", "load_experiment"]


@explains_types
@dataclass(frozen=True, eq=False)
class Experiment(Plots):
    """A robot and every recording made with it.

    Attributes
    ----------
    name
        The experiment's name.
    robot, sensor
        What was recorded, and the sensor if there is one.
    motions
        In the order of experiment.toml; names differ.
    effects, effect_values
        What the user's model already has: ``name`` or ``name@where``; starting values, and ``fixed`` where true.
    inertia_rel_std
        Prior relative standard deviation of the nominal inertias; 0: exact; None: not known at all.
    position_resolution, position_std
        One encoder count and random noise on top [rad or m], where known.
    gear_ratio, locked
        By joint name [1], [rad or m].
    folder
        Where it was read from, None if it was made in memory.
    warnings
        What looked doubtful about the recordings, one line each, with the findings first.
    findings
        What of it is certain.
    library
        The effects that there are: the package's and the user's own.
    """

    name: str
    robot: Robot
    motions: tuple[Motion, ...]
    sensor: Sensor | None = None
    effects: tuple[str, ...] = ()
    effect_values: EffectParameters = field(default_factory=dict)
    inertia_rel_std: float | None = None
    position_resolution: float | None = None
    position_std: float | None = None
    gear_ratio: dict[str, float] = field(default_factory=dict)
    locked: dict[str, float] = field(default_factory=dict)
    folder: Path | None = None
    warnings: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    library: EffectLibrary = field(default_factory=EffectLibrary)

    def __post_init__(self) -> None:
        """Check that tables have the robot's joints and that names differ, and examine the motions that have not been.

        Raises
        ------
        InputError
            What is recorded cannot be right, whether it comes from a file or from arrays.
        """
        object.__setattr__(self, "effects", listed_effects(self.effects))
        object.__setattr__(self, "motions", (self.motions,) if isinstance(self.motions, Motion) else self.motions)
        check_kinds(self.name, self.robot, self.sensor, self.motions)
        self._check_robot()
        sizes = {key: getattr(self, key) for key in ("inertia_rel_std", "position_resolution", "position_std")}
        check_knowledge(sizes, self.gear_ratio, self.robot)
        names = [motion.name for motion in self.motions]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f'experiment {self.name}: two motions are named "{name}"; name them apart')
        for motion in self.motions:
            for table in (motion.table, motion.static):
                if table is not None and table.positions.shape[1] != self.robot.n:
                    raise InputError(
                        f"{table.source}: {table.positions.shape[1]} joints but the robot has {self.robot.n}; "
                        "give a table with one column of positions per joint"
                    )
        given, motions, findings, doubts = self.motions, [], list(self.findings), []
        for index, motion in enumerate(self.motions):
            if not motion.examined:
                place = f"motion '{motion.name}':" if self.folder is None else f"experiment.toml: [motion.{index}]"
                motion, found, more = examine(motion, self.robot, self.position_resolution, place)
                findings += found
                doubts += more
            motions.append(motion)
        object.__setattr__(self, "motions", tuple(motions))
        if any(not motion.examined for motion in given):
            findings += self._partial_torques()
        object.__setattr__(self, "findings", tuple(findings))
        certain = tuple(finding.text for finding in findings)
        doubted = [text for text in self.warnings if text not in certain]
        object.__setattr__(self, "warnings", (*certain, *doubted, *doubts))

    def _check_robot(self) -> None:
        """Take over which joints slide and where locked ones stand; the sensor must be where the robot was read for."""
        robot = self.robot
        if self.library.sliding != (sliding := tuple(np.flatnonzero(robot.prismatic).tolist())):
            object.__setattr__(self, "library", self.library.for_robot(robot.n, sliding))
        if not self.locked:
            object.__setattr__(self, "locked", dict(robot.locked))
        if {name: position for name, position in self.locked.items() if position} != robot.locked:
            raise InputError(
                f"experiment {self.name}: locked = {dict(self.locked)}, but the robot was read with {dict(robot.locked)}; give "
                "load_robot the same"
            )
        if self.sensor is not None and self.sensor.joint != robot.sensor_joint:
            here, there = ("under the base" if j is None else f"in {j}" for j in (self.sensor.joint, robot.sensor_joint))
            raise InputError(
                f"experiment {self.name}: the sensor is {here}, but the robot was read for one {there}; write "
                f"load_robot(..., sensor_joint={self.sensor.joint!r})"
            )

    def __repr__(self) -> str:
        place = None if self.sensor is None else self.sensor.joint
        sensor = f", sensor in {place}" if place else "" if self.sensor is None else ", sensor under the base"
        motions = f"{len(self.motions)} motion{'s' * (len(self.motions) != 1)}"
        return f"<{type(self).__name__} {self.name}: {self.robot.name} with {self.robot.n} joints{sensor}, {motions}>"

    def _partial_torques(self) -> list[Finding]:
        """That torques are used of some joints only, and what that means."""
        if not any(motion.table.torques is not None for motion in self.motions):
            return []
        known = self.torque_joints
        if not known:
            raise InputError(
                f"experiment {self.name}: no joint has torques in every recording of torques; record the same joints in each"
            )
        without = [j for j in range(self.robot.n) if j not in known]
        if not without:
            return []
        columns, names = columns_of([f"tau{j + 1}" for j in without]), listed([self.robot.joint_names[j] for j in without])
        tables = [motion.table for motion in self.motions if motion.table.torques is not None]
        lacking = [table.source for table in tables if not {*without} <= {*table.torque_joints}]
        where = "any recording" if len(lacking) == len(tables) else f"{listed(lacking)}, so those of other recordings go unused"
        return [
            Finding(
                f"{columns}: no torques of {names} in {where}; torques of other joints "
                "are used, which say nothing of friction and rotors there and less of the links; record them, to know more"
            )
        ]

    @classmethod
    @explains_types
    def from_arrays(
        cls,
        urdf: str | Path | Robot,
        t: ArrayLike,
        q: ArrayLike,
        *,
        torques: ArrayLike | None = None,
        wrench: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
        commanded: ArrayLike | None = None,
        validation: Mapping[str, ArrayLike] | Table | Sequence[Mapping[str, ArrayLike] | Table] | None = None,
        sensor: Sensor | str | None = None,
        joints: Sequence[str] | None = None,
        locked: Mapping[str, float] | None = None,
        gravity: Sequence[float] = _GRAVITY,
        effects: Sequence[str] | str | None = None,
        inertia_rel_std: float | None = None,
        position_resolution: float | None = None,
        position_std: float | None = None,
        gear_ratio: Mapping[str, float] | None = None,
        kind: Literal["trajectory", "poses"] = "trajectory",
        name: str = "arrays",
    ) -> Experiment:
        """Make an experiment of a URDF and one recording as arrays, lists or data frames; no file is written.

        Readings are checked as those of files are: rows that hold a NaN or the time of the row before are left out and reported.

        Parameters
        ----------
        urdf
            Path of the URDF or what else `bayesid.load_robot` takes, or a robot that it loaded.
        t
            Times (N,) [s]; numpy's dates and durations count from the first.
        q
            Joint positions (N, n) [rad or m].
        torques
            Joint torques (N, n) [N m or N]; NaN throughout for a joint that has none.
        wrench
            Force, then moment about the sensor's origin, sensor frame: what the sensor applies to the robot (N, 6) [N, N m].
        velocities, commanded
            (N, n) [rad/s or m/s], [rad or m], where they were recorded.
        validation
            Recordings that are only predicted: ``dict(t=..., q=..., torques=...)``, a `Table`, or a list of them.
        sensor
            Where the wrench is measured: a `Sensor`, ``"base"``, or the name of its joint; default: under the base, in the base's
            axes, or in the joint that `load_robot` was told.
        joints
            Moving joints in the order of the columns of ``q``; default: every one that is not locked, in the URDF's order.
        locked
            Position of every other moving joint [rad or m]; default 0.
        gravity
            In the base frame (3,) [m/s^2].
        effects
            What the model has beside rigid bodies, as ``[model] effects``; default: what an MJCF file states, else nothing.
        inertia_rel_std, position_resolution, position_std, gear_ratio
            As the attributes of the experiment.
        kind
            ``poses`` where every row is a separate pose at rest.
        name
            Of the experiment.

        Raises
        ------
        InputError
            The URDF or the arrays cannot be right; the message says which array, row and value, and what to do.
        """
        if isinstance(sensor, str):
            sensor = Sensor(None if sensor == "base" else sensor)
        if not isinstance(sensor, Sensor | None):
            raise InputError(f'sensor: is a {type(sensor).__name__}; give a Sensor, "base", or the name of a joint')
        if sensor is None and wrench is not None:
            sensor = Sensor(urdf.sensor_joint if isinstance(urdf, Robot) else None)
        locked = {} if locked is None else dict(locked)
        warnings: list[str] = []
        if isinstance(urdf, Robot):
            robot = urdf
            check_loaded(robot, joints, None if gravity is _GRAVITY else gravity)
        else:
            robot = load_robot(urdf, joints, locked, gravity, None if sensor is None else sensor.joint)
            warnings += robot_doubts(robot, locked, "", inertia_rel_std)
        own, values = with_stated_effects(robot, None if effects is None else listed_effects(effects))
        recording = dict(t=t, q=q, torques=torques, wrench=wrench, velocities=velocities, commanded=commanded)
        held_out: list[Any] = (
            list(validation) if isinstance(validation, list | tuple) else [] if validation is None else [validation]
        )
        motions = []
        for k, given in enumerate([recording, *held_out]):
            called = "identification" if k == 0 else "validation" if len(held_out) == 1 else f"validation{k}"
            table = given if isinstance(given, Table) else as_table(given, robot, called)
            if table.positions.shape[1] != robot.n:
                raise InputError(
                    f"{called}: q has {table.positions.shape[1]} columns but {robot.urdf.name} has {robot.n} moving joints "
                    f"({listed(robot.joint_names)}); name those of the columns, joints=[...], and where others stand, "
                    "locked={...}"
                )
            warnings += _check_present(table, sensor is not None, arrays=True)
            motions.append(Motion(called, "identification" if k == 0 else "validation", table, kind))
        experiment = cls(
            name=name, robot=robot, motions=tuple(motions), sensor=sensor, effects=own, effect_values=values,
            inertia_rel_std=inertia_rel_std, position_resolution=position_resolution, position_std=position_std,
            gear_ratio=dict(gear_ratio or {}), locked=locked, warnings=tuple(warnings),
        )  # fmt: skip
        return replace(experiment, warnings=(*experiment.warnings, *_check_roles(experiment.motions, "pass validation=...")))

    def __getitem__(self, name: str) -> Motion:
        """The motion of a name.

        Raises
        ------
        KeyError
            There is none; the message lists those that there are.
        """
        motions = {motion.name: motion for motion in self.motions}
        if name not in motions:
            raise KeyError(f"no motion is named {name!r}; there are {', '.join(motions) or 'none'}")
        return motions[name]

    def __contains__(self, motion: object) -> bool:
        """Whether it has this motion, or one of this name."""
        return any(one is motion or one.name == motion for one in self.motions)

    def __iter__(self) -> Iterator[Motion]:
        """The motions one after the other."""
        return iter(self.motions)

    def plot(self, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
        """Draw the recording of a motion, the first by default; as `Motion.plot`.

        Raises
        ------
        InputError
            The experiment has no motion, or as there.
        KeyError
            There is no motion of that name.
        """
        if not self.motions:
            raise InputError(f"experiment {self.name} has no motion to draw")
        return (self.motions[0] if motion is None else self[motion]).plot(channels=channels, ax=ax)

    def to_dataframe(self) -> DataFrame:
        """The motions, a row each: name, role, kind, number of samples, duration [s], rate [Hz] and names of the readings."""
        from pandas import DataFrame

        return DataFrame(
            {
                "motion": m.name, "role": m.role, "kind": m.kind, "samples": len(m.table), "duration_s": m.table.duration,
                "rate_hz": 1.0 / m.table.step if m.table.step else None,
                "readings": ", ".join(name for name, _ in m.table.channels()),
            }
            for m in self.motions
        )  # fmt: skip

    def with_findings(self, notes: Iterable[str], *, validated: bool = True) -> tuple[str, ...]:
        """What is certain about the recordings, then what a verb has to say, then what is doubtful about the recordings.

        ``validated``: False where the verb says itself that there is no motion for validation, which is then said once.
        """
        certain = [finding.text for finding in self.findings]
        doubts = [text for text in self.warnings if text not in certain and (validated or _UNVALIDATED not in text)]
        return tuple([*certain, *notes, *doubts])

    @property
    def identification(self) -> tuple[Motion, ...]:
        """The motions that may be fitted."""
        return tuple(motion for motion in self.motions if motion.role == "identification")

    @property
    def validation(self) -> tuple[Motion, ...]:
        """The motions that may only be predicted."""
        return tuple(motion for motion in self.motions if motion.role == "validation")

    @property
    def torque_joints(self) -> tuple[int, ...]:
        """Indices of the joints whose torques every recording of torques has; all joints where no torques were recorded."""
        known = [set(motion.table.torque_joints) for motion in self.motions if motion.table.torques is not None]
        return tuple(sorted(set.intersection(*known))) if known else tuple(range(self.robot.n))

    def possible_effects(self, channels: Sequence[str]) -> tuple[Effect, ...]:
        """Every effect of the library that acts on one of these channels, by their names, at every place."""
        places, joints = self.library.places, self.robot.joint_names
        return tuple(e for name in self.library.classes for e in places(name, joints, channels, self.gear_ratio))

    def with_model(self, path: str | Path) -> Experiment:
        """Return this experiment with a model.toml in place of its ``[model]``.

        Raises
        ------
        InputError
            The file is absent or holds anything else.
        """
        effects, values, expressions = read_model(path)
        library = self.library.with_expressions(expressions, self.robot.n, Path(path).name)
        return replace(self, effects=effects, effect_values=values, library=library)


def motions_named(motions: Sequence[M], asked: Sequence[str]) -> list[M]:
    """Those of motions, recorded or planned, that the argument ``motions`` asks for; an `InputError` if it asks for others."""
    by_name = {m.name: m for m in motions}
    if not asked:
        raise InputError(f"{argument('motions')} names none; write one or more of {', '.join(by_name)}")
    for name in asked:
        if name not in by_name:
            raise InputError(f"{argument('motions', name)}: no such motion; there are {', '.join(by_name)}")
    return [by_name[name] for name in asked]


@explains_types
def load_experiment(folder: str | Path, library: EffectLibrary | None = None, *, planned: bool = False) -> Experiment:
    """Read and check an experiment folder.

    Parameters
    ----------
    folder
        The folder with experiment.toml in it.
    library
        The effects that there are, with the user's own (`bayesid.load_effects`); default those of the package.
    planned
        Whether tables may be motions that are only planned, without readings.

    Raises
    ------
    InputError
        Something is missing or cannot be right; the message says which file, key or column, and value, and what to do.
    """
    if not isinstance(library, EffectLibrary | None):
        raise InputError(f"library: is a {type(library).__name__}; give bayesid.load_effects(...)")
    setup, file = _read_setup(Path(folder), library)
    if not file.motion:
        raise InputError("experiment.toml: motion: is missing; write a [[motion]] with name and table for each recording")
    motions, warnings = [], list(setup.warnings)
    stated = column_map(file.columns, file.units, {}, "experiment.toml")
    stated.check_joints(setup.robot.joint_names)
    for section in file.motion:
        motion, doubts = _read_motion(Path(folder), section, setup, planned, stated)
        motions.append(motion)
        warnings += doubts
    experiment = replace(setup, motions=tuple(motions), warnings=tuple(warnings))
    return replace(experiment, warnings=(*experiment.warnings, *_check_roles(experiment.motions, "add one")))


def as_experiment(given: object, also: str = "") -> Experiment:
    """What a verb is given, as an experiment: itself, what holds it as ``experiment``, or read from its folder.

    ``also`` is what else the verb takes, for the message.
    """
    if isinstance(given, Experiment):
        return given
    if isinstance(given, (str, Path)):
        return load_experiment(given)
    if isinstance(held := getattr(given, "experiment", None), Experiment):
        return held
    takes = f"the folder of an experiment, an Experiment{f' or {also}' if also else ''}"
    raise InputError(f"a {type(given).__name__} is given for the experiment: pass {takes}")


def load_setup(folder: str | Path, library: EffectLibrary | None = None) -> Experiment:
    """Read and check the robot and sensor of an experiment folder, whose tables need not exist yet: no motions."""
    return _read_setup(Path(folder), library)[0]


def as_setup(given: object, takes: str) -> Experiment:
    """Robot, sensor and model of what a verb is given: an experiment, its folder, or a robot.

    A robot has the sensor in the joint that it was loaded with, or under its base.
    ``takes`` is what the verb takes, for the message.
    """
    if isinstance(given, Robot):
        return Experiment(given.name, given, (), Sensor(given.sensor_joint))
    if isinstance(given, (str, Path)):
        return load_setup(given)
    if isinstance(given, Experiment):
        return given
    raise InputError(f"a {type(given).__name__} is given for the experiment: pass {takes}")


def _read_setup(folder: Path, library: EffectLibrary | None) -> tuple[Experiment, ExperimentFile]:
    """What experiment.toml and the URDF say."""
    if folder.exists() and (kind := kind_of(folder)) and not (folder / "experiment.toml").is_file():
        what = "a table" if kind in ("text", "parquet") else "a log of another tool"
        raise InputError(
            f"{folder}: is {what} and no experiment folder; make one of it and the robot's URDF with {call('import')}"
        )
    if not folder.is_dir():
        raise InputError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder'}; give an experiment folder")
    toml = folder / "experiment.toml"
    if not toml.is_file():
        result = next(iter(folder.glob("*.json")), None) is not None and (folder / "report.html").is_file()
        instead = "it holds a result; give the experiment's folder" if result else "write one, or give the folder that holds it"
        raise InputError(f"{folder}: has no experiment.toml; {instead}")
    file = read_file(toml, ExperimentFile)
    warnings = check_keys(file)
    joint = None if file.sensor is None else file.sensor.joint
    robot, doubts = read_robot(folder, file.robot, joint)
    warnings += doubts
    sensor = None
    if file.sensor is not None:
        given = file.sensor.model_dump()
        for key in ("force_std", "torque_std"):
            if given[key] == 0.0:
                given[key] = None
                warnings.append(
                    f"experiment.toml: [sensor] {key}: 0 is no sensor's noise; the data's own is used: write the data sheet's"
                )
        sensor = Sensor(**given)
    known = (library or EffectLibrary()).for_robot(robot.n, np.flatnonzero(robot.prismatic).tolist())
    effects, values, expressions = model_parts(file.model)
    effects, values = with_stated_effects(robot, effects if "effects" in file.model.model_fields_set else None, values)
    warnings += unlisted_values(effects, values, robot.joint_names)
    warnings += joints_by_place((*effects, *values), robot.joint_names)
    experiment = Experiment(
        name=file.name, robot=robot, sensor=sensor, motions=(), effects=effects, effect_values=values,
        inertia_rel_std=file.robot.inertia_rel_std, position_resolution=file.robot.position_resolution,
        position_std=file.robot.position_std, gear_ratio=dict(file.robot.gear_ratio), locked=dict(file.robot.locked),
        folder=folder, warnings=tuple(warnings),
        library=known.with_expressions(expressions, robot.n, "experiment.toml"),
    )  # fmt: skip
    return experiment, file


def _read_table(folder: Path, name: str, kind: str, setup: Experiment, stated: ColumnMap) -> tuple[Table, list[str]]:
    """A table of the folder: in bayesid's own columns, or in those that experiment.toml states."""
    has_sensor = setup.sensor is not None
    if not (stated.columns or stated.units or stated.scale):
        return read_table(folder / name, name, setup.robot.n, has_sensor)
    joints = setup.robot.joint_names
    sliding = [joint for joint, slides in zip(joints, setup.robot.prismatic, strict=True) if slides]
    return read_stated(folder / name, name, stated, joints, sliding, has_sensor, kind == "poses"), []


def _stored(folder: Path, section: MotionSection, setup: Experiment, stated: ColumnMap) -> StoredTable | None:
    """The table of a motion that is read in chunks; None where it is read whole."""
    if section.chunked is False or section.kind == "poses":
        return None
    place = f"experiment.toml: motion '{section.name}': a table that is read in chunks"
    if stated.columns or stated.units or stated.scale:
        if section.chunked:
            raise InputError(f"{place} has bayesid's own columns; write it once with them, and remove [columns] and [units]")
        return None
    stored = stored_table(folder / section.table, section.table, setup.robot.n, setup.sensor is not None, section.chunked)
    for key in ("period", "parked"):
        if stored is not None and getattr(section, key):
            raise InputError(f"{place} goes without {key}; remove it, or cut out what fits in memory")
    return stored


def _read_motion(
    folder: Path, section: MotionSection, setup: Experiment, planned: bool, stated: ColumnMap
) -> tuple[Motion, list[str]]:
    has_sensor = setup.sensor is not None
    stored = _stored(folder, section, setup, stated)
    table, warnings = (
        (stored.excerpt(), [*stored.notes]) if stored else _read_table(folder, section.table, section.kind, setup, stated)
    )
    if not (planned and table.wrench is None and table.torques is None):
        warnings += _check_present(table, has_sensor, arrays=False)
    static = None
    if section.static is not None:
        static, doubts = _read_table(folder, section.static, "poses", setup, stated)
        warnings += doubts
    if stored is not None and static is not None and len(static) in (len(stored), len(table)):
        raise InputError(
            f"experiment.toml: motion '{section.name}': a table that is read in chunks goes without a static run row by row; "
            "remove static, or cut out what fits in memory"
        )
    parked = tuple((float(start), float(end)) for start, end in section.parked)
    return Motion(section.name, section.role, table, section.kind, static, section.period, parked, stored=stored), warnings


def _check_present(table: Table, has_sensor: bool, arrays: bool) -> list[str]:
    """Check that there is something to explain: a wrench where there is a sensor, or torques."""
    wrench, torques = ("wrench", "torques") if arrays else ("columns fx ... mz", "columns tau1 ...")
    given, be = ("a sensor is given", "is") if arrays else ("experiment.toml has a [sensor]", "are")
    if table.wrench is None and table.torques is None:
        if has_sensor:
            raise InputError(f"{table.source}: {wrench} {be} missing although {given}; add {wrench}, or {torques}")
        need = "give one of them" if arrays else "add torques, or a wrench fx ... mz and a [sensor]"
        none = f"{torques} and {wrench} are missing" if arrays else f"{torques} are missing and experiment.toml has no [sensor]"
        raise InputError(f"{table.source}: {none}; {need}")
    if table.wrench is None and has_sensor:
        return [f"{table.source}: {wrench} {be} missing although {given}; add {wrench}, to use more than torques"]
    return []


def _check_roles(motions: Sequence[Motion], remedy: str) -> list[str]:
    warnings = []
    if not any(motion.role == "validation" for motion in motions):
        place = "experiment.toml: " if remedy == "add one" else ""
        warnings.append(f"{place}{_UNVALIDATED}; {remedy}, to test the estimate on a held-out motion")
    for one, other in itertools.combinations(motions, 2):
        same = len(one.table) == len(other.table) and np.array_equal(one.table.positions, other.table.positions)
        if same and one.role != other.role and np.array_equal(one.table.times, other.table.times):
            source = other.table.source
            warnings.append(f"{source}: the same motion as {one.table.source}, which says little about others; record another")
    return warnings
