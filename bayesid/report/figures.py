"""What all figures share: style, colours, layout, and a figure as SVG.

Figures are made without pyplot, so that nothing global changes and nothing needs a display. Dense curves are
rasterised inside otherwise sharp figures.
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from bayesid.errors import InputError

MEASURED, PREDICTED, NOISE, GREY = "#a9bbd6", "#b91c1c", "#0f766e", "#64748b"
#: Colours of the classes of base parameters.
CLASSES = {"alone": "#1d4ed8", "combination": "#7c3aed", "weak": "#d97706", "prior": "#94a3b8"}
_WIDTH = 10.4  # inches; the page is about a hundred times that in pixels
#: Points from which a curve is smaller as an image.
DENSE = 1500
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # a fixed place: looking for a free one costs half the time of drawing
    "axes.edgecolor": "#94a3b8",
    "axes.labelcolor": "#334155",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e2e8f0",
    "grid.linewidth": 0.7,
    "xtick.color": "#475569",
    "ytick.color": "#475569",
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "figure.facecolor": "white",
    "figure.dpi": 100,
    "savefig.dpi": 110,
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.3,
    "text.parse_math": False,  # names are the user's: a $ in one begins no formula
}
_P = ParamSpec("_P")


class Drawing(Figure):
    """A figure that a notebook shows by itself, whether or not ``%matplotlib inline`` or pyplot was ever loaded."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with mpl.rc_context(_STYLE):
            self.savefig(buffer, format="png")
        return buffer.getvalue()


def styled(draw: Callable[_P, Figure]) -> Callable[_P, Figure]:
    """Draw with the house style, and leave the caller's own style as it was."""

    @functools.wraps(draw)
    def inner(*args: _P.args, **kwargs: _P.kwargs) -> Figure:
        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return inner


def to_svg(figure: Figure, name: str) -> str:
    """The figure as an ``<svg>`` element to be put into a page.

    ``name`` is different for each figure of a page, so that references inside one do not reach into another; the same figure
    and name give the same text.
    """
    buffer = io.StringIO()
    with mpl.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"| version="1\.1"', "", text)
    # A hundredth of a point is finer than any screen or paper.
    text = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]).replace(" \n", "\n"), text)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    prefix = re.sub(r"\W+", "-", name)

    def keep(match: re.Match) -> str:
        return f' id="{prefix}-{match[1]}"' if match[1] in used else ""

    text = re.sub(r' id="([^"]*)"', keep, text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{prefix}-", text)
    # The page decides how wide a figure is; the viewBox keeps its shape.
    opening, rest = text.split(">", 1)
    return re.sub(r' (width|height)="[^"]*"', "", opening) + ">" + rest


def make_grid(
    rows: int, columns: int, height: float, *, left: float = 0.7, right: float = 0.2, top: float = 0.5, bottom: float = 0.45,
    gap: float = 0.75, space: float = 0.33, used: int | None = None, ax: Any = None, **options: Any,
) -> tuple[Figure, np.ndarray]:  # fmt: skip
    """A figure with panels of a height; margins, gaps between columns and spaces between rows in inches.

    An automatic layout would take most of a report's time.

    The user's own Axes ``ax``, row by row, are taken in place of a new figure; an `InputError` where they are fewer or more than
    panels. ``options`` go to ``subplots`` of a new one, of whose panels all but the first ``used`` are hidden.
    """
    if ax is not None:
        given = given_axes(ax)
        if len(given) != rows * columns:
            shape = f"{rows} rows of {columns}" if columns > 1 else str(rows)
            raise InputError(f"ax holds {len(given)} axes and the figure has {shape} panels; give one for each, row by row")
        whole = given[0].get_figure(root=True)
        if whole is None:
            raise InputError("ax was removed from its figure; give axes that are in one")
        return whole, np.array(given, object).reshape(rows, columns)
    total = top + rows * height + (rows - 1) * space + bottom
    figure = Drawing(figsize=(_WIDTH, total))
    width = (_WIDTH - left - right - (columns - 1) * gap) / columns
    figure.subplots_adjust(
        left=left / _WIDTH, right=1.0 - right / _WIDTH, top=1.0 - top / total, bottom=bottom / total,
        wspace=gap / width, hspace=space / height,
    )  # fmt: skip
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for panel in axes.ravel()[used:] if used is not None else ():
        panel.set_visible(False)
    return figure, axes


def given_axes(ax: Any) -> Sequence[Axes]:
    """The user's own axes, one or many in any shape, row by row; an `InputError` where something else is among them."""
    axes = [ax] if isinstance(ax, Axes) else list(np.asarray(ax, object).ravel())
    for one in axes:
        if not isinstance(one, Axes):
            raise InputError(f"ax holds a {type(one).__name__}; give Axes of matplotlib, as plt.subplots() makes them")
    return axes


def picked(names: Sequence[str], channels: Sequence[str] | str | None) -> list[int]:
    """Places of the channels asked for; all of them by default. An `InputError` where there is no such channel."""
    asked = names if channels is None else [channels] if isinstance(channels, str) else channels
    for name in asked:
        if name not in names:
            raise InputError(f"channels: there is no '{name}' here; choose of {', '.join(names)}")
    if not len(asked):
        raise InputError(f"channels: none is named; choose of {', '.join(names)}")
    return [list(names).index(name) for name in asked]


def add_legend(axes: np.ndarray, *panels: Axes, lines: int = 1) -> None:
    """One legend of what some panels show, default the first, as `place_legend` places it."""
    entries: dict[str, Any] = {}
    for panel in panels or axes.flat[:1]:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    place_legend(axes, entries, lines)


def place_legend(axes: np.ndarray, entries: Mapping[str, Any], lines: int = 1) -> None:
    """One legend for all panels, of handles by label: in the upper right corner of an own figure, in the first of given axes."""
    figure, handles = axes.flat[0].figure, list(entries.values())
    if handles and isinstance(figure, Drawing):
        columns = -(-len(handles) // lines)
        figure.legend(handles, list(entries), loc="upper right", ncols=columns, borderaxespad=0.1, handletextpad=0.6)
    elif handles:
        axes.flat[0].legend(handles, list(entries), loc="best")


def list_rows(panel: Axes, names: Sequence[str], edge: float = 0.6, **style: Any) -> None:
    """Names of rows from top to bottom in place of an axis; ``edge`` is the room beyond the first and the last one [rows]."""
    panel.set_yticks(np.arange(len(names)), list(names), **style)
    panel.set_ylim(len(names) - 1.0 + edge, -edge)
    panel.grid(axis="y", visible=False)
    panel.tick_params(axis="y", length=0)


def draw_intervals(
    panel: Axes, y: np.ndarray, values: np.ndarray, ends: np.ndarray, limit: float, colour: str, label: str, *, size: float
) -> None:
    """Values (k,) as dots at heights ``y`` (k,) with their intervals (2, k); a triangle where one lies outside the picture."""
    low, high = ends
    sure = np.isfinite(high - low) & np.isfinite(values)
    panel.hlines(y[sure], low[sure], high[sure], color=colour, lw=0.5 * size, alpha=0.45)
    inside = np.abs(values) <= limit
    panel.plot(values[inside], y[inside], "o", ms=size, mew=0, color=colour, label=label)
    for k in np.flatnonzero(np.abs(values) > limit):
        side = np.sign(values[k])
        panel.plot(0.985 * side * limit, y[k], ">" if side > 0 else "<", ms=size + 1.0, mew=0, color=colour)


def label_lowest(axes: np.ndarray, label: str) -> None:
    """Name the abscissa below the lowest visible panel of every column."""
    for column in axes.T:
        visible = [panel for panel in column if panel.get_visible()]
        if visible:
            visible[-1].set_xlabel(label)
            visible[-1].tick_params(labelbottom=True)


def tidy_time(ax: Axes, poses: bool) -> None:
    """Margins and ticks of an axis of times, or of numbered poses; limits that rounding errors do not fill."""
    ax.margins(x=0.01 if not poses else 0.03)
    if poses:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    low, high = ax.get_ylim()
    if high - low < 1e-12 * max(abs(low), abs(high), 1e-12):  # nothing moves: keep the axis from magnifying rounding
        ax.set_ylim(low - 1.0, high + 1.0)


def plain_log(axis) -> None:
    """Round plain numbers on a logarithmic axis: no minor ticks, no mathematics font."""
    low, high = sorted(axis.get_view_interval())
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    ticks = [10.0**c for c in (decades[::3], decades[::2], decades)]
    ticks += [np.outer(10.0**decades, m).ravel() for m in ((1, 3), (1, 2, 5), (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9))]
    inside = [t[(t >= low) & (t <= high)] for t in ticks]
    chosen = next((t for t in inside if len(t) >= 3), inside[-1])
    kept: list[float] = []
    for tick in np.sort(chosen):  # labels need room: a sixth of the axis each
        if not kept or np.log(tick / kept[-1]) >= np.log(high / low) / 6.0:
            kept.append(float(tick))
    axis.set_major_locator(FixedLocator(kept))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
