"""Kinds of files that logs come in, and what reading one gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError, required

_FILES = {
    "bag": (".bag", ".db3", ".mcap"), "text": (".csv", ".tsv", ".txt", ".dat", ".log"), "parquet": (".parquet", ".pq"),
    "numpy": (".npz", ".npy"), "mat": (".mat",), "hdf5": (".h5", ".hdf5", ".hdf"),
    "pickle": (".pkl", ".pickle", ".pt", ".joblib"),
}  # fmt: skip


_KIND = {suffix: kind for kind, suffixes in _FILES.items() for suffix in suffixes}
#: What a LeRobot data set has.
INFO = Path("meta") / "info.json"
#: Kinds that are no tables of an experiment folder, though they can be imported.
FOREIGN = ("bag", "lerobot", "numpy", "mat", "hdf5")


def kind_of(path: Path) -> str:
    """What a file or folder is: ``lerobot``, ``bag``, or a key of `_FILES`; empty where it is none of them."""
    if not path.is_dir():
        return _KIND.get(path.suffix.lower(), "")
    if (path / INFO).is_file():
        return "lerobot"
    return "bag" if (path / "metadata.yaml").is_file() or any(any(path.glob(f"*{end}")) for end in (".db3", ".mcap")) else ""


@dataclass(frozen=True, eq=False)
class Stream:
    """Columns that share their rows: a topic of a bag, or a table."""

    name: str  # the topic; empty for a table, or its file's name where several are one recording
    #: (N,) by name, numbers or texts as they were recorded; entries of an array are columns ``name[0]``, ``name[1]``, ...
    columns: Mapping[str, np.ndarray]
    #: Times of the rows (N,) [ns since 1970], by ``header`` (when the sender took the sample) and ``log`` (when the recorder
    #: got it); empty for a table, whose times are a column.
    clocks: Mapping[str, np.ndarray] = field(default_factory=dict)
    frame: str = ""  # the frame that its messages name; empty where there is none

    def full_name(self, column: str) -> str:
        """The column's name with its topic's before it."""
        return f"{self.name}/{column}" if self.name else column


@dataclass(frozen=True, eq=False)
class Source:
    """One recording as another tool wrote it."""

    name: str  # what it is called in messages and in experiment.toml
    streams: tuple[Stream, ...]  # what was read of it
    unread: tuple[str, ...] = ()  # topics that were not read, with their types, one ``/topic (type)`` each
    notes: tuple[str, ...] = ()  # how files became one recording, one line each


def array_columns(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of an array (N,) or (N, ...): itself, or ``name[0]``, ``name[1]``, ... of its entries in C order."""
    if values.ndim == 1:
        return {name: values}
    flat = values.reshape(len(values), -1)
    return {f"{name}[{k}]": flat[:, k] for k in range(flat.shape[1])}


def extra(module: str, package: str, source: str) -> Any:
    """Import a module of an optional package; an `InputError` says how to install it."""
    return required(module, InputError(f"reading it needs {package}", file=source, remedy='pip install "bayesid[import]"'))
