"""How samples become rows: robot, effects, bandwidth and filters, and the unfiltered regressor of any of the samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import TypeVar

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.dynamics.channels import Channels
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import Effect, MotionSegment, Point, Term, linearised, reach_of, readings, with_places
from bayesid.regression.segment import Segment
from bayesid.robot.robot import Robot
from bayesid.signals.filters import LowPass
from bayesid.signals.smoothing import OVERLAP, smooth

_A = TypeVar("_A")

_PANEL = 512  # samples whose rows stay in the processor's cache


@dataclass(frozen=True, repr=False)
class RowModel:
    """How samples become rows: everything but the samples."""

    #: The model.
    robot: Robot
    channels: Channels
    base: BaseParameters
    effects: tuple[Effect, ...]
    bandwidth: float  # of the joint motion [Hz]
    step: float  # distance of rows [s]
    filters: LowPass | None = None  # the paper's low-passes, or None for rows straight from the smoothed trajectory
    point: Point | None = None  # where the readings are linearised, where effects are not plain columns beside the rigid ones
    clear: float | None = None  # as in `bayesid.effects.MotionSegment` [Hz]

    @property
    def rings(self) -> bool:
        """Whether an effect rings for a while with all that strikes it, the encoders' errors among that."""
        return any(effect.settling > 0.0 for effect in self.effects)

    @property
    def margin(self) -> float:
        """Time at both ends of a segment where the smoothed trajectory is loose [s]."""
        return 0.75 / self.bandwidth

    def reach(self, step: float) -> float:
        """Time before and after samples that are a time ``step`` apart [s] that their rows depend on [s]."""
        beyond = 0.0 if self.point is None else self.point.reach(self.effects, self.bandwidth, step)
        return beyond + 2.0 * step + (OVERLAP + 2) * 0.5 / self.bandwidth

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

    @property
    def width(self) -> int:
        """Numbers in a channel's row: base and effect parameters, and the reading."""
        return self.base.rank + self.extra_columns + 1

    def of_free(self, values: Iterable[_A]) -> tuple[_A, ...]:
        """Values of the parameters that are estimated, among those with one entry for each parameter of the effects."""
        return tuple(compress(values, self.free))

    def every_value(self, estimated: np.ndarray) -> np.ndarray:
        """Values of all parameters of the effects (p,), from those that are estimated (e,); others as they are held."""
        values = np.zeros(len(self.free)) if self.point is None else self.point.values.copy()
        values[self.free] = estimated
        return values

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Names of the effect parameters that are estimated."""
        return self.of_free(n for e in self.effects for n in e.column_names)

    @property
    def effect_units(self) -> tuple[str, ...]:
        """Units of the effects' columns."""
        return self.of_free(u for e in self.effects for u in e.units)

    def state(self, segment: Segment, first: int, last: int) -> MotionSegment:
        """Smoothed trajectory of samples first ... last - 1, from them and enough neighbours."""
        times = segment.times[first:last]
        if segment.poses:
            still = np.zeros_like(segment.positions[first:last])
            return MotionSegment(times, segment.positions[first:last], still, still, still=True, in_turn=segment.in_turn)
        if segment.rates is not None:
            return MotionSegment(times, segment.positions[first:last], *segment.rates[:, first:last])
        return replace(self.smoothed(segment, times), encoders=(times, segment.positions[first:last]))

    def smoothed(self, segment: Segment, at: np.ndarray) -> MotionSegment:
        """Smoothed trajectory at times (N,) [s], from samples there and enough neighbours."""
        reach = OVERLAP * 0.5 / self.bandwidth
        part = slice(segment.index(at.min() - reach), segment.index(at.max() + reach, "right"))
        return MotionSegment(at, *smooth(segment.times[part], segment.positions[part], self.bandwidth, at=at))

    @cached_property
    def interpolated(self) -> np.ndarray:
        """Whose columns are interpolated in time with the regressor (p,), where the readings are linear in all effects."""
        return np.repeat([_interpolated(e) for e in self.effects], [len(e.column_names) for e in self.effects]).astype(bool)

    @property
    def may_interpolate(self) -> bool:
        """Whether rows may be made of regressors on a grid of times.

        Columns that add up to others, as those of a rotor and of a link may, must be made in the same way: otherwise the small
        difference would seem to tell them apart.
        """
        return all(_interpolated(e) or e.column_in_time == "sampled" for e in self.effects)

    def effect_columns(self, segment: Segment, state: MotionSegment, interpolated: bool | None = None) -> np.ndarray:
        """Columns of all effects, or of those only that are `interpolated` or not (N, channels, parameters), to be read only."""
        effects = tuple(e for e in self.effects if interpolated is None or _interpolated(e) == interpolated)
        if effects and all(effect.always_the_same for effect in effects):
            columns = self._constant_columns[segment.offset]
            return np.broadcast_to(columns, (len(state.times), *columns.shape))
        return self._columns(effects, state, segment.offset)

    @cached_property
    def _constant_columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns (channels, parameters) of the effects that are always the same, without a sensor's offset and with it."""
        same = tuple(effect for effect in self.effects if effect.always_the_same)
        still = np.zeros((1, self.robot.n))
        still = MotionSegment(np.zeros(1), still, still, still)
        return self._columns(same, still, False)[0], self._columns(same, still, True)[0]

    def _columns(self, effects: tuple[Effect, ...], state: MotionSegment, offset: bool) -> np.ndarray:
        out = np.zeros((len(state.times), len(self.channels), sum(len(e.column_names) for e in effects)))
        for effect, places in with_places(effects):
            if offset or not effect.removed_by_static_run:
                out[:, :, places] = effect.motion_columns(state, self.channels.names)
        return out

    def around(self, segment: Segment, first: int, last: int, terms: Sequence[Term]) -> tuple[int, int]:
        """First and last sample (exclusive) whose motion effects need to be known for the samples first ... last - 1."""
        if segment.poses:
            return first, last
        times = segment.times
        reach = reach_of(terms, self.bandwidth, float(np.median(np.diff(times[:1000]))))
        return segment.index(times[first] - reach), segment.index(times[last - 1] + reach, "right")

    def _states(self, segment: Segment, first: int, last: int) -> tuple[MotionSegment, int, int]:
        """The samples' motion and what the effects need of that around them: samples a ... b - 1, with a and b."""
        assert self.point is not None
        a, b = self.around(segment, first, last, [*self.point.terms(self.effects), *self.beside])
        states = replace(
            self.state(segment, a, b), still=segment.poses, bandwidth=self.bandwidth, middle=self.point.middle, clear=self.clear
        )
        return states, a, b

    def about_point(self, segment: Segment, first: int, last: int) -> np.ndarray:
        """Unfiltered rows of samples about the point: regressor, effects, shifted target (N, channels, p + 1)."""
        assert self.point is not None
        states, a, b = self._states(segment, first, last)
        read = segment.readings[a:b] if segment.gravity else segment.measured(a, b)
        (effects, point), acts = self._acting(segment)
        rigid, some, target = linearised(
            self.robot, self.channels, states, effects, point, self.base.independent, read, gravity=segment.gravity
        )
        others = np.zeros((*some.shape[:2], int(self.free.sum())))
        others[:, :, acts[self.free]] = some
        parts = [rigid, others, *self._columns_beside(segment, states, point.terms(effects)), target[:, :, None]]
        return np.concatenate([part[first - a : last - a] for part in parts], axis=2)

    @property
    def beside(self) -> tuple[Term, ...]:
        """Effects that are not in the model and have columns all the same: here none."""
        return ()

    def _columns_beside(self, segment: Segment, states: MotionSegment, terms: Sequence[Term]) -> list[np.ndarray]:
        """Columns of those (N, channels, k), by the effects of the model that act in the segment."""
        return []

    def _acting(self, segment: Segment) -> tuple[tuple[tuple[Effect, ...], Point], np.ndarray]:
        """The effects that act in a segment, the point with their values alone, and which of all parameters are theirs."""
        assert self.point is not None
        effects = tuple(e for e in self.effects if segment.events or not e.once)
        acts = np.repeat([e in effects for e in self.effects], [len(e.parameters) for e in self.effects]).astype(bool)
        return (effects, replace(self.point, values=self.point.values[acts], free=self.point.free[acts])), acts

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
        rigid = self.kernel.readings(state.positions, state.velocities, state.accelerations, links, gravity=segment.gravity)
        effects = self.effect_columns(segment, state)
        return rigid + np.tensordot(effects, solution[rank:], 1)

    def modelled(self, segment: Segment, first: int, last: int, solution: np.ndarray) -> np.ndarray:
        """What the model makes of the samples' motion (N, channels), with these parameters or those of its point."""
        if self.point is None:
            return self.predicted(segment, first, last, solution)
        states, a, _ = self._states(segment, first, last)
        (effects, point), _ = self._acting(segment)
        read = readings(self.robot, self.channels, states, point.links, point.terms(effects), gravity=segment.gravity)
        return read[first - a : last - a]


def _interpolated(effect: Effect) -> bool:
    """Whether its column is interpolated with the regressor; what is always the same is the same either way."""
    return effect.always_the_same or effect.column_in_time == "interpolated"
