"""Which two bodies have twelve given base parameters, and how light can they be? With proofs in exact arithmetic.

With pseudo-inertias P_i (4x4, positive semidefinite for bodies that can exist [Wensing2018]_) the base parameters
are ``p_k = sum_i <A_ik, P_i>`` and the least mass is a semidefinite programme with a dual:

    min  sum_i <E, P_i>   subject to  sum_i <A_ik, P_i> = p_k,  <Q_i, P_i> >= 0,  P_i >= 0
    max  p'y              subject to  Z_i = E - sum_k y_k A_ik - l_i Q_i >= 0,    l_i >= 0

E picks the mass out of P. Any y that the dual allows proves a lower bound: mass = p'y + sum <Z_i, P_i> + l_i <Q_i, P_i>.
Q_i, if asked for, keeps the mass of body i within a ball about its joint. Both sides are rounded to fractions and
checked without rounding errors, so neither bound rests on the solver.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cvxpy as cp
import numpy as np

from bayesid.robot import inertia

sys.path.append(str(Path(__file__).parents[2]))
from tests.example_robots import PAPER_ESTIMATE

PRINTED = [Fraction(repr(value)) for value in PAPER_ESTIMATE]  # the decimals as printed
A2 = Fraction("0.4318")  # length of the upper arm [m], Armstrong et al. 1986
HALF_DIGIT = Fraction(1, 20000)
_DIGITS = 10**9
# The ten parameters of joint 1's body, then of joint 2's.
_M, _MX, _MY, _MZ, _XX, _XY, _YY, _XZ, _YZ, _ZZ = range(10)
# The columns that each of the twelve can be solved for.
_PIVOTS = [_MX, _MZ, 10 + _MX, 10 + _MY, _XY, _YY, _YZ, 10 + _XY, 10 + _XZ, 10 + _YY, 10 + _YZ, 10 + _ZZ]
_E = np.diag([0, 0, 0, 1])


def _functionals() -> np.ndarray:
    """F (10, 4, 4) with ``parameter_k = <F_k, P>``: the inverse of the pseudo-inertia, in fractions."""
    f = np.full((10, 4, 4), Fraction(0), object)
    f[_M, 3, 3] = Fraction(1)
    for k, axis in ((_MX, 0), (_MY, 1), (_MZ, 2)):
        f[k, axis, 3] = f[k, 3, axis] = Fraction(1, 2)
    for k, (i, j) in {_XY: (0, 1), _XZ: (0, 2), _YZ: (1, 2)}.items():
        f[k, i, j] = f[k, j, i] = Fraction(-1, 2)
    for k, (i, j) in {_XX: (1, 2), _YY: (0, 2), _ZZ: (0, 1)}.items():
        f[k, i, i] = f[k, j, j] = Fraction(1)
    return f


FUNCTIONALS = _functionals()


@dataclass(frozen=True)
class Reading:
    """One way to read the paper's twelve symbols.

    Attributes
    ----------
    d2
        Offset of link 2 along the axis of joint 2 [m].
    elbow
        False: I2 is about the origin of a frame at joint 2, so alpha m2 is link 2's first moment there and a2 only
        says where r2x counts from. True: r2 and I2 both belong to a frame at the elbow, ``alpha m2 = (a2 + r2x) m2``.
    """

    d2: Fraction
    elbow: bool = False

    @property
    def matrix(self) -> np.ndarray:
        """(12, 20) fractions: from the two bodies' ten parameters to the twelve base parameters."""
        d2, b = self.d2, 10
        rows: list[dict[int, Fraction | int]] = [
            {_MX: 1},
            {_MZ: 1, b + _M: d2, b + _MZ: 1},
            {b + _MX: 1, b + _M: A2 if self.elbow else 0},
            {b + _MY: 1},
            {_XY: 1},
            {_YY: 1, b + _M: d2**2, b + _MZ: 2 * d2, b + _XX: 1},
            {_YZ: 1},
            {b + _XY: 1},
            {b + _XZ: 1},
            {b + _YY: 1, b + _XX: -1},
            {b + _YZ: 1},
            {b + _ZZ: 1},
        ]
        matrix = np.full((12, 20), Fraction(0), object)
        for row, entries in zip(matrix, rows, strict=True):
            for k, value in entries.items():
                row[k] = Fraction(value)
        return matrix

    def ball(self, body: int, radius: Fraction) -> np.ndarray:
        """Q (4, 4): <Q, P> >= 0 when no mass of the body is farther than `radius` [m] from its joint."""
        centre = np.array([-A2 if self.elbow and body else Fraction(0), Fraction(0), Fraction(0)])
        q = np.full((4, 4), Fraction(0), object)
        q[[0, 1, 2], [0, 1, 2]] = Fraction(-1)
        q[:3, 3] = q[3, :3] = centre
        q[3, 3] = radius**2 - centre @ centre
        return q


READINGS = {
    f"{'elbow' if elbow else 'joint 2'}, d2 = {d2}": Reading(Fraction(d2), elbow)
    for elbow in (False, True) for d2 in ("-0.2435", "0.2435")
}  # fmt: skip


@dataclass(frozen=True)
class LeastMass:
    """Proven bounds on the least moving mass.

    Attributes
    ----------
    lower, upper
        No bodies with these base parameters are lighter than `lower`; `bodies` weigh `upper` [kg].
    prices
        y (12,), by which `lower` is proven: kg per unit of each base parameter.
    ball_prices
        l (2,), the same for the balls [kg per kg m^2].
    bodies
        Pseudo-inertias (2, 4, 4), exact.
    """

    lower: Fraction
    upper: Fraction
    prices: np.ndarray
    ball_prices: np.ndarray
    bodies: np.ndarray

    @property
    def masses(self) -> list[float]:
        """Of the two bodies [kg]."""
        return [float(p[3, 3]) for p in self.bodies]


def is_positive(matrix: np.ndarray) -> bool:
    """Whether a symmetric matrix of fractions is positive semidefinite, by elimination without rounding."""
    rest = matrix.copy()
    while len(rest):
        pivot = rest[0, 0]
        if pivot < 0 or (pivot == 0 and any(rest[0])):
            return False
        rest = rest[1:, 1:] - (np.outer(rest[1:, 0], rest[0, 1:]) / pivot if pivot else 0)
    return True


def base_parameters(reading: Reading, bodies: np.ndarray) -> np.ndarray:
    """The twelve base parameters of pseudo-inertias (2, 4, 4), without rounding if they are fractions."""
    return reading.matrix @ np.array([np.sum(f * body) for body in bodies for f in FUNCTIONALS])


def slacks(reading: Reading, prices: np.ndarray, ball_prices: np.ndarray, radius: Fraction | None = None) -> np.ndarray:
    """Z (2, 4, 4): mass minus price of a point mass at x is ``[x, 1] Z_i [x, 1]'``."""
    out = []
    for i in range(2):
        value = prices @ reading.matrix[:, 10 * i : 10 * i + 10]
        out.append(_E - np.tensordot(value, FUNCTIONALS, 1) - (ball_prices[i] * reading.ball(i, radius) if radius else 0))
    return np.array(out)


def _kept(radius: Fraction | None) -> tuple[list[list[int]], list[int]]:
    """Axes of each body and rows of p that the least mass depends on.

    Spread of link 1 along y1, the axis of joint 1, is in none of the twelve. Without a ball it is free, lets I1xy and
    I1yz be anything at a cost of mass as small as one likes, and must be left out for both problems to have an interior.
    """
    if radius:
        return [[0, 1, 2, 3]] * 2, list(range(12))
    return [[0, 2, 3], [0, 1, 2, 3]], [k for k in range(12) if k not in (4, 6)]


class _Programme:
    """Both programmes in cvxpy, with everything strictly inside by `margin`."""

    def __init__(self, reading: Reading, printed, errors, radius: Fraction | None, margin: float, second: float | None = None):
        axes, rows = _kept(radius)
        matrix = reading.matrix.astype(float)
        p, e = np.array(printed, float)[rows], np.array(errors, float)[rows]
        f = FUNCTIONALS.astype(float)
        balls = [reading.ball(i, radius).astype(float) for i in range(2)] if radius else []
        self.bodies = [cp.Variable((len(a), len(a)), symmetric=True) for a in axes]
        whole = [np.eye(4)[:, a] @ body @ np.eye(4)[a] for a, body in zip(axes, self.bodies, strict=True)]
        values = matrix[rows] @ cp.hstack([cp.trace(fk @ body) for body in whole for fk in f])
        conditions = [body >> margin * np.eye(len(a)) for a, body in zip(axes, self.bodies, strict=True)]
        conditions += [cp.trace(q @ body) >= margin for q, body in zip(balls, whole, strict=False)]
        # Errors of zero as equations: two inequalities would leave no interior.
        conditions += [values[e == 0] == p[e == 0]] if (e == 0).any() else []
        conditions += [cp.abs(values[e > 0] - p[e > 0]) <= e[e > 0] * (1 - margin)] if (e > 0).any() else []
        conditions += [] if second is None else [whole[1][3, 3] == second]
        self.masses = [body[3, 3] for body in whole]
        self.conditions, self.whole = conditions, whole
        self.primal = cp.Problem(cp.Minimize(sum(self.masses)), conditions)

        self.prices, self.ball_prices = cp.Variable(12), cp.Variable(2, nonneg=True)
        out = [k for k in range(12) if k not in rows]
        conditions = [self.prices[out] == 0] if out else []
        for i, a in enumerate(axes):
            value = self.prices @ matrix[:, 10 * i : 10 * i + 10]
            z = _E - sum(value[k] * f[k] for k in range(10))
            if radius:
                z = z - self.ball_prices[i] * balls[i]
            conditions.append(z[np.ix_(a, a)] >> margin * np.eye(len(a)))
        gain = np.array(printed, float) @ self.prices - np.array(errors, float) @ cp.abs(self.prices)
        self.dual = cp.Problem(cp.Maximize(gain), conditions)


def solve(problem: cp.Problem) -> bool:
    """Solve to the solver's full accuracy; whether an optimum was found."""
    with warnings.catch_warnings():
        # Infeasible cases at the edge come as "inaccurate": they are reported as not solved.
        warnings.simplefilter("ignore", UserWarning)
        problem.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    return problem.status in ("optimal", "optimal_inaccurate")


def lightest(reading: Reading, printed=PRINTED, radius: Fraction | None = None, second: float | None = None) -> float | None:
    """Least moving mass [kg] by the solver alone, optionally with the mass of link 2 given; None if there is none."""
    programme = _Programme(reading, printed, [Fraction(0)] * 12, radius, 0.0, second)
    return float(programme.primal.value) if solve(programme.primal) else None


def range_of_link_2(reading: Reading, printed=PRINTED) -> tuple[float | None, float | None]:
    """Least and greatest mass of link 2 [kg] by the solver; None: no limit."""
    programme = _Programme(reading, printed, [Fraction(0)] * 12, None, 0.0)
    out = []
    for sign in (1, -1):
        problem = cp.Problem(cp.Minimize(sign * programme.masses[1]), programme.conditions)
        out.append(sign * float(problem.value) if solve(problem) else None)
    return out[0], out[1]


def _fractions(values: np.ndarray) -> np.ndarray:
    """The nearest fractions with nine decimals."""
    flat = [Fraction(round(float(v) * _DIGITS), _DIGITS) for v in np.ravel(values)]
    return np.array(flat, object).reshape(np.shape(values))


def least_mass(
    reading: Reading, printed=PRINTED, errors=(Fraction(0),) * 12, radius: Fraction | None = None, margin: float = 1e-6
) -> LeastMass:
    """Least moving mass of bodies with these base parameters, proven from both sides.

    Parameters
    ----------
    reading
        How the symbols are read.
    printed, errors
        Base parameters (12,) and by how much each may differ, as fractions.
    radius
        Of the balls about the joints that hold the links' mass [m]; None: anywhere.
    margin
        Distance of both solutions from the boundary, so that rounding leaves them possible.

    Raises
    ------
    RuntimeError
        A proof failed: there are no such bodies, or `margin` does not fit.
    """
    programme = _Programme(reading, printed, errors, radius, margin)
    if not (solve(programme.primal) and solve(programme.dual)):
        raise RuntimeError("no bodies with these base parameters were found")
    prices = _fractions(programme.prices.value)
    ball_prices = np.maximum(_fractions(programme.ball_prices.value if radius else np.zeros(2)), Fraction(0))
    prices[[k for k in range(12) if k not in _kept(radius)[1]]] = Fraction(0)
    if not all(is_positive(z) for z in slacks(reading, prices, ball_prices, radius)):
        raise RuntimeError("the prices prove nothing; raise the margin")
    lower = sum(p * y - e * abs(y) for p, e, y in zip(printed, errors, prices, strict=True))
    bodies = _exact_bodies(reading, printed, errors, programme.whole, radius)
    if not all(is_positive(body) for body in bodies):
        raise RuntimeError("the bodies cannot exist; raise the margin")
    if radius and any(np.sum(reading.ball(i, radius) * body) < 0 for i, body in enumerate(bodies)):
        raise RuntimeError("the bodies leave their balls; raise the margin")
    return LeastMass(lower, bodies[0][3, 3] + bodies[1][3, 3], prices, ball_prices, bodies)


def _exact_bodies(reading: Reading, printed, errors, whole, radius: Fraction | None) -> np.ndarray:
    """Bodies (2, 4, 4) near the solver's that have the base parameters exactly."""
    near = [body.value for body in whole]
    target = np.array(printed, object)
    if any(errors):
        found = _fractions(base_parameters(reading, np.array(near)))
        target = np.array([min(max(v, p - e), p + e) for v, p, e in zip(found, printed, errors, strict=True)], object)
    if not radius:
        # Spread along y1 that carries I1xy and I1yz: Schur complement of the block that the programme saw.
        first, side = near[0].copy(), np.array([-float(target[4]), -float(target[6]), 0.0])
        first[1, 1] = 2 * side @ np.linalg.solve(first[np.ix_([0, 2, 3], [0, 2, 3])], side)
        near[0] = first
    parameters = _fractions(np.array([inertia.from_pseudo_inertia(body) for body in near]).ravel())
    matrix = reading.matrix
    parameters[_PIVOTS] = Fraction(0)
    parameters[_PIVOTS] = target - matrix @ parameters
    basis = np.array([[[Fraction(float(v)) for v in row] for row in b] for b in inertia.BASIS], object)
    return np.array([np.tensordot(part, basis, 1) for part in parameters.reshape(2, 10)])


def second_moments(printed: np.ndarray, d2: float) -> np.ndarray:
    """Q (3, 3) [kg m^2]: the printed numbers are possible if Q > 0 and only if Q >= 0 (frame at joint 2).

    Q is link 2's second moment of mass about the shoulder in P1's axes at q2 = 0, with all of the sixth parameter that
    link 1 might claim left to link 2. If it is positive definite, masses large enough provide any first moments.
    """
    _, _, p3, p4, _, p6, _, p8, p9, p10, p11, p12 = printed
    xz, yz = d2 * p3 - p9, d2 * p4 - p11
    return np.array([[(p12 + p10) / 2, -p8, xz], [-p8, (p12 - p10) / 2, yz], [xz, yz, p6 - (p12 - p10) / 2]])
