"""The transposed recursion against central differences of the regressor, for every kind of robot and channel."""

from __future__ import annotations

import numpy as np
import pytest

from bayesid.dynamics.channels import stack_channels, torque_channels, wrench_channels
from bayesid.dynamics.regressor_gradient import regressor_gradient
from bayesid.dynamics.regressors import Kernel
from bayesid.robot.robot import load_robot
from tests.robots import ROBOTS, write

TURNED = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


@pytest.mark.parametrize("name", ["panda", "prismatic_arm", "tree", "wrist_sensor_arm"])
@pytest.mark.parametrize("gravity", [True, False])
def test_gradient_is_that_of_central_differences(name, gravity, tmp_path):
    """<U, dY> in random directions of q, v and a, with random weights."""
    robot = load_robot(write(tmp_path, ROBOTS[name]()), sensor_joint="wrist_ft" if name == "wrist_sensor_arm" else None)
    wrench = wrench_channels(robot, TURNED, np.array([0.1, -0.2, 0.3]))
    rng = np.random.default_rng(1)
    for channels in (wrench, torque_channels(robot), stack_channels(wrench, torque_channels(robot))):
        columns = np.sort(rng.choice(10 * len(robot.body_names), 3 * len(robot.body_names), replace=False))
        kernel = Kernel.of(robot, channels, columns)
        motion = rng.normal(size=(3, 5, robot.n))
        weights = rng.normal(size=(5, len(channels), len(columns)))
        gradients = regressor_gradient(kernel, *motion, weights, gravity=gravity)
        for k in range(3):
            for j in range(robot.n):
                step = np.zeros_like(motion)
                step[k, :, j] = 1e-5
                both = [kernel.dynamics(*(motion + sign * step), gravity=gravity) for sign in (1, -1)]
                difference = np.sum(weights * (both[0] - both[1]), axis=(1, 2)) / 2e-5
                scale = 1.0 + np.abs(difference).max()
                np.testing.assert_allclose(gradients[k][:, j] / scale, difference / scale, atol=2e-8)
