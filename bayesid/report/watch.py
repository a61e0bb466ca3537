"""The report of ``watch``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from bayesid.arguments import argument, call
from bayesid.diagnosis.changes.scales import FRICTION_SHARE, GAIN_SHARE
from bayesid.report.charts import CYCLE, WIDTH, Panel, chart, text_width, write
from bayesid.report.page import figure, how, lead, note, page, versions
from bayesid.results.text import HALF, channel_text, number, percent
from bayesid.section import ShownSection

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesid.results.watch import Watch


_CHANGED, _SAME, _DARK, _LINE = "#c2410c", "#0f766e", "#334155", "#94a3b8"
_HEIGHT, _TOP, _BOTTOM = 150.0, 26.0, 46.0


def course(values: Sequence[float], changed: Sequence[bool], title: str, needed: float | None = None) -> Markup:
    """A number of every recording in turn, nan where it was not compared: red dots where something changed."""
    y = np.array(values, float)
    top = 1.1 * max(float(np.nanmax(y)), needed or 0.0, 1.0)
    panel = _panel(len(y), (0.0, top))
    x = np.arange(1.0, len(y) + 1.0)
    parts = [panel.frame(title, "recording", whole=True), panel.curve(x, y, _LINE)]
    hit = np.array(changed, bool)
    parts += [_dots(panel, x[m], y[m], colour) for m, colour in ((hit, _CHANGED), (~hit, _SAME))]
    if needed is not None:
        parts.append(panel.curve(np.array([panel.x[0], panel.x[1]]), np.array([needed, needed]), _DARK))
        parts.append(write(panel.left + panel.width, float(panel.down(np.array(needed))) - 4.0, "asked for", 8.5, _DARK, "end"))
    return chart(_TOP + _HEIGHT + _BOTTOM, parts)


def sizes(series: Sequence[tuple[str, np.ndarray, np.ndarray]], count: int, title: str) -> Markup:
    """Sizes of the changes named, with half their 95 % intervals, nan where not named, recording by recording (count,)."""
    ends = np.concatenate([v + s * np.nan_to_num(h) for _, v, h in series for s in (-1.0, 1.0)])
    low, high = min(0.0, float(np.nanmin(ends))), max(0.0, float(np.nanmax(ends)))
    room = 0.08 * (high - low or 1.0)
    panel = _panel(count, (low - room * (low < 0.0), high + room))
    parts, at = [panel.frame(title, "recording", whole=True)], panel.left
    x = np.arange(1.0, count + 1.0)
    for k, (name, value, half) in enumerate(series):
        colour = CYCLE[k % len(CYCLE)]
        for place, v, h in zip(x, value, half, strict=True):
            if np.isfinite(v) and np.isfinite(h):
                parts.append(panel.curve(np.array([place, place]), np.array([v - h, v + h]), colour))
        parts.append(_dots(panel, x, value, colour))
        parts.append(write(at, _TOP + _HEIGHT + _BOTTOM + 6.0, f"● {name}", 9.0, colour))
        at += text_width(name) + 28.0
    return chart(_TOP + _HEIGHT + _BOTTOM + 16.0, parts)


def _panel(count: int, y: tuple[float, float]) -> Panel:
    return Panel(56.0, _TOP, WIDTH - 76.0, _HEIGHT, (0.5, count + 0.5), y)


def _dots(panel: Panel, x: np.ndarray, y: np.ndarray, colour: str) -> str:
    seen = np.isfinite(y)
    places = zip(panel.across(x[seen]).tolist(), panel.down(y[seen]).tolist(), strict=True)
    return "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{colour}"/>' for a, b in places)


_GAP = "What the reference leaves, in what the recording's own fit leaves"


def watch_report(result: Watch) -> str:
    """The report of ``watch``: HTML with all figures inside."""
    entries = result.recordings
    channel = next(w.comparison.recording.problem.channel for w in entries if w.comparison is not None)
    changed = [bool(w.changes) or w.verdict == "unknown" for w in entries]
    gaps, evidence = [w.gap for w in entries], [w.evidence for w in entries]
    sections = [
        ShownSection("Recordings", [
            result.table,
            note("“Residual over own fit”: what the reference leaves on segments held out in turn, in units of what the "
                 "recording's own fit of the same model leaves; 1 is no difference at all. Friction of every joint may differ by "
                 f"{percent(FRICTION_SHARE, 2)} and drive gains by {percent(GAIN_SHARE, 2)} before anything is named."),
        ]),
        ShownSection("The course", [
            figure(course(gaps, changed, _GAP), "Red: something changed. Friction that wanders with warmth raises it, too."),
            figure(course(evidence, changed, "Largest log evidence of a change", result.accept),
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
    from bayesid.report.curve_figures import course_figure

    entries = result.recordings
    changed = np.array([bool(w.changes) or w.verdict == "unknown" for w in entries], bool)
    return course_figure([w.name for w in entries], np.array([w.gap for w in entries]), changed, _GAP, ax)


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
