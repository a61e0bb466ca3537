"""How much of the error on a motion that was not fitted a flexible model could still predict.

What a model lacks and what cannot be predicted look alike in an error. So what the fitted motions left over is regressed on
smooth functions of the joints' positions, speeds, directions and accelerations, in six ways: of all joints or of a torque's
own, with the rigid body's parameters as they are, fitted again freely beside them, or penalised alike. What the best takes
from the error of another motion is a lower bound of what is predictable and not in the model.

Ridge regression [Hoerl1970]_ on columns of unit length; its strength, no correction at all among the choices, is for each channel
the one that predicts stretches of the fitted motions best that were left out. A joint outside the range of the fitted motions
counts as at its end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct
from scipy.linalg import LinAlgError, get_lapack_funcs

from bayesid.recordings.table import usual_step
from bayesid.regression.blocks import Block
from bayesid.regression.linalg import or_one
from bayesid.regression.motion_rows import row_count
from bayesid.regression.problem import Problem
from bayesid.regression.row_cache import CACHE_BYTES, PILOT_ROWS, PILOT_SEGMENTS, few_of
from bayesid.regression.row_model import RowModel
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import Segment
from bayesid.signals.smoothing import smooth

(_solve_positive,) = get_lapack_funcs(("posv",), dtype=np.float64)
#: Band in which predictions are compared, the same whatever filter or method was used [Hz].
BAND = 10.0
#: Stretches that errors are counted by, and folds of those that were fitted.
_STRETCHES, _FOLDS = 8, 4
#: Fewer rows in a stretch, or in all, show nothing.
_SHORTEST, _FEWEST = 8, 64
#: Penalties on columns of unit length.
_STRENGTHS = (3e-4, 3e-3, 3e-2)
#: Penalty of rigid parameters that are fitted again.
_ALMOST_NONE = 1e-9
#: Ways to treat the rigid parameters.
_WAYS = 3
#: A gain counts from so many standard errors: Student's t with seven degrees of freedom at 97.5 %, for the best of six ways.
_CERTAIN = 3.636
#: Speeds, as shares of the largest, at which a joint's direction is half told.
_TURNS = (0.02, 0.1)
#: Functions of one joint.
_PER_JOINT = 13


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
    """Residuals (k, c), rigid and effect columns (k, c, p) and joint states (k, n) of one motion's rows, in signal units."""

    residual: np.ndarray
    columns: np.ndarray
    positions: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    stretch: np.ndarray
    step: float


def flexible_gaps(problem: Problem, solution: np.ndarray, motions: Sequence[str]) -> dict[str, FlexibleGap]:
    """Gap of each motion that was not fitted; without those that are too short, or no motions at all.

    Parameters
    ----------
    problem, solution
        The model and its parameters, base then effects (p,).
    motions
        Names of motions that were not fitted.
    """
    moving = [name for name in motions if any(not s.poses for s in problem.segments[name])]
    fitted = _rows(problem, solution, problem.fitted) if moving else None
    if fitted is None or len(fitted.residual) < _FEWEST:
        return {}
    functions = _Functions.of(fitted)
    channels = problem.row_model.channels
    joints = [int(j) if name.startswith("tau") else None for name, j in zip(channels.names, channels.joint, strict=True)]
    corrections = _corrections(functions, fitted, joints)
    out = {}
    for name in moving:
        rows = _rows(problem, solution, [name])
        if rows is not None and len(rows.residual) >= _FEWEST:
            values = functions(rows)
            gaps = [g for g in (_gap(rows, values, way) for way in corrections) if g is not None]
            if gaps:
                out[name] = max(gaps, key=lambda g: g.removed)
    return out


@dataclass(frozen=True)
class _Functions:
    """Smooth functions of the joints' states over the range of the fitted motions."""

    middle: np.ndarray
    half: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    moving: np.ndarray

    @classmethod
    def of(cls, rows: _Rows) -> _Functions:
        low, high = rows.positions.min(axis=0), rows.positions.max(axis=0)
        speed, acceleration = np.abs(rows.speeds).max(axis=0), np.abs(rows.accelerations).max(axis=0)
        moving = high - low > 1e-3 * max(float((high - low).max()), 1e-12)
        return cls(0.5 * (low + high), 0.5 * (high - low), speed, acceleration, moving)

    def __call__(self, rows: _Rows) -> np.ndarray:
        """(k, 1 + 13 moving joints), a constant first."""
        out = [np.ones(len(rows.positions))]
        for j in np.flatnonzero(self.moving):
            x = np.clip((rows.positions[:, j] - self.middle[j]) / self.half[j], -1.0, 1.0)
            v = np.clip(rows.speeds[:, j] / self.speed[j], -1.0, 1.0)
            a = np.clip(rows.accelerations[:, j] / self.acceleration[j], -1.0, 1.0)
            angle, (sharp, soft) = np.arccos(x), (np.tanh(v / turn) for turn in _TURNS)
            out += [np.cos(k * angle) for k in range(1, 5)]  # Chebyshev polynomials of the position
            out += [v, np.abs(v), v * np.abs(v), sharp, soft, sharp * x, sharp * np.cos(2.0 * angle), a, np.tanh(10.0 * a)]
        return np.stack(out, axis=1)

    def of_joint(self, joint: int) -> np.ndarray:
        """Columns of the constant and of one joint."""
        if not self.moving[joint]:
            return np.zeros(1, int)
        first = 1 + _PER_JOINT * int(np.count_nonzero(self.moving[:joint]))
        return np.concatenate([[0], first + np.arange(_PER_JOINT)])


def _rows(problem: Problem, solution: np.ndarray, motions: Sequence[str]) -> _Rows | None:
    """Rows of motions, evenly thinned where there are many; None without any."""
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
        parts.append((np.full(len(block.rows), size), block.residual(solution), block.matrix, *state))
    if not parts:
        return None
    size, residual, columns, q, v, a = (np.concatenate(part) for part in zip(*parts, strict=True))
    residual /= size[:, None]
    columns /= size[:, None, None]
    stretch = np.arange(len(residual)) * _STRETCHES // len(residual)
    return _Rows(residual, columns, q, v, a, stretch, problem.row_model.step)


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
        length = min(PILOT_ROWS / PILOT_SEGMENTS * row_model.step + 2.0 * row_model.margin, duration)
        for start in s.times[0] + (duration - length) * np.linspace(0.0, 1.0, count):
            a, b = np.searchsorted(s.times, [start, start + length + 1e-9])
            piece = s.part(int(a), int(b))
            if np.ptp(piece.inner(row_model.margin)) > 1:
                yield piece


#: Columns of a correction, functions then rigid ones, and their coefficients; None: no correction.
_Correction = tuple[np.ndarray, np.ndarray] | None


def _corrections(functions: _Functions, rows: _Rows, joints: Sequence[int | None]) -> list[list[_Correction]]:
    """A correction of each channel by each of the ways there are; none where the fitted motions are too short.

    ``joints`` are those whose torques the channels read, None for a sensor's.
    """
    inside = [rows.stretch == k for k in range(_STRETCHES)]
    if min(int(own.sum()) for own in inside) < _SHORTEST:
        return []
    found = functions(rows)
    shared = np.array([found[own].T @ found[own] for own in inside])
    sums = [_sums(found, shared, rows.columns[:, c], rows.residual[:, c], inside) for c in range(len(joints))]
    every = np.arange(found.shape[1])
    sets = [[every] * len(joints)]
    if any(joint is not None for joint in joints):
        sets.append([every if joint is None else functions.of_joint(joint) for joint in joints])
    return [correction for columns in sets for correction in _ways(sums, columns, found.shape[1])]


@dataclass(frozen=True)
class _Sums:
    """Gram matrices (s, n, n), sides (s, n) and powers (s,) of one channel by stretch, over functions, then rigid columns."""

    grams: np.ndarray
    sides: np.ndarray
    powers: np.ndarray


def _sums(
    functions: np.ndarray, shared: np.ndarray, rigid: np.ndarray, residual: np.ndarray, inside: Sequence[np.ndarray]
) -> _Sums:
    f, n = functions.shape[1], functions.shape[1] + rigid.shape[1]
    grams, sides, powers = np.empty((_STRETCHES, n, n)), np.empty((_STRETCHES, n)), np.empty(_STRETCHES)
    for k, own in enumerate(inside):
        x, r, y = functions[own], rigid[own], residual[own]
        grams[k, :f, :f], grams[k, f:, f:], grams[k, f:, :f] = shared[k], r.T @ r, r.T @ x
        grams[k, :f, f:] = grams[k, f:, :f].T
        sides[k, :f], sides[k, f:], powers[k] = x.T @ y, r.T @ y, y @ y
    return _Sums(grams, sides, powers)


def _ways(sums: Sequence[_Sums], functions: Sequence[np.ndarray], count: int) -> Iterator[list[_Correction]]:
    """By functions alone, or with one set of rigid parameters for all channels fitted again beside them, freely or penalised.

    What the estimate made of an effect that it does not know is in its rigid parameters, too.
    """
    rigid = np.arange(count, sums[0].grams.shape[1])
    columns = [np.concatenate([own, rigid]) for own in functions]
    weights = np.array([1.0 / max(float(s.powers.sum()), 1e-300) for s in sums])
    wholes = [(s.grams.sum(axis=0)[np.ix_(k, k)], s.sides.sum(axis=0)[k]) for s, k in zip(sums, columns, strict=True)]
    folds = []
    for out in (slice(fold, None, _FOLDS) for fold in range(_FOLDS)):
        folds.append([
            (s.grams[out].sum(axis=0)[np.ix_(k, k)], s.sides[out].sum(axis=0)[k], float(s.powers[out].sum()))
            for s, k in zip(sums, columns, strict=True)
        ])  # fmt: skip
    sizes = [np.diagonal(gram) for gram, _ in wholes]
    groups = [range(len(sums))] if all(own is functions[0] for own in functions) else [[c] for c in range(len(sums))]
    errors = np.zeros((len(_STRENGTHS), _WAYS, len(sums)))
    for error, strength in zip(errors, _STRENGTHS, strict=True):
        for held in folds:
            rest = [(g - h, y - z) for (g, y), (h, z, _) in zip(wholes, held, strict=True)]
            for way, found in enumerate(_solved(rest, groups, sizes, weights, strength, len(rigid))):
                error[way] += [power - 2.0 * x @ side + x @ gram @ x for x, (gram, side, power) in zip(found, held, strict=True)]
    solutions = [_solved(wholes, groups, sizes, weights, strength, len(rigid)) for strength in _STRENGTHS]
    best = errors.argmin(axis=0)
    for way in range(_WAYS):
        yield [
            (k, solutions[best[way, c]][way][c]) if errors[best[way, c], way, c] < s.powers.sum() else None
            for c, (s, k) in enumerate(zip(sums, columns, strict=True))
        ]


def _solved(
    parts: Sequence[tuple[np.ndarray, np.ndarray]], groups: Sequence[Sequence[int]], sizes: Sequence[np.ndarray],
    weights: np.ndarray, strength: float, rigid: int,
) -> list[list[np.ndarray]]:  # fmt: skip
    """Coefficients of functions, then of rigid columns, for each channel: without these, hardly penalised, as the functions are.

    Penalties are shares of the columns' energies ``sizes``. The functions of each channel are eliminated: what is left are
    the normal equations of the rigid parameters. Channels of one of the ``groups`` have the same functions.
    """
    eliminated = []
    for own in groups:
        gram, f = parts[own[0]][0], len(parts[own[0]][1]) - rigid
        scale = or_one(np.sqrt(sizes[own[0]][:f]))
        penalised = gram[:f, :f] / np.outer(scale, scale)
        penalised.flat[:: f + 1] += strength
        right = np.hstack([part for c in own for part in (parts[c][1][:f, None], parts[c][0][:f, f:])]) / scale[:, None]
        _, found, failed = _solve_positive(penalised, right)  # LAPACK itself: SciPy's checks would take longer
        if failed:
            raise LinAlgError("no positive definite matrix")
        eliminated += np.hsplit(found / scale[:, None], len(own))
    schur, side = np.zeros((rigid, rigid)), np.zeros(rigid)
    for (gram, y), found, weight, f in zip(parts, eliminated, weights, map(len, eliminated), strict=True):
        schur += weight * (gram[f:, f:] - gram[f:, :f] @ found[:, 1:])
        side += weight * (y[f:] - gram[f:, :f] @ found[:, 0])
    length = or_one(np.sqrt(np.sum([w * size[-rigid:] for w, size in zip(weights, sizes, strict=True)], axis=0)))
    scaled = schur / np.outer(length, length)
    rigids = [np.zeros(rigid)]
    rigids += [np.linalg.solve(scaled + share * np.eye(rigid), side / length) / length for share in (_ALMOST_NONE, strength)]
    return [[np.append(found[:, 0] - found[:, 1:] @ u, u) for found in eliminated] for u in rigids]


def _gap(rows: _Rows, functions: np.ndarray, corrections: Sequence[_Correction]) -> FlexibleGap | None:
    """Power before and after by stretch; the gain's standard error from the scatter of the stretches' differences."""
    left = rows.residual.copy()
    for c, correction in enumerate(corrections):
        if correction is not None:
            columns, found = correction
            own = columns < functions.shape[1]
            left[:, c] -= functions[:, columns[own]] @ found[own]
            left[:, c] -= rows.columns[:, c, columns[~own] - functions.shape[1]] @ found[~own]
    power = np.zeros((_STRETCHES, 2))
    for k in range(_STRETCHES):
        own = rows.stretch == k
        if own.sum() < _SHORTEST:
            return None
        power[k] = [_band_power(x[own], rows.step) for x in (rows.residual, left)]
    before, after = power.sum(axis=0)
    if not before > 0.0:
        return None
    ratio = after / before
    # Of a ratio of sums, by its linearisation: d ratio = (d after - ratio d before) / before.
    spread = np.std(power[:, 1] - ratio * power[:, 0], ddof=1) * np.sqrt(_STRETCHES) / before
    removed, rows_count = 1.0 - np.sqrt(ratio), len(rows.residual)
    std = spread / max(2.0 * np.sqrt(ratio), 1e-9)
    rms = np.sqrt(np.array([before, after]) / rows_count)
    return FlexibleGap(float(rms[0]), float(rms[1]), float(removed), float(std))


def _band_power(values: np.ndarray, step: float) -> float:
    """Energy of rows (k, c) below `BAND`, all channels together."""
    z = np.asarray(dct(values, axis=0, norm="ortho"))
    return float(np.sum(z[: max(int(min(2.0 * step * BAND, 1.0) * len(z)), 1)] ** 2))
