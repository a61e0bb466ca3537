"""The command line: one file a verb, imported when the verb is called."""

from __future__ import annotations

import gc
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:  # not from typing: before Ctrl-C is caught, nothing is imported that is not needed
    from collections.abc import Sequence
    from types import FrameType
    from typing import NoReturn


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0 done, 1 the work failed, 2 bad input or usage.

    ``arguments`` are those after the program's name; default: the process' own. Ctrl-C and SIGTERM end it with one line at any
    moment, so the rest is imported here, where they are caught.
    """
    own = arguments is None
    collecting = gc.isenabled()
    interrupted, then = False, "files of a run are written all or none"

    def stop(_number: int, _frame: FrameType | None) -> NoReturn:
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    handlers = {}
    try:
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) is not signal.SIG_IGN:
                    handlers[number] = signal.signal(number, stop)
        except ValueError:
            pass  # not in the main thread, which alone gets signals
        from bayesid.cli.verbs import run

        status = run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt as stopped:
        interrupted = True
        then = str(stopped) or then
        status = 1
    except Exception as error:  # an import that fails, or one that turned an interruption into an error of its own
        status = 1
        if not interrupted:
            sys.stderr.write(f"bayesid: cannot start ({' '.join(str(error).split())[:200]}); install it again\n")
    finally:
        for number, handler in handlers.items():
            # A process that is about to end must not be disturbed any more: Python would show where.
            signal.signal(number, signal.SIG_IGN if own else handler or signal.SIG_DFL)
    if interrupted and status == 1:
        sys.stderr.write(f"bayesid: interrupted; {then}\n")
        # An interruption that came within the text of an `exec` stays with Python as one that nobody caught: ``python -m`` would
        # then end by the signal, and not with this status. Any other text makes it forget that.
        exec("")
    if own:  # the process ends: to look for cyclic garbage once more would take a fifth of a second of any verb
        gc.freeze()
    elif collecting:  # a verb may have turned it off
        gc.enable()
    return status
