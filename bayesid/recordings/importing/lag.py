"""By how much one course is later than another of the same quantity: cross-correlation, with its uncertainty."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_LONGEST, _STEP = 0.5, 0.005  # of the lags that are tried [s]
_SHARE = 0.1  # of the recording, at most
_SAMPLES, _FEWEST = 20_000, 200
_STEPS = 5  # of Gauss and Newton, from the best lag that was tried
#: Share of its variation up to which the later course may differ from the other: beyond, they are not the same quantity.
_ALIKE = 0.5

#: A course and its rate at times (m,): both (m, k).
Course = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def lag(times: np.ndarray, values: np.ndarray, course: Course, first: float, last: float) -> tuple[float, float] | None:
    """The lag d that minimises ``sum |values(t) - course(t - d) - offset|^2``, where their cross-correlation is largest.

    Parameters
    ----------
    times, values
        Of the course that may be late (N,) [s], (N, k).
    course
        The other, and its rate.
    first, last
        When the other begins and ends [s].

    Returns
    -------
    lag, std
        [s]; None where the two have too little in common, or the recording is too short. With s the rate of the other course
        and e what is left, ``var d = var(sum s e) / (sum s^2)^2``, in which what is left may be correlated over time.
    """
    longest = min(_LONGEST, _SHARE * (last - first))
    rows = np.flatnonzero((times >= first + longest) & (times <= last - longest))
    rows = rows[:: max(len(rows) // _SAMPLES, 1)]
    if len(rows) < _FEWEST:
        return None
    t, y = times[rows], values[rows] - values[rows].mean(axis=0)

    def left(d: float) -> tuple[np.ndarray, np.ndarray]:
        there, rate = course(t - d)
        return y - there + there.mean(axis=0), rate - rate.mean(axis=0)

    tried = np.arange(-longest, longest + 0.5 * _STEP, _STEP)
    power = [float((left(d)[0] ** 2).sum()) for d in tried]
    best = int(np.argmin(power))
    if not 0 < best < len(tried) - 1 or power[best] > _ALIKE**2 * float((y**2).sum()):
        return None
    d = float(tried[best])
    for _ in range(_STEPS):
        e, s = left(d)
        d -= float((s * e).sum() / (s**2).sum())
    e, s = left(d)
    variance = sum(_variance(*columns) for columns in zip(s.T, e.T, strict=True))
    return d, float(np.sqrt(variance) / (s**2).sum())


def _variance(s: np.ndarray, e: np.ndarray) -> float:
    """Variance of ``sum s e`` for a known s (N,) and noise as correlated over time as e (N,): ``sum_l R_s(l) g(l)``.

    R_s(l) is the sum of ``s(t) s(t + l)``, g(l) the autocovariance of e up to the lag at which it is first not positive.
    """
    size = 2 * len(e)
    products, covariance = (np.fft.irfft(np.abs(np.fft.rfft(x - x.mean(), size)) ** 2, size)[: len(e)] for x in (s, e))
    end = int(np.argmax(covariance <= 0.0)) or len(e)
    covariance = covariance[:end] / np.arange(len(e), len(e) - end, -1)
    return float(covariance[0] * products[0] + 2.0 * covariance[1:] @ products[1:end])
