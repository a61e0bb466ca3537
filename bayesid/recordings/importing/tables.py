"""Tables of other tools: CSV with any separator, and Parquet; every column as it stands."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, is_number, listed, one_line
from bayesid.recordings.importing.stream import INFO, Source, Stream, array_columns, extra
from bayesid.recordings.motion_checks import MIN_SAMPLES
from bayesid.recordings.table_reader import EMPTY, count_lines

_SEPARATORS = (",", ";", "\t", "|")
_SNIFFED = 20  # lines that tell what separates cells
_LONGEST_LINE = 1 << 20  # of a text that is a table [bytes]


def read_csv(path: Path, poses: bool = False) -> Stream:
    """Read a table of texts; commas, semicolons, tabs, bars or blanks separate, and but for commas decimals may have one.

    Numbers without a header, such as a matrix that savetxt writes, are an array of the file's name: ``log[0]``, ``log[1]``, ...
    Such a matrix (n, N) is turned, for samples outnumber columns, but for those of ``poses``, of which there may be a few.
    Cells that are lists, ``[0.1, 0.2]``, are an array, too: ``position[0]``, ``position[1]``, ...
    An `InputError` where it is binary, empty, or with rows of another width, as a file that was cut off has.
    """
    import pandas as pd

    lines, wrong = _first_lines(path), partial(InputError, file=path.name)
    first, separator, named = _first_line(lines, path.name)
    header = [name.strip() for name in _cells(lines[first].lstrip("# "), separator)]
    trailing = len(header) > 1 and not header[-1]  # some loggers end every line with a separator
    if not named:
        width = len(header) - trailing
        header = ([path.stem] if width == 1 else [f"{path.stem}[{k}]" for k in range(width)]) + [""] * trailing
    for name in header[: len(header) - trailing]:
        if header.count(name) > 1 and name:
            raise wrong(f"there are {header.count(name)} of it", key=f"column {cut(name)}", remedy="keep one")
    cells = [cell.strip() for cell in _cells(lines[first], separator)]
    numbered = len(cells) > 2 and cells == [str(k) for k in range(len(cells))]  # as pandas does where columns have no names
    skipped = first + named + numbered
    widths = {len(_cells(line, separator)) for line in lines[skipped:] if line.strip()}
    if named and len(widths) == 1 and widths != {len(header)} and len(lines) > skipped + 1:
        problem = f"line {first + 1} names {len(header)} columns, but every row has {max(widths)} cells"
        remedy = f"name each of them, or none: without that line they are {path.stem}[0], {path.stem}[1] and so on"
        raise wrong(problem, remedy=remedy)
    decimal = _decimal(lines[skipped:], separator)
    count_lines(path, path.name, len(header), separator, first, "the header" if named else "the first row")
    between = r"\s+" if separator == " " else separator
    try:
        frame: Any = pd.read_csv(
            path, sep=between, decimal=decimal, header=None, names=list(range(len(header))), skiprows=skipped,
            index_col=False, skipinitialspace=True, encoding="utf-8-sig", na_values=EMPTY, low_memory=False,
        )  # fmt: skip
    except (ValueError, OverflowError) as error:  # pandas' parser errors and Unicode's are ValueErrors too
        raise wrong(f"cannot be read as CSV ({cut(one_line(str(error)), 80)})", remedy="check the file") from None
    if not len(frame):
        raise wrong("has a header but no rows", remedy="give one row per sample")
    columns: dict[str, np.ndarray] = {}
    for k, name in enumerate(header):
        columns |= _list_columns(name, frame[k].to_numpy()) if name else {}
    if not (named or poses) and len(columns) > max(len(frame), MIN_SAMPLES):
        columns = array_columns(path.stem, np.squeeze(np.stack(list(columns.values()))))
    return Stream("", _with_stamps(_by_joint(columns)))


def read_parquet(path: Path) -> Stream:
    """Read a Parquet file; lists of one length are arrays. An `InputError` where it is none, or pyarrow is not installed."""
    parquet = extra("pyarrow.parquet", "pyarrow", path.name)
    try:
        table = parquet.read_table(path)
        columns: dict[str, np.ndarray] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            columns |= _arrow_column(name, column)
    # pyarrow's own errors are these, too: NotImplementedError for a type that it cannot read
    except (ValueError, OSError, MemoryError, KeyError, NotImplementedError) as error:
        raise InputError(
            f"cannot be read as Parquet ({cut(one_line(str(error)), 80)})", file=path.name, remedy="write it again"
        ) from None
    return Stream("", _with_stamps(columns))


def _arrow_column(name: str, column: Any) -> dict[str, np.ndarray]:
    """A column of a Parquet table as numbers or texts; lists of several lengths are left out."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        rows = column.to_pylist()
        widths = {len(row) for row in rows if row is not None}
        if len(widths) != 1 or 0 in widths:
            return {}
        empty = [None] * widths.pop()
        try:  # entries and rows without a number are such cells
            values = np.asarray([empty if row is None else row for row in rows])
            values = values.astype(np.float64) if values.dtype.kind == "O" else values
        except (TypeError, ValueError):
            return {}
        return array_columns(name, values) if values.dtype.kind in "fiub" else {}
    if pa.types.is_struct(kind):
        out: dict[str, np.ndarray] = {}
        for part, values in zip(kind, column.flatten(), strict=True):
            out |= _arrow_column(f"{name}/{part.name}", values)
        return out
    return {name: column.to_pandas().to_numpy()}


def _first_lines(path: Path) -> list[str]:
    wrong = partial(InputError, file=path.name, remedy="export the table as CSV in UTF-8")
    with path.open("rb") as handle:
        block = handle.read(_LONGEST_LINE)
    if b"\0" in block:
        raise wrong("holds zero bytes and is no text")
    try:
        text = block.decode("utf-8-sig", errors="strict" if len(block) < _LONGEST_LINE else "ignore")
    except UnicodeDecodeError:
        raise wrong("is not UTF-8 text") from None
    lines = text.splitlines()
    return (lines if len(block) < _LONGEST_LINE or len(lines) < 2 else lines[:-1])[: 10 * _SNIFFED]  # the last may be cut


def _first_line(lines: list[str], source: str) -> tuple[int, str, bool]:
    """Index of the first line of the table, after remarks and blank lines, what separates cells, and whether it has names."""
    filled = [k for k, line in enumerate(lines) if line.strip() and not re.fullmatch(r"\s*sep=.\s*", line)]  # sep= is Excel's
    if not filled:
        raise InputError("is empty", file=source, remedy="give a table with one row per sample")
    first = next((k for k in filled if not is_number(re.split(r"[,;|\s]", lines[k].strip())[0])), None)
    if first is None:
        first = filled[0]
        return first, next((mark for mark in _SEPARATORS if _separates(mark, lines[first])), " "), False
    for after in [k for k in filled if k > first]:  # remarks before a header, which may begin as they do
        if not lines[after].lstrip().startswith(("#", "%")) and not _is_remark(lines[first], lines[after]):
            break
        first = after
    counts = {separator: lines[first].count(separator) for separator in _SEPARATORS}
    separator = max(counts, key=lambda s: counts[s])
    widths = {len(_cells(line.lstrip("# "), " ")) for line in lines[first:] if line.strip()}
    if not counts[separator] and len(widths) == 1 and widths != {1}:
        return first, " ", True  # as numpy, and logs of Universal Robots' RTDE, have it
    if not counts[separator]:
        problem = f'line {first + 1} names one column, "{cut(lines[first].strip())}"'
        remedy = "separate columns with commas, semicolons or tabs"
        if lines[first].rstrip().endswith(":"):
            remedy = "record a bag in place of what `topic echo` of ROS prints"
        raise InputError(problem, file=source, remedy=remedy)
    return first, separator, True


def _separates(mark: str, line: str) -> bool:
    """Whether what stands between these marks are numbers alone, which may have decimal commas where the mark is none."""
    cells = [cell.strip() for cell in _cells(line, mark)]
    return len(cells) > 1 and all(is_number(cell if mark == "," else cell.replace(",", ".")) for cell in cells if cell)


def _cells(line: str, separator: str) -> list[str]:
    """Cells of a line; any number of blanks separates where blanks do."""
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a cell is longer than any of a table
        return line.split(separator)


def _decimal(lines: list[str], separator: str) -> str:
    """What decimals are written with: a comma where some cells of numbers have one and none has a point."""
    if separator == ",":
        return "."
    cells = [cell.strip(' "') for line in lines for cell in (line.split() if separator == " " else line.split(separator))]
    commas, points = (any(re.fullmatch(rf"[-+]?\d*{mark}\d+(?:[eE][-+]?\d+)?", cell) for cell in cells) for mark in (",", "[.]"))
    return "," if commas and not points else "."


def _is_remark(line: str, after: str) -> bool:
    """Whether a line that begins with # or % names no columns: a line of another number of names comes after it."""
    separators = (*_SEPARATORS, " ") if not any(s in after for s in _SEPARATORS) else _SEPARATORS
    separator = max(separators, key=after.count)
    begins = after.strip().split(separator)[0].strip()
    alike = line.strip().lstrip("#% ").count(separator) == after.strip().lstrip("#% ").count(separator)
    return line.lstrip().startswith(("#", "%")) and not is_number(begins) and not alike


def _list_columns(name: str, cells: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of one whose cells are lists of one length, as pandas and numpy write them; any other as it is."""
    if cells.dtype != object or not all(isinstance(cell, str) for cell in cells):
        return {name: cells}
    plain = (re.sub(r"np\.\w+\(([^()]*)\)", r"\1", cell.strip()) for cell in cells)  # a list of numpy's own numbers
    lists = [re.fullmatch(r"(?:array\((?:'\w', )?)?[\[(]([^][()]*)[\])]+", cell) for cell in plain]
    rows = [re.findall(r"[^\s,]+", found[1]) for found in lists if found]
    if len(rows) < len(cells) or len({len(row) for row in rows}) != 1:
        return {name: cells}
    try:
        return array_columns(name, np.array(rows, np.float64))
    except ValueError:  # names of joints
        return array_columns(name, np.array([[entry.strip("'\"") for entry in row] for row in rows], object))


def _with_stamps(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns with those of stamps of ROS, whole seconds and the nanoseconds beyond, as one of nanoseconds."""
    out = dict(columns)
    for name, seconds in columns.items():
        match = re.fullmatch(r"((.*?)[/._]?)secs?", name)
        if match is None:
            continue
        beyond = next((other for word in ("nanosec", "nsec", "nsecs") if (other := match[1] + word) in columns), None)
        if beyond is not None and seconds.dtype.kind in "iu" and columns[beyond].dtype.kind in "iu":
            del out[name], out[beyond]
            out[match[2] or "stamp"] = seconds.astype(np.int64) * 10**9 + columns[beyond].astype(np.int64)
    return out


def _by_joint(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of a JointState that was written as ``name0, ..., position0, ...``, under their joints' names."""
    names: dict[tuple[str, str], str] = {}
    for column, values in columns.items():
        match = re.fullmatch(r"(.*?)name\[?(\d+)\]?", column)
        if match and values.dtype == object and all(value == values[0] for value in values) and isinstance(values[0], str):
            names[match[1], match[2]] = values[0]
    if not names:
        return columns
    out: dict[str, np.ndarray] = {}
    for column, values in columns.items():
        match = re.fullmatch(r"(.*?)(name|position|velocity|effort)\[?(\d+)\]?", column)
        joint = names.get((match[1], match[3])) if match else None
        if match is None or joint is None:
            out[column] = values
        elif match[2] != "name":
            out[f"{match[1]}{joint}/{match[2]}"] = values
    return out


def read_lerobot(path: Path, episodes: Sequence[int] = ()) -> tuple[Source, ...]:
    """Read a data set: one source an episode, with entries of ``observation.state`` and ``action`` named as info.json does.

    ``path`` is the folder with ``meta/info.json``; without ``episodes`` all are read. An `InputError` where pyarrow is not
    installed, info.json is damaged or of another version, or an episode is not there.
    """
    info, wrong = _read_info(path), partial(InputError, file=path.name)
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise wrong("has no data/**/*.parquet", remedy="fetch the data set whole")
    named: dict[str, np.ndarray] = {}
    tables = [read_parquet(file).columns for file in files]
    for column in tables[0]:
        if all(column in table for table in tables):
            named[_named(column, info)] = np.concatenate([table[column] for table in tables])
    if "episode_index" not in named or "timestamp" not in named:
        raise wrong("has no columns episode_index and timestamp", remedy="give a data set of version 3")
    number = named["episode_index"].astype(int)
    there = sorted(set(number.tolist()))
    for episode in episodes:
        if episode not in there:
            raise wrong(f"no episode {episode}", remedy=f"there are {listed([str(e) for e in there])}")
    sources = []
    for episode in episodes or there:
        rows = np.flatnonzero(number == episode)
        rows = rows[np.argsort(named["timestamp"][rows], kind="stable")]
        sources.append(Source(f"{path.name}_{episode}", (Stream("", {name: values[rows] for name, values in named.items()}),)))
    return tuple(sources)


def _read_info(path: Path) -> dict[str, Any]:
    wrong = partial(InputError, file=f"{path.name}/{INFO.as_posix()}")
    try:
        info = json.loads((path / INFO).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise wrong(f"cannot be read ({cut(one_line(str(error)), 80)})") from None
    version = str(info.get("codebase_version", "")) if isinstance(info, dict) else ""
    if not version.startswith("v3"):
        remedy = "convert the data set to version 3 with LeRobot's own tool"
        raise wrong(f'"{cut(version)}" is not version 3', key="codebase_version", value=version, remedy=remedy)
    return info


def _named(column: str, info: dict[str, Any]) -> str:
    """A column of an array under the name that info.json gives its entry, where it gives one."""
    feature, bracket, index = column.partition("[")
    names = info.get("features", {}).get(feature, {}).get("names") if isinstance(info.get("features"), dict) else None
    if isinstance(names, dict):  # {"motors": [...]}
        names = next((part for part in names.values() if isinstance(part, list)), None)
    if not bracket or not isinstance(names, list) or not index[:-1].isdigit() or int(index[:-1]) >= len(names):
        return column
    return f"{feature}/{names[int(index[:-1])]}"
