"""Figures of ``check``: ranges of the joints, and recordings as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.report.figures import CYCLE, DENSE, add_legend, make_grid, styled, tidy_time


@styled
def joint_ranges(
    names: Sequence[str],
    lower: np.ndarray,
    upper: np.ndarray,
    motions: Sequence[tuple[str, np.ndarray, np.ndarray]],
    units: Sequence[str],
) -> Figure:
    """How much of each joint's range each motion uses.

    Parameters
    ----------
    names, units
        Of the joints (n,).
    lower, upper
        Limits (n,), infinite where there are none.
    motions
        Name, lowest and highest positions (n,) of each.
    """
    count, shown = len(names), list(motions)[:8]
    figure, axes = make_grid(1, 1, count * (0.22 + 0.13 * len(shown)), left=0.3 + 0.062 * max(map(len, names)))
    ax = axes[0, 0]
    slot = 0.8 / max(len(shown), 1)
    for j in range(count):
        if np.isfinite(lower[j]) and np.isfinite(upper[j]):
            ax.barh(j, upper[j] - lower[j], left=lower[j], height=0.9, color="#eef2f7", lw=0, label="_limits")
            ax.vlines([lower[j], upper[j]], j - 0.45, j + 0.45, color="#94a3b8", lw=1.2)
    for k, (name, low, high) in enumerate(shown):
        at = np.arange(count) - 0.4 + (k + 0.5) * slot
        thickness = min(0.8 * slot, 0.3)
        ax.barh(at, high - low, left=low, height=thickness, color=CYCLE[k % len(CYCLE)], lw=0, label=name)
        still = high - low < 1e-9
        ax.plot(low[still], at[still], "|", ms=7, color=CYCLE[k % len(CYCLE)])
    ax.set_yticks(np.arange(count), names)
    ax.set_ylim(count - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("position [" + " or ".join(dict.fromkeys(units)) + "]")
    add_legend(figure, *ax.get_legend_handles_labels())
    return figure


@styled
def recording(
    times: np.ndarray, panels: Sequence[tuple[str, str, Sequence[str], np.ndarray]], breaks: Sequence[int], poses: bool
) -> Figure:
    """One recording as it is: a panel for each group of columns.

    Parameters
    ----------
    times
        (N,) [s]; poses are numbered instead.
    panels
        Title, unit, names of the curves (k,) and curves (N, k).
    breaks
        Indices of the first samples after gaps: no line is drawn across.
    poses
        Whether each sample stands for itself.
    """
    figure, grid = make_grid(len(panels), 1, 1.5, right=1.0, top=0.25, sharex=True)
    axes = grid[:, 0]
    x = np.arange(1.0, len(times) + 1) if poses else times
    x = np.insert(x, list(breaks), np.nan)
    for ax, (title, unit, names, values) in zip(axes, panels, strict=True):
        for k, (name, curve) in enumerate(zip(names, np.insert(values, list(breaks), np.nan, axis=0).T, strict=True)):
            style: dict[str, Any] = {"marker": "o", "ls": "", "ms": 3} if poses else {"lw": 1.0, "rasterized": len(x) > DENSE}
            ax.plot(x, curve, color=CYCLE[k % len(CYCLE)], label=name, **style)
        ax.set_title(f"{title} [{unit}]")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.2, borderaxespad=0.3, labelspacing=0.25)
        tidy_time(ax, x, poses)
    axes[-1].set_xlabel("pose" if poses else "time [s]")
    return figure
