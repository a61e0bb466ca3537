"""An effect at its place, with or without values, and how it is written: ``name`` or ``name@where``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects.catalogue import KINDS, REST_SPEED, Kind
from bayesid.errors import InputError


@dataclass(frozen=True, eq=False)
class Scene:
    """One gap-free stretch of joint motion, smoothed.

    Attributes
    ----------
    times
        (N,) [s].
    positions, velocities, accelerations
        What the encoders say, (N, n) each [rad or m and per second (squared)].
    still
        Whether every sample is a pose at rest of its own.
    bandwidth
        Of the joint motion [Hz].
    clear
        Up to where motion stands out of the encoders' noise [Hz]: what is differentiated again is smoothed to this, default
        a share of the bandwidth.
    middle
        Joint positions at the middle of the motion (n,), for effects that refer to it; default `middle_of` this
        stretch.
    cell
        Time that a sample stands for [s]: friction that reverses in it is its mean there. Zero: its value at the sample.
    """

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    still: bool = False
    bandwidth: float = 10.0
    middle: np.ndarray | None = None
    clear: float | None = None
    cell: float = 0.0
    cache: dict = field(default_factory=dict, init=False, repr=False)

    @property
    def middle_positions(self) -> np.ndarray:
        """Joint positions at the middle of the motion (n,)."""
        if self.middle is not None:
            return np.asarray(self.middle, float)
        return middle_of(self.positions)

    @property
    def at_rest(self) -> Scene:
        """The same positions, each held."""
        if "at_rest" not in self.cache:
            zero = np.zeros_like(self.positions)
            self.cache["at_rest"] = replace(self, velocities=zero, accelerations=zero, still=True, middle=self.middle_positions)
        return self.cache["at_rest"]


def middle_of(positions: np.ndarray) -> np.ndarray:
    """Joint positions at the middle of a motion (n,).

    Where it starts and ends, if that is one place, else half-way between the extremes: a periodic motion goes around
    the place that it starts from and comes back to.
    """
    first, last = positions[0], positions[-1]
    closed = np.abs(last - first) < 0.02 * np.maximum(np.ptp(positions, axis=0), 1e-9)
    return first if closed.all() else 0.5 * (positions.min(axis=0) + positions.max(axis=0))


#: The name under which models that are linear in their parameters know it.
State = Scene


@dataclass(frozen=True)
class Effect:
    """A kind of effect at its place.

    Attributes
    ----------
    name, where
        As in the experiment format; joints as ``joint1`` ... ``jointn``.
    joint
        Index of the joint, None where it acts elsewhere.
    axes
        Indices of the wrench axes: the one that reads, or source and reading axis.
    ratio
        Gear ratio of the joint, where it is known and matters (`rotor_momentum`).
    """

    name: str
    where: str
    joint: int | None = None
    axes: tuple[int, ...] = ()
    ratio: float | None = None

    @property
    def kind(self) -> Kind:
        """Its entry of the catalogue."""
        return KINDS[self.name]

    @property
    def spec(self) -> str:
        """``name@where``."""
        return f"{self.name}@{self.where}"

    @property
    def column_names(self) -> tuple[str, ...]:
        """One name a parameter, ``viscous_friction@joint1.coefficient``."""
        return tuple(f"{self.spec}.{p}" for p in self.kind.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """One unit a parameter."""
        if self.name == "sensor_crosstalk":
            source, reading = (("N", "N m")[axis >= 3] for axis in self.axes)
            return ("1",) if source == reading else (f"{reading} per {source}",)
        return self.kind.units

    def columns(self, state: Scene, channels: Sequence[str]) -> np.ndarray:
        """What one unit of each parameter adds to each channel, (N, channels, parameters).

        For effects whose columns need the joint motion only; see `bayesid.effects.columns` for all others.
        """
        out = np.zeros((len(state.times), len(channels), len(self.kind.parameters)))
        if self.name in ("sensor_offset", "sensor_drift"):
            for k, axis in enumerate(WRENCH_NAMES):
                if axis in channels:
                    out[:, channels.index(axis), k] = 1.0 if self.name == "sensor_offset" else state.times
            return out
        joint = -1 if self.joint is None else self.joint
        name = f"tau{joint + 1}"
        if name in channels:
            out[:, channels.index(name), 0] = {
                "viscous_friction": lambda: state.velocities[:, joint],
                "coulomb_friction": lambda: sense(state.velocities[:, joint], state.accelerations[:, joint], state.cell),
                "torque_offset": lambda: np.ones(len(state.times)),
                "rotor_inertia": lambda: state.accelerations[:, joint],
            }[self.name]()
        return out


def sense(velocity: np.ndarray, acceleration: np.ndarray, cell: float) -> np.ndarray:
    """Sign of a velocity (N,), or its mean over the time that a sample stands for, in which the velocity is ``v + a t``.

    Nearly at rest the sign is noise and the joint may stick, and a narrow ramp says so.
    """
    return np.clip(velocity / np.maximum(REST_SPEED, 0.5 * cell * np.abs(acceleration)), -1.0, 1.0)


@dataclass(frozen=True)
class Term:
    """An effect with values of its parameters.

    Attributes
    ----------
    effect
        Which, and where.
    values
        One number a parameter, in the order of ``effect.kind.parameters``.
    """

    effect: Effect
    values: tuple[float, ...]

    def __post_init__(self):
        object.__setattr__(self, "values", tuple(float(v) for v in self.values))
        if len(self.values) != len(self.effect.kind.parameters):
            raise ValueError(f"{self.effect.spec} has {len(self.effect.kind.parameters)} parameters, not {len(self.values)}")


def places(
    name: str, joint_names: Sequence[str], channels: Sequence[str], gear_ratio: Mapping[str, float] | None = None
) -> tuple[Effect, ...]:
    """All effects of one kind that can change one of the channels.

    Parameters
    ----------
    name
        Of the kind.
    joint_names
        The URDF's names in the order of q1 ... qn.
    channels
        Names of the channels.
    gear_ratio
        By the joint's name.
    """
    kind = KINDS[name]
    if not any(kind.acts_on(channel) for channel in channels):
        return ()
    ratios = gear_ratio or {}
    out: list[Effect] = []
    if kind.at == "axis":
        out = [Effect(name, axis, axes=(k,)) for k, axis in enumerate(WRENCH_NAMES)]
    elif kind.at == "axis->axis":
        pairs = [(i, k) for i in range(6) for k in range(6) if i != k]
        out = [Effect(name, f"{WRENCH_NAMES[i]}->{WRENCH_NAMES[k]}", axes=(i, k)) for i, k in pairs]
    elif kind.at.startswith("joint"):
        for i, joint in enumerate(joint_names):
            if kind.channels == ("torque",) and f"tau{i + 1}" not in channels:
                continue
            ratio = ratios.get(joint, ratios.get(f"joint{i + 1}")) if name == "rotor_momentum" else None
            out.append(Effect(name, f"joint{i + 1}", i, ratio=ratio))
        if kind.at == "joint|robot":
            out.append(Effect(name, "robot"))
    else:
        out = [Effect(name, kind.at)]
    return tuple(out)


def parse_effects(
    specs: Sequence[str], joint_names: Sequence[str], channels: Sequence[str], gear_ratio: Mapping[str, float] | None = None
) -> tuple[Effect, ...]:
    """Effects from their specifications, those that act on the given channels.

    Parameters
    ----------
    specs
        Each ``name``, which means everywhere, or ``name@where``.
    joint_names
        The URDF's names in the order of q1 ... qn; ``joint1`` ... ``jointn`` are understood too.
    channels
        Names of the channels in use; an effect on other channels is left out.
    gear_ratio
        By the joint's name.

    Raises
    ------
    InputError
        Unknown name or place.
    """
    effects: dict[str, Effect] = {}
    for spec in specs:
        name, _, where = spec.partition("@")
        if name not in KINDS:
            close = get_close_matches(name, KINDS, 1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(KINDS)}"
            raise InputError(f"effect '{spec}': no effect is called '{name}'; {hint}")
        everywhere = places(name, joint_names, (*WRENCH_NAMES, *(f"tau{i + 1}" for i in range(len(joint_names)))), gear_ratio)
        place = f"joint{list(joint_names).index(where) + 1}" if where in joint_names else where
        found = [e for e in everywhere if place in ("", e.where)]
        if not found:
            raise InputError(f"effect '{spec}': {_where_else(KINDS[name], where, len(joint_names))}")
        if not place and KINDS[name].at == "joint|robot":
            found = [e for e in found if e.joint is not None]
        if any(KINDS[name].acts_on(channel) for channel in channels):
            for effect in found:
                effects.setdefault(effect.spec, effect)
    return tuple(effects.values())


def _where_else(kind: Kind, where: str, joints: int) -> str:
    known = f"joint1 to joint{joints} or a URDF joint name"
    return {
        "sensor": f"'{kind.name}' acts at the sensor; write '{kind.name}'",
        "base": f"'{kind.name}' acts at the base; write '{kind.name}'",
        "robot": f"'{kind.name}' acts on the whole robot; write '{kind.name}'",
        "axis": f"no axis '{where}'; write one of {', '.join(WRENCH_NAMES)}",
        "axis->axis": f"no pair of axes '{where}'; write the source and the axis that reads it, as in fx->mz",
        "joint": f"no joint '{where}'; write {known}",
        "joint|robot": f"no joint '{where}'; write {known}, or robot",
    }[kind.at]
