"""Marginal likelihoods of changes in closed form.

With every channel in units of what the recording's own fit leaves of it, what the reference leaves is

    y - X m = X d + Z theta + e,    d ~ N(0, C + N),    theta ~ N(0, T),    e ~ N(0, k 1)

with the reference's covariance C, the tolerance N for what differs from day to day, and a dispersion k that every hypothesis may
choose. Rows that follow each other are not independent: where r of them count as one, all densities are raised to the power
1/r, which is the same as rows shortened by the root of r. All columns are reduced once to a triangular factor; with ``B`` the
columns times the root of ``C + N``,

    log p = -1/2 [n log k + log det(1 + B B'/k) + y' (k 1 + B B')^-1 y],

and a change with columns Z adds, with ``V = k 1 + B B'`` and ``W = T^1/2 Z' V^-1 Z T^1/2``,

    -1/2 log det(1 + W) + 1/2 b' (1 + W)^-1 b,    b = T^1/2 Z' V^-1 y.

Z' V^-1 Z of a few columns comes from the singular vectors of B, so that a hypothesis costs a few numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from bayesid.diagnosis.changes.hypotheses import Hypothesis
from bayesid.diagnosis.changes.scales import DISPERSIONS, SIZES
from bayesid.estimators.factor import stack

_PANEL = 2048


@dataclass(frozen=True, eq=False)
class Reduced:
    """Rows as a triangular factor."""

    columns: np.ndarray  # factor of the columns (q + 1, q)
    target: np.ndarray  # what the reference leaves, rotated alike (q + 1,)
    rows: float  # how many independent rows there were

    @classmethod
    def of(cls, rows: np.ndarray, left: np.ndarray, correlation: float = 1.0) -> Reduced:
        """Reduce rows (N, q) and what the reference leaves of them (N,), so many of which count as one."""
        r = np.zeros((0, rows.shape[1] + 1))
        for a in range(0, len(rows), _PANEL):
            r = stack(r, np.column_stack([rows[a : a + _PANEL], left[a : a + _PANEL]]))
        r /= np.sqrt(correlation)
        return cls(r[:, :-1], r[:, -1], len(rows) / correlation)


@dataclass(frozen=True, eq=False)
class Marginal:
    """What is left of the data once everything known is integrated out."""

    data: Reduced  # the rows
    #: Combinations of columns with unit variance each (q, k): root of the reference's covariance, the tolerance, and changes
    #: that are accepted.
    known: np.ndarray
    mean: np.ndarray  # amplitudes of all columns that are expected (q,): of what is in both recordings
    #: By which the tolerance is wider than usual; `known` holds it but for effects that are in no change yet.
    factor: float = 1.0
    prior: float = 0.0  # log probability of that factor beforehand

    @cached_property
    def _within(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Singular values of B (r,), and what their left vectors take of the columns (r, q) and of the target (r,)."""
        u, s, _ = np.linalg.svd(self.data.columns @ self.known, full_matrices=False)
        return s, u.T @ self.data.columns, u.T @ self._target

    @cached_property
    def _target(self) -> np.ndarray:
        """What is left beside the expected amplitudes (q + 1,)."""
        return self.data.target - self.data.columns @ self.mean

    @cached_property
    def _null(self) -> np.ndarray:
        """Log density of the data without a further change by dispersion (K,), but for a constant."""
        (s, _, along), y, k = self._within, self._target, DISPERSIONS[:, None]
        size = self.data.rows * np.log(DISPERSIONS) + np.log1p(s**2 / k).sum(axis=1)
        return self.prior - 0.5 * (size + (y @ y - along @ along) / DISPERSIONS + (along**2 / (k + s**2)).sum(axis=1))

    @property
    def null(self) -> float:
        """Log density of the data without a further change, but for a constant."""
        return float(self._null.max())

    @property
    def dispersion(self) -> float:
        """The dispersion that suits best without a further change."""
        return float(DISPERSIONS[int(np.argmax(self._null))])

    def _products(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``Z' V^-1 Z`` (K, k, k) and ``Z' V^-1 y`` (K, k) of some columns, by dispersion."""
        s, inside, along = self._within
        z = np.column_stack([self.data.columns[:, columns], self._target])
        within = np.column_stack([inside[:, columns], along])
        weighted = within / (DISPERSIONS[:, None, None] + s[:, None] ** 2)
        both = (z.T @ z - within.T @ within) / DISPERSIONS[:, None, None] + within.T @ weighted
        return both[:, :-1, :-1], both[:, :-1, -1]

    def _with_shared(self, change: Hypothesis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log density without a change (K,), and products of its columns as `_products`, what is in both recordings counted."""
        if (both := change.shared) is None:
            return self._null, *self._products(change.columns)
        gram, vector = self._products(np.concatenate([change.columns, both.columns]))
        own = len(change.columns)
        mean = np.concatenate([np.zeros(own), both.mean])
        null = self._null + vector @ mean - 0.5 * np.einsum("i,kij,j->k", mean, gram, mean)
        vector = vector - gram @ mean
        # Directions of unit variance: the effect wanders, and is known so well.
        root = np.asarray(block_diag(self.factor * np.diag(both.wander), both.root))
        lower = np.linalg.cholesky(np.eye(root.shape[1]) + root.T @ gram @ root)
        seen = np.linalg.solve(lower, root.T @ np.concatenate([gram[:, :, :own], vector[:, :, None]], axis=2))
        left, along = seen[:, :, :own].transpose(0, 2, 1), seen[:, :, own]
        null = null + 0.5 * np.sum(along**2, axis=1) - np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        return null, gram[:, :own, :own] - left @ seen[:, :, :own], vector[:, :own] - (left @ along[:, :, None])[:, :, 0]

    def information(self, change: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """Log density without a change (K,), and precision to which the data show its amplitudes (K, k, k), by dispersion."""
        return self._with_shared(change)[:2]

    def curves(self, change: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """Log density by dispersion (K,) without a change, and with it by size of its prior, too (sizes, K).

        Of an effect that the reference's model does not have, what is in both recordings is in both densities.
        """
        null, gram, vector = self._with_shared(change)
        return null, null + added_evidence(gram, vector, change.root)


def added_evidence(gram: np.ndarray, vector: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Log evidence that columns with Gram matrices (K, k, k) and products with the target (K, k) add, by size (sizes, K).

    Beforehand the amplitudes' covariance has the root (k, m) times each of `SIZES`: one eigendecomposition of W does for all.
    """
    values, vectors = np.linalg.eigh(root.T @ gram @ root)
    along = ((vector @ root)[:, None, :] @ vectors)[:, 0]
    square = np.square(SIZES)[:, None, None]
    spread = square * np.maximum(values, 0.0)
    return 0.5 * np.sum(square * along**2 / (1.0 + spread) - np.log1p(spread), axis=2)


def gain(marginals: Iterable[Marginal], change: Hypothesis) -> float:
    """Log evidence of a change, its size unknown; with and without it, the best dispersion and the best of several tolerances."""
    return _best_gain([m.curves(change) for m in marginals])


def without_change(marginals: Iterable[Marginal], effect: Hypothesis) -> float:
    """Log density of the data without a change, what the reference says of an effect that its model lacks counted."""
    return max(float(m.information(effect)[0].max()) for m in marginals)


def expected_gain(marginals: Iterable[Marginal], change: Hypothesis, amplitudes: np.ndarray) -> Callable[[float], float]:
    """Log evidence that a change would have on average over noise, were its amplitudes (k,) these times a factor.

    A change makes the data less probable without it, which a larger dispersion or a wider tolerance makes good in part.
    """
    parts = []
    for null, gram in (m.information(change) for m in marginals):
        seen = gram @ amplitudes
        cost = added_evidence(gram, np.zeros_like(seen), change.root)
        parts.append((null, 0.5 * seen @ amplitudes, cost, added_evidence(gram, seen, change.root) - cost))

    def at(factor: float) -> float:
        without = [null - factor**2 * lost for null, lost, _, _ in parts]
        return _best_gain([(w, w + cost + factor**2 * won) for w, (_, _, cost, won) in zip(without, parts, strict=True)])

    return at


def _best_gain(curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Log evidence by log densities as `Marginal.curves` gives them, the best dispersion and tolerance with and without."""
    with_it = max(np.logaddexp.reduce(c, axis=0).max() for _, c in curves) - np.log(len(SIZES))
    return float(with_it - max(c.max() for c, _ in curves))


def best_size(marginal: Marginal, change: Hypothesis) -> float:
    """The size of a change's prior that suits best."""
    return SIZES[int(np.argmax(marginal.curves(change)[1].max(axis=1)))]


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Posterior of the amplitudes of all columns, ``x = start + B c``."""

    start: np.ndarray  # what is expected beforehand (q,)
    directions: np.ndarray  # B, combinations of columns of unit variance beforehand (q, k)
    mean: np.ndarray  # of c (k,)
    root: np.ndarray  # of the covariance of c (k, k)

    @property
    def all(self) -> np.ndarray:
        """Amplitudes of all columns (q,)."""
        return self.start + self.directions @ self.mean

    def part(self, own: slice) -> np.ndarray:
        """What some of the directions make of the amplitudes of all columns (q,)."""
        return self.directions[:, own] @ self.mean[own]

    def part_root(self, own: slice) -> np.ndarray:
        """Root of the covariance of `part` (q, k)."""
        return self.directions[:, own] @ self.root[own]


def amplitudes(marginal: Marginal, gram: np.ndarray | None = None, target: np.ndarray | None = None) -> Amplitudes:
    """The posterior under what is known and the dispersion that suits best: c has precision ``1 + B'A'A B / k``.

    ``A'A`` (q, q) and ``A'y`` (q,) are by default those of all rows.
    """
    a, y = marginal.data.columns, marginal.data.target
    gram = a.T @ a if gram is None else gram
    target = a.T @ y if target is None else target
    b, k = marginal.known, marginal.dispersion
    lower = np.linalg.cholesky(np.eye(b.shape[1]) + b.T @ gram @ b / k)
    root = np.linalg.inv(lower).T
    return Amplitudes(marginal.mean, b, root @ (root.T @ (b.T @ (target - gram @ marginal.mean))) / k, root)
