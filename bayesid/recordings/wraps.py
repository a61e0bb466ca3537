"""Angles that an encoder counts within one turn: the same poses, as angles that go on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.recordings.complaints import listed
from bayesid.recordings.table import GAP, Table
from bayesid.robot.robot import Robot

TURN = 2.0 * np.pi
#: A step from one sample to the next that is a whole number of turns up to this is a wrap, for no joint goes that far in one, and
#: angles beyond a limit by less than this are near it [rad].
_SLACK = 0.5
_LIMIT_SLACK = 0.1  # as the limits are checked [rad]


def unwrapped(table: Table, robot: Robot, kind: str) -> tuple[Table, str | None]:
    """Undo wraps of turning joints, and take off the whole turn by which readings are outside the joint's limits.

    Parameters
    ----------
    table
        The recording.
    robot
        Says which joints turn, and their limits.
    kind
        ``trajectory``, or ``poses`` for rows that do not follow each other.

    Returns
    -------
    table, told
        The same table and None where there was nothing to undo.
    """
    positions, wrapped, shifted = np.array(table.positions), {}, []
    for j in np.flatnonzero(~robot.prismatic).tolist():
        q = table.positions[:, j]
        if kind == "trajectory":
            jumps = _wraps(table.times, q, table.step)
            if jumps.any():
                wrapped[j] = float(table.times[np.argmax(jumps != 0.0)])
                q = q - TURN * np.append(0.0, np.cumsum(jumps))
        whole = _turns_off(q, float(robot.lower[j]), float(robot.upper[j]), kind == "trajectory")
        if np.any(whole):
            shifted.append(j)
        positions[:, j] = q - TURN * whole
    if not wrapped and not shifted:
        return table, None
    commanded = table.commanded
    if commanded is not None:
        turns = np.round((positions - commanded) / TURN) * ~robot.prismatic
        commanded = commanded + TURN * turns
    joints = sorted({*wrapped, *shifted})
    columns, names = listed([f"q{j + 1}" for j in joints]), listed([robot.joint_names[j] for j in joints])
    place = f"{table.source}: column{'s' * (len(joints) > 1)} {columns}: {names}"
    if wrapped:
        first = min(wrapped.values())
        told = f"{place}: angles wrap at a full turn, the first at {first:.6g} s; unwrapped"
        told += f", {listed([f'q{j + 1}' for j in shifted])} by whole turns into the limits" if shifted else ""
    else:
        told = f"{place}: whole turns outside the limits of {robot.urdf.name}; taken off"
    return replace(table, positions=positions, commanded=commanded), f"{told}: the same poses"


def _wraps(times: np.ndarray, q: np.ndarray, step: float) -> np.ndarray:
    """Turns in each step of an angle (N - 1,); zeros where it nowhere wraps within a sample."""
    steps = np.diff(q)
    turns = np.round(steps / TURN)
    gap = np.diff(times) > GAP * step
    within = (turns != 0.0) & (np.abs(steps - TURN * turns) < _SLACK) & ~gap
    if not within.any():
        return np.zeros(len(steps))
    return np.where(within | gap, turns, 0.0)


def _turns_off(q: np.ndarray, lower: float, upper: float, together: bool) -> np.ndarray | float:
    """Turns to be taken off angles that are outside the limits and would be inside without: one number, or one an angle (N,)."""
    if not np.isfinite([lower, upper]).all():
        return 0.0
    low, high = (q.min(), q.max()) if together else (q, q)

    def excess(turns: float | np.ndarray) -> np.ndarray:
        return np.maximum(high - TURN * turns - upper, lower - low + TURN * turns)

    whole = np.where(high > upper, 1.0, -1.0)
    return np.where((excess(0.0) > _LIMIT_SLACK) & (excess(whole) < _SLACK), whole, 0.0)
