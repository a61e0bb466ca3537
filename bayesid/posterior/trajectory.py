"""Exact Hamiltonian trajectories of a Gaussian that bounce off linear and semidefinite walls [Pakman2014]_.

Under a Gaussian with mean m and covariance C, with velocities drawn from N(0, C), the motion is known exactly,

    x(t) = m + (x - m) cos t + v sin t,

so there is no step size and nothing is rejected. Walls are ``x_j >= 0`` and ``P_i(x) >= 0``, one symmetric 4x4
matrix a body, whose ten entries are coordinates themselves. With ``u = tan(t / 2)``,

    (1 + u^2) P(t) = (P_m + P_a) + 2 u P_v + u^2 (P_m - P_a),

whose determinant is a polynomial of degree eight in u; its first root in (0, tan(T / 2)] is the next wall
[Chalkis2022]_. Bernstein coefficients isolate it: no sign change, no root; one sign change, one root. At a wall with
normal ``g = d lambda_min / dx`` the velocity is reflected in the metric of C, ``v - 2 (g'v) / (g'Cg) C g``.
"""

from __future__ import annotations

from math import comb

import numba
import numpy as np

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")

#: Where the ten entries of a symmetric 4x4 matrix sit.
ROW = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 3])
COLUMN = np.array([0, 1, 2, 3, 1, 2, 3, 2, 3, 3])
#: More bounces than this in one trajectory: it is given up.
MOST_BOUNCES = 5000
_DEGREE = 8
_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)
_TO_BERNSTEIN = np.linalg.inv(
    np.array([[comb(_DEGREE, k) * u**k * (1 - u) ** (_DEGREE - k) for k in range(_DEGREE + 1)] for u in _NODES])
)


@_jit
def _pivots(entries, out):
    """Pivots of a symmetric 4x4 matrix (10 entries) without pivoting; their product is the determinant.

    Returns False as soon as one is not positive: then the matrix is not positive definite.
    """
    a, b, c, d, e, f, g, h, i, j = entries
    out[0] = a
    if a <= 0.0:
        return False
    p, q, r = b / a, c / a, d / a
    e, f, g, h, i, j = e - p * b, f - p * c, g - p * d, h - q * c, i - q * d, j - r * d
    out[1] = e
    if e <= 0.0:
        return False
    p, q = f / e, g / e
    h, i, j = h - p * f, i - p * g, j - q * g
    out[2] = h
    if h <= 0.0:
        return False
    out[3] = j - i * i / h
    return out[3] > 0.0


@_jit
def _determinant(a, b, c, d, e, f, g, h, i, j):
    """Determinant of the symmetric matrix [[a b c d], [b e f g], [c f h i], [d g i j]]."""
    s0, s1, s2 = a * e - b * b, a * f - c * b, a * g - d * b
    s3, s4, s5 = b * f - c * e, b * g - d * e, c * g - d * f
    c5, c4, c3 = h * j - i * i, f * j - i * g, f * i - h * g
    c2, c1, c0 = c * j - i * d, c * i - h * d, c * g - f * d
    return s0 * c5 - s1 * c4 + s2 * c3 + s3 * c2 - s4 * c1 + s5 * c0


@_jit
def _along(start, slope, bend, u):
    """Determinant of ``start + 2 u slope + u^2 bend`` (10 entries each)."""
    p, q = 2.0 * u, u * u
    return _determinant(
        start[0] + p * slope[0] + q * bend[0], start[1] + p * slope[1] + q * bend[1], start[2] + p * slope[2] + q * bend[2],
        start[3] + p * slope[3] + q * bend[3], start[4] + p * slope[4] + q * bend[4], start[5] + p * slope[5] + q * bend[5],
        start[6] + p * slope[6] + q * bend[6], start[7] + p * slope[7] + q * bend[7], start[8] + p * slope[8] + q * bend[8],
        start[9] + p * slope[9] + q * bend[9],
    )  # fmt: skip


@_jit
def _first_root(coefficients, tolerance):
    """First root in (0, 1] of a polynomial by its Bernstein coefficients, as an interval; (2, 2) if there is none.

    The interval holds exactly one sign change, or is as small as rounding.
    """
    stack = np.empty((64, 9))
    low, width = np.empty(64), np.empty(64)
    stack[0], low[0], width[0] = coefficients, 0.0, 1.0
    top = 1
    while top > 0:
        top -= 1
        b = stack[top].copy()
        a, w = low[top], width[top]
        changes, sign = 0, 1
        for k in range(9):
            if b[k] < -tolerance:
                if sign > 0:
                    changes, sign = changes + 1, -1
            elif b[k] > tolerance and sign < 0:
                changes, sign = changes + 1, 1
        if changes == 0:
            continue
        if (changes == 1 and b[8] < -tolerance) or w < 1e-12 or top > 60:
            return a, a + w
        # De Casteljau: the left half's coefficients are first entries, the right half's are last ones.
        right = top
        left = top + 1
        for k in range(9):
            stack[left, k] = b[0]
            stack[right, 8 - k] = b[8 - k]
            for i in range(8 - k):
                b[i] = 0.5 * (b[i] + b[i + 1])
        low[right], width[right] = a + 0.5 * w, 0.5 * w
        low[left], width[left] = a, 0.5 * w
        top += 2
    return 2.0, 2.0


@_jit
def _hit(start, slope, bend, limit, to_bernstein, nodes):
    """Smallest u in (0, limit] where the determinant vanishes, or infinity."""
    values, coefficients = np.empty(9), np.empty(9)
    for k in range(9):
        values[k] = _along(start, slope, bend, limit * nodes[k])
    size = 0.0
    for k in range(9):
        total = 0.0
        for i in range(9):
            total += to_bernstein[k, i] * values[i]
        coefficients[k] = total
        size = max(size, abs(total))
    # Starting on a wall the determinant is zero to rounding, of either sign; the way leads inside.
    coefficients[0] = max(values[0], 0.0)
    a, b = _first_root(coefficients, 1e-15 * size)
    if a > 1.0:
        return np.inf
    a, b = a * limit, b * limit
    for _ in range(60):
        if b - a <= 1e-15 * b:
            break
        middle = 0.5 * (a + b)
        if _along(start, slope, bend, middle) > 0.0:
            a = middle
        else:
            b = middle
    return a


@_jit
def _line(c, b, a):
    """Where ``c + 2 b u + a u^2``, not negative at zero, becomes negative; infinity if nowhere beyond zero."""
    inside = b * b - a * c
    if inside < 0.0 or (b >= 0.0 and a >= 0.0):
        return np.inf
    # The root with falling slope; in either form nothing cancels.
    return (b + np.sqrt(inside)) / -a if b > 0.0 else c / (np.sqrt(inside) - b)


@_jit
def _null_vector(entries):
    """Unit vector that a nearly singular symmetric 4x4 matrix takes (almost) to zero: inverse iteration."""
    matrix, size = np.empty((4, 4)), 0.0
    k = 0
    for i in range(4):
        for j in range(i, 4):
            matrix[i, j] = matrix[j, i] = entries[k]
            size = max(size, abs(entries[k]))
            k += 1
    for i in range(4):
        matrix[i, i] += 1e-13 * size
    vector = np.array([0.5, 0.45, 0.55, 0.48])
    for _ in range(4):
        a, x = matrix.copy(), vector.copy()
        for i in range(4):
            best = i
            for r in range(i + 1, 4):
                if abs(a[r, i]) > abs(a[best, i]):
                    best = r
            if best != i:
                for c in range(4):
                    a[i, c], a[best, c] = a[best, c], a[i, c]
                x[i], x[best] = x[best], x[i]
            pivot = a[i, i] if a[i, i] != 0.0 else 1e-300
            for r in range(i + 1, 4):
                factor = a[r, i] / pivot
                for c in range(i, 4):
                    a[r, c] -= factor * a[i, c]
                x[r] -= factor * x[i]
        for i in range(3, -1, -1):
            for c in range(i + 1, 4):
                x[i] -= a[i, c] * x[c]
            x[i] /= a[i, i] if a[i, i] != 0.0 else 1e-300
        vector = x / np.sqrt(np.sum(x * x))
    return vector


@_jit
def feasible(x, bodies, bounded):
    """Whether all bodies' matrices are positive definite and all bounded coordinates positive."""
    pivots = np.empty(4)
    for k in range(bodies):
        if not _pivots(x[10 * k : 10 * k + 10], pivots):
            return False
    for k in range(len(bounded)):
        if x[bounded[k]] <= 0.0:
            return False
    return True


@_jit
def _travel(x, velocity, mean, root, bodies, bounded, to_bernstein, nodes, most):
    """Follow one trajectory for a quarter turn; x is moved in place. Returns the number of bounces, -1: given up."""
    d = len(x)
    offset, v = x - mean, velocity.copy()
    remaining = 0.5 * np.pi
    bounces = 0
    while True:
        limit = np.tan(0.5 * remaining)
        best, wall = np.inf, -1
        for k in range(bodies):
            part = slice(10 * k, 10 * k + 10)
            m, a = mean[part], offset[part]
            u = _hit(m + a, v[part], m - a, min(limit, best), to_bernstein, nodes)
            if u < best:
                best, wall = u, k
        for k in range(len(bounded)):
            j = bounded[k]
            u = _line(max(mean[j] + offset[j], 0.0), v[j], mean[j] - offset[j])
            if u < min(limit, best):
                best, wall = u, bodies + k
        if best > limit:
            break
        # Slightly before the wall, so that the next piece of the trajectory starts inside.
        t = 2.0 * np.arctan(best) * (1.0 - 1e-9)
        cosine, sine = np.cos(t), np.sin(t)
        for i in range(d):
            offset[i], v[i] = offset[i] * cosine + v[i] * sine, v[i] * cosine - offset[i] * sine
        remaining -= t
        bounces += 1
        if bounces > most or remaining <= 0.0:
            return -1
        if wall >= bodies:
            first, count = bounded[wall - bodies], 1
            normal = np.ones(1)
        else:
            first, count = 10 * wall, 10
            w = _null_vector(mean[first : first + 10] + offset[first : first + 10])
            normal = np.empty(10)
            k = 0
            for i in range(4):
                for j in range(i, 4):
                    normal[k] = w[i] * w[j] * (1.0 if i == j else 2.0)
                    k += 1
        approach = 0.0
        for k in range(count):
            approach += normal[k] * v[first + k]
        if approach >= 0.0:
            continue
        # C g = root root' g
        inner = np.zeros(d)
        for k in range(count):
            for i in range(d):
                inner[i] += root[first + k, i] * normal[k]
        push = np.zeros(d)
        for i in range(d):
            total = 0.0
            for k in range(d):
                total += root[i, k] * inner[k]
            push[i] = total
        size = 0.0
        for k in range(count):
            size += normal[k] * push[first + k]
        for i in range(d):
            v[i] -= 2.0 * approach / size * push[i]
    cosine, sine = np.cos(remaining), np.sin(remaining)
    end = mean + offset * cosine + v * sine
    if not feasible(end, bodies, bounded):
        return -1
    x[:] = end
    return bounces


def travel(x: np.ndarray, velocity: np.ndarray, mean: np.ndarray, root: np.ndarray, bodies: int, bounded: np.ndarray) -> int:
    """Move a point x of a truncated Gaussian, in place, along one exact trajectory of a quarter turn; returns the bounces.

    x (d,) is inside all walls: ten entries of each body's matrix, then the rest, of which ``bounded`` cannot be negative. The
    velocity is a draw of N(0, C), with C = A A' and A the ``root`` of the Gaussian before it is cut, whose mean may be outside.
    With too many bounces, or where rounding leads outside, x stays as it was, and -1 is returned.
    """
    return _travel(x, velocity, mean, root, bodies, bounded, _TO_BERNSTEIN, _NODES, MOST_BOUNCES)
