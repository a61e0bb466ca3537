"""Priors: the nominal model and its trust."""

from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.robot_section import robot_doubts
from bayesid.robot.prior import Prior, gyration_radius, point_like
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links
from tests import robots

EXAMPLE = Path(bayesid.__file__).parent / "robot"


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


def test_links_that_are_points_in_their_urdf_are_told_where_it_is_trusted(links):
    """The public UR10 has 12.9 and 3.9 kg in balls of 1e-3 kg m^2 for the long links; a share of such a size is a millimetre."""
    robot = load_robot(EXAMPLE / "ur10.urdf")
    np.testing.assert_array_equal(point_like(robot), [False, True, True, False, False, False])
    assert gyration_radius(robot.nominal[1]) == pytest.approx(np.sqrt(1.5e-3 / robot.nominal[1, 0]), rel=1e-6)
    said = [w for w in robot_doubts(robot, {}, "", 0.1) if "of one point" in w]
    assert len(said) == 1 and "have their mass within 20 mm of one point" in said[0] and "to 2 mm" in said[0]
    assert not any("of one point" in w for w in robot_doubts(robot, {}, ""))
    assert not point_like(links[0]).any()


@pytest.mark.parametrize("name", list(robots.ROBOTS))
def test_no_link_of_other_robots_is_a_point(name, tmp_path):
    robot = load_robot(robots.write(tmp_path, robots.ROBOTS[name]()))
    assert not point_like(robot).any()
