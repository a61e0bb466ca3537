"""What a physically consistent estimate certifies: its optimality, whether data contradict physics, which bounds conflict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from bayesid.errors import EstimationError, InputError
from bayesid.estimators.conic.problem import Conic, Linear, Solution
from bayesid.estimators.conic.solver import Infeasible, solve_conic

#: Data contradict physics when the test's probability is below this.
CONTRADICTION = 0.01


@dataclass(frozen=True)
class BodyCertificate:
    """Eigenvalues of a body's pseudo-inertia relative to its nominal size (4,), and its rank."""

    relative_eigenvalues: tuple[float, ...]
    rank: int


@dataclass(frozen=True)
class Certificate:
    """The certificate of an optimum as plain numbers; see `bayesid.estimators.conic.problem.Solution`."""

    certified: bool  # whether gap, violation and residual are below their limits
    #: Of the optimum: its value here, and what no feasible point can be below.
    objective: float
    lower_bound: float
    relative_gap: float
    largest_error_std: float  # how far the optimum can be, in standard deviations
    #: Residuals of the optimality conditions, and iterations of the solver.
    primal_violation: float
    dual_residual: float
    complementarity: float
    iterations: int
    margin: float  # how far inside the boundary every body is kept, relative to its size
    bodies: dict[str, BodyCertificate]  # by name
    on_boundary: tuple[str, ...]  # names of bodies on the boundary of those that can exist
    active_bounds: tuple[str, ...]  # names of bounds that hold with equality and push

    @classmethod
    def of(cls, problem: Conic, solution: Solution, names: Sequence[str]) -> Certificate:
        """The certificate of a solution; ``names`` are the bodies'."""
        gap = max(solution.objective - solution.bound, 0.0)
        return cls(
            certified=solution.certified,
            objective=solution.objective,
            lower_bound=solution.bound,
            relative_gap=solution.gap,
            largest_error_std=float(np.sqrt(2.0 * gap)),
            primal_violation=solution.violation,
            dual_residual=solution.stationarity,
            complementarity=solution.complementarity,
            iterations=solution.iterations,
            margin=problem.margin,
            bodies={
                name: BodyCertificate(tuple(values.tolist()), int(rank))
                for name, values, rank in zip(names, solution.eigenvalues, solution.ranks, strict=True)
            },
            on_boundary=tuple(name for name, rank in zip(names, solution.ranks, strict=True) if rank < 4),
            active_bounds=tuple(solution.active),
        )


@dataclass(frozen=True)
class PhysicsTest:
    """Whether the unconstrained estimate and bodies that can exist are further apart than noise explains."""

    distance: float  # squared, in units of the noise
    directions: int  # number of determined combinations that the constraints speak of
    probability_at_most: float  # upper bound on the probability of such a distance when bodies can exist
    data_contradict_physics: bool  # whether that is below `CONTRADICTION`
    tested: bool  # whether the nearest body that can exist was found

    @classmethod
    def of(cls, distance: float, directions: int, tested: bool) -> PhysicsTest:
        """Test a distance.

        ``distance = min (x - x_ls)' V^-1 (x - x_ls)`` over all possible bodies is at most the distance of the true ones,
        which is chi-squared; its own law is a mixture of chi-squared ones with fewer degrees [Shapiro1988]_. So the
        probability is an upper bound, whatever the truth and wherever on the cone: the test never errs more often than it says.
        """
        probability = float(chi2.sf(distance, directions)) if directions else 1.0
        return cls(float(distance), directions, probability, probability < CONTRADICTION, tested)


def explain(problem: Conic) -> InputError:
    """The smallest set of bounds that no body can meet together, found by leaving out one after the other."""
    # Any regular objective will do; in units of the body's size the solver is well conditioned.
    plain = replace(problem, factor=np.diag(1.0 / problem.units))
    conflicting = list(problem.bounds)
    for group in problem.bounds:
        rest = [g for g in conflicting if g is not group]
        if not _feasible(plain, rest):
            conflicting = rest
    if not conflicting:
        return InputError("bounds: no body can meet them; leave some out")
    if len(conflicting) == 1:
        return InputError(f"bounds: no body that can exist has {conflicting[0].name}; widen it")
    named = f"{', '.join(g.name for g in conflicting[:-1])} and {conflicting[-1].name}"
    return InputError(f"bounds: {named} exclude each other; widen one of them")


def _feasible(problem: Conic, bounds: Sequence[Linear]) -> bool:
    try:
        return solve_conic(replace(problem, bounds=tuple(bounds))).violation < 1e-6
    except (Infeasible, EstimationError):
        return False
