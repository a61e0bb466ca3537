"""What is inside a joint, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayesid.effects import JointMotion, readings
from bayesid.effects.friction import DahlFriction
from bayesid.effects.segment import direction
from tests.effects.arms import both, moving, term


def test_inside_a_joint(panda):
    segment, channels = moving(panda), both(panda)
    true = readings(panda, channels, segment, panda.nominal)
    values = {
        "viscous_friction": (2.0,), "coulomb_friction": (3.0,), "torque_offset": (0.7,), "stribeck_friction": (1.5, 0.2),
        "load_friction": (0.1,), "rotor_inertia": (0.4,), "torque_gain": (0.2,),
        "torque_ripple": (0.5, 12.0, 0.4), "spring": (8.0, 0.3),
    }  # fmt: skip
    got = readings(panda, channels, segment, panda.nominal, [term(panda, f"{k}@joint3", *v) for k, v in values.items()])
    q, v, a, tau = segment.positions[:, 2], segment.velocities[:, 2], segment.accelerations[:, 2], true[:, 8]
    sense = np.clip(v / 1e-3, -1, 1)
    inside = 2 * v + (3 + 1.5 * np.exp(-((v / 0.2) ** 2)) + 0.1 * np.abs(tau)) * sense + 0.7 + 0.4 * a
    expected = true.copy()
    expected[:, 8] = 1.2 * (tau + inside + 0.5 * np.sin(12 * q + 0.4) + 8 * (q - 0.3))
    np.testing.assert_allclose(got, expected, atol=1e-10)


def test_friction_that_reverses_within_a_sample_is_its_mean_there():
    """Against the mean of many signs of ``v + a t`` over the sample's time; without that time, the sign at its middle."""
    v, a, cell = np.array([-0.03, -0.004, 0.0, 0.002, 0.009, 0.5]), np.array([2.0, 2.0, 3.0, -1.0, 2.0, 4.0]), 8e-3
    inside = cell * (np.arange(20001) / 20000 - 0.5)
    want = np.sign(v[:, None] + a[:, None] * inside).mean(axis=1)
    np.testing.assert_allclose(direction(v, a, cell), want, atol=2e-4)
    np.testing.assert_array_equal(direction(v, a, 0.0), np.sign(v))


def test_friction_by_direction_posture_and_warmth(panda):
    segment, channels = moving(panda), both(panda)
    true = readings(panda, channels, segment, panda.nominal)
    values = {"directional_friction": (0.8,), "posture_friction": (1.5, -0.6), "warming_friction": (2.0, 3.0, 1.7)}
    got = readings(panda, channels, segment, panda.nominal, [term(panda, f"{k}@joint3", *v) for k, v in values.items()])
    q, v, sense = segment.positions[:, 2], segment.velocities[:, 2], np.clip(segment.velocities[:, 2] / 1e-3, -1, 1)
    expected = true.copy()
    expected[:, 8] += 0.8 * np.abs(v) + (1.5 * np.cos(q) - 0.6 * np.sin(q)) * sense
    expected[:, 8] += (2.0 * sense + 3.0 * v) * 1.7 * (np.exp(-segment.times / 1.7) - 1)
    np.testing.assert_allclose(got, expected, atol=1e-10)


@pytest.mark.parametrize("distance", [0.004, 0.02, 0.3])
def test_dahl_friction_solves_its_equation(distance):
    """Against a stiff solver in time on a sine, and the closed form of its loop; a cut of the recording changes nothing later."""
    t = 0.01 * np.arange(1000)
    q, v, a = 0.4 * np.sin(2 * t), 0.8 * np.cos(2 * t), -1.6 * np.sin(2 * t)
    motion = JointMotion(t, q, v, a, None, 0.0)
    dahl = DahlFriction("joint1", 0)
    got = dahl.torque(motion, (3.0, distance))

    def rate(time, z):
        speed = 0.8 * np.cos(2 * time)
        return (np.sign(speed) - z) * abs(speed) / distance

    solved = solve_ivp(rate, (0.0, t[-1]), [1.0], t_eval=t, max_step=2e-3, rtol=1e-6, atol=1e-8).y[0]
    np.testing.assert_allclose(got, 3.0 * solved, atol=3e-3)
    # From turning point to turning point z goes from -e to e, e = 1 - (1 + e) exp(-s / distance) = tanh(s / (2 distance)).
    assert np.max(got[500:]) == pytest.approx(3.0 * np.tanh(0.8 / (2 * distance)), rel=1e-3)
    later = dahl.torque(JointMotion(t[50:], q[50:], v[50:], a[50:], None, 0.0), (3.0, distance))
    np.testing.assert_allclose(later[-100:], got[-100:], atol=3.0 * np.exp(-7.0 / distance) + 1e-9)
    # A joint that rests does not move its bristle: poses at rest have none of it.
    rest = JointMotion(t, q, 0 * v, 0 * a, None, 0.0)
    np.testing.assert_array_equal(dahl.torque(rest, (3.0, distance)), 0.0)


def test_a_late_torque_is_that_of_a_moment_ago(panda):
    """All of it, friction included, in the joint that is late; at ``robot`` in every joint."""
    fine, channels = moving(panda, 4000, 0.001), both(panda)
    drives = [
        term(panda, "viscous_friction@joint3", 2.0), term(panda, "coulomb_friction@joint3", 3.0),
        term(panda, "load_friction@joint3", 0.1), term(panda, "torque_gain@joint3", 0.2), term(panda, "spring@joint2", 8.0, 0.3),
    ]  # fmt: skip
    now = readings(panda, channels, replace(fine, cell=0.001), panda.nominal, drives)
    late = readings(panda, channels, fine, panda.nominal, [*drives, term(panda, "torque_delay@joint3", 0.005)])
    others = np.arange(13) != 8
    np.testing.assert_array_equal(late[:, others], now[:, others])
    np.testing.assert_allclose(late[30:-30, 8], now[25:-35, 8], atol=1e-6)
    all_late = readings(panda, channels, fine, panda.nominal, [*drives, term(panda, "torque_delay@robot", 0.005)])
    np.testing.assert_array_equal(all_late[:, :6], now[:, :6])
    np.testing.assert_allclose(all_late[30:-30, 6:], now[25:-35, 6:], atol=1e-6)
    # Two delays of one joint add up; poses at rest are the same at any time.
    twice = readings(
        panda, channels, fine, panda.nominal,
        [*drives, term(panda, "torque_delay@robot", 0.002), term(panda, "torque_delay@joint3", 0.003)],
    )  # fmt: skip
    np.testing.assert_allclose(twice[:, 8], late[:, 8], atol=1e-9)
    terms = [*drives, term(panda, "torque_delay@robot", 0.005)]
    still = readings(panda, channels, fine.at_rest, panda.nominal, terms)
    np.testing.assert_array_equal(still, readings(panda, channels, fine.at_rest, panda.nominal, drives))
