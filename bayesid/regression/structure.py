"""What a linear model consists of before any row is made: its effects, base parameters, and the point it is linearised at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.dynamics.channels import Channels
from bayesid.effects import Effect, EffectLibrary, Point, middle_of, starting_point
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.regression.segment import Segment


@dataclass(frozen=True, eq=False)
class Structure:
    """Effects and base parameters of a model."""

    specs: tuple[str, ...]  # the effects as they were named, ``name`` or ``name@where``; those nobody needs to name first
    effects: tuple[Effect, ...]  # those that act on the channels, at their places
    base: BaseParameters  # base parameters of the richest motion of this kind
    unseen: tuple[str, ...]  # those of ``specs`` that show in none of the channels
    point: Point | None  # where readings are linearised; None where effects are plain columns beside the rigid ones


def model_structure(
    experiment: Experiment, channels: Channels, specs: Sequence[str], segments: Sequence[Segment], source: str
) -> Structure:
    """What the model of some segments consists of, with effects that the user names.

    Segments tell whether gravity and constant offsets are in the readings, and whether anything moves; ``source`` says where
    the names come from, for messages. An `InputError` where an effect or a place of it does not exist.
    """
    offset = any(s.offset for s in segments)
    if offset:
        specs = [*_unstated(experiment.library, channels, specs), *specs]
    library, joints = experiment.library, experiment.robot.joint_names
    try:
        effects = library.parse(specs, joints, channels.names, experiment.gear_ratio)
    except InputError as error:
        raise type(error)(f"{source}: {error}") from None
    base = structural_base(
        experiment.robot,
        channels,
        gravity=any(s.gravity for s in segments),
        offset=offset and any(not name.startswith("tau") for name in channels.names),
        at_rest=all(s.poses for s in segments),
    )
    unseen = tuple(spec for spec in specs if not library.parse([spec], joints, channels.names, experiment.gear_ratio))
    return Structure(tuple(specs), effects, base, unseen, _point(experiment, base, effects, segments))


def _unstated(library: EffectLibrary, channels: Channels, specs: Sequence[str]) -> list[str]:
    """Effects that every model of readings has from which no static run is subtracted, where the user names them or not."""
    stated = {spec.partition("@")[0] for spec in specs}
    classes = [c for c in library.classes.values() if c.estimated_without_static_run and c.name not in stated]
    return [c.name for c in classes if any(c.acts_on(name) for name in channels.names)]


def absorbed_offset(base: BaseParameters, links: np.ndarray) -> np.ndarray:
    """What of a sensor's estimated offset is weight (6,)."""
    return np.zeros(6) if base.absorbed is None else base.absorbed[:6] @ np.ravel(links)


def _point(experiment: Experiment, base: BaseParameters, effects: tuple[Effect, ...], fitted: Sequence[Segment]) -> Point | None:
    """Where to start from, for effects that are more than columns beside the rigid ones."""
    try:
        values, free = starting_point(effects, experiment.effect_values, experiment.robot.joint_names)
    except InputError as error:
        raise InputError(f"experiment.toml: {error}") from None
    if all(e.from_motion_alone for e in effects) and free.all():
        return None
    links = experiment.robot.nominal
    absorbed = absorbed_offset(base, links)
    start = 0
    for effect in effects:
        count = len(effect.parameters)
        if effect.absorbs_weight:
            values[start : start + count] += absorbed
        start += count
    return Point(links, base.matrix @ links.ravel(), values, free, absorbed, _middle(fitted))


def _middle(fitted: Sequence[Segment]) -> np.ndarray | None:
    """Joint positions at the middle of the first fitted motion."""
    moving = [r for r in fitted if not r.poses]
    return middle_of(moving[0].positions) if moving else None
