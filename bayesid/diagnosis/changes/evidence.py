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

Z' V^-1 Z of all columns at once comes from the singular vectors of B, so that a hypothesis costs a few numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from bayesid.diagnosis.changes.hypotheses import Hypothesis, SharedAmplitudes
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
    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``y' V^-1 y`` with the rest of the null's log density (K,), ``Z' V^-1 y`` (K, q), ``Z' V^-1 Z`` (K, q, q)."""
        a, y = self.data.columns, self.data.target - self.data.columns @ self.mean
        u, s, _ = np.linalg.svd(a @ self.known, full_matrices=False)
        inside, along = u.T @ a, u.T @ y
        rest, beside, left = a.T @ a - inside.T @ inside, a.T @ y - inside.T @ along, float(y @ y - along @ along)
        null, vectors, grams = [], [], []
        for k in DISPERSIONS:
            weight = 1.0 / (k + s**2)
            size = self.data.rows * np.log(k) + np.log1p(s**2 / k).sum()
            null.append(self.prior - 0.5 * (size + left / k + along @ (weight * along)))
            vectors.append(beside / k + inside.T @ (weight * along))
            grams.append(rest / k + inside.T @ (weight[:, None] * inside))
        return np.array(null), np.array(vectors), np.array(grams)

    @property
    def null(self) -> float:
        """Log density of the data without a further change, but for a constant."""
        return float(self._parts[0].max())

    @property
    def dispersion(self) -> float:
        """The dispersion that suits best without a further change."""
        return float(DISPERSIONS[int(np.argmax(self._parts[0]))])

    def _shared(self, both: SharedAmplitudes) -> np.ndarray:
        """Directions of unit variance of an effect that is in both recordings: it wanders, and is known so well (2 k, m)."""
        return np.asarray(block_diag(self.factor * np.diag(both.wander), both.root))

    def information(self, change: Hypothesis) -> np.ndarray:
        """Precision to which the data show amplitudes of a change (k, k), at the best dispersion."""
        gram = self._parts[2][int(np.argmax(self._parts[0]))]
        own = np.ix_(change.columns, change.columns)
        if (both := change.shared) is None:
            return gram[own]
        at = np.concatenate([change.columns, both.columns])
        always = self._shared(both)
        seen = gram[np.ix_(change.columns, at)] @ always
        inner = np.eye(len(always.T)) + always.T @ gram[np.ix_(at, at)] @ always
        return gram[own] - seen @ np.linalg.solve(inner, seen.T)

    def curves(self, change: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """Log density by dispersion (K,) without a change, and with it by size of its prior, too (sizes, K).

        Of an effect that the reference's model does not have, what is in both recordings is in both densities.
        """
        null, vectors, grams = self._parts
        columns, always = change.columns, np.zeros((len(change.columns), 0))
        if (both := change.shared) is not None:
            columns = np.concatenate([columns, both.columns])
            always = self._shared(both)
        gram, vector = grams[:, columns[:, None], columns], vectors[:, columns]
        if both is not None:
            mean = np.concatenate([np.zeros(len(change.columns)), both.mean])
            null = null + vector @ mean - 0.5 * np.einsum("i,kij,j->k", mean, gram, mean)
            vector = vector - gram @ mean
        added = np.vstack([np.diag(change.sizes), np.zeros((len(columns) - len(change.sizes), len(change.sizes)))])
        without = null + added_evidence(gram, vector, always)
        with_it = [null + added_evidence(gram, vector, np.hstack([always, size * added])) for size in SIZES]
        return without, np.array(with_it)


def added_evidence(gram: np.ndarray, vector: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Log evidence that columns with Gram matrices (K, k, k) and products with the target (K, k) add.

    Beforehand the amplitudes have a covariance of root (k, m).
    """
    if not root.shape[1]:
        return np.zeros(len(vector))
    lower = np.linalg.cholesky(np.eye(root.shape[1]) + root.T @ gram @ root)
    z = np.linalg.solve(lower, (vector @ root)[:, :, None])[:, :, 0]
    return 0.5 * np.sum(z**2, axis=1) - np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)


def gain(marginals: Iterable[Marginal], change: Hypothesis) -> float:
    """Log evidence of a change, its size unknown; with and without it, the best dispersion and the best of several tolerances."""
    curves = [m.curves(change) for m in marginals]
    with_it = max((logsumexp(c, axis=0) - np.log(len(SIZES))).max() for _, c in curves)
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
