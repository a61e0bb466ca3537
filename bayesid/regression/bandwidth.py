"""Bandwidth of the joint motion by what it does to predictions: the error on parts of the recording that were left out.

Cross-validation of the positions alone (`bayesid.signals.smoothing.choose_smoother`) asks which frequencies of the positions
are not encoder noise. On a real arm that is not the question: positions that were resampled or filtered have no white noise,
and joints vibrate at frequencies at which the readings do not follow a rigid model. So bandwidths from that choice downwards
are tried. Each is fitted to three quarters of the parts of the fitted motions and judged on the rest, always on residuals in
the same band,

    error(B) = mean over parts of sum_c |residual_c|^2 / mean |residual_c at the first bandwidth|^2,

and the largest bandwidth is taken whose error is not larger than the smallest one by more than `WORTH` and by more than chance,
twice the standard error of the differences part by part: where the model holds, lower ones predict no better, and a lower
bandwidth leaves readings unused. Where the positions' own choice is the end of the range searched it is no choice: their noise
is not what the search takes it for, and biases accelerations the more the higher the bandwidth. That of the smallest error is
taken then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from bayesid.regression.blocks import Block
from bayesid.regression.linalg import solve

#: Largest ratio of neighbouring bandwidths that are tried, and the lowest of them [Hz]: below it rows hold little but the motion,
#: that of validation motions included, which these errors do not see.
RATIO, LOWEST = 2.0**0.5, 5.0
#: Relative difference of two errors (of power; half of it in amplitude) that is not worth a lower bandwidth.
WORTH = 0.05
#: Band of the residuals that judge [Hz]; rows at every bandwidth hold it.
BAND = 8.0
_PARTS, _FOLDS = 8, 4
_SHORTEST = 8  # rows of a part


@dataclass(frozen=True)
class BandwidthChoice:
    """Bandwidths that were tried, and what they do to predictions and to the estimate."""

    bandwidths: np.ndarray  # (b,) [Hz], falling
    error: np.ndarray  # residual power on parts that were left out, relative to the first bandwidth (b,)
    estimates: np.ndarray  # channel-weighted least squares at each bandwidth (b, p)
    chosen: int  # index of the one taken


def candidates(highest: float) -> np.ndarray:
    """Bandwidths to try, falling in equal ratios to the lowest [Hz]."""
    steps = int(np.ceil(max(np.log(highest / LOWEST), 0.0) / np.log(RATIO) - 1e-9))
    return np.geomspace(highest, min(highest, LOWEST), steps + 1)


def choose_bandwidth(rows: Callable[[float], Sequence[Block]], highest: float, at_end: bool = False) -> BandwidthChoice | None:
    """Judge bandwidths by parts that were left out; None where there is nothing to choose or too little to judge by.

    ``rows`` gives those of the fitted motions at a bandwidth; their times may differ from one to the next. The first one tried
    is the ``highest`` [Hz]; ``at_end`` says whether that is the end of the range that the positions were searched in.
    """
    bandwidths = candidates(highest)
    if len(bandwidths) < 2:
        return None
    tried = [tuple(rows(float(b))) for b in bandwidths]
    edges = _intervals(tried[-1])
    while len(tried) > 1 and min((len(_part(tried[-1], edge)) for edge in edges), default=0) < _SHORTEST:
        tried = tried[:-1]  # a short recording: slow rows are too few
        edges = _intervals(tried[-1])
    if len(tried) < 2 or len(edges) < _FOLDS:
        return None
    scale = np.ones(tried[0][0].rows.shape[1])
    powers, estimates = [], []
    for k, blocks in enumerate(tried):
        parts = [_part(blocks, edge) for edge in edges]
        # Rows are reduced once, part by part and channel by channel: other weights and folds need the factors alone.
        reduced = [_by_channel(rows) for rows in (*parts, *(b.rows for b in blocks if b.group == "poses"))]
        if k == 0:
            for _ in range(2):
                scale = _scale(_solved([_weighted(factors, scale) for factors in reduced]), parts)
        factors = [_weighted(factors, scale) for factors in reduced]
        power = np.zeros((len(parts), len(scale)))
        for fold in range(_FOLDS):
            found = _solved([factor for i, factor in enumerate(factors) if i >= len(parts) or i % _FOLDS != fold])
            for i in range(fold, len(parts), _FOLDS):
                power[i] = _band_power(parts[i][:, :, -1] - parts[i][:, :, :-1] @ found, edges[i])
        powers.append(power)
        estimates.append(_solved(factors))
    error = np.array([np.sum(power / powers[0].mean(axis=0), axis=1) for power in powers])  # (bandwidths, parts)
    mean = error.mean(axis=1)
    best = int(np.argmin(mean))
    doubt = np.std(error - error[best], axis=1, ddof=1) / np.sqrt(error.shape[1])
    as_good = np.flatnonzero(mean - mean[best] <= np.maximum(WORTH * mean[best], 2.0 * doubt))
    chosen = best if at_end else int(as_good[0])
    return BandwidthChoice(bandwidths[: len(tried)], mean / mean[0], np.array(estimates), chosen)


def _intervals(blocks: Sequence[Block]) -> list[tuple[int, float, float]]:
    """Motion, start and end [s] of parts about equally long, within blocks that follow one another."""
    spans: list[list] = []
    for b in blocks:
        if b.group == "poses" or len(b.times) < 2:
            continue
        if spans and not b.start and spans[-1][0] == b.motion and b.times[0] > spans[-1][2]:
            spans[-1][2] = b.times[-1]
        else:
            spans.append([b.motion, b.times[0], b.times[-1]])
    whole = sum(end - start for _, start, end in spans)
    out = []
    for motion, start, end in spans:
        count = max(round(_PARTS * (end - start) / whole), 1)
        cuts = np.linspace(start, end, count + 1)
        out += [(motion, float(a), float(b)) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    return out


def _part(blocks: Sequence[Block], edge: tuple[int, float, float]) -> np.ndarray:
    """Rows of a part (k, channels, p + 1)."""
    motion, start, end = edge
    own = [b for b in blocks if b.motion == motion and b.group != "poses"]
    return np.concatenate([b.rows[(b.times >= start) & (b.times < end)] for b in own] or [np.zeros((0, 1, 1))])


def _factor(rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _by_channel(rows: np.ndarray) -> list[np.ndarray]:
    """Triangular factor of each channel's rows (k, channels, p + 1)."""
    return [_factor(rows[:, c]) for c in range(rows.shape[1])]


def _weighted(factors: Sequence[np.ndarray], scale: np.ndarray) -> np.ndarray:
    """Factor of all channels' rows over their scales (c,)."""
    return _factor(np.concatenate([factor / s for factor, s in zip(factors, scale, strict=True)]))


def _solved(factors: Sequence[np.ndarray]) -> np.ndarray:
    """Least squares of all rows behind some factors (p,)."""
    factor = _factor(np.concatenate(factors))
    return solve(factor[:, :-1], factor[:, -1])


def _scale(found: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    residual = np.concatenate([part[:, :, -1] - part[:, :, :-1] @ found for part in parts])
    size = np.sqrt(np.mean(residual**2, axis=0))
    return np.maximum(size, 1e-9 * max(float(size.max()), 1e-300))


def _band_power(residual: np.ndarray, edge: tuple[int, float, float]) -> np.ndarray:
    """Energy of residual rows (k, c) in the band over their time, whatever the rate of rows (c,).

    Rows are scaled to the noise of one sample, which makes a slow signal larger by the root of the samples that a row stands for:
    its energy is the same in many rows and in few.
    """
    duration, n = edge[2] - edge[1], len(residual)
    count = min(max(int(2.0 * duration * BAND), 1), n)
    return np.sum(np.asarray(dct(residual, axis=0, norm="ortho"))[:count] ** 2, axis=0) / duration
