"""A drift beside static runs: `diagnose` and `identify` have the same rows of it, on recordings simulated with known slopes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.recordings.experiment import Sensor
from bayesid.simulation.trajectories import Trajectory, fourier_trajectory
from tests.robots import wrist_sensor_arm, write
from tests.simulated import experiment, puma2

SLOPES = {"fx": 0.05, "fy": -0.04, "fz": 0.06, "mx": 0.004, "my": -0.003, "mz": 0.005}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bayesid.Simulation:
    """Two motions of 12 s, each with its static run, links known to 3 %; an offset is there, too."""
    robot = puma2(tmp_path_factory.mktemp("drift"))
    setup = experiment(robot, [], Sensor(), inertia_rel_std=0.03)
    planned = [
        fourier_trajectory(robot, role, role, duration=12.0, fundamental=0.25, static=True, seed=seed)
        for seed, role in enumerate(("identification", "validation"))
    ]
    recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=5e-5)
    return bayesid.simulate(setup, planned, effects={"sensor_drift": SLOPES, "sensor_offset": {}}, recorder=recorder, seed=1)


def test_a_drift_with_static_runs_is_named(recorded: bayesid.Simulation) -> None:
    found = bayesid.diagnose(recorded)
    assert found.verdict == "named" and [f.term.effect.spec for f in found.found] == ["sensor_drift@sensor"]
    (said,) = found.to_dict()["effects"]
    for axis, slope in SLOPES.items():
        assert abs(said["parameters"][axis]["value"] - slope) < 4.0 * said["parameters"][axis]["std"]
    assert found.gap is not None and found.gap.before > 1.9 and found.gap.after < 1.1 and found.gap.closed_low > 0.9


@pytest.mark.parametrize("static", ["motion", "joint"])
def test_identify_has_the_same_slopes_whether_static_runs_are_subtracted_or_fitted(
    recorded: bayesid.Simulation, static: str
) -> None:
    estimate = bayesid.identify(recorded, effects="sensor_drift", static=static).to_dict()
    (said,) = [e for e in estimate["effects"] if e["name"] == "sensor_drift"]
    for axis, slope in SLOPES.items():
        assert abs(said["parameters"][axis]["value"] - slope) < 4.0 * said["parameters"][axis]["std"]


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> bayesid.Simulation:
    """Poses of a wrist sensor that drifts from each to the next."""
    path = write(tmp_path_factory.mktemp("wrist"), wrist_sensor_arm())
    setup = experiment(bayesid.load_robot(path, sensor_joint="wrist_ft"), [], Sensor("wrist_ft"))
    q = np.random.default_rng(3).uniform(-2.5, 2.5, (24, setup.robot.n))
    planned = [Trajectory("poses", "identification", np.arange(24.0), q, 0.0 * q, 0.0 * q, kind="poses")]
    recorder = bayesid.Recorder(force_std=0.05, torque_std=0.003, resolution=1e-5)
    return bayesid.simulate(setup, planned, effects={"sensor_drift": SLOPES, "sensor_offset": {}}, recorder=recorder, seed=4)


def test_a_drift_from_pose_to_pose_is_found_by_the_order_of_the_rows(poses: bayesid.Simulation) -> None:
    """Against least squares with numpy's own: weight, first moment, offset and a slope for each axis, pose by pose."""
    table, robot = poses.motions[0].table, poses.robot
    rows, target = [], []
    for q, t, w in zip(table.positions, table.times, table.wrench, strict=True):
        down = sensor_attitude(robot, q).T @ np.array([0.0, 0.0, -9.81])
        block = np.zeros((6, 16))
        block[:3, 0], block[3:, 1:4] = -down, pin.skew(down)
        block[:, 4:10], block[:, 10:] = np.eye(6), t * np.eye(6)
        rows.append(block / np.repeat([0.05, 0.003], 3)[:, None])
        target.append(w / np.repeat([0.05, 0.003], 3))
    expected = np.linalg.lstsq(np.concatenate(rows), np.ravel(target), rcond=None)[0]
    weighed, calibrated = bayesid.payload(poses), bayesid.calibrate(poses)
    assert [e.spec for e in weighed.effects] == ["sensor_drift@sensor"]
    assert weighed.mass.value == pytest.approx(expected[0], rel=1e-3)
    for k, q in enumerate(calibrated.found["sensor_drift@sensor"]):
        assert abs(q.value - expected[10 + k]) < 0.5 * q.std
        assert q.low < list(SLOPES.values())[k] < q.high


def sensor_attitude(robot: bayesid.Robot, q: np.ndarray) -> np.ndarray:
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId("sensor_plate")].rotation
