"""A gap and what closes it: waterfall and bars of evidence, as SVG text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from bayesid.report.charts import WIDTH, chart, text_width, write

#: Colours: what is left, what is closed, what is neither.
LEFT, CLOSED, OTHER, _DARK, _GRID = "#c2410c", "#0f766e", "#94a3b8", "#334155", "#e2e8f0"
_ROW, _BAR, _TOP = 24.0, 14.0, 8.0


def _rect(x: float, y: float, width: float, colour: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(width, 0.6):.1f}" height="{_BAR}" fill="{colour}"/>'


def waterfall(steps: Sequence[tuple[str, float]], floor: float, floor_name: str = "own fit (floor)") -> Markup:
    """A gap between a model or a reference and recordings, and what each step takes of it.

    Parameters
    ----------
    steps
        Names and mean squares, first before any step, last with everything.
    floor
        Mean square that stays in any case: of the recording's own fit, or of the noise.
    floor_name
        What that is.
    """
    names = [steps[0][0], *(f"{'+ ' if k else ''}{name}" for k, (name, _) in enumerate(steps[1:], 1)), floor_name]
    left = 16.0 + max(text_width(n) for n in names)
    scale = (WIDTH - left - 130.0) / max(value for _, value in steps)
    parts, y, before = [], _TOP, None
    for (_, value), name in zip([*steps, ("", floor)], names, strict=True):
        parts.append(write(left - 8.0, y + 11.0, name, 9.0, _DARK, "end"))
        last = name == names[-1]
        if before is None or last:
            parts.append(_rect(left, y, scale * value, OTHER if last else LEFT))
            end, words = value, f"{np.sqrt(value):.2f}"
        else:
            low, high = sorted((before, value))
            parts.append(_rect(left, y, scale * low, _GRID))
            parts.append(_rect(left + scale * low, y, scale * (high - low), CLOSED if value < before else LEFT))
            end, words = high, f"{np.sqrt(value):.2f} left"
        parts.append(write(left + scale * end + 6.0, y + 11.0, words, 9.0, _DARK))
        before, y = value, y + _ROW
    return chart(y + _TOP, parts)


def evidence_bars(scores: Sequence[tuple[str, float, bool]], needed: float) -> Markup:
    """Log evidence of each change on its own; a line where it counts.

    Parameters
    ----------
    scores
        Name, log evidence, and whether it is named.
    needed
        Log evidence that a change must bring.
    """
    left = 16.0 + max(text_width(name) for name, _, _ in scores)
    top = max([2.0 * needed, *(value for _, value, _ in scores)])
    scale = (WIDTH - left - 70.0) / top
    parts, y = [], _TOP
    height = _ROW * len(scores)
    x = left + scale * needed
    parts.append(f'<path d="M{x:.1f} {y:.1f}v{height:.1f}" stroke="{OTHER}" stroke-width="1" stroke-dasharray="3 3"/>')
    for name, value, named in scores:
        parts.append(write(left - 8.0, y + 11.0, name, 9.0, _DARK, "end", bold=named))
        parts.append(_rect(left, y, scale * max(value, 0.0), CLOSED if named else OTHER))
        parts.append(write(left + scale * max(value, 0.0) + 6.0, y + 11.0, f"{value:.1f}".replace("-", "−"), 9.0, _DARK))
        y += _ROW
    return chart(y + _TOP, parts)
