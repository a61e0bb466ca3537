"""Arrays as the compiled functions take them: of one kind, so that each function is compiled once."""

from __future__ import annotations

import numpy as np


def kernel_input(array: np.ndarray) -> np.ndarray:
    """The array, contiguous, of floats, and seen as read-only; a copy only where it is not contiguous.

    Numba compiles a function anew for every layout, and for arrays that can and cannot be written.
    """
    seen = np.ascontiguousarray(array, dtype=float).view()
    seen.flags.writeable = False
    return seen
