"""What an estimator takes and gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.stats import norm

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators.details import Details
from bayesid.regression.linalg import standard_deviations
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel

if TYPE_CHECKING:
    from pandas import DataFrame

#: Central probability of ``low`` to ``high``.
LEVEL = 0.95


class Estimator(Protocol):
    """Anything that turns a regression into an estimate; pass such an object wherever a method is named."""

    @property
    def name(self) -> str:
        """What the results call it."""
        ...

    def fit(self, regression: Regression) -> Estimate:
        """Estimate base and effect parameters."""
        ...


@dataclass(frozen=True)
class Estimate:
    """Estimated base parameters, effect parameters and how sure they are.

    Attributes
    ----------
    method
        The estimator's name.
    base
        What the base parameters are combinations of.
    effect_names, effect_units
        Effect parameters, estimated jointly.
    solution
        Base parameters, then effect parameters (p,).
    full_covariance
        Of ``solution`` (p, p); None where no honest one exists.
    undetermined
        Columns of ``solution`` that the data say nothing about (p,).
    weak
        Columns that the data determine no better than the size of a body (p,).
    interval
        ``confidence``, ``credible`` or ``none``, then ``interval_reason`` says why.
    noise
        Noise model of each group of rows.
    rows
        Number of scalar rows fitted.
    condition_number
        Of the weighted regressor with columns of unit length.
    residual_rms
        Of whitened rows; 1 when the noise model holds.
    whiteness
        Largest autocorrelation of whitened residuals over lags 1 ... 10, times sqrt(rows).
    details
        What the method chose, and why; one class for each family, `OwnDetails` for estimators of one's own.
    links
        Link parameters of its own (P,), ``base.matrix @ links == values``; None: the nearest to the nominal ones.
    possible
        Smallest and largest values that the estimator allows, where intervals end (2, p); None: any.
    """

    method: str
    base: BaseParameters
    effect_names: tuple[str, ...]
    effect_units: tuple[str, ...]
    solution: np.ndarray
    full_covariance: np.ndarray | None
    undetermined: np.ndarray
    weak: np.ndarray
    interval: str
    noise: dict[str, NoiseModel]
    rows: int
    condition_number: float
    residual_rms: float
    whiteness: float
    interval_reason: str = ""
    details: Details = Details()
    links: np.ndarray | None = None
    possible: np.ndarray | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.base.names

    @property
    def values(self) -> np.ndarray:
        """Base parameters (r,)."""
        return self.solution[: self.base.rank]

    @property
    def covariance(self) -> np.ndarray | None:
        """Of the base parameters (r, r); None where no honest one exists."""
        r = self.base.rank
        return None if self.full_covariance is None else self.full_covariance[:r, :r]

    @property
    def full_std(self) -> np.ndarray:
        """Standard deviations of ``solution`` (p,); nan where the data say nothing or none is honest."""
        if self.full_covariance is None:
            return np.full(len(self.solution), np.nan)
        return np.where(self.undetermined, np.nan, standard_deviations(self.full_covariance))

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of the base parameters (r,)."""
        return self.full_std[: self.base.rank]

    @property
    def full_low(self) -> np.ndarray:
        """Lower ends of the central 95 % intervals of ``solution`` (p,), cut off where nothing is possible."""
        ends = self.solution - norm.ppf(0.5 + LEVEL / 2) * self.full_std
        return ends if self.possible is None else np.clip(ends, *self.possible)

    @property
    def full_high(self) -> np.ndarray:
        """Upper ends of the central 95 % intervals of ``solution`` (p,), cut off where nothing is possible."""
        ends = self.solution + norm.ppf(0.5 + LEVEL / 2) * self.full_std
        return ends if self.possible is None else np.clip(ends, *self.possible)

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the intervals of the base parameters (r,)."""
        return self.full_low[: self.base.rank]

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the intervals of the base parameters (r,)."""
        return self.full_high[: self.base.rank]

    def _spreads(self) -> list[str]:
        """Intervals as text (p,): half their width, both ends where one is cut off, empty where there is none."""
        out = []
        for std, low, high in zip(self.full_std, self.full_low, self.full_high, strict=True):
            whole = np.isclose(high - low, 2 * 1.959964 * std, rtol=1e-6)
            text = f"± {1.96 * std:<10.3g}" if whole else f"in [{low:.3g}, {high:.3g}]"
            out.append(text if np.isfinite(std) else "")
        return out

    @property
    def classes(self) -> tuple[str, ...]:
        """``alone``, ``combination``, ``weak`` or ``prior`` for each base parameter."""
        several = np.count_nonzero(self.base.matrix, axis=1) > 1
        return tuple(
            "prior" if self.undetermined[i] else "weak" if self.weak[i] else "combination" if several[i] else "alone"
            for i in range(self.base.rank)
        )

    def to_dataframe(self) -> DataFrame:
        """Base parameters, then effect parameters (class ``effect``), as a table; see `parameter_table` for its columns."""
        return parameter_table(
            [*self.names, *self.effect_names], [*self.base.labels, *self.effect_names], self.solution, self.full_std,
            [*self.base.units, *self.effect_units], [*self.classes, *["effect"] * len(self.effect_names)],
        )  # fmt: skip

    def __repr__(self) -> str:
        return (
            f"<Estimate by {self.method}: {self.base.rank} base and {len(self.effect_names)} effect parameters "
            f"from {self.rows} rows>"
        )

    def __str__(self) -> str:
        """Table of the base and effect parameters."""
        lines = [f"{self.method}: {self.base.rank} base parameters, {self.rows} rows"]
        names = [*self.base.labels, *self.effect_names]
        units = [*self.base.units, *self.effect_units]
        width = min(max(map(len, names), default=0), 60)
        for name, value, spread, unit in zip(names, self.solution, self._spreads(), units, strict=True):
            lines.append(f"  {name[:60]:<{width}}  {value:>11.5g} {spread or '  (no interval)'} {unit}")
        if self.interval == "none":
            lines.append(f"  no intervals: {self.interval_reason}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """The same as an HTML table for notebooks."""
        names = [*self.base.labels, *self.effect_names]
        units = [*self.base.units, *self.effect_units]
        rows = ""
        for name, value, text, unit in zip(names, self.solution, self._spreads(), units, strict=True):
            spread = text.removeprefix("± ").strip()
            rows += f"<tr><td>{escape(name)}</td><td>{value:.5g}</td><td>{spread}</td><td>{unit}</td></tr>"
        return f"<table><tr><th>{self.method}</th><th>value</th><th>± 95 %</th><th>unit</th></tr>{rows}</table>"

    def to_dict(self) -> dict[str, Any]:
        """The estimate's part of ``estimate.json``."""
        covariance = None if self.covariance is None else self.covariance.tolist()
        base = [
            {
                "name": name,
                "unit": unit,
                "value": float(value),
                "std": _number(std),
                "low": _number(low),
                "high": _number(high),
                "class": kind,
                "label": label,
            }
            for name, unit, value, std, low, high, kind, label in zip(
                self.names, self.base.units, self.values, self.std, self.low, self.high, self.classes, self.base.labels,
                strict=True,
            )
        ]  # fmt: skip
        result: dict[str, Any] = {
            "method": self.method,
            "base_parameters": base,
            "interval": self.interval,
            "covariance": covariance,
            "full_covariance": None if self.full_covariance is None else self.full_covariance.tolist(),
            "full_covariance_names": [*self.names, *self.effect_names],
            "base_map": self.base.matrix.tolist(),
            "link_parameter_names": list(self.base.parameter_names),
            "rank": self.base.rank,
            "condition_number": _number(self.condition_number),
            "residual": {"whitened_rms": _number(self.residual_rms), "whiteness": _number(self.whiteness), "rows": self.rows},
            "details": self.details.to_dict(),
        }
        if self.interval_reason:
            result["interval_reason"] = self.interval_reason
        return result


def parameter_table(
    names: Sequence[str], labels: Sequence[str], values: np.ndarray, std: np.ndarray, units: Sequence[str],
    classes: Sequence[str], low: np.ndarray | None = None, high: np.ndarray | None = None,
) -> DataFrame:
    """Parameters as a table: ``name``, ``label``, ``value``, ``std``, ``low``, ``high``, ``unit``, ``class``, a row each.

    Parameters
    ----------
    names, labels, units, classes
        Texts (p,).
    values, std
        (p,); nan where there is no honest standard deviation.
    low, high
        Ends of the central 95 % intervals (p,); default those of a normal distribution.
    """
    from pandas import DataFrame

    half = norm.ppf(0.5 + LEVEL / 2) * std
    return DataFrame(
        {
            "name": list(names), "label": list(labels), "value": values, "std": std,
            "low": values - half if low is None else low, "high": values + half if high is None else high,
            "unit": list(units), "class": list(classes),
        }
    )  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def largest_autocorrelation(white: Sequence[np.ndarray], lags: int = 10) -> float:
    """Largest autocorrelation of white residuals (k, channels), in standard errors."""
    total = max(sum(len(w) for w in white), 1)
    power = sum(np.sum(w**2, axis=0) for w in white)
    worst = 0.0
    for lag in range(1, lags + 1):
        product = sum(np.sum(w[lag:] * w[:-lag], axis=0) for w in white if len(w) > lag)
        worst = max(worst, float(np.max(np.abs(product / np.maximum(power, 1e-300)))) * np.sqrt(total))
    return worst
