"""The report of ``compare``: turns a `Comparison` into what its template shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.report.charts import CYCLE
from bayesid.report.figures import GREY, NOISE, add_legend, given_axes, make_grid, plain_log, styled
from bayesid.report.identification import STATIC, mood_of
from bayesid.report.page import render, run_times, svg, versions
from bayesid.results.comparison import TEXT_MOTIONS, Comparison, in_sigmas, overview, values_table
from bayesid.results.entry import Entry
from bayesid.results.loaded import LoadedComparison
from bayesid.results.text import DASH, chance, channel_text, number, percent
from bayesid.validation.agreement import HausmanTest
from bayesid.validation.headline import judged
from bayesid.validation.prediction import BAND, Prediction

#: From so many parameters they stand in two columns.
_TWO_COLUMNS = 14
#: Names of at most so many channels stand in one line.
_ONE_LINE = 9


@styled
def values_side_by_side(
    names: Sequence[str], estimators: Sequence[str], difference: np.ndarray, ends: np.ndarray, reference: str, ax: Any = None
) -> Figure:
    """Each base parameter by each estimator, with intervals, around the reference.

    Parameters
    ----------
    names
        Of the parameters (r,).
    estimators
        Their names (e,).
    difference, ends
        Value less the reference's value (e, r), and the same of both ends of the 95 % interval (2, e, r), in standard deviations
        of the reference; nan where there is none.
    reference
        Its name.
    """
    count, many = len(names), len(estimators)
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
        for e, name in enumerate(estimators):
            colour, at = CYCLE[e % len(CYCLE)], y + (e - 0.5 * (many - 1)) * slot
            d, (low, high) = difference[e, part], ends[:, e, part]
            sure = np.isfinite(high - low) & np.isfinite(d)
            ax.hlines(at[sure], low[sure], high[sure], color=colour, lw=1.6, alpha=0.5)
            inside = np.abs(d) <= limit
            ax.plot(d[inside], at[inside], "o", ms=3.6, mew=0, color=colour, label=name)
            for k in np.flatnonzero(np.abs(d) > limit):
                side = np.sign(d[k])
                ax.plot(0.985 * side * limit, at[k], ">" if side > 0 else "<", ms=4.5, mew=0, color=colour)
        ax.hlines(y[1:] - 0.5, -limit, limit, color="#e2e8f0", lw=0.7)
        ax.set_yticks(y, list(names[part]))
        ax.set(xlim=(-limit, limit), ylim=(len(y) - 0.45, -0.55))
        ax.set_xlabel(f"value less that of {reference} [standard deviations of {reference}]")
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
    add_legend(axes, *axes[0, 0].get_legend_handles_labels())
    return figure


@styled
def errors_side_by_side(
    estimators: Sequence[str],
    baselines: int,
    motions: Sequence[tuple[str, Sequence[str], *tuple[np.ndarray, ...]]],
    ax: Any = None,
) -> Figure:
    """What each estimator's prediction misses, motion by motion: in per cent of the signal and in units of the noise.

    Into one axis a motion of the user's own, in per cent alone.

    Parameters
    ----------
    estimators
        Names from top to bottom (e,).
    baselines
        How many of them, at the top, were not fitted.
    motions
        Title, channels (c,), error of each channel over its signal (e, c), of all channels (e,), residual of each
        channel in units of the noise (e, c), of all (e,).
    """
    y = np.arange(len(estimators))
    margin = 0.35 + 0.066 * max(map(len, estimators))
    lines = 1 if len(motions[0][1]) <= _ONE_LINE else 2
    columns = 1 if ax is not None and len(given_axes(ax)) == len(motions) else 2
    figure, axes = make_grid(len(motions), columns, 0.24 * len(estimators) + 0.1, left=margin, top=0.5 * lines, gap=0.35,
                             sharey=True, sharex="col", ax=ax)  # fmt: skip
    for row, (title, channels, *parts) in zip(axes, motions, strict=True):
        titles = f"{title}: error below {BAND:g} Hz [% of the signal]", "what is left, in units of the noise"
        for ax, title, each, whole in zip(row, titles, parts[::2], parts[1::2], strict=False):
            for c, channel in enumerate(channels):
                ax.plot(each[:, c], y, "|", ms=8, mew=1.4, color=CYCLE[c % len(CYCLE)], label=channel)
            ax.plot(whole, y, "o", ms=6, color="#0f172a", mew=0, label="all channels")
            if baselines:
                ax.axhspan(-0.5, baselines - 0.5, color="#f1f5f9", lw=0, zorder=0)
            ax.set_ylim(len(y) - 0.4, -0.6)
            ax.set_yticks(y, list(estimators))
            ax.tick_params(axis="y", length=0, labelleft=ax is row[0])
            ax.set_title(title)
        for ax in row[1:]:
            ax.axvline(1.0, color=NOISE, lw=1.4, zorder=0)
    for column, floor in zip(axes.T, (None, 0.8), strict=False):
        values = np.concatenate([line.get_xdata() for ax in column for line in ax.lines if line.get_marker() in ("|", "o")])
        values = np.asarray(values, float)[np.asarray(values, float) > 0]
        low, high = (values.min(), values.max()) if len(values) else (1.0, 1.0)
        for ax in column:
            ax.set_xscale("log")
            ax.set_xlim(min(low / 1.15, floor or np.inf), max(high * 1.15, low * 2.0))
            plain_log(ax.xaxis)
    add_legend(axes, *axes[0, 0].get_legend_handles_labels(), lines=lines)
    return figure


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


def comparison_report(result: Comparison) -> str:
    """The report of ``compare``: an HTML page with all figures inside."""
    problem = result.problem
    done = [e for e in result.entries if e.estimate is not None]
    motions = [_motion_errors(result, k) for k in range(len(done[0].predictions))]
    return render(
        "comparison.html",
        name="Comparison of estimators" if problem is None else problem.experiment.name,
        source="a regression of one's own" if problem is None else
        f"the {channel_text(problem.channel)} of {', '.join(problem.fitted)}",
        count=len(result.entries),
        warning_list=result.warnings,
        lead=_lead(result),
        card_list=_cards(result),
        reference=result.reference,
        efficient=result.tests[0].efficient if result.tests else "",
        shown=[p.motion for p in done[0].predictions[:TEXT_MOTIONS]],
        validated=bool(done[0].validation),
        robot=problem is not None,
        links_known=any(e.impossible is not None for e in result.entries),
        band=number(BAND, 2),
        overview=[_row(result, e) for e in (*result.baselines, *result.entries)],
        refused=[{"name": e.name, "reason": e.refusal} for e in result.entries if e.estimate is None],
        descriptions=[(e.name, _describe(e)) for e in (*result.baselines, *result.entries)],
        predictions=svg(errors_figure(result), "predictions") if motions else "",
        values_figure=svg(values_figure(result, result.reference), "values") if result.reference else "",
        columns=[e.name for e in done],
        nominal=result.regression.nominal is not None,
        values=values_table(result),
        effects=values_table(result, effects=True),
        gaps=_matrix(result),
        farthest=[
            {"pair": f"{g.first} and {g.second}", "compared": g.compared, "rms": in_sigmas(g.rms),
             "largest": in_sigmas(g.largest), "where": g.where}
            for g in sorted(result.gaps, key=lambda g: -g.rms)
        ],
        tests=[_test(t) for t in result.tests],
        errors=motions,
        impossible=[(e.name, ", ".join(e.impossible)) for e in result.entries if e.impossible],
        credible=[n for n, e in result.estimates.items() if e.interval == "credible"],
        intervals=[(n, e.interval_reason) for n, e in result.estimates.items() if e.interval == "none"],
        how=_how(result),
    )  # fmt: skip


def _row(result: Comparison, entry: Entry) -> dict[str, Any]:
    """One line of the overview."""
    test = next((t for t in result.tests if t.method == entry.name), None)
    return {
        **overview(result, entry),
        "refused": entry.refusal,
        "baseline": any(entry is b for b in result.baselines),
        "motions": [
            {"error": percent(p.relative_error), "white": number(p.times_noise, 3), "mood": judged(p).mood}
            for p in entry.predictions[:TEXT_MOTIONS]
        ],
        "links_mood": "" if entry.impossible is None else "bad" if entry.impossible or entry.conflicting else "good",
        "test_mood": "bad" if test is not None and test.contradiction else "",
    }


def _describe(entry: Entry) -> str:
    return _DESCRIPTIONS.get(entry.name) or entry.description or "an estimator of one's own"


def _score(entry: Entry) -> float:
    """Residual over all motions that it is judged by in units of the noise: root mean square."""
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
            "The same rows, fitted by several estimators. A regression of one's own has no motion to validate on, so what can be "
            f"compared is values, intervals and how far they agree.{sorry}"
        )
    scores = {e.name: _score(e) for e in done}
    best = min(scores, key=lambda n: scores[n])
    ties = [n for n in scores if n != best and scores[n] <= (1 + _TIE) * scores[best]]
    where = "motions that were not fitted" if done[0].validation else "the fitted motions (there is no other)"
    known = all(p.noise_known for p in done[0].predictions)

    def left(entry: Entry) -> str:
        return number(_score(entry), 3) if known else percent(_error(entry))

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


def _cards(result: Comparison) -> list[dict[str, str]]:
    done = [e for e in result.entries if e.estimate is not None]
    cards = []
    if done[0].predictions:
        best = min(done, key=_score)
        cards.append({"value": f"{number(_score(best), 3)} ×", "mood": mood_of(_score(best)),
                      "text": f"noise is left by the best prediction ({best.name}); 1 is perfect"})  # fmt: skip
        worst = max(done, key=_score)
        if worst is not best:
            cards.append({"value": f"{number(_score(worst), 3)} ×", "mood": mood_of(_score(worst)),
                          "text": f"by the worst ({worst.name})"})  # fmt: skip
    for e in result.baselines:
        cards.append({"value": f"{number(_score(e), 3)} ×", "mood": mood_of(_score(e)), "text": f"by {_baseline(e.name)}"})
    if result.gaps:
        far = max(result.gaps, key=lambda g: g.rms)
        pair = f"{far.first} and {far.second}, the farthest pair"
        cards.append({"value": f"{in_sigmas(far.rms)} σ", "mood": "",
                      "text": f"rms between {pair}, in standard deviations of {result.reference}"})  # fmt: skip
    known = [e for e in done if e.impossible is not None]
    if known:
        fine = sum(not e.impossible and not e.conflicting for e in known)
        cards.append({"value": f"{fine} of {len(known)}", "mood": "good" if fine == len(known) else "",
                      "text": "estimators allow links that can all exist"})  # fmt: skip
    return cards


def _baseline(name: str) -> str:
    return "the nominal model" if name == "nominal" else "the nominal model with fitted effects"


def errors_figure(result: Comparison | LoadedComparison, ax: Any = None) -> Figure:
    """What each estimator's predictions miss, motion by motion."""
    entries = [e for e in (*result.baselines, *result.entries) if not e.refusal]
    motions = []
    for k in range(min(len(entries[0].predictions), _SHOWN_MOTIONS)):
        ps = [e.predictions[k] for e in entries]
        motions.append(
            (ps[0].motion, ps[0].channel_names,
             100 * np.array([p.nrmse for p in ps]), 100 * np.array([p.relative_error for p in ps]),
             np.array([p.whitened_rms_by_channel for p in ps]), np.array([p.whitened_rms for p in ps]))
        )  # fmt: skip
    return errors_side_by_side([e.name for e in entries], len(result.baselines), motions, ax)


def values_figure(result: Comparison | LoadedComparison, name: str, ax: Any = None) -> Figure:
    """Base parameters by each estimator around those of the reference of a name."""
    reference = result[name]
    shown = np.flatnonzero(reference.std > 0)
    names = [f"{short}  ({k + 1})" for k, short in enumerate(reference.base.short_names) if k in shown]
    estimates = result.estimates.values()
    std = reference.std[shown]
    hidden = np.array([e.undetermined[: e.base.rank][shown] for e in estimates])
    difference = np.array([(e.values - reference.values)[shown] / std for e in estimates])
    ends = np.array([[(end - reference.values)[shown] / std for end in (e.low, e.high)] for e in estimates]).swapaxes(0, 1)
    return values_side_by_side(names, list(result.estimates), np.where(hidden, np.nan, difference), ends, name, ax)


def _matrix(result: Comparison) -> list[dict[str, Any]]:
    """Root mean square differences of all pairs."""
    names = list(result.estimates)
    found = {frozenset((g.first, g.second)): g.rms for g in result.gaps}
    return [{"name": a, "cells": [DASH if a == b else in_sigmas(found.get(frozenset((a, b)))) for b in names]} for a in names]


def _test(test: HausmanTest) -> dict[str, str]:
    if test.probability is None:
        return {"name": test.method, "statistic": DASH, "degrees": DASH, "probability": DASH, "mood": "", "verdict": test.reason}
    bad = test.contradiction
    return {
        "name": test.method, "statistic": number(test.statistic, 3), "degrees": str(test.degrees),
        "probability": chance(test.probability), "mood": "bad" if bad else "good",
        "verdict": "differs by more than the noise explains" if bad else "differs by no more than the noise explains",
    }  # fmt: skip


def _motion_errors(result: Comparison, index: int) -> dict[str, Any]:
    """Errors of one motion, channel by channel and estimator by estimator."""
    entries = [e for e in (*result.baselines, *result.entries) if e.estimate is not None]
    ps = [e.predictions[index] for e in entries]

    def white(p: Prediction, c: int) -> str:
        return number(float(p.whitened_rms_by_channel[c]) if p.noise_known else None, 3)

    channels = [
        {"name": name, "unit": unit,
         "cells": [{"rmse": number(p.rmse[c], 3), "nrmse": percent(p.nrmse[c]), "white": white(p, c)}
                   for p in ps]}
        for c, (name, unit) in enumerate(zip(ps[0].channel_names, ps[0].channel_units, strict=True))
    ]  # fmt: skip
    whole = [{"nrmse": percent(p.relative_error), "white": number(p.times_noise, 3), "mood": judged(p).mood} for p in ps]
    return {"title": ps[0].motion, "names": [e.name for e in entries], "channels": channels, "whole": whole,
            "repeats": f"This motion repeats the fitted ‘{ps[0].repeats}’." if ps[0].repeats else ""}  # fmt: skip


def _how(result: Comparison) -> list[tuple[str, str]]:
    problem, regression = result.problem, result.regression
    how = []
    if problem is not None:
        filters = problem.row_model.filters
        how += [
            ("Bandwidth of the motion", f"{number(problem.smoother.bandwidth, 3)} Hz; {problem.smoother.reason}"),
            ("Accelerations", "from a spline through the positions, without delay" if filters is None else
             f"none: low-pass filters on both sides, l = {number(filters.l, 3)} and d = {number(filters.d, 3)} rad/s"),
            ("Static readings", STATIC[problem.static]),
        ]  # fmt: skip
    how += [
        ("Rows", f"{regression.rows.count} of {len(regression.channel_names)} channels, the same for all estimators"),
        ("Noise", "learned once; what is left is counted in it for all, so that no estimator is judged by a noise of its own"),
        run_times(result.seconds),
        versions("numpy", "scipy", "pin"),
    ]  # fmt: skip
    return how
