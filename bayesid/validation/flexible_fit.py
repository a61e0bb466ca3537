"""Smooth functions of the joints' states, and their coefficients for what a model left of the fitted motions.

Ridge regression [Hoerl1970]_ on columns of unit length; its strength, no correction at all among the choices, is for each channel
the one that predicts stretches of the fitted motions best that were left out. A joint outside the range of the fitted motions
counts as at its end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, get_lapack_funcs

from bayesid.regression.linalg import or_one

(_solve_positive,) = get_lapack_funcs(("posv",), dtype=np.float64)
#: Folds of the stretches of the fitted motions.
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
    """Smooth functions of the joints' states over the range of the fitted motions.

    Attributes
    ----------
    middle, half
        Middle and half width of the range of positions (n,) [rad or m].
    speed, acceleration
        The largest (n,) [rad/s or m/s, and per second].
    moving
        Which joints move (n,).
    """

    middle: np.ndarray
    half: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    moving: np.ndarray

    @classmethod
    def of(cls, state: State) -> Functions:
        """Of the range of these states."""
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
    """Gram matrices (s, n, n), sides (s, n) and powers (s,) of one channel by stretch, over functions, then rigid columns."""

    grams: np.ndarray
    sides: np.ndarray
    powers: np.ndarray


def grams(values: np.ndarray, columns: np.ndarray, inside: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Gram matrices of each channel by stretch (s, n, n), over functions (k, f), then rigid columns (k, c, p)."""
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


def corrections(functions: Functions, found: Sequence[Sums], joints: Sequence[int | None]) -> list[list[Correction]]:
    """A correction of each channel by each of the ways there are.

    Parameters
    ----------
    functions, found
        What the corrections are made of, and `sums` of each channel.
    joints
        Whose torques the channels read, None for a sensor's.
    """
    every = np.arange(functions.count)
    sets = [[every] * len(joints)]
    if any(joint is not None for joint in joints):
        sets.append([every if joint is None else functions.of_joint(joint) for joint in joints])
    return [correction for columns in sets for correction in _ways(found, columns, functions.count)]


def _ways(sums: Sequence[Sums], functions: Sequence[np.ndarray], count: int) -> Iterator[list[Correction]]:
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
