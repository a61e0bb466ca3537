"""What ``diagnose`` found: its numbers, in one sentence, a few lines for a terminal, a table for a notebook."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from bayesid.design.tell.choose import Telling
from bayesid.diagnosis.candidates import Proposal, least_visible
from bayesid.diagnosis.data import FAR, DiagnosisData, Episode
from bayesid.diagnosis.description.describe import Description
from bayesid.diagnosis.gap import LEAST_GAP
from bayesid.diagnosis.in_part import InPart
from bayesid.diagnosis.locate import Disagreement
from bayesid.diagnosis.push import Push
from bayesid.diagnosis.remarks import by_kind, held_out_text, poses_text
from bayesid.diagnosis.search import Found, Search
from bayesid.diagnosis.stability import Stability
from bayesid.diagnosis.validation import Gap
from bayesid.diagnosis.verdict import Reason
from bayesid.effects import Term
from bayesid.effects.effect import Derived
from bayesid.estimators.parameters import with_ends
from bayesid.recordings.complaints import in_words
from bayesid.recordings.schema import EffectParameters, write_model
from bayesid.results.described import DRAFT, described_lines, description_dict, terms_of, write_draft
from bayesid.results.excitation import NEXT_MOTION, telling_dict
from bayesid.results.files import SCHEMA, Files, ShownResult
from bayesid.results.fitted_model import fitted_model, placed
from bayesid.rounding import DASH, HALF, channel_text, ends, number, percent, unit_text, with_half
from bayesid.section import Part, ShownTable, as_html, powers
from bayesid.simulation.trajectories import write_trajectory
from bayesid.validation.own_fit import MotionErrors, Shift
from bayesid.validation.prediction import Prediction, leaves_more

#: What stands for a value that the data leave open.
NOT_DETERMINED = "not determined"
#: Disagreements that a terminal shows.
_SHOWN = 4
#: So many effects are spelt out in a sentence, and so many channels of what stays; more are named by kind.
_SPELT_OUT, _CHANNELS_SAID = 3, 3
_COUNTS = {1: "one effect", 2: "two effects", 3: "three effects"}


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(ShownResult):
    """What `diagnose` found.

    Attributes
    ----------
    data
        What was compared.
    verdict
        ``named``, ``named_in_part``, ``ambiguous``, ``unknown`` or ``nothing_missing``.
    search
        The models fitted.
    found
        The effects named, none for the last two verdicts.
    where
        Where the user's model and the data disagree.
    gap
        On the validation motions; None without any.
    shifts
        Base parameters that the missing effects had moved, as `bayesid.identify` estimates them with both models.
    remarks
        What the reader should know.
    next_experiment
        What would settle what is open.
    seconds
        Run time.
    stability
        Each effect named without each part of the recordings; None where that says nothing.
    telling
        The motion that settles an ambiguous verdict; None for any other.
    description
        A draft of what no effect explains; None where all is explained, or no motion that it was not chosen on confirms one.
    part
        What held-out recordings say of effects named in part; None for any other verdict.
    reason
        Why the verdict is ``unknown``, or not ``named`` but ``named_in_part``; empty for any other.
    remainder
        Where the model with the effects named in part and the data disagree.
    errors
        What `bayesid.identify` leaves of every motion without and with the effects named; those that were not fitted first.
    left_out
        Friction that the user's model states, by name, that was left out of the search, for it explains more so.
    """

    verb, report = "diagnose", "diagnosis"
    data: DiagnosisData
    verdict: str
    search: Search
    found: tuple[Found, ...]
    where: tuple[Disagreement, ...]
    gap: Gap | None
    remarks: tuple[str, ...]
    next_experiment: str
    seconds: float = 0.0
    stability: tuple[Stability | None, ...] = ()
    telling: Telling | None = None
    description: Description | None = None
    part: InPart | None = None
    reason: Reason = ""
    remainder: tuple[Disagreement, ...] = ()
    errors: tuple[MotionErrors, ...] = ()
    shifts: tuple[Shift, ...] = ()
    left_out: tuple[str, ...] = ()

    def __repr__(self) -> str:
        named = f": {', '.join(f.term.effect.spec for f in self.found)}" if self.found else ""
        return f"<Diagnosis of {self.data.experiment.name}: {self.verdict}{named}>"

    def _parts(self) -> list[str]:
        readings = channel_text(self.data.channel, dict.fromkeys(s.motion for s in self.data.segments))
        lines = [f"{self.data.experiment.name}: {self.verdict.replace('_', ' ')} ({readings})", verdict_sentence(self)]
        for k in range(len(self.found)):
            known = self.part is not None and self.shares(k) is not None
            share = f"; without it {share_range(self, k)} is open again" if known else ""
            for spec, key, value, half, _, unit in effect_rows(self, k):
                text = value if half == DASH else f"{value} ± {half} {powers(unit)}".rstrip()
                lines.append(f"  {spec}: {key} {text}{share}")
                share = ""
        if self.part is not None:
            lines.append(part_sentence(self))
        if self.gap is None:
            lines.append(without_validation(self))
        elif self.found and self.part is None:
            motions, closed, least = ", ".join(self.gap.motions), known_share(self.gap.closed), known_share(self.gap.closed_low)
            if self.gap.difference < self.data.settings.detected**2:
                lines.append(f"{motions} hardly depends on what is named, and neither confirms nor denies it")
            elif closed:
                lines.append(f"gap on {motions}: {closed} closed" + (f", at least {least}" if least else ""))
        lines += [error_line(e) for e in shown_errors(self)]
        if self.verdict == "unknown" and self.search.found:
            lines.append(f"best attempt: {', '.join(by_kind(f.term for f in self.search.found))}")
        lines += self._shown_places()
        lines += [f"note: {r}" for r in notes(self)]
        if self.next_experiment:
            lines.append(f"next: {self.next_experiment}")
        return lines

    def _shown_places(self) -> list[str]:
        """Where model and data disagree, or of effects named in part what stays, the first few places; and what describes it."""
        word = "unexplained" if self.verdict == "nothing_missing" else "stays" if self.part is not None else "disagrees"
        places = self.where if self.part is None else self.remainder
        lines = [f"{word}: {disagreement_line(w, poses=self.data.poses)}" for w in places[:_SHOWN]]
        lines += [f"and in {len(places) - _SHOWN} more places"] if len(places) > _SHOWN else []
        return lines + ([] if self.description is None else described_lines(self.description, self.data.channels.names))

    def _repr_html_(self) -> str:
        """The same for notebooks, values as a table."""
        parts: list[Part] = [f"**{verdict_sentence(self)}** {validation_sentence(self)}"]
        parts += [f"E{error_line(e)[1:]}." for e in shown_errors(self)]
        if self.found:
            rows = [row for k in range(len(self.found)) for row in effect_rows(self, k)]
            parts.append(ShownTable(["effect", "parameter", "value", "± 95 %", "interval", "unit"], rows, "k k nb n n ku"))
        return as_html([*parts, *self._shown_places(), *notes(self), self.next_experiment])

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects of the model after the diagnosis: the user's, as they are beside those named, and those."""
        fitted = self.search.best if self.found else self.search.base
        known = fitted.terms[: len(self.search.base.terms)]
        return (*known, *(f.term for f in self.found))

    def derived(self, index: int) -> tuple[Derived, ...]:
        """What follows from the values of an effect, see `bayesid.effects.effect.Effect.derived`."""
        found, best = self.found[index], self.search.best
        at = [column for column, (owner, _) in enumerate(best.free) if owner == len(self.search.base.terms) + index]
        if len(at) != len(found.std):  # only of a fit of all its parameters is their covariance known
            return ()
        covariance = best.covariance[np.ix_(at, at)]
        scale = found.std / np.sqrt(np.maximum(np.diag(covariance), 1e-300))  # a dispersion, and infinite where undetermined
        with np.errstate(invalid="ignore"):
            return found.term.effect.derived(found.term.values, covariance * np.outer(scale, scale))

    @property
    def needed(self) -> float:
        """Log evidence that an effect has to bring to be named."""
        return self.data.settings.accept

    @property
    def model(self) -> tuple[tuple[str, ...], EffectParameters]:
        """The experiment's model with the named effects added, see `bayesid.results.fitted_model`."""
        experiment = self.data.experiment
        return fitted_model(experiment, [*experiment.effects, *(f.term.effect.spec for f in self.found)], self.terms)

    def evidence(self, proposal: Proposal) -> float:
        """Log evidence that an effect alone would add to the user's model."""
        each = float(np.log(self.search.projector.rows))
        return 0.5 * (proposal.gain / self.search.dispersion - proposal.parameters * each)

    def least_visible(self, proposal: Proposal) -> dict[str, float]:
        """Size of each parameter alone from which an effect is named half of the time, where there is one."""
        search = self.search
        least = least_visible(self.data.settings, proposal.parameters, search.projector.rows, search.dispersion)
        each = zip(proposal.term.effect.parameters, proposal.lengths, strict=False)  # none of an effect without amplitude
        return {name: least / length for name, length in each if length > 0.0}

    def to_dict(self) -> dict[str, Any]:
        """What ``diagnosis.json`` holds."""
        return {
            "schema": SCHEMA, "experiment": self.data.experiment.name, "channel": self.data.channel, "verdict": self.verdict,
            "effects": [self._effect(f, k) for k, f in enumerate(self.found)],
            "remainder": self._remainder(), "where": [d.to_dict() for d in self.where], "gap": self._gap(),
            "errors": [e.to_dict() for e in self.errors],
            "description": None if self.description is None else description_dict(self.description, self.data.channels.names),
            "candidates": [
                {"name": p.term.effect.name, "where": p.term.effect.where, "log_bayes_factor": self.evidence(p),
                 "minimum_detectable": self.least_visible(p).get(p.term.effect.parameters[0])}
                for p in self.search.proposals
            ],
            "identification": {
                "rows": self.search.projector.rows,
                "before": float(np.sqrt(self.search.base.chi2 / self.search.projector.rows)),
                "after": float(np.sqrt(self.search.best.chi2 / self.search.projector.rows)),
                "unexplained": float(np.sqrt(self.search.dispersion)),
            },
            "left_out": list(self.left_out), "base_parameter_shifts": [asdict(shift) for shift in self.shifts],
            "remarks": list(self.remarks), "next_experiment": self.next_experiment,
            "next_motion": None if self.telling is None else telling_dict(self.telling, NEXT_MOTION),
            "runtime_s": self.seconds,
        }  # fmt: skip

    def _beside(self) -> Files:
        effects, values = self.model
        files = {"model.toml": lambda path: write_model(effects, values, path, self.data.experiment.library.expressions)}
        if (telling := self.telling) is not None:
            files[NEXT_MOTION] = partial(write_trajectory, telling.trajectory)
        if (description := self.description) is not None:
            files[DRAFT] = lambda path: write_draft(description, self.data.experiment, path)
        return files

    def _gap(self) -> dict[str, Any] | None:
        """The gap of the model as it is handed on: an attempt that was not accepted closes nothing."""
        if self.gap is None:
            return None
        out = {**self.gap.to_dict(), "floor_known": self.data.floor_known, "floor_source": self.data.floor_source}
        if self.verdict == "unknown":
            out |= {"best_attempt_after": out["after"], "after": out["before"], "closed": 0.0, "closed_low": 0.0}
        return out

    def shares(self, index: int) -> tuple[float, float] | None:
        """Share of the held-out gap that an effect closes and its lower end; None where that was not measured for it alone."""
        if isinstance(self.found[index].term, Push):  # it is in no other motion
            return None
        if self.part is not None:
            return self.part.shares[index].share, self.part.shares[index].share_low
        alone = len(self.found) == 1 and self.gap is not None and np.isfinite(self.gap.closed)
        return (self.gap.closed, self.gap.closed_low) if self.gap is not None and alone else None

    def _remainder(self) -> dict[str, Any] | None:
        """What stays beside effects named in part."""
        if self.part is None:
            return None
        rows = [] if self.description is None else terms_of(self.description, self.data.channels.names)
        described_by = "; ".join(f"{reading} ~ {formula}" for reading, formula, *_ in rows) or None
        return {
            "share": self.part.remainder, "where": [d.to_dict() for d in self.remainder], "described_by": described_by,
            "closed_in": [
                {"channels": list(g.channels), "effects": list(g.effects), "share": g.closed} for g in self.part.groups
            ],
            "stretches": self.part.held_out_parts, "correlated_rows": self.part.correlation,
        }  # fmt: skip

    def _effect(self, found: Found, index: int) -> dict[str, Any]:
        effect = found.term.effect
        parameters = {key: with_ends(value, s, unit) for key, value, s, unit in found.term.with_std(found.std)}
        derived = {key: with_ends(value, s, unit) for key, value, s, unit in self.derived(index)}
        rivals = [{"name": t.effect.name, "where": t.effect.where} for t, _ in found.rivals]
        share, share_low = self.shares(index) or (None, None)
        odds = np.array([0.0, *(-lack for _, lack in found.rivals)])
        probability = (1.0 - self.data.settings.outside_library) / np.exp(odds).sum()
        return {
            "name": effect.name, "where": effect.where, "probability": float(probability),
            "log_bayes_factor": found.gain, "share": share, "share_low": share_low, "parameters": parameters,
            "derived": derived, "ambiguous_with": rivals,
            "stability": next((x.to_dict() for x in self.stability if x and x.spec == effect.spec), None),
            "course": found.term.to_dict() if isinstance(found.term, Push) else None,
        }  # fmt: skip


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict in plain words."""
    d = diagnosis
    names = [f"{placed(f.term.effect, d.data.robot)} ({f.term.effect.summary})" for f in d.found]
    if d.verdict == "nothing_missing" and not d.data.floor_known:
        return "Nothing of the library is missing that these motions could show; anything else may be: the noise is not known."
    if d.verdict == "nothing_missing" and (more := [e.last for e in d.errors if leaves_more(e.last)]):
        worst = max(more, key=lambda p: p.whitened_rms)
        stays = f"{_times(worst)} times the noise stays on ‘{worst.motion}’"
        return f"Nothing of the library is missing that these motions could show; yet in a fit of all readings {stays}."
    if d.verdict == "nothing_missing":
        return "Nothing is missing that these motions could show: the model as it is explains the readings down to their noise."
    if d.verdict == "unknown":
        return "Something is missing, and no effect of the library explains it."
    count = _COUNTS.get(len(names), f"{len(names)} effects")
    misses = f"Without its own {in_words(d.left_out)} the model misses" if d.left_out else "The model misses"
    if d.verdict == "named_in_part":
        each = [_with_rivals(name, f, d) for name, f in zip(names, d.found, strict=True)]
        spelt = in_words(each) if len(names) <= _SPELT_OUT else in_words(by_kind(f.term for f in d.found))
        by = "" if d.part is None else f" that {held_out_text(d.data, d.part.held_out_parts)} confirm"
        more = d.part is None or d.reason == "residual" or bool(d.part.groups)
        return f"{misses} {count}{by}{', and more that stays unexplained' if more else ''}: {spelt}."
    if d.verdict == "ambiguous":
        parts = [_with_rivals(name, f, d) for name, f in zip(names, d.found, strict=True)]
        these = "poses" if d.data.poses else "motions"
        return f"{misses} {count}, but these {these} do not tell every name apart: {'; and '.join(parts)}."
    return f"{misses} {count}: {' and '.join(names)}."


def _with_rivals(name: str, found: Found, diagnosis: Diagnosis) -> str:
    """An effect with those that explain as much."""
    others = [" with ".join(placed(t.effect, diagnosis.data.robot) for t in terms) for terms in found.alternatives]
    return f"either {name} or {' or '.join(others)}" if others else name


def part_sentence(diagnosis: Diagnosis) -> str:
    """What effects named in part close of the gap on recordings held out in turn, and what stays."""
    d, part = diagnosis, diagnosis.part
    if part is None:
        return ""
    own = part.search.found
    closes = f"{in_words(by_kind(f.term for f in own))} {'closes' if len(own) == 1 else 'close'}"
    if len(own) == len(d.found):  # a push is no part of other recordings
        closes = "it closes" if len(own) == 1 else "they close"
    none = part.remainder < LEAST_GAP
    text = f"With each of {part.held_out_parts} {held_out_text(d.data, part.held_out_parts)}, {closes} "
    text += "all of the gap" if none else f"{percent(1.0 - part.remainder)} of the gap and {percent(part.remainder)} stays"
    if part.courses[-1] == 0.0:
        known = d.data.floor_source == FAR  # known, but not what weighs rows that hold far more
        text += f", the noise{'' if known else ', which is not known,'} included"
    places = [w for w in d.remainder if not w.event]
    channels = in_words(list(dict.fromkeys(w.channel for w in places))[:_CHANNELS_SAID])
    joints = in_words(list(dict.fromkeys(w.joint for w in places[:_SHOWN] if w.joint)))
    if channels:
        text += "; what still stands out of the noise is" if none else ", most of it"
        text += f" in {channels}" + (f", and it goes with {joints}" if joints else "")
    if none:  # of what parts of the recordings show; another motion may show more
        unseen = [e.last for e in d.errors if not e.fitted and e.last.noise_known]
        left = [p for p in unseen if (p.whitened_rms / p.expected_rms) ** 2 > d.data.settings.unexplained]
        more = [f"{_times(p)} times the noise stays on ‘{p.motion}’" for p in left]
        text += f"; yet {in_words(more)}, which took no part in any fit" if left else ""
    return f"{text}."


def validation_sentence(diagnosis: Diagnosis) -> str:
    """What unseen motions, or for want of any the fitted ones, say of it."""
    d, gap = diagnosis, diagnosis.gap
    others = [f"‘{e.motion}’" for e in d.errors if not e.fitted]
    of_others = f"On {in_words(others)}, which took no part in any fit, {left_text(d)}." if others else ""
    if gap is None:
        of_fitted = f"On the fitted {'ones' if len(d.errors) > 1 else 'one'} {left_text(d)}." if d.errors else ""
        text = f"{without_validation(d)} {of_others or of_fitted}".rstrip()
        return f"{part_sentence(d)} {text}" if d.verdict == "named_in_part" else text
    text = of_others
    if d.verdict == "named_in_part":
        return f"{part_sentence(d)} {text}".rstrip()
    if d.verdict == "nothing_missing":
        count = sum(not w.event for w in d.where)
        if count:
            places, them = ("one place stands", "it") if count == 1 else (f"{count} places stand", "them")
            text += f" In the fitted motions {places} out of the noise, but no effect of the library explains {them}."
    elif d.verdict == "unknown":
        tried, closed = in_words(by_kind(f.term for f in d.search.found)), known_share(gap.closed)
        if tried:
            text += f" The best attempt ({tried}) closes {closed or 'nothing'} of the gap."
    elif gap.difference < d.data.settings.detected**2:
        what = "it" if len(d.found) == 1 else "them"
        text += f" The readings of these motions hardly depend on {what}, so they neither confirm nor deny {what}."
    elif closed := known_share(gap.closed):
        least = known_share(gap.closed_low)
        where = "" if len(others) == len(gap.motions) else f" on {in_words([f'‘{m}’' for m in gap.motions])}"
        text += f" That closes {closed} of the gap{where}" + (f", at least {least}." if least else ".")
    here = [f.term for f in d.found if isinstance(f.term, Episode)]
    if here and isinstance(here[0], Push):
        text += f" A push is in ‘{here[0].motion}’ alone; the other motions are explained without it."
    elif here:
        text += f" A contact happens once, here in ‘{here[0].motion}’, so other motions cannot confirm it."
    return text.strip()


def without_validation(diagnosis: Diagnosis) -> str:
    """That no motion validates what was found, and whether there are such motions at all."""
    if any(not e.fitted for e in diagnosis.errors):
        return "The search validated what it found on no other motion."
    return "No motion that took no part in the fit was compared."


def which_motions(diagnosis: Diagnosis) -> str:
    """The motions that the numbers are of, where the search was validated on none."""
    if diagnosis.gap is not None:
        return ""
    others = [f"‘{e.motion}’" for e in diagnosis.errors if not e.fitted]
    if others:
        return (
            f"**The search was validated on no other motion.** What is left by channel is that of {in_words(others)}, which took "
            "no part in the fit; the courses below it are of fitted ones."
        )
    if diagnosis.data.skipped:
        return "**No validation motion could be compared**: these are the fitted motions, and held-out validation is missing."
    return "**There is no validation motion**: these are the fitted motions, and held-out validation is missing."


def shown_errors(diagnosis: Diagnosis) -> tuple[MotionErrors, ...]:
    """Errors of the motions that were not fitted, or of all where there are none."""
    return tuple(e for e in diagnosis.errors if not e.fitted) or diagnosis.errors


def left_text(diagnosis: Diagnosis) -> str:
    """What is left of the motions: in units of the noise, or of the signal where no reading tells the noise."""
    errors = shown_errors(diagnosis)
    several = len(errors) > 1

    def each(e: MotionErrors, value: Callable[[Prediction], str]) -> str:
        where = f" on ‘{e.motion}’" if several else ""
        return value(e.before) + where if e.after is None else f"from {value(e.before)} to {value(e.after)}{where}"

    goes = any(e.after is not None for e in errors)
    known = all(e.before.noise_known for e in errors)
    size = _times if known else _share
    sizes = in_words([each(e, size) for e in errors])
    if known:
        complete = number(max(e.last.expected_rms for e in errors), 3)
        text = f"the residual goes {sizes} times the noise" if goes else f"{sizes} times the noise is left"
        return f"{text}; a complete model would leave {complete}"
    text = f"the error goes {sizes} of the signal" if goes else f"the error is {sizes} of the signal"
    return f"{text} (the measurement noise is not known)"


def _times(p: Prediction) -> str:
    return number(p.whitened_rms, 3)


def _share(p: Prediction) -> str:
    return percent(p.relative_error)


def error_line(e: MotionErrors) -> str:
    """One motion's errors without and with the effects named, in times the noise, per cent and units.

    All channels together, then those that gain most, or of which most is left where nothing is named.
    """
    before, after = e.before, e.last

    def change(text: Callable[[Prediction], str]) -> str:
        return text(before) if e.after is None else f"{text(before)} -> {text(after)}"

    order = np.argsort(-before.rmse / np.maximum(before.signal if e.after is None else after.rmse, 1e-300))
    worst = [k for k in order if before.rmse[k] > 0.0][:_CHANNELS_SAID]
    units = before.channel_units
    parts = [f"{before.channel_names[k]} {change(lambda p, k=k: number(float(p.rmse[k]), 3))} {units[k]}" for k in worst]
    noise = f"{change(_times)} x noise" if before.noise_known else "noise not known"
    whole = change(_share)
    return f"error of {e.motion}{' (fitted)' if e.fitted else ''}: {noise}, {whole} of the signal; {', '.join(parts)}"


def notes(diagnosis: Diagnosis) -> list[str]:
    """What the reader should know beside the verdict and its validation."""
    said = [r for r in diagnosis.remarks if not r.startswith("Something is missing")]
    return [*said, *event_sentences(diagnosis)]


def steady_sentence(found: Found, diagnosis: Diagnosis) -> str:
    """Between which values the parameters stay, and what evidence is left, whichever part of the recordings is left out."""
    mine = next((x for x in diagnosis.stability if x is not None and x.spec == found.term.effect.spec), None)
    if mine is None:
        return ""
    parts = []
    for key, value, unit, (low, high) in zip(
        found.term.effect.parameters, found.term.values, found.term.effect.units, mine.ranges, strict=True
    ):
        if np.isfinite(low) and np.isfinite(high):
            # As many digits as tell the two ends apart.
            first, last = (with_half(v, max(0.2 * (high - low), 1e-6 * abs(value)))[0] for v in (low, high))
            parts.append(f"{key} between {first} and {last} {powers(unit_text(unit))}".rstrip())
        else:
            parts.append(f"{key} not determined")
    least = f"{mine.least:,.0f}".replace(",", " ") if mine.least >= 100 else number(mine.least, 3)
    return f"Whichever of {mine.blocks} parts of the recordings is left out: {'; '.join(parts)}; log evidence at least {least}."


def event_sentences(diagnosis: Diagnosis) -> list[str]:
    """Short events above the compared band, a sentence for each motion that has some."""
    events = [w for w in diagnosis.where if w.event]
    out = []
    for motion in dict.fromkeys(w.motion for w in events):
        mine = sorted((w for w in events if w.motion == motion), key=lambda w: w.start)
        channels = in_words(list(dict.fromkeys(w.channel for w in mine)))
        taps, one = sum(w.tap for w in mine), len(mine) == 1
        times = in_words([f"{w.peak:.2f}" for w in mine])
        text = f"{'One short event' if one else f'{len(mine)} short events'} in ‘{motion}’ at {times} s, loudest in {channels}, "
        text += f"above the frequencies that models are compared at ({mine[0].band_hz[0]:.3g} Hz and more)"
        text += ", in a motion that took no part in the fit" if mine[0].unseen else ""
        if taps:
            those = "it" if one else "they" if taps == len(mine) else f"{'one' if taps == 1 else taps} of them"
            who = f"{those} looks like a tap" if taps == 1 else f"{those} look like taps"
            text += f"; {who}: a broad band, over within {diagnosis.data.settings.moment:g} s"
        out.append(f"{text}. No motion of the robot explains {'it' if one else 'them'}.")
    return out


def effect_rows(diagnosis: Diagnosis, index: int) -> list[tuple[str, str, str, str, str, str]]:
    """The effect before each of its `parameter_rows`, in the first with those that explain as much."""
    found = diagnosis.found[index]
    rivals = "".join(f" or {' with '.join(t.effect.spec for t in terms)}" for terms in found.alternatives)
    rows = parameter_rows(diagnosis, index)
    return [(found.term.effect.spec + ("" if k else rivals), *row) for k, row in enumerate(rows)]


def parameter_rows(diagnosis: Diagnosis, index: int) -> list[tuple[str, str, str, str, str]]:
    """Name, value, half the 95 % interval, the interval and the unit of an effect's parameters and of what follows from them.

    Where the data do not determine a value none is shown.
    """
    found, rows = diagnosis.found[index], []
    for key, value, std, unit in (*found.term.with_std(found.std), *diagnosis.derived(index)):
        half = HALF * std
        known = np.isfinite(half) and half > 0.0
        text, spread = with_half(value, half) if known else (NOT_DETERMINED, DASH)
        rows.append((key, text, spread, ends(value - half, value + half) if known else DASH, unit_text(unit)))
    return rows


def disagreement_line(where: Disagreement, *, poses: bool = False) -> str:
    """Channel, motion, time, band and joint of a disagreement; of ``poses`` that do not follow each other, which of them."""
    w, (low, high) = where, where.band_hz
    if w.event:
        text = f"{w.channel} in {w.motion}, {w.start:.2f} to {w.end:.2f} s"
        return f"{text}: {number(w.ratio, 3)} x the usual level at {low:.3g} to {high:.3g} Hz, a {w.looks_like}"
    if poses:
        text = f"{w.channel} in {w.motion}, {poses_text(w.start, w.end)}: {number(w.ratio, 3)} x noise"
        return text + (f", goes with {w.joint}" if w.joint else "")
    text = f"{w.channel} in {w.motion}{' at rest' if w.still else ''}, {w.start:.1f} to {w.end:.1f} s"
    text += f": {number(w.ratio, 3)} x noise, most at {low:g} to {high:g} Hz"
    return text + (f", goes with {w.joint}" if w.joint else "")


def share_range(diagnosis: Diagnosis, index: int) -> str:
    """Share of the gap that an effect closes beside all others, and the least it does with 95 % confidence."""
    found = diagnosis.shares(index)
    if found is None:
        return DASH
    return f"{percent(max(found[0], 0.0))} of the gap" + (f" (at least {percent(found[1])})" if found[1] > 0.0 else "")


def known_share(share: float) -> str:
    """A share of a gap as per cent, nothing where it is not known or none; 100 % means all of it."""
    if not np.isfinite(share) or share <= 0:
        return ""
    return percent(share) if share < 0.999 else f"{100.0 if share >= 1.0 else min(round(100.0 * share, 3), 99.999):.6g} %"
