"""Least squares over bodies that can exist, as a conic problem, and the certificate of its solution.

Everything that data and prior say is one triangular factor C and its minimiser m; what remains is

    min 1/2 ||C (x - m)||^2   subject to   P_i(x) >= eps S_i for every body i,   G x >= h,

with x the link parameters, then the effects; P_i the pseudo-inertia [Wensing2018]_, linear in x; S_i that of a reference
body; and G x >= h the bounds. The dual of the problem is in closed form,
so a pair (x, z) certifies itself: no solver has to be trusted. With K the cone of the constraints ``B x - c``,

    d(z) = z'(c - B m) - 1/2 ||C^-T B' z||^2   <=   optimum   <=   1/2 ||C (x - m)||^2   for z in K*, B x - c in K,

and by strong convexity ``||C (x - x*)||^2 <= 2 gap``: the gap bounds the error in units of the standard deviation.

With the entropic distance to the nominal links in place of the prior's (`solve_entropic`), ``D(P || P0) = tr(P0^-1 P) -
log det(P0^-1 P) - 4`` for each link, weighted with 1 / s^2 [Lee2020]_, s means the same: the constant pull-back metric is its
second-order expansion. The logarithm keeps every link off the boundary by itself. The sum of a quadratic and ``-log det`` is
self-concordant, so the Newton decrement at a point bounds how far its value is from the optimum [Nesterov1994]_: that is the
lower bound there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import clarabel
import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.sparse import csc_matrix

from bayesid.errors import EstimationError
from bayesid.robot import inertia

#: Every pseudo-inertia is kept this far inside, relative to the body's size: solvers stop within about 1e-9 of the
#: boundary on either side, and simulators refuse bodies on the wrong one.
MARGIN = 1e-7
#: Solutions whose own certificate has a larger gap are refused.
LARGEST_GAP = 1e-8
# Clarabel's order of a symmetric 4 x 4: upper triangle by columns, off the diagonal times sqrt 2.
_UP, _RIGHT = np.array([(i, j) for j in range(4) for i in range(j + 1)]).T
_ROOT = np.where(_UP == _RIGHT, 1.0, np.sqrt(2.0))


@dataclass(frozen=True)
class Linear:
    """A named group of bounds ``matrix @ x >= low``."""

    name: str  # what a person calls it, with its numbers
    #: (k, n), (k,).
    matrix: np.ndarray
    low: np.ndarray


@dataclass(frozen=True)
class Conic:
    """The conic problem of an estimate."""

    factor: np.ndarray  # C, (n, n), upper triangular and regular
    centre: np.ndarray  # m, where the objective is zero (n,)
    bodies: tuple[tuple[int, ...], ...]  # columns of every body's ten parameters, in `bayesid.robot.inertia.PARAMETERS`' order
    #: Pseudo-inertias S_i that bodies are measured with, such as the nominal ones (b, 4, 4), positive definite.
    references: np.ndarray
    bounds: tuple[Linear, ...] = ()  # linear bounds
    margin: float = MARGIN  # eps; see `MARGIN`
    room: float = 0.0  # by how much all scaled constraints are tighter than that

    @cached_property
    def congruences(self) -> np.ndarray:
        """Inverse roots T of the references, ``T S T' = 1`` (b, 4, 4)."""
        return np.linalg.inv(np.linalg.cholesky(self.references))

    @cached_property
    def units(self) -> np.ndarray:
        """Size of every parameter: those of the reference, one for effects (n,)."""
        out = np.ones(len(self.centre))
        for columns, reference in zip(self.bodies, self.references, strict=True):
            mass, radius = reference[3, 3], np.sqrt(np.trace(reference[:3, :3]) / 3.0 / reference[3, 3])
            out[list(columns)] = mass * np.array([1.0] + [radius] * 3 + [radius**2] * 6)
        return out

    @cached_property
    def linear(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrix (k, n) and lower limits (k,) of all bounds."""
        matrix = np.concatenate([np.zeros((0, len(self.centre))), *(b.matrix for b in self.bounds)])
        return matrix, np.concatenate([np.zeros(0), *(b.low for b in self.bounds)])

    def pseudo_inertias(self, x: np.ndarray) -> np.ndarray:
        """Relative to the reference, less the margin (b, 4, 4): they have to be positive semidefinite."""
        bodies = np.array([inertia.pseudo_inertia(x[list(columns)]) for columns in self.bodies]).reshape(-1, 4, 4)
        return self.congruences @ bodies @ np.swapaxes(self.congruences, 1, 2) - self.margin * np.eye(4)

    @cached_property
    def constraints(self) -> tuple[np.ndarray, np.ndarray, list]:
        """B (k, n), c (k,) and Clarabel's cones with ``B x - c`` in them.

        Bounds are divided by the length of their row in units of the reference: all constraints are then of order one.
        """
        matrix, level = self.linear
        size = np.maximum(np.linalg.norm(matrix * self.units, axis=1), np.abs(level) * 1e-3)
        size[size == 0] = 1.0
        rows, low = [matrix / size[:, None]], [level / size + self.room]
        cones: list[Any] = [clarabel.NonnegativeConeT(len(level))] if len(level) else []
        for columns, root in zip(self.bodies, self.congruences, strict=True):
            block = np.zeros((10, len(self.centre)))
            block[:, list(columns)] = pack(root @ inertia.BASIS @ root.T).T
            rows.append(block)
            low.append(pack((self.margin + self.room) * np.eye(4)))
            cones.append(clarabel.PSDTriangleConeT(4))
        return np.concatenate(rows), np.concatenate(low), cones

    @property
    def parts(self) -> tuple[slice, slice]:
        """Indices of bounds and bodies among the constraints."""
        a = sum(len(b.low) for b in self.bounds)
        return slice(0, a), slice(a, a + 10 * len(self.bodies))

    def slack(self, x: np.ndarray) -> np.ndarray:
        """``B x - c`` (k,)."""
        matrix, low, _ = self.constraints
        return matrix @ x - low

    def violation(self, x: np.ndarray) -> float:
        """Largest violation of the scaled constraints; at most 0 when all hold."""
        slack, (bounds, bodies) = self.slack(x), self.parts
        worst = [-np.inf, *(-slack[bounds])]
        if self.bodies:
            worst.append(-np.linalg.eigvalsh(unpack(slack[bodies].reshape(-1, 10))).min())
        return float(max(worst))


def pack(symmetric: np.ndarray) -> np.ndarray:
    """Symmetric (..., 4, 4) to (..., 10) with the same inner product, in Clarabel's order."""
    return symmetric[..., _UP, _RIGHT] * _ROOT


def unpack(packed: np.ndarray) -> np.ndarray:
    """The inverse of `pack`."""
    out = np.zeros(packed.shape[:-1] + (4, 4))
    out[..., _UP, _RIGHT] = out[..., _RIGHT, _UP] = packed / _ROOT
    return out


def project_dual(problem: Conic, z: np.ndarray) -> np.ndarray:
    """Nearest multipliers in the dual cone (both cones are their own dual)."""
    bounds, bodies = problem.parts
    out = z.copy()
    out[bounds] = np.maximum(z[bounds], 0.0)
    values, vectors = np.linalg.eigh(unpack(z[bodies].reshape(-1, 10)))
    out[bodies] = pack((vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)).ravel()
    return out


@dataclass(frozen=True)
class Solution:
    """A point, its multipliers and what they certify."""

    x: np.ndarray  # (n,)
    multipliers: np.ndarray  # z of the scaled constraints, projected onto the dual cone (k,)
    #: 1/2 ||C (x - m)||^2, and the lower bound d(z) on what any feasible point has.
    objective: float
    bound: float
    violation: float  # largest violation of a scaled constraint (relative to the body's size), 0 inside
    stationarity: float  # ||C (x - m) - C^-T B' z||, in standard deviations, relative to 1 + ||C (x - m)||
    complementarity: float  # z'(B x - c), relative to 1 + objective
    eigenvalues: np.ndarray  # of the scaled pseudo-inertias, margin included (b, 4)
    ranks: np.ndarray  # of the pseudo-inertias; below 4: the body is on the boundary of those that can exist (b,)
    active: tuple[str, ...]  # names of the bounds that hold with equality and push
    iterations: int  # of the interior-point method; 0: the unconstrained minimiser is inside

    @property
    def gap(self) -> float:
        """Relative duality gap: (objective - bound) / (1 + objective)."""
        return (self.objective - self.bound) / (1.0 + self.objective)

    @property
    def certified(self) -> bool:
        """Whether gap, violation and stationarity are below `LARGEST_GAP`, `MARGIN` and 1e-6."""
        return abs(self.gap) <= LARGEST_GAP and self.violation <= MARGIN and self.stationarity <= 1e-6


def solution_at(problem: Conic, x: np.ndarray, z: np.ndarray, iterations: int) -> Solution:
    """Residuals from the problem itself; nothing of the solver's own account is used."""
    z = project_dual(problem, z)
    (matrix, low, _), slack = problem.constraints, problem.slack(x)
    away = problem.factor @ (x - problem.centre)
    pull = solve_triangular(problem.factor, matrix.T @ z, trans=1)
    objective = 0.5 * float(away @ away)
    bound = float(z @ (low - matrix @ problem.centre)) - 0.5 * float(pull @ pull)
    margins = problem.pseudo_inertias(x)
    inside = np.linalg.eigvalsh(margins)
    pushed = np.linalg.eigvalsh(unpack(z[problem.parts[1]].reshape(-1, 10)))[:, ::-1]
    # On the boundary: the constraint pushes in a direction in which the body has next to no extent.
    ranks = 4 - np.count_nonzero((pushed > np.maximum(inside, 0.0)) & (inside < 1e-3), axis=1)
    return Solution(
        x=x,
        multipliers=z,
        objective=objective,
        bound=bound,
        violation=max(problem.violation(x), 0.0),
        stationarity=float(np.linalg.norm(away - pull) / (1.0 + np.linalg.norm(away))),
        complementarity=float(z @ slack) / (1.0 + objective),
        eigenvalues=inside + problem.margin,
        ranks=ranks,
        active=active_bounds(problem.bounds, slack, z),
        iterations=iterations,
    )


def active_bounds(bounds: Sequence[Linear], slack: np.ndarray, z: np.ndarray) -> tuple[str, ...]:
    """Names of the bounds that hold the optimum back: a multiplier z above the slack, one number a row of each."""
    out, start = [], 0
    for group in bounds:
        part = slice(start, start := start + len(group.low))
        if (z[part] > np.maximum(slack[part], 1e-9)).any():
            out.append(group.name)
    return tuple(out)


# Better than a tenth of what is allowed: then rounding on another machine cannot make the difference.
_SURE = 0.1
#: Solutions that violate a constraint by more than that share of what is allowed are moved inside, see `_inward`: towards the
#: solution of the problem with all constraints this much tighter.
_ROOM = 10.0 * MARGIN


class Infeasible(Exception):
    """No parameters meet all constraints."""


class Unsolved(EstimationError):
    """No point was found whose certificate holds; multipliers alone still give a lower bound on what any feasible one has."""

    def __init__(self, bound: float) -> None:
        super().__init__("the conic solver found no physical solution; check units and the conditioning of the motion")
        self.bound = bound  # of 1/2 ||C (x - m)||^2


def solve_conic(problem: Conic) -> Solution:
    """The minimiser, with its certificate.

    `Infeasible` where no parameters meet all constraints, and `Unsolved` where the solver stopped without a solution whose
    certificate holds.
    """
    if problem.violation(problem.centre) <= 0.0:
        return solution_at(problem, problem.centre, np.zeros(problem.parts[1].stop), 0)
    return _inward(problem, _minimum(problem))


def _minimum(problem: Conic) -> Solution:
    """The minimum by Clarabel; the first of its solutions whose certificate holds with plenty to spare, else the best."""
    (matrix, _, cones), slack = problem.constraints, problem.slack(problem.centre)
    # In u = C (x - m) the objective is 1/2 ||u||^2 whatever the data, and only constraints are left to be scaled: each
    # cone by one positive number. Squaring C, or scaling columns alone, costs half the digits.
    whitened = solve_triangular(problem.factor, matrix.T, trans=1).T
    _, bodies = problem.parts
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
            tries.append(solution_at(problem, x, np.array(found.z) * scale, found.iterations))
            if _quality(tries[-1]) <= _SURE:
                return tries[-1]
    if tries:
        # Any multipliers give a lower bound: the highest one may go with a point from another try.
        z = max(tries, key=lambda t: t.bound).multipliers
        tries += [solution_at(problem, t.x, z, t.iterations) for t in tries]
    best = min(tries, key=_quality, default=None)
    if best is None or not _quality(best) < 1e3:
        raise Unsolved(max((t.bound for t in tries), default=0.0))
    return best


def _inward(problem: Conic, found: Solution) -> Solution:
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
        return solution_at(problem, x, found.multipliers, found.iterations)

    best = min(found, certified(_clipped(problem, found.x)), key=_quality)
    if _quality(best) <= _SURE:
        return best
    try:
        inside = _minimum(replace(problem, room=_ROOM)).x
    except (Infeasible, EstimationError):
        return best  # bounds that leave no room, such as an exact mass
    room = -problem.violation(inside)
    if room <= 0.0:
        return best
    way = best.violation / (best.violation + room) * (inside - best.x)
    return min(best, *(certified(best.x + part * way) for part in (1.0, 0.5, 0.25, 0.1, 0.03)), key=_quality)


def _clipped(problem: Conic, x: np.ndarray) -> np.ndarray:
    """The parameters with negative eigenvalues of the scaled pseudo-inertias raised to zero."""
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


_NEWTON_STEPS = 60


def solve_entropic(problem: Conic, matrix: np.ndarray, target: np.ndarray, rel_std: float) -> Solution:
    """Minimise ``1/2 ||A x - t||^2 + sum D_i / s^2``, A (k, n), t (k,), under the problem's linear bounds.

    References are P0; the problem's factor and centre are those of the quadratic expansion. `Infeasible` where no parameters
    meet the bounds, and an `EstimationError` where the solver found nothing.
    """
    weight = 1.0 / rel_std**2
    rows, low = problem.linear
    size = np.linalg.norm(rows * problem.units, axis=1)
    rows, low = rows / size[:, None], low / size
    bases = [root @ inertia.BASIS @ root.T for root in problem.congruences]

    def bodies(x: np.ndarray) -> np.ndarray:
        each = [np.tensordot(x[list(c)], b, 1) for c, b in zip(problem.bodies, bases, strict=True)]
        return np.array(each)

    def value(x: np.ndarray) -> float:
        pseudo = bodies(x)
        if np.linalg.eigvalsh(pseudo).min() <= 0:
            return np.inf
        divergence = np.trace(pseudo, axis1=1, axis2=2) - np.linalg.slogdet(pseudo)[1] - 4.0
        return float(0.5 * np.sum((matrix @ x - target) ** 2) + weight * divergence.sum())

    def slopes(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gradient, hessian = matrix.T @ (matrix @ x - target) - rows.T @ z, matrix.T @ matrix
        for columns, basis, pseudo in zip(problem.bodies, bases, bodies(x), strict=True):
            inverse = np.linalg.inv(pseudo)
            product = inverse @ basis
            gradient[list(columns)] += weight * (np.trace(basis, axis1=1, axis2=2) - np.trace(product, axis1=1, axis2=2))
            hessian[np.ix_(columns, columns)] += weight * np.einsum("kij,lji->kl", product, product)
        return gradient, hessian

    if problem.bounds:
        x, z = _by_exponential_cone(problem, matrix, target, weight, bases, rows, low)
    else:
        x, z = np.zeros(len(problem.centre)), np.zeros(0)
        for columns, reference in zip(problem.bodies, problem.references, strict=True):
            x[list(columns)] = inertia.from_pseudo_inertia(reference)
    # Newton's method on the Lagrangian, with multipliers that keep active bounds equal: from anywhere without bounds, as a
    # polish with them.
    units, steps = problem.units, 0
    active = z > np.maximum(rows @ x - low, 1e-9)
    while steps < _NEWTON_STEPS:
        steps += 1
        gradient, hessian = slopes(x, np.zeros(len(rows)))
        factor = cho_factor(hessian * np.outer(units, units) + 1e-15 * np.diag(np.diag(hessian) * units**2))
        z = np.zeros(len(rows))
        if active.any():
            held = rows[active] * units
            back = cho_solve(factor, held.T)
            z[active] = np.linalg.lstsq(held @ back, back.T @ (units * gradient) - (rows @ x - low)[active], rcond=1e-12)[0]
        gradient = gradient - rows.T @ z
        step = -units * cho_solve(factor, units * gradient)
        decrement = float(max(-gradient @ step, 0.0))
        if decrement < 1e-18:
            slack = np.where(active, 0.0, rows @ x - low)
            if active.any() and z.min() < 0.0:
                active[np.argmin(z)] = False  # it pulls instead of pushing
            elif slack.min(initial=0.0) < 0.0:
                active[np.argmin(slack)] = True
            else:
                break
            continue
        length, here = 1.0, value(x) - z @ (rows @ x)
        while length > 1e-10 and not value(x + length * step) - z @ (rows @ (x + length * step)) <= here:
            length /= 2.0
        if length <= 1e-10:
            break
        x = x + length * step
    # The certificate is about these multipliers, none of which may be negative.
    z = np.maximum(z, 0.0)
    gradient, hessian = slopes(x, z)
    factor = cho_factor(hessian * np.outer(units, units) + 1e-15 * np.diag(np.diag(hessian) * units**2))
    decrement = float(max((units * gradient) @ cho_solve(factor, units * gradient), 0.0))
    slack = rows @ x - low
    objective = value(x)
    values = np.linalg.eigvalsh(bodies(x))
    # The theorem needs a decrement below 0.68 in the function scaled to self-concordance.
    if not decrement / min(weight, 1.0) < 0.4:
        raise EstimationError("the entropic problem was not solved to an accuracy that can be certified; try metric pullback")
    return Solution(
        x=x,
        multipliers=z,
        objective=objective,
        bound=objective - float(z @ slack) - decrement,
        violation=float(max(-slack.min(initial=0.0), -values.min(), 0.0)),
        stationarity=float(np.sqrt(decrement)),
        complementarity=float(z @ slack) / (1.0 + objective),
        eigenvalues=values,
        ranks=np.full(len(values), 4),
        active=active_bounds(problem.bounds, slack, z),
        iterations=steps,
    )


def _by_exponential_cone(problem: Conic, matrix, target, weight, bases, rows, low) -> tuple[np.ndarray, np.ndarray]:
    """Point and multipliers by the exponential cone."""
    import cvxpy as cp  # a third of a second, which no other estimator needs

    y = cp.Variable(len(problem.centre))
    cost = 0.5 * cp.sum_squares((matrix * problem.units) @ y - target)
    for columns, basis in zip(problem.bodies, bases, strict=True):
        scaled = basis * problem.units[list(columns)][:, None, None]
        pseudo = cp.reshape(scaled.reshape(10, 16).T @ y[list(columns)], (4, 4), order="C")
        cost += weight * (cp.trace(pseudo) - cp.log_det(0.5 * (pseudo + pseudo.T)))
    rule = (rows * problem.units) @ y >= low
    task = cp.Problem(cp.Minimize(cost), [rule])
    try:
        task.solve(solver=cp.CLARABEL)
    except cp.SolverError as error:
        raise EstimationError(f"the entropic problem was not solved ({error}); try metric pullback") from None
    if task.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        raise Infeasible
    if y.value is None or rule.dual_value is None:
        raise EstimationError("the entropic problem was not solved; try metric pullback")
    return problem.units * y.value, np.maximum(rule.dual_value, 0.0)


def nearest_body(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The body that can exist nearest to ten parameters (10,), in the metric of their covariance (10, 10).

    The set of possible bodies is convex and holds the truth. So the projection onto it, in the metric of the covariance, is
    no farther from the truth than the estimate, and regions about it hold the truth no less often.
    """
    if inertia.is_physically_consistent(mean, 0.0):
        return mean
    size = np.sqrt(np.diag(covariance))
    spread, axes = np.linalg.eigh(covariance / np.outer(size, size))
    factor = np.asarray(np.linalg.qr((axes / np.sqrt(np.maximum(spread, 1e-12 * spread[-1]))).T / size, mode="r"))
    around = np.maximum(mean, [size[0], *(-np.inf,) * 9])  # constraints are scaled by a body that the data do not exclude
    return solve_conic(Conic(factor, mean, (tuple(range(10)),), inertia.solid(around)[None])).x
