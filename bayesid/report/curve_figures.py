"""Curves over time with matplotlib: recordings as they are, and planned motions; what ``plot()`` draws of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayesid.drawing import Figures, figures_of
from bayesid.recordings.experiment import Motion
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.report.charts import CYCLE
from bayesid.report.figures import DENSE, NOISE, PREDICTED, add_legend, make_grid, picked, styled, tidy_time

#: Samples of a recording that are drawn, about.
_PLOTTED = 4000


def recording_figure(motion: Motion, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
    """Positions and readings of a recording as it is, a panel a group of columns."""
    table = motion.table
    stride = 1 if motion.kind == "poses" else max(len(table) // _PLOTTED, 1)
    numbers = range(1, table.positions.shape[1] + 1)
    groups = [("joint positions [rad or m]", [f"q{j}" for j in numbers], table.positions)]
    if table.wrench is not None:
        groups.append(("forces [N]", list(WRENCH_COLUMNS[:3]), table.wrench[:, :3]))
        groups.append(("moments [N m]", list(WRENCH_COLUMNS[3:]), table.wrench[:, 3:]))
    if table.torques is not None:
        known = list(table.torque_joints)
        groups.append(("joint torques [N m or N]", [f"tau{j + 1}" for j in known], table.torques[:, known]))
    gaps = [-(-part.start // stride) for part in table.segments()[1:]]
    shown = [(title, names, values[::stride]) for title, names, values in groups]
    return curves(table.times[::stride], shown, channels, ax, gaps=gaps, poses=motion.kind == "poses")


def panels_figure(
    times: np.ndarray, panels: Sequence[tuple[str, str, list[str], np.ndarray]], channels: Sequence[str] | str | None = None,
    ax: Any = None,
) -> Figure:  # fmt: skip
    """A planned motion: title, unit, names (k,) and values (N, k) of each panel over time (N,) [s]; as `curves`."""
    return curves(times, [(f"{title} [{unit}]", names, values) for title, unit, names, values in panels], channels, ax)


@styled
def curves(
    times: np.ndarray, groups: Sequence[tuple[str, Sequence[str], np.ndarray]], channels: Sequence[str] | str | None = None,
    ax: Any = None, *, gaps: Sequence[int] = (), poses: bool = False,
) -> Figure:  # fmt: skip
    """Groups of curves over time [s], or numbered poses, a panel a group: its title, names (k,) and values (N, k).

    No line is drawn across ``gaps``, the first samples after holes.
    """
    every = [name for _, names, _ in groups for name in names]
    wanted = {every[k] for k in picked(every, channels)}
    shown = [(title, [(k, n) for k, n in enumerate(names) if n in wanted], values) for title, names, values in groups]
    shown = [group for group in shown if group[1]]
    figure, axes = make_grid(len(shown), 1, 1.35, right=0.85, top=0.35, sharex=True, ax=ax)
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
def course_figure(
    names: Sequence[str], values: np.ndarray, changed: np.ndarray, title: str, needed: float | None = None, ax: Any = None
) -> Figure:
    """A number of every recording of a series in turn, coloured where something changed; nan where it was not compared."""
    figure, axes = make_grid(1, 1, 1.8, top=0.4, ax=ax)
    panel, x = axes[0, 0], np.arange(len(values))
    panel.plot(x, values, color="#94a3b8", lw=0.9)
    for part, colour, label in ((changed, PREDICTED, "changed"), (~changed, NOISE, "nothing changed")):
        if part.any():
            panel.plot(x[part], values[part], "o", ms=5, color=colour, mew=0, label=label)
    if needed is not None:
        panel.axhline(needed, color="#334155", lw=0.9, label="asked for")
    panel.set_ylim(0.0, 1.08 * panel.get_ylim()[1])
    panel.set_xticks(x, [name if len(name) < 18 else f"{name[:16]}…" for name in names])
    panel.set_title(title)
    add_legend(axes, *panel.get_legend_handles_labels())
    return figure


@figures_of.register
def _(result: Motion) -> Figures:
    return {"recording": partial(recording_figure, result)}
