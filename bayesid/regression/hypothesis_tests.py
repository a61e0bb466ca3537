"""Tests of hypotheses about estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2


@dataclass(frozen=True)
class ChiSquared:
    """A statistic that is chi-squared distributed where the hypothesis holds."""

    #: Its value and degrees of freedom; 0 where nothing can be tested.
    statistic: float
    degrees: int
    probability: float  # of a statistic at least as large; 1 where nothing can be tested
    #: Smallest eigenvalue of the covariance that was tested with, in the units of the test; well below zero: it is none.
    lowest: float


def hausman(difference: np.ndarray, covariance: np.ndarray, size: np.ndarray | float = 1.0, smallest: float = 0.0) -> ChiSquared:
    """Whether the difference d (p,) of two estimates of the same numbers is nothing but noise [Hausman1978]_.

    ``d' C^+ d`` is chi-squared. For a consistent estimate and the efficient one from the same rows C (p, p) is the difference
    of their covariances, for independent estimates the sum. ``size`` (p,) holds units in which all entries of d are alike;
    directions in which C, in these, is not larger than ``smallest`` say nothing and are left out.
    """
    if not len(difference):
        return ChiSquared(0.0, 0, 1.0, 0.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    keep = values > smallest
    z = vectors.T[keep] @ (difference / size) / np.sqrt(values[keep])
    degrees, statistic = int(keep.sum()), float(z @ z)
    return ChiSquared(statistic, degrees, float(chi2.sf(statistic, degrees)) if degrees else 1.0, float(values[0]))
