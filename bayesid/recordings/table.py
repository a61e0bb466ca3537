"""One recording as arrays; `bayesid.recordings.table_reader` reads it from a file."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import unmasked
from bayesid.errors import InputError
from bayesid.recordings.complaints import columns_of

#: What to do about rows of which most lack a reading.
JOIN = "if topics of different rates were joined, interpolate them at the times of one; else leave the column out"


def usable_rows(
    times: np.ndarray, columns: Mapping[str, np.ndarray], source: str, place: Callable[[int], str]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows without a reading and those that repeat the time before (k,), and a line for each of the reasons that there is.

    Of the ``times`` (N,) [s], one that goes back is an error of its own, which is not looked for here; ``columns`` are readings
    (N,), NaN where there is none. An `InputError` where most rows would be left out: the table is a join of topics of their own
    times, or its times have too few digits.
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
        _refuse_most(fault, repeats, len(filled), source, "column t", place(int(repeats[0])), remedy)
        notes.append(_note("column t", repeats, "at the time of the row before", source, place, times))
    missing = np.flatnonzero(empty)
    if len(missing):
        _refuse_most("no reading", missing, len(times), source, columns_of(holes), place(int(missing[0])), JOIN)
        notes.append(_note(columns_of(holes), missing, "without a reading", source, place, times))
    return np.union1d(missing, repeats), tuple(notes)


def _note(what: str, rows: np.ndarray, fault: str, source: str, place: Callable[[int], str], times: np.ndarray) -> str:
    first = int(rows[0])
    at = f", {times[first]:.6g} s" if np.isfinite(times[first]) else ""
    where = f"{'the first: ' if len(rows) > 1 else ''}{place(first)}{at}"
    count = f"{len(rows)} row{'s' * (len(rows) > 1)}"
    return f"{source}: {what}: {count} {fault} ({where}) left out, nothing is filled in; check the logger"


def _refuse_most(fault: str, rows: np.ndarray, of: int, source: str, columns: str, where: str, remedy: str) -> None:
    if 2 * len(rows) > of:
        problem = f"{fault} ({len(rows)} of {of} rows)"
        raise InputError(problem, file=source, key=f"{columns}, {where}", value=len(rows), remedy=remedy)


if TYPE_CHECKING:
    from pandas import DataFrame

WRENCH_COLUMNS = ("fx", "fy", "fz", "mx", "my", "mz")
LONGEST_STEP = 0.5  # samples this far apart are no trajectory [s]
GAP = 5.0  # a step this many times the median one is a gap: nothing may be filtered across it
_BLOCK_ROWS = 200_000
#: Columns of one number a joint, by the array they go into.
JOINT_GROUPS = {"positions": "q", "velocities": "v", "commanded": "qr", "torques": "tau"}


@explains_types
@dataclass(frozen=True, eq=False)
class Table:
    """One recording of ``N`` samples of ``n`` joints; every array is read-only.

    Attributes
    ----------
    times
        (N,), strictly increasing [s].
    positions
        Encoder readings (N, n) [rad or m].
    velocities, commanded, torques
        (N, n) [rad/s or m/s], [rad or m], [N m or N], or None.
    wrench
        Force, then moment about the sensor origin, sensor frame (N, 6) [N, N m], or None.
    source
        The file's name, for messages.
    dropped, notes
        Rows of the recording that were left out on reading, for they had no reading or the time of the row before (k,), and
        what is to be said of that, one line each.

    Torques of a joint that has none are NaN in every row; `torque_joints` are the others. Any other NaN is a row without a
    reading: such rows are left out when a table is made.
    """

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    commanded: np.ndarray | None = None
    torques: np.ndarray | None = None
    wrench: np.ndarray | None = None
    source: str = "table"
    dropped: np.ndarray = field(default_factory=lambda: np.zeros(0, int), repr=False)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make every array a read-only float64 view, check that they fit together, and leave out rows without a reading."""
        positions = _floats(self.positions, f"{self.source}: positions")
        if positions.ndim != 2:
            raise InputError(f"{self.source}: positions have shape {positions.shape}; give (samples, joints)")
        count = np.size(np.asarray(self.times))
        if len(positions) != count == positions.shape[1]:
            raise InputError(f"{self.source}: positions have shape {positions.shape}; give {positions.T.shape}, samples first")
        rows, joints = positions.shape
        if not rows:
            raise InputError(f"{self.source}: has no rows; give one row per sample")
        shapes = {
            "times": (rows,), "positions": (rows, joints), "velocities": (rows, joints), "commanded": (rows, joints),
            "torques": (rows, joints), "wrench": (rows, 6),
        }  # fmt: skip
        arrays: dict[str, np.ndarray] = {}
        for name, shape in shapes.items():
            given = getattr(self, name)
            if given is None:
                continue
            array = seconds(given, self.source) if name == "times" else _floats(given, f"{self.source}: {name}")
            if array.shape != shape:
                turned = ", samples first" if array.ndim == 2 and array.T.shape == shape else ""
                raise InputError(f"{self.source}: {name} have shape {array.shape}; give {shape}{turned}")
            if np.isinf(array).any():
                row = int(np.argwhere(np.isinf(array))[0][0])
                raise InputError(f"{self.source}: {name}, row {row}: not finite; leave out rows without a reading")
            arrays[name] = array
        if "torques" in arrays and np.isnan(arrays["torques"]).all():
            del arrays["torques"]  # of no joint at all
        dropped, notes = usable_rows(arrays["times"], _columns(arrays), self.source, lambda row: f"row {row}")
        if len(dropped):
            arrays = {name: np.delete(array, dropped, axis=0) for name, array in arrays.items()}
            object.__setattr__(self, "dropped", dropped)
            object.__setattr__(self, "notes", (*self.notes, *notes))
        for name in shapes:
            array = arrays.get(name)
            if array is not None:
                array = array.view()
                array.setflags(write=False)
            object.__setattr__(self, name, array)
        check_increasing(self.times, self.source, lambda row: f"row {row}")

    @property
    def _arrays(self) -> dict[str, np.ndarray]:
        """All arrays that there are by their names."""
        names = ("times", *JOINT_GROUPS, "wrench")
        return {name: array for name in names if (array := getattr(self, name)) is not None}

    def __repr__(self) -> str:
        return f"<Table {self.source}: {len(self)} samples, {self.positions.shape[1]} joints, {self.duration:.4g} s>"

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.times)

    def __getitem__(self, rows: slice | int | np.ndarray) -> Table:
        """Some samples as a table of their own.

        Parameters
        ----------
        rows
            Anything that picks rows of an array, times still rising: ``table[:100]``, ``table[::10]``, a mask (N,).

        Raises
        ------
        InputError
            The times that are picked do not rise.
        """
        picked = np.atleast_1d(np.arange(len(self))[rows])
        return replace(self, **{name: array[picked] for name, array in self._arrays.items()}, dropped=np.zeros(0, int))

    def to_dataframe(self) -> DataFrame:
        """The samples, a row each, in the columns of a recorded table: ``t``, ``q1``, ..., ``fx``, ..., ``mz`` [SI units]."""
        from pandas import DataFrame  # takes longer to import than most tables take to read

        return DataFrame({"t": self.times} | _columns(self._arrays))

    @property
    def step(self) -> float:
        """The usual time between samples (their median) [s]; 0 for a single sample."""
        return usual_step(self.times) if len(self) > 1 else 0.0

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0]) if len(self) else 0.0

    @property
    def torque_joints(self) -> tuple[int, ...]:
        """Indices of the joints whose torques were recorded."""
        return () if self.torques is None else tuple(map(int, np.flatnonzero(~np.isnan(self.torques[0]))))

    def without(self, rows: np.ndarray) -> Table:
        """The table without more rows, by their indices in the recording as it was read (k,)."""
        more = np.setdiff1d(rows, self.dropped)
        kept = np.delete(np.arange(len(self) + len(self.dropped)), self.dropped)
        arrays = {name: np.delete(array, np.searchsorted(kept, more), axis=0) for name, array in self._arrays.items()}
        return replace(self, **arrays, dropped=np.union1d(self.dropped, more))

    def channels(self) -> list[tuple[str, np.ndarray]]:
        """Name and readings (N,) of every wrench and torque column."""
        wrench = [] if self.wrench is None else list(zip(WRENCH_COLUMNS, self.wrench.T, strict=True))
        return wrench + [(f"tau{j + 1}", self.torques[:, j]) for j in self.torque_joints if self.torques is not None]

    def segments(self) -> list[slice]:
        """Return the pieces between gaps, in order: steps above five times the median one are gaps."""
        longest, edges = GAP * self.step, [0]
        for first in range(0, len(self) - 1, _BLOCK_ROWS):  # in blocks, so that no array of the table's length is made
            steps = np.diff(self.times[first : first + _BLOCK_ROWS + 1])
            edges += (np.flatnonzero(steps > longest) + first + 1).tolist()
        edges.append(len(self))
        return [slice(a, b) for a, b in itertools.pairwise(edges)]


def seconds(times: object, source: str) -> np.ndarray:
    """Times as numbers (N,) [s]: dates and durations, whose unit is known, count from the first."""
    given = np.asarray(unmasked(times))
    if given.dtype.kind == "O" and given.ndim == 1 and any(isinstance(one, datetime) for one in given[:2]):
        from pandas import DatetimeIndex, to_datetime  # as above

        given = DatetimeIndex(to_datetime(given, utc=True)).tz_localize(None).to_numpy()
    if given.dtype.kind in "mM" and given.ndim == 1:
        empty = np.isnat(given)
        since = given - given[~empty][:1] if not empty.all() else given
        return np.where(empty, np.nan, since / np.timedelta64(1, "s"))
    return _floats(given, f"{source}: times")


def _floats(given: object, what: str) -> np.ndarray:
    """Numbers as a float64 array, a view where they are one already; nan where they are masked."""
    try:
        return np.asarray(unmasked(given), dtype=np.float64)
    except (TypeError, ValueError):
        with contextlib.suppress(AttributeError, TypeError, ValueError):  # what pandas calls NA has no number
            return cast(Any, given).to_numpy(dtype=np.float64, na_value=np.nan)
        raise InputError(f"{what}: are no array of numbers; give numbers, as many in every row") from None


def _columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Readings by the names of their columns, without torques of joints that have none."""
    out: dict[str, np.ndarray] = {}
    for group, prefix in JOINT_GROUPS.items():
        given = enumerate(arrays[group].T if group in arrays else ())
        out |= {f"{prefix}{j + 1}": column for j, column in given if group != "torques" or not np.isnan(column).all()}
    return out | dict(zip(WRENCH_COLUMNS, arrays["wrench"].T, strict=True) if "wrench" in arrays else ())


def of_every_joint(torques: np.ndarray, names: Sequence[str], joints: int) -> np.ndarray:
    """Torques of some joints (N, k), in columns ``tau1`` and so on, as those of all joints: NaN where there are none (N, n)."""
    if torques.shape[1] == joints:
        return torques
    every = np.full((len(torques), joints), np.nan)
    every[:, [int(name[3:]) - 1 for name in names]] = torques
    return every


def usual_step(times: np.ndarray) -> float:
    """Median step of times (N,), judged by the first hundred thousand or so [s]."""
    return float(np.median(np.diff(times[: 1 << 17])))


def write_table(table: Table, path: Path) -> None:
    """Write a table as CSV, with digits enough to read the same numbers back."""
    table.to_dataframe().to_csv(path, index=False, lineterminator="\n")


def check_increasing(times: np.ndarray, source: str, place: Callable[[int], str]) -> None:
    """Refuse times (N,) that go back; ``place`` names a row."""
    wrong = np.flatnonzero(np.diff(times) < 0.0)
    if len(wrong):
        row = int(wrong[0]) + 1
        before, here = float(times[row - 1]), float(times[row])
        remedy = "times must strictly increase: export them again or remove those rows"
        if (np.abs(times[wrong + 1] - times[0]) <= usual_step(times)).all():  # the clock starts again each time
            remedy = "do recordings follow each other there? give each a file of its own"
        raise InputError(
            f"{source}: column t, {place(row)}: time goes back, {here:g} after {before:g} "
            f"({len(wrong)} such row{'s' * (len(wrong) != 1)}); {remedy}"
        )
