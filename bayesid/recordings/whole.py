"""Files of a folder that appear together or not at all, whatever happens meanwhile."""

from __future__ import annotations

import os
import platform
import re
import shutil
import signal
import tempfile
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_DRAFT = re.compile(r"\.bayesid-([0-9a-f]{8})-(\d+)-\w+")


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty hidden folder; what is in it when the block ends goes into ``folder``, all files or none.

    Other files of ``folder``, which is made if absent, stay. On any error (an `OSError` where something cannot be written) or
    interruption everything is as before. What a run that was killed left behind is put right first.
    """
    folder = folder.absolute()
    missing = [part for part in (folder.parent, *folder.parent.parents) if not part.exists()]
    draft: Path | None = None
    done = False
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        for place in (folder.parent, folder):
            _bury_the_dead(place, folder)
        with uninterrupted():
            # Within the folder if it exists, for it may be a volume of its own, which nothing is renamed into.
            draft = Path(tempfile.mkdtemp(dir=folder if folder.is_dir() else folder.parent, prefix=f"{_mark()}-"))
        new, old = draft / "new", draft / "old"
        new.mkdir()
        yield new
        with uninterrupted():
            if folder.is_dir():
                _replace(new, old, folder)
            else:
                new.rename(folder)
            done = True
    finally:
        with uninterrupted():
            if draft is not None:
                shutil.rmtree(draft, ignore_errors=True)
            for part in [] if done else missing:
                try:
                    part.rmdir()
                except OSError:
                    break


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Keep Ctrl-C and SIGTERM waiting until the block has ended; only the main thread ever gets them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    for number in handlers:
        signal.signal(number, lambda n, _: came.append(n))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in came[:1]:
            signal.raise_signal(number)


def _replace(new: Path, old: Path, folder: Path) -> None:
    """Move every file of one folder into another; on an error move all back."""
    old.mkdir()
    moved: list[str] = []
    try:
        for path in sorted(new.iterdir()):
            if (folder / path.name).exists():
                (folder / path.name).rename(old / path.name)
            moved.append(path.name)
            path.rename(folder / path.name)
    except OSError:
        for name in reversed(moved):
            (folder / name).unlink(missing_ok=True)
            if (old / name).exists():
                (old / name).rename(folder / name)
        raise


def _mark() -> str:
    """Name of this machine's and process' drafts."""
    return f".bayesid-{zlib.crc32(platform.node().encode()):08x}-{os.getpid()}"


def _bury_the_dead(place: Path, folder: Path) -> None:
    """Remove drafts of processes of this machine that are gone; files that one was just replacing go back."""
    if os.name != "posix" or not place.is_dir():
        return
    for path in place.iterdir():
        match = _DRAFT.fullmatch(path.name)
        if match is None or not path.name.startswith(_mark()[:18]) or _alive(int(match[2])):
            continue
        if place == folder and (path / "old").is_dir():
            for kept in (path / "old").iterdir():
                kept.replace(folder / kept.name)
        shutil.rmtree(path, ignore_errors=True)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
