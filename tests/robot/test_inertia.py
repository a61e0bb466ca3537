"""Ten parameters: round trips, change of frame against Pinocchio, metric and consistency."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bayesid.robot import inertia

PROPERTY = settings(max_examples=60, deadline=None, derandomize=True, database=None)
seeds = st.integers(0, 2**32 - 1)


def body(rng):
    """A cloud of point masses: always a possible body."""
    points, masses = rng.normal(size=(8, 3)) * rng.uniform(0.2, 0.5, 3) + rng.normal(size=3) * 0.3, rng.uniform(0.1, 2, 8)
    second = np.einsum("n,ni,nj->ij", masses, points, points)
    moments = np.trace(second) * np.eye(3) - second
    return np.concatenate([[masses.sum()], masses @ points, moments[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def placement(rng):
    return Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)


@PROPERTY
@given(seeds)
def test_mass_com_inertia_round_trip(seed):
    phi = body(np.random.default_rng(seed))
    mass, com, moments = inertia.to_mass_com_inertia(phi)
    np.testing.assert_allclose(inertia.from_mass_com_inertia(mass, com, moments), phi, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(pin.Inertia(mass, com, moments).toDynamicParameters(), phi, rtol=1e-10, atol=1e-12)


def test_body_without_mass():
    mass, com, moments = inertia.to_mass_com_inertia(np.zeros(10))
    assert mass == 0 and not com.any() and not moments.any()


@PROPERTY
@given(seeds)
def test_pseudo_inertia(seed):
    phi = body(np.random.default_rng(seed))
    pseudo = inertia.pseudo_inertia(phi)
    np.testing.assert_allclose(pseudo, pin.PseudoInertia.FromDynamicParameters(phi).toMatrix(), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.einsum("k,kij->ij", phi, inertia.BASIS), pseudo, rtol=1e-12, atol=1e-12)


def test_batches():
    phi = np.array([body(np.random.default_rng(k)) for k in range(6)]).reshape(2, 3, 10)
    assert inertia.inertia_matrix(phi).shape == (2, 3, 3, 3)
    np.testing.assert_array_equal(inertia.pseudo_inertia(phi)[1, 2], inertia.pseudo_inertia(phi[1, 2]))
    assert inertia.is_physically_consistent(phi).shape == (2, 3)


@PROPERTY
@given(seeds)
def test_transform(seed):
    rng = np.random.default_rng(seed)
    phi, (rotation, translation) = body(rng), placement(rng)
    moved = inertia.transform(phi, rotation, translation)
    expected = pin.SE3(rotation, translation).act(pin.Inertia.FromDynamicParameters(phi)).toDynamicParameters()
    np.testing.assert_allclose(moved, expected, rtol=1e-10, atol=1e-11)
    back = inertia.transform(moved, rotation.T, -rotation.T @ translation)
    np.testing.assert_allclose(back, phi, rtol=1e-9, atol=1e-10)


@PROPERTY
@given(seeds)
def test_metric_does_not_depend_on_the_frame_or_the_unit_of_mass(seed):
    rng = np.random.default_rng(seed)
    phi, frame = body(rng), placement(rng)
    change = np.array([inertia.transform(unit, *frame) for unit in np.eye(10)]).T
    moved = change.T @ inertia.pullback_metric(inertia.transform(phi, *frame)) @ change
    metric = inertia.pullback_metric(phi)
    # Compare in the metric's own unit ball, as its entries span many decades.
    root = np.linalg.inv(np.linalg.cholesky(metric))
    np.testing.assert_allclose(root @ moved @ root.T, np.eye(10), atol=1e-6)
    np.testing.assert_allclose(inertia.pullback_metric(3 * phi) * 9, metric, rtol=1e-8)
    # d = phi is a relative change of one: 1/2 tr(1) = 2.
    assert phi @ metric @ phi == pytest.approx(2.0, rel=1e-7)


@pytest.mark.parametrize("phi", [
    np.zeros(10),
    np.array([1.0, *np.zeros(9)]),
    inertia.from_mass_com_inertia(2.0, np.array([0.1, 0.2, 0.3]), np.zeros((3, 3))),
    inertia.from_mass_com_inertia(2.0, np.array([0.1, 0.2, 0.3]), np.diag([1.0, 1.0, 0.0])),
])  # fmt: skip
def test_metric_of_bodies_without_extent_is_definite(phi):
    values = np.linalg.eigvalsh(inertia.pullback_metric(phi))
    assert np.isfinite(values).all() and values[0] > 0


@PROPERTY
@given(seeds)
def test_consistency(seed):
    rng = np.random.default_rng(seed)
    phi = body(rng)
    assert inertia.is_physically_consistent(phi)
    assert inertia.is_physically_consistent(inertia.transform(phi, *placement(rng)))
    assert not inertia.is_physically_consistent(-phi)
    mass, com, moments = inertia.to_mass_com_inertia(phi)
    values, vectors = np.linalg.eigh(moments)
    values[2] = 1.1 * (values[0] + values[1])  # against the triangle inequality, though positive definite
    impossible = vectors @ np.diag(values) @ vectors.T
    assert not inertia.is_physically_consistent(inertia.from_mass_com_inertia(mass, com, impossible))


def test_point_masses_and_nothing_are_consistent():
    assert inertia.is_physically_consistent(np.zeros(10))
    assert inertia.is_physically_consistent(inertia.from_mass_com_inertia(1.5, np.array([0.3, -0.2, 0.5]), np.zeros((3, 3))))
