"""Scaled least squares against plain dense answers."""

import numpy as np
from numpy.testing import assert_allclose, assert_equal

from bayesid.regression.linalg import (
    column_lengths,
    condition_number,
    determined_inverse,
    pseudo_inverse,
    solve,
    standard_deviations,
    takes,
    undetermined,
    unshown,
)

SIZES = 10.0 ** np.array([-6.0, 0.0, 3.0, 6.0])


def columns(rng, zero=(), dependent=False):
    matrix = rng.normal(size=(30, 4)) * SIZES
    if dependent:
        matrix[:, 3] = 1e6 * matrix[:, 1] + 1e3 * matrix[:, 2]
    matrix[:, list(zero)] = 0.0
    return matrix


def test_solution_is_that_of_the_normal_equations_whatever_the_units():
    rng = np.random.default_rng(0)
    matrix, target = columns(rng), rng.normal(size=(30, 2))
    scaled = matrix / SIZES
    expected = np.linalg.inv(scaled.T @ scaled) @ scaled.T @ target / SIZES[:, None]
    assert_allclose(solve(matrix, target), expected, rtol=1e-10)
    assert_allclose(solve(matrix, target[:, 0]), expected[:, 0], rtol=1e-10)
    assert_allclose(pseudo_inverse(matrix) @ target, expected, rtol=1e-10)


def test_directions_without_rows_stay_zero_and_are_told():
    rng = np.random.default_rng(1)
    matrix, target = columns(rng, zero=[2]), rng.normal(size=30)
    found = solve(matrix, target)
    assert found[2] == 0.0 and list(undetermined(matrix)) == [False, False, True, False]
    left = matrix[:, [0, 1, 3]]
    assert_allclose(found[[0, 1, 3]], np.linalg.lstsq(left / SIZES[[0, 1, 3]], target)[0] / SIZES[[0, 1, 3]], rtol=1e-10)
    both = columns(rng, dependent=True)
    assert list(undetermined(both)) == [False, True, True, True]
    assert_allclose(both @ solve(both, target), both[:, :3] @ solve(both[:, :3], target), rtol=1e-8)


def test_inverse_in_the_determined_columns_gives_their_covariance():
    rng = np.random.default_rng(2)
    factor = np.linalg.qr(columns(rng, zero=[0]), mode="r")
    inverse = determined_inverse(factor, undetermined(factor))
    assert not inverse[0].any()
    unit = factor[:, 1:] / SIZES[1:]
    expected = np.linalg.inv(unit.T @ unit) / np.outer(SIZES[1:], SIZES[1:])
    assert_allclose((inverse @ inverse.T)[1:, 1:], expected, rtol=1e-9)


def test_condition_number_does_not_know_units():
    rng = np.random.default_rng(3)
    matrix = columns(rng)
    unit = matrix / np.linalg.norm(matrix, axis=0)
    assert_allclose(condition_number(matrix), np.linalg.cond(unit), rtol=1e-9)
    assert np.isinf(condition_number(columns(rng, zero=[1]))) and condition_number(np.zeros((3, 0))) == 1.0


def test_lengths_and_standard_deviations_of_next_to_nothing():
    assert_allclose(column_lengths(np.diag([3.0, 0.0, 1e-20])), [3.0, 1.0, 1.0])
    assert_allclose(standard_deviations(np.diag([4.0, -1e-20]), 1e-300), [2.0, 1e-150])


def test_fewer_rows_than_columns_leave_some_undetermined():
    matrix = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 2.0, 1.0, 0.0]])
    assert_equal(undetermined(matrix), [False, True, True, True])
    assert_equal(undetermined(np.vstack([matrix, np.zeros((2, 4))])), [False, True, True, True])


def test_columns_that_rounding_alone_keeps_apart_are_undetermined():
    """Derivatives of a shape that is far off differ by what differencing rounds; a product of factors has no digits for it."""
    rng = np.random.default_rng(4)
    matrix = rng.normal(size=(200, 4))
    matrix[:, 3] = matrix[:, 1] - matrix[:, 2] + 5e-10 * rng.normal(size=200)
    factor = np.linalg.qr(matrix, mode="r")
    hidden = undetermined(factor)
    assert list(hidden) == [False, True, True, True]
    inverse = determined_inverse(factor, hidden)
    bread = inverse @ inverse.T
    assert np.linalg.eigvalsh(bread @ (factor.T @ factor) @ bread).min() > -1e-15


def test_a_row_takes_what_the_data_do_not_show_unless_it_takes_the_sum_that_they_know():
    """Of two equal columns the sum is known, with the variance of one column in their place; of a column of zeros nothing."""
    rng = np.random.default_rng(4)
    one, other = rng.normal(size=(2, 50))
    rows = np.column_stack([one, 3e-3 * other, 3e-3 * other, np.zeros(50)])
    inverse = pseudo_inverse(rows)
    covariance, hidden = inverse @ inverse.T, undetermined(rows)
    assert_equal(hidden, [False, True, True, True])
    changes = unshown(covariance, hidden)
    assert changes.shape == (4, 2)
    assert_allclose(np.linalg.norm(changes, axis=0), 1.0)
    close = 5 + 1e-5
    asked = np.array([[1.0, 0, 0, 0], [1, 5, 5, 0], [1, 5, close, 0], [0, 5, 0, 0], [0, 0, 0, 1], [1, 5, 5, 1e-6], [0, 0, 0, 0]])
    assert_equal(takes(asked, changes), [False, False, False, True, True, True, False])
    kept = np.linalg.inv(rows[:, :2].T @ rows[:, :2])
    assert_allclose(asked[1] @ covariance @ asked[1], asked[1, :2] @ kept @ asked[1, :2], rtol=1e-9)
    assert unshown(covariance, np.zeros(4, bool)).shape == (4, 0) and not takes(asked, np.zeros((4, 0))).any()


def test_what_is_not_shown_is_told_from_the_covariance_whatever_the_lengths_of_columns():
    """A load's weight is g times its mass beside a drive's offset: a null space of other lengths was told before."""
    rng = np.random.default_rng(5)
    one, other, inertial = rng.normal(size=(3, 50))
    rows = np.column_stack([one, inertial + 9.81, np.ones(50), 1e-3 * inertial, 5.0 * other])
    inverse = pseudo_inverse(rows)
    assert_allclose(inverse, np.linalg.pinv(rows, rcond=1e-12), atol=1e-9)
    (change,) = unshown(inverse @ inverse.T, undetermined(rows)).T
    assert_allclose(change / change[1], [0.0, 1.0, -9.81, -1e3, 0.0], atol=1e-9)
