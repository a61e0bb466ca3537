"""Stages of a verb: shown on a progress display as they begin, and timed; shown where nothing else is asked for."""

from __future__ import annotations

import functools
import inspect
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from bayesid.argument_types import explains_types
from bayesid.errors import require_seed

#: Called with the name of every stage.
Progress = Callable[[str], None]
_P = ParamSpec("_P")
_R = TypeVar("_R")
#: Nothing is shown of what is done sooner [s].
DELAY = 2.0
_REFRESHED = 0.5  # the time that has gone by, on a terminal and in a notebook [s]


def quiet(_: str) -> None:
    """No display of the progress."""
    return None


class _Shown:
    """Stands for a display that begins when a verb has taken `DELAY`, see `shows_progress`."""

    def __call__(self, _: str) -> None:
        """Do nothing: the verb calls the display."""

    def __repr__(self) -> str:
        return "SHOWN"


#: The default of ``progress``: stages are shown where they take over two seconds; None: never.
SHOWN = _Shown()


def shows_progress(verb: Callable[_P, _R]) -> Callable[_P, _R]:
    """A verb whose ``progress`` is a display while that is `SHOWN`, whose ``seed`` has to be one, and that `explains_types`."""
    signature, explained = inspect.signature(verb), explains_types(verb)

    @functools.wraps(verb)
    def shown(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            given = signature.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{verb.__name__}() {error}") from None
        require_seed(given.arguments.get("seed", 0))
        if given.arguments.get("progress", SHOWN) is not SHOWN:
            return explained(*args, **kwargs)
        with _Display(verb.__name__) as display:
            given.arguments["progress"] = display
            return explained(*given.args, **given.kwargs)

    return shown


class _Display:
    """The stage and the time that has gone by, in a line of tqdm's: on a terminal, in a notebook, or a line a stage elsewhere."""

    def __init__(self, verb: str):
        self.verb, self.stage, self.bar = verb, "", None
        self.done, self.since = threading.Event(), time.time()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def __call__(self, stage: str) -> None:
        """Show that another stage begins."""
        self.stage = stage

    def __enter__(self) -> _Display:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.done.set()
        self.thread.join()
        if self.bar is not None:
            self.bar.close()

    def _run(self) -> None:
        if self.done.wait(DELAY):
            return
        lasting = "ipykernel" in sys.modules or sys.stderr is None or not sys.stderr.isatty()
        self.bar = _tqdm()(desc=self.verb, bar_format="{desc} [{elapsed}]", leave=lasting)
        self.bar.start_t = self.since
        live, shown = "ipykernel" in sys.modules or not lasting, None
        while True:
            if live or self.stage != shown:
                shown = self.stage
                self.bar.set_description_str(f"{self.verb}: {shown}")
            if self.done.wait(_REFRESHED):
                return


def _tqdm() -> Any:
    """Tqdm for where this runs; without widgets in a notebook, the one that writes text."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from tqdm.auto import tqdm
    return tqdm


class Clock:
    """Run time by stage, shown on a progress display as it goes: called with a stage's name when it begins."""

    def __init__(self, progress: Progress | None):
        self.progress, self.seconds = progress or quiet, {}  # what is called with each stage; times of those that are over [s]
        self.stage, self.since = "", time.perf_counter()

    def __call__(self, stage: str) -> None:
        """End the stage that runs and begin another."""
        self.stop()
        self.stage = stage
        self.progress(stage)

    def stop(self) -> dict[str, float]:
        """End the stage that runs; the run times so far."""
        now = time.perf_counter()
        if self.stage:
            self.seconds[self.stage] = self.seconds.get(self.stage, 0.0) + now - self.since
        self.stage, self.since = "", now
        return self.seconds
