"""The arm of the case study: what is known of it, what it really is, and its motion under control, by Pinocchio."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import bayesid
from bayesid.simulation.simulation import perturbed_links

sys.path.append(str(Path(__file__).parents[2]))
from tests.example_robots import Joint, Link, Vector, urdf_text

SEED = 7
TRUST = 0.15
DEGREES = math.pi / 180.0
#: Distances and senses of the joints, limits, and the links' masses, middles and half axes; an arm of the size and limits that
#: makers of light seven-joint arms publish (about 0.8 m of reach, 14 kg), its bodies uniform ellipsoids.
TABLE: tuple[tuple[float, Vector, tuple[float, float, float], float, Vector, Vector], ...] = (
    (0.16, (0, 0, 1), (170, 1.7, 176), 3.4, (0.0, -0.03, 0.12), (0.08, 0.09, 0.13)),
    (0.20, (0, 1, 0), (120, 1.7, 176), 3.5, (0.0, 0.05, 0.05), (0.07, 0.09, 0.13)),
    (0.22, (0, 0, 1), (170, 1.75, 110), 2.9, (0.0, 0.03, 0.13), (0.07, 0.08, 0.13)),
    (0.20, (0, -1, 0), (120, 2.3, 110), 2.5, (0.0, 0.06, 0.04), (0.06, 0.08, 0.11)),
    (0.20, (0, 0, 1), (170, 2.4, 110), 1.5, (0.0, 0.02, 0.08), (0.06, 0.06, 0.12)),
    (0.20, (0, 1, 0), (120, 3.1, 40), 1.6, (0.01, 0.01, 0.0), (0.06, 0.07, 0.06)),
    (0.10, (0, 0, 1), (170, 3.1, 40), 0.8, (0.02, 0.01, 0.05), (0.05, 0.04, 0.05)),
)
EFFECTS = ("viscous_friction", "rotor_inertia")
#: What is inside the joints: friction [N m s/rad] and reflected rotor inertia [kg m^2].
FRICTION = np.array([6.0, 6.0, 4.0, 4.0, 3.0, 1.5, 1.0])
ROTORS = np.array([0.9, 0.9, 0.6, 0.5, 0.3, 0.15, 0.1])


def urdf() -> str:
    """The arm as its drawings have it."""
    links, joints = [Link("base", 4.0, (0.0, 0.0, 0.07), (0.02, 0.02, 0.02))], []
    for k, (height, axis, (degrees, speed, effort), mass, com, half) in enumerate(TABLE, 1):
        x, y, z = (h * h * mass / 5.0 for h in half)
        limits = (-degrees * DEGREES, degrees * DEGREES, speed, effort)
        joints.append(Joint(f"joint{k}", links[-1].name, f"link{k}", (0.0, 0.0, height), axis=axis, limits=limits))
        links.append(Link(f"link{k}", mass, com, (y + z, z + x, x + y), (0.1, -0.1, 0.2)))
    return urdf_text("seven_joint_arm", links, joints)


def setup(folder: Path) -> bayesid.Experiment:
    """What is known before any motion: the drawing, how far it is trusted, and the sensors."""
    path = folder / "robot.urdf"
    path.write_text(urdf(), encoding="utf-8")
    sensor = bayesid.Sensor(translation=np.array([0.0, 0.0, -0.05]), force_std=0.5, torque_std=0.05)
    return bayesid.Experiment(
        "seven_joint_arm", bayesid.load_robot(path), (), sensor, effects=EFFECTS, inertia_rel_std=TRUST, position_resolution=2e-5
    )


def true_links(robot: bayesid.Robot) -> np.ndarray:
    """The links that the arm really has (7, 10): each body of the drawing deformed by about the stated share."""
    return perturbed_links(robot, TRUST, SEED)


def inside() -> dict[str, dict[str, float]]:
    """Friction and rotors for `bayesid.simulate`."""
    out = {f"viscous_friction@joint{k + 1}": {"coefficient": float(c)} for k, c in enumerate(FRICTION)}
    return out | {f"rotor_inertia@joint{k + 1}": {"inertia": float(j)} for k, j in enumerate(ROTORS)}


def plant(robot: bayesid.Robot, links: np.ndarray) -> pin.Model:
    """Pinocchio's model of the true links."""
    model = pin.buildModelFromUrdf(str(robot.urdf))
    for joint, body in enumerate(links.reshape(-1, 10)):
        model.inertias[joint + 1] = pin.Inertia.FromDynamicParameters(body)
    return model


def mass_matrix(model: pin.Model, data: pin.Data, q: np.ndarray) -> np.ndarray:
    """True mass matrix, rotors included (7, 7)."""
    upper = np.triu(pin.crba(model, data, q))
    return upper + np.triu(upper, 1).T + np.diag(ROTORS)


def true_torques(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques that a motion takes (N, 7)."""
    data = model.createData()
    rigid = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    return rigid + FRICTION * v + ROTORS * a


def follow(
    model: pin.Model,
    command: Callable[..., np.ndarray],
    desired: Callable[[float], tuple[np.ndarray, ...]],
    time: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,), errors of the joints (N, 7) and torques (N, 7) under control, from rest on the path (Runge-Kutta).

    Parameters
    ----------
    model
        The true arm.
    command
        Torques for q, v and the desired position, velocity and acceleration.
    desired
        These at a time.
    time, step
        Length and step of the simulation [s].
    """
    data, size = model.createData(), model.nv

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:size], x[size:]
        torque = command(q, v, *desired(t)) - FRICTION * v - pin.rnea(model, data, q, v, np.zeros(size))
        return np.concatenate([v, np.linalg.solve(mass_matrix(model, data, q), torque)])

    start = desired(0.0)
    x = np.concatenate([start[0], start[1]])
    times, errors, torques = step * np.arange(round(time / step) + 1), [], []
    for t in times:
        target = desired(t)
        errors.append(x[:size] - target[0])
        torques.append(command(x[:size], x[size:], *target))
        a = rates(t, x)
        b = rates(t + 0.5 * step, x + 0.5 * step * a)
        c = rates(t + 0.5 * step, x + 0.5 * step * b)
        x = x + step / 6.0 * (a + 2.0 * b + 2.0 * c + rates(t + step, x + step * c))
    return times, np.array(errors), np.array(torques)
