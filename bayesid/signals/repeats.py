"""Where a recording says the same thing twice: a motion that repeats itself or another one, and a robot standing still."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.optimize import fminbound

from bayesid.signals.arrays import runs

#: A repeat or a rest lasts this long [s] and a period this long [s], to tell low frequencies.
_SHORTEST, _SHORTEST_PERIOD = 3.0, 1.5
#: Positions repeat if no joint is off by more than this share of its range, nor by more than so many times the median.
_SAME_POSITION, _SETTLED = 0.005, 4.0
#: What repeats must move one joint by this share of its range.
_MOVES = 0.2
#: Normalised distance below which a lag is looked at closely, how many lags are, and the rate of comparison [Hz].
_NEAR, _LAGS, RATE = 0.5, 6, 25.0
#: A joint stands still if its encoder stays within this [rad or m] for this long [s], or within a few counts.
_STILL_TRAVEL, _STILL_TIME = 5e-4, 0.5
#: What may ring after a stop is left out [s]: half of the time for standing still, by which a window that wide ends a rest early,
#: once more.
_RINGING = 0.25


@dataclass(frozen=True, eq=False)
class Repeat:
    """The same positions twice."""

    #: Indices of the segments; the same one for a periodic motion.
    first: int
    second: int
    lag: float  # of the second against the first, a number of seconds
    #: Times of the first [s].
    start: float
    end: float


Course = tuple[np.ndarray, np.ndarray]


def find_repeats(courses: Sequence[Course], counts: np.ndarray) -> list[Repeat]:
    """Where motions repeat themselves or an earlier one, by courses at `RATE` and one encoder count a joint (n,) [rad or m]."""
    if not courses:
        return []
    span = np.max([np.ptp(q, axis=0) for _, q in courses], axis=0)
    tolerance = np.maximum(_SAME_POSITION * span, 2.0 * counts)
    found: list[Repeat] = []
    for b, mine in enumerate(courses):
        own = _repeat(mine, mine, tolerance, span, _SHORTEST_PERIOD)
        if own:
            found.append(Repeat(b, b, *own))
            continue
        for a in range(b):
            other = _repeat(courses[a], mine, tolerance, span, -np.inf)
            if other and not any(r.first == a and r.second != a for r in found):
                found.append(Repeat(a, b, *other))
                break
    return found


def _repeat(
    first: Course, second: Course, tolerance: np.ndarray, span: np.ndarray, shortest: float
) -> tuple[float, float, float] | None:
    """Lag, start and end of the longest time in which the second course repeats the first; None if there is none."""
    best: tuple[float, float, float] | None = None
    for lag in _near(first[1], second[1], span, shortest):
        found = _same(first, second, lag + second[0][0] - first[0][0], tolerance, span)
        if found and (best is None or found[2] - found[1] > 1.25 * (best[2] - best[1])):
            best = found
    return best


def _near(a: np.ndarray, b: np.ndarray, span: np.ndarray, shortest: float) -> Iterator[float]:
    """Lags [s] of local minima of the normalised distance between courses (M, n), (L, n), by size."""
    moves = span > 0
    size = np.maximum(np.std(np.vstack([a, b]), axis=0)[moves], 1e-12)
    a, b = (a[:, moves] - a[:, moves].mean(axis=0)) / size, (b[:, moves] - a[:, moves].mean(axis=0)) / size
    if not moves.any():
        return
    total = next_fast_len(len(a) + len(b))
    transform = [np.fft.rfft(x, total, axis=0) for x in (a, b, np.ones((len(a), 1)), np.ones((len(b), 1)))]
    squares = [np.fft.rfft(np.sum(x**2, axis=1)[:, None], total, axis=0) for x in (a, b)]

    def across(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.fft.irfft(np.sum(x.conj() * y, axis=1), total)

    # sum over t of |b(t + k) - a(t)|^2, and over how many samples.
    distance = across(squares[0], transform[3]) + across(transform[2], squares[1]) - 2.0 * across(transform[0], transform[1])
    lags = np.concatenate([np.arange(1 - len(a), 0), np.arange(len(b))])
    count = np.maximum(np.round(across(transform[2], transform[3]))[lags], 1.0)
    distance = np.sqrt(np.maximum(distance[lags], 0.0) / count / moves.sum())
    allowed = (count >= _SHORTEST * RATE) & (lags >= shortest * RATE)
    low = np.full(len(lags), False)
    low[1:-1] = (distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])
    chosen = np.flatnonzero(low & allowed & (distance < _NEAR))
    order = chosen[np.argsort(np.abs(lags[chosen]), kind="stable")][:_LAGS]
    yield from lags[order] / RATE


def _same(
    first: Course, second: Course, lag: float, tolerance: np.ndarray, span: np.ndarray
) -> tuple[float, float, float] | None:
    """Exact lag, start and end of the longest segment of time in which positions are the same within a tolerance (n,)."""
    course = CubicSpline(*second)

    def off(shift: float) -> tuple[np.ndarray, np.ndarray]:
        inside = (first[0] + shift >= second[0][0]) & (first[0] + shift <= second[0][-1])
        return inside, np.max(np.abs(course(first[0][inside] + shift) - first[1][inside]) / tolerance.clip(1e-12), axis=1)

    # The median: a transient at the start or the end must not decide.
    step = 1.5 / RATE
    exact = float(fminbound(lambda x: float(np.median(off(x)[1])), lag - step, lag + step, xtol=1e-5, full_output=True)[0])
    inside, distance = off(exact)
    times = first[0][inside]
    # A motion that settles into its period is still on its way there while it is off by much more than later.
    limit = min(1.0, max(_SETTLED * float(np.median(distance)), 0.1)) if len(times) else 1.0
    longest = max(runs(distance < limit), key=lambda r: r[1] - r[0], default=(0, 0))
    if longest[1] - longest[0] < _SHORTEST * RATE:
        return None
    part = first[1][inside][slice(*longest)]
    if not np.any(np.ptp(part, axis=0) > _MOVES * np.maximum(span, 1e-12)):
        return None
    return exact, float(times[longest[0]]), float(times[longest[1] - 1])


def find_rests(times: np.ndarray, encoders: np.ndarray, counts: np.ndarray) -> list[tuple[float, float]]:
    """Times [s] in which no joint moves for three seconds at least, less what may still ring at both ends."""
    size = max(int(_STILL_TIME / np.median(np.diff(times))), 2)
    travel = maximum_filter1d(encoders, size, axis=0) - minimum_filter1d(encoders, size, axis=0)
    rests = runs(np.all(travel <= np.maximum(2.5 * counts, _STILL_TRAVEL), axis=1))
    # A filter of this width ends a rest half its width early; ringing is given as long again.
    ends = [(times[i] + _RINGING, times[j - 1] - _RINGING) for i, j in rests]
    return [(float(a), float(b)) for a, b in ends if b - a >= _SHORTEST]
