"""What an estimator takes, gives and says of its own work: details in one class for each family, all with the same beginning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Protocol

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.estimators.parameters import HasParameters, Parameters, central_interval
from bayesid.regression.linalg import standard_deviations
from bayesid.regression.regression import Regression
from bayesid.rounding import LEVEL
from bayesid.section import as_html, as_text
from bayesid.signals.noise import NoiseModel

#: Marks a field that ``to_dict`` leaves out while it is None.
OPTIONAL = {"optional": True}


@dataclass(frozen=True, kw_only=True)
class Details:
    """What every estimator says."""

    #: Whether generalised and channel-weighted least squares agree, so that residuals are noise alone; None: not tested. And the
    #: probability of a difference as large as theirs when the model is complete.
    model_complete: bool | None = field(default=None, metadata=OPTIONAL)
    agreement_of_gls_and_wls: float | None = field(default=None, metadata=OPTIONAL)
    #: Factor that covariances have for model error: how much more the fit scatters between parts of the recording than noise
    #: explains; 1 where noise does. And that of each channel's readings, of which it is the mean; None where the model is
    #: complete, or noise explains it.
    dispersion: float | None = field(default=None, metadata=OPTIONAL)
    dispersion_by_channel: Mapping[str, float] | None = field(default=None, metadata=OPTIONAL)
    warnings: tuple[str, ...] = ()  # what the user should know before using the estimate

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``estimate.json``; warnings only where there are any."""
        out = as_plain(self)
        if not self.warnings:
            del out["warnings"]
        return out


@dataclass(frozen=True, kw_only=True)
class CustomDetails(Details):
    """Details of an estimator of one's own, by name.

    Attributes
    ----------
    entries
        Plain values.
    """

    entries: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """The entries, after what every estimator says."""
        out = super().to_dict()
        entries = out.pop("entries")
        return {**out, **entries}


def as_plain(value: Any) -> Any:
    """Dataclasses and mappings as dictionaries, tuples as lists; a class with another ``to_dict`` decides for itself."""
    if is_dataclass(value) and not isinstance(value, type):
        out = {}
        for f in fields(value):
            entry = getattr(value, f.name)
            if entry is not None or not f.metadata.get("optional"):
                own = getattr(entry, "to_dict", None)
                out[f.metadata.get("key", f.name)] = as_plain(entry) if own is None else own()
        return out
    if isinstance(value, Mapping):
        return {key: as_plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [as_plain(entry) for entry in value]
    return value


class Estimator(Protocol):
    """Anything that turns a regression into an estimate; pass such an object wherever a method is named."""

    @property
    def name(self) -> str:
        """What the results call it."""
        ...

    def fit(self, regression: Regression) -> Estimate:
        """Estimate base and effect parameters."""
        ...


@dataclass(frozen=True, eq=False)
class Estimate(HasParameters):
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
        Of ``solution`` (p, p); None where no honest one exists. Singular where the data determine only sums of parameters,
        such as a link's and a rotor's inertia about one axis: that of the sums is in it, along what they leave open it is zero.
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
        What the method chose, and why; one class for each family, `CustomDetails` for estimators of one's own.
    links
        Link parameters of its own (P,), ``base.matrix @ links == values``; None: the nearest to the nominal ones.
    possible
        Smallest and largest values that the estimator allows, where intervals end (2, p); None: any.
    expected_error
        What encoders' errors are expected to add to ``solution`` (p,), of effects that make much of them
        (`bayesid.estimators.attenuation`). `parameters` are without it; predictions are made with ``solution``, as it was fitted.
        None: nothing.
    held_covariance
        What the covariance of ``solution`` is larger by because shapes of effects, which were to be estimated, are held where the
        fit stopped, but may be anything plausible (p, p) (`bayesid.estimators.held_shapes`). `parameters` count it; predictions,
        of motions like those fitted, do not. None: nothing is held.
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
    expected_error: np.ndarray | None = None
    held_covariance: np.ndarray | None = None

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
        """Covariance of the base parameters (r, r); None where no honest one exists."""
        r = self.base.rank
        return None if self.full_covariance is None else self.full_covariance[:r, :r]

    def stated_covariance(self) -> np.ndarray:
        """``full_covariance`` with ``held_covariance``; an `InputError` with the reason where there is none."""
        if self.full_covariance is None:
            raise InputError(f"{self.method} has no covariance: {self.interval_reason}")
        return self.full_covariance if self.held_covariance is None else self.full_covariance + self.held_covariance

    @property
    def full_std(self) -> np.ndarray:
        """Standard deviations of ``solution`` (p,); nan where the data say nothing or none is honest."""
        if self.full_covariance is None:
            return np.full(len(self.solution), np.nan)
        return np.where(self.undetermined, np.nan, standard_deviations(self.full_covariance))

    @property
    def unbiased(self) -> np.ndarray:
        """``solution`` less ``expected_error`` (p,)."""
        return self.solution if self.expected_error is None else self.solution - self.expected_error

    @property
    def unbiased_std(self) -> np.ndarray:
        """Standard deviations of ``unbiased`` (p,): an expected error is known about to its own size, and shapes may be held."""
        error = 0.0 if self.expected_error is None else self.expected_error
        held = 0.0 if self.held_covariance is None else standard_deviations(self.held_covariance)
        return np.sqrt(self.full_std**2 + error**2 + held**2)

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of the base parameters (r,)."""
        return self.full_std[: self.base.rank]

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the central 95 % intervals of the base parameters (r,), cut off where nothing is possible."""
        return self.parameters().low[: self.base.rank]

    @property
    def high(self) -> np.ndarray:
        """Upper ends of these intervals (r,)."""
        return self.parameters().high[: self.base.rank]

    @property
    def classes(self) -> tuple[str, ...]:
        """``alone``, ``combination``, ``weak`` or ``prior`` for each base parameter."""
        several = np.count_nonzero(self.base.matrix, axis=1) > 1
        return tuple(
            "prior" if self.undetermined[i] else "weak" if self.weak[i] else "combination" if several[i] else "alone"
            for i in range(self.base.rank)
        )

    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then effect parameters, with central intervals of a probability, cut off where nothing is possible."""
        names = list(self.effect_names)
        return Parameters(
            [*self.names, *names], [*self.base.labels, *self.base.effect_labels(names)], self.unbiased, self.unbiased_std,
            *central_interval(self.unbiased, self.unbiased_std, level, self.possible),
            [*self.base.units, *self.effect_units], [*self.classes, *["effect"] * len(names)],
        )  # fmt: skip

    def __repr__(self) -> str:
        return (
            f"<Estimate by {self.method}: {self.base.rank} base and {len(self.effect_names)} effect parameters "
            f"from {self.rows} rows>"
        )

    def __str__(self) -> str:
        """Table of the base and effect parameters."""
        head = f"{self.method}: {self.base.rank} base parameters, {self.rows} rows"
        return "\n".join([head, *as_text([self.parameters().table(), *self.no_intervals])])

    def _repr_html_(self) -> str:
        """The same as an HTML table for notebooks."""
        return as_html([self.parameters().table(self.method), *self.no_intervals])

    @property
    def no_intervals(self) -> tuple[str, ...]:
        """Why there are no intervals, a line; empty where there are."""
        return (f"no intervals: {self.interval_reason}",) if self.interval == "none" else ()

    def to_dict(self) -> dict[str, Any]:
        """The estimate's part of ``estimate.json``."""
        covariance = None if self.covariance is None else self.covariance.tolist()
        parameters = self.parameters().to_list()
        result: dict[str, Any] = {
            "method": self.method,
            "base_parameters": parameters[: self.base.rank],
            "effect_parameters": parameters[self.base.rank :],
            "interval": self.interval,
            "covariance": covariance,
            "full_covariance": None if self.full_covariance is None else self.full_covariance.tolist(),
            "full_covariance_names": [*self.names, *self.effect_names],
            "expected_error": None if self.expected_error is None else self.expected_error.tolist(),
            "held_covariance": None if self.held_covariance is None else self.held_covariance.tolist(),
            "base_map": self.base.matrix.tolist(),
            "weight_in_offset": self.base.absorbed.tolist() if self.base.absorbed is not None else None,
            "link_parameter_names": list(self.base.parameter_names),
            "rank": self.base.rank,
            "condition_number": _number(self.condition_number),
            "residual": {"whitened_rms": _number(self.residual_rms), "whiteness": _number(self.whiteness), "rows": self.rows},
            "details": self.details.to_dict(),
        }
        if self.interval_reason:
            result["interval_reason"] = self.interval_reason
        return result


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def largest_autocorrelation(white: Sequence[np.ndarray]) -> float:
    """Largest autocorrelation of white residuals (k, channels) at lags up to ten, in standard errors."""
    total = max(sum(len(w) for w in white), 1)
    power = sum(np.sum(w**2, axis=0) for w in white)
    worst = 0.0
    for lag in range(1, 11):
        product = sum(np.sum(w[lag:] * w[:-lag], axis=0) for w in white if len(w) > lag)
        worst = max(worst, float(np.max(np.abs(product / np.maximum(power, 1e-300)))) * np.sqrt(total))
    return worst


def strongest(regression: Regression, direction: np.ndarray, size: np.ndarray) -> str:
    """Name of the parameter that a direction of parameters (p,) moves most, in units of their sizes (p,)."""
    return [*regression.base.labels, *regression.effect_names][int(np.argmax(np.abs(direction) / size))]
