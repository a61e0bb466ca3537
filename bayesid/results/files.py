"""Writing results: all files of a verb or none."""

from __future__ import annotations

import functools
import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayesid.errors import InputError


class Files(NamedTuple):
    """What a verb writes.

    Attributes
    ----------
    documents
        JSON-serialisable objects by file name.
    others
        Functions that write a file at the given path, by file name.
    report
        Text of ``report.html``.
    """

    documents: Mapping[str, Any]
    others: Mapping[str, Callable[[Path], Any]]
    report: str


@functools.singledispatch
def files_of(result: object) -> Files:
    """The files of a result; each verb registers its own, so that results need to know nothing of reports.

    Raises
    ------
    TypeError
        No verb has registered this type of result.
    """
    raise TypeError(f"{type(result).__name__} has no files: no verb in bayesid.workflows registers them")


class Result:
    """What every verb returns: plain data that can be shown, made into a dictionary and written."""

    def write(self, folder: str | Path) -> Path:
        """Write the verb's files and ``report.html``, all or none; returns the report's path."""
        return write_results(folder, *files_of(self))

    def _repr_html_(self) -> str:
        """The text of ``str()`` for notebooks."""
        return f"<pre>{escape(str(self))}</pre>"


def check_output(folder: str | Path) -> Path:
    """The output folder as a path, refused early if it cannot be one."""
    folder = Path(folder)
    for part in [folder, *folder.parents]:
        if part.exists():
            if not part.is_dir():
                raise InputError(f"--out {folder}: {part} is a file; name a folder")
            break
    return folder


def write_results(
    folder: str | Path, documents: Mapping[str, Any], files: Mapping[str, Callable[[Path], Any]], report: str
) -> Path:
    """Write JSON documents, other files and the report; they appear together or not at all.

    Parameters
    ----------
    folder
        Made if absent; files of an earlier run are replaced.
    documents
        JSON-serialisable objects by file name; numbers that are not finite are refused.
    files
        Functions that write a file at the given path, by file name.
    report
        Text of ``report.html``.

    Returns
    -------
    path
        Of the report.
    """
    folder = check_output(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as temporary:
        made = Path(temporary)
        for name, document in documents.items():
            text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
            (made / name).write_text(text + "\n", encoding="utf-8")
        for name, write in files.items():
            write(made / name)
        (made / "report.html").write_text(report, encoding="utf-8")
        folder.mkdir(exist_ok=True)
        for path in made.iterdir():
            shutil.move(path, folder / path.name)
    return folder / "report.html"


def strict(value: Any) -> Any:
    """The same for strict JSON: plain numbers, null for those that are not finite, text for whatever else there is."""
    if isinstance(value, dict):
        return {str(k): strict(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return strict(value.tolist())
    if isinstance(value, (list, tuple)):
        return [strict(v) for v in value]
    if isinstance(value, np.generic):
        return strict(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
