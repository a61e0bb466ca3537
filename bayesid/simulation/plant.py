"""What a simulated plant has beyond rigid bodies, with values of plausible size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES, Channels
from bayesid.effects import Effect, EffectLibrary, EncoderEffect, MotionSegment, Term, TransmissionEffect, reach_of, readings
from bayesid.effects.torque_chain import coupling_matrix
from bayesid.errors import InputError
from bayesid.robot.robot import Robot

Values = Mapping[str, float | bool]

_CHUNK = 8192  # samples whose readings are made at once
#: What is differentiated again on the way, a flexible joint's torque, is smooth up to this [Hz].
_BANDWIDTH = 20.0


def default_values(effect: Effect, robot: Robot) -> dict[str, float]:
    """Parameters of plausible size, see `bayesid.effects.Effect.typical`."""
    return {key: float(value) for key, value in zip(effect.parameters, effect.typical(robot), strict=True)}


def complete_effects(
    robot: Robot,
    effects: Mapping[str, Values | None] | Sequence[str],
    stated: Mapping[str, Values],
    library: EffectLibrary | None = None,
) -> dict[str, dict[str, float]]:
    """Every effect, ``name`` or ``name@where``, at each of its places with all its values.

    Values that are not given are ``stated`` (``[model.values]``), else `default_values`, or zero for the axes of a sensor that
    are left out. An `InputError` where an effect, place or parameter is unknown.
    """
    given = effects if isinstance(effects, Mapping) else dict.fromkeys(effects)
    out: dict[str, dict[str, float]] = {}
    for spec, own in given.items():
        for effect in places_of(spec, robot, library or EffectLibrary()):
            own_here = own
            if own is None:
                own_here = stated.get(effect.spec, stated.get(spec, stated.get(effect.name)))
            values = default_values(effect, robot)
            known = {key: float(value) for key, value in (own_here or {}).items() if key != "fixed"}
            for key in known:
                if key not in values:
                    raise InputError(f"effect '{spec}': no parameter '{key}'; it has {', '.join(values)}")
            if effect.zero_unless_stated and known:
                values = dict.fromkeys(values, 0.0)
            out[effect.spec] = values | known
    return out


def places_of(
    spec: str, robot: Robot, library: EffectLibrary, gear_ratio: Mapping[str, float] | None = None
) -> tuple[Effect, ...]:
    """An effect, ``name`` or ``name@where``, at each of its places; gear ratios are by the joint's name."""
    library.named(spec.partition("@")[0], spec, "'{}' cannot be simulated")
    channels = (*WRENCH_NAMES, *(f"tau{i + 1}" for i in range(robot.n)))
    return library.parse([spec], robot.joint_names, channels, gear_ratio)


def at_encoders(robot: Robot, segment: MotionSegment, terms: Sequence[Term]) -> MotionSegment:
    """What the encoders say of true joint motion, before noise: they know nothing of a joint that gives."""
    coupling = coupling_matrix(robot, [(t.effect, t.values) for t in terms if isinstance(t.effect, TransmissionEffect)])
    offset = np.zeros(robot.n)
    for term in terms:
        if isinstance(term.effect, EncoderEffect):
            offset[term.effect.joint] += term.effect.shift(term.values)
    q, v, a = (x @ coupling.T for x in (segment.positions, segment.velocities, segment.accelerations))
    return replace(segment, positions=q + offset, velocities=v, accelerations=a)


def plant_readings(
    robot: Robot, channels: Channels, segment: MotionSegment, links: np.ndarray, terms: Sequence[Term]
) -> np.ndarray:
    """What a plant's channels read (N, c), made piece by piece; an `InputError` where that is not finite."""
    times, size = segment.times, len(segment.times)
    margin = 0.0
    if not segment.still and size > 1:
        margin = reach_of(terms, _BANDWIDTH, float(np.median(np.diff(times))))
    middle = segment.middle_positions
    out = np.empty((size, len(channels)))
    for first in range(0, size, _CHUNK):
        last = min(first + _CHUNK, size)
        a, b = first, last
        if margin:
            a = int(np.searchsorted(times, times[first] - margin))
            b = int(np.searchsorted(times, times[last - 1] + margin, side="right"))
        part = slice(a, b)
        motion = (x[part] for x in (times, segment.positions, segment.velocities, segment.accelerations))
        piece = MotionSegment(*motion, still=segment.still, bandwidth=_BANDWIDTH, middle=middle, in_turn=segment.in_turn)
        with np.errstate(all="ignore"):  # what is not finite is reported below
            out[first:last] = readings(robot, channels, piece, links, terms)[first - a : last - a]
    if not np.isfinite(out).all():
        specs = ", ".join(t.effect.spec for t in terms)
        raise InputError(f"readings are not finite with {specs or 'these links'}; give smaller values, or mend the formula")
    return out
