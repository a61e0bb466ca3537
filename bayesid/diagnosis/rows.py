"""Whitened rows of residuals and of the derivatives of models, over segments of recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.diagnosis.data import DiagnosisData, active_terms
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import Term, columns
from bayesid.effects.families import EncoderEffect, JointDelayEffect, JointGainEffect, JointTorqueEffect


def residual_rows(data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, offset: np.ndarray, terms: Sequence[Term]):
    """Whitened rows of what was measured less what is predicted (rows,)."""
    out = []
    for s in segments:
        measured = s.measured_readings - s.measured_ones * offset
        with np.errstate(all="ignore"):  # a very compliant mount diverges; its fit is then refused
            out.append(s.whiten(measured - s.spectrum(data.predict(s, links, terms))).ravel())
    return np.concatenate(out)


def term_rows(
    data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, terms: Sequence[Term], term: Term
) -> np.ndarray:
    """Whitened derivatives of the readings with respect to a term's parameters beside other terms (rows, k)."""
    parts = []
    for s in segments:
        if active_terms(s, [term]):
            parts.append(_white_columns(data, s, links, active_terms(s, terms), term))
        else:
            parts.append(np.zeros((s.shape[0] * s.shape[1], len(term.values))))
    return np.vstack(parts)


def _white_columns(data: DiagnosisData, segment: Segment, links: np.ndarray, terms: tuple[Term, ...], term: Term) -> np.ndarray:
    """Rows of one segment (rows, k); those of what the joint's motion alone says are transformed once."""
    effect = term.effect

    def made() -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(all="ignore"):  # as above
            found = columns(data.robot, data.channels, segment.scene, links, terms, effect, term.values)
        return segment.live_spectrum(found)

    if not isinstance(effect, JointTorqueEffect) or effect.uses_load:
        return segment.white_rows(*made())
    reads = (EncoderEffect, JointDelayEffect, JointGainEffect)
    # What another joint's encoder or drive does is nothing to this joint's torque.
    here = (None, effect.joint)
    beside = tuple(t for t in terms if isinstance(t.effect, reads) and t.effect.joint in here)
    return segment.white_rows(*segment.kept.get((effect, term.values if effect.shape else (), beside), made))


def model_rows(data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
    """Whitened derivatives with respect to all free parameters of a model's effects (rows, k)."""
    parts = [np.zeros((sum(s.shape[0] * s.shape[1] for s in segments), 0))]
    parts += [
        term_rows(data, segments, links, tuple(x for x in terms if x is not t), t) for t in terms if not data.fixed(t)
    ]  # fmt: skip
    return np.hstack(parts)
