"""Independent jobs on all cores, with results in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

_A = TypeVar("_A")
_B = TypeVar("_B")


def in_order(work: Callable, jobs: Iterable) -> Iterator:
    """Results in order from a few threads, with only a few results waiting at any time; a single job needs none."""
    threads = min(os.cpu_count() or 1, 8)
    jobs = iter(jobs)
    few = list(islice(jobs, 2))
    if len(few) < 2:
        yield from map(work, few)
        return
    jobs = chain(few, jobs)
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque = deque()
        for job in jobs:
            waiting.append(pool.submit(work, job))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def both(one: Callable[[], _A], other: Callable[[], _B]) -> tuple[_A, _B]:
    """Results of two jobs that run at once; where both fail, the first one's error is raised."""
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(other)
        return one(), waiting.result()
