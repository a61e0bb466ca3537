"""Least squares with factors that are not negative, from normal equations, without the import of a library for it."""

from __future__ import annotations

import numba
import numpy as np

#: A factor joins where the error falls by more than this share of the largest slope at zero.
_LEVEL = 1e-12


def non_negative_least_squares(gram: np.ndarray, products: np.ndarray) -> np.ndarray:
    """The x that are not negative and make ``x'Ax / 2 - b'x`` least (m,), by active sets [Lawson1974]_.

    Parameters
    ----------
    gram
        A, positive definite (m, m).
    products
        b (m,).
    """
    return _active_set(np.ascontiguousarray(gram, float), np.ascontiguousarray(products, float))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _active_set(gram, products):
    m = len(products)
    x, trial, slope = np.zeros(m), np.zeros(m), products.copy()
    free, chosen, count = np.zeros(m, np.bool_), np.zeros(m, np.int64), 0
    root = np.zeros((m, m))  # Cholesky factor of the chosen factors' part of A
    level = _LEVEL * max(np.abs(products).max(), 1e-300)
    for _ in range(3 * m):
        best, steepest = -1, level
        for k in range(m):
            if not free[k] and slope[k] > steepest:
                best, steepest = k, slope[k]
        if best < 0:
            break
        chosen[count], free[best] = best, True
        _append(root, gram, chosen, count)
        count += 1
        while count > 0:
            _solve(root, products, chosen, count, trial)
            step, leaves = 1.0, -1
            for i in range(count):
                if trial[i] <= 0.0:
                    share = x[chosen[i]] / (x[chosen[i]] - trial[i])
                    if leaves < 0 or share < step:
                        step, leaves = share, i
            for i in range(count):
                x[chosen[i]] += step * (trial[i] - x[chosen[i]])
            if leaves < 0:
                break
            x[chosen[leaves]] = 0.0
            kept = 0
            for i in range(count):
                if x[chosen[i]] > 0.0:
                    chosen[kept] = chosen[i]
                    kept += 1
                else:
                    x[chosen[i]], free[chosen[i]] = 0.0, False
            count = kept
            for i in range(count):
                _append(root, gram, chosen, i)
        for k in range(m):
            slope[k] = products[k]
            for i in range(count):
                slope[k] -= gram[k, chosen[i]] * x[chosen[i]]
    return x


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _append(root, gram, chosen, count):
    """One more row of the Cholesky factor."""
    for i in range(count + 1):
        total = gram[chosen[count], chosen[i]]
        for k in range(i):
            total -= root[count, k] * root[i, k]
        root[count, i] = np.sqrt(max(total, 1e-300)) if i == count else total / root[i, i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _solve(root, products, chosen, count, out):
    """The least squares of the chosen factors alone."""
    for i in range(count):
        total = products[chosen[i]]
        for k in range(i):
            total -= root[i, k] * out[k]
        out[i] = total / root[i, i]
    for i in range(count - 1, -1, -1):
        out[i] /= root[i, i]
        for k in range(i):
            out[k] -= root[i, k] * out[i]
