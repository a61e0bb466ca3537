"""Figures of recordings and of fits to them: curves over time, predictions, what is left beside the noise, and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.drawing import Figures, figures_of
from bayesid.estimators import Estimate
from bayesid.recordings.experiment import Motion
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.regression.bandwidth import BandwidthChoice
from bayesid.regression.regression import Regression
from bayesid.report.charts import CYCLE, Group, recorded
from bayesid.report.figures import (
    CLASSES,
    DENSE,
    GREY,
    MEASURED,
    NOISE,
    PREDICTED,
    add_legend,
    draw_intervals,
    given_axes,
    label_lowest,
    list_rows,
    make_grid,
    picked,
    plain_log,
    styled,
    tidy_time,
)
from bayesid.results.loaded import LoadedIdentification
from bayesid.rounding import HALF
from bayesid.validation.prediction import BAND, Prediction, ResidualSpectrum

#: Samples of a recording that are drawn, about.
_PLOTTED = 4000
#: Half a 95 % interval, in natural sizes, from which a parameter counts as weak: a standard deviation of one.
WEAK = 1.96


def recording_figure(motion: Motion, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
    """Positions and readings of a recording as it is, a panel a group of columns."""
    times, groups, gaps = recorded(motion, _PLOTTED)
    return curves(times, groups, channels, ax, gaps=gaps, poses=motion.kind == "poses")


@styled
def curves(
    times: np.ndarray, groups: Sequence[Group], channels: Sequence[str] | str | None = None, ax: Any = None, *,
    gaps: Sequence[int] = (), poses: bool = False,
) -> Figure:  # fmt: skip
    """Groups of curves over time [s], or numbered poses, a panel a group.

    No line is drawn across ``gaps``, the first samples after holes.
    """
    every = [name for _, names, _ in groups for name in names]
    wanted = {every[k] for k in picked(every, channels)}
    shown = [(title, [(k, n) for k, n in enumerate(names) if n in wanted], values) for title, names, values in groups]
    shown = [group for group in shown if group[1]]
    height = max(1.35, 0.205 * max(len(names) for _, names, _ in shown))  # names of all curves have room beside them
    figure, axes = make_grid(len(shown), 1, height, right=0.85, top=0.35, sharex=True, ax=ax)
    x = np.insert(np.arange(1.0, len(times) + 1) if poses else times, list(gaps), np.nan)
    for panel, (title, names, values) in zip(axes[:, 0], shown, strict=True):
        for k, name in names:
            style: dict[str, Any] = {"ls": "", "marker": ".", "ms": 4} if poses else {"lw": 0.9, "rasterized": len(x) > DENSE}
            panel.plot(x, np.insert(values[:, k], list(gaps), np.nan), color=CYCLE[k % len(CYCLE)], label=name, **style)
        panel.set_title(title)
        panel.yaxis.set_major_locator(MaxNLocator(4))
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.0)
        tidy_time(panel, poses)
    axes[-1, 0].set_xlabel("pose" if poses else "time [s]")
    return figure


@styled
def measured_against_predicted(prediction: Prediction, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
    """Each channel of one motion, measured and predicted: the paper's figure 5."""
    chosen = picked(prediction.channel_names, channels)
    count = len(chosen)
    columns = 2 if count > 1 and ax is None else 1
    figure, axes = make_grid(-(-count // columns), columns, 1.15, sharex=True, ax=ax)
    # A wrench: forces on the left, moments on the right. Anything else: row by row.
    order = axes.T.ravel() if tuple(prediction.channel_names[k] for k in chosen) == WRENCH_COLUMNS else axes.ravel()
    x, (measured, predicted) = _with_breaks(prediction, prediction.measured, prediction.predicted)
    dense = len(x) > DENSE
    for k, ax in zip(chosen, order, strict=False):
        if prediction.poses:
            ax.plot(x, measured[:, k], "o", ms=6, mfc="none", mew=1.6, color="#64748b", label="measured")
            ax.plot(x, predicted[:, k], "x", ms=5, mew=1.4, color=PREDICTED, label="predicted")
        else:
            ax.plot(x, measured[:, k], color=MEASURED, lw=3.2, label="measured", rasterized=dense)
            ax.plot(x, predicted[:, k], color=PREDICTED, lw=0.9, label="predicted", rasterized=dense)
        ax.set_title(f"{prediction.channel_names[k]} [{prediction.channel_units[k]}]")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        tidy_time(ax, prediction.poses)
    for ax in order[count:]:
        ax.set_visible(False)
    label_lowest(axes, "pose" if prediction.poses else "time [s]")
    add_legend(axes)
    return figure


@styled
def residuals(prediction: Prediction, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
    """What is left of each channel, in time and in frequency, beside the noise; into one axis a channel, in time alone."""
    chosen = picked(prediction.channel_names, channels)
    spectrum, count = prediction.spectrum, len(chosen)
    level = None if spectrum is None or spectrum.filtered else noise_in_band(spectrum)
    if spectrum is None or (ax is not None and len(given_axes(ax)) == count):
        spectrum = None
        figure, axes = make_grid(count, 1, 0.95, sharex=True, ax=ax)
    else:
        figure, axes = make_grid(count, 2, 0.95, sharex="col", width_ratios=(1.7, 1.0), ax=ax)
    x, (left,) = _with_breaks(prediction, prediction.residuals)
    for row, k in zip(axes, chosen, strict=True):
        name, unit, ax = prediction.channel_names[k], prediction.channel_units[k], row[0]
        if prediction.poses:
            ax.vlines(x, 0.0, left[:, k], color=PREDICTED, lw=1.2)
            ax.plot(x, left[:, k], "o", ms=4, color=PREDICTED, mew=0)
        else:
            if level is not None:
                ax.axhspan(-1.96 * level[k], 1.96 * level[k], color=NOISE, alpha=0.16, lw=0, label="95 % of the noise")
            ax.plot(x, left[:, k], color=PREDICTED, lw=0.8, rasterized=len(x) > DENSE, label="measured less predicted")
        ax.axhline(0.0, color="#334155", lw=0.6)
        ax.set_title(f"{name} [{unit}]")
        ax.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
        tidy_time(ax, prediction.poses)
        if spectrum is not None:
            ax = row[1]
            ax.loglog(spectrum.frequencies, spectrum.residual[:, k], color=PREDICTED, lw=0.9)
            ax.loglog(spectrum.frequencies, spectrum.noise[:, k], color=NOISE, lw=1.8, label="noise model")
            ax.set_title(f"{name} [{unit}/√Hz]")
            ax.set_xlim(spectrum.frequencies[0], spectrum.frequencies[-1])
            plain_log(ax.xaxis)
            plain_log(ax.yaxis)
    axes[-1, 0].set_xlabel("pose" if prediction.poses else "time [s]")
    if spectrum is not None:
        axes[-1, 1].set_xlabel("frequency [Hz]")
    add_legend(axes, *axes[0])
    return figure


def noise_in_band(spectrum: ResidualSpectrum, band: float = BAND) -> np.ndarray:
    """Standard deviation that the noise model leaves below a frequency (c,) [unit of the channel]."""
    width = spectrum.frequencies[0]
    inside = spectrum.frequencies <= band
    return np.sqrt(np.sum(spectrum.noise[inside] ** 2, axis=0) * width)


def _with_breaks(prediction: Prediction, *curves: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Abscissa and curves with a hole wherever the recording has a gap."""
    times = prediction.times
    if prediction.poses:
        return np.arange(1.0, len(times) + 1), curves
    step = np.diff(times)
    if len(step):
        # Curves are limited to the band: points much closer than that only make the page large.
        stride = max(int(0.2 / BAND / np.median(step)), 1)
        times, curves = times[::stride], tuple(c[::stride] for c in curves)
        step = np.diff(times)
    gaps = np.flatnonzero(step > 5.0 * np.median(step)) + 1 if len(step) else []
    return np.insert(times, gaps, np.nan), tuple(np.insert(c, gaps, np.nan, axis=0) for c in curves)


@styled
def parameter_intervals(
    names: Sequence[str], change: np.ndarray, ends: np.ndarray, scale: np.ndarray, classes: Sequence[str], ax: Any = None
) -> Figure:
    """Base parameters as dots with 95 % intervals, in units of their natural size, and how sure each is; into one axis, no more.

    ``change`` is the value less the reference (r,), ``ends`` both ends of the interval less it (2, r), nan where there is none,
    ``scale`` the natural size (r,), all in SI units; ``classes`` are keys of `CLASSES` (r,).
    """
    count = len(names)
    panels = 1 if ax is not None and len(given_axes(ax)) == 1 else 2
    figure, axes = make_grid(1, panels, 0.3 + 0.2 * count, left=0.3 + 0.062 * max(map(len, names), default=0), gap=0.4,
                         sharey=True, width_ratios=(1.9, 1.0)[:panels], ax=ax)  # fmt: skip
    left, position, relative = axes[0, 0], change / scale, ends / scale
    width = 0.5 * (relative[1] - relative[0])
    # The well determined ones set the scale: weak ones would press them all to zero.
    good = np.isin(classes, ("alone", "combination"))
    reach = (np.abs(position) + np.nan_to_num(width))[good if good.any() else slice(None)]
    usual, longest = np.percentile(reach, [90, 100]) if count else (1.0, 1.0)
    # Everything, unless a few intervals are so long that the others would be dots.
    limit = float(1.05 * longest if longest <= 4.0 * usual else 1.1 * np.percentile(reach, 97))
    limit = limit if limit > 0 else 1.0
    for kind, colour in CLASSES.items():
        at = np.flatnonzero(np.array(classes) == kind)
        if len(at):
            draw_intervals(left, at, position[at], relative[:, at], limit, colour, kind, size=4.5)
    left.axvline(0.0, color="#334155", lw=0.9)
    left.set(xlim=(-limit, limit), xlabel="change against the nominal model, in natural sizes")
    list_rows(left, names, 0.7)
    left.set_title("Value and 95 % interval")
    if panels == 2:
        _how_sure(axes[0, 1], 100 * width, classes)
    add_legend(axes)
    return figure


def _reference(regression: Regression | LoadedIdentification, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Nominal base parameters (zero without a model) and their natural sizes (r,)."""
    rank = estimate.base.rank
    nominal = np.zeros(rank) if regression.nominal is None else regression.nominal
    half = np.nan_to_num(HALF * estimate.std)
    own = np.maximum(np.maximum(np.abs(estimate.values), np.abs(nominal)), np.maximum(half, 1e-9))
    scale = own if regression.nominal_scale is None else regression.nominal_scale
    return nominal, np.where(np.isfinite(scale) & (scale > 1e-9 * own), scale, own)


def intervals_figure(regression: Regression | LoadedIdentification, estimate: Estimate, ax: Any = None) -> Figure:
    """Base parameters against the nominal model, with their 95 % intervals."""
    nominal, scale = _reference(regression, estimate)
    names = [f"{name}  ({k + 1})" for k, name in enumerate(estimate.base.short_names)]
    between = np.array([estimate.low - nominal, estimate.high - nominal])
    return parameter_intervals(names, estimate.values - nominal, between, scale, estimate.classes, ax)


def _how_sure(ax: Axes, width: np.ndarray, classes: Sequence[str]) -> None:
    """Half of each interval (r,) [% of the natural size], downwards."""
    positive = np.flatnonzero(np.isfinite(width) & (width > 0))
    ax.set(ylim=(len(width) - 0.3, -0.7))
    ax.tick_params(axis="y", length=0, labelleft=False)
    if not len(positive):
        ax.set(xticks=[], frame_on=False)
        ax.text(0.5, 0.5, "no honest interval", transform=ax.transAxes, ha="center", color=GREY)
        return
    shown = width[positive]
    ax.hlines(positive, 1e-30, shown, color="#cbd5e1", lw=0.9)
    for kind, colour in CLASSES.items():
        own = np.array(classes)[positive] == kind
        ax.plot(shown[own], positive[own], "o", ms=4.5, color=colour, mew=0)
    ax.set_title("How sure")
    ax.set_xlabel("half interval [% of natural size]")
    ax.grid(axis="y", visible=False)
    ax.set_xscale("log")
    ax.set_xlim(10 ** np.floor(np.log10(shown.min()) - 0.1), 10 ** np.ceil(np.log10(shown.max()) + 0.1))
    ax.axvline(100.0 * WEAK, color=CLASSES["weak"], lw=0.9, ls="--")
    plain_log(ax.xaxis)


@styled
def bandwidth_sensitivity(choice: BandwidthChoice, std: np.ndarray) -> Figure:
    """What the bandwidth does to predictions of parts left out, and to the estimate with its standard deviations (p,)."""
    figure, axes = make_grid(1, 2, 1.9, left=0.65, gap=0.75)
    left, right = axes[0]
    tried, taken = choice.bandwidths, choice.bandwidths[choice.chosen]
    error = np.sqrt(choice.error)
    left.plot(tried, 100 * (error / error[choice.chosen] - 1), "o-", color=NOISE, ms=4)
    left.set_ylabel("error on segments left out,\nover the chosen one's [%]")
    known = np.isfinite(std) & (std > 0)
    moved = (choice.estimates - choice.estimates[choice.chosen])[:, known] / std[known]
    if moved.size:
        right.plot(tried, np.abs(moved).max(axis=1), "o-", color=PREDICTED, ms=4, label="largest")
        right.plot(tried, np.sqrt(np.mean(moved**2, axis=1)), "o-", color=NOISE, ms=4, label="root mean square")
        right.legend(loc="best", frameon=False)
    right.set_ylabel("change of the parameters\n[standard deviations]")
    for axis in (left, right):
        axis.axvline(taken, color=GREY, lw=1, ls=":")
        axis.set_xlabel("bandwidth [Hz]; dotted: chosen")
    return figure


@figures_of.register
def _(result: Motion) -> Figures:
    return {"recording": partial(recording_figure, result)}


@figures_of.register
def _(result: LoadedIdentification) -> Figures:
    return {"intervals": partial(intervals_figure, result, result.estimate)}
