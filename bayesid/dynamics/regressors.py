"""Regressors of wrenches and joint torques, batched over samples, with or without accelerations.

Every channel is one idea: a **twist** S fixed in a link. Its reading is the power-conjugate of the wrench
transmitted to the bodies beyond, ``y = S' w``: the six unit twists of a sensor frame give a wrench, a joint's
axis gives its torque. With H and G the linear maps from all bodies' ten parameters phi to their spatial
momentum and weight about one fixed origin,

    w = d/dt (H phi) - G phi                                   (Newton and Euler)
    y = d/dt (P phi) - Q phi,   P = S' H,   Q = dS/dt' H + S' G

so P needs positions and velocities only; its time derivative is left to the filter (`bayesid.signals.filters`), which
is equation 14 of [Liu1998]_ for all terms at once. Where accelerations are at hand, `dynamics_regressor` gives
``y = Y phi`` directly. Spatial vectors are (linear; angular).
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from bayesid.dynamics.channels import Channels
from bayesid.robot.robot import Robot


def dynamics_regressor(
    robot: Robot,
    channels: Channels,
    positions: np.ndarray,
    velocities: np.ndarray,
    accelerations: np.ndarray,
    columns: np.ndarray | None = None,
    *,
    gravity: bool = True,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Regressor Y with ``reading = Y phi``, (samples, channels, columns).

    Parameters
    ----------
    robot, channels
        What moves and what is measured.
    positions, velocities, accelerations
        Joint trajectory, (samples, n) each [rad or m and per second (squared)].
    columns
        Indices into ``robot.parameter_names``; default all.
    gravity
        Whether the weight is part of the reading; False for the motion wrench of [Liu1998]_ equation 24.
    out
        Array to write into.
    """
    arguments = _arguments(robot, channels, columns, gravity)
    out = np.empty((len(positions), len(channels), len(arguments[-1]))) if out is None else out
    q, v, a = map(_c, (positions, velocities, accelerations))
    _regressor(False, q, v, a, *arguments, out, out[:0])  # pyright: ignore[reportCallIssue]
    return out


def momentum_regressors(
    robot: Robot,
    channels: Channels,
    positions: np.ndarray,
    velocities: np.ndarray,
    columns: np.ndarray | None = None,
    *,
    gravity: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Regressors P, Q with ``reading = d/dt(P phi) - Q phi``, each (samples, channels, columns).

    Parameters are those of `dynamics_regressor`; no acceleration is needed.
    """
    arguments = _arguments(robot, channels, columns, gravity)
    momentum, rest = np.empty((2, len(positions), len(channels), len(arguments[-1])))
    q, v = _c(positions), _c(velocities)
    _regressor(True, q, v, v, *arguments, momentum, rest)  # pyright: ignore[reportCallIssue]
    return momentum, rest


def _c(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)


def _arguments(robot: Robot, channels: Channels, columns, gravity: bool) -> tuple[Any, ...]:
    """Tables of the kernel: a chain of rows (the joints, then split bodies), twists, columns by body."""
    n, bodies = robot.n, len(robot.body_names)
    columns = np.arange(10 * bodies) if columns is None else np.asarray(columns)
    # A split body is one more row, of a joint that never moves.
    parent = np.append(robot.parent, robot.body_joint[n:])
    placement = np.concatenate([robot.rotation, robot.body_rotation[n:]])
    translation = np.concatenate([robot.translation, robot.body_translation[n:]])
    axis = np.concatenate([robot.axis, np.zeros((bodies - n, 3))])
    slides = np.append(robot.prismatic, np.ones(bodies - n, bool))
    to_reference, origin = channels.reference_rotation.T, channels.reference_translation
    root = parent < 0
    placement[root] = to_reference @ placement[root]
    translation[root] = (translation[root] - origin) @ to_reference.T
    # Rodrigues: placement times turn(q) = turn[0] + cos(q) turn[1] + sin(q) turn[2].
    along = axis[:, :, None] * axis[:, None, :]
    turn = placement[:, None] @ np.stack([along, np.eye(3) - along, np.cross(axis[:, None], np.eye(3)).swapaxes(1, 2)], 1)
    turn[slides] = 0.0
    turn[slides, 0] = placement[slides]
    axis = np.einsum("rij,rj->ri", placement, axis)
    # Twists of one unit entry fixed in the root pick a row of the block, without a product.
    pick = (channels.joint < 0) & (np.count_nonzero(channels.twist, axis=1) == 1) & (channels.twist.max(axis=1) == 1.0)
    by_body = np.argsort(columns // 10, kind="stable")
    return (
        np.append(robot.order, np.arange(n, bodies)), parent, turn.reshape(bodies, 27), translation, axis,
        slides.astype(float), to_reference @ robot.gravity * (1.0 if gravity else 0.0),
        channels.joint, _c(channels.twist), np.where(pick, np.argmax(channels.twist, axis=1), -1), channels.bodies,
        np.searchsorted(columns[by_body] // 10, np.arange(bodies + 1)), by_body, columns[by_body] % 10,
    )  # fmt: skip


# The kernel works on _L samples at once: every number of the equations is a run of _L, ``row[field + s]``, and
# the innermost loops run over s, so that they compile to vector instructions. A row of the state, one a body:
_L = 16
_R, _P, _W, _DW, _A = 0, 9 * _L, 12 * _L, 15 * _L, 18 * _L  # rotation, origin, spin, its rate, acceleration
_STATE = 21 * _L
_BLOCK = 10 * _L  # one row of a body's block: ten parameters
_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"})


# Vectors are tuples, matrices tuples of rows.
_dot = _jit(lambda a, b: a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
_add = _jit(lambda a, b, k=1.0: (a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]))
_cross = _jit(lambda a, b: (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))
_apply = _jit(lambda r, x: (_dot(r[0], x), _dot(r[1], x), _dot(r[2], x)))
_column = _jit(lambda r, k: (r[0][k], r[1][k], r[2][k]))
_get = _jit(lambda row, i, step=_L: (row[i], row[i + step], row[i + 2 * step]))
_get_rotation = _jit(lambda row, s: (_get(row, s), _get(row, 3 * _L + s), _get(row, 6 * _L + s)))


@_jit
def _put(row, i, x, step=_L):
    row[i], row[i + step], row[i + 2 * step] = x


@_jit
def _advance(up, here, motion, turn, translation, axis, slides):
    """Pose, spin w, its rate w' and origin's acceleration A of a row from its parent's; motion: q, sin, cos, q', q''.

    ``w += q' d, w' += q'' d + q' w x d`` for a turning axis d, ``A += q'' d + 2 q' w x d`` for a sliding one,
    and ``A += w' x r + w x (w x r)`` of the parent over the offset r.
    """
    a, b, c = _get(turn, 0, 1), _get(turn, 3, 1), _get(turn, 6, 1)
    ca, cb, cc = _get(turn, 9, 1), _get(turn, 12, 1), _get(turn, 15, 1)
    sa, sb, sc = _get(turn, 18, 1), _get(turn, 21, 1), _get(turn, 24, 1)
    fixed, direction, turns = _get(translation, 0, 1), _get(axis, 0, 1), 1.0 - slides
    zero = (0.0, 0.0, 0.0)
    for s in range(_L):
        r, w, dw = _get_rotation(up, s), _get(up, _W + s), _get(up, _DW + s)
        sine, cosine = motion[_L + s], motion[2 * _L + s]
        rate, rate2 = motion[3 * _L + s], motion[4 * _L + s]
        ta = _add(_add(a, ca, cosine), sa, sine)
        tb = _add(_add(b, cb, cosine), sb, sine)
        tc = _add(_add(c, cc, cosine), sc, sine)
        for k in range(3):
            _put(here, 3 * k * _L + s, _add(_add(_add(zero, ta, r[k][0]), tb, r[k][1]), tc, r[k][2]))
        offset = _apply(r, _add(fixed, direction, slides * motion[s]))
        d = _apply(r, direction)
        bend = _cross(w, d)
        pull = _add(_cross(dw, offset), _cross(w, _cross(w, offset)))
        _put(here, _P + s, _add(_get(up, _P + s), offset))
        _put(here, _W + s, _add(w, d, turns * rate))
        _put(here, _DW + s, _add(_add(dw, d, turns * rate2), bend, turns * rate))
        pull = _add(_add(pull, d, slides * rate2), bend, slides * 2.0 * rate)
        _put(here, _A + s, _add(_get(up, _A + s), pull))


@_jit
def _body_block(state, block):
    """Rate of one body's momentum: six rows by ten columns.

    A point r of the body adds ``A + w' x r + w x (w x r)`` times its mass; with the rotation R into the
    body's axes, the inertia adds ``R (L(a) + [b]x L(b))`` for a = R' w', b = R' w, where L(x) I = I x.
    """
    force, moment = block[: 3 * _BLOCK], block[3 * _BLOCK :]
    for s in range(_L):
        r, p, acc = _get_rotation(state, s), _get(state, _P + s), _get(state, _A + s)
        w, dw = _get(state, _W + s), _get(state, _DW + s)
        _put(force, s, acc, _BLOCK)
        _put(moment, s, _cross(p, acc), _BLOCK)
        for k in range(3):
            arm = _column(r, k)
            f = _add(_cross(dw, arm), _cross(w, _cross(w, arm)))
            _put(force, (1 + k) * _L + s, f, _BLOCK)
            _put(moment, (1 + k) * _L + s, _add(_cross(p, f), _cross(arm, acc)), _BLOCK)
        r0, r1, r2 = _column(r, 0), _column(r, 1), _column(r, 2)
        x, y, z = _dot(r0, dw), _dot(r1, dw), _dot(r2, dw)
        a, b, c = _dot(r0, w), _dot(r1, w), _dot(r2, w)
        _put(moment, 4 * _L + s, _apply(r, (x, c * a, -b * a)), _BLOCK)
        _put(moment, 5 * _L + s, _apply(r, (y - c * a, x + c * b, a * a - b * b)), _BLOCK)
        _put(moment, 6 * _L + s, _apply(r, (-c * b, y, a * b)), _BLOCK)
        _put(moment, 7 * _L + s, _apply(r, (z + b * a, c * c - a * a, x - b * c)), _BLOCK)
        _put(moment, 8 * _L + s, _apply(r, (b * b - c * c, z - a * b, y + a * c)), _BLOCK)
        _put(moment, 9 * _L + s, _apply(r, (b * c, -a * c, z)), _BLOCK)


@_jit
def _weight_block(state, gravity, block):
    """The same rows of one body's weight; no moment of inertia has any."""
    g, moment = _get(gravity, 0, 1), block[3 * _BLOCK :]
    for s in range(_L):
        r = _get_rotation(state, s)
        _put(block, s, g, _BLOCK)
        _put(moment, s, _cross(_get(state, _P + s), g), _BLOCK)
        for k in range(3):
            _put(moment, (1 + k) * _L + s, _cross(_column(r, k), g), _BLOCK)


@_jit
def _twist(state, fixed, twist, rate):
    """A twist fixed in a link, about the origin: ``(R l + p x R a; R a)``; its rate for spin w', origin velocity A.

    That rate is the motion cross product with (A - w' x p; w').
    """
    linear, angular = _get(fixed, 0, 1), _get(fixed, 3, 1)
    for s in range(_L):
        r, p, w = _get_rotation(state, s), _get(state, _P + s), _get(state, _DW + s)
        turned = _apply(r, angular)
        moved = _add(_apply(r, linear), _cross(p, turned))
        _put(twist, s, moved)
        _put(twist, 3 * _L + s, turned)
        velocity = _add(_get(state, _A + s), _cross(p, w))
        _put(rate, s, _add(_cross(w, moved), _cross(velocity, turned)))
        _put(rate, 3 * _L + s, _cross(w, turned))


@_jit
def _project(twist, block, result, add):
    """``result (+)= twist' block``: one row of ten parameters."""
    for k in range(10):
        for s in range(_L):
            i = k * _L + s
            total = result[i] if add else 0.0
            for row in range(6):
                total += twist[row * _L + s] * block[row * _BLOCK + i]
            result[i] = total


@_jit
def _store(row, out, first, count, channel, columns, parameters):
    """A body's ten runs of samples to the columns asked for."""
    for s in range(count):
        for k in range(len(columns)):
            out[first + s, channel, columns[k]] = row[parameters[k] * _L + s]


@_jit
def _regressor(
    by_momentum, q, v, a,
    order, parent, turn, translation, axis, slides, gravity,
    twist_row, fixed_twist, pick, carries, start, column, parameter, out, rest,
):  # fmt: skip
    """Fill ``out`` with Y; by momentum ``out`` with P and ``rest`` with Q.

    The momentum is the rate of momentum of the same robot that starts from rest with the velocities for its
    accelerations, without weight; so `_advance` then has the spin for w' and the velocity for A.
    """
    n, bodies, channels, samples = q.shape[1], len(parent), len(twist_row), len(q)
    state = np.zeros((bodies + 1, _STATE))  # the last row, parent -1, is the root
    for s in range(_L):
        for k in range(3):
            state[bodies, 4 * k * _L + s] = 1.0
            state[bodies, _A + k * _L + s] = 0.0 if by_momentum else -gravity[k]
    motion = np.zeros((bodies, 5 * _L))
    block, weight, row, other = np.zeros(6 * _BLOCK), np.zeros(6 * _BLOCK), np.zeros(_BLOCK), np.zeros(_BLOCK)
    twist, twist_rate = np.zeros((channels, 6 * _L)), np.zeros((channels, 6 * _L))
    for c in range(channels):
        for k in range(6):
            twist[c, k * _L : (k + 1) * _L] = fixed_twist[c, k]

    for first in range(0, samples, _L):
        count = min(_L, samples - first)
        if not carries.all():
            out[first : first + count], rest[first : first + count] = 0.0, 0.0
        for s in range(count):
            for i in range(n):
                angle = q[first + s, i]
                motion[i, s], motion[i, _L + s], motion[i, 2 * _L + s] = angle, np.sin(angle), np.cos(angle)
                motion[i, 3 * _L + s] = 0.0 if by_momentum else v[first + s, i]
                motion[i, 4 * _L + s] = a[first + s, i]
        for i in order:
            _advance(state[parent[i]], state[i], motion[i], turn[i], translation[i], axis[i], slides[i])
        for c in range(channels):
            if twist_row[c] >= 0:
                _twist(state[twist_row[c]], fixed_twist[c], twist[c], twist_rate[c])
        for body in range(bodies):
            mine, which = column[start[body] : start[body + 1]], parameter[start[body] : start[body + 1]]
            if len(mine) == 0:
                continue
            _body_block(state[body], block)
            if by_momentum:
                _weight_block(state[body], gravity, weight)
            for c in range(channels):
                if not carries[c, body]:
                    continue
                values, others, here = row, other, pick[c] * _BLOCK
                if here >= 0:
                    values, others = block[here : here + _BLOCK], weight[here : here + _BLOCK]
                else:
                    _project(twist[c], block, row, False)
                    if by_momentum:
                        _project(twist[c], weight, other, False)
                        _project(twist_rate[c], block, other, True)
                _store(values, out, first, count, c, mine, which)
                if by_momentum:
                    _store(others, rest, first, count, c, mine, which)
