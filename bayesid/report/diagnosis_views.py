"""What the pictures of a diagnosis show: residuals by channel, time and frequency, signals, and parts of the noise floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.locate import BANDS, by_band, by_window, places_looked_at
from bayesid.diagnosis.noise import pose_noise
from bayesid.diagnosis.separation import Visible, visible
from bayesid.diagnosis.spectra import SpectralSegment, sensor_noise
from bayesid.diagnosis.validation import residual_spectra
from bayesid.results.diagnosis import Diagnosis

#: Recordings in the picture of residuals, and channels in the picture of signals.
_PANELS, _CHANNELS = 4, 3
#: Signals are shown below one of these frequencies, the one at which the disagreement stands out most [Hz].
_CUTS = (1.0, 3.0, 10.0)


@dataclass(frozen=True, eq=False)
class ResidualPanel:
    """Residuals of one recording in units of the noise, before and after."""

    #: Which recording, and whether it took part in no fit.
    title: str
    unseen: bool
    #: For each gap-free segment: edges of the windows (w + 1,) [s], root mean squares before and after (w, c, 2), and whether
    #: they are significant (w, c, 2).
    pieces: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    bands: np.ndarray  # root mean squares by band (b, c, 2)


@dataclass(frozen=True, eq=False)
class SignalView:
    """What was measured in one channel, and measured less predicted before and after."""

    #: What is shown.
    channel: str
    unit: str
    motion: str
    #: (N,) [s], (N,) and (N, 2).
    times: np.ndarray
    measured: np.ndarray
    values: np.ndarray
    noise: float  # standard deviation that sensor and encoders leave in the same band
    below: float  # highest frequency shown [Hz]


@dataclass(frozen=True, eq=False)
class Noise:
    """Where the noise floor of a channel comes from."""

    #: What is shown.
    channel: str
    unit: str
    sample: float  # standard deviation of the sensor's noise in one sample
    #: What of it, and of the encoders' noise in the prediction, falls into the band that is compared.
    sensor: float
    encoders: float


@dataclass(frozen=True, eq=False)
class Views:
    """All that the report shows beside the diagnosis itself."""

    #: What each picture shows, see their classes.
    panels: tuple[ResidualPanel, ...]
    signals: tuple[SignalView, ...]
    noise: tuple[Noise, ...]
    visible: tuple[Visible, ...]
    bands: tuple[tuple[float, float], ...]  # their limits [Hz]
    changed: bool  # whether a model other than the user's was fitted, so that there is an "after"


def diagnosis_views(diagnosis: Diagnosis) -> Views:
    """Evaluate both models on all recordings."""
    data, s = diagnosis.data, diagnosis.search
    sides = []
    for segments in (data.segments, data.unseen):
        sides.append([residual_spectra(data, segments, fit) for fit in (s.base, s.best)] if segments else [[], []])
    pairs = [
        (segment, np.stack([before, after], axis=-1), unseen)
        for segments, (b, a), unseen in zip((data.segments, data.unseen), sides, (False, True), strict=True)
        for segment, before, after in zip(segments, b, a, strict=True)
    ]  # fmt: skip
    judged = [p for p in pairs if p[2]] or pairs
    return Views(
        panels=_panels(pairs, diagnosis.noise_level),
        signals=_signals(diagnosis, judged),
        noise=_noise(diagnosis),
        visible=() if s.library is None else visible(s.library),
        bands=BANDS,
        changed=s.best is not s.base and len(s.best.terms) > len(s.base.terms),
    )


def _panels(pairs: list[tuple[SpectralSegment, np.ndarray, bool]], level: float) -> tuple[ResidualPanel, ...]:
    """Moving recordings first, fitted ones before unseen ones; then the runs at rest."""
    looked = {unseen: places_looked_at([s for s, _, u in pairs if u == unseen]) for unseen in (False, True)}
    groups: dict[tuple[str, bool], list[tuple[SpectralSegment, np.ndarray, bool]]] = {}
    for pair in pairs:
        groups.setdefault((pair[0].motion, pair[0].still), []).append(pair)
    order = sorted(groups, key=lambda k: (k[1], groups[k][0][2]))
    moving = [k for k in order if not k[1]]
    fitted, unseen = ([k for k in moving if groups[k][0][2] == u] for u in (False, True))
    room = max(_PANELS - 1 - min(len(unseen), 2), 1)
    chosen = [*fitted[:room], *unseen[:2]]
    chosen += [k for k in order if k not in chosen and not groups[k][0][2]][: _PANELS - len(chosen)]
    out = []
    for motion, still in chosen:
        group = groups[motion, still]
        pieces = []
        for s, w, u in group:
            sides = [by_window(s, w[..., k], 1.0, looked[u]) for k in (0, 1)]
            marks = [by_window(s, w[..., k], level, looked[u])[3] < s.settings.level for k in (0, 1)]
            at = sides[0][0]
            edges = at + 0.5 if s.apart else s.times[np.minimum(at, len(s.times) - 1)]  # poses are counted from one
            ratio = np.stack([np.sqrt(energy / freedom) for _, energy, freedom, _ in sides], axis=-1)
            pieces.append((edges, ratio, np.stack(marks, axis=-1)))
        counts = np.array([len(w) for _, w, _ in group], float)
        squares = np.stack([np.stack([by_band(s, w[..., k]) for k in (0, 1)], axis=-1) ** 2 for s, w, _ in group])
        bands = np.sqrt(np.average(squares, axis=0, weights=counts))
        title = f"{motion}, the run at rest" if still and not group[0][0].apart else motion
        out.append(ResidualPanel(title, group[0][2], tuple(pieces), bands))
    return tuple(out)


def _signals(diagnosis: Diagnosis, judged: list[tuple[SpectralSegment, np.ndarray, bool]]) -> tuple[SignalView, ...]:
    """The channels that disagreed most, on the recording on which they did."""
    channels = diagnosis.data.channels
    moving = [p for p in judged if not p[0].still] or judged
    energy = np.sum([np.sum(w[..., 0] ** 2, axis=0) for _, w, _ in judged], axis=0)
    worst = np.argsort(-energy)[:_CHANNELS]
    # One recording for all of them: the one with the largest residual.
    s, w, _ = max(moving, key=lambda p: float(np.mean(p[1][..., 0] ** 2)))
    root = np.linalg.cholesky(s.covariance)
    left = np.matmul(root, w)  # the residual's coefficients in the channels' units (K, c, 2)
    out = []
    for c in np.sort(worst):
        variance = s.covariance[:, c, c]
        cuts = [f for f in _CUTS if f <= s.frequencies[-1] * 1.05] or [float(s.frequencies[-1])]
        inside = {f: s.frequencies <= f for f in cuts}
        below = max(cuts, key=lambda f: float(np.sum(left[inside[f], c, 0] ** 2) / np.sum(variance[inside[f]])))
        kept = np.where(inside[below][:, None], np.column_stack([s.measured_readings[:, c], left[:, c]]), 0.0)
        course = s.samples(kept)
        noise = float(np.sqrt(np.sum(variance[inside[below]]) / len(s.times)))
        out.append(
            SignalView(
                channels.names[c], channels.units[c], s.motion, s.times + s.apart, course[:, 0], course[:, 1:], noise, below
            )
        )
    return tuple(out)


def _noise(diagnosis: Diagnosis) -> tuple[Noise, ...]:
    data = diagnosis.data
    moving = [s for s in (*data.segments, *data.unseen) if not s.still or s.apart]
    sample = pose_noise(data) if moving[0].apart else sensor_noise(moving)
    count = sum(len(s.times) for s in moving)
    band = np.sum([len(s.frequencies) * np.mean(s.weight(s.times) ** 2, axis=0) for s in moving], axis=0) / count
    total = np.sum([np.einsum("kcc->c", s.covariance) for s in moving], axis=0) / count
    sensor = sample**2 * band
    return tuple(
        Noise(name, unit, float(sample[c]), float(np.sqrt(sensor[c])), float(np.sqrt(max(total[c] - sensor[c], 0.0))))
        for c, (name, unit) in enumerate(zip(data.channels.names, data.channels.units, strict=True))
    )
