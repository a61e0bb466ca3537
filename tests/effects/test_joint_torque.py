"""What is inside a joint, against closed forms."""

import numpy as np

from bayesid.effects import readings
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
