"""What ``diagnose --reference`` and ``watch`` found: what changed since a reference, in one recording and in a series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.arguments import argument, call
from bayesid.diagnosis.changes.findings import HiddenChange, NamedChange, ReferenceComparison, Value, no_such_robot
from bayesid.diagnosis.changes.held_out import Place
from bayesid.diagnosis.changes.hypotheses import EVERYWHERE, Hypothesis
from bayesid.estimators.parameters import joined, with_ends
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import EffectParameters, write_model
from bayesid.results.files import SCHEMA, Files, ShownResult, strict
from bayesid.results.fitted_model import fitted_model, placed
from bayesid.rounding import DASH, HALF, channel_text, ends, number, percent, unit_text, with_half
from bayesid.section import Cell, ShownTable, as_html, powers
from bayesid.validation.own_fit import left_dict
from bayesid.validation.prediction import Prediction

#: Kinds of changes whose smallest visible size is given where nothing changed.
_LISTED = ("payload", "friction", "coulomb_friction", "viscous_friction", "torque_gain", "sensor_offset", "sensor_gain")
#: Each verdict in a few words, and its colour.
VERDICTS = {
    "named": ("changed", "fair"), "named_in_part": ("changed, named in part", "fair"),
    "ambiguous": ("changed, ambiguous", "fair"), "unknown": ("changed, unknown", "bad"),
    "nothing_missing": ("nothing changed", "good"), "not_compared": ("not compared", "bad"),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Changes(ShownResult):
    """What `diagnose` found with a reference: the changes since then.

    Attributes
    ----------
    comparison
        Everything that was found.
    seconds
        Run time.
    remarks
        What the user should know about the recordings, and about those of the reference.
    """

    verb, report = "diagnose", "changes"
    comparison: ReferenceComparison
    seconds: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """``named``, ``named_in_part``, ``ambiguous``, ``unknown`` or ``nothing_missing``: nothing changed."""
        return self.comparison.verdict

    @property
    def experiment(self) -> Experiment:
        """The later recording."""
        return self.comparison.recording.problem.experiment

    @property
    def reference(self) -> str:
        """Folder of the reference, its name where it was made in memory."""
        before = self.comparison.reference.problem.experiment
        return before.name if before.folder is None else str(before.folder)

    @property
    def model(self) -> tuple[tuple[str, ...], EffectParameters]:
        """The reference's model with the named changes: effects that came are fixed, for links could take them up again."""
        known = self.comparison.reference
        came = [t for t in self.comparison.terms if t.effect not in known.effects]
        terms = [t for t in self.comparison.terms if t.effect in known.effects and known.hands_on(t.effect)] + came
        _, values = fitted_model(self.experiment, (), terms)
        for term in came:
            values[term.effect.spec]["fixed"] = True
        return tuple(t.effect.spec for t in terms), values

    def __repr__(self) -> str:
        c = self.comparison
        named = f": {', '.join(x.change.spec for x in c.changes)}" if c.changes else ""
        return f"<Changes of {self.experiment.name} since {c.reference.problem.experiment.name}: {self.verdict}{named}>"

    @property
    def table(self) -> ShownTable:
        """Every parameter of every change, with its interval."""
        rows = [[x.change.spec, *value_text(v)] for x in self.comparison.changes for v in (*x.values, *x.derived)]
        return ShownTable(["change", "parameter", "value", "± 95 %", "interval", "unit"], rows, "k k nb n n ku")

    def _parts(self) -> list[str | ShownTable]:
        c = self.comparison
        problem = c.recording.problem
        since, readings = c.reference.problem.experiment.name, channel_text(problem.channel, problem.fitted)
        lines = [f"{problem.experiment.name} since {since}: {c.verdict.replace('_', ' ')} ({readings})", verdict_sentence(c)]
        for x in c.changes:
            for v in (*x.values, *x.derived):
                name, text, half, _, unit = value_text(v)
                before = f" (reference {number(v.before)})" if x.change.known else ""
                lines.append(f"  {x.change.spec}: {name} {joined(text, half)} {powers(unit)}".rstrip() + before)
            if sentence := shares_sentence(x, c):
                lines.append(f"  {sentence}")
        return [*lines, gap_sentence(c), *(f"warning: {w}" for w in self.remarks), *_open(c)]

    def _repr_html_(self) -> str:
        """The same for notebooks, values as a table."""
        c = self.comparison
        shares = [s for x in c.changes if (s := shares_sentence(x, c))]
        table = [self.table] if c.changes else []
        said = [f"warning: {w}" for w in self.remarks]
        return as_html([f"**{verdict_sentence(c)}**", f"{gap_sentence(c)}.", *table, *shares, *said, *_open(c)])

    def to_dict(self) -> dict[str, Any]:
        """What ``diagnosis.json`` holds."""
        c = self.comparison
        minimum = {h.change.spec: h.value for h in c.hidden}
        return strict({
            "schema": SCHEMA, "experiment": self.experiment.name, "reference": self.reference,
            "channel": c.recording.problem.channel, "verdict": c.verdict, "summary": verdict_sentence(c),
            "effects": [entry for x in c.changes for entry in change_dicts(x)],
            "where": [self._place(p) for p in c.errors.places],
            "gap": self._gap(), "remainder": self._remainder(),
            "friction": [{"name": v.name, "reference": v.before, **with_ends(v.value, v.std, v.unit)} for v in c.wandered],
            "candidates": [
                {"name": h.name, "where": h.where, "log_bayes_factor": e, "minimum_detectable": minimum.get(h.spec, np.inf)}
                for h, e in c.scores
            ],
            "identification": {
                "rows": len(c.recording.left), "rows_that_count_as_one": c.recording.correlation,
                "dispersion": c.selection.marginal().dispersion, "tolerance_factor": c.selection.factor,
                "bandwidth_hz": c.recording.problem.smoother.bandwidth,
            },
            "remarks": list(self.remarks), "next_experiment": next_experiment(c), "runtime_s": self.seconds,
        })  # fmt: skip

    def _beside(self) -> Files:
        effects, values = self.model
        return {"model.toml": lambda path: write_model(effects, values, path, self.experiment.library.expressions)}

    def _gap(self) -> dict[str, Any]:
        p = self.comparison.errors
        after = p.after if self.comparison.changes else p.tolerance
        accepted = zip(self.comparison.selection.accepted, p.changes, strict=True)
        return {
            "metric": f"rms on {p.segments} parts held out in turn, over what the recording's own fit leaves",
            "before": np.sqrt(p.reference), "after": np.sqrt(after), "floor": np.sqrt(p.floor),
            "closed": p.closed, "closed_low": p.closed_low,
            "steps": [{"name": a.change.spec, "after": np.sqrt(m)} for a, m in accepted], "tolerance_alone": np.sqrt(p.tolerance),
        }  # fmt: skip

    def _remainder(self) -> dict[str, Any]:
        c = self.comparison
        left = sorted(c.errors.places, key=lambda p: -p.after)
        return {"share": c.errors.remainder, "where": [self._place(p) for p in left[:4]], "described_by": c.described_by}

    def _place(self, place: Place) -> dict[str, Any]:
        problem = self.comparison.recording.problem
        channel = problem.row_model.channels.names[place.channel]
        joint = f"joint{channel[3:]}" if channel.startswith("tau") else None
        return {
            "channel": channel, "motion": problem.regression.motion_names[place.motion], "start": place.start,
            "end": place.end, "joint": joint, "band_hz": [0.0, problem.smoother.bandwidth],
            "before": place.before, "after": place.after,
        }  # fmt: skip


def change_dicts(x: NamedChange) -> list[dict[str, Any]]:
    """Entries of ``effects`` in ``diagnosis.json``: one, or one for every effect that changes by the same factor."""
    one = change_dict(x)
    if not x.change.together:
        return [one]
    specs, out = [e.spec for e in x.change.effects], []
    for e in x.change.effects:
        own = {v.name.removeprefix(f"{e.name}."): v for v in x.derived if v.name.startswith(f"{e.name}.")}
        values = {name: {**with_ends(v.value, v.std, v.unit), "reference": v.before} for name, v in own.items()}
        others = [spec for spec in specs if spec != e.spec]
        out.append({**one, "name": e.name, "parameters": values, "derived": one["parameters"], "together_with": others})
    return out


def change_dict(x: NamedChange) -> dict[str, Any]:
    """An entry of ``effects`` in ``diagnosis.json``."""
    lead = x.found.lead
    return {
        "name": x.change.name, "where": x.change.where, "probability": x.probability, "log_bayes_factor": x.found.evidence,
        "parameters": {v.name: {**with_ends(v.value, v.std, v.unit), "reference": v.before} for v in x.values},
        "derived": {v.name: with_ends(v.value, v.std, v.unit) for v in x.derived},
        "ambiguous_with": [{"name": h.name, "where": h.where} for h, _ in x.found.rivals],
        "next_best": None if lead is None else {"name": lead[0].name, "where": lead[0].where, "behind": lead[1]},
        "share": x.share, "share_low": x.share_low,
    }  # fmt: skip


def worded(change: Hypothesis, comparison: ReferenceComparison) -> str:
    """``payload at joint6 (wrist_3_joint)``; the place is left out where there is only one."""
    if change.where == EVERYWHERE:
        return f"{change.name} at every joint"
    effect = change.effects[0]
    return change.name + placed(effect, comparison.reference.robot).removeprefix(effect.name)


def verdict_sentence(comparison: ReferenceComparison) -> str:
    """The verdict in plain words."""
    c = comparison
    since = f"since ‘{c.reference.problem.experiment.name}’"
    if c.verdict == "nothing_missing" and c.wandered:
        return f"No change is named {since}, but friction differs by more than it usually does: {wandered(c, 2)}."
    if c.verdict == "nothing_missing":
        return f"Nothing has changed {since} that this recording could show: friction and gains are within what they wander."
    if c.verdict == "unknown":
        return f"Something has changed {since}, and no effect of the library is confirmed to explain any of it."
    names = []
    for x in c.changes:
        rivals = [worded(h, c) for h, _ in x.found.rivals]
        names.append(f"{'either ' * bool(rivals)}{worded(x.change, c)}" + (f" or {' or '.join(rivals)}" if rivals else ""))
    end = ", and more stays open" if c.verdict == "named_in_part" else ""
    return f"Changed {since}: {'; '.join(names)}{end}."


def verdict_words(comparison: ReferenceComparison) -> tuple[str, str]:
    """The verdict in a few words, and its colour."""
    if comparison.verdict == "nothing_missing" and comparison.wandered:
        return "no change named, friction differs", "fair"
    return VERDICTS[comparison.verdict]


def wandered(comparison: ReferenceComparison, shown: int) -> str:
    """``coulomb_friction@joint2.level by 5.9 ± 0.6 N m from 9.98``, so many of them."""
    texts = []
    for v in comparison.wandered:
        _, text, half, _, unit = value_text(v)
        texts.append(f"{v.name} by {joined(text, half)} {powers(unit)} from {number(v.before, 3)}".replace("  ", " "))
    return listed(texts, shown)


def value_text(v: Value) -> tuple[str, str, str, str, str]:
    """Name, change, half the 95 % interval, the interval and the unit of a parameter."""
    half = HALF * v.std
    text, spread = with_half(v.value, half)
    return v.name, text, spread, ends(v.value - half, v.value + half), unit_text(v.unit)


def shares_sentence(x: NamedChange, comparison: ReferenceComparison) -> str:
    """How much of the gap a change closes."""
    if not np.isfinite(x.share):
        return ""
    return (
        f"{worded(x.change, comparison)} alone closes {percent(x.share)} of the gap on parts held out in turn, at least "
        f"{percent(x.share_low)} with 95 % confidence"
    )


def gap_sentence(comparison: ReferenceComparison) -> str:
    """The gap on held-out parts."""
    p = comparison.errors
    before, floor = number(float(np.sqrt(p.reference)), 3), number(float(np.sqrt(p.floor)), 3)
    after = number(float(np.sqrt(p.after if comparison.changes else p.tolerance)), 3)
    what = "with the changes" if comparison.changes else "with friction and gains within what they wander"
    return (
        f"on parts held out in turn the reference leaves {before} times what the recording's own fit leaves, "
        f"{after} {what}; the floor is {floor}"
    )


def hidden_by_kind(comparison: ReferenceComparison) -> dict[tuple[str, str, str], list[HiddenChange]]:
    """Changes that could hide, by name, parameter and unit: joints that slide have another than those that turn."""
    out: dict[tuple[str, str, str], list[HiddenChange]] = {}
    for h in comparison.hidden:
        out.setdefault((h.change.name, *h.change.parameters[0]), []).append(h)
    return out


def hidden_sentences(comparison: ReferenceComparison) -> list[str]:
    """How large a change could hide, a sentence for each kind and unit."""
    out = []
    kinds = [(*kind, found) for name in _LISTED for kind, found in hidden_by_kind(comparison).items() if kind[0] == name]
    for name, _, unit, found in kinds:
        sizes = [f"{h.change.where} {number(h.value, 2)}" for h in found if h.change.where != EVERYWHERE and np.isfinite(h.value)]
        if sizes:
            out.append(f"{name} up to{'' if unit == '1' else f' ({unit})'}: {', '.join(sizes)}")
    return out


def notes(comparison: ReferenceComparison) -> list[str]:
    """What the reader should know beside the verdict."""
    c = comparison
    out = []
    for x in c.changes:
        if x.change.name == "payload" and x.values[0].value < 0.0:
            out.append(f"A negative mass at {x.change.where}: something was taken away since the reference.")
    if c.described_by is not None:
        out.append(f"What stays goes with {c.described_by}.")
    if c.wandered:
        out.append(f"Friction that differs by more than it usually does from day to day: {wandered(c, 6)}.")
    if c.verdict == "nothing_missing" and c.wandered and c.scores:
        best, evidence = max(c.scores, key=lambda x: x[1])
        needed = number(c.settings.accept, 3)
        out.append(f"The best single change is {best.spec}, with a log evidence of {number(evidence, 3)}; {needed} is asked for.")
    if (strange := no_such_robot(c.recording, c.errors)).any():
        names = listed([n for n, s in zip(c.recording.problem.row_model.channels.names, strange, strict=True) if s])
        out.append(
            f"The recording's own fit leaves up to {number(float(c.recording.grown.max()), 2)} times as much of {names} as the "
            "reference's leaves: no other links or friction read so. Look for columns or cables that were exchanged, for other "
            f"units or signs (`{call('check')}`), for a sensor that is overloaded or loose, and for contacts."
        )
    return out


def next_experiment(comparison: ReferenceComparison) -> str:
    """What to record next, in a sentence or two; nothing where nothing is open."""
    c = comparison
    if pairs := [(x.change, [h for h, _ in x.found.rivals]) for x in c.changes if x.found.rivals]:
        names = "; ".join(f"{a.spec} from {', '.join(h.spec for h in rivals)}" for a, rivals in pairs)
        text = f"To tell {names}: record the same motion at half and at full speed, and with other joints moving."
        # What the reference's model has, and what all joints share, is not for `excite --tell`.
        plain = [h.spec for a, rivals in pairs[:1] for h in (a, *rivals) if not h.known and h.where != EVERYWHERE]
        planned = f" {call('excite')} with {argument('tell', plain)} plans the motion that does it best."
        return text + (planned if len(plain) > 1 else "")
    if c.verdict not in ("named_in_part", "unknown"):
        return ""
    return (
        "Record one joint at a time, slowly and fast, forth and back, as now and if possible in the known state again: what "
        "stays with position is a cable or a spring, what changes sign with velocity is friction, what grows with "
        "acceleration is inertia or a payload."
    )


def runners_up(comparison: ReferenceComparison) -> list[str]:
    """What would do next best in each change's place, where nothing does as well."""
    leads = [(x.change.spec, x.found.lead) for x in comparison.changes if x.found.lead is not None and not x.found.rivals]
    return [f"Next best in place of {spec}: {h.spec}, {number(lack, 3)} behind in log evidence." for spec, (h, lack) in leads]


def _open(c: ReferenceComparison) -> list[str]:
    """What could hide, what the reader should know, and what to record next."""
    hidden = [] if c.changes else [f"could hide: {text}" for text in hidden_sentences(c)]
    following = [f"next: {text}" for text in [next_experiment(c)] if text]
    return [*hidden, *(f"note: {text}" for text in (*notes(c), *runners_up(c))), *following]


@dataclass(frozen=True, eq=False)
class Watched:
    """One recording of the series."""

    name: str  # of the recording
    comparison: ReferenceComparison | None  # what changed since the reference; None where it could not be compared
    complaint: str = ""  # why it could not
    #: What the reference's fit leaves of its motions, as `bayesid.identify` fits and measures it.
    left: tuple[Prediction, ...] = ()
    #: What the user should know about it.
    warnings: tuple[str, ...] = ()

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
        return float("nan") if errors is None else float(np.sqrt(errors.reference))

    @property
    def evidence(self) -> float:
        """Largest log evidence of a single change; nan where not compared."""
        return float("nan") if self.comparison is None else max((e for _, e in self.comparison.scores), default=0.0)

    @property
    def line(self) -> list[Cell]:
        """Cells of the table: name, verdict, what changed, the gap, and what is left over the noise."""
        if self.comparison is None:
            return [self.name, VERDICTS[self.verdict], self.complaint, DASH, DASH]
        noise = number(self.times_noise, 3) if np.isfinite(self.times_noise) else DASH
        return [self.name, verdict_words(self.comparison), self._said or DASH, number(self.gap, 3), noise]

    @property
    def _said(self) -> str:
        """What changed, or what friction differs."""
        if self.comparison is None:
            return self.complaint
        return "; ".join(map(_change_text, self.changes)) or (
            f"({wandered(self.comparison, 1)})" if self.comparison.wandered else ""
        )

    def __str__(self) -> str:
        """The recording in one line."""
        words = VERDICTS[self.verdict] if self.comparison is None else verdict_words(self.comparison)
        gap = "" if self.comparison is None else f" (residual {number(self.gap, 3)} times that of its own fit)"
        return f"{self.name}: {words[0]}{f': {self._said}' if self._said else ''}{gap}"

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``watch.json``."""
        out: dict[str, Any] = {"name": self.name, "verdict": self.verdict}
        if self.comparison is None:
            return {**out, "complaint": self.complaint}
        p = self.comparison.errors
        return strict({
            **out, "effects": [entry for x in self.changes for entry in change_dicts(x)], "gap": self.gap,
            "gap_left": float(np.sqrt(p.after if self.changes else p.tolerance)),
            "largest_log_evidence": self.evidence, "left": [left_dict(x) for x in self.left],
            "times_noise": self.times_noise, "warnings": list(self.warnings),
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
    warnings
        What the user should know about the reference's recordings.
    """

    verb, report = "watch", "changes"
    reference: str
    folder: str | None
    recordings: tuple[Watched, ...]
    accept: float
    planned: int
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()

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
        if unknown := [w.name for w in self.recordings if w.verdict == "unknown"]:
            out.append(f"Changed in {listed(unknown, 6)}, and no effect of the library is confirmed to explain any of it")
        differs = [w.name for w in self.recordings if _differs(w)]
        if not out:
            out.append("No change is named" if differs else "Nothing changed that these recordings could show")
        if differs:
            out.append(f"In {listed(differs, 6)} friction differs by more than it usually does from day to day")
        if len(names) < self.planned:
            out.append(f"Interrupted: {len(names)} of {self.planned} recordings were compared")
        return out

    @property
    def all_warnings(self) -> list[str]:
        """Of the reference, then of the recordings, each once."""
        told: dict[str, list[str]] = {}
        for w in self.recordings:
            for text in w.warnings:
                told.setdefault(text, []).append(w.name)
        return [*self.warnings, *(f"In {listed(names, 6)}: {text}" for text, names in told.items())]

    @property
    def table(self) -> ShownTable:
        """A line for each recording."""
        head = ["recording", "verdict", "what changed", "residual over own fit", "x noise"]
        return ShownTable(head, [w.line for w in self.recordings], "k - w n n")

    def _parts(self) -> list[str | ShownTable]:
        head = f"{len(self.recordings)} recordings since {self.reference}"
        head += f"; a change is named from a log evidence of {self.accept:.3g}"
        return [head, self.table, *(f"{s}." for s in self.sentences()), *(f"warning: {w}" for w in self.all_warnings)]

    def to_dict(self) -> dict[str, Any]:
        """What ``watch.json`` holds."""
        return strict({
            "schema": SCHEMA, "experiment": self.reference, "reference": self.folder or self.reference,
            "log_evidence_needed": self.accept, "planned": self.planned,
            "recordings": [w.to_dict() for w in self.recordings],
            "history": {spec: list(where) for spec, where in self.history.items()},
            "warnings": list(self.warnings), "runtime_s": self.seconds,
        })  # fmt: skip


def _differs(w: Watched) -> bool:
    """Whether no change is named in a recording, and friction differs by more than it usually does."""
    return w.comparison is not None and w.verdict == "nothing_missing" and bool(w.comparison.wandered)


def _change_text(x: NamedChange) -> str:
    """``payload@joint6 m 2.78 ± 0.22 kg``."""
    name, text, half, _, unit = value_text(x.values[0])
    return f"{x.change.spec} {name} {joined(text, half)} {powers(unit)}".rstrip()
