"""The report of ``compare``."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.drawing import Figures, figures_of
from bayesid.report.charts import CYCLE
from bayesid.report.figures import GREY, NOISE, add_legend, draw_intervals, given_axes, list_rows, make_grid, plain_log, styled
from bayesid.report.identification import how_motions
from bayesid.report.page import below, cards, figure, fold, how, lead, mood_of, note, page, svg, terms, warnings
from bayesid.results.comparison import Comparison, Entry, in_sigmas, overview_table, values_table
from bayesid.results.files import report_of
from bayesid.results.loaded import LoadedComparison
from bayesid.rounding import DASH, chance, channel_text, number, percent
from bayesid.section import Cell, Html, Part, ShownSection, ShownTable
from bayesid.validation.agreement import HausmanTest
from bayesid.validation.prediction import BAND, judged

#: From so many parameters they stand in two columns.
_TWO_COLUMNS = 14
#: Names of at most so many channels stand in one line.
_ONE_LINE = 9


_SHOWN_MOTIONS = 4
#: Two residuals closer than this do not tell two estimators apart.
_TIE = 0.02
_DESCRIPTIONS = {
    "ols": "ordinary least squares: every reading counts the same, whatever its unit and noise",
    "wls": "least squares with every channel weighted by its noise; the default",
    "gls": "generalised least squares: weighted by the noise's colour, too; the most exact where the model is complete",
    "ridge": "least squares drawn towards the nominal model; biased, so without an interval",
    "tsvd": "least squares in the directions that these motions show well; the others stay nominal",
    "tls": "total least squares: encoder noise in the regressor counts",
    "iv": "instrumental variables: free of the bias that encoder noise brings",
    "huber": "robust: samples far off the model, such as taps and contact, count less",
    "student": "robust: noise with heavy tails, samples far off count little",
    "sdp": "only links that can exist, drawn towards the nominal model where the data say little",
}


@report_of.register
def comparison_report(result: Comparison) -> str:
    """The report of ``compare``: an HTML page with all figures inside."""
    problem, reference = result.problem, result.reference
    done = [e for e in result.entries if e.estimate is not None]
    predicted, validated = bool(done[0].predictions), bool(done[0].validation)
    told = any(p.noise_known for p in done[0].predictions)
    sections = [_side_by_side(result)]
    if predicted:
        sections.append(ShownSection("How well each one predicts", [
            "Motions for validation took no part in the fit, so a smaller error here is a better estimate. But motions are "
            "few: a difference of a few per cent does not show that one estimator is better, and an estimator that is picked "
            "by this figure has been fitted to the validation motion a little." if validated else
            "**There is no validation motion**: these are the fitted motions, on which the estimator that fits most closely "
            "looks best, right or wrong.",
            figure(svg(errors_figure(result), "predictions"),
                   f"Dot: all channels together; strokes: the channels. {'Left: error' if told else 'Error'} below "
                   f"{number(BAND, 2)} Hz in per cent of the reading"
                   f"{', right: what is left in units of the noise, where the green line is perfect' if told else ''}. On grey: "
                   "the nominal model, which the estimates should beat."),
        ], "Prediction"))  # fmt: skip
    below_line = " Below the line: effects beyond rigid bodies, estimated along." if result.regression.effect_names else ""
    sections += [
        ShownSection("Values", [
            figure(svg(values_figure(result, reference), "values") if reference else "",
                   f"Each base parameter by each estimator (dots) with its central 95 % interval (bars), relative to {reference} "
                   f"and in units of its standard deviation. Green: the 95 % interval of {reference}. Triangles lie outside "
                   "the picture. Numbers as in the table."),
            values_table(result, whole=True),
            note("In a label, m2 is the mass of body 2, m2 r2x its first moment along x and I2xy an inertia about the origin "
                 "of its joint's frame. ±: half of the 95 % interval; where it is missing, none is honest." + below_line),
        ]),
        _agreement(result),
    ]  # fmt: skip
    if predicted:
        role = "validation: not fitted" if validated else "fitted"
        sections.append(ShownSection("Errors by channel", [
            f"Root mean square of measured less predicted below {number(BAND, 2)} Hz in the unit of the channel and relative "
            "to the reading, and what is left in units of the noise (× noise).",
            *(_motion_errors(result, k, role) for k in range(len(done[0].predictions))),
        ]))  # fmt: skip
    after = "SI units, force before moment. Intervals are central and hold 95 %."
    sections.append(how(*_how(result), seconds=result.seconds, after=after, title="How this was done"))
    name = "Comparison of estimators" if problem is None else problem.experiment.name
    source = "a regression of one's own" if problem is None else f"the {channel_text(problem.channel, problem.fitted)}"
    better = "every estimator predicts better than the nominal model, and " if predicted and result.baselines else ""
    opening = [
        warnings(result.warnings, f"No warnings: {better}no test finds estimators in contradiction."), lead(_lead(result)),
        cards(_cards(result)),
    ]  # fmt: skip
    kicker = f"{len(result.entries)} estimators side by side, all fitted to {source}"
    return page(name, kicker, opening, sections, f"{name}: estimators side by side")


def _side_by_side(result: Comparison) -> ShownSection:
    """All estimators in a table, with what its columns say and what each estimator is."""
    reference, efficient = result.reference, result.tests[0].efficient if result.tests else ""
    done = [e for e in result.entries if e.estimate is not None]
    validated = "motions that took no part in the fit" if done[0].validation else "the fitted motions, as there are no others"
    nearest = (
        "; base parameters alone do not fix them, so the nearest to the nominal ones are judged unless the estimator has links "
    )
    nearest = f"{nearest}of its own" if result.problem is not None else ""
    credible = "; * credible, so it counts what was known before"
    credible = credible if any(e.interval == "credible" for e in result.estimates.values()) else ""
    columns = [
        f"**Error**: of all channels together, in per cent of the signal below {number(BAND, 2)} Hz, on {validated}. **× "
        "noise**: what is left in units of the noise, the same noise for all; 1 is perfect." if done[0].predictions else "",
        f"**Links**: whether bodies with such masses and inertias can exist{nearest}." if result.links_known else "",
        f"**Interval**: median width over the base parameters, relative to {reference}{credible}. **From {reference}**: "
        f"difference of the base parameters in standard deviations of {reference}: rms and largest." if reference else "",
        f"**Hausman**: probability of so large a difference from {efficient} if the model is complete." if efficient else "",
        *(f"{line}." for line in result.untested),
        "**Time**: of the fit alone; rows and noise are prepared once for all.",
    ]  # fmt: skip
    entries = [*result.baselines, *result.entries]
    without = ", ".join(f"**{n}** ({e.interval_reason})" for n, e in result.estimates.items() if e.interval == "none")
    impossible = ", ".join(f"**{e.name}** ({', '.join(e.impossible)})" for e in result.entries if e.impossible)
    return ShownSection("Side by side", [
        overview_table(result),
        *(f"**{e.name}** refused: {e.refusal}" for e in result.entries if e.estimate is None),
        note(" ".join(filter(None, columns))),
        terms([(e.name, _DESCRIPTIONS.get(e.name) or e.description or "an estimator of one's own") for e in entries]),
        f"Without intervals: {without}." if without else "",
        f"Links that cannot exist: {impossible}. Do not simulate with them." if impossible else "",
    ])  # fmt: skip


def _noise_known(entry: Entry) -> bool:
    """Whether something tells the noise of every motion that an entry is judged by."""
    return all(p.noise_known for p in entry.predictions)


def _score(entry: Entry) -> float:
    """What an entry is judged by: residual over all motions in units of the noise, or the error where that is not known."""
    if not _noise_known(entry):
        return _error(entry)
    return float(np.sqrt(np.mean([p.whitened_rms**2 for p in entry.predictions])))


def _error(entry: Entry) -> float:
    """Relative error over all motions that it is judged by: root mean square."""
    return float(np.sqrt(np.mean([p.relative_error**2 for p in entry.predictions])))


def _lead(result: Comparison) -> str:
    done = [e for e in result.entries if e.estimate is not None]
    refused = len(result.entries) - len(done)
    sorry = f" {refused} of {len(result.entries)} could not work with these data." if refused else ""
    if not done[0].predictions:
        return (
            "The same rows, fitted by several estimators. A regression of one's own has no motion to validate on, so what can "
            f"be compared is values, intervals and how far they agree.{sorry}"
        )
    scores = {e.name: _score(e) for e in done}
    best = min(scores, key=lambda n: scores[n])
    ties = [n for n in scores if n != best and scores[n] <= (1 + _TIE) * scores[best]]
    where = "motions that were not fitted" if done[0].validation else "the fitted motions (there is no other)"
    known = _noise_known(done[0])

    def left(entry: Entry) -> str:
        return number(_score(entry), 3) if known else percent(_score(entry))

    least = next(e for e in done if e.name == best)
    text = f"On {where}, {best} leaves least: {left(least)} {'times the noise' if known else 'of the signal'}"
    nominal = result.baselines[-1] if result.baselines else None
    if nominal is not None:
        text += f", where {_baseline(nominal.name)} leaves {left(nominal)}"
    text += "."
    errors = {e.name: _error(e) for e in done}
    closest = min(errors, key=lambda n: errors[n])
    if errors[best] > (1 + _TIE) * errors[closest] or (nominal is not None and _error(nominal) < errors[closest]):
        text += f" In per cent of the signal, where strong channels count most, {closest} is closest ({percent(errors[closest])}"
        text += ")." if nominal is None else f", {_baseline(nominal.name)} {percent(_error(nominal))})."
    if len(ties) == len(done) - 1 and ties:
        text += " All others are within 2 % of it: prediction does not tell these estimators apart here."
    elif ties:
        text += f" {', '.join(ties)} {'is' if len(ties) == 1 else 'are'} within 2 % of it, too close to tell apart."
    return text + sorry


def _cards(result: Comparison) -> list[tuple[str, str, str]]:
    done = [e for e in result.entries if e.estimate is not None]
    large = []

    def times(entry: Entry, text: str) -> None:
        if _noise_known(entry):
            large.append((f"{number(_score(entry), 3)} ×", text, mood_of(_score(entry))))
        else:
            moods = [judged(p).mood for p in entry.predictions]
            large.append((percent(_score(entry)), text, "bad" if "bad" in moods else "fair"))

    if done[0].predictions:
        best, worst = min(done, key=_score), max(done, key=_score)
        unit = "noise" if _noise_known(best) else "of the signal"
        times(best, f"{unit} is left by the best prediction ({best.name}){'; 1 is perfect' * _noise_known(best)}")
        if worst is not best:
            times(worst, f"by the worst ({worst.name})")
    for e in result.baselines:
        times(e, f"by {_baseline(e.name)}")
    if result.gaps:
        far = max(result.gaps, key=lambda g: g.rms)
        pair = f"{far.first} and {far.second}, the farthest pair"
        large.append((f"{in_sigmas(far.rms)} σ", f"rms between {pair}, in standard deviations of {result.reference}", ""))
    known = [e for e in done if e.impossible is not None]
    if known:
        fine = sum(not e.impossible and not e.conflicting for e in known)
        text = "estimators allow links that can all exist"
        large.append((f"{fine} of {len(known)}", text, "good" if fine == len(known) else ""))
    return large


def _baseline(name: str) -> str:
    return "the nominal model" if name == "nominal" else "the nominal model with fitted effects"


@styled
def errors_figure(result: Comparison | LoadedComparison, ax: Any = None) -> Figure:
    """What each estimator's prediction misses, motion by motion: in per cent of the signal and in units of the noise.

    In per cent alone into one axis a motion of the user's own, and where nothing tells the noise. Estimators are from top to
    bottom, those not fitted on grey.
    """
    entries = [e for e in (*result.baselines, *result.entries) if not e.refusal]
    names, baselines = [e.name for e in entries], len(result.baselines)
    motions = [[e.predictions[k] for e in entries] for k in range(min(len(entries[0].predictions), _SHOWN_MOTIONS))]
    lines = 1 if len(motions[0][0].channel_names) <= _ONE_LINE else 2
    told = any(p.noise_known for ps in motions for p in ps)
    columns = 1 if (len(given_axes(ax)) == len(motions) if ax is not None else not told) else 2
    figure, axes = make_grid(len(motions), columns, 0.24 * len(names) + 0.1, left=0.35 + 0.066 * max(map(len, names)),
                             top=0.5 * lines, gap=0.35, sharey=True, sharex="col", ax=ax)  # fmt: skip
    y = np.arange(len(names))
    for row, ps in zip(axes, motions, strict=True):
        known = np.array([1.0 if p.noise_known else np.nan for p in ps])
        percents = 100 * np.array([p.nrmse for p in ps]), 100 * np.array([p.relative_error for p in ps])
        times = known[:, None] * [p.whitened_rms_by_channel for p in ps], np.array([p.times_noise for p in ps])
        titles = f"{ps[0].motion}: error below {BAND:g} Hz [% of the signal]", "what is left, in units of the noise"
        for ax, title, (each, whole) in zip(row, titles, (percents, times), strict=False):
            for c, channel in enumerate(ps[0].channel_names):
                ax.plot(each[:, c], y, "|", ms=8, mew=1.4, color=CYCLE[c % len(CYCLE)], label=channel)
            ax.plot(whole, y, "o", ms=6, color="#0f172a", mew=0, label="all channels")
            if baselines:
                ax.axhspan(-0.5, baselines - 0.5, color="#f1f5f9", lw=0, zorder=0)
            ax.set_ylim(len(y) - 0.4, -0.6)
            ax.set_yticks(y, names)
            ax.tick_params(axis="y", length=0, labelleft=ax is row[0])
            ax.set_title(title)
        for ax in row[1:]:
            ax.axvline(1.0, color=NOISE, lw=1.4, zorder=0)
            if not np.isfinite(known).any():
                ax.text(0.5, 0.5, "the noise is not known", ha="center", va="center", transform=ax.transAxes)
    for column, floor in zip(axes.T, (None, 0.8), strict=False):
        values = np.concatenate([line.get_xdata() for ax in column for line in ax.lines if line.get_marker() in ("|", "o")])
        values = np.asarray(values, float)[np.asarray(values, float) > 0]
        low, high = (values.min(), values.max()) if len(values) else (1.0, 1.0)
        for ax in column:
            ax.set_xscale("log")
            ax.set_xlim(min(low / 1.15, floor or np.inf), max(high * 1.15, low * 2.0))
            plain_log(ax.xaxis)
    add_legend(axes, lines=lines)
    return figure


@styled
def values_figure(result: Comparison | LoadedComparison, name: str, ax: Any = None) -> Figure:
    """Each base parameter by each estimator with its interval, around those of the reference of a name, in its sigmas."""
    reference, estimates = result[name], result.estimates
    shown = np.flatnonzero(reference.std > 0)
    names = [f"{short}  ({k + 1})" for k, short in enumerate(reference.base.short_names) if k in shown]
    count, many = len(names), len(estimates)
    difference, ends = np.empty((many, count)), np.empty((2, many, count))
    for e, estimate in enumerate(estimates.values()):
        known = np.array([estimate.values, estimate.low, estimate.high]) - reference.values
        difference[e], ends[0, e], ends[1, e] = known[:, shown] / reference.std[shown]
        difference[e, estimate.undetermined[: estimate.base.rank][shown]] = np.nan
    columns = 2 if count > _TWO_COLUMNS and ax is None else 1
    per_column = -(-count // columns)
    slot = min(0.8 / many, 0.2)
    margin = 0.35 + 0.062 * max(map(len, names), default=0)
    height = per_column * max(0.085 * many + 0.08, 0.26)
    figure, axes = make_grid(1, columns, height, left=margin, gap=margin, sharex=True, ax=ax)
    reach = np.abs(np.concatenate([difference[None], ends]))
    reach = reach[np.isfinite(reach)]
    usual, longest = np.percentile(reach, [90, 100]) if len(reach) else (3.0, 3.0)
    # Everything, unless a few lie so far out that the others would be dots.
    limit = float(max(1.05 * (longest if longest <= 4.0 * usual else 1.5 * usual), 3.0))
    for column, ax in enumerate(axes[0]):
        part = slice(column * per_column, min((column + 1) * per_column, count))
        y = np.arange(part.stop - part.start)
        ax.axvspan(-1.96, 1.96, color=NOISE, alpha=0.12, lw=0)
        ax.axvline(0.0, color=GREY, lw=0.8)
        for e, label in enumerate(estimates):
            colour, at = CYCLE[e % len(CYCLE)], y + (e - 0.5 * (many - 1)) * slot
            draw_intervals(ax, at, difference[e, part], ends[:, e, part], limit, colour, label, size=3.6)
        ax.hlines(y[1:] - 0.5, -limit, limit, color="#e2e8f0", lw=0.7)
        list_rows(ax, names[part], 0.55)
        ax.set(xlim=(-limit, limit), xlabel=f"value less that of {name} [standard deviations of {name}]")
    add_legend(axes)
    return figure


def _agreement(result: Comparison) -> ShownSection:
    """How far every two estimators are apart, and whether that is more than noise."""
    parts: list[Part] = ["No estimator has intervals, so there is no unit to count differences in."]
    if result.gaps and result.reference:
        names = list(result.estimates)
        found = {frozenset((g.first, g.second)): g.rms for g in result.gaps}
        matrix = [[a, *(DASH if a == b else in_sigmas(found.get(frozenset((a, b)))) for b in names)] for a in names]
        farthest = [
            [f"{g.first} and {g.second}", str(g.compared), in_sigmas(g.rms), in_sigmas(g.largest), g.where]
            for g in sorted(result.gaps, key=lambda g: -g.rms)
        ]
        head = ["pair", "numbers", "rms [σ]", "largest [σ]", "base parameter"]
        parts = [
            "Root mean square difference of the base parameters of every two estimators, in standard deviations of "
            f"{result.reference}. All had the same rows, noise and all, so they should be closer to each other than their "
            "intervals are wide: this is a measure of how much the choice of the estimator matters, not a test. Beyond about "
            "2, the choice matters more than the noise does.",
            ShownTable(["", *names], matrix, "kb" + " n" * len(names), "narrow"),
            fold("Where each pair differs most", ShownTable(head, farthest, "k n n n w")),
        ]
    if result.tests:
        efficient = result.tests[0].efficient
        head = [f"against {efficient}", "statistic", "directions", "probability", ""]
        parts.append(below(
            "Is a difference more than noise?",
            f"Where the model is complete and the noise as modelled, {efficient} is the most exact estimator, and the "
            f"difference of another one from it has the covariance V − V({efficient}) (Hausman's test). A probability below "
            "0.01 % means that the two cannot both be right: something is missing in the model.",
            ShownTable(head, [_test(t) for t in result.tests], "kb n n n w", "narrow"),
        ))  # fmt: skip
    return ShownSection("Do the estimators agree?", parts, "Agreement")


def _test(test: HausmanTest) -> list[Cell]:
    if test.probability is None:
        return [test.method, DASH, DASH, DASH, test.reason]
    said = ("more", "bad") if test.contradiction else ("no more", "good")
    verdict = f"differs by {said[0]} than the noise explains", said[1]
    return [test.method, number(test.statistic, 3), str(test.degrees), chance(test.probability), verdict]


def _motion_errors(result: Comparison, index: int, role: str) -> Html:
    """Errors of one motion, channel by channel and estimator by estimator."""
    entries = [e for e in (*result.baselines, *result.entries) if e.estimate is not None]
    ps = [e.predictions[index] for e in entries]
    rows: list[list[Cell]] = []
    for c, (name, unit) in enumerate(zip(ps[0].channel_names, ps[0].channel_units, strict=True)):
        row: list[Cell] = [f"{name} [{unit}]"]
        for p in ps:
            white = number(float(p.whitened_rms_by_channel[c]) if p.noise_known else None, 3)
            row += [number(p.rmse[c], 3), percent(p.nrmse[c]), white]
        rows.append(row)
    every = [
        cell
        for p in ps
        for cell in ("", (percent(p.relative_error), "sure"), (number(p.times_noise, 3), f"sure {judged(p).mood}"))
    ]
    head = ["channel", *(title for e in entries for title in (f"{e.name}: rms", "relative", "× noise"))]
    table = ShownTable(head, [*rows, ["all", *every]], f"ku{' n n n' * len(ps)}", "tight", {len(rows): "rule"})
    repeats = f"This motion repeats the fitted ‘{ps[0].repeats}’." if ps[0].repeats else ""
    return fold(f"{ps[0].motion} ({role})", note(repeats), table, opened=index == 0)


def _how(result: Comparison) -> list[tuple[str, str]]:
    problem, regression = result.problem, result.regression
    return [
        *([] if problem is None else how_motions(problem)),
        ("Rows", f"{regression.rows.count} of {len(regression.channel_names)} channels, the same for all estimators"),
        ("Noise", "learned once; what is left is counted in it for all, so that no estimator is judged by a noise of its own"),
    ]


@figures_of.register
def _(result: Comparison | LoadedComparison) -> Figures:
    errors = (
        {"errors": partial(errors_figure, result)} if any(e.predictions for e in (*result.baselines, *result.entries)) else {}
    )
    return errors if result.reference is None else {**errors, "values": partial(values_figure, result, result.reference)}
