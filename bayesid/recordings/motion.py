"""One recording and what is known about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from bayesid.argument_types import explains_types
from bayesid.drawing import Plots, figures_of
from bayesid.errors import InputError
from bayesid.recordings.stored import StoredTable
from bayesid.recordings.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
