"""The mistakes that are looked for, each as the change of the data that undoes it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.dynamics.kinematics import P, R, W, link_states
from bayesid.recordings.complaints import in_words
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.robot.robot import Robot
from bayesid.validation.mistakes.evidence import TOOL_REACH, Change
from bayesid.validation.mistakes.samples import Samples

_DIRECTIONS = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
_AXES = "xyz"
_KILOGRAM_FORCE = 9.80665  # [N]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One possible mistake."""

    name: str  # short and fixed, for programs: ``torque_sign``, ``wrench_sign``, ...
    where: str  # which column or joint: ``tau3``, ``q1,q2``; empty for all
    says: str  # what seems to be wrong, as a sentence without its full stop
    remedy: str  # what to do about it
    change: Change  # what undoes it
    touched: tuple[int, ...] = ()  # joints that it is about; empty: the whole robot
    odds: float = 0.0  # log odds beside a usual single mistake, which are 0 [nats]


@dataclass(frozen=True)
class Mistake:
    """What seems to be wrong with the data, and what undoing it would bring."""

    #: Which mistake, as `Candidate` names it.
    name: str
    where: str
    text: str  # one line: what seems wrong, by how much the fit improves, what to do
    channel: str  # ``wrench`` or ``torque``: in which readings it shows
    evidence: float  # log odds against the data as they are [nats]; infinite for readings of an impossible size
    #: Residual in each column, rms, as the data are and with the mistake undone (c,) [unit of the column].
    before: tuple[float, ...] = ()
    after: tuple[float, ...] = ()
    alternatives: tuple[tuple[str, str], ...] = ()  # name and place of other mistakes that would repair the fit as well

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``mistakes`` in ``check.json``."""
        return {
            "name": self.name, "where": self.where, "text": self.text, "channel": self.channel,
            "evidence_nats": self.evidence if math.isfinite(self.evidence) else None,
            "residual_before": list(self.before), "residual_after": list(self.after),
            "alternatives": [{"name": name, "where": where} for name, where in self.alternatives],
        }  # fmt: skip


def of_gravity(gravity: np.ndarray) -> list[Candidate]:
    """Gravity along another axis: the robot hangs from a wall or a ceiling, or its base frame is another."""
    size = float(np.linalg.norm(gravity))
    out = []
    for name, direction in _DIRECTIONS.items():
        if size == 0.0 or np.dot(gravity, direction) > 0.99 * size:
            continue
        vector = size * np.array(direction, dtype=float)
        out.append(along(vector, gravity, name))
    return out


def along(vector: np.ndarray, stated: np.ndarray, name: str = "") -> Candidate:
    """Gravity along another direction (3,) [m/s^2] than the stated one (3,), which may be an axis with a name."""
    away = float(np.degrees(np.arccos(np.clip(vector @ stated / (np.linalg.norm(vector) * np.linalg.norm(stated)), -1.0, 1.0))))
    mount = " (on a wall)" if 60.0 < away < 120.0 else " (on a ceiling)" if away >= 120.0 else ""
    written = ", ".join(f"{g + 0.0:.4g}" for g in vector)
    if name:
        says = f"gravity seems to act along {name} of the base frame{mount}"
        return Candidate("gravity_direction", name, says, _mounted(written), Change(gravity=vector))
    says = f"the base seems to be tilted: gravity acts {away:.3g} degrees from where it is stated{mount}"
    return Candidate("base_tilt", "", says, _mounted(written), Change(gravity=vector, numbers=2))


def _mounted(gravity: str) -> str:
    return f"write [robot] gravity = [{gravity}], or correct the base frame"


def of_weight(robot: Robot, channels: Sequence[str]) -> list[Candidate]:
    """Weight that something has taken out of the readings already: a controller's gravity compensation, or a counterbalance."""
    torque = channels[0].startswith("tau")
    every, what = tuple(range(len(channels))), "all joint torques" if torque else "the wrench"
    columns = "every tau" if torque else "fx ... mz"
    says = f"gravity seems to be taken out of {what} already"
    remedy = "write [robot] gravity = [0, 0, 0], or record them before gravity is compensated"
    out = [Candidate("gravity_removed", "", says, remedy, Change(gravity=np.zeros(3)))]
    masses = robot.nominal[:, 0].sum() > 0.0
    if masses:
        says = f"gravity as the URDF's masses make it seems to be taken out of {what}"
        remedy = f"add that gravity torque to {columns} again, or record them before gravity is compensated"
        if not torque:
            remedy = f"add that weight to {columns} again, or record them before it is taken out"
        out.append(Candidate("gravity_removed", "nominal", says, remedy, Change(weight_added=every)))
    for k, column in enumerate(channels if torque and len(channels) > 1 else ()):
        j = int(column.removeprefix("tau")) - 1
        name = robot.joint_names[j]
        says = f"gravity seems to be taken out of the torque of {name} ({column}) already, by a controller or a counterbalance"
        # A spring, a cylinder or a weight: what it takes off the drive is not missing in the readings.
        balance = f"a counterbalance is part of the robot: add spring@joint{j + 1} to [model] effects"
        remedy = f"record {column} before a controller compensates gravity, or leave it out; {balance}"
        out.append(Candidate("gravity_removed", column, says, remedy, Change(weightless=(k,)), (j,)))
        if masses:
            says = f"gravity as the URDF's masses make it seems to be taken out of the torque of {name} ({column})"
            remedy = f"if a controller does that, add that gravity torque to {column} again; {balance}, and change no torque"
            out.append(Candidate("gravity_removed", f"{column} nominal", says, remedy, Change(weight_added=(k,)), (j,)))
    return out


def signs(names: Sequence[str], measured: Sequence[int], joints: Iterable[int], kind: str) -> Candidate:
    """Opposite signs of some joints' ``torque`` or ``position``, or of both, the kind ``joint``; torques are measured of some."""
    which = tuple(joints)
    every = which == tuple(measured if kind == "torque" else range(len(names)))
    readings = scaled(len(measured), [k for k, j in enumerate(measured) if j in which], -1.0)
    change = Change(readings if kind != "position" else None, scaled(len(names), which, -1.0) if kind != "torque" else None)
    letters = {"torque": ("tau",), "position": ("q",), "joint": ("q", "tau")}[kind]
    columns = in_words([f"{letter}{j + 1}" for j in which for letter in letters])
    where = "" if every else ",".join(f"{letters[0]}{j + 1}" for j in which)
    several, owners = ("s" if len(which) > 1 else ""), in_words([names[j] for j in which])
    name = f"{kind}_sign{several}"
    if kind == "joint":
        says = f"{owners} seem{'' if several else 's'} to turn the other way: {columns} have the opposite sign"
        remedy = f"turn the {'axes' if several else 'axis'} of {owners} in the URDF, or change the signs of {columns}"
        # It shows in the torques of other joints as well: the joint's own may be explained all the same.
        return Candidate(name, where, says, remedy, change)
    if every:
        says = f"all joint {kind}s seem to have the opposite sign"
        return Candidate(name, where, says, f"change the sign of every {letters[0]}", change)
    says = f"the {kind}{several} of {owners} ({columns}) seem{'' if several else 's'} to have the opposite sign"
    return Candidate(name, where, says, f"change the sign{several} of {columns}", change, which)


def of_signs(names: Sequence[str], measured: Sequence[int]) -> list[Candidate]:
    """Signs of one joint or all of them: torques, which loggers turn round, before positions, which follow the URDF."""
    out = []
    for kind in ("torque", "position", "joint") if measured else ("position",):
        joints = range(len(names)) if kind == "position" else measured
        sets = [] if kind == "joint" or len(joints) == 1 else [joints]
        out += [signs(names, measured, chosen, kind) for chosen in [*sets, *([j] for j in joints)]]
    return out


def order(names: Sequence[str], positions: Sequence[int], torques: Sequence[int]) -> Candidate:
    """Columns in another order: which holds the position, and the torque, of each joint (n,), from 0."""
    n = len(names)
    same = list(range(n))
    moved = tuple(j for j in same if positions[j] != j or torques[j] != j)
    change = Change(
        readings=None if list(torques) == same else np.eye(n)[list(torques)],
        joints=None if list(positions) == same else np.eye(n)[list(positions)],
    )
    pair = f"{names[moved[0]]} and {names[moved[1]]}" if len(moved) == 2 else ""
    if not pair:  # the order of all is one thing, which some of them may not show
        moved = ()

    def of(letter: str, columns: Sequence[int]) -> str:
        own = [f"{letter}{columns[j] + 1}" for j in same if columns[j] != j]
        return ",".join(sorted(own) if len(own) == 2 else own)

    def held(letter: str, columns: Sequence[int]) -> str:
        return in_words([f"{letter}{columns[j] + 1} holds {names[j]}" for j in same if columns[j] != j])

    if list(positions) == list(torques):
        listed = ", ".join(names[list(positions).index(k)] for k in same)
        says = f"{pair} seem to be exchanged, in position and torque"
        remedy = "exchange them in [robot] joints"
        if not pair:
            says = f"the columns seem to be in another order of joints: {listed}"
            remedy = "write [robot] joints in that order"
        return Candidate("joint_order", of("q", positions), says, remedy, change, moved)
    alone = [("torque", "tau", torques, "exchange columns {}"), ("position", "q", positions, "exchange {}, or [robot] joints")]
    for (kind, letter, columns, exchange), others in zip(alone, (positions, torques), strict=True):
        if list(others) == same:
            where = of(letter, columns)
            says, remedy = f"the {kind}s of {pair} seem to be exchanged", exchange.format(where.replace(",", " and "))
            if not pair:
                says, remedy = (
                    f"the {kind}s seem to be in another order: {held(letter, columns)}",
                    f"reorder the columns {letter}",
                )
            return Candidate(f"{kind}_order", where, says, remedy, change, moved)
    says = f"positions and torques seem to be in other orders: {held('q', positions)}; {held('tau', torques)}"
    where = f"{of('q', positions)};{of('tau', torques)}"
    return Candidate("column_order", where, says, "reorder the columns q and tau", change, moved)


def zeros(names: Sequence[str], angles: np.ndarray) -> Candidate:
    """Positions that count from another zero than the URDF's: what must be added to each (n,) [rad]."""
    which = [j for j, angle in enumerate(angles) if angle != 0.0]
    several, owners = ("s" if len(which) > 1 else ""), in_words([names[j] for j in which])
    added = in_words([f"{angles[j]:+.5g} rad ({np.degrees(angles[j]):+.0f} degrees) to q{j + 1}" for j in which])
    says = f"{owners} seem{'' if several else 's'} to count from {'other zeros' if several else 'another zero'} than the URDF"
    return Candidate(
        name=f"position_zero{several}", where=",".join(f"q{j + 1}" for j in which), says=says,
        remedy=f"add {added}, or turn the zero{several} in the URDF", change=Change(zeros=angles),
    )  # fmt: skip


def of_wrench(sensor: Sensor, tool: bool = False) -> list[Candidate]:
    """Signs, order, units and frame of a wrench, sensor frame, moments about the sensor origin.

    Poses show a ``tool`` alike whose forces are in a larger unit and whose centre of mass is so many times as far away.
    """
    forces, moments, both = (0, 1, 2), (3, 4, 5), np.eye(2)
    rotation = sensor.rotation
    shift = rotation.T @ sensor.translation
    table = [
        ("wrench_sign", "", "the wrench seems to be that of the robot on the sensor",
         "change the sign of fx ... mz: the table holds what the sensor applies to the robot", -np.eye(6)),
        ("force_sign", "", "the forces seem to have the opposite sign",
         "change the sign of fx, fy and fz", scaled(6, forces, -1.0)),
        ("moment_sign", "", "the moments seem to have the opposite sign",
         "change the sign of mx, my, mz", scaled(6, moments, -1.0)),
        ("forces_moments", "", "forces and moments seem to be exchanged",
         "write forces in fx, fy, fz and moments in mx, my, mz", np.roll(np.eye(6), 3, axis=0)),
    ]  # fmt: skip
    for k, name in enumerate(WRENCH_NAMES):
        says, remedy = f"the sign of {name} seems to be the opposite", f"change the sign of {name}"
        table.append(("axis_sign", name, says, remedy, scaled(6, [k], -1.0)))
    for unit, factor in (("N mm", 1e-3), ("kN m", 1e3), ("kgf m", _KILOGRAM_FORCE)):
        says = f"the moments seem to be in {unit}"
        table.append(("moment_unit", unit, says, "write mx, my and mz in N m", scaled(6, moments, factor)))
    for unit, factor in (("kN", 1e3), ("kgf", _KILOGRAM_FORCE)):
        remedy = "write them in N"
        if tool:
            remedy += f"; they are right where the centre of mass of what the sensor carries is over {TOOL_REACH:g} m away"
        table.append(("force_unit", unit, f"the forces seem to be in {unit}", remedy, scaled(6, forces, factor)))
    if np.abs(rotation - rotation.T).max() > 1e-3:
        says = "the sensor's rotation seems to be the inverse of the stated one"
        remedy = "write the orientation of the sensor in its link ([sensor] rpy), not that of the link in the sensor"
        table.append(("sensor_rotation", "transposed", says, remedy, np.kron(both, rotation.T @ rotation.T)))
    if np.abs(rotation - np.eye(3)).max() > 1e-3:
        says = "the wrench seems to be in the axes of the sensor's link already"
        remedy = "write [sensor] rpy = [0, 0, 0], or readings in the sensor's own frame"
        table.append(("wrench_frame", "link", says, remedy, np.kron(both, rotation.T)))
    if np.linalg.norm(shift) > 1e-3:
        says = "the moments seem to be about the origin of the sensor's link, not about the sensor's"
        remedy = "write [sensor] translation = [0, 0, 0], or moments about the sensor's origin"
        table.append(("moment_point", "link", says, remedy, _shifted(shift)))
        says, remedy = "[sensor] translation seems to have the opposite sign", "write the sensor's origin as seen from its link"
        table.append(("moment_point", "opposite", says, remedy, _shifted(2.0 * shift)))
    every = [*table, *_other_axes()]
    return [Candidate(name, where, says, remedy, Change(readings=matrix)) for name, where, says, remedy, matrix in every]


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
            yield "sensor_axes", recorded, says, remedy, np.kron(np.eye(2), matrix)


def in_base_axes(rotations: np.ndarray) -> list[Candidate]:
    """A moving sensor's wrench in axes that do not move with it, of either sign; its rotations in the base frame (N, 3, 3)."""
    turned = np.zeros((len(rotations), 6, 6))
    turned[:, :3, :3] = turned[:, 3:, 3:] = rotations.swapaxes(1, 2)
    says = "the wrench seems to be in the axes of the base, not in the sensor's"
    remedy = "turn it into the sensor's axes with the joint positions, or record it as the sensor gives it"
    opposite = f"{says}, and to be that of the robot on the sensor"
    return [
        Candidate("wrench_frame", "base", says, remedy, Change(readings=turned)),
        Candidate("wrench_frame", "base, opposite", opposite, f"{remedy}, and change its sign", Change(readings=-turned)),
    ]


def base_axes(robot: Robot, sensor: Sensor, positions: np.ndarray) -> np.ndarray:
    """Rotation of a moving sensor in the base frame at each sample (N, 3, 3)."""
    return link_placement(robot, robot.sensor_parent, positions)[0] @ (robot.sensor_rotation @ sensor.rotation)


def link_placement(robot: Robot, joint: int, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (N, 3, 3) and origin (N, 3) [m] in the base frame of the link that a joint moves, at positions (N, n)."""
    still = np.zeros_like(positions)
    states = link_states(robot, positions, still, still)[:, joint]
    return states[:, R:P].reshape(-1, 3, 3), states[:, P:W]


def of_degrees(robot: Robot, reach: np.ndarray) -> list[Candidate]:
    """Positions in degrees, of joints that reach too far for radians to be likely (n,) [rad]."""
    out, remedy = [], "write radians"
    for j, name in enumerate(robot.joint_names):
        if reach[j] > np.pi and not robot.prismatic[j]:
            says = f"the position of {name} (q{j + 1}) seems to be in degrees"
            change = scaled(robot.n, [j], np.pi / 180.0)
            out.append(Candidate("position_unit", f"q{j + 1}", says, remedy, Change(joints=change), (j,)))
    if reach.max() > np.pi and robot.n > 1 and not robot.prismatic.any():
        change = np.eye(robot.n) * np.pi / 180.0
        out.append(Candidate("position_unit", "", "all joint positions seem to be in degrees", remedy, Change(joints=change)))
    return out


def scaled(count: int, place: Sequence[int], factor: float) -> np.ndarray:
    """Matrix that multiplies some of a number of readings."""
    out = np.eye(count)
    out[list(place), list(place)] = factor
    return out


def _shifted(shift: np.ndarray) -> np.ndarray:
    """Moments about a point that is shifted by this (3,) in the sensor's axes: ``m - shift x f``."""
    out = np.eye(6)
    out[3:, :3] = -pin.skew(shift)
    return out


def candidates(experiment: Experiment, channel: str, samples: Samples) -> list[Candidate]:
    """Every mistake of signs, units and frames that readings of a channel could have, the usual ones first.

    Orders of columns, scales of single joints and a tilted base are found from the data: `bayesid.validation.mistakes.from_data`.
    """
    robot = experiment.robot
    names = robot.joint_names
    if channel == "torque":
        measured = experiment.torque_joints
        out, columns = of_signs(names, measured), tuple(f"tau{j + 1}" for j in measured)
    else:
        assert experiment.sensor is not None
        out, columns = of_wrench(experiment.sensor, tool=robot.sensor_bodies.sum() == 1), WRENCH_NAMES
        if robot.sensor_parent >= 0:
            out += in_base_axes(base_axes(robot, experiment.sensor, samples.positions))
        out += of_signs(names, ())
    out += [*of_weight(robot, columns), *of_gravity(robot.gravity)]
    return [*out, *of_degrees(robot, np.abs(samples.positions).max(axis=0))]
