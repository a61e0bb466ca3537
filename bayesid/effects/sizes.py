"""A robot's own scales, of which plausible sizes of effects are shares: what it weighs, reaches, and its drives can do.

The shares stand with the effects. They are assumed, within the usual percentages; a rotor's inertia is as in the PUMA 560's
drives, where gear ratio^2 x rotor inertia is about 1 % of the effort limit (source: `bayesid.workflows.demo.puma_friction`).
"""

from __future__ import annotations

import numpy as np

from bayesid.robot.robot import Robot, motion_limits

#: Effort where the URDF states none [N m or N].
ANY_EFFORT = 100.0


def reach(robot: Robot) -> float:
    """Length of the arm's longest chain of joint origins beyond the first joint [m]; at least 0.1."""
    length = np.zeros(robot.n)
    for i in robot.order:
        up = int(robot.parent[i])
        length[i] = 0.0 if up < 0 else length[up] + float(np.linalg.norm(robot.translation[i]))
    return max(float(length.max(initial=0.0)), 0.1)


def mass_beyond(robot: Robot, joint: int | None) -> float:
    """Nominal mass that a joint moves, default the first [kg]; at least 0.1."""
    return max(float(robot.nominal[robot.moves_with[joint or 0], 0].sum()), 0.1)


def push(robot: Robot) -> float:
    """A force that such a robot notices: a twentieth of its weight [N]."""
    return 0.05 * 9.81 * mass_beyond(robot, 0)


def effort(robot: Robot, joint: int | None, share: float = 1.0) -> float:
    """A share of the effort limit of a joint, default the first [N m or N]."""
    limit = float(robot.effort_limit[joint or 0])
    return share * (limit if np.isfinite(limit) else ANY_EFFORT)


def speed(robot: Robot, joint: int | None, share: float = 1.0) -> float:
    """A share of the velocity limit of a joint, default the first [rad/s or m/s]."""
    return share * float(motion_limits(robot)[2][joint or 0])


def viscous(robot: Robot, joint: int | None, share: float) -> float:
    """Viscous friction that takes a share of the effort limit at the velocity limit [N m s/rad or N s/m]."""
    return effort(robot, joint, share) / speed(robot, joint)
