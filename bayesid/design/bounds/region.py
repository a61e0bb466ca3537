"""Sets that hold all parameters of a model at once with a stated probability, and robust control with them.

With the estimate b_hat and its covariance V, three sets of the same probability, by the shape that a robust controller needs:

    box        |b_k - b_hat_k| <= c std_k for all k,        c     = quantile of max_k |z_k|
    ellipsoid  (b - b_hat)' V^-1 (b - b_hat) <= rho_V^2,     rho_V = quantile of the Mahalanobis distance
    ball       ||b - b_hat|| <= rho,                         rho   = quantile of the norm, in SI units [Spong1992]_

Of a normal law ``rho_V^2`` is the quantile of chi-square, the others come from many of its draws. Of posterior draws each is
the 95 % quantile of a distance. Mean and covariance that this is measured with come from the same draws, so every draw would be
judged by itself. Each is therefore measured from the mean and covariance of all the others: with ``C = sum (x_i - m)(x_i -
m)'`` of n draws and ``s = (x - m)' C^-1 (x - m)``, leaving one out gives

    d^2 = (n - 2) (n / (n - 1))^2  s / (1 - n s / (n - 1))

(Sherman and Morrison). The quantile is then that of a draw the set has not seen, such as the truth. It is the order statistic
``ceil((n + 1) level)``, which a further draw of the same law stays below with at least that probability.

A robust controller takes Spong's term, or its ellipsoidal form. With e = q - q_d, r = v - v_r, v_r = v_d - rate e, and the
columns Y of M a_r + C v_r + g, the controller

    tau = Y (b_hat + u) - K r

leaves ``M dr/dt + C r + K r = Y (b_hat - b + u)``. Along ``s = Y' r`` the term u opposes whatever error the set allows
[Spong1992]_:

    ball        u = -rho s / ||s||,                 where ||s|| > width, else  -rho s / width
    ellipsoid   u = -rho_V V s / sqrt(s' V s),      where sqrt(s' V s) > width, else  -rho_V V s / width

With a diagonal K, ``x = K^1/2 r`` and ``W = r' M r / 2``, for every b of the set and torques d that no parameter explains,

    dW/dt <= -||x||^2 + ||K^-1/2 d|| ||x|| + rho width / 4 < 0   where   ||x|| > R,
    R = (||K^-1/2 d|| + sqrt(||K^-1/2 d||^2 + rho width)) / 2,

so from rest on the path ``||x|| <= sqrt(mu_max / mu_min) R`` for ever, with mu the eigenvalues of ``K^-1/2 M K^-1/2``. Then
``|r_j| <= ||x|| / sqrt(k_j)``, and ``|e_j|`` is at most that over the rate, as ``de/dt = r - rate e``. Gains in proportion to the
joints' inertias keep the quotient of the eigenvalues small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from bayesid.estimators.parameters import Parameters
from bayesid.regression.linalg import correlations, root_of, standard_deviations
from bayesid.rounding import LEVEL

#: Draws of a normal law that quantiles without a closed form are taken from.
NORMAL_DRAWS = 20_000


def quantile(values: np.ndarray, level: float) -> float:
    """Value that a further draw of the same law is below with at least the probability ``level``."""
    n = len(values)
    place = min(int(np.ceil((n + 1) * level)), n)
    return float(np.partition(values, place - 1)[place - 1])


def left_out(distances: np.ndarray, count: int) -> np.ndarray:
    """Distances (d,) of draws from the mean and covariance of all others, from those ``sqrt((x - m)' V^-1 (x - m))`` of all n.

    Here ``V = C / (n - 1)``, and n is ``count``.
    """
    share = distances**2 / (count - 1)
    rest = np.maximum(1.0 - share * count / (count - 1), 1e-9)
    return np.sqrt((count - 2) * share / rest) * count / (count - 1)


def mahalanobis(deviations: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """``sqrt(d' V^-1 d)`` of deviations (n, k), along the directions that have a variance (n,)."""
    std, values, vectors = correlations(covariance)
    return np.linalg.norm((deviations / std) @ (vectors / np.sqrt(values)), axis=1)


def largest_deviation(std: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """``max_k |d_k| / std_k`` (n,) of deviations d (n, k), over those that have a standard deviation (k,)."""
    used = std > 0.0
    return np.abs(deviations[:, used] * (1.0 / std[used])).max(axis=1, initial=0.0)


def normal_deviations(covariance: np.ndarray, seed: int) -> np.ndarray:
    """Draws of N(0, V), (`NORMAL_DRAWS`, k)."""
    root = root_of(covariance)
    return np.random.default_rng([seed, 11]).normal(size=(NORMAL_DRAWS, root.shape[1])) @ root.T


@dataclass(frozen=True, eq=False)
class Region:
    """Box, ellipsoid and ball that each hold all parameters at once with probability `LEVEL`."""

    #: Of the parameters (k,).
    names: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray  # their centre b_hat (k,)
    covariance: np.ndarray  # V (k, k)
    factor: float  # half the box's width over the standard deviation, c
    ellipsoid: float  # rho_V
    rho: float  # radius of the ball, in SI units of kg, kg m and kg m^2 together
    draws: np.ndarray | None  # deviations from the centre that it was made of (n, k); None: a normal law
    prior_driven: np.ndarray  # which parameters the data hardly narrow, so that prior or physical limits make their bounds (k,)
    #: Which parameters have no bounds of their own (k,): nothing is known of them, or only of their sums with others, such as a
    #: link's and its rotor's inertia. What is known of the sums is in the covariance.
    undetermined: np.ndarray

    def __repr__(self) -> str:
        return f"<Region of {len(self.values)} parameters: rho {self.rho:.3g}, rho_V {self.ellipsoid:.3g}>"

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,); nan of what is undetermined."""
        return np.where(self.undetermined, np.nan, standard_deviations(self.covariance))

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the box (k,)."""
        return self.values - self.factor * self.std

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the box (k,)."""
        return self.values + self.factor * self.std

    @property
    def determined_by(self) -> tuple[str, ...]:
        """What each parameter's bounds come from (k,): ``data``, ``prior``, or ``sum``, without bounds of its own."""
        kinds = zip(self.undetermined.tolist(), self.prior_driven.tolist(), strict=True)
        return tuple("sum" if u else "prior" if p else "data" for u, p in kinds)

    @property
    def bonferroni(self) -> float:
        """What ``factor`` would be by Bonferroni's inequality for a normal law."""
        return float(norm.ppf(1.0 - 0.5 * (1.0 - LEVEL) / max(len(self.values), 1)))

    def deviations(self, seed: int = 0) -> np.ndarray:
        """Draws of the parameters less their centre (n, k), those it was made of or of its normal law."""
        return normal_deviations(self.covariance, seed) if self.draws is None else self.draws

    def distance(self, values: np.ndarray) -> float:
        """Mahalanobis distance of parameters (k,) from the centre; in the ellipsoid where at most ``ellipsoid``."""
        return float(mahalanobis((np.asarray(values, float) - self.values)[None], self.covariance)[0])

    def in_box(self, values: np.ndarray) -> bool:
        """Whether parameters (k,) are in the box."""
        away = np.abs(np.asarray(values, float) - self.values)
        return bool(np.all(away[~self.undetermined] <= (self.factor * self.std)[~self.undetermined]))

    @property
    def basis(self) -> np.ndarray:
        """Directions that have a variance, each of the size of a parameter's standard deviation (k, m).

        With coordinates c, ``b = b_hat + basis c``, the ellipsoid is ``c' C^-1 c <= rho_V^2`` and C has full rank.
        """
        return self._directions[0]

    @property
    def basis_covariance(self) -> np.ndarray:
        """C, the covariance of the coordinates (m, m): ``V = basis C basis'``."""
        return np.diag(self._directions[1])

    @property
    def to_basis(self) -> np.ndarray:
        """Coordinates of a deviation, ``c = to_basis (b - b_hat)`` (m, k); ``to_basis basis`` is the identity."""
        return self._directions[2]

    @cached_property
    def _directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        std, values, vectors = correlations(self.covariance)
        return std[:, None] * vectors, values, vectors.T / std

    def table(self) -> Parameters:
        """The parameters with the ends of the box, each of the class in ``determined_by``."""
        return Parameters(self.names, self.labels, self.values, self.std, self.low, self.high, self.units, self.determined_by)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``."""
        rows = zip(self.table().to_list(), self.prior_driven.tolist(), strict=True)
        return {
            "parameters": [{**row, "prior_driven": driven} for row, driven in rows],
            "covariance": self.covariance.tolist(), "simultaneous_factor": self.factor, "bonferroni_factor": self.bonferroni,
            "rho_V": self.ellipsoid, "rho": self.rho, "law": "normal" if self.draws is None else "draws",
        }  # fmt: skip


def region_of_draws(
    names: Sequence[str],
    labels: Sequence[str],
    units: Sequence[str],
    draws: np.ndarray,
    prior_driven: np.ndarray,
    centre: np.ndarray | None = None,
) -> Region:
    """The sets of draws (n, k) about their mean, or about another centre (k,), whose covariance is the mean square."""
    count = len(draws)
    values = draws.mean(axis=0) if centre is None else centre
    away = draws - values
    covariance = np.atleast_2d(np.cov(away.T)) if centre is None else away.T @ away / (count - 1)
    std = standard_deviations(covariance)
    largest = largest_deviation(std, away)
    # The norm hardly depends on a single draw: the mean less one draw is n / (n - 1) as far.
    norms = np.linalg.norm(away, axis=1) * count / (count - 1)
    return Region(
        tuple(names), tuple(labels), tuple(units), values, covariance,
        factor=quantile(left_out(largest, count), LEVEL),
        ellipsoid=quantile(left_out(mahalanobis(away, covariance), count), LEVEL),
        rho=quantile(norms, LEVEL), draws=away, prior_driven=prior_driven, undetermined=std <= 0.0,
    )  # fmt: skip


def region_of_normal(
    names: Sequence[str],
    labels: Sequence[str],
    units: Sequence[str],
    values: np.ndarray,
    covariance: np.ndarray,
    undetermined: np.ndarray,
    seed: int = 0,
) -> Region:
    """The sets of a normal law; of ``undetermined`` parameters (k,) alone it says nothing."""
    away = normal_deviations(covariance, seed)
    count = root_of(covariance).shape[1]
    std = np.where(undetermined, 0.0, standard_deviations(covariance))
    largest = largest_deviation(std, away)
    return Region(
        tuple(names), tuple(labels), tuple(units), values, covariance, factor=quantile(largest, LEVEL),
        ellipsoid=float(np.sqrt(chi2.ppf(LEVEL, max(count, 1)))), rho=quantile(np.linalg.norm(away, axis=1), LEVEL),
        draws=None, prior_driven=np.zeros(len(values), bool), undetermined=undetermined | (std <= 0.0),
    )  # fmt: skip


def norm_term(sliding: np.ndarray, rho: float, width: float) -> np.ndarray:
    """Change of the parameters (N, k) that opposes any error in the ball, with ``sliding`` s = Y' r (N, k)."""
    size = np.linalg.norm(sliding, axis=-1, keepdims=True)
    return -rho * sliding / np.maximum(size, width)


def ellipsoid_term(sliding: np.ndarray, covariance: np.ndarray, ellipsoid: float, width: float) -> np.ndarray:
    """Change of the parameters (N, k) that opposes any error in the ellipsoid of V (k, k) and rho_V, with s = Y' r (N, k)."""
    along = sliding @ covariance
    size = np.sqrt(np.maximum(np.sum(along * sliding, axis=-1, keepdims=True), 0.0))
    return -ellipsoid * along / np.maximum(size, width)


def tracking_bound(
    rho: float, width: float, gains: np.ndarray, rate: float, eigenvalues: tuple[float, float], other: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of every |r_j| and of every joint's error (n,), from rest on the path on.

    ``rho`` and ``width`` are radius and boundary layer of the term in use, ``gains`` the diagonal of K (n,) [N m s/rad], ``rate``
    the factor of e in v_r [1/s], ``eigenvalues`` the smallest and largest of ``K^-1/2 M K^-1/2`` [s], and ``other`` the largest
    torques that no parameter explains, by joint (n,) or the same for all [N m].
    """
    root = np.sqrt(gains)
    force = float(np.linalg.norm(other / root))
    radius = 0.5 * (force + np.sqrt(force**2 + rho * width))
    sliding = np.sqrt(eigenvalues[1] / eigenvalues[0]) * radius / root
    return sliding, sliding / rate


def effort_ratio(columns: np.ndarray, covariance: np.ndarray, ellipsoid: float, rho: float, seed: int = 0) -> float:
    """Median of ``||Y u||`` of the ball over that of the ellipsoid, outside of their layers, over states' Y (N, n, k)."""
    rng = np.random.default_rng([seed, 17])
    sliding = np.einsum("tjk,tj->tk", columns, rng.normal(size=columns.shape[:2]))
    ball = norm_term(sliding, rho, 1e-300)
    ellipse = ellipsoid_term(sliding, covariance, ellipsoid, 1e-300)
    efforts = [np.linalg.norm(np.einsum("tjk,tk->tj", columns, u), axis=1) for u in (ball, ellipse)]
    return float(np.median(efforts[0] / np.maximum(efforts[1], 1e-300)))
