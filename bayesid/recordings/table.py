"""One recording as arrays, and the CSV or Parquet file it is kept in.

A table is read in blocks that go straight into one array per group of columns, so that ten million rows need little
more memory than their numbers. Only when something is wrong is the file read again, to say where.
"""

from __future__ import annotations

import csv
import importlib
import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayesid.errors import InputError
from bayesid.recordings.schema import suggest

WRENCH_COLUMNS = ("fx", "fy", "fz", "mx", "my", "mz")
GAP = 5.0  # a step this many times the median one is a gap: nothing may be filtered across it
_BLOCK_ROWS = 200_000
_BLOCK_BYTES = 1 << 24
_JOINT_GROUPS = {"positions": "q", "velocities": "v", "commanded": "qr", "torques": "tau"}


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
        _check_increasing(self.times, self.source, lambda row: f"row {row}")

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.times)

    @property
    def step(self) -> float:
        """The usual time between samples (their median) [s]; 0 for a single sample."""
        return usual_step(self.times) if len(self) > 1 else 0.0

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0]) if len(self) else 0.0

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


def read_table(path: Path, source: str, joints: int, wrench: bool = True) -> tuple[Table, list[str]]:
    """Read a table.

    Parameters
    ----------
    path
        A CSV file, or a Parquet file (``.parquet``, ``.pq``).
    source
        What to call it in messages: its path within the experiment folder.
    joints
        How many joints there are: columns ``q1`` to ``q<joints>`` must be there.
    wrench
        Whether the wrench columns are to be read.

    Returns
    -------
    table, warnings

    Raises
    ------
    InputError
        The file is absent or no such table, a column is missing, a cell is no finite number, or time does not increase.
    """
    if not path.is_file():
        raise InputError(f"{source}: no such file; write it or correct the name in experiment.toml")
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            return _read_parquet(path, source, joints, wrench)
        return _read_csv(path, source, joints, wrench)
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror}); give a readable file") from None


def write_table(table: Table, path: Path) -> None:
    """Write a table as CSV, with digits enough to read the same numbers back."""
    columns: dict[str, np.ndarray] = {"t": table.times}
    for field, prefix in _JOINT_GROUPS.items():
        array = getattr(table, field)
        if array is not None:
            columns |= {f"{prefix}{j + 1}": array[:, j] for j in range(array.shape[1])}
    if table.wrench is not None:
        columns |= {name: table.wrench[:, k] for k, name in enumerate(WRENCH_COLUMNS)}
    pd.DataFrame(columns).to_csv(path, index=False, lineterminator="\n")


def _read_csv(path: Path, source: str, joints: int, wrench: bool) -> tuple[Table, list[str]]:
    header = _header(path, source)
    groups, warnings = _groups(header, source, joints, wrench)
    used = [column for columns in groups.values() for column in columns]
    lines = _count_lines(path, source, len(header))
    # More rows than needed, by blank lines at most; what is not filled takes no memory.
    arrays = {group: np.empty((lines, len(columns))) for group, columns in groups.items()}
    rows = 0
    options: dict[str, Any] = dict(
        usecols=used, index_col=False, skipinitialspace=True, encoding="utf-8-sig", chunksize=_BLOCK_ROWS
    )
    try:
        with pd.read_csv(path, dtype=np.float64, **options) as reader:
            for frame in reader:
                block = slice(rows, rows + len(frame))
                for group, columns in groups.items():
                    arrays[group][block] = frame[columns]
                    if not np.isfinite(arrays[group][block]).all():
                        raise ValueError("not finite")
                rows += len(frame)
    except ValueError as error:  # pandas' parser errors and Unicode's are ValueErrors too
        _blame_cell(path, source, used, options)
        raise InputError(f"{source}: cannot be read as CSV ({' '.join(str(error).split())}); check the file") from None
    if not rows:
        raise InputError(f"{source}: has a header but no rows; write one row per sample")
    arrays = {group: array[:rows] for group, array in arrays.items()}
    return _assemble(arrays, source, lambda row: f"line {_line_number(path, row)}"), warnings


def _read_parquet(path: Path, source: str, joints: int, wrench: bool) -> tuple[Table, list[str]]:
    try:
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            f'{source}: reading Parquet needs pyarrow; pip install "bayesid[parquet]", or write the table as CSV'
        ) from None
    try:
        file = parquet.ParquetFile(path)
    except ValueError as error:  # pyarrow.ArrowInvalid
        raise InputError(f"{source}: not a Parquet file ({' '.join(str(error).split())}); write it again") from None
    groups, warnings = _groups(list(file.schema_arrow.names), source, joints, wrench)
    arrays = {}
    for group, columns in groups.items():
        frame = file.read(columns=columns).to_pandas()
        for column in columns:
            if frame[column].dtype.kind not in "fiu":
                raise InputError(f"{source}: column {column}: holds {frame[column].dtype}; write numbers")
        arrays[group] = frame[columns].to_numpy(np.float64)
        bad = np.argwhere(~np.isfinite(arrays[group]))
        if len(bad):
            row, k = bad[0]
            raise InputError(
                f"{source}: column {columns[k]}, row {row}: {arrays[group][row, k]} is not a number; "
                "leave out rows without a reading"
            )
    if not len(arrays["t"]):
        raise InputError(f"{source}: has columns but no rows; write one row per sample")
    return _assemble(arrays, source, lambda row: f"row {row}"), warnings


def _assemble(arrays: dict[str, np.ndarray], source: str, place: Callable[[int], str]) -> Table:
    times = arrays.pop("t")[:, 0]
    _check_increasing(times, source, place)
    return Table(times=times, source=source, **arrays)


def _check_increasing(times: np.ndarray, source: str, place: Callable[[int], str]) -> None:
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        row = int(wrong[0]) + 1
        before, here = float(times[row - 1]), float(times[row])
        fault = "is repeated" if here == before else "goes back"
        raise InputError(
            f"{source}: column t, {place(row)}: time {fault}, {here:g} after {before:g} "
            f"({len(wrong)} such rows); times must strictly increase: export them again or remove those rows"
        )


def _header(path: Path, source: str) -> list[str]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as handle:
            header = next((row for row in csv.reader(handle, skipinitialspace=True) if any(map(str.strip, row))), None)
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{source}: is not UTF-8 text; export the table as CSV in UTF-8") from None
    if header is None:
        raise InputError(f"{source}: is empty; write a header (t, q1, ...) and one row per sample")
    header = [name.strip() for name in header]
    if all(_is_number(name) for name in header):
        raise InputError(f'{source}: line 1 holds numbers ("{header[0]}"); write a header that names the columns')
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"{source}: line 1 is separated by {name}; separate with commas, decimals with points")
    return header


def _groups(header: list[str], source: str, joints: int, wrench: bool) -> tuple[dict[str, list[str]], list[str]]:
    """Choose the columns to read: group -> its columns; and say what of the robot's own is left out."""
    wanted = {"t": ["t"]}
    for group, prefix in _JOINT_GROUPS.items():
        wanted[group] = [f"{prefix}{j + 1}" for j in range(joints)]
    wanted["wrench"] = list(WRENCH_COLUMNS)
    groups: dict[str, list[str]] = {}
    for group, columns in wanted.items():
        missing = [column for column in columns if column not in header]
        for column in columns:
            if header.count(column) > 1:
                raise InputError(f"{source}: column {column}: there are {header.count(column)} of it; keep one")
        if not missing:
            groups[group] = columns
        elif len(missing) < len(columns):
            there = [column for column in columns if column in header]
            raise InputError(
                f"{source}: column {missing[0]} is missing although {', '.join(there)} "
                f"{'is' if len(there) == 1 else 'are'} there; write all of {columns[0]} ... {columns[-1]} or none"
            )
        elif group in ("t", "positions"):
            others = [name for name in header if name and name not in sum(groups.values(), [])]
            raise InputError(f"{source}: column {missing[0]} is missing; {suggest(missing[0], others, 'its other columns are')}")
    warnings = []
    more = [name for name in header if (m := re.fullmatch(r"(?:q|v|qr|tau)(\d+)", name)) and int(m[1]) > joints]
    if more:
        warnings.append(
            f"{source}: columns {', '.join(more)} are not used: [robot] joints lists {joints} joint{'s' * (joints > 1)}"
        )
    if not wrench and groups.pop("wrench", None):
        warnings.append(f"{source}: columns fx ... mz are not used: experiment.toml has no [sensor]")
    return groups, warnings


def _count_lines(path: Path, source: str, width: int) -> int:
    """Count the lines; refuse one with more cells than the header.

    When columns are chosen, pandas drops surplus cells without a word, so a stray comma would shift the numbers.
    """
    lines, quoted = 0, False
    with path.open("rb") as handle:
        while block := handle.read(_BLOCK_BYTES) + handle.readline():
            codes = np.frombuffer(block, np.uint8)
            newlines = np.flatnonzero(codes == 10)
            ends = np.append(newlines, len(codes))
            cells = np.diff(np.searchsorted(np.flatnonzero(codes == 44), ends), prepend=0) + 1
            wide = np.flatnonzero(cells > width)
            quoted = quoted or b'"' in block  # commas within quotes separate nothing: leave these to the parser
            if len(wide) and not quoted:
                raise InputError(
                    f"{source}: line {lines + int(wide[0]) + 1}: {cells[wide[0]]} cells where the header has {width}; "
                    "remove stray commas (decimals are written with a point)"
                )
            lines += len(newlines)
    return lines + 1


def _blame_cell(path: Path, source: str, columns: list[str], options: dict[str, Any]) -> None:
    """Raise for the first cell that is not a finite number, if there is one."""
    options = options | dict(dtype=str, keep_default_na=False, encoding_errors="replace")
    row = 0
    for frame in _quietly(pd.read_csv(path, **options)):
        values = frame[columns].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            at, k = int(bad[0][0]), int(bad[0][1])
            cell = frame[columns[k]].iloc[at]
            shown = f'"{cell}" is not a finite number' if isinstance(cell, str) and cell.strip() else "empty cell"
            raise InputError(
                f"{source}: column {columns[k]}, line {_line_number(path, row + at)}: {shown}; "
                "correct it or leave out rows without a reading"
            )
        row += len(frame)


def _quietly(reader: Any) -> Iterator[pd.DataFrame]:
    """Yield blocks until the file ends or cannot be parsed further."""
    try:
        with reader:
            yield from reader
    except ValueError:
        return


def _line_number(path: Path, row: int) -> int:
    """Return the line, from 1, of a row, from 0: the header and blank lines are no rows."""
    with path.open("rb") as handle:
        filled = (number for number, line in enumerate(handle, 1) if line.strip())
        return next(itertools.islice(filled, row + 1, None), 0)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
