"""What encoders' counts do to predictions: rounding, smoothing and prediction are repeated with other roundings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.signals.smoothing import smooth

#: Repetitions of the encoders' rounding: a standard deviation to 20 %, and to 6 % once neighbouring frequencies are pooled.
ROUNDINGS = 12
#: Log of the odds against a step's being a whole multiple by chance, to a tenth of it either way.
_CHANCE = float(np.log(5.0))


def with_noise(
    segment: SpectralSegment,
    predict: Callable[[SpectralSegment], np.ndarray],
    resmooth: Callable[[SpectralSegment, np.ndarray], SpectralSegment],
    sensor: np.ndarray,
    resolution: np.ndarray,
    position_std: np.ndarray,
    rng: np.random.Generator,
) -> SpectralSegment:
    """The segment with the covariance of its coefficients: the sensor's noise, and what encoder errors make of predictions.

    ``predict`` gives readings of a segment (N, c), ``resmooth`` the segment with other encoder readings (N, n). ``sensor`` is
    the standard deviation of white noise of one sample (c,), or the covariance of a sample for every coefficient (K, c, c); one
    encoder count and random noise on top are by joint (n,) [rad or m].
    """
    exact, settings = predict(segment), segment.settings
    positions, quiet = _smooth_positions(segment)
    channels = exact.shape[1]
    signal = segment.spectrum(exact)
    scatter = np.zeros((len(segment.frequencies), channels, channels))
    if resolution.any() or position_std.any():
        for _ in range(ROUNDINGS):
            # Where within a count the truth lies is unknown: another shift, another rounding.
            shift = rng.uniform(-0.5, 0.5, segment.encoders.shape[1]) * resolution
            read = positions + reading_errors(quiet, shift, resolution, position_std, rng)
            error = segment.spectrum(predict(resmooth(segment, read)) - exact)
            scatter += error[:, :, None] * error[:, None, :] / ROUNDINGS
        scatter = pooled(scatter, settings.neighbours // 2)
    weight = segment.weight(segment.times)
    share = weight.T @ weight / len(weight) + np.diag(~segment.alive)  # a channel that says nothing has any noise
    floor = (np.diag(sensor**2) if sensor.ndim == 1 else sensor) * share
    rough = np.zeros_like(scatter)
    # Of what is read where the model predicts nothing: a joint without load whose friction is not in the model.
    power = pooled(np.maximum(signal**2, segment.measured_readings**2), settings.neighbours // 2)
    rough[:, np.arange(channels), np.arange(channels)] = settings.accuracy**2 * power
    return segment.with_noise(floor + scatter + rough)


def _smooth_positions(segment: SpectralSegment) -> tuple[np.ndarray, np.ndarray]:
    """Positions as the segment's trajectory has them, and as smooth as the data allow (N, n); of poses what was read.

    Where a joint turns, the first follow the counts of this one recording. Rounded once more they would tell of that one case,
    and of errors that are up to a fifth too weak between 3 and 10 Hz.
    """
    if segment.apart:
        return segment.encoders, segment.encoders
    own = segment.trajectory.bandwidth
    positions = smooth(segment.times, segment.encoders, own)[0]
    clear = min(segment.trajectory.clear or own, own)
    return positions, positions if clear == own else smooth(segment.times, segment.encoders, clear)[0]


def reading_errors(
    positions: np.ndarray, shift: np.ndarray, resolution: np.ndarray, position_std: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Errors of encoders whose counts lie elsewhere, by a shift (n,), reading positions (N, n) [rad or m]."""
    q = positions + shift
    read = q + position_std * rng.normal(size=q.shape)
    count = np.where(resolution > 0, resolution, 1.0)
    return np.where(resolution > 0, np.round(read / count) * count, read) - q


def pooled(values: np.ndarray, most: int) -> np.ndarray:
    """Mean over neighbouring frequencies, fewer at the ends."""
    total = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0)
    index = np.arange(len(values))
    reach = np.minimum(most, np.maximum(index // 2, 1))
    low, high = np.maximum(index - reach, 0), np.minimum(index + reach + 1, len(values))
    return (total[high] - total[low]) / (high - low).reshape((-1,) + (1,) * (values.ndim - 1))


def encoder_count(positions: np.ndarray, settings: Settings) -> float:
    """The step that all readings (N,) are whole multiples of, apart from one another; 0 if there is none [rad or m]."""
    values = np.unique(positions)
    steps = np.diff(values)
    steps = steps[steps > 1e-9]
    if not len(steps):
        return 0.0
    # Numbers written with few decimals are off by up to half of the last one; a step is then no exact multiple.
    for part in (1, 2, 3):
        multiples = steps / (steps.min() / part)
        if len(steps) * _CHANCE > settings.accept and np.mean(np.abs(multiples - np.round(multiples)) < 0.1) > 0.98:
            return float(steps.min() / part)
    return 0.0


@dataclass(frozen=True, eq=False)
class Encoders:
    """What their errors do to predictions."""

    #: Readings predicted for a segment (M, c); the segment with other encoder readings (N, n).
    predict: Callable[[SpectralSegment], np.ndarray]
    resmooth: Callable[[SpectralSegment, np.ndarray], SpectralSegment]
    #: One encoder count and random noise on top, by joint (n,) [rad or m].
    resolution: np.ndarray
    position_std: np.ndarray
    seed: int  # of the roundings

    def roundings(self, segments: Sequence[SpectralSegment], wanted: set[int]) -> dict[int, list[SpectralSegment]]:
        """Segments as other roundings would have shown them; an encoder's zero is the same in all."""
        rng = np.random.default_rng([self.seed, 1])
        out: dict[int, list[SpectralSegment]] = {i: [] for i in sorted(wanted)}
        if not (self.resolution.any() or self.position_std.any()):
            return out
        exact = {i: _smooth_positions(s) for i, s in enumerate(segments) if i in wanted}
        for _ in range(ROUNDINGS):
            shift = rng.uniform(-0.5, 0.5, len(self.resolution)) * self.resolution
            for i, (positions, quiet) in exact.items():
                errors = reading_errors(quiet, shift, self.resolution, self.position_std, rng)
                out[i].append(self.resmooth(segments[i], positions + errors))
        return out
