"""Samples at uneven times, brought to even ones: where time stamps jitter, drift, or lack a few."""

from __future__ import annotations

import numpy as np

from bayesid.signals.smoothing import smooth

#: Times within this share of a step of even ones are even: the motion that is missed is a tenth of a sample's.
EVEN = 0.1


def uneven(times: np.ndarray) -> bool:
    """Whether times (N,) stray from an even grid by more than a small share of their step."""
    grid = np.linspace(times[0], times[-1], len(times))
    return bool(np.abs(times - grid).max() > EVEN * (grid[1] - grid[0])) if len(times) > 2 else False


def resample_evenly(times: np.ndarray, values: np.ndarray, bandwidth: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples (N, c) of increasing true times (N,) [s] at even ones, as far apart as the median step, from the first to the last.

    With the least-squares spline s of `smooth`, of a bandwidth [Hz], ``y(t) = y_k + s(t) - s(t_k)`` at the sample k that is
    nearest. What the spline does not follow, noise above all, is moved as it is: interpolation would average neighbours and so
    make it less. Where a sample was dropped, one of the others' deviations from the spline stands in, drawn with a fixed seed: a
    neighbour's would be there twice, and white noise no longer white.
    """
    step = float(np.median(np.diff(times)))
    even = np.linspace(times[0], times[-1], max(round((times[-1] - times[0]) / step), 1) + 1)
    right = np.clip(np.searchsorted(times, even), 1, len(times) - 1)
    nearest = np.where(even - times[right - 1] < times[right] - even, right - 1, right)
    again = np.append(False, np.diff(nearest) == 0)
    nearest[again] = np.random.default_rng(0).integers(len(times), size=int(again.sum()))
    centre = values.mean(axis=0)
    course = smooth(times, values - centre, bandwidth, at=np.concatenate([even, times]))[0]
    return even, values[nearest] + course[: len(even)] - course[len(even) + nearest]
