"""Whitened rows of residuals and of the derivatives of models, over segments of recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.diagnosis.data import DiagnosisData, active_terms
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import Term, columns
from bayesid.effects.exact import effect_derivatives_at_joint
from bayesid.effects.families import EncoderEffect, JointDelayEffect, JointGainEffect, needs_no_load
from bayesid.effects.model import Model


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
    effect, channels = term.effect, {joint: channel for channel, joint in segment.torque_channels}
    if needs_no_load(effect) and effect.joint in channels:
        # What another joint's encoder or drive does is nothing to this joint's torque.
        reads, here = (EncoderEffect, JointDelayEffect, JointGainEffect), (None, effect.joint)
        beside = tuple(t for t in terms if isinstance(t.effect, reads) and t.effect.joint in here)
        live = np.arange(len(data.channels)) == channels[effect.joint]

        def made() -> np.ndarray:
            model = Model.of(data.robot, data.channels, segment.scene, data.links, beside)
            with np.errstate(all="ignore"):  # as above
                return segment.spectrum(effect_derivatives_at_joint(model, effect, term.values)[:, None], live)

        key = effect, term.values if effect.shape else (), beside
        return segment.white_rows(live, segment.kept.get(key, made))
    with np.errstate(all="ignore"):  # as above
        found = columns(data.robot, data.channels, segment.scene, links, terms, effect, term.values)
    return segment.white(found)


def model_rows(data: DiagnosisData, segments: Sequence[Segment], links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
    """Whitened derivatives with respect to all free parameters of a model's effects (rows, k)."""
    parts = [np.zeros((sum(s.shape[0] * s.shape[1] for s in segments), 0))]
    parts += [
        term_rows(data, segments, links, tuple(x for x in terms if x is not t), t) for t in terms if not data.fixed(t)
    ]  # fmt: skip
    return np.hstack(parts)
