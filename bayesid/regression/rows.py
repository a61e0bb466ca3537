"""How samples become rows: recordings + robot + effects + filters -> blocks of rows in the motion's band.

Samples are handled in chunks that fit the processor's cache and on all cores; what comes out is a thin stream of
rows. Two ways lead there: with the accelerations of the smoothed trajectory, or without any through the
paper's filters. Where samples are many, regressors of a smoothed trajectory are computed on a coarser grid of times and
interpolated, if a check between those times shows that to be accurate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.effects import MotionSegment
from bayesid.regression.blocks import Block
from bayesid.regression.parallel import in_order
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import LongSegment, Segment
from bayesid.signals.filters import FilterState, low_pass
from bayesid.signals.projection import HALF_WIDTH, GridProjection, project

_CHUNK = 4096  # samples handled at once
_PANEL = 512  # samples whose rows stay in the processor's cache
_BLOCK_ROWS = 4096  # rows handed on at once
#: Of a recording that is read in chunks: samples whose rows are made by one task, at least, and chunks in memory at a time.
_TASK_SAMPLES, _WINDOW = 1 << 18, 16
#: Time in units of the slower filter's own after which nothing is left of its state: exp(-36) = 2e-16.
_FADED = 36.0
#: Times in 1 / bandwidth that regressors are computed at and interpolated from; the first that is accurate is taken.
_GRIDS = (16.0, 32.0)
#: A grid is less work than regressors of all samples where there are so many times more of these.
_WORTH_A_GRID = 1.5
#: Interpolated regressors may be off by this share of a column's size in a channel, root mean square halfway between the times of
#: so many pairs, half of them the fastest: by a hundredth of the noise, where readings are 2,500 times as large as that.
_ACCURACY, _CHECKED = 4e-6, 32
#: Of columns that are next to nothing in a channel, by this share of the largest there: they count no less than that.
_LITTLE = 1e-3

#: From a segment and its samples first ... last - 1: what is put on their rows (N, channels, any).
Samples = Callable[[Segment, int, int], np.ndarray]


def make_blocks(
    row_model: RowModel, segments: Sequence[Segment | LongSegment], samples: Samples | None = None, *, kept: bool = False
) -> Iterator[Block]:
    """Turn segments into blocks of rows, one after the other.

    ``samples`` gives what to put on the rows of samples first ... last - 1 instead of regressor and readings (N, channels,
    any). Where all blocks will be ``kept``, those of a segment lie side by side, and memory is given out in large pages.
    """
    if samples is None and row_model.point is not None:
        samples = row_model.about_point
    for segment in segments:
        if isinstance(segment, LongSegment):
            for chunk in row_chunks(row_model, segment):
                yield from chunk.blocks(samples)
            continue
        if segment.poses:
            for a in range(0, len(segment.times), _CHUNK):
                b = min(a + _CHUNK, len(segment.times))
                yield Block((samples or row_model.samples)(segment, a, b), segment.times[a:b], segment.motion, a == 0, "poses")
            continue
        a, b = segment.inner(row_model.margin)
        if b - a < 2:  # between gaps, too short for the smoothed trajectory to settle: it says nothing
            continue
        start = segment.times[a] + 0.5 * row_model.step
        total = _count(row_model, float(segment.times[a]), float(segment.times[b - 1]))
        if row_model.filters:
            parts = _filtered(row_model, segment, range(a, b), samples, start, _Memory())
        else:
            parts = _direct(row_model, segment, range(a, b), samples, start)
        yield from _merge(row_model, parts, start, range(total), segment.motion, kept)


def _count(row_model: RowModel, begin: float, end: float) -> int:
    """How many rows samples from one time [s] to another make."""
    return max(int((end - begin) / row_model.step), 1)


@dataclass(frozen=True)
class RowChunk:
    """Some rows of a recording that is read in chunks: the same as if all of it were in memory."""

    #: How samples become rows, and where they are.
    row_model: RowModel
    segment: LongSegment
    start: float  # time of the segment's first row [s]
    rows: range  # which of its rows
    samples: range  # the samples that all of its rows are made of
    spacing: float | None  # distance of times that regressors are interpolated from [s]; None: they are computed at all samples

    def blocks(self, samples: Samples | None = None) -> Iterator[Block]:
        """Blocks of regressor and measurements, or of what else is to be put on the rows."""
        model, segment, every = self.row_model, self.segment, self.samples
        if samples is None and model.point is not None:
            samples = model.about_point
        begin = self.start + (self.rows.start - HALF_WIDTH - 1) * model.step
        end = self.start + (self.rows.stop + HALF_WIDTH + 1) * model.step
        if model.filters is not None:  # what they remember has faded by then
            begin -= _FADED / min(model.filters.l, model.filters.d)
        # Whole runs of samples from the segment's first one, as in memory.
        first = max(segment.index(begin) - every.start, 0) // _CHUNK
        last = -(-(segment.index(end, "right") - every.start) // _CHUNK)
        run = range(every.start + first * _CHUNK, min(every.start + last * _CHUNK, every.stop))
        yield from _merge(model, self._parts(run, samples), self.start, self.rows, segment.motion, False)

    def _parts(self, run: range, samples: Samples | None) -> Iterator[_Part]:
        """Parts of a run of samples, of which a few are in memory at a time."""
        model, memory = self.row_model, _Memory()
        for first in range(run.start, run.stop, _WINDOW * _CHUNK):
            last = min(first + _WINDOW * _CHUNK, run.stop)
            window, at = _window(model, self.segment, first, last)
            here = range(first - at, last - at)
            if model.filters is not None:
                yield from _filtered(model, window, here, samples, self.start, memory)
            else:
                yield from _of_chunks(model, window, here, samples, self.start, self.spacing)


def row_chunks(row_model: RowModel, segment: LongSegment) -> list[RowChunk]:
    """The rows of a recording that is read in chunks: how they are divided depends on the recording alone."""
    a, b = segment.inner(row_model.margin)
    if b - a < 2:
        return []
    begin, end = segment.time(a), segment.time(b - 1)
    start, total = begin + 0.5 * row_model.step, _count(row_model, begin, end)
    usual, spacing = (end - begin) / (b - 1 - a), None
    if row_model.point is None and row_model.filters is None:
        last = min(a + _CHUNK, b)
        window, at = _window(row_model, segment, a, last)
        spacing, _ = _accurate_grid(row_model, window, range(a - at, last - at), start, usual)
    size = _BLOCK_ROWS * max(math.ceil(_TASK_SAMPLES * usual / (_BLOCK_ROWS * row_model.step)), 1)
    return [
        RowChunk(row_model, segment, start, range(first, min(first + size, total)), range(a, b), spacing)
        for first in range(0, total, size)
    ]


def _window(row_model: RowModel, segment: LongSegment, first: int, last: int) -> tuple[Segment, int]:
    """Samples first ... last - 1 with all that their rows depend on, and the first sample of that."""
    reach = row_model.reach(segment.step)
    a = max(segment.index(segment.time(first) - reach) - 2, 0)
    b = min(segment.index(segment.time(last - 1) + reach, "right") + 2, segment.count)
    return segment.part(a, b), a


#: A chunk's share of the rows: index of its first row, rows so far, their kernels' energies.
_Part = tuple[int, np.ndarray, np.ndarray]


def _empty(row_model: RowModel, start: float, times: np.ndarray, columns: int) -> _Part:
    """Rows, still zero, that samples at these times contribute to."""
    first = max(int(np.floor((times[0] - start) / row_model.step)) - HALF_WIDTH, 0)
    count = int(np.ceil((times[-1] - start) / row_model.step)) + HALF_WIDTH + 1 - first
    return first, np.zeros((count, len(row_model.channels), columns)), np.zeros(count)


def _direct(row_model: RowModel, segment: Segment, run: range, samples: Samples | None, start: float) -> Iterator[_Part]:
    """Parts from smoothed accelerations; chunks are independent, so all cores work."""
    spacing = None
    if samples is None:
        times, first = segment.times, range(run.start, min(run.start + _CHUNK, run.stop))
        usual = (times[run.stop - 1] - times[run.start]) / (len(run) - 1)
        spacing, part = _accurate_grid(row_model, segment, first, start, usual)
        if part is not None:
            yield part
            run = range(first.stop, run.stop)
    yield from _of_chunks(row_model, segment, run, samples, start, spacing)


def _of_chunks(
    row_model: RowModel, segment: Segment, run: range, samples: Samples | None, start: float, spacing: float | None
) -> Iterator[_Part]:
    """Parts of a run of samples, each from a grid of this spacing where that is accurate."""

    def of_samples(first: int) -> _Part:
        last = min(first + _CHUNK, run.stop)
        part = None if spacing is None else _from_grid(row_model, segment, first, last, start, spacing)
        if part is not None:
            return part
        if samples is None:
            return _from_samples(row_model, segment, first, last, start)
        times, wide = segment.times[first:last], samples(segment, first, last)
        begin, rows, energy = _empty(row_model, start, times, wide.shape[2])
        project(times, wide, start, row_model.step, begin, rows, energy)
        return begin, rows, energy

    yield from in_order(of_samples, range(run.start, run.stop, _CHUNK))


def _accurate_grid(
    row_model: RowModel, segment: Segment, first: range, start: float, usual: float
) -> tuple[float | None, _Part | None]:
    """Distance of times [s] that regressors may be interpolated from, with much less work, and the first chunk's part.

    What is accurate in the first chunk is so in others, most likely. None where none is.
    """
    if not row_model.may_interpolate or segment.rates is not None:
        return None, None
    for spacing in (1.0 / (each * row_model.bandwidth) for each in _GRIDS):
        if spacing >= _WORTH_A_GRID * usual:
            part = _from_grid(row_model, segment, first.start, first.stop, start, spacing)
            if part is not None:
                return spacing, part
    return None, None


def _from_samples(row_model: RowModel, segment: Segment, first: int, last: int, start: float) -> _Part:
    """A chunk's part with the regressors of all samples."""
    times, rank = segment.times[first:last], row_model.base.rank
    state = row_model.state(segment, first, last)
    effects, measured = row_model.effect_columns(segment, state), segment.measured(first, last)
    begin, rows, energy = _empty(row_model, start, times, rank + effects.shape[2] + 1)
    buffer = np.empty((_PANEL, rows.shape[1], rows.shape[2]))
    for k in range(0, last - first, _PANEL):
        part = slice(k, min(k + _PANEL, last - first))
        panel = _panel(row_model, segment, state, part, buffer)
        panel[:, :, rank:-1], panel[:, :, -1] = effects[part], measured[part]
        project(times[part], panel, start, row_model.step, begin, rows, energy)
    return begin, rows, energy


def _from_grid(row_model: RowModel, segment: Segment, first: int, last: int, start: float, spacing: float) -> _Part | None:
    """A chunk's part with regressors computed at fewer times than there are samples, and interpolated; None: not accurate enough.

    Readings, and effects that are not interpolated with the regressor, such as friction, are taken at all samples.
    """
    times, rank = segment.times[first:last], row_model.base.rank
    cells = int((times[-1] - times[0]) / spacing) + 1
    grid = times[0] + spacing * np.arange(-GridProjection.BEFORE, cells + GridProjection.AFTER)
    checked = _cells_to_check(segment.positions[first + np.searchsorted(times[:-1], times[0] + spacing * np.arange(cells + 1))])
    middles = times[0] + spacing * (checked + 0.5)
    state = row_model.smoothed(segment, np.concatenate([grid, middles]))
    effects = row_model.effect_columns(segment, state, True)
    width, interpolated = rank + len(row_model.interpolated) + 1, rank + np.flatnonzero(row_model.interpolated)
    begin, rows, energy = _empty(row_model, start, times, width)
    weights = GridProjection.of(times, grid[0], spacing, start, row_model.step, begin, len(rows))
    halfway, guessed = GridProjection.of_middles(checked), np.zeros((len(checked), rows.shape[1], width))
    buffer = np.zeros((_PANEL, rows.shape[1], width))
    for k in range(0, len(grid), _PANEL):
        part = slice(k, min(k + _PANEL, len(grid)))
        panel = _panel(row_model, segment, state, part, buffer)
        panel[:, :, interpolated] = effects[part]
        weights.add(panel, k, rows)
        halfway.add(panel, k, guessed)
    exact = _panel(row_model, segment, state, slice(len(grid), len(state.times)), buffer)
    exact[:, :, interpolated] = effects[len(grid) :]
    if not _accurate(guessed, exact):
        return None
    sampled = segment.measured(first, last)[:, :, None]
    if not row_model.interpolated.all():
        friction = row_model.effect_columns(segment, row_model.state(segment, first, last), False)
        sampled = np.concatenate([friction, sampled], axis=2)
    others = np.zeros((len(rows), rows.shape[1], sampled.shape[2]))
    project(times, sampled, start, row_model.step, begin, others, energy)
    rows[:, :, np.append(rank + np.flatnonzero(~row_model.interpolated), width - 1)] += others
    return begin, rows, energy


def _cells_to_check(positions: np.ndarray) -> np.ndarray:
    """Some evenly spread cells between joint positions (k + 1, n), and those in which the joints move most."""
    cells, half = len(positions) - 1, _CHECKED // 2
    fastest = np.argsort(np.abs(np.diff(positions, axis=0)).sum(axis=1))[-half:]
    return np.unique(np.append(np.linspace(0, cells - 1, half).astype(int), fastest))


def _panel(row_model: RowModel, segment: Segment, state: MotionSegment, part: slice, buffer: np.ndarray) -> np.ndarray:
    """Regressors of some of a state's times in the first columns of a buffer (at least as many, channels, any)."""
    q, v, a = state.positions[part], state.velocities[part], state.accelerations[part]
    return row_model.kernel.dynamics(q, v, a, gravity=segment.gravity, out=buffer[: part.stop - part.start])


def _accurate(guessed: np.ndarray, exact: np.ndarray) -> bool:
    """Whether interpolated regressors (k, channels, p) are those computed."""
    off, size = (np.sqrt(np.mean(x**2, axis=0)) for x in (guessed - exact, exact))
    return bool(np.all(off <= _ACCURACY * np.maximum(size, _LITTLE * size.max(axis=1, keepdims=True))))


@dataclass
class _Memory:
    """What the filters remember of the samples before: of the rigid bodies, and of all else."""

    rigid: FilterState | None = None
    other: FilterState | None = None


def _filtered(
    row_model: RowModel, segment: Segment, run: range, samples: Samples | None, start: float, memory: _Memory
) -> Iterator[_Part]:
    """Parts through the paper's filters, acceleration-free: d/dt of the momentum is left to the filter."""
    assert row_model.filters is not None
    for first in range(run.start, run.stop, _CHUNK):
        last = min(first + _CHUNK, run.stop)
        if samples is not None:
            # The momentum has no simple form about a point: accelerations stand in for its rate.
            times, wide = segment.times[first:last], samples(segment, first, last)
            begin, rows, energy = _empty(row_model, start, times, wide.shape[2])
            filtered, memory.other = low_pass(row_model.filters, times, -wide.reshape(len(times), -1), None, memory.other)
            project(times, filtered.reshape(wide.shape), start, row_model.step, begin, rows, energy)
            yield begin, rows, energy
            continue
        # One sample more on each side, for the correction below; the margin always leaves that.
        state = row_model.state(segment, first - 1, last + 1)
        begin, rows, energy = _empty(row_model, start, segment.times[first:last], row_model.width)
        for k in range(0, last - first, _PANEL):
            size = min(_PANEL, last - first - k)
            wide, part = slice(k, k + size + 2), slice(k + 1, k + size + 1)
            momentum, weight = row_model.kernel.momentum(state.positions[wide], state.velocities[wide], gravity=segment.gravity)
            momentum = _for_trapezoids(state.times[wide], momentum)
            sub = MotionSegment(state.times[part], state.positions[part], state.velocities[part], state.accelerations[part])
            measured = segment.measured(first + k, first + k + size)
            rest = np.concatenate([row_model.effect_columns(segment, sub), measured[:, :, None]], axis=2)
            flat = weight[1:-1].reshape(size, -1)
            rigid, memory.rigid = low_pass(row_model.filters, sub.times, flat, momentum.reshape(size, -1), memory.rigid)
            other, memory.other = low_pass(row_model.filters, sub.times, -rest.reshape(size, -1), None, memory.other)
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


def _merge(row_model: RowModel, parts: Iterable[_Part], start: float, wanted: range, motion: int, kept: bool) -> Iterator[Block]:
    """Add up the rows that neighbouring chunks share, and hand on those that are complete and wanted."""
    done, waiting, energy, total = 0, None, np.zeros(0), wanted.stop
    rows, begun, filled = np.empty(0), wanted.start, 0
    room = np.empty(0)

    def handed_on(complete: np.ndarray, power: np.ndarray) -> Iterator[Block]:
        """Blocks that are full with these rows; what is left over waits."""
        nonlocal rows, room, begun, filled
        while len(complete):
            if not filled:
                count = min(_BLOCK_ROWS, total - begun)
                if not len(room):
                    room = np.empty((len(wanted) if kept else count, *complete.shape[1:]))
                rows, room = room[:count], room[count:]
            taken = min(len(rows) - filled, len(complete))
            root = np.sqrt(np.maximum(power[:taken], 1e-12))
            np.divide(complete[:taken], root[:, None, None], out=rows[filled : filled + taken])
            complete, power, filled = complete[taken:], power[taken:], filled + taken
            if filled == len(rows):
                times = start + row_model.step * np.arange(begun, begun + filled)
                yield Block(rows, times, motion, begun == 0)
                begun, filled = begun + filled, 0

    for first, part, power in parts:
        if waiting is not None:
            shared = done + len(waiting) - first
            part[:shared] += waiting[first - done :]
            power[:shared] += energy[first - done :]
            whole = slice(max(wanted.start - done, 0), max(min(first, total) - done, 0))
            yield from handed_on(waiting[whole], energy[whole])
        done, waiting, energy = first, part, power
    if waiting is not None and done < total:
        whole = slice(max(wanted.start - done, 0), total - done)
        yield from handed_on(waiting[whole], energy[whole])
    assert begun == total, "the last chunk reaches beyond the last row, so that every block is full"
