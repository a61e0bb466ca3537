"""The numbers that results print, as rows of data frames, by their documents: the same of a result and of its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pandas import DataFrame

_Document = Mapping[str, Any]
_QUANTITY = ("value", "std", "low", "high", "unit")


def _effects(document: _Document) -> Iterator[dict[str, Any]]:
    """A row a parameter of each effect that was found."""
    for effect in document["effects"]:
        for parameter, number in effect["parameters"].items():
            yield {**effect, "parameter": parameter, **number}


def _motions(document: _Document) -> Iterator[dict[str, Any]]:
    """A row a motion, with what a fit leaves of it where there was one."""
    left = {of["motion"]: of for of in document["left"]}
    for motion in document["motions"]:
        yield {**motion, **left.get(motion["name"], {})}


def _base_parameters(document: _Document) -> Iterator[dict[str, Any]]:
    """A row a base parameter of the readings that are recorded, or that come first."""
    sets = {of["name"]: of for of in document["sensor_sets"]}
    yield from sets[document["default_sensor_set"]]["base_parameters"]


def _influences(document: _Document) -> Iterator[dict[str, Any]]:
    """A row a level of every factor that was varied, then one an effect that the model lacks."""
    for factor in document.get("factors", ()):  # not there where nothing was simulated
        yield from ({"factor": factor["name"], **level} for level in factor["levels"])
    for of in document["bias_susceptibility"]:
        yield {"factor": "effect left out", "label": f"{of['effect']}@{of['where']}", **of}


def _recordings(document: _Document) -> Iterator[dict[str, Any]]:
    """A row a recording; its effects in one text."""
    for recording in document["recordings"]:
        changes = ", ".join(f"{effect['name']}@{effect['where']}" for effect in recording.get("effects", ()))
        yield {**recording, "effects": changes}


def _quantities(document: _Document, groups: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """A row a number of each group of quantities, such as the mass, or the coordinates of a centre of mass."""
    for group in groups:
        entry = document[group] or {}
        for name, number in [("", entry)] if "unit" in entry and "order" not in entry else entry.items():
            if isinstance(number, Mapping):
                yield {"quantity": group, "parameter": name, **number}


def _calibration(document: _Document) -> Iterator[dict[str, Any]]:
    yield from ({"quantity": f"{row['name']}@{row['where']}", **row} for row in _effects(document))
    yield from _quantities(document, ("mass", "centre_of_mass", "common_gain"))


_FOUND = ("name", "where", "parameter", "value", "std", "unit", "probability", "share", "share_low")
#: Columns of each kind of result, and what makes its rows.
_TABLES: dict[str, tuple[tuple[str, ...], Callable[[_Document], Iterator[Mapping[str, Any]]]]] = {
    "Inspection": (
        ("name", "role", "kind", "samples", "duration_s", "rate_hz", "dropped_samples", "relative_error", "times_noise"),
        _motions,
    ),
    "Identifiability": (
        ("name", "label", "unit", "class", "expected_std", "size", "relative_std", "prior_share"), _base_parameters,
    ),
    "Accuracy": (
        ("factor", "label", "source", "median_rms_ratio", "low", "high", "prediction", "largest_sigmas"), _influences,
    ),
    "Diagnosis": (_FOUND, _effects),
    "Changes": (_FOUND, _effects),
    "Watch": (("name", "verdict", "effects", "largest_log_evidence", "gap", "gap_left", "times_noise"), _recordings),
    "Excitation": (("kind", "where", "reached", "limit", "unit", "ratio"), lambda document: iter(document["limits"])),
    "DistinguishingMotion": (
        ("true", "other", "noncentrality", "log_bayes_factor", "log_bayes_factor_std", "probability"),
        lambda document: iter(document["tell"]["pairs"]),
    ),
    "PayloadEstimate": (
        ("quantity", "parameter", *_QUANTITY, "shown"),
        lambda document: _quantities(document, ("mass", "centre_of_mass", "first_moment", "inertia")),
    ),
    "Calibration": (("quantity", "parameter", *_QUANTITY), _calibration),
    "Exported": (
        ("to", "about"), lambda document: ({"to": form, "about": document["about"].get(form)} for form in document["to"]),
    ),
}  # fmt: skip


def frame(kind: str, document: _Document) -> DataFrame:
    """The table of a result's class, of its document; nan where the document has nothing."""
    from pandas import DataFrame

    columns, rows = _TABLES[kind]
    return DataFrame(
        [[np.nan if (x := row.get(c)) is None else x for c in columns] for row in rows(document)], columns=[*columns]
    )
