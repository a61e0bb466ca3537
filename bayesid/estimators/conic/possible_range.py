"""Ranges that no possible robot leaves, one parameter at a time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.estimators.conic.problem import Linear

_TOLERANCE = 1e-9


def possible_range(base: np.ndarray, bodies: Sequence[Sequence[int]], bounds: Sequence[Linear], effects: int) -> np.ndarray:
    """Smallest and largest value that base parameters and effects of a possible robot can have (2, r + e).

    A combination ``k' phi`` is the sum of ``tr(A_i P_i)`` over bodies with pseudo-inertias ``P_i >= 0``. These are free of each
    other and of any size, so it is at least 0 exactly when every ``A_i >= 0``, at most 0 when every ``A_i <= 0``, and
    otherwise any number. Bounds of one parameter narrow that. An interval for a true value that is possible covers it no
    less often without what lies outside.

    Parameters
    ----------
    base
        K (r, P).
    bodies
        Ten columns of each body.
    bounds
        Over link parameters and effects (P + e).
    effects
        Their number e.
    """
    rank, size = base.shape
    through = np.zeros((rank + effects, size + effects))
    through[:rank, :size] = base
    through[rank:, size:] = np.eye(effects)
    out = np.tile([[-np.inf], [np.inf]], rank + effects)
    others = np.setdiff1d(np.arange(size), np.concatenate([list(b) for b in bodies]) if bodies else [])
    for k, row in enumerate(base):
        if np.any(row[others]):
            continue
        values = np.linalg.eigvalsh(np.array([_form(row[list(b)]) for b in bodies]))
        slack = _TOLERANCE * np.abs(values).max()
        if values.min() >= -slack:
            out[0, k] = 0.0
        elif values.max() <= slack:
            out[1, k] = 0.0
    length = np.linalg.norm(through, axis=1)
    for group in bounds:
        for row, low in zip(group.matrix, group.low, strict=True):
            along = through @ row
            for k in np.flatnonzero(np.abs(along) >= (1.0 - _TOLERANCE) * length * np.linalg.norm(row)):
                limit = low * length[k] ** 2 / along[k]
                side = 0 if along[k] > 0 else 1
                out[side, k] = max(out[0, k], limit) if side == 0 else min(out[1, k], limit)
    return out


def _form(coefficients: np.ndarray) -> np.ndarray:
    """A with ``tr(A P)`` the sum of a body's ten parameters times these coefficients."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = coefficients
    return np.array(
        [
            [yy + zz, -0.5 * xy, -0.5 * xz, 0.5 * hx],
            [-0.5 * xy, xx + zz, -0.5 * yz, 0.5 * hy],
            [-0.5 * xz, -0.5 * yz, xx + yy, 0.5 * hz],
            [0.5 * hx, 0.5 * hy, 0.5 * hz, m],
        ]
    )
