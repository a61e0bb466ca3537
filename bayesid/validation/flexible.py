"""How much of the error on a motion that was not fitted a flexible model could still predict.

What a model lacks and what cannot be predicted look alike in an error. So what the fitted motions left over is regressed on
smooth functions of the joints' positions, speeds, directions and accelerations, in six ways: of all joints or of a torque's
own, with the rigid body's parameters as they are, fitted again freely beside them, or penalised alike. What the best takes
from the error of another motion is a lower bound of what is predictable and not in the model.

The regression is ridge regression [Hoerl1970]_ on columns of unit length; its strength, no correction at all among the choices,
is for each channel the one that predicts parts of the fitted motions best that were left out. A joint outside the range of
the fitted motions counts as at its end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct
from scipy.linalg import LinAlgError, get_lapack_funcs

from bayesid.estimators.dispersion import PARTS
from bayesid.recordings.table import usual_step
from bayesid.regression.blocks import Block
from bayesid.regression.linalg import or_one
from bayesid.regression.problem import Problem, pilot_pieces
from bayesid.regression.row_cache import CACHE_BYTES, few_of, row_count
from bayesid.regression.rows import make_blocks
from bayesid.regression.segment import LongSegment
from bayesid.signals.smoothing import smooth

#: Band in which predictions are compared, the same whatever filter or method was used [Hz].
BAND = 10.0
#: Fewer rows, eight in a part, show nothing.
_FEWEST = 64
#: A gain counts from so many standard errors: Student's t with seven degrees of freedom at 97.5 %, for the best of six ways.
_CERTAIN = 3.636


(_solve_positive,) = get_lapack_funcs(("posv",), dtype=np.float64)
#: Folds of the parts of the fitted motions.
_FOLDS = 4
#: Penalties on columns of unit length.
_STRENGTHS = (3e-4, 3e-3, 3e-2)
#: Penalty of rigid parameters that are fitted again.
_ALMOST_NONE = 1e-9
#: Ways to treat the rigid parameters.
_WAYS = 3
#: Speeds, as shares of the largest, at which a joint's direction is half told.
_TURNS = (0.02, 0.1)
#: Functions of one joint.
_PER_JOINT = 13

#: Positions, speeds and accelerations of the joints (k, n) each.
State = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Functions:
    """Smooth functions of the joints' states over the range of the fitted motions."""

    #: Middle and half width of the range of positions (n,) [rad or m].
    middle: np.ndarray
    half: np.ndarray
    #: The largest (n,) [rad/s or m/s, and per second].
    speed: np.ndarray
    acceleration: np.ndarray
    moving: np.ndarray  # which joints move (n,)

    @classmethod
    def of(cls, state: State) -> Functions:
        """Functions of the range of these states."""
        positions, speeds, accelerations = state
        low, high = positions.min(axis=0), positions.max(axis=0)
        speed, acceleration = np.abs(speeds).max(axis=0), np.abs(accelerations).max(axis=0)
        moving = high - low > 1e-3 * max(float((high - low).max()), 1e-12)
        return cls(0.5 * (low + high), 0.5 * (high - low), speed, acceleration, moving)

    @property
    def count(self) -> int:
        """How many there are: a constant, and 13 of each moving joint."""
        return 1 + _PER_JOINT * int(np.count_nonzero(self.moving))

    def __call__(self, state: State) -> np.ndarray:
        """(k, count), a constant first."""
        positions, speeds, accelerations = state
        out = [np.ones(len(positions))]
        for j in np.flatnonzero(self.moving):
            x = np.clip((positions[:, j] - self.middle[j]) / self.half[j], -1.0, 1.0)
            v = np.clip(speeds[:, j] / self.speed[j], -1.0, 1.0)
            a = np.clip(accelerations[:, j] / self.acceleration[j], -1.0, 1.0)
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


#: Columns of a correction, functions then rigid ones, and their coefficients; None: no correction.
Correction = tuple[np.ndarray, np.ndarray] | None


@dataclass(frozen=True)
class Sums:
    """Gram matrices (s, n, n), sides (s, n) and powers (s,) of one channel by part, over functions, then rigid columns."""

    grams: np.ndarray
    sides: np.ndarray
    powers: np.ndarray


def grams(values: np.ndarray, columns: np.ndarray, inside: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Gram matrices of each channel by part (s, n, n), over functions (k, f), then rigid columns (k, c, p)."""
    f, n = values.shape[1], values.shape[1] + columns.shape[2]
    shared, out = [values[own].T @ values[own] for own in inside], []
    for c in range(columns.shape[1]):
        gram = np.empty((len(inside), n, n))
        for k, own in enumerate(inside):
            x, r = values[own], columns[own, c]
            gram[k, :f, :f], gram[k, f:, f:], gram[k, f:, :f] = shared[k], r.T @ r, r.T @ x
            gram[k, :f, f:] = gram[k, f:, :f].T
        out.append(gram)
    return out


def sums(
    gram: Sequence[np.ndarray], values: np.ndarray, columns: np.ndarray, residual: np.ndarray, inside: Sequence[np.ndarray]
) -> list[Sums]:
    """Sums of each channel from `grams` and residuals (k, c)."""
    out = []
    for c, (matrices, y) in enumerate(zip(gram, residual.T, strict=True)):
        sides = [np.concatenate([values[own].T @ y[own], columns[own, c].T @ y[own]]) for own in inside]
        out.append(Sums(matrices, np.array(sides), np.array([y[own] @ y[own] for own in inside])))
    return out


def _ways(sums: Sequence[Sums], functions: Sequence[np.ndarray], count: int) -> Iterator[list[Correction]]:
    """Corrections by functions alone, or with one set of rigid parameters for all channels fitted beside them, free or penalised.

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


@dataclass(frozen=True)
class FlexibleGap:
    """What a flexible model does to the error on a motion that was not fitted."""

    #: Share that the flexible model, on top of the estimate, removes of the error of all channels below 10 Hz; negative where it
    #: adds some.
    removed: float
    std: float  # its standard error, from the scatter between parts of the motion

    @property
    def certain(self) -> bool:
        """Whether the gain is beyond chance."""
        return self.removed > _CERTAIN * self.std

    def to_dict(self) -> dict:
        """``flexible_model`` of a motion in ``estimate.json``."""
        return {"removed": self.removed, "std": self.std, "beyond_chance": self.certain}


@dataclass(frozen=True)
class _Rows:
    """Rows of one motion, or of those fitted, in signal units."""

    #: Readings (k, c), and rigid and effect columns (k, c, p).
    target: np.ndarray
    columns: np.ndarray
    state: State  # of the joints
    inside: list[np.ndarray]  # which rows are in each part (k,)
    step: float  # distance of rows [s]

    def residual(self, solution: np.ndarray) -> np.ndarray:
        """What parameters (p,) leave (k, c)."""
        return self.target - self.columns @ solution


@dataclass(frozen=True)
class FlexibleModel:
    """All of a flexible model but what depends on an estimate: the fitted rows, functions of their states, and products."""

    functions: Functions  # of the range of the fitted motions
    fitted: _Rows  # rows of the fitted motions
    values: np.ndarray  # the functions there (k, f)
    grams: list[np.ndarray]  # Gram matrices (s, f + p, f + p) of each channel, by part
    joints: list[int | None]  # whose torques the channels read, None for a sensor's

    @classmethod
    def of(cls, problem: Problem, motions: Sequence[str]) -> FlexibleModel | None:
        """The model for motions that were not fitted; None where none of these moves, or too few rows were fitted."""
        fitted = _rows(problem, problem.fitted) if _moving(problem, motions) else None
        if fitted is None:
            return None
        functions, channels = Functions.of(fitted.state), problem.row_model.channels
        values = functions(fitted.state)
        joints = [int(j) if name.startswith("tau") else None for name, j in zip(channels.names, channels.joint, strict=True)]
        return cls(functions, fitted, values, grams(values, fitted.columns, fitted.inside), joints)

    def ways(self, solution: np.ndarray) -> list[list[Correction]]:
        """A correction of each channel by each of the ways there are, for parameters, base then effects (p,)."""
        fitted, functions = self.fitted, self.functions
        found = sums(self.grams, self.values, fitted.columns, fitted.residual(solution), fitted.inside)
        every = np.arange(functions.count)
        sets = [[every] * len(self.joints)]
        if any(joint is not None for joint in self.joints):
            sets.append([every if joint is None else functions.of_joint(joint) for joint in self.joints])
        return [correction for columns in sets for correction in _ways(found, columns, functions.count)]


def flexible_gaps(
    problem: Problem, solution: np.ndarray, motions: Sequence[str], model: FlexibleModel | None = None
) -> dict[str, FlexibleGap]:
    """Gap of each motion that was not fitted; without those that are too short, or no motions at all."""
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
    part = np.arange(len(target)) * PARTS // len(target)
    return _Rows(target, columns, (q, v, a), [part == k for k in range(PARTS)], problem.row_model.step)


def _blocks(problem: Problem, motions: Sequence[str]) -> Iterable[Block]:
    """Blocks of moving rows without the paper's filters: a pilot of the fitted motions, pieces of other long ones."""
    row_model, segments = problem.row_model, [s for name in motions for s in problem.segments[name] if not s.poses]
    count, width = row_count(row_model, segments), len(row_model.channels) * row_model.width
    long = any(isinstance(s, LongSegment) for name in motions for s in problem.rows.segments[name])  # the segments are an excerpt
    if long or row_model.filters is not None or 8 * count * width > CACHE_BYTES:
        pieces = [p for p in pilot_pieces(row_model, segments) if np.ptp(p.inner(row_model.margin)) > 1]
        return make_blocks(replace(row_model, filters=None), pieces)
    fitted = tuple(motions) == problem.fitted
    moving = (b for b in (problem.regression.rows.pilot() if fitted else problem.rows.blocks(motions)) if b.group != "poses")
    return moving if fitted else few_of(moving, count)


def _gap(
    rows: _Rows, residual: np.ndarray, power: np.ndarray, functions: np.ndarray, way: Sequence[Correction]
) -> FlexibleGap:  # fmt: skip
    """Gap by one way, from the residual and its power by part; the gain's standard error from the scatter of the parts."""
    left = residual.copy()
    for c, correction in enumerate(way):
        if correction is not None:
            columns, found = correction
            own = columns < functions.shape[1]
            left[:, c] -= functions[:, columns[own]] @ found[own]
            left[:, c] -= rows.columns[:, c, columns[~own] - functions.shape[1]] @ found[~own]
    reduced = _band_powers(left, rows)
    before = power.sum()
    ratio = reduced.sum() / before
    # Of a ratio of sums, by its linearisation: d ratio = (d after - ratio d before) / before.
    spread = np.std(reduced - ratio * power, ddof=1) * np.sqrt(PARTS) / before
    return FlexibleGap(float(1.0 - np.sqrt(ratio)), float(spread / max(2.0 * np.sqrt(ratio), 1e-9)))


def _band_powers(values: np.ndarray, rows: _Rows) -> np.ndarray:
    """Energy of rows (k, c) below `BAND` by part, all channels together."""
    out = []
    for own in rows.inside:
        z = np.asarray(dct(values[own], axis=0, norm="ortho"))
        out.append(float(np.sum(z[: max(int(min(2.0 * rows.step * BAND, 1.0) * len(z)), 1)] ** 2)))
    return np.array(out)
