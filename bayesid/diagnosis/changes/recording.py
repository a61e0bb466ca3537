"""The later recording in the reference's terms: what is left of it there, and columns of all that may have changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arguments import argument
from bayesid.diagnosis.changes.proposals import with_proposals
from bayesid.diagnosis.changes.reference import Reference, with_bodies
from bayesid.errors import InputError
from bayesid.estimators.dispersion import PARTS, Rows, dispersions
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare, weight_columns
from bayesid.regression.rows import make_blocks
from bayesid.robot.robot import Robot

#: Frames of two URDFs are the same if they differ by no more than this [m, 1].
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class LaterRecording:
    """The later recording's rows about the reference, each channel in units of what the recording's own fit leaves of it."""

    problem: Problem  # its own fit's problem
    #: (N, q): columns of the reference's parameters, of bodies attached to each link (ten a body), of the reference's
    #: proposals, and of these less what the reference's estimate takes of them.
    rows: np.ndarray
    left: np.ndarray  # readings less what the reference says (N,)
    #: Of the rows (N,) [s], and index of the motion.
    times: np.ndarray
    motions: np.ndarray
    channel: np.ndarray  # index of the channel (N,)
    #: What the recording's own fit of the same model leaves (N,), as large as it is of readings that were not fitted: mean square
    #: one in every channel.
    own: np.ndarray
    scale: np.ndarray  # unit of each channel (c,) [N m or N], times the root of ``samples``
    samples: float  # how many samples a row stands for
    grown: np.ndarray  # how many times as much of each channel as the reference's own fit its own fit leaves (c,)
    correlation: float  # how many rows count as one: dispersion of the own fit between parts of the recording


def read_recording(reference: Reference, experiment: Experiment, motions: Sequence[str] | None) -> LaterRecording:
    """Prepare, weight and lay out the later recording: the given motions, or those with role ``identification``.

    Rows are weighted by channel and not whitened: what a real joint does beyond any model is no stationary noise, and a fit
    that gives much weight to frequencies with little noise is biased. How few of them are independent, parts of the recording
    show (`bayesid.estimators.dispersion`). An `InputError` where it is another robot, or its readings are others.
    """
    before = reference.problem
    problem, estimate = solve(_prepared(reference, experiment, motions, before.smoother.bandwidth), "wls")
    model = problem.row_model
    mine, other = model.channels.names, before.row_model.channels.names
    alike = mine == other and model.base.rank == before.row_model.base.rank
    if not alike or len(estimate.solution) != len(reference.solution):
        named, after = argument("reference", before.experiment.name), experiment.name
        if mine != other:
            raise InputError(
                f"{named}: has {listed(other)}, but {after} has {listed(mine)}; leave out of both what one of them lacks"
            )
        if problem.at_rest != before.at_rest:
            raise InputError(f"{named}: only one of the two is of poses at rest; compare poses with poses, motions with motions")
        raise InputError(f"{named}: only one of the two has static readings; leave them out of both")
    blocks = list(make_blocks(with_proposals(model, reference.point, reference.proposals), problem.fitted_segments))
    rows = np.concatenate([block.rows for block in blocks])
    count, p = rows.shape[1], len(reference.solution)
    own = rows[:, :, -1] - rows[:, :, :p] @ estimate.solution
    if own.size < 2 * p:
        raise InputError(
            f"experiment {experiment.name}: its own fit has {p} parameters for {own.size} numbers, so that what it leaves is no "
            "measure of what a change leaves; record longer, or more poses"
        )
    scale = np.sqrt(np.sum(own**2, axis=0) / (len(own) - p / count))
    scale = np.maximum(scale, 1e-9 * scale.max(initial=1e-200))
    left = own / np.maximum(np.sqrt(np.mean(own**2, axis=0)), 1e-300)
    samples = _samples_of_a_row(problem)
    # Noise is alike in single samples, what a model lacks in rows.
    grown = scale / reference.left * min(1.0, np.sqrt(_samples_of_a_row(before) / samples))
    flat = (rows / scale[:, None]).reshape(-1, rows.shape[2])
    x, z, y = flat[:, :p], flat[:, p:-1], flat[:, -1]
    grams = [part.T @ part for part in np.array_split(np.column_stack([x, y]), PARTS)]
    return LaterRecording(
        problem, np.hstack([x, x @ _body_columns(problem), z, z - x @ reference.lacking.carried]), y - x @ reference.solution,
        np.repeat(np.concatenate([block.times for block in blocks]), count),
        np.repeat(np.concatenate([np.full(len(block.rows), block.motion) for block in blocks]), count),
        np.tile(np.arange(count), len(rows)), left.ravel(), scale, samples, grown,
        dispersions(Rows(grams), estimate.solution)[0].factor,
    )  # fmt: skip


def _samples_of_a_row(problem: Problem) -> float:
    step = float(np.median(np.concatenate([np.diff(s.times) for s in problem.fitted_segments])))
    return max(problem.row_model.step / step, 1.0)


def chosen_bandwidth(reference: Reference, experiment: Experiment, motions: Sequence[str] | None) -> float:
    """The bandwidth that the later recording would choose for itself [Hz]; parameters and errors as in `read_recording`."""
    return _prepared(reference, experiment, motions, None).smoother.bandwidth


def _prepared(reference: Reference, experiment: Experiment, motions: Sequence[str] | None, bandwidth: float | None) -> Problem:
    """The later recording with the reference's robot and model."""
    before = reference.problem
    check_same(before.experiment, experiment)
    known = replace(
        experiment, robot=reference.robot, effects=before.experiment.effects, effect_values=before.experiment.effect_values,
        library=before.experiment.library, gear_ratio=before.experiment.gear_ratio,
    )  # fmt: skip
    return prepare(known, FitOptions(before.channel, effects=before.effects, motions=motions, bandwidth=bandwidth))


def _body_columns(problem: Problem) -> np.ndarray:
    """What the reference's parameters change by with the ten parameters of each body (p, 10 b)."""
    model = problem.row_model
    out = np.zeros((model.base.rank + len(problem.regression.effect_names), len(model.base.parameter_names)))
    out[: model.base.rank] = model.base.matrix
    absorbing = weight_columns(model)
    if model.base.absorbed is not None and absorbing:
        out[model.base.rank + np.array(absorbing)] = model.base.absorbed[: len(absorbing)]
    return out


def check_same(before: Experiment, after: Experiment) -> None:
    """Refuse a comparison of two robots with an `InputError`; masses and limits may differ, for they are not compared."""
    one, other = before.robot, with_bodies(after).robot
    if one.joint_names != other.joint_names:
        raise InputError(
            f"{argument('reference', before.name)}: joints {', '.join(one.joint_names)}, but {after.name} has "
            f"{', '.join(other.joint_names)}; name a recording of the same robot"
        )
    if (part := _differs(one, other)) is not None:
        raise InputError(
            f"{argument('reference', before.name)}: {part} not as in {after.name}; name a recording of the same robot"
        )
    a, b = before.sensor, after.sensor
    moved = a is not None and b is not None and np.abs(np.subtract([a.translation, a.rpy], [b.translation, b.rpy])).max() > _SAME
    if (a is None) != (b is None) or (a is not None and b is not None and a.joint != b.joint) or moved:
        raise InputError(
            f"{argument('reference', before.name)}: [sensor] is not as in {after.name}; state the same in both experiment.toml"
        )


def _differs(one: Robot, other: Robot) -> str | None:
    """What of two robots' geometry is not the same."""
    for name, words in (
        ("body_names", "the sensor's link is"), ("parent", "the tree of joints is"), ("prismatic", "the kinds of joints are"),
        ("rotation", "joint frames are"), ("translation", "joint frames are"), ("axis", "joint axes are"),
        ("gravity", "gravity is"),
    ):  # fmt: skip
        a, b = getattr(one, name), getattr(other, name)
        if a is b or (isinstance(a, tuple) and a == b):
            continue
        unlike = isinstance(a, tuple) or np.shape(a) != np.shape(b)
        if unlike or np.max(np.abs(np.subtract(a, b, dtype=float)), initial=0.0) > _SAME:
            return words
    return None
