"""The filters applied alike to regressors and measurements.

Any linear operation applied to both sides of ``w = Y phi`` keeps the equation exact. Two are used:

* the paper's two first-order low-passes [Liu1998]_, which also turn ``d/dt (P phi) - Q phi`` into something that
  needs no accelerations;
* a projection onto the frequency band in which the robot moves, which discards what only holds noise and thins
  the rows, without delay and without colouring white noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from bayesid.errors import InputError
from bayesid.signals.kernel_input import kernel_input

#: Bandwidths that a recording can tell from none, and from no filter [rad/s].
_SLOWEST, _FASTEST = 1e-6, 1e9

#: Frequencies at which the spectrum of rows is computed; order of the recursion that stands for thinning.
_SPECTRUM = 4096
_THINNING_ORDER = 8


@dataclass(frozen=True)
class LowPass:
    """Two first-order low-passes in series, ``l / (l + s) * d / (d + s)``, of unit gain at zero frequency.

    Attributes
    ----------
    l, d
        Bandwidths [rad/s]; the paper used l = 1, d = 50.
    """

    l: float  # noqa: E741 -- the paper's symbol, and the name of the command-line option
    d: float

    def __post_init__(self):
        for name, value in (("l", self.l), ("d", self.d)):
            if not _SLOWEST <= value <= _FASTEST:
                raise InputError(f"low-pass {name} = {value}: give a bandwidth from {_SLOWEST:g} to {_FASTEST:g} rad/s")

    def poles(self, step: float) -> np.ndarray:
        """Poles of the two filters sampled every ``step`` seconds (2,)."""
        return np.exp(-np.array([self.l, self.d]) * step)


@dataclass(frozen=True)
class FilterState:
    """What the low-pass remembers between two pieces of one recording: last inputs, last outputs."""

    last_time: float
    last_rate: np.ndarray
    last_rest: np.ndarray
    first_output: np.ndarray
    second_output: np.ndarray


def low_pass(
    filters: LowPass, times: np.ndarray, rest: np.ndarray, rate_of: np.ndarray | None = None, state: FilterState | None = None
) -> tuple[np.ndarray, FilterState]:
    """Filter ``d/dt(rate_of) - rest`` (or ``-rest``) from the zero state at the first sample.

    Both filters are integrated by the trapezoidal rule, so that with ``c = l dt / 2``

        y_k = ((1 - c) y_{k-1} + l (P_k - P_{k-1}) - c (Q_k + Q_{k-1})) / (1 + c)

    which is ``l (P - (P)_l - e^{-lt} P(0)) - (Q)_l`` of [Liu1998]_ equation 14, start included: the same zero
    state on both sides of the equation, hence nothing to discard.

    Parameters
    ----------
    filters
        The two bandwidths.
    times
        (N,) [s], may be uneven.
    rest, rate_of
        Q and P, (N, columns).
    state
        As returned for the piece before; None at the start of a recording.

    Returns
    -------
    filtered
        (N, columns).
    state
        For the next piece.
    """
    rest = np.ascontiguousarray(rest, float)
    moving = rate_of is not None
    rate = np.ascontiguousarray(rate_of, float) if moving else rest[:, :0]
    if state is None:
        zero = np.zeros(rest.shape[1])
        state = FilterState(times[0], rate[0].copy() if moving else zero, rest[0].copy(), zero, zero.copy())
    first, second = state.first_output.copy(), state.second_output.copy()
    out = np.empty_like(rest)
    _low_pass(
        filters.l, filters.d, times, state.last_time, rate, state.last_rate, rest, state.last_rest, first, second, moving, out
    )
    return out, FilterState(times[-1], rate[-1].copy() if moving else state.last_rate, rest[-1].copy(), first, second)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _low_pass(l, d, times, last_time, rate, last_rate, rest, last_rest, first, second, moving, out):  # noqa: E741
    for k in range(len(times)):
        step = times[k] - (last_time if k == 0 else times[k - 1])
        c, e = 0.5 * l * step, 0.5 * d * step
        for m in range(rest.shape[1]):
            before = last_rest[m] if k == 0 else rest[k - 1, m]
            change = -0.5 * step * (rest[k, m] + before)
            if moving:
                change += rate[k, m] - (last_rate[m] if k == 0 else rate[k - 1, m])
            y = ((1.0 - c) * first[m] + l * change) / (1.0 + c)
            second[m] = ((1.0 - e) * second[m] + e * (y + first[m])) / (1.0 + e)
            first[m] = y
            out[k, m] = second[m]


#: Roll-off of the projection's kernel and half its length in rows.
ROLL_OFF = 0.5
HALF_WIDTH = 5


def project(times: np.ndarray, values: np.ndarray, start: float, step: float, first: int, out: np.ndarray, energy: np.ndarray):
    """Add samples to the rows of a band: shifted root-raised-cosine kernels, which are orthonormal.

    White noise of standard deviation s on evenly spaced samples therefore stays white with the same s, and
    signals below ``(1 - ROLL_OFF) / (2 step)`` keep their energy. Where a kernel reaches over an end of the
    recording it is cut off; divide every row by the root of its energy. As both sides of an equation are
    treated alike, none of this biases an estimate.

    Parameters
    ----------
    times, values
        Samples (N,) [s] and (N, ...).
    start, step
        Centre of row 0 and distance of rows [s].
    first
        Index of the row that ``out[0]`` holds.
    out, energy
        Rows (k, ...) and sums of squared weights (k,), added to in place; contributions to rows outside are
        dropped.
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


def row_noise_poles(filters: LowPass, sample_step: float, row_step: float) -> np.ndarray:
    """Poles of a recursion that white sensor noise obeys once it has become filtered rows.

    Beside the filters' own two poles the rows' spectrum bears the mark of thinning: bilinear filters at the
    sampling rate, times the projection's raised cosine, folded at the rate of rows. That is known, so it need
    not be learned from few rows, and costs no parameters of the noise.

    Parameters
    ----------
    filters
        The two low-passes.
    sample_step, row_step
        Time between samples and between rows [s].
    """
    poles = filters.poles(row_step)
    cycles = np.arange(_SPECTRUM) / _SPECTRUM - 0.5  # per row
    density = np.zeros(_SPECTRUM)
    for fold in (-1, 0, 1):
        f = cycles + fold
        # Raised cosine: 1 up to (1 - ROLL_OFF) / 2, 0 from (1 + ROLL_OFF) / 2.
        inside = np.cos(0.5 * np.pi * np.clip((np.abs(f) - 0.5 * (1 - ROLL_OFF)) / ROLL_OFF, 0.0, 1.0)) ** 2
        warped = (2.0 / sample_step * np.tan(np.pi * f * sample_step / row_step)) ** 2
        density += inside / ((1.0 + warped / filters.l**2) * (1.0 + warped / filters.d**2))
    turn = np.exp(2j * np.pi * cycles)
    density *= np.prod(np.abs(1.0 - poles[:, None] / turn) ** 2, axis=0)
    covariance = np.real(np.fft.ifft(np.fft.ifftshift(density)))
    lag = np.arange(_THINNING_ORDER)
    rest = np.linalg.solve(covariance[np.abs(lag[:, None] - lag)], -covariance[1 : _THINNING_ORDER + 1])
    return np.concatenate([poles, np.roots(np.append(1.0, rest))])
