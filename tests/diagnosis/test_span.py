"""Spaces that columns span, against least squares."""

import numpy as np
import pytest

from bayesid.diagnosis.projector import Span, orthonormal


def left_by(columns, values):
    return values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0]


@pytest.fixture
def columns():
    """Columns of very different lengths, one of them zero and two the same direction."""
    rng = np.random.default_rng(0)
    own = rng.normal(size=(200, 6)) * 10.0 ** rng.uniform(-9, 9, 6)
    return np.column_stack([own, np.zeros(200), -3e5 * own[:, 2]])


def test_projection_is_that_of_least_squares(columns):
    values = np.random.default_rng(1).normal(size=(200, 3))
    span = Span.of(columns)
    assert span.rank == 6
    unit = columns[:, :6] / np.linalg.norm(columns[:, :6], axis=0)
    np.testing.assert_allclose(span.project_out(values), left_by(unit, values), atol=1e-10)
    np.testing.assert_allclose(np.sum(span.along(values) ** 2, axis=0), np.sum((values - left_by(unit, values)) ** 2, axis=0))
    basis = orthonormal(columns)
    np.testing.assert_allclose(basis.T @ basis, np.eye(6), atol=1e-10)


def test_more_columns_count_once(columns):
    """New directions add to the rank, those that are there do not, whatever their length."""
    values, new = np.random.default_rng(2).normal(size=200), np.random.default_rng(3).normal(size=(200, 2))
    more = np.column_stack([columns[:, :2] @ [1e3, 2.0], 1e-6 * new, np.zeros(200)])
    both = Span.of(columns).with_more(more)
    assert both.rank == 8
    unit = columns[:, :6] / np.linalg.norm(columns[:, :6], axis=0)
    np.testing.assert_allclose(both.project_out(values), left_by(np.column_stack([unit, new]), values), atol=1e-9)


def test_nothing_spans_nothing():
    span = Span.of(np.zeros((5, 0)))
    assert span.rank == 0
    np.testing.assert_array_equal(span.project_out(np.arange(5.0)), np.arange(5.0))
    assert span.with_more(np.zeros((5, 2))).rank == 0


def test_columns_that_are_but_rounding_make_no_direction():
    """One that is all rounding, and two that differ by no more than that."""
    rng = np.random.default_rng(4)
    column, noise = rng.normal(size=(200, 1)), 1e-10 * rng.normal(size=(200, 3)) / np.sqrt(200)
    weak = 1e-6 * column + noise[:, 1:]
    columns = np.hstack([rng.normal(size=(200, 2)), noise[:, :1], weak])
    assert Span.of(columns).rank == 5
    assert Span.of(columns, rounding=3e-10).rank == 3
    assert Span.of(noise, rounding=3e-10).rank == 0
    assert Span.of(columns[:, :2]).with_more(noise, 3e-10).rank == 2
    left = Span.of(columns, rounding=3e-10).project_out(column[:, 0])
    assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(column)
