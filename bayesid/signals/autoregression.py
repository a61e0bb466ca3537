"""Recursions in time: whitening polynomials of series by Burg's and Levinson's recursions, autocovariances, moving averages."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"}, forceinline=True)


def fit(series: Sequence[np.ndarray], order: int, taken: Sequence[np.ndarray] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Whitening polynomials of orders 0 ... order and their innovation variances, channel by channel.

    Burg's recursion over all recordings, one array each (k, channels). Where further series (k, channels, p) are ``taken``, whose
    products are summed over p, their mean autocovariance is added to that of Burg's highest order, and the polynomials follow by
    Levinson's recursion, which for Burg's own autocovariance gives Burg's own back. Polynomials are
    ``1, -a_1, ..., -a_p, 0 ...`` of each channel and order p (channels, order + 1, order + 1), variances (channels, order + 1).
    """
    ends = np.cumsum([0, *map(len, series)])
    values = np.ascontiguousarray(np.concatenate(series).T, float)
    polynomials = np.zeros((len(values), order + 1, order + 1))
    variances = np.zeros((len(values), order + 1))
    _burg(values, ends, polynomials, variances)
    if taken:
        added = np.zeros(variances.shape)
        for z in taken:
            _add_lagged_products(np.ascontiguousarray(z, float), added)
        _levinson(added / ends[-1], polynomials, variances)
    return polynomials, variances


@_jit
def _burg(values, ends, polynomials, variances):
    for c in range(len(values)):
        forward, backward = values[c].copy(), values[c].copy()
        power = 0.0
        for x in values[c]:
            power += x * x
        polynomials[c, 0, 0], variances[c, 0] = 1.0, power / max(len(values[c]), 1)
        for p in range(1, variances.shape[1]):
            product, power = 0.0, 0.0
            for r in range(len(ends) - 1):
                for t in range(ends[r] + p, ends[r + 1]):
                    product += forward[t] * backward[t - 1]
                    power += forward[t] * forward[t] + backward[t - 1] * backward[t - 1]
            reflection = -2.0 * product / power if power > 0.0 else 0.0
            for r in range(len(ends) - 1):
                for t in range(ends[r + 1] - 1, ends[r] + p - 1, -1):
                    f, b = forward[t], backward[t - 1]
                    forward[t], backward[t] = f + reflection * b, b + reflection * f
            _raise_order(polynomials[c], variances[c], p, reflection)


@_jit
def _levinson(added, polynomials, variances):
    for c in range(len(added)):
        a, variance, order = polynomials[c], variances[c], added.shape[1] - 1
        if variance[order] <= 0.0:
            continue
        # Autocovariance of the highest order, from one order to the next.
        covariance = np.zeros(order + 1)
        covariance[0] = variance[0]
        for p in range(1, order + 1):
            covariance[p] = -a[p, p] * variance[p - 1]
            for k in range(1, p):
                covariance[p] -= a[p - 1, k] * covariance[p - k]
        covariance += added[c]
        a[:], variance[0] = 0.0, covariance[0]
        a[0, 0] = 1.0
        for p in range(1, order + 1):
            total = 0.0
            for k in range(p):
                total += a[p - 1, k] * covariance[p - k]
            _raise_order(a, variance, p, -total / variance[p - 1])


@_jit
def _raise_order(polynomials, variances, p, reflection):
    """Levinson's step from order p - 1 to p."""
    for k in range(p + 1):
        polynomials[p, k] = polynomials[p - 1, k] + reflection * polynomials[p - 1, p - k]
    variances[p] = variances[p - 1] * (1.0 - reflection * reflection)


@_jit
def _add_lagged_products(z, out):
    """Sums over time and the last axis of ``z_t z_{t - lag}`` by channel (channels, lags)."""
    rows, channels, width = z.shape
    for c in range(channels):
        for t in range(rows):
            here, lags = z[t, c], min(t + 1, out.shape[1])
            lag = 0
            while lag + 4 < lags:  # a few lags at once: their sums do not wait for each other
                z0, z1, z2, z3, z4 = z[t - lag, c], z[t - lag - 1, c], z[t - lag - 2, c], z[t - lag - 3, c], z[t - lag - 4, c]
                s0 = s1 = s2 = s3 = s4 = 0.0
                for j in range(width):
                    x = here[j]
                    s0 += x * z0[j]
                    s1 += x * z1[j]
                    s2 += x * z2[j]
                    s3 += x * z3[j]
                    s4 += x * z4[j]
                out[c, lag] += s0
                out[c, lag + 1] += s1
                out[c, lag + 2] += s2
                out[c, lag + 3] += s3
                out[c, lag + 4] += s4
                lag += 5
            for rest in range(lag, lags):
                total = 0.0
                for j in range(width):
                    total += here[j] * z[t - rest, c, j]
                out[c, rest] += total


def autocovariance(polynomial: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariance at lags 0 ... lags of a stationary recursion with unit innovations."""
    p = len(polynomial) - 1
    # Yule-Walker: sum_k a_k g(|j - k|) = [j = 0], for j = 0 ... p.
    j, k = np.indices((p + 1, p + 1))
    system = np.zeros((p + 1, p + 1))
    np.add.at(system, (j, np.abs(j - k)), np.broadcast_to(polynomial, (p + 1, p + 1)))
    values = list(np.linalg.solve(system, np.eye(p + 1)[0]))
    while len(values) <= lags:
        values.append(-float(np.dot(polynomial[1:], values[-1 : -p - 1 : -1])))
    return np.array(values[: lags + 1])


def moving_average(polynomial: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Moving average along the first axis, from the zero state."""
    if len(polynomial) == 1 and polynomial[0] == 1.0:
        return rows
    out = polynomial[0] * rows
    for k in range(1, len(polynomial)):
        out[k:] += polynomial[k] * rows[:-k]
    return out


def channel_products(rows: np.ndarray) -> np.ndarray:
    """Sums over time and the last axis of products of channels (channels, channels) of rows (k, channels, p)."""
    flat = np.ascontiguousarray(np.swapaxes(rows, 0, 1)).reshape(rows.shape[1], -1)
    return flat @ flat.T


def mix(matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Apply a channels x channels matrix to rows (k, channels, ...)."""
    flat = np.ascontiguousarray(rows, float).reshape(*rows.shape[:2], -1)
    out = np.empty(flat.shape)
    _mix(np.ascontiguousarray(matrix, float), flat, out)
    return out.reshape(rows.shape)


@_jit
def _mix(matrix, rows, out):
    for t in range(len(rows)):
        for c in range(len(matrix)):
            factor = matrix[c, 0]
            for j in range(rows.shape[2]):
                out[t, c, j] = factor * rows[t, 0, j]
            for d in range(1, len(matrix)):
                if matrix[c, d] != 0.0:  # triangular ones are half empty
                    factor = matrix[c, d]
                    for j in range(rows.shape[2]):
                        out[t, c, j] += factor * rows[t, d, j]
