"""Mass, centre of mass and inertia from ten parameters: closed forms, finite differences, how often intervals hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from bayesid.design.payload.body import BodyKnowledge, about_centre
from bayesid.estimators.conic.problem import nearest_body
from bayesid.robot import inertia
from bayesid.rounding import HALF

BODY = inertia.from_mass_com_inertia(2.0, np.array([0.03, -0.05, 0.1]), np.diag([0.01, 0.012, 0.006]))
SIZES = np.array([0.02, *(0.002,) * 3, *(5e-4,) * 6])


def test_knowledge_is_generalised_least_squares():
    rng = np.random.default_rng(1)
    matrix, root = rng.normal(size=(14, 10)), rng.normal(size=(14, 14))
    covariance = root @ root.T + 0.1 * np.eye(14)
    values = matrix @ BODY + rng.normal(size=14)
    weight = np.linalg.inv(covariance)
    known = BodyKnowledge.of(matrix, values, covariance)
    expected = np.linalg.inv(matrix.T @ weight @ matrix)
    np.testing.assert_allclose(known.covariance, expected, rtol=1e-8)
    np.testing.assert_allclose(known.mean, expected @ matrix.T @ weight @ values, rtol=1e-8)
    assert known.shown.all() and not known.hidden.shape[1]


def test_what_no_combination_holds_is_not_shown():
    matrix = np.zeros((4, 10))
    matrix[0, 0], matrix[1, [1, 0]], matrix[2, 2], matrix[3, [4, 6]] = 1.0, (1.0, 0.3), 1.0, 1.0
    known = BodyKnowledge.of(matrix, matrix @ BODY, 1e-4 * np.eye(4))
    assert known.shown.tolist() == [True, True, True, False, *[False] * 6]
    np.testing.assert_allclose(known.mean[:3], BODY[:3], rtol=1e-9)
    assert [q.shown for q in known.centre] == [True, True, False] and not any(q.shown for q in known.inertia)
    # Where two combinations are known as one sum only, nothing is known of either.
    sums = np.zeros((2, 10))
    sums[0, 0] = sums[1, 1] = 1.0
    half = BodyKnowledge.of(sums, sums @ BODY, np.array([[0.25, 0.25], [0.25, 0.25]]))
    assert not half.shown[:2].any() and not half.mass.shown


def test_a_mass_whose_interval_begins_at_zero_but_for_rounding_is_not_shown():
    """It was shown as 0.094 +- 0.094 kg, with a centre of mass that had no interval."""
    for std in BODY[0] / HALF * (1.0 + np.array([-1e-15, -1e-12, 0.0, 1e-15])):
        body = BodyKnowledge(BODY, np.diag(np.array([std, *SIZES[1:]]) ** 2))
        assert not body.mass.shown and body.mass.low == 0.0 and not any(q.shown for q in (*body.centre, *body.inertia))


def test_another_frame_is_another_view_of_the_same_body():
    from pinocchio.rpy import rpyToMatrix

    turn, shift = rpyToMatrix(0.3, -0.4, 1.0), np.array([0.1, 0.2, -0.3])
    known = BodyKnowledge(BODY, np.diag(SIZES**2)).moved(turn, shift)
    np.testing.assert_allclose(known.mean, inertia.transform(BODY, turn, shift), atol=1e-12)
    back = known.moved(turn.T, -turn.T @ shift)
    np.testing.assert_allclose(back.covariance, np.diag(SIZES**2), atol=1e-12)
    poses = BodyKnowledge(BODY, np.diag(SIZES**2), np.eye(10)[:, 4:])
    assert poses.moved(turn, shift).shown.tolist() == [True] * 4 + [False] * 6


def test_inertia_about_the_centre_and_its_derivatives():
    values, slopes = about_centre(BODY)
    np.testing.assert_allclose(values, [0.01, 0.0, 0.012, 0.0, 0.0, 0.006], atol=1e-12)
    for k in range(10):
        step = np.zeros(10)
        step[k] = 1e-6
        difference = (about_centre(BODY + step)[0] - about_centre(BODY - step)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, k], difference, atol=1e-7)


@pytest.mark.parametrize("mass", [2.0, 0.06])
def test_intervals_hold_as_often_as_they_say(mass):
    """Mass and centre of mass of 4,000 draws, also where the mass is hardly known."""
    rng = np.random.default_rng(4)
    true = BODY * mass / BODY[0]
    held, runs = np.zeros(4), 4000
    for _ in range(runs):
        known = BodyKnowledge(true + SIZES * rng.normal(size=10), np.diag(SIZES**2), np.eye(10)[:, 4:])
        held[0] += known.mass.low <= true[0] <= known.mass.high
        for k, q in enumerate(known.centre, 1):
            held[k] += not q.shown or q.low <= true[k] / true[0] <= q.high
    assert (np.abs(held / runs - 0.95) < 0.012).all() or (mass < 0.1 and (held / runs > 0.938).all())


def test_values_are_those_of_a_body_that_can_exist():
    thin = inertia.from_mass_com_inertia(1.0, np.array([0.0, 0.0, 0.1]), np.diag([0.004, 0.004, 1e-6]))
    rng = np.random.default_rng(2)
    spoiled = 0
    for _ in range(50):
        known = BodyKnowledge(thin + 0.3 * SIZES * rng.normal(size=10), np.diag((0.3 * SIZES) ** 2))
        spoiled += not inertia.is_physically_consistent(known.mean)
        possible = known.possible
        assert inertia.is_physically_consistent(possible.mean)
        assert np.linalg.norm((possible.mean - thin) / SIZES) <= np.linalg.norm((known.mean - thin) / SIZES) + 1e-6
    assert spoiled > 25
    assert BodyKnowledge(BODY, np.diag(SIZES**2)).possible.mean is BODY
    negative = BodyKnowledge(-BODY, np.diag(SIZES**2), np.eye(10)[:, 4:])
    assert negative.possible.mass.value == 0.0 and not negative.mass.shown


def test_draws_are_of_bodies_that_can_exist_and_else_of_the_normal_law():
    """Against the law itself where the body is far from impossible, and against rejection where it is not."""
    sure = BodyKnowledge(BODY, np.diag((0.1 * SIZES) ** 2))
    found = (sure.draws(2000, 1) - BODY) / (0.1 * SIZES)
    assert np.abs(found.mean(axis=0)).max() < 0.1 and np.abs(found.std(axis=0) - 1.0).max() < 0.07
    thin = inertia.from_mass_com_inertia(1.0, np.array([0.0, 0.0, 0.1]), np.diag([0.004, 0.004, 1e-6]))
    some = BodyKnowledge(thin, np.diag((0.3 * SIZES) ** 2)).draws(2000, 2)
    every = thin + 0.3 * SIZES * np.random.default_rng(3).normal(size=(100_000, 10))
    every = every[inertia.is_physically_consistent(every, 0.0)]
    assert inertia.is_physically_consistent(some).all() and len(every) > 3000
    assert np.abs((some.mean(axis=0) - every.mean(axis=0)) / every.std(axis=0)).max() < 0.12
    assert np.abs(some.std(axis=0) / every.std(axis=0) - 1.0).max() < 0.08
    poses = BodyKnowledge(BODY, np.diag(SIZES**2), np.eye(10)[:, 4:]).draws(500, 4)
    assert np.isnan(poses[:, 4:]).all() and (poses[:, 0] > 0.0).all()
    np.testing.assert_array_equal(poses, BodyKnowledge(BODY, np.diag(SIZES**2), np.eye(10)[:, 4:]).draws(500, 4))


@pytest.mark.parametrize("sigmas", [-1.0, -6.0, -60.0])
def test_draws_of_a_mass_below_zero_are_of_the_cut_law(sigmas):
    """Of poses, against rejection or the exponential tail; other parameters follow the mass."""
    covariance = np.diag(SIZES**2)
    covariance[0, 1] = covariance[1, 0] = 0.8 * SIZES[0] * SIZES[1]
    found = BodyKnowledge(sigmas * SIZES, covariance, np.eye(10)[:, 4:]).draws(4000, 1) / SIZES
    assert (found[:, 0] > 0.0).all() and np.isfinite(found[:, :4]).all()
    law = truncnorm(-sigmas, np.inf, loc=sigmas)
    assert abs(found[:, 0].mean() - law.mean()) < 5.0 * law.std() / np.sqrt(4000)
    left = found[:, 1] - sigmas - 0.8 * (found[:, 0] - sigmas)
    assert abs(left.mean()) < 0.05 and abs(left.std() - 0.6) < 0.04


def test_of_a_mass_far_below_zero_no_body_is_sought_near_by():
    """As a wrench with its sign reversed makes it; its draws are bodies all the same."""
    known = BodyKnowledge(-BODY, np.diag((0.003 * SIZES) ** 2))
    assert known.negative and known.possible is known and not known.mass.shown and known.mass.value == 0.0
    assert inertia.is_physically_consistent(known.draws(50)).all()
    assert not BodyKnowledge(-BODY, np.diag((100.0 * SIZES) ** 2)).negative


def test_models_that_cannot_be_told_apart_share_an_interval():
    one, other = (BodyKnowledge(BODY * f, np.diag(SIZES**2)).mass for f in (1.0, 1.1))
    both = one.joined((other,))
    assert both.value == one.value and (both.low, both.high) == (one.low, other.high) and both.shown


def test_a_mass_about_zero_has_a_nearest_body_that_can_exist():
    """As joint torques tell it of a light tool: -0.04 +- 0.11 kg, and a first moment that no such mass could have."""
    mean = np.array([-0.041, -0.0026, 0.0046, 0.0123, 3.3e-4, 1e-4, -7e-4, 8e-5, -4e-4, -2.7e-4])
    std = np.array([0.113, 6e-4, 6e-4, 1.5e-3, 1.2e-3, 5e-4, 1.2e-3, 7e-4, 6e-4, 8e-4])
    found = BodyKnowledge(mean, np.diag(std**2)).possible.mean
    assert np.linalg.eigvalsh(inertia.pseudo_inertia(found))[0] > -1e-6
    # No farther than any body of a family that can exist: points of some mass where its first moment says.
    away = np.sum(((found - mean) / std) ** 2)
    for mass in np.linspace(0.02, 0.4, 40):
        h = mean[1:4]
        point = np.array([mass, *h, *((h @ h) * np.eye(3) - np.outer(h, h))[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]] / mass])
        assert away <= np.sum(((point - mean) / std) ** 2) + 1e-6


def test_the_nearest_body_of_a_covariance_that_is_almost_singular():
    """A direction that is all but exact, as after a fit with a prior: the inverse is positive definite only but for rounding."""
    rng, wrong = np.random.default_rng(5), BODY - 0.02 * np.eye(10)[9]
    for _ in range(10):
        axes = np.linalg.qr(rng.normal(size=(10, 10)))[0]
        covariance = (axes * np.append(1e-17, np.ones(9))) @ axes.T
        found = nearest_body(wrong + 0.1 * SIZES * rng.normal(size=10), covariance * np.outer(SIZES, SIZES))
        assert np.linalg.eigvalsh(inertia.pseudo_inertia(found))[0] > -1e-6
