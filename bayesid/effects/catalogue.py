"""The named effects: where each acts, its parameters, their units and sizes, and what it can be mistaken for.

Names, places and signs are those of the experiment format; the equations are in `bayesid.effects.model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.robot import inertia

#: Speed below which a joint counts as nearly at rest and friction as partly mobilised [rad/s or m/s].
REST_SPEED = 1e-3
#: A contact grows and fades in this time, within its window [s].
CONTACT_RAMP = 0.2


@dataclass(frozen=True)
class Kind:
    """One named effect.

    Attributes
    ----------
    name
        As in the experiment format.
    channels
        ``wrench``, ``torque`` or both: what it changes.
    at
        Where it can be: ``sensor``, ``axis``, ``axis->axis``, ``base``, ``joint``, ``robot`` or ``joint|robot``.
    parameters, units
        Its parameters; units for turning joints.
    lower, upper
        Range outside which a value is not plausible, one number a parameter.
    starts
        Values from which an estimate starts and that stand where none is given; a tuple of the parameters.
    shape
        Parameters that the readings are not linear in.
    summary
        What it is, one line.
    confusable_with
        Effects that some motions cannot tell from it.
    """

    name: str
    channels: tuple[str, ...]
    at: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    summary: str
    lower: tuple[float, ...] = ()
    upper: tuple[float, ...] = ()
    starts: tuple[float, ...] = ()
    shape: tuple[str, ...] = ()
    confusable_with: tuple[str, ...] = ()

    @property
    def linear(self) -> bool:
        """Whether readings are linear in all its parameters."""
        return not self.shape

    @property
    def non_negative(self) -> tuple[bool, ...]:
        """Whether a negative value is impossible, by parameter."""
        return tuple(low >= 0.0 for low in self.lower)

    def acts_on(self, channel: str) -> bool:
        """Whether it changes a channel of this name (``fx`` ... ``mz``, ``tau1`` ...)."""
        return ("wrench" if channel in WRENCH_NAMES else "torque") in self.channels


_BOTH, _WRENCH, _TORQUE = ("wrench", "torque"), ("wrench",), ("torque",)
_LOADS = ("N",) * 3 + ("N m",) * 3
_RATES = ("N/s",) * 3 + ("N m/s",) * 3
_POINT = ("point_x", "point_y", "point_z")


def _kind(name, channels, at, parameters, units, summary, *, lower=None, upper=None, starts=None, **rest) -> Kind:
    count = len(parameters)

    def each(value, default):
        value = default if value is None else value
        return tuple(float(v) for v in (value if isinstance(value, tuple) else (value,) * count))

    return Kind(
        name, channels, at, parameters, units, summary, each(lower, -inf), each(upper, inf), each(starts, 0.0), **rest
    )


_ALL = (
    _kind("sensor_offset", _WRENCH, "sensor", WRENCH_NAMES, _LOADS, "constant bias of the sensor",
          confusable_with=("base_tilt", "payload")),
    _kind("sensor_drift", _WRENCH, "sensor", WRENCH_NAMES, _RATES, "bias that grows with time",
          confusable_with=("tether",)),
    _kind("sensor_gain", _WRENCH, "axis", ("gain",), ("1",), "one axis reads (1 + gain) times the truth",
          lower=-0.9, upper=2.0, confusable_with=("sensor_crosstalk", "base_compliance")),
    _kind("sensor_crosstalk", _WRENCH, "axis->axis", ("coefficient",), ("1",), "one axis reads a share of another",
          lower=-1.0, upper=1.0, confusable_with=("sensor_rotation", "sensor_translation", "base_tilt")),
    _kind("sensor_rotation", _WRENCH, "sensor", ("rx", "ry", "rz"), ("rad",) * 3, "the sensor is turned against its stated pose",
          lower=-0.5, upper=0.5, shape=("rx", "ry", "rz"), confusable_with=("base_tilt", "encoder_offset", "sensor_crosstalk")),
    _kind("sensor_translation", _WRENCH, "sensor", ("x", "y", "z"), ("m",) * 3, "the sensor is shifted against its stated pose",
          lower=-1.0, upper=1.0, confusable_with=("sensor_crosstalk",)),
    _kind("sensor_delay", _WRENCH, "sensor", ("delay",), ("s",), "the sensor reads the wrench of a moment ago",
          lower=-0.1, upper=0.1, shape=("delay",), confusable_with=("fluid_drag", "joint_flexibility")),
    _kind("base_tilt", _BOTH, "base", ("x", "y"), ("rad",) * 2, "the base is not level: gravity is turned",
          lower=-0.3, upper=0.3, shape=("x", "y"), confusable_with=("sensor_rotation", "sensor_offset", "sensor_crosstalk")),
    _kind("payload", _BOTH, "joint", inertia.PARAMETERS, inertia.UNITS, "a body is attached to a link",
          lower=(0.0,) + (-inf,) * 9, confusable_with=("inertia_error", "payload")),
    _kind("inertia_error", _BOTH, "joint", inertia.PARAMETERS, inertia.UNITS, "a link's nominal inertia is wrong",
          confusable_with=("payload", "inertia_error", "rotor_momentum", "rotor_inertia")),
    _kind("tether", _BOTH, "joint", ("stiffness", "rest_length", "anchor_x", "anchor_y", "anchor_z", *_POINT),
          ("N/m",) + ("m",) * 7, "a hose or cable pulls a link, like a one-sided spring",
          lower=(0.0, 0.0) + (-10.0,) * 3 + (-1.0,) * 3, upper=(inf, 10.0) + (10.0,) * 3 + (1.0,) * 3,
          starts=(10.0, 0.3, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0),
          shape=("rest_length", "anchor_x", "anchor_y", "anchor_z", *_POINT), confusable_with=("base_tilt", "tether")),
    _kind("fluid_drag", _BOTH, "robot", ("linear", "quadratic"), ("N s/m^2", "N s^2/m^3"), "drag of air or water along the links",
          lower=0.0, confusable_with=("viscous_friction", "sensor_delay")),
    _kind("rotor_momentum", _BOTH, "joint", ("inertia",), ("kg m^2",), "angular momentum of a spinning rotor",
          lower=0.0, confusable_with=("inertia_error", "rotor_inertia")),
    _kind("joint_flexibility", _BOTH, "joint", ("compliance",), ("rad/(N m)",), "the link gives under the joint's torque",
          lower=0.0, upper=1.0, shape=("compliance",), confusable_with=("encoder_offset", "sensor_delay")),
    _kind("encoder_offset", _BOTH, "joint", ("angle",), ("rad",), "an encoder's zero is wrong",
          lower=-0.5, upper=0.5, shape=("angle",), confusable_with=("sensor_rotation", "joint_flexibility")),
    _kind("external_contact", _BOTH, "joint|robot", ("start", "end", "fx", "fy", "fz", *_POINT),
          ("s", "s", "N", "N", "N", "m", "m", "m"), "something pushes a link for part of the time",
          lower=(-inf,) * 5 + (-1.0,) * 3, upper=(inf,) * 5 + (1.0,) * 3, starts=(0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0),
          shape=("start", "end", *_POINT), confusable_with=("external_contact", "tether")),
    _kind("base_compliance", _WRENCH, "base", ("resonance", "damping"), ("Hz", "1"), "the mount gives and rings",
          lower=(1.0, 0.0), upper=(200.0, 1.0), starts=(20.0, 0.05), shape=("resonance", "damping"),
          confusable_with=("base_tilt", "sensor_gain", "sensor_crosstalk")),
    _kind("viscous_friction", _TORQUE, "joint", ("coefficient",), ("N m s/rad",), "friction in proportion to velocity",
          lower=0.0, confusable_with=("coulomb_friction", "fluid_drag")),
    _kind("coulomb_friction", _TORQUE, "joint", ("level",), ("N m",), "constant friction against the motion",
          lower=0.0, confusable_with=("viscous_friction", "stribeck_friction", "load_friction")),
    _kind("torque_offset", _TORQUE, "joint", ("offset",), ("N m",), "amplifier bias or asymmetric friction",
          confusable_with=("spring", "payload")),
    _kind("stribeck_friction", _TORQUE, "joint", ("level", "velocity"), ("N m", "rad/s"), "extra friction near zero speed",
          lower=(0.0, 1e-3), upper=(inf, 2.0), starts=(1.0, 0.1), shape=("velocity",), confusable_with=("coulomb_friction",)),
    _kind("load_friction", _TORQUE, "joint", ("coefficient",), ("1",), "friction in proportion to the joint's load",
          lower=0.0, upper=1.0, confusable_with=("coulomb_friction",)),
    _kind("rotor_inertia", _TORQUE, "joint", ("inertia",), ("kg m^2",), "inertia of motor and gears, seen from the joint",
          lower=0.0, confusable_with=("inertia_error", "rotor_momentum")),
    _kind("torque_gain", _TORQUE, "joint", ("gain",), ("1",), "the torque reads (1 + gain) times the truth",
          lower=-0.9, upper=2.0, confusable_with=("inertia_error", "payload")),
    _kind("torque_ripple", _TORQUE, "joint", ("amplitude", "periods", "phase"), ("N m", "1/rad", "rad"),
          "torque that repeats with the joint's angle", lower=(0.0, 1.0, -inf), upper=(inf, 1000.0, inf),
          starts=(0.5, 10.0, 0.0), shape=("periods", "phase"), confusable_with=("spring",)),
    _kind("spring", _TORQUE, "joint", ("stiffness", "rest"), ("N m/rad", "rad"), "a spring across a joint",
          starts=(1.0, 0.0), shape=("rest",), confusable_with=("torque_offset", "payload")),
)  # fmt: skip

#: Every effect by name.
KINDS: dict[str, Kind] = {kind.name: kind for kind in _ALL}
