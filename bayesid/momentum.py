"""Regressors of wrenches and joint torques, batched over samples, with or without accelerations.

Every channel is one idea: a **twist** S fixed in a link. Its reading is the power-conjugate of the wrench
transmitted to the bodies beyond, ``y = S' w``: the six unit twists of a sensor frame give a wrench, a joint's
axis gives its torque. With H and G the linear maps from all bodies' ten parameters phi to their spatial
momentum and weight about one fixed origin,

    w = d/dt (H phi) - G phi                                   (Newton and Euler)
    y = d/dt (P phi) - Q phi,   P = S' H,   Q = dS/dt' H + S' G

so P needs positions and velocities only; its time derivative is left to the filter (`bayesid.filters`), which
is equation 14 of [Liu1998]_ for all terms at once. Where accelerations are at hand, `dynamics_regressor` gives
``y = Y phi`` directly. Spatial vectors are (linear; angular).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from bayesid.robot import Robot

WRENCH_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True)
class Channels:
    """What is measured: twists, each fixed in a link.

    Attributes
    ----------
    names, units
        A name and unit a channel (c,).
    joint
        Joint whose frame each twist is fixed in, -1 for the root (c,).
    twist
        The twist in that frame, linear part at the frame's origin (c, 6).
    bodies
        Which bodies each channel carries (c, b).
    reference_rotation, reference_translation
        Pose in the base frame of the frame all computing is done in (3, 3), (3,); a base sensor's own
        frame, so that its rows need no projection.
    static_wrench
        Constant reading of what hangs on the sensor and does not move (c,).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    joint: np.ndarray
    twist: np.ndarray
    bodies: np.ndarray
    reference_rotation: np.ndarray
    reference_translation: np.ndarray
    static_wrench: np.ndarray

    def __len__(self) -> int:
        return len(self.names)


def wrench_channels(robot: Robot, rotation: np.ndarray, translation: np.ndarray) -> Channels:
    """Channels of the robot's force/torque sensor: force before moment, in the sensor frame.

    Parameters
    ----------
    robot
        Says in which joint the sensor sits and what it carries.
    rotation, translation
        The sensor frame's pose in the sensor joint's child link, or in the base frame (3, 3), (3,) [m].
    """
    frame_rotation = robot.sensor_rotation @ rotation
    frame_translation = robot.sensor_rotation @ translation + robot.sensor_translation
    on_root = robot.sensor_parent < 0
    twist = np.eye(6)
    if not on_root:
        # Columns: a unit force pairs with translation along a sensor axis, a unit moment with rotation
        # about it through the sensor origin p, whose velocity at the link frame's origin is p x w.
        twist = np.zeros((6, 6))
        twist[:3, :3] = twist[3:, 3:] = frame_rotation.T
        twist[3:, :3] = np.cross(frame_translation, frame_rotation.T)
    reference = (frame_rotation, frame_translation) if on_root else (np.eye(3), np.zeros(3))
    static = np.zeros(6)
    if on_root:
        mass, first_moment = robot.static_nominal[0], robot.static_nominal[1:4]
        # The sensor holds the root link up: force -m g, moment -(mc - m p) x g about the sensor origin.
        static[:3] = -mass * (frame_rotation.T @ robot.gravity)
        static[3:] = -frame_rotation.T @ np.cross(first_moment - mass * frame_translation, robot.gravity)
    return Channels(
        names=WRENCH_NAMES,
        units=("N",) * 3 + ("N m",) * 3,
        joint=np.full(6, robot.sensor_parent),
        twist=twist,
        bodies=np.tile(robot.sensor_bodies, (6, 1)),
        reference_rotation=reference[0],
        reference_translation=reference[1],
        static_wrench=static,
    )


def torque_channels(robot: Robot) -> Channels:
    """Channels of the joint torques (forces, for sliding joints) that move the rigid links."""
    twist = np.zeros((robot.n, 6))
    twist[robot.prismatic, :3] = robot.axis[robot.prismatic]
    twist[~robot.prismatic, 3:] = robot.axis[~robot.prismatic]
    return Channels(
        names=tuple(f"tau{i + 1}" for i in range(robot.n)),
        units=tuple("N" if slides else "N m" for slides in robot.prismatic),
        joint=np.arange(robot.n),
        twist=twist,
        bodies=robot.moves_with,
        reference_rotation=np.eye(3),
        reference_translation=np.zeros(3),
        static_wrench=np.zeros(robot.n),
    )


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
    out = _output(out, len(positions), channels, arguments)
    zero = out[:0]
    _regressor(False, *map(_c, (positions, velocities, accelerations)), *arguments, out, zero)
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
    momentum, rest = (_output(None, len(positions), channels, arguments) for _ in range(2))
    q, v = _c(positions), _c(velocities)
    _regressor(True, q, v, v, *arguments, momentum, rest)
    return momentum, rest


def _c(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)


def _output(out, samples, channels, arguments):
    shape = (samples, len(channels), len(arguments[-2]))
    return np.empty(shape) if out is None else out


def _arguments(robot: Robot, channels: Channels, columns, gravity: bool):
    columns = np.arange(10 * len(robot.body_names)) if columns is None else np.asarray(columns)
    rotation, translation = robot.rotation.copy(), robot.translation.copy()
    to_reference, origin = channels.reference_rotation.T, channels.reference_translation
    for i in np.flatnonzero(robot.parent < 0):
        rotation[i] = to_reference @ rotation[i]
        translation[i] = to_reference @ (translation[i] - origin)
    weight = to_reference @ robot.gravity * (1.0 if gravity else 0.0)
    one_hot = np.where(
        (channels.joint < 0) & (np.count_nonzero(channels.twist, axis=1) == 1) & (channels.twist.max(axis=1) == 1.0),
        np.argmax(channels.twist, axis=1),
        -1,
    )
    return (
        robot.order, robot.parent, rotation, translation, robot.axis, robot.prismatic, weight,
        robot.body_joint, robot.body_rotation, robot.body_translation,
        channels.joint, _c(channels.twist), one_hot, channels.bodies, columns // 10, columns % 10,
    )  # fmt: skip


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _multiply(a, b, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _apply(a, x, out):
    for i in range(3):
        out[i] = a[i, 0] * x[0] + a[i, 1] * x[1] + a[i, 2] * x[2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rotate_about(axis, angle, out):
    """Rodrigues' rotation matrix."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z, k = axis[0], axis[1], axis[2], 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + k * x * x, k * x * y - s * z, k * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = k * x * y + s * z, c + k * y * y, k * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = k * x * z - s * y, k * y * z + s * x, c + k * z * z


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _body_columns(rotation, origin, linear, w, spin, spin_rate, gyroscopic, out):
    """Six rows by ten columns of one body: d/dt of its momentum, its momentum or its weight, by inputs.

    A point r of the body contributes the vector ``linear + w r`` times its mass; the rotational inertia
    contributes R L(R' spin_rate) (+ R spin x L(spin), if gyroscopic), L(x) I = I x.
    """
    moment = np.empty(3)
    column = np.empty(3)
    force = np.empty(3)
    out[:3, 0] = linear
    _cross(origin, linear, moment)
    out[3:, 0] = moment
    for k in range(3):
        column[:] = rotation[:, k]
        _apply(w, column, force)
        out[:3, 1 + k] = force
        _cross(origin, force, moment)
        out[3:, 1 + k] = moment
        _cross(column, linear, moment)
        out[3:, 1 + k] += moment
    out[:3, 4:] = 0.0
    x, y, z = 0.0, 0.0, 0.0
    a, b, c = 0.0, 0.0, 0.0
    for i in range(3):
        x += rotation[i, 0] * spin_rate[i]
        y += rotation[i, 1] * spin_rate[i]
        z += rotation[i, 2] * spin_rate[i]
        a += rotation[i, 0] * spin[i]
        b += rotation[i, 1] * spin[i]
        c += rotation[i, 2] * spin[i]
    if not gyroscopic:
        a = b = c = 0.0
    local = np.empty((3, 6))
    # Columns Ixx, Ixy, Iyy, Ixz, Iyz, Izz of L(alpha) + [w]x L(w) in body axes.
    local[0, 0], local[1, 0], local[2, 0] = x, c * a, -b * a
    local[0, 1], local[1, 1], local[2, 1] = y - c * a, x + c * b, a * a - b * b
    local[0, 2], local[1, 2], local[2, 2] = -c * b, y, a * b
    local[0, 3], local[1, 3], local[2, 3] = z + b * a, c * c - a * a, x - b * c
    local[0, 4], local[1, 4], local[2, 4] = b * b - c * c, z - a * b, y + a * c
    local[0, 5], local[1, 5], local[2, 5] = b * c, -a * c, z
    for k in range(6):
        for i in range(3):
            out[3 + i, 4 + k] = (
                rotation[i, 0] * local[0, k] + rotation[i, 1] * local[1, k] + rotation[i, 2] * local[2, k]
            )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _regressor(
    by_momentum, q, v, a,
    order, parent, placement_r, placement_p, axis, prismatic, gravity,
    body_joint, body_r, body_p, channel_joint, channel_twist, one_hot, carries, column_body, column_parameter,
    out, rest,
):  # fmt: skip
    n, bodies, channels, columns = len(order), len(body_joint), len(channel_joint), len(column_body)
    rotation, origin = np.zeros((n, 3, 3)), np.zeros((n, 3))
    w, dw, velocity, acceleration = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    frame, turn = np.empty((3, 3)), np.empty((3, 3))
    offset, direction, t1, t2 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    zero, no_turn = np.zeros(3), np.zeros((3, 3))
    matrix, point, linear, map_w = np.empty((3, 3)), np.empty(3), np.empty(3), np.zeros((3, 3))
    block, weight = np.zeros((bodies, 6, 10)), np.zeros((bodies, 6, 10))
    twist, twist_rate = np.zeros((channels, 6)), np.zeros((channels, 6))
    used = np.zeros(bodies, np.bool_)
    used[column_body] = True

    for sample in range(len(q)):
        for step in range(n):
            i = order[step]
            up = parent[i]
            if up < 0:
                frame[:] = placement_r[i]
                origin[i] = placement_p[i]
                w[i] = 0.0
                dw[i] = 0.0
                velocity[i] = 0.0
                acceleration[i] = -gravity
            else:
                _multiply(rotation[up], placement_r[i], frame)
                _apply(rotation[up], placement_p[i], offset)
                origin[i] = origin[up] + offset
                w[i] = w[up]
                dw[i] = dw[up]
                _cross(w[up], offset, t1)
                velocity[i] = velocity[up] + t1
                _cross(w[up], t1, t2)
                _cross(dw[up], offset, t1)
                acceleration[i] = acceleration[up] + t1 + t2
            _apply(frame, axis[i], direction)
            rate, rate2 = v[sample, i], a[sample, i]
            if prismatic[i]:
                rotation[i] = frame
                for k in range(3):
                    offset[k] = q[sample, i] * direction[k]
                    origin[i, k] += offset[k]
                _cross(w[i], offset, t1)
                _cross(w[i], t1, t2)
                velocity[i] += t1 + rate * direction
                acceleration[i] += t2 + rate2 * direction
                _cross(dw[i], offset, t1)
                acceleration[i] += t1
                _cross(w[i], direction, t1)
                acceleration[i] += 2.0 * rate * t1
            else:
                _rotate_about(axis[i], q[sample, i], turn)
                _multiply(frame, turn, rotation[i])
                _cross(w[i], direction, t1)
                for k in range(3):
                    w[i, k] += rate * direction[k]
                    dw[i, k] += rate2 * direction[k] + rate * t1[k]

        for body in range(bodies):
            if not used[body]:
                continue
            i = body_joint[body]
            _multiply(rotation[i], body_r[body], matrix)
            _apply(rotation[i], body_p[body], offset)
            point[:] = origin[i] + offset
            x, y, z = w[i, 0], w[i, 1], w[i, 2]
            _cross(w[i], offset, t1)
            if by_momentum:
                linear[:] = velocity[i] + t1
                map_w[0, 1], map_w[0, 2], map_w[1, 2] = -z, y, -x
                map_w[1, 0], map_w[2, 0], map_w[2, 1] = z, -y, x
                map_w[0, 0] = map_w[1, 1] = map_w[2, 2] = 0.0
                _body_columns(matrix, point, linear, map_w, zero, w[i], False, block[body])
                _body_columns(matrix, point, gravity, no_turn, zero, zero, False, weight[body])
            else:
                _cross(w[i], t1, t2)
                _cross(dw[i], offset, t1)
                linear[:] = acceleration[i] + t1 + t2
                d, e, f = dw[i, 0], dw[i, 1], dw[i, 2]
                # [dw]x + [w]x [w]x
                map_w[0, 0], map_w[1, 1], map_w[2, 2] = -y * y - z * z, -x * x - z * z, -x * x - y * y
                map_w[0, 1], map_w[1, 0] = x * y - f, x * y + f
                map_w[0, 2], map_w[2, 0] = x * z + e, x * z - e
                map_w[1, 2], map_w[2, 1] = y * z - d, y * z + d
                _body_columns(matrix, point, linear, map_w, w[i], dw[i], True, block[body])

        for c in range(channels):
            j = channel_joint[c]
            if j < 0:
                twist[c] = channel_twist[c]
                continue
            # Into the computing frame, linear part at its origin: s -> (R s_l + p x R s_a; R s_a).
            _apply(rotation[j], channel_twist[c, 3:], t1)
            _apply(rotation[j], channel_twist[c, :3], t2)
            twist[c, 3:] = t1
            _cross(origin[j], t1, offset)
            twist[c, :3] = t2 + offset
            if by_momentum:
                # Rate of a twist fixed in a frame with spatial velocity (v0; w): the motion cross product.
                _cross(w[j], origin[j], t2)
                t2[:] = velocity[j] - t2
                _cross(t2, t1, offset)
                _cross(w[j], twist[c, :3], t2)
                twist_rate[c, :3] = t2 + offset
                _cross(w[j], t1, t2)
                twist_rate[c, 3:] = t2

        for c in range(channels):
            axis_only, moving = one_hot[c], channel_joint[c] >= 0
            for column in range(columns):
                body, k = column_body[column], column_parameter[column]
                if not carries[c, body]:
                    out[sample, c, column] = 0.0
                    if by_momentum:
                        rest[sample, c, column] = 0.0
                    continue
                if axis_only >= 0:
                    out[sample, c, column] = block[body, axis_only, k]
                    if by_momentum:
                        rest[sample, c, column] = weight[body, axis_only, k]
                    continue
                total, other = 0.0, 0.0
                for row in range(0 if k < 4 else 3, 6):
                    total += twist[c, row] * block[body, row, k]
                out[sample, c, column] = total
                if by_momentum:
                    for row in range(6):
                        other += twist[c, row] * weight[body, row, k]
                        if moving:
                            other += twist_rate[c, row] * block[body, row, k]
                    rest[sample, c, column] = other
