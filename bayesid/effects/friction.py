"""Friction inside a joint."""

from __future__ import annotations

from math import inf

import numpy as np

from bayesid.effects import sizes
from bayesid.effects.effect import Parameter
from bayesid.effects.families import JointTorqueEffect

_ARMSTRONG = "[Armstrong1994](references.md)"
#: Speeds below which a Stribeck law may fall [rad/s or m/s].
STRIBECK_SPEEDS = tuple(float(v) for v in np.geomspace(0.01, 0.6, 8))


class ViscousFriction(JointTorqueEffect):
    name = "viscous_friction"
    summary = "friction in proportion to velocity"
    equation = "$c\\,\\dot q$"
    source = _ARMSTRONG
    quantities = (Parameter("coefficient", "N m s/rad", lower=0.0),)
    confusable_with = ("coulomb_friction", "fluid_drag")
    urdf_dynamics = "damping"

    def typical(self, robot):
        return [0.06 * sizes.effort(robot, self.joint) / sizes.speed(robot, self.joint)]

    def torque(self, motion, values):
        return values[0] * motion.velocity


class CoulombFriction(JointTorqueEffect):
    name = "coulomb_friction"
    summary = "constant friction against the motion"
    equation = "$l\\,\\mathrm{sign}\\,\\dot q$, a ramp below 0.001 rad/s (m/s)"
    source = _ARMSTRONG
    quantities = (Parameter("level", "N m", lower=0.0),)
    confusable_with = ("viscous_friction", "stribeck_friction", "load_friction")
    urdf_dynamics = "friction"
    reverses_at_once = True

    def typical(self, robot):
        return [0.05 * sizes.effort(robot, self.joint)]

    def torque(self, motion, values):
        return values[0] * motion.direction


class StribeckFriction(JointTorqueEffect):
    name = "stribeck_friction"
    summary = "extra friction near zero speed"
    equation = "$l\\,e^{-(\\dot q / v)^2}\\,\\mathrm{sign}\\,\\dot q$"
    source = _ARMSTRONG
    quantities = (
        Parameter("level", "N m", lower=0.0, start=1.0),
        Parameter("velocity", "rad/s", 1e-3, 2.0, start=0.1, linear=False, step=1e-3, tried=STRIBECK_SPEEDS),
    )
    confusable_with = ("coulomb_friction",)
    reverses_at_once = True

    def typical(self, robot):
        return [0.02 * sizes.effort(robot, self.joint), 0.05 * sizes.speed(robot, self.joint)]

    def torque(self, motion, values):
        return values[0] * np.exp(-((motion.velocity / max(values[1], 1e-9)) ** 2)) * motion.direction


class LoadFriction(JointTorqueEffect):
    name = "load_friction"
    summary = "friction in proportion to the joint's load"
    equation = "$c\\,\\lvert\\tau\\rvert\\,\\mathrm{sign}\\,\\dot q$"
    source = _ARMSTRONG
    quantities = (Parameter("coefficient", "1", 0.0, 1.0, typical=0.05),)
    confusable_with = ("coulomb_friction",)
    reverses_at_once = True
    uses_load = True

    def torque(self, motion, values):
        return values[0] * np.abs(motion.load) * motion.direction

    def per_load(self, motion, values):
        return values[0] * np.sign(motion.load) * motion.direction


class TorqueOffset(JointTorqueEffect):
    name = "torque_offset"
    summary = "amplifier bias or asymmetric friction"
    equation = "$o$"
    quantities = (Parameter("offset", "N m", -inf),)
    confusable_with = ("spring", "payload")

    def typical(self, robot):
        return [0.01 * sizes.effort(robot, self.joint)]

    def torque(self, motion, values):
        return np.full(len(motion.velocity), values[0])
