"""A search as it is shown where something stays unexplained: with white noise of the power that was measured.

Beside what no model explains, effects are proven with every frequency counted alike (`bayesid.diagnosis.held_out`). Noise that is
measured frequency by frequency would then tell another story: where readings were filtered before they were recorded next to
none is left at some frequencies, and a model that is better everywhere else seems worse. So each channel keeps its noise's mean
square over the band, as white noise, and "times the noise" keeps its meaning.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.diagnosis.candidates import make_library
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.fit import begin, finish, fit
from bayesid.diagnosis.held_out import scaled
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.search import Search


def with_white_noise(s: Search) -> Search:
    """The same effects with the same values and covariance, and the user's model fitted anew.

    Parameters
    ----------
    s
        With the proven effects as its best model.
    """
    data = scaled(s.projector.data, mean_noise(s.projector.data))
    users, found = s.base.terms, s.best.terms
    base, projector = fit(make_projector(data, users), users, s.base), make_projector(data, found)
    best = replace(finish(begin(projector, found, s.best)), covariance=s.best.covariance)
    return replace(s, projector=projector, base=base, best=best, library=make_library(projector, base, best))


def mean_noise(data: DiagnosisData) -> np.ndarray:
    """Mean square of every channel's noise over the frequencies compared, on the fitted motions (c,)."""
    powers = [np.diagonal(s.covariance, axis1=1, axis2=2) for s in data.segments]
    return np.asarray(np.concatenate(powers).mean(axis=0))


def noise_share(data: DiagnosisData, square: np.ndarray, channels: np.ndarray | bool = True) -> float:
    """Mean square of the noise in units of what the user's model leaves (c,), no more than that; 0 where it is unknown.

    Of some channels (c,), where they are given.
    """
    if not data.floor_known:
        return 0.0
    ratio = [(np.diagonal(s.covariance, axis1=1, axis2=2) / square)[:, s.alive & channels].ravel() for s in data.segments]
    return min(float(np.concatenate(ratio).mean()), 1.0)
