"""Compiled recursions against plain loops."""

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from bayesid.signals.autoregression import autocovariance, fit, mix


def burg(series, order):
    """The textbook's recursion with shrinking arrays, for one channel."""
    pairs, polynomial = [(x.copy(), x.copy()) for x in series], np.array([1.0])
    variance = sum(x @ x for x in series) / sum(map(len, series))
    out = [(polynomial, variance)]
    for _ in range(order):
        pairs = [(f[1:], b[:-1]) for f, b in pairs]
        reflection = -2.0 * sum(f @ b for f, b in pairs) / sum(f @ f + b @ b for f, b in pairs)
        pairs = [(f + reflection * b, b + reflection * f) for f, b in pairs]
        extended = np.append(polynomial, 0.0)
        polynomial, variance = extended + reflection * extended[::-1], variance * (1.0 - reflection**2)
        out.append((polynomial, variance))
    return out


def test_polynomials_are_those_of_burgs_recursion_over_all_recordings():
    rng = np.random.default_rng(0)
    series = [lfilter([1.0], [1.0, -1.2, 0.5], rng.normal(size=(n, 2)), axis=0) for n in (4, 60, 200)]
    polynomials, variances = fit(series, 6)
    for c in range(2):
        for p, (polynomial, variance) in enumerate(burg([s[:, c] for s in series], 6)):
            np.testing.assert_allclose(polynomials[c, p, : p + 1], polynomial, rtol=1e-10, atol=1e-13)
            np.testing.assert_allclose(variances[c, p], variance, rtol=1e-10)
            assert not polynomials[c, p, p + 1 :].any()


def test_what_was_taken_is_added_to_the_autocovariance():
    rng = np.random.default_rng(1)
    series, taken = [rng.normal(size=(n, 1)) for n in (80, 50)], [0.3 * rng.normal(size=(n, 1, 5)) for n in (80, 50)]
    order, rows = 4, 130
    alone, power = burg([s[:, 0] for s in series], order)[-1]
    covariance = power * autocovariance(alone, order)
    for lag in range(order + 1):
        covariance[lag] += sum(np.sum(z[lag:] * z[: len(z) - lag]) for z in taken) / rows
    polynomials, variances = fit(series, order, taken)
    for p in range(1, order + 1):
        expected = solve_toeplitz(covariance[:p], -covariance[1 : p + 1])
        np.testing.assert_allclose(polynomials[0, p, 1 : p + 1], expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(variances[0, p], covariance[0] + expected @ covariance[1 : p + 1], rtol=1e-9)


def test_autocovariance_is_that_of_a_long_impulse_response():
    polynomial = np.array([1.0, -1.2, 0.5, 0.1])
    response = lfilter([1.0], polynomial, np.eye(1, 400)[0])
    expected = [response[: len(response) - lag] @ response[lag:] for lag in range(9)]
    np.testing.assert_allclose(autocovariance(polynomial, 8), expected, rtol=1e-10)
    np.testing.assert_allclose(autocovariance(np.array([1.0]), 2), [1.0, 0.0, 0.0])


def test_channels_are_mixed():
    rng = np.random.default_rng(2)
    matrix, rows = np.tril(rng.normal(size=(3, 3))), rng.normal(size=(7, 3, 4))
    np.testing.assert_allclose(mix(matrix, rows), np.einsum("cd,tdj->tcj", matrix, rows), rtol=1e-13)
    np.testing.assert_allclose(mix(matrix, rows[..., 0]), rows[..., 0] @ matrix.T, rtol=1e-13, atol=1e-15)
