"""Samples of a slow topic, held in a fast log until the next one comes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesid.recordings.complaints import Finding, listed
from bayesid.recordings.table import Table

_JUDGED = 200_000  # rows of a long recording that are looked at
_FEWEST = 20  # changes
#: Rows from one change to the next, on average: what repeats less often is a lost message now and then.
_HELD = 1.4
#: The usual change beside the smallest: a signal that repeats because its steps are below a count moves by single counts.
_COUNTS = 3.0
_REGULAR = 0.9  # share of the changes that come when they are due
_DUE = 0.25  # of the time between changes; at least a row


@dataclass(frozen=True)
class HeldColumn:
    """A column that is new in some rows only.

    Attributes
    ----------
    column
        Its name.
    rows
        From one new sample to the next, on average.
    """

    column: str
    rows: float


def held_columns(table: Table) -> list[HeldColumn]:
    """Columns of which samples are held for several rows each while they change by far more than a count."""
    return [HeldColumn(name, rows) for name, values in _columns(table) if (rows := rows_held(values[:_JUDGED])) is not None]


def held_findings(table: Table, held: list[HeldColumn]) -> list[Finding]:
    """What is said of held columns: a line for those that are held alike."""
    out, rate = [], 1.0 / table.step
    left = list(held)
    while left:
        alike = [h for h in left if abs(h.rows - left[0].rows) < 0.1 * left[0].rows]
        left = [h for h in left if h not in alike]
        names, rows = [h.column for h in alike], float(np.median([h.rows for h in alike]))
        kinds = {name.rstrip("0123456789") for name in names}
        channels = {"torque": "tau" in kinds, "wrench": bool(kinds & {"fx", "fy", "fz", "mx", "my", "mz"})}
        silences = ("wrench", "torque") if "q" in kinds else tuple(channel for channel, is_held in channels.items() if is_held)
        remedy = (
            "leave them out"
            if kinds == {"v"}
            else "interpolate them between the rows in which they change, or record them at the rate of the log"
        )
        if len(names) == 1:
            remedy = remedy.replace("them", "it").replace("they change", "it changes")
        text = (
            f"{table.source}: column{'s' * (len(names) > 1)} {listed(names, 30)}: new only every {rows:.3g} rows "
            f"({rate / rows:.3g} Hz in a log of {rate:.4g} Hz), held in between as samples of a slower topic are, and so "
            f"{500.0 * rows / rate:.2g} ms late on average; {remedy}"
        )
        out.append(Finding(text, silences))
    return out


def _columns(table: Table) -> Iterator[tuple[str, np.ndarray]]:
    for array, prefix in ((table.positions, "q"), (table.velocities, "v")):
        if array is not None:
            yield from ((f"{prefix}{j + 1}", column) for j, column in enumerate(array.T))
    yield from table.channels()


def rows_held(values: np.ndarray) -> float | None:
    """Rows from one new sample to the next, on average; None for a column that is new in nearly every row or at rest."""
    steps = np.abs(np.diff(values))
    changes = np.flatnonzero(steps)
    if len(changes) < _FEWEST or np.median(steps[changes]) < _COUNTS * np.quantile(steps[changes], 0.05):
        return None
    apart = np.diff(changes)
    apart = apart[apart <= 3.0 * np.median(apart)]  # longer ones are rests
    rows = float(np.mean(apart))
    regular = np.mean(np.abs(apart - rows) <= max(_DUE * rows, 1.0))
    return rows if rows >= _HELD and regular >= _REGULAR else None
