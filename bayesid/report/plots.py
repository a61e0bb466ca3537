"""Figures of results: one figure a function; results go in, a Figure comes out.

Figures are made without pyplot, so that nothing global changes and nothing needs a display. Dense curves are
rasterised inside otherwise sharp figures.
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.validation.prediction import BAND, Prediction, Spectrum

MEASURED, PREDICTED, NOISE, GREY = "#a9bbd6", "#b91c1c", "#0f766e", "#64748b"
#: Half a 95 % interval, in natural sizes, from which a parameter counts as weak: a standard deviation of one.
WEAK = 1.96
#: Colours of the classes of base parameters.
CLASSES = {"alone": "#1d4ed8", "combination": "#7c3aed", "weak": "#d97706", "prior": "#94a3b8"}
CYCLE = ("#1d4ed8", "#c2410c", "#0f766e", "#7c3aed", "#be185d", "#a16207", "#475569", "#0891b2", "#65a30d", "#dc2626")
_WIDTH = 10.4  # inches; the page is about a hundred times that in pixels
_DENSE = 1500  # points from which a curve is smaller as an image
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
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


def styled(draw: Callable[_P, Figure]) -> Callable[_P, Figure]:
    """Draw with the house style, and leave the caller's own style as it was."""

    @functools.wraps(draw)
    def inner(*args: _P.args, **kwargs: _P.kwargs) -> Figure:
        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return inner


def to_svg(figure: Figure, name: str) -> str:
    """The figure as an ``<svg>`` element to be put into a page.

    Parameters
    ----------
    figure
        Any of this module's figures.
    name
        Different for each figure of a page, so that references inside one do not reach into another; the
        same figure and name give the same text.
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


@styled
def parameter_intervals(
    names: Sequence[str],
    change: np.ndarray,
    half: np.ndarray,
    scale: np.ndarray,
    classes: Sequence[str],
    *,
    relative_to: str = "nominal model",
) -> Figure:
    """Base parameters as dots with 95 % intervals, in units of their natural size, and how sure each one is.

    Parameters
    ----------
    names
        Short names (r,).
    change
        Value less reference (r,) [SI].
    half
        Half the width of the 95 % interval (r,) [SI], nan where there is none.
    scale
        Natural size of each parameter (r,) [SI], positive.
    classes
        Keys of `CLASSES` (r,).
    relative_to
        What ``change`` is counted from.
    """
    count = len(names)
    figure, axes = make_grid(1, 2, 0.3 + 0.2 * count, left=0.3 + 0.062 * max(map(len, names), default=0), gap=0.4,
                         sharey=True, width_ratios=(1.9, 1.0))  # fmt: skip
    left, right = axes[0]
    y = np.arange(count)
    position, width = change / scale, half / scale
    # The well determined ones set the scale: weak ones would press them all to zero.
    good = np.isin(classes, ("alone", "combination"))
    reach = (np.abs(position) + np.nan_to_num(width))[good if good.any() else slice(None)]
    usual, longest = np.percentile(reach, [90, 100]) if count else (1.0, 1.0)
    # Everything, unless a few intervals are so long that the others would be dots.
    limit = float(1.05 * longest if longest <= 4.0 * usual else 1.1 * np.percentile(reach, 97))
    limit = limit if limit > 0 else 1.0
    for kind, colour in CLASSES.items():
        at = np.flatnonzero(np.array(classes) == kind)
        if not len(at):
            continue
        sure = at[np.isfinite(width[at])]
        left.hlines(y[sure], position[sure] - width[sure], position[sure] + width[sure], color=colour, lw=2.2, alpha=0.45)
        inside = at[np.abs(position[at]) <= limit]
        left.plot(position[inside], y[inside], "o", ms=4.5, color=colour, label=kind, mew=0)
        for k in at[np.abs(position[at]) > limit]:
            side = np.sign(position[k])
            left.plot(0.985 * side * limit, y[k], ">" if side > 0 else "<", ms=5.5, color=colour, mew=0)
        shown = sure[width[sure] > 0]
        right.hlines(y[shown], 1e-30, 100 * width[shown], color="#cbd5e1", lw=0.9)
        right.plot(100 * width[shown], y[shown], "o", ms=4.5, color=colour, mew=0)
    left.axvline(0.0, color="#334155", lw=0.9)
    left.set(xlim=(-limit, limit), ylim=(count - 0.3, -0.7), xlabel=f"change against the {relative_to}, in natural sizes")
    left.set_yticks(y, names)
    left.grid(axis="y", visible=False)
    left.set_title("Value and 95 % interval")
    right.set_title("How sure")
    right.set_xlabel("half interval [% of natural size]")
    right.grid(axis="y", visible=False)
    positive = 100 * width[np.isfinite(width) & (width > 0)]
    if len(positive):
        right.set_xscale("log")
        right.set_xlim(10 ** np.floor(np.log10(positive.min()) - 0.1), 10 ** np.ceil(np.log10(positive.max()) + 0.1))
        right.axvline(100.0 * WEAK, color=CLASSES["weak"], lw=0.9, ls="--")
        plain_log(right.xaxis)
    else:
        right.set(title="", xlabel="", xticks=[], frame_on=False)
        right.text(0.5, 0.5, "no honest interval", transform=right.transAxes, ha="center", color=GREY)
    left.tick_params(axis="y", length=0)
    right.tick_params(axis="y", length=0)
    handles, labels = left.get_legend_handles_labels()
    add_legend(figure, handles, labels)
    return figure


@styled
def measured_against_predicted(prediction: Prediction) -> Figure:
    """Each channel of one motion, measured and predicted: the paper's figure 5."""
    count = len(prediction.channel_names)
    columns = 2 if count > 1 else 1
    rows = -(-count // columns)
    figure, axes = make_grid(rows, columns, 1.15, sharex=True)
    # A wrench: forces on the left, moments on the right. Anything else: row by row.
    order = axes.T.ravel() if prediction.channel_names == WRENCH_COLUMNS else axes.ravel()
    x, (measured, predicted) = _with_breaks(prediction, prediction.measured, prediction.predicted)
    dense = len(x) > _DENSE
    for k, (ax, name, unit) in enumerate(zip(order, prediction.channel_names, prediction.channel_units, strict=False)):
        if prediction.poses:
            ax.plot(x, measured[:, k], "o", ms=6, mfc="none", mew=1.6, color="#64748b", label="measured")
            ax.plot(x, predicted[:, k], "x", ms=5, mew=1.4, color=PREDICTED, label="predicted")
        else:
            ax.plot(x, measured[:, k], color=MEASURED, lw=3.2, label="measured", rasterized=dense)
            ax.plot(x, predicted[:, k], color=PREDICTED, lw=0.9, label="predicted", rasterized=dense)
        ax.set_title(f"{name} [{unit}]")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        _tidy_time(ax, x, prediction.poses)
    for ax in order[count:]:
        ax.set_visible(False)
    _label_lowest(axes, "pose" if prediction.poses else "time [s]")
    add_legend(figure, *order[0].get_legend_handles_labels())
    return figure


@styled
def residuals(prediction: Prediction) -> Figure:
    """What is left of each channel, in time and in frequency, beside the noise."""
    spectrum, count = prediction.spectrum, len(prediction.channel_names)
    if spectrum is None:
        figure, axes = make_grid(count, 1, 0.95, sharex=True)
    else:
        figure, axes = make_grid(count, 2, 0.95, sharex="col", width_ratios=(1.7, 1.0))
    x, (left,) = _with_breaks(prediction, prediction.measured - prediction.predicted)
    level = None if spectrum is None or spectrum.filtered else noise_in_band(spectrum)
    for k, (name, unit) in enumerate(zip(prediction.channel_names, prediction.channel_units, strict=True)):
        ax = axes[k, 0]
        if prediction.poses:
            ax.vlines(x, 0.0, left[:, k], color=PREDICTED, lw=1.2)
            ax.plot(x, left[:, k], "o", ms=4, color=PREDICTED, mew=0)
        else:
            if level is not None:
                ax.axhspan(-1.96 * level[k], 1.96 * level[k], color=NOISE, alpha=0.16, lw=0, label="95 % of the noise")
            ax.plot(x, left[:, k], color=PREDICTED, lw=0.8, rasterized=len(x) > _DENSE, label="measured less predicted")
        ax.axhline(0.0, color="#334155", lw=0.6)
        ax.set_title(f"{name} [{unit}]")
        ax.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
        _tidy_time(ax, x, prediction.poses)
        if spectrum is not None:
            ax = axes[k, 1]
            ax.loglog(spectrum.frequencies, spectrum.residual[:, k], color=PREDICTED, lw=0.9)
            ax.loglog(spectrum.frequencies, spectrum.noise[:, k], color=NOISE, lw=1.8, label="noise model")
            ax.set_title(f"{name} [{unit}/√Hz]")
            ax.set_xlim(spectrum.frequencies[0], spectrum.frequencies[-1])
            plain_log(ax.xaxis)
            plain_log(ax.yaxis)
    axes[-1, 0].set_xlabel("pose" if prediction.poses else "time [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if spectrum is not None:
        axes[-1, 1].set_xlabel("frequency [Hz]")
        more = axes[0, 1].get_legend_handles_labels()
        handles, labels = [*handles, *more[0]], [*labels, *more[1]]
    add_legend(figure, handles, labels)
    return figure


def noise_in_band(spectrum: Spectrum, band: float = BAND) -> np.ndarray:
    """Standard deviation that the noise model leaves below a frequency (c,) [unit of the channel]."""
    width = spectrum.frequencies[0]
    inside = spectrum.frequencies <= band
    return np.sqrt(np.sum(spectrum.noise[inside] ** 2, axis=0) * width)


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
            style: dict[str, Any] = {"marker": "o", "ls": "", "ms": 3} if poses else {"lw": 1.0, "rasterized": len(x) > _DENSE}
            ax.plot(x, curve, color=CYCLE[k % len(CYCLE)], label=name, **style)
        ax.set_title(f"{title} [{unit}]")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.2, borderaxespad=0.3, labelspacing=0.25)
        _tidy_time(ax, x, poses)
    axes[-1].set_xlabel("pose" if poses else "time [s]")
    return figure


def make_grid(
    rows: int, columns: int, height: float, *, left: float = 0.7, right: float = 0.2, top: float = 0.5, gap: float = 0.75,
    **options: Any,
) -> tuple[Figure, np.ndarray]:  # fmt: skip
    """A figure with panels of a height; margins in inches. An automatic layout would take most of a report's time."""
    bottom, space = 0.45, 0.33
    total = top + rows * height + (rows - 1) * space + bottom
    figure = Figure(figsize=(_WIDTH, total))
    width = (_WIDTH - left - right - (columns - 1) * gap) / columns
    figure.subplots_adjust(
        left=left / _WIDTH, right=1.0 - right / _WIDTH, top=1.0 - top / total, bottom=bottom / total,
        wspace=gap / width, hspace=space / height,
    )  # fmt: skip
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def add_legend(figure: Figure, handles: list, labels: list, lines: int = 1) -> None:
    """One legend for all panels, in the figure's upper right corner."""
    if handles:
        figure.legend(handles, labels, loc="upper right", ncols=-(-len(handles) // lines), borderaxespad=0.1, handletextpad=0.6)


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


def _tidy_time(ax: Axes, x: np.ndarray, poses: bool) -> None:
    ax.margins(x=0.01 if not poses else 0.03)
    if poses:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    low, high = ax.get_ylim()
    if high - low < 1e-12 * max(abs(low), abs(high), 1e-12):  # nothing moves: keep the axis from magnifying rounding
        ax.set_ylim(low - 1.0, high + 1.0)


def _label_lowest(axes: np.ndarray, label: str) -> None:
    """Name the abscissa below the lowest visible panel of every column."""
    for column in axes.T:
        visible = [ax for ax in column if ax.get_visible()]
        if visible:
            visible[-1].set_xlabel(label)
            visible[-1].tick_params(labelbottom=True)


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
