"""A recording examined: what cannot be right is an error, what is certain a finding, what is doubtful a warning.

Every check returns its warnings, one line each, that say which file, column and time; errors are raised. Nothing is repaired but
for angles that were counted in turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import Finding, columns_of, listed
from bayesid.recordings.motion_checks import (
    MATCH,
    MIN_SAMPLES,
    TURN,
    check_trajectory,
    held_columns,
    held_findings,
    joint_columns,
    wraps,
)
from bayesid.recordings.parts import Motion
from bayesid.recordings.table import Table
from bayesid.robot.robot import Robot

LIMIT_SLACK = 0.1  # so far beyond a limit [rad or m] nothing is said
_FAR_OUTSIDE = 4.0 * np.pi  # beyond a limit by this much [rad or m]: another unit
_LARGE_ANGLE = 20.0  # no joint with limits turns this far [rad]
_KINKS = 2  # so many turns at zero make a magnitude
_REACH = 6  # samples on either side of a turn
_CLEAR = 0.05  # torques that are never below this share of their largest are clear of zero
_AROUND = 0.25  # a sample moves if the robot does within this time before and after [s]
_READINGS = {"wrench": "fx ... mz", "torques": "tau1 ..."}


def check_positions(table: Table, robot: Robot) -> list[str]:
    """Compare positions with the URDF's limits; an `InputError` where they are so far outside that the unit must be wrong."""
    warnings = []
    for j in range(robot.n):
        q, lower, upper = table.positions[:, j], float(robot.lower[j]), float(robot.upper[j])
        excess = np.maximum(lower - q, q - upper)
        worst = int(np.argmax(excess))
        limited = bool(np.isfinite([lower, upper]).any())
        slides = bool(robot.prismatic[j])
        far = excess[worst] > _FAR_OUTSIDE
        if limited and not slides and np.abs(q).max() > _LARGE_ANGLE:
            far, worst = True, int(np.argmax(np.abs(q)))
        place = f"{table.source}: column q{j + 1}: {robot.joint_names[j]} is at {q[worst]:.6g} at {table.times[worst]:.6g} s"
        allowed = f"{robot.urdf.name} allows {lower:.6g} to {upper:.6g} {'m' if slides else 'rad'}"
        if far:
            unit = "millimetres? write metres" if slides else "degrees? write radians"
            motor = "; if it is the motor's position, divide by the gear ratio"
            raise InputError(f"{place}, {allowed}; is it in {unit}, or correct the limits{motor}")
        if excess[worst] > LIMIT_SLACK:
            warnings.append(f"{place}, {allowed}; check the unit (rad or m), the joint order, its zero and the limits")
    return warnings


def check_channels(table: Table, moves: bool = True) -> list[str]:
    """Look for sensor channels that do not work at all, in any kind of table.

    An `InputError` where all six wrench channels, or all torques, are zero throughout, or torques of a robot that ``moves`` have
    lost their signs. At rest an arm that is lifted from where it hangs may load each joint to one side, from zero on.
    """
    for name, columns in _READINGS.items():
        array = getattr(table, name)
        if array is not None and not np.nan_to_num(array).any():
            raise InputError(f"{table.source}: columns {columns}: 0 in every row; record them, or leave them out")
    unsigned = _without_sign(table)
    never = f"{table.source}: columns {', '.join(unsigned)}: never negative, as if they were magnitudes; "
    if unsigned and moves:
        raise InputError(f"{never}a moving robot's torques have both signs: export them with their signs")
    torque, other = "leave it out, for it is fitted as a reading", "check it"
    return [f"{never}if they are, export them with their signs"] * bool(unsigned) + [
        f"{table.source}: column {name}: {value:g} in every row; that channel looks dead, "
        f"{torque if name.startswith('tau') else other}"
        for name, value in dead_channels(table).items()
    ]


def dead_channels(table: Table) -> dict[str, float]:
    """Readings that are the same in every row, by their columns."""
    return {name: float(values[0]) for name, values in table.channels() if len(table) > 1 and np.ptp(values) == 0.0}


def _without_sign(table: Table) -> list[str]:
    """Torque columns that are magnitudes: none is ever negative.

    Of three joints or more, one at least comes next to zero, as no torque does that gravity loads to one side only. One or two
    may come there by chance; their torques are magnitudes where they turn back at zero, instead of going on with their slope: a
    minimum that touches zero by chance is flat for many samples.
    """
    if table.torques is None or len(table) < 4 * _REACH or (table.torques < 0.0).any():
        return []
    if len(table.torque_joints) > 2:
        torques = table.torques[:, table.torque_joints]
        if (torques.min(axis=0) > _CLEAR * torques.max(axis=0)).all():
            return []  # gravity holds each to one side, as it does a boom's joints
        return [f"tau{table.torque_joints[0] + 1}", "...", f"tau{table.torque_joints[-1] + 1}"]
    found = []
    for j in table.torque_joints:
        values = table.torques[:, j]
        noise = float(np.median(np.abs(np.diff(values, 3)))) / (0.6745 * np.sqrt(20.0))  # as of white noise
        low = _REACH + np.flatnonzero(values[_REACH:-_REACH] < max(2.0 * noise, 0.01 * values.max()))
        before, after = values[low - _REACH], values[low + _REACH]
        # Down to zero and up again by as much within a few samples, far beyond the noise: a minimum is flatter than that.
        steep = np.minimum(before, after) > np.maximum(8.0 * noise, 4.0 * values[low])
        alike = np.maximum(before, after) < 2.0 * np.minimum(before, after)
        bottom = np.median(values[low[:, None] + np.arange(-1, 2)], axis=1)
        straight = bottom < 0.5 * np.minimum(values[low - _REACH // 2], values[low + _REACH // 2])
        if np.count_nonzero(np.diff(low[steep & alike & straight], prepend=-np.inf) > _REACH) >= _KINKS:
            found.append(f"tau{j + 1}")
    return found


def check_static(table: Table, static: Table, resolution: float | None) -> None:
    """Check a static table against its motion.

    An `InputError` where it lacks a channel of the motion, has as many rows but other positions, or is cut out of the motion.
    """
    for name, columns in _READINGS.items():
        if getattr(table, name) is not None and getattr(static, name) is None:
            raise InputError(
                f"{static.source}: columns {columns} are missing although {table.source} has them; "
                "a static table needs the same columns"
            )
    if len(static) != len(table):
        if _moves_in(table, static):
            raise InputError(
                f"holds rows of {table.source} in which the robot moves", file=static.source,
                remedy="give readings of the robot at rest, or remove [[motion]] static",
            )  # fmt: skip
        return
    allowed = max(MATCH, 10.0 * (resolution or 0.0))
    difference = np.abs(static.positions - table.positions)
    row, j = (int(k) for k in np.unravel_index(np.argmax(difference), difference.shape))
    if difference[row, j] > allowed:
        rows = int((difference > allowed).any(axis=1).sum())
        raise InputError(
            f"{static.source}: column q{j + 1}, sample {row + 1}: {static.positions[row, j]:.6g} but "
            f"{table.positions[row, j]:.6g} in {table.source} ({rows} of {len(table)} differ by more than "
            f"{allowed:g}); with as many rows as the motion it must hold the same positions row by row: "
            "record it again, or give static poses with another number of rows"
        )
    for name in _READINGS:
        moving, still = getattr(table, name), getattr(static, name)
        if moving is not None and _same_digits(moving, still):
            raise InputError(
                f"holds the same {name} as {table.source}, in which the robot moves", file=static.source,
                remedy="give readings of the robot at rest, or remove [[motion]] static",
            )  # fmt: skip


def _same_digits(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether readings (N, c) are the same to the digits of those that are written with fewer."""
    for a, b in zip(first.T, second.T, strict=True):
        known = np.isfinite(a)
        digit = max((float(np.diff(np.unique(x[known])).min(initial=np.inf)) for x in (a, b)), default=0.0)
        apart = np.abs(a - b)[known]
        if np.any(known != np.isfinite(b)) or np.any(apart > (0.501 * digit if np.isfinite(digit) else 0.0)):
            return False
    return True


def _moves_in(table: Table, static: Table) -> bool:
    """Whether most rows of a static table are rows of its motion in which the robot moves; those at rest may be cut out of it."""
    rows = [
        np.ascontiguousarray(np.hstack([t.positions, *(x for name in _READINGS if (x := getattr(t, name)) is not None)]))
        for t in (table, static)
    ]
    if rows[0].shape[1] != rows[1].shape[1]:  # what the motion lacks
        return False
    mine, still = (x.view(np.dtype((np.void, x.itemsize * x.shape[1]))).ravel() for x in rows)
    before, after = (np.searchsorted(table.times, table.times + s).clip(max=len(table) - 1) for s in (-_AROUND, _AROUND))
    moves = np.abs(table.positions[after] - table.positions[before]).max(axis=1) > MATCH
    return bool(np.mean(np.isin(still, mine[moves])) > 0.5)


def check_intervals(
    table: Table, stated: str, period: float | None, parked: Sequence[tuple[float, float]], resolution: float | None
) -> list[str]:
    """Check the stated ``period`` and ``parked`` times [s]; an `InputError` where one is outside the recording, or backwards."""
    warnings: list[str] = []
    first, last, slack = float(table.times[0]), float(table.times[-1]), 0.5 * table.step
    for start, end in parked:
        place = f"{stated} parked: [{start:g}, {end:g}]"
        if not start < end:
            raise InputError(f"{place} does not end after its start; write [start, end] in seconds")
        if start < first - slack or end > last + slack:
            raise InputError(
                f"{place} is outside the recording ({table.source} is from {first:g} to {last:g} s); write times within it"
            )
        inside = (table.times >= start) & (table.times <= end)
        if not inside.any():
            raise InputError(f"{place} holds no sample of {table.source}; write a longer interval")
        travel = np.ptp(table.positions[inside], axis=0)
        j = int(np.argmax(travel))
        if travel[j] > max(MATCH, 10.0 * (resolution or 0.0)):
            warnings.append(f"{place}: q{j + 1} moves by {travel[j]:.3g} in that time; does it stand? correct the interval")
    if period is None:
        return warnings
    place = f"{stated} period: {period:g} s"
    if period > table.duration + 2.0 * slack:
        raise InputError(
            f"{place} is longer than the recording ({table.source} lasts {table.duration:g} s); correct or remove it"
        )
    if period < 4.0 * slack * (1.0 - 1e-9):  # a period of two steps may come out a rounding shorter
        raise InputError(f"{place} is not even two samples ({table.step:g} s apart) of {table.source}; write seconds")
    again = np.flatnonzero(table.times <= last - period)
    # Medians: a robot that starts from rest repeats only later.
    for j in range(table.positions.shape[1]):
        q = table.positions[:, j]
        later = np.interp(table.times[again] + period, table.times, q)
        if len(again) > MIN_SAMPLES and np.median(np.abs(later - q[again])) > 0.1 * np.ptp(q) > MATCH:
            return [*warnings, f"{place}: q{j + 1} of {table.source} does not repeat after it; check the period"]
    return warnings


#: Angles beyond a limit by less than this are near it [rad].
_SLACK = 0.5


def unwrapped(table: Table, robot: Robot, kind: str) -> tuple[Table, str | None]:
    """Undo wraps of turning joints, and take off the whole turn by which readings are outside the joint's limits.

    Commands, which may wrap where positions do not, follow these. Rows of the kind ``poses`` do not follow each other. Returned
    are the table and a note, or the same table and None where there was nothing to undo.
    """
    positions, wrapped, shifted = np.array(table.positions), {}, []
    for j in np.flatnonzero(~robot.prismatic).tolist():
        q = table.positions[:, j]
        if kind == "trajectory":
            jumps = wraps(table.times, q, table.step)
            if jumps.any():
                wrapped[j] = float(table.times[np.argmax(jumps != 0.0)])
                q = q - TURN * np.append(0.0, np.cumsum(jumps))
        whole = _turns_off(q, float(robot.lower[j]), float(robot.upper[j]), kind == "trajectory")
        if np.any(whole):
            shifted.append(j)
        positions[:, j] = q - TURN * whole
    commanded, followed = table.commanded, []
    if commanded is not None:
        turns = np.round((positions - commanded) / TURN) * ~robot.prismatic
        commanded = commanded + TURN * turns
        followed = [f"qr{j + 1}" for j in np.flatnonzero(turns.any(axis=0))]
    joints = sorted({*wrapped, *shifted})
    if not joints and not followed:
        return table, None
    if not joints:
        notes = f"{table.source}: {columns_of(followed)}: whole turns off the positions; taken off: the same poses"
        return replace(table, commanded=commanded), notes
    place = f"{table.source}: {joint_columns(robot, joints)}"
    if wrapped:
        first = min(wrapped.values())
        notes = f"{place}: angles wrap at a full turn, the first at {first:.6g} s; unwrapped"
        notes += f", {listed([f'q{j + 1}' for j in shifted])} by whole turns into the limits" if shifted else ""
    else:
        notes = f"{place}: whole turns outside the limits of {robot.urdf.name}; taken off"
    return replace(table, positions=positions, commanded=commanded), f"{notes}: the same poses"


def _turns_off(q: np.ndarray, lower: float, upper: float, together: bool) -> np.ndarray | float:
    """Turns to be taken off angles that are outside the limits and would be inside without: one number, or one an angle (N,)."""
    if not np.isfinite([lower, upper]).all():
        return 0.0
    low, high = (q.min(), q.max()) if together else (q, q)

    def excess(turns: float | np.ndarray) -> np.ndarray:
        return np.maximum(high - TURN * turns - upper, lower - low + TURN * turns)

    whole = np.where(high > upper, 1.0, -1.0)
    return np.where((excess(0.0) > LIMIT_SLACK) & (excess(whole) < _SLACK), whole, 0.0)


def examine(motion: Motion, robot: Robot, resolution: float | None, place: str) -> tuple[Motion, list[Finding], list[str]]:
    """The motion with angles unwrapped, what is certain about its tables, and what is doubtful, one line each.

    An `InputError` where what is recorded cannot be right; ``place`` is where its times are stated, for messages.
    """
    findings, doubts = [], []
    table, notes = unwrapped(motion.table, robot, motion.kind)
    static, moved = motion.static, None
    if static is not None:
        # Row by row the motion's own positions, each turned as there; else poses that do not follow each other.
        static, moved = unwrapped(static, robot, motion.kind if motion.stop_and_go else "poses")
    certain = [*motion.table.notes, notes, *(motion.static.notes if motion.static else ()), moved]
    findings += [Finding(text) for text in certain if text]
    if motion.stored is not None:
        size, part = len(motion.stored), len(motion.table)
        excerpt = "the whole recording" if part == size else f"an excerpt of {part:,} samples in evenly spread pieces"
        fitted = "is fitted in chunks" if motion.role == "identification" else "is only predicted, on that excerpt"
        text = (
            f"{motion.table.source}: {size:,} samples, of which few are in memory at a time: the recording {fitted}; what looks "
            f"at recordings as wholes (checks, noise floor, figures, diagnose, methods tls and iv) has {excerpt}"
        )
        findings.append(Finding(text))
    doubts += check_positions(table, robot) + check_channels(table, motion.kind == "trajectory")
    if motion.kind == "trajectory":
        held = held_columns(table)
        findings += held_findings(table, held)
        doubts += check_trajectory(table, robot, resolution, held, None if motion.stored is None else motion.stored.gap_times)
    doubts += check_intervals(table, place, motion.period, motion.parked, resolution)
    if static is not None:
        check_static(table, static, resolution)
        doubts += check_positions(static, robot) + check_channels(static, moves=False)
    return replace(motion, table=table, static=static, examined=True), findings, doubts
