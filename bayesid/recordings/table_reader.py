"""Tables from CSV and Parquet files.

A table is read in blocks that go straight into one array per group of columns, so that ten million rows need little
more memory than their numbers. Only when something is wrong is the file read again, to say where.
"""

from __future__ import annotations

import csv
import itertools
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from bayesid.arguments import call
from bayesid.errors import InputError, required
from bayesid.recordings.complaints import cut, is_number, listed, one_line, suggest
from bayesid.recordings.importing.column_map import numbered
from bayesid.recordings.importing.stream import FOREIGN, kind_of
from bayesid.recordings.table import JOINT_GROUPS, WRENCH_COLUMNS, Table, check_increasing, of_every_joint, usable_rows
from bayesid.recordings.toml_file import LARGEST

if TYPE_CHECKING:
    import pandas as pd

#: Files up to this size are read by numpy, in less time than it takes to import pandas [bytes].
_SMALL = 8_000_000
_BLOCK_ROWS = 200_000
_BLOCK_BYTES = 1 << 24
#: Cells without a reading, as C, Python and Windows print them; any other text is a mistake.
EMPTY = ["", *(sign + text for text in ("nan", "NaN", "NAN", "nan(ind)") for sign in ("", "-", "+"))]
_LARGEST_TIME = 1e19  # [s]; nanoseconds since 1970, which are named as such, are below


def read_table(path: Path, source: str, joints: int, wrench: bool = True) -> tuple[Table, list[str]]:
    """Read a CSV or Parquet table with columns ``q1`` to ``q<joints>``, and warnings; ``source`` is what messages call it.

    An `InputError` where the file is absent or no such table, a column is missing, a cell is no finite number, or time does not
    increase.
    """
    if path.exists() and kind_of(path) in FOREIGN:
        raise InputError(f"{source}: is a log of another tool and no table; make an experiment folder with {call('import')}")
    if not path.is_file():
        raise InputError(f"{source}: no such file; write it or correct the name in experiment.toml")
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            return _read_parquet(path, source, joints, wrench)
        return _read_csv(path, source, joints, wrench)
    except OSError as error:
        reason = error.strerror or cut(one_line(str(error)), 80)  # pyarrow's have a text alone
        raise InputError(f"{source}: cannot be read ({reason}); give a readable file") from None


def _read_csv(path: Path, source: str, joints: int, wrench: bool) -> tuple[Table, list[str]]:
    header = read_header(path, source)
    groups, warned = column_groups(header, source, joints, wrench)
    # By place, not by name: pandas knows the names as they stand, with blanks around them.
    places = {group: [header.index(column) for column in columns] for group, columns in groups.items()}
    used = {place: header[place] for group in places.values() for place in group}
    lines = count_lines(path, source, len(header))
    cells = _plain_cells(path, list(used)) if path.stat().st_size <= _SMALL else None
    if cells is not None:
        arrays = {group: cells[:, [list(used).index(k) for k in columns]] for group, columns in places.items()}
        return _assemble(arrays, groups, source, joints, lambda row: f"line {_line_number(path, row)}"), warned
    import pandas as pd

    # More rows than needed, by blank lines at most; what is not filled takes no memory.
    arrays = {group: np.empty((lines, len(columns))) for group, columns in groups.items()}
    rows = 0
    options: dict[str, Any] = dict(
        header=0, names=list(range(len(header))), usecols=list(used), index_col=False, skipinitialspace=True,
        encoding="utf-8-sig", chunksize=_BLOCK_ROWS, keep_default_na=False, na_values=EMPTY,
    )  # fmt: skip
    try:
        with pd.read_csv(path, dtype=np.float64, **options) as reader:
            for frame in reader:
                block = slice(rows, rows + len(frame))
                for group, columns in places.items():
                    arrays[group][block] = frame[columns]
                    if np.isinf(arrays[group][block]).any():
                        raise ValueError("not finite")
                rows += len(frame)
    except ValueError as error:  # pandas' parser errors and Unicode's are ValueErrors too
        _blame_cell(path, source, used, options)
        reason = cut(one_line(str(error)), 80)
        raise InputError(f"cannot be read as CSV ({reason})", file=source, remedy="check the file") from None
    if not rows:
        raise InputError("has a header but no rows", file=source, remedy="write one row per sample")
    arrays = {group: array[:rows] for group, array in arrays.items()}
    return _assemble(arrays, groups, source, joints, lambda row: f"line {_line_number(path, row)}"), warned


def _plain_cells(path: Path, places: list[int]) -> np.ndarray | None:
    """Columns of a table (N, columns) that holds nothing but finite numbers below its first line; else None: pandas decides."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # that there are no rows
            cells = np.loadtxt(
                path, delimiter=",", skiprows=1, usecols=places, comments=None, ndmin=2, encoding="utf-8-sig"
            )  # fmt: skip
    except (ValueError, UserWarning):
        return None
    return cells if np.isfinite(cells).all() else None


def open_parquet(path: Path, source: str) -> Any:
    """A Parquet file, of which nothing but its description is read yet; an `InputError` where it is none, or without pyarrow."""
    remedy = 'pip install "bayesid[parquet]", or write the table as CSV'
    parquet = required("pyarrow.parquet", InputError("reading Parquet needs pyarrow", file=source, remedy=remedy))
    try:
        return parquet.ParquetFile(path)
    except ValueError as error:  # pyarrow.ArrowInvalid
        raise InputError(f"{source}: not a Parquet file ({' '.join(str(error).split())}); write it again") from None


def _read_parquet(path: Path, source: str, joints: int, wrench: bool) -> tuple[Table, list[str]]:
    file = open_parquet(path, source)
    groups, warned = column_groups(list(file.schema_arrow.names), source, joints, wrench)
    arrays = {}
    for group, columns in groups.items():
        frame = file.read(columns=columns).to_pandas(ignore_metadata=True)  # which would make an index of one of them
        for column in columns:
            if frame[column].dtype.kind not in "fiu":
                raise InputError(f"{source}: column {column}: holds {frame[column].dtype}; write numbers")
        arrays[group] = frame[columns].to_numpy(np.float64)
        bad = np.argwhere(np.isinf(arrays[group]))
        if len(bad):
            row, k = bad[0]
            raise InputError(
                f"{source}: column {columns[k]}, row {row}: {arrays[group][row, k]} is not a number; "
                "leave out rows without a reading"
            )
    if not len(arrays["t"]):
        raise InputError(f"{source}: has columns but no rows; write one row per sample")
    return _assemble(arrays, groups, source, joints, lambda row: f"row {row}"), warned


def _assemble(
    arrays: dict[str, np.ndarray], groups: dict[str, list[str]], source: str, joints: int, place: Callable[[int], str]
) -> Table:
    times = arrays["t"][:, 0]
    columns = {name: arrays[group][:, k] for group, names in groups.items() for k, name in enumerate(names) if group != "t"}
    columns = {name: values for name, values in columns.items() if name[:3] != "tau" or not np.isnan(values).all()}
    if "torques" in arrays and not {*groups["torques"]} & {*columns}:
        del arrays["torques"]  # of no joint at all
    dropped, notes = usable_rows(times, columns, source, place)
    if len(dropped):
        rows = np.delete(np.arange(len(times)), dropped)
        arrays = {group: np.delete(array, dropped, axis=0) for group, array in arrays.items()}
        read, place = place, lambda row: read(int(rows[row]))
    for group, array in arrays.items():
        largest = _LARGEST_TIME if group == "t" else LARGEST
        # By extremes: no array of the table's length is made.
        if max(-float(np.nanmin(array)), float(np.nanmax(array))) > largest:
            row, k = (int(i) for i in np.argwhere(np.abs(array) > largest)[0])
            raise InputError(
                f"{array[row, k]:g} is no reading", file=source, key=f"column {groups[group][k]}, {place(row)}",
                value=float(array[row, k]), remedy="correct it or leave out rows without a reading",
            )  # fmt: skip
    times = arrays.pop("t")[:, 0]
    check_increasing(times, source, place)
    if "torques" in arrays:
        arrays["torques"] = of_every_joint(arrays["torques"], groups["torques"], joints)
    return Table(times=times, source=source, dropped=dropped, notes=notes, **arrays)


def read_header(path: Path, source: str) -> list[str]:
    """Names of the columns of a CSV file.

    An `InputError` where it is empty or no text, starts with numbers, or separates by something else than commas.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as handle:
            header = next((row for row in csv.reader(handle, skipinitialspace=True) if not _blank(row)), None)
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{source}: is not UTF-8 text; export the table as CSV in UTF-8") from None
    if header is None:
        raise InputError(f"{source}: is empty; write a header (t, q1, ...) and one row per sample")
    header = [name.strip() for name in header]
    if all(is_number(name) for name in header):
        raise InputError(f'{source}: line 1 holds numbers ("{cut(header[0])}"); write a header that names the columns')
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"{source}: line 1 is separated by {name}; separate with commas, decimals with points")
    return header


def column_groups(header: list[str], source: str, joints: int, wrench: bool) -> tuple[dict[str, list[str]], list[str]]:
    """Choose the columns to read: group -> its columns; and say what of the robot's own is left out."""
    wanted = {"t": ["t"]}
    for group, prefix in JOINT_GROUPS.items():
        wanted[group] = [f"{prefix}{j + 1}" for j in range(joints)]
    wanted["wrench"] = list(WRENCH_COLUMNS)
    groups: dict[str, list[str]] = {}
    warned = []
    for group, columns in wanted.items():
        missing = [column for column in columns if column not in header]
        for column in columns:
            if header.count(column) > 1:
                raise InputError(f"{source}: column {column}: there are {header.count(column)} of it; keep one")
        if not missing:
            groups[group] = columns
        elif len(missing) < len(columns):
            there = [column for column in columns if column in header]
            lacks, meant = next(((column, near) for column in missing if (near := _meant(column, header))), (missing[0], ""))
            if meant or group not in ("torques", "velocities", "commanded"):
                raise InputError(
                    f"{source}: column {lacks} is missing although {', '.join(there)} "
                    f"{'is' if len(there) == 1 else 'are'} there; {meant}write all of {columns[0]} ... {columns[-1]} or none"
                )
            if group == "torques":
                groups[group] = there  # each says something of the links that its joint moves
            else:
                warned.append(
                    f"{source}: columns {listed(there)} are not used, for {listed(missing)} "
                    f"{'is' if len(missing) == 1 else 'are'} missing; write all of them or leave them out"
                )
        elif group in ("t", "positions"):
            others = [name for name in header if name and name not in sum(groups.values(), [])]
            raise InputError(f"{source}: column {missing[0]} is missing; {suggest(missing[0], others, 'its other columns are')}")
    more = [name for name in header if (m := re.fullmatch(r"(?:q|v|qr|tau)(\d+)", name)) and int(m[1]) > joints]
    if more:
        warned.append(
            f"{source}: columns {', '.join(more[:12])} are not used: [robot] joints lists {joints} joint{'s' * (joints > 1)}; "
            "list the others there, or remove the columns"
        )
    if not wrench and groups.pop("wrench", None):
        warned.append(f"{source}: columns fx ... mz are not used: experiment.toml has no [sensor]; add it, or remove the columns")
    return groups, warned


def _meant(column: str, header: list[str]) -> str:
    """The header's name for a missing column, where it differs by capitals, separators or another word for the quantity."""
    near = [name for name in header if re.sub(r"[^a-z0-9]", "", name.lower()) == column]
    near = near or [name for name in header if (ours := numbered(name)) and f"{ours[0]}{ours[1]}" == column]
    return f'did you mean "{cut(near[0])}"? ' if near else ""


def count_lines(path: Path, source: str, width: int, separator: str = ",", skipped: int = 0, first: str = "the header") -> int:
    """Count the lines; refuse one with more or fewer cells than the header. Where blanks separate, any number of them does.

    pandas fills and drops cells without a word where columns are chosen, so that one stray or missing comma would shift the
    numbers of its row into other columns. ``width`` is that of the header in cells; ``skipped`` lines before it may be of any
    width. ``first`` is what messages call the line that has it.
    """
    if separator == " ":
        return _count_blanks(path, source, width, skipped, first)
    lines = 0
    with path.open("rb") as handle:
        while block := handle.read(_BLOCK_BYTES) + handle.readline():
            if b"\0" in block:
                raise InputError("holds zero bytes and is no text", file=source, remedy="export the table as CSV in UTF-8")
            if b'"' in block or block.count(b"\r") > block.count(b"\r\n"):
                return _count_quoted(path, source, width, separator, skipped, first)  # what is in quotes separates nothing
            codes = np.frombuffer(block, np.uint8)
            newlines = np.flatnonzero(codes == 10)
            ends = np.append(newlines, len(codes))
            starts = np.append(0, newlines + 1)
            cells = np.diff(np.searchsorted(np.flatnonzero(codes == ord(separator)), ends), prepend=0) + 1
            odd = np.flatnonzero((cells != width) & (ends > starts))
            for k in odd.tolist():
                if lines + k >= skipped and block[starts[k] : ends[k]].strip():
                    _refuse_width(int(cells[k]), width, lines + k + 1, source, first)
            lines += len(newlines)
    return lines + 1


def _count_quoted(path: Path, source: str, width: int, separator: str, skipped: int, first: str) -> int:
    """The same for a table with quotes, or with line ends of old Macintoshes: cell by cell, and slower."""
    with path.open(encoding="utf-8-sig", newline="", errors="replace") as handle:
        reader = csv.reader(handle, delimiter=separator, skipinitialspace=True)
        try:
            for row in reader:
                if len(row) != width and reader.line_num > skipped and not _blank(row):
                    _refuse_width(len(row), width, reader.line_num, source, first)
        except csv.Error as error:
            raise InputError(
                f"line {reader.line_num}: cannot be read as CSV ({error})", file=source, remedy="check the quotes there"
            ) from None
    return reader.line_num + 1


def _count_blanks(path: Path, source: str, width: int, skipped: int, first: str) -> int:
    """The same for a table whose cells are apart by blanks: below the header, which may begin with a mark."""
    line = 0
    with path.open(encoding="utf-8-sig", errors="replace") as handle:
        for line, text in enumerate(handle, 1):
            if line > skipped + 1 and len(cells := text.split()) != width and cells:
                _refuse_width(len(cells), width, line, source, first)
    return line + 1


def _refuse_width(cells: int, width: int, line: int, source: str, first: str) -> NoReturn:
    remedy = "remove stray commas (decimals are written with a point)" if cells > width else "write a cell for every column"
    count = f"{cells} cell{'s' * (cells > 1)}"
    raise InputError(f"{count} where {first} has {width}", file=source, key=f"line {line}", value=cells, remedy=remedy)


def _blank(row: list[str]) -> bool:
    return len(row) <= 1 and not "".join(row).strip()


def _blame_cell(path: Path, source: str, columns: dict[int, str], options: dict[str, Any]) -> None:
    """Raise for the first cell that is not a finite number, if there is one."""
    import pandas as pd

    options = options | dict(dtype=str, na_values=[], encoding_errors="replace")
    places, row = list(columns), 0
    for frame in _quietly(pd.read_csv(path, **options)):
        values = frame[places].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
        bad = np.argwhere(~np.isfinite(values) & ~frame[places].isin(EMPTY).to_numpy())
        if len(bad):
            at, k = int(bad[0][0]), int(bad[0][1])
            cell = frame[places[k]].iloc[at]
            raise InputError(
                f'"{cut(one_line(str(cell)))}" is not a finite number', file=source,
                key=f"column {columns[places[k]]}, line {_line_number(path, row + at)}", value=cell,
                remedy="correct it or leave out rows without a reading",
            )  # fmt: skip
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
    with path.open(encoding="utf-8-sig", newline="", errors="replace") as handle:
        reader = csv.reader(handle, skipinitialspace=True)
        filled = (reader.line_num for cells in reader if not _blank(cells))
        return next(itertools.islice(filled, row + 1, None), 0)
