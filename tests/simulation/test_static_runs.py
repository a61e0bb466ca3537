"""A static run has what stays when the robot stops, and no more."""

from __future__ import annotations

import numpy as np

from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.simulation.simulation import Recorder, simulate
from bayesid.simulation.trajectories import fourier_trajectory
from tests.simulated import puma2

PERFECT = Recorder(resolution=0.0, force_std=0.0, torque_std=0.0, drive_std=0.0)


def test_drift_and_contacts_do_not_act_in_a_static_run_and_offsets_do(tmp_path):
    robot = puma2(tmp_path)
    setup = Experiment("arm", robot, (), Sensor())
    motion = [fourier_trajectory(robot, duration=6.0, static=True, fundamental=0.5)]

    def static(*effects: str) -> np.ndarray:
        (made,) = simulate(setup, motion, effects=effects, recorder=PERFECT).motions
        return made.static.wrench

    plain = static()
    np.testing.assert_array_equal(static("sensor_drift", "external_contact@joint2"), plain)
    assert np.abs(static("sensor_offset") - plain).min() > 0.1
