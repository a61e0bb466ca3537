"""The report of ``accuracy``."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.design.accuracy.sensor_choice import KINDS, SensorChoice
from bayesid.drawing import Figures, figures_of
from bayesid.dynamics.base_parameters import notation
from bayesid.report.accuracy_figures import (
    SHOWN_EFFECTS,
    certificate_figure,
    certificate_section,
    susceptibility_figure,
    sweeps_figure,
)
from bayesid.report.page import cards, figure, fold, how, lead, note, page, run_times, svg, terms, versions, warnings
from bayesid.results.accuracy import (
    NO_BIAS,
    Accuracy,
    change,
    coverage_text,
    effects_table,
    improvements_table,
    sensor_title,
    sensors_table,
    sweeps_table,
    worst_places,
)
from bayesid.results.files import report_of
from bayesid.robot import inertia
from bayesid.rounding import DASH, HALF, channel_text, number, percent
from bayesid.section import Part, ShownSection, ShownTable

#: Places of each kind of effect that the map shows.
_MAPPED_PLACES = 4


@report_of.register
def accuracy_report(result: Accuracy) -> str:
    """The report of ``accuracy``: an HTML page with all figures inside."""
    bench, sweeps, base = result.bench, result.sweeps, result.bench.problem.row_model.base
    biased = [s for s in result.susceptibility if s.largest >= NO_BIAS]
    sections: list[Part] = []
    if result.improvements:
        best = "The best step of each factor that lowers the error beyond chance, what lowers it most first."
        sections.append(ShownSection("What would buy most", [best, improvements_table(result)]))
    if sweeps is not None:
        sections.append(ShownSection("One factor at a time", [
            "Everything else stays as it is. Error: root mean square of estimate less truth, bias included. Predictions: of "
            f"{', '.join(bench.predicted_motions)}, error over signal, noise of the readings not counted.",
            figure(svg(sweeps_figure(sweeps), "sweeps"),
                   "Median over the base parameters, relative to your own setting (green line); bars: 95 % intervals from "
                   f"{sweeps.runs} simulated recordings of each level, which all levels share. Circles around dots: by formula."),
            sweeps_table(sweeps),
            note("Lost: combinations of parameters that such readings do not determine; the median is over the others. Length: "
                 "recording the first part, or the whole motion several times with fresh noise. Faster sampling: noise taken "
                 "as independent from sample to sample."),
        ]))  # fmt: skip
    mapped = min(len(worst_places(biased, _MAPPED_PLACES)), SHOWN_EFFECTS)
    unbiased = f", {len(result.susceptibility) - len(biased)} of them without any bias"
    sections.append(ShownSection("Effects left out of the model", [
        "What the estimate would be off by if the robot or sensor had an effect that the model lacks, at a usual size, "
        "everything else being right (bias susceptibility). A payload or another body that belongs to a link is no error of "
        "the link that carries it: there the change says what the estimate then holds.",
        figure(svg(bias_map(result), "susceptibility") if biased else "",
               f"The {mapped} places that bias most, at most four of a kind, by base parameter; white: less than a tenth of a "
               "standard deviation."),
        "Each kind of effect at its worst place:", effects_table(worst_places(result.susceptibility, 1), base.labels),
        fold(f"All {len(result.susceptibility)} places{unbiased * (len(biased) < len(result.susceptibility))}",
             effects_table(result.susceptibility, base.labels)),
    ], "Effects left out"))  # fmt: skip
    sections += certificate_section(result.certificate, base)
    if result.sensors is not None:
        sections.append(_sensors(result.sensors))
    parameters = [_parameters(result), note("± : standard errors of the simulation.")]
    sections += [
        ShownSection("Every base parameter", parameters, "Parameters"),
        how(*_how(result), after="SI units, force before moment.", title="How this was done"),
    ]
    readings = channel_text(bench.problem.channel, bench.problem.fitted)
    kicker = f"Accuracy of {bench.rank} base parameters by {bench.method.name}, from the {readings}"
    fine = "No warnings: formula and simulation agree, and the model is complete as far as its residuals tell."
    name = bench.experiment.name
    return page(name, kicker, [warnings(result.warnings, fine), lead(_lead(result)), cards(_cards(result))], sections,
                f"{name}: accuracy")  # fmt: skip


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


def _cards(result: Accuracy) -> list[tuple[str, str, str]]:
    large = []
    if result.sweeps is not None:
        own, predicted = result.sweeps.own, ", ".join(result.bench.predicted_motions)
        large.append((percent(own.prediction, 2), f"of the signal of {predicted}: by so much predictions are wrong", ""))
        largest = float(np.nanmax(np.abs(own.bias) / np.maximum(own.std, 1e-300)))
        mood = "good" if largest < 0.5 + 3.0 / np.sqrt(result.sweeps.runs) else "fair"
        large.append((f"{number(largest, 2)} σ", "largest bias by smoothing and encoders alone", mood))
    large += [(change(v.ratio), f"of the median error by {v.improvement}", "") for _, v in result.improvements[:2]]
    if (c := result.certificate) is not None:
        mood = "good" if c.holds else "bad"
        large.append((percent(c.overall), f"of 95 % intervals held the truth on {c.twins} twins", mood))
    return large


def _parameters(result: Accuracy) -> ShownTable:
    base, bench, sweeps = result.bench.problem.row_model.base, result.bench, result.sweeps
    head, columns = ["#", "base parameter", "value", "std printed"], "nd w n n"
    if sweeps is not None:
        formula = sweeps.formula is not None
        head += ["std simulated", *["by formula"] * formula, "bias", "rms error"]
        columns += " n" + " n" * formula + " n nb"
    rows = []
    for k, (label, unit) in enumerate(zip(base.labels, base.units, strict=True)):
        row = [str(k + 1), label, number(bench.truth[k]), number(bench.estimate.std[k], 3)]
        if sweeps is not None:
            own = sweeps.own
            row.append(f"{number(own.std[k], 3)} ± {number(own.std_error[k], 2)}")
            row += [] if sweeps.formula is None else [number(sweeps.formula[k], 3)]
            row += [f"{number(own.bias[k], 2)} ± {number(own.bias_error[k], 2)}", number(own.rms[k], 3)]
        worst, most = max(result.susceptibility, key=lambda s: np.nan_to_num(abs(s.sigmas[k])), default=None), DASH
        if worst is not None and np.isfinite(worst.sigmas[k]) and abs(worst.sigmas[k]) >= NO_BIAS:
            most = f"{worst.effect.spec} ({number(abs(worst.sigmas[k]), 2)} σ)"
        rows.append([*row, unit, most])
    return ShownTable([*head, "unit", "most harmful effect"], rows, f"{columns} ku -", "tight")


def _sensors(choice: SensorChoice) -> ShownSection:
    """Candidates side by side: what they leave, their ranges, link parameters and effects."""
    outlooks = choice.outlooks
    candidates = [o.candidate.name for o in outlooks]
    ranges = [
        (f"{o.candidate.name} ({KINDS[o.candidate.kind]})", ", ".join(
            f"{n} {number(p, 3)} {u}" + (f" of {number(r, 3)}" if np.isfinite(r) else "")
            for n, p, u, r in zip(o.candidate.readings, o.peak, o.candidate.units, o.candidate.limit, strict=True)))
        for o in outlooks
    ]  # fmt: skip
    names = list(dict.fromkeys(n for o in outlooks for n in o.names))
    by_name = [dict(zip(o.names, o.link_std, strict=True)) for o in outlooks]
    before = {n: s for o in outlooks for n, s in zip(o.names, o.prior_std, strict=True)}
    units: dict[str, str] = dict(zip(inertia.PARAMETERS, inertia.UNITS, strict=True))
    links = [
        [label, f"± {number(HALF * before[n], 2)}", *(f"± {number(HALF * v[n], 2)}" if n in v else DASH for v in by_name),
         units.get(n.rpartition(".")[2], "")]
        for n, label in zip(names, notation(names), strict=True)
    ]  # fmt: skip
    specs = list(dict.fromkeys(spec for o in outlooks for spec in o.effects))
    seen = [s for s in specs if any(o.effects.get(s) is not None for o in outlooks)]
    effects = [[s, *(DASH if o.effects.get(s) is None else percent(o.effects[s] or 0.0, 2) for o in outlooks)] for s in seen]
    numbers = " n" * len(outlooks)
    return ShownSection("Candidate sensors", [
        "What each sensor would tell of the fitted motions, its offset fitted along, before it is bought. Left of a body: the "
        "share of the prior uncertainty of its ten parameters; 100 % is what is known without the sensor. Better than "
        "beforehand: combinations of link parameters with a smaller error than what is known of them anyway.",
        sensors_table(choice), note(f"{sensor_title(choice)}."),
        fold("Largest readings and ranges", terms(ranges)),
        fold("Expected 95 % intervals of every link parameter",
             ShownTable(["link parameter", "without", *candidates, "unit"], links, f"k nd{numbers} ku", "tight")),
        fold("Smallest effects that would be seen",
             note("In per cent of an effect of usual size, with what the links could explain of it taken away; a dash: not "
                  f"seen at any plausible size. {len(specs) - len(seen)} effects are seen by none."),
             ShownTable(["effect", *candidates], effects, f"k{numbers}", "tight")),
    ], "Sensors")  # fmt: skip


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


@figures_of.register
def _(result: Accuracy) -> Figures:
    figures: dict[str, Any] = {"susceptibility": partial(bias_map, result)}
    if result.sweeps is not None:
        figures["sweeps"] = partial(sweeps_figure, result.sweeps)
    if result.certificate is not None:
        figures["certificate"] = partial(certificate_figure, result.certificate, result.bench.problem.row_model.base.short_names)
    return figures
