"""A few hundred smooth samples of a recording: joint motion and readings in one low band, without delay."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.recordings.experiment import Experiment
from bayesid.regression.readings import has_readings, readings_of
from bayesid.signals.smoothing import smooth

#: Joint motion and readings are kept up to here [Hz]: gravity, inertia and friction of any arm show below.
BANDWIDTH = 5.0
#: Samples in all; enough for every parameter of a seven-joint arm four times over.
_SAMPLES = 300
_POSES = 100
_SHORTEST = 4.0 / BANDWIDTH
MARGIN = 0.75 / BANDWIDTH  # the ends of a spline are loose: there it has data on one side only [s]
#: Of a long recording, so many samples are smoothed, in pieces spread over it.
_SMOOTHED = 40_000
_PIECES = 8
#: Index of the recording, times, positions, readings.
_Piece = tuple[int, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Samples:
    """Joint motion and readings at ``N`` instants."""

    #: (N, n) [rad or m, and per second (squared)]; zero rates for poses at rest.
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    readings: np.ndarray  # what the channels read, nothing subtracted (N, c)
    #: Which gap-free piece and which recording each is from (N,): a sensor may have been zeroed in between.
    part: np.ndarray
    motion: np.ndarray

    def __len__(self) -> int:
        return len(self.part)

    @cached_property
    def quarter(self) -> np.ndarray:
        """Which quarter of its recording each is from (N,)."""
        out = np.empty(len(self), int)
        for motion in np.unique(self.motion):
            rows = np.flatnonzero(self.motion == motion)
            out[rows] = 4 * np.arange(len(rows)) // len(rows)
        return out


def low_passed(experiment: Experiment, channel: str) -> Samples | None:
    """Samples of all motions, spread over them; None where there are not enough.

    Readings go through the same least-squares spline as positions: both keep what is below `BANDWIDTH`, and neither is delayed.
    """
    pieces: list[_Piece] = []
    poses: list[tuple[int, np.ndarray, np.ndarray]] = []
    for index, motion in enumerate(experiment.motions):
        table = motion.table
        if not has_readings(table, channel):
            continue
        read = readings_of(experiment, table, channel)
        if motion.kind == "poses":
            poses.append((index, table.positions, read))
        else:
            pieces += [(index, table.times[p], table.positions[p], read[p]) for p in table.segments()]
        if channel == "wrench" and motion.static is not None and motion.static.wrench is not None:
            poses.append((index, motion.static.positions, motion.static.wrench))
    samples = sum(len(piece[1]) for piece in pieces)
    pieces = [p for piece in pieces for p in _thinned(piece, _SMOOTHED * len(piece[1]) // samples)]
    pieces = [p for p in pieces if _duration(p) > _SHORTEST]
    whole = sum(map(_duration, pieces))
    parts = [_smoothed(piece, max(int(_SAMPLES * _duration(piece) / whole), 2)) for piece in pieces]
    for _, q, read in poses:
        rows = slice(None, None, max(len(q) // _POSES, 1))
        still = np.zeros_like(q[rows])
        parts.append((q[rows], still, still, read[rows]))
    if not parts:
        return None
    counts = [len(p[0]) for p in parts]
    motions = [p[0] for p in pieces] + [p[0] for p in poses]
    q, v, a, read = (np.concatenate([p[k] for p in parts]) for k in range(4))
    return Samples(q, v, a, read, np.repeat(np.arange(len(parts)), counts), np.repeat(motions, counts))


def _smoothed(piece: _Piece, count: int) -> tuple[np.ndarray, ...]:
    """So many samples of a piece: positions, velocities, accelerations, readings."""
    _, times, positions, read = piece
    both, rates, bends = splined(times, np.hstack([positions, read]), np.linspace(times[0] + MARGIN, times[-1] - MARGIN, count))
    n = positions.shape[1]
    return both[:, :n], rates[:, :n], bends[:, :n], both[:, n:]


def splined(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (N, k) of times (N,) in the low band, their first and second derivatives, at other times (m,): (m, k) each."""
    bandwidth = min(BANDWIDTH, 0.2 * (len(times) - 1) / float(times[-1] - times[0]))
    centre = values.mean(axis=0)
    smoothed, rates, bends = smooth(times, values - centre, bandwidth, at=at)
    return smoothed + centre, rates, bends


def _duration(piece: _Piece) -> float:
    return float(piece[1][-1] - piece[1][0])


def _thinned(piece: _Piece, allowed: int) -> list[_Piece]:
    """Up to so many samples of a piece, in runs spread over it."""
    motion, times, positions, read = piece
    if len(times) <= allowed:
        return [piece]
    length = max(allowed // _PIECES, 2)
    starts = np.linspace(0, len(times) - length, _PIECES).astype(int)
    return [(motion, times[a : a + length], positions[a : a + length], read[a : a + length]) for a in starts]
