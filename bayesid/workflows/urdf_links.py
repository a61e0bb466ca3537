"""From an estimate to the links and the friction that its URDF holds."""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.nearest_links import nearest_links
from bayesid.estimators import Estimate
from bayesid.estimators.conic.consistent_links import consistent_links
from bayesid.regression.problem import Problem
from bayesid.results.urdf_links import UrdfLinks
from bayesid.robot.typical import states_masses, typical_links


def urdf_links(problem: Problem, estimate: Estimate) -> UrdfLinks:
    """Links that can exist, nearest to the nominal ones within the estimate's uncertainty; the estimator's own if it has some."""
    robot, rank = problem.experiment.robot, problem.row_model.base.rank
    stated = states_masses(robot)
    near = "the nominal links" if stated else "cylinders between the joints, as the URDF states no masses"
    if estimate.links is not None:
        links = unconstrained = estimate.links
        moved, solution, near = None, estimate.solution, near
    else:
        nominal = robot.nominal if stated else typical_links(robot)
        moved = consistent_links(problem.regression, estimate, nominal, scaled=not stated)
        links, solution = moved.links, moved.solution
        unconstrained = nearest_links(robot, problem.row_model.base, estimate.values, ~estimate.undetermined[:rank])
    friction, left_out = _friction(problem, estimate, solution)
    return UrdfLinks(
        links=links,
        unconstrained=unconstrained,
        moved=moved,
        nominal=near,
        errors=_errors(problem, estimate.solution, solution),
        friction=friction,
        left_out=left_out,
    )


def _friction(problem: Problem, estimate: Estimate, solution: np.ndarray) -> tuple[dict[str, dict[str, float]], tuple[str, ...]]:
    """Identified effects that a URDF has an attribute for, by joint, and the negative ones among them."""
    row_model, out, negative = problem.row_model, {}, []
    values, known = np.zeros((2, len(row_model.free))), np.zeros(len(row_model.free), bool)
    values[:, row_model.free] = [s[row_model.base.rank :] for s in (estimate.solution, solution)]
    known[row_model.free] = ~estimate.undetermined[row_model.base.rank :]
    column = 0
    for effect in row_model.effects:
        attribute, joint = effect.urdf_dynamics, effect.joint
        if attribute is not None and joint is not None and known[column]:
            name = problem.experiment.robot.joint_names[joint]
            if values[:, column].min() >= 0.0:
                out.setdefault(name, {})[attribute] = float(values[1, column])
            else:
                negative.append(f"{name} {attribute}")
        column += len(effect.parameters)
    return out, tuple(negative)


def _errors(problem: Problem, *solutions: np.ndarray) -> dict[str, tuple[float, float]]:
    """Error norm over signal norm of all channels' rows, motion by motion, for two solutions."""
    readable = [m for m in problem.experiment.motions if m.name in problem.segments]
    unfitted = [m.name for m in readable if m.name not in problem.fitted and m.role == "validation"]
    out = {}
    for name in unfitted or problem.fitted:
        power, size = np.zeros(len(solutions)), 0.0
        for block in problem.rows.blocks([name]):
            power += [np.sum(block.residual(s) ** 2) for s in solutions]
            size += float(np.sum(block.target**2))
        first, second = np.sqrt(power / max(size, 1e-300))
        out[name] = (float(first), float(second))
    return out
