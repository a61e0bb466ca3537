"""What is inside the joints, rotors and friction, which a sensor under the base or at the wrist cannot know at all.

How large these usually are follows from the effort limits, see `bayesid.effects.sizes`; a guess, to be replaced by a data
sheet's numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.design.bounds.model import ReadingModel
from bayesid.design.bounds.workspace import Workspace
from bayesid.effects.drives import RotorInertia
from bayesid.effects.friction import CoulombFriction, ViscousFriction
from bayesid.robot.robot import motion_limits


@dataclass(frozen=True, eq=False)
class InsideJoints:
    """What is inside the joints, by joint (n,), as far as it was identified and as large as it usually is otherwise."""

    joints: tuple[str, ...]  # their names
    identified: tuple[str, ...]  # specs of the effects inside the joints that were identified
    #: Usual size where it was not identified, nan where it was [kg m^2, N m, N m s/rad; kg, N, N s/m].
    rotor: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    rotor_share: np.ndarray  # the usual rotor inertia over the smallest diagonal element of the links' mass matrix
    friction_share: np.ndarray  # usual friction at full speed over the largest torque of gravity; nan where there is none

    @property
    def complete(self) -> bool:
        """Whether all of it was identified."""
        return not np.isfinite(np.concatenate([self.rotor, self.coulomb, self.viscous])).any()

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``; null for what was identified."""
        numbers = {
            name: [float(x) if np.isfinite(x) else None for x in getattr(self, name)]
            for name in ("rotor", "coulomb", "viscous", "rotor_share", "friction_share")
        }
        return {"joints": list(self.joints), "identified": list(self.identified), "usual_size_where_not_identified": numbers}


def inside_joints(model: ReadingModel, workspace: Workspace) -> InsideJoints:
    """What was identified inside the joints, and how large the rest usually is."""
    robot = model.robot
    held = {drive.effect.spec for drive in model.drives}

    def usual(kinds: Sequence[type[RotorInertia] | type[CoulombFriction] | type[ViscousFriction]]) -> list[np.ndarray]:
        out = []
        for kind in kinds:
            effects = [kind(f"joint{j + 1}", j) for j in range(robot.n)]
            out.append(np.array([np.nan if e.spec in held else float(e.typical(robot)[0]) for e in effects]))
        return out

    rotor, coulomb, viscous = usual((RotorInertia, CoulombFriction, ViscousFriction))
    friction = np.nan_to_num(coulomb) + np.nan_to_num(viscous) * motion_limits(robot)[2]
    known = np.isnan(coulomb) & np.isnan(viscous)
    floor = 1e-9 * max(float(workspace.gravity.max(initial=0.0)), 1e-300)
    carried = np.where(workspace.gravity > floor, workspace.gravity, np.nan)
    return InsideJoints(
        robot.joint_names, tuple(sorted(held)), rotor, coulomb, viscous, rotor / np.maximum(workspace.inertia[:, 0], 1e-300),
        np.where(known, np.nan, friction / carried),
    )  # fmt: skip
