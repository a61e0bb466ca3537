"""Estimates from poses at rest and from a motion are compared where they are of the same parameters."""

from __future__ import annotations

import numpy as np

import bayesid
from bayesid.recordings.experiment import Motion, Sensor
from tests.robots import puma560, write
from tests.simulated import experiment, fourier, recording


def test_a_motion_does_not_contradict_poses_that_show_no_inertia(tmp_path):
    """The motion was fitted by the parameters that poses show, and all that its inertias make was called a contradiction."""
    robot, sensor = bayesid.load_robot(write(tmp_path, puma560())), Sensor(translation=np.array([0.0, 0.0, -0.1]))
    noise = dict(force_std=0.02, torque_std=0.002)
    q = np.random.default_rng(1).uniform(-1.2, 1.2, (60, robot.n))
    poses = recording(robot, sensor, (np.arange(60.0), q, 0.0 * q, 0.0 * q), seed=1, **noise)
    moving = recording(robot, sensor, fourier(robot, 2), seed=2, **noise)
    motions = [Motion("poses", "identification", poses, "poses"), Motion("moving", "validation", moving)]
    found = bayesid.identify(experiment(robot, motions, sensor), "wrench", progress=None)
    (agreement,) = found.agreements
    assert agreement.compared > 2 and not agreement.contradiction
    assert not any("contradict" in w for w in found.warnings)
