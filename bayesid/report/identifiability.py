"""The report of ``identifiability``: turns its result into what its template shows."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from bayesid.design.identifiability import SetReport
from bayesid.design.visibility import WORDS, LinkExpectation
from bayesid.report.identifiability_figures import classes, expected
from bayesid.report.page import render, run_times, svg, versions
from bayesid.results.identifiability import Identifiability, own_std
from bayesid.results.identifiability_text import TOLD_HEAD, counts, effect_lines, lead, share, sources, spread, told
from bayesid.results.text import DASH, number, percent

_SOURCES = {
    "given": "as given", "data sheet": "the sensor's data sheet ([sensor] force_std, torque_std)", "assumed": "assumed",
    "readings": "what a fit leaves of the recorded readings, colour and model error included",
}  # fmt: skip


def identifiability_report(result: Identifiability) -> str:
    """The report of ``identifiability``: an HTML page with all figures inside."""
    main = result.main
    return render(
        "identifiability.html",
        name=result.name,
        kicker=_kicker(result),
        warning_list=result.warnings,
        lead=lead(result),
        card_list=_cards(main),
        advice=[a.text for a in result.advice],
        sets=[_set(r, r is main) for r in result.sensor_sets],
        classes=svg(classes(result.sensor_sets, main), "classes"),
        many=len(result.sensor_sets) > 1,
        words=[{"kind": k, "text": WORDS[k], "count": n} for k, n in counts(main)],
        title=main.sensor_set.title,
        parameters=[_link(p, k, result) for k, p in enumerate(main.parameters)],
        spread=spread(main),
        expected=svg(expected_figure(main), "expected") if main.base_parameters else "",
        bases=[_base(k, main) for k in range(main.rank)],
        sized=any(b.size for b in main.base_parameters),
        prior=any(b.prior_share is not None for b in main.base_parameters),
        unexcited=main.unexcited,
        effects=[{"name": n, "text": t} for n, t in effect_lines(main)],
        told=told(result) if result.separations else [],
        told_head=TOLD_HEAD,
        how=_how(result),
    )


def expected_figure(report: SetReport, ax: Any = None) -> Figure:
    """Expected standard deviations of a sensor set's combinations."""
    return expected(report, report.shown.base.short_names, ax)


def _kicker(result: Identifiability) -> str:
    what = {"recorded": "recorded", "planned": "planned", "regression": "given"}[result.source]
    names = ", ".join(n + (f" ({number(d, 3)} s)" if d else "") for n, d in result.motions.items())
    return f"What can be determined from the {what} motion{'s' if len(result.motions) > 1 else ''} {names}, before estimating"


def _cards(main: SetReport) -> list[dict[str, str]]:
    most = main.rank_of_any_motion
    rank = f"{main.rank}" if most is None else f"{main.rank} of {most}"
    mood = "good" if most in (None, main.rank) else "fair"
    cards = [{"value": rank, "mood": mood, "text": "combinations determined, of those that any motion can show"}]
    if any(b.size for b in main.base_parameters):
        weak = main.rank - main.well_known
        cards.append({"value": str(main.well_known), "mood": "fair" if weak else "good",
                      "text": "of them expected to be known better than by the size of a body"})  # fmt: skip
    alone = sum(p.kind == "alone" for p in main.parameters)
    cards.append({"value": f"{alone} of {len(main.parameters)}", "mood": "", "text": "link parameters identified alone"})
    cards.append({"value": number(main.condition_number, 3), "mood": "", "text": "condition number, columns at unit length"})
    return cards


def _set(report: SetReport, main: bool) -> dict[str, Any]:
    found = dict(counts(report))
    return {
        "title": report.sensor_set.title, "main": main, "rank": str(report.rank),
        "most": DASH if report.rank_of_any_motion is None else str(report.rank_of_any_motion),
        "known": str(report.well_known) if any(b.size for b in report.base_parameters) else DASH,
        "condition": number(report.condition_number, 3), "counts": [found.get(k, 0) for k in WORDS], "noise": sources(report),
    }  # fmt: skip


def _link(link: LinkExpectation, index: int, result: Identifiability) -> dict[str, Any]:
    main = result.main
    inside = [main.base_parameters[k] for k in link.combinations]
    better = [f"move {j}" for j in link.joints]
    # Sets come in the order of what they ask for: the first that shows more is enough.
    better += [r.sensor_set.title for r in result.sensor_sets if r.sensor_set.name in link.sensor_sets][:1]
    return {
        "name": link.name, "kind": link.kind, "text": WORDS[link.kind],
        "std": number(own_std(link, main), 3) if inside else DASH, "unit": inside[0].unit if inside else "",
        "combination": inside[0].label if inside and inside[0].label != link.name else "",
        "more": len(inside) - 1, "better": ", ".join(better) or DASH,
        "others": [{"kind": r.parameters[index].kind} for r in result.sensor_sets if r is not main],
    }  # fmt: skip


def _base(index: int, main: SetReport) -> dict[str, Any]:
    b = main.base_parameters[index]
    return {
        "index": index + 1, "label": b.label, "unit": b.unit, "std": number(b.std, 3), "size": number(b.size, 3),
        "relative": share(b.std / b.size) if b.size else DASH, "kind": b.kind,
        "prior": DASH if b.prior_share is None else percent(b.prior_share, 2),
    }  # fmt: skip


def _how(result: Identifiability) -> list[tuple[str, str]]:
    main = result.main
    rows = [("Noise", "; ".join(f"{k}: {_SOURCES[source]}" for k, source in main.noise.items()))]
    if main.noise_std:
        rows.append(("Standard deviation of a row", ", ".join(f"{n} {number(s, 3)}" for n, s in main.noise_std.items())))
    model = main.expected.row_model
    if model is not None:
        rows.append(("Rows", f"joint motion up to {number(model.bandwidth, 3)} Hz, {number(1.0 / model.step, 3)} rows a second"))
    if result.still:
        rows.append(("Joints that stand still", ", ".join(result.still)))
    rows += [
        ("Ranks", "of the regressor, effects projected out; a column counts from 3e-5 of its length on"),
        ("Size", "standard deviation of a combination when every body's mass distribution is uncertain by its own size"),
        run_times(result.seconds),
        versions("numpy", "pin"),
    ]
    return rows
