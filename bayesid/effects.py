"""Effects beyond rigid bodies: what they add to a reading, as columns that are linear in their parameters.

Names, places and signs are those of the experiment format. An effect is written ``name`` (everywhere it can
be) or ``name@where``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from bayesid.errors import InputError
from bayesid.momentum import WRENCH_NAMES

#: Speed below which a joint counts as nearly at rest and Coulomb friction as partly mobilised [rad/s or m/s].
REST_SPEED = 1e-3


@dataclass(frozen=True)
class State:
    """What columns are made from, per sample.

    Attributes
    ----------
    times
        (N,) [s].
    positions, velocities, accelerations
        Smoothed joint trajectory, (N, n) each.
    """

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray


@dataclass(frozen=True)
class Kind:
    """One named effect.

    Attributes
    ----------
    acts_on
        ``wrench`` or ``torque``: the channels that it adds to.
    at
        ``sensor`` (all six channels) or ``joint`` (that joint's torque).
    parameters, units
        Its parameters.
    column
        From the state (and the joint's index) the factor of each parameter, (N, parameters); for a sensor
        effect one factor, the same for its six channels.
    non_negative
        Whether a negative value is impossible.
    """

    acts_on: str
    at: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    column: Callable[[State, int], np.ndarray]
    non_negative: bool = False


_PER_SECOND = ("N/s",) * 3 + ("N m/s",) * 3

KINDS: dict[str, Kind] = {
    "sensor_offset": Kind(
        "wrench", "sensor", WRENCH_NAMES, ("N",) * 3 + ("N m",) * 3, lambda s, _: np.ones_like(s.times)
    ),
    "sensor_drift": Kind("wrench", "sensor", WRENCH_NAMES, _PER_SECOND, lambda s, _: s.times),
    "viscous_friction": Kind(
        "torque", "joint", ("coefficient",), ("N m s/rad",), lambda s, j: s.velocities[:, j], non_negative=True
    ),
    # Nearly at rest the sign is noise and the joint may stick; a narrow ramp says so.
    "coulomb_friction": Kind(
        "torque",
        "joint",
        ("level",),
        ("N m",),
        lambda s, j: np.clip(s.velocities[:, j] / REST_SPEED, -1.0, 1.0),
        non_negative=True,
    ),
    "torque_offset": Kind("torque", "joint", ("offset",), ("N m",), lambda s, j: np.ones_like(s.times)),
    "rotor_inertia": Kind(
        "torque", "joint", ("inertia",), ("kg m^2",), lambda s, j: s.accelerations[:, j], non_negative=True
    ),
}


#: Effects of the experiment format that no estimator here takes yet.
NOT_YET = (
    "sensor_gain", "sensor_crosstalk", "sensor_rotation", "sensor_translation", "sensor_delay", "base_tilt", "payload",
    "inertia_error", "tether", "fluid_drag", "rotor_momentum", "joint_flexibility", "encoder_offset", "external_contact",
    "base_compliance", "stribeck_friction", "load_friction", "torque_gain", "torque_ripple", "spring",
)  # fmt: skip


class UnsupportedEffectError(InputError):
    """An effect of the format that cannot be estimated yet."""


@dataclass(frozen=True)
class Effect:
    """A kind of effect at its place; ``joint`` is None for the sensor."""

    name: str
    where: str
    joint: int | None

    @property
    def kind(self) -> Kind:
        """Its entry of the registry."""
        return KINDS[self.name]

    @property
    def column_names(self) -> tuple[str, ...]:
        """One name a column, ``viscous_friction@joint1.coefficient``."""
        return tuple(f"{self.name}@{self.where}.{p}" for p in self.kind.parameters)

    def columns(self, state: State, channels: Sequence[str]) -> np.ndarray:
        """What one unit of each parameter adds to each channel, (N, channels, parameters)."""
        count = len(self.kind.parameters)
        out = np.zeros((len(state.times), len(channels), count))
        values = self.kind.column(state, -1 if self.joint is None else self.joint)
        if self.joint is None:
            for k, axis in enumerate(self.kind.parameters):
                if axis in channels:
                    out[:, channels.index(axis), k] = values
        else:
            name = f"tau{self.joint + 1}"
            if name in channels:
                out[:, channels.index(name), 0] = values
        return out


def parse_effects(specs: Sequence[str], joint_names: Sequence[str], channels: Sequence[str]) -> tuple[Effect, ...]:
    """Effects from their specifications, those that act on the given channels.

    Parameters
    ----------
    specs
        Each ``name`` or ``name@where``.
    joint_names
        The URDF's names in the order of q1 ... qn; ``joint1`` ... ``jointn`` are understood too.
    channels
        Names of the channels in use; an effect on other channels is left out.

    Raises
    ------
    InputError
        Unknown name or place.
    UnsupportedEffectError
        An effect of the format that cannot be estimated yet.
    """
    effects: dict[tuple[str, str], Effect] = {}
    for spec in specs:
        name, _, where = spec.partition("@")
        if name not in KINDS:
            if name in NOT_YET:
                raise UnsupportedEffectError(f"effect '{spec}': cannot be estimated yet; leave it out, or use {', '.join(KINDS)}")
            close = get_close_matches(name, [*KINDS, *NOT_YET], 1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(KINDS)}"
            raise InputError(f"effect '{spec}': no effect is called '{name}'; {hint}")
        kind = KINDS[name]
        for effect in _places(spec, name, kind, where, joint_names):
            if any(c.startswith("tau") == (kind.acts_on == "torque") for c in channels):
                effects.setdefault((effect.name, effect.where), effect)
    return tuple(effects.values())


def _places(spec: str, name: str, kind: Kind, where: str, joint_names: Sequence[str]) -> list[Effect]:
    if kind.at == "sensor":
        if where not in ("", "sensor"):
            raise InputError(f"effect '{spec}': '{name}' acts at the sensor; write '{name}'")
        return [Effect(name, "sensor", None)]
    places = {f"joint{i + 1}": i for i in range(len(joint_names))}
    if not where:
        return [Effect(name, place, i) for place, i in places.items()]
    joint = {joint_name: i for i, joint_name in enumerate(joint_names)} | places
    if where not in joint:
        raise InputError(f"effect '{spec}': no joint '{where}'; write joint1 to joint{len(joint_names)} or a URDF joint name")
    return [Effect(name, f"joint{joint[where] + 1}", joint[where])]
