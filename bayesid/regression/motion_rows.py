"""Rows of every motion of an experiment, made once: the fit, its cross-checks and predictions read the same ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from threading import Lock

from bayesid.regression.blocks import Block
from bayesid.regression.row_cache import CACHE_BYTES
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks, row_chunks
from bayesid.regression.segment import LongSegment, Segment


class MotionRows:
    """Blocks of rows by motion, made when first read and kept while all that is kept fits in `CACHE_BYTES`."""

    def __init__(self, row_model: RowModel, segments: Mapping[str, Sequence[Segment | LongSegment]]):
        self.row_model, self.segments = row_model, segments
        self._kept: dict[str, tuple[Block, ...]] = {}
        self._room, self._lock = CACHE_BYTES, Lock()

    def __reduce__(self):
        """A copy makes its rows anew."""
        return MotionRows, (self.row_model, self.segments)

    def blocks(self, motions: Iterable[str]) -> Iterator[Block]:
        """Read the rows of motions, one after the other, in time order."""
        for name in motions:
            yield from self._kept[name] if name in self._kept else self._made(name)

    def _made(self, name: str) -> Iterator[Block]:
        segments = self.segments[name]
        model = self.row_model
        size = 8 * row_count(model, segments) * len(model.channels) * (model.base.rank + model.extra_columns + 1)
        with self._lock:
            keep = size <= self._room
            self._room -= size if keep else 0
        made, whole = [], False
        try:
            for block in make_blocks(model, segments, kept=keep):
                if keep:
                    made.append(block)
                yield block
            whole = True
        finally:
            with self._lock:
                if keep and whole and name not in self._kept:
                    self._kept[name] = tuple(made)
                else:  # not read to the end, or made by two threads at once
                    self._room += size if keep else 0


def row_parts(row_model: RowModel, segments: Sequence[Segment | LongSegment]) -> tuple[Callable[[], list[Block]], ...] | None:
    """The rows of segments in parts that can be made anywhere; None where no recording is read in chunks."""
    if not any(isinstance(s, LongSegment) for s in segments):
        return None
    parts: list[Callable[[], list[Block]]] = []
    for segment in segments:
        if isinstance(segment, LongSegment):
            parts += row_chunks(row_model, segment)
        else:
            parts.append(partial(_all_blocks, row_model, segment))
    return tuple(parts)


def _all_blocks(row_model: RowModel, segment: Segment) -> list[Block]:
    return list(make_blocks(row_model, [segment]))


def row_count(row_model: RowModel, segments: Sequence[Segment | LongSegment]) -> int:
    """How many rows `make_blocks` makes."""
    margin, step = row_model.margin, row_model.step
    moving = [s.ends[1] - s.ends[0] - s.lost(margin) - margin for s in segments if not s.poses]
    return sum(s.count for s in segments if s.poses) + sum(max(int(duration / step), 1) for duration in moving)
