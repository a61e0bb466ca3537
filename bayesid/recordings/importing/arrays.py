"""Arrays by name: NumPy archives, MAT files up to version 7.3, HDF5, and what MuJoCo's identification calls a TimeSeries."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, listed, one_line
from bayesid.recordings.importing.stream import Source, Stream, array_columns

_DEEPEST = 8  # structures within structures
_LARGEST = 1 << 32  # of what a file says it holds [bytes]
_KINDS = "fiubUSMm"


def read_npz(path: Path) -> Source:
    """Read a NumPy archive; pickled objects are never loaded. An `InputError` where it is no archive of arrays."""
    try:
        with path.open("rb") as handle:  # numpy leaves a file that it cannot read open
            content = np.load(handle, allow_pickle=False)
            found = {path.stem: content} if isinstance(content, np.ndarray) else _of_archive(content)
    except Exception as error:  # numpy and zipfile raise whatever a damaged file leads to
        raise _unreadable(path, "a NumPy archive", error) from None
    if "signal_mapping" in found:
        found = _time_series(path, found)
    return _source(path, _named_fields(found))


def _of_archive(archive: Any) -> dict[str, np.ndarray]:
    """Arrays of an archive; those of objects, which are pickled, are left out."""
    found: dict[str, np.ndarray] = {}
    size = sum(part.file_size for part in archive.zip.infolist())
    if size > _LARGEST:
        raise ValueError(f"it would take {size / 1e9:.0f} GB")
    for name in archive.files:
        try:
            found[name] = archive[name]
        except ValueError as error:
            if "allow_pickle" not in str(error):
                raise
    return found


def _time_series(path: Path, found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of MuJoCo's ``TimeSeries`` by the names that its mapping, ``{name: [kind, indices]}`` as JSON, gives them."""
    try:
        times, data = found["times"], found["data"]
        mapping = json.loads(str(found["signal_mapping"]))
        return {"times": times} | {str(name): data[:, np.array(indices, int)] for name, (_, indices) in mapping.items()}
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise _unreadable(path, "a TimeSeries of MuJoCo", error) from None


def read_mat(path: Path) -> Source:
    """Read a MAT file; fields of structures are named ``structure/field``. An `InputError` where it is no MAT file."""
    import h5py
    import scipy.io
    from scipy.io.matlab import MatlabOpaque

    if h5py.is_hdf5(path):
        return read_hdf5(path)
    try:
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False, chars_as_strings=True)
    except Exception as error:  # scipy raises whatever a damaged file leads to
        raise _unreadable(path, "a MAT file", error) from None
    known = {k: v for k, v in content.items() if not k.startswith("__") and not isinstance(v, MatlabOpaque)}
    opaque = [v.ravel()[0] for v in content.values() if isinstance(v, MatlabOpaque)]
    objects = [f"{_text(v['s0'])} ({_text(v['s2'])})" for v in opaque]
    return _source(path, dict(_of_structures(known, 0)), objects)


def read_hdf5(path: Path) -> Source:
    """Read the arrays of an HDF5 file, or of a MAT file of version 7.3, named by the groups that they are in."""
    import h5py

    found: dict[str, np.ndarray] = {}
    objects: list[str] = []
    size = 0

    def visit(name: str, item: Any) -> None:
        nonlocal size
        if "MATLAB_object_decode" in item.attrs and not name.startswith("#"):  # what it holds stands elsewhere, in no known form
            objects.append(f"{name} ({_text(item.attrs.get('MATLAB_class', 'object'))})")
        elif isinstance(item, h5py.Dataset) and (item.dtype.kind in _KINDS or item.dtype.names) and not name.startswith("#"):
            size += item.nbytes
            if size > _LARGEST:
                raise ValueError(f"it would take more than {size / 1e9:.0f} GB")
            if not item.attrs.get("MATLAB_empty", 0) and item.ndim:
                values = np.asarray(item[()])
                # MATLAB writes columns one after the other: what it calls (N, n) is stored as (n, N).
                found[name] = values.T if "MATLAB_class" in item.attrs else values

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except Exception as error:  # h5py raises whatever a damaged file leads to
        raise _unreadable(path, "an HDF5 file", error) from None
    return _source(path, _named_fields(found), objects)


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _unreadable(path: Path, what: str, error: BaseException) -> InputError:
    reason = cut(one_line(str(error)), 100) or type(error).__name__
    return InputError(f"cannot be read as {what} ({reason})", file=path.name, remedy="is it cut off? write it again")


def _of_structures(content: Mapping[str, Any], depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays by the path to them, through MATLAB's structures, ``log/q``, and arrays of structures and cells, ``log(1)/q``."""
    for path, value in content.items():
        fields = getattr(value, "_fieldnames", None)
        if depth < _DEEPEST and fields is not None:
            yield from _of_structures({f"{path}/{field}": getattr(value, field) for field in fields}, depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
            yield path, value
        elif depth < _DEEPEST and isinstance(value, np.ndarray) and value.dtype.kind == "O":
            yield from _of_structures({f"{path}({k})": part for k, part in enumerate(value.ravel("F"), 1)}, depth + 1)


def _named_fields(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays with fields (numpy's structured ones) as one array a field."""
    out: dict[str, np.ndarray] = {}
    for name, values in found.items():
        if values.dtype.names:
            out |= {f"{name}/{part}": values[part] for part in values.dtype.names}
        else:
            out[name] = values
    return out


def _source(path: Path, found: Mapping[str, np.ndarray], objects: Sequence[str] = ()) -> Source:
    """Arrays of one length as one stream, the longest first; arrays (n, N) are turned, for samples outnumber columns.

    ``objects`` are those of MATLAB's classes, such as timeseries and tables, which cannot be read.
    """
    by_length: dict[int, dict[str, np.ndarray]] = {}
    for name, values in found.items():
        values = np.squeeze(values) if values.ndim > 1 else values
        if values.dtype.kind not in _KINDS or values.ndim == 0 or values.size < 2:
            continue
        if values.ndim == 2 and values.shape[0] < values.shape[1]:
            values = values.T
        by_length.setdefault(len(values), {}).update(array_columns(name, values))
    if not by_length:
        what = f"; it holds {listed([*found, *objects], 6)}" if found or objects else ""
        remedy = "give times and positions as arrays of numbers"
        if objects:
            remedy += ", which objects of MATLAB's classes are not: save x.Time and x.Data of a timeseries, x{:,:} of a table"
        raise InputError(f"holds no arrays of samples{what}", file=path.name, remedy=remedy)
    order = sorted(by_length, key=lambda rows: -len(by_length[rows]) * (rows > 1))
    return Source(path.stem, tuple(Stream("", by_length[rows]) for rows in order), tuple(objects))
