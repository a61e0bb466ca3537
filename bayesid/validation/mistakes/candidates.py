"""The mistakes that are looked for, each as the change of the data that undoes it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.robot.robot import Robot

_DIRECTIONS = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
_AXES = "xyz"
_KILOGRAM_FORCE = 9.80665  # [N]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One possible mistake.

    Attributes
    ----------
    name
        Short and fixed, for programs: ``torque_sign``, ``wrench_sign``, ...
    where
        Which column or joint: ``tau3``, ``q1,q2``; empty for all.
    says
        What seems to be wrong, as a sentence without its full stop.
    remedy
        What to do about it.
    readings, joints, gravity
        The change of the data that undoes it, as `bayesid.validation.mistakes.evidence.Explainer.fit` takes it.
    touched
        Joints that it is about; empty: the whole robot.
    """

    name: str
    where: str
    says: str
    remedy: str
    readings: np.ndarray | None = None
    joints: np.ndarray | None = None
    gravity: np.ndarray | None = None
    touched: tuple[int, ...] = ()


def of_gravity(gravity: np.ndarray) -> list[Candidate]:
    """Gravity along another axis: the robot hangs from a wall or a ceiling, or its base frame is another."""
    size = float(np.linalg.norm(gravity))
    out = []
    for name, direction in _DIRECTIONS.items():
        if size == 0.0 or np.dot(gravity, direction) > 0.99 * size:
            continue
        vector = size * np.array(direction, dtype=float)
        says = f"gravity seems to act along {name} of the base frame"
        remedy = f"write [robot] gravity = [{', '.join(f'{g + 0.0:.4g}' for g in vector)}], or correct the base frame"
        out.append(Candidate("gravity_direction", name, says, remedy, gravity=vector))
    return out


def of_torques(names: Sequence[str]) -> list[Candidate]:
    """Signs of torques, and torque columns in another order."""
    n = len(names)
    says, remedy = "all joint torques seem to have the opposite sign", "change the sign of every tau"
    out = [Candidate("torque_signs", "", says, remedy, -np.eye(n))]
    for j in range(n if n > 1 else 0):
        column = f"tau{j + 1}"
        says = f"the torque of {names[j]} ({column}) seems to have the opposite sign"
        out.append(Candidate("torque_sign", column, says, f"change the sign of {column}", _flip(n, j), touched=(j,)))
    for j, k in itertools.combinations(range(n), 2):
        one, other = f"tau{j + 1}", f"tau{k + 1}"
        says, remedy = f"the torques of {names[j]} and {names[k]} seem to be exchanged", f"exchange columns {one} and {other}"
        out.append(Candidate("torque_order", f"{one},{other}", says, remedy, _swap(n, j, k), touched=(j, k)))
    return out


def of_joints(names: Sequence[str], torques: bool) -> list[Candidate]:
    """Signs and orders of joint positions, alone and together with the torques'."""
    n, out = len(names), []
    if n > 1:
        says, remedy = "all joint positions seem to have the opposite sign", "change the sign of every q"
        out.append(Candidate("position_signs", "", says, remedy, joints=-np.eye(n)))
    for j, name in enumerate(names):
        q, turned = f"q{j + 1}", _flip(n, j)
        says = f"the position of {name} ({q}) seems to have the opposite sign"
        out.append(Candidate("position_sign", q, says, f"change the sign of {q}", joints=turned, touched=(j,)))
        if torques:
            says = f"{name} seems to turn the other way: {q} and tau{j + 1} both have the opposite sign"
            remedy = f"turn the axis of {name} in the URDF, or change the signs of {q} and tau{j + 1}"
            # It shows in the torques of other joints as well: the joint's own may be explained all the same.
            out.append(Candidate("joint_sign", q, says, remedy, turned, turned))
    for j, k in itertools.combinations(range(n), 2):
        one, other, swap = f"q{j + 1}", f"q{k + 1}", _swap(n, j, k)
        where, pair = f"{one},{other}", f"{names[j]} and {names[k]}"
        says, remedy = f"the positions of {pair} seem to be exchanged", f"exchange {one} and {other}, or [robot] joints"
        out.append(Candidate("position_order", where, says, remedy, joints=swap, touched=(j, k)))
        if torques:
            says, remedy = f"{pair} seem to be exchanged, in position and torque", "exchange them in [robot] joints"
            out.append(Candidate("joint_order", where, says, remedy, swap, swap, touched=(j, k)))
    return out


def of_wrench(sensor: Sensor) -> list[Candidate]:
    """Signs, order, units and frame of a wrench, sensor frame, moments about the sensor origin."""
    same, zero = np.eye(3), np.zeros((3, 3))
    rotation = pin.rpy.rpyToMatrix(*map(float, sensor.rpy))
    shift = rotation.T @ sensor.translation
    table = [
        ("wrench_sign", "", "the wrench seems to be that of the robot on the sensor",
         "change the sign of fx ... mz: the table holds what the sensor applies to the robot", -np.eye(6)),
        ("force_sign", "", "the forces seem to have the opposite sign", "change the sign of fx, fy and fz", _blocks(-same, same)),
        ("moment_sign", "", "the moments seem to have the opposite sign", "change the sign of mx, my, mz", _blocks(same, -same)),
        ("forces_moments", "", "forces and moments seem to be exchanged",
         "write forces in fx, fy, fz and moments in mx, my, mz", np.block([[zero, same], [same, zero]])),
    ]  # fmt: skip
    for unit, factor in (("N mm", 1e-3), ("kN m", 1e3), ("kgf m", _KILOGRAM_FORCE)):
        says = f"the moments seem to be in {unit}"
        table.append(("moment_unit", unit, says, "write mx, my and mz in N m", scaled(6, (3, 4, 5), factor)))
    for unit, factor in (("kN", 1e3), ("kgf", _KILOGRAM_FORCE)):
        table.append(("force_unit", unit, f"the forces seem to be in {unit}", "write them in N", scaled(6, (0, 1, 2), factor)))
    if np.abs(rotation - rotation.T).max() > 1e-3:
        says = "the sensor's rotation seems to be the inverse of the stated one"
        remedy = "write the orientation of the sensor in its link ([sensor] rpy), not that of the link in the sensor"
        table.append(("sensor_rotation", "transposed", says, remedy, _blocks(rotation.T @ rotation.T, rotation.T @ rotation.T)))
    if np.abs(rotation - same).max() > 1e-3:
        says = "the wrench seems to be in the axes of the sensor's link already"
        remedy = "write [sensor] rpy = [0, 0, 0], or readings in the sensor's own frame"
        table.append(("wrench_frame", "link", says, remedy, _blocks(rotation.T, rotation.T)))
    if np.linalg.norm(shift) > 1e-3:
        says = "the moments seem to be about the origin of the sensor's link, not about the sensor's"
        remedy = "write [sensor] translation = [0, 0, 0], or moments about the sensor's origin"
        table.append(("moment_point", "link", says, remedy, _shifted(shift)))
        says, remedy = "[sensor] translation seems to have the opposite sign", "write the sensor's origin as seen from its link"
        table.append(("moment_point", "opposite", says, remedy, _shifted(2.0 * shift)))
    return [Candidate(*row) for row in [*table, *_other_axes()]]


def _other_axes() -> Iterator[tuple[str, str, str, str, np.ndarray]]:
    """The 46 other ways to name three axes and their signs, all six columns alike."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if abs(matrix.trace()) == 3.0:
                continue  # the axes as they are, or all turned round, which is the sign of the wrench
            recorded = ", ".join(("" if s > 0 else "-") + _AXES[k] for k, s in zip(order, signs, strict=True))
            turned = np.linalg.det(matrix) > 0.0
            remedy = "turn the sensor ([sensor] rpy) or reorder the columns" if turned else "reorder fx ... mz and their signs"
            says = f"the sensor's axes x, y, z seem to be the recorded {recorded}"
            yield "sensor_axes", recorded, says, remedy, _blocks(matrix, matrix)


def of_degrees(robot: Robot, reach: np.ndarray) -> list[Candidate]:
    """Positions in degrees, of joints that reach too far for radians to be likely (n,) [rad]."""
    out, remedy = [], "write radians"
    for j, name in enumerate(robot.joint_names):
        if reach[j] > np.pi and not robot.prismatic[j]:
            says = f"the position of {name} (q{j + 1}) seems to be in degrees"
            change = scaled(robot.n, [j], np.pi / 180.0)
            out.append(Candidate("position_unit", f"q{j + 1}", says, remedy, joints=change, touched=(j,)))
    if reach.max() > np.pi and robot.n > 1 and not robot.prismatic.any():
        change = np.eye(robot.n) * np.pi / 180.0
        out.append(Candidate("position_unit", "", "all joint positions seem to be in degrees", remedy, joints=change))
    return out


def scaled(count: int, place: Sequence[int], factor: float) -> np.ndarray:
    """Matrix that multiplies some of a number of readings."""
    out = np.eye(count)
    out[list(place), list(place)] = factor
    return out


def _flip(n: int, j: int) -> np.ndarray:
    return scaled(n, [j], -1.0)


def _swap(n: int, j: int, k: int) -> np.ndarray:
    out = np.eye(n)
    out[[j, k]] = out[[k, j]]
    return out


def _blocks(forces: np.ndarray, moments: np.ndarray) -> np.ndarray:
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, 3:] = forces, moments
    return out


def _shifted(shift: np.ndarray) -> np.ndarray:
    """Moments about a point that is shifted by this (3,) in the sensor's axes: ``m - shift x f``."""
    out = np.eye(6)
    out[3:, :3] = -_cross(shift)
    return out


def _cross(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def candidates(experiment: Experiment, channel: str, reach: np.ndarray) -> list[Candidate]:
    """Every mistake of signs, orders, units and frames that readings of a channel could have.

    Parameters
    ----------
    experiment
        The robot and its sensor.
    channel
        ``wrench`` or ``torque``.
    reach
        Largest position of each joint (n,) [rad or m].
    """
    names = experiment.robot.joint_names
    out = of_torques(names) if channel == "torque" else []
    if channel == "wrench" and experiment.sensor is not None:
        out = of_wrench(experiment.sensor)
    out += of_joints(names, channel == "torque") + of_gravity(experiment.robot.gravity)
    return [*out, *of_degrees(experiment.robot, reach)]
