"""Figures of ``check``: ranges of the joints, and recordings as they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from bayesid.report.charts import CYCLE, WIDTH, Panel, chart, key, key_width, limits, text_width, write

_LONGEST_NAME = 40
_LINE = 14.0


def joint_ranges(
    names: Sequence[str],
    lower: np.ndarray,
    upper: np.ndarray,
    motions: Sequence[tuple[str, np.ndarray, np.ndarray]],
    units: Sequence[str],
) -> Markup:
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
    names = [_cut(name) for name in names]
    count, shown = len(names), list(motions)[:8]
    places, lines = _legend([_cut(name) for name, _, _ in shown])
    left, top = 12.0 + max(map(text_width, names)), 8.0 + _LINE * lines
    height = 72.0 * count * (0.22 + 0.13 * len(shown))
    bounded = np.isfinite(lower) & np.isfinite(upper)
    ends = [lower[bounded], upper[bounded], *(end for _, *both in shown for end in both)]
    panel = Panel(left, top, WIDTH - 14.4 - left, height, limits(ends, 0.05), (count - 0.4, -0.6))
    parts = [panel.bar(lower[j], upper[j], j, 0.9, "#eef2f7") for j in np.flatnonzero(bounded).tolist()]
    parts.append(panel.frame("", "position [" + " or ".join(dict.fromkeys(units)) + "]", y_axis=False))
    for j, name in enumerate(names):
        parts.append(write(left - 6.0, float(panel.down(np.array(j))) + 3.2, name, 8.5, "#475569", "end"))
        if bounded[j]:
            parts += [panel.stroke(end, j, 0.9, "#94a3b8") for end in (lower[j], upper[j])]
    slot = 0.8 / max(len(shown), 1)
    thickness = min(0.8 * slot, 0.3)
    for k, (name, low, high) in enumerate(shown):
        colour = CYCLE[k % len(CYCLE)]
        for j in range(count):
            at = j - 0.4 + (k + 0.5) * slot
            still = high[j] - low[j] < 1e-9
            parts.append(
                panel.stroke(low[j], at, thickness, colour) if still else panel.bar(low[j], high[j], at, thickness, colour)
            )
        parts.append(key(*places[k], _cut(name), colour, 4.0))
    return chart(top + height + 33.0, parts)


def recording(
    times: np.ndarray, panels: Sequence[tuple[str, str, Sequence[str], np.ndarray]], breaks: Sequence[int], poses: bool
) -> Markup:
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
    left, right, top, height, gap = 50.4, 72.0, 18.0, 108.0, 24.0
    x = np.arange(1.0, len(times) + 1) if poses else times
    x = np.insert(x, list(breaks), np.nan)
    across, parts = limits([x], 0.03 if poses else 0.01), []
    for p, (title, unit, names, values) in enumerate(panels):
        values = np.insert(values, list(breaks), np.nan, axis=0)
        place = top + p * (height + gap)
        panel = Panel(left, place, WIDTH - left - right, height, across, limits([values], 0.05))
        last = p == len(panels) - 1
        label = ("pose" if poses else "time [s]") if last else ""
        parts.append(panel.frame(f"{title} [{unit}]", label, x_numbers=last, whole=poses))
        middle = place + height / 2 - _LINE * (len(names) - 1) / 2
        for k, name in enumerate(names):
            colour = CYCLE[k % len(CYCLE)]
            parts.append((panel.dots if poses else panel.curve)(x, values[:, k], colour))
            parts.append(key(WIDTH - right + 8.0, middle + _LINE * k, name, colour))
    return chart(top + len(panels) * height + (len(panels) - 1) * gap + 33.0, parts)


def _cut(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"


def _legend(names: Sequence[str]) -> tuple[list[tuple[float, float]], int]:
    """Where the entries of a legend begin: lines from the right, as many as they need; and how many lines those are."""
    lines: list[list[str]] = [[]]
    for name in names:
        if lines[-1] and sum(map(key_width, [*lines[-1], name])) > WIDTH - 14.4:
            lines.append([])
        lines[-1].append(name)
    places = []
    for row, line in enumerate(lines):
        x = WIDTH - 4.0 - sum(map(key_width, line))
        for name in line:
            places.append((x, 10.0 + _LINE * row))
            x += key_width(name)
    return places, len(lines)
