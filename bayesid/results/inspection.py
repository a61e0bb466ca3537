"""What ``check`` found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.motion_checks import REPORTED, Timing
from bayesid.results.files import SCHEMA, ShownResult, strict
from bayesid.rounding import counted
from bayesid.section import ShownTable
from bayesid.validation.mistakes.candidates import Mistake
from bayesid.validation.own_fit import left_dict, left_text
from bayesid.validation.prediction import Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class MotionSummary:
    """What one motion of the folder is."""

    motion: Motion  # the recording itself
    gaps: tuple[tuple[float, float], ...]  # (start, end) of each hole in it [s]
    timing: Timing | None  # how even its time stamps are; None for poses
    rate: float  # samples a second; nan for poses
    columns: tuple[str, ...]  # groups of columns that it has: ``q, v, qr, tau, wrench``
    #: Reach (n,) [rad or m] and largest speed (n,) [rad/s or m/s] of the joints, nan for poses.
    lowest: np.ndarray
    highest: np.ndarray
    speed: np.ndarray
    static: str  # ``none``, ``stop-and-go`` (row by row the motion's positions) or ``poses``
    noise: dict[str, float]  # standard deviation of one sample by channel [unit of the channel]; empty where it cannot be had
    #: Standard deviation about the mean of each parked interval, by channel [unit of the channel]; empty where the experiment
    #: states none.
    noise_at_rest: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``motions`` in ``check.json``."""
        m = self.motion
        return strict({
            "name": m.name, "role": m.role, "kind": m.kind, "samples": len(m.table), "duration_s": m.table.duration,
            "rate_hz": self.rate, "gaps": [list(g) for g in self.gaps],
            "dropped_samples": self.timing.dropped if self.timing else 0, "jitter_s": self.timing.jitter if self.timing else None,
            "columns": list(self.columns),
            "lowest": self.lowest, "highest": self.highest, "speed": self.speed,
            "static": self.static, "static_samples": 0 if m.static is None else len(m.static),
            "period_s": m.period, "parked": [list(p) for p in m.parked], "noise_std": self.noise,
            "noise_at_rest_std": self.noise_at_rest,
        })  # fmt: skip


@dataclass(frozen=True)
class InspectedReadings:
    """A set of readings and what it can show at all."""

    name: str  # in words
    base: BaseParameters  # base parameters of the richest motion
    available: bool  # whether the motions to fit have these readings


@dataclass(frozen=True, eq=False)
class Inspection(ShownResult):
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
    mistakes
        Signs, frames, orders and units that seem to be wrong, the most certain first; the warnings begin with them.
    warnings
        What looks doubtful, most important first.
    left
        What `identify` with its default estimator would leave of every motion; empty where it cannot be fitted, or is longer
        than fits in memory.
    """

    verb, report = "check", "check"
    experiment: Experiment
    motions: tuple[MotionSummary, ...]
    sensor_sets: tuple[InspectedReadings, ...]
    channel: str
    bandwidth: float | None
    bandwidth_reason: str
    position_std: np.ndarray
    mistakes: tuple[Mistake, ...]
    warnings: tuple[str, ...]
    left: tuple[Prediction, ...] = ()

    def plot(self, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
        """Draw the recording of a motion, the first by default; as `Experiment.plot`."""
        return self.experiment.plot(motion, channels=channels, ax=ax)

    @property
    def name(self) -> str:
        """The experiment's name."""
        return self.experiment.name

    def to_dict(self) -> dict[str, Any]:
        """What ``check.json`` holds."""
        robot, sensor = self.experiment.robot, self.experiment.sensor
        limits = {k: getattr(robot, k) for k in ("lower", "upper", "velocity_limit", "effort_limit")}
        return strict({
            "schema": SCHEMA, "experiment": self.name, "warnings": list(self.warnings),
            "mistakes": [m.to_dict() for m in self.mistakes],
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
            "effects": list(self.experiment.effects), "channel": self.channel,
            "motions": [m.to_dict() for m in self.motions],
            "bandwidth_hz": self.bandwidth, "bandwidth_reason": self.bandwidth_reason, "position_std": self.position_std,
            "left": [left_dict(p) for p in self.left],
            "sensor_sets": [
                {"readings": s.name, "rank": s.base.rank, "available": s.available, "base_parameters": list(s.base.names),
                 "invisible": list(s.base.invisible)}
                for s in self.sensor_sets
            ],
        })  # fmt: skip

    def __repr__(self) -> str:
        found = f"{counted(len(self.mistakes), 'mistake')}, {counted(len(self.warnings), 'warning')}"
        return f"<Inspection of {self.name}: {counted(len(self.motions), 'motion')}, {found}>"

    def _parts(self) -> list[str | ShownTable]:
        robot = self.experiment.robot
        lines: list[str | ShownTable] = [
            f"{self.name}: {counted(robot.n, 'joint')}, {counted(len(robot.body_names), 'body', 'bodies')}, "
            f"{counted(len(self.motions), 'motion')}"
        ]
        lines += [f"warning: {w}" for w in self.warnings]
        for m in self.motions:
            rate = "" if np.isnan(m.rate) else f", {m.motion.table.duration:.4g} s at {m.rate:.4g} Hz"
            what = "poses" if m.motion.kind == "poses" else "samples"
            lines.append(
                f"{m.motion.role} '{m.motion.name}': {len(m.motion.table)} {what}{rate}, "
                f"columns {' '.join(m.columns)}, static {m.static}"
                + (f", {counted(len(m.gaps), 'gap')}" if m.gaps else "")
                + (f", {counted(m.timing.dropped, 'sample')} missing" if m.timing and m.timing.dropped else "")
                + (f", stamps jitter by {m.timing.jitter:.2g} s rms" if m.timing and m.timing.jitter > REPORTED / m.rate else "")
            )
            if m.noise_at_rest:
                lines.append("  noise at rest: " + ", ".join(f"{c} {s:.3g}" for c, s in m.noise_at_rest.items()))
        lines += [f"a fit would leave of {p.motion}: {left_text(p)}" for p in self.left]
        if self.bandwidth is not None:
            lines.append(f"bandwidth of the motion {self.bandwidth:.3g} Hz ({self.bandwidth_reason})")
        if any("v" in m.columns for m in self.motions):
            lines.append("velocities are those of the smoothed positions; columns v are only compared with them")
        lines += [f"rank {s.base.rank} from {s.name}{'' if s.available else ' (not recorded)'}" for s in self.sensor_sets]
        return lines
