"""How far an estimate scatters between parts of a recording, over what its noise model allows.

What a model lacks (friction that wanders with load and temperature, gear errors) follows the motion. It does not average out as
noise does, so intervals from the noise alone are too short. Parts of the same recording that should agree show by how
much: with the weighted rows X_k of part k, residuals r_k and ``A = sum_k X_k'X_k``, a part pulls the estimate by

    A^-1/2 v_k,   v_k = (1 - H_k)^-1/2 A^-1/2 X_k' r_k,   H_k = A^-1/2 X_k'X_k A^-1/2,

where ``(1 - H_k)^-1/2`` gives back what the fit took from the residuals of its own rows: the bias-reduced covariance of clustered
rows [Bell2002]_. Its size relative to the covariance V that the noise alone would give, ``V = A^-1 M A^-1`` with
``M = X' Sigma X``, Sigma the covariance of the weighted rows' noise,

    dispersion = trace(W sum_k v_k v_k') / trace(W A^-1/2 M A^-1/2),   W = (A^-1/2 M A^-1/2)^-1,

is one for noise, whatever its colour within a part, and larger where parts disagree. The rows of one channel have a
dispersion of their own, with that channel's X_k and r_k in the pull and its X in M, but not in W: how far the friction of one
joint wanders says little of how far to trust the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from bayesid.regression.linalg import correlations

#: Parts that a recording is cut into. Fewer leave few degrees of freedom; in more of them little moves.
PARTS = 8
#: Largest share of a direction that one part may hold, before its correction is bounded.
_LARGEST_SHARE = 0.95
_SMALLEST = 1e-9


@dataclass(frozen=True)
class Rows:
    """Some or all of the weighted rows."""

    grams: Sequence[np.ndarray]  # ``[X_k y_k]'[X_k y_k]`` of each part (p + 1, p + 1)
    middle: np.ndarray | None = None  # ``M = X' Sigma X`` (p, p); None: they are white, ``X'X``


@dataclass(frozen=True)
class Dispersion:
    """Dispersion of an estimate between parts, and what it rests on."""

    found: float = 1.0  # the dispersion; 1 where there are too few rows to tell
    degrees: int = 0  # degrees of freedom; 0 there
    size: float = 0.0  # the trace that it is relative to

    @property
    def factor(self) -> float:
        """Factor of a variance: the dispersion, nowhere below one.

        It is not asked whether chance alone explains it: intervals that are widened only where that is improbable are too short
        wherever a moderate scatter is real, and what this costs where it is chance is a few per cent of their width.
        """
        return max(self.found, 1.0)

    def beyond_chance(self, chance: float) -> bool:
        """Whether it is larger than noise alone makes it, but for so improbable a chance."""
        return self.degrees > 0 and self.found > float(chi2.ppf(1.0 - chance, self.degrees)) / self.degrees


def dispersions(whole: Rows, solution: np.ndarray, channels: Sequence[Rows] = ()) -> list[Dispersion]:
    """Dispersion of the fit (p,) to all rows, and of what the rows of each channel pull it by."""
    p, parts = len(solution), [whole, *channels]
    nothing = [Dispersion() for _ in parts]
    if len(whole.grams) < 2:
        return nothing
    gram = np.sum([g[:p, :p] for g in whole.grams], axis=0)
    length, values, vectors = correlations(gram, _SMALLEST)
    if not len(values):
        return nothing
    root = vectors / np.sqrt(values) / length[:, None]  # root' A root = 1
    corrections = []
    for g in whole.grams:
        share, axes = np.linalg.eigh(root.T @ g[:p, :p] @ root)
        corrections.append((axes / np.sqrt(1.0 - np.minimum(share, _LARGEST_SHARE))) @ axes.T @ root.T)
    spread = np.eye(root.shape[1]) if whole.middle is None else root.T @ whole.middle @ root
    weight = np.linalg.pinv(spread, rcond=_SMALLEST, hermitian=True)
    out = []
    for part in parts:
        pulls = [c @ (g[:p, p] - g[:p, :p] @ solution) for c, g in zip(corrections, part.grams, strict=True)]
        middle = np.sum([g[:p, :p] for g in part.grams], axis=0) if part.middle is None else part.middle
        ratio = weight @ root.T @ middle @ root
        size, square = float(np.trace(ratio)), float(np.sum(ratio * ratio.T))
        if size <= 0.0:
            out.append(Dispersion())
            continue
        # Directions count by their share of the trace; those of one part are correlated, so that half of them count.
        degrees = max(int(size**2 / square * (len(part.grams) - 1) / 2), 1)
        out.append(Dispersion(float(sum(v @ weight @ v for v in pulls)) / size, degrees, size))
    return out


def widening(whole: Dispersion, channels: Sequence[Dispersion]) -> np.ndarray:
    """Factor of the noise variance of each channel (c,).

    Where channels pull together, by the links that they share, the whole scatters by more than its parts: then all are
    multiplied by what is missing. Without channels, the factor of the whole (1,); ones where there are too few rows to tell.
    """
    if not channels or not whole.size:
        return np.full(max(len(channels), 1), whole.factor)
    own = np.array([c.factor for c in channels])
    return own * max(whole.found / np.average(own, weights=[c.size for c in channels]), 1.0)
