"""Independent jobs on all cores, with results in order."""

from __future__ import annotations

import functools
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from itertools import chain, islice
from typing import TypeVar

import scipy.linalg  # noqa: F401 -- its library must be there when the libraries are looked up
from threadpoolctl import ThreadpoolController

_A = TypeVar("_A")
_B = TypeVar("_B")


#: Whether the thread works for a call of `in_order` or `both` that keeps all cores busy.
_here = threading.local()


def _mark() -> None:
    _here.helps = True


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager:
    """While this lasts, linear algebra stays in the thread that calls it: the matrices are small, and the cores busy anyway."""
    return _libraries().limit(limits=1, user_api="blas")


def in_order(work: Callable, jobs: Iterable) -> Iterator:
    """Results in order from a few threads, with only a few results waiting at any time; a single job needs none.

    Jobs that call this or `both` themselves do their own jobs one after the other where there are enough of them for all cores:
    more threads would only wait for each other.
    """
    threads = min(os.cpu_count() or 1, 8)
    jobs = iter(jobs)
    first = list(islice(jobs, max(threads, 2)))
    if len(first) < 2 or getattr(_here, "helps", False):
        yield from map(work, chain(first, jobs))
        return
    with ThreadPoolExecutor(threads, initializer=_mark if len(first) >= threads else None) as pool:
        waiting: deque = deque()
        for job in chain(first, jobs):
            waiting.append(pool.submit(work, job))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def both(one: Callable[[], _A], other: Callable[[], _B]) -> tuple[_A, _B]:
    """Results of two jobs that run at once, as in `in_order`; where both fail, the first one's error is raised."""
    if getattr(_here, "helps", False):
        return one(), other()
    with ThreadPoolExecutor(1, initializer=_mark if (os.cpu_count() or 1) <= 2 else None) as pool:
        waiting = pool.submit(other)
        return one(), waiting.result()
