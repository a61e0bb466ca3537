"""What pulls or pushes the links from outside: a tether, the air, a hand."""

from __future__ import annotations

from functools import partial
from itertools import product
from math import inf

import numpy as np

from bayesid.dynamics.kinematics import P, R, V, W
from bayesid.effects import sizes
from bayesid.effects.bodies import body_of
from bayesid.effects.effect import Linearisation, Parameter
from bayesid.effects.families import LoadEffect, Loads

#: A contact grows and fades in this time, within its window [s].
CONTACT_RAMP = 0.2
#: Lengths of a tether that an exact fit starts from [m].
TETHER_LENGTHS = (0.8, 2.0)
#: Windows of a contact one beside the other that a fit may start from.
_MOST_WINDOWS = 16
#: Along the axes, the edges and the diagonals of a cube.
_DIRECTIONS = tuple(np.array(way) / np.linalg.norm(way) for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way))
_POINT = tuple(
    Parameter(f"point_{axis}", "m", -1.0, 1.0, typical=x, linear=False) for axis, x in (("x", 0.05), ("y", 0.03), ("z", 0.08))
)
# Drag along a rod: five Gauss points, exact for the linear part, ample for |v| v.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def _at(state: np.ndarray, row: int, point) -> np.ndarray:
    """A point of a link in the base frame (N, 3)."""
    return state[:, row, P : P + 3] + _along(state, row, point)


def _along(state: np.ndarray, row: int, direction) -> np.ndarray:
    """A vector fixed in a link in base axes (N, 3)."""
    x = state[:, row]
    return sum((float(c) * x[:, R + k : R + 9 : 3] for k, c in enumerate(direction)), np.zeros(()))


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Row by row, of vectors (N, 3) or (N, 3, k); `np.cross` takes several times as long."""
    out = np.empty(np.broadcast_shapes(one.shape, other.shape))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[:, k] = one[:, i] * other[:, j] - one[:, j] * other[:, i]
    return out


def _wrench(points: np.ndarray, force: np.ndarray) -> np.ndarray:
    """A force (N, 3) at points (N, 3) as a wrench about the origin (N, 6); so, too, of changes (N, 3, k) at (N, 3, 1)."""
    return np.concatenate([force, _cross(points, force)], axis=1)


def _axes(state: np.ndarray, row: int) -> np.ndarray:
    """A link's axes in base axes, the columns of its rotation (N, 3, 3)."""
    return state[:, row, R : R + 9].reshape(-1, 3, 3)


class Tether(LoadEffect):
    name = "tether"
    summary = "a hose or cable pulls a link, like a one-sided spring"
    equation = "$k \\max(\\lVert d\\rVert - L, 0)\\,d / \\lVert d\\rVert$ on the point, $d$ from there to the anchor"
    source = "one-sided linear spring"
    quantities = (
        Parameter("stiffness", "N/m", lower=0.0, start=10.0),
        Parameter("rest_length", "m", 0.0, 10.0, start=0.3, linear=False),
        Parameter("anchor_x", "m", -10.0, 10.0, linear=False),
        Parameter("anchor_y", "m", -10.0, 10.0, linear=False),
        Parameter("anchor_z", "m", -10.0, 10.0, start=1.5, linear=False),
        *_POINT,
    )
    confusable_with = ("base_tilt", "tether")
    single = True

    def typical(self, robot):
        long = sizes.reach(robot)
        return [sizes.push(robot) / long, 0.3 * long, 0.4 * long, -0.5 * long, 1.5 * long, *(p.typical for p in _POINT)]

    def loads(self, robot, segment, states, values) -> Loads:
        assert self.joint is not None
        stiffness, length = values[:2]
        points = _at(states, self.joint, values[5:8])
        line = np.asarray(values[2:5]) - points
        distance = np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-12)
        force = stiffness * np.maximum(distance - length, 0.0) * line / distance
        return [(body_of(robot, self.joint), _wrench(points, force))]

    def load_columns(self, robot, segment, states, values) -> Loads:
        # With u = d / |d|, where it is taut: dF = (|d| - L) u dk - k u dL + k [(1 - L / |d|) 1 + L / |d| u u'] (da - dp).
        assert self.joint is not None
        stiffness, length = values[:2]
        points, axes = _at(states, self.joint, values[5:8]), _axes(states, self.joint)
        line = np.asarray(values[2:5]) - points
        distance = np.maximum(np.linalg.norm(line, axis=1), 1e-12)[:, None]
        unit, taut = line / distance, distance > length
        stretch, slack = np.where(taut, distance - length, 0.0), np.where(taut, length / distance, 0.0)[:, :, None]
        pulls = np.empty((len(points), 3, 8))
        pulls[:, :, 0], pulls[:, :, 1] = stretch * unit, -stiffness * taut * unit
        along = np.where(taut, 1.0, 0.0)[:, :, None] * np.eye(3) - slack * np.eye(3)
        pulls[:, :, 2:5] = stiffness * (along + slack * unit[:, :, None] * unit[:, None, :])
        pulls[:, :, 5:] = -(pulls[:, :, 2:5] @ axes)
        out = _wrench(points[:, :, None], pulls)
        out[:, 3:, 5:] += _cross(axes, (stiffness * stretch * unit)[:, :, None])  # as the point moves
        return [(body_of(robot, self.joint), out)]

    def linearisations(self, around):
        # A taut tether without length pulls with k (anchor - x): linear in k and k anchor, whose columns are the derivatives
        # at k = 1 with the anchor at the origin.
        centre = around.mean_places[self.joint or 0]
        at = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        return (Linearisation(at, partial(_tethers, centre=centre), _pulls),)

    def starts_tried(self, around):
        # Anchors all around the link's mean place, a third of the length slack.
        centre = around.mean_places[self.joint or 0]
        stiffness = self.typical(around.robot)[0]
        return np.array([[stiffness, 0.3 * x, *(centre + x * way), 0.0, 0.0, 0.0] for x in TETHER_LENGTHS for way in _DIRECTIONS])


def _pulls(values: np.ndarray) -> np.ndarray:
    """Amplitudes of k and k anchor."""
    return np.array([values[0], 0.0, *(values[0] * values[2:5]), 0.0, 0.0, 0.0])


def _tethers(a: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Tethers of several lengths (m, 8) whose mean pull is that of ``k (anchor - x)``, from amplitudes at k = 1, anchor 0.

    A short motion shows the pull, hardly where it comes from; so the anchor is put at a likely distance from the link's
    mean place (3,), with a third of the length slack, and the exact fit moves it.
    """
    pull = a[2:5] - a[0] * centre
    size = max(float(np.linalg.norm(pull)), 1e-12)
    return np.array([[size / (0.7 * x), 0.3 * x, *(centre + pull / size * x), 0.0, 0.0, 0.0] for x in TETHER_LENGTHS])


class ExternalContact(LoadEffect):
    name = "external_contact"
    at = "joint|robot"
    summary = "something pushes a link for part of the time"
    equation = "force $F$ in base axes on the point, from start to end, with ramps of 0.2 s along half a cosine"
    quantities = (
        Parameter("start", "s", typical=2.0, linear=False, step=1e-3),
        Parameter("end", "s", start=1.0, typical=4.0, linear=False, step=1e-3),
        Parameter("fx", "N", start=1.0),
        Parameter("fy", "N", start=1.0),
        Parameter("fz", "N", start=1.0),
        *_POINT,
    )
    confusable_with = ("external_contact", "tether")
    once = True
    single = True
    #: Lengths of the time windows in which it is sought [s].
    windows = (0.4, 0.7, 1.2, 2.0, 3.5, 6.0, 10.0)

    def typical(self, robot):
        push = sizes.push(robot)
        return [2.0, 4.0, push, -0.6 * push, 0.8 * push, *(p.typical for p in _POINT)]

    def loads(self, robot, segment, states, values) -> Loads:
        row = robot.n if self.joint is None else self.joint
        points = _at(states, row, values[5:8])
        force = contact_window(segment.times, values[0], values[1])[:, None] * np.asarray(values[2:5])
        if segment.still:  # it pushed while the robot moved, not when it was stopped for a reading
            force = np.zeros_like(force)
        return [(body_of(robot, self.joint), _wrench(points, force))]

    def load_columns(self, robot, segment, states, values) -> Loads:
        row = robot.n if self.joint is None else self.joint
        points, axes, push = _at(states, row, values[5:8]), _axes(states, row), np.asarray(values[2:5], float)
        out = np.zeros((len(points), 6, 8))
        if not segment.still:
            share = contact_window(segment.times, values[0], values[1])[:, None]
            pushes = np.zeros((len(points), 3, 8))
            pushes[:, :, :2] = push[:, None] * _window_slopes(segment.times, values[0], values[1])[:, None, :]
            pushes[:, :, 2:5] = share[:, :, None] * np.eye(3)
            out = _wrench(points[:, :, None], pushes)
            out[:, 3:, 5:] += _cross(axes, (share * push)[:, :, None])
        return [(body_of(robot, self.joint), out)]

    def linearisations(self, around):
        return ()  # it is sought in windows of time

    def starts_tried(self, around):
        # Windows of several lengths, each half a length after the one before.
        first, last = around.times
        lengths = [x for x in self.windows if (last - first) / _MOST_WINDOWS < x < last - first]
        begins = [(begin, x) for x in lengths for begin in np.arange(first, last - 0.5 * x, 0.5 * x)]
        return np.array([[begin, begin + x, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0] for begin, x in begins]).reshape(-1, 8)


class ContactAnywhere(LoadEffect):
    """A contact whose point is not known: linear in its force f and in the products of that with the point r. It has no name."""

    at = "joint|robot"
    quantities = (
        *ExternalContact.quantities[:5],
        *(Parameter(f"{force}_{point}", "N m") for force in ("fx", "fy", "fz") for point in ("x", "y", "z")),
    )
    once = True

    def loads(self, robot, segment, states, values) -> Loads:
        return [(body, x[:, :, 2:] @ np.asarray(values[2:])) for body, x in self.load_columns(robot, segment, states, values)]

    def load_columns(self, robot, segment, states, values) -> Loads:
        # Of the window alone: no force is known yet that it could move.
        row = robot.n if self.joint is None else self.joint
        axes, out = _axes(states, row), np.zeros((len(states), 6, 14))
        if not segment.still:
            pushes = contact_window(segment.times, values[0], values[1])[:, None, None] * np.eye(3)
            out[:, :, 2:5] = _wrench(_at(states, row, (0.0, 0.0, 0.0))[:, :, None], pushes)
            for k in range(3):
                out[:, 3:, 5 + 3 * k : 8 + 3 * k] = _cross(axes, pushes[:, :, k, None])
        return [(body_of(robot, self.joint), out)]


def contact_window(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """Share of a contact's force at each time (N,): up from its start and down to its end, along half a cosine."""
    share = np.clip(np.minimum((times - start) / CONTACT_RAMP, (end - times) / CONTACT_RAMP), 0.0, 1.0)
    return 0.5 - 0.5 * np.cos(np.pi * share)


def _window_slopes(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """Derivatives of that share with respect to start and end (N, 2) [1/s]."""
    ramps = np.stack([(times - start) / CONTACT_RAMP, (end - times) / CONTACT_RAMP], axis=1)
    share = ramps.min(axis=1, keepdims=True)
    steep = 0.5 * np.pi / CONTACT_RAMP * np.sin(np.pi * np.clip(share, 0.0, 1.0))  # zero on and outside of the window
    return np.where(ramps == share, steep * np.array([-1.0, 1.0]), 0.0)


class FluidDrag(LoadEffect):
    name = "fluid_drag"
    at = "robot"
    summary = "drag of air or water along the links"
    equation = "$-(l + q\\lVert v\\rVert)\\,v$ per metre of the straight rods between joint origins"
    source = "integral of the drag on a rod's elements"
    quantities = (Parameter("linear", "N s/m^2", 0.0, inf), Parameter("quadratic", "N s^2/m^3", 0.0, inf))
    confusable_with = ("viscous_friction", "sensor_delay")

    def typical(self, robot):
        return [0.5 * sizes.push(robot) / sizes.reach(robot)] * 2

    def loads(self, robot, segment, states, values) -> Loads:
        linear, quadratic = values
        out: dict[int, np.ndarray] = {}
        for joint, body, ends in zip(robot.rod_joint, map(int, robot.rod_body), robot.rods, strict=True):
            rod = ends[1] - ends[0]
            length = float(np.linalg.norm(rod))
            if length < 1e-9:
                continue
            x = states[:, joint]
            start, along = _at(states, joint, ends[0]), _along(states, joint, rod)
            spin, force, later = x[:, W : W + 3], np.zeros_like(start), np.zeros_like(start)
            velocity, change = x[:, V : V + 3] + _cross(spin, start - x[:, P : P + 3]), _cross(spin, along)
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                share = 0.5 * (1.0 + node)  # of the way along the rod
                speed = velocity + share * change
                size = linear + quadratic * np.sqrt(np.sum(speed * speed, axis=1, keepdims=True))
                pull = -0.5 * weight * length * size * speed
                force += pull
                later += share * pull
            wrench = _wrench(start, force)
            wrench[:, 3:] += _cross(along, later)
            out[body] = out[body] + wrench if body in out else wrench
        return list(out.items())
