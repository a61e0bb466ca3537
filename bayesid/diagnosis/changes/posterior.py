"""What is known of all amplitudes together once the later recording is read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.changes.evidence import Marginal


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
