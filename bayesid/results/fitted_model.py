"""What files of results hold of the fitted model: effects with their values, the robot, the links of ``identified.urdf``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arguments import call
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects import Effect, Term, stated_of, with_places
from bayesid.errors import InputError
from bayesid.estimators.conic.consistent_links import ConsistentLinks
from bayesid.estimators.estimator import LEVEL
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import EffectParameters
from bayesid.regression.problem import Problem, weight_columns
from bayesid.regression.row_model import RowModel
from bayesid.robot import inertia
from bayesid.robot.robot import Robot, load_robot
from bayesid.robot.urdf import JointDynamics
from bayesid.signals.noise import NoiseModel

#: A frame without mass in the URDF, that no motion weighs, is no body: all its ten parameters are below this [SI].
_MASSLESS = 1e-9
#: A robot's whole mass is stated right to this factor: data sheets are, and models by hand hardly worse.
TOTAL_MASS = 1.5
#: Errors of predictions that grow by more than this share bring a warning.
LARGEST_GROWTH = 0.05
_NAMED = 4


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
        stated = stated_of(effect, experiment.effect_values, experiment.robot.joint_names)
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
    return [(effect, *whole[:, at]) for effect, at in with_places(row_model.effects)]


def own_values(problem: Problem, values: np.ndarray, links: np.ndarray) -> np.ndarray:
    """Estimated effect parameters (..., e) without what is weight of links (..., 10 b): what looks like it is fitted as one."""
    at, absorbed = weight_columns(problem.row_model), problem.row_model.base.absorbed
    if absorbed is None or not at:
        return values
    own = values.copy()
    own[..., at] -= links @ absorbed[: len(at)].T
    return own


def own_offset(problem: Problem, values: np.ndarray, std: np.ndarray, links: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The sensor's offset (6,), freed from the weight that looks like one, which only the nominal model knows.

    ``values`` and ``std`` are those of all estimated effect parameters (e,). Its standard deviation is nan where the nominal mass
    that it rests on has no stated one. None without an offset that is estimated.
    """
    at, absorbed = weight_columns(problem.row_model), problem.row_model.base.absorbed
    if not at:
        return None
    own, known = own_values(problem, values, links)[at], std[at].copy()
    if absorbed is not None:
        rows = absorbed[: len(at)]
        rel_std = problem.experiment.inertia_rel_std
        share = np.sqrt(np.sum((rows * links).reshape(len(rows), -1, 10).sum(axis=2) ** 2, axis=1))
        known = np.where(share > 1e-9, np.nan if rel_std is None else np.hypot(known, (rel_std or 0.0) * share), known)
    return own, known


def placed(effect: Effect, robot: Robot) -> str:
    """``sensor_gain at mx``, ``tether at joint3 (elbow_joint)``; the place is left out where there is only one."""
    if effect.at in ("sensor", "base", "robot"):
        return effect.name
    own = effect.where if effect.joint is None else robot.joint_names[effect.joint]
    return f"{effect.name} at {effect.where}" + ("" if own == effect.where else f" ({own})")


def filter_section(row_model: RowModel) -> dict[str, float | None]:
    """``filter`` in documents of fits: the paper's low-pass filters [rad/s], None without."""
    filters = row_model.filters
    return {"l": None if filters is None else filters.l, "d": None if filters is None else filters.d}


def noise_section(noise: Mapping[str, NoiseModel], channels: Sequence[str]) -> dict[str, dict[str, float]]:
    """``noise_std`` in documents of fits: by group of motions and channel [unit of the channel]."""
    return {group: dict(zip(channels, map(float, model.std), strict=True)) for group, model in noise.items()}


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


def impossible_bodies(links: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Names of the bodies (b,), of parameters (b, 10), that are not physically consistent."""
    massless = np.abs(links).max(axis=1) <= _MASSLESS
    exists = inertia.is_physically_consistent(links)
    return tuple(name for name, possible in zip(names, exists | massless, strict=True) if not possible)


@dataclass(frozen=True)
class UrdfLinks:
    """Links of ``identified.urdf``."""

    links: np.ndarray  # ten parameters a body (10 b,), physically consistent
    #: The nearest to the nominal ones that have exactly the estimated base parameters, possible or not (10 b,).
    unconstrained: np.ndarray
    #: How far the base parameters had to move, and what stood against it; None where the estimator has links of its own.
    moved: ConsistentLinks | None
    nominal: str  # what the links are near to
    #: Relative error of the rows of each motion that was not fitted (of all, where all were): predicted by the estimate, and by
    #: these links with the effects that go with them.
    errors: dict[str, tuple[float, float]]
    dynamics: JointDynamics  # friction, and what else was identified beside the links
    stated_mass: float | None = None  # of the URDF in all [kg]; None where it says nothing of these links' masses

    @property
    def mass(self) -> float:
        """Mass of all links together [kg]."""
        return float(self.links[::10].sum())

    @property
    def usable(self) -> bool:
        """Whether the links are as heavy as a robot of this URDF can be."""
        stated = self.stated_mass
        return stated is None or 1.0 / TOTAL_MASS <= self.mass / stated <= TOTAL_MASS

    def __repr__(self) -> str:
        return f"<UrdfLinks: {len(self.links) // 10} bodies>"

    def to_dict(self) -> dict[str, Any]:
        """``identified_urdf`` in ``estimate.json``."""
        moved = self.moved
        return {
            "near_to": self.nominal,
            "usable": self.usable,
            "moved": None if moved is None else {
                "sigma": moved.distance,
                "allowed_sigma": moved.allowed,
                "confidence": LEVEL,
                "base_parameters": moved.directions,
                "inside": moved.inside,
                "largest": None if moved.largest is None else {"label": moved.largest[0], "sigma": moved.largest[1]},
                "links_at_the_edge": list(moved.on_boundary),
                "conflicts": [{"label": label, "sigma": sigma} for label, sigma in moved.conflicts],
            },
            "relative_error_of_rows": {motion: {"estimate": a, "urdf": b} for motion, (a, b) in self.errors.items()},
            **self.dynamics.to_dict(),
        }  # fmt: skip

    def text(self) -> str:
        """One or two sentences on how far the links are from the estimate."""
        moved = self.moved
        if moved is None:
            return f"The links are the estimator's own, near to {self.nominal}; their base parameters are the estimate."
        text = f"Links are near to {self.nominal}"
        if moved.distance is None or moved.largest is None:
            return f"{text}; the estimate has no covariance, so predictions of the fitted motions alone hold them."
        return (
            f"{text}. Their base parameters are {moved.distance:.3g} sigma from the estimate, jointly ({_radius(moved)}); "
            f"most moved {moved.largest[0]}, by {moved.largest[1]:.2g} of its standard deviations."
        )

    def warnings(self) -> list[str]:
        """Conflicts between the estimate and bodies that can exist, and what the links predict worse."""
        out, moved = [], self.moved
        inside = moved is None or moved.inside
        if moved is not None and not moved.inside:
            labels = [f"{label} ({sigma:.3g} sigma)" for label, sigma in moved.conflicts]
            edge = f"; at the edge of what can exist: {listed(moved.on_boundary, _NAMED)}" if moved.on_boundary else ""
            furthest = f"; moved furthest: {listed(labels, _NAMED)}" if labels else ""
            out.append(
                "No bodies that can exist have base parameters inside the estimate's uncertainty: those of identified.urdf "
                f"are {moved.distance:.3g} sigma away, jointly ({_radius(moved)}){edge}{furthest}. Something is missing in the "
                f"model, such as friction or rotor inertia: `{call('diagnose')}` looks for it."
            )
        worse = {m: (e, x) for m, (e, x) in self.errors.items() if x > (1.0 + LARGEST_GROWTH) * e}
        if worse:
            motion, (estimate, links) = max(worse.items(), key=lambda item: item[1][1] / max(item[1][0], 1e-300))
            why = "stays inside the uncertainty, which is wide" if inside else "is a robot that can exist"
            more = "" if len(worse) == 1 else f" (the worst of {len(worse)} motions)"
            out.append(
                f"identified.urdf predicts the rows of '{motion}'{more}, up to the motion's bandwidth, with {100 * links:.3g} % "
                f"error, the base parameters with {100 * estimate:.3g} %: it {why}. Predict with the base parameters, simulate "
                "with the URDF."
            )
        return out


def joint_dynamics(
    problem: Problem, links: np.ndarray, effects: np.ndarray, determined: np.ndarray, estimated: np.ndarray | None = None
) -> JointDynamics:
    """What was identified inside the joints, as a URDF holds it, and what it has no place for.

    ``effects`` are values of estimated parameters that go with the ``links`` (10 b,), beside those that are stated;
    ``determined`` which of them the data determine, alone, and ``estimated`` those of the estimate itself where they are others:
    neither may be negative; (e,) each.
    """
    effects = own_values(problem, effects, links)
    friction: dict[str, dict[str, float]] = {}
    negative, beside = [], {}
    own = by_effect(problem.row_model, effects if estimated is None else estimated, determined)
    for (effect, values, known), (_, linked, _) in zip(own, by_effect(problem.row_model, effects, determined), strict=True):
        attribute, joint = effect.urdf_dynamics, effect.joint
        if attribute is None or joint is None:
            beside |= dict(zip(effect.column_names, zip(linked.tolist(), effect.units, strict=True), strict=True))
        elif known[0] != 0.0:  # stated values, which are not estimated, are not a number here
            name = problem.experiment.robot.joint_names[joint]
            if min(values[0], linked[0]) >= 0.0:
                friction.setdefault(name, {})[attribute] = float(linked[0])
            else:
                negative.append(f"{name} {attribute}")
    return JointDynamics(friction, tuple(negative), beside)


def _radius(moved: ConsistentLinks) -> str:
    return f"{moved.allowed:.3g} is the radius of the {100 * LEVEL:g} % region of {moved.directions}"
