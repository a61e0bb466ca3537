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


def between_turns(whole: DiagnosisData, s: Search, named: bool, seed: int) -> DiagnosisData | None:
    """The recordings between the times at which joints turn, if what a search says is of these times; else None.

    It is where the effects found are ``named`` and most of the evidence for one of them, which is no dry friction itself, comes
    from there; and where they are not, if most of what they leave above the noise is there.
    """
    if whole.channel == "wrench" or whole.poses or not whole.floor_known:
        return None
    parts = (_between(whole.segments), _between(whole.unseen))
    between = with_noise_of(replace(whole, segments=parts[0], unseen=parts[1]), whole.links, whole.terms, seed)
    terms, share = s.best.terms, 1.0 - whole.settings.most
    every, some = (fit(make_projector(data, terms), terms, s.best) for data in (whole, between))
    if not named:
        chance = whole.settings.detected * np.sqrt(2.0 / every.projector.rows)
        return between if _excess(some) < share * _excess(every) and _excess(every) > chance else None
    known = len(s.base.terms)
    wet = [k for k, t in enumerate(terms) if k >= known and not t.effect.reverses_at_once]
    return between if any(_evidence(some, k) < share * _evidence(every, k) for k in wet) else None


def _between(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
    return tuple(replace(s, between_turns=True, covariance=np.zeros(0)) for s in segments)


def _excess(fitted: Fit) -> float:
    """Mean square of whitened residuals above that of noise."""
    return fitted.chi2 / fitted.projector.rows - 1.0


def _evidence(fitted: Fit, index: int) -> float:
    """Log evidence for one of the terms beside the others."""
    others = tuple(t for k, t in enumerate(fitted.terms) if k != index)
    return fitted.score - fit(fitted.projector, others, fitted).score
