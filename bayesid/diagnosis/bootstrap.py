"""Intervals by drawing blocks of time anew: readings that follow each other are not independent, blocks of seconds nearly are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesid.diagnosis.settings import Settings

#: How often sums are drawn.
_DRAWS = 999


def lower_end(blocks: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], settings: Settings, seed: int) -> np.ndarray:
    """Lower end of the one-sided 95 % interval (`Settings.interval`) of what depends on sums over blocks.

    Parameters
    ----------
    blocks
        What is summed, by block of time (b, k).
    statistic
        From sums (draws, k) to what is asked for (draws, ...).
    settings
        ``interval`` counts here.
    seed
        Of the draws.

    Returns
    -------
    lower end
        (...).
    """
    picks = np.random.default_rng(seed).integers(len(blocks), size=(_DRAWS, len(blocks)))
    return np.quantile(statistic(blocks[picks].sum(axis=1)), 1.0 - settings.interval, axis=0)
