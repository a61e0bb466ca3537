"""Kinds of files that logs come in, by their names."""

from __future__ import annotations

from pathlib import Path

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
