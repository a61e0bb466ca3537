"""Which reader a file or folder needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.importing.arrays import read_hdf5, read_mat, read_npz
from bayesid.recordings.importing.bags import read_bag
from bayesid.recordings.importing.stream import Source, Stream, kind_of
from bayesid.recordings.importing.tables import read_csv, read_lerobot, read_parquet

_ARRAYS = {"numpy": read_npz, "mat": read_mat, "hdf5": read_hdf5}


def read_source(
    path: str | Path, topics: Sequence[str] = (), mapped: Iterable[str] = (), episodes: Sequence[int] = ()
) -> tuple[Source, ...]:
    """Read a bag, an MCAP file, a table, an archive of arrays, or a data set of LeRobot: the recordings in it, as they are.

    Of a bag ``topics`` are read, and those of columns that are ``mapped``; of a data set its ``episodes``, default all. An
    `InputError` where it is not there, of an unknown kind, or damaged.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file or folder", file=str(path), remedy="give a recording")
    kind = kind_of(path)
    try:
        if kind == "lerobot":
            return read_lerobot(path, episodes)
        if kind == "bag":
            return (read_bag(path, topics, mapped),)
        if kind in _ARRAYS:
            return (Source(path.stem, _ARRAYS[kind](path)),)
        if kind in ("parquet", "text"):
            return (Source(path.stem, (read_parquet(path) if kind == "parquet" else read_csv(path),)),)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", file=path.name, remedy="give a readable file") from None
    what, remedy = (
        f'files "{path.suffix}" are not known',
        "give a ROS bag, MCAP, CSV, Parquet, NPZ, MAT, HDF5 or a LeRobot data set",
    )
    if kind == "pickle":
        what, remedy = "is a pickle, which could run anything when it is read", "save arrays as .npz or CSV"
    elif path.is_dir():
        what = "folder holds no metadata.yaml, .mcap, .db3 or meta/info.json"
    raise InputError(what, file=path.name, remedy=remedy)


def joined(sources: Sequence[Source]) -> Source:
    """Several files that are parts of one recording: topics and tables with the same columns one after the other.

    Tables with other columns have the names of their files before those of their columns.
    """
    groups: dict[tuple[str, frozenset[str], frozenset[str]], list[tuple[str, Stream]]] = {}
    for source in sources:
        for stream in source.streams:
            key = (stream.name, frozenset(stream.columns), frozenset(stream.clocks))
            groups.setdefault(key, []).append((source.name, stream))
    tables = sum(not name for name, _, _ in groups)
    streams = []
    for (name, _, _), parts in groups.items():
        (file, first), *_ = parts
        columns = {c: np.concatenate([stream.columns[c] for _, stream in parts]) for c in first.columns}
        clocks = {c: np.concatenate([stream.clocks[c] for _, stream in parts]) for c in first.clocks}
        streams.append(replace(first, name=name or (file if tables > 1 else ""), columns=columns, clocks=clocks))
    unread = dict.fromkeys(topic for source in sources for topic in source.unread)
    return Source(sources[0].name, tuple(streams), tuple(unread))
