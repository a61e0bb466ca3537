"""Where joints and base really are: encoders, flexible joints, a base that is not level or gives way."""

from __future__ import annotations

from dataclasses import astuple
from functools import partial
from math import inf

import numpy as np
import pinocchio as pin

from bayesid.effects import sizes
from bayesid.effects.effect import Linearisation, Parameter, Term
from bayesid.effects.families import EncoderEffect, FlexibleJointEffect, GravityEffect, MountEffect, PlayEffect
from bayesid.signals.smoothing import OVERLAP

#: Resonances of a flexible joint [Hz], tried where columns leave something unexplained: above its resonance a link moves
#: against its motor, which no derivative at a stiff joint says.
JOINT_RESONANCES = np.geomspace(3.0, 30.0, 17)
#: How far the effort limit may bend a joint, where compliances are tried [rad or m]: a series elastic drive bends a tenth.
SOFTEST = 0.5
#: Torques at which gear teeth may lie firmly on each other, as shares of the effort limit.
FIRM_SHARES = (3e-4, 3e-3, 3e-2)
#: Resonances of a mount [Hz], which are tried; so damped that the half-power bandwidth, twice the damping, reaches from the one
#: before to the one after: a fit from a sharper one ends beside the mount's own resonance.
MOUNT_RESONANCES = np.geomspace(2.5, 60.0, 14)
MOUNT_DAMPING = float(0.5 * (MOUNT_RESONANCES[2] - MOUNT_RESONANCES[0]) / MOUNT_RESONANCES[1])
#: Ringing of a mount is followed until it has died down to exp(-8), but no longer than this [s].
_LONGEST = 20.0


class EncoderOffset(EncoderEffect):
    name = "encoder_offset"
    summary = "an encoder's zero is wrong"
    equation = "the encoder reads $q + a$"
    quantities = (Parameter("angle", "rad", -0.5, 0.5, typical=0.01, linear=False),)
    confusable_with = ("sensor_rotation", "joint_flexibility")

    def shift(self, values):
        return float(values[0])


class JointFlexibility(FlexibleJointEffect):
    name = "joint_flexibility"
    summary = "the link gives under the joint's torque"
    equation = "link at $q - C\\tau$, $\\tau$ the torque that moves the links"
    source = "[Spong1987](references.md), torque by the rigid model of the links"
    quantities = (Parameter("compliance", "rad/(N m)", 0.0, 1.0, linear=False, step=1e-6),)
    confusable_with = ("encoder_offset", "sensor_delay")
    last_resort = True
    restarts = (0.25, 0.5, 2.0, 4.0)

    def typical(self, robot):
        # A hundredth of a radian under four times the effort limit, as in a harmonic drive.
        return [2.5e-3 / sizes.effort(robot, self.joint)]

    def reach(self, values, bandwidth, step):
        return OVERLAP / bandwidth

    def compliance(self, values):
        return float(values[0])

    def holds_below(self, values, around):
        # At its resonance, compliance * inertia * (2 pi f)^2 = 1, the link swings while the motor and its encoder stand still.
        softness = values[0] * around.joint_inertia[self.joint or 0]
        return 1.0 / (2.0 * np.pi * np.sqrt(softness)) if softness > 0.0 else inf

    def trials(self, around):
        felt = around.joint_inertia[self.joint or 0]
        tried = 1.0 / (felt * (2.0 * np.pi * JOINT_RESONANCES) ** 2)
        limit = around.robot.effort_limit[self.joint or 0]
        softest = SOFTEST / limit if np.isfinite(limit) else self.upper[0]
        return tried[tried <= softest][:, None]


class Backlash(PlayEffect):
    name = "backlash"
    summary = "play between gear teeth: the link leans on the side that its torque pushes it to"
    equation = "link at $q - \\frac{g}{2} \\tanh(\\tau / s)$, $g$ the gap, $s$ the torque at which teeth are firm"
    source = "[Nordin2002](references.md), the dead zone of a shaft without inertia, with soft teeth"
    quantities = (
        # Three minutes of arc, between the one of a good robot's gear and the ten of a spur gear.
        Parameter("gap", "rad", 0.0, 0.2, typical=1e-3, linear=False, step=1e-6),
        Parameter("firm", "N m", 1e-3, inf, start=1.0, typical=partial(sizes.effort, share=0.005), linear=False, step=1e-4),
    )
    confusable_with = ("encoder_offset", "joint_flexibility")

    def reach(self, values, bandwidth, step):
        return OVERLAP / bandwidth

    def teeth(self, values):
        return 0.5 * values[0], values[1]

    def is_another(self, values, doubt, travel):
        # A gap of any size between teeth that are as soft for it is a spring.
        return values[0] <= doubt[0]

    def as_another(self, values):
        most, firm = self.teeth(values)
        return Term(JointFlexibility(*astuple(self)), (most / firm,))

    def linearisations(self, around):
        # Without play the torque at which teeth are firm says nothing: it is tried.
        effort, held = sizes.effort(around.robot, self.joint), np.array([False, True])
        return tuple(Linearisation.holding(np.array([0.0, share * effort]), held) for share in FIRM_SHARES)


class BaseTilt(GravityEffect):
    name = "base_tilt"
    summary = "the base is not level: gravity is turned"
    equation = "gravity is turned about base $x$, then $y$"
    quantities = tuple(Parameter(n, "rad", -0.3, 0.3, typical=x, linear=False) for n, x in (("x", 0.01), ("y", -0.015)))
    confusable_with = ("sensor_rotation", "sensor_offset", "sensor_crosstalk")

    def turned(self, gravity, values):
        return pin.rpy.rpyToMatrix(float(values[0]), float(values[1]), 0.0) @ gravity


class BaseCompliance(MountEffect):
    name = "base_compliance"
    channels = ("wrench",)
    summary = "the mount is compliant and underdamped"
    equation = (
        "$I(q)\\ddot\\theta + c\\dot\\theta + k\\theta = -h$, $h$ the moment about base $x$ and $y$ that the robot asks for; "
        "$k$, $c$ from the mean of the two inertias at the middle of the motion, the root link's included"
    )
    source = "a rigid body on a spring and damper"
    quantities = (
        Parameter("resonance", "Hz", 1.0, 200.0, start=20.0, typical=12.0, linear=False, step=0.01),
        Parameter("damping", "1", 0.0, 1.0, start=0.05, typical=0.05, linear=False, step=1e-3),
    )
    confusable_with = ("base_tilt", "sensor_gain", "sensor_crosstalk")
    settling = 1.5

    def reach(self, values, bandwidth, step):
        rate = 2.0 * np.pi * values[0] * max(values[1], 1e-3)
        return min(8.0 / rate, _LONGEST) + 2.0 / bandwidth

    def resonance(self, values):
        return float(values[0]), float(values[1])

    def sought(self, around):
        return around.base_sensor

    def linearisations(self, around):
        return ()  # no small amplitude stands for it

    def trials(self, around):
        return np.column_stack([MOUNT_RESONANCES, np.full(len(MOUNT_RESONANCES), MOUNT_DAMPING)])

    def starts_tried(self, around):
        return self.trials(around)
