"""The report of ``accuracy``: turns an `Accuracy` into what its template shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.design.accuracy.sensor_choice import SensorChoice
from bayesid.design.accuracy.sensor_file import KINDS
from bayesid.report.accuracy_figures import SHOWN_EFFECTS, susceptibility_figure, sweeps_figure
from bayesid.report.certificate import certificate_section
from bayesid.report.page import render, run_times, svg, versions
from bayesid.results.accuracy import (
    NO_BIAS,
    Accuracy,
    change,
    coverage_text,
    effect_cells,
    level_cells,
    sensor_rows,
    sensor_title,
    worst_places,
)
from bayesid.results.text import DASH, HALF, channel_text, number, percent
from bayesid.robot import inertia
from bayesid.robot.notation import notation

#: Places of each kind of effect that the map shows.
_MAPPED_PLACES = 4


def accuracy_report(result: Accuracy) -> str:
    """The report of ``accuracy``: an HTML page with all figures inside."""
    bench, sweeps = result.bench, result.sweeps
    biased = [s for s in result.susceptibility if s.largest >= NO_BIAS]
    certificate = result.certificate
    base = bench.problem.row_model.base
    return render(
        "accuracy.html",
        name=bench.experiment.name,
        kicker=f"Accuracy of {bench.rank} base parameters by {bench.method.name}, from the "
        f"{channel_text(bench.problem.channel)} of {', '.join(bench.problem.fitted)}",
        warning_list=result.warnings,
        lead=_lead(result),
        card_list=_cards(result),
        improvements=_improvements(result),
        sweeps="" if sweeps is None else svg(sweeps_figure(sweeps), "sweeps"),
        factors=[] if sweeps is None else [
            {"title": s.title, "rows": [{"cells": level_cells(v, k == s.own), "own": k == s.own, "reason": v.reason,
                                         "source": v.source} for k, v in enumerate(s.levels)]}
            for s in sweeps.sweeps
        ],
        runs=0 if sweeps is None else sweeps.runs,
        predicted=", ".join(bench.predicted_motions),
        map="" if not biased else svg(bias_map(result), "susceptibility"),
        map_size=min(len(worst_places(biased, _MAPPED_PLACES)), SHOWN_EFFECTS),
        worst=[effect_cells(s, base.labels) for s in worst_places(result.susceptibility, 1)],
        effects=[effect_cells(s, base.labels) for s in result.susceptibility],
        unbiased=len(result.susceptibility) - len(biased),
        certificate=certificate_section(certificate, base),
        certified=certificate is not None,
        sensors=None if result.sensors is None else _sensors(result.sensors),
        parameters=_parameters(result),
        simulated=sweeps is not None,
        formula=sweeps is not None and sweeps.formula is not None,
        how=_how(result),
    )  # fmt: skip


def bias_map(result: Accuracy, ax: Any = None) -> Figure:
    """Bias of every base parameter by the effects that bias most."""
    biased = [s for s in result.susceptibility if s.largest >= NO_BIAS]
    shown = worst_places(biased, _MAPPED_PLACES)[:SHOWN_EFFECTS]
    base = result.bench.problem.row_model.base
    matrix = np.array([s.sigmas for s in shown]).reshape(len(shown), base.rank)
    return susceptibility_figure([s.effect.spec for s in shown], base.short_names, matrix, ax)


def _lead(result: Accuracy) -> str:
    text = ""
    best = result.improvements
    if best:
        first = best[0][1]
        text = f"What would help most: {first.improvement} ({change(first.ratio)} of the median error of the base parameters)."
        if len(best) > 1:
            text += " Then " + ", ".join(f"{v.improvement} ({change(v.ratio)})" for _, v in best[1:3]) + "."
    elif result.sweeps is not None:
        text = "None of the changes that were tried lowers the error by more than chance."
    worst = next((s for s in result.susceptibility if s.largest >= NO_BIAS), None)
    if worst is not None:
        text += (
            f" Of the effects that the model lacks, {worst.effect.spec} of usual size would do most harm: a bias of "
            f"{number(worst.largest, 2)} standard deviations."
        )
    return f"{text} {coverage_text(result.certificate)}".strip()


def _cards(result: Accuracy) -> list[dict[str, str]]:
    cards = []
    if result.sweeps is not None:
        own = result.sweeps.own
        predicted = ", ".join(result.bench.predicted_motions)
        cards.append({"value": percent(own.prediction, 2), "mood": "",
                      "text": f"of the signal of {predicted}: by so much predictions are wrong"})  # fmt: skip
        largest = float(np.nanmax(np.abs(own.bias) / np.maximum(own.std, 1e-300)))
        good = largest < 0.5 + 3.0 / np.sqrt(result.sweeps.runs)
        cards.append({"value": f"{number(largest, 2)} σ", "mood": "good" if good else "fair",
                      "text": "largest bias by smoothing and encoders alone"})  # fmt: skip
    for _, v in result.improvements[:2]:
        cards.append({"value": change(v.ratio), "mood": "", "text": f"of the median error by {v.improvement}"})
    if result.certificate is not None:
        c = result.certificate
        cards.append({"value": percent(c.overall), "mood": "good" if c.holds else "bad",
                      "text": f"of 95 % intervals held the truth on {c.twins} twins"})  # fmt: skip
    return cards


def _improvements(result: Accuracy) -> list[list[str]]:
    if result.sweeps is None:
        return []
    rows = []
    for _, v in result.improvements:
        sure = DASH if v.source == "formula" else f"{change(v.ratio_low)} … {change(v.ratio_high)}"
        rows.append([v.improvement, change(v.ratio), sure, change(v.prediction_ratio), v.source])
    return rows


def _parameters(result: Accuracy) -> list[dict[str, Any]]:
    base, bench, sweeps = result.bench.problem.row_model.base, result.bench, result.sweeps
    rows = []
    for k, (label, unit) in enumerate(zip(base.labels, base.units, strict=True)):
        value, std = number(bench.truth[k]), number(bench.estimate.std[k], 3)
        row = {"index": k + 1, "label": label, "unit": unit, "value": value, "std": std}
        if sweeps is not None:
            own = sweeps.own
            row |= {
                "bias": f"{number(own.bias[k], 2)} ± {number(own.bias_error[k], 2)}", "sim": f"{number(own.std[k], 3)} ± "
                f"{number(own.std_error[k], 2)}", "rms": number(own.rms[k], 3),
                "formula": DASH if sweeps.formula is None else number(sweeps.formula[k], 3),
            }  # fmt: skip
        worst = max(result.susceptibility, key=lambda s: np.nan_to_num(abs(s.sigmas[k])), default=None)
        row["worst"] = DASH
        if worst is not None and np.isfinite(worst.sigmas[k]) and abs(worst.sigmas[k]) >= NO_BIAS:
            row["worst"] = f"{worst.effect.spec} ({number(abs(worst.sigmas[k]), 2)} σ)"
        rows.append(row)
    return rows


def _sensors(choice: SensorChoice) -> dict[str, Any]:
    """Candidates side by side: what they leave, their ranges, link parameters and effects."""
    outlooks = choice.outlooks
    names = list(dict.fromkeys(n for o in outlooks for n in o.names))
    by_name = [dict(zip(o.names, o.link_std, strict=True)) for o in outlooks]
    before = {n: s for o in outlooks for n, s in zip(o.names, o.prior_std, strict=True)}
    units: dict[str, str] = dict(zip(inertia.PARAMETERS, inertia.UNITS, strict=True))
    specs = list(dict.fromkeys(spec for o in outlooks for spec in o.effects))
    shown = [s for s in specs if any(o.effects.get(s) is not None for o in outlooks)]
    return {
        "title": sensor_title(choice),
        "names": [o.candidate.name for o in outlooks],
        "kinds": [KINDS[o.candidate.kind] for o in outlooks],
        "rows": sensor_rows(choice),
        "exceeded": [o.load > 1.0 for o in outlooks],
        "ranges": [
            {"name": o.candidate.name, "cells": [
                f"{n} {number(p, 3)} {u}" + (f" of {number(r, 3)}" if np.isfinite(r) else "")
                for n, p, u, r in zip(o.candidate.readings, o.peak, o.candidate.units, o.candidate.limit, strict=True)
            ]}
            for o in outlooks
        ],
        "links": [
            {"name": label, "unit": units.get(n.rpartition(".")[2], ""), "before": number(HALF * before[n], 2),
             "cells": [number(HALF * values[n], 2) if n in values else DASH for values in by_name]}
            for n, label in zip(names, notation(names), strict=True)
        ],
        "effects": [
            {"name": s, "cells": [DASH if o.effects.get(s) is None else percent(o.effects[s] or 0.0, 2) for o in outlooks]}
            for s in shown
        ],
        "unseen": len(specs) - len(shown),
    }  # fmt: skip


def _how(result: Accuracy) -> list[tuple[str, str]]:
    bench = result.bench
    channels = bench.problem.row_model.channels
    noise = ", ".join(f"{n} {number(s, 2)} {u}" for n, s, u in zip(channels.names, bench.noise.std, channels.units, strict=True))
    colour = "white" if bench.noise.order == 0 else f"autoregressive of order {bench.noise.order}"
    encoder = f"counts of {number(bench.resolution, 2)}" if bench.resolution else "no counts known"
    if bench.position_std.any():
        encoder += f"; random errors of {number(float(bench.position_std.max()), 2)} at most"
    links = "the nominal ones" if bench.nominal else "those with the estimated base parameters, nearest to the nominal ones"
    rows = [
        ("True motion", "the recording's own, its positions smoothed; each twin starts a random part of a sample later"),
        ("True links", links),
        ("True effects", ", ".join(t.effect.spec for t in bench.terms) or "none"),
        ("Noise of a reading", f"{noise}; {colour}, from what the fit leaves, model error included"),
        ("Encoders", encoder),
    ]
    if result.sweeps is not None:
        rows.append(("Twins", f"{result.sweeps.runs} of every simulated level, all from seed {result.sweeps.seed}"))
    return [*rows, run_times(result.seconds), versions("numpy", "scipy", "pin")]
