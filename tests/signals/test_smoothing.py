import numpy as np
import pytest
from scipy.interpolate import LSQUnivariateSpline

from bayesid.errors import InputError
from bayesid.signals.smoothing import OVERLAP, Splines, choose_smoother, smooth


def fourier(times, seed=0, joints=3):
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * 0.1 * np.arange(1, 6)
    a, b = rng.normal(0, 0.3, (2, 5, joints))
    s, c = np.sin(np.outer(times, w)), np.cos(np.outer(times, w))
    return s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b


def test_smooth_motion_comes_back_exactly():
    times = np.arange(0, 10, 0.008)
    q, v, a = fourier(times)
    qs, vs, accelerations = smooth(times, q, 10.0)
    assert np.abs(qs - q).max() < 1e-8 and np.abs(vs - v).max() < 1e-6
    inside = slice(20, -20)
    assert np.abs(accelerations - a)[inside].max() < 1e-4


def test_polynomials_of_degree_five_are_reproduced_on_uneven_times():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.004, 0.012, 400))
    p = np.polynomial.Polynomial([0.3, -1, 2, 0.5, -0.2, 0.05])
    q, v, a = smooth(times, p(times)[:, None], 4.0)
    inside = slice(30, -30)  # the ends are loose and not used
    np.testing.assert_allclose(q[inside, 0], p(times)[inside], rtol=3e-9)
    np.testing.assert_allclose(v[inside, 0], p.deriv()(times)[inside], rtol=0, atol=1e-6)
    np.testing.assert_allclose(a[inside, 0], p.deriv(2)(times)[inside], rtol=0, atol=1e-4)


def test_equals_scipys_spline_away_from_the_ends():
    times = np.arange(0, 8, 0.01)
    rng = np.random.default_rng(2)
    y = np.sin(2 * times) + 0.01 * rng.normal(size=len(times))
    spacing = 0.5 / 2.0
    q, v, _ = smooth(times, y[:, None], 2.0)
    reference = LSQUnivariateSpline(times, y, np.arange(spacing, times[-1], spacing), k=5)
    middle = slice(250, -250)
    np.testing.assert_allclose(q[middle, 0], reference(times)[middle], atol=1e-6)
    np.testing.assert_allclose(v[middle, 0], reference.derivative()(times)[middle], atol=1e-5)


def test_no_delay():
    """A forward difference would be half a sample early or late; the spline is not."""
    times = np.arange(0, 20, 0.008)
    q, v, _ = fourier(times)
    noisy = np.round(q / 2e-5) * 2e-5
    smoothed = smooth(times, noisy, 5.0)[1]
    acceleration = np.gradient(v, times, axis=0)
    delay = np.sum((smoothed - v) * acceleration) / np.sum(acceleration**2)
    assert abs(delay) < 1e-5
    forward = np.diff(noisy, axis=0) / 0.008
    late = np.sum((forward - v[:-1]) * acceleration[:-1]) / np.sum(acceleration[:-1] ** 2)
    assert abs(late - 0.004) < 2e-4


def test_pieces_with_overlap_agree_with_the_whole():
    times = np.arange(0, 30, 0.008)
    rng = np.random.default_rng(3)
    q = fourier(times)[0] + 1e-4 * rng.normal(size=(len(times), 3))
    whole = smooth(times, q, 5.0)
    reach = OVERLAP * 0.1
    window = (times >= 10 - reach) & (times <= 15 + reach)
    core = (times >= 10) & (times <= 15)
    piece = smooth(times[window], q[window], 5.0, at=times[core])
    rate = 2 * np.pi * 5.0
    for a, b, unit in zip(whole, piece, (1, rate, rate**2), strict=True):
        assert np.abs(a[core] - b).max() < 1e-3 * 1e-4 * unit  # a thousandth of the noise


def test_bandwidth_follows_motion_and_noise():
    times = np.arange(0, 20, 0.008)
    q = fourier(times)[0]
    fine = choose_smoother([(times, np.round(q / 2e-5) * 2e-5)], 2e-5)
    coarse = choose_smoother([(times, np.round(q / 2e-3) * 2e-3)], 2e-3)
    assert 1.0 < coarse.bandwidth < fine.bandwidth < 6.0
    np.testing.assert_allclose(fine.position_std, 2e-5 / np.sqrt(12), rtol=0.1)
    faster = choose_smoother([(times / 3, np.round(q / 2e-5) * 2e-5)], 2e-5)
    assert faster.bandwidth > 2 * fine.bandwidth


def test_the_bandwidth_suits_a_much_slower_recording_too():
    fast, slow = np.arange(0, 3, 0.005), np.arange(0, 3, 0.04)
    rng = np.random.default_rng(0)
    q = [fourier(10.0 * t)[0] + 1e-6 * rng.normal(size=(len(t), 3)) for t in (fast, slow)]
    chosen = choose_smoother([(fast, q[0]), (fast + 5.0, q[0]), (slow, q[1])])
    assert chosen.bandwidth <= 10.0
    smooth(slow, q[1], chosen.bandwidth)


def test_chosen_bandwidth_is_near_the_best_for_accelerations():
    times = np.arange(0, 20, 0.008)
    q, _, a = fourier(times, seed=5)
    noisy = np.round(q / 1e-4) * 1e-4
    errors = {f: np.std((smooth(times, noisy, f)[2] - a)[25:-25]) for f in np.geomspace(1, 12, 12)}
    chosen = choose_smoother([(times, noisy)], 1e-4).bandwidth
    assert np.std((smooth(times, noisy, chosen)[2] - a)[25:-25]) < 2.0 * min(errors.values())


def test_a_joint_at_rest_stands_still():
    """Rounding of a spline through one number again and again is no motion."""
    times = np.arange(0, 10, 0.008)
    positions = np.column_stack([np.sin(times), np.full(len(times), 0.4)])
    q, v, a = smooth(times, positions, 8.0)
    assert (q[:, 1] == 0.4).all() and not v[:, 1].any() and not a[:, 1].any()
    np.testing.assert_array_equal(q[:, 0], smooth(times, positions[:, :1], 8.0)[0][:, 0])


def test_too_few_samples_are_refused():
    times = np.array([0.0, 5.0, 5.01, 9.0])
    with pytest.raises(InputError, match="too few or too uneven"):
        smooth(times, np.full((4, 1), np.inf), 3.0)


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
def test_newton_steps_are_those_of_the_dense_sum(damping):
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 4.12, 400)
    splines = Splines.over(t, 3.0)
    position, acceleration = dense = np.zeros((2, 400, splines.count))
    for matrix, order in zip(dense, (0, 2), strict=True):
        for k in range(6):
            matrix[np.arange(400), splines.first + k] = splines.values[order][:, k]
    root, pull = rng.normal(size=(400, 2, 2)) * [1.0, 1e-2], rng.normal(size=(2, 400)) * [[1.0], [1e-2]]
    bent = np.swapaxes(root, 1, 2) @ root
    both = np.stack([position, acceleration], axis=1)
    normal = np.einsum("mak,mab,mbl->kl", both, bent, both)
    expected = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), position.T @ pull[0] + acceleration.T @ pull[1])
    step = splines.newton_step(np.stack([bent[:, 0, 0], bent[:, 0, 1], bent[:, 1, 1]]), pull)
    np.testing.assert_allclose(step(damping), expected, atol=1e-6 * np.abs(expected).max())


def test_rows_are_solved_beside_rows_that_are_to_be_small():
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 4.12, 400)
    splines, values = Splines.over(t, 3.0), rng.normal(size=(400, 2))
    kinds = [rng.normal(size=(400, 1)) * splines.values[order] for order in (0, 2)]
    dense = np.zeros((2, 400, splines.count))
    for matrix, rows in zip(dense, kinds, strict=True):
        for k in range(6):
            matrix[np.arange(400), splines.first + k] = rows[:, k]
    both = np.concatenate(dense)
    solved = splines.factored(*kinds)
    for column in values.T:
        expected = np.linalg.lstsq(both, np.concatenate([column, 0.0 * column]), rcond=None)[0]
        np.testing.assert_allclose(solved(column), expected, atol=1e-6 * np.abs(expected).max())
    assert np.isnan(splines.factored(np.nan * kinds[0], kinds[1])(values[:, 0])).all()
