"""The white noise of single samples, read off the readings themselves above the band of the motion, whatever the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import chi2

#: Samples of one window, and the quantile of windows that count as quiet.
_WINDOW, _QUIET = 64, 0.1
#: Windows looked at together, which stay in the processor's cache.
_AT_ONCE = 128
#: White noise has as much power at a fifth of the sampling rate as near half of it; beyond this ratio it was filtered.
_FILTERED_RATIO = 8.0
#: Share of the readings' size below which their noise is no sensor's (the best converters resolve 20 bits): a filter took it.
NO_SENSOR = 1e-6
#: The mean over all windows is taken, being more exact, where it exceeds what the quiet ones say by less than this.
_STEADY = 1.3
#: Shares of the windows, the quietest, over which a mean may be taken, and by how many standard errors it may exceed what the
#: quantile says.
_SHARES, _CONSISTENT = (0.25, 0.5, 0.75, 1.0), 2.5
#: Frequencies above the motion's, and those that tell filtered readings, as shares of the sampling rate.
_ABOVE = (0.3, 0.48)
_COMPARED = ((0.15, 0.25), (0.4, 0.48))


def quiet_noise(readings: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation of one sample's white noise (c,), from quiet moments above the motion's band.

    Power at high frequencies in short windows. Real motion reaches there, too, where the robot hurries, reverses or is
    struck; so the quietest windows count: a low quantile of the windows' powers, over what that quantile would be if
    the noise were all there is. A quantile of few windows is inexact. So the mean over the largest share of them, quietest first,
    is taken that agrees with it, over what that mean would be of noise alone: over all where the noise is the same all the time.

    Recordings (N, c) are made in the same way; a static run may average its readings longer than a moving one.
    """
    (powers,), freedom = _powers(readings, [_ABOVE])
    return _quiet(powers, freedom)


def steady_noise(readings: Sequence[np.ndarray]) -> np.ndarray:
    """The same as `quiet_noise` (c,), but from all windows where the noise is as strong in all of them."""
    (powers,), freedom = _powers(readings, [_ABOVE])
    quiet, mean = _quiet(powers, freedom), np.sqrt(powers.mean(axis=0))
    return np.where(mean < _STEADY * quiet, mean, quiet)


def low_passed(readings: Sequence[np.ndarray]) -> bool:
    """Whether readings were filtered before they were recorded, so that noise above the band tells nothing of it below.

    Either the noise falls with frequency there, or so little of it is left in most channels that only the digits of the file make
    it. Simulated readings without noise count as such, too: nothing tells how much of it a sensor would have.
    """
    lower, upper = (np.quantile(p, _QUIET, axis=0) for p in _powers(readings, _COMPARED)[0])
    size = np.sqrt(np.sum([np.einsum("kc,kc->c", y, y) for y in readings], axis=0) / sum(map(len, readings)))
    falls = np.max(lower / np.maximum(upper, 1e-300)) > _FILTERED_RATIO
    return bool(falls or np.median(np.sqrt(upper) / np.maximum(size, 1e-300)) < NO_SENSOR)


def _quiet(powers: np.ndarray, freedom: float) -> np.ndarray:
    """Standard deviation of noise whose windows have these powers (w, c) at their quietest (c,)."""
    usual = chi2.ppf(_QUIET, freedom) / freedom
    density = chi2.pdf(freedom * usual, freedom) * freedom
    out = sure = np.quantile(powers, _QUIET, axis=0) / usual
    error = np.sqrt(_QUIET * (1.0 - _QUIET) / len(powers)) / (density * usual)
    ordered = np.sort(powers, axis=0)
    for share in _SHARES:
        count = int(np.ceil(share * len(powers)))
        # Mean of a chi-squared below its quantile: x p(x, nu) is nu p(x, nu + 2).
        below = chi2.cdf(chi2.ppf(share, freedom), freedom + 2.0) / share
        mean = ordered[:count].mean(axis=0) / below
        out = np.where(mean <= (1.0 + _CONSISTENT * error) * sure, mean, out)
    return np.sqrt(out)


def _powers(readings: Sequence[np.ndarray], bands: Sequence[tuple[float, float]]) -> tuple[list[np.ndarray], float]:
    """Power per sample in bands (shares of the sampling rate) of every window (w, c), and the last band's degrees of freedom.

    Windows overlap by half: those of a Hann shape are nearly independent. Second differences first, so that a slow, large
    motion does not leak upwards; their gain is (2 sin(pi f h))^4.
    """
    powers, freedom = [[] for _ in bands], 1.0
    for values in readings:
        length = min(_WINDOW, len(values) // 2)
        windows = sliding_window_view(values, length, axis=0)[:: max(length // 2, 1)]  # (w, c, samples), nothing copied
        difference = np.diff(np.eye(length), n=2, axis=0)
        frequency = np.fft.rfftfreq(length - 2)
        shape = np.hanning(length)[1:-1]
        for k, (low, high) in enumerate(bands):
            inside = frequency[(frequency > low) & (frequency < high)]
            gain = np.sqrt(len(inside) * np.sum(shape**2)) * (2.0 * np.sin(np.pi * inside)) ** 2
            # Of the few frequencies of a band, differences, window and transform are one product.
            angle = 2.0 * np.pi * inside[:, None] * np.arange(length - 2)
            turn = np.concatenate([np.cos(angle), np.sin(angle)]) * shape / np.tile(gain, 2)[:, None] @ difference
            # A Hann window spreads each frequency over about three bins: of a sum of squares that depend on each other,
            # the chi-squared with the same mean and variance.
            spread = turn @ turn.T
            freedom = np.trace(spread) ** 2 / np.sum(spread**2)
            for first in range(0, len(windows), _AT_ONCE):
                powers[k].append(np.sum((windows[first : first + _AT_ONCE] @ turn.T) ** 2, axis=2))
    return [np.concatenate(p) for p in powers], freedom
