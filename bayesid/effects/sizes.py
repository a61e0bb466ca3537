"""Sizes of effects that are plausible on a given robot: what a simulation takes and a search for effects expects.

Most are shares of the robot's own scales: the weight and reach beyond a joint, the effort limit of its drive. The
shares are assumed, within the usual percentages; a rotor's inertia is as in the PUMA 560's drives, where gear
ratio^2 x rotor inertia is about 1 % of the effort limit (source: `bayesid.workflows.demo.puma_friction`).
"""

from __future__ import annotations

import numpy as np

from bayesid.effects.effect import Effect
from bayesid.robot.limits import motion_limits
from bayesid.robot.robot import Robot

#: Effort where the URDF states none [N m or N].
ANY_EFFORT = 100.0
# A strain-gauge platform under an arm: tens of newtons [N, N m]; drift per second is a thousandth.
_OFFSET = (14.0, -9.0, 26.0, 1.6, -2.1, 0.7)


def reach(robot: Robot) -> float:
    """Length of the arm's longest chain of joint origins beyond the first joint [m]; at least 0.1."""
    length = np.zeros(robot.n)
    for i in robot.order:
        up = int(robot.parent[i])
        length[i] = 0.0 if up < 0 else length[up] + float(np.linalg.norm(robot.translation[i]))
    return max(float(length.max(initial=0.0)), 0.1)


def mass_beyond(robot: Robot, joint: int) -> float:
    """Nominal mass that a joint moves [kg]; at least 0.1."""
    return max(float(robot.nominal[robot.moves_with[joint], 0].sum()), 0.1)


def typical(effect: Effect, robot: Robot) -> np.ndarray:
    """A plausible value of each parameter of an effect (k,), in its units.

    Parameters
    ----------
    effect
        Which, and where.
    robot
        Its masses, lengths, and effort and velocity limits.
    """
    return np.array(list(_values(effect.name, effect.joint, robot).values()), float)


def _values(name: str, joint: int | None, robot: Robot) -> dict[str, float]:
    j = 0 if joint is None else joint
    known = bool(np.isfinite(robot.effort_limit[j]))
    effort = float(robot.effort_limit[j]) if known else ANY_EFFORT
    speed = float(motion_limits(robot)[2][j])
    long, mass = reach(robot), mass_beyond(robot, j)
    push = 0.05 * 9.81 * mass_beyond(robot, 0)
    axes = ("fx", "fy", "fz", "mx", "my", "mz")
    point = {"point_x": 0.05, "point_y": 0.03, "point_z": 0.08}
    # A compact body of a tenth of the moved mass, in the last link at most a kilogram or so, off the joint's axis.
    m, r = 0.1 * mass, 0.1 * long
    body = {
        "m": m, "mcx": 0.5 * m * r, "mcy": 0.3 * m * r, "mcz": 0.6 * m * r, "Ixx": m * r * r, "Ixy": -0.15 * m * r * r,
        "Iyy": 0.9 * m * r * r, "Ixz": -0.3 * m * r * r, "Iyz": -0.18 * m * r * r, "Izz": 0.8 * m * r * r,
    }  # fmt: skip
    return {
        "sensor_offset": lambda: dict(zip(axes, _OFFSET, strict=True)),
        "sensor_drift": lambda: dict(zip(axes, (1e-3 * x for x in _OFFSET), strict=True)),
        "sensor_gain": lambda: {"gain": 0.03},
        "sensor_crosstalk": lambda: {"coefficient": 0.02},
        "sensor_rotation": lambda: {"rx": 0.01, "ry": -0.015, "rz": 0.02},
        "sensor_translation": lambda: {"x": 0.004, "y": -0.003, "z": 0.005},
        "sensor_delay": lambda: {"delay": 0.004},
        "base_tilt": lambda: {"x": 0.01, "y": -0.015},
        "payload": lambda: body,
        # Mass that is there, but further out than its nominal moment of inertia says: no body is that.
        "inertia_error": lambda: body | {"m": 0.0, "Ixx": 0.0, "Ixy": 0.0, "Iyy": 0.0, "Ixz": 0.0, "Iyz": 0.0, "Izz": 0.0},
        "tether": lambda: {
            "stiffness": push / long, "rest_length": 0.3 * long, "anchor_x": 0.4 * long, "anchor_y": -0.5 * long,
            "anchor_z": 1.5 * long, **point,
        },
        "fluid_drag": lambda: {"linear": 0.5 * push / long, "quadratic": 0.5 * push / long},
        "rotor_momentum": lambda: {"inertia": 1e-4 * effort},
        # A hundredth of a radian under four times the effort limit, as in a harmonic drive.
        "joint_flexibility": lambda: {"compliance": 2.5e-3 / effort},
        "encoder_offset": lambda: {"angle": 0.01},
        "external_contact": lambda: {
            "start": 2.0, "end": 4.0, "fx": push, "fy": -0.6 * push, "fz": 0.8 * push, **point,
        },
        "base_compliance": lambda: {"resonance": 12.0, "damping": 0.05},
        "viscous_friction": lambda: {"coefficient": 0.06 * effort / speed},
        "coulomb_friction": lambda: {"level": 0.05 * effort},
        "torque_offset": lambda: {"offset": 0.01 * effort},
        "stribeck_friction": lambda: {"level": 0.02 * effort, "velocity": 0.05 * speed},
        "load_friction": lambda: {"coefficient": 0.05},
        "rotor_inertia": lambda: {"inertia": 0.01 * effort},
        "torque_gain": lambda: {"gain": 0.05},
        "torque_ripple": lambda: {"amplitude": 0.01 * effort, "periods": 20.0, "phase": 0.5},
        "spring": lambda: {"stiffness": 0.03 * effort, "rest": 0.3},
    }[name]()  # fmt: skip
