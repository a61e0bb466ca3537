"""Readings of planned motions from Pinocchio's inverse dynamics, for tests of what is expected of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import Table
from bayesid.robot.robot import Robot
from bayesid.simulation.trajectories import Trajectory


def readings(robot: Robot, locked: dict[str, float], q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """What an upright sensor at the base frame's origin, and the drives, read (N, 6 + n): `pin.rnea` of a robot free to float."""
    model = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelFreeFlyer())
    model.gravity.linear = robot.gravity
    data, joints = model.createData(), [model.joints[model.getJointId(n)] for n in robot.joint_names]
    out = np.empty((len(q), 6 + robot.n))
    full, rate, acceleration = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for name, x in locked.items():
        full[model.joints[model.getJointId(name)].idx_q] = x
    for k in range(len(q)):
        for j, joint in enumerate(joints):
            full[joint.idx_q], rate[joint.idx_v], acceleration[joint.idx_v] = q[k, j], v[k, j], a[k, j]
        tau = pin.rnea(model, data, full, rate, acceleration)
        out[k] = np.concatenate([tau[:6], [tau[joint.idx_v] for joint in joints]])
    return out


def recorded(setup: Experiment, trajectory: Trajectory, wrench: np.ndarray, static: np.ndarray | None = None) -> Experiment:
    """The experiment with this motion, read like this."""
    table = Table(trajectory.times, trajectory.positions, wrench=wrench)
    rest = None if static is None else Table(trajectory.times, trajectory.positions, wrench=static)
    return replace(setup, motions=(Motion(trajectory.name, "identification", table, static=rest),))
