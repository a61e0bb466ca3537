"""Exact readings and their derivatives, as they are or less what the same positions read at rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.dynamics.channels import Channels
from bayesid.effects.derivatives import effect_derivatives, link_derivatives
from bayesid.effects.effect import Effect, Term
from bayesid.effects.model import Model
from bayesid.effects.segment import MotionSegment
from bayesid.robot.robot import Robot


def readings(
    robot: Robot,
    channels: Channels,
    segment: MotionSegment,
    links: np.ndarray,
    terms: Sequence[Term] = (),
    *,
    gravity: bool = True,
) -> np.ndarray:
    """What the channels read, everything included: a base sensor's load of the root link, too.

    Parameters
    ----------
    robot, channels
        What moves and what is measured.
    segment
        How it moves.
    links
        Ten parameters a body (b, 10) or (10 b,).
    terms
        The effects with their values.
    gravity
        False: less what the same positions read at rest (equation 21 of [Liu1998]_), free of offset and weight.

    Returns
    -------
    readings
        (N, c) [N, N m].

    Raises
    ------
    InputError
        Links of the wrong shape.
    """
    moving = Model.of(robot, channels, segment, links, terms).readings
    if gravity:
        return moving
    return moving - Model.of(robot, channels, segment.at_rest, links, terms).readings


def rigid_columns(
    robot: Robot,
    channels: Channels,
    segment: MotionSegment,
    links: np.ndarray,
    terms: Sequence[Term] = (),
    *,
    gravity: bool = True,
) -> np.ndarray:
    """Derivative of `readings` with respect to the links' parameters, (N, c, 10 b).

    The links' motion is held: how a flexible joint or mount gives way to a change of the links is not part of it.

    Parameters and errors are those of `readings`.
    """
    moving = link_derivatives(Model.of(robot, channels, segment, links, terms))
    if gravity:
        return moving
    return moving - link_derivatives(Model.of(robot, channels, segment.at_rest, links, terms))


def columns(
    robot: Robot,
    channels: Channels,
    segment: MotionSegment,
    links: np.ndarray,
    terms: Sequence[Term],
    effect: Effect,
    values: Sequence[float] | None = None,
    *,
    gravity: bool = True,
) -> np.ndarray:
    """Derivative of `readings` with respect to an effect's parameters, (N, c, k).

    Parameters
    ----------
    robot, channels, segment, links, terms, gravity
        As in `readings`.
    effect
        One of the terms' or another.
    values
        Where to take the derivative; default the term's own values, or the effect's starts where it is no
        term yet.
    """
    own = next((t.values for t in terms if t.effect == effect), effect.starts)
    here = Term(effect, tuple(own if values is None else values))
    full = (*(t for t in terms if t.effect != effect), here)
    moving = effect_derivatives(Model.of(robot, channels, segment, links, full), effect)
    if gravity:
        return moving
    return moving - effect_derivatives(Model.of(robot, channels, segment.at_rest, links, full), effect)
