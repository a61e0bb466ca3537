"""What a recording holds in SI units, each quantity at its own times."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, is_number, listed
from bayesid.recordings.importing.clock import RowTimes
from bayesid.recordings.importing.column_map import (
    NEED_CONSTANT,
    UNITS,
    ColumnMap,
    foreign_unit,
    quantity_of,
    unit_of_joint,
)
from bayesid.recordings.importing.found_columns import FoundColumn, Layout
from bayesid.recordings.importing.stream import Stream
from bayesid.recordings.motion_checks import TURN, Timing, rows_held, rows_without_stalls, wraps
from bayesid.recordings.table import GAP, WRENCH_COLUMNS, Table, check_increasing
from bayesid.recordings.toml_file import LARGEST

#: In a table of several topics, a quantity without a reading in most rows has its own, slower times.
_OWN_TIMES = 0.5
_SET_BACK = 0.5  # a message that is so much earlier than the one before is late in no transport [s]
_JUDGED = 200_000  # rows that are looked at for repeated samples
_REGULAR = 0.9  # share of held positions with a single velocity of which the velocities are differences
_SAID = {"q": "positions", "v": "velocities", "qr": "positions", "tau": "torques", "f": "forces", "m": "moments"}
#: What is said of rows that are left out, with how many of how many, and of what.
STALLED = (
    "{} of {} rows{} repeat the row before in positions and readings while the robot moves, old samples at the times of new "
    "ones; left out"
)
NAMES = {"q": "positions", "v": "velocities", "qr": "commands", "tau": "torques", "wrench": "wrench"}


@dataclass(frozen=True, eq=False)
class Signal:
    """Columns of one quantity that were recorded together."""

    quantity: str  # a key of `NAMES`
    ours: tuple[str, ...]  # ``q1``, ... or ``fx``, ... (k,)
    #: (N,) [s] and (N, k) in SI units; NaN where a row of the log has no reading.
    times: np.ndarray
    values: np.ndarray
    columns: tuple[str, ...]  # the log's names (k,)
    units: tuple[str, ...]  # those that it was written in (k,)
    scales: tuple[float, ...]  # stated factors that it was multiplied with after its unit (k,); 1 where none is
    topic: str  # the stream's name; empty for a table
    clock: RowTimes  # of its stream
    recorded: int  # rows of the stream that have a reading, repeated ones and those of a time that was there before included
    held: float = 1.0  # how many rows of the log hold each sample; 1 where every row is a sample

    @property
    def name(self) -> str:
        """What the signal is, in words."""
        return NAMES[self.quantity]

    @property
    def called(self) -> str:
        """What the signal is, in words, with its topic."""
        return f"{self.name} of {self.topic}" if self.topic else self.name

    @property
    def step(self) -> float:
        """Usual time between samples [s]; 0 for a single one."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0

    @property
    def timing(self) -> Timing | None:
        """How even its times are; None for fewer than three samples."""
        if len(self.times) < 3:
            return None
        return Timing.of(Table(times=self.times, positions=np.zeros((len(self.times), 1))))

    def unwrapped(self) -> tuple[np.ndarray, np.ndarray, bool]:
        """Times (m,) and values (m, k) of the rows with a reading, angles without wraps at a turn, and whether there were any.

        What lies between two samples may be taken from these only: between those on either side of a wrap is a whole turn.
        """
        rows = ~np.isnan(self.values).any(axis=1)
        times, values = self.times[rows], self.values[rows]
        if self.quantity not in ("q", "qr"):
            return times, values, False
        turns = np.array([np.append(0.0, np.cumsum(wraps(times, column, self.step))) for column in values.T]).T
        return times, values - TURN * turns, bool(turns.any())

    def gaps(self) -> list[tuple[float, float]]:
        """Start and end of each gap [s]."""
        at = np.flatnonzero(np.diff(self.times) > GAP * self.step)
        return [(float(self.times[k]), float(self.times[k + 1])) for k in at]


def make_signals(
    layout: Layout,
    clocks: Sequence[tuple[Stream, RowTimes]],
    stated: ColumnMap,
    source: str,
    held: bool = True,
    sliding: Collection[str] = (),
) -> tuple[list[Signal], list[str]]:
    """Signals, one for the columns of a quantity in each stream, converted to SI units, and notes.

    ``held`` says whether rows that only repeat a sample are looked for, and left out; ``sliding`` are the joints that slide. An
    `InputError` where a cell is no number, a unit is none of the quantity or joint, or says nothing without a constant.
    """
    notes: list[str] = []
    groups: dict[tuple[str, int], list[FoundColumn]] = {}
    for found in layout.found:
        quantity = "wrench" if found.ours in WRENCH_COLUMNS else quantity_of(found.ours)
        groups.setdefault((quantity, id(found.stream)), []).append(found)
    signals = []
    for (quantity, _), found in groups.items():
        stream = found[0].stream
        clock = next(clock for one, clock in clocks if one is stream)
        converted = [_converted(f, stated, layout.joints, source, sliding) for f in found]
        columns, units, scales = zip(*converted, strict=True)
        notes += _renamed(found, stated)
        values = np.column_stack(columns)
        there = [k for k in range(len(found)) if not np.isnan(values[:, k]).all()]
        if len(there) < len(found):
            without = listed([f.column for k, f in enumerate(found) if k not in there], 4)
            if quantity == "q":
                raise InputError(
                    f"no position in any row of {without}", file=source, remedy=f"leave these joints out ({argument('joints')})"
                )
            if quantity != "tau" or not there:
                notes.append(f"{NAMES[quantity]}: no reading in any row of {without}; not used")
                continue
            notes.append(f"torques: no reading in any row of {without}")
            found, values = [found[k] for k in there], values[:, there]
            units, scales = (tuple(part[k] for k in there) for part in (units, scales))
        rows, more = _usable(clock, values, stream.name or "table", source)
        notes += more
        times = clock.times[rows]
        if shift := stated.shift.get(quantity, 0.0):
            times = times + shift
            notes.append(f"{NAMES[quantity]}: times shifted by {shift:g} s, as stated")
        signal = Signal(
            quantity, tuple(f.ours for f in found), times, values[rows],
            tuple(stream.full_name(f.column) for f in found), units, scales, stream.name, clock,
            int(np.count_nonzero(~np.isnan(values).any(axis=1))),
        )  # fmt: skip
        signals.append(signal)
    if held:
        signals, differences = _without_differences(signals)
        signals, stalled = _without_stalls([_without_held(s) for s in signals])
        notes += [*differences, *stalled]
    return signals, list(dict.fromkeys(notes))


def _renamed(found: Sequence[FoundColumn], stated: ColumnMap) -> list[str]:
    """That columns are read in another unit than their names state."""
    columns: dict[tuple[str, str], list[str]] = {}
    for f in found:
        unit = stated.unit(f.ours)
        if unit is not None and f.unit not in (None, unit):
            columns.setdefault((unit, str(f.unit)), []).append(cut(f.stream.full_name(f.column), 80))
    return [
        f"{listed(names, 4)}: read in {unit}, as stated, and not in the {other} of the name"
        for (unit, other), names in columns.items()
    ]


def resting(
    found: FoundColumn, stated: ColumnMap, joint: str, source: str, sliding: Collection[str]
) -> tuple[float, float] | None:
    """Where a joint that is not used stands, and how far it moves [rad or m]; None where it has no position.

    A unit stated for positions that is none of this joint's, which cannot be stated apart, does not hold for it.
    """
    unit = stated.units.get("q")
    unit = unit if unit_of_joint("q", unit, joint in sliding) else None
    like = ColumnMap(
        units={} if unit is None else {"q": unit}, scale={k: by for k, by in stated.scale.items() if k == "q"}, file=stated.file
    )
    values = _converted(replace(found, ours="q1"), like, [joint], source, sliding)[0]
    values = values[~np.isnan(values)]
    return (float(np.median(values)), float(np.ptp(values))) if len(values) else None


def _converted(
    found: FoundColumn, stated: ColumnMap, joints: Sequence[str], source: str, sliding: Collection[str]
) -> tuple[np.ndarray, str, float]:
    """A column in SI units, the unit that it was written in, and the factor that is stated for it."""
    quantity = quantity_of(found.ours)
    raw = found.stream.columns[found.column]
    place = f'column "{cut(found.stream.full_name(found.column), 80)}"'
    wrong = partial(InputError, file=source, remedy="correct it, or leave the cell empty")
    try:
        values = raw.astype(np.float64)
    except (TypeError, ValueError):
        row, text = next((k, str(cell)) for k, cell in enumerate(raw) if not is_number(cell))
        raise wrong(f'"{cut(text)}" is no number', key=f"{place}, row {row}", value=text) from None
    for row in np.flatnonzero(np.isinf(values) | (np.abs(values) > LARGEST))[:1].tolist():
        raise wrong(f"{values[row]:g} is no reading", key=f"{place}, row {row}", value=float(values[row]))
    unit = stated.unit(found.ours) or found.unit
    joint = joints[int(found.ours.removeprefix(quantity)) - 1] if found.ours not in WRENCH_COLUMNS else ""
    scale = stated.factor(found.ours, joint)
    if unit is not None and unit in NEED_CONSTANT and scale is None:
        raise InputError(
            f"torques in {unit} say nothing without a constant", file=stated.file or source,
            key=f"units {found.ours}", value=unit,
            remedy=f"write N m per {unit} at the joint, {argument('scale')} {joint}=11.2",
        )  # fmt: skip
    ours, used = (unit_of_joint(quantity, given, joint in sliding) for given in (None, unit))
    if unit is None and scale is None and (other := foreign_unit(quantity, found.column)):
        remedy = f"say what they are ({argument('units')} {found.ours}={ours}, or a factor, {argument('scale')} {found.ours}=...)"
        raise InputError(f"{other} is no unit of {_SAID[quantity]}", file=source, key=place, value=other, remedy=remedy)
    if used is None:
        problem = f"{unit} is no unit of {joint}, which {'slides' if joint in sliding else 'turns'}"
        own = f'{found.ours} = "{ours}" in [units]' if stated.file else f"{argument('units')} {found.ours}={ours}"
        remedy = f"state its own ({own})"
        raise InputError(problem, file=stated.file or source, key=f"units {found.ours}", value=unit, remedy=remedy)
    scale = 1.0 if scale is None else scale
    factor = UNITS[quantity][used] * scale
    return (values if factor == 1.0 else values * factor), used, scale


def _usable(clock: RowTimes, values: np.ndarray, what: str, source: str) -> tuple[np.ndarray, list[str]]:
    """Rows to be used (k,), in the order of time: those of a topic by its stamps, those of a table as they stand."""
    notes = []
    rows = np.flatnonzero(~np.isnan(clock.times))
    none = np.any(np.isnan(values), axis=1)
    if clock.kind != "column" or none.mean() > _OWN_TIMES:
        if clock.kind != "column" and none.any():
            notes.append(f"{what}: {int(none.sum())} messages lack a number; left out")
        rows = rows[~none[rows]]
    times = clock.times[rows]
    if clock.kind == "column":
        check_increasing(times, source, lambda row: f"row {rows[row]}")
    elif back := int((np.diff(times) < 0.0).sum()):
        by, messages = float(-np.diff(times).min()), "message" if back == 1 else "messages"
        text = f"{what}: {back} {messages} came out of order, by up to {by:.3g} s; sorted by {clock.text}"
        if by > _SET_BACK:
            apart = f"{argument('clock', 'log')} keeps them apart"
            text += f": if that clock was set back, two stretches lie over each other, and {apart}"
        notes.append(text)
        rows = rows[np.argsort(times, kind="stable")]
    again = np.append(False, np.diff(clock.times[rows]) == 0.0)[: len(rows)]
    if 2 * again.sum() > len(rows):
        raise InputError(
            f"time is repeated in {int(again.sum())} of {len(rows)} rows", file=source, key=what, value=int(again.sum()),
            remedy="write times with more digits, or name another column or clock",
        )  # fmt: skip
    if again.any():
        notes.append(f"{what}: {int(again.sum())} rows have the time of the one before; left out")
        rows = rows[~again]
    return rows, notes


def _without_stalls(signals: Sequence[Signal]) -> tuple[list[Signal], list[str]]:
    """Signals without the rows in which positions and readings of a stream are those of the row before while the robot moves.

    Such a row is an old sample at the time of a new one, as of a logger that reads faster than the robot writes. What was done
    is told, a line for each stream.
    """
    out, notes = list(signals), []
    for q in (s for s in signals if s.quantity == "q"):
        together = [k for k, s in enumerate(out) if s.clock is q.clock and np.array_equal(s.times, q.times)]
        sensed = [out[k] for k in together if out[k].quantity != "qr"]
        if not any(s.quantity in ("tau", "wrench") for s in sensed):  # encoders repeat what moves by less than a count
            continue
        kept = rows_without_stalls(q.times, q.values, np.column_stack([s.values for s in sensed]))
        if len(q.times) - len(kept) < 2:
            continue
        notes.append(STALLED.format(len(q.times) - len(kept), len(q.times), f" of {q.topic}" if q.topic else ""))
        for k in together:
            out[k] = replace(out[k], times=out[k].times[kept], values=out[k].values[kept])
    return out, notes


def _without_differences(signals: Sequence[Signal]) -> tuple[list[Signal], list[str]]:
    """Signals without velocities that are differences of held positions from one row to the next, and notes.

    Such velocities are 0 in all but one of the rows that hold a position, and as many times too large in that one.
    """
    out, notes = list(signals), []
    for q in (s for s in signals if s.quantity == "q"):
        rows, new = _without_held(q).held, _new(q)
        moving = np.diff(new) <= 2.0 * rows  # else at rest
        for v in (s for s in signals if s.quantity == "v" and rows > 1.0 and np.array_equal(s.times, q.times)):
            told = np.add.reduceat(v.values.any(axis=1), new, dtype=int)[:-1]  # rows with a velocity, of each position
            if np.mean(told[moving] == 1) >= _REGULAR:
                out.remove(v)
                notes.append(
                    f"velocities: 0 in all but one of the {rows:.3g} rows that repeat a position: differences from row to row; "
                    "not used, the positions tell"
                )
    return out, notes


def _new(signal: Signal) -> np.ndarray:
    """Rows in which a signal changes, the first among them (k,)."""
    return np.flatnonzero(np.append(True, (np.diff(signal.values, axis=0) != 0.0).any(axis=1)))


def _without_held(signal: Signal) -> Signal:
    """The signal without the rows that only repeat a sample of a slower topic until the next one comes."""
    held = [rows for column in signal.values.T if (rows := rows_held(column[:_JUDGED])) is not None]
    moving = [column for column in signal.values.T if np.ptp(column) > 0.0]
    if not held or len(held) < 0.5 * len(moving):
        return signal
    new = _new(signal)
    return replace(signal, times=signal.times[new], values=signal.values[new], held=len(signal.times) / len(new))
