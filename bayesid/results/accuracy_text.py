"""What ``accuracy`` found as text, for a terminal or a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from bayesid.design.accuracy.bench import Bench
from bayesid.design.accuracy.certificate import Certificate
from bayesid.design.accuracy.sensor_choice import Outlook, SensorChoice
from bayesid.design.accuracy.susceptibility import Susceptibility
from bayesid.design.accuracy.sweeps import Level, Sweeps
from bayesid.results.text import DASH, channel_text, html_table, number, percent, text_table

#: Effects that a summary lists.
_SHOWN_EFFECTS = 10
#: A bias of less than this many standard deviations is none.
NO_BIAS = 0.01


def accuracy_text(
    bench: Bench, sweeps: Sweeps | None, susceptibility: Sequence[Susceptibility], certificate: Certificate | None,
    sensors: SensorChoice | None, warnings: Sequence[str], *, html: bool = False,
) -> str:  # fmt: skip
    """Improvements, sweeps, susceptibility and coverage; fields of an `Accuracy`, as text or as HTML tables."""
    labels = bench.problem.row_model.base.labels
    title = (
        f"{bench.experiment.name}: accuracy of {bench.rank} base parameters by {bench.method.name} from the "
        f"{channel_text(bench.problem.channel)} of {', '.join(bench.problem.fitted)}"
    )
    parts: list[tuple[str, list[str], list[list[str]]]] = []
    if sweeps is not None:
        rows = [[v.improvement, change(v.ratio), change(v.prediction_ratio), v.source]
                for _, v in sweeps.improvements()]  # fmt: skip
        if rows:
            parts.append(("What would buy most", ["change", "median error", "prediction", "by"], rows))
    if sweeps is not None and html:  # too long for a terminal
        rows = [[s.title if k == 0 else "", *level_cells(v, k == s.own)] for s in sweeps.sweeps for k, v in enumerate(s.levels)]
        head = ["factor", "level", "median error", "95 %", "prediction", "lost"]
        parts.append((f"One factor at a time, {sweeps.runs} twins a level", head, rows))
    if susceptibility:
        rows = [effect_cells(s, labels) for s in worst_places(susceptibility, 1)[:_SHOWN_EFFECTS]]
        head = ["effect left out", "size", "largest bias", "of", "prediction"]
        parts.append(("Bias by effects left out of the model, each at its worst place", head, rows))
    if sensors is not None:
        parts.append((sensor_title(sensors), ["", *(o.candidate.name for o in sensors.outlooks)], sensor_rows(sensors)))
    notes = [coverage_text(certificate), *(f"warning: {w}" for w in warnings)]
    if html:
        tables = "".join(f"<p><b>{escape(name)}</b></p>{html_table(head, rows)}" for name, head, rows in parts)
        return f"<p>{escape(title)}</p>{tables}{''.join(f'<p>{escape(n)}</p>' for n in notes if n)}"
    lines = [title]
    for name, head, rows in parts:
        lines += ["", name, *text_table(head, rows)]
    return "\n".join([*lines, "", *(f"  {n}" for n in notes if n)]).rstrip()


def change(ratio: float) -> str:
    """A ratio as a change in per cent, or as a factor where it is large."""
    if not np.isfinite(ratio):
        return DASH
    if ratio >= 3.0:
        return f"× {number(ratio, 2)}"
    return f"{100 * (ratio - 1):+.0f} %".replace("-", "−") if abs(ratio - 1) >= 0.005 else "0 %"


def level_cells(level: Level, own: bool) -> list[str]:
    """Label, change of the median error, its interval, prediction error, parameters lost."""
    if level.source == "refused":
        return [level.label, "cannot be fitted", "", "", ""]
    if own:
        return [f"{level.label} (yours)", "", "", percent(level.prediction), ""]
    sure = "formula" if level.source == "formula" else f"{change(level.ratio_low)} … {change(level.ratio_high)}"
    lost = f"{level.lost} of {len(level.std)}" if level.lost else ""
    return [level.label, change(level.ratio), sure, percent(level.prediction), lost]


def effect_cells(s: Susceptibility, labels: tuple[str, ...]) -> list[str]:
    """Effect and place, size, largest bias in standard deviations, of which parameter, error of predictions."""
    none = s.largest < NO_BIAS
    bias, of = ("none", "") if none else (f"{number(s.largest, 2)} σ", _short(labels[s.most_biased]))
    return [s.effect.spec, size_text(s), bias, of, percent(s.prediction, 2) if s.prediction > 1e-12 else "0 %"]


def worst_places(found: Sequence[Susceptibility], each: int) -> list[Susceptibility]:
    """Of every kind of effect the places where it biases most, largest bias first."""
    counts: dict[str, int] = {}
    out = []
    for s in found:
        counts[s.effect.name] = counts.get(s.effect.name, 0) + 1
        if counts[s.effect.name] <= each:
            out.append(s)
    return out


def size_text(s: Susceptibility) -> str:
    """Its first parameters with units."""
    values = list(zip(s.effect.parameters, s.values, s.effect.units, strict=True))
    shown = [f"{p} {number(v, 2)}{'' if u == '1' else ' ' + u}" for p, v, u in values[:2]]
    return ", ".join(shown) + (" …" if len(values) > 2 else "")


def _short(label: str) -> str:
    first = label.split(" ")
    return label if len(label) <= 24 else " ".join(first[: 2 if first[0][:1] != "I" else 1]) + " …"


def sensor_title(sensors: SensorChoice) -> str:
    """What the table of sensors shows."""
    how = "assumed" if sensors.assumed else "as stated"
    return f"Candidate sensors: share of the links' prior uncertainty ({percent(sensors.trust, 2)}, {how}) that would be left"


def sensor_rows(sensors: SensorChoice) -> list[list[str]]:
    """A line for each thing that candidates are compared by, a cell for each candidate behind its name."""
    outlooks = sensors.outlooks
    bodies = list(dict.fromkeys(body for o in outlooks for body in o.left))
    return [
        ["combinations determined", *(str(o.determined.base.rank) for o in outlooks)],
        ["better than beforehand", *(str(o.told) for o in outlooks)],
        *([f"left of {b}", *(percent(o.left[b], 2) if b in o.left else DASH for o in outlooks)] for b in bodies),
        ["range used", *(_range_used(o) for o in outlooks)],
    ]


def _range_used(outlook: Outlook) -> str:
    if not np.isfinite(outlook.candidate.limit).any():
        return DASH
    return percent(outlook.load, 2) + (" (too much)" if outlook.load > 1.0 else "")


def coverage_text(c: Certificate | None) -> str:
    """One sentence on a certificate; empty without."""
    if c is None:
        return ""
    low, high = c.band
    least, most = percent(float(np.nanmin(c.coverage))), percent(float(np.nanmax(c.coverage)))
    return (
        f"Coverage of 95 % intervals on {c.twins} twins: {percent(c.overall)} ± {percent(1.96 * c.overall_error, 2)} overall, "
        f"{least} to {most} by parameter; exact intervals keep to {percent(low)} … {percent(high)}: "
        + ("they hold." if c.holds else "some are too short.")
    )
