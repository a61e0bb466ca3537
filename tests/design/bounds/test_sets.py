"""Sets of parameters: sizes against brute force and against fresh draws of the same law."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from bayesid.design.bounds.region import (
    largest_deviation,
    left_out,
    mahalanobis,
    quantile,
    region_of_draws,
    region_of_normal,
)
from bayesid.regression.linalg import root_of


def law(k, seed):
    """A mean and a covariance of k numbers of very different sizes."""
    rng = np.random.default_rng(seed)
    root = np.diag(10.0 ** rng.uniform(-3, 1, k)) @ rng.normal(size=(k, k))
    return rng.normal(size=k), root @ root.T


def names(k):
    return [f"p{i}" for i in range(k)], [f"p{i}" for i in range(k)], ["1"] * k


def test_leaving_one_out_is_that_of_leaving_one_out():
    mean, covariance = law(4, 0)
    draws = np.random.default_rng(1).multivariate_normal(mean, covariance, 40, method="cholesky")
    away = draws - draws.mean(axis=0)
    found = left_out(mahalanobis(away, np.cov(draws.T)), len(draws))
    single = left_out(largest_deviation(draws.std(axis=0, ddof=1), away), len(draws))
    for i in range(len(draws)):
        others = np.delete(draws, i, axis=0)
        d = draws[i] - others.mean(axis=0)
        assert found[i] == pytest.approx(np.sqrt(d @ np.linalg.solve(np.cov(others.T), d)), rel=1e-6)
        assert single[i] == pytest.approx(np.max(np.abs(d) / others.std(axis=0, ddof=1)), rel=1e-9)


def test_quantile_is_an_order_statistic_that_a_further_draw_respects():
    values = np.arange(1.0, 100.0)
    assert quantile(values, 0.95) == 95.0  # ceil(100 * 0.95)
    rng = np.random.default_rng(0)
    below = [rng.normal() <= quantile(rng.normal(size=60), 0.95) for _ in range(4000)]
    assert abs(np.mean(below) - np.ceil(61 * 0.95) / 61) < 4 * np.sqrt(0.05 * 0.95 / 4000)


def test_sets_of_draws_hold_a_draw_that_they_have_not_seen():
    """Few draws of many parameters, where judging draws by themselves would give sets that are far too small."""
    k, count, repeats = 12, 150, 500
    mean, covariance = law(k, 2)
    root, rng = np.linalg.cholesky(covariance), np.random.default_rng(3)
    inside = np.zeros((repeats, 3))
    for i in range(repeats):
        drawn = mean + rng.normal(size=(count + 1, k)) @ root.T
        region = region_of_draws(*names(k), drawn[:-1], np.zeros(k, bool))
        truth = drawn[-1]
        inside[i] = [
            region.distance(truth) <= region.ellipsoid, region.in_box(truth),
            np.linalg.norm(truth - region.values) <= region.rho,
        ]  # fmt: skip
    assert np.all(np.abs(inside.mean(axis=0) - 0.95) < 3.5 * np.sqrt(0.05 * 0.95 / repeats))


def test_sets_of_a_normal_law():
    k = 6
    mean, covariance = law(k, 4)
    region = region_of_normal(*names(k), mean, covariance, np.zeros(k, bool))
    assert region.ellipsoid == pytest.approx(np.sqrt(chi2.ppf(0.95, k)))
    fresh = mean + np.random.default_rng(5).normal(size=(20_000, k)) @ np.linalg.cholesky(covariance).T
    inside = np.mean([region.in_box(x) for x in fresh[:4000]])
    assert abs(inside - 0.95) < 4 * np.sqrt(0.05 * 0.95 / 4000)
    assert abs(np.mean(np.linalg.norm(fresh - mean, axis=1) <= region.rho) - 0.95) < 4 * np.sqrt(0.05 * 0.95 * 2 / 20_000)
    assert norm.ppf(0.975) < region.factor <= 1.01 * region.bonferroni


def test_directions_without_a_variance_do_not_count():
    mean, covariance = law(4, 6)
    through = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 1.0, 0, 0]])  # the third is the sum of the others
    wide = through @ covariance @ through.T
    assert root_of(wide).shape == (3, 2)
    region = region_of_normal(*names(3), through @ mean, wide, np.zeros(3, bool))
    assert region.ellipsoid == pytest.approx(np.sqrt(chi2.ppf(0.95, 2)))
    d = np.array([[0.3, -0.2, 0.0, 0.0]])
    expected = np.sqrt(d[0, :2] @ np.linalg.solve(covariance[:2, :2], d[0, :2]))
    assert mahalanobis(d @ through.T, wide)[0] == pytest.approx(expected, rel=1e-6)
