import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event
from time import sleep

import numpy as np
import pytest

from bayesid.regression import row_cache
from bayesid.regression.blocks import Block
from bayesid.regression.row_cache import Kept, RowCache, few_of

ROWS, COUNT = 50, 40


def rows() -> RowCache:
    """Forty blocks of fifty rows; every number in a block is the block's."""

    def blocks():
        for k in range(COUNT):
            yield Block(np.full((ROWS, 2, 4), float(k)), np.arange(ROWS) + 100.0 * k, 0, k == 0)

    return RowCache(Kept(blocks), COUNT * ROWS, 8)


def order(blocks) -> list[int]:
    return [int(b.rows[0, 0, 0]) for b in blocks]


@pytest.fixture
def hasty():
    """Threads that take turns a million times a second."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_threads_that_read_at_once_all_see_every_block_once(hasty):
    threads, cache = 8, rows()
    gate = Barrier(threads)

    def read(_):
        gate.wait()
        return order(cache.blocks()), order(cache.pilot()), cache.derived("sum", lambda: object())

    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(read, range(threads)))
    assert all(blocks == pilot == list(range(COUNT)) for blocks, pilot, _ in found)
    assert all(a is b for a, b in zip(cache.blocks(), cache.pilot(), strict=True))
    assert len({id(made) for *_, made in found}) == 1


def test_rows_are_kept_and_said_to_be_only_while_they_fit(monkeypatch):
    cache = rows()
    first = list(cache.blocks())
    assert cache.fits_in_memory and all(a is b for a, b in zip(first, cache.blocks(), strict=True))
    monkeypatch.setattr(row_cache, "CACHE_BYTES", 0)
    assert not rows().fits_in_memory


def test_a_reading_given_up_half_way_keeps_nothing():
    cache = rows()
    begun = next(cache.blocks())
    again = list(cache.blocks())
    assert again[0] is not begun and order(again) == list(range(COUNT)) and next(cache.blocks()) is again[0]


def test_another_pilot_is_learned_from_anew():
    cache = rows()
    assert cache.derived("weights", lambda: "old") == "old"
    other = cache.with_pilot(list(cache.blocks())[3:5])
    assert order(other.pilot()) == [3, 4] and other.derived("weights", lambda: "new") == "new"
    assert order(other.blocks()) == list(range(COUNT))
    assert order(cache.pilot()) == list(range(COUNT)) and cache.derived("weights", lambda: "new") == "old"


def test_what_two_threads_want_is_made_once_and_the_second_waits():
    cache, made = rows(), []
    begun = Event()

    def make():
        begun.set()
        made.append(1)
        sleep(0.05)
        return cache.derived("pilot", lambda: "pilot"), "weights"

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(cache.derived, "weights", make)
        assert begun.wait(10.0)
        second = pool.submit(cache.derived, "weights", make)
        assert first.result(10.0) is second.result(10.0)
    assert made == [1]


def test_what_failed_to_be_made_is_made_at_the_next_call():
    cache = rows()

    def fails():
        raise ValueError("once")

    with pytest.raises(ValueError, match="once"):
        cache.derived("weights", fails)
    assert cache.derived("weights", lambda: 2) == 2


def test_few_rows_are_all_taken_and_many_evenly_spread():
    blocks = list(rows().blocks())
    assert order(few_of(iter(blocks), COUNT * ROWS)) == list(range(COUNT))
    many = [Block(np.full((1000, 1, 2), float(k)), np.arange(1000.0), 0, False) for k in range(16)]
    taken = list(few_of(iter(many), 16_000))
    assert [int(b.rows[0, 0, 0]) for b in taken] == list(range(0, 16, 2)) and {len(b.rows) for b in taken} == {256}
