"""Segments of neighbouring rows: how long their residuals are, what weight that gives them, and windows that are rejected.

A disturbance lasts for several rows: thinning spreads an impact over a few, a contact lasts for a second. So lengths of
residuals are taken over segments, and a rejected window grows from a segment that is too long over its neighbours as long as
those are unusual, too.

A segment of n independent standard normal numbers has the squared length q ~ chi2(n). A loss turns q into the weight w(q) of
all of its rows; least squares is w = 1.

* Huber [Huber1964]_: w = min(1, k / sqrt(q)), where a normal segment is longer than k with a fixed probability.
* Student's t [Lange1989]_: w = (nu + n) / (nu + q), the multivariate t with nu degrees of freedom for whole segments.

The iteration asks of a loss the weights w(q), their slopes w'(q), the scale squared at which the lengths q are as long as normal
ones (``variance``), and the loss with what it learns from all lengths (``fitted``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.special import digamma, gammaln
from scipy.stats import chi2

from bayesid.regression.blocks import Block
from bayesid.signals.noise import NoiseModel

#: Length of a segment [s] and its smallest number of rows.
SEGMENT_SECONDS = 0.2
SEGMENT_ROWS = 4
#: A window grows over neighbouring segments that are longer than all but this share of normal ones ...
GROWTH = 0.01
#: ... and closes over good ones of at most this many segments between two windows.
CLOSED = 2
#: Rows beside a window that go with it: a kernel's main lobe.
MARGIN = 1
_IMPULSE = 4096
#: Probability that Huber's loss leaves a normal segment its whole weight, unless a constant is given.
WHOLE = 0.95
#: Degrees of freedom are looked for in this range; the upper end is as good as normal.
LOWEST_NU, HIGHEST_NU = 1.0, 1000.0
_SCALE_PASSES = 100
#: Squared scale of residuals that are all zero, which divides them still.
_NO_SCALE = 1e-100


@dataclass(frozen=True)
class Residuals:
    """Residuals of all rows, and what is known of each row."""

    values: np.ndarray  # (N, channels)
    #: (N,) [s] and index of the recording.
    times: np.ndarray
    motion: np.ndarray
    run: np.ndarray  # (N,) gap-free pieces of recordings
    segment: np.ndarray  # (N,) segments; a pose is one of its own
    poses: np.ndarray  # (N,) whether the row is one of separate poses
    sizes: tuple[int, ...]  # number of rows of each block

    @property
    def count(self) -> int:
        """Number of segments."""
        return int(self.segment[-1]) + 1

    def groups(self) -> dict[str, np.ndarray]:
        """Which rows belong to each group of noise."""
        masks = {"trajectory": ~self.poses, "poses": self.poses}
        return {name: mask for name, mask in masks.items() if mask.any()}

    @cached_property
    def first(self) -> np.ndarray:
        """First row of each segment."""
        return np.flatnonzero(np.append(True, np.diff(self.segment) > 0))

    def split(self, rows: np.ndarray) -> list[np.ndarray]:
        """An array with an entry for each row, block by block."""
        return np.split(rows, np.cumsum(self.sizes)[:-1])


def residuals(blocks: Iterable[Block], values: np.ndarray) -> Residuals:
    """Residuals of a fit, with the rows laid out in segments."""
    parts, run, segment = [], -1, 0
    for block in blocks:
        residual = block.target - block.matrix @ values
        k = len(residual)
        poses = block.group == "poses"
        step = float(np.median(np.diff(block.times))) if k > 1 else np.inf
        run += int(block.start or not parts or parts[-1][2][0] != block.motion or block.times[0] - parts[-1][1][-1] > 1.5 * step)
        own = np.arange(k) // (1 if poses else max(round(SEGMENT_SECONDS / max(step, 1e-9)), SEGMENT_ROWS))
        parts.append((residual, block.times, np.full(k, block.motion), np.full(k, run), segment + own, np.full(k, poses)))
        segment += int(own[-1]) + 1
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Residuals(*columns, sizes=tuple(len(p[0]) for p in parts))


@dataclass(frozen=True)
class Metric:
    """Covariance of a group's rows at lags 0, 1, ... (lags, channels, channels)."""

    covariance: np.ndarray

    @classmethod
    def of(cls, noise: NoiseModel, lags: int) -> Metric:
        """The metric of a stationary noise model."""
        impulse = np.zeros(_IMPULSE if noise.order else 1)
        impulse[0] = 1.0
        response = np.array([lfilter([1.0], a, impulse) for a in noise.coefficients])
        return cls(
            np.array([
                response[:, lag:] @ response[:, : response.shape[1] - lag].T * noise.innovation
                if lag < response.shape[1] else np.zeros_like(noise.innovation)
                for lag in range(lags)
            ])
        )  # fmt: skip

    def lengths(self, rows: np.ndarray) -> np.ndarray:
        """Squared Mahalanobis lengths of rows (k, channels)."""
        lower = np.linalg.cholesky(self.covariance[0])
        return np.sum(np.linalg.solve(lower, rows.T) ** 2, axis=0)

    @property
    def precision(self) -> np.ndarray:
        """Inverse of the covariance at lag 0."""
        return np.linalg.inv(self.covariance[0])

    def freedom(self) -> np.ndarray:
        """Degrees of freedom of segments of 0 ... lags rows.

        The squared length q of m rows has mean ``c m`` and, where neighbouring rows are alike, a larger variance than
        ``2 c m``: as if there were only ``c m / (1 + (2 / c) sum_l (1 - l / m) |C_l|^2)`` numbers, C_l the
        correlation of whitened rows at lag l.
        """
        inverse = np.linalg.inv(np.linalg.cholesky(self.covariance[0]))
        alike = np.sum((inverse @ self.covariance @ inverse.T) ** 2, axis=(1, 2))
        lags, c = len(alike), self.covariance.shape[1]
        m = np.arange(lags + 1)
        share = np.clip(1.0 - np.arange(1, lags) / np.maximum(m[:, None], 1), 0.0, None)
        return c * m / (1.0 + 2.0 / c * share @ alike[1:])


def metrics(residual: Residuals, noise: dict[str, NoiseModel]) -> dict[str, Metric]:
    """Metrics of all groups, with lags for their longest segment."""
    rows = np.bincount(residual.segment)
    return {g: Metric.of(noise[g], int(rows[residual.segment[mask]].max())) for g, mask in residual.groups().items()}


def lengths(
    residual: Residuals, metric: dict[str, Metric], accepted_rows: np.ndarray, correction: dict[str, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared length q of each segment's good rows and its degrees of freedom n, so that q ~ chi2(n); 0, 0 without any.

    ``correction``: each group's share of the degrees of freedom, see `overdispersion_correction`.
    """
    q, n = np.zeros(residual.count), np.zeros(residual.count)
    for group, mask in residual.groups().items():
        use = mask & accepted_rows
        free = metric[group].freedom() * (1.0 if correction is None else correction[group])
        rows = np.bincount(residual.segment[use], minlength=residual.count)
        channels = residual.values.shape[1]
        squares = np.bincount(residual.segment[use], metric[group].lengths(residual.values[use]), minlength=residual.count)
        q += squares * free[rows] / np.maximum(channels * rows, 1)
        n += free[rows]
    return q, n


def overdispersion_correction(residual: Residuals, metric: dict[str, Metric]) -> dict[str, float]:
    """Correction for overdispersion: share of each group's degrees of freedom that the actual spread of lengths has, at most 1.

    Where an effect is missing in the model, residuals are larger in some segments than in others without any contact. The
    ratio of the lower quartile of q to its median shows that, and is hardly changed by a fifth of contaminated segments;
    chi-squared lengths of fewer degrees of freedom have the same ratio.
    """
    out = {}
    q, n = lengths(residual, metric, np.ones(len(residual.values), bool))
    for group, mask in residual.groups().items():
        own = np.unique(residual.segment[mask])
        typical = float(np.median(n[own]))
        low, middle = np.quantile(q[own] / n[own], (0.25, 0.5))
        seen = low / middle if middle > 0 else 1.0
        grid = typical * np.geomspace(0.02, 1.0, 200)
        ratio = chi2.ppf(0.25, grid) / chi2.median(grid)
        out[group] = float(np.interp(seen, ratio, grid)) / typical
    return out


def accepted(residual: Residuals, q: np.ndarray, n: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Rows outside of the windows that grow from ``seeds``, segments that are too long (N,)."""
    if not seeds.any():
        return np.ones(len(residual.values), bool)
    run, poses = residual.run[residual.first], residual.poses[residual.first]
    together = (run[1:] == run[:-1]) & ~poses[1:] & ~poses[:-1]
    bad, unusual = seeds.copy(), chi2.sf(q, n) < GROWTH
    for order in (slice(None), slice(None, None, -1)):
        b, u, t = bad[order], unusual[order], together[order]
        for k in np.flatnonzero(u[1:] & t) + 1:  # few: the unusual ones only
            b[k] |= b[k - 1]
    # Good segments between two windows of the same run.
    at = np.flatnonzero(bad)
    for a, b in zip(at[:-1], at[1:], strict=True):
        if 1 < b - a <= CLOSED + 1 and together[a:b].all():
            bad[a:b] = True
    rows = bad[residual.segment]
    edge = (residual.run[1:] == residual.run[:-1]) & ~residual.poses[1:] & ~residual.poses[:-1]
    for _ in range(MARGIN):
        wider = rows.copy()
        wider[1:] |= rows[:-1] & edge
        wider[:-1] |= rows[1:] & edge
        rows = wider
    return ~rows


def weighted(blocks: Iterable[Block], residual: Residuals, weights: np.ndarray) -> Iterator[Block]:
    """Blocks with every row times its weight."""
    for block, w in zip(blocks, residual.split(weights), strict=True):
        yield block if (w == 1.0).all() else replace(block, rows=block.rows * w[:, None, None])


def windows(residual: Residuals, accepted_rows: np.ndarray, names: tuple[str, ...]) -> dict[str, list[list[float]]]:
    """Rejected windows of each recording: times of the first and the last row [s]."""
    out: dict[str, list[list[float]]] = {}
    change = np.flatnonzero(np.diff(accepted_rows) | (np.diff(residual.run) != 0)) + 1
    for part in np.split(np.arange(len(accepted_rows)), change):
        if not accepted_rows[part[0]]:
            span = [round(float(residual.times[part[k]]), 4) for k in (0, -1)]
            out.setdefault(names[residual.motion[part[0]]], []).append(span)
    return out


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
        for _ in range(_SCALE_PASSES):
            last, value = value, max(float(np.sum(np.minimum(q, value * limit))) / expected, _NO_SCALE)
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
        for _ in range(_SCALE_PASSES):
            last, value = value, max(float(np.sum(self.weights(q / value, n) * q) / np.sum(n)), _NO_SCALE)
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
