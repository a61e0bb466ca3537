"""How far the largest of many deviations goes: the size of sets that hold all of them at once.

The size of a set is the 95 % quantile of a distance over draws. Mean and covariance that the distance is measured with come
from the same draws, so every draw would be judged by itself. Each is therefore measured from the mean and covariance of all
the others: with ``C = sum (x_i - m)(x_i - m)'`` of n draws and ``s = (x - m)' C^-1 (x - m)``, leaving one out gives

    d^2 = (n - 2) (n / (n - 1))^2  s / (1 - n s / (n - 1))

(Sherman and Morrison). The quantile is then that of a draw the set has not seen, such as the truth. It is the order statistic
``ceil((n + 1) level)``, which a further draw of the same law stays below with at least that probability.
"""

from __future__ import annotations

import numpy as np

from bayesid.regression.linalg import or_one, standard_deviations

#: Draws of a normal law that quantiles without a closed form are taken from.
NORMAL_DRAWS = 20_000
#: Correlations are trusted to this share of the largest eigenvalue.
_SMALLEST = 1e-12
_PANEL = 2_000_000


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


def directions(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations (k,), and those directions of the correlations that have a variance: values (m,), vectors (k, m)."""
    std = or_one(standard_deviations(covariance), 0.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    keep = values > _SMALLEST * max(float(values.max(initial=0.0)), 1e-300)
    return std, values[keep], vectors[:, keep]


def root_of(covariance: np.ndarray) -> np.ndarray:
    """L with ``L L'`` the covariance (k, m), its m directions that have a variance."""
    std, values, vectors = directions(covariance)
    return std[:, None] * vectors * np.sqrt(values)


def mahalanobis(deviations: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """``sqrt(d' V^-1 d)`` of deviations (n, k), along the directions that have a variance (n,)."""
    std, values, vectors = directions(covariance)
    return np.linalg.norm((deviations / std) @ (vectors / np.sqrt(values)), axis=1)


def largest_deviation(rows: np.ndarray, std: np.ndarray, deviations: np.ndarray) -> np.ndarray:
    """``max_t |rows_t' d| / std_t`` (n,) of deviations d (n, k), over rows (t, k) that have a standard deviation (t,)."""
    used = std > 0.0
    scaled = rows[used] / std[used, None]
    out = np.zeros(len(deviations))
    step = max(_PANEL // max(len(deviations), 1), 1)
    for first in range(0, len(scaled), step):
        np.maximum(out, np.abs(scaled[first : first + step] @ deviations.T).max(axis=0), out=out)
    return out


def normal_deviations(covariance: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Draws of N(0, V), (count, k)."""
    root = root_of(covariance)
    return np.random.default_rng([seed, 11]).normal(size=(count, root.shape[1])) @ root.T
