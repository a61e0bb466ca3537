"""Readings that an estimate predicts for any motion, with their bands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import null_space

from bayesid.dynamics.regressors import Kernel
from bayesid.effects import MotionSegment, Point, linearised
from bayesid.errors import InputError
from bayesid.estimators.parameters import central_interval
from bayesid.regression.linalg import takes, unshown
from bayesid.regression.problem import Problem
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import Segment
from bayesid.robot.robot import Robot

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class PredictedReadings:
    """Readings that a model predicts, and how sure they are."""

    #: What is read (c,).
    channel_names: tuple[str, ...]
    channel_units: tuple[str, ...]
    values: np.ndarray  # predicted readings (N, c), effects such as friction included
    #: Their standard deviations (N, c), from the covariance of all parameters; the noise of a single reading is not in them.
    #: nan where the estimate has no honest covariance, or where the reading takes something that the data say nothing of, as a
    #: motion takes inertias that fitted poses at rest do not show. A sum that they know, such as of a link's inertia and its
    #: rotor's, is known, whatever is open of its parts.
    std: np.ndarray
    #: Whether they hold gravity; False where a static run was subtracted from what was fitted: then the estimate knows the
    #: motion's part of the wrench only.
    gravity: bool = True

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the 95 % band, reading by reading (N, c)."""
        return central_interval(self.values, self.std)[0]

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the 95 % band, reading by reading (N, c)."""
        return central_interval(self.values, self.std)[1]

    def to_dataframe(self) -> DataFrame:
        """A row a sample and reading: ``sample``, ``channel``, ``unit``, ``value``, ``std``, ``low``, ``high``."""
        from pandas import DataFrame

        count, channels = self.values.shape
        return DataFrame({
            "sample": np.repeat(np.arange(count), channels), "channel": np.tile(self.channel_names, count),
            "unit": np.tile(self.channel_units, count),
            "value": self.values.ravel(), "std": self.std.ravel(), "low": self.low.ravel(), "high": self.high.ravel(),
        })  # fmt: skip

    def __repr__(self) -> str:
        gravity = "" if self.gravity else ", without gravity"
        return f"<PredictedReadings: {len(self.values)} samples of {', '.join(self.channel_names)}{gravity}>"


def checked_states(robot: Robot, *states: np.ndarray) -> list[np.ndarray]:
    """Positions, velocities and so on as finite arrays (N, n); an `InputError` where they are not."""
    out = [np.atleast_2d(np.asarray(x, float)) for x in states]
    for name, x in zip(("q", "v", "a", "a_r"), out, strict=False):
        if x.shape != (len(out[0]), robot.n) or not len(x):
            raise InputError(f"{name} has shape {x.shape}: give (N, {robot.n}), one column a joint, all with the same N")
        if not np.isfinite(x).all():
            raise InputError(f"{name} is not finite in row {int(np.argwhere(~np.isfinite(x))[0][0])}; leave that sample out")
    return out


def checked_times(times: np.ndarray, count: int) -> np.ndarray:
    """Times of so many samples (N,) [s]; an `InputError` where they are not as many, or do not rise."""
    out = np.asarray(times, float)
    if out.shape != (count,) or not (np.isfinite(out).all() and (np.diff(out) > 0).all()):
        raise InputError(f"times: give {count} increasing times [s], one a sample of q")
    return out


def predict_readings(
    problem: Problem,
    solution: np.ndarray,
    covariance: np.ndarray | None,
    undetermined: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    times: np.ndarray | None = None,
) -> PredictedReadings:
    """Readings at joint positions, velocities and accelerations, (N, n) each, or (n,) for one sample.

    The model is linearised at the estimate; ``solution``, ``covariance`` and ``undetermined`` are of base parameters, then
    effect parameters (p,), (p, p), (p,). Times (N,) [s] are needed where an effect depends on them, such as a delay or a drift.
    An `InputError` where shapes do not fit, values are not finite, or times are missing.
    """
    row_model = problem.row_model
    states = checked_states(row_model.robot, q, v, a)
    count = len(states[0])
    gravity = any(s.gravity for s in problem.fitted_segments)
    if times is None:
        _require_timeless(problem, states, gravity)
        clock = np.arange(count, dtype=float)
    else:
        clock = checked_times(times, count)
    matrix, constant = _columns(row_model, clock, states, gravity)
    values = constant + matrix @ solution
    std = np.full(values.shape, np.nan)
    if covariance is not None:
        std = np.sqrt(np.maximum(np.einsum("ncp,pq,ncq->nc", matrix, covariance, matrix, optimize=True), 0.0))
        std[takes(matrix, unshown(covariance, undetermined))] = np.nan
    if problem.at_rest:  # the model of poses has no parameters for what a motion takes beyond gravity
        nominal, beyond = _beyond_poses(row_model, states)
        std = np.where(beyond, np.nan, std)
        if row_model.point is None:  # about a point, which has the nominal links, they are in the constant
            values = values + np.where(beyond, nominal, 0.0)
    channels = row_model.channels
    return PredictedReadings(channels.names, channels.units, values, std, gravity)


def _columns(row_model: RowModel, times: np.ndarray, states: list[np.ndarray], gravity: bool) -> tuple[np.ndarray, np.ndarray]:
    """``matrix`` (N, c, p) and ``constant`` (N, c): readings are ``constant + matrix @ solution``."""
    rank, channels = row_model.base.rank, row_model.channels
    state = MotionSegment(times, states[0], states[1], states[2], bandwidth=row_model.bandwidth)
    nothing = np.zeros((len(times), len(channels)))
    if row_model.point is not None:
        state = replace(state, middle=row_model.point.middle)
        rigid, others, target = linearised(
            row_model.robot, channels, state, row_model.effects, row_model.point, row_model.base.independent, nothing,
            gravity=gravity,
        )  # fmt: skip
        return np.concatenate([rigid, others], axis=2), -target
    segment = Segment(times, states[0], nothing, nothing, 0, gravity=gravity, offset=gravity)
    matrix = np.empty((*nothing.shape, rank + row_model.extra_columns))
    matrix[:, :, :rank] = row_model.kernel.dynamics(*states, gravity=gravity)
    matrix[:, :, rank:] = row_model.effect_columns(segment, state)
    return matrix, nothing + channels.static_wrench if gravity else nothing


def _beyond_poses(row_model: RowModel, states: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What readings take of parameters, such as inertias, that the base parameters of poses at rest do not hold.

    By the nominal links (N, c), and whether it is anything (N, c).
    """
    base = row_model.base
    rows, changes = Kernel.of(row_model.robot, row_model.channels).dynamics(*states), null_space(base.matrix)
    links = row_model.robot.nominal.ravel()
    nominal = links - np.eye(len(links))[:, base.independent] @ (base.matrix @ links)
    if base.absorbed is not None:  # weight that is the same in every state is in the sensor's offset
        constant = np.broadcast_to(np.eye(rows.shape[1], len(base.absorbed)), (*rows.shape[:2], len(base.absorbed)))
        rows = np.concatenate([rows, constant], axis=2)
        nominal, changes = (np.concatenate([x, -base.absorbed @ x]) for x in (nominal, changes))
    return rows @ nominal, takes(rows, changes)


def _require_timeless(problem: Problem, states: list[np.ndarray], gravity: bool) -> None:
    """Refuse to do without times where any effect asks for them: with another clock it would say something else."""
    row_model = problem.row_model
    effects, point = row_model.effects, row_model.point
    waits = isinstance(point, Point) and (
        any(e.settling > 0.0 for e in effects) or point.reach(effects, row_model.bandwidth, row_model.step) > 0.0
    )
    if not waits:
        some = [x[:8] for x in states]
        clock = np.arange(len(some[0]), dtype=float)
        (one, first), (other, second) = (_columns(row_model, t, some, gravity) for t in (clock, 100.0 + 3.0 * clock))
        waits = not (np.array_equal(one, other) and np.array_equal(first, second))
    if waits:
        raise InputError(f"times are missing, and one of {', '.join(e.spec for e in effects)} depends on them; give times=")
