"""Parameters with their intervals, as every result shows and writes them: the one place that makes ``low`` and ``high``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from bayesid.arguments import ByName
from bayesid.errors import InputError
from bayesid.rounding import DASH, LEVEL, with_interval, without_rounding_errors
from bayesid.section import ShownTable

if TYPE_CHECKING:
    from pandas import DataFrame


def tails(level: float = LEVEL) -> tuple[float, float]:
    """Probabilities below the ends of a central interval; an `InputError` where the level is no probability."""
    if not (isinstance(level, Real) and 0.0 < level < 1.0):
        raise InputError(f"level = {level}: give a probability between 0 and 1, such as 0.95")
    return 0.5 - level / 2, 0.5 + level / 2


def central_interval(
    values: np.ndarray, std: np.ndarray, level: float = LEVEL, possible: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the central intervals of normal laws with a probability inside; an `InputError` where it is none.

    Values and their standard deviations have any shape; without an honest one, nan, the ends are nan. Intervals end at
    ``possible``, the smallest and largest values that can be (2, ...); None: any.
    """
    half = norm.ppf(tails(level)[1]) * np.asarray(std)
    ends = values - half, values + half
    return ends if possible is None else (np.clip(ends[0], *possible), np.clip(ends[1], *possible))


def with_ends(value: float, std: float, unit: str) -> dict[str, Any]:
    """A value for JSON with its standard deviation, the ends of its 95 % interval, None where there is none, and its unit."""
    known = float(std) if np.isfinite(std) and std > 0 else np.nan
    low, high = central_interval(np.array(float(value)), np.array(known))
    return {"value": float(value), "std": _known(known), "low": _known(float(low)), "high": _known(float(high)), "unit": unit}


@dataclass(frozen=True)
class EstimatedParameter:
    """One parameter with its interval."""

    #: The name in full, and one for reading.
    name: str
    label: str
    #: Estimate, standard deviation and ends of the central interval, nan where no honest one exists, and their unit.
    value: float
    std: float
    low: float
    high: float
    unit: str
    kind: str  # ``alone``, ``combination``, ``weak``, ``prior`` or ``effect``

    def __repr__(self) -> str:
        value, spread = with_interval(self.value, self.std, self.low, self.high)
        return f"<{self.label}: {joined(value, spread)} {self.unit}>"


@dataclass(frozen=True, eq=False)
class Parameters(ByName):
    """Parameters of a result with their central intervals, base parameters first."""

    names: Sequence[str]  # (p,)
    labels: Sequence[str]
    values: np.ndarray  # (p,); these and the next are nan where there is no honest interval
    std: np.ndarray
    low: np.ndarray
    high: np.ndarray
    units: Sequence[str]
    classes: Sequence[str]  # that of what is no base parameter is ``effect``

    def __post_init__(self) -> None:
        """Leave no rounding errors that look like values."""
        object.__setattr__(self, "values", without_rounding_errors(self.values, self.std))

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self.names)

    def __getitem__(self, name: str) -> EstimatedParameter:
        """The parameter of a name or a label; a `KeyError` that lists the labels where there is none."""
        for known in (self.names, self.labels):
            if name in known:
                k = list(known).index(name)
                value, std, low, high = (float(x[k]) for x in (self.values, self.std, self.low, self.high))
                return EstimatedParameter(self.names[k], self.labels[k], value, std, low, high, self.units[k], self.classes[k])
        raise KeyError(f"no parameter is called {name!r}; there are {'; '.join(self.labels)}")

    def to_dataframe(self) -> DataFrame:
        """A row a parameter: ``name``, ``label``, ``value``, ``std``, ``low``, ``high``, ``unit``, ``class``.

        An effect's name is its label: an offset that holds weight is not that without, which other tables have.
        """
        from pandas import DataFrame

        each = zip(self.names, self.labels, self.classes, strict=True)
        return DataFrame(
            {
                "name": [label if kind == "effect" else name for name, label, kind in each], "label": list(self.labels),
                "value": self.values, "std": self.std, "low": self.low, "high": self.high,
                "unit": list(self.units), "class": list(self.classes),
            }
        )  # fmt: skip

    def to_list(self) -> list[dict[str, Any]]:
        """The parameters for JSON: name, unit, value, ``std``, ``low``, ``high``, class, label; None where there is no number."""
        numbers = zip(*([_known(x) for x in v] for v in (self.values, self.std, self.low, self.high)), strict=True)
        return [
            {"name": name, "unit": unit, "value": value, "std": std, "low": low, "high": high, "class": kind, "label": label}
            for name, unit, (value, std, low, high), kind, label in zip(
                self.names, self.units, numbers, self.classes, self.labels, strict=True
            )
        ]

    def table(self, title: str = "parameter") -> ShownTable:
        """A line a parameter: label, value and interval to its second digit, unit, and a note where the prior decides."""
        rows = []
        for k, label in enumerate(self.labels):
            value, spread = with_interval(self.values[k], self.std[k], self.low[k], self.high[k])
            said = "no interval" if spread == DASH else "prior-driven" if self.classes[k] == "prior" else ""
            rows.append([label, joined(value, spread), self.units[k], said])
        return ShownTable([title, "value, 95 %", "unit", ""], rows, "w n ku -")


class HasParameters(ByName, ABC):
    """What results with parameters have in common; they give `parameters`."""

    @abstractmethod
    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then effect parameters, with central intervals of a probability.

        Raises
        ------
        InputError
            The level is no probability.
        """

    def __getitem__(self, name: str) -> EstimatedParameter:
        """A base or effect parameter with its 95 % interval, by its name or label: ``result["m2 r2x"]``.

        Raises
        ------
        KeyError
            There is none; the message lists the labels.
        """
        return self.parameters()[name]

    def conf_int(self, level: float = LEVEL) -> DataFrame:
        """Central intervals of a probability: ``low`` and ``high``, a row a parameter by its label, nan where there is none.

        Raises
        ------
        InputError
            The level is no probability.
        """
        return self.parameters(level).to_dataframe().set_index("label").loc[:, ["low", "high"]]

    def to_dataframe(self) -> DataFrame:
        """Base parameters, then effect parameters (class ``effect``), as `Parameters.to_dataframe`."""
        return self.parameters().to_dataframe()


def joined(value: str, spread: str) -> str:
    """``1.84 ± 0.22``, ``0.04 in 0 … 0.17`` or the value alone."""
    return value if spread == DASH else f"{value} in {spread}" if "…" in spread else f"{value} ± {spread}"


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
