"""Numbers and terms as text, the same in a terminal, a notebook and a report."""

from __future__ import annotations

import numpy as np

from bayesid.rounding import DASH, HALF, ends, interval, number, with_half, with_interval

__all__ = [
    "DASH", "HALF", "chance", "channel_text", "counted", "ends", "interval", "number", "percent", "with_half", "with_interval",
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


def counted(count: int, one: str, several: str = "") -> str:
    """``1 motion``, ``2 motions``; what several are called where it is not one with an s."""
    return f"{count} {one if count == 1 else several or f'{one}s'}"
