"""Motions brought within limits, and random ones to start from."""

from __future__ import annotations

import numpy as np

from bayesid.design.excitation.limits import Limits
from bayesid.design.excitation.series import Coordinates, FourierSeries

#: What is left of every limit for what lies between samples of torques, wrenches and distances.
GUARD = 1e-3
_HALVINGS, _COARSE = 14, 250
#: Smallest step by which a motion that fits coarse samples is made to fit fine ones.
_SHRINK = 0.002
#: A motion that must shrink to less than this share of what its joints could do goes round something: another is better.
_SMALLEST = 0.02


def scaled_to_fit(series: FourierSeries, limits: Limits, samples: int, largest: float = np.inf) -> FourierSeries | None:
    """The motion with its amplitudes as large as all limits allow; None where even a small motion about its centre breaks one.

    Amplitudes are first scaled to the joints' own limits, exactly; then, where loads or distances do not fit, all by one
    factor, found by halving on coarse samples and made smaller until it fits the fine ones.

    Parameters
    ----------
    series
        Any motion.
    limits
        To keep.
    samples
        Even samples of a period that loads and distances are tested on.
    largest
        Factor that the amplitudes are raised by at most.
    """
    room = limits.kinematic_room(series, max(samples, 20 * series.harmonics))
    factor = min(float(room.min(initial=np.inf)) * (1.0 - 1e-9), largest)

    def excess(share: float, at: int) -> float:
        found = limits.worst_loads(series.scaled(share * factor), at)
        return max((float(worst.max(initial=0.0)) for worst in found.values()), default=0.0) - (1.0 - GUARD)

    coarse = min(samples, max(_COARSE, 20 * series.harmonics))
    share = 1.0
    if excess(1.0, coarse) > 0.0:
        if excess(_SMALLEST, coarse) > 0.0:
            return None
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle, coarse) <= 0.0 else (low, middle)
        share = low
    while share >= _SMALLEST:
        over = excess(share, samples)
        if over <= 0.0:
            return series.scaled(share * factor)
        share *= 1.0 - max(2.0 * over, _SHRINK)
    return None


def random_series(coordinates: Coordinates, limits: Limits, rng: np.random.Generator) -> FourierSeries:
    """A random motion: every joint takes a random share of what its own limits allow, about a random place in its range."""
    x = rng.normal(size=coordinates.count)
    series = coordinates.series(x)
    m = limits.moving
    place = rng.uniform(-0.7, 0.7, len(m))
    series.centre[m] = limits.middle[m] + place * limits.reach[m]
    share = np.zeros(len(series.centre))
    share[m] = limits.kinematic_room(series, 20 * series.harmonics) * rng.uniform(0.5, 1.0, len(m))
    return series.scaled(share)


def random_feasible(
    coordinates: Coordinates, limits: Limits, rng: np.random.Generator, samples: int, tries: int = 50
) -> FourierSeries | None:
    """A random motion within all limits, scaled as large as they allow; None where none was found in so many tries."""
    for _ in range(tries):
        found = scaled_to_fit(random_series(coordinates, limits, rng), limits, samples)
        if found is not None:
            return found
    return None
