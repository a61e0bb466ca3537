"""What ``bounds`` found: what a controller may rely on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.io import savemat

from bayesid.arguments import ByName
from bayesid.design.bounds.bands import FAR, Band, band
from bayesid.design.bounds.knowledge import Known
from bayesid.design.bounds.model import ReadingModel
from bayesid.design.bounds.region import Region, ellipsoid_term, norm_term, tracking_bound
from bayesid.design.bounds.remainder import Remainder
from bayesid.design.bounds.workspace import InsideJoints, Workspace, mass_eigenvalues
from bayesid.drawing import figures_of
from bayesid.errors import InputError
from bayesid.estimators.estimator import LEVEL
from bayesid.estimators.parameters import EstimatedParameter
from bayesid.results.estimated import forwarded
from bayesid.results.files import SCHEMA, Files, ShownResult
from bayesid.results.fitted_model import joint_dynamics
from bayesid.robot.urdf import write_urdf
from bayesid.rounding import HALF, number, percent
from bayesid.section import Part, ShownTable
from bayesid.validation.predicted_readings import checked_states, checked_times

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class TrajectoryBands:
    """Readings of one trajectory with their bands."""

    name: str  # of the motion or the file
    given: bool  # whether it was asked for; else it is a motion of the experiment
    positions: np.ndarray  # joint positions (N, n) [rad or m]
    #: Bands of the joint torques, and of the sensor's wrench without its offset; None without a sensor.
    torque: Band
    wrench: Band | None

    def __repr__(self) -> str:
        return f"<TrajectoryBands of {self.name}: {self.torque!r}>"

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``trajectories`` in ``bounds.json``."""
        return {
            "name": self.name, "given": self.given, "torque": self.torque.to_dict(),
            "wrench": None if self.wrench is None else self.wrench.to_dict(), "far_above": FAR,
        }  # fmt: skip


class _HasRegion:
    """Sets of the parameters of the joint torques, from ``region``."""

    names: tuple[str, ...] = forwarded("region.names", "Names of the parameters of the joint torques (k,).")
    values: np.ndarray = forwarded("region.values", "Their centre (k,).")
    std: np.ndarray = forwarded("region.std", "Standard deviations (k,), nan where the data tell no more than a sum with others.")
    low: np.ndarray = forwarded("region.low", "Lower ends of the box that holds all of them at once (k,); nan as in ``std``.")
    high: np.ndarray = forwarded("region.high", "Upper ends of that box (k,).")
    covariance: np.ndarray = forwarded("region.covariance", "Their covariance V (k, k).")
    rho: float = forwarded("region.rho", "Radius of the ball that holds them, for Spong's term; in SI units together.")
    ellipsoid: float = forwarded("region.ellipsoid", "Radius rho_V of the ellipsoid ``(b - b_hat)' V^-1 (b - b_hat) <= rho_V^2``")


@dataclass(frozen=True, eq=False, repr=False)
class ControllerBounds(_HasRegion, ByName, ShownResult):
    """What a controller may rely on, with probability 95 % for each bound.

    Attributes
    ----------
    known
        What the data leave of the robot.
    parameters
        Sets of the identified base parameters.
    torque_model, wrench_model
        Joint torques and the sensor's wrench, with the sets of their parameters; the second None without a sensor.
    trained
        Largest standard deviation of each torque, and of each part of the wrench, in the motions that were fitted.
    torque_per_unit
        Root mean square torque that one unit of each parameter makes in the fitted motions, at the joint it moves most (k,) [N m
        or N, over the parameter's unit].
    effort_ratio
        How many times more torque Spong's term with the ball takes than with the ellipsoid, median over states.
    workspace
        Bounds of mass matrix, Coriolis terms and gravity.
    remainder, wrench_remainder
        What the model leaves of torques, and of the sensor's wrench, that no parameter explains: of motions that were not fitted,
        else of the fitted ones; None where there are none.
    inside
        What is inside the joints.
    trajectories
        Bands of trajectories.
    urdfs
        How many sampled URDFs are written.
    assumptions
        What the bounds rest on, a sentence each.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    seed
        Of everything random.
    """

    verb, report = "bounds", "bounds"
    known: Known
    parameters: Region
    torque_model: ReadingModel
    wrench_model: ReadingModel | None
    trained: tuple[np.ndarray, np.ndarray]
    torque_per_unit: np.ndarray
    effort_ratio: float
    workspace: Workspace
    remainder: Remainder | None
    wrench_remainder: Remainder | None
    inside: InsideJoints
    trajectories: tuple[TrajectoryBands, ...]
    urdfs: int
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    seed: int = 0

    # ---- for a controller ---------------------------------------------------------------------------------------

    @property
    def region(self) -> Region:
        """Sets of the parameters of the joint torques: base parameters, then those of friction and rotors identified."""
        return self.torque_model.region

    @property
    def links(self) -> np.ndarray:
        """Links that can exist, drawn within the uncertainty (m, 10 b)."""
        return self.known.links.links

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None) -> Band:
        """Joint torques of a motion with their bands.

        Parameters
        ----------
        q, v, a
            Joint positions, velocities and accelerations (N, n), or (n,) [rad or m, and per second (squared)].
        times
            (N,) [s], to be kept with the band.

        Raises
        ------
        InputError
            Shapes do not fit, or values are not finite.
        """
        model = self.torque_model
        q, v, a = checked_states(model.robot, q, v, a)
        times = None if times is None else checked_times(times, len(q))
        return band(model, q, v, a, times, self.trained[0], self.remainder, self.seed)

    def wrench(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None) -> Band:
        """Wrench on the sensor, weight included and its offset not; as `torque`.

        Raises
        ------
        InputError
            There is no sensor; or as `torque`.
        """
        if self.wrench_model is None:
            raise InputError("the experiment has no [sensor], so it has no wrench; describe it in experiment.toml")
        q, v, a = checked_states(self.wrench_model.robot, q, v, a)
        times = None if times is None else checked_times(times, len(q))
        return band(self.wrench_model, q, v, a, times, self.trained[1], self.wrench_remainder, self.seed)

    def control_columns(
        self, q: np.ndarray, v: np.ndarray, reference_v: np.ndarray, reference_a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Constant (N, n) and columns Y (N, n, k) of ``M a_r + C(q, v) v_r + g`` for passivity-based control.

        Parameters are as in `bayesid.design.bounds.model.ReadingModel.control_columns`, (N, n) or (n,) each.
        """
        q, v, reference_v, reference_a = checked_states(self.torque_model.robot, q, v, reference_v, reference_a)
        return self.torque_model.control_columns(q, v, reference_v, reference_a)

    def robust_term(self, sliding: np.ndarray, width: float, shape: str = "ellipsoid") -> np.ndarray:
        """Change u of the parameters that opposes every error the set allows: the controller's torque is ``Y (b_hat + u) - K r``.

        Parameters
        ----------
        sliding
            ``Y' r`` (N, k) or (k,), with r the velocity less the reference's.
        width
            Of the boundary layer, in which the term grows linearly.
        shape
            ``ellipsoid``, or ``ball`` for Spong's own.

        Raises
        ------
        InputError
            The shape is neither, the width is not positive, or there is no column for every parameter.
        """
        if not width > 0.0:
            raise InputError(f"width = {width}: give a positive number, or the term would jump")
        radius, sliding, count = self._radius(shape), np.asarray(sliding, float), len(self.covariance)
        if sliding.shape[-1:] != (count,):
            raise InputError(f"sliding has shape {sliding.shape}: give Y' r, one column for each of the {count} parameters")
        if shape == "ball":
            return norm_term(sliding, radius, width)
        return ellipsoid_term(sliding, self.covariance, radius, width)

    def _radius(self, shape: str) -> float:
        if shape not in ("ellipsoid", "ball"):
            raise InputError(f"shape '{shape}': choose ellipsoid or ball")
        return self.ellipsoid if shape == "ellipsoid" else self.rho

    def tracking_bound(
        self, gains: np.ndarray | float, rate: float, width: float, shape: str = "ellipsoid", other: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of ``|r_j|`` and of every joint's error (n,) with that term, from rest on the path on.

        Parameters
        ----------
        gains
            Diagonal of K (n,), or one for all joints; best in proportion to the joints' inertias, ``workspace.inertia``.
        rate
            Of e in the reference velocity ``v_d - rate e`` [1/s].
        width, shape
            As in `robust_term`.
        other
            Torques that no parameter explains, such as ``remainder.bound`` (n,).

        Raises
        ------
        InputError
            Something is not positive or not one for every joint, or the shape is neither.
        """
        n, w = self.torque_model.robot.n, self.workspace
        for name, given in (("gains", gains), ("other", other)):
            if np.shape(given) not in ((), (n,)):
                raise InputError(f"{name} has shape {np.shape(given)}: give one number, or one for each of the {n} joints")
        diagonal = np.broadcast_to(np.asarray(gains, float), n)
        if not (np.all(diagonal > 0.0) and rate > 0.0 and width > 0.0):
            raise InputError(f"gains = {gains}, rate = {rate}, width = {width}: give positive numbers")
        radius = self._radius(shape)
        eigenvalues = mass_eigenvalues(self.torque_model, diagonal, w.draws, w.configurations, self.seed)
        return tracking_bound(radius, width, diagonal, rate, eigenvalues, other)

    # ---- as data --------------------------------------------------------------------------------------------------

    def plot_torque(
        self, trajectory: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None
    ) -> Figure:
        """Draw the torques of a trajectory with their bands.

        Parameters
        ----------
        trajectory
            Its name; default the first.
        channels
            Which readings, such as ``["tau1"]``; default all.
        ax
            matplotlib's Axes to draw into, two for each channel: the band, and half its width; default a figure of its own.

        Raises
        ------
        InputError
            There is no such trajectory or channel, or the number of axes is another.
        """
        return self._plot("torque", trajectory, channels, ax)

    def plot_wrench(
        self, trajectory: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None
    ) -> Figure:
        """Draw the wrench of a trajectory with its bands; as `plot_torque`."""
        return self._plot("wrench", trajectory, channels, ax)

    plot = plot_torque

    def _plot(self, channel: str, name: str | None, channels: Sequence[str] | str | None, ax: Any) -> Figure:
        known: Mapping[str, TrajectoryBands] = {t.name: t for t in self.trajectories}
        if not known:
            raise InputError("no trajectory has bands, as no motion of the experiment moves; pass trajectory= to bounds")
        if name is not None and name not in known:
            raise InputError(f"trajectory '{name}' has no bands; choose one of {', '.join(known)}")
        shown = getattr(known[name] if name is not None else self.trajectories[0], channel)
        if shown is None:
            raise InputError("the experiment has no [sensor], so it has no wrench; describe it in experiment.toml")
        return figures_of(self)["band"](shown, channels, ax)

    def to_dataframe(self) -> DataFrame:
        """Parameters of the joint torques as a table, ``low`` and ``high`` of the box that holds all of them at once.

        ``class`` is ``data``, ``prior`` where the nominal model drives the bounds, ``sum`` where the data tell no more than a sum
        with others: ``std``, ``low`` and ``high`` are nan there.
        """
        return self.region.table().to_dataframe()

    def __getitem__(self, name: str) -> EstimatedParameter:
        """One parameter of the joint torques, by its name or label, with the box's ends.

        Raises
        ------
        KeyError
            There is none of this name.
        """
        return self.region.table()[name]

    def to_dict(self) -> dict[str, Any]:
        """What ``bounds.json`` holds."""
        k = self.known
        return {
            "schema": SCHEMA, "experiment": k.problem.experiment.name, "level": LEVEL, "seed": self.seed,
            "source": k.source, "method": k.method, "channel": k.problem.channel, "motions": list(k.problem.fitted),
            "held_out_scale": k.held_out_scale, "headline": self.headline, "dispersion": k.dispersion,
            "identified": self.parameters.to_dict(),
            "joint_torques": {
                **self.region.to_dict(), "base_map": self.torque_model.base.matrix.tolist(),
                "link_parameter_names": list(self.torque_model.base.parameter_names),
                "effort_ball_over_ellipsoid": self.effort_ratio, "torque_per_unit": self.torque_per_unit.tolist(),
            },
            "rho": self.rho, "rho_V": self.ellipsoid,
            "workspace": self.workspace.to_dict(),
            "other_uncertainty": None if self.remainder is None else self.remainder.to_dict(),
            "other_uncertainty_of_wrench": None if self.wrench_remainder is None else self.wrench_remainder.to_dict(),
            "identified_urdf": k.dynamics.to_dict(), "inside_joints": self.inside.to_dict(),
            "trained_std": {"torque": self.trained[0].tolist(), "wrench": self.trained[1].tolist()},
            "trajectories": [t.to_dict() for t in self.trajectories],
            "links_drawn": len(self.links), "sampled_urdfs": self.urdfs,
            "assumptions": list(self.assumptions), "warnings": list(self.warnings), "runtime_s": self.seconds,
        }  # fmt: skip

    def _beside(self) -> Files:
        robot, known = self.known.problem.experiment.robot, self.known
        files: dict[str, str | Callable[[Path], Any]] = {
            "bounds.mat": lambda path: savemat(path, self.to_matlab(), oned_as="column"),
            "identified.urdf": lambda path: write_urdf(robot, known.urdf, path, known.dynamics),
        }
        for k, draw in enumerate(np.linspace(0, len(self.links) - 1, self.urdfs).astype(int), 1):
            linked, free = known.links.effects[draw], ~known.undetermined[known.base.rank :]
            along = joint_dynamics(known.problem, self.links[draw], linked, free)
            files[f"sampled-{k:03d}.urdf"] = lambda path, draw=draw, along=along: write_urdf(robot, self.links[draw], path, along)
        return files

    def to_matlab(self) -> dict[str, Any]:
        """``bounds.mat``: arrays for MATLAB; indices of columns count from one."""
        region, w = self.region, self.workspace
        out: dict[str, Any] = {
            "names": np.array(region.names, object), "units": np.array(region.units, object), "b_hat": region.values,
            "V": region.covariance, "basis": region.basis, "to_basis": region.to_basis, "V_basis": region.basis_covariance,
            "V_basis_factor": np.linalg.cholesky(region.basis_covariance), "std": region.std,
            "box_low": region.low, "box_high": region.high, "rho": self.rho,
            "rho_V": self.ellipsoid,
            "base_map": self.torque_model.base.matrix, "base_columns": self.torque_model.base.independent + 1,
            "link_parameter_names": np.array(self.torque_model.base.parameter_names, object), "links_hat": self.known.centre,
            "links": self.links, "alpha": w.alpha, "mass_ratio": np.array(w.ratio), "mass_eigenvalues": np.array(w.eigenvalues),
            "coriolis": w.coriolis, "coriolis_error": w.coriolis_error, "gravity": w.gravity, "gravity_error": w.gravity_error,
            "identified": {
                "names": np.array(self.parameters.names, object), "values": self.parameters.values,
                "covariance": self.parameters.covariance, "low": self.parameters.low, "high": self.parameters.high,
            },
            "trajectories": np.array([_for_matlab(t) for t in self.trajectories], object),
        }  # fmt: skip
        if self.remainder is not None:
            r = self.remainder
            out["other"] = {"bound": r.bound, "speeds": r.speeds, "by_speed": r.by_speed, "held_out": r.held_out}
        return out

    def __repr__(self) -> str:
        return f"<ControllerBounds of {self.known.problem.experiment.name}: rho {self.rho:.3g}, alpha {self.workspace.alpha:.3g}>"

    def _parts(self) -> list[Part]:
        known = self.known
        title = f"{known.problem.experiment.name}: bounds for controllers from the {known.source} ({known.method})."
        warned = [f"warning: {w}" for w in self.warnings]
        bands: list[Part] = []
        for t in self.trajectories:
            bands += [f"{t.name}, joint torques: {bands_of(t.torque)}", band_table(t.torque)]
        return [f"{title} {self.headline}", *warned, *self._facts(), joints(self), *bands]

    @property
    def headline(self) -> str:
        """What the bounds hold with probability 95 % of, and what that is conditional on."""
        left, sets = self.remainder, "Sets of parameters hold with probability 95 %, given that the model is right"
        if left is None:
            return f"{sets}; {self.unread}, so bands hold what parameters leave open and nothing that the model lacks."
        named = ", ".join(left.motions)
        if left.complete:
            where = f"which {'was' if len(left.motions) == 1 else 'were'}{' not' * left.held_out} fitted"
            return f"{sets}; so do bands: noise and parameters explain all that is left of {named}, {where}."
        if left.held_out:
            return (
                f"{sets}. Pointwise bands of torques hold 95 % of the samples of motions like {named}, not fitted: what is left "
                "there, which no parameter explains, is in them."
            )
        return (
            f"{sets}. Pointwise bands of torques hold 95 % of the samples of motions like "
            f"{', '.join(self.known.problem.fitted)}, with the robot as warm and worn as it was then: no motion was held out, so "
            "nothing shows another kind of motion or another day."
        )

    @property
    def unread(self) -> str:
        """Why nothing tells what the model lacks of the torques, where there is no ``remainder``."""
        experiment = self.known.problem.experiment
        if all(m.table.torques is None for m in experiment.motions):
            return "no joint torques were recorded"
        if missing := [n for k, n in enumerate(experiment.robot.joint_names) if k not in experiment.torque_joints]:
            return f"torques of {', '.join(missing)} were not recorded"
        if all(m.kind == "poses" for m in experiment.motions if m.table.torques is not None):
            return "torques were recorded of poses at rest only"
        return "no motion with torques is long enough"

    def _facts(self) -> list[str]:
        """What there is to say in one line each."""
        region, w, left = self.region, self.workspace, self.remainder
        units = matrix_units(self.torque_model.robot.prismatic)
        out = [
            f"parameters of the joint torques: {len(region.values)}, "
            + (
                f"all at once within {number(region.factor, 3)} standard deviations (box)"
                if region.factor > 0.0
                else "only in sums"
            )
            + f", rho_V {number(region.ellipsoid, 4)} (ellipsoid), rho {number(region.rho, 3)} (ball, SI units)",
            f"torque of the ball over that of the ellipsoid: {number(self.effort_ratio, 2)} times (median)",
            f"mass matrix: M_hat is {number(w.ratio[0], 3)} to {number(w.ratio[1], 3)} times M; alpha {number(w.alpha, 3)}"
            + (" (of identified.urdf)" if w.of_urdf else "")
            + ("" if w.alpha < 1.0 else ", not below 1: computed torque has no guarantee"),
            f"Coriolis: error {number(w.coriolis_error, 2)} of {number(w.coriolis, 3)} [{units.coriolis}]",
            f"every drawn mass matrix: positive definite; smallest eigenvalue {number(w.smallest_drawn, 3)} [{units.mass}]",
        ]
        if left is not None:
            kind = "motions that were not fitted" if left.held_out else "the fitted motions"
            each = zip(left.bound, self.torque_model.channels.units, strict=True)
            bounds = ", ".join(f"{number(b, 3)} {unit}" for b, unit in each)
            out.append(f"other uncertainty: 99 % of the torques of {kind} within {bounds}")
        return out


def _for_matlab(t: TrajectoryBands) -> dict[str, Any]:
    out = {"name": t.name, "t": t.torque.times, "q": t.positions}
    for channel, shown in (("torque", t.torque), ("wrench", t.wrench)):
        if shown is not None:
            out[channel] = {
                "names": np.array(shown.names, object), "value": shown.values, "std": shown.std,
                "model_error": shown.model_error, "low": shown.low, "high": shown.high, "pointwise_low": shown.pointwise_low,
                "pointwise_high": shown.pointwise_high, "factor": shown.factor, "extrapolation": shown.extrapolation,
            }  # fmt: skip
    return out


@dataclass(frozen=True)
class MatrixUnits:
    """Units of what all joints have together."""

    mass: str  # of the mass matrix
    coriolis: str  # of ``C(q, v) v`` over the speed squared
    acceleration: str
    bent: str  # of an acceleration over the speed squared


def matrix_units(prismatic: np.ndarray) -> MatrixUnits:
    """Those of joints of which some slide (n,); where others turn, numbers of several units are put together."""
    if not prismatic.any():
        return MatrixUnits("kg m²", "N m s²", "rad/s²", "")
    return MatrixUnits("kg", "kg/m", "m/s²", "1/m") if prismatic.all() else MatrixUnits(*["SI units"] * 4)


def joints(result: ControllerBounds) -> ShownTable:
    """Bounds joint by joint."""
    w, inside = result.workspace, result.inside
    least = 1e-9 * float(w.gravity.max(initial=0.0))  # rounding of a joint that carries no weight
    gravity, error = (np.where(x > least, x, 0.0) for x in (w.gravity, w.gravity_error))
    head = ["joint", "inertia", "unit", "error", "gravity", "error", "unit", "usual rotor inertia", "usual friction"]
    rows = []
    for j, (name, torque) in enumerate(zip(inside.joints, result.torque_model.channels.units, strict=True)):
        rotor = "identified" if not np.isfinite(inside.rotor[j]) else f"{number(inside.rotor_share[j], 2)} × inertia"
        share = inside.friction_share[j]
        known = not (np.isfinite(inside.coulomb[j]) or np.isfinite(inside.viscous[j]))
        friction = f"{number(share, 2)} × gravity" if np.isfinite(share) else f"{number(inside.coulomb[j], 2)} {torque}"
        rows.append(
            [name, f"{number(w.inertia[j, 0], 3)} … {number(w.inertia[j, 1], 3)}", "kg" if torque == "N" else "kg m²",
             percent(w.inertia_error[j], 2) if w.inertia_error[j] <= 1.0 else "over 100 %",
             number(gravity[j], 3), number(error[j], 2), torque, rotor, "identified" if known else friction]
        )  # fmt: skip
    return ShownTable(head, rows, "k n k n n n k n n", "narrow")


def bands_of(b: Band) -> str:
    """What the two bands of a trajectory hold."""
    return (
        f"the pointwise band is {number(HALF, 3)} standard deviations to each side and holds 95 % of the samples, the "
        f"simultaneous one {number(b.factor, 3)} and holds all samples at once with probability 95 %. The table has half of "
        "each, the mean."
    )


def band_table(b: Band) -> ShownTable:
    """Bands of a trajectory, channel by channel."""
    columns = (
        np.abs(b.values).max(axis=0), b.pointwise_half_width.mean(axis=0), HALF * b.model_error.mean(axis=0),
        b.half_width.mean(axis=0), b.extrapolation,
    )  # fmt: skip
    rows = [
        [n, u, number(x, 3), number(p, 2), number(r, 2), number(h, 2), (number(e, 2), "bad" if e > FAR else "")]
        for n, u, x, p, r, h, e in zip(b.names, b.units, *columns, strict=True)
    ]
    head = ["channel", "unit", "largest", "pointwise ±", "± of model error alone", "simultaneous ±", "std over fitted motions’"]
    return ShownTable(head, rows, "k - n nb n n n", "tight")
