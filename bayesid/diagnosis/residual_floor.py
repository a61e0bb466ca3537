"""The noise floor where it cannot be measured: what the richest model leaves, as a function of frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.diagnosis.candidates import Library
from bayesid.diagnosis.data import WHITE, DiagnosisData
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.spectra import Segment

#: What the report says of the noise floor, by where that comes from.
SOURCES = {
    WHITE: "Nothing of it is assumed: the sensor's noise is read off the quietest moments above the frequencies of the motion.",
    "repeats": "Noise floor measured on repeats: how far readings scatter where the motion repeats, by frequency. What does not "
    "repeat, a single contact or a drive that sticks now and then, counts as noise.",
    "parked": "Noise floor measured at rest: the readings' noise while the robot stands still, by frequency. What shakes only in "
    "motion is not in it.",
    "stated": "Noise floor unknown: the readings were filtered before they were recorded. The data sheet's noise is taken for "
    "the least there is, and what the richest model of the library leaves beyond it for noise, too, so nothing can be said about "
    "effects that the library lacks.",
    "richest model": "Noise floor unknown: the readings were filtered before they were recorded, or hold far more than noise. "
    "What the richest model of the library leaves stands in for it, so nothing can be said about effects that the library lacks.",
}
#: Edges of the frequencies that share a floor [Hz].
_EDGES = np.concatenate([[0.0], np.geomspace(0.15, 10.0, 9)])


def with_floor_of(library: Library, fit: Fit) -> DiagnosisData:
    """The data with noise enlarged to what a fit and all columns of the library together leave.

    Never below what was measured. What remains of a model error that no effect of the library resembles counts as noise
    then: names become harder to earn, and whether something unknown is missing can no longer be said.
    """
    data, (left, parameters) = library.projector.data, library.unexplained(fit)
    share = library.projector.rows / max(library.projector.rows - parameters, 0.1 * library.projector.rows)
    channels = len(data.channels)
    energy, count = np.zeros((len(_EDGES), channels)), np.zeros((len(_EDGES), 1))
    at = 0
    for s in data.segments:
        mine, at = left[at : at + s.shape[0] * s.shape[1]].reshape(s.shape), at + s.shape[0] * s.shape[1]
        part = np.searchsorted(_EDGES, s.frequencies, side="right") - 1
        np.add.at(energy, part, mine**2)
        np.add.at(count, part, 1.0)
    ratio = np.maximum(share * energy / np.maximum(count, 1.0), 1.0)

    def louder(segments: Sequence[Segment]) -> tuple[Segment, ...]:
        out = []
        for s in segments:
            root = np.linalg.inv(s.whitener) * np.sqrt(ratio[np.searchsorted(_EDGES, s.frequencies, side="right") - 1])[:, None]
            out.append(s.with_noise(root @ root.transpose(0, 2, 1)))
        return tuple(out)

    source = data.floor_source if data.floor_source == "stated" else "richest model"
    fitted, unseen = louder(data.segments), louder(data.unseen)
    return replace(data, segments=fitted, unseen=unseen, floor_known=False, floor_source=source)
