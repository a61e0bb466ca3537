"""The robot of an experiment folder: its URDF, read under the names and limits that experiment.toml states."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.schema import RobotSection, suggest
from bayesid.robot.inertia import is_physically_consistent
from bayesid.robot.robot import Robot, load_robot


def read_robot(folder: Path, section: RobotSection, sensor_joint: str | None) -> tuple[Robot, list[str]]:
    """Read the robot and check it.

    Parameters
    ----------
    folder
        The experiment folder.
    section
        Its ``[robot]``.
    sensor_joint
        The joint that the sensor sits in, if any.

    Returns
    -------
    robot, warnings

    Raises
    ------
    InputError
        The URDF is absent or damaged, or lacks a joint that experiment.toml names.
    """
    urdf = folder / section.urdf
    if not urdf.is_file():
        raise InputError(f'experiment.toml: [robot] urdf: "{section.urdf}" is no file in {folder}; name the URDF there')
    remarks: list[str] = []
    try:
        with _collected_stderr(remarks):
            robot = load_robot(urdf, section.joints, section.locked, section.gravity, sensor_joint)
    except InputError as error:
        # The robot knows the URDF only; the user's mistake may be in the keys that name its joints.
        for key, names in (("joints", section.joints), ("locked", list(section.locked))):
            if any(str(error).startswith(f"joint '{name}'") for name in names):
                raise InputError(f"experiment.toml: [robot] {key}: {error}") from None
        if remarks:
            reason = remarks[0].removeprefix("Error: ").partition(". ")[0]
            raise InputError(f"{section.urdf}: not a valid URDF: {reason}; correct it there") from None
        raise
    for remark in remarks:
        # The parser goes on without a mass or inertia that it cannot read: the robot would be another one.
        if remark.startswith("Error"):
            raise InputError(f"{section.urdf}: {remark.removeprefix('Error: ')}; correct it there")
    for name in section.gear_ratio:
        if name not in section.joints:
            hint = suggest(name, section.joints)
            raise InputError(f'experiment.toml: [robot] gear_ratio: "{name}" is not one of joints; {hint}')
    return robot, [*(f"{section.urdf}: {remark}" for remark in remarks), *_check(robot, section)]


def _check(robot: Robot, section: RobotSection) -> list[str]:
    for name, axis in zip(robot.joint_names, robot.axis, strict=True):
        if not np.isclose(np.linalg.norm(axis), 1.0, atol=1e-3):
            raise InputError(f"{section.urdf}: joint {name}: axis {axis.tolist()} has no direction; write a unit vector")
    warnings = []
    for name, body in zip(robot.body_names, robot.nominal, strict=True):
        if body[0] < 0.0:
            raise InputError(f"{section.urdf}: mass of what {name} carries: {body[0]:g} kg; masses are 0 or more")
        if section.inertia_rel_std is not None and not is_physically_consistent(body):
            warnings.append(
                f"{section.urdf}: no body can have the mass, centre and inertia of what {name} carries; "
                "correct them, or leave [robot] inertia_rel_std out if they are not to be trusted"
            )
    return warnings


@contextlib.contextmanager
def _collected_stderr(remarks: list[str]) -> Iterator[None]:
    """Collect what the URDF parser, a C++ library, writes straight to file descriptor 2: it would spoil our one line."""
    with tempfile.TemporaryFile() as sink:
        try:
            saved = os.dup(2)
        except OSError:  # no standard error at all
            yield
            return
        try:
            os.dup2(sink.fileno(), 2)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            sink.seek(0)
            lines = [line.strip() for line in sink.read().decode("utf-8", "replace").splitlines()]
            # Each message is followed by the place in the parser's own source, which tells a user nothing.
            remarks += [" ".join(line.split()) for line in lines if line and not line.startswith("at line")]
