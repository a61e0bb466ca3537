"""Stages of a verb: told to a progress display as they begin, and timed."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Called with the name of every stage.
Progress = Callable[[str], None]


def quiet(_: str) -> None:
    """No display of the progress."""
    return None


class Clock:
    """Run time by stage, told to a progress display as it goes: called with a stage's name when it begins.

    Attributes
    ----------
    progress
        Is told.
    seconds
        Run time of every stage that is over [s].
    """

    def __init__(self, progress: Progress):
        self.progress, self.seconds = progress, {}
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
