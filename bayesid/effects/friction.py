"""Friction inside a joint; the bristle of [Dahl1968]_ with exponent 1 obeys ``dz = (sign(dx) - z) |dx| / w``."""

from __future__ import annotations

from functools import partial
from math import inf

import numba
import numpy as np

from bayesid.effects import sizes
from bayesid.effects.effect import Parameter
from bayesid.effects.families import JointTorqueEffect

_ARMSTRONG = "[Armstrong1994](references.md)"
_BITTENCOURT = "[Bittencourt2012](references.md)"


def bent(moves: np.ndarray, width: float, start: float = 0.0) -> np.ndarray:
    """How far the bristle is bent, from -1 to 1, at the start and after each signed move without a reversal (m + 1,).

    A move of a way s in one direction takes z to ``sign - (sign - z) exp(-|s| / width)``, however fast.
    """
    moves = np.ascontiguousarray(moves, dtype=float)
    return _bent(np.sign(moves), np.exp(-np.abs(moves) / width), float(start))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bent(sign, keep, start):
    out = np.empty(len(sign) + 1)
    out[0] = start
    for k in range(len(sign)):
        out[k + 1] = sign[k] - (sign[k] - out[k]) * keep[k]
    return out


#: Speeds below which a Stribeck law may fall [rad/s or m/s].
STRIBECK_SPEEDS = tuple(float(v) for v in np.geomspace(0.01, 0.6, 8))
#: Ways over which a bristle may bend before it slips [rad or m].
BRISTLE_DISTANCES = tuple(float(d) for d in np.geomspace(0.005, 0.3, 6))
#: Motion that a bristle remembers [s]: in this time a joint has gone far enough to forget how it came there, or stands still.
BRISTLE_MEMORY = 5.0
#: Speed from which a joint is taken for slipping where a recording begins [rad/s or m/s]; noise at rest is far less.
SLIPPING_SPEED = 0.05
#: Time constants with which a drive may warm [s].
WARMING_TIMES = (5.0, 30.0, 300.0)


class ViscousFriction(JointTorqueEffect):
    name = "viscous_friction"
    part_of = "friction"
    summary = "friction in proportion to velocity"
    wanders = True
    equation = "$c\\,\\dot q$"
    source = _ARMSTRONG
    quantities = (Parameter("coefficient", "N m s/rad", never_negative=True, typical=partial(sizes.viscous, share=0.06)),)
    confusable_with = ("coulomb_friction", "fluid_drag")
    column_in_time = "sampled"
    urdf_dynamics = "damping"

    def torque(self, motion, values):
        return values[0] * motion.velocity


class DirectionalFriction(JointTorqueEffect):
    name = "directional_friction"
    part_of = "friction"
    summary = "viscous friction that differs by direction"
    equation = (
        "$d\\,\\lvert\\dot q\\rvert$: with viscous friction $c$ it is $c + d$ forwards, $c - d$ backwards; "
        "where the constant part differs, that is `torque_offset`"
    )
    source = _ARMSTRONG
    # A fifth of the usual viscous friction.
    quantities = (Parameter("difference", "N m s/rad", typical=partial(sizes.viscous, share=0.012)),)
    confusable_with = ("torque_offset", "spring")

    def torque(self, motion, values):
        return values[0] * np.abs(motion.velocity)


class CoulombFriction(JointTorqueEffect):
    name = "coulomb_friction"
    part_of = "friction"
    summary = "constant friction against the motion"
    wanders = True
    equation = "$l\\,\\mathrm{sign}\\,\\dot q$, a ramp below 0.001 rad/s (m/s)"
    source = _ARMSTRONG
    quantities = (Parameter("level", "N m", never_negative=True, typical=partial(sizes.effort, share=0.05)),)
    confusable_with = ("viscous_friction", "stribeck_friction", "load_friction")
    urdf_dynamics = "friction"
    column_in_time = "sampled"
    reverses_at_once = True

    def torque(self, motion, values):
        return values[0] * motion.direction


class PostureFriction(JointTorqueEffect):
    name = "posture_friction"
    part_of = "friction"
    summary = "constant friction that grows and falls with the joint's angle"
    equation = "$(a \\cos q + b \\sin q)\\,\\mathrm{sign}\\,\\dot q$, beside a Coulomb friction"
    source = _ARMSTRONG
    # A fifth of the usual Coulomb friction.
    quantities = (
        Parameter("cosine", "N m", typical=partial(sizes.effort, share=0.008)),
        Parameter("sine", "N m", typical=partial(sizes.effort, share=0.006)),
    )
    confusable_with = ("coulomb_friction", "load_friction")
    reverses_at_once = True

    def torque(self, motion, values):
        return (values[0] * np.cos(motion.position) + values[1] * np.sin(motion.position)) * motion.direction


class DahlFriction(JointTorqueEffect):
    name = "dahl_friction"
    part_of = "friction"
    summary = "constant friction that builds up over a short way after every reversal, with hysteresis"
    equation = (
        "$l z$, $\\mathrm{d}z = (\\mathrm{sign}\\,\\dot q - z)\\,\\lvert\\mathrm{d}q\\rvert / \\delta$; "
        "with a way $\\delta$ below a milliradian it is `coulomb_friction`"
    )
    source = "[Dahl1968](references.md), with exponent 1"
    quantities = (
        Parameter("level", "N m", lower=0.0, start=1.0, typical=partial(sizes.effort, share=0.05)),
        # A bristle that slips sooner is Coulomb friction, which has some presliding in every drive.
        Parameter("distance", "rad", 1e-3, 1.0, start=0.02, typical=0.02, linear=False, step=1e-5, tried=BRISTLE_DISTANCES),
    )
    confusable_with = ("coulomb_friction", "stribeck_friction", "spring")
    # Whatever friction does at a reversal, it turns over a little late: that alone is no bristle. Coulomb friction is a bristle
    # that is stiff.
    instead_of = ("coulomb_friction", "stribeck_friction", "load_friction", "posture_friction", "warming_friction")
    reverses_at_once = True
    remembers = True

    def reach(self, values, bandwidth, step):
        return BRISTLE_MEMORY

    def torque(self, motion, values):
        # Where a recording starts at rest the bristle does, too; a joint that moves has bent it.
        start = float(np.clip(motion.velocity[0] / SLIPPING_SPEED, -1.0, 1.0))
        return values[0] * bent(motion.ways, max(values[1], 1e-9), start)[::2]


class StribeckFriction(JointTorqueEffect):
    name = "stribeck_friction"
    part_of = "friction"
    summary = "extra friction near zero speed"
    wanders = True
    equation = "$l\\,e^{-(\\dot q / v)^2}\\,\\mathrm{sign}\\,\\dot q$"
    source = _ARMSTRONG
    quantities = (
        Parameter("level", "N m", lower=0.0, start=1.0, typical=partial(sizes.effort, share=0.02)),
        Parameter(
            "velocity", "rad/s", 1e-3, 2.0, start=0.1, typical=partial(sizes.speed, share=0.05), linear=False, step=1e-3,
            tried=STRIBECK_SPEEDS,
        ),
    )  # fmt: skip
    confusable_with = ("coulomb_friction", "dahl_friction")
    reverses_at_once = True

    def torque(self, motion, values):
        return values[0] * np.exp(-((motion.velocity / max(values[1], 1e-9)) ** 2)) * motion.direction


class LoadFriction(JointTorqueEffect):
    name = "load_friction"
    part_of = "friction"
    summary = "friction in proportion to the joint's load"
    wanders = True
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


class WarmingFriction(JointTorqueEffect):
    name = "warming_friction"
    part_of = "friction"
    summary = "friction of a cold drive that falls as it warms"
    equation = (
        "$-(l\\,\\mathrm{sign}\\,\\dot q + c\\,\\dot q)\\,T (1 - e^{-t / T})$ beside the cold friction, with $t$ of the table: "
        "it falls by $l$, $c$ a second at first, by $l T$, $c T$ in the end"
    )
    source = f"{_BITTENCOURT}, with a temperature that settles exponentially"
    # Rates, not whole falls: a recording that is short against the time constant shows the rates alone. They fall, and slowly:
    # friction that grew within a second would be friction that the model lacks.
    quantities = (
        Parameter("level", "N m/s", lower=0.0, fall_of="coulomb_friction.level"),
        Parameter("coefficient", "N m/rad", lower=0.0, start=0.01, fall_of="viscous_friction.coefficient"),
        Parameter("time", "s", 5.0, 1e5, start=30.0, linear=False, step=1e-3, tried=WARMING_TIMES),
    )
    confusable_with = ("viscous_friction", "coulomb_friction", "torque_gain")
    reverses_at_once = True
    remembers = True
    since_zero = True

    def typical(self, robot):
        # A tenth of the usual Coulomb friction and a third of the usual viscous friction are gone when warm, after minutes.
        effort, time = sizes.effort(robot, self.joint), 120.0
        return [0.005 * effort / time, 0.02 * effort / sizes.speed(robot, self.joint) / time, time]

    def torque(self, motion, values):
        level, coefficient, time = values
        return (level * motion.direction + coefficient * motion.velocity) * time * np.expm1(-motion.time / time)


class TorqueOffset(JointTorqueEffect):
    name = "torque_offset"
    summary = "amplifier bias or asymmetric friction"
    wanders = True
    equation = "$o$"
    quantities = (Parameter("offset", "N m", -inf, typical=partial(sizes.effort, share=0.01)),)
    always_the_same = True
    confusable_with = ("spring", "payload")

    def torque(self, motion, values):
        return np.full(len(motion.velocity), values[0])
