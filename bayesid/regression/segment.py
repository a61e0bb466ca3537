"""One gap-free segment of a recording, in memory or in its file, or of a planned motion, ready to be turned into rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from bayesid.recordings.stored import StoredTable
from bayesid.recordings.table import usual_step

#: A segment starts at rest if in so long a time [s] joints move by no more than this share of the most in such a time.
_REST, _STILL = 0.1, 0.01


@dataclass(frozen=True)
class Segment:
    """One gap-free segment of a recording, ready to be turned into rows."""

    #: (N,) [s] and encoder positions (N, n) [rad or m].
    times: np.ndarray
    positions: np.ndarray
    readings: np.ndarray  # what the channels read (N, channels)
    known: np.ndarray  # what of it is known, a static run's readings (N, channels) or a constant (channels,)
    motion: int  # index of the recording
    gravity: bool = True  # False for a motion wrench, from which gravity has been subtracted
    offset: bool = True  # whether a sensor's constant offset is in it
    poses: bool = False  # whether every sample is a pose at rest of its own
    commanded: np.ndarray | None = None  # commanded positions (N, n), if they were recorded
    period: float | None = None  # the motion repeats with it [s], if it does
    #: Velocities and accelerations of a planned motion (2, N, n) [rad/s or m/s, and per second]; None: positions are smoothed.
    rates: np.ndarray | None = None
    #: Time that what rings needs to forget how the robot was moving when the segment starts, unless it starts at rest [s].
    settling: float = 0.0
    in_turn: bool = False  # as in `bayesid.effects.MotionSegment`
    #: Whether effects that happen once may have happened in it: not at rest, nor in a motion that is there to be predicted.
    events: bool = True

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.times)

    @property
    def step(self) -> float:
        """Usual time between samples [s]."""
        return usual_step(self.times)

    @property
    def ends(self) -> tuple[float, float]:
        """Times of the first and the last sample [s]."""
        return float(self.times[0]), float(self.times[-1])

    def measured(self, first: int, last: int) -> np.ndarray:
        """Readings of samples first ... last - 1 less what is known (k, channels)."""
        return self.readings[first:last] - (self.known if self.known.ndim == 1 else self.known[first:last])

    def index(self, time: float, side: Literal["left", "right"] = "left") -> int:
        """Where a time [s] would be inserted among the samples', as `numpy.searchsorted` says it."""
        return int(np.searchsorted(self.times, time, side=side))

    def lost(self, margin: float) -> float:
        """Time that is lost at the start where a margin [s] is lost at the end."""
        return margin if self.settling <= margin or self._starts_at_rest else self.settling

    @property
    def _starts_at_rest(self) -> bool:
        """Whether the joints move `_REST` s from the start by next to nothing of what they do in such a time at most."""
        later = min(int(np.searchsorted(self.times, self.times[0] + _REST)), len(self.times) - 1)
        moved = np.linalg.norm(self.positions[later:] - self.positions[: len(self.positions) - later], axis=1)
        return bool(moved[0] <= _STILL * moved.max())

    def inner(self, margin: float) -> tuple[int, int]:
        """First and last sample (exclusive) that are a time [s] from both ends, and have settled; the same where none is."""
        first = self.index(self.times[0] + self.lost(margin))
        last = self.index(self.times[-1] - margin, "right")
        return first, max(first, last)

    def part(self, first: int, last: int) -> Segment:
        """Samples first ... last - 1 as a segment of their own."""
        span = slice(first, last)
        known = self.known if self.known.ndim == 1 else self.known[span]
        return replace(
            self, times=self.times[span], positions=self.positions[span], readings=self.readings[span], known=known,
            commanded=None if self.commanded is None else self.commanded[span],
            rates=None if self.rates is None else self.rates[:, span],
        )  # fmt: skip


#: Samples that show whether a segment starts at rest.
_FIRST = 100_000


@dataclass(frozen=True, eq=False)
class LongSegment:
    """One gap-free segment of a table that is read in chunks; samples count from its own first."""

    stored: StoredTable  # the table
    #: Its samples first ... last - 1 of the table.
    first: int
    last: int
    groups: tuple[str, ...]  # which readings the channels are: ``wrench``, ``torques`` or both
    torque_joints: tuple[int, ...]  # joints whose torques are read
    known: np.ndarray  # what of every reading is known (channels,)
    motion: int  # index of the recording
    offset: bool = True  # whether a sensor's constant offset is in it
    settling: float = 0.0  # as of a `Segment` [s]
    poses = False
    gravity = True
    commanded = None
    period = None
    rates = None

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.last - self.first

    @cached_property
    def step(self) -> float:
        """Usual time between samples [s]."""
        return usual_step(self.part(0, 1 << 17).times)

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Times of the first and the last sample [s]."""
        return self.time(0), self.time(self.count - 1)

    def time(self, sample: int) -> float:
        """Time of a sample [s]."""
        at = self.first + sample
        return float(self.stored.read(at, at + 1)["t"][0, 0])

    def index(self, time: float, side: Literal["left", "right"] = "left") -> int:
        """Where a time [s] would be inserted among the samples', as `numpy.searchsorted` says it."""
        return min(max(self.stored.index(time, side) - self.first, 0), self.count)

    def part(self, first: int, last: int) -> Segment:
        """Samples first ... last - 1, read into a segment of their own."""
        first, last = max(first, 0), min(last, self.count)
        table = self.stored.table(self.first + first, self.first + last)
        read = {"wrench": table.wrench, "torques": None if table.torques is None else table.torques[:, self.torque_joints]}
        readings = [part for group in self.groups if (part := read[group]) is not None]
        return Segment(
            table.times, table.positions, readings[0] if len(readings) == 1 else np.hstack(readings), self.known, self.motion,
            offset=self.offset, settling=self.settling,
        )  # fmt: skip

    def lost(self, margin: float) -> float:
        """Time that is lost at the start where a margin [s] is lost at the end."""
        return margin if self.settling <= margin else self.part(0, _FIRST).lost(margin)

    def inner(self, margin: float) -> tuple[int, int]:
        """First and last sample (exclusive) that are a time [s] from both ends, and have settled; the same where none is."""
        begin, end = self.ends
        first, last = self.index(begin + self.lost(margin)), self.index(end - margin, "right")
        return first, max(first, last)
