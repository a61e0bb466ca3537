"""How an estimate becomes the links and the friction that its URDF holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.dynamics.base_parameters import nearest_links
from bayesid.errors import BayesidError
from bayesid.estimators import Estimate, Estimator
from bayesid.estimators.conic.consistent_links import consistent_links
from bayesid.estimators.nonlinear import solve
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.results.fitted_model import UrdfLinks, joint_dynamics
from bayesid.robot.prior import assumed_links, states_masses

_ROTORS = "rotor_inertia"


def urdf_links(problem: Problem, estimate: Estimate) -> UrdfLinks:
    """Links that can exist, nearest to the nominal ones within the estimate's uncertainty; the estimator's own if it has some."""
    robot, rank = problem.experiment.robot, problem.row_model.base.rank
    stated = states_masses(robot)
    near = "the nominal links" if stated else "cylinders between the joints, as the URDF states no masses"
    if estimate.links is not None:
        links = unconstrained = estimate.links
        moved, solution, near = None, estimate.solution, near
    else:
        moved = consistent_links(problem.regression, estimate, assumed_links(robot), scaled=not stated)
        links, solution = moved.links, moved.solution
        unconstrained = nearest_links(robot, problem.row_model.base, estimate.values, ~estimate.undetermined[:rank])
    dynamics = joint_dynamics(problem, links, solution[rank:], ~estimate.undetermined[rank:], estimate.solution[rank:])
    return UrdfLinks(
        links=links,
        unconstrained=unconstrained,
        moved=moved,
        nominal=near,
        errors=_errors(problem, estimate.solution, solution),
        dynamics=dynamics,
        # Joint torques hardly show masses; where they are far from the stated ones all the same, they stand for something else.
        stated_mass=float(robot.nominal[:, 0].sum()) if problem.channel == "torque" and stated else None,
    )


def missing_rotors(
    problem: Problem, estimate: Estimate, method: Estimator, options: FitOptions, links: UrdfLinks, mistaken: bool = False
) -> list[str]:
    """That links are as heavy as no arm of this URDF is, or cannot exist, and whether rotor inertias in the model repair it.

    Joint torques hardly show masses. Where the links must be far from the stated ones all the same, they stand for inertia that
    no link has, as a rule that of the drives' rotors, which acts about each joint's axis alone. It is tried there, and where the
    model is incomplete, to see whether it is complete then; unless a mistake in the data is known that has to be undone first
    (``mistaken``), or poses at rest are all that is fitted, which show no inertia.
    """
    robot = problem.experiment.robot
    if problem.channel != "torque" or not states_masses(robot):
        return []
    stated = robot.nominal[:, 0]

    def impossible(these: UrdfLinks) -> bool:
        return these.moved is not None and not these.moved.inside

    found = links.links[::10]
    possible = links.usable and not impossible(links)
    if possible and estimate.details.model_complete is not False:
        return []
    k = int(np.argmax(np.abs(found - stated)))
    said = (
        f"The links of identified.urdf are no usable result: they have {found.sum():.3g} kg in all, those of the URDF "
        f"{stated.sum():.3g} kg ({robot.body_names[k]}: {found[k]:.3g}, stated {stated[k]:.3g}), to have the "
        f"{'first moments' if problem.at_rest else 'inertias'} that the estimate asks for. "
    )
    if mistaken:
        return [] if links.usable else [f"{said}Undo the mistake that is named below, then fit again: do not rely on these."]
    if problem.at_rest:
        lacks = "The URDF's masses or inertias are wrong, or the model lacks something: do not rely on these."
        return [] if links.usable else [said + lacks]
    effects = [effect.spec for effect in problem.row_model.effects]
    rotors, repaired = [spec for spec in effects if spec.startswith(_ROTORS)], None
    if len(rotors) < len(problem.experiment.torque_joints):
        every = [*(spec for spec in effects if spec not in rotors), _ROTORS]
        repaired = _links_with(problem, method, replace(options, effects=every), complete=possible)
    if repaired is None or not repaired.usable or impossible(repaired):
        lacks = "The model lacks something that acts like inertia, or the URDF's masses are wrong: do not rely on these."
        return [] if links.usable else [said + lacks]
    motion, (before, _) = next(iter(links.errors.items()))
    then = "nothing else is missing in it" if possible else f"the links of identified.urdf can exist, with {repaired.mass:.3g} kg"
    return [
        f"{'' if links.usable else said}With {_ROTORS} in the model {then}, and the error of '{motion}' goes from "
        f"{100 * before:.3g} to {100 * repaired.errors[motion][0]:.3g} %: "
        + (
            f"beside those of some joints, {_ROTORS} of the others seems to be missing. Put {_ROTORS}, of all, in place of "
            f"{', '.join(rotors)} in [model] effects."
            if rotors
            else f"the rotors of the drives seem to be missing. Add {_ROTORS} to [model] effects."
        )
    ]


def _links_with(problem: Problem, method: Estimator, options: FitOptions, complete: bool) -> UrdfLinks | None:
    """The links of the same fit with rotors; None where it fails, shows none or, if asked for, is not complete."""
    try:
        found = solve(prepare(problem.experiment, replace(options, bandwidth=problem.smoother.bandwidth)), method)
        links = urdf_links(*found) if found[1].details.model_complete or not complete else None
    except (BayesidError, np.linalg.LinAlgError):
        return None
    return links if links is not None and _shows_rotors(found[1], links) else None


def _shows_rotors(estimate: Estimate, links: UrdfLinks) -> bool:
    """Whether a rotor is seen beside the links, or each is left an inertia that a rotor can have.

    More parameters let links exist and hide what else is missing, too; those of rotors are negative then as often as not.
    """
    parameters = estimate.parameters()
    seen = (low > 0.0 for name, low in zip(parameters.names, parameters.low, strict=True) if name.startswith(_ROTORS))
    left = (value for name, (value, _) in links.dynamics.beside.items() if name.startswith(_ROTORS))
    return any(seen) or all(value >= 0.0 for value in left)


def _errors(problem: Problem, *solutions: np.ndarray) -> dict[str, tuple[float, float]]:
    """Error norm over signal norm of all channels' rows, motion by motion, for two solutions."""
    out = {}
    for name in [m.name for m in problem.judges] or problem.fitted:
        power, size = np.zeros(len(solutions)), 0.0
        for block in problem.rows.blocks([name]):
            power += [np.sum(block.residual(s) ** 2) for s in solutions]
            size += float(np.sum(block.target**2))
        first, second = np.sqrt(power / max(size, 1e-300))
        out[name] = (float(first), float(second))
    return out
