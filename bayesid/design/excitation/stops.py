"""The static run: where the robot stops, when it is read, and how long that takes.

The paper stops at every sampling position of the motion, for the wrench at rest is to be subtracted sample by sample
[Liu1998]_. A motion that repeats needs one period of stops only, whose readings serve every period; and a motion's gravity
wrench is so smooth that fewer stops, fitted along as poses, tell as much. From stop to stop the joints move with a polynomial of
degree five, ``T = max(1.875 |d| / speed, sqrt(5.774 |d| / acceleration))``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.arguments import argument
from bayesid.design.excitation.limits import Limits
from bayesid.design.excitation.series import FourierSeries
from bayesid.errors import InputError

#: Peak speed and acceleration of the polynomial of degree five from rest to rest, for a way and time of one.
_SPEED, _ACCELERATION = 1.875, 10.0 / np.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class StopAndGo:
    """Stops of a static run."""

    positions: np.ndarray  # where the robot stops (k, n) [rad or m]
    #: Times at which it arrives, and between which it is read (k,) [s].
    arrive: np.ndarray
    start: np.ndarray
    end: np.ndarray
    rows: np.ndarray  # row of ``trajectory.csv`` that each stop belongs to (k,)
    every_sample: bool  # whether every sample of the motion has its stop, so that readings can be subtracted row by row

    @property
    def seconds(self) -> float:
        """How long the run takes [s]."""
        return float(self.end[-1])

    def __repr__(self) -> str:
        return f"<StopAndGo: {len(self.rows)} stops, {self.seconds / 60:.1f} min>"


def stop_and_go(
    series: FourierSeries, limits: Limits, rate: float, *, stops: int | None = None, settle: float = 0.3, read: float = 0.2
) -> StopAndGo:
    """Schedule of a static run over one period, refused with an `InputError` where a number is out of range.

    ``rate`` is that of the motion's samples [1/s], ``stops`` how many there are, evenly in time (None: at every sample),
    ``settle`` and ``read`` how long the robot waits before a reading and how long it is read [s].
    """
    samples = int(round(series.period * rate))
    if stops is not None and not 2 <= stops <= samples:
        raise InputError(f"{argument('stops', stops)}: give 2 to {samples}, the samples of a period")
    for name, value in (("settle", settle), ("read", read)):
        if not (np.isfinite(value) and value >= 0):
            raise InputError(f"{argument(name, value)}: give a time in seconds, 0 or more")
    count = samples if stops is None else stops
    rows = np.round(np.linspace(0, samples, count, endpoint=False)).astype(int)
    q = series.at(rows / rate)[0]
    m = limits.moving
    way = np.abs(np.diff(q, axis=0))[:, m]
    moves = np.maximum(_SPEED * way / limits.speed[m], np.sqrt(_ACCELERATION * way / limits.acceleration[m])).max(axis=1)
    arrive = np.concatenate([[0.0], np.cumsum(moves + settle + read)])
    return StopAndGo(q, arrive, arrive + settle, arrive + settle + read, rows, len(rows) == samples)
