"""Segments of neighbouring rows, and windows in time that are rejected as a whole.

A disturbance lasts for several rows: thinning spreads an impact over a few, a contact lasts for a second. So lengths of
residuals are taken over segments, and a rejected window grows from a segment that is too long over its neighbours as long as
those are unusual, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import lfilter
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
