"""Where the rows come from, and which of them are kept: the fit, its cross-checks and predictions read the same ones.

Nothing of the size samples x parameters is ever held: rows are kept only while they fit in `CACHE_BYTES`; otherwise
every reading makes them anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import chain
from threading import Lock, RLock
from typing import Any, TypeVar

import numpy as np

from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks, row_chunks
from bayesid.regression.segment import LongSegment, Segment
from bayesid.tasks import fold, map_tasks

_A = TypeVar("_A")

#: Rows of a fit are kept in memory up to this many bytes, and those of other motions up to as many; made anew beyond.
CACHE_BYTES = 64 * 2**20
#: About as many rows as the noise is learned from, in this many segments spread over a long recording.
PILOT_ROWS = 2048
PILOT_SEGMENTS = 8


class Kept:
    """Blocks, made at the first reading and kept if that is read to its end; of threads that read at once, those of the first."""

    def __init__(self, make: Callable[[], Iterable[Block]]):
        self._make, self._kept, self._lock = make, None, Lock()

    def __reduce__(self):
        """A copy makes its rows anew."""
        return Kept, (self._make,)

    def __call__(self) -> Iterator[Block]:
        """Read all blocks."""
        if self._kept is not None:
            yield from self._kept
            return
        made = []
        for block in self._make():
            made.append(block)
            yield block
        with self._lock:
            self._kept = self._kept or tuple(made)


class MotionRows:
    """Blocks of rows by motion, kept as far as there is room: for motions that are ``fitted``, and as much for others."""

    def __init__(self, row_model: RowModel, segments: Mapping[str, Sequence[Segment | LongSegment]], fitted: Sequence[str] = ()):
        self.row_model, self.segments = row_model, segments
        self._blocks: dict[str, Callable[[], Iterable[Block]]] = {}
        room = {own: CACHE_BYTES for own in (True, False)}
        for name in segments:
            own, size = name in fitted, 8 * row_count(row_model, segments[name]) * len(row_model.channels) * row_model.width
            keep = size <= room[own]
            room[own] -= size if keep else 0
            make = partial(make_blocks, row_model, segments[name], kept=keep)
            self._blocks[name] = Kept(make) if keep else make

    def blocks(self, motions: Iterable[str]) -> Iterator[Block]:
        """Read the rows of motions, one after the other, in time order."""
        return chain.from_iterable(self._blocks[name]() for name in motions)


def row_parts(row_model: RowModel, segments: Sequence[Segment | LongSegment]) -> tuple[Callable[[], Iterable[Block]], ...] | None:
    """The rows of segments in parts that can be made anywhere; None where no recording is read in chunks."""
    if not any(isinstance(s, LongSegment) for s in segments):
        return None
    parts: list[Callable[[], Iterable[Block]]] = []
    for segment in segments:
        if isinstance(segment, LongSegment):
            parts += [chunk.blocks for chunk in row_chunks(row_model, segment)]
        else:
            parts.append(partial(make_blocks, row_model, [segment]))
    return tuple(parts)


def row_count(row_model: RowModel, segments: Sequence[Segment | LongSegment]) -> int:
    """How many rows `make_blocks` makes."""
    margin, step = row_model.margin, row_model.step
    moving = [s.ends[1] - s.ends[0] - s.lost(margin) - margin for s in segments if not s.poses]
    return sum(s.count for s in segments if s.poses) + sum(max(int(duration / step), 1) for duration in moving)


@dataclass(eq=False, repr=False)
class RowCache:
    """Rows of a regression, with what depends on them alone, which is made once; several threads may read at once."""

    blocks: Callable[[], Iterator[Block]]  # reads all blocks, recording by recording, in time order
    count: int  # number of rows in all blocks
    width: int  # numbers in a row: channels times (parameters + 1)
    #: Makes blocks of a few segments alone, where there are many more rows than `PILOT_ROWS`; None: picked from all blocks.
    make_pilot: Callable[[], Iterable[Block]] | None = None
    #: Poles of the low-pass filters that the rows went through from the zero state, at the rows' spacing.
    known_poles: np.ndarray | None = None
    #: Of recordings that are read in chunks: make some of the blocks each, anywhere; together, in order, all of them.
    parts: Sequence[Callable[[], Iterable[Block]]] | None = None
    given_pilot: tuple[Block, ...] | None = None  # blocks of the pilot in place of those

    def __post_init__(self) -> None:
        """Begin with nothing derived."""
        self._lock, self._derived, self._making = Lock(), dict[str, Any](), dict[str, RLock]()

    def __reduce__(self):
        """A copy reads its rows anew."""
        return RowCache, (self.blocks, self.count, self.width, self.make_pilot, self.known_poles, self.parts, self.given_pilot)

    @property
    def fits_in_memory(self) -> bool:
        """Whether the blocks are few enough to be kept after the first reading."""
        return 8 * self.count * self.width <= CACHE_BYTES

    def total(self, each: Callable[[Block], _A], add: Callable[[_A, _A], _A]) -> _A:
        """Sum of what each block gives, from all cores; of recordings that are read in chunks, a task a chunk.

        ``add`` adds what two neighbours, or sums of neighbours, gave.
        """
        if self.parts is None:
            return reduce(add, in_order(each, self.blocks()))
        return fold(map_tasks(partial(_part_total, each, add), self.parts), add)

    def pilot(self) -> Sequence[Block]:
        """Enough blocks to learn the noise from: all of an ordinary recording, segments of a long one."""

        def made() -> tuple[Block, ...]:
            if self.make_pilot is None or self.fits_in_memory or self.count <= 2 * PILOT_ROWS:
                return tuple(few_of(self.blocks(), self.count))
            return tuple(self.make_pilot())

        return self.derived("pilot_blocks", made) if self.given_pilot is None else self.given_pilot

    def few(self) -> Sequence[Block]:
        """Blocks of about `PILOT_ROWS` rows at most: all of a short recording, segments of a longer one."""
        return self.pilot() if self.make_pilot is None or self.count <= PILOT_ROWS else tuple(self.make_pilot())

    def derived(self, name: str, make: Callable[[], Any]) -> Any:
        """What ``make`` gives, made at the first call only: estimators share what depends on the rows alone.

        A thread that wants what another one is making waits for it.
        """
        with self._lock:
            making = self._making.setdefault(name, RLock())
        with making:
            if name not in self._derived:
                self._derived[name] = make()
            return self._derived[name]

    def with_pilot(self, pilot: Sequence[Block]) -> RowCache:
        """The same rows with another pilot, of which nothing has been learned yet."""
        return replace(self, given_pilot=tuple(pilot))


def _part_total(each: Callable[[Block], _A], add: Callable[[_A, _A], _A], part: Callable[[], Iterable[Block]]) -> _A:
    return reduce(add, in_order(each, part()))


def few_of(blocks: Iterable[Block], rows: int) -> Iterator[Block]:
    """All blocks where they hold few rows, else about `PILOT_ROWS` of them, as evenly spread as the blocks' starts. Reads all."""
    if rows <= 2 * PILOT_ROWS:
        yield from blocks
        return
    segment, spacing = PILOT_ROWS // PILOT_SEGMENTS, rows / PILOT_SEGMENTS
    seen, due = 0, 0.0
    for block in blocks:
        count = 0
        while due < seen + len(block.rows):
            count, due = count + 1, due + spacing
        seen += len(block.rows)
        if count:
            keep = slice(0, count * segment)
            yield replace(block, rows=block.rows[keep], times=block.times[keep])
