"""The report of ``watch``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.diagnosis.changes.scales import FRICTION_SHARE, GAIN_SHARE
from bayesid.report.page import render, versions
from bayesid.report.watch_figures import course, sizes
from bayesid.results.text import HALF, channel_text, number, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesid.results.watch import Watch

_MOODS = {"nothing_missing": "good", "unknown": "bad", "not_compared": "bad"}


def watch_report(result: Watch) -> str:
    """The report of ``watch``: HTML with all figures inside."""
    entries = result.recordings
    compared = [w.comparison for w in entries if w.comparison is not None]
    changed = [bool(w.changes) or w.verdict == "unknown" for w in entries]
    return render(
        "watch.html",
        reference=result.reference, channel=channel_text(compared[0].recording.problem.channel), sentences=result.sentences(),
        rows=[(k, w.line, _MOODS.get(w.verdict, "fair")) for k, w in enumerate(entries, 1)],
        gap=course([w.gap for w in entries], changed, "What the reference leaves, in what the recording's own fit leaves"),
        evidence=course([w.evidence for w in entries], changed, "Largest log evidence of a change", result.accept),
        sizes=_sizes(result), accept=number(result.accept, 3), gains=percent(GAIN_SHARE, 2), friction=percent(FRICTION_SHARE, 2),
        how=[("Recordings", f"{len(entries)} of {result.planned}"), ("Run time", f"{number(result.seconds, 3)} s"),
             versions("numpy", "scipy", "pin")],
    )  # fmt: skip


def gap_figure(result: Watch, ax: Any = None) -> Figure:
    """What the reference leaves of each recording in turn, in what the recording's own fit leaves."""
    from bayesid.report.curve_figures import course_figure

    entries = result.recordings
    changed = np.array([bool(w.changes) or w.verdict == "unknown" for w in entries], bool)
    title = "What the reference leaves, in what the recording's own fit leaves"
    return course_figure([w.name for w in entries], np.array([w.gap for w in entries]), changed, title, ax)


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
