"""A description as a draft effect: its formulas, in the form that ``[model.expressions]`` has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.description.candidates import CandidateTerm
from bayesid.diagnosis.description.shapes import Shape
from bayesid.effects import Effect

NAME = "draft"


def draft_table(candidates: Sequence[CandidateTerm], names: Sequence[str]) -> dict[str, Any]:
    """Formulas by reading and the amplitudes to be estimated, ``c1`` ..., in the order of `amplitudes`.

    Parameters
    ----------
    candidates
        The terms.
    names
        Of the channels.
    """
    sums: dict[str, list[str]] = {}
    parameters: dict[str, dict[str, Any]] = {}
    for candidate in candidates:
        for channel in candidate.channels:
            for text in candidate.shape.texts:
                key = f"c{len(parameters) + 1}"
                sums.setdefault(names[channel], []).append(f"{key} * {text}")
                parameters[key] = {"unit": unit_of(names[channel], candidate.shape)}
    texts = {reading: " + ".join(parts) for reading, parts in sums.items()}
    return {"summary": "what no effect of the library explains, described", **texts, "parameters": parameters}


def unit_of(reading: str, shape: Shape) -> str:
    """Unit of the amplitude of a shape in a reading, for turning joints."""
    own = "N" if reading.startswith("f") else "N m"
    return " per ".join([own, *(u for f in shape.products[0] if (u := f.unit))])


def draft_effect(data: DiagnosisData, table: dict[str, Any]) -> Effect:
    """The draft as an effect beside those that there are."""
    library = data.experiment.library
    name = next(n for k in range(1, 1000) if (n := NAME if k == 1 else f"{NAME}{k}") not in library.classes)
    made = library.with_expressions({name: table}, data.robot.n, "draft")
    (effect,) = made.places(name, data.robot.joint_names, data.channels.names, data.experiment.gear_ratio)
    return effect
