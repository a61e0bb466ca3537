"""Links of flexible joints, against motions that are made the other way round: from the link to the motor."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from bayesid.dynamics.channels import stack_channels, torque_channels, wrench_channels
from bayesid.effects import EffectLibrary, MotionSegment, Term, readings
from bayesid.robot.robot import load_robot
from bayesid.signals.smoothing import smooth
from tests.robots import ROBOTS, write


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    return load_robot(write(tmp_path_factory.mktemp("panda"), ROBOTS["panda"]()))


def course(robot, frequencies, seed=0, count=2400, rate=120.0):
    """A link motion of sines, from rest to rest, with exact rates."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / rate
    q = np.zeros((count, robot.n))
    for f in frequencies:
        size, phase = rng.normal(0.0, 0.3 / (1.0 + f**2), robot.n), rng.uniform(0, 6, robot.n)
        q += size * np.sin(2 * np.pi * f * t[:, None] + phase)
    q *= (np.sin(np.pi * t / t[-1]) ** 2)[:, None]
    return t, *smooth(t, q, 50.0)


def motors(robot, t, link, joints, compliance):
    """Motor positions of a link motion: link + compliance x torque; and smoothed rates."""
    channels = torque_channels(robot)
    q = link[0].copy()
    q[:, joints] += compliance * readings(robot, channels, MotionSegment(t, *link), robot.nominal, [])[:, joints]
    return smooth(t, q, 50.0)


@pytest.mark.parametrize(
    ("joints", "compliance", "frequencies"),
    [
        ([1], 2e-5, (0.2, 0.9, 2.1)),  # far below the resonance
        ([0], 4e-4, (0.2, 1.7, 3.0, 10.0, 14.0)),  # resonance between the motion's frequencies
        ([3], 2e-3, (0.3, 12.0, 15.0)),  # motion below and far above it
        ([1, 3], 1e-4, (0.2, 0.9, 2.1)),
    ],
)
def test_readings_are_those_of_the_links_motion(panda, joints, compliance, frequencies):
    """What the wrench sensor and the drives read is what the true link motion takes, also above the joint's resonance."""
    both = stack_channels(wrench_channels(panda, np.eye(3), np.zeros(3)), torque_channels(panda))
    t, *link = course(panda, frequencies)
    motor = motors(panda, t, link, joints, compliance)
    terms = [
        Term(EffectLibrary().parse([f"joint_flexibility@joint{j + 1}"], panda.joint_names, both.names, None)[0], (compliance,))
        for j in joints
    ]  # fmt: skip
    truth = readings(panda, both, MotionSegment(t, *link), panda.nominal, [])
    stiff = readings(panda, both, MotionSegment(t, *motor), panda.nominal, [])
    got = readings(panda, both, MotionSegment(t, *motor, clear=20.0), panda.nominal, terms)
    inside = slice(120, -120)
    error = np.sqrt(np.mean((got - truth)[inside] ** 2, axis=0))
    effect = np.sqrt(np.mean((stiff - truth)[inside] ** 2, axis=0))
    large = effect > 0.05 * effect.max()
    # Near the resonance nothing can be said of the link, and a little on both sides.
    assert np.all(error[large] < 0.1 * effect[large])


@pytest.mark.parametrize(("joint", "gap", "firm"), [(1, 1e-3, 2.0), (3, 1e-3, 0.5), (3, 1e-3, 0.05)])
def test_backlash_is_seen_through(panda, joint, gap, firm):
    """Motors that a link's motion needs when its teeth lie on the side that its torque pushes them to; smoothed as ever."""
    both = stack_channels(wrench_channels(panda, np.eye(3), np.zeros(3)), torque_channels(panda))
    t, *link = course(panda, (0.2, 0.9, 2.1))
    truth = readings(panda, both, MotionSegment(t, *link), panda.nominal, [])
    torque = truth[:, 6 + joint]
    assert np.sum(np.diff(np.sign(torque)) != 0) > 10
    q = link[0].copy()
    q[:, joint] += 0.5 * gap * np.tanh(torque / firm)
    seen = MotionSegment(t, *smooth(t, q, 12.0), bandwidth=12.0)
    (effect,) = EffectLibrary().parse([f"backlash@joint{joint + 1}"], panda.joint_names, both.names)
    tight = readings(panda, both, seen, panda.nominal, [])
    got = readings(panda, both, seen, panda.nominal, [Term(effect, (gap, firm))])
    low, inside = butter(4, 5.0, fs=120.0, output="sos"), slice(120, -120)
    error, apart = (np.sqrt(np.mean(sosfiltfilt(low, x - truth, axis=0)[inside] ** 2, axis=0)) for x in (got, tight))
    large = apart > 0.2 * apart.max()
    assert np.all(error[large] < 0.1 * apart[large])
    # At rest it leans with the weight that it holds.
    pose = seen.at_rest
    held = readings(panda, both, pose, panda.nominal, [Term(effect, (gap, firm))])
    moved = MotionSegment(t, seen.positions.copy(), 0 * q, 0 * q, still=True)
    moved.positions[:, joint] -= 0.5 * gap * np.tanh(held[:, 6 + joint] / firm)
    np.testing.assert_allclose(held, readings(panda, both, moved, panda.nominal, []), atol=0.02)
