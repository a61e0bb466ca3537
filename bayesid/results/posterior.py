"""What ``sample`` found on an experiment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from bayesid.posterior.result import Posterior
from bayesid.regression.problem import Problem
from bayesid.results.files import Result
from bayesid.validation.prediction import Prediction

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class ExperimentPosterior(Posterior, Result):
    """The posterior of an experiment, with its predictions.

    Attributes
    ----------
    problem
        The experiment made ready.
    fitted, validation
        Predictions of the fitted motions and of the others by the posterior's mean and covariance.
    trust
        Relative standard deviation of the nominal bodies; None with a flat prior or one of the user's own.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    problem: Problem = field(kw_only=True)
    fitted: tuple[Prediction, ...] = ()
    validation: tuple[Prediction, ...] = ()
    trust: float | None = None
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """``posterior.json``."""
        filters = self.problem.row_model.filters
        return {
            "schema": SCHEMA,
            "experiment": self.problem.experiment.name,
            "channel": self.problem.channel,
            "motions": list(self.problem.fitted),
            "filter": {"l": None if filters is None else filters.l, "d": None if filters is None else filters.d},
            "inertia_rel_std": self.trust,
            **super().to_dict(),
            "fit": [p.to_dict() for p in self.fitted],
            "validation": [p.to_dict() for p in self.validation],
            "warnings": list(self.warnings),
            "runtime_s": self.seconds,
        }
