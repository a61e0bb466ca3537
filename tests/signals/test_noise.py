import numpy as np
import pytest
from scipy.signal import lfilter

from bayesid.signals.noise import NoiseModel, estimate_noise

COEFFICIENTS = np.array([[1, -1.2, 0.5], [1, -0.5, -0.3]])
INNOVATION = np.array([[1.0, 0.4], [0.4, 2.0]])


def dense(model, rows):
    """Covariance by inverting the whitening of unit vectors: the slow oracle."""
    channels = len(model.innovation)
    whitening = model.whiten(np.eye(rows * channels).reshape(rows, channels, -1)).reshape(rows * channels, -1)
    inverse = np.linalg.inv(whitening)
    return inverse @ inverse.T


def draw(rng, rows, from_zero=True):
    u = rng.multivariate_normal(np.zeros(2), INNOVATION, size=rows)
    return np.stack([lfilter([1.0], COEFFICIENTS[c], u[:, c]) for c in range(2)], axis=1)


def test_covariance_is_that_of_the_recursion():
    rng = np.random.default_rng(0)
    u = rng.multivariate_normal(np.zeros(2), INNOVATION, size=(40_000, 12))
    draws = np.stack([lfilter([1.0], COEFFICIENTS[c], u[:, :, c]) for c in range(2)], axis=2).reshape(len(u), -1)
    np.testing.assert_allclose(dense(NoiseModel(COEFFICIENTS, INNOVATION, True), 12), np.cov(draws.T), atol=0.15)


def test_stationary_start_has_the_same_variance_everywhere():
    model = NoiseModel(COEFFICIENTS, INNOVATION)
    variance = np.diag(dense(model, 30)).reshape(30, 2)
    np.testing.assert_allclose(variance, np.broadcast_to(model.std**2, (30, 2)), rtol=1e-9)


@pytest.mark.parametrize("from_zero", [True, False])
def test_coloured_rows_give_the_covariance_of_sums(from_zero):
    model = NoiseModel(COEFFICIENTS, INNOVATION, from_zero)
    x = np.random.default_rng(1).normal(size=(40, 2, 3))
    z = model.colour_transposed(x).reshape(80, 3)
    flat = x.reshape(80, 3)
    np.testing.assert_allclose(z.T @ z, flat.T @ dense(model, 40) @ flat, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("from_zero", [True, False])
@pytest.mark.parametrize("rows", [1, 2, 40])
def test_whitening_transposed_is_the_transpose(rows, from_zero):
    model = NoiseModel(COEFFICIENTS, INNOVATION, from_zero)
    x, z = np.random.default_rng(3).normal(size=(2, rows, 2))
    assert np.isclose(np.sum(model.whiten_transposed(z) * x), np.sum(z * model.whiten(x)), rtol=1e-10)


@pytest.mark.parametrize("from_zero", [True, False])
@pytest.mark.parametrize("cut", [1, 2, 17, 39])
def test_whitening_runs_on_over_blocks(cut, from_zero):
    """Also where the first block is shorter than the order of the recursion."""
    model = NoiseModel(COEFFICIENTS, INNOVATION, from_zero)
    x = np.random.default_rng(2).normal(size=(40, 2, 3))
    parts = np.concatenate([model.whiten(x[:cut]), model.whiten(x[cut:], x[:cut])])
    np.testing.assert_allclose(parts, model.whiten(x), atol=1e-12)


def test_estimated_noise_is_the_one_drawn():
    rng = np.random.default_rng(3)
    model = estimate_noise([draw(rng, 4000) for _ in range(3)])
    assert model.order == 2
    np.testing.assert_allclose(model.coefficients, COEFFICIENTS, atol=0.03)
    np.testing.assert_allclose(model.innovation, INNOVATION, rtol=0.05, atol=0.05)


def test_white_noise_is_found_white_and_known_poles_are_kept():
    rng = np.random.default_rng(4)
    assert estimate_noise([rng.normal(size=(3000, 4))]).order == 0
    poles = np.array([0.95, 0.4])
    filtered = lfilter([1.0], np.poly(poles), rng.normal(size=(3000, 4)), axis=0)
    model = estimate_noise([filtered], known_poles=poles)
    assert model.order == 2 and model.from_zero
    np.testing.assert_allclose(model.innovation, np.eye(4), atol=0.1)


def test_variance_is_enlarged_for_fitted_parameters():
    rng = np.random.default_rng(5)
    x = rng.normal(size=(100, 50))
    variances = []
    for _ in range(50):
        e = rng.normal(size=(100, 1))
        residual = e - x @ np.linalg.lstsq(x, e, rcond=None)[0]
        variances.append(estimate_noise([residual], parameters=50, highest_order=0).innovation[0, 0])
    assert abs(np.mean(variances) - 1.0) < 0.1


def test_silence_does_not_break_it():
    model = estimate_noise([np.zeros((50, 3))])
    assert np.isfinite(model.whiten(np.zeros((50, 3)))).all()
