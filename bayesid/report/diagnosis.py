"""The report of ``diagnose``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from bayesid.arguments import call
from bayesid.diagnosis.data import WHITE, DiagnosisData, Episode
from bayesid.diagnosis.description.describe import Description
from bayesid.diagnosis.detectability import DetectableEffect
from bayesid.diagnosis.gap import LEAST_GAP
from bayesid.diagnosis.locate import Disagreement
from bayesid.diagnosis.noise_models import SOURCES
from bayesid.diagnosis.push import Push
from bayesid.diagnosis.remarks import by_kind, held_out_text, poses_text
from bayesid.diagnosis.rivals import Found
from bayesid.drawing import Figures, figures_of
from bayesid.effects import Effect
from bayesid.recordings.complaints import listed
from bayesid.report import diagnosis_figures as figures
from bayesid.report.diagnosis_figures import Views
from bayesid.report.excitation import PAIRS, motion_groups, motion_plot
from bayesid.report.page import below, bullets, cards, figure, fold, how, lead, mood_of, note, page, svg, warnings
from bayesid.results import diagnosis as results
from bayesid.results.described import not_distinguished, shares, terms_of, use_line
from bayesid.results.diagnosis import Diagnosis
from bayesid.results.excitation import pair_table
from bayesid.results.files import report_of
from bayesid.results.fitted_model import placed
from bayesid.rounding import DASH, chance, channel_text, number, percent, unit_text
from bayesid.section import Cell, Part, ShownSection, ShownTable

#: Bars in the picture of the evidence, lines in the table of parameters that moved.
_BARS, _SHIFTS = 14, 12
#: Two traces that share more than this part of their energy look alike until the effect is large.
_ALIKE = 0.99
_MOODS = {"named": "good", "named_in_part": "fair", "ambiguous": "fair", "unknown": "bad", "nothing_missing": "good"}


#: Other formulas that a line lists.
_LISTED = 8


def described_section(data: DiagnosisData, description: Description) -> ShownSection:
    """What goes with what no effect explains, by formulas."""
    d = description
    rows = [[reading, value, half, text, unit] for reading, text, value, half, unit in terms_of(d, data.channels.names)]
    these = "these go" if len(d.terms) > 1 else "this one goes"
    beside = f", beside {', '.join(t.effect.spec for t in d.start.terms)}" if d.start.terms else ""
    terms = []
    for c, causes in zip(d.terms, d.causes, strict=True):
        others = not_distinguished(c)
        rivals = f"{listed((f'`{o}`' for o in others), _LISTED)}: these do as well there." if others else ""
        share, low = percent(min(c.share, 1.0)), percent(min(c.share_low, 1.0))
        terms.append(
            f"`{', '.join(c.candidate.shape.texts)}` closes {share} of what was left on the other half (at least {low}). "
            f"**It may be** {'; or '.join(causes)}. "
            + (f"**It cannot be told from** {rivals}" if rivals else "Nothing else that was tried does as well there.")
        )
    unseen = ", on a motion that was not fitted." if d.gap is not None else "."
    return ShownSection("Described, not named", [
        f"Of {d.candidates} short formulas of positions, speeds, loads and time {these} with what no effect of the library "
        f"explains{beside}. Chosen on one half of the recordings, tested on the other, then fitted to all. The draft: "
        f"{shares(d)}.",
        ShownTable(["reading", "amplitude", "± (95 %)", "times", "unit of the amplitude"], rows, "kb nb n - u", "narrow"),
        bullets(terms),
        figure(svg(figures.described_figure(data, d), "described"),
               "What was measured less all the rest of the model, and what the term says, over the term's own "
               f"variable{unseen}"),
        note(f"A description is no name: another cause can leave the same trace. `{use_line(d)}`"),
    ], "Described")  # fmt: skip


@report_of.register
def diagnosis_report(diagnosis: Diagnosis) -> str:
    """The report of ``diagnose``: HTML with all figures inside."""
    d, data, views = diagnosis, diagnosis.data, figures.diagnosis_views(diagnosis)
    described = [] if d.description is None else [described_section(data, d.description)]
    moved = [_moved(d)] if d.found else []
    found = [_found(d)] if d.found else []
    sections = [
        *_stays(d), _where(d, views), *found, *described, _why(d), *moved, _left(d, views), _visible(d, views),
        _noise_floor(d), _next(d), how(*_how(d), seconds=d.seconds, after="All numbers are in `diagnosis.json`."),
    ]  # fmt: skip
    opening = [
        lead(f"**{results.verdict_sentence(d)}** {results.validation_sentence(d)}"), cards(_cards(d)),
        warnings(results.notes(d), "", "Know this before you use it"),
    ]  # fmt: skip
    name, readings = data.experiment.name, channel_text(data.channel, dict.fromkeys(s.motion for s in data.segments))
    tested = "" if d.gap is None else f", tested on {', '.join(d.gap.motions)}"
    kicker = f"Where model and measurement disagree, and what is missing: from the {readings}{tested}"
    return page(name, kicker, opening, sections, f"{name}: diagnosis")


def _stays(d: Diagnosis) -> list[ShownSection]:
    """What effects named in part close on held-out recordings, and what stays."""
    if d.part is None:
        return []
    *courses, floor = d.part.courses
    closed = zip(d.part.search.found, courses[1:], strict=True)
    steps = [("the model as it was", courses[0]), *((f.term.effect.spec, c) for f, c in closed)]
    still = "Where the model with these effects and the readings disagree most; the columns are explained below the next table."
    held_out = held_out_text(d.data, d.part.held_out_parts)
    title = "What stays: next to nothing" if d.part.remainder < LEAST_GAP else f"What stays: {percent(d.part.remainder)}"
    return [ShownSection(title, [
        f"{results.part_sentence(d)} What a real robot does beyond any model follows the motion, so readings that follow each "
        "other do not count as independent, and an effect is named only if recordings that took no part are predicted better "
        "with it than without.",
        figure(svg(figures.waterfall(steps, floor, "noise" if floor else "noise, not known"), "waterfall"),
               f"Mean square of the residual on {held_out}, every channel in units of what the model as it "
               "was leaves of it; numbers are its root. Green: what an effect takes of the gap beside those above it."),
        *([_places(d.remainder, d.data.poses), note(still)] if d.remainder else []),
    ], "What stays")]  # fmt: skip


def _where(d: Diagnosis, views: Views) -> ShownSection:
    """Where model and readings disagree."""
    nothing, channels = d.verdict == "nothing_missing", d.data.channels.names
    stands_out = "What stands out of the noise, and where" if nothing else "What disagrees, and where"
    title = stands_out if d.where else "No place stands out" if d.found else "Nothing disagrees"
    right = "with the effects named here" if d.found else "the best attempt"
    sides = f". Left the model as it was, right {right}" if views.changed else ""
    rests = " A joint that rests may stick, so its torque counts only while it moves." if d.data.channel != "wrench" else ""
    at_rest = (
        " A run at rest is the static recording of the same motion." if any("at rest" in p.title for p in views.panels) else ""
    )
    poses = d.data.poses
    maps = figures.residual_maps(views, channels, poses)
    each = "pose by pose" if poses else "in windows of one second and by frequency"
    window = "pose" if poses else "window"
    over = " and pose, numbered in the order of the table" if poses else ", time and frequency"
    parts: list[Part] = [
        f"What was measured less what the model predicts, in units of the noise, {each}. "
        f"White is noise, dark is many times as much; a dot marks a {window} that chance would give in fewer than one of a "
        f"thousand such recordings{sides}.{rests}",
        figure(svg(maps, "maps"), f"Residual by channel{over}.{at_rest} Channels are made independent of those "
                                  "above them, so an error in one can show in those below."),
    ]  # fmt: skip
    if not d.where:
        parts.append(f"In no channel, {window} or motion that was fitted is the residual larger than noise explains.")
        return ShownSection(title, parts, "Where")
    parts += [
        _places(d.where, poses),
        note("The model as it was, fitted poses, most out of the noise first. **Chance**: of as much noise at any of these "
             "poses." if poses else
             "The model as it was, fitted motions, strongest places first. **Goes with**: the joint whose position, speed and "
             "acceleration explain more than half of it; a **short event** or **tap** is in the readings themselves, of any "
             "motion, above the frequencies that are compared, in times of what is usual there. **Chance**: of as much noise "
             "anywhere in these recordings."),
        "Short places like these are not enough to name anything: no effect of the library explains them. A knock, a gap in "
        "the readings or a moment of fast motion at which the noise is larger than elsewhere looks like "
        "this." if nothing and not poses else "",
    ]  # fmt: skip
    return ShownSection(title, parts, "Where")


def _places(places: Sequence[Disagreement], poses: bool) -> ShownTable:
    if poses:
        rows = [
            [w.channel, w.motion, poses_text(w.start, w.end), number(w.ratio, 3), w.joint or DASH, chance(w.p_value)]
            for w in places
        ]
        return ShownTable(["channel", "motion", "which", "× noise", "goes with", "chance"], rows, "kb - n nb - n", "narrow")
    rows = []
    for w in places:
        digits, (low, high) = 2 if w.event else 1, w.band_hz
        rows.append([
            w.channel, w.motion + (", at rest" if w.still else ""), f"{w.start:.{digits}f} – {w.end:.{digits}f} s",
            number(w.ratio, 3), f"{low:.3g} – {high:.3g} Hz", w.joint or w.looks_like or DASH, chance(w.p_value),
        ])  # fmt: skip
    return ShownTable(
        ["channel", "motion", "when", "× noise", "most at", "goes with", "chance"], rows, "kb - n nb n - n", "narrow"
    )


def _found(d: Diagnosis) -> ShownSection:
    """What the effects are that were named."""
    parts, held_out = [], "" if d.part is None else held_out_text(d.data, d.part.held_out_parts)
    for k, f in enumerate(d.found):
        term, summary = f.term, f.term.effect.summary
        once = f"; it happened once, in {term.motion}" if isinstance(term, Episode) else ""
        rivals = ", ".join(" with ".join(f"**{t.effect.spec}** ({t.effect.summary})" for t in terms) for terms in f.alternatives)
        share = "" if d.part is None or d.shares(k) is None else results.share_range(d, k)
        course = svg(figures.push_course(term), "course") if isinstance(term, Push) else ""
        parts.append(below(
            placed(term.effect, d.data.robot),
            f"{summary[0].upper()}{summary[1:]}{once}.{f' Or, just as well: {rivals}.' if rivals else ''}",
            ShownTable(["parameter", "value", "± (95 %)", "interval", "unit"], results.parameter_rows(d, k), "k nb n n u",
                       "narrow"),
            figure(course, "The force that was pushed with, in base axes, with its 95 % band. Its course is free: forces and "
                           "moments of every moment tell it. The values above hold its mean, and model.toml a constant force "
                           "of that."),
            note(results.steady_sentence(f, d)),
            note(f"Without it and with all others, {share} would be open again on {held_out}." if share else ""),
        ))  # fmt: skip
    end = note(
        "Fitted together with the links and with each other, by the effects' exact equations; intervals count what is not "
        "known of the links. `model.toml` beside this page holds the model with these effects, for the next "
        f"`{call('identify')}`."
    )
    return ShownSection("What it is", [*parts, end])


def _why(d: Diagnosis) -> ShownSection:
    """The effects that were tried, and what speaks for those that are named."""
    proposals = _proposals(d)
    shown = [p for p in proposals if p["evidence"] > 0][:_BARS]
    tried = f"{len(proposals)} effects at their places were tried"
    if d.verdict == "nothing_missing":
        text = f"{tried}. " + (
            f"What each alone would add is below; at least {d.needed:g} of log evidence is asked for, and no exact fit brings "
            "that."
            if shown else "Not one of them makes the readings more probable once its parameters are paid for."
        )  # fmt: skip
    elif d.verdict == "unknown":
        best = ", ".join(by_kind(f.term for f in d.search.found))
        text = (
            f"{tried}, alone and several together{f'; the best attempt was {best}' if best else ''}. No "
            "combination leaves only noise, so no effect is named: one that is not listed changes the readings in part as "
            "listed ones do, and their evidence below says no more than that."
        )
    else:
        text = (
            f"{tried}, each first alone and beside the model as it was. Links may change along within their prior, so what a "
            "wrong inertia explains counts for none of them. Log evidence is what the readings gain in probability less what "
            f"the effect's parameters cost; an effect has to bring {d.needed:g} or more."
        )
    several = " Several can be high at once where their traces overlap: what decides is the exact fit, below." if d.found else ""
    bars = figures.evidence(
        [p["spec"] for p in shown], np.array([p["evidence"] for p in shown]), [p["kind"] for p in shown], d.needed
    ) if shown else None  # fmt: skip
    rows = [
        [(p["spec"], "" if p["kind"] == "other" else "sure"), _large(p["evidence"]), percent(p["share"], 2), p["summary"]]
        for p in proposals
    ]
    summary = f"All {len(proposals)} effects tried, and how much of the disagreement each would explain alone"
    return ShownSection("Why that, and not something else" if d.found else "What was tried", [
        text,
        figure("" if bars is None else svg(bars, "evidence"),
               f"The effects that explain most, by log evidence (logarithmic axis).{several}"),
        bullets([_rivals(f, d, proposals) for f in d.found]),
        fold(summary, ShownTable(["effect", "log evidence", "explains at most", "what it is"], rows, "k n n -", "narrow")),
    ], "Why that" if d.found else "")  # fmt: skip


def _moved(d: Diagnosis) -> ShownSection:
    """What naming an effect did to the base parameters."""
    title, name = "What it did to the parameters", "Parameters"
    if d.data.prior is None:
        return ShownSection(title, ["Nothing: the nominal links are taken as exact."], name)
    if all(e.after is None for e in d.errors):  # a remark says why
        return ShownSection(title, ["Not known: identify has not fitted both models to these recordings."], name)
    if not d.shifts:
        nothing = "Hardly anything: no base parameter had moved by more than three of its standard deviations."
        return ShownSection(title, [nothing], name)
    rows = [[s.label, number(s.before), number(s.after), number(s.sigmas, 3)] for s in d.shifts[:_SHIFTS]]
    more = len(d.shifts) - _SHIFTS
    return ShownSection(title, [
        "Without the effect the fit bends the rigid parameters to make up for it. Base parameters that had moved by more than "
        "three standard deviations, as identify estimates them with either model:",
        ShownTable(["base parameter", "without the effect", "with it", "moved [σ]"], rows, "w n nb n"),
        note(f"And {more} more, by less." if more > 0 else ""),
    ], name)  # fmt: skip


def _left(d: Diagnosis, views: Views) -> ShownSection:
    """What is left with the model as it was and as it is in the end."""
    known, changed = all(e.before.noise_known for e in results.shown_errors(d)), views.changed
    either = " with either model" if any(e.after is not None for e in results.shown_errors(d)) else ""
    in_noise = f"Residual of every channel in units of the noise (logarithmic axis), as identify leaves it{either}."
    if d.part is None:
        in_noise += " The line is what a complete model would leave: noise, and what is not known of its fitted parameters."
    in_percent = (
        f"Residual of every channel in per cent of its signal (logarithmic axis), as identify leaves it{either}; the "
        "measurement noise is not known."
    )
    poses = d.data.poses
    end = "the effects named" if d.found else "the best attempt"
    models = f", with the model as it was and with {end}" if changed else ""
    where = "" if all(e.fitted for e in results.shown_errors(d)) else " on unseen motions"
    which = "pose by pose" if poses else "at the frequencies where it stands out"
    return ShownSection(f"{'Before and after' if changed else 'What is left'}{where}", [
        results.which_motions(d),
        figure(svg(figures.channels_figure(d), "bars") if d.errors else "", in_noise if known else in_percent),
        figure(svg(figures.signals(views, poses), "signals"),
               f"Left: measured and predicted in {views.signals[0].motion}, in the channels that disagreed most, "
               f"{which}{models}. Right: measured less predicted, on a scale of its own."),
        below(
            "In their own units, motion by motion",
            f"What `identify` leaves below 10 Hz{', with the model as it was and with the effects named' if d.found else ''}: "
            "root mean square of measured less predicted, in times the noise, in units, and in per cent of what was measured.",
            _errors(d),
        ),
    ], "Before and after")  # fmt: skip


def _errors(d: Diagnosis) -> ShownTable:
    """Errors of every motion in units and per cent, before and after."""
    rows: list[list[Cell]] = []
    marks = {}
    for e in d.errors:
        marks[len(rows)] = "rule"
        title = e.motion + ("" if e.fitted else ", not fitted")
        for name, p in [("error", e.before)] if e.after is None else [("before", e.before), ("after", e.after)]:
            each = [
                f"{number(float(v), 3)} ({percent(float(share), 2)})" if share > 0 else number(float(v), 3)
                for v, share in zip(p.rmse, p.nrmse, strict=True)
            ]
            rows.append([title, (name, "dim"), number(p.times_noise, 3), percent(p.relative_error), *each])
            title = ""
    channels = [f"{n} [{u}]" for n, u in zip(d.data.channels.names, d.data.channels.units, strict=True)]
    return ShownTable(["motion", "", "× noise", "all", *channels], rows, f"k - n nb{' n' * len(channels)}", "tight", marks)


def _visible(d: Diagnosis, views: Views) -> ShownSection:
    """Sizes from which effects would be seen, and told apart."""
    unseen = " **Anything smaller may be there unseen.**" if d.verdict == "nothing_missing" else ""
    parts: list[Part] = [
        "Sizes from which an effect would be named half of the time beside all that the links could do, and from which it would "
        f"be so beside the effect that looks most like it, too.{unseen}"
    ]
    if views.visible:
        alike = _look_alikes(views)
        hardest = (
            "Hardest to tell apart with these motions, by the share of the first one's trace that the second would take over:"
        )
        every = [
            [v.effect.spec, v.parameter, number(v.smallest, 2, "never"), number(v.named, 2, "never"), unit_text(v.unit),
             v.rival or DASH, _near_one(v.share)]
            for v in views.visible
        ]  # fmt: skip
        head = ["effect", "parameter", "seen from", "told apart from", "unit", "looks most like", "share"]
        parts += [
            _seen(views), hardest if alike else "", bullets(alike),
            fold("Every place", ShownTable(head, every, "k - nb n ku k n", "tight")),
            note("Effects of several parameters have the others in proportion to their usual sizes. Linearised. An effect that "
                 "another one contains, as a spring contains an offset, is never apart from it by its trace; it is named for "
                 "having fewer parameters. A mount's resonance, a contact and a ripple have no such size and are missing "
                 "here."),
        ]  # fmt: skip
    return ShownSection("What these motions could show at all", parts, "What could be seen")


def _noise_floor(d: Diagnosis) -> ShownSection:
    white, spread = d.data.floor_source == WHITE, d.search.dispersion
    more = (
        f" All models together leave {number(float(np.sqrt(spread)), 3)} times that: what nothing explains counts as noise, "
        "and widens all intervals and thresholds." if spread > 1.05 else ""
    )  # fmt: skip
    sample, sensor, encoders = figures.noise_parts(d.data)
    sizes = np.transpose([sample, sensor, encoders, np.hypot(sensor, encoders)]).tolist()
    names = zip(d.data.channels.names, d.data.channels.units, strict=True)
    rows = [[name, *(number(x, 3) for x in each), unit] for (name, unit), each in zip(names, sizes, strict=True)]
    grows = "" if d.data.poses else "; it grows steeply with frequency"
    sides = ("sensor", "encoders") if white else ("white part", "beyond it")
    head = ["channel", "sensor, one sample", *(f"{side}, in the band" for side in sides), "floor, in the band", "unit"]
    return ShownSection("Where the noise floor comes from", [
        f"{SOURCES[d.data.floor_source]} The encoders' share is made by repeating the prediction with other roundings and "
        f"errors of the size that these encoders show{grows}.{more}",
        ShownTable(head, rows, "k n n n nb -", "narrow"),
    ], "Noise")  # fmt: skip


def _next(d: Diagnosis) -> ShownSection:
    parts: list[Part] = [d.next_experiment or "Nothing is open."]
    if d.telling is not None:
        told = d.telling.trajectory
        plot = motion_plot(told, motion_groups(told))
        parts += [pair_table(d.telling), note(PAIRS), figure(plot, "The motion of next_motion.csv.")]
    return ShownSection("What next", parts)


def _cards(d: Diagnosis) -> list[tuple[str, str, str]]:
    large = [(d.verdict.replace("_", " "), "the verdict", _MOODS[d.verdict])]
    if d.errors:
        e = max(results.shown_errors(d), key=lambda e: e.before.whitened_rms)
        known = e.before.noise_known
        unit, sides = "noise" if known else "of the signal", [(e.before, "by the model as it was")]
        if e.after is not None:
            sides.append((e.after, "with the effects named added" if d.part else "with the missing effect added"))
        for p, what in sides:
            value = f"{number(p.whitened_rms, 3)} ×" if known else percent(p.relative_error)
            mood = mood_of(p.whitened_rms / p.expected_rms) if known else ""
            large.append((value, f"{unit} is left {what}, on {e.motion}", mood))
        if known and d.part is None:
            large.append((f"{number(e.last.expected_rms, 3)} ×", "is what a complete model would leave", ""))
    if d.part is not None:
        held_out = held_out_text(d.data, d.part.held_out_parts)
        return [*large, (percent(d.part.remainder), f"of the gap on {held_out} stays unexplained", "")]
    if d.found and d.gap is not None and (closed := results.known_share(d.gap.closed)):
        low = results.known_share(d.gap.closed_low)
        least = f", at least {low} with 95 % confidence" if low else ""
        large.append((closed, f"of the gap to the floor is closed{least}", ""))
    return large


def _proposals(d: Diagnosis) -> list[dict[str, Any]]:
    """All effects tried on their own, with what they would explain."""
    s = d.search
    excess = max(s.base.chi2 - s.projector.rows, 1.0)
    taken = {_columns_of(f.term.effect) for f in d.found}
    rivals = {_columns_of(t.effect) for f in d.found for t, _ in f.rivals}
    out = []
    for p in s.proposals:
        name = _columns_of(p.term.effect)
        kind = "named" if name in taken else "rival" if name in rivals else "other"
        out.append({"spec": p.term.effect.spec, "evidence": d.evidence(p), "kind": kind,
                    "share": min(p.gain / excess, 1.0), "summary": p.term.effect.summary})  # fmt: skip
    return sorted(out, key=lambda p: -p["evidence"])


def _columns_of(effect: Effect) -> str:
    """An attached body and a wrong inertia have the same columns; only an exact fit tells them apart."""
    return f"{effect.columns_of or effect.name}@{effect.where}"


def _rivals(f: Found, d: Diagnosis, proposals: list[dict[str, Any]]) -> str:
    """What speaks for a named effect, and against others in its place."""
    text = f"**{f.term.effect.spec}**: without it the best model loses {_large(f.gain)} of log evidence."
    if f.together:
        text += f" {' and '.join(f.together)} {'do' if len(f.together) > 1 else 'does'} the same, whatever the motion."
    if len(f.rivals) > len(f.together):
        lacks = ", ".join(
            f"{t.effect.spec} {'loses only' if lack > 0.0 else 'gains'} {number(abs(lack), 2)}"
            for t, lack in f.rivals
            if t.effect.spec not in f.together
        )
        return f"{text} In its place {lacks}: too little to decide."
    # The best effect on its own that is neither named nor a rival.
    first, other = proposals[0] if proposals else None, next((p for p in proposals if p["kind"] == "other"), None)
    behind = ""
    if len(d.found) == 1 and first is not None and first["kind"] == "named" and other is not None:
        lack = _large(first["evidence"] - other["evidence"])
        behind = f"; at first sight, linearised, the next best was {other['spec']}, behind by {lack}"
    return f"{text} No other effect in its place comes near{behind}."


def _large(value: float) -> str:
    return f"{value:,.0f}".replace(",", " ").replace("-", "−") if abs(value) >= 100 else number(value, 3)


def _seen(views: Views) -> ShownTable:
    """One line for each kind of effect: the smallest sizes, over all its places."""
    groups: dict[tuple[str, str], list[DetectableEffect]] = {}
    for v in views.visible:
        groups.setdefault((v.effect.name, unit_text(v.unit)), []).append(v)
    rows = []
    for (name, unit), members in groups.items():
        best, worst = (pick(members, key=lambda v: v.smallest) for pick in (min, max))
        ends = [v.named for v in members if np.isfinite(v.named)]
        apart = "never" if not ends else _span(min(ends), max(ends)) + ("" if len(ends) == len(members) else ", or never")
        sizes = [v.usual for v in members]
        rows.append([
            name, best.effect.summary, best.parameter, _at(best, members), _at(worst, members) if len(members) > 1 else "",
            apart, _span(min(sizes), max(sizes)), unit,
        ])  # fmt: skip
    head = ["effect", "what it is", "parameter", "seen from", "hardest place", "told apart from", "a usual size", "unit"]
    return ShownTable(head, rows, "kb w - nb n n nd ku", "tight")


def _at(v: DetectableEffect, members: Sequence[DetectableEffect]) -> str:
    return number(v.smallest, 2, "never") + (f" ({v.effect.where})" if len(members) > 1 else "")


def _span(low: float, high: float) -> str:
    one, other = number(low, 2), number(high, 2)
    return one if one == other else f"{one} … {other}"


def _look_alikes(views: Views) -> list[str]:
    """Pairs of effects that look alike, most alike first."""
    pairs: dict[frozenset[str], str] = {}
    for v in sorted(views.visible, key=lambda v: -v.share):
        if v.rival is not None and np.isfinite(v.smallest) and v.share > _ALIKE:
            one, other = v.effect.spec, v.rival
            pairs.setdefault(frozenset((one, other)), f"{one} and {other}: {_near_one(v.share)}")
    return list(pairs.values())[:8]


def _near_one(share: float) -> str:
    return f"{np.floor(1e6 * share) / 1e4:.6g} %" if share > 0.99 else percent(share, 2)


def _how(d: Diagnosis) -> list[tuple[str, str]]:
    data, s = d.data, d.search
    rel_std = data.experiment.inertia_rel_std
    if rel_std is None:
        links = "every rigid parameter is free: inertia_rel_std is not stated, so a wrong inertia is no candidate"
    elif rel_std == 0:
        links = "nominal links are taken as exact (inertia_rel_std = 0)"
    else:
        links = f"nominal links count as known to {percent(rel_std, 3)} of every mass (inertia_rel_std), and are fitted along"
    highest = max(x.frequencies[-1] for x in data.segments)
    how_compared = "as cosines of the poses' order" if data.poses else f"as amplitudes by frequency, up to {highest:.3g} Hz"
    return [
        ("Model as it was", ", ".join(t.effect.spec for t in s.base.terms) or "rigid bodies only"),
        ("Links", links),
        ("Compared", f"{s.projector.rows} numbers: readings {how_compared}"),
        ("Tried", f"{len(s.proposals)} effects and places, the best of them by exact fits, alone and together"),
        ("Weighted residual of the search", f"{number(float(np.sqrt(s.base.chi2 / s.projector.rows)), 3)} before, "
         f"{number(float(np.sqrt(s.best.chi2 / s.projector.rows)), 3)} after: channels and frequencies weighted by noise"),
    ]  # fmt: skip


@figures_of.register
def _(result: Diagnosis) -> Figures:
    return {"channels": partial(figures.channels_figure, result)}
