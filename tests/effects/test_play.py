"""Links behind gear teeth with play, found in what encoders count, against the motions that were counted."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from bayesid.dynamics.channels import stack_channels, torque_channels, wrench_channels
from bayesid.effects import EffectLibrary, MotionSegment, Term, columns, readings
from bayesid.effects.play import _best_tried, _curvature
from bayesid.robot.robot import load_robot
from bayesid.signals.smoothing import smooth
from tests.robots import ROBOTS, write

COUNT, RATE, BANDWIDTH = 2e-5, 200.0, 12.0


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    return load_robot(write(tmp_path_factory.mktemp("panda"), ROBOTS["panda"]()))


def moved(robot, seed=0, rests=True):
    """A link motion of slow sines with exact rates, from rest to rest, and standing still in the middle."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(16 * RATE)) / RATE
    q, v, a = np.zeros((3, len(t), robot.n))
    for first, last in ((0.5, 7.0), (8.5, 15.5)) if rests else ((0.0, 16.0),):
        at = np.clip((t - first) / (last - first), 0.0, 1.0)[:, None]
        inside = ((t > first) & (t < last))[:, None]
        for k in (4, 7, 11):
            w, size = np.pi * k, rng.normal(0.0, 2.0 / k, robot.n)
            # sin^3 starts and ends with position, speed and acceleration zero
            s, c, rate = np.sin(w * at), np.cos(w * at), w / (last - first)
            q += size * s**3
            v += size * inside * 3 * s**2 * c * rate
            a += size * inside * (6 * s * c**2 - 3 * s**3) * rate**2
    return t, q, v, a


def band(x):
    return sosfiltfilt(butter(4, 8.0, fs=RATE, output="sos"), x, axis=0)


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize(("joint", "gap", "firm"), [(0, 4e-4, 0.05), (0, 2e-3, 0.1), (0, 3e-3, 0.02)])
def test_a_joint_without_load_is_seen_as_well_as_one_without_play(panda, joint, gap, firm, rests):
    """Teeth cross in milliseconds: only the single samples say when. Error as of the same encoder on the link itself."""
    channels = stack_channels(wrench_channels(panda, np.eye(3), np.zeros(3)), torque_channels(panda))
    t, *link = moved(panda, rests=rests)
    truth = readings(panda, channels, MotionSegment(t, *link), panda.nominal, [])
    torque = truth[:, 6 + joint]
    loaded = torque[np.abs(torque) > 3 * firm]
    assert np.sum(np.diff(np.sign(loaded)) != 0) >= 10
    behind = 0.5 * gap * np.tanh(torque / firm)[:, None] * np.eye(panda.n)[joint]
    counted = [np.round(x / COUNT) * COUNT for x in (link[0], link[0] + behind)]
    (effect,) = EffectLibrary().parse([f"backlash@joint{joint + 1}"], panda.joint_names, channels.names)
    without, seen = (MotionSegment(t, *smooth(t, q, BANDWIDTH), bandwidth=BANDWIDTH, encoders=(t, q)) for q in counted)
    bound, stiff, got = (
        np.sqrt(np.mean(band(readings(panda, channels, segment, panda.nominal, terms) - truth)[200:-200] ** 2, axis=0))
        for segment, terms in ((without, ()), (seen, ()), (seen, (Term(effect, (gap, firm)),)))
    )
    large = stiff > 5 * bound
    assert large.any()
    assert np.all(got[large] < 3 * bound[large])


def test_play_too_small_for_the_encoders_follows_the_slow_torque(panda):
    """Its readings are linear in the gap, and have the sign of what a larger one makes."""
    channels = torque_channels(panda)
    t, *link = moved(panda)
    read = np.round(link[0] / COUNT) * COUNT
    segment = MotionSegment(t, *smooth(t, read, BANDWIDTH), bandwidth=BANDWIDTH, encoders=(t, read))
    (effect,) = EffectLibrary().parse(["backlash@joint1"], panda.joint_names, channels.names)
    none, one, two, large = (
        readings(panda, channels, segment, panda.nominal, [Term(effect, (gap, 0.1))])[200:-200, 0]
        for gap in (0.0, 1e-7, 2e-7, 1e-4)
    )
    assert np.linalg.norm((two - none) - 2 * (one - none)) < 0.1 * np.linalg.norm(two - none)
    assert np.corrcoef(band(two - none), band(large - none))[0, 1] > 0.0


def test_derivatives_are_what_a_change_of_a_hundredth_makes(panda):
    channels = torque_channels(panda)
    t, *link = moved(panda, rests=False)
    gap, firm = 4e-4, 0.05
    torque = readings(panda, channels, MotionSegment(t, *link), panda.nominal, [])[:, 0]
    read = link[0] + 0.5 * gap * np.tanh(torque / firm)[:, None] * np.eye(panda.n)[0]
    read = np.round(read / COUNT) * COUNT
    segment = MotionSegment(t, *smooth(t, read, BANDWIDTH), bandwidth=BANDWIDTH, encoders=(t, read))
    (effect,) = EffectLibrary().parse(["backlash@joint1"], panda.joint_names, channels.names)
    term = Term(effect, (gap, firm))
    slope = columns(panda, channels, segment, panda.nominal, [term], effect)[200:-200, 0, 0]
    below, above = (
        readings(panda, channels, segment, panda.nominal, [Term(effect, (share * gap, firm))])[200:-200, 0]
        for share in (0.99, 1.01)
    )
    assert np.linalg.norm(band(above - below) - 0.02 * gap * band(slope)) < 0.3 * np.linalg.norm(band(above - below))


def test_the_curvature_is_that_of_the_sum_at_its_best_torques():
    """Once the torque that teeth feel is the best one, by the position and the acceleration of the link."""
    rng = np.random.default_rng(5)
    sharp, sure, inertia, most, firm = 4.0, rng.uniform(0.5, 2.0, 30), rng.uniform(0.5, 2.0, 30), 1.5, 0.7
    gone, held = rng.normal(size=(2, 30))

    def best(q, a, k):
        def left(felt):
            wrong = felt - held[k] - inertia[k] * a
            return 0.5 * sharp * (gone[k] - q - most * np.tanh(felt / firm)) ** 2 + 0.5 * sure[k] * wrong**2

        rough = min(np.linspace(-5.0, 5.0, 2001), key=left)
        return minimize_scalar(left, bounds=(rough - 0.01, rough + 0.01), method="bounded", options={"xatol": 1e-10})

    felt = np.array([best(0.0, 0.0, k).x for k in range(30)])
    bent, pull = _curvature(gone, sharp, sure, inertia, most, firm, np.tanh(felt / firm))
    more = sharp * (gone - most * np.tanh(felt / firm)) * np.tanh(felt / firm) > 0.0  # else the bend is left out
    assert 5 < more.sum() < 25
    h = 1e-3
    for k in np.flatnonzero(more):
        f = {(i, j): best(i * h, j * h, k).fun for i in (-1, 0, 1) for j in (-1, 0, 1)}
        second = [
            f[1, 0] - 2 * f[0, 0] + f[-1, 0],
            0.25 * (f[1, 1] - f[1, -1] - f[-1, 1] + f[-1, -1]),
            f[0, 1] - 2 * f[0, 0] + f[0, -1],
        ]
        np.testing.assert_allclose(bent[:, k], np.array(second) / h**2, rtol=1e-3, atol=1e-3)
        first = [f[-1, 0] - f[1, 0], f[0, -1] - f[0, 1]]
        np.testing.assert_allclose(pull[:, k], np.array(first) / (2 * h), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("doubt", [0.01, 0.3, 10.0])
def test_the_best_of_all_torques_is_found(doubt):
    rng = np.random.default_rng(4)
    torque, tried = 0.5 * np.cumsum(rng.normal(size=500)), np.sort(rng.normal(size=40)) * 3.0
    gone, sharp, firm = np.tanh(torque) + 0.3 * rng.normal(size=500), 1.0 / 0.1**2, np.full(500, 1.0 / doubt**2)
    each = np.column_stack([torque, np.tile(tried, (500, 1))])
    left = sharp * (gone[:, None] - np.tanh(each)) ** 2 + firm[:, None] * (each - torque[:, None]) ** 2
    best = each[np.arange(500), np.argmin(left, axis=1)]
    np.testing.assert_array_equal(_best_tried(gone, torque, np.tanh(torque), sharp, firm, tried, np.tanh(tried)), best)


def stopped(robot, seed):
    """Moves of all joints at once to random poses, and a short stop at each, 12 s at 125 Hz."""
    rng, rate = np.random.default_rng(seed), 125.0
    t = np.arange(int(12 * rate)) / rate
    q, v, a = np.zeros((3, len(t), robot.n))
    start = 0.5
    while (lasting := rng.uniform(1.0, 2.5)) < 11.5 - start:
        step, s = rng.uniform(-1.0, 1.0, robot.n), np.clip((t - start) / lasting, 0.0, 1.0)[:, None]
        q += step * (10 * s**3 - 15 * s**4 + 6 * s**5)
        v += step * (30 * s**2 - 60 * s**3 + 30 * s**4) / lasting
        a += step * (60 * s - 180 * s**2 + 120 * s**3) / lasting**2
        start += lasting + rng.uniform(0.05, 0.35)
    return t, q, v, a


def cruising(robot, seed):
    """The first joint forth and back at even speed, where its torque hovers about zero, others in sines, 12 s at 125 Hz."""
    rng, rate = np.random.default_rng(seed), 125.0
    t = np.arange(int(12 * rate)) / rate
    w, size = rng.uniform(0.8, 2.5, robot.n), rng.uniform(0.1, 0.4, robot.n)
    phase = t[:, None] * w + rng.uniform(0.0, 6.0, robot.n)
    q, v, a = size * np.sin(phase), size * w * np.cos(phase), -size * w**2 * np.sin(phase)
    turn, top = 2 * np.pi * t / rng.uniform(5.0, 7.0), rng.uniform(0.3, 0.6)
    even = np.tanh(4.0 * np.sin(turn))
    v[:, 0], a[:, 0] = top * even, top * (1.0 - even**2) * 4.0 * np.gradient(np.sin(turn), t)
    q[:, 0] = CubicSpline(t, v[:, 0]).antiderivative()(t)
    return t, q, v, a


def with_play(folder, seed, motion=stopped, gap=5e-3, firm=0.1, count=1e-4):
    """A UR5 whose first joint has a play of fifty counts, as its encoder without play and with it counts."""
    robot = load_robot(write(folder, ROBOTS["ur5"]()))
    channels = torque_channels(robot)
    t, *link = motion(robot, seed)
    truth = readings(robot, channels, MotionSegment(t, *link), robot.nominal, [])
    behind = 0.5 * gap * np.tanh(truth[:, :1] / firm) * np.eye(robot.n)[0]
    (effect,) = EffectLibrary().parse(["backlash@joint1"], robot.joint_names, channels.names)
    counted = [np.round(x / count) * count for x in (link[0], link[0] + behind)]
    segments = [MotionSegment(t, *smooth(t, x, BANDWIDTH), bandwidth=BANDWIDTH, encoders=(t, x)) for x in counted]
    return robot, channels, truth, Term(effect, (gap, firm)), segments


def over_the_bound(folder, *how):
    """Error of the readings over that of the same encoder on a link without play."""
    robot, channels, truth, term, segments = with_play(folder, *how)
    bound, got = (
        np.std(band(readings(robot, channels, segment, robot.nominal, terms) - truth)[100:-100, 0])
        for segment, terms in zip(segments, ((), (term,)), strict=True)
    )
    return got / bound


@pytest.mark.parametrize("seed", [1, 2, 13])
def test_a_wide_play_is_followed_through_stops(tmp_path, seed):
    """Gauss-Newton steps alone chatter before rests, which costs 38 to 51 times the bound."""
    assert over_the_bound(tmp_path, seed) < 3.0


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("gap", [1e-3, 2e-3])
def test_crossings_while_the_torque_hovers_about_zero_are_found(tmp_path, seed, gap):
    """Many follow each other closely, and teeth rest on neither side for long: 5 to 15 times the bound by single crossings."""
    assert over_the_bound(tmp_path, seed, cruising, gap) < 3.0


@pytest.mark.slow
def test_a_wide_play_through_many_stops(tmp_path):
    """The figures of docs/explanation/limits.md."""
    errors = [over_the_bound(tmp_path, seed) for seed in range(14)]
    assert np.median(errors) < 1.5 and np.max(errors) < 17.0


@pytest.mark.parametrize("seed", [1, 2, 13])
def test_derivatives_keep_crossings_where_they_are(tmp_path, seed):
    """Against fits of their own to a gap a five-hundredth smaller and larger, but for parts in which these differ."""
    robot, channels, _, term, (_, segment) = with_play(tmp_path, seed)
    slope = band(columns(robot, channels, segment, robot.nominal, [term], term.effect)[100:-100, 0, 0])
    gap, firm = term.values
    below, above = (
        readings(robot, channels, segment, robot.nominal, [Term(term.effect, (share * gap, firm))])[100:-100, 0]
        for share in (0.998, 1.002)
    )
    change = band(above - below) / (0.004 * gap)
    assert np.median(np.abs(slope - change)) < 0.01 * np.median(np.abs(change))
    assert np.std(slope) < 1.1 * np.std(change)
