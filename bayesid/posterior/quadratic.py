"""Sums of squares as quadratic forms in coordinates that make their sum the unit matrix."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs

_FACTORISE, _SOLVE_FACTORISED = get_lapack_funcs(("potrf", "potrs"), dtype="d")


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Squares ``|F_k theta - f_k|^2`` of every term as ``z' G_k z - 2 h_k' z + q_k`` with ``theta = centre + root z``.

    The last term is the prior's. At unit scales the sum of all G is the unit matrix and that of all h is zero, so
    squaring the factors costs no digits.
    """

    centre: np.ndarray
    root: np.ndarray
    gram: np.ndarray
    linear: np.ndarray
    constant: np.ndarray

    def squares(self, z: np.ndarray) -> np.ndarray:
        """All terms (..., k + 1) at points z (..., d)."""
        k, d = self.linear.shape
        turned = (z @ self._side_by_side).reshape(*z.shape[:-1], k, d)
        return np.einsum("...kd,...d->...k", turned - 2.0 * self.linear, z) + self.constant

    @cached_property
    def _side_by_side(self) -> np.ndarray:
        """(d, (k + 1) d), for one product instead of many."""
        return np.ascontiguousarray(np.swapaxes(self.gram, 0, 1).reshape(self.gram.shape[1], -1))

    def gaussian(self, precisions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (d,) and lower Cholesky factor (d, d) of the precision in z, for weights ``1 / s^2`` of the terms (k,)."""
        weights = np.append(precisions, 1.0)
        k, d = self.linear.shape
        lower, trouble = _FACTORISE((weights @ self.gram.reshape(k, d * d)).reshape(d, d), lower=1)
        if trouble:
            raise np.linalg.LinAlgError("the precision is not positive definite")
        return _SOLVE_FACTORISED(lower, weights @ self.linear, lower=1)[0], lower
