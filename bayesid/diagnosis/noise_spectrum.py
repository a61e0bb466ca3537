"""Noise measured where a recording says the same thing twice: a motion repeated, or a robot standing still.

Between repeats of a motion the model's error is the same and cancels; what is left of the readings is noise, at all
frequencies, the low ones included that a filter before the recording leaves coloured. With e = reading - prediction
and a lag P the difference ``d(t) = e(t + P) - e(t)`` has the spectrum

    S_d(f) = 2 (1 - cos(2 pi f P)) S(f),   2 S(f) on average over a band wider than 1 / P.

The prediction takes out how far the motion itself failed to repeat, and brings in the encoders' errors. Those repeat
with the positions, but not entirely; the share that does not is found by the same difference of simulated roundings,
and subtracted. At rest the readings about their linear trend have the spectrum S(f) itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import dct, idct
from scipy.interpolate import CubicSpline

from bayesid.diagnosis.encoders import Encoders
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.spectra import SpectralSegment, taper
from bayesid.signals.repeats import RATE, Course, Repeat, find_repeats

#: Of a power less the encoders' share no less than this is left: a difference of two estimates may be negative.
_LEAST = 0.05


@dataclass(frozen=True, eq=False)
class Piece:
    """Samples of nothing but noise."""

    #: (N,) [s] and (N, c), without trend.
    times: np.ndarray
    values: np.ndarray
    weight: np.ndarray  # (N, c): falls to zero at both ends, and where a joint may stick
    gain: float  # power of the values in units of one reading's noise: 2 for differences, 1 at rest
    lowest: float  # frequency from which on it can be seen [Hz]
    share: float  # degrees of freedom for each coefficient
    known: np.ndarray  # simulated values (k, N, c) of what does not count as the sensor's noise
    settings: Settings  # the thresholds

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return float((self.times[-1] - self.times[0]) / (len(self.times) - 1))

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies of the coefficients in the band (K,) [Hz]."""
        length = len(self.times) * self.step
        return 0.5 / length * np.arange(int(2.0 * length * self.settings.band))

    def power(self, values: np.ndarray) -> np.ndarray:
        """Covariance of one sample of white noise that has the coefficients of values (N, c), by frequency (K, c, c)."""
        z = np.asarray(dct(values * self.weight, axis=0, norm="ortho"))[: len(self.frequencies)]
        norm = self.gain * (self.weight.T @ self.weight) / len(self.weight)
        return z[:, :, None] * z[:, None, :] / np.maximum(norm, 1e-12)


@dataclass(frozen=True, eq=False)
class NoiseSpectrum:
    """Noise of the readings by frequency.

    Noise that is stronger in the band than above it is there whether it is sampled or not: what recordings at different rates
    have in common is its density, the variance of a sample times the time between samples.
    """

    frequencies: np.ndarray  # centres of bands (B,) [Hz]
    density: np.ndarray  # root of the density (B, c), in the channels' units times s^1/2
    correlation: np.ndarray  # across channels (B, c, c)
    freedom: np.ndarray  # degrees of freedom of each band (B,)
    lowest: float  # frequency from which on it was measured [Hz]; below, the lowest band's is taken
    source: str = ""  # ``repeats`` or ``parked``
    #: Of motions that repeat themselves, by name: how far readings repeat may differ from motion to motion.
    own: Mapping[str, NoiseSpectrum] = field(default_factory=dict)

    def of(self, motion: str) -> NoiseSpectrum:
        """A motion's own, or else that of all."""
        return self.own.get(motion, self)

    def enough(self, settings: Settings) -> bool:
        """Whether it was measured where it matters."""
        return self.lowest <= 1.0 / settings.shortest_segment

    def at(self, frequencies: np.ndarray, step: float, least: np.ndarray | None = None) -> np.ndarray:
        """Covariance of one sample of as strong white noise (K, c, c) at frequencies (K,), samples a step apart [s].

        Its standard deviations are no smaller than least (c,).
        """
        x, knots = np.log(np.maximum(frequencies, 1e-3)), np.log(self.frequencies)
        out = np.exp(np.stack([np.interp(x, knots, column) for column in np.log(self.density).T], axis=1)) / np.sqrt(step)
        out = out if least is None else np.maximum(out, least)
        flat = self.correlation.reshape(len(knots), -1).T
        between = np.stack([np.interp(x, knots, column) for column in flat], axis=1).reshape(-1, *self.correlation.shape[1:])
        return out[:, :, None] * between * out[:, None, :]


def course(segment: SpectralSegment) -> Course:
    """Its positions on an even grid (M,), (M, n)."""
    times = np.arange(segment.times[0], segment.times[-1], 1.0 / RATE)
    inner = np.clip(times, segment.trajectory.times[0], segment.trajectory.times[-1])
    return times, CubicSpline(segment.trajectory.times, segment.trajectory.positions)(inner)


def repeat_pieces(
    segments: Sequence[SpectralSegment],
    repeats: Sequence[Repeat],
    predict: Callable[[SpectralSegment], np.ndarray],
    roundings: Mapping[int, Sequence[SpectralSegment]],
) -> list[Piece]:
    """Differences between repeats.

    ``predict`` gives readings of a segment (M, c); ``roundings`` holds every segment several times more as other roundings of
    its encoders would have shown it.
    """
    predicted = {i: predict(segments[i]) for r in repeats for i in (r.first, r.second)}
    wrong = {i: [predict(s) - predicted[i] for s in roundings[i]] for i in predicted}
    out = []
    for r in repeats:
        a, b = segments[r.first], segments[r.second]
        times = a.times[(a.times >= r.start) & (a.times <= r.end)]
        later = times + r.lag
        values = _left(b, predicted[r.second], later) - _left(a, predicted[r.first], times)
        errors = [
            CubicSpline(b.trajectory.times, y)(later) - CubicSpline(a.trajectory.times, x)(times)
            for x, y in zip(wrong[r.first], wrong[r.second], strict=True)
        ]
        edge = taper(times, times, a.trajectory.bandwidth, a.settings)[:, None]
        weight = edge * a.determined(times) * b.determined(later)
        used = a.used(times) & b.used(later)
        known = np.array([_detrended(times, e, used) for e in errors]).reshape(-1, *values.shape)
        length, periodic = r.end - r.start, r.first == r.second
        lowest = max(1.0 / length, 0.25 / r.lag if periodic else 0.0)
        # Neighbouring differences share a period of the motion: their squares are correlated by a quarter.
        share = 1.0 / (1.0 + 0.5 * max(1.0 - r.lag / length, 0.0)) if periodic else 1.0
        kept = share * _kept(edge[:, 0] * used)
        out.append(Piece(times, _detrended(times, values, used), weight, 2.0, lowest, kept, known, a.settings))
    return out


def _left(segment: SpectralSegment, predicted: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Readings less predicted ones at any times within a segment (k, c)."""
    own = segment.readings - CubicSpline(segment.trajectory.times, predicted)(segment.times)
    return CubicSpline(segment.times, own)(times)


def rest_piece(times: np.ndarray, readings: np.ndarray, bandwidth: float, settings: Settings) -> Piece:
    """Readings (N, c) of a robot that stands still."""
    edge = taper(times, times, bandwidth, settings)
    weight = np.repeat(edge[:, None], readings.shape[1], axis=1)
    lowest = 1.5 / (times[-1] - times[0])
    known = np.zeros((0, *readings.shape))
    return Piece(times, _detrended(times, readings), weight, 1.0, lowest, _kept(edge), known, settings)


def _kept(weight: np.ndarray) -> float:
    """Independent coefficients that a weight leaves of each."""
    return float(np.sum(weight**2) ** 2 / (len(weight) * np.sum(weight**4)))


def _detrended(times: np.ndarray, values: np.ndarray, used: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Values (N, c) less the line through those that are used."""
    line = np.vander((times - times.mean()) / np.ptp(times), 2)
    return values - line @ np.linalg.lstsq(line[used], values[used], rcond=None)[0]


def measured_spectrum(pieces: Sequence[Piece]) -> NoiseSpectrum | None:
    """The spectrum of noise pooled over pieces, in bands of enough degrees of freedom; None if there are not enough."""
    parts = []
    for p in pieces:
        seen = p.frequencies >= p.lowest
        total = p.step * p.power(p.values)[seen]
        known = p.step * np.mean([p.power(k)[seen] for k in p.known], axis=0) if len(p.known) else np.zeros_like(total)
        parts.append((p.frequencies[seen], total, known, np.full(seen.sum(), p.share)))
    if not parts:
        return None
    settings = pieces[0].settings
    frequency, total, known, freedom = (np.concatenate(x) for x in zip(*parts, strict=True))
    order = np.argsort(frequency, kind="stable")
    frequency, total, known, freedom = frequency[order], total[order], known[order], freedom[order]
    edges = _bands(freedom, settings)
    if len(edges) < 3:
        return None

    def banded(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1) * freedom[:, None]
        return (np.add.reduceat(flat, edges[:-1], axis=0) / weight[:, None]).reshape(-1, *values.shape[1:])

    weight = np.add.reduceat(freedom, edges[:-1])
    all_, part = banded(total), banded(known)
    if not np.all(np.einsum("bcc->bc", all_) > 0):
        return None
    rest = np.stack([_less(a, k) for a, k in zip(all_, part, strict=True)])
    size = np.sqrt(np.einsum("bcc->bc", rest))
    # As many degrees of freedom as there are make whitened squares larger than 1 by nu / (nu - 2) on average.
    density = size * np.sqrt(weight / (weight - 2.0))[:, None]
    centre = np.exp(banded(np.log(frequency)))
    correlation = rest / (size[:, :, None] * size[:, None, :])
    near = [slice(max(b - 1, 0), b + 2) for b in range(len(weight))]
    sound = [_sound(np.average(correlation[n], axis=0, weights=weight[n]), float(weight[n].sum())) for n in near]
    return NoiseSpectrum(centre, density, np.stack(sound), weight, float(frequency[0]))


def _less(total: np.ndarray, known: np.ndarray) -> np.ndarray:
    """A covariance (c, c) less a part of it, in no direction less than a least share of what it was.

    Encoders' errors come from a few joints and reach all channels: large in some directions, and nothing in others.
    """
    root = np.sqrt(np.diag(total))
    values, vectors = np.linalg.eigh(total / np.outer(root, root))
    half = root[:, None] * vectors * np.sqrt(np.maximum(values, 1e-9))
    inverse = np.linalg.inv(half)
    left, axes = np.linalg.eigh(np.eye(len(total)) - inverse @ known @ inverse.T)
    out = half @ axes * np.sqrt(np.clip(left, _LEAST, 1.0))
    return out @ out.T


def _bands(freedom: np.ndarray, settings: Settings) -> np.ndarray:
    """First indices of bands of enough degrees of freedom; the last is the end."""
    edges, got = [0], 0.0
    for i, f in enumerate(freedom):
        got += f
        if got >= settings.enough:
            edges.append(i + 1)
            got = 0.0
    if len(edges) > 1:
        edges[-1] = len(freedom)
    return np.array(edges)


def _sound(correlation: np.ndarray, freedom: float) -> np.ndarray:
    """A correlation matrix, shrunk by what so many degrees of freedom leave uncertain, without negative eigenvalues."""
    channels = len(correlation)
    out = correlation * freedom / (freedom + channels + 1.0)
    values, vectors = np.linalg.eigh(0.5 * (out + out.T) + np.diag(1.0 - np.diag(out)))
    out = (vectors * np.maximum(values, 0.02)) @ vectors.T
    size = np.sqrt(np.diag(out))
    return out / np.outer(size, size)


def coloured(pieces: Sequence[Piece], white: np.ndarray, channels: Sequence[int]) -> bool:
    """Whether noise in the band is stronger than the white noise (c,) read above it.

    Judged by the median over windows of a second, so that what happened once, a contact, is not taken for noise; without
    frequencies below a hertz, which do not stay within a window. The next hertz comes in gradually, and the last one goes so:
    behind a sharp edge a contact rings through all windows.
    """
    ratios = []
    for p in pieces:
        z = np.zeros(p.values.shape)
        cycles = p.settings.window * np.append(p.frequencies, p.settings.band)  # in a window
        passed = np.sin(0.5 * np.pi * np.clip(np.minimum(cycles - 1.0, cycles[-1] - cycles), 0.0, 1.0))[:-1] ** 2
        high = len(passed)
        z[:high] = passed[:, None] * np.asarray(dct(p.values * p.weight, axis=0, norm="ortho"))[:high]
        signal = np.asarray(idct(z, axis=0, norm="ortho"))
        share = np.sum(passed**2) / len(signal) * p.gain * p.weight**2
        known = np.mean([p.power(k).diagonal(0, 1, 2).mean(axis=0) for k in p.known], axis=0) if len(p.known) else 0.0
        pieces_ = max(int((p.times[-1] - p.times[0]) / p.settings.window), 1)
        edges = np.linspace(0, len(signal), pieces_ + 1).astype(int)[:-1]
        expected = np.add.reduceat(share * (white**2 + known), edges)
        # What has hardly any weight says nothing, and what is beside it rings there.
        seen = np.add.reduceat(p.weight**2, edges) > 0.5 * np.diff([*edges, len(signal)])[:, None]
        ratios.append(np.where(seen, np.add.reduceat(signal**2, edges) / np.maximum(expected, 1e-300), np.nan))
    every = np.concatenate(ratios or [np.zeros((0, len(white)))])
    each = [column[np.isfinite(column)] for column in every.T[list(channels)]]
    return any(len(column) > 0 and np.median(column) > pieces[0].settings.coloured_ratio for column in each)


def _own(segments: Sequence[SpectralSegment], repeats: Sequence[Repeat], pieces: Sequence[Piece]) -> dict[str, NoiseSpectrum]:
    """Spectra of motions that repeat themselves often enough."""
    mine: dict[str, list[Piece]] = {}
    for r, piece in zip(repeats, pieces, strict=True):
        names = {segments[r.first].motion, segments[r.second].motion}
        for name in names if len(names) == 1 else ():
            mine.setdefault(name, []).append(piece)
    found = {name: measured_spectrum(own) for name, own in mine.items()}
    return {name: spectrum for name, spectrum in found.items() if spectrum is not None and spectrum.enough(segments[0].settings)}


def measure(
    segments: Sequence[SpectralSegment],
    rests: Sequence[tuple[np.ndarray, np.ndarray]],
    white: np.ndarray,
    filtered: bool,
    encoders: Encoders,
) -> NoiseSpectrum | None:
    """The noise of moving recordings by frequency, where they allow it.

    Where noise above the band is no guide, for readings were ``filtered`` before they were recorded, repeats are preferred, for
    they hold the noise of motion, too; then rests, times (N,) and readings (N, c) of a robot that stands still. Otherwise the
    white noise read above the band (c,) is the better estimate, and is replaced only where repeats or a wrench at rest show
    noise that is much stronger in the band. ``encoders`` say what of the difference of repeats is their doing.
    """
    settings = segments[0].settings
    repeats = find_repeats([course(s) for s in segments], encoders.resolution)
    roundings = encoders.roundings(segments, {i for r in repeats for i in (r.first, r.second)})
    channels = range(len(white))
    # A drive at rest holds with friction whatever it takes, and that may wander: no reason to distrust white noise.
    torques = {c for s in segments for c, _ in s.torque_channels}
    at_rest = [rest_piece(*r, segments[0].trajectory.bandwidth, settings) for r in rests]
    sources = [
        ("repeats", repeat_pieces(segments, repeats, encoders.predict, roundings), channels),
        ("parked", at_rest, [c for c in channels if c not in torques]),
    ]
    for source, pieces, judged in sources:
        spectrum = measured_spectrum(pieces)
        if spectrum is not None and spectrum.enough(settings) and (filtered or coloured(pieces, white, judged)):
            return replace(spectrum, source=source, own=_own(segments, repeats, pieces) if source == "repeats" else {})
    return None
