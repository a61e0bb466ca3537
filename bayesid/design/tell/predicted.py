"""Segments that read exactly what a model predicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import Term


@dataclass(frozen=True, eq=False)
class PredictedSegment(Segment):
    """A segment whose readings are given by their coefficients, without noise.

    Attributes
    ----------
    coefficients
        Of the readings (K, c).
    """

    coefficients: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @cached_property
    def measured_readings(self) -> np.ndarray:
        """Coefficients of the readings (K, c)."""
        return self.coefficients


def predicted(data: DiagnosisData, segment: Segment, links: np.ndarray, offset: np.ndarray, terms: Sequence[Term]) -> Segment:
    """The segment with the readings that a model predicts in place of its own.

    Parameters
    ----------
    data
        The robot and what is compared.
    segment
        Any.
    links, offset, terms
        The model.
    """
    read = segment.spectrum(data.predict(segment, links, terms)) + segment.measured_ones * offset
    given = {item.name: getattr(segment, item.name) for item in fields(Segment) if item.init}
    return PredictedSegment(**given, coefficients=read)
