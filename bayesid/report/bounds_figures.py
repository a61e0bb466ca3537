"""Figures of ``bounds``: readings with bands, sets of parameters, bounds by joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.design.bounds.bands import Band
from bayesid.design.bounds.region import Region
from bayesid.design.bounds.remainder import Remainder
from bayesid.report.figures import CLASSES, DENSE, GREY, NOISE, PREDICTED, add_legend, make_grid, picked, styled, tidy_time

_BLUE = CLASSES["alone"]
#: From so many parameters they stand in two columns.
_TWO_COLUMNS = 14


@styled
def band_figure(band: Band, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
    """Readings of a trajectory with their bands; below each, half the simultaneous band, which is often too thin to be seen."""
    chosen = picked(band.names, channels)
    count = len(chosen)
    columns = 2 if count > 1 and ax is None else 1
    rows = -(-count // columns)
    figure, axes = make_grid(2 * rows, columns, 0.85, ax=ax, sharex=True, height_ratios=(1.5, 0.8) * rows)
    dense = len(band.times) > DENSE
    for at, k in enumerate(chosen):
        name, unit = band.names[k], band.units[k]
        ax, below = axes[2 * (at // columns), at % columns], axes[2 * (at // columns) + 1, at % columns]
        low, high = band.low[:, k], band.high[:, k]
        ax.fill_between(band.times, low, high, color=_BLUE, alpha=0.25, lw=0, label="95 %, whole trajectory")
        ax.plot(band.times, band.values[:, k], color=PREDICTED, lw=0.9, label="predicted", rasterized=dense)
        ax.set_title(f"{name} [{unit}]")
        below.plot(band.times, band.factor * band.std[:, k], color=_BLUE, lw=0.9, label="half the band", rasterized=dense)
        below.plot(
            band.times, band.pointwise_high[:, k] - band.values[:, k], color=GREY, lw=0.8, ls="--", label="sample by sample",
            rasterized=dense,
        )  # fmt: skip
        below.set_ylim(bottom=0.0)
        for panel in (ax, below):
            panel.yaxis.set_major_locator(MaxNLocator(3))
        tidy_time(ax, band.times, False)
    for k in range(count, rows * columns):
        for ax in (axes[2 * (k // columns), k % columns], axes[2 * (k // columns) + 1, k % columns]):
            ax.set_visible(False)
    for column in axes.T:
        visible = [ax for ax in column if ax.get_visible()]
        visible[-1].set_xlabel("time [s]")
        visible[-1].tick_params(labelbottom=True)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    more = axes[1, 0].get_legend_handles_labels()
    add_legend(axes, [*handles, *more[0]], [*labels, *more[1]])
    return figure


@styled
def region_figure(names: Sequence[str], region: Region, nominal: np.ndarray) -> Figure:
    """Every parameter with its simultaneous and its own 95 % interval, and the nominal value, in standard deviations."""
    count = len(names)
    columns = 2 if count > _TWO_COLUMNS else 1
    per_column = -(-count // columns)
    margin = 0.35 + 0.062 * max(map(len, names), default=0)
    figure, axes = make_grid(1, columns, max(per_column * 0.22, 0.8), left=margin, gap=margin, sharex=True)
    limit = 1.6 * region.factor
    away = (nominal - region.values) / np.where(region.std > 0, region.std, np.inf)
    for column, ax in enumerate(axes[0]):
        part = slice(column * per_column, min((column + 1) * per_column, count))
        y = np.arange(part.stop - part.start)
        driven = region.prior_driven[part]
        ax.axvspan(-1.96, 1.96, color=NOISE, alpha=0.15, lw=0, label="95 % of each alone")
        for kind, colour, label in ((~driven, _BLUE, "95 % of all at once"), (driven, "#d97706", "driven by the prior")):
            if kind.any():
                ax.hlines(y[kind], -region.factor, region.factor, color=colour, lw=2.2, label=label)
        inside = np.abs(away[part]) <= limit
        ax.plot(away[part][inside], y[inside], "o", ms=4, mfc="white", mec=GREY, label="nominal model")
        for k in np.flatnonzero(~inside):
            side = np.sign(away[part][k])
            ax.plot(0.97 * side * limit, y[k], ">" if side > 0 else "<", ms=4.5, mew=0, color=GREY)
        ax.set_yticks(y, list(names[part]))
        ax.set(xlim=(-limit, limit), ylim=(len(y) - 0.45, -0.55))
        ax.set_xlabel("distance from the centre [standard deviations]")
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
    add_legend(axes, *axes[0, 0].get_legend_handles_labels())
    return figure


@styled
def remainder_figure(left: Remainder, names: Sequence[str], units: Sequence[str]) -> Figure:
    """99 % of what is left of each joint's torque, by speed."""
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    figure, axes = make_grid(rows, columns, 1.2, gap=0.55)
    figure.subplots_adjust(hspace=0.5)  # the numbers below each panel need room
    for j, ax in enumerate(axes.ravel()):
        if j >= len(names):
            ax.set_visible(False)
            continue
        edges = np.concatenate([[0.0], left.speeds[j]])
        ax.stairs(left.by_speed[j], edges, fill=True, color=_BLUE, alpha=0.3)
        ax.axhline(left.bound[j], color=PREDICTED, lw=1.1)
        ax.set_title(f"{names[j]} [{units[j]}]")
        ax.set_ylim(bottom=0.0)
        ax.yaxis.set_major_locator(MaxNLocator(3))
        ax.xaxis.set_major_locator(MaxNLocator(4))
        if j + columns >= len(names):
            ax.set_xlabel("speed [rad/s or m/s]")
    return figure
