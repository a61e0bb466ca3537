"""Torques where joints turn: friction may stick there and hold anything, and what a model leaves there is no effect.

A joint that turns may halt for a few hundredths of a second, while its drive goes from one breakaway torque to the other. Its
acceleration jumps as its friction does, and smoothed positions say neither when nor how far. Where friction slips at once the
model predicts all of that, and it is evidence; so a search leaves these times out only after one that did not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.fit import Fit, fit
from bayesid.diagnosis.noise import with_noise_of
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.spectra import SpectralSegment


def between_turns(whole: DiagnosisData, s: Search, seed: int) -> DiagnosisData | None:
    """The recordings between the times at which joints turn, if most of what a search leaves above the noise is there."""
    if whole.channel == "wrench" or whole.poses or not whole.floor_known:
        return None
    parts = (_between(whole.segments), _between(whole.unseen))
    between = with_noise_of(replace(whole, segments=parts[0], unseen=parts[1]), whole.links, whole.terms, seed)
    terms = s.best.terms
    every, some = (fit(make_projector(data, terms), terms, s.best) for data in (whole, between))
    chance = whole.settings.detected * np.sqrt(2.0 / every.projector.rows)
    left = (1.0 - whole.settings.most) * _excess(every)
    return between if _excess(some) < left and _excess(every) > chance else None


def _between(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
    return tuple(replace(s, between_turns=True, covariance=np.zeros(0)) for s in segments)


def _excess(fitted: Fit) -> float:
    """Mean square of whitened residuals above that of noise."""
    return fitted.chi2 / fitted.projector.rows - 1.0
