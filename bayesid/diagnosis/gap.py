"""Shares of a gap, and their intervals by drawing blocks of time anew.

Readings that follow each other are not independent, blocks of seconds nearly are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from bayesid.diagnosis.settings import Settings

#: A gap is no less than this share of the mean square that it is counted from.
LEAST_GAP = 1e-3
#: How often sums are drawn.
_DRAWS = 999


def share_of_gap(closed, before, floor):
    """Share of the gap from mean squares ``before`` to ``floor`` that ``closed``, a difference of such, is; of arrays, each."""
    return closed / np.maximum(before - floor, LEAST_GAP * before)


def lower_end(blocks: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], settings: Settings, seed: int) -> np.ndarray:
    """Lower end of the one-sided 95 % interval (`Settings.interval`) of a statistic of sums over blocks of time (b, k).

    The statistic takes drawn sums (draws, k) and gives what is asked for (draws, ...); the seed is that of the draws.
    """
    return np.quantile(statistic(_drawn(len(blocks), seed) @ blocks), 1.0 - settings.interval, axis=0)


@lru_cache(maxsize=8)  # a few recordings' worth: of one, the same blocks are drawn hundreds of times
def _drawn(count: int, seed: int) -> np.ndarray:
    """How often each of so many blocks is drawn (draws, count)."""
    picks = np.random.default_rng(seed).integers(count, size=(_DRAWS, count))
    return np.stack([np.bincount(own, minlength=count) for own in picks]).astype(float)
