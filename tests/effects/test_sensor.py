"""The force/torque sensor's own effects, against sensors that are stated there and closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import wrench_channels
from bayesid.effects import readings
from tests.effects.arms import SHIFT, TURN, both, moving, term


@pytest.mark.parametrize("name", ["panda", "wrist"])
def test_sensor_pose_is_that_of_another_sensor(name, request):
    """A turned or shifted sensor reads what a sensor that is stated there would."""
    robot = request.getfixturevalue(name)
    segment = moving(robot, 60)
    stated = wrench_channels(robot, TURN, SHIFT)
    r, d = np.array([0.05, -0.1, 0.2]), np.array([0.02, -0.03, 0.01])
    terms = [term(robot, "sensor_rotation", *r), term(robot, "sensor_translation", *d)]
    true = wrench_channels(robot, TURN @ Rotation.from_rotvec(r).as_matrix(), SHIFT + d)
    np.testing.assert_allclose(
        readings(robot, stated, segment, robot.nominal, terms), readings(robot, true, segment, robot.nominal), atol=1e-10
    )


def test_sensor_chain_in_its_order(panda):
    segment, channels = moving(panda), both(panda)
    true = readings(panda, channels, segment, panda.nominal)
    offset, drift = np.arange(1.0, 7.0), 0.1 * np.arange(6.0, 0.0, -1.0)
    terms = [
        term(panda, "sensor_gain@mz", 0.1), term(panda, "sensor_crosstalk@fx->mz", 0.03),
        term(panda, "sensor_offset", *offset), term(panda, "sensor_drift", *drift),
    ]  # fmt: skip
    expected = true.copy()
    expected[:, 5] = 1.1 * true[:, 5] + 0.03 * true[:, 0]
    expected[:, :6] += offset + segment.times[:, None] * drift
    np.testing.assert_allclose(readings(panda, channels, segment, panda.nominal, terms), expected, atol=1e-10)
    # A delay moves all six, and the motion a moment ago gives the wrench of that moment.
    fine = moving(panda, 4000, 0.001)
    late = readings(panda, channels, fine, panda.nominal, [term(panda, "sensor_delay", 0.005)])
    now = readings(panda, channels, fine, panda.nominal)
    np.testing.assert_allclose(late[5:, :6], now[:-5, :6], atol=1e-6)
    np.testing.assert_array_equal(late[:, 6:], now[:, 6:])
    # With a static run subtracted, offsets and pulls go, drift and pushes stay.
    tether = term(panda, "tether@joint5", 50.0, 0.1, 0.3, 0.2, 1.0, 0.0, 0.0, 0.0)
    apart = readings(panda, channels, segment, panda.nominal, [*terms, tether], gravity=False)
    plain = readings(panda, channels, segment, panda.nominal, terms[:2], gravity=False)
    np.testing.assert_allclose((apart - plain)[:, :6], segment.times[:, None] * drift, atol=1e-9)
    # Poses are read after re-zeroing: their times are numbers.
    held = [readings(panda, channels, segment.at_rest, panda.nominal, some) for some in (terms, terms[:3])]
    np.testing.assert_array_equal(*held)
