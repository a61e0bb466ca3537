"""An identified robot as exports need it, whatever made it, and ranges for domain randomisation: what a posterior leaves open."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bayesid.arguments import argument, call
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.effects.built_in import CLASSES
from bayesid.errors import InputError
from bayesid.results.export.simulators import ARMATURE
from bayesid.robot import inertia
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics, link_names


@dataclass(frozen=True)
class FoundEffect:
    """An effect of the model with the values that were found."""

    #: As in ``estimate.json``.
    name: str
    where: str
    parameters: dict[str, tuple[float, str]]  # value and unit of each

    @property
    def spec(self) -> str:
        """The effect's name and place, ``name@where``."""
        return f"{self.name}@{self.where}"

    @property
    def joint(self) -> int | None:
        """Index of its joint; None where it acts elsewhere."""
        found = re.fullmatch(r"joint(\d+)", self.where)
        return int(found[1]) - 1 if found else None


@dataclass(frozen=True, eq=False)
class IdentifiedRobot:
    """What is handed on."""

    #: Of the experiment; how it was estimated, and from which readings.
    name: str
    method: str
    channel: str
    readings: tuple[str, ...]  # names of these, such as ``tau1``
    robot: Robot  # kinematics
    locked: dict[str, float]  # position of joints that do not move, by name [rad or m]
    base: BaseParameters  # what the estimated base parameters are combinations of
    effects: tuple[FoundEffect, ...]  # of the model
    effect_names: tuple[str, ...]  # of those parameters of the effects that were estimated (e,)
    #: Base parameters, then these (p,); theirs (p, p), None where there is none; which the data say nothing of (p,).
    solution: np.ndarray
    covariance: np.ndarray | None
    undetermined: np.ndarray
    #: Of ``identified.urdf``: ten parameters a body (10 b,), which can exist, and friction. Links are None where none are
    #: known, dynamics where they are those of ``solution``.
    links: np.ndarray | None
    dynamics: JointDynamics | None
    #: Of a posterior: links that can exist (d, 10 b) and the effects' parameters (d, e); None where links were not drawn.
    link_draws: np.ndarray | None = None
    effect_draws: np.ndarray | None = None

    @property
    def unread(self) -> tuple[str, ...]:
        """Names of joints whose torque was not read, so that nothing is known of what acts inside them."""
        return tuple(name for k, name in enumerate(self.robot.joint_names, 1) if f"tau{k}" not in self.readings)

    @cached_property
    def effect_columns(self) -> dict[str, int]:
        """Where each estimated parameter of an effect stands in ``solution``, by its name."""
        return {name: self.base.rank + k for k, name in enumerate(self.effect_names)}

    def joint_dynamics(self, drawn: np.ndarray | None = None) -> JointDynamics:
        """What a URDF holds inside the joints and what not, by the effects' values (e,), default those of ``links``."""
        if drawn is None and self.dynamics is not None:
            return self.dynamics
        drawn = self.solution[self.base.rank :] if drawn is None else drawn
        found = dict(zip(self.effect_names, drawn.tolist(), strict=True))
        attributes = {kind.name: kind.urdf_dynamics for kind in CLASSES}
        friction: dict[str, dict[str, float]] = {}
        negative, beside = [], {}
        for effect in self.effects:
            attribute, joint = attributes.get(effect.name), effect.joint
            for key, (stated, unit) in effect.parameters.items():
                name = f"{effect.spec}.{key}"
                value = float(found.get(name, stated))
                if attribute is None or joint is None:
                    beside[name] = (value, unit)
                elif value >= 0.0:
                    friction.setdefault(self.robot.joint_names[joint], {})[attribute] = value
                else:
                    negative.append(f"{self.robot.joint_names[joint]} {attribute}")
        return JointDynamics(friction, tuple(negative), beside)


#: Effects that simulators have inside a joint, by what they call them: effect and parameter.
JOINT_CONSTANTS = {
    "damping": ("viscous_friction", "coefficient"), "frictionloss": ("coulomb_friction", "level"),
    "armature": (ARMATURE, "inertia"),
}  # fmt: skip
_TAILS = (0.05, 0.95)


def randomisation(found: IdentifiedRobot) -> dict[str, Any]:
    """Mean, standard deviation and 5 to 95 % range of every link's and joint's constants.

    Links are named as in the URDF. Of each: mass [kg], centre of mass [m] and inertia about it [kg m^2] in its frame; of a
    joint ``damping``, ``frictionloss`` and ``armature``, where they were estimated. Numbers that are drawn from their ranges
    one by one are no draw of the posterior, which holds how they go together: take whole draws where that matters.
    """
    links, effects = draws_of(found)
    robot = found.robot
    bodies = {}
    for name, draws in zip(link_names(robot), np.moveaxis(links.reshape(len(links), -1, 10), 1, 0), strict=True):
        parts = [inertia.to_mass_com_inertia(draw) for draw in draws]
        mass, com, about = (np.array(part) for part in zip(*parts, strict=True))
        bodies[name] = {
            "mass": _summary(mass, "kg"), "centre_of_mass": [_summary(com[:, k], "m") for k in range(3)],
            "inertia": {key: _summary(about[:, i, j], "kg m^2") for key, (i, j) in inertia.ENTRIES.items()},
        }  # fmt: skip
    joints: dict[str, dict[str, Any]] = {name: {} for name in robot.joint_names}
    for effect in found.effects:
        for constant, (kind, key) in JOINT_CONSTANTS.items():
            column = found.effect_columns.get(f"{effect.spec}.{key}")
            if effect.name == kind and effect.joint is not None and column is not None:
                drawn = effects[:, column - found.base.rank]
                joints[robot.joint_names[effect.joint]][constant] = _summary(drawn, effect.parameters[key][1])
    return {"draws": len(links), "links": bodies, "joints": joints}


def draws_of(found: IdentifiedRobot) -> tuple[np.ndarray, np.ndarray]:
    """Draws of links (d, 10 b) and of the effects' parameters (d, e); an `InputError` where there are none."""
    if found.link_draws is None or found.effect_draws is None:
        raise InputError(
            f"{found.name}: draws of links are asked for, and a result of {found.method} has none; export one of "
            f"`{call('sample')}` with a nominal prior (inertia_rel_std in experiment.toml, or {argument('prior_std', 0.3)})"
        )
    return found.link_draws, found.effect_draws


def _summary(values: np.ndarray, unit: str) -> dict[str, Any]:
    low, high = np.quantile(values, _TAILS)
    return {"mean": float(values.mean()), "std": float(values.std(ddof=1)), "p05": float(low), "p95": float(high), "unit": unit}
