"""The noise floor where it cannot be measured: what the richest model leaves, as a function of frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.diagnosis.candidates import Library
from bayesid.diagnosis.case import Case
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.spectra import Stretch

#: Edges of the frequencies that share a floor [Hz].
_EDGES = np.concatenate([[0.0], np.geomspace(0.15, 10.0, 9)])


def with_floor_of(library: Library, fit: Fit) -> Case:
    """The case with noise enlarged to what a fit and all columns of the library together leave.

    Never below what was measured. What remains of a model error that no effect of the library resembles counts as noise
    then: names become harder to earn, and whether something unknown is missing can no longer be said.
    """
    case, left, parameters = library.rigid.case, library.unexplained(fit), library.parameters(fit)
    share = library.rigid.rows / max(library.rigid.rows - parameters, 0.1 * library.rigid.rows)
    channels = len(case.channels)
    energy, count = np.zeros((len(_EDGES), channels)), np.zeros((len(_EDGES), 1))
    at = 0
    for s in case.stretches:
        mine, at = left[at : at + s.shape[0] * s.shape[1]].reshape(s.shape), at + s.shape[0] * s.shape[1]
        part = np.searchsorted(_EDGES, s.frequencies, side="right") - 1
        np.add.at(energy, part, mine**2)
        np.add.at(count, part, 1.0)
    ratio = np.maximum(share * energy / np.maximum(count, 1.0), 1.0)

    def louder(stretches: Sequence[Stretch]) -> tuple[Stretch, ...]:
        out = []
        for s in stretches:
            root = np.linalg.inv(s.whitener) * np.sqrt(ratio[np.searchsorted(_EDGES, s.frequencies, side="right") - 1])[:, None]
            out.append(replace(s, covariance=root @ root.transpose(0, 2, 1)))
        return tuple(out)

    return replace(case, stretches=louder(case.stretches), unseen=louder(case.unseen), floor_known=False)
