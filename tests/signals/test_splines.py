"""Splines function by function, against those that smooth, and dense least squares."""

import numpy as np
import pytest

from bayesid.signals.smoothing import Splines, smooth


def test_nearest_splines_are_those_that_smooth():
    rng = np.random.default_rng(0)
    t = 0.3 + np.sort(rng.uniform(0.0, 9.0, 1500))
    q = np.cumsum(rng.normal(size=(1500, 2)), axis=0)
    splines = Splines.over(t, 6.0)
    got = splines.motion(np.column_stack([splines.nearest(own) for own in q.T]))
    for mine, known in zip(got, smooth(t, q, 6.0), strict=True):
        np.testing.assert_allclose(mine, known, rtol=0, atol=1e-8 * np.abs(known).max())
    at = np.linspace(t[0], t[-1], 77)
    elsewhere = Splines.over(t, 6.0, at).motion(splines.nearest(q[:, 0]))
    for mine, known in zip(elsewhere, smooth(t, q[:, :1], 6.0, at=at), strict=True):
        np.testing.assert_allclose(mine, known[:, 0], rtol=0, atol=1e-8 * np.abs(known).max())


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_rows_are_solved_in_least_squares(damping):
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 4.12, 400)
    splines, values = Splines.over(t, 3.0), rng.normal(size=400)
    rows = splines.values[0] + rng.normal(size=(400, 1)) * 1e-3 * splines.values[2]
    dense = np.zeros((400, splines.count))
    for k in range(6):
        dense[np.arange(400), splines.first + k] = rows[:, k]
    normal = dense.T @ dense
    expected = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), dense.T @ values)
    np.testing.assert_allclose(splines.solved(rows, values, damping), expected, atol=1e-6 * np.abs(expected).max())
