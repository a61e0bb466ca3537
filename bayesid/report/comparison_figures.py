"""Figures of `compare`: names and numbers go in, a Figure comes out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesid.report.charts import CYCLE
from bayesid.report.figures import GREY, NOISE, add_legend, given_axes, make_grid, plain_log, styled
from bayesid.validation.prediction import BAND

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
def proof_side_by_side(
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
