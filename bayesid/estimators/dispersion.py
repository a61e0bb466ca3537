"""How far an estimate scatters between stretches of a recording, over what its noise model allows.

What a model lacks (friction that wanders with load and temperature, gear errors) follows the motion. It does not average out as
noise does, so intervals from the noise alone are too short. Stretches of the same recording that should agree show by how
much: with the weighted rows X_k of stretch k, residuals r_k and ``A = sum_k X_k'X_k``, a stretch pulls the estimate by

    A^-1/2 v_k,   v_k = (1 - H_k)^-1/2 A^-1/2 X_k' r_k,   H_k = A^-1/2 X_k'X_k A^-1/2,

where ``(1 - H_k)^-1/2`` gives back what the fit took from the residuals of its own rows: the bias-reduced covariance of clustered
rows [Bell2002]_. Its size relative to the covariance V that the noise alone would give,

    dispersion = trace(V^-1 A^-1/2 sum_k v_k v_k' A^-1/2) / rank,

is one for noise, whatever its colour within a stretch, and larger where stretches disagree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from bayesid.regression.linalg import or_one

#: Stretches that a recording is cut into. Fewer leave few degrees of freedom; in more of them little moves.
STRETCHES = 8
#: A dispersion above one counts where chance reaches it with a smaller probability than this.
CHANCE = 0.05
#: Largest share of a direction that one stretch may hold, before its correction is bounded.
_LARGEST_SHARE = 0.95
_SMALLEST = 1e-9


def dispersion(grams: Sequence[np.ndarray], solution: np.ndarray, middle: np.ndarray | None = None) -> tuple[float, int]:
    """Dispersion of an estimate between stretches, and the degrees of freedom that it rests on.

    Parameters
    ----------
    grams
        ``[X_k y_k]'[X_k y_k]`` of each stretch's weighted rows (p + 1, p + 1).
    solution
        The fit to all of them (p,).
    middle
        ``X' Sigma X`` of the weighted rows (p, p), with the covariance Sigma of their noise; None: they are white.

    Returns
    -------
    dispersion, degrees
        1 and 0 where there are too few rows to tell.
    """
    p = len(solution)
    if len(grams) < 2:
        return 1.0, 0
    gram = np.sum([g[:p, :p] for g in grams], axis=0)
    length = or_one(np.sqrt(np.maximum(np.diag(gram), 0.0)))
    values, vectors = np.linalg.eigh(gram / np.outer(length, length))
    keep = values > _SMALLEST * values.max(initial=0.0)
    if not keep.any():
        return 1.0, 0
    root = vectors[:, keep] / np.sqrt(values[keep]) / length[:, None]  # root' A root = 1
    weight = np.eye(root.shape[1]) if middle is None else np.linalg.pinv(root.T @ middle @ root, rcond=_SMALLEST, hermitian=True)
    total = 0.0
    for g in grams:
        share, axes = np.linalg.eigh(root.T @ g[:p, :p] @ root)
        pull = axes.T @ (root.T @ (g[:p, p] - g[:p, :p] @ solution)) / np.sqrt(1.0 - np.minimum(share, _LARGEST_SHARE))
        total += pull @ (axes.T @ weight @ axes) @ pull
    # Directions of one stretch are correlated, so that half of them count.
    return float(total / root.shape[1]), max(root.shape[1] * (len(grams) - 1) // 2, 1)


def beyond_chance(found: float, degrees: int, chance: float = CHANCE) -> bool:
    """Whether a dispersion is larger than noise alone makes it."""
    return degrees > 0 and found > float(chi2.ppf(1.0 - chance, degrees)) / degrees
