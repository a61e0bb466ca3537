"""The verb ``import``: files of other tools as an experiment, and what was done to them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.arguments import names as as_names
from bayesid.errors import InputError
from bayesid.recordings.complaints import listed, suggest
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.importing.clock import lag
from bayesid.recordings.importing.column_map import ColumnMap, load_column_map
from bayesid.recordings.importing.found_columns import currents, stated_times, where_torques_are
from bayesid.recordings.importing.recording import Recording, joined_files, make_recording, read_source
from bayesid.recordings.importing.signals import STALLED, Signal
from bayesid.recordings.importing.stream import Source, kind_of
from bayesid.recordings.motion_checks import without_stalls, zero_velocities
from bayesid.recordings.robot_section import robot_doubts, with_stated_effects
from bayesid.results.imported import Delay, Imported, ImportedRecording
from bayesid.robot.robot import load_robot
from bayesid.robot.urdf_file import UrdfFile, read_urdf
from bayesid.signals.smoothing import smooth
from bayesid.validation.mistakes.shifts import delay_profile

_Paths = str | Path | Sequence[str | Path]
_COURSE = 10.0  # bandwidth of the positions that other topics are compared with [Hz]
_LONGEST_NAME = 80  # of a motion, which experiment.toml may call a little longer [bytes]
_STANDS = 0.02  # a joint that moves by less stands [rad or m]
#: Parts of a complaint of a unit, and what says the unit in an import.
_UNITS = {
    "degrees per second": "v=deg/s", "millimetres per second": "v=mm/s", "degrees": "q=deg", "millimetres": "q=mm",
    "milliseconds": "t=ms", "microseconds": "t=us", "nanoseconds": "t=ns",
}  # fmt: skip


@explains_types
def read_recording(
    source: _Paths,
    urdf: str | Path,
    *,
    validation: _Paths = (),
    mapping: str | Path | None = None,
    columns: Mapping[str, str | Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    joint_names: Mapping[str, str] | None = None,
    shift: Mapping[str, float] | None = None,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    sensor: Sensor | str | None = None,
    clock: Literal["header", "log"] | None = None,
    topics: Sequence[str] = (),
    episodes: Sequence[int] = (),
    join_files: bool = False,
    rate: float | None = None,
    kind: Literal["trajectory", "poses"] = "trajectory",
    hold_out: float | None = None,
    name: str = "imported",
) -> Imported:
    """Make an experiment of files of other tools: ROS bags, MCAP, CSV, Parquet, NPZ, MAT, HDF5, LeRobot.

    Columns are found by their names (ours, a joint's name beside ``position``, ``velocity`` or ``effort``, numbers beside such a
    word) or as stated. Quantities of topics with times of their own are brought to the times of the slowest of positions and
    readings.

    Parameters
    ----------
    source
        A file or folder, or several: a recording each, of which the last is for validation where ``validation`` names none.
    urdf
        Path of the robot's URDF, or any other robot that `bayesid.load_robot` takes.
    validation
        Recordings that are only predicted, whether or not ``source`` names them too.
    mapping
        A TOML file with ``[columns]``, ``[units]`` and ``[units.scale]``.
    columns
        The log's names by ours: ``{"t": "Time", "q": "{joint}/pos", "fx": "Fx"}``; in place of those of ``mapping``, as the
        next four.
    units
        By quantity or column: ``{"t": "ms", "q": "deg", "tau": "A"}``.
    scale
        Factors by column, quantity, or joint (of its torque): ``{"elbow_joint": 11.2}`` [N m/A at the joint].
    joint_names
        The log's names of joints by the URDF's, where they differ.
    shift
        What is added to the times of a quantity [s]: ``{"wrench": -0.03}`` where its stamps are 30 ms late.
    joints
        Moving joints in the order of q1 ... qn; default: every moving joint that has positions, in the URDF's order.
    locked
        Where other joints stand [rad or m]; default 0.
    gravity
        In the base frame (3,) [m/s^2].
    sensor
        Where the wrench is measured: ``"base"``, the name of a joint, or a `Sensor`; default: the fixed joint whose child link
        the messages name as their frame.
    clock
        Of topics: stamps of headers, or times of the log; default: stamps, where there are any.
    topics
        Of a bag, those to be read; default: joint states and wrenches, and those that ``columns`` names.
    episodes
        Of a LeRobot data set, those to be read; default: all.
    join_files
        Whether the files of ``source`` are parts of one recording.
    rate
        Samples a second of tables that hold no times [Hz].
    kind
        ``poses`` where every row is a separate pose at rest; then no times are needed.
    hold_out
        Share of each recording for identification, its end, that is kept for validation: a motion of its own.
    name
        The experiment's.

    Returns
    -------
    imported
        The experiment, and what was done; ``imported.write(folder)`` writes an experiment folder.

    Raises
    ------
    InputError
        A file cannot be read, a column is not found or could be several, or what is recorded cannot be right.
    """
    stated = ColumnMap() if mapping is None else load_column_map(mapping)
    beside = dict(columns=columns, units=units, scale=scale, joints=joint_names, shift=shift)
    stated = replace(stated, **{key: {**getattr(stated, key), **more} for key, more in beside.items() if more})
    topics, joints = as_names(topics) or (), as_names(joints)
    _check_meant([*_paths(source), *_paths(validation)], topics=topics, clock=clock, episodes=episodes)
    options = dict(topics=topics, mapped=stated.names(), episodes=episodes, poses=kind == "poses")
    times = stated_times(stated) if join_files else None
    predicted = {path.resolve() for path in _paths(validation)}
    fitted = [path for path in _paths(source) if path.resolve() not in predicted]
    given, held_out = _read(fitted, times, **options), _read(validation, times, **options)
    if not given:
        what = "every recording is for validation; name one that is not" if held_out else "no recording is given; name one"
        raise InputError(f"{what} ({argument('source')})")
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise InputError(f"{argument('rate', rate)}: give samples a second, such as 500")
    if hold_out is not None and not 0.0 < hold_out < 1.0:
        raise InputError(f"{argument('hold_out', hold_out)}: give a share between 0 and 1, such as 0.3")
    if len(given) > 1 and not held_out and hold_out is None:
        given, held_out = given[:-1], given[-1:]
    file = read_urdf(urdf)
    moving = _moving(file)
    stated.check_joints(moving)
    for key, names in (("joints", joints or ()), ("locked", locked or {})):
        for joint in names:
            if joint not in moving:
                raise InputError(f"{argument(key)}: {joint} is no moving joint of {file.path.name}; {suggest(joint, moving)}")
    sliding = [joint for joint in moving if file.joints[joint].kind == "prismatic"]

    def make(one: Source) -> Recording:
        return make_recording(one, stated, moving, joints, clock, kind == "poses", locked or {}, sliding, rate)

    sources = [*given, *held_out]
    try:
        made = [(make(one), files) for one, files in sources]
    except InputError as error:
        if len(sources) > 1 and not join_files and (remedy := _of_several(make, [one for one, _ in sources], stated)):
            raise InputError(f"{error}{'' if str(error).endswith('?') else '.'} {remedy}") from None
        raise
    joints = _shared_joints([recording for recording, _ in made])
    notes: list[str] = []
    placed, place_notes = _sensor(sensor, [recording for recording, _ in made], file)
    notes += place_notes
    stand, stand_notes = _locked([joint for joint in moving if joint not in joints], dict(locked or {}), made)
    notes += stand_notes
    robot = load_robot(file, list(joints), stand, gravity, None if placed is None else placed.joint)
    doubts = robot_doubts(robot, stand, "")
    effects, values = with_stated_effects(robot)
    if effects:
        kinds = dict.fromkeys(effect.partition("@")[0] for effect in effects)
        notes.append(f"{file.path.name} states {listed(kinds)}: effects of the model, its numbers their starting values")
    names = _names([recording.source.name for recording, _ in made])
    motions = [
        Motion(label, "identification" if k < len(given) else "validation", recording.table(label), kind=kind)
        for k, (label, (recording, _)) in enumerate(zip(names, made, strict=True))
    ]
    if hold_out is not None:
        motions = [part for motion in motions for part in _halves(motion, hold_out)]
    usable = [_usable(motion, joints) for motion in motions]
    motions, notes = [motion for motion, _ in usable], [*notes, *(text for _, texts in usable for text in texts)]
    if not any(motion.role == "validation" for motion in motions):
        notes.append(
            f"no recording for validation: name one ({argument('validation')}), or hold out the end of this one "
            f"({argument('hold_out', 0.3)}), to test the estimate"
        )
    _check_readings(motions, placed, made[0][0])
    notes += [
        f"{motion.name}: no wrench of all six axes is found although a sensor is stated: torques alone are used"
        for motion in motions if motion.table.wrench is None and placed is not None
    ]  # fmt: skip
    try:
        experiment = Experiment(
            name=_names([name])[0], robot=robot, motions=tuple(motions), sensor=placed, locked=stand, warnings=tuple(doubts),
            effects=effects, effect_values=values,
        )  # fmt: skip
    except InputError as error:
        raise _of_log(error, dict(zip(names, (recording for recording, _ in made), strict=True))) from None
    recordings = tuple(
        ImportedRecording(label, files, recording, _delays(experiment, label, recording))
        for label, (recording, files) in zip(names, made, strict=True)
    )
    return Imported(experiment, recordings, tuple(notes))


def _of_several(make: Callable[[Source], Recording], sources: Sequence[Source], stated: ColumnMap) -> str:
    """What would read several files of which one is no recording by itself; empty where nothing would."""
    nameless = all(column.startswith(f"{one.name}[") for one in sources for stream in one.streams for column in stream.columns)
    try:
        used = {found.column.rpartition("[")[0] for found in make(joined_files(sources, stated_times(stated))).layout.found}
    except InputError:
        used = set()
    names = {one.name for one in sources}
    if nameless and not used >= names:
        if len(names) == 1 or any("{file}" in name for name in stated.names()):
            return ""
        return f'In {argument("columns")}, "{{file}}" stands for the name of each file, such as in q={{file}}[0:6] of six joints'
    return f"Together the files are one recording: {argument('join_files', True)} reads them so" if used else ""


def _halves(motion: Motion, share: float) -> list[Motion]:
    """A recording for identification, and its end for validation; one for validation as it is."""
    if motion.role == "validation":
        return [motion]
    table = motion.table
    cut = int(np.searchsorted(table.times, table.times[0] + (1.0 - share) * table.duration))
    end = replace(table[cut:], source=f"{motion.name}-end", notes=())
    return [replace(motion, table=table[:cut]), Motion(f"{motion.name}-end", "validation", end, kind=motion.kind)]


def _usable(motion: Motion, joints: Sequence[str]) -> tuple[Motion, list[str]]:
    """A motion without velocities that are none and old samples at the times of new ones, and what was left out.

    What is held out may be slow beside the rest of its recording, and seem to rest there.
    """
    if motion.kind != "trajectory":
        return motion, []
    notes, table = [], motion.table
    if zero := zero_velocities(table):
        notes.append(
            f"{motion.name}: velocities are 0 in every row of {listed([joints[j] for j in zero], 4)}, which move"
            f"{'s' if len(zero) == 1 else ''}: not used, they are those of the positions"
        )
        table = replace(table, velocities=None)
    whole, table = len(table), without_stalls(table)
    if len(table) < whole:
        notes.append(f"{motion.name}: {STALLED.format(whole - len(table), whole, '')}")
    return replace(motion, table=table), notes


def _locked(
    joints: Sequence[str], given: dict[str, float], made: Sequence[tuple[Recording, tuple[str, ...]]]
) -> tuple[dict[str, float], list[str]]:
    """Where joints stand that are not used: as stated, else as recorded, else at zero; and what is to be said of it."""
    notes, without, stand = [], [], {}
    for joint in joints:
        if joint in given:
            continue
        at = [recording.resting[joint] for recording, _ in made if joint in recording.resting]
        stand[joint] = float(np.median([middle for middle, _ in at])) if at else 0.0
        if not at:
            without.append(joint)
        elif max(span for _, span in at) > _STANDS:
            far = max(span for _, span in at)
            notes.append(
                f"{joint} is not used but moves by {far:.3g}: it is locked in the middle, at {stand[joint]:.4g}; use it "
                f"({argument('joints')}), if its motion counts"
            )
        else:
            notes.append(f"{joint} is not used and stands: locked at {stand[joint]:.4g}")
    if without:
        they = "it stands" if len(without) == 1 else "they stand"
        notes.append(f"no positions of {listed(without)}: locked at 0; say where {they} ({argument('locked')})")
    return stand | given, notes


def _moving(file: UrdfFile) -> list[str]:
    """Every moving joint in the order that a robot has them by default."""
    still = ("fixed", "floating", "planar")
    return [name for name in load_robot(file).joint_names if name in file.joints and file.joints[name].kind not in still]


def _paths(given: _Paths) -> list[Path]:
    return [Path(given)] if isinstance(given, (str, Path)) else [Path(path) for path in given]


def _check_meant(paths: Sequence[Path], **given: Any) -> None:
    """Refuse an option of bags or data sets where none is read."""
    kinds = {kind_of(path) for path in paths}
    for option, value in given.items():
        kind, what = ("lerobot", "data sets of LeRobot") if option == "episodes" else ("bag", "bags")
        if value and kind not in kinds and all(path.exists() for path in paths):
            raise InputError(f"{argument(option)}: holds for {what} only, and none is given; leave it out")


def _read(paths: _Paths, times: Sequence[str] | None, **options: Any) -> list[tuple[Source, tuple[str, ...]]]:
    """What files hold, with their names: a recording each, or all together one, whose ``times`` are stated or none."""
    files = _paths(paths)
    sources = [(one, (path.name,)) for path in files for one in read_source(path, **options)]
    if times is not None and len(sources) > 1:
        return [(joined_files([one for one, _ in sources], times), tuple(path.name for path in files))]
    return sources


def _shared_joints(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """The joints of all recordings, which must be the same."""
    first = recordings[0]
    for recording in recordings:
        if recording.layout.joints != first.layout.joints:
            raise InputError(
                f"has positions of {listed(recording.layout.joints)}, but {first.source.name} of {listed(first.layout.joints)}",
                file=recording.source.name, remedy=f"name the joints of both ({argument('joints')}), or leave one out",
            )  # fmt: skip
    return first.layout.joints


def _names(given: Sequence[str]) -> list[str]:
    """Names of motions: of the files, apart and as experiment.toml takes them."""
    names: list[str] = []
    for text in given:
        plain = "".join(c if c.isprintable() else "_" for c in re.sub(r'[/\\,"\s]+', "_", text)).lstrip(".")
        plain = plain.encode()[:_LONGEST_NAME].decode(errors="ignore") or "recording"
        name, k = plain, 2
        while name in names:
            name, k = f"{plain}-{k}", k + 1
        names.append(name)
    return names


def _sensor(given: Sensor | str | None, recordings: Sequence[Recording], file: UrdfFile) -> tuple[Sensor | None, list[str]]:
    """Where the wrench is measured, as stated or as the messages' frame says."""
    frames = {f.stream.frame for recording in recordings for f in recording.layout.found if f.ours == "fx"}
    if isinstance(given, Sensor):
        return given, []
    if given == "base":
        return Sensor(), []
    if given is not None:
        if given not in file.joints:
            raise InputError(
                f"{argument('sensor', given)}: no joint of that name", value=given,
                remedy=f'write "base", or {suggest(given, file.joints, "one of")}',
            )  # fmt: skip
        return Sensor(joint=given), []
    if not frames:
        return None, []
    (frame, *others) = frames
    children = {joint.child: joint for joint in file.joints.values()}
    if not others and frame in children and children[frame].kind == "fixed":
        joint = children[frame].name
        return Sensor(joint=joint), [
            f"the wrench is in frame {frame}: the sensor sits in joint {joint}, and measures what is beyond"
        ]
    what = f'its frame "{frame}" is no child link of a fixed joint of the URDF' if not others and frame else "no frame says where"
    return None, [
        f"the wrench is kept but not used, for it is not known where the sensor sits ({what}): say it "
        f"({argument('sensor', 'base')} or the name of a joint; or in [sensor] of experiment.toml once it is written)"
    ]


def _check_readings(motions: Sequence[Motion], sensor: Sensor | None, recording: Recording) -> None:
    for motion in motions:
        if motion.table.torques is None and (motion.table.wrench is None or sensor is None):
            if motion.table.wrench is not None:
                raise InputError(
                    "there is a wrench, and no torques, but it is not known where the sensor sits", file=motion.name,
                    remedy=f"say it: {argument('sensor', 'base')}, or the name of the joint that it sits in",
                )  # fmt: skip
            joints = recording.layout.joints
            measured = currents(recording.source.streams, len(joints))
            said = where_torques_are(recording.source.streams, len(joints))
            if measured:
                said = (
                    f"{listed(measured, 4)} may be motor currents: {argument('columns')} tau={measured[0]}, {argument('units')} "
                    f"tau=A, and N m per A at each joint, {argument('scale')} {joints[0]}=11.2,..."
                )
            raise InputError("no torques and no wrench are found", file=motion.name, remedy=said)


def _of_log(error: InputError, recordings: Mapping[str, Recording]) -> InputError:
    """A complaint with the log's own names of columns, and where it is of a unit with what says the unit in an import."""
    text = str(error)
    said = next((option for words, option in _UNITS.items() if words in text), None)
    recording = next((r for name, r in recordings.items() if text.startswith((f"{name}:", f"{name}-end:"))), None)
    theirs = {} if recording is None else recording.names
    text = text.replace('write kind = "poses"', f"say {argument('kind', 'poses')}")
    text = re.sub(r"\bcolumn (\w+)", lambda m: f'column "{theirs[m[1]]}"' if m[1] in theirs else m[0], text)
    return InputError(f"{text} (or say so: {argument('units')} {said})" if said else text)


def _delays(experiment: Experiment, name: str, recording: Recording) -> tuple[Delay, ...]:
    """Delays of other topics against that of the positions."""
    if experiment[name].kind == "poses":
        return ()
    positions = next(s for s in recording.signals if s.quantity == "q")
    out = []
    for signal in recording.signals:
        found, method = None, "by what the motion explains of it"
        if signal.topic == positions.topic or (signal.quantity == "wrench" and experiment.sensor is None):
            continue
        if signal.quantity in ("wrench", "tau"):
            profile = delay_profile(
                replace(experiment, motions=(experiment[name],)), "wrench" if signal.quantity == "wrench" else "torque"
            )
            found = None if profile is None else profile.best()
        elif signal.quantity in ("v", "qr"):
            found, method = _lag(signal, positions), "cross-correlation"
        if found is not None:
            out.append(Delay(signal.called, positions.called, *found, method))
    return tuple(out)


def _lag(signal: Signal, positions: Signal) -> tuple[float, float] | None:
    """The lag of velocities behind the positions' rates, or of commands behind the positions (negative: ahead)."""
    shared = [k for k, ours in enumerate(positions.ours) if f"{signal.quantity}{ours[1:]}" in signal.ours]
    columns = [signal.ours.index(f"{signal.quantity}{positions.ours[k][1:]}") for k in shared]
    (later, late, _), (times, values, _) = signal.unwrapped(), positions.unwrapped()
    values = values[:, shared]
    if len(times) < 20 or not len(later) or not shared or positions.gaps():
        return None
    bandwidth = min(_COURSE, 0.2 / positions.step)
    smoothed = smooth(times, values - values.mean(axis=0), bandwidth)
    course, rate = (CubicSpline(times, smoothed[k]) for k in ((1, 2) if signal.quantity == "v" else (0, 1)))
    return lag(later, late[:, columns], lambda at: (course(at), rate(at)), float(times[0]), float(times[-1]))
