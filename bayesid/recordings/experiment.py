"""The experiment folder: read it and check it. docs/experiment.md describes it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayesid.effects.library import EffectLibrary
from bayesid.errors import InputError
from bayesid.recordings import checks, motion_checks
from bayesid.recordings.robot_section import read_robot
from bayesid.recordings.schema import (
    EffectParameters,
    ExperimentFile,
    MotionSection,
    check_keys,
    model_parts,
    read_file,
    read_model,
)
from bayesid.recordings.table import WRENCH_COLUMNS, Table
from bayesid.recordings.table_reader import read_table
from bayesid.robot.robot import Robot

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = ["WRENCH_COLUMNS", "Experiment", "Motion", "Sensor", "Table", "load_experiment"]


@dataclass(frozen=True, eq=False)
class Motion:
    """One recording and what is known about it.

    Attributes
    ----------
    name, role, kind
        As in experiment.toml; a motion of role ``validation`` is never fitted.
    table
        The samples.
    static
        Readings with the robot stopped: row by row those of `table` (`stop_and_go`), or separate poses.
    period
        The motion repeats with it [s].
    parked
        (start, end) times in which the robot stands still [s].
    """

    name: str
    role: Literal["identification", "validation"]
    table: Table
    kind: Literal["trajectory", "poses"] = "trajectory"
    static: Table | None = None
    period: float | None = None
    parked: tuple[tuple[float, float], ...] = ()

    def __repr__(self) -> str:
        return f"<Motion {self.name} ({self.role}): {self.table!r}>"

    @property
    def stop_and_go(self) -> bool:
        """Whether the static table holds the motion's own positions, row by row."""
        return self.static is not None and len(self.static) == len(self.table)


@dataclass(frozen=True, eq=False)
class Sensor:
    """The force/torque sensor.

    Attributes
    ----------
    joint
        The URDF joint it sits in; None: between the world and the base.
    translation, rpy
        Origin (3,) [m] and orientation (3,) [rad] of its frame in the base frame, or in that joint's child link.
    force_std, torque_std
        Noise of one sample [N], [N m], where known.
    """

    joint: str | None = None
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rpy: np.ndarray = field(default_factory=lambda: np.zeros(3))
    force_std: float | None = None
    torque_std: float | None = None

    def __post_init__(self) -> None:
        """Make the vectors read-only and check their length."""
        for name in ("translation", "rpy"):
            vector = np.array(getattr(self, name), dtype=np.float64)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise InputError(f"sensor {name}: {vector.tolist()} will not do; give three numbers")
            vector.setflags(write=False)
            object.__setattr__(self, name, vector)


@dataclass(frozen=True, eq=False)
class Experiment:
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
        Trust in the nominal inertias (relative, 1 sigma); 0: exact; None: not known at all.
    position_resolution, position_std
        One encoder count and random noise on top [rad or m], where known.
    gear_ratio, locked
        By joint name [1], [rad or m].
    folder
        Where it was read from, None if it was made in memory.
    warnings
        What looked doubtful on reading, one line each.
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
    library: EffectLibrary = field(default_factory=EffectLibrary)

    def __post_init__(self) -> None:
        """Check that tables have the robot's joints and that names differ."""
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

    def __repr__(self) -> str:
        place = None if self.sensor is None else self.sensor.joint
        sensor = f", sensor in {place}" if place else "" if self.sensor is None else ", sensor under the base"
        motions = f"{len(self.motions)} motion{'s' * (len(self.motions) != 1)}"
        return f"<{type(self).__name__} {self.name}: {self.robot.name} with {self.robot.n} joints{sensor}, {motions}>"

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

    def __iter__(self) -> Iterator[Motion]:
        """The motions one after the other."""
        return iter(self.motions)

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

    @property
    def identification(self) -> tuple[Motion, ...]:
        """The motions that may be fitted."""
        return tuple(motion for motion in self.motions if motion.role == "identification")

    @property
    def validation(self) -> tuple[Motion, ...]:
        """The motions that may only be predicted."""
        return tuple(motion for motion in self.motions if motion.role == "validation")

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
    setup, file = _read_setup(Path(folder), library)
    motions, warnings = [], list(setup.warnings)
    for index, section in enumerate(file.motion):
        motion, doubts = _load_motion(Path(folder), file, section, f"[motion.{index}]", setup.robot, planned)
        motions.append(motion)
        warnings += doubts
    warnings += _check_roles(motions)
    return replace(setup, motions=tuple(motions), warnings=tuple(warnings))


def as_experiment(given: object, also: str = "") -> Experiment:
    """What a verb is given, as an experiment: itself, or read from its folder.

    Parameters
    ----------
    given
        An experiment, or the path of its folder.
    also
        What else the verb takes, for the message.

    Raises
    ------
    InputError
        It is neither; or as `load_experiment`.
    """
    if isinstance(given, Experiment):
        return given
    if isinstance(given, (str, Path)):
        return load_experiment(given)
    takes = f"the folder of an experiment, an Experiment{f' or {also}' if also else ''}"
    raise InputError(f"a {type(given).__name__} is given for the experiment: pass {takes}")


def load_setup(folder: str | Path, library: EffectLibrary | None = None) -> Experiment:
    """Read and check the robot and sensor of an experiment folder, whose tables need not exist yet: no motions.

    Raises
    ------
    InputError
        experiment.toml or the URDF is missing or wrong.
    """
    return _read_setup(Path(folder), library)[0]


def _read_setup(folder: Path, library: EffectLibrary | None) -> tuple[Experiment, ExperimentFile]:
    """What experiment.toml and the URDF say."""
    if not folder.is_dir():
        raise InputError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder'}; give an experiment folder")
    toml = folder / "experiment.toml"
    if not toml.is_file():
        raise InputError(f"{folder}: has no experiment.toml; write one, or give the folder that holds it")
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
    effects, values, expressions = model_parts(file.model)
    experiment = Experiment(
        name=file.name, robot=robot, sensor=sensor, motions=(), effects=effects, effect_values=values,
        inertia_rel_std=file.robot.inertia_rel_std, position_resolution=file.robot.position_resolution,
        position_std=file.robot.position_std, gear_ratio=dict(file.robot.gear_ratio), locked=dict(file.robot.locked),
        folder=folder, warnings=tuple(warnings),
        library=(library or EffectLibrary()).for_robot(robot.n).with_expressions(expressions, robot.n, "experiment.toml"),
    )  # fmt: skip
    return experiment, file


def _load_motion(
    folder: Path, file: ExperimentFile, section: MotionSection, key: str, robot: Robot, planned: bool
) -> tuple[Motion, list[str]]:
    has_sensor, resolution = file.sensor is not None, file.robot.position_resolution
    table, warnings = read_table(folder / section.table, section.table, robot.n, has_sensor)
    if not (planned and table.wrench is None and table.torques is None):
        warnings += _check_present(table, has_sensor)
    warnings += checks.check_positions(table, robot)
    warnings += checks.check_channels(table)
    if section.kind == "trajectory":
        warnings += motion_checks.check_trajectory(table, robot, resolution)
    warnings += checks.check_intervals(table, key, section.period, section.parked, resolution)
    static = None
    if section.static is not None:
        static, doubts = read_table(folder / section.static, section.static, robot.n, has_sensor)
        warnings += doubts + checks.check_static(table, static, resolution)
        warnings += checks.check_positions(static, robot) + checks.check_channels(static)
    parked = tuple((float(start), float(end)) for start, end in section.parked)
    motion = Motion(section.name, section.role, table, section.kind, static, section.period, parked)
    return motion, warnings


def _check_present(table: Table, has_sensor: bool) -> list[str]:
    """Check that there is something to explain: a wrench where there is a sensor, or torques."""
    if table.wrench is None and table.torques is None:
        if has_sensor:
            raise InputError(
                f"{table.source}: columns fx ... mz are missing although experiment.toml has a [sensor]; "
                "add them, or torques tau1 ..."
            )
        raise InputError(
            f"{table.source}: columns tau1 ... are missing and experiment.toml has no [sensor]; "
            "add torques, or a wrench fx ... mz and a [sensor]"
        )
    if table.wrench is None and has_sensor:
        return [f"{table.source}: columns fx ... mz are missing although there is a [sensor]; add them, to use more than torques"]
    return []


def _check_roles(motions: list[Motion]) -> list[str]:
    warnings = []
    if not any(motion.role == "validation" for motion in motions):
        warnings.append('experiment.toml: no motion has role "validation"; add one, to test the estimate on a held-out motion')
    for one, other in itertools.combinations(motions, 2):
        same = len(one.table) == len(other.table) and np.array_equal(one.table.positions, other.table.positions)
        if same and one.role != other.role and np.array_equal(one.table.times, other.table.times):
            source = other.table.source
            warnings.append(f"{source}: the same motion as {one.table.source}, which says little about others; record another")
    return warnings
