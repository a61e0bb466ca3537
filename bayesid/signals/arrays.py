"""Arrays as the compiled functions take them, and runs of true flags in one."""

from __future__ import annotations

import numpy as np


def kernel_input(array: np.ndarray) -> np.ndarray:
    """The array, contiguous, of floats, and seen as read-only; a copy only where it is not contiguous.

    Numba compiles a function anew for every layout, and for arrays that can and cannot be written.
    """
    seen = np.ascontiguousarray(array, dtype=float).view()
    seen.flags.writeable = False
    return seen


def runs(flags: np.ndarray, bridge: int = 0) -> list[tuple[int, int]]:
    """First and one past the last index of every run of true flags (N,); gaps of up to ``bridge`` flags are closed."""
    at = np.flatnonzero(flags)
    cuts = np.flatnonzero(np.diff(at) > bridge + 1)
    first, last = at[[0, *(cuts + 1)] if len(at) else []], at[[*cuts, -1] if len(at) else []]
    return [(int(a), int(b) + 1) for a, b in zip(first, last, strict=True)]
