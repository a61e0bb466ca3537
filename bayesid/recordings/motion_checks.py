"""Checks of a motion sampled in time: lost samples, stalled loggers, velocities of another unit, frozen encoders, clipping.

Every check returns its warnings, one line each, that say which file, column and time; errors are raised.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arguments import call
from bayesid.errors import InputError
from bayesid.recordings.complaints import Finding, columns_of, listed
from bayesid.recordings.table import GAP, LONGEST_STEP, Table
from bayesid.robot.robot import Robot
from bayesid.signals.arrays import runs

_JUDGED = 200_000  # rows of a long recording that are looked at
_FEWEST = 20  # changes
#: Rows from one change to the next, on average: what repeats less often is a lost message now and then.
_HELD = 1.4
#: The usual change beside the smallest: a signal that repeats because its steps are below a count moves by single counts.
_COUNTS = 3.0
_REGULAR = 0.9  # share of the changes that come when they are due
_DUE = 0.25  # of the time between changes; at least a row
#: Jitter beyond this share of a step, or a drift of the step by it, is reported.
REPORTED = 0.1

TURN = 2.0 * np.pi
#: A step from one sample to the next that is a whole number of turns up to this is a wrap, for no joint goes that far in one
#: [rad].
_WRAP = 0.5


def wraps(times: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Turns in each step of an angle (N - 1,); zeros where it nowhere wraps, by one turn, within a sample."""
    steps = np.diff(q)
    turns = np.round(steps / TURN)
    gap = np.diff(times) > GAP * step
    within = (np.abs(turns) == 1.0) & (np.abs(steps - TURN * turns) < _WRAP) & ~gap
    if not within.any():
        return np.zeros(len(steps))
    return np.where(within | gap, turns, 0.0)


def held_columns(table: Table) -> dict[str, float]:
    """Columns of which samples are held for several rows each, how many, while they change by far more than a count."""
    return {name: rows for name, values in _columns(table) if (rows := rows_held(values[:_JUDGED])) is not None}


def held_findings(table: Table, held: Mapping[str, float]) -> list[Finding]:
    """What is said of `held_columns`: a line for those that are held alike."""
    out, left = [], dict(held)
    while left:
        rate = 1.0 / table.step
        first = next(iter(left.values()))
        names = [name for name, rows in left.items() if abs(rows - first) < 0.1 * first]
        rows = float(np.median([left.pop(name) for name in names]))
        kinds = {name.rstrip("0123456789") for name in names}
        channels = {"torque": "tau" in kinds, "wrench": bool(kinds & {"fx", "fy", "fz", "mx", "my", "mz"})}
        silences = ("wrench", "torque") if "q" in kinds else tuple(channel for channel, is_held in channels.items() if is_held)
        remedy = (
            "leave them out"
            if kinds == {"v"}
            else "interpolate them between the rows in which they change, or record them at the rate of the log"
        )
        if len(names) == 1:
            remedy = remedy.replace("them", "it").replace("they change", "it changes")
        text = (
            f"{table.source}: {columns_of(names, 30)}: new only every {rows:.3g} rows "
            f"({rate / rows:.3g} Hz in a log of {rate:.4g} Hz), held in between as samples of a slower topic are, and so "
            f"{500.0 * rows / rate:.2g} ms late on average; {remedy}"
        )
        out.append(Finding(text, silences))
    return out


def _columns(table: Table) -> Iterator[tuple[str, np.ndarray]]:
    for array, prefix in ((table.positions, "q"), (table.velocities, "v")):
        if array is not None:
            yield from ((f"{prefix}{j + 1}", column) for j, column in enumerate(array.T))
    yield from table.channels()


def rows_held(values: np.ndarray) -> float | None:
    """Rows from one new sample to the next, on average; None for a column that is new in nearly every row or at rest."""
    steps = np.abs(np.diff(values))
    changes = np.flatnonzero(steps)
    if len(changes) < _FEWEST or np.median(steps[changes]) < _COUNTS * np.quantile(steps[changes], 0.05):
        return None
    apart = np.diff(changes)
    apart = apart[apart <= 3.0 * np.median(apart)]  # longer ones are rests
    rows = float(np.mean(apart))
    regular = np.mean(np.abs(apart - rows) <= max(_DUE * rows, 1.0))
    return rows if rows >= _HELD and regular >= _REGULAR else None


@dataclass(frozen=True)
class Timing:
    """How even time stamps are."""

    missing: np.ndarray  # samples that each step lacks (N - 1,); of gaps, which are told apart, zero
    #: Error of a time stamp that would make steps scatter as they do, rms [s]: a stamp ends one step and starts the next.
    jitter: float
    #: Usual step in the first and the last quarter [s].
    first_step: float
    last_step: float

    @classmethod
    def of(cls, table: Table) -> Timing:
        """The timing of a table of at least two rows."""
        steps = table_steps(table)
        short = steps <= GAP * table.step
        quarter = max(np.count_nonzero(short) // 4, 1)
        first, last = float(np.median(steps[short][:quarter])), float(np.median(steps[short][-quarter:]))
        usual = np.linspace(first, last, len(steps))  # drift is no jitter
        missing = np.where(short, _missing(steps / table.step), 0)
        scatter = (steps - (1.0 + missing) * usual)[short]
        return cls(missing, float(np.sqrt(0.5 * np.mean(scatter**2))), first, last)

    @property
    def dropped(self) -> int:
        """Samples missing in steps that are no gaps."""
        return int(self.missing.sum())


def table_steps(table: Table) -> np.ndarray:
    """Steps in time (N - 1,) [s]; those over rows that were left out, which is told on its own, are as long as usual."""
    steps = np.diff(table.times)
    kept = np.delete(np.arange(len(table) + len(table.dropped)), table.dropped)
    steps[np.diff(kept) > 1] = table.step
    return steps


def _missing(steps: np.ndarray) -> np.ndarray:
    """Samples that each step, in usual ones, lacks (n,).

    A stamp that is late makes a step long and the next one short: what is lost is missing in a step and its neighbours together.
    """
    padded = np.concatenate([[1.0], steps, [1.0]])
    together = padded[:-2] + padded[1:-1] + padded[2:]
    return np.maximum(np.minimum(np.round(steps) - 1.0, np.round(together) - 3.0), 0.0).astype(int)


MIN_SAMPLES = 20
MATCH = 5e-3  # positions of one pose, moving and stopped, agree to this [rad or m]
FROZEN_TIME = 0.5  # an encoder standing longer than this [s] while the joint moves is frozen
_DEGREE = 180.0 / np.pi
_NEAR = 1.2  # factor within which a scale is recognised
_FEW = 2  # frozen encoders more than this are named in one line
_CLOCKS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_EPOCH = (3e8, 1e10)  # seconds since 1970, of computers' dates
_USUAL_STEP = 4e-3  # in the middle of those of robots' logs, 1 ms to 20 ms [s]
_MARK = 100.0  # usual ranges of a channel, which no reading goes and comes back within a sample
_END = 0.05  # of a joint's range, within which its end stop is
_WINDOW = 5  # samples before and after a place over which a speed is taken
_SLOW = 0.2  # share of a joint's usual top speed above which it moves for certain


def check_trajectory(
    table: Table,
    robot: Robot,
    resolution: float | None,
    held: Collection[str] = (),
    gaps: Sequence[tuple[float, float]] | None = None,
) -> list[str]:
    """Check a motion sampled in time: steps, velocities, encoders, and channels that stall or clip.

    ``resolution`` is one encoder count [rad or m], ``held`` columns whose samples are known to be held: that their values
    repeat is no doubt of its own. ``gaps`` are start and end of those [s] of the recording that the table has pieces of; by
    default the table is whole. An `InputError` where samples are too few, time is in another unit than seconds, or velocities
    are not those of the positions.
    """
    if len(table) < MIN_SAMPLES:
        raise InputError(
            f"{table.source}: {len(table)} rows are no trajectory (at least {MIN_SAMPLES}); "
            'record more, or write kind = "poses" if each row is a pose at rest'
        )
    if table.velocities is None and table.step >= LONGEST_STEP:
        raise InputError(
            f"{table.source}: column t: steps of {table.step:g} s are no trajectory; {_clock(table)}; write seconds, or "
            'kind = "poses" if each row is a pose at rest'
        )
    stalled = _stalled(table)
    warnings = [*_steps(table, gaps), *([] if held else _stalls(table, stalled))]
    warnings += check_velocities(table, robot)
    for j in range(robot.n):
        warnings += _jumps(table, robot, j)
    warnings += _encoders(table, robot, stalled, resolution)
    for name, values in table.channels():
        warnings += [] if name in held else _clipped(table, name, values)
        warnings += _marks(table, name, values)
    return warnings


def _clock(table: Table) -> str:
    """Unit of times whose steps are too long for seconds: that of a date, else of the likeliest rate."""
    if (np.diff(table.times) == 1.0).all():
        return "t seems to count the rows"
    short = {unit: factor for unit, factor in _CLOCKS.items() if table.step < LONGEST_STEP * factor}
    date = {unit: factor for unit, factor in short.items() if _EPOCH[0] < table.times[0] / factor < _EPOCH[1]}
    unit = min(date or _CLOCKS, key=lambda name: abs(np.log(table.step / _CLOCKS[name] / _USUAL_STEP)))
    since = " since 1970" if date else ""
    return f"t seems to be in {unit}{since}, steps of {table.step / _CLOCKS[unit]:.3g} s"


def _steps(table: Table, gaps: Sequence[tuple[float, float]] | None) -> list[str]:
    if gaps is None:
        gaps = [(table.times[k], table.times[k + 1]) for k in np.flatnonzero(table_steps(table) > GAP * table.step)]
    column = f"{table.source}: column t: "
    timing, uneven = Timing.of(table), []
    if timing.jitter > REPORTED * table.step:
        uneven.append(
            f"{column}time stamps jitter by {timing.jitter:.2g} s rms (a step is usually {table.step:.4g} s) and are taken as "
            "true times; if the samples were taken evenly, write even times"
        )
    if abs(timing.last_step - timing.first_step) > REPORTED * table.step:
        uneven.append(
            f"{column}steps drift from {timing.first_step:.4g} to {timing.last_step:.4g} s and are taken as they are; "
            "if the rate was constant, write even times"
        )
    said = []
    if len(gaps):
        said.append(f"gap at {listed([f'{start:.6g} to {end:.6g} s' for start, end in gaps], 3)}")
    if timing.dropped:
        of, which = ("1 sample is", "") if timing.dropped == 1 else (f"{timing.dropped} samples are", "the first ")
        first = table.times[np.flatnonzero(timing.missing)[0]]
        said.append(f"{of} missing{' elsewhere' * bool(len(gaps))}, {which}after {first:.6g} s")
    if not said:
        return uneven
    apart = "the pieces between gaps are treated apart, too short ones left out, " * bool(len(gaps))
    remedy = f"check the logger; or did `{call('import')}` leave rows out?"
    return [*uneven, f"{column}{'; '.join(said)} (a step is usually {table.step:.4g} s); {apart}{remedy}"]


def _travel(table: Table, velocities: np.ndarray, j: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances over about 0.1 s, by the positions and by the velocities.

    Integrating velocities, rather than differentiating positions, keeps encoder counts out of the comparison.
    """
    t, v = table.times, velocities[:, j]
    width = int(np.clip(np.ceil(0.1 / table.step), 5, max(2, len(t) // 8)))
    edges = np.arange(0, len(t), width)
    steps = np.diff(t)
    moved = np.append(0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * steps))
    broken = np.append(0, np.cumsum((steps > GAP * table.step) | _jumping(table, j)))
    whole = np.diff(broken[edges]) == 0
    return np.diff(table.positions[edges, j])[whole], np.diff(moved[edges])[whole]


def check_velocities(table: Table, robot: Robot) -> list[str]:
    """Compare velocities with the positions; an `InputError` where their unit is another."""
    if table.velocities is None:
        return []
    scales = {j: scale for j in range(robot.n) if (scale := _velocity_scale(table, robot, j)) is not None}
    wrong = {j: scale for j, scale in scales.items() if abs(scale - 1.0) > 0.2}
    if len(wrong) == len(scales) > 1 and max(wrong.values()) < _NEAR * min(wrong.values()):  # of what is common to all joints
        scale, names = float(np.median(list(wrong.values()))), columns_of([f"v{j + 1}" for j in wrong], 30)
        wrong_by = f"{scale:.3g} times too long" if scale > 1.0 else f"{1.0 / scale:.3g} times too short"
        return [
            f"{table.source}: {names}: all {scale:.3g} times what the positions say, as where column t is {wrong_by}: a sample "
            f"every {table.step / scale:.3g} s, not {table.step:.3g} s; correct t or the stated rate, or the velocities' unit"
        ]
    return [
        f"{table.source}: column v{j + 1}: {scale:.3g} times what column q{j + 1} of {robot.joint_names[j]} says; check its "
        "unit, whether t is the time of the samples, and the order of the columns, or leave the v columns out"
        for j, scale in wrong.items()
    ]


def _moves(by_position: np.ndarray) -> bool:
    """Whether what a joint travels by its positions (k,) is a motion that velocities can be compared with."""
    weights = np.abs(by_position)
    # What moved by half of its way at once jumped, such as a joint at rest whose first reading came after the first row.
    return bool(len(weights) and 2e-3 <= weights.max() < 0.5 * weights.sum())


def zero_velocities(table: Table) -> list[int]:
    """Joints that move although their velocities are 0 in every row."""
    if table.velocities is None:
        return []
    zero = np.flatnonzero(~table.velocities.any(axis=0)).tolist()
    return [j for j in zero if _moves(_travel(table, table.velocities, j)[0])]


def _velocity_scale(table: Table, robot: Robot, j: int) -> float | None:
    """How many times too fast a velocity column is; None where its joint does not move, or an `InputError` as of another unit."""
    assert table.velocities is not None
    by_position, by_velocity = _travel(table, table.velocities, j)
    weights = np.abs(by_position)
    place = f"{table.source}: column v{j + 1}"
    if not _moves(by_position):
        return None
    if not table.velocities[:, j].any():
        raise InputError(f"{place}: 0 in every row although {robot.joint_names[j]} moves; leave the v columns out")
    # The scale that minimises the sum of absolute deviations: single jumps of an encoder do not count.
    moving = weights > 0.0
    ratios, weights = (by_velocity[moving] / by_position[moving]), weights[moving]
    order = np.argsort(ratios)
    middle = np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())
    scale = float(ratios[order][middle])
    fits = f"{place}: {scale:.3g} times what column q{j + 1} of {robot.joint_names[j]} says"
    known = {
        -1.0: "the sign is reversed; turn it, or leave the v columns out",
        1e6: "column t looks like microseconds; write seconds",
        1e9: "column t looks like nanoseconds; write seconds",
    }
    known |= {
        1e3: "it looks like millimetres per second, or column t like milliseconds; write m/s and seconds",
        1e-3: f"column q{j + 1} looks like millimetres; write m",
    } if robot.prismatic[j] else {
        _DEGREE: "it looks like degrees per second; write rad/s",
        1.0 / _DEGREE: f"column q{j + 1} looks like degrees; write rad",
        1e3: "column t looks like milliseconds; write seconds",
        1e3 * _DEGREE: "it looks like degrees per second with t in milliseconds; write rad/s and seconds",
    }  # fmt: skip
    for factor, advice in known.items():
        if 1.0 / _NEAR < scale / factor < _NEAR:
            raise InputError(f"{fits}; {advice}")
    if not 0.1 < scale < 10.0:
        raise InputError(f"{fits}; check the units of t, q and v and the order of the columns, or leave the v columns out")
    return scale


def _jumping(table: Table, j: int) -> np.ndarray:
    """Return (N - 1,): the steps of the position that no joint makes within a sample.

    Up to a tenth of the steps may be such, as where a logger writes 0 in place of what it did not get.
    """
    steps = np.abs(np.diff(table.positions[:, j]))
    steps[np.diff(table.times) > GAP * table.step] = 0.0
    usual = float(np.quantile(steps[steps > 0.0], 0.9)) if steps.any() else 0.0
    return steps > max(0.5, 20.0 * usual)


def _jumps(table: Table, robot: Robot, j: int) -> list[str]:
    jumps = np.flatnonzero(_jumping(table, j))
    if not len(jumps):
        return []
    k = jumps[0]
    size = abs(float(table.positions[k + 1, j] - table.positions[k, j]))
    advice = "unwrap the angle" if abs(size - 2.0 * np.pi) < 0.1 else "check the encoder"
    return [
        f"{table.source}: column q{j + 1}: {robot.joint_names[j]} jumps by {size:.4g} at {table.times[k]:.6g} s "
        f"({len(jumps)} such places); {advice}"
    ]


def _speeds(times: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Mean speed from `_WINDOW` samples before to as many after each sample; columns as in the positions."""
    rows = np.arange(len(times))
    before, after = np.maximum(rows - _WINDOW, 0), np.minimum(rows + _WINDOW, len(times) - 1)
    return np.abs(positions[after] - positions[before]).T / (times[after] - times[before])


def _moving(table: Table, share: float) -> np.ndarray:
    """Return (N,): whether any joint moves faster than this share of its usual top speed."""
    speeds = _speeds(table.times, table.positions)  # (n, N)
    return np.any(speeds > np.maximum(share * np.quantile(speeds, 0.95, axis=1, keepdims=True), 1e-12), axis=0)


def _stalled(table: Table) -> np.ndarray:
    """Return (N,): whether the row repeats the one before in every column but the time."""
    same = np.arange(len(table)) > 0
    for _, column in _columns(table):
        same[1:] &= np.diff(column) == 0.0
    return same


def stalls(times: np.ndarray, positions: np.ndarray, repeated: np.ndarray) -> list[tuple[int, int]]:
    """Runs of repeated rows (N,), from and to, that are not simply a robot at rest: it moves just before and just after them.

    That is by the steps of its positions (N, n) [rad or m] at times (N,) [s]. At the end of a recording the step before is all
    there is.
    """
    slow = _SLOW * np.quantile(_speeds(times, positions), 0.95, axis=1)
    fast = np.append(False, np.any(np.abs(np.diff(positions, axis=0)) > slow * np.diff(times)[:, None], axis=1))
    return [(a, b) for a, b in runs(repeated) if fast[a - 1] and (b == len(times) or fast[b])]


def rows_without_stalls(times: np.ndarray, positions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Rows (k,) that are left without `stalls` of positions (N, n) and all values (N, m) that were recorded with them."""
    kept = np.arange(len(times))
    # Without them the robot is seen to be faster, and may be seen to move at more of them.
    while stalled := stalls(times[kept], positions[kept], np.append(False, (np.diff(values[kept], axis=0) == 0.0).all(axis=1))):
        kept = np.delete(kept, np.concatenate([np.arange(*run) for run in stalled]))
    return kept


def without_stalls(table: Table) -> Table:
    """The table without the rows that a check would report to repeat the row before while the robot moves."""
    kept = rows_without_stalls(table.times, table.positions, np.column_stack([column for _, column in _columns(table)]))
    return table[kept] if len(table) - len(kept) > 1 else table


def _stalls(table: Table, stalled: np.ndarray) -> list[str]:
    """Report rows that repeat the row before while the robot moves."""
    counted = stalls(table.times, table.positions, stalled)
    rows = sum(b - a for a, b in counted)
    if rows < 2:
        return []
    a, b = max(counted, key=lambda run: run[1] - run[0])
    where = f"the longest time from {table.times[a]:.6g} to {table.times[b - 1]:.6g} s; did the logger stall?"
    if b - a == 1:
        where = f"each alone, the first at {table.times[a]:.6g} s; did the logger read faster than the robot writes?"
    return [f"{table.source}: {rows} rows repeat the row before in every column while the robot moves, {where} cut them out"]


def _encoders(table: Table, robot: Robot, stalled: np.ndarray, resolution: float | None) -> list[str]:
    """Find joints that do not move, and times in which a reading stands still but the joint, it seems, does not.

    A robot of many joints is often moved a few at a time: then one line lists those that stand.
    """
    held = [j for j in range(robot.n) if _is_held(table.positions[:, j], resolution)]
    moving = [j for j in range(robot.n) if j not in held]
    frozen = {j: where for j in moving if (where := _frozen(table, j, stalled, resolution))}
    stops = {j: end for j, where in frozen.items() if (end := _end_stop(table, robot, j, where))}
    frozen = {j: where for j, where in frozen.items() if j not in stops}
    warnings = []
    if moving and held:  # where none moves the robot was parked, as somebody meant it
        verb, them = ("never moves; lock it", "it") if len(held) == 1 else ("never move; lock them", "them")
        place = f"{table.source}: {joint_columns(robot, held)}"
        warnings.append(f"{place} {verb} ([robot] locked), or expect nothing about {them} where no other motion moves {them}")
    for j, end in stops.items():
        warnings.append(f"{table.source}: {joint_columns(robot, [j])} {end}; leave those times out")
    if len(frozen) > _FEW:
        first, place = next(iter(frozen)), f"{table.source}: {joint_columns(robot, list(frozen))}"
        warnings.append(
            f"{place} stand still for a time while they seem to move, q{first + 1} at "
            f"{_when(table, first, frozen[first])}; were they held, or are encoders frozen?"
        )
    else:
        for j, rows in frozen.items():
            place = f"{table.source}: {joint_columns(robot, [j])}"
            warnings.append(f"{place} stands at {_when(table, j, rows)} as if frozen; check that encoder")
    return warnings


def joint_columns(robot: Robot, joints: Sequence[int]) -> str:
    """Columns of positions and the joints that they are of: ``columns q1, q2: shoulder, elbow``."""
    return f"{columns_of([f'q{j + 1}' for j in joints])}: {listed([robot.joint_names[j] for j in joints])}"


def _is_held(q: np.ndarray, resolution: float | None) -> bool:
    """Whether a joint does not move: two encoder counts are the flicker of a joint at rest."""
    steps = np.abs(np.diff(q))
    if not steps.any():
        return True
    # Unknown counts show as the smallest step, where readings mostly do not change at all.
    count = resolution if resolution else float(steps[steps > 0.0].min()) if np.mean(steps == 0.0) > 0.5 else 0.0
    return bool(np.ptp(q) <= 2.0 * count * (1.0 + 1e-6))


def _when(table: Table, j: int, rows: tuple[int, int]) -> str:
    a, b = rows
    return f"{table.positions[a, j]:.6g} from {table.times[a]:.6g} to {table.times[b]:.6g} s"


def _end_stop(table: Table, robot: Robot, j: int, rows: tuple[int, int]) -> str:
    """That a joint that stands is at the end of its range, where it went no further in the whole recording; empty if not."""
    q, at = table.positions[:, j], float(table.positions[rows[0], j])
    for limit, end, which in ((robot.lower[j], q.min(), "lower"), (robot.upper[j], q.max(), "upper")):
        if at == end and abs(at - limit) < _END * (robot.upper[j] - robot.lower[j]) < np.inf:
            return (
                f"stands at {_when(table, j, rows)} and goes no further: it seems to be on its {which} end stop "
                f"({robot.urdf.name} allows {limit:.6g}), which bears a part of the load"
            )
    return ""


def _frozen(table: Table, j: int, stalled: np.ndarray, resolution: float | None) -> tuple[int, int] | None:
    """First and last row in which a joint's reading stands still although the joint moves; None where it does not."""
    t, q = table.times, table.positions[:, j]
    steps = np.abs(np.diff(q))
    speed = _speeds(t, q)
    top, usual = float(np.quantile(speed, 0.95)), float(np.quantile(steps[steps > 0.0], 0.95))
    for a, b in runs(steps == 0.0):
        if t[b] - t[a] <= FROZEN_TIME or stalled[a + 1 : b + 1].all():
            continue  # the latter is said for the whole row already
        if table.velocities is not None:
            v, turns = table.velocities[a : b + 1, j], np.abs(np.diff(table.velocities[:, j]))
            count = resolution or float(steps[steps > 0.0].min())
            # Two counts of the speed are the flicker of a joint at rest, and some drives never read zero.
            least = max(0.05 * top, 2.0 * float(turns[turns > 0.0].min()) if turns.any() else 0.0)
            frozen = abs(np.trapezoid(v, t[a : b + 1])) > max(20.0 * count, MATCH) and np.abs(v).mean() > least
        else:
            # A joint at rest cannot be somewhere else one sample later.
            jumps = b < len(steps) and steps[b] > 5.0 * usual and t[b + 1] - t[b] < GAP * table.step
            arrives = top > 0.0 and a > 0 and _mean_speed(t, q, a - _WINDOW, a) > 0.2 * top
            leaves = b == len(steps) or jumps or (top > 0.0 and _mean_speed(t, q, b, b + _WINDOW) > 0.2 * top)
            frozen = jumps or (leaves and arrives)
        if frozen:
            return a, b
    return None


def _mean_speed(t: np.ndarray, q: np.ndarray, a: int, b: int) -> float:
    a, b = max(a, 0), min(b, len(t) - 1)
    return float(abs(q[b] - q[a]) / (t[b] - t[a])) if b > a else 0.0


def _marks(table: Table, name: str, values: np.ndarray) -> list[str]:
    """Find single samples so far from both neighbours that they are no readings, such as -9999 where a logger had none."""
    usual = float(np.ptp(np.quantile(values, [0.1, 0.9])))
    off = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    if not usual or not (off > _MARK * usual).any():
        return []
    worst = 1 + int(np.argmax(off))
    rows = int(np.count_nonzero(np.abs(values - np.median(values)) > 0.5 * _MARK * usual))
    return [
        f"{table.source}: column {name}: {values[worst]:g} at {table.times[worst]:.6g} s, far from the readings before and after "
        f"({rows} such row{'s' * (rows != 1)}); if it marks a missing reading, leave the cell empty"
    ]


def _clipped(table: Table, name: str, values: np.ndarray) -> list[str]:
    """Find an extreme value that is held, and reached and left more abruptly than a rounded peak is."""
    steps = np.abs(np.diff(values))
    if not steps.any():
        return []
    quantum = float(steps[steps > 0.0].min())
    moving: np.ndarray | None = None
    for extreme in (float(values.max()), float(values.min())):
        held = [(a, b) for a, b in runs(values == extreme) if b - a >= 5]
        if not held:
            continue
        moving = _moving(table, 0.05) if moving is None else moving
        places = [
            (a, b)
            for a, b in held
            if moving[a:b].mean() > 0.5
            and max(steps[a - 1] if a else 0.0, steps[b - 1] if b <= len(steps) else 0.0) > 1.5 * quantum
        ]
        if len(places) >= 2 or (places and max(b - a for a, b in places) >= MIN_SAMPLES):
            return [
                f"{table.source}: column {name}: stays at {extreme:g} in {len(places)} places, the first at "
                f"{table.times[places[0][0]]:.6g} s, as if clipped; use a larger range or leave those times out"
            ]
    return []
