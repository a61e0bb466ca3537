"""Models of readings, workspace and controller against Pinocchio and closed forms."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from bayesid.design.bounds.bands import band
from bayesid.design.bounds.model import Drive, ReadingModel
from bayesid.design.bounds.region import ellipsoid_term, norm_term, region_of_draws, tracking_bound
from bayesid.design.bounds.remainder import Remainder
from bayesid.design.bounds.workspace import Terms, mass_eigenvalues, sobol_configurations, workspace_bounds
from bayesid.dynamics.base_parameters import structural_base
from bayesid.dynamics.channels import torque_channels
from bayesid.effects.drives import RotorInertia
from bayesid.effects.friction import StribeckFriction, ViscousFriction
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links
from tests import robots


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return load_robot(robots.write(tmp_path_factory.mktemp("ur5"), robots.ur5()))


def model_of(robot, draws=40, rel_std=0.05, drives=(), extra=None):
    base = structural_base(robot, channels := torque_channels(robot))
    links = np.array([perturbed_links(robot, rel_std, seed).ravel() for seed in range(draws)])
    drawn = links @ base.matrix.T
    names, labels, units = base.names, base.labels, base.units
    if extra is not None:
        drawn = np.concatenate([drawn, extra], axis=1)
        more = [f"e{k}" for k in range(extra.shape[1])]
        names, labels, units = (*names, *more), (*labels, *more), (*units, *[""] * len(more))
    region = region_of_draws(names, labels, units, drawn, np.zeros(drawn.shape[1], bool))
    return ReadingModel(robot, channels, base, drives, region, drawn), links


def pinocchio(robot, links) -> pin.Model:
    model = pin.buildModelFromUrdf(str(Path(robot.urdf)))
    for j, body in enumerate(links.reshape(-1, 10)):
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    return model


def states(n, count, seed):
    return np.random.default_rng(seed).normal(size=(4, count, n))


def test_columns_of_passivity_based_control_are_those_of_the_christoffel_symbols(robot):
    model, links = model_of(robot, 2)
    q, v, vr, ar = states(robot.n, 5, 0)
    constant, columns = model.control_columns(q, v, vr, ar)
    reference = pinocchio(robot, links[0])
    data = reference.createData()
    for k in range(len(q)):
        mass = pin.crba(reference, data, q[k])
        mass = np.triu(mass) + np.triu(mass, 1).T
        coriolis = pin.computeCoriolisMatrix(reference, data, q[k], v[k])
        expected = mass @ ar[k] + coriolis @ vr[k] + pin.computeGeneralizedGravity(reference, data, q[k])
        np.testing.assert_allclose(constant[k] + columns[k] @ model.draws[0], expected, atol=1e-8)


def test_terms_of_the_workspace_are_those_of_pinocchio(robot):
    model, links = model_of(robot, 2)
    q, v, _, _ = states(robot.n, 6, 1)
    terms = Terms.of(model, q)
    reference = pinocchio(robot, links[1])
    data = reference.createData()
    pairs = [(j, k) for j in range(robot.n) for k in range(j, robot.n)]
    for i in range(len(q)):
        mass = pin.crba(reference, data, q[i])
        mass = np.triu(mass) + np.triu(mass, 1).T
        np.testing.assert_allclose(terms.mass[i] @ model.draws[1], mass, atol=1e-9)
        weight = pin.computeGeneralizedGravity(reference, data, q[i])
        np.testing.assert_allclose(terms.gravity[i] @ model.draws[1], weight, atol=1e-9)
        products = np.array([v[i, j] * v[i, k] * (1.0 if j == k else 2.0**0.5) for j, k in pairs])
        assert np.linalg.norm(products) == pytest.approx(v[i] @ v[i])
        expected = pin.computeCoriolisMatrix(reference, data, q[i], v[i]) @ v[i]
        np.testing.assert_allclose(terms.coriolis[i] @ model.draws[1] @ products, expected, atol=1e-9)


def test_bounds_hold_for_robots_of_the_same_law_at_their_configurations(robot):
    """Ninety-five of a hundred robots that were not among the draws keep each bound."""
    model, _ = model_of(robot, 240, 0.03)
    found = workspace_bounds(model, configurations=48)
    q, _, _ = sobol_configurations(robot, 48, 0)
    terms, hat = Terms.of(model, q), model.region.values
    fresh = np.array([perturbed_links(robot, 0.03, seed).ravel() for seed in range(10_000, 10_240)]) @ model.base.matrix.T
    kept = np.zeros((len(fresh), 4))
    for i, b in enumerate(fresh):
        ratio = [np.linalg.eigvals(np.linalg.solve(m, h)).real for m, h in zip(terms.mass @ b, terms.mass @ hat, strict=True)]
        kept[i] = [
            np.abs(np.array(ratio) - 1.0).max() <= found.alpha, np.min(ratio) >= found.ratio[0],
            np.all(np.abs(terms.gravity @ (hat - b)).max(axis=0) <= found.gravity_error),
            np.linalg.norm(terms.coriolis @ (hat - b), 2, axis=(1, 2)).max() <= found.coriolis_error,
        ]  # fmt: skip
    expected = np.array([0.95, 0.975, 0.95, 0.95])
    assert np.all(np.abs(kept.mean(axis=0) - expected) < 4 * np.sqrt(2 * 0.05 * 0.95 / len(fresh)))
    assert found.smallest_drawn > 0.0 and found.nominal_eigenvalue > 0.0
    assert found.alpha >= max(found.ratio[1] - 1.0, 1.0 - found.ratio[0]) - 0.05


def test_what_was_identified_inside_joints_is_in_the_torques(robot):
    drives = (
        Drive(RotorInertia("joint2", 1), (0.3,), (0,)), Drive(ViscousFriction("joint3", 2), (2.0,), (0,)),
        Drive(StribeckFriction("joint1", 0), (1.5, 0.2), (0, 1)),
    )  # fmt: skip
    extra = np.array([0.3, 2.0, 1.5, 0.2]) + 1e-9 * np.random.default_rng(0).normal(size=(30, 4))
    model, links = model_of(robot, 30, 1e-9, drives, extra)
    q, v, a, _ = states(robot.n, 7, 2)
    constant, columns = model.columns(q, v, a)
    torque = constant + columns @ model.region.values
    reference = pinocchio(robot, links[0])
    data = reference.createData()
    expected = np.array([pin.rnea(reference, data, *state) for state in zip(q, v, a, strict=True)])
    expected[:, 1] += 0.3 * a[:, 1]
    expected[:, 2] += 2.0 * v[:, 2]
    expected[:, 0] += 1.5 * np.exp(-((v[:, 0] / 0.2) ** 2)) * np.clip(v[:, 0] / 1e-3, -1, 1)
    np.testing.assert_allclose(torque, expected, atol=1e-5)
    inertia = model.drive_inertia()[1] @ model.region.values[model.base.rank :]
    np.testing.assert_allclose(inertia, np.diag([0, 0.3, 0, 0, 0, 0]), atol=1e-6)


def test_what_is_stated_inside_joints_is_in_the_mass_matrix(robot):
    """A rotor's inertia from a data sheet moves bounds as one that was identified for certain does."""
    stated, _ = model_of(robot, 30, 0.03, (Drive(RotorInertia("joint2", 1), (0.3,), ()),))
    estimated, _ = model_of(robot, 30, 0.03, (Drive(RotorInertia("joint2", 1), (0.3,), (0,)),), np.full((30, 1), 0.3))
    one, other = (workspace_bounds(model, configurations=8).to_dict() for model in (stated, estimated))
    for name, value in one.items():
        np.testing.assert_allclose(value, other[name], rtol=1e-9, atol=1e-12, err_msg=name)
    gains = np.full(robot.n, 5.0)
    one, other = (mass_eigenvalues(model, gains, 30, 8, 0) for model in (stated, estimated))
    assert one == pytest.approx(other, rel=1e-9)


def test_a_whole_trajectory_is_within_the_band_as_often_as_it_says(robot):
    model, _ = model_of(robot, 200, 0.1)
    t = np.linspace(0, 2, 60)[:, None]
    q, v, a = np.sin(t + np.arange(6)), np.cos(t + np.arange(6)), -np.sin(t + np.arange(6))
    found = band(model, q, v, a, t[:, 0], np.ones(6))
    rigid = model.columns(q, v, a)[1]
    fresh = np.array([perturbed_links(robot, 0.1, seed).ravel() for seed in range(20_000, 20_400)]) @ model.base.matrix.T
    torques = np.einsum("tck,dk->dtc", rigid, fresh)
    whole = np.mean(np.all((torques >= found.low) & (torques <= found.high), axis=(1, 2)))
    assert abs(whole - 0.95) < 4 * np.sqrt(0.05 * 0.95 * (1 / 200 + 1 / 400))
    assert found.factor > 1.96 and found.pointwise_high.max() < found.high.max()
    np.testing.assert_allclose(found.extrapolation, found.std.max(axis=0))


def test_errors_of_the_model_are_no_draws_of_its_parameters(robot):
    """Among 200 draws none is 15 standard deviations from the others: an error that was made a band of thousands."""
    model, _ = model_of(robot, 200, 0.1)
    t, one = np.linspace(0, 2, 60), np.ones((6, 1))
    paths = ((np.full((60, 6), 15.0), t),)
    left = Remainder(model.channels.names, ("m",), True, one[:, 0], one, one, one[:, 0], one, 5.0 * one, paths)
    q = np.sin(t[:, None] + np.arange(6))
    assert 15.0 < band(model, q, q, q, t, left=left).factor < 18.0


@pytest.mark.parametrize("width", [1e-9, 0.3])
def test_robust_terms_oppose_the_worst_error_of_their_set(width):
    """With the worst error of the set, ``s' (error + u)`` is at most a quarter of radius times width."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 5))
    covariance, rho = root @ root.T, 2.0
    for s in 10.0 ** rng.uniform(-2, 1, (200, 1)) * rng.normal(size=(200, 5)):
        ball = rho * np.linalg.norm(s) + s @ norm_term(s, rho, width)
        ellipse = rho * np.sqrt(s @ covariance @ s) + s @ ellipsoid_term(s, covariance, rho, width)
        assert max(ball, ellipse) <= 0.25 * rho * width * (1 + 1e-9) + 1e-9


def test_tracking_bound_is_where_the_worst_case_comes_to_rest():
    """One mass with a constant force: the bound is attained without a robust term, ``m dr/dt = d - k r``."""
    one = np.array([4.0])
    sliding, error = tracking_bound(rho=0.0, width=0.1, gains=one, rate=5.0, eigenvalues=(0.5, 0.5), other=3.0)
    assert sliding == pytest.approx(3.0 / 4.0) and error == pytest.approx(sliding / 5.0)
    only, _ = tracking_bound(rho=2.0, width=0.1, gains=one, rate=5.0, eigenvalues=(1.0, 4.0))
    assert only == pytest.approx(2.0 * np.sqrt(2.0 * 0.1 / (4 * 4.0)))
