"""Limits of a motion: those that the URDF states, and those of a small arm where it states none."""

from __future__ import annotations

import numpy as np

from bayesid.robot.robot import Robot

# Where the URDF states no limit: half a turn to both sides, and speeds of a small arm.
_RANGE = {False: np.pi / 2, True: 0.25}
_SPEED = {False: 1.5, True: 0.3}


def motion_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower and upper positions and the largest speed (n,), all finite: those of a small arm where none are stated."""
    reach = np.array([_RANGE[bool(p)] for p in robot.prismatic])
    speed = np.array([_SPEED[bool(p)] for p in robot.prismatic])
    free = ~(np.isfinite(robot.lower) & np.isfinite(robot.upper))
    fastest = np.where(np.isfinite(robot.velocity_limit), robot.velocity_limit, speed)
    return np.where(free, -reach, robot.lower), np.where(free, reach, robot.upper), fastest
