"""Figures of ``identifiability``: classes of link parameters by sensor set, and expected standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayesid.design.identifiability import SetReport
from bayesid.design.visibility import ALONE, COMBINATION, EFFECT, LETTERS, NEVER, UNEXCITED, WEAK, WORDS, by_body
from bayesid.report.figures import CLASSES, GREY, add_legend, make_grid, plain_log, styled

#: Colour of every class, and of its letter, which tells it in print and to the colour-blind.
LOOKS = {
    ALONE: (CLASSES["alone"], "white"),
    COMBINATION: (CLASSES["combination"], "white"),
    WEAK: (CLASSES["weak"], "black"),
    EFFECT: ("#be185d", "white"),
    UNEXCITED: ("#cbd5e1", "black"),
    NEVER: ("#f8fafc", "#94a3b8"),
}
_COLUMNS = 3
_ROW = 0.2  # inches


@styled
def classes(reports: Sequence[SetReport], main: SetReport, ax: Any = None) -> Figure:
    """The class of every link parameter, a panel for each sensor set: bodies downwards, their ten parameters across.

    Parameters
    ----------
    reports
        Of the sensor sets.
    main
        The one whose title is set apart.
    """
    kinds = tuple(LOOKS)
    names = [p.name for p in main.parameters]
    bodies, across = by_body(names)
    across_page = min(len(reports), _COLUMNS) if ax is None else 1
    rows = -(-len(reports) // across_page)
    longest = max(map(len, bodies))
    height = max(_ROW * len(bodies), 0.5)
    figure, axes = make_grid(rows, across_page, height, left=0.25 + 0.075 * longest, top=0.75 + 0.2 * (rows - 1), gap=0.25, ax=ax)
    if ax is None:
        figure.subplots_adjust(hspace=0.5 / height, top=1.0 - 0.75 / figure.get_figheight())
    for k, ax in enumerate(axes.ravel()):
        if k >= len(reports):
            ax.set_visible(False)
            continue
        report, columns = reports[k], len(across)
        table = np.array([kinds.index(p.kind) for p in report.parameters]).reshape(len(bodies), columns)
        colours = ListedColormap([LOOKS[kind][0] for kind in kinds])
        ax.pcolormesh(table, cmap=colours, vmin=-0.5, vmax=len(kinds) - 0.5, edgecolors="white", linewidth=1.2)
        for (i, j), kind in np.ndenumerate(table):
            ax.text(j + 0.5, i + 0.52, LETTERS[kinds[kind]], ha="center", va="center", fontsize=7.5, color=LOOKS[kinds[kind]][1])
        ax.invert_yaxis()
        ax.grid(False)
        ax.set_xticks(np.arange(columns) + 0.5, across, fontsize=7)
        ax.set_yticks(np.arange(len(bodies)) + 0.5, bodies if k % across_page == 0 else [""] * len(bodies), fontsize=8)
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        most = report.rank_of_any_motion
        rank = f"{report.rank}" if most in (None, report.rank) else f"{report.rank} of {most}"
        ax.set_title(f"{'● ' if report is main else ''}{report.sensor_set.title}: {rank}", fontsize=8.5)
    used = {p.kind for r in reports for p in r.parameters}
    handles = [Patch(facecolor=LOOKS[k][0], edgecolor="#94a3b8", linewidth=0.5) for k in kinds if k in used]
    add_legend(axes, handles, [f"{LETTERS[k]}: {WORDS[k]}" for k in kinds if k in used], lines=2)
    return figure


@styled
def expected(report: SetReport, names: Sequence[str], ax: Any = None) -> Figure:
    """Expected standard deviation of every combination, relative to its size where that is known, the surest first.

    Parameters
    ----------
    report
        Of the readings that would be used.
    names
        Short names of its combinations (r,).
    """
    bases = report.base_parameters
    sized = all(b.size for b in bases)
    values = np.array([b.std / b.size if sized and b.size else b.std for b in bases])
    order = np.argsort(values)
    figure, axes = make_grid(1, 1, max(0.165 * len(bases), 0.6), left=1.2, top=0.45, ax=ax)
    ax = axes[0, 0]
    colours = [CLASSES[bases[k].kind] for k in order]
    ax.barh(np.arange(len(bases)), values[order], color=colours, height=0.72, left=0.0)
    ax.set_yticks(np.arange(len(bases)), [names[k] for k in order], fontsize=7.5)
    ax.set_ylim(len(bases) - 0.4, -0.6)
    ax.grid(axis="y", visible=False)
    ax.set_xscale("log")
    ends = values[values > 0]
    ax.set_xlim(10 ** np.floor(np.log10(ends.min()) - 0.1), 10 ** np.ceil(np.log10(ends.max()) + 0.1))
    if sized:
        ax.axvline(1.0, color=GREY, lw=1.0, ls="--")
    ax.set_xlabel("expected standard deviation" + (" / size; dashed: as large as the body itself" if sized else " [SI units]"))
    plain_log(ax.xaxis)
    used = {b.kind for b in bases}
    shown = [k for k in (ALONE, COMBINATION, WEAK) if k in used]
    add_legend(axes, [Patch(color=CLASSES[k]) for k in shown], [WORDS[k] for k in shown])
    ax.tick_params(axis="y", length=0)
    return figure
