"""Priors: the nominal model and its trust."""

import numpy as np
import pytest

from bayesid.errors import InputError
from bayesid.robot.prior import Prior
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links
from tests import robots


@pytest.fixture(scope="module")
def links(tmp_path_factory):
    """A UR5's nominal links."""
    robot = load_robot(robots.write(tmp_path_factory.mktemp("ur5"), robots.ur5()))
    return robot, robot.nominal


def test_perturbed_links_are_draws_from_the_prior(links):
    """Small perturbations of the simulator have the prior's covariance: chi-squared, and every mass with rel_std."""
    robot, nominal = links
    prior = Prior.nominal(nominal, 0.01)
    draws = np.array([perturbed_links(robot, 0.01, seed).ravel() for seed in range(400)]) - prior.mean
    squares = np.einsum("ni,ij,nj->n", draws, prior.precision, draws)
    assert np.mean(squares) == pytest.approx(len(prior.mean), rel=0.05)
    masses = draws[:, ::10] / prior.mean[::10]
    np.testing.assert_allclose(masses.std(axis=0), 0.01, rtol=0.12)
    np.testing.assert_allclose(np.sqrt(np.diag(prior.covariance))[::10] / prior.mean[::10], 0.01, rtol=1e-6)


@pytest.mark.parametrize("bad", [0.0, -0.1, float("nan")])
def test_a_prior_needs_a_trust(links, bad):
    """Zero, negative and missing trusts are refused by name."""
    with pytest.raises(InputError, match="rel_std"):
        Prior.nominal(links[1], bad)


@pytest.mark.parametrize("kind", [Prior.nominal, Prior.warped])
def test_bodies_may_be_declared_not_to_be_possible_ones(links, kind):
    """With the same mean and precision."""
    plain, free = kind(links[1], 0.1), kind(links[1], 0.1, physical=False)
    assert plain.physical and not free.physical
    np.testing.assert_array_equal(free.precision, plain.precision)
