"""Charts as SVG text, drawn without matplotlib: `check` answers before matplotlib would be imported.

Lengths are points of a page 748.8 wide, as in `bayesid.report.figures`. A `Panel` is a rectangle with axes; it turns
values into places and gives its frame, curves, bars and marks as SVG elements.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from markupsafe import Markup, escape

from bayesid.recordings.experiment import Motion
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.signals.arrays import runs

CYCLE = (
    "#1d4ed8", "#c2410c", "#0f766e", "#7c3aed", "#be185d", "#a16207", "#475569", "#0891b2", "#65a30d", "#dc2626",
    "#f472b6", "#14b8a6", "#facc15", "#4c1d95", "#a3a3a3", "#38bdf8",
)  # fmt: skip
WIDTH = 748.8
#: A point of a curve closer than this to the line between its neighbours is not drawn.
_FLAT = 0.12
_LONGEST_NUMBER = 8
_GREY, _DARK, _EDGE, _GRID = "#475569", "#334155", "#94a3b8", "#e2e8f0"


#: Curves that share a panel: its title with the unit, their names (k,) and values (N, k).
Group: TypeAlias = tuple[str, Sequence[str], np.ndarray]


@dataclass(frozen=True)
class Panel:
    """A rectangle with axes."""

    #: On the page [pt].
    left: float
    top: float
    width: float
    height: float
    #: Values at the left and right edge, and at the lower and upper one.
    x: tuple[float, float]
    y: tuple[float, float]

    def across(self, values: np.ndarray) -> np.ndarray:
        """Places of values from left to right [pt]."""
        return self.left + self.width * (values - self.x[0]) / (self.x[1] - self.x[0])

    def down(self, values: np.ndarray) -> np.ndarray:
        """Places of values from the top of the page [pt]."""
        return self.top + self.height * (self.y[1] - values) / (self.y[1] - self.y[0])

    def frame(self, title: str, x_label: str, *, y_axis: bool = True, x_numbers: bool = True, whole: bool = False) -> str:
        """Grid, axes, numbers and titles; with ``whole`` only whole numbers stand on the horizontal axis."""
        right, bottom = self.left + self.width, self.top + self.height
        parts = []
        numbers, label = tick_labels(ticks(*self.x, 10, whole))
        for value, text in numbers:
            at = float(self.across(np.array(value)))
            parts.append(_line(at, self.top, at, bottom, _GRID, 0.7))
            if x_numbers:
                parts += [_line(at, bottom, at, bottom + 3.5, _GREY, 0.8), write(at, bottom + 13.5, text, 8.5, _GREY, "middle")]
        if x_numbers and label:
            x_label += f" {label}"
        if y_axis:
            numbers, label = tick_labels(ticks(*self.y, 4))
            title += f" {label}" if label else ""
            for value, text in numbers:
                at = float(self.down(np.array(value)))
                parts += [_line(self.left, at, right, at, _GRID, 0.7), _line(self.left - 3.5, at, self.left, at, _GREY, 0.8)]
                parts.append(write(self.left - 7.0, at + 3.2, text, 8.5, _GREY, "end"))
        parts += [_line(self.left, self.top, self.left, bottom, _EDGE, 0.7), _line(self.left, bottom, right, bottom, _EDGE, 0.7)]
        if title:
            parts.append(write(self.left, self.top - 6.0, title, 9.5, "#000000", bold=True))
        if x_label:
            parts.append(write(self.left + self.width / 2, bottom + 27.0, x_label, 9.0, _DARK, "middle"))
        return "".join(parts)

    def curve(self, x: np.ndarray, y: np.ndarray, colour: str) -> str:
        """A line through points; nan interrupts it."""
        parts = (slice(*run) for run in runs(np.isfinite(x) & np.isfinite(y)))
        path = "".join(_path(*_simplified(self.across(x[part]), self.down(y[part]))) for part in parts)
        return f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1" stroke-linejoin="round"/>'

    def dots(self, x: np.ndarray, y: np.ndarray, colour: str) -> str:
        """A dot for each point."""
        places = zip(self.across(x).tolist(), self.down(y).tolist(), strict=True)
        return "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="1.5" fill="{colour}"/>' for a, b in places)

    def bar(self, low: float, high: float, middle: float, thickness: float, colour: str) -> str:
        """A horizontal bar from one value to another; ``middle`` and ``thickness`` in values of the vertical axis."""
        a, b = self.across(np.array([low, high])).tolist()
        c, d = sorted(self.down(np.array([middle - thickness / 2, middle + thickness / 2])).tolist())
        return f'<rect x="{a:.1f}" y="{c:.1f}" width="{b - a:.1f}" height="{d - c:.1f}" fill="{colour}"/>'

    def stroke(self, value: float, middle: float, thickness: float, colour: str) -> str:
        """A vertical stroke at a value, measured as a `bar` is."""
        at = float(self.across(np.array(value)))
        c, d = self.down(np.array([middle - thickness / 2, middle + thickness / 2])).tolist()
        return _line(at, c, at, d, colour, 1.2)


def recorded(
    motion: Motion, most: int, position_unit: str = "rad or m", torque_unit: str = "N m or N"
) -> tuple[np.ndarray, list[Group], list[int]]:
    """Times (N,) [s] of about ``most`` samples of a recording, its groups of columns, and the first samples after holes."""
    table = motion.table
    stride = 1 if motion.kind == "poses" else max(len(table) // most, 1)
    groups: list[Group] = [
        (f"joint positions [{position_unit}]", [f"q{j + 1}" for j in range(table.positions.shape[1])], table.positions)
    ]
    if table.wrench is not None:
        groups.append(("forces [N]", list(WRENCH_COLUMNS[:3]), table.wrench[:, :3]))
        groups.append(("moments [N m]", list(WRENCH_COLUMNS[3:]), table.wrench[:, 3:]))
    if table.torques is not None:
        known = list(table.torque_joints)
        groups.append((f"joint torques [{torque_unit}]", [f"tau{j + 1}" for j in known], table.torques[:, known]))
    gaps = [-(-part.start // stride) for part in table.segments()[1:]]
    return table.times[::stride], [(title, names, values[::stride]) for title, names, values in groups], gaps


def chart(height: float, parts: Sequence[str]) -> Markup:
    """Elements as one ``<svg>`` to be put into a page."""
    box = f'width="{WIDTH}" height="{height:.2f}"'
    # Every text in it went through `write`, which escapes.
    return Markup(f'<svg viewBox="0 0 {WIDTH} {height:.2f}"><rect {box} fill="#ffffff"/>{"".join(parts)}</svg>')


def write(x: float, y: float, text: str, size: float, colour: str, anchor: str = "start", bold: bool = False) -> str:
    """A text whose baseline is at y."""
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" font-family="DejaVu Sans" fill="{colour}" '
        f'text-anchor="{anchor}"{weight}>{escape(text)}</text>'
    )


def text_width(text: str) -> float:
    """Room for a text of mixed letters of 9 pt in the widest font that a page may be shown in [pt]."""
    return 0.66 * 9.0 * len(text)


def key(x: float, y: float, text: str, colour: str, thickness: float = 1.6) -> str:
    """An entry of a legend: a short line and its name, in the middle of a line of text at y."""
    return _line(x, y, x + 11.0, y, colour, thickness) + write(x + 16.0, y + 3.2, text, 9.0, "#000000")


def key_width(text: str) -> float:
    """Room that `key` takes [pt]."""
    return 28.0 + text_width(text)


def ticks(low: float, high: float, most: int, whole: bool = False) -> np.ndarray:
    """Round numbers within limits, about ``most`` intervals at most: multiples of 1, 2, 2.5 or 5 times a power of ten."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if power * m >= rough * (1 - 1e-9))
    if whole:
        step = max(math.ceil(step), 1)
    return step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)


def tick_labels(values: np.ndarray) -> tuple[list[tuple[float, str]], str]:
    """Numbers on an axis with their texts; where they are long or look alike, what is to be added to all of them, in words."""
    added, texts = 0.0, _texts(values)
    if max(map(len, texts)) > _LONGEST_NUMBER or len(set(texts)) < len(texts):
        added = float(values[0])
        texts = _texts(values - added)
    label = f"({'+' if added > 0 else '−'} {abs(added):.15g})" if added else ""
    return list(zip(values.tolist(), texts, strict=True)), label


def limits(values: Sequence[np.ndarray], margin: float) -> tuple[float, float]:
    """Lowest and highest finite value with a margin, a share of the range; rounding errors do not fill it."""
    finite = [v[np.isfinite(v)] for v in values]
    finite = [v for v in finite if len(v)]
    low, high = (min(map(np.min, finite)), max(map(np.max, finite))) if finite else (0.0, 0.0)
    low, high = float(low), float(high)
    if high - low < 1e-12 * max(abs(low), abs(high), 1e-12):
        room = max(1.0, 1e-9 * abs(low))
        return low - room, high + room
    return low - margin * (high - low), high + margin * (high - low)


def _texts(values: np.ndarray) -> list[str]:
    step = abs(float(values[1] - values[0])) if len(values) > 1 else max(abs(float(values[0])), 1.0)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    digits += abs(step * 10.0**digits - round(step * 10.0**digits)) > 1e-6  # steps of 2.5
    if digits > 6 or max(np.abs(values)) >= 1e7:
        texts = [f"{v:.6g}" for v in values]
    else:
        texts = [f"{v + 0.0:.{digits}f}" for v in np.round(values, digits)]
    return [t.replace("-", "−") for t in texts]


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float) -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="{colour}" stroke-width="{width}"/>'


def _simplified(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of a line without those that nobody would miss: every second one is asked in turn, until hardly one goes."""
    for _ in range(6):
        before = len(x)
        a, b, c = slice(0, -2, 2), slice(1, -1, 2), slice(2, None, 2)
        count = min(len(x[a]), len(x[b]), len(x[c]))
        if not count:
            break
        share = (x[b][:count] - x[a][:count]) / np.maximum(x[c][:count] - x[a][:count], 1e-9)
        off = y[a][:count] + share * (y[c][:count] - y[a][:count]) - y[b][:count]
        keep = np.ones(before, bool)
        keep[1 : 1 + 2 * count : 2] = np.abs(off) > _FLAT
        x, y = x[keep], y[keep]
        if len(x) > 0.95 * before:
            break
    return x, y


def _path(x: np.ndarray, y: np.ndarray) -> str:
    """A line in tenths of a point, from each point to the next."""
    places = np.round(10.0 * np.column_stack([x, y])).astype(int)
    steps = np.diff(places, axis=0) / 10.0
    return f"M{places[0, 0] / 10.0:g} {places[0, 1] / 10.0:g}l" + " ".join(f"{a:g} {b:g}" for a, b in steps.tolist())
