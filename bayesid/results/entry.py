"""What one estimator made of the data in a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.results.files import strict
from bayesid.results.urdf_links import UrdfLinks
from bayesid.validation.prediction import Prediction

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class Entry:
    """What one estimator made of the data.

    Attributes
    ----------
    name
        The estimator's, made unique.
    description
        What it is, in one line.
    estimate
        None where the estimator refused; ``refusal`` says why.
    refusal
        Empty where there is an estimate.
    seconds
        Time of the fit alone; rows and noise are made once for all.
    links
        Link parameters (P,), those that `identify` writes: physically consistent; None without a robot.
    impossible
        Names of the bodies that cannot exist; None without ``links``.
    urdf
        How far these links are from the estimate; None where that is not known.
    fitted, validation
        Predictions of the fitted motions and of the others.
    """

    name: str
    description: str
    estimate: Estimate | None
    refusal: str = ""
    seconds: float = 0.0
    links: np.ndarray | None = None
    impossible: tuple[str, ...] | None = None
    urdf: UrdfLinks | None = None
    fitted: tuple[Prediction, ...] = ()
    validation: tuple[Prediction, ...] = ()

    def __repr__(self) -> str:
        return f"<Entry {self.name}: {'refused' if self.estimate is None else 'fitted'}>"

    @property
    def physically_consistent(self) -> bool | None:
        """Whether every link can exist; None where that is not known."""
        return None if self.impossible is None else not self.impossible

    @property
    def conflicting(self) -> bool:
        """Whether no links that can exist are within the estimate's uncertainty."""
        return self.urdf is not None and self.urdf.moved is not None and not self.urdf.moved.inside

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """Predictions of validation motions, or of the fitted ones where there is no other."""
        return self.validation or self.fitted

    def to_dict(self) -> dict[str, Any]:
        """The estimator's part of ``comparison.json``."""
        if self.estimate is None:
            return {"name": self.name, "status": "refused", "reason": self.refusal}
        estimate = self.estimate
        document = {k: v for k, v in estimate.to_dict().items() if k not in ("base_map", "link_parameter_names", "rank")}
        effects = document.pop("effect_parameters")
        predictions = {
            "link_parameters": None if self.links is None else self.links.tolist(),
            "physically_consistent": self.physically_consistent,
            "impossible_bodies": None if self.impossible is None else list(self.impossible),
            "identified_urdf": None if self.urdf is None else self.urdf.to_dict(),
            **self.predictions_to_dict(),
        }
        known = {k: v for k, v in predictions.items() if v is not None}
        return strict({"name": self.name, "status": "fitted", **document, "effects": effects, **known})

    def predictions_to_dict(self) -> dict[str, Any]:
        """Predictions; empty where there is no motion."""
        if not self.predictions:
            return {}
        return {"validation": [p.to_dict() for p in self.validation], "fit": [p.to_dict() for p in self.fitted]}


def equal_estimates(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Names of estimators whose values and covariance are equal to the last digit, a tuple for each set of two or more."""
    groups: dict[tuple[bytes, bytes | None], list[str]] = {}
    for entry in entries:
        if entry.estimate is not None:
            covariance = entry.estimate.full_covariance
            key = entry.estimate.solution.tobytes(), None if covariance is None else covariance.tobytes()
            groups.setdefault(key, []).append(entry.name)
    return [tuple(names) for names in groups.values() if len(names) > 1]


class _WithEntries(Protocol):
    @property
    def entries(self) -> tuple[Entry, ...]: ...

    @property
    def baselines(self) -> tuple[Entry, ...]: ...

    @property
    def estimates(self) -> dict[str, Estimate]: ...


class HasEntries:
    """Estimates by name and their tables, from ``entries`` and ``baselines``."""

    @property
    def estimates(self: _WithEntries) -> dict[str, Estimate]:
        """Estimates by the names of their estimators, without those that refused."""
        return {e.name: e.estimate for e in self.entries if e.estimate is not None}

    def same_as(self: _WithEntries, name: str) -> tuple[str, ...]:
        """Names of the other estimators whose values and covariance equal those of this one to the last digit."""
        return tuple(n for names in equal_estimates(self.entries) if name in names for n in names if n != name)

    def __getitem__(self: _WithEntries, name: str) -> Estimate:
        """The estimate of a name.

        Raises
        ------
        KeyError
            No estimator of that name took part, or it refused; the message says why.
        """
        if name not in self.estimates:
            refused = [e.refusal for e in self.entries if e.name == name]
            raise KeyError(f"{name} refused: {refused[0]}" if refused else f"{name}; there are {', '.join(self.estimates)}")
        return self.estimates[name]

    def to_dataframe(self: _WithEntries, of: Literal["parameters", "scores"] = "parameters") -> DataFrame:
        """Tables of what was compared.

        Parameters
        ----------
        of
            ``parameters``: those of all estimators below each other, ``method`` and then the columns of
            `Estimate.to_dataframe`. ``scores``: a row an estimator and motion, the nominal model's first: ``method``,
            ``motion``, ``role``, ``relative_error`` (all channels together, in the band), ``relative_error_raw``,
            ``whitened_rms``, ``expected_rms``, ``coverage`` and ``nrmse_fx`` ... by channel.

        Raises
        ------
        InputError
            It is neither.
        """
        from pandas import DataFrame, concat

        if of == "scores":
            entries = [e for e in (*self.baselines, *self.entries) if not e.refusal]
            return DataFrame(
                {
                    "method": e.name, "motion": p.motion, "role": p.role, "relative_error": p.relative_error,
                    "relative_error_raw": p.relative_error_raw, "whitened_rms": p.whitened_rms, "expected_rms": p.expected_rms,
                    "coverage": p.coverage, **{f"nrmse_{n}": v for n, v in zip(p.channel_names, p.nrmse, strict=True)},
                }
                for e in entries for p in (*e.fitted, *e.validation)
            )  # fmt: skip
        if of != "parameters":
            raise InputError(f"of = {of!r}: give 'parameters' or 'scores'")
        tables = {name: e.to_dataframe() for name, e in self.estimates.items()}
        return concat(tables, names=["method"]).reset_index(level="method").reset_index(drop=True)
