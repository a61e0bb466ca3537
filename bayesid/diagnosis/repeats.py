"""Where a recording says the same thing twice: a motion that repeats itself or another one, and a robot standing still."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.optimize import fminbound

from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.spectra import Segment


@dataclass(frozen=True, eq=False)
class Repeat:
    """The same positions twice.

    Attributes
    ----------
    first, second
        Indices of the segments; the same one for a periodic motion.
    lag
        Of the second against the first, a number of seconds.
    start, end
        Times of the first [s].
    """

    first: int
    second: int
    lag: float
    start: float
    end: float


def find_repeats(segments: Sequence[Segment], counts: np.ndarray) -> list[Repeat]:
    """Where moving segments repeat themselves or an earlier one.

    Parameters
    ----------
    segments
        Recordings of motions.
    counts
        One encoder count by joint (n,) [rad or m].
    """
    if not segments:
        return []
    settings = segments[0].settings
    courses = [_course(s, settings) for s in segments]
    span = np.max([np.ptp(q, axis=0) for _, q in courses], axis=0)
    tolerance = np.maximum(settings.same_position * span, 2.0 * counts)
    found: list[Repeat] = []
    for b, mine in enumerate(courses):
        own = _repeat(mine, mine, tolerance, span, settings.shortest_period, settings)
        if own:
            found.append(Repeat(b, b, *own))
            continue
        for a in range(b):
            other = _repeat(courses[a], mine, tolerance, span, -np.inf, settings)
            if other and not any(r.first == a and r.second != a for r in found):
                found.append(Repeat(a, b, *other))
                break
    return found


def _course(segment: Segment, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Positions on an even grid of `Settings.repeat_rate` (M,), (M, n)."""
    times = np.arange(segment.times[0], segment.times[-1], 1.0 / settings.repeat_rate)
    inner = np.clip(times, segment.scene.times[0], segment.scene.times[-1])
    return times, CubicSpline(segment.scene.times, segment.scene.positions)(inner)


def _repeat(
    first: tuple[np.ndarray, np.ndarray],
    second: tuple[np.ndarray, np.ndarray],
    tolerance: np.ndarray,
    span: np.ndarray,
    shortest: float,
    settings: Settings,
) -> tuple[float, float, float] | None:
    """Lag, start and end of the longest time in which the second course repeats the first; None if there is none."""
    best: tuple[float, float, float] | None = None
    for lag in _near(first[1], second[1], span, shortest, settings):
        found = _same(first, second, lag + second[0][0] - first[0][0], tolerance, span, settings)
        if found and (best is None or found[2] - found[1] > 1.25 * (best[2] - best[1])):
            best = found
    return best


def _near(a: np.ndarray, b: np.ndarray, span: np.ndarray, shortest: float, settings: Settings) -> Iterator[float]:
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
    allowed = (count >= settings.shortest_repeat * settings.repeat_rate) & (lags >= shortest * settings.repeat_rate)
    low = np.full(len(lags), False)
    low[1:-1] = (distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])
    chosen = np.flatnonzero(low & allowed & (distance < settings.near_lag))
    order = chosen[np.argsort(np.abs(lags[chosen]), kind="stable")][: settings.lags]
    yield from lags[order] / settings.repeat_rate


def _same(
    first: tuple[np.ndarray, np.ndarray],
    second: tuple[np.ndarray, np.ndarray],
    lag: float,
    tolerance: np.ndarray,
    span: np.ndarray,
    settings: Settings,
) -> tuple[float, float, float] | None:
    """Exact lag, start and end of the longest segment of time in which positions are the same within a tolerance (n,)."""
    course = CubicSpline(*second)

    def off(shift: float) -> tuple[np.ndarray, np.ndarray]:
        inside = (first[0] + shift >= second[0][0]) & (first[0] + shift <= second[0][-1])
        return inside, np.max(np.abs(course(first[0][inside] + shift) - first[1][inside]) / tolerance.clip(1e-12), axis=1)

    # The median: a transient at the start or the end must not decide.
    step = 1.5 / settings.repeat_rate
    exact = float(fminbound(lambda x: float(np.median(off(x)[1])), lag - step, lag + step, xtol=1e-5, full_output=True)[0])
    inside, distance = off(exact)
    times = first[0][inside]
    # A motion that settles into its period is still on its way there while it is off by much more than later.
    limit = min(1.0, max(settings.settled_ratio * float(np.median(distance)), 0.1)) if len(times) else 1.0
    longest = max(_runs(distance < limit), key=lambda r: r[1] - r[0], default=(0, 0))
    if longest[1] - longest[0] < settings.shortest_repeat * settings.repeat_rate:
        return None
    part = first[1][inside][slice(*longest)]
    if not np.any(np.ptp(part, axis=0) > settings.repeat_moves * np.maximum(span, 1e-12)):
        return None
    return exact, float(times[longest[0]]), float(times[longest[1] - 1])


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and one past the last index of every run of true flags (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(i), int(j)) for i, j in zip(edges[::2], edges[1::2], strict=True)]


def find_rests(times: np.ndarray, encoders: np.ndarray, counts: np.ndarray, settings: Settings) -> list[tuple[float, float]]:
    """Times [s] in which no joint moves for `Settings.shortest_repeat` at least, less what may still ring at both ends.

    Parameters
    ----------
    times, encoders
        (N,) [s], (N, n) [rad or m].
    counts
        One encoder count by joint (n,).
    settings
        The thresholds.
    """
    size = max(int(settings.still_time / np.median(np.diff(times))), 2)
    travel = maximum_filter1d(encoders, size, axis=0) - minimum_filter1d(encoders, size, axis=0)
    rests = _runs(np.all(travel <= np.maximum(2.5 * counts, settings.still_travel), axis=1))
    # A filter of this width ends a rest half its width early; ringing is given as long again.
    ends = [(times[i] + settings.ringing, times[j - 1] - settings.ringing) for i, j in rests]
    return [(float(a), float(b)) for a, b in ends if b - a >= settings.shortest_repeat]
