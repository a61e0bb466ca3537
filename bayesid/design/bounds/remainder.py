"""What parameters do not explain: the non-parametric part of the uncertainty [Liu1996]_, counted once.

Readings differ from a model's by the error of its parameters, by what the model lacks and by noise. The first is ``A V A'``,
with V the parameters' covariance, so the second is what is left beside it, joint by joint and by speed, where friction shows.
Of motions that were not fitted, with residuals e below 10 Hz and noise n^2 there, 95 % of the samples have

    |e| <= 1.96 sqrt(A V A' + r^2 + n^2),    r^2 = quantile of e^2 / 1.96^2 - A V A' - n^2,

and so has a band of that width for any other motion. Residuals that were fitted are smaller by what the parameters took,
whose mean is ``A V A'`` once more: with its sign turned they tell r^2 where no motion was held out. Where one was, they are
taken along as they are, at least that large: how much a model lacks differs between motions, and the next may be like any of
them. Where what is left is as large as noise and parameters make it, nothing is lacking and r is zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from bayesid.design.bounds.model import ReadingModel, spread
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects.families import only_read
from bayesid.recordings.experiment import Motion
from bayesid.regression.problem import Problem
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import Segment
from bayesid.rounding import HALF, LEVEL
from bayesid.validation.noise_floor import NoiseFloor, noise_floor
from bayesid.validation.prediction import BAND, TOLERATED, in_band

#: Share of the samples that a bound holds.
SHARE = 0.99
#: Classes of speed, as many samples in each.
_CLASSES = 5


@dataclass(frozen=True, eq=False)
class Remainder:
    """What is left of the readings of motions, by channel."""

    channels: tuple[str, ...]  # names of the channels (c,)
    motions: tuple[str, ...]  # names of the motions
    held_out: bool  # whether none of them was fitted
    bound: np.ndarray  # 99 % of the samples are below (c,) [N m or N]
    #: Upper edges of classes of speed (c, k): the joint's own for its torque, the fastest joint's for the wrench [rad/s or
    #: m/s].
    speeds: np.ndarray
    by_speed: np.ndarray  # the same bound in each class, of the fitted motions where no other is that fast (c, k)
    share: np.ndarray  # root mean square of what is left over that of the readings (c,)
    middles: np.ndarray  # median speed in each class (c, k)
    #: r by class: what the model lacks, as a standard deviation beside that of the parameters (c, k); zero where nothing does.
    model_error: np.ndarray
    #: What is left of each segment in units of ``sqrt(A V A' + r^2 + n^2)`` (N, c), and its times (N,) [s].
    paths: tuple[tuple[np.ndarray, np.ndarray], ...]

    @property
    def complete(self) -> bool:
        """Whether noise and parameters explain all that is left."""
        return not self.model_error.any()

    def at(self, v: np.ndarray) -> np.ndarray:
        """R at joint velocities (N, n), linear in speed between the classes (N, c)."""
        speed = _speeds(v, self.channels)
        return np.stack([np.interp(*x) for x in zip(speed.T, self.middles, self.model_error, strict=True)], axis=1)

    def pieces(self, count: int, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Pieces of ``paths`` at ``times`` (N,) [s], each from a random place on and repeated where it ends (count, N, c).

        Where the times are nan, each sample has a random place of its own.
        """
        lengths = np.array([len(t) for _, t in self.paths])
        joined = np.concatenate([path for path, _ in self.paths])
        if np.isnan(times).any():
            return joined[rng.integers(len(joined), size=(count, len(times)))]
        which = rng.choice(len(lengths), size=count, p=lengths / lengths.sum())
        step = np.array([np.median(np.diff(t)) for _, t in self.paths])[which, None]
        after = np.round((times - times[0]) / step).astype(int)
        place = (rng.integers(lengths[which])[:, None] + after) % lengths[which][:, None]
        return joined[(np.cumsum(lengths) - lengths)[which][:, None] + place]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``."""
        return {
            "motions": list(self.motions), "held_out": self.held_out, "share_of_samples": SHARE,
            "torque_residual": self.bound.tolist(), "speed_classes": self.speeds.tolist(),
            "torque_residual_by_speed": self.by_speed.tolist(), "relative_rms": self.share.tolist(),
            "model_error_std_by_speed": self.model_error.tolist(), "median_speeds": self.middles.tolist(),
        }  # fmt: skip


def _speeds(v: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Speed that each channel's error is sorted by (N, c)."""
    speed = np.abs(v)
    return np.repeat(speed.max(axis=1, keepdims=True), len(names), axis=1) if names == WRENCH_NAMES else speed


def remainder(problem: Problem, model: ReadingModel, floor: NoiseFloor | None = None) -> Remainder | None:
    """What the model leaves of recorded readings; None where none were recorded.

    They are those of motions of role ``validation`` and of those that were fitted; bounds are of the former where there are any.
    Of the wrench the mean over a motion is left to the sensor's offset. ``floor`` is noise of the readings that were fitted; that
    of others is measured.
    """
    readable = [m for m in problem.experiment.motions if m.name in problem.segments and m.kind != "poses"]
    with_readings = [m for m in readable if _read(model, m) is not None]
    judges = [m for m in with_readings if m.role == "validation" and m.name not in problem.fitted]
    fitted = [m for m in with_readings if m.name in problem.fitted]
    unseen, seen = ([part for m in motions for part in _left(problem, model, m)] for motions in (judges, fitted))
    if not (parts := [*unseen, *seen]):
        return None
    e, v, y, variance = (np.concatenate([part[k] for part in parts]) for k in range(1, 5))
    count = sum(len(part[0]) for part in unseen) or len(e)  # samples that bounds are of come first
    noise = _noise_below(problem, model, floor, float(np.median(np.diff(parts[0][0]))))
    taken = not judges and set(model.channels.names) <= set(problem.row_model.channels.names)
    own = -variance if taken else np.where(np.arange(len(e))[:, None] < count, variance, 0.0)
    lacking = np.mean(e**2 - np.minimum(own, 0.0), axis=0) > TOLERATED**2 * (noise + np.mean(np.maximum(own, 0.0), axis=0))
    more = e**2 / HALF**2 - own - noise
    speed = _speeds(v, model.channels.names)
    edges = np.quantile(speed, np.arange(1, _CLASSES + 1) / _CLASSES, axis=0)
    of_classes = np.full((3, e.shape[1], _CLASSES), np.nan)
    bounds, middles, error = of_classes
    for j, k, at in _classes(speed, edges):
        bounds[j, k] = np.quantile(np.abs(e[at, j]), SHARE)
        middles[j, k] = np.median(speed[at, j])
        error[j, k] = np.sqrt(max(float(np.quantile(more[at, j], LEVEL)), 0.0)) if lacking[j] else 0.0
    for j, k, at in _classes(speed[:count], edges):
        bounds[j, k] = np.quantile(np.abs(e[:count][at, j]), SHARE)
    for k in range(1, _CLASSES):  # where a joint mostly rests, several classes are that one speed
        of_classes[:, :, k] = np.where(np.isnan(of_classes[:, :, k]), of_classes[:, :, k - 1], of_classes[:, :, k])
    rms = [np.sqrt(np.mean(x[:count] ** 2, axis=0)) for x in (e, y)]
    found = Remainder(
        model.channels.names, tuple(m.name for m in judges or fitted), bool(judges),
        np.quantile(np.abs(e[:count]), SHARE, axis=0), edges.T, bounds, rms[0] / np.maximum(rms[1], 1e-300), middles, error, (),
    )  # fmt: skip
    # Noise is in what is left: where neither parameters nor the model err, as at rest, it must not be taken for their error.
    paths = [(left / np.maximum(np.sqrt(s + found.at(w) ** 2 + noise), 1e-300), t) for t, left, w, _, s in parts]
    return replace(found, paths=tuple(paths))


def _is_wrench(model: ReadingModel) -> bool:
    return model.channels.names == WRENCH_NAMES


def _classes(speed: np.ndarray, edges: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
    """Channel, class of speed, and which samples (N,) are of that class, as far as there are any."""
    for j in range(speed.shape[1]):
        place = np.minimum(np.searchsorted(edges[:, j], speed[:, j]), len(edges) - 1)
        for k in np.unique(place):
            yield j, int(k), place == k


def _read(model: ReadingModel, motion: Motion) -> np.ndarray | None:
    """What was recorded of a model's channels (N, c)."""
    if _is_wrench(model):
        return motion.table.wrench
    every = len(motion.table.torque_joints) == model.robot.n  # a bound is of all joints
    return motion.table.torques if every else None


def _left(problem: Problem, model: ReadingModel, motion: Motion) -> Iterator[tuple[np.ndarray, ...]]:
    """Times, what is left of the readings, joint velocities, readings below 10 Hz, and A V A', segment by segment."""
    readings = _read(model, motion)
    assert readings is not None
    for segment in problem.segments[motion.name]:
        first, last = (0, 0) if segment.poses else segment.inner(problem.row_model.margin)
        if last - first < 2:
            continue
        state = problem.row_model.state(segment, first, last)
        at = np.searchsorted(motion.table.times, state.times)
        constant, matrix = model.columns(state.positions, state.velocities, state.accelerations)
        measured = in_band(state.times, readings[at] - _only_read(problem.row_model, model, segment, first, last), poses=False)
        left = measured - in_band(state.times, constant + matrix @ model.region.values, poses=False)
        if _is_wrench(model):  # the offset takes the mean of both
            left, matrix = left - left.mean(axis=0), matrix - matrix.mean(axis=0)
        yield state.times, left, state.velocities, measured, spread(matrix, model.region.covariance) ** 2


def _only_read(row_model: RowModel, model: ReadingModel, segment: Segment, first: int, last: int) -> np.ndarray | float:
    """What identified errors of the sensor and the drives' readings add to samples first ... last - 1 (N, c)."""
    point, names = row_model.point, row_model.channels.names
    acts = [not only_read(effect) for effect in row_model.effects]
    if point is None or all(acts) or not set(model.channels.names) <= set(names):
        return 0.0
    own = np.repeat(acts, [len(effect.parameters) for effect in row_model.effects])
    true = replace(point, values=point.values[own], free=point.free[own], unsettled=None)
    without = replace(row_model, effects=tuple(compress(row_model.effects, acts)), point=true)
    read, there = (m.modelled(segment, first, last, np.zeros(0)) for m in (row_model, without))
    return (read - there)[:, [names.index(name) for name in model.channels.names]]


def _noise_below(problem: Problem, model: ReadingModel, floor: NoiseFloor | None, step: float) -> np.ndarray:
    """Variance of the readings' noise below 10 Hz (c,); zero where nothing tells it."""
    names, fitted = model.channels.names, problem.row_model.channels.names
    if not set(names) <= set(fitted):  # then it is of all joints or of none
        fitted, floor = names, noise_floor(problem, "wrench" if _is_wrench(model) else "torque")
    if floor is None:
        return np.zeros(len(names))
    below = floor.below(BAND, problem.row_model.step) * min(step / problem.row_model.step, 1.0)
    return below[[fitted.index(name) for name in names]]
