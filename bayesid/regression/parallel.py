"""Independent jobs on all cores, with results in order; one Python thread a core, for more would only wait for each other."""

from __future__ import annotations

import functools
import importlib
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from itertools import chain, islice
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from bayesid.tasks import in_task

_A = TypeVar("_A")
_B = TypeVar("_B")


#: More threads than these gain nothing: the work between compiled functions is one thread's at a time.
_MOST = 8


class _Working:
    """How many jobs of `in_order` and `both` are being done, in all threads."""

    def __init__(self) -> None:
        self._lock, self._all, self._here = threading.Lock(), 0, threading.local()

    def change(self, by: int) -> None:
        """So many more are being done, or are about to be."""
        with self._lock:
            self._all += by

    def __call__(self, job: Callable, *arguments):
        """Do a job that `change` has counted."""
        before, self._here.works = getattr(self._here, "works", 0), 1
        try:
            return job(*arguments)
        finally:
            self._here.works = before
            self.change(-1)

    def here(self, job: Callable[[], _A]) -> _A:
        """Do a job in this thread, counted unless the thread's own is."""
        if getattr(self._here, "works", 0):
            return job()
        self.change(1)
        return self(job)

    def cores(self, own: int = 0) -> int:
        """Cores for the thread that asks and for so many jobs that it has given to others already."""
        if in_task():  # of a cluster, which has a process for every core
            return 1
        others = self._all - getattr(self._here, "works", 0) - own
        return min(os.cpu_count() or 1, _MOST) - others


_working = _Working()


def _submit(pool: ThreadPoolExecutor, job: Callable, *arguments) -> Future:
    """Give a job to a pool; it counts from now on."""
    _working.change(1)
    try:
        return pool.submit(_working, job, *arguments)
    except BaseException:
        _working.change(-1)
        raise


@functools.cache
def _libraries() -> ThreadpoolController:
    importlib.import_module("scipy.linalg")  # its own library of linear algebra has to be there to be found
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager:
    """While this lasts, linear algebra stays in the thread that calls it: the matrices are small, and the cores busy anyway."""
    return _libraries().limit(limits=1, user_api="blas")


def in_order(work: Callable, jobs: Iterable) -> Iterator:
    """Results in order from a few threads, with only a few results waiting at any time; a single job needs none.

    While other jobs keep the cores busy, such as those that this is called in or beside, a job is done by the thread that asks.
    """
    jobs = iter(jobs)
    first = list(islice(jobs, 2))
    if len(first) < 2:
        yield from map(work, first)
        return
    waiting: deque[Future] = deque()
    pool: ThreadPoolExecutor | None = None
    with ExitStack() as stack:
        for job in chain(first, jobs):
            while (cores := _working.cores(sum(not future.done() for future in waiting))) < 2 and waiting:
                yield waiting.popleft().result()
            if cores < 2:
                yield work(job)
                continue
            pool = pool or stack.enter_context(ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST)))
            waiting.append(_submit(pool, work, job))
            if len(waiting) > cores:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def both(one: Callable[[], _A], other: Callable[[], _B]) -> tuple[_A, _B]:
    """Results of two jobs that run at once, as in `in_order`; where both fail, the first one's error is raised."""
    if _working.cores() < 2:
        return one(), other()
    with ThreadPoolExecutor(1) as pool:
        waiting = _submit(pool, other)
        return _working.here(one), waiting.result()
