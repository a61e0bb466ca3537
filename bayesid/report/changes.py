"""The reports of ``diagnose --reference`` and ``watch``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.arguments import argument, call
from bayesid.diagnosis.changes.findings import NamedChange, ReferenceComparison
from bayesid.diagnosis.changes.scales import FRICTION_SHARE, GAIN_SHARE
from bayesid.drawing import Figures, figures_of
from bayesid.report.charts import CYCLE
from bayesid.report.diagnosis_figures import evidence, waterfall
from bayesid.report.figures import NOISE, PREDICTED, add_legend, make_grid, styled
from bayesid.report.page import below, cards, figure, how, lead, note, page, svg, warnings
from bayesid.results import changes as results
from bayesid.results.changes import Changes, Watch
from bayesid.results.files import report_of
from bayesid.rounding import DASH, HALF, channel_text, number, percent, unit_text
from bayesid.section import Html, ShownSection, ShownTable

#: Bars in the picture of the evidence.
_BARS = 12
#: Letters below a picture that have room beside each other.
_LETTERS = 120


@report_of.register
def changes_report(result: Changes) -> str:
    """The report of ``diagnose --reference``: HTML with all figures inside."""
    c = result.comparison
    problem, before = c.recording.problem, c.reference.problem.experiment
    places = [_place(result, p) for p in c.errors.places]
    following = results.next_experiment(c)
    sections = [
        *([ShownSection("What changed", [
            *(_change(x, c) for x in c.changes),
            note("Changes since the reference. Intervals count what is not known of links, friction and gains. `model.toml` "
                 "beside this page holds the reference's model with these changes, for the next "
                 f"`{call('identify')}`."),
        ])] if c.changes else []),
        ShownSection("The gap, and what closes it", [
            f"The recording was cut into {c.errors.segments} parts. Each was predicted from what the others say, in units of "
            f"what the recording's own fit of the same model leaves: {results.gap_sentence(c)}.",
            figure(svg(waterfall(_steps(c), c.errors.floor), "waterfall"),
                   "Mean square of the residual on parts that were held out; numbers are its root. Green: what a step takes of "
                   "the gap."),
            _channels(c),
        ], "The gap"),
        ShownSection("Why that, and not something else" if c.changes else "What was tried", [
            f"{len(c.scores)} changes at their places competed, each with what is known of the robot from the reference, and "
            f"with friction of every joint free by {percent(FRICTION_SHARE, 2)} and drive gains by {percent(GAIN_SHARE, 2)}: "
            "so much they wander from day to day. The bars show what each alone adds to the log evidence; "
            f"{c.settings.accept:g} is asked for.",
            *results.runners_up(c),
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
            hidden_table(c),
            note("By these motions, beside what was named; a body's other parameters in the proportions of a compact one near "
                 "the joint."),
        ], "What could hide"),
        how(*_how(result), seconds=result.seconds),
    ]  # fmt: skip
    opening = [
        lead(f"**{results.verdict_sentence(c)}**"), cards(_cards(c)),
        warnings([*result.remarks, *results.notes(c)], "", "Know this before you use it"),
    ]  # fmt: skip
    kicker = f"What changed since the reference: from the {channel_text(problem.channel, problem.fitted)}"
    return page(f"{problem.experiment.name} since {before.name}", kicker, opening, sections)


def _change(x: NamedChange, c: ReferenceComparison) -> Html:
    """What one change is and its values."""
    rows = [[*results.value_text(v), *([number(v.before)] if x.change.known else [])] for v in (*x.values, *x.derived)]
    head = ["parameter", "change", "± (95 %)", "interval", "unit", *["in the reference"] * x.change.known]
    summary, share = x.change.summary, results.shares_sentence(x, c)
    text = f"{summary[0].upper()}{summary[1:]}.{f' {share}.' if share else ''}"
    return below(results.worded(x.change, c), text, ShownTable(head, rows, f"k nb n n u{' n' * x.change.known}", "narrow"))


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
    words, mood = results.verdict_words(c)
    large = [(words, f"since {c.reference.problem.experiment.name}", mood)]
    for x in c.changes[:2]:
        name, text, half, _, unit = results.value_text(x.values[0])
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
    models = ["reference", "with the changes alone", "all else within its tolerance", "own fit"]
    return ShownTable(["channel", "own fit leaves", "unit", *models], rows, "k n - n n n n", "narrow")


def _place(result: Changes, place) -> list[str]:
    problem = result.comparison.recording.problem
    return [
        problem.row_model.channels.names[place.channel], problem.regression.motion_names[place.motion],
        f"{place.start:.1f} – {place.end:.1f} s", number(place.before, 3), number(place.after, 3),
    ]  # fmt: skip


def hidden_table(c: ReferenceComparison) -> ShownTable:
    """Smallest changes that would have been named, a line for each kind and unit."""
    rows = []
    for (name, parameter, unit), members in results.hidden_by_kind(c).items():
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
    ]


@figures_of.register
def _(result: Changes) -> Figures:
    return {"evidence": partial(evidence_figure, result)}


@report_of.register
def watch_report(result: Watch) -> str:
    """The report of ``watch``: HTML with all figures inside."""
    entries = result.recordings
    channel = next(w.comparison.recording.problem.channel for w in entries if w.comparison is not None)
    evidence = [w.evidence for w in entries]
    sections = [
        ShownSection("Recordings", [
            result.table,
            note("“Residual over own fit”: what the reference leaves on segments held out in turn, in units of what the "
                 "recording's own fit of the same model leaves; 1 is no difference at all. Friction of every joint may differ by "
                 f"{percent(FRICTION_SHARE, 2)} and drive gains by {percent(GAIN_SHARE, 2)} before anything is named. "
                 "“x noise”: what the reference's own [model] leaves, without the friction that is fitted along here."),
        ]),
        ShownSection("The course", [
            figure(svg(gap_figure(result), "gap"), "Friction that wanders with warmth raises it, too."),
            figure(svg(_course(result, evidence, "Largest log evidence of a change", result.accept), "evidence"),
                   "A change is named from the line on. It is higher the more recordings there are, so that the series as a "
                   "whole names falsely as rarely as one alone."),
            *(figure(svg(sizes, f"sizes-{k}"), "With 95 % intervals; recordings without a dot show no such change.")
              for k, sizes in enumerate(_sizes(result))),
        ]),
        how(("Recordings", f"{len(entries)} of {result.planned}"), seconds=result.seconds,
            after=f"Everything about one recording: `{call('diagnose')}` with `{argument('reference', result.reference)}`. "
                  f"A change is named from a log evidence of {number(result.accept, 3)}."),
    ]  # fmt: skip
    kicker = f"What changed since the reference, and when: from the {channel_text(channel)}"
    opening = [*(lead(f"**{s}.**") for s in result.sentences()), warnings(result.all_warnings)]
    return page(f"Recordings since {result.reference}", kicker, opening, sections)


def gap_figure(result: Watch, ax: Any = None) -> Figure:
    """What the reference leaves of each recording in turn, in what the recording's own fit leaves."""
    title = "What the reference leaves, in what the recording's own fit leaves"
    return _course(result, [w.gap for w in result.recordings], title, ax=ax)


@styled
def _course(result: Watch, values: Sequence[float], title: str, needed: float | None = None, ax: Any = None) -> Figure:
    """A number of every recording in turn, coloured where something changed; nan where it was not compared."""
    entries, shown = result.recordings, np.array(values, float)
    changed = np.array([bool(w.changes) or w.verdict == "unknown" for w in entries], bool)
    figure, axes = make_grid(1, 1, 1.8, top=0.4, ax=ax)
    panel, x = axes[0, 0], np.arange(1, len(entries) + 1)
    panel.plot(x, shown, color="#94a3b8", lw=0.9)
    for part, colour, label in ((changed, PREDICTED, "changed"), (~changed, NOISE, "nothing changed")):
        if part.any():
            panel.plot(x[part], shown[part], "o", ms=5, color=colour, mew=0, label=label)
    if needed is not None:
        panel.axhline(needed, color="#334155", lw=0.9, label="asked for")
    panel.set_ylim(0.0, 1.08 * panel.get_ylim()[1])
    names = [w.name if len(w.name) < 18 else f"{w.name[:16]}…" for w in entries]
    if len(names) * max(map(len, names)) <= _LETTERS:
        panel.set_xticks(x, names)
    else:  # names would hide one another
        panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        panel.set_xlabel("recording, counted as in the table")
    panel.set_title(title)
    add_legend(axes)
    return figure


def _sizes(result: Watch) -> list[Figure]:
    """Sizes of the changes named, recording by recording, with their 95 % intervals: a picture for each unit."""
    units: dict[str, dict[str, np.ndarray]] = {}
    count = len(result.recordings)
    for k, w in enumerate(result.recordings):
        for x in w.changes:
            v = x.values[0]
            both = units.setdefault(v.unit, {}).setdefault(f"{x.change.spec} {v.name}", np.full((2, count), np.nan))
            both[:, k] = v.value, HALF * v.std
    return [sizes_figure(series, count, f"Size of the changes named [{unit}]") for unit, series in units.items()]


@styled
def sizes_figure(series: Mapping[str, np.ndarray], count: int, title: str) -> Figure:
    """Values and half their intervals (2, count) by name, nan where not named."""
    columns = max(int(9.6 / (0.5 + 0.066 * max(map(len, series)))), 1)
    lines = -(-len(series) // columns)
    figure, axes = make_grid(1, 1, 2.1, top=0.45 + 0.19 * lines)
    panel, x = axes[0, 0], np.arange(1, count + 1)
    for k, (name, (value, half)) in enumerate(series.items()):
        panel.errorbar(x, value, np.nan_to_num(half), fmt="o", ms=5, lw=1.2, color=CYCLE[k % len(CYCLE)], label=name)
    panel.axhline(0.0, color="#334155", lw=0.6)
    panel.set(title=title, xlabel="recording", xlim=(0.5, count + 0.5))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    add_legend(axes, lines=lines)
    return figure


@figures_of.register
def _(result: Watch) -> Figures:
    return {"gap": partial(gap_figure, result)}
