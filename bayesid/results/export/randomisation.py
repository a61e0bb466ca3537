"""Ranges for domain randomisation: what a posterior leaves open of links and joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesid.arguments import argument, call
from bayesid.errors import InputError
from bayesid.results.export.identified import IdentifiedRobot
from bayesid.results.export.simulators import ARMATURE
from bayesid.robot import inertia
from bayesid.robot.urdf import link_names

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
            "inertia": {key: _summary(about[:, i, j], "kg m^2") for key, (i, j) in _ENTRIES.items()},
        }  # fmt: skip
    joints: dict[str, dict[str, Any]] = {name: {} for name in robot.joint_names}
    for k, name in enumerate(found.effect_names):
        for effect in found.effects:
            for key, unit in effect.units.items():
                for constant, (kind, parameter) in JOINT_CONSTANTS.items():
                    own = effect.joint is not None and (effect.name, key) == (kind, parameter)
                    if own and name == f"{effect.spec}.{key}":
                        joints[robot.joint_names[effect.joint or 0]][constant] = _summary(effects[:, k], unit)
    return {"draws": len(links), "links": bodies, "joints": joints}


_ENTRIES = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


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
