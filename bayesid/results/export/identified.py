"""An identified robot as exports need it: whatever made it, and whether it was just made or read from its files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.effects.built_in import CLASSES
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics


@dataclass(frozen=True)
class FoundEffect:
    """An effect of the model with the values that were found."""

    #: As in ``estimate.json``.
    name: str
    where: str
    #: By parameter.
    values: dict[str, float]
    units: dict[str, str]

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
            for key, stated in effect.values.items():
                name = f"{effect.spec}.{key}"
                value = float(found.get(name, stated))
                if attribute is None or joint is None:
                    beside[name] = (value, effect.units[key])
                elif value >= 0.0:
                    friction.setdefault(self.robot.joint_names[joint], {})[attribute] = value
                else:
                    negative.append(f"{self.robot.joint_names[joint]} {attribute}")
        return JointDynamics(friction, tuple(negative), beside)
