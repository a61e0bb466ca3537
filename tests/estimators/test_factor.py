"""Factors of differently weighted rows by way of orthonormal coordinates, against orthogonal decompositions of the rows."""

from functools import partial

import numpy as np
import pytest

from bayesid.estimators.factor import Pilot, channel_grams, reduce_in_coordinates, reduce_rows
from bayesid.regression.blocks import Block
from bayesid.regression.row_cache import RowCache
from bayesid.signals.noise import NoiseModel

NOISE = NoiseModel(np.array([[1.0, -0.6], [1.0, 0.3]]), np.array([[1.0, 0.3], [0.3, 0.5]]))


def made(columns):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(400, 2, len(columns))) @ np.diag(columns)
    # Nearly dependent columns: squaring the rows would lose half of the digits.
    x[:, :, 1] = x[:, :, 0] * columns[1] / columns[0] + 1e-4 * x[:, :, 1]
    rows = np.concatenate([x, (x @ np.ones(len(columns)) + rng.normal(size=(400, 2)))[:, :, None]], axis=2)
    times = 0.1 * np.arange(400)
    return [Block(rows[:250], times[:250], 0, True), Block(rows[250:], times[250:], 0, False)]


def gram(factor):
    return factor.r.T @ factor.r


@pytest.mark.parametrize("dependent", [False, True])
def test_factors_are_those_of_the_rows(dependent):
    blocks = made([1.0, 10.0, 1e3])
    if dependent:  # no coordinates: the rows themselves are reduced
        blocks = [Block(np.concatenate([b.rows[:, :, :1], b.rows], axis=2), b.times, 0, b.start) for b in blocks]
    pilot = Pilot.of(blocks)
    assert (pilot.root is None) == dependent
    scale = np.array([3.0, 0.2])
    for found, transform in (
        (pilot.weighted(scale), lambda b: b.rows / scale[:, None]),
        (pilot.whitened({"trajectory": NOISE}), lambda b: NOISE.whiten(b.rows, None if b.start else blocks[0].rows[-1:])),
    ):
        expected = reduce_rows(blocks, transform)
        assert found.rows == expected.rows
        # Row by row up to the sign: a factor is unique where the columns are independent.
        if not dependent:
            np.testing.assert_allclose(np.abs(found.r), np.abs(expected.r), rtol=1e-9, atol=1e-9 * np.abs(expected.r).max())
        size = np.linalg.norm(expected.r, axis=0)
        np.testing.assert_allclose(gram(found) / np.outer(size, size), gram(expected) / np.outer(size, size), atol=1e-12)


def test_sums_of_squares_are_those_of_the_rows():
    blocks = made([1.0, 10.0, 1e3])
    found = Pilot.of(blocks).gram(lambda b, x: NOISE.colour_transposed(x))
    expected = sum(z.T @ z for z in (NOISE.colour_transposed(b.matrix).reshape(-1, 3) for b in blocks))
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def cached(blocks, pilot, chunked=False):
    """Blocks and some of them as the rows of a regression, of a recording that is in memory or read in chunks."""
    parts = tuple(partial(list, [block]) for block in blocks) if chunked else None
    size = sum(len(b.rows) for b in blocks)
    return RowCache(lambda: iter(blocks), size, blocks[0].rows[0].size, parts=parts, given_pilot=tuple(pilot))


@pytest.mark.parametrize("chunked", [False, True])
def test_rows_reduced_in_a_pilots_coordinates_have_the_factor_of_an_orthogonal_decomposition(chunked):
    blocks, scale = made([1.0, 10.0, 1e3]), np.array([3.0, 0.2])
    expected = reduce_rows(blocks, lambda b: b.rows / scale[:, None])
    found = reduce_in_coordinates(cached(blocks, blocks[:1], chunked), {"trajectory": 1.0 / scale})
    assert found.rows == expected.rows
    np.testing.assert_allclose(np.abs(found.r), np.abs(expected.r), rtol=1e-9, atol=1e-12 * np.abs(expected.r).max())
    by_channel = [sum(b.rows[:, c].T @ b.rows[:, c] for b in blocks) for c in range(2)]
    grams = channel_grams(cached(blocks, blocks[:1], chunked))
    np.testing.assert_allclose(grams, by_channel, rtol=1e-9, atol=1e-10 * np.max(by_channel))


def test_coordinates_of_a_pilot_unlike_the_other_rows_are_not_used():
    """In the pilot's coordinates the other rows' third column is a millionth: its square would have lost half of its digits."""
    blocks = made([1.0, 10.0, 1e3])
    pilot = [Block(b.rows * [1.0, 1.0, 1e6, 1.0], b.times, 0, b.start) for b in blocks]
    assert Pilot.of(pilot).root is not None
    hidden = [Block(b.rows * [1.0, 0.0, 1.0, 1.0], b.times, 0, b.start) for b in blocks]
    for rows in (blocks, hidden):
        expected = reduce_rows(rows, lambda b: b.rows)
        found = reduce_in_coordinates(cached(rows, pilot), {"trajectory": np.ones(2)})
        np.testing.assert_array_equal(found.r, expected.r)
