"""A motion that exceeds limits a little, moved to the nearest one that keeps them.

With the ratios g of `bayesid.design.excitation.limits` and their Jacobian J along the optimiser's numbers x, each step is the
smallest one that meets all limits to first order, less a margin,

    min |d|^2   subject to   sign(g) (g + J d) <= 1 - margin  where |g| is near one:

a least distance problem, which non-negative least squares solves ([Lawson1974]_, chapter 23). Positions, velocities and
accelerations are linear in x, so that only torques, wrenches and distances need more than one step.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from bayesid.design.excitation.limits import Limits, Motion
from bayesid.design.excitation.series import Coordinates

#: Samples below this share of a limit do not count in a step; a step's length at most, so that what is left out stays within.
_NEAR, _LONGEST, _STEPS = 0.9, 0.5, 8


def restored(limits: Limits, coordinates: Coordinates, x: np.ndarray, margin: float) -> np.ndarray | None:
    """Numbers near x whose motion keeps all limits at the samples, less half a margin; None where none was found.

    Parameters
    ----------
    limits
        To keep.
    coordinates
        Of the numbers x.
    x
        Where to start from.
    margin
        Share of every limit that is kept free.
    """
    for _ in range(_STEPS):
        motion = coordinates.motion(x)
        ratios = limits.ratios(motion)
        if max(float(np.abs(part).max(initial=0.0)) for part in ratios) <= 1.0 - 0.5 * margin:
            return x
        rows, room = _active(limits, coordinates, motion, ratios, margin)
        step = _least_distance(-rows, -room)
        if step is None:
            return None
        x = x + step * min(1.0, _LONGEST / max(float(np.linalg.norm(step)), 1e-300))
    return None


def _active(
    limits: Limits, coordinates: Coordinates, motion: Motion, ratios: list[np.ndarray], margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the Jacobian (k, count) of ratios near their limits, signed so that they must not grow, and the room left (k,)."""
    rows, room = [], []
    for p, part in enumerate(ratios):
        for c in range(part.shape[1]):
            near = np.flatnonzero(np.abs(part[:, c]) > _NEAR)
            if not len(near):
                continue
            weights = [np.zeros_like(other) for other in ratios]
            weights[p][:, c] = np.sign(part[:, c])
            rows.append(coordinates.jacobian(*limits.gradient(motion, weights), near))
            room.append(1.0 - margin - np.abs(part[near, c]))
    return np.concatenate(rows), np.concatenate(room)


def _least_distance(matrix: np.ndarray, least: np.ndarray) -> np.ndarray | None:
    """The smallest d with ``matrix d >= least``; None where there is none."""
    stacked = np.vstack([matrix.T, least])
    target = np.zeros(len(stacked))
    target[-1] = 1.0
    try:
        dual, _ = nnls(stacked, target, maxiter=20 * len(stacked))
    except RuntimeError:  # no solution in so many steps
        return None
    rest = stacked @ dual - target
    if abs(rest[-1]) < 1e-10:
        return None
    return -rest[:-1] / rest[-1]
