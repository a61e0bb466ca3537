"""What files of results hold of the fitted model and its robot: effects with the values found, and what loads the robot again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects import Effect, Term
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import EffectParameters
from bayesid.regression.row_model import RowModel
from bayesid.robot.robot import Robot, load_robot


def fitted_model(
    experiment: Experiment, effects: Iterable[str], terms: Iterable[Term]
) -> tuple[tuple[str, ...], EffectParameters]:
    """Effects and their values, as `bayesid.recordings.schema.write_model` takes them.

    Effects that act on other channels stay as the experiment has them, values included; all others get the values of ``terms``,
    from which a fit that is given the file starts. What is fixed stays fixed. Each effect is listed once: not at a joint where
    its kind is listed for all of them, nor by a second name of the joint.
    """
    values: EffectParameters = {spec: dict(given) for spec, given in experiment.effect_values.items()}
    for term in terms:
        effect = term.effect
        keys = [effect.spec, effect.name]
        if effect.joint is not None:
            keys.insert(1, f"{effect.name}@{experiment.robot.joint_names[effect.joint]}")
        stated = next((experiment.effect_values[key] for key in keys if key in experiment.effect_values), {})
        found = {key: float(value) for key, value in zip(effect.parameters, term.values, strict=True)}
        values[effect.spec] = {**found, "fixed": True} if stated.get("fixed", False) else dict(found)
    return _once(experiment, effects), values


def _once(experiment: Experiment, specs: Iterable[str]) -> tuple[str, ...]:
    """Specifications in their order without those whose effects are all among those of others: first of whole kinds."""
    joints = experiment.robot.joint_names
    channels = (*WRENCH_NAMES, *(f"tau{i + 1}" for i in range(len(joints))))
    each: dict[str, set[str]] = {}
    for spec in dict.fromkeys(specs):
        try:
            each[spec] = {e.spec for e in experiment.library.parse([spec], joints, channels, experiment.gear_ratio)}
        except InputError:  # a formula that is handed on beside the library
            each[spec] = {spec}
    kept: list[str] = []
    known: set[str] = set()
    for spec in sorted(each, key=lambda s: -len(each[s])):  # stable: of names of the same effect the first stays
        if not each[spec] <= known:
            kept.append(spec)
            known |= each[spec]
    return tuple(spec for spec in each if spec in kept)


def by_effect(row_model: RowModel, values: np.ndarray, std: np.ndarray) -> list[tuple[Effect, np.ndarray, np.ndarray]]:
    """Every effect of the model with the values of its parameters and their standard deviations.

    ``values`` and ``std`` are those that were estimated (e,); the others are as they were held, their standard deviations nan.
    """
    whole = np.full((2, len(row_model.free)), np.nan)
    whole[0] = 0.0 if row_model.point is None else row_model.point.values
    whole[:, row_model.free] = values, std
    ends = np.cumsum([len(effect.parameters) for effect in row_model.effects])
    return (
        [(e, *part) for e, part in zip(row_model.effects, np.split(whole, ends[:-1], axis=1), strict=True)] if len(ends) else []
    )


def placed(effect: Effect, robot: Robot) -> str:
    """``sensor_gain at mx``, ``tether at joint3 (elbow_joint)``; the place is left out where there is only one."""
    if effect.at in ("sensor", "base", "robot"):
        return effect.name
    own = effect.where if effect.joint is None else robot.joint_names[effect.joint]
    return f"{effect.name} at {effect.where}" + ("" if own == effect.where else f" ({own})")


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

    An `InputError` where the document is of an earlier version, or there is no such URDF.
    """
    stated, urdf = document.get("robot"), file.with_name("identified.urdf")
    if stated is None:
        raise InputError(f"{file}: does not say which joints its robot has, as results of earlier versions do not; run it again")
    if not urdf.is_file():
        raise InputError(f"{urdf}: no such file; it is written with {file.name} where links are known, and holds the robot")
    robot = load_robot(urdf, stated["joints"], stated["locked"], stated["gravity"], stated["sensor_joint"])
    return robot, dict(stated["locked"])
