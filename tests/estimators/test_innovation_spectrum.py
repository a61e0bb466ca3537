"""Covariance of efficient fits where whitening by a recursion a channel is not right, against sums written out and repeats."""

import numpy as np
import pytest

from bayesid.estimators import fit
from bayesid.estimators.covariance import LEAST, covariance_of_sums, innovation_spectra, whitened_middle
from bayesid.estimators.factor import whitened
from bayesid.estimators.weights import learn_weights
from bayesid.regression.regression import Regression

ROWS, CHANNELS, SHAPES = 500, 2, 3
TRUTH = np.array([1.0, -2.0, 0.5])


def motion():
    """A slow regressor (rows, channels, p), below a fortieth of the highest frequency."""
    rng = np.random.default_rng(0)
    t = np.arange(ROWS) / ROWS
    phases = rng.uniform(0, 2 * np.pi, (4, CHANNELS, SHAPES))
    return sum(np.sin(2 * np.pi * (k + 1.3) * t[:, None, None] + phases[k]) for k in range(4))


def recorded(matrix, rng):
    """Readings with white noise, and with that of one encoder in both channels, which grows with the square of the frequency."""
    encoder = np.diff(rng.normal(size=ROWS + 2), 2)[:, None] * np.array([0.8, 1.0])
    return matrix @ TRUTH + 0.3 * rng.normal(size=(ROWS, CHANNELS)) + encoder


@pytest.fixture(scope="module")
def regression():
    matrix = motion()
    return Regression.from_arrays(matrix, recorded(matrix, np.random.default_rng(1)))


def test_it_is_the_sum_written_out(regression):
    """Octaves of a cosine transform by its definition, one coefficient after the other."""
    weights = learn_weights(regression)
    spectrum = innovation_spectra(regression, weights)["trajectory"]
    ((_, white),) = list(whitened(regression.rows.blocks(), weights.noise))
    n, k = len(white), np.arange(len(white))
    cosines = np.sqrt(2.0 / n) * np.cos(np.pi * np.outer(k, k + 0.5) / n)
    cosines[0] /= np.sqrt(2.0)
    middle = np.zeros((SHAPES, SHAPES))
    for f, row in enumerate(cosines):
        z = np.tensordot(row, white[:, :, :-1], 1)
        band = next(b for b, edge in enumerate(spectrum.edges) if f < np.ceil(edge * n))
        middle += z.T @ spectrum.covariance[band] @ z
    np.testing.assert_allclose(whitened_middle(regression, weights), middle, rtol=1e-9)
    counts = np.diff(np.ceil(np.append(0.0, spectrum.edges) * n))
    assert counts[0] >= LEAST and spectrum.edges[-1] == 1.0
    # Whitening to first order in the dark: at low frequencies it calls noise quiet that is not.
    assert np.diag(spectrum.covariance[0]).max() > 1.3


@pytest.mark.slow
def test_intervals_hold_what_repeats_scatter_by():
    """Two hundred recordings; the plain formula of efficient fits would be too short."""
    matrix, rng = motion(), np.random.default_rng(2)
    values, stated, plain = [], [], []
    for _ in range(200):
        regression = Regression.from_arrays(matrix, recorded(matrix, rng))
        estimate = fit(regression, "gls")
        values.append(estimate.values)
        stated.append(estimate.std)
        white = np.concatenate([w for _, w in whitened(regression.rows.blocks(), learn_weights(regression).noise)])
        flat = white[:, :, :-1].reshape(-1, SHAPES)
        plain.append(np.sqrt(np.diag(np.linalg.inv(flat.T @ flat))))
    scatter = np.std(values, axis=0, ddof=1)
    # A standard deviation of 200 repeats is known to 5 %.
    ratio = np.sqrt(np.mean((scatter / np.mean(stated, axis=0)) ** 2))
    assert 0.85 < ratio < 1.15, ratio
    assert np.sqrt(np.mean((scatter / np.mean(plain, axis=0)) ** 2)) > 1.25


@pytest.mark.parametrize("count", [5, pytest.param(41, marks=pytest.mark.slow)])
def test_a_variance_from_few_makes_intervals_that_hold(count):
    """A value of unknown variance, which others of the same tell: 95 % of intervals 1.96 deviations wide hold zero."""
    draws = np.random.default_rng(3).normal(size=(20000, count + 1))
    std = np.sqrt([covariance_of_sums(own[1:, None])[0, 0] for own in draws])
    assert np.mean(np.abs(draws[:, 0]) <= 1.96 * std) == pytest.approx(0.95, abs=0.005)
