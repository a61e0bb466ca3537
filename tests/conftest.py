"""Recordings that are not part of the repository are found through BAYESID_DATA."""

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples on every run, and no time limit: machines are noisy.
settings.register_profile("bayesid", derandomize=True, deadline=None)
settings.load_profile("bayesid")


# A shell ignores Ctrl-C for what it runs in the background, and children inherit that; here it is tested.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared():
    """Path of a file or folder below BAYESID_DATA; skips where it is absent."""
    root = Path(os.environ.get("BAYESID_DATA", Path(__file__).resolve().parents[2] / "shared"))

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"{name} not found; set BAYESID_DATA to the folder that holds it")
        return path

    return find
