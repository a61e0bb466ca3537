"""What pulls, pushes or turns the links from outside or within: force and moment about the base origin.

Each function returns the bodies that it acts on, by index, with the wrench (N, 6) on each.
"""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.kinematics import DW, P, R, V, W
from bayesid.effects.catalogue import CONTACT_RAMP
from bayesid.effects.effect import Scene, Term
from bayesid.robot.robot import Robot

Loads = list[tuple[int, np.ndarray]]
# Drag along a rod: five Gauss points, exact for the linear part, ample for |v| v.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def body_of(robot: Robot, joint: int | None) -> int:
    """Index of the body that something on a joint's link sits on; the last one, b, is the root.

    Where a sensor splits the link it is the part beyond the sensor, where tools, hoses and hands are.
    """
    if joint is None or joint < 0:
        return len(robot.body_names)
    split = np.flatnonzero(robot.body_joint[robot.n :] == joint)
    return int(robot.n + split[0]) if len(split) else joint


def _at(state: np.ndarray, row: int, point) -> np.ndarray:
    """A point of a link in the base frame (N, 3)."""
    x = state[:, row]
    return x[:, P : P + 3] + x[:, R : R + 9].reshape(-1, 3, 3) @ np.asarray(point, float)


def _wrench(points: np.ndarray, force: np.ndarray) -> np.ndarray:
    return np.concatenate([force, np.cross(points, force)], axis=1)


def tether(robot: Robot, scene: Scene, states: np.ndarray, term: Term) -> Loads:
    """One-sided spring: ``k max(|d| - L, 0) d / |d|`` on a point of the link, d from there to the anchor."""
    stiffness, length = term.values[:2]
    joint = term.effect.joint
    assert joint is not None
    points = _at(states, joint, term.values[5:8])
    line = np.asarray(term.values[2:5]) - points
    distance = np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-12)
    force = stiffness * np.maximum(distance - length, 0.0) * line / distance
    return [(body_of(robot, joint), _wrench(points, force))]


def external_contact(robot: Robot, scene: Scene, states: np.ndarray, term: Term) -> Loads:
    """A force of constant direction on a point of the link, from start to end, with ramps."""
    joint = term.effect.joint
    start, end = term.values[:2]
    row = robot.n if joint is None else joint
    points = _at(states, row, term.values[5:8])
    share = contact_window(scene.times, start, end)
    force = share[:, None] * np.asarray(term.values[2:5])
    if scene.still:  # it pushed while the robot moved, not when it was stopped for a reading
        force = np.zeros_like(force)
    return [(body_of(robot, joint), _wrench(points, force))]


def contact_window(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """Share of a contact's force at each time (N,): up from its start and down to its end, along half a cosine."""
    share = np.clip(np.minimum((times - start) / CONTACT_RAMP, (end - times) / CONTACT_RAMP), 0.0, 1.0)
    return 0.5 - 0.5 * np.cos(np.pi * share)


def fluid_drag(robot: Robot, scene: Scene, states: np.ndarray, term: Term) -> Loads:
    """``-(linear + quadratic |v|) v`` per length, along rods between the joints' origins."""
    linear, quadratic = term.values
    out: dict[int, np.ndarray] = {}
    for joint, ends in zip(robot.rod_joint, robot.rods, strict=True):
        rod = ends[1] - ends[0]
        length = float(np.linalg.norm(rod))
        if length < 1e-9:
            continue
        x, body = states[:, joint], body_of(robot, int(joint))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            points = _at(states, joint, ends[0] + 0.5 * (1.0 + node) * rod)
            speed = x[:, V : V + 3] + np.cross(x[:, W : W + 3], points - x[:, P : P + 3])
            size = linear + quadratic * np.linalg.norm(speed, axis=1, keepdims=True)
            wrench = _wrench(points, -0.5 * weight * length * size * speed)
            out[body] = out[body] + wrench if body in out else wrench
    return list(out.items())


def rotor_couple(robot: Robot, states: np.ndarray, joint: int, velocity: np.ndarray, acceleration: np.ndarray):
    """Rate of a rotor's angular momentum per unit of ``gear ratio x rotor inertia``.

    The momentum is ``h = qd z`` with the joint's axis z fixed in the parent link, so
    ``dh/dt = qdd z + qd w x z``. The joint itself feels the rotor's turning with the parent, ``z . dw``.

    Returns
    -------
    body, wrench, own
        The parent's body, the couple that the rotor's motion takes from it (N, 6), and the joint's torque (N,).
    """
    parent = int(robot.parent[joint])
    up = states[:, parent if parent >= 0 else robot.n]
    axis = up[:, R : R + 9].reshape(-1, 3, 3) @ (robot.rotation[joint] @ robot.axis[joint])
    couple = acceleration[:, None] * axis + velocity[:, None] * np.cross(up[:, W : W + 3], axis)
    own = np.sum(axis * up[:, DW : DW + 3], axis=1)
    body = parent if parent >= 0 else len(robot.body_names)
    far = body_of(robot, parent)
    if parent >= 0 and far != parent and robot.sensor_bodies[joint]:
        body = far  # the joint hangs on the part beyond the sensor
    return body, np.concatenate([np.zeros_like(couple), couple], axis=1), own


LOADS = {"tether": tether, "external_contact": external_contact, "fluid_drag": fluid_drag}
