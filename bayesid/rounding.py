"""Numbers and terms as text, the same in a terminal, a notebook and a report: with the digits that their uncertainty allows."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import NormalDist

import numpy as np

DASH = "–"
#: Central probability of the intervals that are shown.
LEVEL = 0.95
#: Half a central 95 % interval of a normal distribution in standard deviations.
HALF = NormalDist().inv_cdf(0.5 + LEVEL / 2)


def number(value: float | None, digits: int = 4, otherwise: str = DASH) -> str:
    """A finite number with so many significant digits, with a power of ten only where it is very small or large."""
    if value is None or not np.isfinite(value):
        return otherwise
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


def ends(low: float, high: float) -> str:
    """Both ends of an interval, to the second digit of half its width."""
    half = 0.5 * (high - low)
    if not np.isfinite(half):
        return DASH
    return " … ".join(_alike(low, high, half=half) if half > 0 else (number(low), number(high)))


def with_interval(value: float, std: float | None, low: float, high: float) -> tuple[str, str]:
    """The same as `with_half`; both ends in place of half the width where they are not where a normal law has them."""
    if std is None or not np.isfinite([std, low, high]).all() or std <= 0:
        return number(value), DASH
    if np.allclose([value - low, high - value], HALF * std, rtol=1e-6, atol=0.0):
        return with_half(value, HALF * std)
    return _alike(value, value, half=0.5 * (high - low) or HALF * std)[0], ends(low, high)


def without_rounding_errors(values: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Numbers (p,), zero where that is all they are: within a millionth of their standard deviations (p,).

    Where there is none, within the precision of the largest number.
    """
    precision = 1e-12 * np.max(np.abs(values), initial=0.0)
    return np.where(np.abs(values) > np.where(np.isfinite(std) & (std > 0), 1e-6 * np.nan_to_num(std), precision), values, 0.0)


def _alike(one: float, other: float, *, half: float) -> tuple[str, str]:
    """Two numbers to the second digit of ``half``, both with the same power of ten."""
    last = int(np.floor(np.log10(half))) - 1
    size = int(np.floor(np.log10(max(abs(one), abs(other), half))))
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


def counted(count: int, one: str, several: str = "") -> str:
    """``1 motion``, ``2 motions``; what several are called where it is not one with an s."""
    return f"{count} {one if count == 1 else several or f'{one}s'}"


def unit_text(unit: str) -> str:
    """A unit behind a number: nothing where that has none."""
    return "" if unit == "1" else unit


_CHANNELS = {"wrench": "sensor's wrench", "torque": "joint torques", "both": "sensor's wrench and joint torques"}


def channel_name(channel: str) -> str:
    """What was fitted, in a word behind *the*."""
    return "wrench and torque" if channel == "both" else channel


def channel_text(channel: str, motions: Iterable[str] = ()) -> str:
    """The readings that were fitted, in words, and of which motions."""
    return " of ".join(filter(None, (_CHANNELS[channel], ", ".join(motions))))
