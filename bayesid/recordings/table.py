"""One recording as arrays; `bayesid.recordings.table_reader` reads it from a file."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayesid.errors import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

WRENCH_COLUMNS = ("fx", "fy", "fz", "mx", "my", "mz")
GAP = 5.0  # a step this many times the median one is a gap: nothing may be filtered across it
_BLOCK_ROWS = 200_000
#: Columns of one number a joint, by the array they go into.
JOINT_GROUPS = {"positions": "q", "velocities": "v", "commanded": "qr", "torques": "tau"}


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
    """

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    commanded: np.ndarray | None = None
    torques: np.ndarray | None = None
    wrench: np.ndarray | None = None
    source: str = "table"

    def __post_init__(self) -> None:
        """Make every array a read-only float64 view and check that they fit together."""
        positions = np.asarray(self.positions)
        if positions.ndim != 2:
            raise InputError(f"{self.source}: positions have shape {positions.shape}; give (samples, joints)")
        rows, joints = positions.shape
        shapes = {
            "times": (rows,), "positions": (rows, joints), "velocities": (rows, joints), "commanded": (rows, joints),
            "torques": (rows, joints), "wrench": (rows, 6),
        }  # fmt: skip
        for field, shape in shapes.items():
            given = getattr(self, field)
            if given is None:
                continue
            array = np.asarray(given, dtype=np.float64).view()
            if array.shape != shape:
                raise InputError(f"{self.source}: {field} have shape {array.shape}; give {shape}")
            if not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                raise InputError(f"{self.source}: {field}, row {row}: not finite; leave out rows without a reading")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        check_increasing(self.times, self.source, lambda row: f"row {row}")

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
        arrays = {name: getattr(self, name) for name in ("times", *JOINT_GROUPS, "wrench")}
        return replace(self, **{name: array[picked] for name, array in arrays.items() if array is not None})

    def to_dataframe(self) -> DataFrame:
        """The samples, a row each, in the columns of a recorded table: ``t``, ``q1``, ..., ``fx``, ..., ``mz`` [SI units]."""
        from pandas import DataFrame  # takes longer to import than most tables take to read

        columns: dict[str, np.ndarray] = {"t": self.times}
        for field, prefix in JOINT_GROUPS.items():
            array = getattr(self, field)
            if array is not None:
                columns |= {f"{prefix}{j + 1}": array[:, j] for j in range(array.shape[1])}
        if self.wrench is not None:
            columns |= {name: self.wrench[:, k] for k, name in enumerate(WRENCH_COLUMNS)}
        return DataFrame(columns)

    @property
    def step(self) -> float:
        """The usual time between samples (their median) [s]; 0 for a single sample."""
        return usual_step(self.times) if len(self) > 1 else 0.0

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0]) if len(self) else 0.0

    def channels(self) -> list[tuple[str, np.ndarray]]:
        """Name and readings (N,) of every wrench and torque column."""
        named: list[tuple[str, np.ndarray]] = []
        if self.wrench is not None:
            named += zip(WRENCH_COLUMNS, self.wrench.T, strict=True)
        if self.torques is not None:
            named += [(f"tau{j + 1}", column) for j, column in enumerate(self.torques.T)]
        return named

    def segments(self) -> list[slice]:
        """Return the pieces between gaps, in order: steps above five times the median one are gaps."""
        longest, edges = GAP * self.step, [0]
        for first in range(0, len(self) - 1, _BLOCK_ROWS):  # in blocks, so that no array of the table's length is made
            steps = np.diff(self.times[first : first + _BLOCK_ROWS + 1])
            edges += (np.flatnonzero(steps > longest) + first + 1).tolist()
        edges.append(len(self))
        return [slice(a, b) for a, b in itertools.pairwise(edges)]


def usual_step(times: np.ndarray) -> float:
    """Median step of times (N,), judged by the first hundred thousand or so [s]."""
    return float(np.median(np.diff(times[: 1 << 17])))


def write_table(table: Table, path: Path) -> None:
    """Write a table as CSV, with digits enough to read the same numbers back."""
    table.to_dataframe().to_csv(path, index=False, lineterminator="\n")


def check_increasing(times: np.ndarray, source: str, place: Callable[[int], str]) -> None:
    """Refuse times (N,) that do not strictly increase; ``place`` names a row."""
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        row = int(wrong[0]) + 1
        before, here = float(times[row - 1]), float(times[row])
        fault = "is repeated" if here == before else "goes back"
        raise InputError(
            f"{source}: column t, {place(row)}: time {fault}, {here:g} after {before:g} "
            f"({len(wrong)} such rows); times must strictly increase: export them again or remove those rows"
        )
