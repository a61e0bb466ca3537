"""One recording of another tool: read, its columns found, converted, and brought to common times."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, call
from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, listed
from bayesid.recordings.importing.arrays import read_hdf5, read_mat, read_npz
from bayesid.recordings.importing.bags import read_bag
from bayesid.recordings.importing.clock import RowTimes, row_clock, table_clock, topic_clock
from bayesid.recordings.importing.column_map import ColumnMap
from bayesid.recordings.importing.found_columns import Layout, find_columns, positions_of, stated_times, time_column, times_of
from bayesid.recordings.importing.signals import Signal, make_signals, resting
from bayesid.recordings.importing.stream import Source, Stream, kind_of
from bayesid.recordings.importing.tables import read_csv, read_lerobot, read_parquet
from bayesid.recordings.table import GAP, JOINT_GROUPS, WRENCH_COLUMNS, Table

#: A topic that is this many times as fast as the rows is averaged over a row's step, so that no noise is folded down.
_FASTER = 1.5
_ALIKE = 1.1  # rates that count as equal
_READINGS = ("tau", "wrench")
_OPTIONAL = ("v", "qr")
_POINTER = b"version https://git-lfs"  # what Git LFS leaves in place of a file that was not fetched
_ARRAYS = {"numpy": read_npz, "mat": read_mat, "hdf5": read_hdf5}


def read_source(
    path: str | Path, topics: Sequence[str] = (), mapped: Iterable[str] = (), episodes: Sequence[int] = (), poses: bool = False
) -> tuple[Source, ...]:
    """Read a bag, an MCAP file, a table, an archive of arrays, or a data set of LeRobot: the recordings in it, as they are.

    Of a bag ``topics`` are read, and those of columns that are ``mapped``; of a data set its ``episodes``, default all.
    ``poses`` says whether each row of a table is a separate pose. An `InputError` where the file is not there, of an unknown
    kind, or damaged.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file or folder", file=str(path), remedy="give a recording")
    kind = kind_of(path)
    try:
        _check_fetched([path] if path.is_file() else path.rglob("*") if kind else [])
        if kind == "lerobot":
            return read_lerobot(path, episodes)
        if kind == "bag":
            return (read_bag(path, topics, mapped),)
        if kind in _ARRAYS:
            return (_ARRAYS[kind](path),)
        if kind in ("parquet", "text"):
            return (Source(path.stem, (read_parquet(path) if kind == "parquet" else read_csv(path, poses),)),)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", file=path.name, remedy="give a readable file") from None
    what, remedy = (
        f'files "{path.suffix}" are not known',
        "give a ROS bag, MCAP, CSV, Parquet, NPZ, MAT, HDF5 or a LeRobot data set",
    )
    if path.suffix.lower() in (".xlsx", ".xls", ".ods"):
        remedy = "save the sheet as CSV"
    if path.suffix.lower() in (".json", ".jsonl"):
        remedy = "save its records as CSV: pandas.DataFrame(records).to_csv(...)"
    if kind == "pickle":
        what, remedy = "is a pickle, which could run anything when it is read", "save arrays as .npz or CSV"
    elif path.is_dir():
        what = "folder holds no metadata.yaml, .mcap, .db3 or meta/info.json"
        if any(kind_of(file) for file in path.iterdir() if file.is_file()):
            remedy = f"name its files; {argument('join_files')} where they are parts of one recording"
    raise InputError(what, file=path.name, remedy=remedy)


def _check_fetched(files: Iterable[Path]) -> None:
    """Refuse what Git LFS left in place of a recording's file."""
    for file in files:
        if file.is_file() and kind_of(file):
            with file.open("rb") as handle:
                if handle.read(len(_POINTER)) == _POINTER:
                    raise InputError(
                        "is a pointer of Git LFS, not the file itself", file=file.name, remedy="fetch it: git lfs pull"
                    )


def joined_files(sources: Sequence[Source], times: Sequence[str] = ()) -> Source:
    """Several files that are parts of one recording: what goes on one after the other, other tables beside each other.

    Topics go on, and so does a table with another of the same columns and earlier times. Those beside each other have the names
    of their files before those of their columns; one without times has those of the only one of as many rows. ``times`` are
    columns of times that the user states; none: they are found by their names.
    """
    groups: list[list[tuple[str, Stream]]] = []
    for source in sources:
        for stream in source.streams:
            group = next((group for group in groups if _goes_on(group[-1], (source.name, stream), times)), None)
            if group is None:
                groups.append([(source.name, stream)])
            else:
                group.append((source.name, stream))
    topics, tables, notes = [], [], []
    for (file, first), *more in groups:
        parts = [first, *(stream for _, stream in more)]
        columns = {c: np.concatenate([stream.columns[c] for stream in parts]) for c in first.columns}
        clocks = {c: np.concatenate([stream.clocks[c] for stream in parts]) for c in first.clocks}
        whole = replace(first, columns=columns, clocks=clocks)
        if whole.name:
            topics.append(whole)
        else:
            tables.append((file, whole))
            if more:
                following = listed([name for name, _ in more])
                notes.append(f"{following} after {file}, as one recording: the same columns at later times")
    unread = dict.fromkeys(topic for source in sources for topic in source.unread)
    return Source(sources[0].name, (*topics, *_beside(tables, times)), tuple(unread), tuple(notes))


def _goes_on(before: tuple[str, Stream], after: tuple[str, Stream], times: Sequence[str]) -> bool:
    """Whether a stream is the next part of another: of the same topic, or a table of the same columns at later times."""
    (_, one), (file, other) = before, after
    if one.name != other.name or set(one.columns) != set(other.columns) or set(one.clocks) != set(other.clocks):
        return False
    if one.name:
        return True
    column = next(iter(times_of(other, times, file)), None)
    if column is None:
        return False
    both = [stream.columns[column] for stream in (one, other)]
    if all(times.dtype.kind in "fiu" for times in both):
        return bool(np.nanmin(both[1]) > np.nanmax(both[0]))
    dates = [[str(time) for time in times.tolist() if time and time == time] for times in both]  # ISO 8601 sorts as texts
    return all(dates) and min(dates[1]) > max(dates[0])


def _beside(tables: Sequence[tuple[str, Stream]], times: Sequence[str]) -> list[Stream]:
    """Tables that stand beside each other, those without times as columns of the only one of as many rows that has them."""
    if len(tables) < 2:
        return [stream for _, stream in tables]
    timed: dict[int, list[int]] = {}
    for k, (file, stream) in enumerate(tables):
        if times_of(stream, times, file):
            timed.setdefault(_rows(stream), []).append(k)
    merged: dict[int, list[int]] = {}  # by the table that has the times, or the first of those that have none
    for k, (_, stream) in enumerate(tables):
        own = timed.setdefault(_rows(stream), [k])
        merged.setdefault(own[0] if len(own) == 1 else k, []).append(k)
    out = []
    for members in merged.values():
        named = []
        for file, stream in (tables[k] for k in members):  # columns of an array without names have the file's already
            has_it = all(column == file or column.startswith(f"{file}[") for column in stream.columns)
            named.append(replace(stream, name="" if has_it else file))
        columns = {stream.full_name(column): values for stream in named for column, values in stream.columns.items()}
        out.append(named[0] if len(named) == 1 else Stream("", columns))
    return out


def _rows(stream: Stream) -> int:
    return len(next(iter(stream.columns.values())))


def join(signals: Sequence[Signal], source: str) -> tuple[np.ndarray, dict[str, np.ndarray], Signal, list[str]]:
    """Bring all signals to the times of the slowest of positions and readings; what shares those times stays as it is.

    Returned are these times (N,) [s], values (N,) by column, the signal whose times these are, and what was done to each other
    one, one line each.

    Others are interpolated by cubic splines, readings of a faster topic averaged over a row's step. Nothing is filled in across
    a gap or beyond an end: such rows are left out, or velocities and commands where these would cost most rows. An `InputError`
    where topics do not overlap in time.
    """
    candidates = [s for s in signals if s.quantity in ("q", *_READINGS) and len(s.times) > 1]
    if not candidates:
        raise InputError("has a single row", file=source, remedy="give a recording of many")
    slowest = max(s.step for s in candidates)
    base = next(s for s in sorted(candidates, key=lambda s: s.quantity not in _READINGS) if s.step * _ALIKE >= slowest)
    inside = np.ones(len(base.times), bool)
    columns: dict[str, np.ndarray] = {}
    how = []
    for signal in signals:
        if np.array_equal(signal.times, base.times, equal_nan=True):
            values = signal.values
        else:
            values, there, text = _brought(signal, base)
            if signal.quantity in _OPTIONAL and 2 * np.count_nonzero(inside & there) < np.count_nonzero(inside):
                how.append(f"{signal.called}: none at most rows; not used")
                continue
            inside &= there
            how.append(text)
        columns |= zip(signal.ours, values.T, strict=True)
    if not inside.any():
        spans = "; ".join(f"{s.called} from {s.times[0]:.6g} to {s.times[-1]:.6g} s" for s in signals)
        remedy = f"are they on different clocks? try {argument('clock', 'log')}"
        raise InputError(f"topics do not overlap in time: {spans}", file=source, remedy=remedy)
    left = int(len(inside) - inside.sum())
    if left:
        how.append(f"{left} of {len(inside)} rows are left out, in which a topic has a gap, has not begun or has ended")
    return base.times[inside], {name: values[inside] for name, values in columns.items()}, base, how


def _brought(signal: Signal, base: Signal) -> tuple[np.ndarray, np.ndarray, str]:
    """A signal at the times of another: values (N, k), which rows it has them for (N,), and what was done."""
    (times, values, wrapped), at = signal.unwrapped(), base.times
    if len(times) < 2:
        return np.full((len(at), values.shape[1]), np.nan), np.zeros(len(at), bool), f"{signal.called}: a single sample"
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    there = (at >= times[0]) & (at <= times[-1]) & (times[right] - times[right - 1] <= GAP * signal.step)
    ratio = base.step / signal.step
    if signal.quantity in _READINGS and ratio >= _FASTER:
        from scipy.interpolate import make_interp_spline  # takes longer to import than most logs take to read

        half = 0.5 * base.step
        low, high = np.maximum(at - half, times[0]), np.minimum(at + half, times[-1])
        width = np.where(there, high - low, 1.0)[:, None]
        integral = make_interp_spline(times, values, k=1).antiderivative()
        mean = (integral(high) - integral(low)) / width
        return mean, there, f"{signal.called}: mean over {1e3 * base.step:.3g} ms about each row ({ratio:.3g} samples)"
    how = f"{signal.called}: {'angles wrap at a full turn; unwrapped and ' * wrapped}interpolated (cubic splines)"
    return _interpolated(times, values, at, signal.step), there, how


def _interpolated(times: np.ndarray, values: np.ndarray, at: np.ndarray, step: float) -> np.ndarray:
    """Values (N, k) at other times, each piece between gaps by its own spline."""
    from scipy.interpolate import CubicSpline  # as above

    edges = np.concatenate([[0], np.flatnonzero(np.diff(times) > GAP * step) + 1, [len(times)]])
    out = np.full((len(at), values.shape[1]), np.nan)
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        piece = slice(first, last)
        rows = (at >= times[first]) & (at <= times[last - 1])
        if rows.any():
            out[rows] = CubicSpline(times[piece], values[piece])(at[rows]) if last - first > 1 else values[first]
    return out


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as it is used."""

    source: Source  # what was read
    layout: Layout  # which columns are used
    clocks: tuple[tuple[Stream, RowTimes], ...]  # of the streams that are used
    signals: tuple[Signal, ...]  # each quantity in SI units, at its own times
    #: All of them at common times (N,) [s]: values (N,) by our names of columns, and the signal whose times these are.
    times: np.ndarray
    columns: dict[str, np.ndarray]
    base: Signal
    done: tuple[str, ...]  # what was done and noticed, one line each
    resting: Mapping[str, tuple[float, float]]  # of joints that are not used, where they stand and how far they move [rad or m]

    @property
    def start(self) -> int | None:
        """When time is zero [ns since 1970]; None where the log does not say."""
        return self.clocks[0][1].start

    @property
    def left_over(self) -> tuple[str, ...]:
        """Full names of columns, and topics, that are not used."""
        used = {(id(found.stream), found.column) for found in self.layout.found}
        used |= {(id(stream), clock.column) for stream, clock in self.clocks}
        columns = [s.full_name(column) for s in self.source.streams for column in s.columns if (id(s), column) not in used]
        return (*columns, *self.source.unread)

    @property
    def names(self) -> dict[str, str]:
        """The log's names of columns by ours."""
        times = [("t", clock.column) for _, clock in self.clocks if clock.column]
        return dict(times) | {ours: theirs for s in self.signals for ours, theirs in zip(s.ours, s.columns, strict=True)}

    def table(self, name: str, wrench: bool = True) -> Table:
        """The recording as a table that messages call ``name``, with or without the wrench."""
        columns, arrays = self.columns, {}
        none = np.full(len(self.times), np.nan)
        for field, quantity in JOINT_GROUPS.items():
            names = [f"{quantity}{k + 1}" for k in range(len(self.layout.joints))]
            there = [column in columns for column in names]
            if all(there) or (quantity in ("q", "tau") and any(there)):
                arrays[field] = np.column_stack([columns.get(column, none) for column in names])
        if wrench and all(axis in columns for axis in WRENCH_COLUMNS):
            arrays["wrench"] = np.column_stack([columns[axis] for axis in WRENCH_COLUMNS])
        return Table(times=self.times, **arrays, source=name)


def make_recording(
    source: Source,
    stated: ColumnMap,
    moving: Sequence[str],
    joints: Sequence[str] | None = None,
    clock: str | None = None,
    poses: bool = False,
    locked: Collection[str] = (),
    sliding: Collection[str] = (),
    rate: float | None = None,
) -> Recording:
    """Find the columns of what was read, convert them, and bring them together; joints as for `find_columns`.

    ``sliding`` are those joints that slide, whose units are others.

    ``clock`` is ``header`` or ``log`` for topics; None: headers, where they have stamps that count. ``rate`` [Hz] is that of
    tables without times. Where rows are separate ``poses`` at rest, no sample is held, and no times are needed. An `InputError`
    where a column is not found or could be several, a cell is no number, or clocks do not meet.
    """
    stated = stated.of_file(source.name)
    if not any(stream.columns for stream in source.streams):
        topics = f"; its topics are {listed(source.unread, 8)}" if source.unread else ""
        raise InputError(
            f"holds no joint states{topics}", file=source.name, remedy=f"name the topics that do ({argument('topics')})"
        )
    layout = find_columns(source.streams, stated, moving, joints, source.name, locked)
    used = {id(found.stream) for found in layout.found}
    clocks: list[tuple[Stream, RowTimes]] = []
    given = stated_times(stated)
    named = not given or any(times_of(stream, given) for stream in source.streams)  # a topic's messages may hold times, too
    for stream in source.streams:
        if id(stream) in used and stream.clocks and named and not (given and times_of(stream, given)):
            if rate is not None:
                problem = f"has times of its own, those of {stream.name}"
                raise InputError(problem, file=source.name, remedy=f"leave out {argument('rate', rate)}")
            clocks.append((stream, topic_clock(stream, clock, source.name)))
        elif id(stream) in used:
            times = time_column(stream, stated, source.name, must=rate is None and not poses)
            if times is not None and rate is not None:
                problem = f'has times of its own, column "{cut(times[0])}"'
                raise InputError(problem, file=source.name, remedy=f"leave out {argument('rate', rate)}")
            one = row_clock(_rows(stream), rate) if times is None else table_clock(stream, *times, source.name, poses)
            clocks.append((stream, one))
    starts = [one.start for _, one in clocks if one.start is not None]
    if starts and len(starts) < len(clocks):
        kinds = "; ".join(f"{stream.name}: {one.text}" for stream, one in clocks)
        raise InputError(f"clocks cannot be brought together: {kinds}", file=source.name, remedy="give files with one clock")
    if starts:
        first = min(one.start + int(np.nanmin(one.times) * 1e9) for _, one in clocks if one.start is not None)
        clocks = [(stream, one.since(first)) for stream, one in clocks]
    signals, notes = make_signals(layout, clocks, stated, source.name, not poses, sliding)
    common, columns, base, how = join(signals, source.name)
    done = [*source.notes, *(text for _, one in clocks for text in one.notes), *notes]
    if len({one.kind for _, one in clocks}) > 1:
        kinds = ", ".join(f"{stream.name} by {one.text}" for stream, one in clocks)
        one_for_all = argument("clock", "log")
        done.append(f"topics have times of different kinds, and are late by the difference: {kinds} (one for all: {one_for_all})")
    for signal in signals:
        if signal.held > 1.0:
            rate = 1.0 / signal.step if signal.step else 0.0
            done.append(
                f"{signal.called}: each sample is repeated for {signal.held:.3g} rows; the true rate is {rate:.4g} Hz, and only "
                "the rows in which it changes are used"
            )
    done += [f"rows are at the times of {base.called}"] if how else []
    others = [joint for joint in moving if joint not in layout.joints and joint not in locked]
    try:
        found = positions_of(source.streams, stated, others, source.name) if others else {}
        stand = {name: at for name, one in found.items() if (at := resting(one, stated, name, source.name, sliding)) is not None}
    except InputError as error:
        raise InputError(f"{error}; a joint that is not used may be locked ({argument('locked')} {others[0]}=...)") from None
    return Recording(source, layout, tuple(clocks), tuple(signals), common, columns, base, (*done, *how), stand)


def read_stated(
    path: Path, name: str, stated: ColumnMap, joints: Sequence[str], sliding: Collection[str], wrench: bool, poses: bool
) -> Table:
    """Read a file of an experiment folder whose columns experiment.toml names; ``name`` is its path within the folder.

    Of the ``joints``, in the order of q1 ... qn, some are ``sliding``.

    Errors are those of `read_source` and `make_recording`, or that the file holds several recordings.
    """
    if not path.exists():
        raise InputError(f"{name}: no such file; write it or correct the name in experiment.toml")
    sources = read_source(path, mapped=stated.names(), poses=poses)
    if len(sources) != 1:
        raise InputError(f"{name}: holds {len(sources)} recordings; make an experiment of them with {call('import')}")
    recording = make_recording(
        Source(name, sources[0].streams, sources[0].unread), stated, joints, joints, poses=poses, sliding=sliding
    )
    table = recording.table(name, wrench)
    return replace(table, notes=(*(f"{name}: {text}" for text in recording.done), *table.notes))
