"""What ``watch`` found in a series of recordings, and how it shows itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.diagnosis.changes.findings import NamedChange, ReferenceComparison
from bayesid.results.changes import change_dict, value_text
from bayesid.results.files import SCHEMA, ShownResult, strict
from bayesid.rounding import DASH, number
from bayesid.section import Cell, ShownTable, powers
from bayesid.validation.own_fit import left_dict
from bayesid.validation.prediction import Prediction

_WORDS = {
    "named": "changed", "named_in_part": "changed, named in part", "ambiguous": "changed, ambiguous",
    "unknown": "changed, unknown", "nothing_missing": "nothing changed",
}  # fmt: skip
_MOODS = {"nothing_missing": "good", "unknown": "bad", "not_compared": "bad"}


@dataclass(frozen=True, eq=False)
class Watched:
    """One recording of the series."""

    name: str  # of the recording
    comparison: ReferenceComparison | None  # what changed since the reference; None where it could not be compared
    complaint: str = ""  # why it could not
    #: What the reference's fit leaves of its motions, as `bayesid.identify` fits and measures it.
    left: tuple[Prediction, ...] = ()

    @property
    def times_noise(self) -> float:
        """Root mean square over its motions of what the reference's fit leaves over the noise; nan where that is not known."""
        known = [p.whitened_rms for p in self.left if p.noise_known]
        return float(np.sqrt(np.mean(np.square(known)))) if known else float("nan")

    @property
    def verdict(self) -> str:
        """Verdict as in ``diagnosis.json``, or ``not_compared``."""
        return "not_compared" if self.comparison is None else self.comparison.verdict

    @property
    def changes(self) -> tuple[NamedChange, ...]:
        """Changes that are named; none where the recording was refused."""
        return () if self.comparison is None else self.comparison.changes

    @property
    def gap(self) -> float:
        """What the reference leaves of the recording, in what the recording's own fit leaves; nan where not compared."""
        errors = None if self.comparison is None else self.comparison.errors
        return float("nan") if errors is None else float(np.sqrt(errors.reference / errors.floor))

    @property
    def evidence(self) -> float:
        """Largest log evidence of a single change; nan where not compared."""
        return float("nan") if self.comparison is None else max((e for _, e in self.comparison.scores), default=0.0)

    @property
    def words(self) -> str:
        """The verdict in a few words."""
        return _WORDS.get(self.verdict, "not compared")

    @property
    def line(self) -> list[Cell]:
        """Cells of the table: name, verdict, what changed, the gap, and what is left over the noise."""
        verdict = self.words, _MOODS.get(self.verdict, "fair")
        if self.comparison is None:
            return [self.name, verdict, self.complaint, DASH, DASH]
        noise = number(self.times_noise, 3) if np.isfinite(self.times_noise) else DASH
        return [self.name, verdict, "; ".join(map(_change_text, self.changes)) or DASH, number(self.gap, 3), noise]

    def __str__(self) -> str:
        """The recording in one line."""
        said = self.complaint or "; ".join(map(_change_text, self.changes))
        gap = "" if self.comparison is None else f" (residual {number(self.gap, 3)} times that of its own fit)"
        return f"{self.name}: {self.words}{f': {said}' if said else ''}{gap}"

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``watch.json``."""
        out: dict[str, Any] = {"name": self.name, "verdict": self.verdict}
        if self.comparison is None:
            return {**out, "complaint": self.complaint}
        p = self.comparison.errors
        return strict({
            **out, "effects": [change_dict(x) for x in self.changes], "gap": self.gap,
            "gap_left": float(np.sqrt((p.after if self.changes else p.tolerance) / p.floor)),
            "largest_log_evidence": self.evidence, "left": [left_dict(x) for x in self.left],
            "times_noise": self.times_noise,
        })  # fmt: skip


@dataclass(frozen=True, eq=False)
class Watch(ShownResult):
    """A series of recordings compared with one reference.

    Attributes
    ----------
    reference
        Its name.
    folder
        Its folder; None where it was made in memory.
    recordings
        In the order given.
    accept
        Log evidence that a change had to bring to be named.
    planned
        How many recordings the series has; more than there are where it was interrupted.
    seconds
        Run time.
    """

    verb, report = "watch", "watch"
    reference: str
    folder: str | None
    recordings: tuple[Watched, ...]
    accept: float
    planned: int
    seconds: float = 0.0

    def __repr__(self) -> str:
        changed = sum(bool(w.changes) for w in self.recordings)
        return f"<Watch of {len(self.recordings)} recordings against {self.reference}: {changed} with changes>"

    @property
    def history(self) -> dict[str, tuple[str, ...]]:
        """Recordings in which each change is named, by change, in order of the first."""
        out: dict[str, tuple[str, ...]] = {}
        for w in self.recordings:
            for x in w.changes:
                out[x.change.spec] = (*out.get(x.change.spec, ()), w.name)
        return out

    def sentences(self) -> list[str]:
        """Say when each change came, and whether it stayed."""
        names = [w.name for w in self.recordings]
        out = []
        for spec, where in self.history.items():
            later = [w for w in self.recordings[names.index(where[0]) :] if w.comparison is not None]
            part = "all" if len(later) == len(where) else f"{len(where)} of {len(later)}"
            out.append(f"{spec}: first in {where[0]}" + (f", in {part} recordings from then on" if len(later) > 1 else ""))
        if not out:
            out.append("Nothing changed that these recordings could show")
        if len(names) < self.planned:
            out.append(f"Interrupted: {len(names)} of {self.planned} recordings were compared")
        return out

    @property
    def table(self) -> ShownTable:
        """A line for each recording."""
        head = ["recording", "verdict", "what changed", "residual over own fit", "x noise"]
        return ShownTable(head, [w.line for w in self.recordings], "k - w n n")

    def _parts(self) -> list[str | ShownTable]:
        head = f"{len(self.recordings)} recordings since {self.reference}"
        head += f"; a change is named from a log evidence of {self.accept:.3g}"
        return [head, self.table, *(f"{s}." for s in self.sentences())]

    def to_dict(self) -> dict[str, Any]:
        """What ``watch.json`` holds."""
        return strict({
            "schema": SCHEMA, "experiment": self.reference, "reference": self.folder or self.reference,
            "log_evidence_needed": self.accept, "planned": self.planned,
            "recordings": [w.to_dict() for w in self.recordings],
            "history": {spec: list(where) for spec, where in self.history.items()},
            "runtime_s": self.seconds,
        })  # fmt: skip


def _change_text(x: NamedChange) -> str:
    """``payload@joint6 m 2.78 ± 0.22 kg``."""
    name, text, half, _, unit = value_text(x.values[0])
    return f"{x.change.spec} {name} {text}{'' if half == DASH else f' ± {half}'} {powers(unit)}".rstrip()
