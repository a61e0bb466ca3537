"""A gap-free segment of a recording that is read in chunks: what a `Segment` is, but for the samples, which stay in the file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from bayesid.recordings.stored import StoredTable
from bayesid.recordings.table import usual_step
from bayesid.regression.segment import Segment

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
