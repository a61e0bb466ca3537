"""How far an effect differs from zero: one rule for every verdict."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.settings import Settings


def distance(best: Fit, index: int) -> tuple[float, int]:
    """Squared distance from zero of what makes an effect one, in units of its covariance, and how many values that are.

    That are the parameters that readings are linear in: without a force there is no contact, however well its window and its
    point are known, and without stiffness no tether. An effect that has none of them, as a delay, is measured by all of its
    parameters.
    """
    term = best.terms[index]
    shape = set(term.effect.shape)
    counts = set(term.effect.parameters) - shape or shape
    mine = [(column, k) for column, (owner, k) in enumerate(best.free) if owner == index]
    mine = [(column, k) for column, k in mine if term.effect.parameters[k] in counts]
    at, values = [column for column, _ in mine], np.array([term.values[k] for _, k in mine])
    if term.effect.shape and not best.determined[at].all():
        return 0.0, len(at)  # another shape would do with any size
    return squared_distance(values, best.covariance[np.ix_(at, at)]), len(at)


def squared_distance(values: np.ndarray, covariance: np.ndarray) -> float:
    """Squared distance from zero of values (k,) in units of their covariance (k, k), along what that determines."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled = values / size
    return float(scaled @ np.linalg.pinv(covariance / np.outer(size, size), hermitian=True) @ scaled)


def wald_evidence(best: Fit, index: int, dispersion: float) -> float:
    """Log evidence of one effect among many from its estimate and covariance alone, without a fit that leaves it out."""
    squared, count = distance(best, index)
    return (0.5 * squared - 0.5 * count * np.log(best.projector.rows)) / dispersion


def differs_from_zero(best: Fit, index: int, dispersion: float = 1.0) -> bool:
    """Whether an effect's values together leave the interval about zero that is stated for them.

    A fit without an effect may be much worse although its value is not known: the interval counts how the residuals scatter
    from frequency to frequency, the evidence only how many and how large they are.
    """
    squared, count = distance(best, index)
    return count == 0 or outside(squared / dispersion, count, best.projector.data.settings)


def outside(squared: float, count: int, settings: Settings) -> bool:
    """Whether so many values together lie outside the interval about zero, by their squared distance from it."""
    return squared >= float(chi2.ppf(settings.interval, count))


__all__ = ["differs_from_zero", "distance", "outside", "squared_distance", "wald_evidence"]
