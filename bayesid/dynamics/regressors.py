"""Regressors of wrenches and joint torques, batched over samples, with or without accelerations.

Every channel is a twist S fixed in a link, with reading ``y = S' w`` (`bayesid.dynamics.channels`). With H and G the linear maps
from all bodies' ten parameters phi to their spatial momentum and weight about one fixed origin,

    w = d/dt (H phi) - G phi                                   (Newton and Euler)
    y = d/dt (P phi) - Q phi,   P = S' H,   Q = dS/dt' H + S' G

so P needs positions and velocities only; its time derivative is left to the filter (`bayesid.signals.filters`), which
is equation 14 of [Liu1998]_ for all terms at once. Where accelerations are at hand, `Kernel.dynamics` gives
``y = Y phi`` directly. Spatial vectors are (linear; angular).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.dynamics import newton_euler
from bayesid.dynamics.channels import Channels
from bayesid.dynamics.newton_euler import BLOCK, LANES, jit
from bayesid.robot.robot import Robot
from bayesid.signals.arrays import kernel_input


@dataclass(frozen=True)
class Kernel:
    """Regressors of one robot's channels, with all that does not depend on the samples worked out once.

    Its arrays can be written, as they can after pickling: the compiled loops are compiled for one kind of array.
    """

    #: A chain of rows (the joints, then split bodies), twists and columns by body, as the compiled loops take them.
    tables: tuple[Any, ...]
    gravity: np.ndarray  # in the frame of computing (3,) [m/s^2]
    columns: int  # how many columns the regressor has

    @classmethod
    def of(cls, robot: Robot, channels: Channels, columns: np.ndarray | None = None) -> Kernel:
        """Tables of a robot and its channels, for columns by their indices into ``robot.parameter_names``; default all."""
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
        # Twists of one unit entry fixed in the root pick a row of the block, without a product.
        pick = (channels.joint < 0) & (np.count_nonzero(channels.twist, axis=1) == 1) & (channels.twist.max(axis=1) == 1.0)
        by_body = np.argsort(columns // 10, kind="stable")
        tables = (
            *chain(np.append(robot.order, np.arange(n, bodies)), parent, placement, translation, axis, slides),
            channels.joint, np.array(channels.twist, float), np.where(pick, np.argmax(channels.twist, axis=1), -1),
            channels.bodies, np.searchsorted(columns[by_body] // 10, np.arange(bodies + 1)), by_body, columns[by_body] % 10,
        )  # fmt: skip
        return cls(tables, to_reference @ robot.gravity, len(columns))

    def dynamics(
        self,
        positions: np.ndarray,
        velocities: np.ndarray,
        accelerations: np.ndarray,
        *,
        gravity: bool = True,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Regressor Y with ``reading = Y phi`` (samples, channels, columns) of a joint motion (samples, n), into ``out`` if any.

        Without ``gravity`` the weight is no part of the reading: the motion wrench of [Liu1998]_ equation 24.
        """
        out = np.empty((len(positions), self._channels, self.columns)) if out is None else out
        q, v, a = map(kernel_input, (positions, velocities, accelerations))
        _regressor(False, q, v, a, *self._chain(gravity), *self.tables[6:], out, out[:0])
        return out

    def momentum(self, positions: np.ndarray, velocities: np.ndarray, *, gravity: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Regressors P, Q with ``reading = d/dt(P phi) - Q phi``, each (samples, channels, columns).

        Parameters are those of `dynamics`; no acceleration is needed.
        """
        momentum, rest = np.empty((2, len(positions), self._channels, self.columns))
        q, v = kernel_input(positions), kernel_input(velocities)
        _regressor(True, q, v, v, *self._chain(gravity), *self.tables[6:], momentum, rest)
        return momentum, rest

    def readings(
        self,
        positions: np.ndarray,
        velocities: np.ndarray,
        accelerations: np.ndarray,
        links: np.ndarray,
        *,
        gravity: bool = True,
    ) -> np.ndarray:
        """``Y phi`` of all columns without Y: inverse dynamics (samples, channels); the rest as for `dynamics`.

        ``links`` are ten parameters a body, in the order of ``robot.parameter_names`` (10 bodies,); they need not be possible
        ones.
        """
        q, v, a = map(kernel_input, (positions, velocities, accelerations))
        out = np.empty((len(q), self._channels))
        links = kernel_input(links).reshape(-1, 10)
        add_up_readings(q, v, a, *self._chain(gravity), *self.tables[6:10], np.arange(len(links)), links, out)
        return out

    @property
    def _channels(self) -> int:
        return len(self.tables[6])

    def _chain(self, gravity: bool) -> tuple[Any, ...]:
        return *self.tables[:6], self.gravity if gravity else np.zeros(3)


def chain(
    order: np.ndarray, parent: np.ndarray, rotation: np.ndarray, translation: np.ndarray, axis: np.ndarray, slides: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Joints (r,) as the compiled loops take them, by placements in their parents, (r, 3, 3), (r, 3) [m], and axes (r, 3)."""
    # Rodrigues: placement times turn(q) = turn[0] + cos(q) turn[1] + sin(q) turn[2].
    along = axis[:, :, None] * axis[:, None, :]
    turn = rotation[:, None] @ np.stack([along, np.eye(3) - along, np.cross(axis[:, None], np.eye(3)).swapaxes(1, 2)], 1)
    turn[slides] = 0.0
    turn[slides, 0] = rotation[slides]
    axis = np.einsum("rij,rj->ri", rotation, axis)
    return order, parent, turn.reshape(-1, 27), translation, axis, slides.astype(float)


@jit
def _regressor(
    by_momentum, q, v, a,
    order, parent, turn, translation, axis, slides, gravity,
    twist_row, fixed_twist, pick, carries, start, column, parameter, out, rest,
):  # fmt: skip
    """Fill ``out`` with Y; by momentum ``out`` with P and ``rest`` with Q.

    The momentum is the rate of momentum of the same robot that starts from rest with the velocities for its
    accelerations, without weight; so `advance` then has the spin for w' and the velocity for A.
    """
    bodies, channels, samples = len(parent), len(twist_row), len(q)
    state, motion = newton_euler.at_rest(bodies, gravity, by_momentum), np.zeros((bodies, 5 * LANES))
    block, weight, row, other = np.zeros(6 * BLOCK), np.zeros(6 * BLOCK), np.zeros(BLOCK), np.zeros(BLOCK)
    twist, twist_rate = np.zeros((channels, 6 * LANES)), np.zeros((channels, 6 * LANES))
    for c in range(channels):
        for k in range(6):
            twist[c, k * LANES : (k + 1) * LANES] = fixed_twist[c, k]

    for first in range(0, samples, LANES):
        count = min(LANES, samples - first)
        if not carries.all():
            out[first : first + count], rest[first : first + count] = 0.0, 0.0
        newton_euler.set_motion(motion, q, v, a, first, count, by_momentum)
        for i in order:
            newton_euler.advance(state[parent[i]], state[i], motion[i], turn[i], translation[i], axis[i], slides[i])
        for c in range(channels):
            if twist_row[c] >= 0:
                newton_euler.twist_and_rate(state[twist_row[c]], fixed_twist[c], twist[c], twist_rate[c])
        for body in range(bodies):
            mine, which = column[start[body] : start[body + 1]], parameter[start[body] : start[body + 1]]
            if len(mine) == 0:
                continue
            newton_euler.body_columns(state[body], block)
            if by_momentum:
                newton_euler.weight_columns(state[body], gravity, weight)
            for c in range(channels):
                if not carries[c, body]:
                    continue
                values, others, here = row, other, pick[c] * BLOCK
                if here >= 0:
                    values, others = block[here : here + BLOCK], weight[here : here + BLOCK]
                else:
                    newton_euler.project(twist[c], block, row, False)
                    if by_momentum:
                        newton_euler.project(twist[c], weight, other, False)
                        newton_euler.project(twist_rate[c], block, other, True)
                newton_euler.store(values, out, first, count, c, mine, which)
                if by_momentum:
                    newton_euler.store(others, rest, first, count, c, mine, which)


@jit
def add_up_readings(
    q, v, a, order, parent, turn, translation, axis, slides, gravity, twist_row, fixed_twist, pick, carries, row_of, links, out
):
    """Fill ``out`` (N, c) with readings of bodies of parameters ``links`` (b, 10), each moving with its row ``row_of`` (b,).

    ``carries`` (c, b) says which bodies a channel carries.
    """
    bodies, channels, samples = len(links), len(twist_row), len(q)
    state, motion = newton_euler.at_rest(len(parent), gravity, False), np.zeros((len(parent), 5 * LANES))
    wrench, total = np.zeros((bodies, 6 * LANES)), np.zeros(6 * LANES)
    twist, twist_rate = np.zeros(6 * LANES), np.zeros(6 * LANES)
    for first in range(0, samples, LANES):
        count = min(LANES, samples - first)
        newton_euler.set_motion(motion, q, v, a, first, count, False)
        for i in order:
            newton_euler.advance(state[parent[i]], state[i], motion[i], turn[i], translation[i], axis[i], slides[i])
        for body in range(bodies):
            newton_euler.body_wrench(state[row_of[body]], links[body], wrench[body])
        for c in range(channels):
            total[:] = 0.0
            for body in range(bodies):
                if carries[c, body]:
                    for k in range(6 * LANES):
                        total[k] += wrench[body, k]
            if pick[c] >= 0:
                for s in range(count):
                    out[first + s, c] = total[pick[c] * LANES + s]
                continue
            if twist_row[c] >= 0:
                newton_euler.twist_and_rate(state[twist_row[c]], fixed_twist[c], twist, twist_rate)
            else:
                for k in range(6):
                    twist[k * LANES : (k + 1) * LANES] = fixed_twist[c, k]
            for s in range(count):
                power = 0.0
                for k in range(6):
                    power += twist[k * LANES + s] * total[k * LANES + s]
                out[first + s, c] = power
