"""The entropic distance to the nominal links, with its certificate.

``D(P || P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4`` for each link, weighted with 1 / s^2 [Lee2020]_: the constant
pull-back metric is its second-order expansion, so s means the same. The logarithm keeps every link off the boundary by
itself. The sum of a quadratic and ``-log det`` is self-concordant, so the Newton decrement at a point bounds how far its
value is from the optimum [Nesterov1994]_: that is the lower bound here.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayesid.errors import EstimationError
from bayesid.estimators.conic.problem import Conic, Infeasible, Solution, active_bounds
from bayesid.robot import inertia

_STEPS = 60


def solve_entropic(problem: Conic, matrix: np.ndarray, target: np.ndarray, rel_std: float) -> Solution:
    """Minimise ``1/2 ||A x - t||^2 + sum D_i / s^2``, A (k, n), t (k,), under the problem's linear bounds.

    References are P0; the problem's factor and centre are those of the quadratic expansion. `Infeasible` where no parameters
    meet the bounds, and an `EstimationError` where the solver found nothing.
    """
    weight = 1.0 / rel_std**2
    rows = np.concatenate([b.matrix for b in problem.bounds]) if problem.bounds else np.zeros((0, len(problem.centre)))
    low = np.concatenate([b.low for b in problem.bounds]) if problem.bounds else np.zeros(0)
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
        x, z = _with_bounds(problem, matrix, target, weight, bases, rows, low)
    else:
        x, z = np.zeros(len(problem.centre)), np.zeros(0)
        for columns, reference in zip(problem.bodies, problem.references, strict=True):
            x[list(columns)] = inertia.from_pseudo_inertia(reference)
    # Newton's method on the Lagrangian, with multipliers that keep active bounds equal: from anywhere without bounds, as a
    # polish with them.
    units, steps = problem.units, 0
    active = z > np.maximum(rows @ x - low, 1e-9)
    while steps < _STEPS:
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


def _with_bounds(problem: Conic, matrix, target, weight, bases, rows, low) -> tuple[np.ndarray, np.ndarray]:
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
