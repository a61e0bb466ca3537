"""What was imported from files of other tools, and what was done to it."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.importing.clock import date
from bayesid.recordings.importing.recording import Recording
from bayesid.recordings.importing.signals import Signal
from bayesid.recordings.writer import write_experiment
from bayesid.results.files import SCHEMA, strict
from bayesid.rounding import number, with_half

_EVEN = 1e-6  # jitter that no log of a robot is without [s]
_OURS = {"rad", "m", "rad/s", "m/s", "N m", "N"}


@dataclass(frozen=True)
class Delay:
    """How much later one quantity is than another."""

    #: What is late, and against what, with their topics.
    late: str
    against: str
    #: [s]; negative where it is early.
    value: float
    std: float
    method: str  # how it was found

    def __str__(self) -> str:
        side = "later" if self.value >= 0.0 else "earlier"
        value, std = with_half(1e3 * abs(self.value), 1e3 * max(self.std, 1e-5))
        return f"{self.late} {value} +- {std} ms {side} than {self.against} ({self.method})"


@dataclass(frozen=True, eq=False)
class ImportedRecording:
    """One recording: where everything came from, and what was done to it."""

    name: str  # of its motion in the experiment
    files: tuple[str, ...]  # names of the files or folders that it was read from
    recording: Recording  # every quantity as it was recorded, and what was done
    delays: tuple[Delay, ...] = ()  # between topics


@dataclass(frozen=True, eq=False)
class Imported:
    """An experiment made of other tools' files.

    Attributes
    ----------
    experiment
        As every verb takes it.
    recordings
        One a motion, in their order.
    done
        What holds of all: joints without data, where the sensor is, what is missing.
    """

    experiment: Experiment
    recordings: tuple[ImportedRecording, ...]
    done: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<Imported {self.experiment!r}>"

    def __str__(self) -> str:
        e = self.experiment
        lines = [
            f"{e.name}: {e.robot.n} joint{'s' * (e.robot.n != 1)} of {e.robot.urdf.name}, "
            f"{len(e.motions)} recording{'s' * (len(e.motions) != 1)}",
            "  " + ", ".join(f"q{j + 1} {name}" for j, name in enumerate(e.robot.joint_names)),
            *(f"  {text}" for text in self.done),
        ]
        for recording in self.recordings:
            lines += self._recording_lines(recording)
        return "\n".join([*lines, *(f"  warning: {text}" for text in self.experiment.warnings)])

    def _recording_lines(self, imported: ImportedRecording) -> list[str]:
        lines, recording = [], imported.recording
        for motion in self.experiment:
            if motion.name in (imported.name, f"{imported.name}-end"):
                table = motion.table
                if motion.kind == "poses":
                    lines.append(f"  {motion.role} '{motion.name}' ({', '.join(imported.files)}): {len(table)} poses")
                    continue
                rate = f" at {number(1.0 / table.step, 4)} Hz" if table.step else ""
                start = date(recording.start) if motion.name == imported.name else None
                since = f", from {start}" if start is not None else ""
                lines.append(
                    f"  {motion.role} '{motion.name}' ({', '.join(imported.files)}): {len(table)} rows over "
                    f"{number(table.duration, 4)} s{rate}{since}"
                )
        alike: dict[tuple[str, bytes, float], list[Signal]] = {}
        for signal in recording.signals:
            alike.setdefault((signal.topic, signal.times.tobytes(), signal.held), []).append(signal)
        for signals in alike.values():
            names = ", ".join(signal.name for signal in signals)
            times = signals[0].clock.text if self.experiment[imported.name].kind == "poses" else _times(signals[0])
            lines.append(f"    {names}{f' of {signals[0].topic}' if signals[0].topic else ''}: {times}")
            lines += [f"      {_span(signal.ours)} from {_span(signal.columns)}{_units(signal)}" for signal in signals]
        lines += [f"    {text}" for text in recording.done]
        lines += [f"    {delay}" for delay in imported.delays]
        if recording.left_over:
            lines.append(f"    not used: {listed(recording.left_over, 8)}")
        return lines

    def _repr_html_(self) -> str:
        """The text of ``str()`` for notebooks."""
        from html import escape

        return f"<pre>{escape(str(self))}</pre>"

    def to_dict(self) -> dict[str, Any]:
        """The document ``import.json``."""
        experiment = self.experiment
        return {
            "schema": SCHEMA, "experiment": experiment.name, "joints": list(experiment.robot.joint_names),
            "done": list(self.done), "recordings": [_document(r) for r in self.recordings], "warnings": list(experiment.warnings),
        }  # fmt: skip

    @explains_types
    def write(self, folder: str | Path) -> Path:
        """Write the experiment folder, with ``import.json`` in it, whole or not at all; returns its path.

        Raises
        ------
        InputError
            The folder has something in it, is a file, or cannot be written.
        """
        text = json.dumps(strict(self.to_dict()), indent=1, allow_nan=False, ensure_ascii=False)
        write_experiment(self.experiment, folder, {"import.json": text + "\n"})
        return Path(folder)


def _times(signal: Signal) -> str:
    """How many samples there are, how fast and how even."""
    timing, late, gaps = signal.timing, signal.clock.late, signal.gaps()
    parts = [f"{len(signal.times)} samples" + (f" at {number(1.0 / signal.step, 4)} Hz" if signal.step else "")]
    if timing is not None:
        parts.append(f"jitter {number(1e3 * timing.jitter, 2)} ms rms" if timing.jitter > _EVEN else "even")
        parts += [f"{timing.dropped} missing"] if timing.dropped else []
    if gaps:
        where = listed([f"{start:.6g} to {end:.6g} s" for start, end in gaps], 3)
        parts.append(f"{len(gaps)} gap{'s' * (len(gaps) > 1)} ({where})")
    text = signal.clock.text
    if late is not None:
        text += f"; the log's times are {number(1e3 * late[0], 3)} +- {number(1e3 * late[1], 2)} ms later"
    return f"{', '.join(parts)}; {text}"


def _units(signal: Signal) -> str:
    """The units of a log that are not ours, and the factors that were stated."""
    units, scales = list(dict.fromkeys(signal.units)), signal.scales
    text = "" if set(units) <= _OURS else f" [{', '.join(units)}]"
    if all(by == 1.0 for by in scales):
        return text
    return f"{text}, times {', '.join(f'{by:g}' for by in (scales[:1] if len(set(scales)) == 1 else scales))}"


def _span(names: Sequence[str]) -> str:
    """``tau1 ... tau6``; one by one where numbers between them are not there."""
    numbers = [int(found[0]) for name in names if (found := re.search(r"\d+$", name))]
    if len(numbers) == len(names) and numbers != list(range(numbers[0], numbers[0] + len(names))):
        return ", ".join(names)
    return names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"


def _document(imported: ImportedRecording) -> dict[str, Any]:
    recording = imported.recording
    return {
        "motion": imported.name, "files": list(imported.files),
        "start": date(recording.start), "rows_of": recording.base.name,
        "signals": [_signal(s) for s in recording.signals], "done": list(recording.done),
        "delays": [
            {"late": d.late, "against": d.against, "value_s": d.value, "std_s": d.std, "method": d.method}
            for d in imported.delays
        ],
        "left_over": list(recording.left_over),
    }  # fmt: skip


def _signal(signal: Signal) -> dict[str, Any]:
    timing, late = signal.timing, signal.clock.late
    return {
        "quantity": signal.quantity, "topic": signal.topic or None,
        "columns": {
            ours: {"from": theirs, "unit": unit, "scale": scale}
            for ours, theirs, unit, scale in zip(signal.ours, signal.columns, signal.units, signal.scales, strict=True)
        },
        "clock": signal.clock.kind, "recorded": signal.recorded, "samples": len(signal.times), "held_rows": signal.held,
        "rate_hz": 1.0 / signal.step if signal.step else np.nan, "jitter_s": None if timing is None else timing.jitter,
        "dropped_samples": 0 if timing is None else timing.dropped, "gaps": [list(gap) for gap in signal.gaps()],
        "log_late_s": None if late is None else late[0], "log_late_spread_s": None if late is None else late[1],
    }  # fmt: skip
