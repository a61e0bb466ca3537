"""Newton's and Euler's equations of one body, written once, for runs of samples: pose and rates, columns, wrench, twists.

The kernels work on `LANES` samples at once: every number of the equations is a run of that many, ``row[field + s]``, and the
innermost loops run over s, so that they compile to vector instructions. Spatial vectors are (linear; angular).
Numba notices changes of the file that a compiled loop is in, not of this one: after a change here empty ``__pycache__``.
"""

from __future__ import annotations

import numba
import numpy as np

#: Samples in a run.
LANES = 16
_L = LANES
# Where a row of the state, one a body, has its rotation, origin, spin, the spin's rate and the origin's acceleration.
R, P, W, DW, A = 0, 9 * _L, 12 * _L, 15 * _L, 18 * _L
STATE = 21 * _L
#: One of six rows of a body's block: ten parameters.
BLOCK = 10 * _L
#: Compiles a function as all of this package's kernels are; products and sums may be fused and reordered, nothing more. What
#: another kernel calls becomes part of it: else the process that compiles both rounds otherwise than those that find them made.
jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"}, forceinline=True)

# Vectors are tuples, matrices tuples of rows.
dot = jit(lambda a, b: a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
add = jit(lambda a, b, k=1.0: (a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]))
cross = jit(lambda a, b: (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))
apply = jit(lambda r, x: (dot(r[0], x), dot(r[1], x), dot(r[2], x)))
column = jit(lambda r, k: (r[0][k], r[1][k], r[2][k]))
get = jit(lambda row, i, step=_L: (row[i], row[i + step], row[i + 2 * step]))
get_one = jit(lambda x, i: (x[i], x[i + 1], x[i + 2]))
get_rotation = jit(lambda row, s: (get(row, s), get(row, 3 * _L + s), get(row, 6 * _L + s)))


@jit
def put(row, i, x, step=_L):
    """Write a vector to ``row[i], row[i + step], row[i + 2 step]``."""
    row[i], row[i + step], row[i + 2 * step] = x


@jit
def put_one(x, i, value):
    """Write a vector of a single sample."""
    x[i], x[i + 1], x[i + 2] = value


@jit
def at_rest(rows, gravity, by_momentum):
    """State of all rows (rows + 1, STATE); the last is the root, at rest and, except by momentum, accelerated against gravity."""
    state = np.zeros((rows + 1, STATE))
    for k in range(3):
        state[rows, 4 * k * _L : (4 * k + 1) * _L] = 1.0
        state[rows, A + k * _L : A + (k + 1) * _L] = 0.0 if by_momentum else -gravity[k]
    return state


@jit
def set_motion(motion, q, v, a, first, count, by_momentum):
    """Joint motion of a run of samples: q, sin, cos, q', q''; by momentum q' is none, see `bayesid.dynamics.regressors`."""
    for s in range(count):
        for i in range(q.shape[1]):
            angle = q[first + s, i]
            motion[i, s], motion[i, _L + s], motion[i, 2 * _L + s] = angle, np.sin(angle), np.cos(angle)
            motion[i, 3 * _L + s] = 0.0 if by_momentum else v[first + s, i]
            motion[i, 4 * _L + s] = a[first + s, i]


@jit
def advance(up, here, motion, turn, translation, axis, slides):
    """Pose, spin w, its rate w' and origin's acceleration A of a row from its parent's; motion: q, sin, cos, q', q''.

    ``w += q' d, w' += q'' d + q' w x d`` for a turning axis d, ``A += q'' d + 2 q' w x d`` for a sliding one,
    and ``A += w' x r + w x (w x r)`` of the parent over the offset r.
    """
    a, b, c = get(turn, 0, 1), get(turn, 3, 1), get(turn, 6, 1)
    ca, cb, cc = get(turn, 9, 1), get(turn, 12, 1), get(turn, 15, 1)
    sa, sb, sc = get(turn, 18, 1), get(turn, 21, 1), get(turn, 24, 1)
    fixed, direction, turns = get(translation, 0, 1), get(axis, 0, 1), 1.0 - slides
    zero = (0.0, 0.0, 0.0)
    for s in range(_L):
        r, w, dw = get_rotation(up, s), get(up, W + s), get(up, DW + s)
        sine, cosine = motion[_L + s], motion[2 * _L + s]
        rate, rate2 = motion[3 * _L + s], motion[4 * _L + s]
        ta = add(add(a, ca, cosine), sa, sine)
        tb = add(add(b, cb, cosine), sb, sine)
        tc = add(add(c, cc, cosine), sc, sine)
        for k in range(3):
            put(here, 3 * k * _L + s, add(add(add(zero, ta, r[k][0]), tb, r[k][1]), tc, r[k][2]))
        offset = apply(r, add(fixed, direction, slides * motion[s]))
        d = apply(r, direction)
        bend = cross(w, d)
        pull = add(cross(dw, offset), cross(w, cross(w, offset)))
        put(here, P + s, add(get(up, P + s), offset))
        put(here, W + s, add(w, d, turns * rate))
        put(here, DW + s, add(add(dw, d, turns * rate2), bend, turns * rate))
        pull = add(add(pull, d, slides * rate2), bend, slides * 2.0 * rate)
        put(here, A + s, add(get(up, A + s), pull))


@jit
def body_columns(state, block):
    """Rate of one body's momentum: six rows by ten columns.

    A point r of the body adds ``A + w' x r + w x (w x r)`` times its mass; with the rotation R into the
    body's axes, the inertia adds ``R (L(a) + [b]x L(b))`` for a = R' w', b = R' w, where L(x) I = I x.
    """
    force, moment = block[: 3 * BLOCK], block[3 * BLOCK :]
    for s in range(_L):
        r, p, acc = get_rotation(state, s), get(state, P + s), get(state, A + s)
        w, dw = get(state, W + s), get(state, DW + s)
        put(force, s, acc, BLOCK)
        put(moment, s, cross(p, acc), BLOCK)
        for k in range(3):
            arm = column(r, k)
            f = add(cross(dw, arm), cross(w, cross(w, arm)))
            put(force, (1 + k) * _L + s, f, BLOCK)
            put(moment, (1 + k) * _L + s, add(cross(p, f), cross(arm, acc)), BLOCK)
        r0, r1, r2 = column(r, 0), column(r, 1), column(r, 2)
        x, y, z = dot(r0, dw), dot(r1, dw), dot(r2, dw)
        a, b, c = dot(r0, w), dot(r1, w), dot(r2, w)
        put(moment, 4 * _L + s, apply(r, (x, c * a, -b * a)), BLOCK)
        put(moment, 5 * _L + s, apply(r, (y - c * a, x + c * b, a * a - b * b)), BLOCK)
        put(moment, 6 * _L + s, apply(r, (-c * b, y, a * b)), BLOCK)
        put(moment, 7 * _L + s, apply(r, (z + b * a, c * c - a * a, x - b * c)), BLOCK)
        put(moment, 8 * _L + s, apply(r, (b * b - c * c, z - a * b, y + a * c)), BLOCK)
        put(moment, 9 * _L + s, apply(r, (b * c, -a * c, z)), BLOCK)


@jit
def weight_columns(state, gravity, block):
    """The same rows of one body's weight; no moment of inertia has any."""
    g, moment = get(gravity, 0, 1), block[3 * BLOCK :]
    for s in range(_L):
        r = get_rotation(state, s)
        put(block, s, g, BLOCK)
        put(moment, s, cross(get(state, P + s), g), BLOCK)
        for k in range(3):
            put(moment, (1 + k) * _L + s, cross(column(r, k), g), BLOCK)


@jit
def _inertia(i, x):
    """I x for the entries 4 to 9 of a body's parameters: Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
    return (
        i[4] * x[0] + i[5] * x[1] + i[7] * x[2],
        i[5] * x[0] + i[6] * x[1] + i[8] * x[2],
        i[7] * x[0] + i[8] * x[1] + i[9] * x[2],
    )


@jit
def body_wrench(state, links, wrench):
    """Rate of one body's momentum from its ten parameters (10,): force and moment about the origin, six runs.

    The same equations as `body_columns`, summed: with h = R (m c), ``f = m A + w' x h + w x (w x h)`` and
    ``n = R (I a + b x I b) + h x A + p x f``.
    """
    mass, first = links[0], get(links, 1, 1)
    for s in range(_L):
        r, p, acc = get_rotation(state, s), get(state, P + s), get(state, A + s)
        w, dw = get(state, W + s), get(state, DW + s)
        h = apply(r, first)
        f = add(add(cross(dw, h), cross(w, cross(w, h))), acc, mass)
        r0, r1, r2 = column(r, 0), column(r, 1), column(r, 2)
        a, b = (dot(r0, dw), dot(r1, dw), dot(r2, dw)), (dot(r0, w), dot(r1, w), dot(r2, w))
        turning = add(_inertia(links, a), cross(b, _inertia(links, b)))
        put(wrench, s, f)
        put(wrench, 3 * _L + s, add(add(apply(r, turning), cross(h, acc)), cross(p, f)))


@jit
def twist_and_rate(state, fixed, twist, rate):
    """A twist fixed in a link, about the origin: ``(R l + p x R a; R a)``; its rate for spin w', origin velocity A.

    That rate is the motion cross product with (A - w' x p; w').
    """
    linear, angular = get(fixed, 0, 1), get(fixed, 3, 1)
    for s in range(_L):
        r, p, w = get_rotation(state, s), get(state, P + s), get(state, DW + s)
        turned = apply(r, angular)
        moved = add(apply(r, linear), cross(p, turned))
        put(twist, s, moved)
        put(twist, 3 * _L + s, turned)
        velocity = add(get(state, A + s), cross(p, w))
        put(rate, s, add(cross(w, moved), cross(velocity, turned)))
        put(rate, 3 * _L + s, cross(w, turned))


@jit
def project(twist, block, result, add):
    """``result (+)= twist' block``: one row of ten parameters."""
    for k in range(10):
        for s in range(_L):
            i = k * _L + s
            total = result[i] if add else 0.0
            for row in range(6):
                total += twist[row * _L + s] * block[row * BLOCK + i]
            result[i] = total


@jit
def store(row, out, first, count, channel, columns, parameters):
    """A body's ten runs of samples to the columns asked for."""
    for s in range(count):
        for k in range(len(columns)):
            out[first + s, channel, columns[k]] = row[parameters[k] * _L + s]
