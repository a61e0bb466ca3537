"""Readings in a frequency basis, where their noise is white once it is divided by its known spectrum.

A segment of samples becomes its lowest discrete cosine coefficients, up to `Settings.band`. Each coefficient is one
frequency, so a noise that depends on frequency is a small covariance across channels for each of them:

    S(f) = diag(sensor noise) + E(f) + accuracy of the model

The sensor's share is white and read off above the band. E is what the encoders' counts do to the prediction:
rounding, smoothing and prediction are repeated with other roundings. It grows with the fourth power of
frequency, so that low frequencies tell most, and an unweighted error in the time domain wastes nearly all.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numba
import numpy as np
from scipy.fft import dct, idct
from scipy.ndimage import binary_opening, convolve, distance_transform_edt, uniform_filter1d

from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.effects import REST_SPEED, MotionSegment
from bayesid.effects.segment import Results
from bayesid.signals.arrays import kernel_input

#: As many kinds of friction as there are, at each joint of a long arm and at every shape that is tried.
_KEPT = 600
#: Time in which the weight falls to nothing before what is left out [s], about that of a contact's ramp.
_FLANK = 0.2


@dataclass(frozen=True, eq=False)
class _Averaged:
    """What multiplies samples of channels that read averages: a weight (M, c), and differences where that changes (k,)."""

    weight: np.ndarray
    at: np.ndarray
    rates: np.ndarray  # factors of the difference between the samples after and before (k, c)


@dataclass(frozen=True, eq=False)
class SpectralSegment:
    """One gap-free recording of a motion or of its static run."""

    #: Which motion it belongs to.
    motion: str
    role: str
    #: (N,) [s], the numbers of poses, whenever they were taken; and the encoders' readings (N, n).
    times: np.ndarray
    encoders: np.ndarray
    readings: np.ndarray  # measured (N, c)
    #: Smoothed trajectory on a coarser even grid over the same time (M, n): predictions have little above the band.
    trajectory: MotionSegment
    still: bool  # whether every sample is a pose at rest
    torque_channels: tuple[tuple[int, int], ...]  # (channel, joint) of the channels that are joint torques
    covariance: np.ndarray  # of the coefficients (K, c, c); empty until it is known
    instant: bool = False  # whether a reading is the value at its time; otherwise it is the mean over one sample's time
    settings: Settings = DEFAULT  # the diagnosis' thresholds
    between_turns: bool = False  # whether torques have little weight where their joint turns
    left_out: tuple[float, float] | None = None  # start and end of a time that has no weight [s]: something else acted then
    #: Coefficients of columns that are the same for any noise.
    kept: Results = field(default_factory=lambda: Results(_KEPT), init=False, repr=False)

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return float((self.times[-1] - self.times[0]) / (len(self.times) - 1))

    @property
    def apart(self) -> bool:
        """Whether the samples are poses that do not follow each other: then their positions are not smoothed."""
        return bool(np.isinf(self.trajectory.bandwidth))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of coefficients and channels."""
        return len(self.frequencies), self.readings.shape[1]

    @cached_property
    def alive(self) -> np.ndarray:
        """Channels that say anything (c,): a torque whose joint rests all the time says nothing."""
        return np.asarray(self._weight.any(axis=0))

    @property
    def count(self) -> int:
        """Number of coefficients of all channels that say anything."""
        return len(self.frequencies) * int(self.alive.sum())

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Frequencies of the coefficients (K,) [Hz]."""
        spacing = 0.5 / (len(self.times) * self.step)
        band = min(self.settings.band, 0.4 / self.step, 0.8 * self.trajectory.bandwidth)
        return spacing * np.arange(max(int(band / spacing), 1))

    def spectrum(self, samples: np.ndarray, channels: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Coefficients (K, c, ...) of predicted samples (M, c, ...) of all channels, or of those given.

        A reading is the mean over one sample's time h, a prediction a point: its coefficients get the mean's
        share, ``sin(pi f h) / (pi f h)``. Readings are averaged before they are weighted, so what averaging does to the
        weight w is taken back: ``w mean(p) = mean(w p) - h^2 / 24 (2 w' p' + w'' p)``. Poses at rest and instants are points
        on both sides.
        """
        scale = np.sqrt(len(self.times) / len(self.trajectory.times))
        if self.still or self.instant:
            return _transform(samples, self._trajectory_weight[:, channels], len(self.frequencies)) * scale
        averaged = self._averaged(channels)

        flat = kernel_input(samples.reshape(*samples.shape[:2], int(np.prod(samples.shape[2:]))))
        weighted = _weighted(flat, kernel_input(averaged.weight), averaged.at, kernel_input(averaged.rates))
        share = self._mean_share * scale
        out = np.asarray(dct(weighted, axis=0, norm="ortho", overwrite_x=True))[: len(share)] * share[:, None, None]
        return out.reshape(len(share), *samples.shape[1:])

    @cached_property
    def _mean_share(self) -> np.ndarray:
        """Share of a coefficient that is left of means over a sample's time (K,)."""
        return np.sinc(self.frequencies * self.step)

    @cached_property
    def _trajectory_weight(self) -> np.ndarray:
        """Weight on the segment's grid (M, c)."""
        return self.weight(self._grid)

    @property
    def _grid(self) -> np.ndarray:
        """Times of the segment's grid (M,), the poses' numbers."""
        return self.times if self.apart else self.trajectory.times

    def _averaged(self, channels: np.ndarray | slice) -> _Averaged:
        """What multiplies the samples of some channels; where no weight of theirs changes there is nothing but that."""
        which = tuple(np.arange(self.readings.shape[1])[channels])
        if which not in self._averages:
            times, weight = self.trajectory.times, self._trajectory_weight[:, which]
            slope = np.gradient(weight, times, axis=0)
            bend, share = np.gradient(slope, times, axis=0), self.step**2 / 24.0
            at = np.flatnonzero(slope.any(axis=1))
            span = times[np.minimum(at + 1, len(times) - 1)] - times[np.maximum(at - 1, 0)]
            self._averages[which] = _Averaged(weight - share * bend, at, share * 2.0 * slope[at] / span[:, None])
        return self._averages[which]

    @cached_property
    def _averages(self) -> dict[tuple[int, ...], _Averaged]:
        """What `_averaged` has found, by channels: the same are asked for again and again."""
        return {}

    @cached_property
    def measured_readings(self) -> np.ndarray:
        """Coefficients of the readings (K, c)."""
        return self.measured(self.readings)

    @cached_property
    def measured_ones(self) -> np.ndarray:
        """Coefficients of a constant of one in every channel (K, c)."""
        return self.measured(np.ones(self.readings.shape))

    def measured(self, samples: np.ndarray) -> np.ndarray:
        """Coefficients (K, c, ...) of measured samples (N, c, ...)."""
        return _transform(samples, self._weight, len(self.frequencies))

    @cached_property
    def _weight(self) -> np.ndarray:
        """Weight of the readings (N, c)."""
        return self.weight(self.times)

    def course(self, samples: np.ndarray) -> np.ndarray:
        """Coefficients (K, ...) of courses in time (M, ...) on the segment's grid that belong to no channel."""
        edge = taper(self._grid, self.times, self.trajectory.bandwidth, self.settings)[:, None]
        flat = _transform(samples.reshape(len(samples), -1), edge, len(self.frequencies))
        return flat.reshape(-1, *samples.shape[1:]) * np.sqrt(len(self.times) / len(samples))

    def weight(self, times: np.ndarray) -> np.ndarray:
        """Weight of times in every channel (k, c): the taper at both ends, and what `determined` says."""
        return taper(times, self.times, self.trajectory.bandwidth, self.settings)[:, None] * self.determined(times)

    def determined(self, times: np.ndarray) -> np.ndarray:
        """How far the model determines a reading (k, c).

        A joint at rest may stick, and its drive then holds anything; nor is a reading determined in a time that is left out.
        """
        out = np.ones((len(times), self.readings.shape[1]))
        for channel, joint in self.torque_channels:
            out[:, channel] = np.interp(times, self.trajectory.times, self._moving[:, joint])
        if self.left_out is not None:
            start, end = self.left_out
            out *= np.sin(0.5 * np.pi * np.clip(np.maximum(start - times, times - end) / _FLANK, 0.0, 1.0))[:, None] ** 2
        return out

    def used(self, times: np.ndarray) -> np.ndarray:
        """Which times are not left out (k,)."""
        start, end = self.left_out or (np.inf, -np.inf)
        return (times < start) | (times > end)

    @cached_property
    def _moving(self) -> np.ndarray:
        """1 where a joint moves, 0 where it rests for longer than `Settings.moment`, with smooth flanks (M, n).

        And 0 where it turns, if torques are compared `between_turns`.
        """
        step = float(np.median(np.diff(self.trajectory.times)))
        length = max(int(self.settings.moment / step), 1)
        velocities = self.trajectory.velocities
        # Encoder counts make single velocities noisy; a mean over a rest is not, and one over a reversal is soon past zero.
        speed = np.abs(uniform_filter1d(velocities, length, axis=0))
        slow = np.maximum(self.settings.rest_share * speed.max(axis=0), 2.0 * REST_SPEED)
        # A rest that lasts: opening (erosion, then dilation) along time. Then the flanks.
        rest = binary_opening(speed < slow, np.ones((length, 1), bool))
        wide = np.hanning(2 * length + 3)[1:-1, None]
        moving = np.clip(1.0 - convolve(rest.astype(float), wide / wide.sum() * 2.0, mode="nearest"), 0.0, 1.0)
        turns = np.abs(velocities) < slow
        turns[1:] |= velocities[1:] * velocities[:-1] < 0.0
        for joint, at in enumerate(turns.T):
            if self.between_turns and at.any():
                away = np.asarray(distance_transform_edt(~at)) * step / (0.5 * self.settings.moment)
                moving[:, joint] *= np.sin(0.5 * np.pi * np.minimum(away, 1.0)) ** 2
        return moving

    def samples(self, coefficients: np.ndarray) -> np.ndarray:
        """The band-limited signal (N, ...) of coefficients (K, ...)."""
        full = np.zeros((len(self.times), *coefficients.shape[1:]))
        full[: len(coefficients)] = coefficients
        return np.asarray(idct(full, axis=0, norm="ortho"))

    @cached_property
    def whitener(self) -> np.ndarray:
        """Root of the inverse covariance, one matrix a coefficient (K, c, c)."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def whiten(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients (K, c, ...) in units of their noise."""
        flat = coefficients.reshape(*coefficients.shape[:2], -1)
        return np.matmul(self.whitener, flat).reshape(coefficients.shape)

    def with_noise(self, covariance: np.ndarray) -> SpectralSegment:
        """The same recording with another covariance of the coefficients (K, c, c)."""
        out = replace(self, covariance=covariance)
        object.__setattr__(out, "kept", self.kept)
        return out

    def live_spectrum(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Channels in which predicted samples (M, c, ...) are not zero throughout (c,), and their coefficients (K, live, ...)."""
        # Down contiguous rows, which is six times as fast as over two axes.
        any_sample = np.asarray(samples.reshape(len(samples), -1).any(axis=0))
        live = np.asarray(any_sample.reshape(samples.shape[1], -1).any(axis=1))
        if not live.any():
            return live, np.zeros((len(self.frequencies), 0, *samples.shape[2:]))
        return live, self.spectrum(samples if live.all() else samples[:, live], live)

    def white_rows(self, live: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """White rows (K c, ...) of coefficients (K, live, ...) of some channels (c,), of nothing in the others."""
        flat = coefficients.reshape(*coefficients.shape[:2], int(np.prod(coefficients.shape[2:])))
        return np.matmul(self.whitener[:, :, live], flat).reshape(-1, *coefficients.shape[2:])

    def white(self, samples: np.ndarray) -> np.ndarray:
        """Predicted samples (M, c, ...) as white rows (K c, ...); channels that are zero throughout cost nothing."""
        return self.white_rows(*self.live_spectrum(samples))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weighted(samples, weight, at, rates):
    """Weighted samples (M, c, k), less differences between those before and after some (m,) times factors (m, c)."""
    out = np.empty(samples.shape)
    for m in range(samples.shape[0]):
        for c in range(samples.shape[1]):
            for k in range(samples.shape[2]):
                out[m, c, k] = samples[m, c, k] * weight[m, c]
    for i, m in enumerate(at):
        after, before = min(m + 1, len(samples) - 1), max(m - 1, 0)
        for c in range(samples.shape[1]):
            for k in range(samples.shape[2]):
                out[m, c, k] -= (samples[after, c, k] - samples[before, c, k]) * rates[i, c]
    return out


def _transform(samples: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    weighted = samples * weight.reshape(weight.shape + (1,) * (samples.ndim - 2))
    return np.asarray(dct(weighted, axis=0, norm="ortho"))[:count]


def taper(times: np.ndarray, whole: np.ndarray, bandwidth: float, settings: Settings) -> np.ndarray:
    """Weight of times (k,) in a recording: 1, but falling to 0 at both ends, where the smoothed trajectory is loose.

    It falls within `Settings.ramp` as a squared cosine of a squared sine's argument, so gently that the large constant weight
    of a robot leaks no more than 1e-6 of itself into the band when predictions are made on a coarse grid.
    """
    length = min(max(settings.ramp, 1.5 / bandwidth), 0.25 * (whole[-1] - whole[0]))
    inside = np.clip(np.minimum(times - whole[0], whole[-1] - times) / length, 0.0, 1.0)
    return np.sin(0.5 * np.pi * np.sin(0.5 * np.pi * inside) ** 2) ** 2
