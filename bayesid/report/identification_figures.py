"""Figures of ``identify``: base parameters with their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesid.drawing import Figures, figures_of
from bayesid.estimators import Estimate
from bayesid.regression.bandwidth import BandwidthChoice
from bayesid.regression.regression import Regression
from bayesid.report.figures import (
    CLASSES,
    GREY,
    NOISE,
    PREDICTED,
    add_legend,
    draw_intervals,
    given_axes,
    list_rows,
    make_grid,
    plain_log,
    styled,
)
from bayesid.results.loaded import LoadedIdentification
from bayesid.rounding import HALF

#: Half a 95 % interval, in natural sizes, from which a parameter counts as weak: a standard deviation of one.
WEAK = 1.96


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
def _(result: LoadedIdentification) -> Figures:
    return {"intervals": partial(intervals_figure, result, result.estimate)}
