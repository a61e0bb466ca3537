"""Runs command lines one after the other, as told on standard input, and says how each ended.

A process of its own, so that a crash of the interpreter or a hang ends this one and not the test. What a run prints goes
to files. numpy's warnings are errors here: a user must not see them.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import sys
import warnings
from pathlib import Path

#: More memory than any of the small cases may ask for [bytes]; a recording that does not fit is refused before.
MEMORY = 6 << 30


def main() -> None:
    """Serve until standard input ends: a line with ``arguments``, ``folder`` and ``longest`` [s] gives a line with the status."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    from bayesid.cli import main as run

    warnings.simplefilter("error", RuntimeWarning)
    for line in sys.stdin:
        task = json.loads(line)
        os.chdir(task["folder"])
        streams = [os.open(Path(task["folder"]) / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC) for name in ("stdout", "stderr")]
        for number, stream in zip((1, 2), streams, strict=True):
            os.dup2(stream, number)
            os.close(stream)
        # A run that takes longer ends the process. Its own time, not the clock's: others may use the machine as well.
        signal.setitimer(signal.ITIMER_PROF, task["longest"])
        try:
            status: object = run(task["arguments"])
        except BaseException as error:  # main must let nothing through
            status = repr(error)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        sys.stdout.flush()
        sys.stderr.flush()
        replies.write(json.dumps(status) + "\n")
        replies.flush()


if __name__ == "__main__":
    main()
