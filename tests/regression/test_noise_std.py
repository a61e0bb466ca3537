"""Noise that is known beforehand: weights, covariances and posteriors are those of the textbook, not of the residuals."""

import warnings

import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz
from scipy.signal import lfilter

import bayesid

SAMPLES, CHANNELS, PARAMETERS = 400, 3, 4
STD = np.array([0.1, 1.0, 5.0])
TRUTH = np.array([1.2, -0.3, 0.05, 2.0])


def arrays(seed: int = 0, std: np.ndarray = STD) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(SAMPLES, CHANNELS, PARAMETERS))
    return matrix, matrix @ TRUTH + std * rng.normal(size=(SAMPLES, CHANNELS))


def by_hand(matrix: np.ndarray, target: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Efficient least squares and its covariance; ``variance`` of all rows (N c,), or their covariance (N c, N c)."""
    x, y = matrix.reshape(-1, PARAMETERS), target.ravel()
    weight = np.diag(1.0 / variance) if variance.ndim == 1 else np.linalg.inv(variance)
    covariance = np.linalg.inv(x.T @ weight @ x)
    return covariance @ x.T @ weight @ y, covariance


@pytest.mark.parametrize("method", ["wls", "gls"])
def test_one_number_a_channel(method):
    matrix, target = arrays()
    estimate = bayesid.fit(bayesid.Regression.from_arrays(matrix, target, noise_std=STD), method)
    values, covariance = by_hand(matrix, target, np.tile(STD**2, SAMPLES))
    np.testing.assert_allclose(estimate.values, values, rtol=1e-9)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=1e-8)
    assert estimate.residual_rms == pytest.approx(1.0, abs=0.1) and estimate.details.dispersion == 1.0


def test_plain_least_squares_has_the_sandwich_of_that_noise():
    matrix, target = arrays()
    estimate = bayesid.fit(bayesid.Regression.from_arrays(matrix, target, noise_std=STD), "ols")
    x = matrix.reshape(-1, PARAMETERS)
    bread = np.linalg.inv(x.T @ x)
    np.testing.assert_allclose(estimate.covariance, bread @ (x.T * np.tile(STD**2, SAMPLES)) @ x @ bread, rtol=1e-8)


@pytest.mark.parametrize("method", ["ols", "wls", "gls"])
def test_one_number_a_sample_and_channel(method):
    std = STD * np.exp(np.random.default_rng(3).normal(size=(SAMPLES, 1)))
    matrix, target = arrays(1, std)
    estimate = bayesid.fit(bayesid.Regression.from_arrays(matrix, target, noise_std=std), method)
    values, covariance = by_hand(matrix, target, std.ravel() ** 2)
    np.testing.assert_allclose(estimate.values, values, rtol=1e-9)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=1e-8)


def test_behind_low_passes_the_noise_has_their_colour_and_the_size_stated():
    low_pass, step = bayesid.LowPass(l=2.0, d=20.0), 0.02
    times = step * np.arange(SAMPLES)
    matrix, target = arrays()
    regression = bayesid.Regression.from_arrays(matrix, target, times=times, low_pass=low_pass, noise_std=STD)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", bayesid.BayesidWarning)  # the target's noise is white
        estimate = bayesid.fit(regression, "gls")
    answer = lfilter([1.0], np.poly(low_pass.poles(step)), np.eye(1, 100_000)[0])
    lower = toeplitz(answer[:SAMPLES], np.zeros(SAMPLES)) / np.linalg.norm(answer)
    order = np.arange(SAMPLES * CHANNELS).reshape(CHANNELS, SAMPLES).T.ravel()
    covariance = block_diag(*(s**2 * lower @ lower.T for s in STD))[np.ix_(order, order)]
    np.testing.assert_allclose(estimate.covariance, by_hand(matrix, target, covariance)[1], rtol=1e-6)


def test_the_posterior_is_the_normal_law_of_that_noise_and_has_no_scales():
    matrix, target = arrays()
    posterior = bayesid.sample(bayesid.Regression.from_arrays(matrix, target, noise_std=STD), draws=4000, seed=1)
    values, covariance = by_hand(matrix, target, np.tile(STD**2, SAMPLES))
    std = np.sqrt(np.diag(covariance))
    assert posterior.model.scale_names == ()
    np.testing.assert_allclose((posterior.values - values) / std, 0.0, atol=0.12)
    np.testing.assert_allclose(posterior.std / std, 1.0, atol=0.08)


@pytest.mark.parametrize("method", ["ols", "wls", "gls", "tls", "iv", "sdp"])
def test_intervals_follow_what_is_stated_in_every_estimator(method):
    rng = np.random.default_rng(5)
    matrix = rng.normal(size=(SAMPLES, CHANNELS, 10))
    body = np.array([2.0, 0.1, 0.0, 0.2, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1])
    target = matrix @ body + 0.01 * STD * rng.normal(size=(SAMPLES, CHANNELS))
    errors = 1e-9 * rng.normal(size=(10, *matrix.shape))
    options = dict(bodies=[range(10)], instruments=matrix, regressor_noise=errors)
    one, two = (bayesid.Regression.from_arrays(matrix, target, noise_std=k * 0.01 * STD, **options) for k in (1.0, 2.0))
    first = bayesid.fit(one, method)
    with pytest.warns(bayesid.BayesidWarning, match="intervals are too long; correct noise_std"):
        second = bayesid.fit(two, method)
    np.testing.assert_allclose(second.std, 2.0 * first.std, rtol=0.02)
    assert "noise_std" in second.details.warnings[-1] and not any("noise_std" in w for w in first.details.warnings)


@pytest.mark.parametrize("method", ["huber", "student"])
def test_robust_estimators_count_outliers_in_that_noise(method):
    matrix, target = arrays()
    spoiled = target.copy()
    spoiled[100:110] += 200.0 * STD
    clean, dirty = (bayesid.fit(bayesid.Regression.from_arrays(matrix, y, noise_std=STD), method) for y in (target, spoiled))
    with pytest.warns(bayesid.BayesidWarning, match="complete the model"):
        plain = bayesid.fit(bayesid.Regression.from_arrays(matrix, spoiled, noise_std=STD), "wls")
    moved, carried = (np.abs(e.values - clean.values).max() / clean.std.max() for e in (dirty, plain))
    assert moved < 1.5 < 10.0 < carried
    np.testing.assert_allclose(clean.std, np.sqrt(np.diag(by_hand(matrix, target, np.tile(STD**2, SAMPLES))[1])), rtol=0.15)


def test_residuals_larger_than_stated_are_told_with_what_to_do():
    matrix, target = arrays()
    with pytest.warns(bayesid.BayesidWarning, match="complete the model, correct noise_std, or leave it out"):
        bayesid.fit(bayesid.Regression.from_arrays(matrix, target, noise_std=STD / 2), "wls")


@pytest.mark.parametrize(
    "std, message",
    [
        (np.ones(5), "give one a channel"),
        (np.array([1.0, 0.0, 1.0]), r"noise_std\[1\] is no standard deviation"),
        (np.full((SAMPLES, CHANNELS), np.nan), r"noise_std\[0, 0\]"),
    ],
)
def test_what_is_no_standard_deviation_is_refused(std, message):
    with pytest.raises(bayesid.InputError, match=message):
        bayesid.Regression.from_arrays(*arrays(), noise_std=std)


def test_one_number_a_sample_does_not_go_with_filters():
    matrix, target = arrays()
    with pytest.raises(bayesid.InputError, match="give one number a channel"):
        bayesid.Regression.from_arrays(
            matrix, target, times=0.02 * np.arange(SAMPLES), low_pass=bayesid.LowPass(1.0, 20.0), noise_std=np.ones(target.shape)
        )
