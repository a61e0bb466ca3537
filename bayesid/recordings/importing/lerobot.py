"""Data sets of LeRobot, version 3: Parquet files of frames, whose columns meta/info.json describes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, listed, one_line
from bayesid.recordings.importing.kinds import INFO
from bayesid.recordings.importing.stream import Source, Stream
from bayesid.recordings.importing.tables import read_parquet


def read_lerobot(path: Path, episodes: Sequence[int] = ()) -> tuple[Source, ...]:
    """Read a data set: one source an episode, with entries of ``observation.state`` and ``action`` named as info.json does.

    Parameters
    ----------
    path
        The folder with ``meta/info.json``.
    episodes
        Which to read; empty: all.

    Raises
    ------
    InputError
        pyarrow is not installed, info.json is damaged or of another version, or an episode is not there.
    """
    info = _read_info(path)
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise InputError("has no data/**/*.parquet", file=path.name, remedy="fetch the data set whole")
    named: dict[str, np.ndarray] = {}
    tables = [read_parquet(file).columns for file in files]
    for column in tables[0]:
        if all(column in table for table in tables):
            named[_named(column, info)] = np.concatenate([table[column] for table in tables])
    if "episode_index" not in named or "timestamp" not in named:
        raise InputError("has no columns episode_index and timestamp", file=path.name, remedy="give a data set of version 3")
    number = named["episode_index"].astype(int)
    there = sorted(set(number.tolist()))
    for episode in episodes:
        if episode not in there:
            raise InputError(f"no episode {episode}", file=path.name, remedy=f"there are {listed([str(e) for e in there])}")
    sources = []
    for episode in episodes or there:
        rows = np.flatnonzero(number == episode)
        rows = rows[np.argsort(named["timestamp"][rows], kind="stable")]
        sources.append(Source(f"{path.name}_{episode}", (Stream("", {name: values[rows] for name, values in named.items()}),)))
    return tuple(sources)


def _read_info(path: Path) -> dict[str, Any]:
    try:
        info = json.loads((path / INFO).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"cannot be read ({cut(one_line(str(error)), 80)})", file=f"{path.name}/{INFO.as_posix()}") from None
    version = str(info.get("codebase_version", "")) if isinstance(info, dict) else ""
    if not version.startswith("v3"):
        raise InputError(
            f'"{cut(version)}" is not version 3', file=f"{path.name}/{INFO.as_posix()}", key="codebase_version", value=version,
            remedy="convert the data set to version 3 with LeRobot's own tool",
        )  # fmt: skip
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
