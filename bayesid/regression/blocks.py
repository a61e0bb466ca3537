"""Blocks of rows, and what may be known about the errors of the regressor in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

#: Scalar rows whose products stay in the processor's second cache.
PANEL = 1024


@dataclass(frozen=True)
class Block:
    """Consecutive rows of one recording.

    Attributes
    ----------
    rows
        Regressor columns and, last, the target (k, channels, p + 1).
    times
        (k,) [s].
    motion
        Index of the recording.
    start
        Whether the recording (or a segment after a gap) starts with the first row.
    group
        Rows with the same noise: ``trajectory`` or ``poses``.
    """

    rows: np.ndarray
    times: np.ndarray
    motion: int
    start: bool
    group: str = "trajectory"

    @property
    def matrix(self) -> np.ndarray:
        """Regressor (k, channels, p)."""
        return self.rows[:, :, :-1]

    @property
    def target(self) -> np.ndarray:
        """Measured (k, channels)."""
        return self.rows[:, :, -1]

    def residual(self, solution: np.ndarray) -> np.ndarray:
        """What parameters (p,) leave of what was measured (k, channels)."""
        return residual_of(self.rows, solution)

    def panels(self) -> Iterator[Block]:
        """The same rows, as many at a time as stay in the processor's second cache: for work that treats each row alone."""
        count = max(PANEL // self.rows.shape[1], 1)
        for first in range(0, len(self.rows), count):
            part = slice(first, first + count)
            yield replace(self, rows=self.rows[part], times=self.times[part], start=self.start and first == 0)


def residual_of(rows: np.ndarray, solution: np.ndarray) -> np.ndarray:
    """Target less prediction (k, channels) of regressor columns and target (k, channels, p + 1), as one product."""
    return (rows.reshape(-1, rows.shape[-1]) @ np.append(-solution, 1.0)).reshape(rows.shape[:-1])


@dataclass(frozen=True)
class Pair:
    """The same rows of two trajectories: regressors, and instruments for them.

    Attributes
    ----------
    regressors, instruments
        Blocks with the same rows and the same target.
    symmetric
        Whether each also serves as the instrument of the other.
    """

    regressors: Block
    instruments: Block
    symmetric: bool = False


@dataclass(frozen=True)
class Instruments:
    """Rows whose errors are independent of the regressor's.

    Attributes
    ----------
    pairs
        Makes them, all recordings one after the other.
    describe
        What they are, for the estimate's details.
    drawn
        From the number of a draw: the same with further errors drawn from the regressor's law, if that is known.
    """

    pairs: Callable[[], Iterable[Pair]]
    describe: Callable[[], dict[str, Any]]
    drawn: Callable[[int], Iterable[Pair]] | None = None


@dataclass(frozen=True)
class RegressorNoise:
    """The law of the regressor's errors, as draws from it.

    Attributes
    ----------
    perturbed
        From the number of a draw and a sign: all blocks with that error, times the sign, added.
    simulated
        Blocks of a motion near the recorded one: without errors (None), or with those of a draw.
    pieces
        The same of a few thousand samples at most: evenly spread pieces of long recordings.
    misread
        From a number of draws and parameters (p,): what errors of each draw add to ``X b`` in the rows of `pieces`,
        ``misread(draws, b)[d][k]`` (rows, channels). Much less work than the regressors of these draws.
    present
        Whether there is any.
    describe
        How large it is, for the estimate's details.
    draws
        How many there are; None: any number.
    rung
        Whether something in the model rings with them, and makes much more of them than rigid bodies do.
    """

    perturbed: Callable[[int, float], Iterable[Block]]
    simulated: Callable[[int | None], Iterable[Block]]
    pieces: Callable[[int | None], Iterable[Block]]
    misread: Callable[[int, np.ndarray], list[list[np.ndarray]]]
    present: Callable[[], bool]
    describe: Callable[[], dict[str, Any]]
    draws: int | None = None
    rung: bool = False
