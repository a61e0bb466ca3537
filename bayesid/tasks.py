"""Independent tasks, here or on the processes of a Dask cluster: results in order, the same wherever they are computed."""

from __future__ import annotations

import contextlib
import functools
import importlib
import itertools
import logging
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from bayesid.arguments import argument
from bayesid.errors import EstimationError, InputError, required

_A = TypeVar("_A")
_B = TypeVar("_B")

#: Tasks that wait at a worker while it does one: it need not wait for the next, and results that come early are few.
_AHEAD = 4
#: Times a task is given out again after the process that did it was lost.
_LOST = 5
#: How long a scheduler is waited for [s].
_PATIENCE = 30
#: Partial results that are added at once.
ARITY = 8

_clients: list[Any] = []  # of every thread, for a verb has several
_inside = threading.local()


def in_task() -> bool:
    """Whether this thread does a task of a cluster: other processes have the other cores."""
    return getattr(_inside, "task", False)


def on_cluster() -> bool:
    """Whether `map_tasks` gives tasks to other processes here."""
    return bool(_clients) and not in_task()


@contextlib.contextmanager
def cluster(workers: int | None = None, scheduler: str | None = None) -> Iterator[None]:
    """While this lasts, `map_tasks` gives its tasks to ``workers`` processes of this machine, or to those of a ``scheduler``.

    None or 1 is nothing but this process. A scheduler is given by its address, such as ``tcp://10.0.0.1:8786``; its workers need
    the same version of bayesid, and files of recordings under the same path. An `InputError` where both are given, Dask is not
    installed, or no scheduler answers at the address.
    """
    if workers is not None and (not hasattr(workers, "__index__") or workers < 1):
        raise InputError(f"{argument('workers', workers)}: give a number of processes of at least 1")
    if scheduler is not None and workers is not None:
        raise InputError(f"{argument('workers')} and {argument('scheduler')} are both given: a cluster has workers of its own")
    if scheduler is None and workers in (None, 1):
        yield
        return
    distributed = _distributed()
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        # What tasks need is sent with them, so that a lost worker's can be done by another.
        warnings.filterwarnings("ignore", message="Sending large graph")
        # Ports and directories of others are none of the user's business here.
        warnings.filterwarnings("ignore", category=UserWarning, module="distributed")
        if scheduler is None:
            scheduler = stack.enter_context(local_cluster(workers or 1))
        try:
            client = stack.enter_context(distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{argument('scheduler', scheduler)}: no scheduler answers ({error}); start one with `dask scheduler`, and its "
                "workers with `dask worker ADDRESS`"
            ) from None
        _clients.append(client)
        try:
            yield
        finally:
            _clients.remove(client)


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[str]:
    """The address of a Dask cluster of so many processes on this machine, which end with the context."""
    settings = {
        "distributed.scheduler.allowed-failures": _LOST,
        "distributed.worker.multiprocessing-method": "spawn",
        "distributed.worker.daemon": True,
        "distributed.comm.timeouts.connect": "5s",
        # Without what Dask sets for memory: giving every array back to the system at once doubles the work.
        "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1, "MKL_NUM_THREADS": 1},
    }
    with importlib.import_module("dask").config.set(settings):
        with _without_interrupts():
            local = _distributed().LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", memory_limit=0,
                silence_logs=logging.CRITICAL,
            )  # fmt: skip
        with local:
            yield local.scheduler_address


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Processes that are started here ignore Ctrl-C: it is for this one to end them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _distributed() -> Any:
    options = f"{argument('workers')} and {argument('scheduler')}"
    return required("distributed", InputError(f'{options} need Dask; pip install "bayesid[dask]"'))


def map_tasks(
    function: Callable[[_A], _B],
    items: Iterable[_A],
    *,
    locally: Callable[[Callable[[_A], _B], Iterable[_A]], Iterable[_B]] = map,
) -> Iterator[_B]:
    """Results of a function for independent items, in their order.

    Within `cluster`, tasks go to its workers, a few ahead of the results that are asked for. In a task, linear algebra and
    compiled loops keep to one thread. A task whose worker is lost is done again by another; a function that gives the same
    result wherever it is called makes the whole the same. An `EstimationError` where workers were lost again and again with the
    same task; most often their memory is too small.

    ``function`` is sent once a call, with all that it refers to; ``locally`` is how items are done without a cluster.
    """
    yield from _on_workers(_clients[-1], function, items) if on_cluster() else locally(function, items)


def _on_workers(client: Any, function: Callable[[_A], _B], items: Iterable[_A]) -> Iterator[_B]:
    cloudpickle, killed = importlib.import_module("cloudpickle"), importlib.import_module("distributed").KilledWorker
    # A task of its own that any worker can do again; what is only scattered is lost with the worker that holds it.
    shared = client.submit(_Unpacked, cloudpickle.dumps(function), pure=False)
    waiting: deque = deque()
    given = iter(items)
    try:
        room = _AHEAD * max(sum(client.nthreads().values()), 1)
        for item in itertools.islice(given, room):
            waiting.append(client.submit(_task, shared, item, pure=False))
        while waiting:
            try:
                result = waiting[0].result()
            except killed as error:
                raise EstimationError(
                    f"workers were lost again and again with the same task ({error}); give each more "
                    "memory, or use fewer on a machine"
                ) from None
            waiting.popleft().release()
            for item in itertools.islice(given, 1):
                waiting.append(client.submit(_task, shared, item, pure=False))
            yield result
    finally:
        client.cancel([*waiting, shared], force=True, reason="no longer needed")


class _Unpacked:
    """A function from its bytes; unpacked where it is called, and packed as the same bytes wherever it is sent on."""

    def __init__(self, packed: bytes):
        self.packed, self._function = packed, None

    def __call__(self, item: Any) -> Any:
        if self._function is None:
            self._function = importlib.import_module("cloudpickle").loads(self.packed)
        return self._function(item)

    def __reduce__(self):
        return _Unpacked, (self.packed,)


def _task(function: Callable[[_A], _B], item: _A) -> _B:
    """A task on a worker, in one thread."""
    from threadpoolctl import threadpool_limits

    _inside.task = True
    try:
        # First: numba's threads, when they start, set OpenMP's number to their own.
        importlib.import_module("numba").set_num_threads(1)
        with threadpool_limits(1):
            return function(item)
    finally:
        _inside.task = False


def fold(parts: Iterable[_A], add: Callable[[_A, _A], _A]) -> _A:
    """All parts, one at least, added, `ARITY` at a time in order, and these sums likewise: the same wherever parts come from.

    Only a few sums of each level are held.
    """
    levels: list[list[_A]] = []
    for part in parts:
        for level in levels:
            level.append(part)
            if len(level) < ARITY:
                break
            part = functools.reduce(add, level)
            level.clear()
        else:
            levels.append([part])
    rest: list[_A] = []
    for level in levels:
        rest = [functools.reduce(add, [*level, *rest])] if level or rest else []
    return rest[0]
