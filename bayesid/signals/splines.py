"""The splines that positions are smoothed to, function by function: for fits in which more than positions count."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy.linalg import solveh_banded

from bayesid.signals.kernel_input import kernel_input
from bayesid.signals.smoothing import DEGREE, POLYNOMIALS

_ORDER = DEGREE + 1


@dataclass(frozen=True, eq=False)
class Splines:
    """Uniform quintic B-splines at some times, six of which live at each: the functions of `bayesid.signals.smooth`."""

    first: np.ndarray  # of the six at each time (M,)
    values: np.ndarray  # of the six, and of their first two derivatives (3, M, 6)
    count: int  # number k of functions

    @classmethod
    def over(cls, times: np.ndarray, bandwidth: float, at: np.ndarray | None = None) -> Splines:
        """Over times (N,) [s] with nothing above a bandwidth [Hz], at these or at others within them (M,)."""
        spacing = 0.5 / bandwidth
        start = np.floor(times[0] / spacing)
        count = int(np.floor(times[-1] / spacing) - start) + _ORDER
        where = (times if at is None else np.clip(at, times[0], times[-1])) / spacing - start
        first = np.minimum(where.astype(int), count - _ORDER)
        powers = (where - first)[:, None] ** np.arange(_ORDER)
        values, polynomial = np.empty((3, len(where), _ORDER)), POLYNOMIALS
        for order in range(3):
            values[order] = powers[:, : _ORDER - order] @ polynomial.T / spacing**order
            polynomial = polynomial[:, 1:] * np.arange(1, _ORDER - order)
        return cls(first, values, count)

    def part(self, which: slice) -> Splines:
        """The functions that live at some neighbouring times."""
        first = self.first[which]
        return Splines(first - first[0], self.values[:, which], int(first[-1] - first[0]) + _ORDER)

    def motion(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (M, ...) of coefficients (k, ...)."""
        own = coefficients[self.first[:, None] + np.arange(_ORDER)]
        q, v, a = np.einsum("dmf,mf...->dm...", self.values, own)
        return q, v, a

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Coefficients (k, ...) of the least-squares spline through values (M, ...)."""
        return self.solved(self.values[0], values)

    def remainder(self, values: np.ndarray) -> np.ndarray:
        """What the least-squares spline leaves of values (M, ...)."""
        own = self.nearest(values)[self.first[:, None] + np.arange(_ORDER)]
        return values - np.einsum("mf,mf...->m...", self.values[0], own)

    def solved(self, rows: np.ndarray, values: np.ndarray, damping: float = 0.0) -> np.ndarray:
        """Least squares ``rows c = values`` (k, ...), where the rows (M, 6) multiply the six functions at each time.

        The normal matrix's diagonal is enlarged by the damping, a share of it.
        """
        columns = kernel_input(values.reshape(len(values), -1))
        band, right = _normal_equations(self.first, kernel_input(rows), columns, self.count)
        # A whisper of ridge keeps the outermost functions, of which only a tail lies in the data, determined.
        band[-1] += damping * band[-1] + 1e-14 * band[-1].max()
        return solveh_banded(band, right, check_finite=False).reshape(self.count, *values.shape[1:])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _normal_equations(first, rows, values, count):
    """Upper banded Gram matrix (6, count) of rows (M, 6), each of functions from its first one on, and right sides (count, c)."""
    band, right = np.zeros((6, count)), np.zeros((count, values.shape[1]))
    for sample in range(len(first)):
        k = first[sample]
        for i in range(6):
            for column in range(values.shape[1]):
                right[k + i, column] += rows[sample, i] * values[sample, column]
            for j in range(i, 6):
                band[5 + i - j, k + j] += rows[sample, i] * rows[sample, j]
    return band, right
