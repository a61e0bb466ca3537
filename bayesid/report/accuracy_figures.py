"""Figures of ``accuracy``, and the section on coverage in its report and that of ``identify``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from bayesid.design.accuracy.certificate import CoverageCertificate
from bayesid.design.accuracy.sweeps import Level, Sweep, Sweeps
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators.estimator import LEVEL
from bayesid.report.figures import GREY, NOISE, PREDICTED, Drawing, add_legend, list_rows, make_grid, plain_log, styled
from bayesid.report.page import figure, fold, svg
from bayesid.results.accuracy import coverage_text
from bayesid.rounding import number, percent
from bayesid.section import Html, Part, ShownSection, ShownTable, as_html

_BLUE, _RED = "#1d4ed8", "#c2410c"
_HEAT = "YlOrRd"
#: Smaller biases are white [standard deviations].
_WHITE = 0.1
_TOP = 0.35
#: Effects that the map shows, and base parameters from which their names are numbers only.
SHOWN_EFFECTS, _NAMED = 40, 48
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
        for panel, s in zip(axes.ravel(), curves, strict=False):
            _curve(panel, s, sweeps)
        if rows:
            _dots(axes.ravel()[-1], rows, sweeps)
        add_legend(axes)
        return figure
    lines = -(-len(curves) // _PANELS)
    height, dots = 1.75, 0.27 * len(rows) + 0.1
    top, bottom, space = 0.75, 0.5, 0.85
    total = top + lines * (height + space) + (dots + 0.35 if rows else 0.0) + bottom
    figure = Drawing(figsize=(10.4, total))
    left, width, gap = 0.62, 2.75, 0.52
    for i, s in enumerate(curves):
        row, column = divmod(i, _PANELS)
        at = (left + column * (width + gap), total - top - row * (height + space) - height, width, height)
        _curve(figure.add_axes((at[0] / 10.4, at[1] / total, at[2] / 10.4, at[3] / total)), s, sweeps)
    if rows:
        names = 4.35
        _dots(figure.add_axes((names / 10.4, bottom / total, (10.2 - names) / 10.4, dots / total)), rows, sweeps)
    add_legend(np.array(figure.axes, object))
    return figure


def _relative(level: Level, own: Level) -> np.ndarray:
    """Error of every base parameter over the user's own."""
    ratio = level.rms / np.maximum(own.rms, 1e-300)
    return ratio[np.isfinite(ratio)]


def _quantiles(level: Level, sweeps: Sweeps) -> tuple[float, float]:
    """Range of the middle 80 % of the parameters, scaled as the median is."""
    ratio = _relative(level, sweeps.own)
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


@styled
def susceptibility_figure(effects: Sequence[str], parameters: Sequence[str], sigmas: np.ndarray, ax: Any = None) -> Figure:
    """Bias of each base parameter (r,) by each effect left out (e,), in standard deviations (e, r), as a map."""
    matrix = np.abs(sigmas)
    left, right = 0.35 + 0.068 * max(map(len, effects), default=0), 1.0
    own = ax is None
    figure, ax, below = _over_parameters(parameters, 0.19 * max(len(effects), 1), left, right, ax)
    values = np.where(matrix >= _WHITE, matrix, np.nan)
    top = max(float(np.nanmax(matrix, initial=10.0)), 10.0)
    edges = np.arange(len(parameters) + 1) - 0.5, np.arange(len(effects) + 1) - 0.5
    mesh = ax.pcolormesh(*edges, values, cmap=_HEAT, norm=LogNorm(_WHITE, top))
    ax.set_yticks(np.arange(len(effects)), list(effects), fontsize=8)
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
    figure, axes = make_grid(1, 1, height, left=left, right=right, top=_TOP, ax=ax)
    if ax is None:
        width, total = figure.get_size_inches()[0], _TOP + height + below
        figure.set_size_inches(width, total)
        figure.subplots_adjust(left=left / width, right=1 - right / width, top=1 - _TOP / total, bottom=below / total)
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
    section = ShownSection(
        "Coverage certificate",
        [
            coverage_text(certificate) + more,
            figure(
                svg(certificate_figure(certificate, base.short_names), "certificate"),
                "Dots: share of 95 % intervals that held the truth; strokes: its own 95 % interval. Green band: where exact "
                "intervals of all parameters lie together with a probability of 99 %.",
            ),
            fold("Every base parameter", _table(certificate, base)),
        ],
        "Certificate",
    )
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
