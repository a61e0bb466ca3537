"""Candidate sensors as a file lists them, ``sensors.toml``: where each is, its noise, range and resolution."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.errors import InputError
from bayesid.recordings.toml_file import Name, NonNegative, Positive, Section, Vector3, read_toml
from bayesid.robot.robot import Robot

KINDS = {
    "base": "force/torque sensor under the base",
    "wrist": "force/torque sensor in a joint",
    "plate": "load cells under a plate",
    "torque": "joint torque sensors",
}
_AXES = {"x": 0, "y": 1, "z": 2}


class _Listed(Section):
    """One ``[[sensor]]``."""

    name: Name
    kind: Literal["base", "wrist", "plate", "torque"]
    noise: Annotated[list[Positive], Field(min_length=1)]
    range: list[Positive] = []
    resolution: list[NonNegative] = []
    rate: Positive | None = None
    joint: str | None = None
    translation: Vector3 | None = None
    rpy: Vector3 | None = None
    cells: list[Vector3] | None = None
    axes: Literal["z", "xyz"] | None = None
    joints: list[str] | None = None


class _File(Section):
    """The whole file."""

    format: Literal[1] = 1
    sensor: Annotated[list[_Listed], Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class CandidateSensor:
    """A sensor that might be bought.

    Attributes
    ----------
    name, kind
        What it is called, and a key of `KINDS`.
    readings, units
        Names and units of what it measures (m,).
    std
        Standard deviation of one sample of each, rounding to its resolution included (m,).
    limit
        Largest magnitude that each can read (m,); infinite where none is stated.
    rate
        Samples a second; None: those of the recording.
    joint
        Joint that a wrist sensor sits in.
    rotation, translation
        Pose of its frame in the base frame, or in that joint's child link (3, 3), (3,) [m].
    load_map
        From readings to the wrench in that frame (6, m): of load cells; None: the readings are the channels.
    drives
        Indices of the joints that torque sensors are in.
    """

    name: str
    kind: str
    readings: tuple[str, ...]
    units: tuple[str, ...]
    std: np.ndarray
    limit: np.ndarray
    rate: float | None
    joint: str | None
    rotation: np.ndarray
    translation: np.ndarray
    load_map: np.ndarray | None = None
    drives: tuple[int, ...] = ()

    @property
    def reading_map(self) -> np.ndarray:
        """From the channels to the readings (m, c); load cells of equal stiffness share a wrench as its pseudo-inverse does."""
        if self.load_map is not None:
            return np.linalg.pinv(self.load_map)
        return np.eye(len(self.readings))


def read_sensors(path: str | Path, robot: Robot) -> tuple[CandidateSensor, ...]:
    """Read a list of candidate sensors.

    Parameters
    ----------
    path
        The file.
    robot
        Its joints.

    Raises
    ------
    InputError
        The file is absent or holds a wrong key or value.
    """
    path = Path(path)
    keys = {("sensor",): _Listed.model_fields}
    file = read_toml(path, _File, keys, "a sensors.toml, which holds [[sensor]] tables")
    names = [s.name for s in file.sensor]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f'{path.name}: two sensors are named "{name}"; name them apart')
    return tuple(_candidate(s, path.name, robot) for s in file.sensor)


def _candidate(given: _Listed, source: str, robot: Robot) -> CandidateSensor:
    place = f'{source}: sensor "{given.name}"'
    allowed = {
        "base": ("translation", "rpy"), "wrist": ("joint", "translation", "rpy"), "plate": ("cells", "axes"),
        "torque": ("joints",),
    }[given.kind]  # fmt: skip
    for key in ("joint", "translation", "rpy", "cells", "axes", "joints"):
        if getattr(given, key) is not None and key not in allowed:
            raise InputError(f"{place}: {key} is not for kind {given.kind}; remove it, or write another kind")
    rotation, translation = np.eye(3), np.zeros(3)
    load_map, drives, units = None, (), ("N",) * 3 + ("N m",) * 3
    readings: tuple[str, ...] = WRENCH_NAMES
    if given.kind in ("base", "wrist"):
        if given.kind == "wrist" and given.joint is None:
            raise InputError(f"{place}: joint is missing; name the URDF joint that it sits in")
        rotation = pin.rpy.rpyToMatrix(*map(float, given.rpy or (0.0, 0.0, 0.0)))
        translation = np.array(given.translation or (0.0, 0.0, 0.0))
    elif given.kind == "plate":
        readings, translation, load_map = _cells(given, place)
        units = ("N",) * len(readings)
    else:
        names = given.joints or list(robot.joint_names)
        for name in names:
            if name not in robot.joint_names:
                raise InputError(f"{place}: joint '{name}' is none of {', '.join(robot.joint_names)}")
        drives = tuple(robot.joint_names.index(name) for name in names)
        readings = tuple(f"tau{k + 1}" for k in drives)
        units = tuple("N" if robot.prismatic[k] else "N m" for k in drives)
    kinds = 2 if given.kind in ("base", "wrist") else 1
    noise = _each(given.noise, "noise", len(readings), kinds, place)
    steps = _each(given.resolution, "resolution", len(readings), kinds, place, 0.0)
    return CandidateSensor(
        given.name, given.kind, readings, units, np.sqrt(noise**2 + steps**2 / 12.0),
        _each(given.range, "range", len(readings), kinds, place, np.inf), given.rate, given.joint, rotation, translation,
        load_map, drives,
    )  # fmt: skip


def _cells(given: _Listed, place: str) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names of the cells' readings, the middle of the cells, and the map from readings to the wrench about it (6, m)."""
    cells = np.array(given.cells or [])
    if len(cells) < 3:
        raise InputError(f"{place}: cells has {len(cells)} places; give at least three, [[x, y, z], ...] in the base frame [m]")
    middle = cells.mean(axis=0)
    readings, columns = [], []
    for k, cell in enumerate(cells):
        for axis in given.axes or "z":
            force = np.eye(3)[_AXES[axis]]
            readings.append(f"cell{k + 1}{axis if given.axes == 'xyz' else ''}")
            columns.append(np.concatenate([force, np.cross(cell - middle, force)]))
    load_map = np.array(columns).T
    if np.linalg.matrix_rank(load_map, 1e-9) < (6 if given.axes == "xyz" else 3):
        raise InputError(f"{place}: the cells stand in one line, so that moments about it are not measured; move one aside")
    return tuple(readings), middle, load_map


def _each(values: list[float], key: str, count: int, kinds: int, place: str, otherwise: float | None = None) -> np.ndarray:
    """One number a reading (m,), from one for all, or one for forces and one for moments."""
    if not values and otherwise is not None:
        return np.full(count, otherwise)
    if len(values) == count:
        return np.array(values, float)
    if len(values) == kinds:
        return np.repeat(np.array(values, float), count // kinds)
    some = "one number for forces and one for moments" if kinds == 2 else "one number for all"
    raise InputError(f"{place}: {key} has {len(values)} numbers; give {some}, or {count}, one a reading")
