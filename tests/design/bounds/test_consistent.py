"""Links that can exist, drawn within an estimate's uncertainty."""

import numpy as np
import pytest

from bayesid.design.bounds.knowledge import consistent_draws
from bayesid.dynamics.base_parameters import structural_base
from bayesid.dynamics.channels import torque_channels
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from tests.simulated import puma2


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


def test_far_from_the_walls_they_have_the_law_of_the_estimate(robot):
    """With next to no prior, base parameters and effects keep mean and covariance, correlations included."""
    base = structural_base(robot, torque_channels(robot))
    nominal = robot.nominal.ravel()
    rng = np.random.default_rng(0)
    size = np.append(np.abs(base.matrix @ nominal) + 0.05, [1.0])
    root = 1e-3 * size[:, None] * rng.normal(size=(base.rank + 1, base.rank + 1)) / np.sqrt(base.rank)
    mean, covariance = np.append(base.matrix @ nominal, 5.0), root @ root.T
    found = consistent_draws(
        base, mean, covariance, np.ones(base.rank + 1, bool), np.zeros(1, bool), Prior.warped(nominal, 1.0), 2000, 0
    )
    drawn = np.concatenate([found.links @ base.matrix.T, found.effects], axis=1)
    inverse = np.linalg.inv(np.linalg.cholesky(covariance / np.outer(size, size))) / size
    white = (drawn - mean) @ inverse.T
    assert np.all(np.abs(white.mean(axis=0)) < 5 / np.sqrt(1000))
    np.testing.assert_allclose(np.cov(white.T), np.eye(len(mean)), atol=0.2)
    assert found.complaint == "" and inertia.is_physically_consistent(found.links.reshape(-1, 10)).all()


def test_an_estimate_that_nothing_can_have_gives_robots_that_can_exist(robot):
    """An inertia estimated far below zero: draws stay on the side of bodies that exist, and within their walls."""
    base = structural_base(robot, torque_channels(robot))
    nominal = robot.nominal.ravel()
    mean = base.matrix @ nominal
    k = base.independent.tolist().index(19)  # joint2.Izz, alone
    std = np.full(base.rank, 0.05)
    mean[k] = -0.2
    found = consistent_draws(
        base, mean, np.diag(std**2), np.ones(base.rank, bool), np.zeros(0, bool), Prior.warped(nominal, 1.0), 400, 0
    )
    assert inertia.is_physically_consistent(found.links.reshape(-1, 10)).all()
    assert (found.links @ base.matrix.T)[:, k].min() > 0.0


def test_what_is_not_determined_is_the_priors(robot):
    base = structural_base(robot, torque_channels(robot))
    nominal = robot.nominal.ravel()
    mean, determined = base.matrix @ nominal, np.ones(base.rank, bool)
    determined[[0, 3]] = False
    covariance = np.diag((1e-3 * np.abs(mean) + 1e-4) ** 2)
    found = consistent_draws(base, mean, covariance, determined, np.zeros(0, bool), Prior.warped(nominal, 0.1), 1500, 1)
    spread = (found.links @ base.matrix.T).std(axis=0)
    prior = (found.prior @ base.matrix.T).std(axis=0)
    assert np.all(spread[determined] < 0.2 * prior[determined])
    assert spread[3] > 0.3 * prior[3]
