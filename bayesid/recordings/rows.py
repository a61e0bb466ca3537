"""Rows of a recording that cannot be used, and what is said of those that are left out: nothing is filled in."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import listed


def usable_rows(
    times: np.ndarray, columns: Mapping[str, np.ndarray], source: str, place: Callable[[int], str]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Find the rows without a reading and those that repeat the time before.

    Parameters
    ----------
    times
        (N,) [s]; a time that goes back is an error of its own, which is not looked for here.
    columns
        Readings (N,) by the name of their column; NaN where there is none.
    source, place
        The recording's name, and the name of a row in it, for messages.

    Returns
    -------
    dropped, notes
        Indices of the rows to be left out (k,), ascending, and a line for each of the two reasons that there is.

    Raises
    ------
    InputError
        Most rows would be left out: the table is a join of topics of their own times, or its times have too few digits.
    """
    empty = np.isnan(times)
    holes = ["t"] if empty.any() else []
    for name, values in columns.items():
        without = np.isnan(values)
        if without.any():
            holes.append(name)
            if without.all():
                raise InputError(
                    "no reading in any row", file=source, key=f"column {name}", remedy="record it, or leave the column out"
                )
            empty |= without
    filled = np.flatnonzero(~empty)
    repeats = filled[1:][np.diff(times[filled]) == 0.0]
    notes = []
    if len(repeats):
        before = float(times[repeats[0]])
        fault, remedy = f"time is repeated, {before:g} after {before:g}", "write times with more digits, or remove those rows"
        _refuse_most(fault, repeats, len(filled), source, "t", place(int(repeats[0])), remedy)
        notes.append(_note("column t", repeats, "at the time of the row before", source, place, times))
    missing = np.flatnonzero(empty)
    if len(missing):
        names = listed(holes)
        remedy = "if topics of different rates were joined, interpolate them at the times of one; else leave the column out"
        _refuse_most("no reading", missing, len(times), source, names, place(int(missing[0])), remedy)
        notes.append(_note(f"column{'s' * (len(holes) > 1)} {names}", missing, "without a reading", source, place, times))
    return np.union1d(missing, repeats), tuple(notes)


def holes_left(dropped: np.ndarray, kept: int) -> np.ndarray:
    """Whether rows were left out between each kept row and the next (kept - 1,), by the indices of those left out."""
    rows = np.delete(np.arange(kept + len(dropped)), dropped)
    return np.diff(rows) > 1


def _note(what: str, rows: np.ndarray, fault: str, source: str, place: Callable[[int], str], times: np.ndarray) -> str:
    first = int(rows[0])
    at = f", {times[first]:.6g} s" if np.isfinite(times[first]) else ""
    where = f"{'the first: ' if len(rows) > 1 else ''}{place(first)}{at}"
    count = f"{len(rows)} row{'s' * (len(rows) > 1)}"
    return f"{source}: {what}: {count} {fault} ({where}) left out, nothing is filled in; check the logger"


def _refuse_most(fault: str, rows: np.ndarray, of: int, source: str, columns: str, where: str, remedy: str) -> None:
    if 2 * len(rows) > of:
        key = f"column{'s' * (',' in columns)} {columns}, {where}"
        raise InputError(f"{fault} ({len(rows)} of {of} rows)", file=source, key=key, value=len(rows), remedy=remedy)
