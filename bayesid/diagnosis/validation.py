"""Held-out validation on motions that were never fitted: the gap before and after, beside what noise alone would leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.data import DiagnosisData, model_rows
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.gap import lower_end, share_of_gap
from bayesid.diagnosis.projector import NuisanceProjector, offset_columns
from bayesid.diagnosis.spectra import SpectralSegment


@dataclass(frozen=True)
class Gap:
    """Root mean square of whitened residuals on validation motions; 1 is sensor and encoder noise alone."""

    #: With the user's model and with the effects found.
    before: float
    after: float
    floor: float  # what is expected of a complete model: noise, and the uncertainty of the fitted parameters on another motion
    #: ``(before^2 - after^2) / (before^2 - floor^2)``, and the lower end of its one-sided 95 % interval, by bootstrap over
    #: blocks of time. NaN where there was no gap: ``before`` is no more than the floor.
    closed: float
    closed_low: float
    #: Sum of squares of what the effects change on these motions, in units of the noise: how well they could confirm them.
    difference: float
    motions: tuple[str, ...]  # the motions compared

    def to_dict(self) -> dict:
        """The entry ``gap`` of ``diagnosis.json``."""
        numbers = {k: float(getattr(self, k)) for k in ("before", "after", "floor", "closed", "closed_low")}
        return {
            "metric": "whitened_rms on validation motions",
            **{k: v if np.isfinite(v) else None for k, v in numbers.items()},
            "motions": list(self.motions),
        }


def residual_spectra(data: DiagnosisData, segments: Sequence[SpectralSegment], fit: Fit) -> list[np.ndarray]:
    """Whitened coefficients (K, c) of every segment; a constant offset is taken out anew, a sensor may have been zeroed."""
    white = [s.whiten(s.measured_readings - s.spectrum(data.predict(s, fit.links, fit.terms))) for s in segments]
    rows = without_offset(data, segments, np.concatenate([w.ravel() for w in white]))
    parts = np.split(rows, np.cumsum([w.size for w in white])[:-1])
    return [part.reshape(w.shape) for part, w in zip(parts, white, strict=True)]


def without_offset(data: DiagnosisData, segments: Sequence[SpectralSegment], rows: np.ndarray) -> np.ndarray:
    """Whitened rows (rows, ...) less what a constant offset of every motion explains, where a static run allows for one."""
    if not (data.offset_free and data.channel == "wrench"):
        return rows
    out = rows.copy()
    edges = np.cumsum([0, *(s.shape[0] * s.shape[1] for s in segments)])
    for motion in dict.fromkeys(s.motion for s in segments):
        mine = [k for k, s in enumerate(segments) if s.motion == motion]
        at = np.concatenate([np.arange(edges[k], edges[k + 1]) for k in mine])
        q, _ = np.linalg.qr(np.vstack([offset_columns(segments[k]) for k in mine]))
        out[at] -= q @ (q.T @ out[at])
    return out


def validate(
    projector: NuisanceProjector, base: Fit, best: Fit, dispersion: float, seed: int, complete: bool = True
) -> Gap | None:
    """Compare both models on the validation motions; None where there are none.

    Where the effects found are not all that is missing (``complete`` false), what they could not determine is no part of the
    floor, and no floor lies above what they leave.
    """
    data = projector.data
    if not data.unseen:
        return None
    before, after = (residual_spectra(data, data.unseen, f) for f in (base, best))
    total = sum(s.count for s in data.unseen)
    floor2, bare2 = (1.0 + _parameter_share(projector, f, dispersion) / total for f in (best, base))
    whole = [float(sum(np.sum(w**2) for w in part)) / total for part in (before, after)]
    if not complete:
        floor2 = min(bare2, *whole)
    energy = np.concatenate([_by_blocks(s, b, a) for s, b, a in zip(data.unseen, before, after, strict=True)])
    low = lower_end(energy, lambda x: share_of_gap(x[:, 0] - x[:, 1], x[:, 0], floor2 * x[:, 2]), data.settings, seed)
    room = whole[0] > floor2  # there is a gap to close
    return Gap(
        before=np.sqrt(whole[0]), after=np.sqrt(whole[1]), floor=np.sqrt(floor2),
        closed=float(share_of_gap(whole[0] - whole[1], whole[0], floor2)) if room else np.nan,
        closed_low=float(low) if room else np.nan,
        difference=float(sum(np.sum((b - a) ** 2) for b, a in zip(before, after, strict=True))),
        motions=tuple(dict.fromkeys(s.motion for s in data.unseen)),
    )  # fmt: skip


def _by_blocks(segment: SpectralSegment, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Energies before and after and number of coefficients, by block of time (blocks, 3)."""
    energies = [np.sum(segment.samples(w) ** 2, axis=1) for w in (before, after)]
    count = max(int((segment.times[-1] - segment.times[0]) / segment.settings.window), 1)
    edges = np.linspace(0, len(energies[0]), count + 1).astype(int)
    sums = [np.add.reduceat(e, edges[:-1]) for e in energies]
    return np.stack([*sums, np.full(count, segment.count / count)], axis=1)


def _parameter_share(projector: NuisanceProjector, best: Fit, dispersion: float) -> float:
    """Expected sum of squares that the uncertainty of links and effects adds to whitened residuals of other motions."""
    data = projector.data
    effects = without_offset(data, data.unseen, model_rows(data, data.unseen, best.links, best.terms))
    share = 0.0
    if projector.root.shape[1]:
        links = np.vstack([s.white(data.link_columns(s, best.terms)) @ projector.root for s in data.unseen])
        links = without_offset(data, data.unseen, links)
        inverse = np.linalg.inv(projector.r)[: projector.root.shape[1]]
        share += float(np.sum((links @ inverse) ** 2))
        # Where an effect's estimate is off, the links have made up for it on the fitted motions.
        effects = effects - links @ (inverse @ (projector.q[: projector.length].T @ best.jacobian))
    share += float(np.einsum("ij,jk,ik->", effects, best.covariance, effects))
    return dispersion * share
