"""A table larger than memory: it stays in its file, of which a few parts at a time are read.

Parts are the row groups of a Parquet file, or runs of lines of a CSV file. Every part is read once beforehand: to check its
numbers, and to find which rows cannot be used and where the gaps are.
"""

from __future__ import annotations

import functools
import io
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import columns_of, cut, listed, one_line
from bayesid.recordings.table import GAP, JOIN, Table, of_every_joint, usual_step
from bayesid.recordings.table_reader import EMPTY, column_groups, count_lines, open_parquet, read_header
from bayesid.recordings.toml_file import LARGEST
from bayesid.tasks import map_tasks

#: Tables whose numbers take more than this are read in chunks [bytes].
LARGE = 2_000_000_000
#: A row group may take so much in memory, as numbers of eight bytes [bytes].
_LARGEST_PART = 300_000_000
_LINES_BYTES = 1 << 25  # of a CSV file that are read at once
#: Rows of the excerpt that stands for the recording where one is looked at as a whole, in so many pieces.
_EXCERPT_ROWS, _PIECES = 200_000, 8
_STEPS = 1000  # that tell the usual one
#: Parts that are kept in memory: a run of samples often goes over the end of one.
_KEPT = 2

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class FilePart:
    """Where a part of the file is: the number of its row group, or the place and length of its lines [bytes]."""

    at: int
    size: int = 0


@dataclass(frozen=True)
class _Layout:
    """What is read of the file."""

    #: The file, and what to call it in messages.
    path: Path
    source: str
    groups: Mapping[str, list[str]]  # group of columns -> their names
    header: tuple[str, ...] | None  # all columns of a CSV file; None: it is Parquet
    changed: int  # when it was written: another file of the same name is read anew

    @property
    def columns(self) -> list[str]:
        """Those that are read, group by group."""
        return [name for group in self.groups.values() for name in group]

    def __hash__(self) -> int:
        return hash((self.path, self.changed))


@dataclass(frozen=True, eq=False)
class StoredTable:
    """A recording of ``N`` usable samples in its file."""

    #: What is read of the file.
    layout: _Layout
    parts: tuple[FilePart, ...]
    starts: np.ndarray  # first usable sample of every part, and N (parts + 1,)
    begins: np.ndarray  # time of that sample (parts,) [s]
    dropped: Mapping[int, np.ndarray]  # by part, rows that are left out for they have no reading or the time of the row before
    gaps: tuple[int, ...]  # samples that come after a gap
    joints: int  # how many joints there are
    notes: tuple[str, ...] = ()  # what is to be said of the rows that are left out

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.starts[-1])

    @property
    def source(self) -> str:
        """The file's name, for messages."""
        return self.layout.source

    def segments(self) -> list[slice]:
        """The pieces between gaps, in order."""
        edges = [0, *self.gaps, len(self)]
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    @property
    def gap_times(self) -> list[tuple[float, float]]:
        """Start and end of every gap [s]."""
        return [(float(start), float(end)) for start, end in (self.read(k - 1, k + 1)["t"][:, 0] for k in self.gaps)]

    def read(self, first: int, last: int) -> Arrays:
        """Samples first ... last - 1 by group of columns (k, columns), and their times ``t`` (k, 1)."""
        parts = range(int(np.searchsorted(self.starts, first, side="right")) - 1, int(np.searchsorted(self.starts[:-1], last)))
        numbers = [self._part(k)[max(first - self.starts[k], 0) : last - self.starts[k]] for k in parts]
        whole = numbers[0].copy() if len(numbers) == 1 else np.concatenate(numbers)
        out, at = {}, 0
        for group, columns in self.layout.groups.items():
            out[group] = np.ascontiguousarray(whole[:, at : at + len(columns)])
            at += len(columns)
        return out

    def table(self, first: int, last: int) -> Table:
        """Samples first ... last - 1 as a table."""
        return self._as_table(self.read(first, last))

    def index(self, time: float, side: Literal["left", "right"] = "left") -> int:
        """Where a time [s] would be inserted among those of the samples, as `numpy.searchsorted` says it."""
        k = int(np.searchsorted(self.begins, time, side=side)) - 1
        if k < 0:
            return 0
        return int(self.starts[k] + np.searchsorted(self._part(k)[:, 0], time, side=side))

    def excerpt(self) -> Table:
        """Evenly spread pieces of the recording, or all of it where it is short."""
        if len(self) <= _EXCERPT_ROWS:
            return self.table(0, len(self))
        length = _EXCERPT_ROWS // _PIECES
        starts = np.linspace(0, len(self) - length, _PIECES).astype(int)
        pieces = [self.read(a, a + length) for a in starts.tolist()]
        return self._as_table({group: np.concatenate([piece[group] for piece in pieces]) for group in pieces[0]})

    def _as_table(self, arrays: Arrays) -> Table:
        times = arrays.pop("t")[:, 0]
        if "torques" in arrays:
            arrays["torques"] = of_every_joint(arrays["torques"], self.layout.groups["torques"], self.joints)
        return Table(times, arrays["positions"], torques=arrays.get("torques"), wrench=arrays.get("wrench"), source=self.source)

    def _part(self, k: int) -> np.ndarray:
        numbers = _numbers(self.layout, self.parts[k])
        return np.delete(numbers, self.dropped[k], axis=0) if k in self.dropped else numbers


def stored_table(path: Path, source: str, joints: int, wrench: bool, chunked: bool | None) -> StoredTable | None:
    """A table that is read in chunks; None where it is small, and is to be read whole; the rest is as for `read_table`.

    It is ``chunked`` if that is said, by default where its numbers take more than `LARGE`. An `InputError` where angles wrap,
    or a row group is too large.
    """
    if chunked is False or not path.is_file():  # who reads it whole says what is missing
        return None
    parquet = path.suffix.lower() in (".parquet", ".pq")
    if not parquet and path.suffix.lower() != ".csv":
        return None
    if not parquet and not chunked and path.stat().st_size <= LARGE:
        return None
    file = open_parquet(path, source) if parquet else None
    header = read_header(path, source) if file is None else list(file.schema_arrow.names)
    groups, _ = column_groups(header, source, joints, wrench)
    groups = {name: columns for name, columns in groups.items() if name not in ("velocities", "commanded")}
    width = sum(map(len, groups.values()))
    if not chunked and file is not None and 8 * file.metadata.num_rows * width <= LARGE:
        return None
    layout = _Layout(path.absolute(), source, groups, None if file is not None else tuple(header), path.stat().st_mtime_ns)
    if file is not None:
        sizes = [file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups)]
        if 8 * width * max(sizes, default=0) > _LARGEST_PART:
            raise InputError(
                f"a row group of {max(sizes):,} rows is too large to be read at once", file=source, value=max(sizes),
                remedy="write the table with row_group_size=250000",
            )  # fmt: skip
        parts = [FilePart(k) for k, size in enumerate(sizes) if size]
    else:
        count_lines(path, source, len(header))
        parts = list(_runs_of_lines(path))
    if not parts:
        raise InputError("has columns but no rows", file=source, remedy="write one row per sample")
    first = _numbers(layout, parts[0])
    without = [name for name in groups.get("torques", ()) if np.isnan(first[:, layout.columns.index(name)]).all()]
    if not without:
        return _scanned(layout, parts, joints)
    read = {group: [name for name in columns if name not in without] for group, columns in groups.items()}
    stored = _scanned(replace(layout, groups={group: columns for group, columns in read.items() if columns}), parts, joints)
    note = f"{source}: {columns_of(without)}: no torque in the first {len(first):,} rows, so not used at all"
    return replace(stored, notes=(*stored.notes, note))


@dataclass(frozen=True)
class _Scan:
    """What is found in a part: its rows, those left out, times, gaps as usable samples of the part, ends of the positions."""

    rows: int
    dropped: np.ndarray
    begin: float
    end: float
    gaps: np.ndarray
    first: np.ndarray
    last: np.ndarray


def _scanned(layout: _Layout, parts: list[FilePart], joints: int) -> StoredTable:
    """The table, once every part has been checked."""
    times = np.zeros(0)
    for part in parts:  # the first, unless it is a few rows
        times = np.append(times, (here := _numbers(layout, part)[:, 0])[~np.isnan(here)])
        if len(times) > _STEPS:
            break
    step = usual_step(times) if len(times) > 1 else np.inf
    scans = list(map_tasks(functools.partial(_scan, layout, step), parts))
    dropped, gaps, starts, begins, last = {}, [], [0], [], None
    kept = []
    for k, scan in enumerate(scans):
        if last is not None and scan.begin == last.end:
            scans[k] = scan = _scan(layout, step, parts[k], last.end)
        usable = scan.rows - len(scan.dropped)
        if not usable:
            continue
        if last is not None:
            if scan.begin <= last.end:
                problem = f"time goes from {last.end:.10g} to {scan.begin:.10g}"
                remedy = "times must strictly increase: sort the rows, and leave out those of the same time"
                raise InputError(problem, file=layout.source, key="column t", value=scan.begin, remedy=remedy)
            if scan.begin - last.end > GAP * step:
                gaps.append(starts[-1])
            else:
                _refuse_wrap(layout, np.stack([last.last, scan.first]), scan.begin)
        if len(scan.dropped):
            dropped[len(kept)] = scan.dropped
        gaps += (starts[-1] + scan.gaps).tolist()
        starts.append(starts[-1] + usable)
        begins.append(scan.begin)
        kept.append(parts[k])
        last = scan
    rows, lost = sum(s.rows for s in scans), sum(len(s.dropped) for s in scans)
    if last is None or 2 * lost > rows:
        problem = f"{lost} of {rows} rows have no reading or the time of the row before"
        raise InputError(problem, file=layout.source, value=lost, remedy=JOIN)
    note = (
        f"{layout.source}: {lost} rows without a reading or with the time of the row before left out, nothing is filled in; "
        "check the logger"
    )
    return StoredTable(
        layout, tuple(kept), np.array(starts), np.array(begins), dropped, tuple(gaps), joints, (note,) if lost else ()
    )  # fmt: skip


def _scan(layout: _Layout, step: float, part: FilePart, before: float = -np.inf) -> _Scan:
    """What is found in a part that follows a sample at a time ``before`` [s]."""
    numbers, columns = _numbers(layout, part), layout.columns
    limit = np.full(numbers.shape[1], LARGEST)
    limit[0] = np.inf
    wrong = np.isinf(numbers) | (np.abs(numbers) > limit)
    if wrong.any():
        row, k = (int(i) for i in np.argwhere(wrong)[0])
        raise InputError(
            f"{numbers[row, k]:g} is no reading", file=layout.source, key=f"column {columns[k]}, t = {numbers[row, 0]:.10g}",
            value=float(numbers[row, k]), remedy="correct it or leave out rows without a reading",
        )  # fmt: skip
    empty = np.isnan(numbers).any(axis=1)
    filled = np.flatnonzero(~empty)
    times = numbers[filled, 0]
    steps = np.diff(times)
    if (steps < 0.0).any():
        at = int(np.flatnonzero(steps < 0.0)[0])
        raise InputError(
            f"time goes back, {times[at + 1]:.10g} after {times[at]:.10g}", file=layout.source, key="column t",
            value=float(times[at + 1]), remedy="times must strictly increase: export them again or remove those rows",
        )  # fmt: skip
    repeats = filled[np.append(times[:1] == before, steps == 0.0)]
    dropped = np.union1d(np.flatnonzero(empty), repeats)
    kept = np.delete(numbers, dropped, axis=0) if len(dropped) else numbers
    positions = kept[:, 1 : 1 + len(layout.groups["positions"])]
    gaps = np.flatnonzero(np.diff(kept[:, 0]) > GAP * step) + 1
    if not len(kept):
        return _Scan(len(numbers), dropped, np.nan, np.nan, gaps, np.zeros(0), np.zeros(0))
    for a, b in zip([0, *gaps], [*gaps, len(kept)], strict=True):
        _refuse_wrap(layout, positions[a:b], float(kept[a, 0]))
    return _Scan(len(numbers), dropped, float(kept[0, 0]), float(kept[-1, 0]), gaps, positions[0].copy(), positions[-1].copy())


def _refuse_wrap(layout: _Layout, positions: np.ndarray, since: float) -> None:
    """Refuse angles that jump by half a turn: nothing is unwrapped where chunks are read on their own."""
    jumps = np.argwhere(np.abs(np.diff(positions, axis=0)) > np.pi)
    if len(jumps):
        row, j = (int(i) for i in jumps[0])
        raise InputError(
            f"jumps from {positions[row, j]:.4g} to {positions[row + 1, j]:.4g}, sample {row + 1} after t = {since:.10g}",
            file=layout.source, key=f"column {layout.groups['positions'][j]}", value=float(positions[row + 1, j]),
            remedy="unwrap the angle (numpy.unwrap) before it is written: a table that is read in chunks is not",
        )  # fmt: skip


def _runs_of_lines(path: Path) -> Iterator[FilePart]:
    """Runs of whole lines of a CSV file, below its header."""
    with path.open("rb") as handle:
        while not (line := handle.readline()).strip(b"\xef\xbb\xbf \t\r\n"):
            if not line:
                return
        while block := handle.read(_LINES_BYTES) + handle.readline():
            if b'"' in block:
                raise InputError(
                    "holds quotes, which a CSV file that is read in chunks must not", file=str(path.name),
                    remedy="write it without, or as Parquet",
                )  # fmt: skip
            if block.strip():
                yield FilePart(handle.tell() - len(block), len(block))


_reading = threading.Lock()


def _numbers(layout: _Layout, part: FilePart) -> np.ndarray:
    """All rows of a part (rows, columns), to be read only."""
    with _reading:  # threads want the same part, most often
        return _read_part(layout, part)


@functools.lru_cache(maxsize=_KEPT)
def _read_part(layout: _Layout, part: FilePart) -> np.ndarray:
    try:
        numbers = (_row_group if layout.header is None else _lines)(layout, part)
    except OSError as error:
        raise InputError(
            f"{layout.source}: cannot be read ({error.strerror or one_line(str(error))}); give a readable file, "
            "on a cluster under the same path everywhere"
        ) from None
    numbers.setflags(write=False)
    return numbers


def _row_group(layout: _Layout, part: FilePart) -> np.ndarray:
    file = open_parquet(layout.path, layout.source)
    columns = layout.columns
    table = file.read_row_group(part.at, columns=columns, use_threads=False)
    out = np.empty((table.num_rows, len(columns)))
    for k, name in enumerate(columns):
        column = table.column(name)
        kind: Any = column.type
        if not any(word in str(kind) for word in ("int", "float", "double")):
            raise InputError(f"{layout.source}: column {name}: holds {kind}; write numbers")
        out[:, k] = column.to_pandas()
    return out


def _lines(layout: _Layout, part: FilePart) -> np.ndarray:
    import pandas as pd

    assert layout.header is not None
    with layout.path.open("rb") as handle:
        handle.seek(part.at)
        text = handle.read(part.size)
    places = [layout.header.index(name) for name in layout.columns]
    try:
        frame = pd.read_csv(
            io.BytesIO(text), header=None, names=list(range(len(layout.header))), usecols=places, index_col=False,
            skipinitialspace=True, keep_default_na=False, na_values=EMPTY, dtype=np.float64,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(
            f"cannot be read as numbers ({cut(one_line(str(error)), 80)})", file=layout.source,
            key=f"columns {listed(layout.columns)}, within {part.size:,} bytes from byte {part.at:,}", remedy="correct that cell",
        ) from None  # fmt: skip
    return np.ascontiguousarray(frame[places].to_numpy(np.float64))
