"""The noise that no model can remove: the sensor's own, and what the encoders' errors make of a prediction.

Neither depends on what the fit left over, so a model that lacks something cannot pass for noise. The sensor's noise is read
off the readings above the band of the motion; where they were filtered before they were recorded it is that of a robot at
rest (``parked``), else the data sheet's, else not known. Encoder errors are simulated: the smoothed motion once more with fresh
encoder noise, and what channel-weighted least squares predicts for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct
from scipy.signal import detrend

from bayesid.estimators.weights import learn_weights
from bayesid.regression.encoder_noise import errors_of
from bayesid.regression.problem import Problem
from bayesid.regression.segment import Segment
from bayesid.signals.white_noise import low_passed, steady_noise

#: Where a floor comes from, for reports.
READINGS, AT_REST, DATA_SHEET, RESIDUALS = "readings", "parked", "data sheet", "residuals"
#: Samples that encoder errors are simulated on, in so many pieces, and how often.
_SIMULATED_SAMPLES, _PIECES, _DRAWS = 4000, 4, 3
_BINS = 24
#: A rest shorter than this shows no noise below the band [s].
_SHORTEST_REST = 1.0


@dataclass(frozen=True)
class NoiseFloor:
    """Noise that is left to a perfect model, of rows straight from the smoothed trajectory, whatever filter was fitted with.

    Attributes
    ----------
    sensor
        Standard deviation of one sample's noise (c,) [unit of the channel].
    encoder
        Power that encoder errors add to a row, by frequency from zero to half the row rate (bins, c).
    source
        ``readings``, ``parked`` or ``data sheet``.
    """

    sensor: np.ndarray
    encoder: np.ndarray
    source: str

    def below(self, band: float, step: float) -> np.ndarray:
        """Variance of this noise in rows below a frequency [Hz] (c,); rows have the energy of one sample.

        Parameters
        ----------
        band
            The frequency [Hz].
        step
            Distance of rows [s].
        """
        share = min(2.0 * step * band, 1.0)
        counted = np.clip(share * _BINS - np.arange(_BINS), 0.0, 1.0) / _BINS
        return share * self.sensor**2 + counted @ self.encoder

    def ratio(self, residuals: Sequence[np.ndarray], step: float, band: float) -> np.ndarray:
        """Root mean square of residual rows of stretches (k, c) in units of this noise, below a frequency (c,)."""
        energy, count = np.zeros(len(self.sensor)), 0
        for rows in residuals:
            z = np.asarray(dct(rows, axis=0, norm="ortho"))
            frequency = np.arange(len(z)) / len(z)  # shares of half the row rate
            z = z[: max(int(min(2.0 * step * band, 1.0) * len(z)), 1)]
            noise = self.sensor**2 + self.encoder[(frequency[: len(z)] * _BINS).astype(int)]
            energy += np.sum(z**2 / noise, axis=0)
            count += len(z)
        return np.sqrt(energy / max(count, 1))


def noise_floor(problem: Problem) -> NoiseFloor | None:
    """The floor of an experiment's moving readings, the same for all estimates of them; None where nothing tells it."""
    moving = [s for segments in problem.segments.values() for s in segments if not s.poses]
    samples = [s.measured(0, len(s.times)) for s in moving if len(s.times) >= 32]
    if not samples:
        return None
    sensor, source = steady_noise(samples), READINGS
    if low_passed(samples):
        quiet = _at_rest(problem)
        stated = _data_sheet(problem)
        if quiet is not None:
            sensor, source = np.maximum(sensor, quiet), AT_REST
        elif stated is not None:
            sensor, source = np.maximum(sensor, stated), DATA_SHEET
        else:
            return None
    # Noise-free simulations: a floor of exactly zero would divide by it.
    sensor = np.maximum(sensor, 1e-9 * max(float(np.max([np.abs(y).max() for y in samples])), 1e-300))
    return NoiseFloor(sensor, _encoder_power(problem, moving), source)


def _encoder_power(problem: Problem, moving: Sequence[Segment]) -> np.ndarray:
    """What encoder errors add to rows, by frequency (bins, c)."""
    row_model = replace(problem.row_model, filters=None)
    power, count = np.zeros((_BINS, len(row_model.channels))), np.zeros(_BINS)
    pieces = []
    for s in sorted(moving, key=lambda s: -len(s.times))[:_PIECES]:
        length = min(len(s.times), _SIMULATED_SAMPLES // _PIECES)
        first = (len(s.times) - length) // 2
        pieces.append(s.part(first, first + length))
    pieces = [p for p in pieces if np.ptp(p.inner(row_model.margin))]
    if not pieces:
        return power
    law, _ = errors_of(row_model, pieces, problem.smoother)
    if not law.present():
        return power
    for errors in law.misread(_DRAWS, learn_weights(problem.regression).solution):
        for error in errors:
            z = np.asarray(dct(error, axis=0, norm="ortho"))
            at = (np.arange(len(z)) / len(z) * _BINS).astype(int)
            np.add.at(power, at, z**2)
            np.add.at(count, at, 1.0)
    return power / np.maximum(count, 1.0)[:, None]


def _at_rest(problem: Problem) -> np.ndarray | None:
    """Noise of the readings while the robot stands still, as the experiment says (c,)."""
    parts = []
    for motion in problem.experiment.motions:
        for start, end in motion.parked:
            for s in problem.segments.get(motion.name, ()):
                inside = (s.times >= start) & (s.times <= end)
                if not s.poses and inside.sum() > 16 and np.ptp(s.times[inside]) >= _SHORTEST_REST:
                    parts.append(detrend(s.readings[inside], axis=0))
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)) if parts else None


def _data_sheet(problem: Problem) -> np.ndarray | None:
    """Noise of one sample by the data sheet (c,), where the sensor is all that is compared."""
    sensor = problem.experiment.sensor
    if problem.channel != "wrench" or sensor is None or sensor.force_std is None or sensor.torque_std is None:
        return None
    return np.repeat([sensor.force_std, sensor.torque_std], 3)
