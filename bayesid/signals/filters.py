"""The filters applied alike to regressors and measurements.

Any linear operation applied to both sides of ``w = Y phi`` keeps the equation exact. Two are used: the paper's two
first-order low-passes [Liu1998]_ here, which also turn ``d/dt (P phi) - Q phi`` into something that needs no
accelerations, and the projection onto the motion's band (`bayesid.signals.projection`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from bayesid.argument_types import explains_types
from bayesid.errors import InputError
from bayesid.signals.projection import ROLL_OFF

#: Bandwidths that a recording can tell from none, and from no filter [rad/s].
_SLOWEST, _FASTEST = 1e-6, 1e9

#: Frequencies at which the spectrum of rows is computed; order of the recursion that stands for thinning.
_SPECTRUM = 4096
_THINNING_ORDER = 8


@explains_types
@dataclass(frozen=True)
class LowPass:
    """Two first-order low-passes in series, ``l / (l + s) * d / (d + s)``, of unit gain at zero frequency.

    Attributes
    ----------
    l, d
        Bandwidths [rad/s]; the paper used l = 1, d = 50.
    """

    l: float
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

    Times (N,) [s] may be uneven; ``rest`` and ``rate_of`` are Q and P, (N, columns). ``state`` is as returned for the piece
    before, None at the start of a recording. Returned are the filtered columns (N, columns) and the state for the next piece.
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
def _low_pass(l, d, times, last_time, rate, last_rate, rest, last_rest, first, second, moving, out):
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


def row_noise_poles(filters: LowPass, sample_step: float, row_step: float) -> np.ndarray:
    """Poles of a recursion that white sensor noise obeys once it has become filtered rows, from the steps of both [s].

    Beside the filters' own two poles the rows' spectrum bears the mark of thinning: bilinear filters at the sampling rate,
    times the projection's raised cosine, folded at the rate of rows. That is known, so it need not be learned from few rows,
    and costs no parameters of the noise.
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
