"""Kernels over samples: poses and rates of every link, body wrenches, channel twists, columns of link parameters.

Everything is in the base frame, moments about its origin. A row of the state is one joint's frame (the last row is
the root, which may itself turn): rotation R (9), origin p, spin w, its rate, the origin's acceleration without
gravity, and its velocity (3 each).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bayesid.dynamics import newton_euler
from bayesid.dynamics.channels import WRENCH_NAMES, Channels
from bayesid.dynamics.newton_euler import BLOCK, LANES, STATE, add, cross, dot, get_one, jit, put_one
from bayesid.dynamics.regressors import add_up_readings, chain
from bayesid.robot import inertia
from bayesid.robot.robot import Robot
from bayesid.signals.arrays import kernel_input

R, P, W, DW, A, V, WIDTH = 0, 9, 12, 15, 18, 21, 24


@jit
def _turn(row, x):
    """Rotate a vector x by the rotation matrix of a row."""
    return (dot(get_one(row, 0), x), dot(get_one(row, 3), x), dot(get_one(row, 6), x))


@jit
def _store(row, states, at, first, count):
    """A run of samples of one joint's frame to the states."""
    for s in range(count):
        for field in range(V):
            states[first + s, at, field] = row[field * LANES + s]


@jit
def _states(q, v, a, order, parent, turn, translation, axis, slides, root, out):
    n, samples = q.shape[1], len(q)
    rows, motion = newton_euler.at_rest(n, np.zeros(3), True), np.zeros((n, 5 * LANES))
    for first in range(0, samples, LANES):
        count = min(LANES, samples - first)
        if len(root):
            for s in range(count):
                for field in range(18):
                    rows[n, field * LANES + s] = root[first + s, field]
        _store(rows[n], out, n, first, count)
        out[first : first + count, n, V : V + 3] = 0.0
        newton_euler.set_motion(motion, q, v, a, first, count, False)
        for i in order:
            up = parent[i]
            newton_euler.advance(rows[up], rows[i], motion[i], turn[i], translation[i], axis[i], slides[i])
            _store(rows[i], out, i, first, count)
            for s in range(first, first + count):  # the origin's velocity: v_up + w_up x r, and along a slide
                offset = add(get_one(out[s, i], P), get_one(out[s, up], P), -1.0)
                slid = _turn(out[s, up], get_one(axis[i], 0))
                put_one(
                    out[s, i],
                    V,
                    add(add(get_one(out[s, up], V), cross(get_one(out[s, up], W), offset)), slid, slides[i] * v[s, i]),
                )


@lru_cache(maxsize=16)
def _tables(robot: Robot):
    parent = np.where(robot.parent < 0, robot.n, robot.parent)
    return chain(robot.order, parent, robot.rotation, np.array(robot.translation), robot.axis, robot.prismatic)


def link_states(
    robot: Robot, positions: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray, root: np.ndarray | None = None
) -> np.ndarray:
    """Poses and rates of every joint's frame and of the root (N, n + 1, 24), from joint motion, (N, n) each.

    ``root`` (N, 18) is rotation, origin, spin and its rate of a root that turns; default at rest in the base frame.
    """
    q, v, a = (kernel_input(x) for x in (positions, velocities, accelerations))
    out = np.empty((len(q), robot.n + 1, WIDTH))
    held = kernel_input(np.zeros((0, 18)) if root is None else root)
    _states(q, v, a, *_tables(robot), held, out)
    return out


@jit
def _run(states, row, first, count, gravity, out):
    """A run of samples of one row of the states as `newton_euler` takes it, gravity taken off the acceleration."""
    for s in range(count):
        for field in range(V):
            out[field * LANES + s] = states[first + s, row, field]
        for k in range(3):
            out[(A + k) * LANES + s] -= gravity[k]


@jit
def _wrenches(states, row_of, links, gravity, out):
    state, wrench = np.zeros(STATE), np.zeros(6 * LANES)
    for first in range(0, len(states), LANES):
        count = min(LANES, len(states) - first)
        for b in range(len(links)):
            _run(states, row_of[b], first, count, gravity, state)
            newton_euler.body_wrench(state, links[b], wrench)
            for s in range(count):
                for k in range(6):
                    out[first + s, b, k] = wrench[k * LANES + s]


def body_wrenches(states: np.ndarray, row_of: np.ndarray, links: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """What each body's motion and weight take, force and moment about the base origin (N, b, 6).

    ``states`` are those of `link_states`, ``row_of`` the row that each body moves with (b,), ``links`` ten parameters a body in
    that row's frame (b, 10); ``gravity`` is in m/s^2.
    """
    out = np.empty((len(states), len(links), 6))
    _wrenches(states, row_of, kernel_input(links), kernel_input(gravity), out)
    return out


@jit
def _twists(states, rows, fixed, out):
    for s in range(len(states)):
        for c in range(len(rows)):
            x = states[s, rows[c]]
            angular = _turn(x, get_one(fixed[c], 3))
            put_one(out[s, c], 0, add(_turn(x, get_one(fixed[c], 0)), cross(get_one(x, P), angular)))
            put_one(out[s, c], 3, angular)


def channel_twists(robot: Robot, channels: Channels, states: np.ndarray) -> np.ndarray:
    """Twist of each channel about the base origin, (N, c, 6)."""
    out = np.empty((len(states), len(channels), 6))
    rows = np.where(channels.joint < 0, robot.n, channels.joint)
    _twists(states, rows, kernel_input(channels.root_twists), out)
    return out


@jit
def project(twists, wrenches, carries):
    """Readings (N, c): the twist's power with the wrenches (N, b, 6) of the bodies that the channel carries (c, b)."""
    out = np.empty(twists.shape[:2])
    for s in range(len(twists)):
        for c in range(len(carries)):
            total = 0.0
            for b in range(carries.shape[1]):
                if carries[c, b]:
                    for k in range(6):
                        total += twists[s, c, k] * wrenches[s, b, k]
            out[s, c] = total
    return out


def readings_of_bodies(
    robot: Robot, channels: Channels, motion: tuple[np.ndarray, np.ndarray, np.ndarray], row_of: np.ndarray, links: np.ndarray,
    gravity: np.ndarray, carries: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """What channels read (N, c) of the bodies that each carries (c, b), root at rest: `project` of `body_wrenches`, at once.

    ``motion`` is positions, velocities and accelerations, (N, n) each.
    """
    q, v, a = (kernel_input(x) for x in motion)
    out = np.empty((len(q), len(channels)))
    twists = channels.joint, channels.root_twists, np.full(len(channels), -1)
    chained = *_tables(robot), np.array(gravity, float)
    some = carries.any(axis=0)  # what no channel carries is nothing to them
    add_up_readings(
        q, v, a, *chained, *twists, np.ascontiguousarray(carries[:, some]), row_of[some], kernel_input(links[some]), out
    )
    return out


@jit
def _columns(states, twists, row_of, carries, gravity, out):
    channels = len(carries)
    state, block, row, twist = np.zeros(STATE), np.zeros(6 * BLOCK), np.zeros(BLOCK), np.zeros((channels, 6 * LANES))
    for first in range(0, len(states), LANES):
        count = min(LANES, len(states) - first)
        for s in range(count):
            for c in range(channels):
                for k in range(6):
                    twist[c, k * LANES + s] = twists[first + s, c, k]
        for b in range(len(row_of)):
            _run(states, row_of[b], first, count, gravity, state)
            newton_euler.body_columns(state, block)
            for c in range(channels):
                if carries[c, b]:
                    newton_euler.project(twist[c], block, row, False)
                else:
                    row[:] = 0.0
                for s in range(count):
                    for k in range(10):
                        out[first + s, c, 10 * b + k] = row[k * LANES + s]


def link_columns(
    states: np.ndarray, twists: np.ndarray, row_of: np.ndarray, carries: np.ndarray, gravity: np.ndarray
) -> np.ndarray:
    """Derivative of the readings with respect to the bodies' parameters in their rows' frames, (N, c, 10 b)."""
    out = np.empty((len(states), len(carries), 10 * len(row_of)))
    _columns(states, twists, row_of, carries, kernel_input(gravity), out)
    return out


def is_wrench(channels: Channels) -> np.ndarray:
    """Which channels are a sensor's (c,)."""
    return np.array([name in WRENCH_NAMES for name in channels.names])


def transform_matrix(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """`bayesid.robot.inertia.transform` as a matrix (10, 10)."""
    return np.array([inertia.transform(unit, rotation, translation) for unit in np.eye(10)]).T
