"""Where model and data disagree: in which channel, when, at which frequencies and with which joint's motion.

Below the compared band's end the model's residual is looked at, in windows of one and of a quarter second; above it the
readings themselves (see `bayesid.diagnosis.impulse_events`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct
from scipy.stats import chi2

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.impulse_events import Event, short_events, unlikely
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.signals.arrays import runs

#: Bands told apart [Hz].
BANDS = ((0.0, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0))
#: Into how many parts a window is divided.
_PARTS = 4
#: Disagreements listed, and as many short events.
LISTED = 8


@dataclass(frozen=True)
class Disagreement:
    """A channel and time in which the residual is larger than noise."""

    #: Where.
    channel: str
    motion: str
    #: When [s].
    start: float
    end: float
    band_hz: tuple[float, float]  # the band with the largest excess there
    joint: str | None  # the joint whose motion goes best with it, or None
    ratio: float  # root mean square over the noise's
    p_value: float  # probability of as much by chance in one of all places looked at
    still: bool = False  # whether it is in the motion's run at rest
    #: Whether it is a short event above the compared band, in the readings themselves, and when that is loudest [s].
    event: bool = False
    peak: float = float("nan")
    tap: bool = False  # whether that looks like a tap: a broad band, over within 0.1 s
    unseen: bool = False  # whether the motion took no part in the fit

    @property
    def looks_like(self) -> str | None:
        """``tap`` or ``short event``, or None."""
        return "tap" if self.tap else "short event" if self.event else None

    def to_dict(self) -> dict:
        """An entry of ``where``."""
        return {
            "channel": self.channel, "motion": self.motion, "start": self.start, "end": self.end, "joint": self.joint,
            "band_hz": list(self.band_hz), "times_noise": self.ratio, "p_value": self.p_value,
            "at_rest": self.still, "looks_like": self.looks_like,
        }  # fmt: skip


def locate(
    data: DiagnosisData, segments: Sequence[SpectralSegment], white: Sequence[np.ndarray], dispersion: float
) -> tuple[Disagreement, ...]:
    """Channels and times with more residual than noise explains, and short events of all motions.

    Coefficients are white, so the energy of a window of a channel is close to chi-squared with as many degrees of freedom as
    coefficients fall to its share, whatever the colour of the noise was; Bonferroni's bound covers all windows looked at, long
    and short, which are then merged. Encoders' counts are no steady noise: for moments they err more than on average. A short
    window alone must therefore stand out of the other short ones, too.

    ``white`` are the segments' whitened residuals (K, c), and ``dispersion`` is the mean square of what counts as noise.
    """
    looked = places_looked_at(segments)
    found = []
    for s, w in zip(segments, white, strict=True):
        settings = s.settings
        p = by_window(s, w, dispersion, looked)[3]
        edges, fine, share, chance = by_window(s, w, dispersion, looked, _PARTS)
        alone = np.maximum(chance, np.minimum(unlikely(fine / share, share, settings) * looked, 1.0))
        for c in range(w.shape[1]):
            level, parts = settings.level, _PARTS
            flags = alone[:, c] < level
            flags |= _placed(p[:, c] < level, chance[:, c] < level, (fine - share)[:, c], settings)
            for first, last in runs(flags, parts):
                span = slice(edges[first], edges[last])
                course = s.samples(w[:, c])[span]
                ratio = float(np.sqrt(fine[first:last, c].sum() / share[first:last, c].sum()))
                least = min(p[first // parts : (last - 1) // parts + 1, c].min(), alone[first:last, c].min())
                found.append(
                    Disagreement(
                        data.channels.names[c], s.motion, float(s.times[edges[first]]), float(s.times[edges[last] - 1]),
                        _strongest_band(s, course, span), _joint(data, s, course, span), ratio, float(least), s.still,
                    )
                )  # fmt: skip
    strongest = sorted(found, key=_strength)[:LISTED]
    return tuple(sorted([*strongest, *_events(data)], key=_strength))


def _strength(d: Disagreement) -> float:
    """Key that sorts the strongest first."""
    return -d.ratio * float(np.sqrt(d.end - d.start))


def _events(data: DiagnosisData) -> list[Disagreement]:
    """The strongest short events of fitted and unseen motions."""
    segments = (*data.segments, *data.unseen)
    found = []
    for k, (s, events) in enumerate(zip(segments, short_events(segments, data.settings.level), strict=True)):
        found += [_event(data, s, e, unseen=k >= len(data.segments)) for e in events]
    return sorted(found, key=_strength)[:LISTED]


def _event(data: DiagnosisData, segment: SpectralSegment, event: Event, *, unseen: bool) -> Disagreement:
    band = (float(np.round(event.band[0], 3)), float(np.round(event.band[1], 3)))
    return Disagreement(
        data.channels.names[event.channel], segment.motion, event.start, event.end, band, None, event.ratio, event.p_value,
        event=True, peak=event.peak, tap=event.tap, unseen=unseen,
    )  # fmt: skip


def _placed(long: np.ndarray, short: np.ndarray, excess: np.ndarray, settings: Settings) -> np.ndarray:
    """Parts of the windows that disagree (parts,): those that hold nearly all of a window's excess (parts,), or all of it."""
    parts = _PARTS
    kept = short & np.repeat(long, parts)
    inside = np.where(kept, excess, 0.0).reshape(-1, parts).sum(axis=1)
    return kept | np.repeat(long & (inside < settings.nearly_all * excess.reshape(-1, parts).sum(axis=1)), parts)


def places_looked_at(segments: Sequence[SpectralSegment]) -> int:
    """Windows of all channels, and their parts."""
    return sum((1 + _PARTS) * _windows(s) * s.shape[1] for s in segments)


def by_window(
    segment: SpectralSegment, white: np.ndarray, dispersion: float, looked: int, parts: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Energy of whitened coefficients (K, c) by windows of one second, each divided into ``parts``.

    Returns the windows' edges in samples (w + 1,), energy over noise and its expectation (w, c), and the chance of as much in
    any of the places looked at (w, c). Where a recording fades in and out, or a joint rests, less is expected, but never less
    than one.
    """
    count = _windows(segment)
    edges = _edges(len(segment.times), count, parts)
    energy = np.add.reduceat(segment.samples(white) ** 2, edges[:-1], axis=0) / dispersion
    weight = np.add.reduceat(segment.weight(segment.times) ** 2, edges[:-1], axis=0)
    freedom = np.maximum(len(white) * weight / np.maximum(weight.sum(axis=0), 1e-300), 1.0)
    return edges, energy, freedom, np.minimum(chi2.sf(energy, freedom) * looked, 1.0)


def _edges(samples: int, count: int, parts: int) -> np.ndarray:
    """Edges of windows in samples, those of the parts among them."""
    return np.arange(count * parts + 1) * samples // (count * parts)


def by_band(segment: SpectralSegment, white: np.ndarray) -> np.ndarray:
    """Root mean square of whitened coefficients in each of `BANDS` (b, c); nan where there are none."""
    out = np.full((len(BANDS), white.shape[1]), np.nan)
    for k, (low, high) in enumerate(BANDS):
        inside = (segment.frequencies >= low) & (segment.frequencies < high)
        if inside.any():
            out[k] = np.sqrt(np.mean(white[inside] ** 2, axis=0))
    return out


def _windows(segment: SpectralSegment) -> int:
    return max(int((segment.times[-1] - segment.times[0]) / segment.settings.window), 1)


def _strongest_band(segment: SpectralSegment, course: np.ndarray, span: slice) -> tuple[float, float]:
    """The band with the largest root mean square of a whitened residual (m,) in a part of a recording."""
    alone = np.zeros((len(segment.times), 1))
    alone[span, 0] = course
    coefficients = np.asarray(dct(alone, axis=0, norm="ortho"))[: len(segment.frequencies)]
    return BANDS[int(np.argmax(np.nan_to_num(by_band(segment, coefficients)[:, 0])))]


def _joint(data: DiagnosisData, segment: SpectralSegment, residual: np.ndarray, span: slice) -> str | None:
    """The joint whose motion explains most of a residual by a few smooth functions of it, if that is half."""
    if len(residual) < 20:
        return None
    at = segment.times[span]
    shares = []
    for j in range(data.robot.n):
        q, v, a = (
            np.interp(at, segment.trajectory.times, part[:, j])
            for part in (segment.trajectory.positions, segment.trajectory.velocities, segment.trajectory.accelerations)
        )
        if np.ptp(q) < 1e-3:
            shares.append(0.0)
            continue
        columns = np.stack([np.ones_like(q), q, q**2, np.cos(q), v, np.tanh(v / 0.05), np.abs(v) * v, a], axis=1)
        columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
        shares.append(1.0 - np.sum(left**2) / max(np.sum(residual**2), 1e-300))
    best = int(np.argmax(shares))
    return f"joint{best + 1}" if shares[best] > 0.5 else None
