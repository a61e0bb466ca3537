"""The report of ``accuracy``, and the section on coverage in that of ``identify``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from statistics import NormalDist
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from bayesid.design.accuracy.certificate import CoverageCertificate
from bayesid.design.accuracy.sensor_choice import KINDS, SensorChoice
from bayesid.design.accuracy.susceptibility import Susceptibility
from bayesid.design.accuracy.sweeps import Level, Sweep, Sweeps
from bayesid.drawing import Figures, figures_of
from bayesid.dynamics.base_parameters import BaseParameters, notation
from bayesid.estimators.estimator import LEVEL
from bayesid.report.figures import GREY, NOISE, PREDICTED, Drawing, add_legend, list_rows, make_grid, plain_log, styled
from bayesid.report.page import cards, figure, fold, how, lead, note, page, svg, terms, warnings
from bayesid.results import accuracy as results
from bayesid.results.accuracy import Accuracy
from bayesid.results.files import report_of
from bayesid.robot import inertia
from bayesid.rounding import DASH, HALF, channel_text, number, percent
from bayesid.section import Html, Part, ShownSection, ShownTable, as_html

_BLUE, _RED = "#1d4ed8", "#c2410c"
_HEAT = "YlOrRd"
#: Smaller biases are white [standard deviations].
_WHITE = 0.1
_TOP = 0.35
#: Effects that the map shows, and base parameters from which their names are numbers only.
_SHOWN_EFFECTS, _NAMED = 40, 48
#: Places of each kind of effect that the map shows.
_MAPPED_PLACES = 4
_PANELS = 3
#: Where the section stands in a page.
_BEGIN, _END = "<!-- certificate -->", "<!-- end of certificate -->"


@styled
def sweeps_figure(sweeps: Sweeps, ax: Any = None) -> Figure:
    """Error over the user's own by factor: curves where a factor has numbers, dots in one last panel where it has none."""
    curves = [s for s in sweeps.sweeps if s.levels[s.own].value is not None]
    others = [s for s in sweeps.sweeps if s.levels[s.own].value is None]
    rows = [(s, k, v) for s in others for k, v in enumerate(s.levels) if v.source != "refused"]
    if ax is not None:
        figure, axes = make_grid(len(curves) + bool(rows), 1, 1.0, ax=ax)
    else:
        height, width, gap, space = 1.75, 2.75, 0.52, 0.85
        left, top, bottom, names = 0.62, 0.75, 0.5, 4.35
        dots = 0.27 * len(rows) + 0.1
        total = top + -(-len(curves) // _PANELS) * (height + space) + (dots + 0.35 if rows else 0.0) + bottom
        places = [
            (left + column * (width + gap), total - top - row * (height + space) - height, width, height)
            for row, column in (divmod(k, _PANELS) for k in range(len(curves)))
        ]
        places += [(names, bottom, 10.2 - names, dots)] * bool(rows)
        figure = Drawing(figsize=(10.4, total))
        axes = np.array([figure.add_axes((x / 10.4, y / total, w / 10.4, h / total)) for x, y, w, h in places], object)
    for panel, s in zip(axes.ravel(), curves, strict=False):
        _curve(panel, s, sweeps)
    if rows:
        _dots(axes.ravel()[-1], rows, sweeps)
    add_legend(axes)
    return figure


def _quantiles(level: Level, sweeps: Sweeps) -> tuple[float, float]:
    """Range of the middle 80 % of the parameters' errors over the user's own, scaled as the median is."""
    ratio = level.rms / np.maximum(sweeps.own.rms, 1e-300)
    ratio = ratio[np.isfinite(ratio)]
    if not len(ratio):
        return np.nan, np.nan
    scale = level.ratio / float(np.median(ratio))
    return float(scale * np.quantile(ratio, 0.1)), float(scale * np.quantile(ratio, 0.9))


def _curve(ax: Axes, sweep: Sweep, sweeps: Sweeps) -> None:
    levels = [v for v in sweep.levels if v.source != "refused"]
    x = np.arange(len(levels))
    middle = np.array([v.ratio for v in levels])
    low, high = np.array([_quantiles(v, sweeps) for v in levels]).T
    ax.fill_between(x, low, high, color=_BLUE, alpha=0.13, lw=0, label="middle 80 % of the parameters")
    bars = np.abs(np.array([[v.ratio - v.ratio_low, v.ratio_high - v.ratio] for v in levels]).T)
    dots = {"marker": "o", "ms": 4, "lw": 1.3, "capsize": 2.5}
    ax.errorbar(x, middle, yerr=bars, color=_BLUE, label="median error of the base parameters", **dots)
    predicted = np.array([v.prediction_ratio for v in levels])
    spread = 1.96 * np.array([v.prediction_error / max(v.prediction, 1e-300) for v in levels]) * predicted
    squares = {"marker": "s", "ms": 3.5, "lw": 1.0, "ls": "--", "capsize": 2.5}
    ax.errorbar(x, predicted, yerr=np.minimum(spread, 0.95 * predicted), color=_RED, label="error of predictions", **squares)
    formula = [k for k, v in enumerate(levels) if v.source == "formula"]
    ax.plot(x[formula], middle[formula], "o", ms=8, mfc="none", mec=_BLUE, mew=0.9, label="by formula")
    at = next(k for k, v in enumerate(levels) if v is sweep.levels[sweep.own])
    ax.axvline(at, color=NOISE, lw=1.0, zorder=0)
    ax.axhline(1.0, color=GREY, lw=0.7, zorder=0)
    ax.set_yscale("log")
    _limits(ax, np.concatenate([low, high, predicted, middle]))
    ax.set_xticks(x, ["yours" if k == at else _tick(v.label) for k, v in enumerate(levels)], fontsize=8)
    ax.margins(x=0.08)
    ax.set_title(sweep.title)
    ax.set_xlabel(f"yours: {sweep.levels[sweep.own].label}", fontsize=8)
    ax.grid(axis="x", visible=False)


def _tick(label: str) -> str:
    short = label.partition(" (")[0].replace("noise std", "std").replace("repeated ", "×").replace(" times", "")
    return short.replace("first ", "")


def _limits(ax: Axes, values: np.ndarray) -> None:
    values = values[np.isfinite(values) & (values > 0)]
    low, high = min(values.min(initial=1.0), 0.7), max(values.max(initial=1.0), 1.5)
    ax.set_ylim(low / 1.25, high * 1.25)
    plain_log(ax.yaxis)


def _dots(ax: Axes, rows: list[tuple[Sweep, int, Level]], sweeps: Sweeps) -> None:
    y = np.arange(len(rows), dtype=float)
    reached = [1.0]
    for k, (_, _, v) in enumerate(rows):
        low, high = _quantiles(v, sweeps)
        if np.isfinite(v.ratio):
            ax.hlines(y[k], low, high, color=_BLUE, lw=6, alpha=0.15)
            sure = [[max(v.ratio - v.ratio_low, 0.0)], [max(v.ratio_high - v.ratio, 0.0)]]
            ax.errorbar(v.ratio, y[k], xerr=sure, color=_BLUE, marker="o", ms=4.5, capsize=2.5, lw=1.2)
            reached += [low, high, v.ratio_low, v.ratio_high]
        if np.isfinite(v.prediction_ratio):
            ax.plot(v.prediction_ratio, y[k] + 0.18, "s", ms=3.5, color=_RED)
            reached.append(v.prediction_ratio)
    labels, before = [], ""
    for sweep, index, v in rows:
        text = v.label + (" (yours)" if index == sweep.own else "")
        labels.append(text if len(text) <= 62 else text[:60] + " …")
        if before and before != sweep.name:
            ax.axhline(len(labels) - 1.5, color="#94a3b8", lw=0.7)
        before = sweep.name
    ax.axvline(1.0, color=NOISE, lw=1.0, zorder=0)
    ax.set_xscale("log")
    values = np.array([r for r in reached if np.isfinite(r) and r > 0])
    ax.set_xlim(min(values.min() / 1.25, 0.7), max(values.max() * 1.25, 1.5))
    plain_log(ax.xaxis)
    list_rows(ax, labels)
    ax.set_title("Error over that of your own setting")


def _mapped(result: Accuracy) -> list[Susceptibility]:
    """Effects and places that bias most, a few of each kind."""
    biased = [s for s in result.susceptibility if s.largest >= results.NO_BIAS]
    return results.worst_places(biased, _MAPPED_PLACES)[:_SHOWN_EFFECTS]


@styled
def bias_map(result: Accuracy, ax: Any = None) -> Figure:
    """Bias of each base parameter by each effect left out that biases most, in standard deviations, as a map."""
    shown, parameters = _mapped(result), result.bench.problem.row_model.base.short_names
    effects = [s.effect.spec for s in shown]
    matrix = np.abs([s.sigmas for s in shown]).reshape(len(shown), len(parameters))
    left, right = 0.35 + 0.068 * max(map(len, effects), default=0), 1.0
    own = ax is None
    figure, ax, below = _over_parameters(parameters, 0.19 * max(len(effects), 1), left, right, ax)
    values = np.where(matrix >= _WHITE, matrix, np.nan)
    top = max(float(np.nanmax(matrix, initial=10.0)), 10.0)
    edges = np.arange(len(parameters) + 1) - 0.5, np.arange(len(effects) + 1) - 0.5
    mesh = ax.pcolormesh(*edges, values, cmap=_HEAT, norm=LogNorm(_WHITE, top))
    ax.set_yticks(np.arange(len(effects)), effects, fontsize=8)
    ax.set_ylim(len(effects) - 0.5, -0.5)
    ax.grid(visible=False)
    ax.set_title("Bias by an effect of usual size that the model lacks [standard deviations]")
    width, total = figure.get_size_inches()
    place = ((width - 0.75) / width, below / total, 0.14 / width, 1 - (_TOP + below) / total)
    bar = figure.colorbar(mesh, cax=figure.add_axes(place)) if own else figure.colorbar(mesh, ax=ax)
    plain_log(bar.ax.yaxis)
    return figure


@styled
def certificate_figure(certificate: CoverageCertificate, parameters: Sequence[str], ax: Any = None) -> Figure:
    """Coverage of each base parameter, by their names (r,), with its 95 % interval, beside the band of exact intervals."""
    figure, ax, _ = _over_parameters(parameters, 2.2, 0.7, 0.2, ax)
    x = np.arange(len(parameters))
    low, high = 100 * certificate.intervals
    share, band = 100 * certificate.coverage, 100 * np.array(certificate.band)
    ax.axhspan(*band, color=NOISE, alpha=0.14, lw=0)
    ax.axhline(100 * LEVEL, color=GREY, lw=0.8)
    known = np.isfinite(share)
    bad = known & (share < band[0] - 1e-9)
    for part, colour in ((known & ~bad, _BLUE), (bad, PREDICTED)):
        ax.vlines(x[part], low[part], high[part], color=colour, lw=1.5, alpha=0.5)
        ax.plot(x[part], share[part], "o", ms=4, color=colour)
    shown = np.concatenate([low[known], band])
    ax.set_ylim(max(float(shown.min(initial=90.0)) - 1.0, 0.0), 100.6)
    ax.grid(axis="x", visible=False)
    ax.set_title(f"Intervals that held the truth, of {certificate.twins} twins [%]")
    return figure


def _over_parameters(parameters: Sequence[str], height: float, left: float, right: float, ax: Any) -> tuple[Figure, Axes, float]:
    """A panel over base parameters, named below it unless they are too many; its margins and the one below in inches."""
    many = len(parameters) > _NAMED
    below = 0.45 if many else 0.3 + 0.072 * max(map(len, parameters), default=0)
    figure, axes = make_grid(1, 1, height, left=left, right=right, top=_TOP, bottom=below, ax=ax)
    ax = axes[0, 0]
    ax.set_xlim(-0.5, len(parameters) - 0.5)
    if many:
        ax.set_xlabel("base parameter, numbers as in the table")
        ax.xaxis.set_major_formatter(lambda value, _: f"{value + 1:g}")
    else:
        ax.set_xticks(np.arange(len(parameters)), list(parameters), rotation=90, fontsize=7.5)
    return figure, ax, below


def certificate_section(certificate: CoverageCertificate | None, base: BaseParameters) -> list[Part]:
    """Coverage of every base parameter, with a figure; the empty place for it without a certificate."""
    if certificate is None:
        return [Html(_BEGIN), Html(_END)]
    more = f" {certificate.refused} more twins could not be fitted." if certificate.refused else ""
    section = ShownSection("Coverage certificate", [
        results.coverage_text(certificate) + more,
        figure(svg(certificate_figure(certificate, base.short_names), "certificate"),
               "Dots: share of 95 % intervals that held the truth; strokes: its own 95 % interval. Green band: where exact "
               "intervals of all parameters lie together with a probability of 99 %."),
        fold("Every base parameter", _table(certificate, base)),
    ], "Certificate")  # fmt: skip
    return [Html(_BEGIN), section, Html(_END)]


def with_certificate(page: str, certificate: CoverageCertificate, base: BaseParameters) -> str:
    """A page that was written before, with the section in its place; the same where there is no place for it."""
    section = as_html(certificate_section(certificate, base))
    return re.sub(f"{_BEGIN}.*?{_END}", lambda _: section, page, count=1, flags=re.DOTALL)


def _table(certificate: CoverageCertificate, base: BaseParameters) -> ShownTable:
    low, high = certificate.intervals
    rows = [
        [
            str(k + 1), label, (percent(share), "bad" if share < certificate.band[0] - 1e-12 else ""),
            f"{percent(low[k])} … {percent(high[k])}", number(certificate.mean_z[k], 2), number(certificate.std_z[k], 3),
        ]
        for k, (label, share) in enumerate(zip(base.labels, certificate.coverage, strict=True))
    ]  # fmt: skip
    return ShownTable(
        ["#", "base parameter", "coverage", "95 % interval", "mean error [σ]", "scatter [σ]"], rows, "nd w nb n n n"
    )


@report_of.register
def accuracy_report(result: Accuracy) -> str:
    """The report of ``accuracy``: an HTML page with all figures inside."""
    bench, sweeps, base = result.bench, result.sweeps, result.bench.problem.row_model.base
    biased = [s for s in result.susceptibility if s.largest >= results.NO_BIAS]
    sections: list[Part] = []
    if result.improvements:
        best = "The best step of each factor that lowers the error beyond chance, what lowers it most first."
        sections.append(ShownSection("What would buy most", [best, results.improvements_table(result)]))
    if sweeps is not None:
        sections.append(ShownSection("One factor at a time", [
            "Everything else stays as it is. Error: root mean square of estimate less truth, bias included. Predictions: of "
            f"{', '.join(bench.predicted_motions)}, error over signal, noise of the readings not counted.",
            figure(svg(sweeps_figure(sweeps), "sweeps"),
                   "Median over the base parameters, relative to your own setting (green line); bars: 95 % intervals from "
                   f"{sweeps.runs} simulated recordings of each level, which all levels share. Circles around dots: by formula."),
            results.sweeps_table(sweeps),
            note("Lost: combinations of parameters that such readings do not determine; the median is over the others. Length: "
                 "recording the first part, or the whole motion several times with fresh noise. Faster sampling: noise taken "
                 "as independent from sample to sample."),
        ]))  # fmt: skip
    unbiased = f", {len(result.susceptibility) - len(biased)} of them without any bias"
    sections.append(ShownSection("Effects left out of the model", [
        "What the estimate would be off by if the robot or sensor had an effect that the model lacks, at a usual size, "
        "everything else being right (bias susceptibility). A payload or another body that belongs to a link is no error of "
        "the link that carries it: there the change says what the estimate then holds.",
        figure(svg(bias_map(result), "susceptibility") if biased else "",
               f"The {len(_mapped(result))} places that bias most, at most four of a kind, by base parameter; white: less than a "
               "tenth of a standard deviation."),
        "Each kind of effect at its worst place:",
        results.effects_table(results.worst_places(result.susceptibility, 1), base.labels),
        fold(f"All {len(result.susceptibility)} places{unbiased * (len(biased) < len(result.susceptibility))}",
             results.effects_table(result.susceptibility, base.labels)),
    ], "Effects left out"))  # fmt: skip
    sections += certificate_section(result.certificate, base)
    if result.sensors is not None:
        sections.append(_sensors(result.sensors))
    parameters = [_parameters(result), note("± : standard errors of the simulation." if sweeps is not None else "")]
    sections += [
        ShownSection("Every base parameter", parameters, "Parameters"),
        how(*_how(result), seconds=result.seconds, after="SI units, force before moment.", title="How this was done"),
    ]
    readings = channel_text(bench.problem.channel, bench.problem.fitted)
    kicker = f"Accuracy of {bench.rank} base parameters by {bench.method.name}, from the {readings}"
    fine = [
        *["formula and simulation agree"] * (sweeps is not None and sweeps.formula is not None),
        *["the model is complete as far as its residuals tell"] * (bench.estimate.details.model_complete is True),
    ]
    name, unwarned = bench.experiment.name, f"No warnings{': ' * bool(fine)}{', and '.join(fine)}."
    opening = [warnings(result.warnings, unwarned), lead(_lead(result)), cards(_cards(result))]
    return page(name, kicker, opening, sections, f"{name}: accuracy")


def _lead(result: Accuracy) -> str:
    text = ""
    best = result.improvements
    if best:
        first = best[0][1]
        text = f"What would help most: {first.improvement} ({results.change(first.ratio)} of the median error of the base "
        text += "parameters)."
        if len(best) > 1:
            text += " Then " + ", ".join(f"{v.improvement} ({results.change(v.ratio)})" for _, v in best[1:3]) + "."
    elif result.sweeps is not None:
        text = "None of the changes that were tried lowers the error by more than chance."
    worst = next((s for s in result.susceptibility if s.largest >= results.NO_BIAS), None)
    if worst is not None:
        text += (
            f" Of the effects that the model lacks, {worst.effect.spec} of usual size would do most harm: a bias of "
            f"{number(worst.largest, 2)} standard deviations."
        )
    return f"{text} {results.coverage_text(result.certificate)}".strip()


def _cards(result: Accuracy) -> list[tuple[str, str, str]]:
    large = []
    if result.sweeps is not None:
        own, predicted = result.sweeps.own, ", ".join(result.bench.predicted_motions)
        large.append((percent(own.prediction, 2), f"of the signal of {predicted}: by so much predictions are wrong", ""))
        biases = np.abs(own.bias) / np.maximum(result.std, 1e-300)
        if np.isfinite(biases).any():
            largest = float(np.nanmax(biases))
            # Of so many means of so many twins without any bias the largest is below this with 95 %.
            chance = NormalDist().inv_cdf(1.0 - 0.5 * (1.0 - LEVEL) / len(own.bias)) / np.sqrt(result.sweeps.runs)
            mood = "good" if largest < max(0.5, chance) else "fair"
            text = (
                f"largest bias by smoothing and encoders alone; {number(chance, 2)} can be chance in {result.sweeps.runs} twins"
            )
            large.append((f"{number(largest, 2)} σ", text, mood))
    large += [(results.change(v.ratio), f"of the median error by {v.improvement}", "") for _, v in result.improvements[:2]]
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
        if worst is not None and np.isfinite(worst.sigmas[k]) and abs(worst.sigmas[k]) >= results.NO_BIAS:
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
        results.sensors_table(choice), note(f"{results.sensor_title(choice)}."),
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
    encoder = f"counts of {number(bench.resolution, 2)} rad (or m)" if bench.resolution else "no counts known"
    if bench.position_std.any():
        encoder += f"; random errors of {number(float(bench.position_std.max()), 2)} rad (or m) at most"
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
    return rows


@figures_of.register
def _(result: Accuracy) -> Figures:
    figures: dict[str, Any] = {"susceptibility": partial(bias_map, result)}
    if result.sweeps is not None:
        figures["sweeps"] = partial(sweeps_figure, result.sweeps)
    if result.certificate is not None:
        figures["certificate"] = partial(certificate_figure, result.certificate, result.bench.problem.row_model.base.short_names)
    return figures
