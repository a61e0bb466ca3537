"""Sets that hold all parameters of a model at once with a stated probability.

With the estimate b_hat and its covariance V, three sets of the same probability, by the shape that a robust controller needs:

    box        |b_k - b_hat_k| <= c std_k for all k,        c     = quantile of max_k |z_k|
    ellipsoid  (b - b_hat)' V^-1 (b - b_hat) <= rho_V^2,     rho_V = quantile of the Mahalanobis distance
    ball       ||b - b_hat|| <= rho,                         rho   = quantile of the norm, in SI units [Spong1992]_

Of a normal law ``rho_V^2`` is the quantile of chi-square, the others come from many of its draws. Of posterior draws each is
`bayesid.design.bounds.simultaneous.quantile` of distances from the other draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from bayesid.design.bounds.simultaneous import (
    NORMAL_DRAWS,
    largest_deviation,
    left_out,
    mahalanobis,
    normal_deviations,
    quantile,
    root_of,
)
from bayesid.estimators.estimator import LEVEL
from bayesid.regression.linalg import standard_deviations


@dataclass(frozen=True, eq=False)
class Region:
    """Box, ellipsoid and ball that each hold all parameters at once with probability `LEVEL`.

    Attributes
    ----------
    names, labels, units
        Of the parameters (k,).
    values
        Their centre b_hat (k,).
    covariance
        V (k, k).
    factor
        Half the box's width over the standard deviation, c.
    ellipsoid
        rho_V.
    rho
        Radius of the ball, in SI units of kg, kg m and kg m^2 together.
    draws
        Deviations from the centre that it was made of (n, k); None: a normal law.
    prior_driven
        Which parameters the data hardly narrow, so that prior or physical limits make their bounds (k,).
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    factor: float
    ellipsoid: float
    rho: float
    draws: np.ndarray | None
    prior_driven: np.ndarray

    def __repr__(self) -> str:
        return f"<Region of {len(self.values)} parameters: rho {self.rho:.3g}, rho_V {self.ellipsoid:.3g}>"

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,)."""
        return standard_deviations(self.covariance)

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the box (k,)."""
        return self.values - self.factor * self.std

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the box (k,)."""
        return self.values + self.factor * self.std

    @property
    def bonferroni(self) -> float:
        """What ``factor`` would be by Bonferroni's inequality for a normal law."""
        return float(norm.ppf(1.0 - 0.5 * (1.0 - LEVEL) / max(len(self.values), 1)))

    def deviations(self, seed: int = 0) -> np.ndarray:
        """Draws of the parameters less their centre (n, k), those it was made of or of its normal law."""
        return normal_deviations(self.covariance, NORMAL_DRAWS, seed) if self.draws is None else self.draws

    def distance(self, values: np.ndarray) -> float:
        """Mahalanobis distance of parameters (k,) from the centre; in the ellipsoid where at most ``ellipsoid``."""
        return float(mahalanobis((np.asarray(values, float) - self.values)[None], self.covariance)[0])

    def in_box(self, values: np.ndarray) -> bool:
        """Whether parameters (k,) are in the box."""
        return bool(np.all(np.abs(np.asarray(values, float) - self.values) <= self.factor * self.std))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``."""
        rows = zip(
            self.names, self.labels, self.units, self.values, self.std, self.low, self.high, self.prior_driven, strict=True
        )
        return {
            "parameters": [
                {"name": n, "label": label, "unit": u, "value": float(v), "std": float(s), "low": float(lo), "high": float(hi),
                 "prior_driven": bool(p)}
                for n, label, u, v, s, lo, hi, p in rows
            ],
            "covariance": self.covariance.tolist(), "simultaneous_factor": self.factor, "bonferroni_factor": self.bonferroni,
            "rho_V": self.ellipsoid, "rho": self.rho, "law": "normal" if self.draws is None else "draws",
        }  # fmt: skip


def region_of_draws(
    names: Sequence[str], labels: Sequence[str], units: Sequence[str], draws: np.ndarray, prior_driven: np.ndarray
) -> Region:
    """The sets of posterior draws (n, k)."""
    count = len(draws)
    values = draws.mean(axis=0)
    away = draws - values
    covariance = np.atleast_2d(np.cov(away.T))
    std = standard_deviations(covariance)
    largest = largest_deviation(np.eye(len(values)), std, away)
    # The norm hardly depends on a single draw: the mean less one draw is n / (n - 1) as far.
    norms = np.linalg.norm(away, axis=1) * count / (count - 1)
    return Region(
        tuple(names), tuple(labels), tuple(units), values, covariance,
        factor=quantile(left_out(largest, count), LEVEL),
        ellipsoid=quantile(left_out(mahalanobis(away, covariance), count), LEVEL),
        rho=quantile(norms, LEVEL), draws=away, prior_driven=prior_driven,
    )  # fmt: skip


def region_of_normal(
    names: Sequence[str], labels: Sequence[str], units: Sequence[str], values: np.ndarray, covariance: np.ndarray,
    prior_driven: np.ndarray, seed: int = 0,
) -> Region:
    """The sets of a normal law."""
    away = normal_deviations(covariance, NORMAL_DRAWS, seed)
    directions = root_of(covariance).shape[1]
    largest = largest_deviation(np.eye(len(values)), standard_deviations(covariance), away)
    return Region(
        tuple(names), tuple(labels), tuple(units), values, covariance, factor=quantile(largest, LEVEL),
        ellipsoid=float(np.sqrt(chi2.ppf(LEVEL, max(directions, 1)))), rho=quantile(np.linalg.norm(away, axis=1), LEVEL),
        draws=None, prior_driven=prior_driven,
    )  # fmt: skip

