"""Bounds on mass matrix, Coriolis terms and gravity over the workspace, and what is inside the joints beside them.

Joint configurations are a Sobol sequence within the joints' limits. At each, of the controller's model (hat) and every draw of
links that can exist:

    mass       eigenvalues lambda of M_hat x = lambda M x; alpha = max |lambda - 1| = ||1 - M^-1 M_hat|| in the norm of M,
               the uncertainty of computed torque, which has to be below 1 [Spong1992]_
    Coriolis   h(q, v) = C(q, v) v = B(q) s(v), with s(v) the products v_j v_k, those of different joints times sqrt 2: then
               ||s(v)|| = ||v||^2, and ||h|| <= ||B|| ||v||^2 for every v
    gravity    |g_hat - g|, joint by joint

Each is largest over the configurations first, then its 95 % quantile over the draws is taken: the bound holds at all those
configurations at once. Between them the largest value can be slightly larger; more of them show by how much.

A sensor under the base or at the wrist cannot know at all what is inside the joints, rotors and friction. How large these usually
are follows from the effort limits, see `bayesid.effects.sizes`; a guess, to be replaced by a data sheet's numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from bayesid.design.bounds.model import ReadingModel
from bayesid.design.bounds.region import quantile
from bayesid.effects.drives import RotorInertia
from bayesid.effects.friction import CoulombFriction, ViscousFriction
from bayesid.robot.robot import Robot, motion_limits
from bayesid.rounding import LEVEL

#: Draws and configurations unless others are asked for.
DRAWS, CONFIGURATIONS = 300, 512
_TOGETHER = 40_000  # pairs of a draw and a configuration that are worked on at once


@dataclass(frozen=True, eq=False)
class Workspace:
    """What holds over the workspace with probability `LEVEL`, unless it is said to be the controller's model (``nominal``)."""

    #: How many of each.
    configurations: int
    draws: int
    #: Range of the joints (n,) [rad or m].
    lower: np.ndarray
    upper: np.ndarray
    ratio: tuple[float, float]  # smallest and largest eigenvalue of M_hat relative to M
    alpha: float  # largest distance of those from 1
    eigenvalues: tuple[float, float]  # smallest and largest eigenvalue of M itself [kg m^2, and kg where joints slide]
    smallest_drawn: float  # smallest eigenvalue of any draw's M at any configuration: above 0, every draw is positive definite
    nominal_eigenvalue: float  # smallest eigenvalue of M_hat with the centre of the parameters
    of_urdf: bool  # whether that is not positive, so that M_hat and all bounds are those of the links in ``identified.urdf``
    inertia: np.ndarray  # smallest and largest diagonal element of M_hat by joint (n, 2)
    inertia_error: np.ndarray  # largest error of each diagonal element relative to it (n,)
    #: ``||B_hat||`` and the bound of ``||B_hat - B||``.
    coriolis: float
    coriolis_error: float
    #: Largest ``|g_hat|`` by joint, and the bounds of the error that hold for all joints at once (n,) [N m or N].
    gravity: np.ndarray
    gravity_error: np.ndarray
    #: Bounds of ``||M^-1 (g_hat - g)||`` and of ``||M^-1 (B_hat - B)||``: what computed torque leaves, besides ``alpha ||a||``,
    #: of which the second goes with ``||v||^2``.
    acceleration_from_gravity: float
    acceleration_from_coriolis: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``."""
        return {
            name: list(value) if isinstance(value, tuple) else value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }


def sobol_configurations(robot: Robot, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint positions spread evenly within the limits (count, n), and the range they fill (n,), (n,)."""
    lower, upper, _ = motion_limits(robot)
    points = qmc.Sobol(robot.n, scramble=False).random_base2(int(np.ceil(np.log2(max(count, 2)))))
    shift = np.random.default_rng([seed, 13]).uniform(size=robot.n)
    return lower + (points[:count] + shift) % 1.0 * (upper - lower), lower, upper


@dataclass(frozen=True, eq=False)
class Terms:
    """Mass matrix, Coriolis and gravity, linear in the parameters, at some configurations."""

    mass: np.ndarray  # (m, n, n, k)
    stated: np.ndarray  # what is beside that in the mass matrix, whatever the parameters (n, n)
    coriolis: np.ndarray  # (m, n, n (n + 1) / 2, k)
    gravity: np.ndarray  # (m, n, k)

    @classmethod
    def of(cls, model: ReadingModel, positions: np.ndarray) -> Terms:
        """Those of the base parameters, and of what goes with acceleration inside the joints, at positions (m, n)."""
        n, rank, still = positions.shape[1], model.base.rank, np.zeros_like(positions)
        size = len(model.region.values)

        def along(vector: np.ndarray, *, moving: bool) -> np.ndarray:
            rates = np.broadcast_to(vector, positions.shape)
            return model.rigid(positions, *((rates, still) if moving else (still, rates)), gravity=False)

        mass = np.zeros((len(positions), n, n, size))
        for j, unit in enumerate(np.eye(n)):
            mass[:, :, j, :rank] = along(unit, moving=False)
        stated, mass[..., rank:] = model.drive_inertia()
        gravity = np.zeros((len(positions), n, size))
        gravity[..., :rank] = model.rigid(positions, still, still)
        single = [along(unit, moving=True) for unit in np.eye(n)]
        parts = []
        for j in range(n):
            for k in range(j, n):
                if j == k:
                    parts.append(single[j])
                else:
                    # Of the quadratic form: h(e_j + e_k) - h(e_j) - h(e_k) = 2 Gamma_jk, and its column holds sqrt 2 Gamma_jk.
                    both = along(np.eye(n)[j] + np.eye(n)[k], moving=True)
                    parts.append((both - single[j] - single[k]) / np.sqrt(2.0))
        coriolis = np.zeros((len(positions), n, len(parts), size))
        coriolis[..., :rank] = np.stack(parts, axis=2)
        return cls(mass, stated, coriolis, gravity)

    def mass_matrices(self, parameters: np.ndarray) -> np.ndarray:
        """Mass matrices (m, n, n) with parameters (k,)."""
        return self.mass @ parameters + self.stated


def workspace_bounds(
    model: ReadingModel,
    draws: int = DRAWS,
    configurations: int = CONFIGURATIONS,
    seed: int = 0,
    possible: np.ndarray | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Workspace:
    """Bounds of the joint torques' model over the workspace.

    ``draws`` and ``configurations`` are how many of each at most, ``seed`` is that of the Sobol sequence's shift. ``possible``
    are parameters of links that can exist (k,), taken for the controller's where the mass matrix of the centre is not positive
    definite everywhere.
    """
    positions, lower, upper = sobol_configurations(model.robot, configurations, seed)
    terms = Terms.of(model, positions)
    drawn, hat = model.draws[_evenly(model, draws)], model.region.values
    nominal = float(np.linalg.eigvalsh(_symmetric(terms.mass_matrices(hat))).min())
    of_urdf = nominal <= 0.0 and possible is not None
    hat = possible if of_urdf and possible is not None else hat
    mass, coriolis, gravity = terms.mass_matrices(hat), terms.coriolis @ hat, terms.gravity @ hat
    found: list[list[np.ndarray]] = []
    step = max(_TOGETHER // len(positions), 1)
    for first in range(0, len(drawn), step):
        progress(f"workspace: {100 * first // len(drawn)} %")
        found += _of_draws(terms, drawn[first : first + step], mass, hat)
    low, high, smallest, largest, diagonal, bent, weight, pushed, thrown = map(np.array, zip(*found, strict=True))
    diagonals = np.diagonal(mass, axis1=1, axis2=2)
    # A factor common to all joints, in units of each joint's own spread, makes their bounds hold at once.
    spread = np.maximum(np.sqrt(np.mean(weight**2, axis=0)), 1e-12 * max(float(weight.max()), 1e-300))
    return Workspace(
        configurations=len(positions), draws=len(drawn), lower=lower, upper=upper,
        ratio=(-quantile(-low, 0.5 + LEVEL / 2), quantile(high, 0.5 + LEVEL / 2)),
        alpha=quantile(np.maximum(np.abs(low - 1.0), np.abs(high - 1.0)), LEVEL),
        eigenvalues=(-quantile(-smallest, 0.5 + LEVEL / 2), quantile(largest, 0.5 + LEVEL / 2)),
        smallest_drawn=float(smallest.min()),
        nominal_eigenvalue=nominal, of_urdf=of_urdf,
        inertia=np.stack([diagonals.min(axis=0), diagonals.max(axis=0)], axis=1),
        inertia_error=np.array([quantile(column, LEVEL) for column in diagonal.T]),
        coriolis=float(np.linalg.norm(coriolis, 2, axis=(1, 2)).max()),
        coriolis_error=quantile(bent, LEVEL),
        gravity=np.abs(gravity).max(axis=0),
        gravity_error=quantile((weight / spread).max(axis=1), LEVEL) * spread,
        acceleration_from_gravity=quantile(pushed, LEVEL),
        acceleration_from_coriolis=quantile(thrown, LEVEL),
    )  # fmt: skip


def mass_eigenvalues(model: ReadingModel, scale: np.ndarray, draws: int, configurations: int, seed: int) -> tuple[float, float]:
    """Bounds of the eigenvalues of ``S^-1/2 M S^-1/2`` over the workspace, S diagonal; the rest as in `workspace_bounds`."""
    terms = Terms.of(model, sobol_configurations(model.robot, configurations, seed)[0])
    root = np.sqrt(np.outer(scale, scale))
    low, high = [], []
    for drawn in model.draws[_evenly(model, draws)]:
        values = np.linalg.eigvalsh(terms.mass_matrices(drawn) / root)
        low.append(values[:, 0].min())
        high.append(values[:, -1].max())
    return -quantile(-np.array(low), 0.5 + LEVEL / 2), quantile(np.array(high), 0.5 + LEVEL / 2)


def _evenly(model: ReadingModel, draws: int) -> np.ndarray:
    """Indices of so many draws at most, evenly picked."""
    return np.linspace(0, len(model.draws) - 1, min(draws, len(model.draws))).astype(int)


def _of_draws(terms: Terms, drawn: np.ndarray, mass: np.ndarray, hat: np.ndarray) -> list[list[np.ndarray]]:
    """Extremes of each draw over all configurations."""
    m = np.einsum("mijk,dk->dmij", terms.mass, drawn, optimize=True) + terms.stated
    m = _symmetric(m)
    values = np.linalg.eigvalsh(m)
    inverse = np.linalg.inv(np.linalg.cholesky(m))  # L^-1 with L L' = M
    ratio = np.linalg.eigvalsh(inverse @ mass @ np.swapaxes(inverse, 2, 3))
    away = hat - drawn
    bent = np.einsum("mijk,dk->dmij", terms.coriolis, away, optimize=True)
    weight = np.einsum("mik,dk->dmi", terms.gravity, away, optimize=True)
    full = np.swapaxes(inverse, 2, 3) @ inverse
    diagonal = np.abs(np.diagonal(m, axis1=2, axis2=3) / np.diagonal(mass, axis1=1, axis2=2) - 1.0).max(axis=1)
    columns = (
        ratio[..., 0].min(axis=1), ratio[..., -1].max(axis=1), values[..., 0].min(axis=1), values[..., -1].max(axis=1),
        diagonal, _largest_gain(bent), np.abs(weight).max(axis=1),
        np.linalg.norm(np.squeeze(full @ weight[..., None], -1), axis=2).max(axis=1), _largest_gain(full @ bent),
    )  # fmt: skip
    return [list(row) for row in zip(*columns, strict=True)]


def _symmetric(matrices: np.ndarray) -> np.ndarray:
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def _largest_gain(matrices: np.ndarray) -> np.ndarray:
    """Largest singular value of matrices (d, m, n, p) over all m (d,), by way of the small squares."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(matrices @ np.swapaxes(matrices, 2, 3))[..., -1].max(axis=1), 0.0))


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
        return not self.lacking

    @property
    def lacking(self) -> tuple[str, ...]:
        """Effects inside the joints that were not identified in every joint."""
        usual = {"rotor_inertia": self.rotor, "viscous_friction": self.viscous, "coulomb_friction": self.coulomb}
        return tuple(name for name, sizes in usual.items() if np.isfinite(sizes).any())

    @property
    def unknown(self) -> str:
        """What of it was not identified in every joint, in words."""
        kinds = {"rotors": "rotor_inertia" in self.lacking, "friction": bool({*self.lacking} - {"rotor_inertia"})}
        return " and ".join(name for name, there in kinds.items() if there)

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
