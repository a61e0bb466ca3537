"""The bristle of [Dahl1968]_ with exponent 1, ``dz = (sign(dx) - z) |dx| / w``: it bends with a way and slips when it is bent."""

from __future__ import annotations

import numpy as np


def bent(moves: np.ndarray, width: float, start: float = 0.0) -> np.ndarray:
    """How far the bristle is bent, from -1 to 1, at the start and after each move (m + 1,).

    A move of a way s in one direction takes z to ``sign - (sign - z) exp(-s / width)``, however fast: a map ``z -> k z + p``.
    Maps are put together two by two, then four by four and so on [Blelloch1990]_.

    Parameters
    ----------
    moves
        Signed ways, each without a reversal (m,).
    width
        The way w over which it bends.
    start
        How far it is bent at the start.
    """
    keep, push = np.zeros((2, len(moves) + 1))
    keep[1:] = np.exp(-np.abs(moves) / width)
    push[0], push[1:] = start, (1.0 - keep[1:]) * np.sign(moves)
    span = 1
    while span < len(keep):
        push[span:] += keep[span:] * push[:-span]
        keep[span:] *= keep[:-span]
        span *= 2
    return push
