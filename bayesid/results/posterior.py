"""What ``sample`` found on an experiment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.posterior.result import Posterior
from bayesid.regression.problem import Problem
from bayesid.results.figures import PlotsPredictions
from bayesid.results.files import Result
from bayesid.validation.predicted_readings import PredictedReadings, predict_readings
from bayesid.validation.prediction import Prediction

if TYPE_CHECKING:
    pass

SCHEMA = 1


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentPosterior(PlotsPredictions, Posterior, Result):
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

    def predict(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None
    ) -> PredictedReadings:
        """Readings of any motion by the posterior's mean, with the 95 % band of its covariance; as `Identification.predict`."""
        columns = self.columns.reshape(-1, self.columns.shape[-1])
        nothing = np.zeros(columns.shape[1], bool)
        covariance = np.atleast_2d(np.cov(columns.T))
        return predict_readings(self.problem, columns.mean(axis=0), covariance, nothing, q, v, a, times)

    def to_dict(self) -> dict[str, Any]:
        """``posterior.json``."""
        filters, own = self.problem.row_model.filters, super().to_dict()
        return {
            "schema": SCHEMA,
            "experiment": self.problem.experiment.name,
            "prior_against_data": own["prior_against_data"],
            "channel": self.problem.channel,
            "motions": list(self.problem.fitted),
            "filter": {"l": None if filters is None else filters.l, "d": None if filters is None else filters.d},
            "inertia_rel_std": self.trust,
            **own,
            "fit": [p.to_dict() for p in self.fitted],
            "validation": [p.to_dict() for p in self.validation],
            "warnings": list(self.warnings),
            "runtime_s": self.seconds,
        }
