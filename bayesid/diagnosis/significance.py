"""How far an effect's values stand out of their own uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from bayesid.diagnosis.fit import Fit


def distance(best: Fit, index: int, keys: Sequence[str] | None = None) -> tuple[float, int]:
    """Squared distance of one effect's values from zero in units of their covariance, and how many values that are.

    Parameters
    ----------
    best, index
        The model, and which of its effects.
    keys
        Parameters that count; default all that are free.
    """
    term = best.terms[index]
    mine = [(column, k) for column, (owner, k) in enumerate(best.free) if owner == index]
    mine = [(column, k) for column, k in mine if keys is None or term.effect.parameters[k] in keys]
    at, values = [column for column, _ in mine], np.array([term.values[k] for _, k in mine])
    covariance = best.covariance[np.ix_(at, at)]
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled = values / size
    return float(scaled @ np.linalg.pinv(covariance / np.outer(size, size), hermitian=True) @ scaled), len(at)


def standing(best: Fit, index: int, dispersion: float) -> float:
    """Log evidence of one effect among many from its estimate and covariance alone, without a fit that leaves it out."""
    squared, count = distance(best, index)
    return (0.5 * squared - 0.5 * count * np.log(best.projector.rows)) / dispersion


def stands_out(best: Fit, index: int, dispersion: float = 1.0, keys: Sequence[str] | None = None) -> bool:
    """Whether an effect's values together leave the interval about zero that is stated for them.

    A fit without an effect may be much worse although its value is not known: the interval counts how the residuals scatter
    from frequency to frequency, the evidence only how many and how large they are. A changed link always stands out here: its
    ten values have a prior of their own, which its evidence weighs.

    Parameters
    ----------
    best, index
        The model, and which of its effects.
    dispersion
        The dispersion factor.
    keys
        Parameters that count; default all.
    """
    if best.terms[index].effect.changes_link:
        return True
    squared, count = distance(best, index, keys)
    return count == 0 or squared >= dispersion * float(chi2.ppf(best.projector.data.settings.interval, count))


__all__ = ["distance", "standing", "stands_out"]
