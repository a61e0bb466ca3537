"""What any robot can be: bodies of positive mass within their links' reach, and friction that only brakes.

A body's ten parameters are a sum, with factors that are not negative, of a few generators: a mass at each corner of a box
around the link, and spread along thirteen directions. The sum holds every body whose centre of mass is in that box and whose
spread about it the directions can make up (a little more and a little less than the physically consistent ones,
[Wensing2018]_): masses, rotational inertias and centres of mass have their signs, which is all that is asked here, and least
squares with factors that are not negative takes milliseconds.
"""

from __future__ import annotations

import itertools

import numpy as np

from bayesid.robot import inertia
from bayesid.robot.robot import Robot

#: How far a body reaches beyond its joints, as a share of its length: counterweights and drives stand over.
_OVERHANG = 0.5
#: Length of a link where the URDF tells none [m].
_USUAL_LENGTH = 0.2
_MASS_BY_LENGTH = 12.0  # [kg/m]
#: Speed, as a share of the usual one, within which Coulomb friction turns over.
_TURNS_OVER = 0.05
_DIRECTIONS = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if d > (0, 0, 0)], dtype=float)


def typical_length(robot: Robot) -> float:
    """The middle length of a robot's links [m]."""
    lengths = np.linalg.norm(np.diff(robot.rods, axis=1)[:, 0], axis=1) if len(robot.rods) else np.zeros(0)
    lengths = lengths[lengths > 1e-3]
    return float(np.median(lengths)) if len(lengths) else _USUAL_LENGTH


def body_generators(robot: Robot) -> np.ndarray:
    """Generators of all bodies' parameters (10 b, 21 b)."""
    usual, count = typical_length(robot), len(robot.body_names)
    columns = []
    for k in range(count):
        ends = np.vstack([np.zeros((1, 3)), robot.rods[robot.rod_joint == robot.body_joint[k]].reshape(-1, 3)])
        low, high = ends.min(axis=0), ends.max(axis=0)
        size = max(float(np.max(high - low)), usual)
        corners = itertools.product(*zip(low - _OVERHANG * size, high + _OVERHANG * size, strict=True))
        for corner in corners:
            columns.append(np.zeros(10 * count))
            columns[-1][10 * k : 10 * k + 4] = 1.0, *corner
        for d in _DIRECTIONS:
            # Mass spread along d has the second moment d d', and so the inertia |d|^2 - d d'.
            spread = size**2 * (np.eye(3) - np.outer(d, d) / (d @ d))
            columns.append(np.zeros(10 * count))
            columns[-1][10 * k + 4 : 10 * k + 10] = spread[inertia.ROW, inertia.COLUMN]
    return np.array(columns).T


def usual_bodies(robot: Robot) -> np.ndarray:
    """Ten parameters of bodies as heavy as links of these lengths usually are (b, 10): a quick guess, good to a factor of twenty.

    A rod from joint to joint of 12 kg a metre: arms, legs and tools from 0.1 to 300 kg are within a factor of twenty of it.
    """
    usual, out = typical_length(robot), []
    for k in range(len(robot.body_names)):
        ends = robot.rods[robot.rod_joint == robot.body_joint[k]].reshape(-1, 3)
        end = ends[np.argmax(np.linalg.norm(ends, axis=1))] if len(ends) else np.zeros(3)
        length = max(float(np.linalg.norm(end)), 0.5 * usual)
        mass = _MASS_BY_LENGTH * length
        out.append(inertia.from_mass_com_inertia(mass, 0.5 * end, mass * length**2 / 30.0 * np.eye(3)))
    return np.array(out)


def friction_columns(velocities: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
    """Viscous and Coulomb friction, rotor inertia, and an offset of either sign of every joint torque (N, n, 5 n).

    None of their factors can be negative, so that no drive is pushed by its friction.
    """
    count, n = velocities.shape
    out = np.zeros((count, n, 5 * n))
    for j in range(n):
        usual = np.sqrt(np.mean(velocities[:, j] ** 2))
        turn = np.tanh(velocities[:, j] / (_TURNS_OVER * usual)) if usual > 0.0 else 0.0
        out[:, j, 5 * j] = velocities[:, j]
        out[:, j, 5 * j + 1] = turn
        out[:, j, 5 * j + 2] = accelerations[:, j]
        out[:, j, 5 * j + 3], out[:, j, 5 * j + 4] = 1.0, -1.0
    return out


def offset_columns(motion: np.ndarray, channels: int) -> np.ndarray:
    """An offset of either sign of every channel in every recording, by the recordings of samples (N,): (N, c, 2 c m)."""
    both = np.hstack([np.eye(channels), -np.eye(channels)])
    mine = motion[:, None] == np.unique(motion)
    return (mine[:, None, :, None] * both[None, :, None, :]).reshape(len(motion), channels, -1)
