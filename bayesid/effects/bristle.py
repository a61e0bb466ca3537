"""The bristle of [Dahl1968]_ with exponent 1, ``dz = (sign(dx) - z) |dx| / w``: it bends with a way and slips when it is bent."""

from __future__ import annotations

import numba
import numpy as np


def bent(moves: np.ndarray, width: float, start: float = 0.0) -> np.ndarray:
    """How far the bristle is bent, from -1 to 1, at the start and after each move (m + 1,).

    A move of a way s in one direction takes z to ``sign - (sign - z) exp(-|s| / width)``, however fast.

    Parameters
    ----------
    moves
        Signed ways, each without a reversal (m,).
    width
        The way w over which it bends.
    start
        How far it is bent at the start.
    """
    moves = np.ascontiguousarray(moves, dtype=float)
    return _bent(np.sign(moves), np.exp(-np.abs(moves) / width), float(start))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bent(sign, keep, start):
    out = np.empty(len(sign) + 1)
    out[0] = start
    for k in range(len(sign)):
        out[k + 1] = sign[k] - (sign[k] - out[k]) * keep[k]
    return out
