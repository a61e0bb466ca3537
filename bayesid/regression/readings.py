"""What is read: the channels of an experiment, which motions have them, and their gap-free segments."""

from __future__ import annotations

import numpy as np

from bayesid.arguments import argument
from bayesid.dynamics.channels import Channels, stack_channels, torque_channels, wrench_channels
from bayesid.errors import InputError, require_one_of
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import Table
from bayesid.regression.segment import LongSegment, Segment
from bayesid.signals.repeats import find_rests

CHANNELS = ("wrench", "torque", "both")


def default_channel(experiment: Experiment) -> str:
    """The wrench where there is a sensor and every fitted motion has its readings, else the torques."""
    wrench = experiment.sensor is not None and all(m.table.wrench is not None for m in experiment.identification)
    return "wrench" if wrench else "torque"


def make_channels(experiment: Experiment, channel: str) -> Channels:
    """Channels of an experiment; an `InputError` where the wrench is asked for and there is no sensor."""
    _require_channel(channel)
    if channel == "torque":
        return torque_channels(experiment.robot).only(experiment.torque_joints)
    if experiment.sensor is None:
        toml = "experiment.toml" if experiment.folder is None else experiment.folder / "experiment.toml"
        raise InputError(f"{toml}: [sensor] is missing; add it, or use {argument('channel', 'torque')}")
    wrench = wrench_channels(experiment.robot, experiment.sensor.rotation, experiment.sensor.translation)
    if channel == "wrench":
        return wrench
    return stack_channels(wrench, torque_channels(experiment.robot).only(experiment.torque_joints))


def _require_channel(channel: str) -> None:
    require_one_of(channel, CHANNELS, argument("channel", channel))


def has_readings(table: Table, channel: str) -> bool:
    """Whether a table has the readings of a channel."""
    _require_channel(channel)
    wrench, torque = table.wrench is not None, table.torques is not None
    return {"wrench": wrench, "torque": torque, "both": wrench and torque}[channel]


def require_readings(motion: Motion, channel: str) -> None:
    """Refuse a motion without the readings of a channel."""
    if not has_readings(motion.table, channel):
        torque_missing = channel != "wrench" and motion.table.torques is None
        columns = "tau1 ... taun" if torque_missing else "fx ... mz"
        raise InputError(
            f"{motion.table.source}: columns {columns} are missing, which {argument('channel', channel)} needs; "
            f"add them, choose another {argument('channel')} or leave motion '{motion.name}' out with {argument('motions')}"
        )


def stated_noise(experiment: Experiment, channel: str) -> np.ndarray | None:
    """Standard deviation of one sample by the data sheet (6,) [N, N m], where the sensor is all that is compared."""
    sensor = experiment.sensor
    if channel != "wrench" or sensor is None or sensor.force_std is None or sensor.torque_std is None:
        return None
    return np.repeat([sensor.force_std, sensor.torque_std], 3)


def rests(motion: Motion, times: np.ndarray, encoders: np.ndarray, counts: np.ndarray) -> list[tuple[float, float]]:
    """Start and end [s] of the times in which the robot stands still: as the experiment says, or as its encoders (N, n) do.

    ``counts`` is one count of each encoder (n,) [rad or m].
    """
    return list(motion.parked) or find_rests(times, encoders, counts)


def motion_segments(
    experiment: Experiment, channels: Channels, motion: Motion, index: int, channel: str, subtract: bool
) -> list[Segment]:
    """Gap-free segments of one motion, and its static readings where those are fitted along."""
    readings, known = readings_of(experiment, motion.table, channel), channels.static_wrench
    gravity = offset = True
    rest = motion.static if channel == "wrench" and motion.static is not None and motion.static.wrench is not None else None
    if rest is not None and rest.wrench is not None and subtract and motion.stop_and_go:
        known = rest.wrench  # equation 21: free of offset and gravity
        gravity = offset = False
    table, poses = motion.table, motion.kind == "poses"
    whole = Segment(
        table.times,
        table.positions,
        readings,
        known,
        index,
        gravity,
        offset,
        poses,
        table.commanded,
        motion.period,
        in_turn=poses,
        events=not poses and motion.role != "validation",
    )
    out = [whole] if poses else [whole.part(p.start, p.stop) for p in table.segments()]
    if rest is not None and rest.wrench is not None and offset:
        out.append(
            Segment(
                rest.times, rest.positions, rest.wrench, channels.static_wrench, index, poses=True, commanded=rest.commanded,
                events=False,
            )
        )  # fmt: skip
    return out


def long_segments(experiment: Experiment, channels: Channels, motion: Motion, index: int, channel: str) -> list[LongSegment]:
    """Gap-free segments of a motion that is read in chunks; no static run is subtracted from it."""
    assert motion.stored is not None
    groups = tuple(name for name, other in (("wrench", "torque"), ("torques", "wrench")) if channel != other)
    return [
        LongSegment(motion.stored, p.start, p.stop, groups, experiment.torque_joints, channels.static_wrench, index)
        for p in motion.stored.segments()
    ]


def readings_of(experiment: Experiment, table: Table, channel: str) -> np.ndarray:
    """A table's readings of a channel (N, c), of joints whose torques the whole experiment has; an `InputError` without any."""
    wanted = []
    if channel != "torque":
        wanted.append(table.wrench)
    if channel != "wrench":
        wanted.append(None if table.torques is None else table.torques[:, experiment.torque_joints])
    there = [part for part in wanted if part is not None]
    if len(there) < len(wanted):
        raise InputError(f"{table.source}: readings of the channel {channel} are missing; add them")
    return there[0] if len(there) == 1 else np.hstack(there)
