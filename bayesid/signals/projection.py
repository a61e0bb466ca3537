"""Projection onto the frequency band in which the robot moves.

It discards what only holds noise and thins the rows, without delay and without colouring white noise. As it is linear, it is
applied to regressors and measurements alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from bayesid.signals.arrays import kernel_input

#: Roll-off of the projection's kernel and half its length in rows.
ROLL_OFF = 0.5
HALF_WIDTH = 5


def project(times: np.ndarray, values: np.ndarray, start: float, step: float, first: int, out: np.ndarray, energy: np.ndarray):
    """Add samples to the rows of a band: shifted root-raised-cosine kernels, which are orthonormal.

    White noise of standard deviation s on evenly spaced samples therefore stays white with the same s, and
    signals below ``(1 - ROLL_OFF) / (2 step)`` keep their energy. Where a kernel reaches over an end of the
    recording it is cut off; divide every row by the root of its energy. As both sides of an equation are
    treated alike, none of this biases an estimate.

    Samples are at times (N,) [s] with values (N, ...), the centre of row 0 is at ``start`` and rows are a ``step`` apart [s].
    Rows ``out`` (k, ...), of which ``first`` is the index of the first, and sums of squared weights ``energy`` (k,) are added to
    in place; contributions to rows outside are dropped.
    """
    flat = kernel_input(values).reshape(len(values), -1)
    _project(kernel_input(times), flat, start, step, first, _TABLE, out.reshape(len(out), -1), energy)


def _kernel(x: np.ndarray, roll_off: float) -> np.ndarray:
    """Root-raised-cosine impulse response, unit spacing and unit energy."""
    edge = 4.0 * roll_off * x
    safe = np.where((x == 0) | (np.abs(edge) == 1.0), 0.1234, x)
    safe_edge = 4.0 * roll_off * safe
    value = np.sin(np.pi * safe * (1 - roll_off)) + safe_edge * np.cos(np.pi * safe * (1 + roll_off))
    value /= np.pi * safe * (1.0 - safe_edge**2)
    angle = np.pi / (4.0 * roll_off)
    corner = roll_off / np.sqrt(2.0) * ((1 + 2 / np.pi) * np.sin(angle) + (1 - 2 / np.pi) * np.cos(angle))
    value = np.where(np.abs(edge) == 1.0, corner, value)
    return np.where(x == 0, 1.0 - roll_off + 4.0 * roll_off / np.pi, value)


_PER_ROW = 2048
#: Samples that are added to a row at once; the loop below is written for this many.
_TOGETHER = 4
_TABLE = _kernel(np.arange(_PER_ROW * HALF_WIDTH + 2) / _PER_ROW, ROLL_OFF)
_TABLE[_PER_ROW * HALF_WIDTH :] = 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _project(times, values, start, step, first, table, out, energy):
    rows, columns = out.shape
    weights = np.empty(_TOGETHER)
    for first_sample in range(0, len(values), _TOGETHER):
        # A few neighbouring samples at once: a row of the output is then read and written once for all of them.
        count = min(_TOGETHER, len(values) - first_sample)
        begin = (times[first_sample] - start) / step - first
        end = (times[first_sample + count - 1] - start) / step - first
        low = max(int(np.ceil(begin - HALF_WIDTH)), 0)
        for row in range(low, min(int(np.floor(end + HALF_WIDTH)), rows - 1) + 1):
            for k in range(_TOGETHER):
                weights[k] = 0.0
                if k < count:
                    distance = abs((times[first_sample + k] - start) / step - first - row)
                    if distance <= HALF_WIDTH:
                        at = distance * _PER_ROW
                        i = int(at)
                        weights[k] = table[i] + (at - i) * (table[i + 1] - table[i])
                        energy[row] += weights[k] * weights[k]
            target = out[row]
            if count == _TOGETHER:
                one, two, three, four = weights
                v1, v2 = values[first_sample], values[first_sample + 1]
                v3, v4 = values[first_sample + 2], values[first_sample + 3]
                for column in range(columns):
                    target[column] += one * v1[column] + two * v2[column] + three * v3[column] + four * v4[column]
            else:
                for k in range(count):
                    source = values[first_sample + k]
                    for column in range(columns):
                        target[column] += weights[k] * source[column]


@dataclass(frozen=True)
class GridProjection:
    """`project` of values at samples that are interpolated from an evenly spaced grid: what each grid point adds to each row.

    Smooth values, as those of a smoothed trajectory, need not be computed at every sample. Polynomials of degree five
    through six grid points stand in for them, so that ``row = sum_k w(t_k) sum_j L_j(t_k) value_j``, and the inner sums over
    samples k are taken once for all values.
    """

    weights: np.ndarray  # of `begin` and the following grid points in each row (rows, span)
    begin: np.ndarray  # index of the first grid point that each row takes (rows,)

    #: Grid points needed before the first and after the last sample.
    BEFORE, AFTER = 2, 3

    @classmethod
    def of(
        cls, times: np.ndarray, origin: float, spacing: float, start: float, step: float, first: int, rows: int
    ) -> GridProjection:
        """Weights for samples at increasing times (N,), grid points and rows; ``start``, ``step`` and ``first`` as in `project`.

        The grid begins at ``origin`` with points ``spacing`` apart [s]; `BEFORE` of them lie before the first sample.
        """
        span = int(2 * HALF_WIDTH * step / spacing) + 2 + cls.BEFORE + cls.AFTER
        centres = start + step * (first + np.arange(rows))
        low = np.searchsorted(times, centres - HALF_WIDTH * step)
        high = np.searchsorted(times, centres + HALF_WIDTH * step, side="right")
        inside = times[np.minimum(low, len(times) - 1)]
        begin = ((inside - origin) / spacing).astype(int) - cls.BEFORE
        position = (kernel_input(times) - origin) / spacing
        weights = _grid_weights(position, kernel_input(times), low, high, begin, start, step, first, span, _TABLE)
        return cls(weights, begin)

    @classmethod
    def of_middles(cls, cells: np.ndarray) -> GridProjection:
        """What interpolation makes of values halfway between grid points, in cells counted from the first sample (k,)."""
        shares = np.array([3.0, -25.0, 150.0, 150.0, -25.0, 3.0]) / 256.0
        return cls(np.tile(shares, (len(cells), 1)), np.asarray(cells, dtype=int))

    def add(self, values: np.ndarray, first: int, out: np.ndarray) -> None:
        """Add values (m, ...) at grid points first ... first + m - 1 to the rows ``out`` (rows, ...), in place."""
        flat = kernel_input(values).reshape(len(values), -1)
        _add_from_grid(flat, first, self.weights, self.begin, out.reshape(len(out), -1))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _grid_weights(position, times, low, high, begin, start, step, first, span, table):
    weights, share = np.zeros((len(low), span)), np.empty((len(times), 6))
    for k in range(len(times)):
        u = position[k] - int(position[k])
        a, b, c, d, e, f = u + 2.0, u + 1.0, u, u - 1.0, u - 2.0, u - 3.0
        share[k, 0], share[k, 1] = b * c * d * e * f / -120.0, a * c * d * e * f / 24.0
        share[k, 2], share[k, 3] = a * b * d * e * f / -12.0, a * b * c * e * f / 12.0
        share[k, 4], share[k, 5] = a * b * c * d * f / -24.0, a * b * c * d * e / 120.0
    for row in range(len(low)):
        for k in range(low[row], high[row]):
            distance = abs((times[k] - start) / step - first - row)
            if distance <= HALF_WIDTH:
                at = distance * _PER_ROW
                i = int(at)
                weight = table[i] + (at - i) * (table[i + 1] - table[i])
                j = int(position[k]) - 2 - begin[row]
                for m in range(6):
                    weights[row, j + m] += weight * share[k, m]
    return weights


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _add_from_grid(values, first, weights, begin, out):
    rows, columns = out.shape
    for row in range(rows):
        target = out[row]
        low, high = max(begin[row], first), min(begin[row] + weights.shape[1], first + len(values))
        for j in range(low, high - 3, _TOGETHER):
            one, two = weights[row, j - begin[row]], weights[row, j + 1 - begin[row]]
            three, four = weights[row, j + 2 - begin[row]], weights[row, j + 3 - begin[row]]
            v1, v2, v3, v4 = values[j - first], values[j + 1 - first], values[j + 2 - first], values[j + 3 - first]
            for column in range(columns):
                target[column] += one * v1[column] + two * v2[column] + three * v3[column] + four * v4[column]
        for j in range(low + max(high - low, 0) // _TOGETHER * _TOGETHER, high):
            weight, value = weights[row, j - begin[row]], values[j - first]
            for column in range(columns):
                target[column] += weight * value[column]
