"""Robust control with these bounds: Spong's term, its ellipsoidal form, and what tracking error they leave.

With e = q - q_d, r = v - v_r, v_r = v_d - rate e, and the columns Y of M a_r + C v_r + g, the controller

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

import numpy as np


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
