"""Quantities of several topics at common times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError
from bayesid.recordings.importing.signals import Signal
from bayesid.recordings.table import GAP

#: A topic that is this many times as fast as the rows is averaged over a row's step, so that no noise is folded down.
_FASTER = 1.5
_ALIKE = 1.1  # rates that count as equal
_READINGS = ("tau", "wrench")


@dataclass(frozen=True, eq=False)
class Joined:
    """Everything of a recording at common times.

    Attributes
    ----------
    times
        (N,) [s].
    values
        (N, k) by quantity, in the order of the signals' columns.
    ours
        Names of the columns (k,) by quantity.
    base
        The signal whose times these are.
    how
        What was done to each other signal, one line each; empty where nothing was.
    """

    times: np.ndarray
    values: dict[str, np.ndarray]
    ours: dict[str, tuple[str, ...]]
    base: Signal
    how: tuple[str, ...]


def join(signals: Sequence[Signal], source: str) -> Joined:
    """Bring all signals to the times of the slowest of positions and readings; what shares those times stays as it is.

    Others are interpolated by cubic splines, readings of a faster topic averaged over a row's step. Nothing is filled in
    across a gap or beyond an end: such rows are left out.

    Raises
    ------
    InputError
        Topics do not overlap in time.
    """
    candidates = [s for s in signals if s.quantity in ("q", *_READINGS) and len(s.times) > 1]
    if not candidates:
        raise InputError("has a single row", file=source, remedy="give a recording of many")
    slowest = max(s.step for s in candidates)
    base = next(s for s in sorted(candidates, key=lambda s: s.quantity not in _READINGS) if s.step * _ALIKE >= slowest)
    shared = [_same_times(s, base) for s in signals]
    inside = np.ones(len(base.times), bool)
    columns: dict[str, list[np.ndarray]] = {}
    ours: dict[str, tuple[str, ...]] = {}
    how = []
    for signal, same in zip(signals, shared, strict=True):
        if same:
            values = signal.values
        else:
            values, there, text = _brought(signal, base)
            inside &= there
            how.append(text)
        columns.setdefault(signal.quantity, []).append(values)
        ours[signal.quantity] = (*ours.get(signal.quantity, ()), *signal.ours)
    if not inside.any():
        spans = "; ".join(f"{s.called} from {s.times[0]:.6g} to {s.times[-1]:.6g} s" for s in signals)
        raise InputError(
            f"topics do not overlap in time: {spans}",
            file=source,
            remedy=f"are they on different clocks? try {argument('clock', 'log')}",
        )
    left = int(len(inside) - inside.sum())
    if left:
        how.append(f"{left} of {len(inside)} rows are left out, in which a topic has a gap, has not begun or has ended")
    values = {quantity: np.column_stack(parts)[inside] for quantity, parts in columns.items()}
    return Joined(base.times[inside], values, ours, base, tuple(how))


def _same_times(one: Signal, other: Signal) -> bool:
    return len(one.times) == len(other.times) and np.array_equal(one.times, other.times, equal_nan=True)


def _brought(signal: Signal, base: Signal) -> tuple[np.ndarray, np.ndarray, str]:
    """A signal at the times of another: values (N, k), which rows it has them for (N,), and what was done."""
    rows = ~np.isnan(signal.values).any(axis=1)
    times, values, at = signal.times[rows], signal.values[rows], base.times
    if len(times) < 2:
        return np.full((len(at), values.shape[1]), np.nan), np.zeros(len(at), bool), f"{signal.called}: a single sample"
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    there = (at >= times[0]) & (at <= times[-1]) & (times[right] - times[right - 1] <= GAP * signal.step)
    ratio = base.step / signal.step
    if signal.quantity in _READINGS and ratio >= _FASTER:
        half = 0.5 * base.step
        low, high = np.maximum(at - half, times[0]), np.minimum(at + half, times[-1])
        width = np.where(there, high - low, 1.0)[:, None]
        mean = (_integral(times, values, high) - _integral(times, values, low)) / width
        return mean, there, f"{signal.called}: mean over {1e3 * base.step:.3g} ms about each row ({ratio:.3g} samples)"
    return _interpolated(times, values, at, signal.step), there, f"{signal.called}: interpolated (cubic splines)"


def _interpolated(times: np.ndarray, values: np.ndarray, at: np.ndarray, step: float) -> np.ndarray:
    """Values (N, k) at other times, each piece between gaps by its own spline."""
    from scipy.interpolate import CubicSpline  # takes longer to import than most logs take to read

    edges = np.concatenate([[0], np.flatnonzero(np.diff(times) > GAP * step) + 1, [len(times)]])
    out = np.full((len(at), values.shape[1]), np.nan)
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        piece = slice(first, last)
        rows = (at >= times[first]) & (at <= times[last - 1])
        if rows.any():
            out[rows] = CubicSpline(times[piece], values[piece])(at[rows]) if last - first > 1 else values[first]
    return out


def _integral(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Integral of values (N, k) from the first time on, straight between samples, up to other times."""
    steps, rise = np.diff(times)[:, None], np.diff(values, axis=0)
    whole = np.vstack([np.zeros(values.shape[1]), np.cumsum(0.5 * (values[1:] + values[:-1]) * steps, axis=0)])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    dt = (at - times[k])[:, None]
    return whole[k] + values[k] * dt + 0.5 * (rise[k] / steps[k]) * dt**2
