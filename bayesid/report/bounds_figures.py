"""Figures of ``bounds``: readings with bands, what uncertain parameters do to torques, what is left by speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.design.bounds.bands import Band
from bayesid.design.bounds.region import Region
from bayesid.design.bounds.remainder import Remainder
from bayesid.report.figures import CLASSES, DENSE, GREY, PREDICTED, add_legend, make_grid, picked, styled, tidy_time

_BLUE = CLASSES["alone"]
#: Parameters that are shown, those whose uncertainty makes most torque.
_PARAMETERS = 20


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
def parameter_figure(names: Sequence[str], region: Region, torque_per_unit: np.ndarray) -> Figure:
    """What each parameter moves in the fitted motions, and what its uncertainty does, in torque; the least certain first."""
    moves = np.abs(region.values) * torque_per_unit
    unsure = np.where(region.undetermined, 0.0, np.nan_to_num(region.factor * region.std)) * torque_per_unit
    order = np.argsort(-unsure, kind="stable")[:_PARAMETERS]
    margin = 0.35 + 0.062 * max((len(names[k]) for k in order), default=0)
    figure, axes = make_grid(1, 1, max(len(order) * 0.22, 0.8), left=margin)
    ax, y = axes[0, 0], np.arange(len(order))
    for kind, colour, label in ((False, _BLUE, "uncertain, 95 %, all at once"), (True, "#d97706", "... driven by the prior")):
        at = region.prior_driven[order] == kind
        if at.any():
            ax.barh(y[at], unsure[order][at], height=0.62, color=colour, alpha=0.55, lw=0, label=label)
    ax.plot(moves[order], y, "o", ms=4, mfc="white", mec=GREY, label="moved by the value itself")
    ax.set_yticks(y, [names[k] for k in order])
    ax.set(xlim=(0.0, None), ylim=(len(y) - 0.45, -0.55))
    ax.set_xlabel("root mean square torque in the fitted motions, at the joint it moves most [N m or N]")
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)
    add_legend(axes, *ax.get_legend_handles_labels())
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
