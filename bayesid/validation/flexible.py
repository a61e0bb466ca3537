"""How much of the error on a motion that was not fitted a flexible model could still predict.

What a model lacks and what cannot be predicted look alike in an error. So what the fitted motions left over is regressed on
smooth functions of the joints' positions, speeds, directions and accelerations, in six ways: of all joints or of a torque's
own, with the rigid body's parameters as they are, fitted again freely beside them, or penalised alike. What the best takes
from the error of another motion is a lower bound of what is predictable and not in the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct

from bayesid.recordings.table import usual_step
from bayesid.regression.blocks import Block
from bayesid.regression.motion_rows import row_count
from bayesid.regression.problem import Problem
from bayesid.regression.row_cache import CACHE_BYTES, PILOT_ROWS, PILOT_SEGMENTS, few_of
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import Segment
from bayesid.signals.smoothing import smooth
from bayesid.validation.flexible_fit import Correction, Functions, State, corrections, grams, sums

#: Band in which predictions are compared, the same whatever filter or method was used [Hz].
BAND = 10.0
#: Stretches that errors are counted by.
_STRETCHES = 8
#: Fewer rows, eight in a stretch, show nothing.
_FEWEST = 64
#: A gain counts from so many standard errors: Student's t with seven degrees of freedom at 97.5 %, for the best of six ways.
_CERTAIN = 3.636


@dataclass(frozen=True)
class FlexibleGap:
    """What a flexible model does to the error on a motion that was not fitted.

    Attributes
    ----------
    before, after
        Root mean square of the residual rows of all channels below 10 Hz, by the estimate and with the flexible model on top.
    removed
        Share of the error that the flexible model removes; negative where it adds some.
    std
        Its standard error, from the scatter between stretches of the motion.
    """

    before: float
    after: float
    removed: float
    std: float

    @property
    def certain(self) -> bool:
        """Whether the gain is beyond chance."""
        return self.removed > _CERTAIN * self.std

    def to_dict(self) -> dict:
        """``flexible_model`` of a motion in ``estimate.json``."""
        return {"removed": self.removed, "std": self.std, "beyond_chance": self.certain}


@dataclass(frozen=True)
class _Rows:
    """Rows of one motion, or of those fitted, in signal units.

    Attributes
    ----------
    target, columns
        Readings (k, c), and rigid and effect columns (k, c, p).
    state
        Of the joints.
    inside
        Which rows are in each stretch (k,).
    step
        Distance of rows [s].
    """

    target: np.ndarray
    columns: np.ndarray
    state: State
    inside: list[np.ndarray]
    step: float

    def residual(self, solution: np.ndarray) -> np.ndarray:
        """What parameters (p,) leave (k, c)."""
        return self.target - self.columns @ solution


@dataclass(frozen=True)
class FlexibleModel:
    """All of a flexible model but what depends on an estimate: the fitted motions' rows, functions of their states, and products.

    Attributes
    ----------
    functions
        Of the range of the fitted motions.
    fitted, values
        Rows of the fitted motions, and the functions' values there (k, f).
    grams
        Gram matrices (s, f + p, f + p) of each channel, by stretch.
    joints
        Whose torques the channels read, None for a sensor's.
    """

    functions: Functions
    fitted: _Rows
    values: np.ndarray
    grams: list[np.ndarray]
    joints: list[int | None]

    @classmethod
    def of(cls, problem: Problem, motions: Sequence[str]) -> FlexibleModel | None:
        """For motions that were not fitted; None where none of these moves, or too few rows were fitted.

        Parameters
        ----------
        problem
            The fitted motions and the model.
        motions
            Names of motions that were not fitted.
        """
        fitted = _rows(problem, problem.fitted) if _moving(problem, motions) else None
        if fitted is None:
            return None
        functions, channels = Functions.of(fitted.state), problem.row_model.channels
        values = functions(fitted.state)
        joints = [int(j) if name.startswith("tau") else None for name, j in zip(channels.names, channels.joint, strict=True)]
        return cls(functions, fitted, values, grams(values, fitted.columns, fitted.inside), joints)

    def ways(self, solution: np.ndarray) -> list[list[Correction]]:
        """A correction of each channel by each of the ways there are, for parameters, base then effects (p,)."""
        fitted = self.fitted
        found = sums(self.grams, self.values, fitted.columns, fitted.residual(solution), fitted.inside)
        return corrections(self.functions, found, self.joints)


def flexible_gaps(
    problem: Problem, solution: np.ndarray, motions: Sequence[str], model: FlexibleModel | None = None
) -> dict[str, FlexibleGap]:
    """Gap of each motion that was not fitted; without those that are too short, or no motions at all.

    Parameters
    ----------
    problem, solution
        The model and its parameters, base then effects (p,).
    motions
        Names of motions that were not fitted.
    model
        Of the fitted motions, if it is made already.
    """
    model = model or FlexibleModel.of(problem, motions)
    if model is None:
        return {}
    ways, out = model.ways(solution), {}
    for name in _moving(problem, motions):
        rows = _rows(problem, [name])
        if rows is not None:
            residual, values = rows.residual(solution), model.functions(rows.state)
            before = _band_powers(residual, rows)
            if before.sum() > 0.0:
                out[name] = max((_gap(rows, residual, before, values, way) for way in ways), key=lambda g: g.removed)
    return out


def _moving(problem: Problem, motions: Sequence[str]) -> list[str]:
    """Names of those that are not poses alone."""
    return [name for name in motions if any(not s.poses for s in problem.segments[name])]


def _rows(problem: Problem, motions: Sequence[str]) -> _Rows | None:
    """Rows of motions, evenly thinned where there are many; None where they are too few."""
    parts: list[tuple[np.ndarray, ...]] = []
    for block in _blocks(problem, motions):
        segment = next(
            s for name in motions for s in problem.segments[name]
            if s.motion == block.motion and s.times[0] <= block.times[0] <= s.times[-1]
        )  # fmt: skip
        bandwidth = problem.row_model.bandwidth
        reach = 5.0 / bandwidth
        a, b = np.searchsorted(segment.times, [block.times[0] - reach, block.times[-1] + reach])
        state = smooth(segment.times[a:b], segment.positions[a:b], bandwidth, at=block.times)
        # A row is as large as the samples in it are many.
        size = np.sqrt(max(problem.row_model.step / usual_step(segment.times), 1.0))
        parts.append((np.full(len(block.rows), size), block.target, block.matrix, *state))
    if not parts:
        return None
    size, target, columns, q, v, a = (np.concatenate(part) for part in zip(*parts, strict=True))
    if len(target) < _FEWEST:
        return None
    target /= size[:, None]
    columns /= size[:, None, None]
    stretch = np.arange(len(target)) * _STRETCHES // len(target)
    return _Rows(target, columns, (q, v, a), [stretch == k for k in range(_STRETCHES)], problem.row_model.step)


def _blocks(problem: Problem, motions: Sequence[str]) -> Iterable[Block]:
    """Blocks of moving rows without the paper's filters: a pilot of the fitted motions, pieces of other long ones."""
    row_model, segments = problem.row_model, [s for name in motions for s in problem.segments[name] if not s.poses]
    count, width = row_count(row_model, segments), len(row_model.channels) * (row_model.base.rank + row_model.extra_columns + 1)
    if row_model.filters is not None or 8 * count * width > CACHE_BYTES:
        return make_blocks(replace(row_model, filters=None), list(_pieces(row_model, segments)))
    if tuple(motions) == problem.fitted:
        blocks = problem.regression.pilot()
    else:
        blocks = problem.rows.blocks(motions)
    moving = (b for b in blocks if b.group != "poses")
    return moving if tuple(motions) == problem.fitted else few_of(moving, count)


def _pieces(row_model: RowModel, segments: Sequence[Segment]) -> Iterator[Segment]:
    """Evenly spread pieces of segments, that make about `PILOT_ROWS` rows together."""
    whole = sum(float(np.ptp(s.times)) for s in segments)
    for s in segments:
        duration = float(np.ptp(s.times))
        count = max(round(PILOT_SEGMENTS * duration / whole), 1)
        ends = row_model.margin + max(row_model.margin, s.settling)
        length = min(PILOT_ROWS / PILOT_SEGMENTS * row_model.step + ends, duration)
        for start in s.times[0] + (duration - length) * np.linspace(0.0, 1.0, count):
            a, b = np.searchsorted(s.times, [start, start + length + 1e-9])
            piece = s.part(int(a), int(b))
            if np.ptp(piece.inner(row_model.margin)) > 1:
                yield piece


def _gap(
    rows: _Rows, residual: np.ndarray, power: np.ndarray, functions: np.ndarray, way: Sequence[Correction]
) -> FlexibleGap:  # fmt: skip
    """Gap by one way, from the residual and its power by stretch; the gain's standard error from the scatter of the stretches."""
    left = residual.copy()
    for c, correction in enumerate(way):
        if correction is not None:
            columns, found = correction
            own = columns < functions.shape[1]
            left[:, c] -= functions[:, columns[own]] @ found[own]
            left[:, c] -= rows.columns[:, c, columns[~own] - functions.shape[1]] @ found[~own]
    reduced = _band_powers(left, rows)
    before, after = power.sum(), reduced.sum()
    ratio = after / before
    # Of a ratio of sums, by its linearisation: d ratio = (d after - ratio d before) / before.
    spread = np.std(reduced - ratio * power, ddof=1) * np.sqrt(_STRETCHES) / before
    removed, rows_count = 1.0 - np.sqrt(ratio), len(residual)
    std = spread / max(2.0 * np.sqrt(ratio), 1e-9)
    rms = np.sqrt(np.array([before, after]) / rows_count)
    return FlexibleGap(float(rms[0]), float(rms[1]), float(removed), float(std))


def _band_powers(values: np.ndarray, rows: _Rows) -> np.ndarray:
    """Energy of rows (k, c) below `BAND` by stretch, all channels together."""
    out = []
    for own in rows.inside:
        z = np.asarray(dct(values[own], axis=0, norm="ortho"))
        out.append(float(np.sum(z[: max(int(min(2.0 * rows.step * BAND, 1.0) * len(z)), 1)] ** 2)))
    return np.array(out)
