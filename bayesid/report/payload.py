"""The reports of ``payload`` and ``calibrate``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.design.payload.body import Quantity
from bayesid.drawing import Figures, figures_of
from bayesid.report.figures import CLASSES, GREY, add_legend, make_grid, styled
from bayesid.report.fit_figures import measured_against_predicted
from bayesid.report.page import below, cards, figure, how, note, page, svg, warnings
from bayesid.results.files import report_of
from bayesid.results.payload import SOURCES, Calibration, PayloadEstimate, cells
from bayesid.rounding import channel_text, number
from bayesid.section import Html, Part, ShownSection


@report_of.register
def calibration_report(result: Calibration) -> str:
    """The report of ``calibrate``: an HTML page with all figures inside."""
    sections = [
        ShownSection("What it has", [
            result.table,
            note("Of what was not found stands the size from which it would be named half of the time, at the place where it "
                 "would stand out least."),
            figure(svg(measured_against_predicted(result.fit.fitted[0]), "readings"),
                   "Readings, measured and by the model with all that was found."),
        ]),
        *_files("Gravity compensation", result.exports()),
        how(("Diagnosis", result.verdict or "refused"), seconds=result.seconds),
    ]  # fmt: skip
    motions = ", ".join(result.fit.problem.fitted)
    return page(
        f"Calibration of {result.name}", f"Force/torque sensor in {result.sensor}, from {motions}",
        [warnings(result.warnings), *result.sentences], sections,
    )  # fmt: skip


@report_of.register
def payload_report(result: PayloadEstimate) -> str:
    """The report of ``payload``: an HTML page with all figures inside."""
    large = [_card("mass", result.mass, 1.0, "kg"), *(_card(f"centre of mass {q.name}", q, 1e3, "mm") for q in result.centre)]
    sections = [
        ShownSection("Values", [
            note(f"In the frame of **{result.frame}**; inertia about the centre of mass, in that frame's axes."),
            result.table,
            figure(svg(payload_figure(result), "payload") if any(q.shown for q in result.quantities[:4]) else "",
                   "With 95 % intervals."),
        ]),
        *_files(
            "For controllers", result.exports(),
            note("Units, frames and order are those of each maker's document. A wrist sensor does not weigh itself: add its own "
                 "mass to what a controller is told, where it sits beyond the flange."),
        ),
        how(
            ("Diagnosis", result.verdict or "left out"),
            ("Physically consistent", "yes" if result.physically_consistent else "no"),
            ("Bound of an inertia that is not shown", f"{number(result.inertia_bound, 3)} kg m²"),
            seconds=result.seconds,
        ),
    ]  # fmt: skip
    source = SOURCES[result.source].format(where=result.source_detail)
    return page(
        f"Payload of {result.name}", f"{source}, from the {channel_text(result.channel)}, carried by {result.carrier}",
        [cards(large), warnings(result.warnings), *result.sentences], sections,
    )  # fmt: skip


def _files(title: str, texts: Mapping[str, str], *before: Part) -> list[ShownSection]:
    """A section with the text of each file; none without files."""
    return (
        [ShownSection(title, [*before, *(below(k, Html(f"<pre>{escape(v)}</pre>")) for k, v in texts.items())])] if texts else []
    )


def _card(name: str, q: Quantity, scale: float, unit: str) -> tuple[str, str, str]:
    """A quantity in another unit, in large type."""
    if not q.shown:
        return "not shown", name, "bad"
    value, interval = cells(replace(q, **{k: scale * getattr(q, k) for k in ("value", "std", "low", "high")}))
    return f"{value} {unit}", f"{name}, {interval} {unit}", "good"


@styled
def payload_figure(result: PayloadEstimate, ax: Any = None) -> Figure:
    """Mass [kg] and centre of mass [mm] with their 95 % intervals, a panel each, beside those without the effects found."""
    figure, axes = make_grid(1, 4, 1.5, gap=0.55, ax=ax)
    series = [(result.quantities[:4], CLASSES["alone"], "estimated", 0.0)]
    if any(e.in_model for e in result.effects):
        series.append((result.plain, GREY, "without the effects found", 1.0))
    for quantities, colour, label, x in series:
        for panel, q, scale in zip(axes[0], quantities, (1.0, 1e3, 1e3, 1e3), strict=True):
            value, low, high = (scale * getattr(q, k) if q.shown else np.nan for k in ("value", "low", "high"))
            ends = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
            panel.errorbar([x], [value], ends, fmt="o", ms=4, color=colour, capsize=2.5, lw=1.2, label=label)
    titles = "mass [kg]", *(f"centre {k} [mm]" for k in "xyz")
    for k, (panel, title) in enumerate(zip(axes[0], titles, strict=True)):
        panel.set_title(title)
        if not any(quantities[k].shown for quantities, *_ in series):
            panel.set_yticks([])
            panel.text(0.5, 0.5, "not shown", transform=panel.transAxes, ha="center", color=GREY)
        panel.set_xticks([])
        panel.set_xlim(-1.0, 2.0)
    add_legend(axes)
    return figure


@figures_of.register
def _(result: Calibration) -> Figures:
    return {"predictions": partial(measured_against_predicted, result.fit.fitted[0], None)}


@figures_of.register
def _(result: PayloadEstimate) -> Figures:
    return {"payload": partial(payload_figure, result)}
