"""Contacts: when something pushed, and where it may have."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesid.diagnosis.data import Episode, term_rows
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.projector import NuisanceProjector
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import ExternalContact, Term
from bayesid.effects.loads import CONTACT_RAMP, ContactAnywhere

#: Columns this much shorter than the longest say nothing.
DEAD = 1e-6


def windows(segment: SpectralSegment) -> list[tuple[float, float]]:
    """Windows tried in a segment, (start, end) [s]; starts are a quarter of their length apart."""
    first, last = segment.times[0], segment.times[-1]
    out = []
    for length in ExternalContact.windows:
        if length < 0.8 * (last - first):
            out += [(t, t + length) for t in np.arange(first, last - length, 0.25 * length)]
    return out


def pulse(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """A contact's course (N,): 0 outside, 1 inside, ramps in between."""
    ramp = min(CONTACT_RAMP, 0.5 * (end - start))
    return np.clip(np.minimum(times - start, end - times) / ramp, 0.0, 1.0)


def is_excuse(best: Fit, index: int) -> bool:
    """Whether a contact found is no more than an excuse for something else; False for all that is no contact.

    It does not act in held-out motions, so nothing there can deny it. So it must end inside the recording, and last for no more
    than half of the motion, longer than not; what lasts longer has to be an effect that is there in other motions, too. Nor is a
    moment in which it does not even come up a contact: force and duration are one number then, and friction that reverses has it.
    """
    term = best.terms[index]
    if not (isinstance(term, Episode) and isinstance(term.effect, ExternalContact)):
        return False
    start, end = term.values[:2]
    times = np.concatenate([s.times for s in best.projector.data.segments if s.motion == term.motion and not s.still])
    first, last = float(times.min()), float(times.max())
    return end > last - 0.5 * CONTACT_RAMP or not CONTACT_RAMP < end - start < 0.5 * (last - first)


def contact_terms(projector: NuisanceProjector, fit: Fit, left: np.ndarray) -> Iterator[tuple[list[Term], float]]:
    """Contacts on each link, with the window in which a constant load would explain most of the residual (rows,)."""
    data = projector.data
    best: tuple[float, float, float, str] | None = None
    at = 0
    for s in data.segments:
        count = s.shape[0] * s.shape[1]
        mine, at = left[at : at + count].reshape(s.shape), at + count
        if s.still:
            continue
        tried = windows(s)
        if not tried:
            continue
        course = np.stack([pulse(s.trajectory.times, a, b) for a, b in tried], axis=1)
        spectrum = s.course(course)  # (K, windows)
        whitener = s.whitener
        score = np.einsum("kw,kdc,kd->wc", spectrum, whitener, mine, optimize=True)
        gram = np.einsum("kw,kcd->wcd", spectrum**2, np.matmul(whitener.transpose(0, 2, 1), whitener), optimize=True)
        gain = np.einsum("wc,wc->w", score, np.linalg.solve(gram, score[:, :, None])[:, :, 0])
        top = int(np.argmax(gain))
        if best is None or gain[top] > best[0]:
            best = (float(gain[top]), *tried[top], s.motion)
    if best is None:
        return
    _, start, end, motion = best
    residual = np.concatenate([left, np.zeros(projector.size)])

    for effect in data.places(ExternalContact.name):
        if effect.where == "robot":
            continue
        # With the force f at the point r the reading is linear in f and in the products r f'.
        anywhere = Episode(ContactAnywhere(effect.where, effect.joint), (start, end, *(0.0,) * 12), motion)
        rows = projector.columns(term_rows(data, data.segments, fit.links, fit.terms, anywhere)[:, 2:])
        length = np.linalg.norm(rows, axis=0)
        length = np.where(length > DEAD * length.max(), length, np.inf)
        plain, *_ = np.linalg.lstsq(rows[:, :3] / length[:3], residual, rcond=1e-6)
        both, *_ = np.linalg.lstsq(rows / length, residual, rcond=1e-3)
        gain = float(np.sum((rows[:, :3] / length[:3] @ plain) ** 2))
        force, products = both[:3] / length[:3], (both[3:] / length[3:]).reshape(3, 3)
        point = np.clip(force @ products / max(force @ force, 1e-12), -0.5, 0.5)
        starts = ((*(plain / length[:3]), 0.0, 0.0, 0.0), (*force, *point))
        yield [Episode(effect, (start, end, *(float(v) for v in s)), motion) for s in starts], gain
