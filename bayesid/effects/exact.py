"""Exact readings and their derivatives, as they are or less what the same positions read at rest.

Readings about a point are a linear model of these: columns, and a target shifted so that the solution is the full value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.dynamics.channels import Channels
from bayesid.dynamics.kinematics import P, R, link_columns
from bayesid.effects import families
from bayesid.effects.bodies import body_of, split_matrix
from bayesid.effects.effect import Effect, Term, with_places
from bayesid.effects.families import differences
from bayesid.effects.flexible import MotionArrays
from bayesid.effects.library import by_number
from bayesid.effects.model import Model
from bayesid.effects.segment import MotionSegment
from bayesid.errors import InputError
from bayesid.robot.robot import Robot

#: Effects with which links are elsewhere than motors hold them.
_GIVING = (families.PlayEffect, families.FlexibleJointEffect, families.MountEffect)


def tangent(model: Model, change: np.ndarray) -> np.ndarray:
    """Change of the readings with a change of the true wrench and torques, (N, c, k)."""
    drives = model.torque_chain
    motors = drives.at_motors(change)
    change = drives.late(model.segment, motors)
    sensor = len(model.wrench) and model.of_family(families.SensorEffect)
    loaded = [(e, v) for e, v in model.of_family(families.JointTorqueEffect) if e.uses_load and e.joint in model.joints]
    on_top = model.of_family(families.ReadingEffect)
    gains = model.of_family(families.JointGainEffect)
    if not (sensor or loaded or on_top or gains):
        return change
    out = np.array(change)
    if sensor:
        out[:, model.wrench] = model.chain().linear(model.segment, change[:, model.wrench])
    for effect, values in loaded:
        k = model.joints[effect.joint]
        share = effect.per_load(model.joint_motion(effect), values)
        out[:, k] += share[:, None] * change[:, k]
    for effect, values in on_top:
        more = effect.tangent(model.readout, values, motors)
        out = out if more is None else out + drives.late(model.segment, more)
    return out * drives.gain[:, None] if gains else out


def link_derivatives(model: Model) -> np.ndarray:
    """Derivative of the readings with respect to the links' parameters at the links' motion, (N, c, 10 b)."""
    robot, b = model.robot, len(model.robot.body_names)
    out = link_columns(model.states, model.twists, model.row_of[:b], model.carries[:, :b], model.gravity)
    for body in range(robot.n, b):
        part = slice(10 * body, 10 * body + 10)
        out[:, :, part] = out[:, :, part] @ split_matrix(robot, body)
    return tangent(model, out)


def effect_derivatives(model: Model, effect: Effect) -> np.ndarray:
    """Derivative of the readings with respect to the parameters of one of the terms, (N, c, k).

    What an effect changes at most is differentiated: its own torque, load or weight; the whole reading where nothing less
    will do.
    """
    term = next(t for t in model.terms if t.effect == effect)
    values = term.values
    out = np.zeros((len(model.segment.times), len(model.channels), len(values)))
    if not any(effect.acts_on(c) for c in model.channels.names):
        return out
    match effect:
        case families.SensorEffect():
            true = model.true[:, model.wrench]
            out[:, model.wrench] = effect.columns(model.chain(without=effect), model.segment, true, values)
        case families.JointGainEffect() | families.JointTorqueEffect() if effect.joint not in model.joints:
            pass
        case families.JointGainEffect():
            k = model.joints[effect.joint]
            share = differences(effect, values, lambda v: np.full(1, effect.gain(v)))
            out[:, k] = model.ungained[:, k, None] * share
        case families.JointTorqueEffect():
            out[:, model.joints[effect.joint]] = effect_derivatives_at_joint(model, effect, values)
        case families.ReadingEffect():
            added = differences(effect, values, lambda v: effect.added(model.readout, v))
            out = model.torque_chain.late(model.segment, added) * model.torque_chain.gain[:, None]
        case families.BodyEffect():
            at = body_of(model.robot, effect.joint)
            rows, carried = model.row_of[at : at + 1], model.carries[:, at : at + 1]
            unit = link_columns(model.states, model.twists, rows, carried, model.gravity)
            ten = type(effect).body is families.BodyEffect.body  # its parameters are the body's own
            out = tangent(model, unit if ten else unit @ differences(effect, values, effect.body))
        case families.RotorEffect():
            unit = model.rotor_reading(model.channels, model.carries, model.states, model.twists, effect)
            share = differences(effect, values, lambda v: np.array(effect.inertia(v)))
            out = tangent(model, unit[:, :, None] * share)
        case families.LoadEffect():
            for body, wrench in effect.load_columns(model.robot, model.segment, model.states, values):
                out -= np.matmul(model.twists, wrench) * model.carries[:, body, None]
            out = tangent(model, out)
        case families.GravityEffect() if not any(model.of_family(f) for f in _GIVING):
            turned = differences(effect, values, lambda v: model.changed(Term(effect, v)).gravity)
            out = tangent(model, _weight(model) @ turned)
        case families.PlayEffect() if _without_play(model, effect):
            out = tangent(model, _play_columns(model, effect, values))
        case _:
            out = differences(effect, values, lambda v: model.changed(Term(effect, v)).readings)
    return out


def effect_derivatives_at_joint(model: Model, effect: families.JointTorqueEffect, values: tuple[float, ...]) -> np.ndarray:
    """Derivative of the reading of a joint's torque with respect to the parameters of what is inside that joint (N, k)."""
    motion = model.joint_motion(effect)
    return differences(effect, values, lambda v: effect.torque(motion, v)) * model.torque_chain.gain[model.joints[effect.joint]]


def _without_play(model: Model, effect: families.PlayEffect) -> bool:
    """Whether a joint's play is none as yet, and links are elsewhere where motors hold them."""
    gives = [t for family in _GIVING for t in model.of_family(family)]
    values = next(values for own, values in gives if own == effect)
    return len(gives) == 1 and effect.teeth(values)[0] == 0.0


def _play_columns(model: Model, effect: families.PlayEffect, values: tuple[float, ...]) -> np.ndarray:
    """Derivative of what there is to read with respect to a play that is none as yet (N, c, k)."""
    rigid = Model(model.robot, model.channels, model.segment, model.links, tuple(t for t in model.terms if t.effect != effect))
    joint, out = effect.joint or 0, np.zeros((len(model.segment.times), len(model.channels), len(values)))
    moves = rigid.little_play(joint, lambda torque: differences(effect, values, lambda v: effect.lean(torque, v)))
    for k, move in enumerate(moves):
        if any(part.any() for part in move):
            step = effect.quantities[k].step
            ahead, back = (
                rigid.taken(rigid.channels, rigid.carries, _moved(rigid.held_by_motors, joint, move, h)) for h in (step, -step)
            )
            out[:, :, k] = (ahead - back) / (2.0 * step)
    return out


def _moved(motion: MotionArrays, joint: int, change: MotionArrays, by: float) -> MotionArrays:
    """A motion of all joints, (N, n) each, with so much of a change of one joint's, (N,) each."""
    parts = [part.copy() for part in motion]
    for part, own in zip(parts, change, strict=True):
        part[:, joint] += by * own
    return parts[0], parts[1], parts[2]


def _weight(model: Model) -> np.ndarray:
    """Derivative of what the channels read of the weight of all bodies with respect to gravity (N, c, 3).

    A body with mass m and first moment h about the base origin pulls with the wrench ``-(m g, h x g)``.
    """
    x = model.states[:, model.row_of]
    rotation = x[:, :, R : R + 9].reshape(*x.shape[:2], 3, 3)
    mass, carried = model.bodies[:, 0], model.carries.astype(float)
    first = mass[:, None] * x[:, :, P : P + 3] + np.matmul(rotation, model.bodies[:, 1:4, None])[..., 0]
    return -(carried @ mass)[:, None] * model.twists[..., :3] - np.cross(model.twists[..., 3:], carried @ first)


def readings(
    robot: Robot,
    channels: Channels,
    segment: MotionSegment,
    links: np.ndarray,
    terms: Sequence[Term] = (),
    *,
    gravity: bool = True,
) -> np.ndarray:
    """What the channels read (N, c) [N, N m], everything included: a base sensor's load of the root link, too.

    ``links`` are ten parameters a body (b, 10) or (10 b,), an `InputError` where they are not. Without ``gravity`` it is less
    what the same positions read at rest (equation 21 of [Liu1998]_), free of offset and weight.
    """
    return _of_motion(lambda model: model.readings, robot, channels, segment, links, terms, gravity)


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
    """
    return _of_motion(link_derivatives, robot, channels, segment, links, terms, gravity)


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
    """Derivative of `readings` with respect to the parameters of an effect, one of the terms' or another, (N, c, k).

    It is taken at ``values``; default the term's own, or the effect's starts where it is no term yet.
    """
    own = next((t.values for t in terms if t.effect == effect), effect.starts)
    here = Term(effect, tuple(own if values is None else values))
    full = (*(t for t in terms if t.effect != effect), here)
    return _of_motion(lambda model: effect_derivatives(model, effect), robot, channels, segment, links, full, gravity)


def _of_motion(
    what: Callable[[Model], np.ndarray], robot: Robot, channels: Channels, segment: MotionSegment, links: np.ndarray,
    terms: Sequence[Term], gravity: bool,
) -> np.ndarray:  # fmt: skip
    """What a model gives for a motion; without gravity, less what it gives for the same positions at rest."""
    moving = what(Model.of(robot, channels, segment, links, terms))
    return moving if gravity else moving - what(Model.of(robot, channels, segment.at_rest, links, terms))


@dataclass(frozen=True, eq=False)
class Point:
    """Where the readings are linearised."""

    links: np.ndarray  # ten parameters a body (b, 10)
    base: np.ndarray  # the base parameters that belong to them (r,)
    values: np.ndarray  # of all effects' parameters, one after the other; of one that absorbs weight, with that
    free: np.ndarray  # which of them are estimated
    absorbed: np.ndarray  # what an effect that absorbs weight holds of it, by axis, (6,) [N, N m]
    middle: np.ndarray | None = None  # joint positions at the middle of the motion (n,)
    #: Which of those that are not estimated were to be, and are held where a fit that ran away with them stopped; None: none.
    unsettled: np.ndarray | None = None

    def terms(self, effects: Sequence[Effect]) -> tuple[Term, ...]:
        """The effects with their values; of one that absorbs weight, what is its own."""
        own = ((effect, self.values[places]) for effect, places in with_places(effects))
        return tuple(Term(effect, tuple(v - self.absorbed if effect.absorbs_weight else v)) for effect, v in own)

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
    estimated = [(effect, point.free[places]) for effect, places in with_places(effects) if point.free[places].any()]
    parts = [
        columns(robot, channels, segment, point.links, terms, effect, gravity=gravity)[:, :, free] for effect, free in estimated
    ]
    others = np.concatenate([np.zeros((*measured.shape, 0)), *parts], axis=2)
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
