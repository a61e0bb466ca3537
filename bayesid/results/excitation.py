"""The motions that ``excite`` found: the most exciting one, and with ``--tell`` the one that tells rivals apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from bayesid.design.excitation.blocks import ScriptedBlock, StopAndGo
from bayesid.design.excitation.diagnosability import Diagnosability
from bayesid.design.excitation.series import FourierSeries
from bayesid.design.tell.choose import Telling
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.recordings.complaints import in_words
from bayesid.results.files import SCHEMA, Files, ShownResult, strict
from bayesid.rounding import counted, number, percent
from bayesid.section import ShownTable, powers
from bayesid.simulation.trajectories import Trajectory, write_trajectory

#: The motion's file beside a diagnosis.
NEXT_MOTION = "next_motion.csv"
#: Pairs of rivals that a sentence names.
_NAMED = 2
#: The motion's file.
TRAJECTORY = "trajectory.csv"
#: Kinds of limits in words.
KINDS = {
    "position": "position", "velocity": "speed", "acceleration": "acceleration", "torque": "torque", "wrench": "sensor",
    "collision": "distance",
}  # fmt: skip


def duration_text(seconds: float) -> str:
    """A time in words."""
    return f"{number(seconds, 3)} s" if seconds < 120.0 else f"{number(seconds / 60.0, 3)} min"


def block_length(block: ScriptedBlock) -> str:
    """How many poses it has, or how long it takes."""
    poses = block.trajectory.kind == "poses"
    return f"{len(block.trajectory.times)} poses" if poses else duration_text(block.seconds)


@dataclass(frozen=True)
class LimitUse:
    """How near a motion comes to one limit."""

    kind: str  # ``position``, ``velocity``, ``acceleration``, ``torque``, ``wrench`` or ``collision``
    where: str  # joint, channel or pair of bodies
    #: Largest value of the motion and what is allowed, the share of the limits taken off; of a position, the far end; of a
    #: collision, the smallest distance and the margin.
    reached: float
    limit: float
    unit: str  # unit of both
    ratio: float  # at most one: the limit is kept

    @property
    def kept(self) -> bool:
        """Whether the limit is kept."""
        return self.ratio <= 1.0


@dataclass(frozen=True, eq=False)
class Excitation(ShownResult):
    """An exciting trajectory within limits.

    Attributes
    ----------
    name
        The experiment's name.
    joint_names, prismatic
        Of the robot.
    readings
        What will be read, in words.
    criterion, criterion_text
        What was optimised.
    value
        Its value, larger is better: for ``d`` the mean logarithm of the information's eigenvalues.
    random
        The same of random feasible motions.
    history
        (seconds, value) whenever a better motion was found.
    interrupted
        Whether the search was stopped by hand.
    options
        As asked.
    series, trajectory
        The motion.
    blocks
        Scripted blocks that go with it.
    static_run
        Schedule of the stop-and-go run, or None.
    limits
        How near it comes to every limit, at ten times the recorded rate.
    loads
        By ``torque`` and ``wrench``: names and values (N, c) of what nominal links take along the motion [N, N m].
    base
        The base parameters that it determines.
    std
        Their expected standard deviations (r,).
    possible
        How many base parameters the richest motion of these joints would determine.
    quantities
        Name, unit and expected standard deviation of the quantities asked for.
    diagnosability
        What the motion could show beyond the model, or None.
    condition_number
        Of the whitened regressor with columns of unit length.
    notes
        What was assumed or left out.
    seconds
        Run time of every stage.
    """

    verb, report = "excite", "excitation"
    name: str
    joint_names: tuple[str, ...]
    prismatic: np.ndarray
    readings: str
    criterion: str
    criterion_text: str
    value: float
    random: np.ndarray
    history: tuple[tuple[float, float], ...]
    interrupted: bool
    options: Mapping[str, Any]
    series: FourierSeries
    trajectory: Trajectory
    blocks: tuple[ScriptedBlock, ...]
    static_run: StopAndGo | None
    limits: tuple[LimitUse, ...]
    loads: Mapping[str, tuple[tuple[str, ...], np.ndarray]]
    base: BaseParameters
    std: np.ndarray
    possible: int
    quantities: tuple[tuple[str, str, float], ...]
    diagnosability: Diagnosability | None
    condition_number: float
    notes: tuple[str, ...]
    seconds: Mapping[str, float]

    @property
    def within_limits(self) -> bool:
        """Whether all limits are kept."""
        return all(use.kept for use in self.limits)

    @property
    def gain(self) -> float:
        """How many times smaller standard deviations, or the condition number, are than for the best random motion, or nan."""
        if not len(self.random):
            return float("nan")
        return float(np.exp((1.0 if self.criterion == "condition" else 0.5) * (self.value - self.random.max())))

    def to_dict(self) -> dict[str, Any]:
        """What ``excitation.json`` holds."""
        base, s, t = self.base, self.series, self.trajectory
        return strict({
            "schema": SCHEMA, "experiment": self.name, "readings": self.readings,
            "criterion": {
                "name": self.criterion, "value": self.value, "random": self.random, "history": self.history,
                "gain_over_best_random": self.gain, "best_random": self.random.max(initial=-np.inf),
            },
            "interrupted": self.interrupted, "options": self.options,
            "series": {"period_s": s.period, "centre": s.centre, "sine": s.sine, "cosine": s.cosine},
            "trajectory": {
                "table": TRAJECTORY, "samples": len(t.times), "duration_s": float(t.times[-1]), "period_s": t.period,
            },
            "blocks": [
                {"kind": b.kind, "shows": b.shows, "table": f"{b.trajectory.name}.csv", "samples": len(b.trajectory.times),
                 "duration_s": b.seconds}
                for b in self.blocks
            ],
            "static_run": None if self.static_run is None else {
                "table": "stop-and-go.csv", "stops": len(self.static_run.rows), "duration_s": self.static_run.seconds,
                "every_sample": self.static_run.every_sample,
            },
            "within_limits": self.within_limits, "limits": [{**asdict(u), "kept": u.kept} for u in self.limits],
            "diagnosability": None if self.diagnosability is None else {
                "value": self.diagnosability.value, "hidden": self.diagnosability.hidden,
                "effects": [{**vars(e), "effect": e.effect.spec} for e in self.diagnosability.effects],
            },
            "quantities": [{"name": name, "unit": unit, "std": std} for name, unit, std in self.quantities],
            "rank": base.rank, "possible_rank": self.possible, "condition_number": self.condition_number,
            "base_parameters": [
                {"name": n, "label": label, "unit": unit, "std": std}
                for n, label, unit, std in zip(base.names, base.labels, base.units, self.std, strict=True)
            ],
            "notes": self.notes, "runtime_s": self.seconds,
        })  # fmt: skip

    def _beside(self) -> Files:
        motions = [self.trajectory, *(b.trajectory for b in self.blocks)]
        files: dict[str, str | Callable[[Path], Any]] = {
            f"{motion.name}.csv": partial(write_trajectory, motion) for motion in motions
        }
        files["motions.toml"] = tomli_w.dumps({"motion": [_section(motion) for motion in motions]})
        if self.static_run is not None:
            files["stop-and-go.csv"] = partial(_write_stops, self.static_run)
        return files

    def __repr__(self) -> str:
        state = "within all limits" if self.within_limits else "outside its limits"
        return f"<Excitation {self.name}: {len(self.joint_names)} joints, {self.trajectory.times[-1]:g} s, {state}>"

    def _parts(self) -> list[str | ShownTable]:
        lines: list[str | ShownTable] = [
            f"{self.name}: exciting trajectory of {self.trajectory.times[-1]:g} s for {self.readings}",
            self.criterion_text,
        ]
        if len(self.random):
            smaller = f"{number(self.gain, 2)} times smaller than with the best of {counted(len(self.random), 'random motion')}"
            whole = self.criterion == "condition"
            lines.append(
                f"condition number {smaller}" if whole else f"standard deviations about {smaller} within the same limits"
            )
        rank, condition = f"{self.base.rank} of {self.possible}", number(self.condition_number, 3)
        lines.append(f"{rank} base parameters determined, condition number {condition}")
        rows = []
        for kind in dict.fromkeys(use.kind for use in self.limits):
            use = max((use for use in self.limits if use.kind == kind), key=lambda use: use.ratio)
            rows.append([KINDS[kind], use.where, f"{number(use.reached, 3)} {use.unit}", f"{number(use.limit, 3)} {use.unit}",
                         percent(use.ratio) if kind != "collision" else "kept" if use.kept else "broken"])  # fmt: skip
        lines.append(ShownTable(["nearest to its limit", "where", "reached", "allowed", "share"], rows))
        lines += [
            f"expected standard deviation of {name}: {number(std, 3)} {powers(unit)}" for name, unit, std in self.quantities
        ]
        if self.diagnosability is not None:
            seen = sum(e.smallest <= e.usual for e in self.diagnosability.effects)
            lines.append(f"effects that would be seen at their usual size: {seen} of {len(self.diagnosability.effects)}")
        if self.blocks:
            lines.append("blocks: " + ", ".join(f"{b.trajectory.name} ({block_length(b)})" for b in self.blocks))
        if self.static_run is not None:
            lines.append(f"static run: {len(self.static_run.rows)} stops, {duration_text(self.static_run.seconds)}")
        if self.interrupted:
            lines.append("interrupted: this is the best motion so far")
        return [*lines, *(f"note: {note}" for note in self.notes)]


def _section(motion: Trajectory) -> dict[str, Any]:
    """``[[motion]]`` of experiment.toml for a recording of this motion."""
    section: dict[str, Any] = {"name": motion.name, "role": motion.role, "kind": motion.kind, "table": f"{motion.name}.csv"}
    section |= {} if motion.period is None else {"period": float(motion.period)}
    section |= {"parked": [list(map(float, interval)) for interval in motion.parked]} if motion.parked else {}
    return section | ({} if motion.static_positions is None else {"static": f"{motion.name}_static.csv"})


def _write_stops(run: StopAndGo, path: Path) -> None:
    """The schedule as a table: row of the motion, time of arrival and of reading, and the positions."""
    from pandas import DataFrame

    columns = {"row": run.rows, "arrive": run.arrive, "read_start": run.start, "read_end": run.end}
    columns |= {f"q{j + 1}": run.positions[:, j] for j in range(run.positions.shape[1])}
    DataFrame(columns).to_csv(path, index=False, float_format="%.9g")


def telling_sentence(telling: Telling) -> str:
    """What to record and what that will settle, or that no motion does."""
    t = telling
    if t.pairs and len(t.hopeless) == len(t.pairs):
        return _hopeless(t).lstrip()
    text = f"Record {NEXT_MOTION} ({duration(t)}, {t.label}) and fit it together with these motions: "
    text += f"it decides between {listed_names(t.rivals)} with probability {chance(t.probability)}"
    text += "" if t.estimated else ", each at its usual size"
    return f"{text}.{_hopeless(t)}"


def _hopeless(t: Telling) -> str:
    """Which rivals no motion tells apart, ``a from b``, where a is the true one; a few of them, nothing where there are none."""
    if not t.hopeless:
        return ""
    pairs = "; ".join(f"{p.true} from {p.other}" for p in t.hopeless[:_NAMED])
    pairs += f" and {len(t.hopeless) - _NAMED} more" if len(t.hopeless) > _NAMED else ""
    return f" Of {t.tried} motions within the limits none tells {pairs}: another sensor or channel may."


def duration(telling: Telling) -> str:
    """How long the motion takes."""
    return f"{number(float(telling.trajectory.times[-1] - telling.trajectory.times[0]), 3)} s"


def listed_names(names: tuple[str, ...]) -> str:
    """Rivals in a sentence; semicolons where a rival is several effects."""
    return in_words(names, "; " if any(", " in name for name in names) else ", ")


def chance(probability: float) -> str:
    """A probability from draws as per cent, never quite certain."""
    return "over 99 %" if probability > 0.99 else "under 1 %" if probability < 0.01 else percent(probability, 2)


def pair_table(telling: Telling) -> ShownTable:
    """Each rival as the true one, and each other that it rules out."""
    rows = []
    for p in telling.pairs:
        gained = f"{number(p.log_bayes_factor, 3)} ± {number(p.log_bayes_factor_std, 2)}"
        rows.append([p.true, p.other, number(p.noncentrality, 3), gained, chance(p.probability)])
    return ShownTable(["if true", "rules out", "noncentrality", "log evidence", "probability"], rows, "k k n n nb")


def telling_dict(telling: Telling, file: str) -> dict[str, Any]:
    """The motion's file, the probabilities, and every pair, for the JSON file."""
    t = telling
    return {
        "file": file, "motion": t.label, "duration": float(t.trajectory.times[-1] - t.trajectory.times[0]),
        "probability": t.probability, "wrong": t.wrong, "sizes": "estimated" if t.estimated else "usual",
        "rivals": [{"effects": name, "probability": w} for name, w in zip(t.rivals, t.weights, strict=True)],
        "pairs": [asdict(p) for p in t.pairs], "tried": t.tried, "notes": list(t.notes),
    }  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class DistinguishingMotion(ShownResult):
    """The motion that best tells effects apart.

    Attributes
    ----------
    name
        The experiment's name.
    channel
        ``wrench``, ``torque`` or ``both``.
    recordings
        Motions that count, in the order of the experiment; none where nothing is recorded yet.
    telling
        The motion, and what it will tell.
    seconds
        Run time of every stage.
    """

    verb, report = "excite", "excitation"
    name: str
    channel: str
    recordings: tuple[str, ...]
    telling: Telling
    seconds: dict[str, float]

    def _beside(self) -> Files:
        return {TRAJECTORY: partial(write_trajectory, self.telling.trajectory)}

    def __repr__(self) -> str:
        t = self.telling
        return f"<DistinguishingMotion of {self.name}: {listed_names(t.rivals)}, {chance(t.probability)}>"

    @property
    def lead(self) -> str:
        """What the motion is and what it decides, in a sentence or two."""
        t = self.telling
        together = f" together with {', '.join(self.recordings)}" if self.recordings else ""
        sizes = "as large as estimated" if t.estimated else "each at its usual size"
        text = f"A motion of {duration(t)}, {t.label}, tells {listed_names(t.rivals)}{together}, {sizes}, "
        text += f"with probability {chance(t.probability)}."
        return text + _hopeless(t)

    def _parts(self) -> list[str | ShownTable]:
        return [f"{self.name}: {self.lead}", pair_table(self.telling)]

    def to_dict(self) -> dict[str, Any]:
        """What ``excitation.json`` holds."""
        return {
            "schema": SCHEMA, "experiment": self.name, "channel": self.channel, "recordings": list(self.recordings),
            "tell": telling_dict(self.telling, TRAJECTORY), "runtime_s": dict(self.seconds),
        }  # fmt: skip
