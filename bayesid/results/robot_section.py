"""Which robot a result is of: what it takes, beside the URDF, to load it again from the files that a verb wrote."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.robot.robot import Robot, load_robot


def robot_section(experiment: Experiment) -> dict[str, Any]:
    """``robot`` in ``estimate.json`` and ``posterior.json``: as `bayesid.load_robot` takes it, but for the URDF."""
    robot, sensor = experiment.robot, experiment.sensor
    return {
        "joints": list(robot.joint_names),
        "locked": {name: float(position) for name, position in experiment.locked.items()},
        "gravity": robot.gravity.tolist(),
        "sensor_joint": None if sensor is None else sensor.joint,
    }


def robot_of(document: Mapping[str, Any], file: Path) -> tuple[Robot, dict[str, float]]:
    """The robot in the ``identified.urdf`` beside a document, and where its locked joints stand.

    Raises
    ------
    InputError
        The document is of an earlier version, or there is no such URDF.
    """
    stated, urdf = document.get("robot"), file.with_name("identified.urdf")
    if stated is None:
        raise InputError(f"{file}: does not say which joints its robot has, as results of earlier versions do not; run it again")
    if not urdf.is_file():
        raise InputError(f"{urdf}: no such file; it is written with {file.name} where links are known, and holds the robot")
    robot = load_robot(urdf, stated["joints"], stated["locked"], stated["gravity"], stated["sensor_joint"])
    return robot, dict(stated["locked"])
