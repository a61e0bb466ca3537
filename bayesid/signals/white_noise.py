"""The white noise of single samples, read off the readings themselves above the band of the motion, whatever the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

#: Samples of one window, and the quantile of windows that count as quiet.
WINDOW, QUIET = 64, 0.1
#: White noise has as much power at a fifth of the sampling rate as near half of it; beyond this ratio it was filtered.
FILTERED_RATIO = 8.0
#: The mean over all windows is taken, being more exact, where it exceeds what the quiet ones say by less than this.
_STEADY = 1.3


def quiet_noise(readings: Sequence[np.ndarray], window: int = WINDOW, quantile: float = QUIET) -> np.ndarray:
    """Standard deviation of one sample's white noise (c,), from quiet moments above the motion's band.

    Power at high frequencies in short windows. Real motion reaches there, too, where the robot hurries, reverses or is
    struck; so the quietest windows count: a low quantile of the windows' powers, over what that quantile would be if
    the noise were all there is.

    Parameters
    ----------
    readings
        Recordings made in the same way (a static run may average its readings longer than a moving one), each (N, c).
    window, quantile
        Samples of a window, and which quantile of the windows counts.
    """
    powers, bins = _powers(readings, 0.3, 0.48, window)
    return np.sqrt(np.quantile(powers, quantile, axis=0) / (chi2.ppf(quantile, 2 * bins) / (2 * bins)))


def steady_noise(readings: Sequence[np.ndarray]) -> np.ndarray:
    """As `quiet_noise` (c,), but from all windows where the noise is as strong in all of them."""
    quiet = quiet_noise(readings)
    mean = np.sqrt(_powers(readings, 0.3, 0.48, WINDOW)[0].mean(axis=0))
    return np.where(mean < _STEADY * quiet, mean, quiet)


def low_passed(
    readings: Sequence[np.ndarray], ratio: float = FILTERED_RATIO, window: int = WINDOW, quantile: float = QUIET
) -> bool:
    """Whether readings were filtered before they were recorded, so that noise above the band tells nothing of it below."""
    lower, upper = (
        np.quantile(_powers(readings, *band, window)[0], quantile, axis=0) for band in ((0.15, 0.25), (0.4, 0.48))
    )
    return bool(np.max(lower / np.maximum(upper, 1e-300)) > ratio)


def _powers(readings: Sequence[np.ndarray], low: float, high: float, window: int) -> tuple[np.ndarray, int]:
    """Power per sample between two frequencies (shares of the sampling rate) of every window (w, c), and how many bins.

    Second differences first, so that a slow, large motion does not leak upwards; their gain is (2 sin(pi f h))^4.
    """
    powers, bins = [], 1
    for values in readings:
        length = min(window, len(values) // 2)
        pieces = len(values) // length
        cut = np.diff(values[: pieces * length].reshape(pieces, length, -1), n=2, axis=1)
        count = cut.shape[1]
        frequency = np.fft.rfftfreq(count)
        shape = np.hanning(count + 2)[1:-1]
        power = np.abs(np.fft.rfft(cut * shape[:, None], axis=1)) ** 2 / np.sum(shape**2)
        inside = (frequency > low) & (frequency < high)
        # A Hann window spreads each frequency over about three bins' worth, 1.5 of them independent.
        bins = max(int(np.count_nonzero(inside) / 1.5), 1)
        powers.append(np.mean(power[:, inside] / ((2.0 * np.sin(np.pi * frequency[inside])) ** 4)[:, None], axis=1))
    return np.concatenate(powers), bins
