"""The report of ``watch``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from bayesid.arguments import argument, call
from bayesid.diagnosis.changes.scales import FRICTION_SHARE, GAIN_SHARE
from bayesid.drawing import Figures, figures_of
from bayesid.report.charts import CYCLE, WIDTH, Panel, chart, text_width, write
from bayesid.report.figures import NOISE, PREDICTED, add_legend, make_grid, styled
from bayesid.report.page import figure, how, lead, note, page, svg, versions
from bayesid.results.files import report_of
from bayesid.results.watch import Watch
from bayesid.rounding import HALF, channel_text, number, percent
from bayesid.section import ShownSection

_HEIGHT, _TOP, _BOTTOM = 150.0, 26.0, 46.0


def sizes(series: Sequence[tuple[str, np.ndarray, np.ndarray]], count: int, title: str) -> Markup:
    """Sizes of the changes named, with half their 95 % intervals, nan where not named, recording by recording (count,)."""
    ends = np.concatenate([v + s * np.nan_to_num(h) for _, v, h in series for s in (-1.0, 1.0)])
    low, high = min(0.0, float(np.nanmin(ends))), max(0.0, float(np.nanmax(ends)))
    room = 0.08 * (high - low or 1.0)
    panel = Panel(56.0, _TOP, WIDTH - 76.0, _HEIGHT, (0.5, count + 0.5), (low - room * (low < 0.0), high + room))
    parts, at = [panel.frame(title, "recording", whole=True)], panel.left
    x = np.arange(1.0, count + 1.0)
    for k, (name, value, half) in enumerate(series):
        colour = CYCLE[k % len(CYCLE)]
        for place, v, h in zip(x, value, half, strict=True):
            if np.isfinite(v) and np.isfinite(h):
                parts.append(panel.curve(np.array([place, place]), np.array([v - h, v + h]), colour))
        seen = np.isfinite(value)
        parts.append(panel.dots(x[seen], value[seen], colour, 3.0))
        parts.append(write(at, _TOP + _HEIGHT + _BOTTOM + 6.0, f"● {name}", 9.0, colour))
        at += text_width(name) + 28.0
    return chart(_TOP + _HEIGHT + _BOTTOM + 16.0, parts)


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
                 f"{percent(FRICTION_SHARE, 2)} and drive gains by {percent(GAIN_SHARE, 2)} before anything is named."),
        ]),
        ShownSection("The course", [
            figure(svg(gap_figure(result), "gap"), "Friction that wanders with warmth raises it, too."),
            figure(svg(_course(result, evidence, "Largest log evidence of a change", result.accept), "evidence"),
                   "A change is named from the line on. It is higher the more recordings there are, so that the series as a "
                   "whole names falsely as rarely as one alone."),
            *(figure(s, "With 95 % intervals; recordings without a dot show no such change.") for s in _sizes(result)),
        ]),
        how(("Recordings", f"{len(entries)} of {result.planned}"), ("Run time", f"{number(result.seconds, 3)} s"),
            versions("numpy", "scipy", "pin"),
            after=f"Everything about one recording: `{call('diagnose')}` with `{argument('reference', result.reference)}`. "
                  f"A change is named from a log evidence of {number(result.accept, 3)}."),
    ]  # fmt: skip
    kicker = f"What changed since the reference, and when: from the {channel_text(channel)}"
    return page(f"Recordings since {result.reference}", kicker, [lead(f"**{s}.**") for s in result.sentences()], sections)


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
    panel, x = axes[0, 0], np.arange(len(entries))
    panel.plot(x, shown, color="#94a3b8", lw=0.9)
    for part, colour, label in ((changed, PREDICTED, "changed"), (~changed, NOISE, "nothing changed")):
        if part.any():
            panel.plot(x[part], shown[part], "o", ms=5, color=colour, mew=0, label=label)
    if needed is not None:
        panel.axhline(needed, color="#334155", lw=0.9, label="asked for")
    panel.set_ylim(0.0, 1.08 * panel.get_ylim()[1])
    panel.set_xticks(x, [w.name if len(w.name) < 18 else f"{w.name[:16]}…" for w in entries])
    panel.set_title(title)
    add_legend(axes)
    return figure


def _sizes(result: Watch) -> list:
    """One picture for each unit of the changes' first parameters."""
    units: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    count = len(result.recordings)
    for k, w in enumerate(result.recordings):
        for x in w.changes:
            v = x.values[0]
            value, half = units.setdefault(v.unit, {}).setdefault(
                f"{x.change.spec} {v.name}", (np.full(count, np.nan), np.full(count, np.nan))
            )
            value[k], half[k] = v.value, HALF * v.std
    return [
        sizes([(name, *both) for name, both in mine.items()], count, f"Size of the changes named [{unit}]")
        for unit, mine in units.items()
    ]


@figures_of.register
def _(result: Watch) -> Figures:
    return {"gap": partial(gap_figure, result)}
