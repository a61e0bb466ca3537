"""Errors of encoders: counts of a known size lie to a motion in ways that one recording does not show."""

import warnings

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bayesid import estimators
from bayesid.errors import BayesidWarning
from bayesid.regression.encoder_noise import _errors
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from tests.studies import encoder_coverage
from tests.studies.coverage_case import setup


def test_errors_of_counts_are_those_of_rounding():
    rng, times = np.random.default_rng(1), np.linspace(0.0, 20.0, 4001)
    positions = np.column_stack([np.sin(times), 0.01 * times])
    count = 1e-3
    errors = np.array([_errors(positions, np.full(2, count / 12**0.5), count, rng) for _ in range(20)])
    assert np.abs(errors).max() <= count / 2 * (1 + 1e-9)
    np.testing.assert_allclose(errors.std(axis=(0, 1)), count / 12**0.5, rtol=0.02)


@pytest.mark.parametrize("still", [0.3, 0.3 + 1e-7 * np.sin(np.linspace(0.0, 9.0, 500))])
def test_an_idle_joint_has_one_and_the_same_error(still):
    positions = np.column_stack([np.broadcast_to(still, 500), np.linspace(0.0, 1.234, 500)])
    rng = np.random.default_rng(2)
    spread = [np.ptp(_errors(positions, np.full(2, 1e-3 / 12**0.5), 1e-3, rng), axis=0) for _ in range(20)]
    assert np.median(spread, axis=0)[0] < 2.1e-7
    assert np.min(spread, axis=0)[1] > 0.9e-3


def test_recordings_of_one_robot_and_motion_state_like_standard_deviations(monkeypatch):
    """Errors of coarse counts are made where the motion turns; a smoothed recording knows that of its own counts only."""
    monkeypatch.setattr(encoder_coverage, "links_unlike", lambda robot, rng: setup("puma").truth)
    stds = []
    with warnings.catch_warnings(), threadpool_limits(1, user_api="blas"):
        warnings.simplefilter("ignore", BayesidWarning)
        for k in range(16):
            recorded, _ = encoder_coverage.record("puma, counts, 0.0001 rad", np.random.default_rng(k))
            stds.append(estimators.fit(prepare(recorded, FitOptions()).regression, "wls").std)
    spread = np.std(stds, axis=0, ddof=1) / np.mean(stds, axis=0)
    assert spread.max() < 0.17, spread  # 0.22 where the turning points stay as they were smoothed
