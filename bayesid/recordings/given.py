"""What a user gives in Python for the parts of an experiment: told apart, and refused in one line where it is of another kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bayesid.errors import InputError
from bayesid.recordings.complaints import listed, suggest
from bayesid.recordings.motion import Motion
from bayesid.recordings.sensor import Sensor
from bayesid.recordings.table import WRENCH_COLUMNS, Table
from bayesid.robot.robot import Robot


def check_kinds(experiment: str, robot: object, sensor: object, motions: Iterable[object]) -> None:
    """Refuse parts of another kind, such as a path for the robot."""
    parts: list[tuple[str, object, Any, str]] = [
        ("robot", robot, Robot, "bayesid.load_robot(...)"), ("sensor", sensor, Sensor | None, "bayesid.Sensor(...)"),
    ]  # fmt: skip
    for motion in motions:
        parts.append(("a motion", motion, Motion, "bayesid.Motion(...)"))
        if isinstance(motion, Motion):
            parts.append((f"the table of {motion.name}", motion.table, Table, "bayesid.Table(...)"))
            parts.append((f"static of {motion.name}", motion.static, Table | None, "bayesid.Table(...)"))
    for name, part, kind, remedy in parts:
        if not isinstance(part, kind):
            raise InputError(f"experiment {experiment}: {name} is a {type(part).__name__}; give {remedy}")


def listed_effects(effects: Sequence[str] | str) -> tuple[str, ...]:
    """Effects one by one, of a list or of one text with commas between."""
    return tuple(part.strip() for part in effects.split(",")) if isinstance(effects, str) else tuple(effects)


def as_table(given: Mapping[str, Any], robot: Robot, source: str) -> Table:
    """A recording's arrays by the names of `Experiment.from_arrays`, as a table."""
    if not isinstance(given, Mapping):
        raise InputError(f"{source}: is a {type(given).__name__}; give dict(t=..., q=..., torques=...), or a Table")
    names = {"t": "times", "q": "positions", **{k: k for k in ("torques", "wrench", "velocities", "commanded")}}
    for key in given:
        if key not in names:
            raise InputError(f"{source}: {key}: no such array; {suggest(key, names)}")
    for key in ("t", "q"):
        if given.get(key) is None:
            raise InputError(f"{source}: {key} is missing; give times t (N,) and joint positions q (N, n)")
    for key, values in given.items():
        columns, order = list(getattr(values, "columns", ())), WRENCH_COLUMNS if key == "wrench" else robot.joint_names
        if sorted(map(str, columns)) == sorted(order) and columns != list(order):
            remedy = "give them in this order" + ("" if key == "wrench" else ", or joints=[...] in that of the columns")
            raise InputError(f"{source}: {key}: the columns are {listed(columns)}, not {listed(order)}; {remedy}")
    return Table(**{names[key]: value for key, value in given.items()}, source=source)
