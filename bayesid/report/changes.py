"""The report of ``diagnose --reference``."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.arguments import call
from bayesid.diagnosis.changes.findings import HiddenChange, NamedChange, ReferenceComparison
from bayesid.diagnosis.changes.scales import FRICTION_SHARE, GAIN_SHARE
from bayesid.drawing import Figures, figures_of
from bayesid.report.diagnosis_figures import evidence, waterfall
from bayesid.report.page import below, cards, figure, how, lead, note, page, svg, versions, warnings
from bayesid.results.changes import (
    Changes,
    gap_sentence,
    next_experiment,
    notes,
    runners_up,
    shares_sentence,
    value_text,
    verdict_sentence,
    worded,
)
from bayesid.results.files import report_of
from bayesid.rounding import DASH, channel_text, number, percent, unit_text
from bayesid.section import Html, ShownSection, ShownTable

#: Bars in the picture of the evidence.
_BARS = 12
_VERDICTS = {
    "named": ("changed", "fair"), "named_in_part": ("changed, named in part", "fair"), "ambiguous": ("ambiguous", "fair"),
    "unknown": ("changed, unknown", "bad"), "nothing_missing": ("nothing changed", "good"),
}  # fmt: skip


@report_of.register
def changes_report(result: Changes) -> str:
    """The report of ``diagnose --reference``: HTML with all figures inside."""
    c = result.comparison
    problem, before = c.recording.problem, c.reference.problem.experiment
    places = [_place(result, p) for p in c.errors.places]
    following = next_experiment(c)
    sections = [
        *([ShownSection("What changed", [
            *(_change(x, c) for x in c.changes),
            note("Changes since the reference. Intervals count what is not known of links, friction and gains. `model.toml` "
                 "beside this page holds the reference's model with these changes, for the next "
                 f"`{call('identify')}`."),
        ])] if c.changes else []),
        ShownSection("The gap, and what closes it", [
            f"The recording was cut into {c.errors.segments} parts. Each was predicted from what the others say, in units of "
            f"what the recording's own fit of the same model leaves: {gap_sentence(c)}.",
            figure(waterfall(_steps(c), c.errors.floor),
                   "Mean square of the residual on parts that were held out; numbers are its root. Green: what a step takes of "
                   "the gap."),
            _channels(c),
        ], "The gap"),
        ShownSection("Why that, and not something else" if c.changes else "What was tried", [
            f"{len(c.scores)} changes at their places competed, each with what is known of the robot from the reference, and "
            f"with friction of every joint free by {percent(FRICTION_SHARE, 2)} and drive gains by {percent(GAIN_SHARE, 2)}: "
            "so much they wander from day to day. The bars show what each alone adds to the log evidence; "
            f"{c.settings.accept:g} is asked for.",
            *runners_up(c),
            figure(svg(evidence_figure(result), "evidence"),
                   "Log evidence of each change on its own; line: what is asked for."),
        ], "Why that"),
        ShownSection("Where reference and recording disagree", [
            ShownTable(["channel", "motion", "when", "reference", "in the end"], places, "kb - n nb n", "narrow"),
            note("In units of what the recording's own fit leaves, worst places first. "
                 f"{percent(c.errors.remainder)} of the gap stays in the end."),
        ] if places else ["No channel is off anywhere by more than its own fit leaves."], "Where"),
        *([ShownSection("What next", [following])] if following else []),
        ShownSection("How large a change could hide", [
            _hidden(c),
            note("By these motions, beside what was named; a body's other parameters in the proportions of a compact one near "
                 "the joint."),
        ], "What could hide"),
        how(*_how(result)),
    ]  # fmt: skip
    opening = [
        lead(f"**{verdict_sentence(c)}**"), cards(_cards(c)),
        warnings(notes(c), "", "Know this before you use it"),
    ]  # fmt: skip
    kicker = f"What changed since the reference: from the {channel_text(problem.channel, problem.fitted)}"
    return page(f"{problem.experiment.name} since {before.name}", kicker, opening, sections)


def _change(x: NamedChange, c: ReferenceComparison) -> Html:
    """What one change is and its values."""
    rows = [[*value_text(v), *([number(v.before)] if x.change.known else [])] for v in (*x.values, *x.derived)]
    head = ["parameter", "change", "± (95 %)", "interval", "unit", *["in the reference"] * x.change.known]
    summary, share = x.change.effects[0].summary, shares_sentence(x, c)
    text = f"{summary[0].upper()}{summary[1:]}.{f' {share}.' if share else ''}"
    return below(worded(x.change, c), text, ShownTable(head, rows, f"k nb n n u{' n' * x.change.known}", "narrow"))


def evidence_figure(result: Changes, ax: Any = None) -> Figure:
    """Log evidence of each change on its own, those that are named apart."""
    c = result.comparison
    named = {x.change.spec for x in c.changes}
    ranked = sorted(((e, h.spec) for h, e in c.scores), reverse=True)[:_BARS]
    shown = [(e, spec) for e, spec in ranked if e > 0] or ranked[:1]
    kinds = ["named" if spec in named else "other" for _, spec in shown]
    return evidence([spec for _, spec in shown], np.array([e for e, _ in shown]), kinds, c.settings.accept, ax)


def _steps(c: ReferenceComparison) -> list[tuple[str, float]]:
    """Names and mean squares of the waterfall."""
    p = c.errors
    steps = [("the reference as it is", p.reference)]
    steps += [(a.change.spec, m) for a, m in zip(c.selection.accepted, p.changes, strict=True)]
    return [*steps, ("all else within its tolerance", p.after)]


def _cards(c: ReferenceComparison) -> list[tuple[str, str, str]]:
    p = c.errors
    words, mood = _VERDICTS[c.verdict]
    large = [(words, f"since {c.reference.problem.experiment.name}", mood)]
    for x in c.changes[:2]:
        name, text, half, _, unit = value_text(x.values[0])
        large.append((f"{text} ± {half} {unit}", f"{name} of {x.change.spec}", ""))
    for value, text in ((p.reference, "times the own fit's residual is left by the reference"), (p.after, "is left in the end")):
        large.append((f"{number(float(np.sqrt(value)), 3)} ×", text, ""))
    return large


def _channels(c: ReferenceComparison) -> ShownTable:
    channels, scale = c.recording.problem.row_model.channels, c.recording.scale / np.sqrt(c.recording.samples)
    rows = [
        [name, number(float(scale[k]), 3), unit, *(number(float(v), 3) for v in c.errors.by_channel[k])]
        for k, (name, unit) in enumerate(zip(channels.names, channels.units, strict=True))
    ]
    head = [
        "channel",
        "own fit leaves",
        "unit",
        "reference",
        "with the changes alone",
        "all else within its tolerance",
        "own fit",
    ]
    return ShownTable(head, rows, "k n - n n n n", "narrow")


def _place(result: Changes, place) -> list[str]:
    problem = result.comparison.recording.problem
    return [
        problem.row_model.channels.names[place.channel], problem.regression.motion_names[place.motion],
        f"{place.start:.1f} – {place.end:.1f} s", number(place.before, 3), number(place.after, 3),
    ]  # fmt: skip


def _hidden(c: ReferenceComparison) -> ShownTable:
    """Smallest changes that would have been named, a line for each kind."""
    kinds: dict[str, list[HiddenChange]] = {}
    for h in c.hidden:
        kinds.setdefault(h.change.name, []).append(h)
    rows = []
    for name, members in kinds.items():
        parameter, unit = members[0].change.parameters[0]
        sizes = ", ".join(f"{h.change.where} {number(h.value, 2) if np.isfinite(h.value) else 'never'}" for h in members)
        rows.append([name, parameter.rsplit(".", 1)[-1], unit_text(unit), sizes])
    return ShownTable(["change", "of", "unit", "smallest that would have been named"], rows, "k - u w")


def _how(result: Changes) -> list[tuple[str, str]]:
    c = result.comparison
    problem = c.recording.problem
    return [
        ("Reference", f"{result.reference}: {len(c.reference.solution)} base and effect parameters with their covariance"),
        ("Model", ", ".join(dict.fromkeys(e.name for e in c.reference.effects)) or DASH),
        ("Bandwidth", f"{number(problem.smoother.bandwidth, 3)} Hz, the lower of what both recordings choose"),
        ("Rows", f"{len(c.recording.left)}, of which {number(c.recording.correlation, 3)} count as one"),
        ("Dispersion", number(c.selection.marginal().dispersion, 3)),
        ("Run time", f"{number(result.seconds, 3)} s"),
        versions("numpy", "scipy", "pin"),
    ]


@figures_of.register
def _(result: Changes) -> Figures:
    return {"evidence": partial(evidence_figure, result)}
