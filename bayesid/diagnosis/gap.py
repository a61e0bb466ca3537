"""Shares of a gap, and their intervals by drawing blocks of time anew.

Readings that follow each other are not independent, blocks of seconds nearly are.
"""

from __future__ import annotations

from collections.abc import Callable

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
    picks = np.random.default_rng(seed).integers(len(blocks), size=(_DRAWS, len(blocks)))
    return np.quantile(statistic(blocks[picks].sum(axis=1)), 1.0 - settings.interval, axis=0)
