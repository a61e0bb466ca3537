"""Where the rows come from, and which of them are kept.

Nothing of the size samples x parameters is ever held: rows are kept only while they fit in `CACHE_BYTES`; otherwise
every reading makes them anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from threading import Lock, RLock
from typing import Any, TypeVar

import numpy as np

from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.tasks import fold, map_tasks

_A = TypeVar("_A")

#: Rows are kept in memory up to this many bytes, and made anew at every reading beyond.
CACHE_BYTES = 64 * 2**20
#: About as many rows as the noise is learned from, in this many segments spread over a long recording.
PILOT_ROWS = 2048
PILOT_SEGMENTS = 8


@dataclass(eq=False, repr=False)
class RowCache:
    """Rows, made when they are read and kept while they fit, with what depends on them alone.

    Several threads may read at once: the rows of the first to finish are kept.
    """

    make: Callable[[], Iterable[Block]]  # makes all blocks; called anew for every reading unless they were kept
    count: int  # number of rows in all blocks
    width: int  # numbers in a row: channels times (parameters + 1)
    #: Makes blocks of a few segments alone, where there are many more rows than `PILOT_ROWS`; None: picked from all blocks.
    make_pilot: Callable[[], Iterable[Block]] | None = None
    #: Poles of the low-pass filters that the rows went through from the zero state, at the rows' spacing.
    known_poles: np.ndarray | None = None
    #: Of recordings that are read in chunks: make some of the blocks each, anywhere; together, in order, all of them.
    parts: Sequence[Callable[[], Iterable[Block]]] | None = None
    #: Blocks that are in memory, all of them and those of the pilot; None: not made yet, or too many.
    kept: tuple[Block, ...] | None = None
    kept_pilot: tuple[Block, ...] | None = None

    def __post_init__(self) -> None:
        """Begin with nothing derived."""
        self._lock, self._derived, self._making = Lock(), dict[str, Any](), dict[str, RLock]()

    def __reduce__(self):
        """A copy reads its rows anew."""
        return RowCache, (self.make, self.count, self.width, self.make_pilot, self.known_poles, self.parts)

    @property
    def fits_in_memory(self) -> bool:
        """Whether the blocks are few enough to be kept after the first reading."""
        return 8 * self.count * self.width <= CACHE_BYTES

    def blocks(self) -> Iterator[Block]:
        """Read all blocks, recording by recording, in time order."""
        if self.kept is not None:
            yield from self.kept
            return
        made = []
        for block in self.make():
            if self.fits_in_memory:
                made.append(block)
            yield block
        if self.fits_in_memory:
            with self._lock:
                self.kept = self.kept or tuple(made)

    def total(self, each: Callable[[Block], _A], add: Callable[[_A, _A], _A]) -> _A:
        """Sum of what each block gives, from all cores; of recordings that are read in chunks, a task a chunk.

        ``add`` adds what two neighbours, or sums of neighbours, gave.
        """
        if self.parts is None:
            return reduce(add, in_order(each, self.blocks()))
        return fold(map_tasks(partial(_part_total, each, add), self.parts), add)

    def pilot(self) -> Sequence[Block]:
        """Enough blocks to learn the noise from: all of an ordinary recording, segments of a long one."""
        if self.kept_pilot is None:
            made = tuple(self._make_pilot())
            with self._lock:
                self.kept_pilot = self.kept_pilot or made
        return self.kept_pilot

    def _make_pilot(self) -> Iterable[Block]:
        if self.count <= 2 * PILOT_ROWS or self.fits_in_memory or self.make_pilot is None:
            return few_of(self.blocks(), self.count)
        return self.make_pilot()

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
        return replace(self, kept=None, kept_pilot=tuple(pilot))


def _part_total(each: Callable[[Block], _A], add: Callable[[_A, _A], _A], part: Callable[[], Iterable[Block]]) -> _A:
    return reduce(add, in_order(each, part()))


def few_of(blocks: Iterable[Block], rows: int) -> Iterator[Block]:
    """All blocks where they hold few rows, else about `PILOT_ROWS` of them, evenly spread."""
    return iter(blocks) if rows <= 2 * PILOT_ROWS else spread(blocks, rows)


def spread(blocks: Iterable[Block], rows: int) -> Iterator[Block]:
    """About `PILOT_ROWS` rows: segments at the starts of blocks, as evenly spread as these are. Reads all blocks."""
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
