"""The conic problem solved by Clarabel, and moved inside the constraints as far as its certificate gains from it."""

from __future__ import annotations

from collections.abc import Iterator

import clarabel
import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csc_matrix

from bayesid.errors import EstimationError
from bayesid.estimators.conic.problem import LARGEST_GAP, MARGIN, Conic, Solution, pack, parts, solution_at, violation
from bayesid.robot import inertia

# Better than a tenth of what is allowed: then rounding on another machine cannot make the difference.
_SURE = 0.1
#: Solutions that violate a constraint by more than that share of what is allowed are moved inside, see `_inward`: towards the
#: solution of the problem with all constraints this much tighter.
_ROOM = 10.0 * MARGIN


class Infeasible(Exception):
    """No parameters meet all constraints."""


def solve_conic(problem: Conic) -> Solution:
    """The minimiser, with its certificate.

    `Infeasible` where no parameters meet all constraints, and an `EstimationError` where the solver stopped without a solution
    whose certificate holds.
    """
    matrix, low, cones = problem.constraints()
    if violation(problem, matrix @ problem.centre - low) <= 0.0:
        return solution_at(problem, matrix, low, problem.centre, np.zeros(len(low)), 0)
    return _inward(problem, matrix, low, cones, _minimum(problem, matrix, low, cones))


def _minimum(problem: Conic, matrix: np.ndarray, low: np.ndarray, cones: list) -> Solution:
    """By Clarabel; the first of its solutions whose certificate holds with plenty to spare, else the best."""
    slack = matrix @ problem.centre - low
    # In u = C (x - m) the objective is 1/2 ||u||^2 whatever the data, and only constraints are left to be scaled: each
    # cone by one positive number. Squaring C, or scaling columns alone, costs half the digits.
    whitened = solve_triangular(problem.factor, matrix.T, trans=1).T
    _, bodies = parts(problem)
    scale = np.linalg.norm(whitened, axis=1)
    scale[bodies] = np.repeat(np.linalg.norm(scale[bodies].reshape(-1, 10), axis=1), 10)
    scale = 1.0 / np.where(scale > 0, scale, 1.0)
    n = len(problem.centre)
    objective, rows = csc_matrix(np.eye(n)), csc_matrix(-whitened * scale[:, None])
    tries: list[Solution] = []
    for settings in _settings():
        found = clarabel.DefaultSolver(objective, np.zeros(n), rows, slack * scale, cones, settings).solve()
        if found.status in (clarabel.SolverStatus.PrimalInfeasible, clarabel.SolverStatus.AlmostPrimalInfeasible):
            if problem.bounds:
                raise Infeasible
            continue  # without bounds there are always bodies: the solver gave up
        x = problem.centre + solve_triangular(problem.factor, np.array(found.x))
        if np.isfinite(x).all():
            tries.append(solution_at(problem, matrix, low, x, np.array(found.z) * scale, found.iterations))
            if _quality(tries[-1]) <= _SURE:
                return tries[-1]
    if tries:
        # Any multipliers give a lower bound: the highest one may go with a point from another try.
        z = max(tries, key=lambda t: t.bound).multipliers
        tries += [solution_at(problem, matrix, low, t.x, z, t.iterations) for t in tries]
    best = min(tries, key=_quality, default=None)
    if best is None or not _quality(best) < 1e3:
        raise EstimationError("the conic solver found no physical solution; check units and the conditioning of the motion")
    return best


def _inward(problem: Conic, matrix: np.ndarray, low: np.ndarray, cones: list, found: Solution) -> Solution:
    """The solution, moved towards the inside as far as its certificate gains from it.

    An interior-point method stops beside the boundary, on either side. Bodies are moved to the nearest ones that are
    inside: that costs little where the violated constraints hardly push. Where linear bounds do not allow it, the way is
    towards a point y with room on every side: at ``x + t (y - x)`` with ``t = v / (v + room of y)`` the violation v of x is
    gone, for the least eigenvalue is concave. The minimiser of the tightened problem is such a point, and costs little:
    by convexity the objective grows by no more than t times the difference. Of these, and of parts of the way, the best
    certificate counts.
    """
    if found.violation <= _SURE * MARGIN:
        return found

    def certified(x: np.ndarray) -> Solution:
        return solution_at(problem, matrix, low, x, found.multipliers, found.iterations)

    best = min(found, certified(_clipped(problem, found.x)), key=_quality)
    if _quality(best) <= _SURE:
        return best
    tight = low.copy()
    bounds, bodies = parts(problem)
    tight[bounds] += _ROOM
    tight[bodies] += np.tile(pack(_ROOM * np.eye(4)), len(problem.bodies))
    try:
        inside = _minimum(problem, matrix, tight, cones).x
    except (Infeasible, EstimationError):
        return best  # bounds that leave no room, such as an exact mass
    room = -violation(problem, matrix @ inside - low)
    if room <= 0.0:
        return best
    way = best.violation / (best.violation + room) * (inside - best.x)
    return min(best, *(certified(best.x + part * way) for part in (1.0, 0.5, 0.25, 0.1, 0.03)), key=_quality)


def _clipped(problem: Conic, x: np.ndarray) -> np.ndarray:
    """With negative eigenvalues of the scaled pseudo-inertias raised to zero."""
    out = x.copy()
    values, vectors = np.linalg.eigh(problem.pseudo_inertias(x))
    raised = (vectors * np.maximum(-values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    back = np.linalg.cholesky(problem.references)
    for columns, change in zip(problem.bodies, back @ raised @ np.swapaxes(back, 1, 2), strict=True):
        out[list(columns)] += inertia.from_pseudo_inertia(change)
    return out


def _quality(solution: Solution) -> float:
    """How far a certificate is from being accepted; at most 1 when it is."""
    return max(abs(solution.gap) / LARGEST_GAP, solution.violation / MARGIN, solution.stationarity / 1e-6)


def _settings() -> Iterator[clarabel.DefaultSettings]:
    """First the usual way, then with other accuracy, regularisation and scaling for the few problems that stall."""
    for tolerance, static, scaled in (
        (1e-11, 1e-8, False), (1e-9, 1e-7, False), (1e-12, 1e-10, False), (1e-13, 1e-12, False), (1e-10, 1e-6, False),
        (1e-9, 1e-7, True),
    ):  # fmt: skip
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.equilibrate_enable = scaled
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        settings.static_regularization_constant = static
        yield settings
