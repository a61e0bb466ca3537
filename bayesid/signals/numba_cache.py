"""Where compiled functions are kept between runs, where neither the installation nor the home can be written."""

import os


def find_place() -> None:
    """Name a folder to numba if it would find none: it refuses to start then, as in a container without a home.

    numba keeps compiled code beside the sources, else in the user's cache folder. Where both are read-only, a folder of
    this user's under the system's temporary one is named; one that somebody else could have filled is never used.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if os.environ.get("NUMBA_CACHE_DIR") or os.access(os.path.dirname(__file__), os.W_OK) or _can_be_made(home):
        return
    import tempfile

    user = os.getuid() if hasattr(os, "getuid") else None
    place = os.path.join(tempfile.gettempdir(), f"bayesid-numba-{user}")
    try:
        os.makedirs(place, mode=0o700, exist_ok=True)
        state = os.lstat(place)
        if user is not None and (state.st_uid != user or state.st_mode & 0o170077 != 0o040000):
            place = tempfile.mkdtemp(prefix="bayesid-numba-")  # what others can write may hold anything
    except OSError:
        return  # nothing can be written at all: numba says so
    os.environ["NUMBA_CACHE_DIR"] = place


def _can_be_made(folder: str) -> bool:
    """Whether a folder can be written, or made."""
    while not os.path.exists(folder) and folder != os.path.dirname(folder):
        folder = os.path.dirname(folder)
    return os.access(folder, os.W_OK | os.X_OK)
