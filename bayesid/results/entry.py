"""What one estimator made of the data in a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.estimators import Estimate
from bayesid.results.files import strict
from bayesid.results.urdf_links import UrdfLinks
from bayesid.validation.prediction import Prediction


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
    def proof(self) -> tuple[Prediction, ...]:
        """Predictions of validation motions, or of the fitted ones where there is no other."""
        return self.validation or self.fitted

    def to_dict(self) -> dict[str, Any]:
        """The estimator's part of ``comparison.json``."""
        if self.estimate is None:
            return {"name": self.name, "status": "refused", "reason": self.refusal}
        estimate = self.estimate
        document = {k: v for k, v in estimate.to_dict().items() if k not in ("base_map", "link_parameter_names", "rank")}
        effects = document.pop("effect_parameters")
        proof = {
            "link_parameters": None if self.links is None else self.links.tolist(),
            "physically_consistent": self.physically_consistent,
            "impossible_bodies": None if self.impossible is None else list(self.impossible),
            "identified_urdf": None if self.urdf is None else self.urdf.to_dict(),
            **self.proof_to_dict(),
        }
        known = {k: v for k, v in proof.items() if v is not None}
        return strict({"name": self.name, "status": "fitted", **document, "effects": effects, **known})

    def proof_to_dict(self) -> dict[str, Any]:
        """Predictions; empty where there is no motion."""
        if not self.proof:
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
