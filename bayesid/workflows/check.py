"""The verb ``check``: what an experiment folder contains and what its readings could show, before any estimate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.effects import parse_effects
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import GAP, WRENCH_COLUMNS, Table
from bayesid.regression.problem import default_channel, make_channels, prepare
from bayesid.report import check_report
from bayesid.results.files import write_results
from bayesid.signals.smoothing import smooth
from bayesid.workflows.progress import Progress, quiet

SCHEMA = 1
_GROUPS = {"positions": "q", "velocities": "v", "commanded": "qr", "torques": "tau", "wrench": "wrench"}
#: Samples of a long recording that speeds are taken from.
_SMOOTHED = 50_000


@dataclass(frozen=True)
class MotionSummary:
    """What one motion of the folder is.

    Attributes
    ----------
    motion
        The recording itself.
    gaps
        (start, end) of each hole in it [s].
    rate
        Samples a second; nan for poses.
    columns
        Groups of columns that it has: ``q, v, qr, tau, wrench``.
    lowest, highest, speed
        Reach (n,) [rad or m] and largest speed (n,) [rad/s or m/s] of the joints, nan for poses.
    static
        ``none``, ``stop-and-go`` (row by row the motion's positions) or ``poses``.
    noise
        Standard deviation of one sample by channel [unit of the channel]; empty where it cannot be had.
    """

    motion: Motion
    gaps: tuple[tuple[float, float], ...]
    rate: float
    columns: tuple[str, ...]
    lowest: np.ndarray
    highest: np.ndarray
    speed: np.ndarray
    static: str
    noise: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``motions`` in ``check.json``."""
        m = self.motion
        return {
            "name": m.name, "role": m.role, "kind": m.kind, "samples": len(m.table), "duration_s": m.table.duration,
            "rate_hz": _finite(self.rate), "gaps": [list(g) for g in self.gaps], "columns": list(self.columns),
            "lowest": self.lowest.tolist(), "highest": self.highest.tolist(), "speed": [_finite(v) for v in self.speed],
            "static": self.static, "static_samples": 0 if m.static is None else len(m.static),
            "period_s": m.period, "parked": [list(p) for p in m.parked], "noise_std": self.noise,
        }  # fmt: skip


@dataclass(frozen=True)
class SensorSet:
    """A set of readings and what it can show at all.

    Attributes
    ----------
    name
        In words.
    base
        Base parameters of the richest motion.
    available
        Whether the motions to fit have these readings.
    """

    name: str
    base: BaseParameters
    available: bool


@dataclass(frozen=True)
class Inspection:
    """What `check` found.

    Attributes
    ----------
    experiment
        What was inspected.
    motions
        One summary a motion.
    sensor_sets
        What each set of readings can show.
    channel
        What `identify` would fit by default.
    bandwidth, bandwidth_reason
        Of the joint motion [Hz], as `identify` would choose it; None where it cannot be chosen.
    position_std
        Random error of one position sample (n,) [rad or m].
    warnings
        What looks doubtful, most important first.
    """

    experiment: Experiment
    motions: tuple[MotionSummary, ...]
    sensor_sets: tuple[SensorSet, ...]
    channel: str
    bandwidth: float | None
    bandwidth_reason: str
    position_std: np.ndarray
    warnings: tuple[str, ...]

    @property
    def name(self) -> str:
        """The experiment's name."""
        return self.experiment.name

    def to_dict(self) -> dict[str, Any]:
        """``check.json``."""
        robot, sensor = self.experiment.robot, self.experiment.sensor
        limits = {k: [_finite(v) for v in getattr(robot, k)] for k in ("lower", "upper", "velocity_limit", "effort_limit")}
        return {
            "schema": SCHEMA,
            "experiment": self.name,
            "warnings": list(self.warnings),
            "robot": {
                "name": robot.name, "joints": list(robot.joint_names), "prismatic": robot.prismatic.tolist(), **limits,
                "locked": dict(self.experiment.locked), "gravity": robot.gravity.tolist(), "bodies": list(robot.body_names),
                "nominal": robot.nominal.ravel().tolist(), "masses": robot.nominal[:, 0].tolist(),
                "inertia_rel_std": self.experiment.inertia_rel_std,
            },
            "sensor": None if sensor is None else {
                "joint": sensor.joint, "translation": sensor.translation.tolist(), "rpy": sensor.rpy.tolist(),
                "force_std": sensor.force_std, "torque_std": sensor.torque_std,
            },
            "effects": list(self.experiment.effects),
            "channel": self.channel,
            "motions": [m.to_dict() for m in self.motions],
            "bandwidth_hz": self.bandwidth,
            "bandwidth_reason": self.bandwidth_reason,
            "position_std": [_finite(v) for v in self.position_std],
            "sensor_sets": [
                {"readings": s.name, "rank": s.base.rank, "available": s.available, "base_parameters": list(s.base.names),
                 "invisible": list(s.base.invisible)}
                for s in self.sensor_sets
            ],
        }  # fmt: skip

    def __str__(self) -> str:
        """A few lines for the terminal, warnings first."""
        robot = self.experiment.robot
        lines = [f"{self.name}: {robot.n} joints, {len(robot.body_names)} bodies, {len(self.motions)} motions"]
        lines += [f"  warning: {w}" for w in self.warnings]
        for m in self.motions:
            rate = "" if np.isnan(m.rate) else f", {m.motion.table.duration:.4g} s at {m.rate:.4g} Hz"
            what = "poses" if m.motion.kind == "poses" else "samples"
            lines.append(
                f"  {m.motion.role} '{m.motion.name}': {len(m.motion.table)} {what}{rate}, "
                f"columns {' '.join(m.columns)}, static {m.static}" + (f", {len(m.gaps)} gaps" if m.gaps else "")
            )
        if self.bandwidth is not None:
            lines.append(f"  bandwidth of the motion {self.bandwidth:.3g} Hz ({self.bandwidth_reason})")
        lines += [f"  rank {s.base.rank} from {s.name}{'' if s.available else ' (not recorded)'}" for s in self.sensor_sets]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        text = str(self).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        return f"<pre>{text}</pre>"

    def write(self, folder: str | Path) -> Path:
        """Write ``check.json`` and ``report.html``; returns the report's path."""
        return write_results(folder, {"check.json": self.to_dict()}, {}, check_report(self))


def check(experiment: Experiment, progress: Progress = quiet) -> Inspection:
    """Say what an experiment contains: robot, motions, noise, and what each set of readings could show.

    Parameters
    ----------
    experiment
        Loaded, and so already validated.
    progress
        Called with the name of every stage.

    Raises
    ------
    InputError
        ``[model] effects`` names an effect or a place that does not exist.
    """
    progress("motions")
    warnings: list[str] = []
    channel = default_channel(experiment)
    bandwidth, reason, position_std = None, "", np.full(experiment.robot.n, np.nan)
    try:
        parse_effects(experiment.effects, experiment.robot.joint_names, [*WRENCH_COLUMNS, "tau1"])
    except InputError as error:
        raise InputError(f"experiment.toml: [model] effects: {error}") from None
    try:
        problem = prepare(experiment, channel, effects=())
        bandwidth, reason, position_std = problem.smoother.bandwidth, problem.smoother.reason, problem.smoother.position_std
    except InputError as error:
        reason = str(error)
        warnings.append(f"identify will refuse this folder as it is: {error}")
    motions = tuple(_summary(m, bandwidth) for m in experiment.motions)
    progress("base parameters")
    return Inspection(
        experiment=experiment,
        motions=motions,
        sensor_sets=_sensor_sets(experiment),
        channel=channel,
        bandwidth=bandwidth,
        bandwidth_reason=reason,
        position_std=position_std,
        warnings=tuple([*warnings, *experiment.warnings]),
    )


def sample_noise(table: Table) -> dict[str, float]:
    """Standard deviation of one sample of each channel from the median of third differences.

    A motion is smooth over four samples and leaves its third differences nearly untouched; white noise of
    standard deviation s gives them ``s sqrt(20)``. The median does not see outliers. Where more than half the
    differences are zero (coarse digits), their root mean square stands in.
    """
    out: dict[str, float] = {}
    groups: list[tuple[tuple[str, ...], np.ndarray]] = [] if table.wrench is None else [(WRENCH_COLUMNS, table.wrench)]
    if table.torques is not None:
        groups.append((tuple(f"tau{j + 1}" for j in range(table.torques.shape[1])), table.torques))
    for names, values in groups:
        parts = [np.diff(values[p], 3, axis=0) for p in table.segments() if p.stop - p.start > 20]
        if not parts:
            continue
        third = np.concatenate(parts)
        robust = np.median(np.abs(third), axis=0) / 0.674490
        plain = np.sqrt(np.mean(third**2, axis=0))
        out |= dict(zip(names, map(float, np.where(robust > 0, robust, plain) / np.sqrt(20.0)), strict=True))
    return out


def _summary(motion: Motion, bandwidth: float | None) -> MotionSummary:
    table, poses = motion.table, motion.kind == "poses"
    step = np.diff(table.times)
    at = [] if poses or not len(step) else np.flatnonzero(step > GAP * table.step)
    columns = tuple(short for field, short in _GROUPS.items() if getattr(table, field) is not None)
    return MotionSummary(
        motion=motion,
        gaps=tuple((float(table.times[k]), float(table.times[k + 1])) for k in at),
        rate=np.nan if poses or not len(step) else 1.0 / table.step,
        columns=columns,
        lowest=table.positions.min(axis=0),
        highest=table.positions.max(axis=0),
        speed=_speed(table, bandwidth) if not poses and bandwidth else np.full(table.positions.shape[1], np.nan),
        static="none" if motion.static is None else "stop-and-go" if motion.stop_and_go else "poses",
        noise={} if poses else sample_noise(table),
    )


def _speed(table: Table, bandwidth: float) -> np.ndarray:
    """Largest speeds of the smoothed positions, but for one sample in a thousand: ends are loose (n,)."""
    speeds = []
    for piece in table.segments():
        piece = slice(piece.start, min(piece.stop, piece.start + _SMOOTHED))
        try:
            speeds.append(np.abs(smooth(table.times[piece], table.positions[piece], bandwidth)[1]))
        except InputError:
            continue  # a stretch too short to be smoothed
    return np.quantile(np.concatenate(speeds), 0.999, axis=0) if speeds else np.full(table.positions.shape[1], np.nan)


def _sensor_sets(experiment: Experiment) -> tuple[SensorSet, ...]:
    fitted = experiment.identification
    wrench = experiment.sensor is not None and all(m.table.wrench is not None for m in fitted)
    torque = all(m.table.torques is not None for m in fitted)
    at_rest = wrench and all(m.kind == "poses" for m in fitted)
    stopped = wrench and all(m.stop_and_go for m in fitted)
    poses = wrench and any(m.static is not None for m in fitted)
    sets = []
    if experiment.sensor is not None:
        channels = make_channels(experiment, "wrench")
        cases = [
            ("the wrench of poses at rest, with an unknown sensor offset", at_rest, dict(offset=True, at_rest=True)),
            ("the wrench, with an unknown sensor offset", wrench and not at_rest, dict(offset=True)),
            ("the wrench and readings at rest fitted along, offset unknown", poses, dict(offset=True)),
            ("the motion wrench: readings at rest subtracted sample by sample", stopped, dict(gravity=False)),
            ("the wrench of a sensor without offset", False, {}),
        ]
        sets += [
            (name, channels, here, options)
            for name, here, options in cases
            if here or options.get("at_rest") is None and "along" not in name
        ]
    sets.append(("the joint torques", make_channels(experiment, "torque"), torque, {}))
    if experiment.sensor is not None:
        both = make_channels(experiment, "both")
        sets.append(("wrench and torques, with an unknown sensor offset", both, wrench and torque, dict(offset=True)))
    return tuple(SensorSet(name, structural_base(experiment.robot, c, **options), here) for name, c, here, options in sets)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
