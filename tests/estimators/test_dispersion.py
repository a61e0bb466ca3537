"""Dispersion between parts: the textbook formula, no effect on noise, intervals that hold where parameters wander."""

import numpy as np
import pytest
from scipy.linalg import sqrtm

import bayesid
from bayesid.estimators.covariance import whitened_middle
from bayesid.estimators.dispersion import PARTS, Dispersion, Rows, dispersions, widening
from bayesid.estimators.weights import learn_weights
from bayesid.posterior.likelihood import Likelihood
from bayesid.regression.regression import Regression


def regression(rng, p=6, channels=2, rows=640, wander=0.0):
    """Slow sines as columns, white noise, and parameters that differ from part to part by ``wander``."""
    times = np.arange(rows) / 20.0
    columns = [np.sin(np.outer(times, rng.uniform(0.5, 12.0, p)) + rng.uniform(0, 6, p)) for _ in range(channels)]
    matrix = np.stack(columns, axis=1)
    own = np.repeat(1.0 + wander * rng.normal(size=(PARTS, p)), rows // PARTS, axis=0)
    target = np.einsum("tcp,tp->tc", matrix, own) + 0.1 * rng.normal(size=(rows, channels))
    return Regression.from_arrays(matrix, target), np.ones(p)


def test_it_is_the_bias_reduced_covariance_of_clustered_rows():
    """Against the definition with whole matrices, one projection a cluster."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(160, 3)), rng.normal(size=160)
    b = np.linalg.lstsq(x, y, rcond=None)[0]
    bread = np.linalg.inv(x.T @ x)
    total = np.zeros((3, 3))
    for rows in np.array_split(np.arange(160), PARTS):
        own = x[rows]
        adjust = np.linalg.inv(np.real(sqrtm(np.eye(len(rows)) - own @ bread @ own.T)))
        pull = bread @ own.T @ adjust @ (y[rows] - own @ b)
        total += np.outer(pull, pull)
    grams = [np.column_stack([x[k], y[k]]).T @ np.column_stack([x[k], y[k]]) for k in np.array_split(np.arange(160), PARTS)]
    (scatter,) = dispersions(Rows(grams), b)
    # The root is taken in other coordinates, in which the share of a cluster is the same.
    assert scatter.found == pytest.approx(np.trace(np.linalg.inv(bread) @ total) / 3, rel=1e-9)
    assert scatter.degrees == 3 * (PARTS - 1) // 2 and scatter.size == pytest.approx(3.0)


def test_noise_alone_costs_intervals_a_few_per_cent():
    found = [learn_weights(regression(np.random.default_rng(k))[0]) for k in range(60)]
    assert np.mean([w.scatter.found for w in found]) == pytest.approx(1.0, abs=0.1)
    assert all(w.dispersion >= 1.0 and w.efficient.factor >= 1.0 for w in found)
    assert np.mean([np.sqrt(w.dispersion) for w in found]) < 1.06
    assert np.mean([np.sqrt(w.efficient.factor) for w in found]) < 1.06
    assert all(w.complete for w in found)


@pytest.mark.parametrize("method", ["ols", "wls", "gls", "huber"])
def test_intervals_hold_where_parameters_wander(method):
    """Intervals from the noise alone would hold the mean parameters in a quarter of the cases."""
    inside, widened = [], []
    for k in range(25):
        data, truth = regression(np.random.default_rng(100 + k), wander=0.1)
        estimate = bayesid.fit(data, method)
        inside.append(np.abs(estimate.values - truth) < 1.96 * estimate.std)
        widened.append(estimate.details.dispersion)
    assert min(widened) > 2.0
    assert np.mean(inside) > 0.85


def test_the_likelihood_of_an_incomplete_model_has_the_curvature_of_the_sandwich():
    data, _ = regression(np.random.default_rng(3), wander=0.2)
    weights = learn_weights(data)
    assert not weights.complete
    plain = bayesid.fit(data, "wls")
    likelihood = Likelihood.of(data)
    stacked = np.concatenate(likelihood.factors)
    precision = stacked[:, :-1].T @ stacked[:, :-1]
    # Channels are weighted by the residuals' own size, which differs a little from that of the noise model.
    np.testing.assert_allclose(np.diag(np.linalg.inv(precision)), np.diag(plain.full_covariance), rtol=0.1)
    found = np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=None)[0]
    assert np.max(np.abs(found - plain.solution) / plain.full_std) < 0.1


def test_chance_needs_degrees_of_freedom():
    assert not Dispersion(100.0, 0).beyond_chance(0.05)
    assert Dispersion(2.0, 100).beyond_chance(0.05) and not Dispersion(1.05, 100).beyond_chance(0.05)


def test_a_channel_that_wanders_alone_widens_what_it_shows_alone():
    """Each channel has parameters of its own; those of the first differ from part to part."""
    inside, quiet, ratio = [], [], []
    for k in range(25):
        rng = np.random.default_rng(200 + k)
        parts = [regression(rng, p=4, channels=1, wander=w)[0] for w in (0.15, 0.0)]
        (one,), (other,) = (list(part.rows.blocks()) for part in parts)
        matrix = np.zeros((len(one.rows), 2, 8))
        matrix[:, 0, :4], matrix[:, 1, 4:] = one.matrix[:, 0], other.matrix[:, 0]
        data = Regression.from_arrays(matrix, np.concatenate([one.target, other.target], axis=1))
        estimate = bayesid.fit(data, "wls")
        hit = np.abs(estimate.values - 1.0) < 1.96 * estimate.std
        inside.append(hit[:4])
        quiet.append(hit[4:])
        ratio.append(estimate.std[4:] / bayesid.fit(parts[1], "wls").std)
    assert np.mean(inside) > 0.85 and np.mean(quiet) > 0.85
    assert np.median(ratio) < 1.2  # the other channel is no less sure


def test_widening_is_the_dispersion_of_each_channel_and_at_least_that_of_all():
    def scatter(found, size=5.0, degrees=60):
        return Dispersion(found, degrees, size)

    np.testing.assert_allclose(widening(scatter(0.8), [scatter(1.2), scatter(0.7)]), [1.2, 1.0])
    np.testing.assert_allclose(widening(scatter(2.0), [scatter(3.0), scatter(0.5)]), [3.0, 1.0])
    np.testing.assert_allclose(widening(scatter(1.1), [scatter(3.0), scatter(0.5)]), [3.0, 1.0])
    np.testing.assert_array_equal(widening(scatter(2.0), []), [2.0])
    np.testing.assert_array_equal(widening(scatter(0.9), []), [1.0])
    np.testing.assert_allclose(widening(scatter(4.0), [scatter(3.0), scatter(1.0, size=15.0)]), [8.0, 8.0 / 3.0])


@pytest.mark.parametrize("method", ["ols", "wls", "gls", "huber"])
def test_a_recording_too_short_for_parts_is_not_widened(method, monkeypatch):
    """Few poses at rest and a model that counts as incomplete: no channel has a dispersion to average."""
    monkeypatch.setattr("bayesid.estimators.weights.SMALLEST_AGREEMENT", 2.0)
    monkeypatch.setattr("bayesid.estimators.weights.LARGEST_LOSS", 0.0)
    data, truth = regression(np.random.default_rng(4), p=3, rows=2 * PARTS)
    found = learn_weights(data)
    assert not found.complete and found.channels and not found.widened
    assert found.dispersion == 1.0 and found.dispersion_by_channel is None
    estimate = bayesid.fit(data, method)
    assert estimate.details.dispersion == 1.0 and np.all(np.abs(estimate.values - truth) < 5.0 * estimate.std)


@pytest.mark.parametrize("method", ["wls", "gls"])
def test_the_dispersion_that_is_said_is_that_of_the_covariance(method):
    """A complete model's: with the factor taken out again the covariance is that of the noise alone."""
    data, _ = regression(np.random.default_rng(3))
    estimate = bayesid.fit(data, method)
    weights = learn_weights(data)
    assert estimate.details.model_complete and estimate.details.dispersion >= 1.0
    x = np.concatenate([b.matrix for b in data.rows.blocks()])
    if method == "wls":
        x = (x / weights.noise["trajectory"].std[:, None]).reshape(-1, x.shape[2])
        alone = np.linalg.inv(x.T @ x)  # the noise is white
    else:
        rows = np.concatenate([weights.noise["trajectory"].whiten(b.matrix) for b in data.rows.blocks()]).reshape(-1, x.shape[2])
        bread = np.linalg.inv(rows.T @ rows)
        alone = bread @ whitened_middle(data, weights) @ bread
    np.testing.assert_allclose(np.diag(estimate.covariance) / np.diag(alone), estimate.details.dispersion, rtol=0.02)


def test_the_likelihood_says_the_dispersion_of_its_own_covariance():
    for k in range(5):
        data, _ = regression(np.random.default_rng(k))
        assert Likelihood.of(data).dispersion == pytest.approx(bayesid.fit(data, "gls").details.dispersion)
