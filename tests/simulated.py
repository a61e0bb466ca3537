"""Experiments made in memory for tests: Fourier motions, quantised encoders, noise with fixed seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.robot.robot import Robot, load_robot
from tests.robots import write


def fourier(robot: Robot, seed: int, duration: float = 20.0, rate: float = 125.0, speed: float = 1.5):
    """Times, positions, velocities and accelerations of a 0.1 Hz five-harmonic motion."""
    rng = np.random.default_rng(seed)
    times = np.arange(0, duration, 1.0 / rate)
    w = 2 * np.pi * 0.1 * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, robot.n))
    s, c = np.sin(np.outer(times, w)), np.cos(np.outer(times, w))
    q, v, acc = s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b
    scale = speed / np.abs(v).max(axis=0)
    return times, q * scale, v * scale, acc * scale


def recording(
    robot: Robot,
    sensor: Sensor | None,
    motion,
    *,
    seed: int = 0,
    force_std: float = 0.0,
    torque_std: float = 0.0,
    resolution: float = 0.0,
    offset: float | np.ndarray = 0.0,
    phi: np.ndarray | None = None,
    static: bool = False,
) -> Table:
    """One table; positions rounded to the resolution, readings from the exact motion."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    times, q, v, a = motion
    if static:
        v, a = np.zeros_like(v), np.zeros_like(a)
    phi = robot.nominal.ravel() if phi is None else phi
    rounded = np.round(q / resolution) * resolution if resolution else q
    wrench = None
    if sensor is not None:
        channels = wrench_channels(robot, Rotation.from_euler("xyz", sensor.rpy).as_matrix(), sensor.translation)
        wrench = Kernel.of(robot, channels).dynamics(q, v, a) @ phi + channels.static_wrench + offset
        wrench = wrench + rng.normal(size=wrench.shape) * np.repeat([force_std, torque_std], 3)
    torques = Kernel.of(robot, torque_channels(robot)).dynamics(q, v, a) @ phi
    torques = torques + torque_std * rng.normal(size=torques.shape)
    return Table(times=times, positions=rounded, wrench=wrench, torques=torques)


def experiment(robot: Robot, motions, sensor: Sensor | None = None, **options) -> Experiment:
    """An experiment of named motions."""
    return Experiment(name="test", robot=robot, motions=tuple(motions), sensor=sensor, **options)


def puma2(folder: Path) -> Robot:
    """The paper's two-joint robot."""
    from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf

    return load_robot(write(folder, puma_two_joint_urdf()), ["joint1", "joint2"], PAPER_LOCKED)


__all__ = ["Motion", "Sensor", "experiment", "fourier", "puma2", "recording"]
