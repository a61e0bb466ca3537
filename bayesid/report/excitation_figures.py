"""Figures of ``excite``: the motion with what it takes, how near it comes to its limits, and random motions beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from bayesid.report.charts import WIDTH, Panel, chart, key, key_width, limits, text_width, write
from bayesid.report.check_figures import recording

_PLOTTED = 1000
_ROW, _BEST, _OTHER, _OVER = 15.0, "#1d4ed8", "#94a3b8", "#b91c1c"


def motion(times: np.ndarray, panels: Sequence[tuple[str, str, list[str], np.ndarray]]) -> Markup:
    """The motion in time (N,) [s]; panels as `motion_panels` makes them."""
    stride = max(-(-len(times) // _PLOTTED), 1)
    thinned = [(title, unit, names, values[::stride]) for title, unit, names, values in panels]
    return recording(times[::stride], thinned, [], False)


def motion_panels(
    parts: Sequence[tuple[str, str, np.ndarray]], loads: Mapping[str, tuple[tuple[str, ...], np.ndarray]]
) -> list[tuple[str, str, list[str], np.ndarray]]:
    """Title, unit, names and values of each panel: joint positions and rates, joint torques and the sensor's readings.

    Parameters
    ----------
    parts
        Title, unit and values (N, n) of positions, velocities and accelerations.
    loads
        Names and values (N, c), by ``torque`` and ``wrench``.
    """
    names = [f"q{j + 1}" for j in range(parts[0][2].shape[1])]
    panels = [(title, unit, names, values) for title, unit, values in parts]
    if "torque" in loads:
        panels.append(("joint torques of the nominal links", "N m", list(loads["torque"][0]), loads["torque"][1]))
    if "wrench" in loads:
        channels, values = loads["wrench"]
        panels.append(("forces on the sensor", "N", list(channels[:3]), values[:, :3]))
        panels.append(("moments on the sensor", "N m", list(channels[3:]), values[:, 3:]))
    return panels


def limit_shares(rows: Sequence[tuple[str, str, float]]) -> Markup:
    """How much of every limit a motion uses, as bars.

    Parameters
    ----------
    rows
        Kind, joint or channel, and share.
    """
    names = [f"{kind} {where}" for kind, where, _ in rows]
    left = 14.0 + max(map(text_width, names)) * 0.9
    height = _ROW * len(rows)
    panel = Panel(left, 8.0, WIDTH - 30.0 - left, height, (0.0, max(1.05, *(r for *_, r in rows))), (len(rows) - 0.4, -0.6))
    parts = [panel.frame("", "share of what is allowed", y_axis=False)]
    for k, (_, _, share) in enumerate(rows):
        parts.append(write(left - 6.0, float(panel.down(np.array(k))) + 3.2, names[k], 8.5, "#475569", "end"))
        parts.append(panel.bar(0.0, share, k, 0.55, _OVER if share > 1.0 else _BEST))
    parts.append(panel.stroke(1.0, 0.5 * len(rows) - 0.5, len(rows), "#0f172a"))
    return chart(height + 44.0, parts)


def beside_random(value: float, others: np.ndarray, label: str) -> Markup:
    """The criterion of the motion beside that of random motions within the same limits.

    Parameters
    ----------
    value, others
        Larger is better.
    label
        What the axis shows.
    """
    names = [f"{len(others)} random motions", "this motion"]
    places = np.cumsum([0.0, key_width(names[0])])
    panel = Panel(30.0, 24.0, WIDTH - 60.0, 46.0, limits([np.append(others, value)], 0.05), (0.0, 1.0))
    spread = 0.2 + 0.6 * (np.arange(len(others)) * 0.618034 % 1.0)  # so that dots do not hide each other
    parts = [panel.frame("", label, y_axis=False), panel.dots(others, spread, _OTHER), panel.stroke(value, 0.5, 0.9, _BEST)]
    parts += [key(30.0 + x, 10.0, n, c, 4.0) for x, n, c in zip(places, names, (_OTHER, _BEST), strict=True)]
    return chart(104.0, parts)
