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
    """Consecutive rows of one recording."""

    rows: np.ndarray  # regressor columns and, last, the target (k, channels, p + 1)
    times: np.ndarray  # (k,) [s]
    motion: int  # index of the recording
    start: bool  # whether the recording (or a segment after a gap) starts with the first row
    group: str = "trajectory"  # rows with the same noise: ``trajectory`` or ``poses``

    @property
    def matrix(self) -> np.ndarray:
        """Regressor (k, channels, p)."""
        return self.rows[:, :, :-1]

    @property
    def target(self) -> np.ndarray:
        """What was measured (k, channels)."""
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
    """The same rows of two trajectories: regressors, and instruments for them."""

    #: Blocks with the same rows and the same target.
    regressors: Block
    instruments: Block
    symmetric: bool = False  # whether each also serves as the instrument of the other


@dataclass(frozen=True)
class Instruments:
    """Rows whose errors are independent of the regressor's."""

    pairs: Callable[[], Iterable[Pair]]  # makes them, all recordings one after the other
    describe: Callable[[], dict[str, Any]]  # what they are, for the estimate's details
    #: From the number of a draw: the same with further errors drawn from the regressor's law, if that is known.
    drawn: Callable[[int], Iterable[Pair]] | None = None


@dataclass(frozen=True)
class RegressorNoise:
    """The law of the regressor's errors, as draws from it."""

    #: From the number of a draw and a sign: all blocks with that error, times the sign, added.
    perturbed: Callable[[int, float], Iterable[Block]]
    #: Blocks of a motion near the recorded one: without errors (None), or with those of a draw.
    simulated: Callable[[int | None], Iterable[Block]]
    #: The same of a few thousand samples at most: evenly spread pieces of long recordings.
    pieces: Callable[[int | None], Iterable[Block]]
    #: From a number of draws and parameters (p,): what errors of each draw add to ``X b`` in the rows of `pieces`,
    #: ``misread(draws, b)[d][k]`` (rows, channels). Much less work than the regressors of these draws.
    misread: Callable[[int, np.ndarray], list[list[np.ndarray]]]
    present: Callable[[], bool]  # whether there is any
    describe: Callable[[], dict[str, Any]]  # how large it is, for the estimate's details
    draws: int | None = None  # how many there are; None: any number
    rung: bool = False  # whether something in the model rings with them, and makes much more of them than rigid bodies do
