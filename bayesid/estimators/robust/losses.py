"""Losses that bound what a segment of rows can do, and their scales.

A segment of n independent standard normal numbers has the squared length q ~ chi2(n). A loss turns q into the weight w(q) of
all of its rows; least squares is w = 1.

* Huber [Huber1964]_: w = min(1, k / sqrt(q)), where a normal segment is longer than k with a fixed probability.
* Student's t [Lange1989]_: w = (nu + n) / (nu + q), the multivariate t with nu degrees of freedom for whole segments.

The iteration asks of a loss the weights w(q), their slopes w'(q), the scale squared at which the lengths q are as long as normal
ones (``variance``), and the loss with what it learns from all lengths (``fitted``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, gammaln
from scipy.stats import chi2

#: Probability that Huber's loss leaves a normal segment its whole weight, unless a constant is given.
WHOLE = 0.95
#: Degrees of freedom are looked for in this range; the upper end is as good as normal.
LOWEST_NU, HIGHEST_NU = 1.0, 1000.0
_PASSES = 100


@dataclass(frozen=True)
class HuberLoss:
    """Huber's loss; ``rare`` is the probability that a normal segment is longer than k."""

    rare: float

    def _limit(self, n: np.ndarray) -> np.ndarray:
        """Square of the distance k at which weights begin to fall."""
        return chi2.isf(self.rare, n)

    def weights(self, q: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Weights min(1, k / sqrt(q))."""
        return np.sqrt(np.minimum(1.0, self._limit(n) / np.maximum(q, 1e-300)))

    def slopes(self, q: np.ndarray, n: np.ndarray) -> np.ndarray:
        """0 below k squared, -w / 2 q above."""
        w = self.weights(q, n)
        return np.where(w < 1.0, -0.5 * w / np.maximum(q, 1e-300), 0.0)

    def variance(self, q: np.ndarray, n: np.ndarray) -> float:
        """Huber's proposal 2: the mean of min(q / s2, k2) is what it is for normal segments."""
        limit = self._limit(n)
        expected = float(np.sum(_clipped_mean(n, limit)))
        value = 1.0
        for _ in range(_PASSES):
            last, value = value, float(np.sum(np.minimum(q, value * limit))) / expected
            if abs(value - last) <= 1e-9 * last:
                break
        return value

    def fitted(self, q: np.ndarray, n: np.ndarray) -> Self:
        """The loss itself: nothing is learned."""
        return self

    def efficiency(self, n: float) -> float:
        """Variance of least squares over that of this loss, for normal noise and segments of n."""
        k2 = self._limit(np.array(n))
        if np.isinf(k2):
            return 1.0
        # E[w + 2 q w'/n] = P(q < k2) + (1 - 1/n) k E[q^-1/2; q > k2], the partial moment again a chi-square's tail.
        tail = np.exp(gammaln(0.5 * (n - 1.0)) - gammaln(0.5 * n)) / np.sqrt(2.0) * chi2.sf(k2, n - 1.0) if n > 1 else 0.0
        slope = chi2.cdf(k2, n) + (1.0 - 1.0 / n) * np.sqrt(k2) * tail
        return float(slope**2 / (_clipped_mean(np.array(n), k2) / n))


@dataclass(frozen=True)
class StudentLoss:
    """Student's t for whole segments; ``estimate``: nu is learned."""

    nu: float
    estimate: bool = False

    def weights(self, q: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Weights (nu + n) / (nu + q)."""
        return np.ones(len(q)) if np.isinf(self.nu) else (self.nu + n) / (self.nu + q)

    def slopes(self, q: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Slopes -w / (nu + q)."""
        return np.zeros(len(q)) if np.isinf(self.nu) else -self.weights(q, n) / (self.nu + q)

    def variance(self, q: np.ndarray, n: np.ndarray) -> float:
        """Maximum of the likelihood for this nu, by expectation and maximisation."""
        value = 1.0
        for _ in range(_PASSES):
            last, value = value, float(np.sum(self.weights(q / value, n) * q) / np.sum(n))
            if abs(value - last) <= 1e-9 * last:
                break
        return value

    def fitted(self, q: np.ndarray, n: np.ndarray) -> Self:
        """The nu of largest likelihood, given the scale [Liu1995]_."""
        if not self.estimate:
            return self

        def score(log_nu: float) -> float:
            nu = float(np.exp(log_nu))
            w, half = (nu + n) / (nu + q), 0.5 * (nu + n)
            own = np.log(0.5 * nu) - digamma(0.5 * nu) + 1.0
            return float(np.mean(own + digamma(half) - np.log(half) + np.log(w) - w))

        low, high = np.log(LOWEST_NU), np.log(HIGHEST_NU)
        if score(high) >= 0:
            return replace(self, nu=HIGHEST_NU)
        if score(low) <= 0:
            return replace(self, nu=LOWEST_NU)
        root = np.asarray(brentq(score, low, high, xtol=1e-6))
        return replace(self, nu=float(np.exp(root)))


Loss = HuberLoss | StudentLoss


def _clipped_mean(n: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Mean of min(q, limit) for q ~ chi2(n)."""
    finite = np.where(np.isinf(limit), 0.0, limit)
    return n * chi2.cdf(limit, n + 2.0) + finite * chi2.sf(limit, n)
