"""The report of ``payload``."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.report.figures import CLASSES, GREY, add_legend, make_grid, styled
from bayesid.report.page import render, run_times, svg, versions
from bayesid.results.payload import SOURCES, PayloadEstimate
from bayesid.results.text import channel_text, number, with_interval


def payload_report(result: PayloadEstimate) -> str:
    """The report of ``payload``: an HTML page with all figures inside."""
    mass, half = with_interval(result.mass.value, result.mass.std, result.mass.low, result.mass.high)
    cards = [{"value": f"{mass} kg" if result.mass.shown else "not shown", "mood": "good" if result.mass.shown else "bad",
              "text": f"mass, ± {half} kg" if result.mass.shown else "mass"}]  # fmt: skip
    for q in result.centre:
        value, half = with_interval(1e3 * q.value, 1e3 * q.std, 1e3 * q.low, 1e3 * q.high)
        cards.append({"value": f"{value} mm" if q.shown else "not shown", "mood": "good" if q.shown else "bad",
                      "text": f"centre of mass {q.name}" + (f", ± {half} mm" if q.shown else "")})  # fmt: skip
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


@styled
def payload_figure(result: PayloadEstimate, ax: Any = None) -> Figure:
    """Mass [kg] and centre of mass [mm] with their 95 % intervals, beside those without the effects that were found."""
    figure, axes = make_grid(1, 2, 1.5, gap=0.4, width_ratios=(1.0, 2.0), ax=ax)
    one, other = axes[0, 0], axes[0, 1]
    told = [(result.quantities[:4], CLASSES["alone"], "told", 0.0)]
    if result.effects:
        told.append((result.plain, GREY, "without the effects found", 0.18))
    for quantities, colour, label, shift in told:
        for panel, part, scale in ((one, quantities[:1], 1.0), (other, quantities[1:4], 1e3)):
            x = np.arange(len(part)) + shift
            ends = (np.array([getattr(q, k) if q.shown else np.nan for q in part]) for k in ("value", "low", "high"))
            value, low, high = (scale * e for e in ends)
            panel.errorbar(x, value, [np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)], fmt="o", ms=4, color=colour,
                           capsize=2.5, lw=1.2, label=label)  # fmt: skip
    one.set_title("mass [kg]")
    one.set_xticks([0], ["m"])
    one.set_xlim(-0.6, 0.8)
    other.set_title(f"centre of mass in the frame of {result.frame} [mm]")
    other.set_xticks([0, 1, 2], ["x", "y", "z"])
    other.set_xlim(-0.6, 2.8)
    add_legend(axes, *other.get_legend_handles_labels())
    return figure
