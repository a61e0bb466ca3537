"""The report of ``diagnose --reference``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.diagnosis.changes.findings import HiddenChange, ReferenceComparison
from bayesid.diagnosis.changes.scales import FRICTION_SHARE, GAIN_SHARE
from bayesid.report.diagnosis_figures import evidence_bars, waterfall
from bayesid.report.page import render, versions
from bayesid.results.changes import (
    gap_sentence,
    next_experiment,
    notes,
    runners_up,
    shares_sentence,
    value_text,
    verdict_sentence,
    worded,
)
from bayesid.results.text import DASH, channel_text, number, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesid.results.changes import Changes

#: Bars in the picture of the evidence.
_BARS = 12
_VERDICTS = {
    "named": ("changed", "fair"), "named_in_part": ("changed, named in part", "fair"), "ambiguous": ("ambiguous", "fair"),
    "unknown": ("changed, unknown", "bad"), "nothing_missing": ("nothing changed", "good"),
}  # fmt: skip


def changes_report(result: Changes) -> str:
    """The report of ``diagnose --reference``: HTML with all figures inside."""
    c = result.comparison
    problem, before = c.recording.problem, c.reference.problem.experiment
    named = {x.change.spec for x in c.changes}
    scores = [(h.spec, e, h.spec in named) for h, e in c.scores]
    return render(
        "changes.html",
        name=problem.experiment.name, reference=before.name, channel=channel_text(problem.channel), fitted=problem.fitted,
        sentence=verdict_sentence(c), gap=gap_sentence(c), cards_of=_cards(c), notes=notes(c),
        runners_up=runners_up(c), next_experiment=next_experiment(c),
        changes=[
            {"name": worded(x.change, c), "summary": x.change.effects[0].summary,
             "rows": [value_text(v) for v in (*x.values, *x.derived)],
             "before": [number(v.before) for v in x.values] if x.change.known else [], "share": shares_sentence(x, c)}
            for x in c.changes
        ],
        waterfall=waterfall(_steps(c), c.errors.floor), segments=c.errors.segments,
        evidence=evidence_bars([s for s in scores if s[1] > 0][:_BARS] or scores[:1], c.settings.accept),
        needed=f"{c.settings.accept:g}",
        tried=len(scores), channels=_channels(c), places=[_place(result, p) for p in c.errors.places],
        remainder=percent(c.errors.remainder), hidden=_hidden(c), gains=percent(GAIN_SHARE, 2),
        friction=percent(FRICTION_SHARE, 2), how=_how(result),
    )  # fmt: skip


def evidence_figure(result: Changes, ax: Any = None) -> Figure:
    """Log evidence of each change on its own, those that are named apart."""
    from bayesid.report.diagnosis_figures import evidence

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


def _cards(c: ReferenceComparison) -> list[dict[str, str]]:
    p = c.errors
    words, mood = _VERDICTS[c.verdict]
    cards = [{"value": words, "mood": mood, "text": f"since {c.reference.problem.experiment.name}"}]
    for x in c.changes[:2]:
        v = value_text(x.values[0])
        cards.append({"value": f"{v[1]} ± {v[2]} {v[4]}", "mood": "", "text": f"{v[0]} of {x.change.spec}"})
    for value, text in ((p.reference, "times the own fit's residual is left by the reference"), (p.after, "is left in the end")):
        cards.append({"value": f"{number(float(np.sqrt(value)), 3)} ×", "mood": "", "text": text})
    return cards


def _channels(c: ReferenceComparison) -> list[dict[str, Any]]:
    channels, scale = c.recording.problem.row_model.channels, c.recording.scale / np.sqrt(c.recording.samples)
    cells = [[number(float(v), 3) for v in row] for row in c.errors.by_channel]
    return [
        {"name": name, "unit": unit, "own": number(float(scale[k]), 3), "cells": cells[k]}
        for k, (name, unit) in enumerate(zip(channels.names, channels.units, strict=True))
    ]


def _place(result: Changes, place) -> dict[str, str]:
    problem = result.comparison.recording.problem
    return {
        "channel": problem.row_model.channels.names[place.channel], "motion": problem.regression.motion_names[place.motion],
        "time": f"{place.start:.1f} – {place.end:.1f} s", "before": number(place.before, 3), "after": number(place.after, 3),
    }  # fmt: skip


def _hidden(c: ReferenceComparison) -> list[dict[str, str]]:
    """Smallest changes that would have been named, a line for each kind."""
    kinds: dict[str, list[HiddenChange]] = {}
    for h in c.hidden:
        kinds.setdefault(h.change.name, []).append(h)
    return [
        {
            "name": name, "parameter": members[0].change.parameters[0][0].rsplit(".", 1)[-1],
            "unit": "" if members[0].change.parameters[0][1] == "1" else members[0].change.parameters[0][1],
            "sizes": ", ".join(f"{h.change.where} {number(h.value, 2) if np.isfinite(h.value) else 'never'}" for h in members),
        }
        for name, members in kinds.items()
    ]  # fmt: skip


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
