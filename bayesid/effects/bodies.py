"""Bodies more or less on a link, and rotors that spin in one."""

from __future__ import annotations

from functools import partial
from math import inf

import numpy as np

from bayesid.dynamics.kinematics import DW, R, W, transform_matrix
from bayesid.effects import sizes
from bayesid.effects.effect import Parameter, Term
from bayesid.effects.families import BodyEffect, RotorEffect
from bayesid.robot import inertia
from bayesid.robot.robot import Robot


def body_of(robot: Robot, joint: int | None) -> int:
    """Index of the body that something on a joint's link sits on; the last one, b, is the root.

    Where a sensor splits the link it is the part beyond the sensor, where tools, tethers and hands are.
    """
    if joint is None or joint < 0:
        return len(robot.body_names)
    split = np.flatnonzero(robot.body_joint[robot.n :] == joint)
    return int(robot.n + split[0]) if len(split) else joint


def _compact(robot: Robot, joint: int | None) -> tuple[float, ...]:
    """A compact body (10,) of a tenth of the moved mass, in the last link at most a kilogram or so, off the joint's axis."""
    m, r = 0.1 * sizes.mass_beyond(robot, joint), 0.1 * sizes.reach(robot)
    first, second = np.array([0.5, 0.3, 0.6]), np.array([1.0, -0.15, 0.9, -0.3, -0.18, 0.8])
    return (m, *(first * m * r), *(second * m * r * r))


class Payload(BodyEffect):
    name = "payload"
    summary = "a body is attached to a link"
    equation = "a possible body in the joint's frame; on the far side of a sensor in that link"
    quantities = tuple(Parameter(n, u, 0.0 if n == "m" else -inf) for n, u in zip(inertia.PARAMETERS, inertia.UNITS, strict=True))
    confusable_with = ("inertia_error", "payload")
    columns_of = "inertia_error"  # which of the two it is, the fit decides

    def typical(self, robot):
        return _compact(robot, self.joint)

    def sought(self, around):
        return False

    def derived(self, values, covariance):
        # The centre of mass c = mc / m, also of what was taken away, whose mass and first moments are negative.
        mass, out = values[0], []
        for k, axis in enumerate("xyz", 1):
            c = values[k] / mass if mass else np.nan
            variance = covariance[k, k] - 2.0 * c * covariance[0, k] + c**2 * covariance[0, 0]
            out.append((f"c{axis}", float(c), float(np.sqrt(np.abs(variance)) / abs(mass)) if mass else np.nan, "m"))
        return tuple(out)


class InertiaError(BodyEffect):
    name = "inertia_error"
    summary = "a link's nominal inertia is wrong"
    equation = "the same, but the change need not be a possible body"
    quantities = tuple(Parameter(n, u) for n, u in zip(inertia.PARAMETERS, inertia.UNITS, strict=True))
    confusable_with = ("payload", "inertia_error", "rotor_momentum", "rotor_inertia")
    may_be = "payload"

    def typical(self, robot):
        # Mass that is there, but further out than its nominal moment of inertia says: no body is that.
        body = _compact(robot, self.joint)
        return (0.0, *body[1:4], *(0.0,) * 6)

    def sought(self, around):
        return around.links_known


class RotorMomentum(RotorEffect):
    name = "rotor_momentum"
    summary = "angular momentum of a spinning rotor"
    equation = (
        "moment $J\\,\\mathrm{d}(\\dot q z)/\\mathrm{d}t$ on what the joint's parent is carried by; on its own torque "
        "$J z \\cdot \\dot\\omega$, and gear ratio $\\times J \\ddot q$ where `gear_ratio` is stated"
    )
    source = "angular momentum, cf. [Spong1987](references.md), which leaves it out"
    quantities = (
        Parameter("inertia", "kg m^2", lower=0.0, typical=partial(sizes.effort, share=1e-4), sliding="kg m", lasting=True),
    )
    along_joint = True  # the gear ratio is per radian or per metre
    confusable_with = ("inertia_error", "rotor_inertia")

    def sought(self, around):
        # In a wrench or in torques alone it is a change of two links.
        return around.both_channels or around.links_known

    def same_as(self, values, around, beside):
        # A turning joint's axis z is fixed in both of its links, which turn against each other at qd: the momentum J qd z is that
        # of an inertia J about z, more in the joint's link and less in its parent. Only the joint's own torque tells how much of
        # it the joint turns, and that is a rotor inertia.
        absorbed = any(e.name == "rotor_inertia" and e.joint == self.joint for e in beside)
        if (around.torques and not absorbed) or self.slides:
            return ()
        robot, joint = around.robot, self.joint or 0
        parent, axis = int(robot.parent[joint]), robot.axis[joint]
        changes = [(joint, values[0], axis), (parent, -values[0], robot.rotation[joint] @ axis)]
        return tuple(
            Term(InertiaError(f"joint{k + 1}", k), (0.0,) * 4 + tuple(size * np.outer(z, z)[np.tril_indices(3)]))
            for k, size, z in changes
            if k >= 0
        )


def rotor_couple(robot: Robot, states: np.ndarray, joint: int, velocity: np.ndarray, acceleration: np.ndarray):
    """The body, couple (N, 6) and joint torque (N,) of a rotor's momentum, per unit of ``gear ratio x rotor inertia``.

    The momentum is ``h = qd z`` with the joint's axis z fixed in the parent link, so ``dh/dt = qdd z + qd w x z``: a couple
    that the parent's body takes. The joint itself feels the rotor's turning with the parent, ``z . dw``.
    """
    parent = int(robot.parent[joint])
    up = states[:, parent if parent >= 0 else robot.n]
    axis = up[:, R : R + 9].reshape(-1, 3, 3) @ (robot.rotation[joint] @ robot.axis[joint])
    couple = acceleration[:, None] * axis + velocity[:, None] * np.cross(up[:, W : W + 3], axis)
    own = np.sum(axis * up[:, DW : DW + 3], axis=1)
    body = parent if parent >= 0 else len(robot.body_names)
    far = body_of(robot, parent)
    if parent >= 0 and far != parent and robot.sensor_bodies[joint]:
        body = far  # the joint hangs on the part beyond the sensor
    return body, np.concatenate([np.zeros_like(couple), couple], axis=1), own


def split_matrix(robot: Robot, body: int) -> np.ndarray:
    """Map from a split body's parameters to those in its joint's frame (10, 10)."""
    return transform_matrix(robot.body_rotation[body], robot.body_translation[body])
