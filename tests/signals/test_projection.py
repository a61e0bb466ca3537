import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import lagrange

from bayesid.signals.projection import HALF_WIDTH, GridProjection, project


def _projector(times, step, count):
    out, energy = np.zeros((count, len(times))), np.zeros(count)
    project(times, np.eye(len(times)), 0.5 * step, step, 0, out, energy)
    return out / np.sqrt(energy)[:, None]


def test_projection_keeps_white_noise_white():
    times = np.arange(0, 20, 0.008)
    rows = _projector(times, 0.05, 399)
    inside = slice(HALF_WIDTH, -HALF_WIDTH)
    gram = (rows @ rows.T)[inside, inside]
    assert np.abs(gram - np.eye(len(gram))).max() < 0.01


def test_projection_keeps_the_energy_of_the_band_and_drops_the_rest():
    times, step = np.arange(0, 20, 0.002), 0.05
    rows = _projector(times, step, 399)
    for frequency, low, high in [(1.0, 0.98, 1.02), (4.0, 0.98, 1.02), (20.0, 0.0, 0.01), (50.0, 0.0, 0.01)]:
        signal = np.sin(2 * np.pi * frequency * times + 0.3)
        share = np.linalg.norm((rows @ signal)[10:-10]) / np.linalg.norm(signal) * np.sqrt(399 / 379)
        assert low <= share <= high, frequency


def test_projection_does_not_depend_on_how_samples_are_cut():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.004, 0.012, 500))
    values = rng.normal(size=(500, 2, 3))
    whole, power = np.zeros((90, 2, 3)), np.zeros(90)
    project(times, values, 0.0, 0.05, 0, whole, power)
    parts, other = np.zeros((90, 2, 3)), np.zeros(90)
    for a in range(0, 500, 83):
        project(times[a : a + 83], values[a : a + 83], 0.0, 0.05, 0, parts, other)
    np.testing.assert_allclose(parts, whole, atol=1e-12)
    np.testing.assert_allclose(other, power, atol=1e-12)


def _grid_rows(times, function, spacing, step, first, count, pieces=1):
    """Rows of a function of time that is known on a grid."""
    last = int((times[-1] - times[0]) / spacing) + GridProjection.AFTER
    grid = times[0] + spacing * np.arange(-GridProjection.BEFORE, last + 1)
    weights = GridProjection.of(times, grid[0], spacing, 0.1, step, first, count)
    values, out = function(grid), np.zeros((count, *function(grid).shape[1:]))
    for part in np.array_split(np.arange(len(grid)), pieces):
        weights.add(values[part], int(part[0]), out)
    return out


@given(st.integers(0, 2**31), st.integers(1, 4))
def test_polynomials_on_a_grid_give_the_rows_of_all_samples(seed, pieces):
    """Interpolation of degree five is exact for them, at uneven times, and in pieces."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.002, 0.012, 300))
    coefficients = rng.normal(size=(6, 2, 3))

    def function(t):
        return np.tensordot(np.vander(t - 1.0, 6), coefficients, 1)

    count, step, spacing = 30, 0.05, rng.uniform(0.012, 0.06)
    rows, energy = np.zeros((count, 2, 3)), np.zeros(count)
    project(times, function(times), 0.1, step, 2, rows, energy)
    np.testing.assert_allclose(_grid_rows(times, function, spacing, step, 2, count, pieces), rows, atol=1e-9 * np.abs(rows).max())


def test_one_grid_point_acts_as_the_polynomials_through_its_neighbours():
    """Against scipy's Lagrange polynomials, sample by sample."""
    times, spacing, step, count = np.arange(0, 2, 0.01), 0.045, 0.05, 35
    grid = times[0] + spacing * np.arange(-2, int((times[-1] - times[0]) / spacing) + 4)
    one = np.eye(len(grid))[20]
    sampled = []
    for t in times:
        j = int((t - grid[0]) / spacing)
        nodes = np.arange(j - 2, j + 4)
        sampled.append(lagrange(grid[nodes] - grid[20], one[nodes])(t - grid[20]) if 20 in nodes else 0.0)
    rows, energy = np.zeros((count, 1)), np.zeros(count)
    project(times, np.array(sampled)[:, None], 0.1, step, 0, rows, energy)
    out = np.zeros((count, 1))
    GridProjection.of(times, grid[0], spacing, 0.1, step, 0, count).add(one[:, None], 0, out)
    np.testing.assert_allclose(out, rows, atol=1e-9)


def test_interpolation_of_a_sine_is_as_good_as_its_degree_allows():
    times = np.arange(0, 10, 0.004)
    errors = []
    for per_period in (12.0, 24.0):
        rows, energy = np.zeros((150, 1)), np.zeros(150)
        project(times, np.sin(2 * np.pi * times)[:, None], 0.1, 0.05, 10, rows, energy)
        off = _grid_rows(times, lambda t: np.sin(2 * np.pi * t)[:, None], 1.0 / per_period, 0.05, 10, 150) - rows
        errors.append(np.abs(off).max() / np.abs(rows).max())
    assert errors[0] < 1e-3 and errors[0] / errors[1] == pytest.approx(2.0**6, rel=0.2)
