"""Chosen quantities: their expected deviations against dense linear algebra, and motions planned for them."""

from __future__ import annotations

import numpy as np
import pytest

import bayesid
from bayesid.design.excitation.information import typical_sizes
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task
from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Sensor
from tests.design.test_excitation import QUICK, experiment_of
from tests.robots import prismatic_arm, wrist_sensor_arm, write


def wrench_rows(robot, motion, columns=None):
    """Whitened rows of the sensor 0.1 m under the base, (N 6, p), and columns of its offset."""
    channels = wrench_channels(robot, np.eye(3), np.array([0.0, 0.0, -0.1]))
    std = np.repeat([0.5, 0.05], 3)
    rows = Kernel.of(robot, channels, columns).dynamics(*motion) / std[None, :, None]
    offset = np.tile(np.diag(1.0 / std), (len(motion[0]), 1))
    return rows.reshape(-1, rows.shape[2]), offset


def test_deviation_of_torques_is_that_of_dense_algebra(tmp_path):
    """Predicted torques along another motion: covariance of all link parameters by the pseudo-inverse, no base parameters."""
    experiment = experiment_of("puma560", tmp_path)
    robot = experiment.robot
    other = bayesid.fourier_trajectory(robot, duration=10.0, rate=20.0, seed=3)
    bayesid.write_trajectory(other, tmp_path / "other.csv")
    text = f"torque@{tmp_path / 'other.csv'}"
    task, _ = make_task(experiment, ExcitationOptions(channel="wrench", quantities=(text,)))
    series = task.coordinates.series(0.4 * np.random.default_rng(0).normal(size=task.coordinates.count))
    motion = series.at(task.coordinates.times)
    rows, offset = wrench_rows(robot, motion)
    rest = rows - offset @ np.linalg.lstsq(offset, rows, rcond=None)[0]
    information = task.recorded / len(motion[0]) * rest.T @ rest
    # The prior of about one typical size hardly matters here; directions that are not seen are cut off.
    values, vectors = np.linalg.eigh(information * np.outer(typical_sizes(robot), typical_sizes(robot)))
    seen = values > 1e-9 * values[-1]
    assert seen.sum() == task.information.base.rank
    root = typical_sizes(robot)[:, None] * vectors[:, seen] / np.sqrt(values[seen])
    torque = Kernel.of(robot, torque_channels(robot)).dynamics(other.positions, other.velocities, other.accelerations)
    expected = np.sqrt(np.sum((torque.reshape(-1, root.shape[0]) @ root) ** 2) / (6 * len(other.times)))
    # Averages are over samples, torques of one sample added up; the root mean square of one torque is 1 / sqrt(6) of it.
    assert task.quantity_stds(series)[0] == pytest.approx(expected, rel=0.02)


def test_torques_of_sliding_joints_are_forces(tmp_path):
    robot = bayesid.load_robot(write(tmp_path, prismatic_arm()))
    bayesid.write_trajectory(bayesid.fourier_trajectory(robot, duration=4.0, rate=20.0), tmp_path / "other.csv")
    arm = bayesid.Experiment("arm", robot, (), Sensor())
    task, _ = make_task(arm, ExcitationOptions(channel="torque", quantities=(f"torque@{tmp_path / 'other.csv'}",)))
    assert [q.unit for q in task.quantities] == ["N or N m"]


def test_deviation_of_a_payload_is_that_of_dense_algebra(tmp_path):
    """Ten parameters of a body on the last link and the offset, all others known."""
    experiment = experiment_of("ur5", tmp_path)
    robot = experiment.robot
    task, _ = make_task(experiment, ExcitationOptions(channel="wrench", quantities=("payload@joint6",)))
    series = task.coordinates.series(0.4 * np.random.default_rng(0).normal(size=task.coordinates.count))
    motion = series.at(task.coordinates.times)
    rows, offset = wrench_rows(robot, motion, np.arange(50, 60))
    whole = np.hstack([rows, offset])
    information = task.recorded / len(motion[0]) * whole.T @ whole
    scale = np.append(typical_sizes(robot)[50:], np.repeat([10.0, 1.0], 3))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    assert task.quantity_stds(series)[0] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-2)


def test_a_payload_beyond_the_robots_own_sensor_is_a_quantity(tmp_path):
    """It hangs on the part that the sensor weighs: its mass by dense algebra, the offset estimated along."""
    robot = bayesid.load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    arm = bayesid.Experiment("arm", robot, (), Sensor(joint="wrist_ft", force_std=0.5, torque_std=0.05))
    task, _ = make_task(arm, ExcitationOptions(channel="wrench", quantities=("payload@joint6",)))
    series = task.coordinates.series(0.4 * np.random.default_rng(0).normal(size=task.coordinates.count))
    motion, far, std = series.at(task.coordinates.times), np.arange(60, 70), np.repeat([0.5, 0.05], 3)
    rows = Kernel.of(robot, wrench_channels(robot, np.eye(3), np.zeros(3)), far).dynamics(*motion) / std[None, :, None]
    whole = np.hstack([rows.reshape(-1, 10), np.tile(np.diag(1.0 / std), (len(motion[0]), 1))])
    information = task.recorded / len(motion[0]) * whole.T @ whole
    scale = np.append(typical_sizes(robot)[far], np.repeat([10.0, 1.0], 3))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    assert task.quantity_stds(series)[0] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-2)


def test_motion_for_a_quantity_tells_more_of_it(tmp_path):
    experiment = experiment_of("ur5", tmp_path)
    quick = QUICK | {"seconds": 3.0}
    common = bayesid.excite(experiment, quantities=("payload@joint6",), seed=0, **quick)
    own = bayesid.excite(experiment, criterion="quantity", quantities=("payload@joint6",), seed=0, **quick)
    assert own.quantities[0][2] < common.quantities[0][2]
    assert own.within_limits and "payload@joint6" in str(own)


@pytest.mark.parametrize(
    ("quantities", "said"),
    [
        (("payload@joint9",), "no such joint"),
        (("m",), "write payload@JOINT"),
        (("payload@joint1",), "do not determine a mass"),
        ((), "quantities"),
    ],
)
def test_what_is_no_quantity_is_told(quantities, said, tmp_path):
    with pytest.raises(bayesid.InputError, match=said):
        bayesid.excite(experiment_of("puma560", tmp_path), criterion="quantity", quantities=quantities, **QUICK)
