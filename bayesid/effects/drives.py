"""Motors, gears and springs inside a joint, how two are coupled, and how its torque is read."""

from __future__ import annotations

from functools import partial
from math import inf

import numpy as np

from bayesid.effects import sizes
from bayesid.effects.effect import Linearisation, Parameter
from bayesid.effects.families import JointDelayEffect, JointGainEffect, JointTorqueEffect, ReadingEffect, TransmissionEffect
from bayesid.effects.segment import direction

#: Periods of a ripple per radian or metre tried; slower ones than a gear's would pass for any error of weight.
RIPPLE_PERIODS = tuple(float(n) for n in (*np.arange(4.0, 40.0, 0.4), *np.geomspace(40.0, 200.0, 60)))

#: A motor that turns by less of another joint's motion is taken for one that does not.
LEAST_COUPLING = 0.1


class RotorInertia(JointTorqueEffect):
    name = "rotor_inertia"
    summary = "inertia of motor and gears, seen from the joint"
    equation = "$J\\,\\ddot q$; the value is gear ratio² × rotor inertia"
    quantities = (Parameter("inertia", "kg m^2", lower=0.0, typical=partial(sizes.effort, share=0.01), lasting=True),)
    confusable_with = ("inertia_error", "rotor_momentum")
    column_in_time = "interpolated"

    def torque(self, motion, values):
        return values[0] * motion.acceleration


class TorqueGain(JointGainEffect):
    name = "torque_gain"
    summary = "the torque reads (1 + gain) times the truth"
    equation = "$(1 + g)\\,\\tau$, friction included"
    quantities = (Parameter("gain", "1", -0.9, 2.0, typical=0.05),)
    confusable_with = ("inertia_error", "payload")


class TorqueDelay(JointDelayEffect):
    name = "torque_delay"
    summary = "torques are read at another time than positions"
    equation = "$\\tau(t - T)$, friction included; at `robot` that of every joint"
    quantities = (Parameter("delay", "s", -0.1, 0.1, typical=0.004, linear=False, step=1e-5),)
    confusable_with = ("viscous_friction", "fluid_drag", "joint_flexibility")

    def reach(self, values, bandwidth, step):
        return abs(values[0]) + 20.0 * step

    def sought(self, around):
        # One bus reads all torques. A single joint's that seem late are its friction, which turns over late.
        return self.joint is None


class CoupledTransmission(TransmissionEffect):
    name = "coupled_transmission"
    summary = "another joint's motion turns the motor, too, as in a coupled wrist or a parallelogram"
    equation = "motor at $q_k + c\\,q_j$; torque of joint $j$ read as $\\tau_j - c\\,\\tau_k$"
    source = "virtual work: motors and joints share their power"
    # Usual is a motor that rides on the joint before its own: that joint's turn over a gear ratio of fifty. A wrist whose shafts
    # run through each other has 1.
    quantities = (Parameter("coupling", "1", -5.0, 5.0, typical=0.02, linear=False),)
    confusable_with = ("encoder_offset",)
    last_resort = True

    def coupling(self, values):
        return float(values[0])

    def sought(self, around):
        # What runs through another joint runs through the one before it: the wrists of TX40 and PUMA, parallelograms.
        return self.joint == (self.driver or 0) + 1

    def linearisations(self, around):
        # Gears have whole teeth: what couples at all couples much, and no column at the uncoupled model stands for it.
        return ()

    def trials(self, around):
        return np.array([[1.0], [-1.0]])


class CoupledFriction(ReadingEffect):
    name = "coupled_friction"
    part_of = "friction"
    channels = ("torque",)
    at = "joint->joint"
    along_joint = True
    summary = "friction and rotor of a motor that another joint turns, too, where tables give positions and torques of the joints"
    wanders = True
    equation = (
        "$c_v\\dot m + l\\,\\mathrm{sign}\\,\\dot m + J\\ddot m$ in the torque of joint $k$, $c$ times that in the torque of "
        "joint $j$, with the motor at $m = q_k + c\\,q_j$"
    )
    source = "virtual work: motors and joints share their power; friction as in [Armstrong1994](references.md)"
    quantities = (
        # Shafts that run through another joint turn with it once: other gears are found from there.
        Parameter("coupling", "1", -5.0, 5.0, start=1.0, typical=1.0, linear=False, tried=(1.0, -1.0), lasting=True),
        Parameter("viscous", "N m s/rad", lower=0.0, typical=partial(sizes.viscous, share=0.06)),
        Parameter("coulomb", "N m", lower=0.0, typical=partial(sizes.effort, share=0.05)),
        Parameter("inertia", "kg m^2", lower=0.0, typical=partial(sizes.effort, share=0.01), lasting=True),
    )
    confusable_with = ("viscous_friction", "coulomb_friction", "rotor_inertia")
    # The joint whose motor it is has no other one.
    instead_of = ("viscous_friction", "coulomb_friction", "rotor_inertia")
    reverses_at_once = True

    def sought(self, around):
        # As for coupled transmissions; with a joint that rests it is the other one's friction.
        joint, driver = self.joint or 0, self.driver or 0
        return joint == driver + 1 and bool(around.moving[joint] and around.moving[driver])

    def comes_after(self, other):
        return other.name in self.instead_of and other.joint in (self.joint, self.driver)

    def is_another(self, values, doubt, travel):
        # Friction and rotor of one joint.
        return abs(values[0]) < LEAST_COUPLING

    def added(self, readout, values):
        coupling, viscous, coulomb, inertia = values
        joint, driver = self.joint or 0, self.driver or 0
        v, a = (x[:, joint] + coupling * x[:, driver] for x in (readout.velocities, readout.accelerations))
        taken = viscous * v + coulomb * direction(v, a, readout.segment.cell) + inertia * a
        out = np.zeros(readout.true.shape)
        for name, share in ((f"tau{joint + 1}", 1.0), (f"tau{driver + 1}", coupling)):
            if name in readout.names:
                out[:, readout.names.index(name)] = share * taken
        return out


class TorqueRipple(JointTorqueEffect):
    name = "torque_ripple"
    summary = "torque that repeats with the joint's angle"
    equation = "$A \\sin(n q + \\varphi)$"
    quantities = (
        Parameter("amplitude", "N m", lower=0.0, start=0.5, typical=partial(sizes.effort, share=0.01)),
        Parameter("periods", "1/rad", 1.0, 1000.0, start=10.0, typical=20.0, linear=False, step=1e-3),
        Parameter("phase", "rad", -inf, inf, typical=0.5, linear=False, step=1e-3, sliding="rad"),
    )
    confusable_with = ("spring",)
    harmonics = RIPPLE_PERIODS

    def torque(self, motion, values):
        return values[0] * np.sin(values[1] * motion.position + values[2])

    def canonical(self, values):
        amplitude, periods, phase = values
        return (amplitude, periods, float((phase + np.pi) % (2.0 * np.pi) - np.pi))

    def linearisations(self, around):
        return ()  # its harmonics are tried

    def is_another(self, values, doubt, travel):
        # Where the joint moves through less than a period, nothing shows that the torque repeats.
        return values[1] * travel < 2.0 * np.pi

    def from_harmonic(self, order, sine, cosine):
        return (float(np.hypot(sine, cosine)), order, float(np.arctan2(cosine, sine)))


def _rest(a: np.ndarray) -> np.ndarray:
    """Stiffness k and rest position q0 of k and k q0."""
    return np.array([a[0], a[1] / a[0] if a[0] else 0.0])


def _pull(values: np.ndarray) -> np.ndarray:
    """Stiffness k and k q0 of stiffness and rest position q0."""
    return np.array([values[0], values[0] * values[1]])


class Spring(JointTorqueEffect):
    name = "spring"
    summary = "a spring across a joint"
    equation = "$k\\,(q - q_0)$"
    quantities = (
        Parameter("stiffness", "N m/rad", start=1.0, typical=partial(sizes.effort, share=0.03)),
        Parameter("rest", "rad", typical=0.3, linear=False),
    )
    confusable_with = ("torque_offset", "payload")

    def torque(self, motion, values):
        return values[0] * (motion.position - values[1])

    def caveat(self, values, positions):
        low, high = float(positions.min()), float(positions.max())
        away = 0.5 * (low + high) - values[1]
        if abs(away) <= high - low:  # over the motion it changes by at least its mean
            return ""
        unit = self.units[1]
        torque = f"{values[0] * away:.3g} {self.units[0].removesuffix('/' + unit)}"
        return (
            f"the rest lies beyond the motion, {low:.3g} to {high:.3g} {unit}, over which it is a torque of {torque} that "
            f"changes by {values[0] * (high - low):.3g}: mostly what torque_offset is, and the rest means little."
        )

    def linearisations(self, around):
        # k (q - q0) is linear in k and k q0, whose columns are the derivatives at k = 1, q0 = 0.
        at = np.array([1.0, 0.0])
        return (Linearisation(at, _rest, _pull),)
