"""What effects may want to know of the recordings that they are sought in: where links are, and what joints feel and do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.kinematics import P, link_states
from bayesid.effects.effect import Surroundings
from bayesid.effects.exact import readings
from bayesid.effects.segment import MotionSegment
from bayesid.robot.robot import Robot

#: A joint that moves by no more than this stands still: a held joint gives way by as much under load [rad or m].
STILL = 1e-3


def surroundings_of(
    robot: Robot, trajectories: Sequence[MotionSegment], links: np.ndarray, channel: str, sensor_under_base: bool, *,
    static_run: bool, links_known: bool,
) -> Surroundings:  # fmt: skip
    """What effects may want to know of some motions; ``links`` are ten parameters a body (10 b,), for what joints feel."""
    states = (link_states(robot, t.positions, t.velocities, t.accelerations)[:, : robot.n] for t in trajectories)
    return Surroundings(
        robot=robot, times=(min(float(t.times[0]) for t in trajectories), max(float(t.times[-1]) for t in trajectories)),
        mean_places=np.mean([x[:, :, P : P + 3].mean(axis=0) for x in states], axis=0),
        joint_inertia=joint_inertia(robot, trajectories[0], links), moving=moving(robot, trajectories), links_known=links_known,
        both_channels=channel == "both", torques=channel != "wrench", static_run=static_run,
        base_sensor=channel != "torque" and sensor_under_base,
    )  # fmt: skip


def moving(robot: Robot, trajectories: Sequence[MotionSegment]) -> np.ndarray:
    """Whether each joint moves in one of some motions (n,)."""
    moves = [np.ptp(trajectory.positions, axis=0) > STILL for trajectory in trajectories if not trajectory.still]
    return np.any([np.zeros(robot.n, bool), *moves], axis=0)


def joint_inertia(robot: Robot, trajectory: MotionSegment, links: np.ndarray) -> np.ndarray:
    """Mean inertia that each joint feels over a motion (n,) [kg m^2 or kg], by ten parameters a body (10 b,)."""
    n = robot.n
    poses = np.repeat(trajectory.positions[:: max(len(trajectory.positions) // 20, 1)], n, axis=0)
    rates = np.tile(np.eye(n), (len(poses) // n, 1))
    channels = torque_channels(robot)
    times = np.arange(len(poses), dtype=float)
    torque = [readings(robot, channels, MotionSegment(times, poses, 0.0 * poses, a), links, ()) for a in (rates, 0.0 * rates)]
    return np.einsum("knn->n", (torque[0] - torque[1]).reshape(-1, n, n)) / (len(poses) // n)
