"""In its limit every estimator is least squares of the same weighting; the posterior's mean with a flat prior, too.

One small regression for all. That these limits also hold on robots, with touches and behind filters is shown beside
each estimator: test_robust.py, test_errors_in_variables.py, test_physical.py, test_posterior.py, test_posterior_sampling.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from bayesid.estimators import METHODS, Huber, LeastSquares, Physical, Ridge, Student, TruncatedSVD, fit
from bayesid.estimators.conic.bounds import Bounds
from bayesid.posterior.model import PosteriorModel
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from tests.posterior_cases import unrestricted

BODY = inertia.from_mass_com_inertia(2.0, np.array([0.05, -0.02, 0.1]), np.diag([0.02, 0.025, 0.015]))


@pytest.fixture(scope="module")
def body():
    """One thick body, all ten parameters well determined, two channels of different noise; regressors known exactly."""
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(600, 2, 10)).cumsum(axis=0) / 10
    target = matrix @ BODY + rng.normal(size=(600, 2)) * (1e-3, 1e-4)
    return Regression.from_arrays(
        matrix, target, bodies=[range(10)], instruments=matrix, regressor_noise=np.zeros((3, *matrix.shape))
    )


LIMITS = [
    ("wls", LeastSquares("same", "channel")),
    ("ols", Ridge(strength=0.0, weights="none")),
    ("wls", Ridge(strength=1e-15, weights="channel")),
    ("gls", Ridge(strength=1e-15, weights="noise")),
    ("wls", TruncatedSVD(rank=10, weights="channel")),
    ("wls", Huber(constant=np.inf)),
    ("wls", Student(nu=np.inf)),
    ("wls", METHODS["tls"]),
    ("wls", METHODS["iv"]),
    ("wls", Physical(rel_std=1e4, weights="channel")),
    ("gls", Physical(rel_std=1e4, weights="noise")),
    ("gls", Physical(rel_std=1e4, weights="noise", bounds=Bounds(total_mass=(1.0, 3.0), com={"body1": ((-1,) * 3, (1,) * 3)}))),
]


@pytest.mark.parametrize(("reference", "method"), LIMITS, ids=lambda m: m if isinstance(m, str) else m.name)
def test_every_limit_is_least_squares(body, reference, method):
    plain = fit(body, reference)
    limit = fit(body, method, prior=Prior.nominal(BODY, 1e4)) if isinstance(method, Physical) else fit(body, method)
    assert np.abs((limit.values - plain.values) / plain.std).max() < 1e-5
    if limit.interval != "none":
        np.testing.assert_allclose(limit.std, plain.std, rtol=0.03)


def test_every_estimator_has_its_limit_here():
    assert {method.name for _, method in LIMITS} >= set(METHODS) - {"ols", "wls", "gls"}


def test_the_posterior_mean_with_a_flat_prior_is_generalised_least_squares(body):
    """Of the density itself; test_posterior.py shows that draws have this mean within Monte-Carlo error."""
    mean, covariance = unrestricted(PosteriorModel.of(body))
    gls = fit(body, "gls")
    assert np.abs((mean - gls.values) / gls.std).max() < 1e-5
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), gls.std, rtol=1e-5)


def test_away_from_the_limit_they_are_not(body):
    """Else the limits would show nothing."""
    plain = fit(body, "wls")
    for method in (Ridge(strength=0.1, weights="channel"), TruncatedSVD(rank=6, weights="channel"), Physical(rel_std=1e-4)):
        moved = fit(body, method, prior=Prior.nominal(1.2 * BODY, 1e-4)) if isinstance(method, Physical) else fit(body, method)
        assert np.abs((moved.values - plain.values) / plain.std).max() > 1.0
