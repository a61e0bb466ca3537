"""Intervals by drawing blocks of time anew: readings that follow each other are not independent, blocks of seconds nearly are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesid.diagnosis.settings import Settings

#: Lower end of one-sided 95 % intervals.
_LOW = 0.05


def lower_end(blocks: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], settings: Settings, seed: int) -> np.ndarray:
    """Lower end of the one-sided 95 % interval of what depends on sums over blocks.

    Parameters
    ----------
    blocks
        What is summed, by block of time (b, k).
    statistic
        From sums (draws, k) to what is asked for (draws, ...).
    settings
        ``bootstrap_draws`` counts here.
    seed
        Of the draws.

    Returns
    -------
    lower end
        (...).
    """
    picks = np.random.default_rng(seed).integers(len(blocks), size=(settings.bootstrap_draws, len(blocks)))
    return np.quantile(statistic(blocks[picks].sum(axis=1)), _LOW, axis=0)
