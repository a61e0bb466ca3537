"""A recording examined: what cannot be right is refused, what is certain is found, what is doubtful told."""

from __future__ import annotations

from dataclasses import replace

from bayesid.recordings import checks, motion_checks
from bayesid.recordings.finding import Finding
from bayesid.recordings.held import held_columns, held_findings
from bayesid.recordings.motion import Motion
from bayesid.recordings.wraps import unwrapped
from bayesid.robot.robot import Robot


def _in_chunks(motion: Motion) -> Finding:
    """What it means that a motion is read in chunks."""
    assert motion.stored is not None
    size, part = len(motion.stored), len(motion.table)
    excerpt = "the whole recording" if part == size else f"an excerpt of {part:,} samples in evenly spread pieces"
    fitted = "is fitted in chunks" if motion.role == "identification" else "is only predicted, on that excerpt"
    return Finding(
        f"{motion.table.source}: {size:,} samples, of which few are in memory at a time: the recording {fitted}; what looks at "
        f"recordings as wholes (checks, noise floor, figures, diagnose, methods tls and iv) has {excerpt}"
    )


def examine(motion: Motion, robot: Robot, resolution: float | None, place: str) -> tuple[Motion, list[Finding], list[str]]:
    """Examine a motion's tables, and undo what is certainly only a way of counting.

    Parameters
    ----------
    motion
        The recording, from a file or from arrays.
    robot
        The robot it is from.
    resolution
        One encoder count [rad or m], where known.
    place
        Where its times are stated, for messages.

    Returns
    -------
    motion, findings, doubts
        The motion with angles unwrapped, what is certain about it, and what is doubtful, one line each.

    Raises
    ------
    InputError
        What is recorded cannot be right.
    """
    findings, doubts = [], []
    table, told = unwrapped(motion.table, robot, motion.kind)
    static, moved = motion.static, None
    if static is not None:
        # Row by row the motion's own positions, each turned as there; else poses that do not follow each other.
        static, moved = unwrapped(static, robot, motion.kind if motion.stop_and_go else "poses")
    certain = [*motion.table.told, told, *(motion.static.told if motion.static else ()), moved]
    findings += [Finding(text) for text in certain if text]
    if motion.stored is not None:
        findings.append(_in_chunks(motion))
    doubts += checks.check_positions(table, robot) + checks.check_channels(table)
    if motion.kind == "trajectory":
        held = held_columns(table)
        findings += held_findings(table, held)
        doubts += motion_checks.check_trajectory(table, robot, resolution, [h.column for h in held])
    doubts += checks.check_intervals(table, place, motion.period, motion.parked, resolution)
    if static is not None:
        doubts += checks.check_static(table, static, resolution)
        doubts += checks.check_positions(static, robot) + checks.check_channels(static)
    return replace(motion, table=table, static=static, examined=True), findings, doubts
