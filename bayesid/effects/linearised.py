"""Readings about a point, as a linear model: columns, and a target shifted so that the solution is the full value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.dynamics.channels import Channels
from bayesid.effects.effect import Effect, Term
from bayesid.effects.exact import columns, readings, rigid_columns
from bayesid.effects.library import by_number
from bayesid.effects.segment import MotionSegment
from bayesid.errors import InputError
from bayesid.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Point:
    """Where the readings are linearised."""

    links: np.ndarray  # ten parameters a body (b, 10)
    base: np.ndarray  # the base parameters that belong to them (r,)
    values: np.ndarray  # of all effects' parameters, one after the other; of one that absorbs weight, with that
    free: np.ndarray  # which of them are estimated
    absorbed: np.ndarray  # what an effect that absorbs weight holds of it, by axis, (6,) [N, N m]
    middle: np.ndarray | None = None  # joint positions at the middle of the motion (n,)

    def terms(self, effects: Sequence[Effect]) -> tuple[Term, ...]:
        """The effects with their values; of one that absorbs weight, what is its own."""
        out, start = [], 0
        for effect in effects:
            count = len(effect.parameters)
            values = self.values[start : start + count]
            out.append(Term(effect, tuple(values - self.absorbed if effect.absorbs_weight else values)))
            start += count
        return tuple(out)

    def reach(self, effects: Sequence[Effect], bandwidth: float, step: float) -> float:
        """Time before and after some samples that their readings depend on [s]."""
        return reach_of(self.terms(effects), bandwidth, step)


def reach_of(terms: Sequence[Term], bandwidth: float, step: float) -> float:
    """Time before and after some samples that their readings depend on [s]; bandwidth of the motion [Hz], step of samples [s]."""
    return max((t.effect.reach(t.values, bandwidth, step) for t in terms), default=0.0)


@np.errstate(all="ignore")  # values that are tried may overflow; the cost, not a warning, says so
def linearised(
    robot: Robot,
    channels: Channels,
    segment: MotionSegment,
    effects: Sequence[Effect],
    point: Point,
    independent: np.ndarray,
    measured: np.ndarray,
    *,
    gravity: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (N, c, r) and (N, c, free effect parameters) and target (N, c) of the linear model about a point.

    ``independent`` are the indices of the links' parameters that are base parameters (r,); ``measured`` are readings, the static
    load of a base sensor included (N, c), without ``gravity`` less those at rest. The target is what is measured less what the
    point reads, plus what the columns make of the point.
    """
    terms = point.terms(effects)
    rigid = rigid_columns(robot, channels, segment, point.links, terms, gravity=gravity)[:, :, independent]
    parts = [np.zeros((*measured.shape, 0))]
    start = 0
    for effect in effects:
        count = len(effect.parameters)
        if point.free[start : start + count].any():
            parts.append(columns(robot, channels, segment, point.links, terms, effect, gravity=gravity))
        start += count
    others = np.concatenate(parts, axis=2)
    target = measured - readings(robot, channels, segment, point.links, terms, gravity=gravity)
    target = target + rigid @ point.base + others @ point.values[point.free]
    return rigid, others, target


def stated_of(
    effect: Effect, stated: Mapping[str, Mapping[str, float | bool]], joint_names: Sequence[str]
) -> Mapping[str, float | bool]:
    """What ``[model.values]`` states of an effect: by its place, by its joint's name, or for all of its kind."""
    own = (key for key in stated if by_number(key, joint_names) == effect.spec)
    return next((stated[key] for key in (effect.spec, *own, effect.name) if key in stated), {})


def starting_point(
    effects: Sequence[Effect], stated: Mapping[str, Mapping[str, float | bool]], joint_names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Values that an estimate starts from, and which are estimated; ``stated`` is ``[model.values]``.

    An `InputError` where a value is of a parameter that the effect does not have.
    """
    values, free = [], []
    for effect in effects:
        own = dict(zip(effect.parameters, effect.starts, strict=True))
        given = stated_of(effect, stated, joint_names)
        for key, value in given.items():
            if key == "fixed":
                continue
            if key not in own:
                raise InputError(f"[model.values] '{effect.spec}': no parameter '{key}'; it has {', '.join(own)}")
            own[key] = float(value)
        values += own.values()
        free += [not given.get("fixed", False)] * len(own)
    return np.array(values, float), np.array(free, bool)
