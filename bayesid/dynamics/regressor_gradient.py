"""Gradient of the dynamics regressor along the joint motion: the transposed recursion, one sample at a time.

For weights U (N, c, columns) on the regressor Y of `bayesid.dynamics.regressors`, the sum ``s = <U, Y(q, q', q'')>`` depends on
each sample's motion alone, and one backward sweep over the tree gives all 3 n derivatives of a sample for about three times
the cost of Y itself, whatever the number of columns (reverse accumulation, [Griewank2008]_). By it a function of
the information matrix ``A = Y' Y`` with gradient G has the gradient of ``U = 2 Y G``, and a function of readings ``Y phi`` with
gradient g that of ``U = g phi'``. For a vector x of the forward recursion, ``x_bar`` is the derivative of s with respect to it;
of ``c = a x b`` it hands on ``a_bar += b x c_bar`` and ``b_bar += c_bar x a``.
"""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.newton_euler import add, apply, cross, dot, get_one, jit, put_one
from bayesid.dynamics.regressors import Kernel
from bayesid.robot.inertia import COLUMN, ROW

# Where a row of the state, one a body, has its rotation, origin, spin, the spin's rate and the origin's acceleration.
R, P, W, DW, A, STATE = 0, 9, 12, 15, 18, 21


def regressor_gradient(
    kernel: Kernel,
    positions: np.ndarray,
    velocities: np.ndarray,
    accelerations: np.ndarray,
    weights: np.ndarray,
    *,
    gravity: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives of ``sum(weights * Y)`` with respect to positions, velocities and accelerations, (N, n) each.

    ``weights`` (N, c, columns) has one number for each of the regressor Y; ``gravity`` says whether it has the weight in it.
    """
    q, v, a, u = (np.ascontiguousarray(x, dtype=float) for x in (positions, velocities, accelerations, weights))
    out = np.zeros((3, *q.shape))
    _gradient(q, v, a, u, *kernel.tables, kernel.gravity if gravity else np.zeros(3), out)
    return out[0], out[1], out[2]


_rows = jit(lambda x: (get_one(x, 0), get_one(x, 3), get_one(x, 6)))
_columns = jit(lambda x: ((x[0], x[3], x[6]), (x[1], x[4], x[7]), (x[2], x[5], x[8])))
_triple = jit(lambda a, b, c: cross(a, cross(b, c)))


@jit
def _plus(x, i, value):
    x[i] += value[0]
    x[i + 1] += value[1]
    x[i + 2] += value[2]


@jit
def _plus_outer(x, a, b):
    """``R_bar += a b'``: of ``a_bar = R b``."""
    for i in range(3):
        x[3 * i] += a[i] * b[0]
        x[3 * i + 1] += a[i] * b[1]
        x[3 * i + 2] += a[i] * b[2]


@jit
def _unit(k, x):
    """The inertia's basis matrix k times a vector."""
    i, j = ROW[k], COLUMN[k]
    y = np.zeros(3)
    y[i] = x[j]
    y[j] = x[i]
    return (y[0], y[1], y[2])


@jit
def _turned(turn, sine, cosine, k):
    """Row k of the rotation that a joint adds, and of its derivative with respect to the joint's position."""
    still, c, s = get_one(turn, 3 * k), get_one(turn, 9 + 3 * k), get_one(turn, 18 + 3 * k)
    return add(add(still, c, cosine), s, sine), add(add((0.0, 0.0, 0.0), c, -sine), s, cosine)


@jit
def _advance(up, here, q, v, a, turn, translation, axis, slides):
    """Advance one sample as `bayesid.dynamics.newton_euler.advance` does."""
    r, w, dw, turns = _rows(up), get_one(up, W), get_one(up, DW), 1.0 - slides
    sine, cosine = np.sin(q), np.cos(q)
    rows = (_turned(turn, sine, cosine, 0)[0], _turned(turn, sine, cosine, 1)[0], _turned(turn, sine, cosine, 2)[0])
    for k in range(3):
        put_one(here, 3 * k, add(add(add((0.0, 0.0, 0.0), rows[0], r[k][0]), rows[1], r[k][1]), rows[2], r[k][2]))
    offset = apply(r, add(get_one(translation, 0), get_one(axis, 0), slides * q))
    d = apply(r, get_one(axis, 0))
    bend = cross(w, d)
    put_one(here, P, add(get_one(up, P), offset))
    put_one(here, W, add(w, d, turns * v))
    put_one(here, DW, add(add(dw, d, turns * a), bend, turns * v))
    pull = add(cross(dw, offset), _triple(w, w, offset))
    pull = add(add(pull, d, slides * a), bend, 2.0 * slides * v)
    put_one(here, A, add(get_one(up, A), pull))


@jit
def _advance_back(up, here_bar, up_bar, q, v, a, turn, translation, axis, slides):
    """Hand a row's derivatives on to its parent's; those of q, v, a are returned."""
    r, w, dw, turns = _rows(up), get_one(up, W), get_one(up, DW), 1.0 - slides
    sine, cosine = np.sin(q), np.cos(q)
    fixed, direction = get_one(translation, 0), get_one(axis, 0)
    arm = add(fixed, direction, slides * q)
    offset, d = apply(r, arm), apply(r, direction)
    bend = cross(w, d)
    p_bar, w_bar, dw_bar, a_bar = get_one(here_bar, P), get_one(here_bar, W), get_one(here_bar, DW), get_one(here_bar, A)
    # Rotation: R = R_up T(q).
    q_bar = 0.0
    for k in range(3):
        row, rate = _turned(turn, sine, cosine, k)
        for i in range(3):
            here = get_one(here_bar, 3 * i)
            up_bar[3 * i + k] += dot(here, row)
            q_bar += r[i][k] * dot(here, rate)
    bend_bar = add(add((0.0, 0.0, 0.0), dw_bar, turns * v), a_bar, 2.0 * slides * v)
    d_bar = add(add((0.0, 0.0, 0.0), w_bar, turns * v), dw_bar, turns * a)
    d_bar = add(add(d_bar, a_bar, slides * a), cross(bend_bar, w))
    v_bar = turns * (dot(w_bar, d) + dot(dw_bar, bend)) + 2.0 * slides * dot(a_bar, bend)
    acceleration_bar = turns * dot(dw_bar, d) + slides * dot(a_bar, d)
    spun = cross(w, offset)
    spun_bar = cross(a_bar, w)
    offset_bar = add(add(p_bar, cross(a_bar, dw)), cross(spun_bar, w))
    _plus(up_bar, P, p_bar)
    _plus(up_bar, W, add(add(w_bar, cross(d, bend_bar)), add(cross(spun, a_bar), cross(offset, spun_bar))))
    _plus(up_bar, DW, add(dw_bar, cross(offset, a_bar)))
    _plus(up_bar, A, a_bar)
    _plus_outer(up_bar, offset_bar, arm)
    _plus_outer(up_bar, d_bar, direction)
    return q_bar + slides * dot(offset_bar, d), v_bar, acceleration_bar


@jit
def _block(state, block):
    """The same as `bayesid.dynamics.newton_euler.body_columns`, for one sample: (10, 6)."""
    r, c, p, acc = _rows(state), _columns(state), get_one(state, P), get_one(state, A)
    w, dw = get_one(state, W), get_one(state, DW)
    put_one(block[0], 0, acc)
    put_one(block[0], 3, cross(p, acc))
    for k in range(3):
        arm = c[k]
        f = add(cross(dw, arm), _triple(w, w, arm))
        put_one(block[1 + k], 0, f)
        put_one(block[1 + k], 3, add(cross(p, f), cross(arm, acc)))
    alpha = (dot(c[0], dw), dot(c[1], dw), dot(c[2], dw))
    beta = (dot(c[0], w), dot(c[1], w), dot(c[2], w))
    for k in range(6):
        put_one(block[4 + k], 0, (0.0, 0.0, 0.0))
        put_one(block[4 + k], 3, apply(r, add(_unit(k, alpha), cross(beta, _unit(k, beta)))))


@jit
def _block_back(state, u, bar):
    """Derivatives of ``sum(u * block)`` for weights u (10, 6), added to a row's."""
    r, c, p, acc = _rows(state), _columns(state), get_one(state, P), get_one(state, A)
    w, dw = get_one(state, W), get_one(state, DW)
    force, moment = get_one(u[0], 0), get_one(u[0], 3)
    acc_bar = add(force, cross(moment, p))
    p_bar = cross(acc, moment)
    w_bar, dw_bar = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(3):
        arm = c[k]
        f = add(cross(dw, arm), _triple(w, w, arm))
        moment = get_one(u[1 + k], 3)
        f_bar = add(get_one(u[1 + k], 0), cross(moment, p))
        spun, spun_bar = cross(w, arm), cross(f_bar, w)
        p_bar = add(p_bar, cross(f, moment))
        acc_bar = add(acc_bar, cross(moment, arm))
        dw_bar = add(dw_bar, cross(arm, f_bar))
        w_bar = add(w_bar, add(cross(spun, f_bar), cross(arm, spun_bar)))
        arm_bar = add(add(cross(acc, moment), cross(f_bar, dw)), cross(spun_bar, w))
        bar[k] += arm_bar[0]
        bar[3 + k] += arm_bar[1]
        bar[6 + k] += arm_bar[2]
    alpha = (dot(c[0], dw), dot(c[1], dw), dot(c[2], dw))
    beta = (dot(c[0], w), dot(c[1], w), dot(c[2], w))
    alpha_bar, beta_bar = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(6):
        moment = get_one(u[4 + k], 3)
        inside = (dot(c[0], moment), dot(c[1], moment), dot(c[2], moment))
        spin = _unit(k, beta)
        _plus_outer(bar, moment, add(_unit(k, alpha), cross(beta, spin)))
        alpha_bar = add(alpha_bar, _unit(k, inside))
        beta_bar = add(beta_bar, add(cross(spin, inside), _unit(k, cross(inside, beta))))
    _plus_outer(bar, dw, alpha_bar)
    _plus_outer(bar, w, beta_bar)
    _plus(bar, P, p_bar)
    _plus(bar, W, add(w_bar, apply(r, beta_bar)))
    _plus(bar, DW, add(dw_bar, apply(r, alpha_bar)))
    _plus(bar, A, acc_bar)


@jit
def _gradient(
    q, v, a, weights,
    order, parent, turn, translation, axis, slides, twist_row, fixed_twist, pick, carries, start, column, parameter, gravity, out,
):  # fmt: skip
    bodies, channels = len(parent), len(twist_row)
    joints = q.shape[1]
    state, bar = np.zeros((bodies + 1, STATE)), np.zeros((bodies + 1, STATE))
    block, u = np.zeros((10, 6)), np.zeros((10, 6))
    twist, twist_bar = np.zeros((channels, 6)), np.zeros((channels, 6))
    for k in range(3):
        state[bodies, 4 * k] = 1.0
        state[bodies, A + k] = -gravity[k]
    for s in range(len(q)):
        bar[:] = 0.0
        twist_bar[:] = 0.0
        for i in order:
            moves = i < joints
            here = (q[s, i], v[s, i], a[s, i]) if moves else (0.0, 0.0, 0.0)
            _advance(state[parent[i]], state[i], *here, turn[i], translation[i], axis[i], slides[i])
        for c in range(channels):
            x = state[twist_row[c]]
            angular = apply(_rows(x), get_one(fixed_twist[c], 3))
            put_one(twist[c], 0, add(apply(_rows(x), get_one(fixed_twist[c], 0)), cross(get_one(x, P), angular)))
            put_one(twist[c], 3, angular)
        for body in range(bodies):
            if start[body] == start[body + 1]:
                continue
            _block(state[body], block)
            u[:] = 0.0
            for c in range(channels):
                if not carries[c, body]:
                    continue
                for j in range(start[body], start[body + 1]):
                    weight, which = weights[s, c, column[j]], parameter[j]
                    for k in range(6):
                        u[which, k] += weight * twist[c, k]
                        twist_bar[c, k] += weight * block[which, k]
            _block_back(state[body], u, bar[body])
        for c in range(channels):
            if twist_row[c] < 0:
                continue
            x, x_bar = state[twist_row[c]], bar[twist_row[c]]
            linear, angular = get_one(fixed_twist[c], 0), get_one(fixed_twist[c], 3)
            moved = get_one(twist_bar[c], 0)
            # (R l + p x R a; R a)
            _plus_outer(x_bar, moved, linear)
            _plus_outer(x_bar, add(get_one(twist_bar[c], 3), cross(moved, get_one(x, P))), angular)
            _plus(x_bar, P, cross(apply(_rows(x), angular), moved))
        for k in range(bodies - 1, -1, -1):
            i = order[k]
            moves = i < joints
            here = (q[s, i], v[s, i], a[s, i]) if moves else (0.0, 0.0, 0.0)
            found = _advance_back(state[parent[i]], bar[i], bar[parent[i]], *here, turn[i], translation[i], axis[i], slides[i])
            if moves:
                out[0, s, i], out[1, s, i], out[2, s, i] = found
