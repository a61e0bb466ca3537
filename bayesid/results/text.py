"""Numbers and terms as text, the same in a terminal, a notebook and a report."""

from __future__ import annotations

from html import escape

import numpy as np

from bayesid.rounding import DASH, HALF, ends, interval, number, with_half, with_interval

__all__ = [
    "DASH", "HALF", "chance", "channel_text", "ends", "html_table", "interval", "number", "percent", "text_table", "with_half",
    "with_interval",
]  # fmt: skip

_CHANNELS = {"wrench": "sensor's wrench", "torque": "joint torques", "both": "sensor's wrench and joint torques"}


def channel_text(channel: str) -> str:
    """The readings that were fitted, in words."""
    return _CHANNELS[channel]


def percent(share: float, digits: int = 3) -> str:
    """A share as per cent."""
    return f"{number(100 * share, digits)} %" if np.isfinite(share) else DASH


def chance(p: float) -> str:
    """A probability as per cent."""
    return "< 0.01 %" if p < 1e-4 else percent(p, 2)


def text_table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Columns of a width, the first to the left, the others to the right."""
    cells = [head, *([_cut(row[0]), *row[1:]] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    return ["  " + "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]).rstrip()
            for row in cells]  # fmt: skip


def _cut(text: str, width: int = 44) -> str:
    return text if len(text) <= width else text[: width - 2] + " …"


def html_table(head: list[str], rows: list[list[str]]) -> str:
    """A plain table for notebooks."""
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"
