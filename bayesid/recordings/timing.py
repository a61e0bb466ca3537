"""How even the time stamps of a recording are: what is missing, how they jitter, how they drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.recordings.table import GAP, Table

#: Jitter beyond this share of a step, or a drift of the step by it, is told.
TOLD = 0.1


@dataclass(frozen=True)
class Timing:
    """How even time stamps are.

    Attributes
    ----------
    dropped
        Samples missing in steps that are no gaps, by how many usual steps fit into them.
    jitter
        Error of a time stamp that would make steps scatter as they do, rms [s]: a stamp ends one step and starts the next.
    first_step, last_step
        Usual step in the first and the last quarter [s].
    """

    dropped: int
    jitter: float
    first_step: float
    last_step: float

    @classmethod
    def of(cls, table: Table) -> Timing:
        """The timing of a table of at least two rows."""
        step = table.step
        steps = np.diff(table.times)
        steps = steps[steps <= GAP * step]
        quarter = max(len(steps) // 4, 1)
        count = np.maximum(np.round(steps / step), 1.0)
        first, last = float(np.median(steps[:quarter])), float(np.median(steps[-quarter:]))
        scatter = steps - count * np.linspace(first, last, len(steps))  # drift is no jitter
        return cls(int((count - 1.0).sum()), float(np.sqrt(0.5 * np.mean(scatter**2))), first, last)
