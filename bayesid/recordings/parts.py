"""The parts of an experiment: sensor and motions, and what a user gives in Python for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin

from bayesid.argument_types import explains_types
from bayesid.drawing import Plots, figures_of
from bayesid.errors import InputError
from bayesid.recordings.complaints import listed, suggest
from bayesid.recordings.stored import StoredTable
from bayesid.recordings.table import WRENCH_COLUMNS, Table
from bayesid.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@explains_types
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
        for name in ("force_std", "torque_std"):
            std = getattr(self, name)
            if std is not None and not 0.0 < std < np.inf:
                raise InputError(f"sensor {name}: {std} is no sensor's noise; give a number above 0, or None if it is not known")

    @property
    def rotation(self) -> np.ndarray:
        """Orientation of its frame as a matrix (3, 3)."""
        return pin.rpy.rpyToMatrix(*map(float, self.rpy))

    @property
    def mounted(self) -> np.ndarray:
        """``translation`` and ``rpy``, one after the other (6,) [m, rad]."""
        return np.concatenate([self.translation, self.rpy])


@explains_types
@dataclass(frozen=True, eq=False)
class Motion(Plots):
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
    examined
        Whether its tables have passed the checks of recorded data; an `Experiment` examines the motions that have not.
    stored
        The whole recording, where it is read in chunks; ``table`` is then an excerpt.
    """

    report = "fit_figures"
    name: str
    role: Literal["identification", "validation"]
    table: Table
    kind: Literal["trajectory", "poses"] = "trajectory"
    static: Table | None = None
    period: float | None = None
    parked: tuple[tuple[float, float], ...] = ()
    examined: bool = False
    stored: StoredTable | None = None

    def __post_init__(self) -> None:
        """Check the words, and leave rows that one of two tables with the same rows lacks out of the other, too."""
        for key, known in (("role", ("identification", "validation")), ("kind", ("trajectory", "poses"))):
            given = getattr(self, key)
            if given not in known:
                raise InputError(f"motion '{self.name}': {key} = {given!r}: give one of {', '.join(map(repr, known))}")
        if self.static is None:
            return
        table, static = self.table, self.static
        if len(table) + len(table.dropped) == len(static) + len(static.dropped):
            object.__setattr__(self, "table", table.without(static.dropped))
            object.__setattr__(self, "static", static.without(table.dropped))

    def __repr__(self) -> str:
        return f"<Motion {self.name} ({self.role}): {self.table!r}>"

    def plot(self, *, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
        """Draw positions and readings over time, a panel for each group of columns.

        Parameters
        ----------
        channels
            Columns to be drawn, such as ``["q1", "fx"]``; default all.
        ax
            matplotlib's Axes to draw into, one for each group drawn (positions, forces, moments, torques); default a figure of
            its own.

        Raises
        ------
        InputError
            There is no such column, or there are fewer or more axes than groups.
        """
        return figures_of(self)["recording"](channels, ax)

    @property
    def stop_and_go(self) -> bool:
        """Whether the static table holds the motion's own positions, row by row."""
        return self.static is not None and len(self.static) == len(self.table)


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
    # Copies: whoever reads the next recording into the same array would change this one.
    own = {names[key]: values.copy() if hasattr(values, "copy") else values for key, values in given.items()}
    return Table(**own, source=source)
