"""Runs of true flags."""

from __future__ import annotations

import numpy as np


def runs(flags: np.ndarray, bridge: int = 0) -> list[tuple[int, int]]:
    """First and one past the last index of every run of true flags (N,); gaps of up to ``bridge`` flags are closed."""
    at = np.flatnonzero(flags)
    cuts = np.flatnonzero(np.diff(at) > bridge + 1)
    first, last = at[[0, *(cuts + 1)] if len(at) else []], at[[*cuts, -1] if len(at) else []]
    return [(int(a), int(b) + 1) for a, b in zip(first, last, strict=True)]
