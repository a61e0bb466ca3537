"""What a diagnosis finds beside that which was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.design.payload.body import Quantity
from bayesid.estimators.parameters import with_ends
from bayesid.results.text import DASH, HALF, ends, with_half, with_interval

#: Share of half an interval by which its middle may be off the value for the interval to be written as ±.
_SKEW = 0.05


@dataclass(frozen=True)
class EffectBeside:
    """Something beside the payload that the readings show."""

    #: As in the experiment format.
    name: str
    where: str
    values: Mapping[str, tuple[float, float, str]]  # value, standard deviation and unit of each parameter
    ambiguous_with: tuple[str, ...] = ()  # effects, ``name@where``, that explain the readings as well
    in_model: bool = True  # whether the payload's values are those beside it

    @property
    def spec(self) -> str:
        """The effect's name and place, ``name@where``."""
        return f"{self.name}@{self.where}"

    def __str__(self) -> str:
        """The effect with its values, and what explains the readings as well."""
        values = ", ".join(_value(k, *given) for k, given in self.values.items())
        rivals = f", or {' or '.join(self.ambiguous_with)}: these recordings do not tell" if self.ambiguous_with else ""
        return f"{self.spec} ({values}){rivals}"

    def to_dict(self) -> dict[str, Any]:
        """An entry of ``effects``."""
        return {
            "name": self.name, "where": self.where, "parameters": {k: with_ends(*v) for k, v in self.values.items()},
            "ambiguous_with": list(self.ambiguous_with), "in_model": self.in_model,
        }  # fmt: skip


def _value(name: str, value: float, std: float, unit: str) -> str:
    text, half = with_half(value, HALF * std)
    return f"{name} {text}{'' if half == DASH else f' ± {half}'} {'' if unit == '1' else unit}".rstrip()


def cells(q: Quantity) -> tuple[str, str]:
    """Value and interval of a quantity as a table has them: ``± half`` where it is even, both ends otherwise, a dash without."""
    if not q.shown:
        return DASH, ends(q.low, q.high) if np.isfinite([q.low, q.high]).all() and q.low < q.high else DASH
    half = 0.5 * (q.high - q.low)
    if abs(q.low + half - q.value) < _SKEW * half:  # a ratio's interval is hardly ever quite even
        value, text = with_half(q.value, half)
        return value, f"± {text}"
    return with_interval(q.value, q.std, q.low, q.high)
