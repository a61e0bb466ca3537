"""The reports of ``payload`` and ``calibrate``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.design.payload.body import Quantity
from bayesid.report.figures import CLASSES, GREY, add_legend, make_grid, styled
from bayesid.report.page import render, run_times, svg, versions
from bayesid.report.prediction_figures import measured_against_predicted
from bayesid.results.beside import cells
from bayesid.results.calibration import Calibration
from bayesid.results.payload import SOURCES, PayloadEstimate
from bayesid.results.text import channel_text, number


def calibration_report(result: Calibration) -> str:
    """The report of ``calibrate``: an HTML page with all figures inside."""
    return render(
        "calibration.html",
        name=result.name, sensor=result.sensor, motions=", ".join(result.fit.problem.fitted), rows=result.rows(),
        sentences=result.sentences, warnings_list=result.warnings, exports=list(result.exports().items()),
        plot_svg=svg(measured_against_predicted(result.fit.fitted[0]), "readings"),
        how=[("Diagnosis", result.verdict or "refused"), run_times(result.seconds), versions("numpy", "scipy", "pin")],
    )  # fmt: skip


def payload_report(result: PayloadEstimate) -> str:
    """The report of ``payload``: an HTML page with all figures inside."""
    cards = [_card("mass", result.mass, 1.0, "kg"), *(_card(f"centre of mass {q.name}", q, 1e3, "mm") for q in result.centre)]
    return render(
        "payload.html",
        name=result.name, source=SOURCES[result.source].format(where=result.source_detail), channel=channel_text(result.channel),
        frame=result.frame, carrier=result.carrier, card_list=cards, warnings_list=result.warnings, sentences=result.sentences,
        rows=[(row, q.shown) for row, q in zip(result.rows(), result.quantities, strict=True)],
        plot_svg=svg(payload_figure(result), "payload"), exports=list(result.exports().items()),
        how=[("Diagnosis", result.verdict or "left out"),
             ("Physically consistent", "yes" if result.physically_consistent else "no"),
             ("Bound of an inertia that is not shown", f"{number(result.inertia_bound, 3)} kg m²"),
             run_times(result.seconds), versions("numpy", "scipy", "pin")],
    )  # fmt: skip


def _card(name: str, q: Quantity, scale: float, unit: str) -> dict[str, str]:
    """A quantity in another unit, in large type."""
    if not q.shown:
        return {"value": "not shown", "mood": "bad", "text": name}
    scaled = replace(q, **{k: scale * getattr(q, k) for k in ("value", "std", "low", "high")})
    value, interval = cells(scaled)
    return {"value": f"{value} {unit}", "mood": "good", "text": f"{name}, {interval} {unit}"}


@styled
def payload_figure(result: PayloadEstimate, ax: Any = None) -> Figure:
    """Mass [kg] and centre of mass [mm] with their 95 % intervals, a panel each, beside those without the effects found."""
    figure, axes = make_grid(1, 4, 1.5, gap=0.55, ax=ax)
    series = [(result.quantities[:4], CLASSES["alone"], "told", 0.0)]
    if any(e.in_model for e in result.effects):
        series.append((result.plain, GREY, "without the effects found", 1.0))
    for quantities, colour, label, x in series:
        for panel, q, scale in zip(axes[0], quantities, (1.0, 1e3, 1e3, 1e3), strict=True):
            value, low, high = (scale * getattr(q, k) if q.shown else np.nan for k in ("value", "low", "high"))
            ends = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
            panel.errorbar([x], [value], ends, fmt="o", ms=4, color=colour, capsize=2.5, lw=1.2, label=label)
    for panel, title in zip(axes[0], ("mass [kg]", *(f"centre {k} [mm]" for k in "xyz")), strict=True):
        panel.set_title(title)
        panel.set_xticks([])
        panel.set_xlim(-1.0, 2.0)
    add_legend(axes, *axes[0, 0].get_legend_handles_labels())
    return figure
