"""What a physically consistent estimate proves: its own optimality, whether data contradict physics, which bounds conflict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from bayesid.errors import EstimationError, InputError
from bayesid.estimators.conic.cone import Conic, Infeasible, Linear, Solution, solve_conic

#: Data contradict physics when the test's probability is below this.
CONTRADICTION = 0.01


def certificate(problem: Conic, solution: Solution, names: Sequence[str]) -> dict[str, Any]:
    """The proof as plain numbers; see `bayesid.estimators.conic.cone.Solution`.

    Parameters
    ----------
    problem, solution
        As solved.
    names
        Of the bodies.

    Returns
    -------
    dict
        ``certified``, ``objective``, ``lower_bound``, ``relative_gap``, ``largest_error_std`` (how far the optimum can be,
        in standard deviations), ``primal_violation``, ``dual_residual``, ``complementarity``, ``iterations``, ``margin``,
        ``bodies`` (eigenvalues of each pseudo-inertia relative to the body's size, rank), ``on_boundary``, ``active_bounds``.
    """
    gap = max(solution.objective - solution.bound, 0.0)
    return {
        "certified": solution.certified,
        "objective": solution.objective,
        "lower_bound": solution.bound,
        "relative_gap": solution.gap,
        "largest_error_std": float(np.sqrt(2.0 * gap)),
        "primal_violation": solution.violation,
        "dual_residual": solution.stationarity,
        "complementarity": solution.complementarity,
        "iterations": solution.iterations,
        "margin": problem.margin,
        "bodies": {
            name: {"relative_eigenvalues": values.tolist(), "rank": int(rank)}
            for name, values, rank in zip(names, solution.eigenvalues, solution.ranks, strict=True)
        },
        "on_boundary": [name for name, rank in zip(names, solution.ranks, strict=True) if rank < 4],
        "active_bounds": list(solution.active),
    }


def contradiction(distance: float, directions: int) -> dict[str, Any]:
    """Whether unconstrained estimate and possible bodies are further apart than noise explains.

    ``distance = min (x - x_ls)' V^-1 (x - x_ls)`` over all possible bodies is at most the distance of the true ones,
    which is chi-squared; its own law is a mixture of chi-squared ones with fewer degrees [Shapiro1988]_. So the
    probability is an upper bound, whatever the truth and wherever on the cone: the test never errs more often than it says.

    Parameters
    ----------
    distance
        Squared, in units of the noise.
    directions
        Number of determined combinations that the constraints speak of.
    """
    probability = float(chi2.sf(distance, directions)) if directions else 1.0
    return {
        "distance": float(distance),
        "directions": directions,
        "probability_at_most": probability,
        "data_contradict_physics": probability < CONTRADICTION,
    }


def explain(problem: Conic) -> InputError:
    """The smallest set of bounds that no body can meet together, found by leaving out one after the other.

    Parameters
    ----------
    problem
        An infeasible one.
    """
    # Any regular objective will do; the body's size is where the solver is at ease.
    plain = replace(problem, factor=np.diag(1.0 / problem.units))
    guilty = list(problem.bounds)
    for group in problem.bounds:
        rest = [g for g in guilty if g is not group]
        if not _possible(plain, rest):
            guilty = rest
    if not guilty:
        return InputError("bounds: no body can meet them; leave some out")
    if len(guilty) == 1:
        return InputError(f"bounds: no body that can exist has {guilty[0].name}; widen it")
    named = f"{', '.join(g.name for g in guilty[:-1])} and {guilty[-1].name}"
    return InputError(f"bounds: {named} exclude each other; widen one of them")


def _possible(problem: Conic, bounds: Sequence[Linear]) -> bool:
    try:
        return solve_conic(replace(problem, bounds=tuple(bounds))).violation < 1e-6
    except (Infeasible, EstimationError):
        return False
