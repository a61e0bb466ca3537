"""Readings of bodies made at once, against Pinocchio's recursion."""

import numpy as np
import pinocchio as pin
import pytest

from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.kinematics import readings_of_bodies
from bayesid.robot.robot import load_robot
from tests.robots import ROBOTS, write


@pytest.mark.parametrize("name", ["puma560", "panda", "prismatic_arm"])
def test_torques_are_those_of_the_recursion(tmp_path, name):
    robot = load_robot(write(tmp_path, ROBOTS[name]()))
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 21, robot.n))  # one run of samples and a part of another
    channels = torque_channels(robot)
    carries = np.hstack([channels.bodies, np.zeros((len(channels), 1), bool)])
    bodies = np.vstack([robot.nominal, robot.static_nominal])
    row_of = np.append(robot.body_joint, robot.n)
    got = readings_of_bodies(robot, channels, (q, v, a), row_of, bodies, robot.gravity, carries)
    model = pin.buildModelFromUrdf(str(robot.urdf))
    model.gravity = pin.Motion(np.asarray(robot.gravity, float), np.zeros(3))
    data = model.createData()
    expected = [pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(got, expected, atol=1e-10)
    some = channels.only([robot.n - 1])
    one = readings_of_bodies(robot, some, (q, v, a), row_of, bodies, robot.gravity, carries[[robot.n - 1]])
    np.testing.assert_allclose(one[:, 0], got[:, -1], atol=1e-12)
