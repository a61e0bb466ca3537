"""Times of a log, of whatever kind, as seconds.

A course that is later than another of the same quantity is so by the lag of their cross-correlation, with its uncertainty.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError
from bayesid.recordings.complaints import cut
from bayesid.recordings.importing.stream import Stream
from bayesid.recordings.table import LONGEST_STEP

_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_DATES = (3e8, 1e10)  # seconds since 1970, of computers' dates
_LONGEST, _STEP = 0.5, 0.005  # of the lags that are tried [s]
_SHARE = 0.1  # of the recording, at most
_SAMPLES, _FEWEST = 20_000, 200
_STEPS = 5  # of Gauss and Newton, from the best lag that was tried
#: Share of its variation up to which the later course may differ from the other: beyond, they are not the same quantity.
_ALIKE = 0.5

#: A course and its rate at times (m,): both (m, k).
Course = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class RowTimes:
    """Times of a stream's rows."""

    kind: str  # ``header``, ``log``, ``column``, or ``rows`` where these are counted
    text: str  # in words
    times: np.ndarray  # (N,) [s] since `start`; NaN where a row has none
    start: int | None  # [ns since 1970]; None for a clock that counts from somewhere else
    #: How much later than the header's stamps the log's times are, median and its spread (half of the middle 68 %) [s]; None
    #: where there are not both.
    late: tuple[float, float] | None = None
    column: str = ""  # the table's, where it is one
    notes: tuple[str, ...] = ()  # what was noticed, one line each

    def since(self, start: int) -> RowTimes:
        """The same with times since another instant [ns since 1970]."""
        if self.start is None or self.start == start:
            return self
        return replace(self, times=self.times + (self.start - start) / 1e9, start=start)


def topic_clock(stream: Stream, wanted: str | None, source: str) -> RowTimes:
    """The clock of a topic: stamps of headers, unless there are none that count, or log times are wanted."""
    log, header = stream.clocks["log"], stream.clocks.get("header")
    usable = header is not None and len(header) > 1 and len(np.unique(header)) > 0.5 * len(header) and bool((header > 0).all())
    kind, text, times, late, notes = "log", "times of the log", log, None, ()
    if header is not None and usable:
        if header[0] > _DATES[0] * 1e9:  # a simulation's clock begins at zero, and is no later or earlier than the log
            low, middle, high = np.quantile((log - header) / 1e9, [0.16, 0.5, 0.84])
            late = float(middle), float(0.5 * (high - low))
        if wanted != "log":
            kind, text, times = "header", "stamps of headers", header
    else:
        what = "messages have no header" if header is None else "stamps of headers are zero or stand still"
        if wanted == "header":
            raise InputError(what, file=source, key=stream.name, remedy=f"use the times of the log ({argument('clock', 'log')})")
        notes = () if header is None else (f"{stream.name}: {what}; times of the log are used",)
    return RowTimes(kind, text, (times - times[0]) / 1e9, int(times[0]), late, notes=notes)


def table_clock(stream: Stream, column: str, unit: str | None, source: str, poses: bool = False) -> RowTimes:
    """The clock of a table: numbers of a unit, counted from anywhere or since 1970, or dates as ISO 8601 texts.

    What would be a date with steps that are too long for a trajectory is none, unless rows are separate ``poses``.
    """
    values = stream.columns[column]
    name = f'column "{cut(column)}"'
    if values.dtype.kind == "m":  # durations, whose unit is known
        seconds = np.where(np.isnat(values), np.nan, values / np.timedelta64(1, "s"))
        return RowTimes("column", f"{name} (durations)", seconds, None, column=column)
    if values.dtype.kind not in "fiubM" and unit != "iso":
        with contextlib.suppress(TypeError, ValueError):  # numbers as texts
            values = values.astype(np.float64)
    if values.dtype.kind not in "fiubM" or unit == "iso":
        values = _dates(values, column, source)
    if values.dtype.kind == "M":
        ns = values.astype("datetime64[ns]")
        missing, counts = np.isnat(ns), ns.astype(np.int64)
        start = int(counts[~missing][0]) if not missing.all() else 0
        times = np.where(missing, np.nan, (counts - start) / 1e9)
        return RowTimes("column", f"{name} (dates)", times, start, column=column)
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    if not len(finite):
        raise InputError(
            "no times in any row", file=source, key=name, remedy=f"name the column of times ({argument('columns')} t=NAME)"
        )
    first = float(finite[0])
    if unit is None:  # a number that is the date of a computer in one unit is in no other
        step = float(np.median(np.abs(np.diff(finite)))) if len(finite) > 1 and not poses else 0.0
        dates = (u for u, per in _PER_SECOND.items() if _DATES[0] < first / per < _DATES[1] and step < LONGEST_STEP * per)
        unit = next(dates, "s")
    per = _PER_SECOND[unit]
    if not _DATES[0] < first / per < _DATES[1]:
        times = values.astype(np.float64) / per
        return RowTimes("column", f"{name} in {_WORDS[unit]}", times, None, column=column)
    start = int(np.floor(first))  # of whole units, so that what is left is exact
    # Whole numbers have digits that floating point lacks; those without a sign cannot go below the start.
    times = (values.astype(np.float64 if values.dtype.kind == "f" else np.int64) - start) / per
    return RowTimes("column", f"{name} in {_WORDS[unit]} since 1970", times, start * (10**9 // per), column=column)


def row_clock(rows: int, rate: float | None) -> RowTimes:
    """The clock of a table without times: rows at a rate [Hz] that is stated, or poses, whose times only number them."""
    text = "poses by their number" if rate is None else f"rows counted, at {rate:g} Hz as stated"
    return RowTimes("rows", text, np.arange(rows) / (rate or 1.0), None)


def date(ns: int | None) -> str | None:
    """An instant [ns since 1970] as ISO 8601 to the millisecond; None where it is none of a computer's date."""
    if ns is None or ns < _DATES[0] * 1e9:
        return None
    return datetime.fromtimestamp(ns / 1e9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _dates(values: np.ndarray, column: str, source: str) -> np.ndarray:
    import pandas as pd

    given = pd.Series(values)
    try:
        dates = pd.to_datetime(given.astype(str).where(given.notna()), utc=True, format="ISO8601", errors="coerce")
    except (ValueError, OverflowError, TypeError):
        dates = pd.Series(pd.NaT, index=given.index, dtype="datetime64[ns, UTC]")
    wrong = np.flatnonzero((dates.isna() & given.notna()).to_numpy())
    if len(wrong):
        raise InputError(
            f'"{cut(str(values[wrong[0]]))}" is neither a number nor a date', file=source,
            key=f'column "{cut(column)}", row {int(wrong[0])}', value=str(values[wrong[0]]),
            remedy="write times as numbers or as 2026-01-31T12:00:00.000Z",
        )  # fmt: skip
    return dates.dt.tz_localize(None).to_numpy()


def lag(times: np.ndarray, values: np.ndarray, course: Course, first: float, last: float) -> tuple[float, float] | None:
    """The lag d that minimises ``sum |values(t) - course(t - d) - offset|^2``, and its standard deviation [s].

    ``times`` (N,) and ``values`` (N, k) are of the course that may be late; the other begins and ends at ``first`` and
    ``last``. None where the two have too little in common, or the recording is too short. With s the rate of the other course
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
