"""Numbers and terms as text, the same in a terminal, a notebook and a report."""

from __future__ import annotations

from html import escape

import numpy as np

DASH = "–"
#: Half a central 95 % interval of a normal distribution in standard deviations.
HALF = 1.959964
_CHANNELS = {"wrench": "sensor's wrench", "torque": "joint torques", "both": "sensor's wrench and joint torques"}


def channel_text(channel: str) -> str:
    """The readings that were fitted, in words."""
    return _CHANNELS[channel]


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, with a power of ten only where it is very small or large."""
    if value is None or not np.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    exponent = int(np.floor(np.log10(abs(float(f"{value:.{digits - 1}e}")))))
    if -4 <= exponent < 6:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}".replace("-", "−")
    return f"{value / 10.0**exponent:.{digits - 1}f}·10{_raised(exponent)}".replace("-", "−")


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def with_half(value: float, half: float | None) -> tuple[str, str]:
    """A value and half its interval, both to the interval's second digit."""
    if half is None or not np.isfinite(half) or half <= 0:
        return number(value), DASH
    return _alike(value, half, half=half)


def interval(value: float, half: float) -> str:
    """The interval's ends, to the second digit of half its width."""
    return ends(value - half, value + half)


def ends(low: float, high: float) -> str:
    """Both ends of an interval, to the second digit of half its width."""
    half = 0.5 * (high - low)
    return " … ".join(_alike(low, high, half=half)) if np.isfinite(half) and half > 0 else DASH


def with_interval(value: float, std: float | None, low: float, high: float) -> tuple[str, str]:
    """As `with_half`; both ends in place of half the width where one of them is cut off."""
    if std is None or not np.isfinite(std) or std <= 0 or np.isclose(high - low, 2 * HALF * std, rtol=1e-6) or not high > low:
        return with_half(value, None if std is None else HALF * std)
    return _alike(value, value, half=0.5 * (high - low))[0], ends(low, high)


def _alike(one: float, other: float, *, half: float) -> tuple[str, str]:
    """Two numbers to the second digit of ``half``, both with the same power of ten."""
    last = int(np.floor(np.log10(half))) - 1
    size = int(np.floor(np.log10(max(abs(one), abs(other)))))
    plain = -4 <= size < 6 and last >= -7
    scale, places, power = (1.0, -last, "") if plain else (10.0**size, size - last, f"·10{_raised(size)}")
    places = max(places, 0)
    first, second = (f"{round(v / scale, places) + 0.0:.{places}f}{power}".replace("-", "−") for v in (one, other))
    return first, second


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
