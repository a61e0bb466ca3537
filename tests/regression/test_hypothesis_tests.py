import numpy as np
import pytest
from scipy.stats import kstest

from bayesid.regression.hypothesis_tests import hausman


def test_statistic_is_the_quadratic_form_in_any_units():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4))
    covariance, difference = root @ root.T, rng.normal(size=4)
    expected = difference @ np.linalg.solve(covariance, difference)
    for size in (1.0, np.array([1e-3, 1.0, 10.0, 1e4])):
        found = hausman(difference, covariance, size, smallest=0.0)
        assert found.statistic == pytest.approx(expected, rel=1e-6) and found.degrees == 4


def test_probabilities_are_uniform_under_the_hypothesis():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    found = [hausman(root @ rng.normal(size=3), root @ root.T).probability for _ in range(400)]
    assert kstest(found, "uniform").pvalue > 0.01


def test_directions_without_a_difference_to_test_are_left_out():
    found = hausman(np.array([1.0, 5.0]), np.diag([1.0, 0.01]), smallest=0.05)
    assert found.degrees == 1 and found.statistic == pytest.approx(1.0)
    nothing = hausman(np.ones(2), np.diag([-0.2, 0.01]), smallest=0.05)
    assert (nothing.degrees, nothing.statistic, nothing.probability) == (0, 0.0, 1.0)
    assert nothing.lowest == pytest.approx(-0.2)
