"""Velocities by differences of encoder positions instead of a smooth trajectory: what [Liu1998]_ did, for comparison."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from bayesid.effects import MotionSegment
from bayesid.regression.motion_rows import MotionRows
from bayesid.regression.problem import Problem, restrict
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import Segment

#: How velocities may be derived.
VELOCITIES = ("smoothed", "central", "forward")


@dataclass(frozen=True, repr=False)
class DifferencedRows(RowModel):
    """Rows whose velocities, and accelerations where there is no filter, are differences of the encoders' positions.

    Attributes
    ----------
    kind
        ``central``: ``v_k = (q_{k+1} - q_{k-1}) / (t_{k+1} - t_{k-1})``; ``forward``:
        ``v_k = (q_{k+1} - q_k) / (t_{k+1} - t_k)``, which is the velocity half a sample later.
    """

    kind: str = "central"

    def state(self, segment: Segment, first: int, last: int) -> MotionSegment:
        """Trajectory of samples first ... last - 1 by differences."""
        if segment.poses:
            return super().state(segment, first, last)
        a, b = max(first - 3, 0), min(last + 3, len(segment.times))
        times, q = segment.times[a:b], segment.positions[a:b]
        v = _differences(times, q, self.kind)
        acceleration = _differences(times, v, self.kind)
        part = slice(first - a, last - a)
        return MotionSegment(times[part], q[part], v[part], acceleration[part])


def differenced(problem: Problem, kind: str) -> Problem:
    """The same problem with velocities by differences."""
    own = {f.name: getattr(problem.row_model, f.name) for f in fields(RowModel)}
    row_model = DifferencedRows(**own, kind=kind)
    return restrict(replace(problem, row_model=row_model, rows=MotionRows(row_model, problem.segments)), problem.fitted)


def _differences(times: np.ndarray, values: np.ndarray, kind: str) -> np.ndarray:
    """Rates of values (N, n), those at the ends one-sided."""
    step = np.diff(times)[:, None]
    slope = np.diff(values, axis=0) / step
    if kind == "forward":
        return np.concatenate([slope, slope[-1:]])
    inner = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
    return np.concatenate([slope[:1], inner, slope[-1:]])
