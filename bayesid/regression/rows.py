"""From samples to rows: recordings + robot + effects + filters -> blocks of rows in the motion's band.

Samples are handled in chunks that fit the processor's cache and on all cores; what comes out is a thin stream of
rows. Two ways lead there: with the accelerations of the smoothed trajectory, or without any through the
paper's filters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.dynamics.channels import Channels
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import Effect, MotionSegment, Point, linearised, readings
from bayesid.errors import InputError
from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.regression.segment import Segment
from bayesid.robot.robot import Robot
from bayesid.signals.filters import HALF_WIDTH, LowPass, low_pass, project
from bayesid.signals.smoothing import OVERLAP, smooth

_CHUNK = 4096  # samples handled at once
_PANEL = 512  # samples whose rows stay in the processor's cache
_BLOCK_ROWS = 4096  # rows handed on at once

#: From a segment and its samples first ... last - 1: what is put on their rows (N, channels, any).
Samples = Callable[[Segment, int, int], np.ndarray]


@dataclass(frozen=True, repr=False)
class RowModel:
    """How samples become rows: everything but the samples.

    Attributes
    ----------
    robot, channels, base, effects
        The model.
    bandwidth
        Of the joint motion [Hz].
    step
        Distance of rows [s].
    filters
        The paper's low-passes, or None for rows straight from the smoothed trajectory.
    point
        Where the readings are linearised, where effects are not plain columns beside the rigid ones.
    """

    robot: Robot
    channels: Channels
    base: BaseParameters
    effects: tuple[Effect, ...]
    bandwidth: float
    step: float
    filters: LowPass | None = None
    point: Point | None = None

    @property
    def margin(self) -> float:
        """Time at both ends of a segment where trajectory or mount have not settled [s]."""
        settling = 0.0 if self.point is None else self.point.settling(self.effects)
        return max(0.75 / self.bandwidth, settling)

    @cached_property
    def kernel(self) -> Kernel:
        """Regressors of the base parameters."""
        return Kernel.of(self.robot, self.channels, self.base.independent)

    @property
    def free(self) -> np.ndarray:
        """Which of the effects' parameters are estimated (p,)."""
        return np.ones(sum(len(e.column_names) for e in self.effects), bool) if self.point is None else self.point.free

    @property
    def extra_columns(self) -> int:
        """Number of effect parameters that are estimated."""
        return int(self.free.sum())

    def state(self, segment: Segment, first: int, last: int) -> MotionSegment:
        """Smoothed trajectory of samples first ... last - 1, from them and enough neighbours."""
        times = segment.times[first:last]
        if segment.poses:
            still = np.zeros_like(segment.positions[first:last])
            return MotionSegment(times, segment.positions[first:last], still, still)
        if segment.rates is not None:
            return MotionSegment(times, segment.positions[first:last], *segment.rates[:, first:last])
        reach = OVERLAP * 0.5 / self.bandwidth
        a = int(np.searchsorted(segment.times, times[0] - reach))
        b = int(np.searchsorted(segment.times, times[-1] + reach, side="right"))
        state = smooth(segment.times[a:b], segment.positions[a:b], self.bandwidth, at=times)
        return MotionSegment(times, *state, encoders=(times, segment.positions[first:last]))

    def effect_columns(self, segment: Segment, state: MotionSegment) -> np.ndarray:
        """(N, channels, effect parameters), to be read only."""
        if all(effect.always_the_same for effect in self.effects):
            columns = self._constant_columns[segment.offset]
            return np.broadcast_to(columns, (len(state.times), *columns.shape))
        return self._columns(state, segment.offset)

    @cached_property
    def _constant_columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns (channels, effect parameters) of effects that are always the same, without a sensor's offset and with it."""
        still = np.zeros((1, self.robot.n))
        still = MotionSegment(np.zeros(1), still, still, still)
        return self._columns(still, False)[0], self._columns(still, True)[0]

    def _columns(self, state: MotionSegment, offset: bool) -> np.ndarray:
        out = np.zeros((len(state.times), len(self.channels), sum(len(e.column_names) for e in self.effects)))
        first = 0
        for effect in self.effects:
            last = first + len(effect.column_names)
            if offset or not effect.removed_by_static_run:
                out[:, :, first:last] = effect.motion_columns(state, self.channels.names)
            first = last
        return out

    def _scene(self, segment: Segment, first: int, last: int) -> tuple[MotionSegment, int, int]:
        """The samples' motion and what the effects need of that around them: samples a ... b - 1, with a and b."""
        assert self.point is not None
        a, b = first, last
        if not segment.poses:
            times = segment.times
            reach = self.point.reach(self.effects, self.bandwidth, float(np.median(np.diff(times[:1000]))))
            a = int(np.searchsorted(times, times[first] - reach))
            b = int(np.searchsorted(times, times[last - 1] + reach, side="right"))
        return replace(self.state(segment, a, b), still=segment.poses, bandwidth=self.bandwidth, middle=self.point.middle), a, b

    def about_point(self, segment: Segment, first: int, last: int) -> np.ndarray:
        """Unfiltered rows of samples about the point: regressor, effects, shifted target (N, channels, p + 1)."""
        assert self.point is not None
        scene, a, b = self._scene(segment, first, last)
        read = segment.readings[a:b] if segment.gravity else segment.measured(a, b)
        rigid, others, target = linearised(
            self.robot, self.channels, scene, self.effects, self.point, self.base.independent, read, gravity=segment.gravity
        )
        part = slice(first - a, last - a)
        return np.concatenate([rigid[part], others[part], target[part, :, None]], axis=2)

    def samples(self, segment: Segment, first: int, last: int) -> np.ndarray:
        """Unfiltered rows of samples: regressor, effects, measured (N, channels, p + 1)."""
        if self.point is not None:
            return self.about_point(segment, first, last)
        state = self.state(segment, first, last)
        rank, effects = self.base.rank, self.effect_columns(segment, state)
        out = np.empty((last - first, len(self.channels), rank + effects.shape[2] + 1))
        for a in range(0, last - first, _PANEL):
            part = slice(a, a + _PANEL)
            out[part, :, :rank] = self.kernel.dynamics(
                state.positions[part], state.velocities[part], state.accelerations[part], gravity=segment.gravity
            )
        out[:, :, rank:-1] = effects
        out[:, :, -1] = segment.measured(first, last)
        return out

    def predicted(self, segment: Segment, first: int, last: int, solution: np.ndarray) -> np.ndarray:
        """What parameters say of the samples: readings less what is known of them (N, channels).

        Without regressors, by inverse dynamics: base parameters are readings of links that have them in the kept columns and
        nothing elsewhere.
        """
        if self.point is not None:
            rows = self.about_point(segment, first, last)
            # By way of the residual: rows about a point have a shifted target.
            return segment.measured(first, last) + rows[:, :, :-1] @ solution - rows[:, :, -1]
        state, rank = self.state(segment, first, last), self.base.rank
        links = np.zeros(len(self.base.parameter_names))
        links[self.base.independent] = solution[:rank]
        rigid = self.kernel.readings(
            state.positions, state.velocities, state.accelerations, links, gravity=segment.gravity
        )
        effects = self.effect_columns(segment, state)
        return rigid + np.tensordot(effects, solution[rank:], 1)

    def modelled(self, segment: Segment, first: int, last: int, solution: np.ndarray) -> np.ndarray:
        """What the model makes of the samples' motion (N, channels), with these parameters or those of its point."""
        if self.point is None:
            return self.predicted(segment, first, last, solution)
        scene, a, _ = self._scene(segment, first, last)
        terms = self.point.terms(self.effects)
        read = readings(self.robot, self.channels, scene, self.point.links, terms, gravity=segment.gravity)
        return read[first - a : last - a]


def make_blocks(row_model: RowModel, segments: Sequence[Segment], samples: Samples | None = None) -> Iterator[Block]:
    """Turn segments into blocks of rows, one after the other.

    Parameters
    ----------
    row_model, segments
        How samples become rows, and the samples.
    samples
        What to put on the rows of samples first ... last - 1 instead of regressor and readings (N, channels, any).
    """
    for segment in segments:
        if segment.poses:
            for a in range(0, len(segment.times), _CHUNK):
                b = min(a + _CHUNK, len(segment.times))
                yield Block((samples or row_model.samples)(segment, a, b), segment.times[a:b], segment.motion, a == 0, "poses")
            continue
        times = segment.times
        a, b = segment.inner(row_model.margin)
        if b - a < 2:
            raise InputError(
                f"a segment of {times[-1] - times[0]:.3g} s from t = {times[0]:.6g} is too short for "
                f"{row_model.bandwidth:.3g} Hz; leave it out or record longer without gaps"
            )
        if samples is None and row_model.point is not None:
            samples = row_model.about_point
        parts = (_filtered if row_model.filters else _direct)(row_model, segment, a, b, samples)
        yield from _merge(row_model, segment, a, b, parts)


#: A chunk's share of the rows: index of its first row, rows so far, their kernels' energies.
_Part = tuple[int, np.ndarray, np.ndarray]


def _empty(row_model: RowModel, start: float, times: np.ndarray, columns: int) -> _Part:
    """Rows, still zero, that samples at these times contribute to."""
    first = max(int(np.floor((times[0] - start) / row_model.step)) - HALF_WIDTH, 0)
    count = int(np.ceil((times[-1] - start) / row_model.step)) + HALF_WIDTH + 1 - first
    return first, np.zeros((count, len(row_model.channels), columns)), np.zeros(count)


def _direct(row_model: RowModel, segment: Segment, a: int, b: int, samples: Samples | None) -> Iterator[_Part]:
    """Parts from smoothed accelerations; chunks are independent, so all cores work."""
    start = segment.times[a] + 0.5 * row_model.step

    def work(first: int) -> _Part:
        last = min(first + _CHUNK, b)
        times = segment.times[first:last]
        if samples is not None:
            wide = samples(segment, first, last)
            begin, rows, energy = _empty(row_model, start, times, wide.shape[2])
            project(times, wide, start, row_model.step, begin, rows, energy)
            return begin, rows, energy
        state, rank = row_model.state(segment, first, last), row_model.base.rank
        effects, measured = row_model.effect_columns(segment, state), segment.measured(first, last)
        begin, rows, energy = _empty(row_model, start, times, rank + effects.shape[2] + 1)
        buffer = np.empty((_PANEL, *rows.shape[1:]))
        for k in range(0, last - first, _PANEL):
            part = slice(k, min(k + _PANEL, last - first))
            panel = row_model.kernel.dynamics(
                state.positions[part], state.velocities[part], state.accelerations[part],
                gravity=segment.gravity, out=buffer[: part.stop - k],
            )  # fmt: skip
            panel[:, :, rank:-1], panel[:, :, -1] = effects[part], measured[part]
            project(times[part], panel, start, row_model.step, begin, rows, energy)
        return begin, rows, energy

    yield from in_order(work, range(a, b, _CHUNK))


def _filtered(row_model: RowModel, segment: Segment, a: int, b: int, samples: Samples | None) -> Iterator[_Part]:
    """Parts through the paper's filters, acceleration-free: d/dt of the momentum is left to the filter."""
    assert row_model.filters is not None
    start = segment.times[a] + 0.5 * row_model.step
    rigid_state = other_state = None
    for first in range(a, b, _CHUNK):
        last = min(first + _CHUNK, b)
        if samples is not None:
            # The momentum has no simple form about a point: accelerations stand in for its rate.
            times, wide = segment.times[first:last], samples(segment, first, last)
            begin, rows, energy = _empty(row_model, start, times, wide.shape[2])
            filtered, other_state = low_pass(row_model.filters, times, -wide.reshape(len(times), -1), None, other_state)
            project(times, filtered.reshape(wide.shape), start, row_model.step, begin, rows, energy)
            yield begin, rows, energy
            continue
        # One sample more on each side, for the correction below; the margin always leaves that.
        state = row_model.state(segment, first - 1, last + 1)
        width = row_model.base.rank + row_model.extra_columns + 1
        begin, rows, energy = _empty(row_model, start, segment.times[first:last], width)
        for k in range(0, last - first, _PANEL):
            size = min(_PANEL, last - first - k)
            wide, part = slice(k, k + size + 2), slice(k + 1, k + size + 1)
            momentum, weight = row_model.kernel.momentum(state.positions[wide], state.velocities[wide], gravity=segment.gravity)
            momentum = _for_trapezoids(state.times[wide], momentum)
            sub = MotionSegment(state.times[part], state.positions[part], state.velocities[part], state.accelerations[part])
            measured = segment.measured(first + k, first + k + size)
            rest = np.concatenate([row_model.effect_columns(segment, sub), measured[:, :, None]], axis=2)
            flat = weight[1:-1].reshape(size, -1)
            rigid, rigid_state = low_pass(row_model.filters, sub.times, flat, momentum.reshape(size, -1), rigid_state)
            other, other_state = low_pass(row_model.filters, sub.times, -rest.reshape(size, -1), None, other_state)
            filtered = np.concatenate([rigid.reshape(momentum.shape), other.reshape(rest.shape)], axis=2)
            project(sub.times, filtered, start, row_model.step, begin, rows, energy)
        yield begin, rows, energy


def _for_trapezoids(times: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Momentum P whose differences are the trapezoidal integrals of its own rate.

    The measured side is integrated by trapezoids, ``P_k - P_{k-1}`` is the exact integral; Euler and
    Maclaurin give the difference, ``h^2 / 12 (P''_k - P''_{k-1})``, to fourth order. Without it a motion of
    1 Hz sampled at 8 ms would be off by 2e-4.
    """
    step = np.diff(times)[:, None, None]
    slope = np.diff(momentum, axis=0) / step
    bend = 2.0 * np.diff(slope, axis=0) / (step[1:] + step[:-1])
    return momentum[1:-1] + np.median(step) ** 2 / 12.0 * bend


def _merge(row_model: RowModel, segment: Segment, a: int, b: int, parts: Iterable[_Part]) -> Iterator[Block]:
    """Add up the rows that neighbouring chunks share, and hand on those that are complete."""
    start = segment.times[a] + 0.5 * row_model.step
    total = max(int((segment.times[b - 1] - segment.times[a]) / row_model.step), 1)
    done, waiting, energy = 0, None, np.zeros(0)
    rows, begun, filled = np.empty(0), 0, 0

    def handed_on(complete: np.ndarray, power: np.ndarray) -> Iterator[Block]:
        """Blocks that are full with these rows; what is left over waits."""
        nonlocal rows, begun, filled
        while len(complete):
            if not filled:
                rows = np.empty((min(_BLOCK_ROWS, total - begun), *complete.shape[1:]))
            taken = min(len(rows) - filled, len(complete))
            root = np.sqrt(np.maximum(power[:taken], 1e-12))
            np.divide(complete[:taken], root[:, None, None], out=rows[filled : filled + taken])
            complete, power, filled = complete[taken:], power[taken:], filled + taken
            if filled == len(rows):
                times = start + row_model.step * np.arange(begun, begun + filled)
                yield Block(rows, times, segment.motion, begun == 0)
                begun, filled = begun + filled, 0

    for first, part, power in parts:
        if waiting is not None:
            shared = done + len(waiting) - first
            part[:shared] += waiting[first - done :]
            power[:shared] += energy[first - done :]
            complete = max(min(first, total) - done, 0)
            yield from handed_on(waiting[:complete], energy[:complete])
        done, waiting, energy = first, part, power
    if waiting is not None and done < total:
        yield from handed_on(waiting[: total - done], energy[: total - done])
    assert begun == total, "the last chunk reaches beyond the last row, so that every block is full"
