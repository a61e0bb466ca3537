"""What parameters do not explain: the non-parametric part of the uncertainty [Liu1996]_, from motions that were not fitted.

The parametric part is constant and bounded by the region of the parameters. The rest is what a held-out motion's torques still
differ by: 99 % of its samples are below the bound, joint by joint, and by speed, where friction shows. It includes the noise of
the torques below 10 Hz, and, where the torques were not fitted, everything inside the joints.

What a sensor under the base or at the wrist cannot know at all is inside the joints: rotors and friction. How large these
usually are follows from the effort limits, see `bayesid.effects.sizes`; a guess, to be replaced by a data sheet's numbers.
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
from bayesid.recordings.experiment import Motion
from bayesid.regression.problem import Problem
from bayesid.robot.limits import motion_limits
from bayesid.validation.prediction import in_band

#: Share of the samples that a bound holds.
SHARE = 0.99
#: Classes of speed, as many samples in each.
_CLASSES = 5


@dataclass(frozen=True, eq=False)
class Remainder:
    """What is left of the joint torques of motions, by joint.

    Attributes
    ----------
    motions
        Names of the motions.
    held_out
        Whether none of them was fitted.
    bound
        99 % of the samples are below (n,) [N m or N].
    speeds
        Upper edges of classes of speed (n, k) [rad/s or m/s].
    by_speed
        The same bound in each class (n, k).
    share
        Root mean square of what is left over that of the torques (n,).
    """

    motions: tuple[str, ...]
    held_out: bool
    bound: np.ndarray
    speeds: np.ndarray
    by_speed: np.ndarray
    share: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``."""
        return {
            "motions": list(self.motions), "held_out": self.held_out, "share_of_samples": SHARE,
            "torque_residual": self.bound.tolist(), "speed_classes": self.speeds.tolist(),
            "torque_residual_by_speed": self.by_speed.tolist(), "relative_rms": self.share.tolist(),
        }  # fmt: skip


def remainder(problem: Problem, model: ReadingModel) -> Remainder | None:
    """What the model leaves of recorded joint torques; None where none were recorded.

    Parameters
    ----------
    problem
        The experiment; its motions of role ``validation`` where there are any with torques, else those that were fitted.
    model
        Of the joint torques.
    """
    readable = [m for m in problem.experiment.motions if m.name in problem.segments and m.kind != "poses"]
    every = problem.experiment.robot.n  # a bound is of all joints
    with_torques = [m for m in readable if len(m.table.torque_joints) == every]
    judges = [m for m in with_torques if m.role == "validation" and m.name not in problem.fitted]
    chosen = judges or [m for m in with_torques if m.name in problem.fitted]
    left, speed, size = [], [], []
    for motion in chosen:
        for e, v, y in _left(problem, model, motion):
            left.append(e)
            speed.append(v)
            size.append(y)
    if not left:
        return None
    e, v, y = np.concatenate(left), np.abs(np.concatenate(speed)), np.concatenate(size)
    edges = np.quantile(v, np.arange(1, _CLASSES + 1) / _CLASSES, axis=0)
    by_speed = np.empty_like(edges)
    for j in range(e.shape[1]):
        place = np.minimum(np.searchsorted(edges[:, j], v[:, j]), _CLASSES - 1)
        by_speed[:, j] = [np.quantile(np.abs(e[place == k, j]), SHARE) if (place == k).any() else 0.0 for k in range(_CLASSES)]
    rms = [np.sqrt(np.mean(x**2, axis=0)) for x in (e, y)]
    return Remainder(
        tuple(m.name for m in chosen), bool(judges), np.quantile(np.abs(e), SHARE, axis=0), edges.T, by_speed.T,
        rms[0] / np.maximum(rms[1], 1e-300),
    )  # fmt: skip


def _left(problem: Problem, model: ReadingModel, motion: Motion):
    """What is left of a motion's torques, joint velocities and torques below 10 Hz, segment by segment, (N, n) each."""
    assert motion.table.torques is not None
    for segment in problem.segments[motion.name]:
        first, last = (0, 0) if segment.poses else segment.inner(problem.row_model.margin)
        if last - first < 2:
            continue
        state = problem.row_model.state(segment, first, last)
        at = np.searchsorted(motion.table.times, state.times)
        constant, matrix = model.columns(state.positions, state.velocities, state.accelerations)
        measured = in_band(state.times, motion.table.torques[at], poses=False)
        predicted = in_band(state.times, constant + matrix @ model.region.values, poses=False)
        yield measured - predicted, state.velocities, measured


@dataclass(frozen=True, eq=False)
class InsideJoints:
    """What is inside the joints, by joint (n,), as far as it was identified and as large as it usually is otherwise.

    Attributes
    ----------
    joints
        Their names.
    identified
        Specs of the effects inside the joints that were identified.
    rotor, coulomb, viscous
        Usual size where it was not identified, nan where it was [kg m^2, N m, N m s/rad; kg, N, N s/m].
    rotor_share
        The usual rotor inertia over the smallest diagonal element of the links' mass matrix.
    friction_share
        Usual friction at full speed over the largest torque of gravity; nan where there is none.
    """

    joints: tuple[str, ...]
    identified: tuple[str, ...]
    rotor: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    rotor_share: np.ndarray
    friction_share: np.ndarray

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
