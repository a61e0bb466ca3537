"""Writing results: all files of a verb or none."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.drawing import Plots, registered_by_report
from bayesid.errors import BayesidWarning, InputError
from bayesid.recordings.complaints import cut
from bayesid.recordings.whole import whole_folder
from bayesid.results.frames import frame
from bayesid.section import Part, as_html, as_text

if TYPE_CHECKING:
    from pandas import DataFrame

REPORT = "report.html"
#: Of the form of every document.
SCHEMA = 1
#: Keys of a written document that are not of the result's `to_dict`: what it is, how it prints, and the other files' hashes.
BESIDE = ("result", "printed", "files")
#: What each verb writes beside the report; a star stands for any number.
WRITTEN = {
    "accuracy": ("accuracy.json",),
    "bounds": ("bounds.json", "bounds.mat", "identified.urdf"),
    "calibrate": ("calibration.json", "gravity_compensation.yaml", "ros2_gravity_filter.yaml", "ros2_admittance.yaml"),
    "check": ("check.json",),
    "compare": ("comparison.json",),
    "diagnose": ("diagnosis.json", "model.toml", "next_motion.csv", "draft_effect.toml"),
    "excite": (
        "excitation.json", "trajectory.csv", "motions.toml", "parked.csv", "poses.csv", "reversed.csv", "speed-33.csv",
        "speed-67.csv", "stop-and-go.csv",
    ),
    "export": (
        "export.json", "identified.xml", "identified.urdf", "identified.sdf", "inverse_dynamics.hpp", "inverse_dynamics.py",
        "ranges.json", "sampled-*.xml", "sampled-*.urdf",
    ),
    "identifiability": ("identifiability.json",),
    "identify": ("estimate.json", "identified.urdf", "identified-unconstrained.urdf", "model.toml"),
    "payload": (
        "payload.json", "ur.script", "endeffector-config.json", "kuka.dat", "xarm.py", "gravity_compensation.yaml",
        "ros2_gravity_filter.yaml", "ros2_admittance.yaml", "next_poses.csv",
    ),
    "sample": ("posterior.json", "posterior.nc", "identified.urdf"),
    "watch": ("watch.json",),
}  # fmt: skip


#: Texts, or functions that write a file at the given path, by file name.
Files: TypeAlias = Mapping[str, str | Callable[[Path], Any]]


@registered_by_report
def report_of(result: object) -> str:
    """Text of a result's ``report.html``."""
    raise TypeError(f"{type(result).__name__} has no report: no module of bayesid.report registers one")


class Result(Plots, ABC):
    """What every verb returns: plain data that can be shown, drawn, made into a dictionary and written.

    Attributes
    ----------
    verb
        The key of `WRITTEN` that lists its files, its own document first.
    """

    verb: ClassVar[str]

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """What its document holds."""

    def _beside(self) -> Files:
        """Files beside the document and the report."""
        return {}

    @explains_types
    def write(self, folder: str | Path) -> Path:
        """Write the verb's files and ``report.html``, all or none; returns the report's path.

        Numbers of the document that are not finite are written as null (`strict`).
        """
        document = {**strict(self.to_dict()), "result": type(self).__name__, "printed": str(self).splitlines()}
        return write_results(folder, WRITTEN[self.verb][0], document, self._beside(), report_of(self))


class ShownResult(Result):
    """A result whose text in a terminal and a notebook is made of the same parts."""

    @abstractmethod
    def _parts(self) -> Sequence[Part]:
        """What a terminal and a notebook show: a headline, then paragraphs and tables."""

    def __str__(self) -> str:
        """What was found, for a terminal."""
        headline, *rest = self._parts()
        return "\n".join([str(headline), *as_text(rest)])

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        return as_html(self._parts())

    def to_dataframe(self) -> DataFrame:
        """The numbers that are printed, as a pandas table; nan where there is none.

        Of `check` a row a motion; of `identifiability` one a base parameter; of `accuracy` one a level of each factor and an
        effect left out; of `diagnose` one a parameter of each effect found; of `watch` one a recording; of `excite` one a limit,
        or a pair of effects to be told apart; of `payload` and `calibrate` one a quantity; of `export` one a form.
        """
        return frame(type(self).__name__, strict(self.to_dict()))


def check_output(folder: str | Path, verb: str = "") -> Path:
    """The output folder as a path, which need not exist; nothing in it is changed.

    An `InputError` where it is a file or cannot be written, or a file in it that ``verb`` (a key of `WRITTEN`) would replace is
    not of an earlier run.
    """
    folder = Path(folder)
    try:
        for part in [folder, *folder.absolute().parents]:
            if part.exists():
                if not part.is_dir():
                    raise InputError(f"{argument('folder', str(folder))}: {part} is a file; name a folder")
                os.rmdir(tempfile.mkdtemp(dir=part, prefix=".bayesid-"))
                break
        _check_ours(folder, (*WRITTEN[verb], REPORT) if verb else ())
    except OSError as error:
        raise InputError(
            f"{argument('folder', cut(str(folder), 120))}: cannot be written ({error.strerror}); name another folder"
        ) from None
    return folder


def write_results(folder: str | Path, name: str, document: Mapping[str, Any], files: Files, report: str) -> Path:
    """Write a JSON document, other files and the report, whose path is returned; they appear together or not at all.

    The document gets a key ``files``: the SHA-256 of each other file written with it. By that a later run knows which files are
    an earlier one's, and may be replaced; those of a document of the same ``name`` that it does not make are removed. Numbers of
    the document that are not finite are refused. An `InputError` where the folder cannot be written, or a file of the user's own
    would be replaced; a warning where one is replaced that belongs to another document there.
    """
    folder, every = check_output(folder), (name, *files, REPORT)
    _check_ours(folder, every)
    others = sorted(path.name for path in folder.glob("*.json") if path.name != name and _document(path) is not None)
    theirs = {path.name for path in _unchanged_files(folder, others)}
    lost = [file for file in (*files, REPORT) if file in theirs]
    left_over = [path for path in _unchanged_files(folder, [name]) if path.name not in every]
    try:
        with whole_folder(folder) as made:
            for file, write in files.items():
                if isinstance(write, str):
                    (made / file).write_text(write, encoding="utf-8")
                else:
                    write(made / file)
            (made / REPORT).write_text(report, encoding="utf-8")
            hashes = {file: _hash(made / file) for file in (*files, REPORT)}
            _write_document(made / name, {**document, "files": hashes})
        for path in left_over:  # such as a draft of what is explained now
            path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{argument('folder', str(folder))}: cannot be written ({error.strerror or error}); name another folder"
        ) from None
    if lost:
        what = f"{' and '.join(lost)} of {' and '.join(others)} in {folder} {'is' if len(lost) == 1 else 'are'}"
        warnings.warn(f"{what} replaced; give every verb a folder of its own to keep both", BayesidWarning, stacklevel=2)
    return folder / REPORT


def read_document(path: Path) -> dict[str, Any]:
    """A JSON document that an earlier run wrote, named by the user as ``estimate``."""
    named = f"{argument('estimate')} {path}"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{named}: cannot be read as JSON ({error}); name a file that bayesid wrote") from None
    if not (isinstance(document, dict) and {"schema", "experiment"} <= document.keys()):
        raise InputError(f"{named}: is no document of bayesid; name the estimate.json of a run of identify")
    check_schema(document, named)
    return document


def check_schema(document: Mapping[str, Any], named: str) -> None:
    """Refuse a document of another schema, whose keys may mean something else.

    Raises
    ------
    InputError
        Which it is of.
    """
    if document["schema"] != SCHEMA:
        raise InputError(
            f"{named}: is of schema {document['schema']}, this bayesid knows {SCHEMA}; read it with the bayesid that wrote it, "
            "or run the verb again"
        )


def amend(path: Path, added: Mapping[str, Any], report: Callable[[str], str]) -> bool:
    """Add keys to a document of an earlier run, and change the report that was written with it; both or none.

    Returns whether the report was still as it was written, and was changed, too.
    """
    document = read_document(path)
    page, hashes = path.parent / REPORT, dict(document.get("files") or {})
    ours = page.is_file() and hashes.get(REPORT) == _hash(page)
    with whole_folder(path.parent) as made:
        if ours:
            (made / REPORT).write_text(report(page.read_text(encoding="utf-8")), encoding="utf-8")
            hashes[REPORT] = _hash(made / REPORT)
        _write_document(made / path.name, {**document, **added, "files": hashes})
    return ours


def _write_document(path: Path, document: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")


def _check_ours(folder: Path, names: Iterable[str]) -> None:
    """Refuse to replace files that no earlier run wrote, or that were changed since."""
    there = [path.name for name in names for path in folder.glob(name)]
    if not there:
        return
    documents = [path.name for path in folder.glob("*.json") if _document(path) is not None]
    ours = {*documents, *(path.name for path in _unchanged_files(folder, documents))}
    for name in there:
        if name not in ours:
            raise InputError(
                f"{folder / name} is there and is not as a run of bayesid wrote it; name another {argument('folder')}, or move "
                "that file away"
            )


def _document(path: Path) -> dict | None:
    """A document of an earlier run; None if it is none, or cannot be read."""
    try:
        return read_document(path)
    except InputError:
        return None


def _unchanged_files(folder: Path, documents: Iterable[str]) -> list[Path]:
    """Files that an earlier run wrote with some documents, still as it wrote them."""
    out = []
    for document in map(_document, (folder / name for name in documents)):
        listed = document.get("files") if document else None
        for name, known in listed.items() if isinstance(listed, dict) else ():
            path = folder / Path(str(name)).name
            if path.is_file() and known == _hash(path):
                out.append(path)
    return out


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
