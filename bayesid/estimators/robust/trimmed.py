"""A robust starting point: the fit to the half of a recording with the smallest residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from bayesid.estimators.robust.segments import Residuals, lengths, metrics, residuals, weighted
from bayesid.regression.blocks import Block
from bayesid.regression.linalg import or_one, standard_deviations
from bayesid.signals.noise import NoiseModel

_ABSOLUTE_PASSES, _TRIMMED_PASSES = 20, 12
#: Root of the weight of the other half: next to nothing, but enough to hold directions that it alone shows.
_TRIMMED_WEIGHT = 0.03


def trimmed(blocks: Sequence[Block]) -> tuple[np.ndarray, dict[str, NoiseModel]]:
    """Fit to the half of the segments with the smallest residuals [Agullo2008]_, and the size of the noise without colour.

    Least absolute lengths come first: convex, and a segment's pull does not grow with its length.
    """
    columns = blocks[0].rows.shape[2] - 1
    residual = residuals(blocks, np.zeros(columns))
    half = (len(residual.values) + columns // residual.values.shape[1] + 1) // 2
    rows = np.bincount(residual.segment)
    use = np.ones(len(residual.values))
    values, scale = np.zeros(columns), _spread(residual, centred=True)
    for k in range(_ABSOLUTE_PASSES + _TRIMMED_PASSES):
        last = values
        values = _solve_gram(sum((_gram(b, scale[b.group]) for b in weighted(blocks, residual, use)), np.zeros(())))
        residual = residuals(blocks, values)
        scale = _spread(residual)
        z = np.empty(len(residual.values))
        for group, mask in residual.groups().items():
            z[mask] = np.mean((residual.values[mask] / scale[group]) ** 2, axis=1)
        power = np.bincount(residual.segment, z) / rows
        if k < _ABSOLUTE_PASSES:
            use = np.maximum(power, 1e-6)[residual.segment] ** -0.25  # the root of the weight 1 / length
        else:
            order = np.argsort(power)
            kept = np.zeros(len(power), bool)
            kept[order[: int(np.searchsorted(np.cumsum(rows[order]), half)) + 1]] = True
            use = np.where(kept[residual.segment], 1.0, _TRIMMED_WEIGHT)
            if k > _ABSOLUTE_PASSES and np.allclose(values, last, rtol=1e-12, atol=0.0):
                break
    noise = {}
    for group, mask in residual.groups().items():
        kept = residual.values[mask & (use == 1.0)]
        channels = kept.shape[1]
        size = kept.T @ kept / len(kept) if len(kept) >= 3 * channels else np.diag(scale[group] ** 2)
        size = size + np.diag(1e-10 * np.diag(size) + 1e-20 * max(np.diag(size).max(), 1e-200))
        # The better half is too quiet; the median of all segments is that of normal ones.
        white = NoiseModel(np.ones((channels, 1)), size)
        alone = replace(residual, values=residual.values[mask], segment=residual.segment[mask], poses=residual.poses[mask])
        q, n = lengths(alone, metrics(alone, {group: white}), np.ones(len(alone.values), bool))
        ratio = float(np.median(q[n > 0] / chi2.median(n[n > 0])))
        noise[group] = NoiseModel(white.coefficients, max(ratio, 1e-12) * size)
    return values, noise


def _spread(residual: Residuals, centred: bool = False) -> dict[str, np.ndarray]:
    """Robust standard deviation of each group's channels, from the median of absolute residuals."""
    out = {}
    for group, mask in residual.groups().items():
        rows = residual.values[mask]
        size = 1.4826 * np.median(np.abs(rows - np.median(rows, axis=0) if centred else rows), axis=0)
        out[group] = np.maximum(size, 1e-9 * max(size.max(), 1e-100))
    return out


def _gram(block: Block, scale: np.ndarray) -> np.ndarray:
    flat = (block.rows / scale[:, None]).reshape(-1, block.rows.shape[2])
    return flat.T @ flat


def _solve_gram(gram: np.ndarray) -> np.ndarray:
    """Least squares from the Gram matrix of [X y], good enough to start from."""
    length = or_one(standard_deviations(gram)[:-1])
    return np.linalg.lstsq(gram[:-1, :-1] / np.outer(length, length), gram[:-1, -1] / length, rcond=1e-12)[0] / length
