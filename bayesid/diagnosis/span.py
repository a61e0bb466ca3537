"""What columns span, from their triangular factor: no basis as large as they are is made to project on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Singular values below this share of the largest are directions that are not there.
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class Span:
    """The space that columns span."""

    columns: np.ndarray  # (rows, k)
    root: np.ndarray  # ``columns @ root`` is an orthonormal basis (k, rank)
    more: Span | None = None  # another space, orthogonal to this one, or None

    @classmethod
    def of(cls, columns: np.ndarray, least: float = _LEAST, rounding: float = 0.0) -> Span:
        """Of columns (rows, k), each in its own unit, but for singular values below a share ``least`` of the largest.

        Directions no longer than ``rounding``, the absolute error of every column in its unit, are left out.
        """
        length = np.linalg.norm(columns, axis=0)
        there = np.flatnonzero(length > 0.0)
        length = np.maximum(length, rounding / least)
        root = np.zeros((columns.shape[1], 0))
        if len(there):
            _, s, vt = np.linalg.svd(np.linalg.qr(columns[:, there] / length[there], mode="r"))
            keep = s > least * max(s[0], float(rounding > 0.0))
            root = np.zeros((columns.shape[1], int(keep.sum())))
            root[there] = (vt[: len(s)][keep] / s[keep, None]).T / length[there, None]
        return cls(columns, root)

    @property
    def rank(self) -> int:
        """Number of dimensions."""
        return self.root.shape[1] + (self.more.rank if self.more else 0)

    def along(self, values: np.ndarray) -> np.ndarray:
        """Components of values (rows,) in the basis of the columns alone (rank,)."""
        return self.root.T @ (self.columns.T @ values)

    def project_out(self, values: np.ndarray) -> np.ndarray:
        """What the columns cannot explain of values (rows, ...)."""
        left = values - self.columns @ (self.root @ self.along(values))
        return self.more.project_out(left) if self.more else left

    def with_more(self, columns: np.ndarray, rounding: float = 0.0) -> Span:
        """The space with further columns (rows, k) in it; ``rounding`` as for `of`."""
        length = np.linalg.norm(columns, axis=0)
        units = columns[:, length > 0.0] / np.maximum(length[length > 0.0], rounding / _LEAST)
        left = self.project_out(self.project_out(units))
        # Of what is explained already only rounding is left.
        new = np.linalg.norm(left, axis=0) > _LEAST
        return Span(self.columns, self.root, Span.of(left[:, new]))


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of columns (rows, k)."""
    span = Span.of(columns)
    return span.columns @ span.root
