"""What ``sample`` found on an experiment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.posterior.convert import write_netcdf
from bayesid.posterior.result import Posterior
from bayesid.regression.problem import Problem
from bayesid.results.estimated import PlotsPredictions
from bayesid.results.files import SCHEMA, Files, Result
from bayesid.results.fitted_model import by_effect, filter_section, joint_dynamics, robot_section
from bayesid.robot.urdf import JointDynamics, write_urdf
from bayesid.validation.predicted_readings import PredictedReadings, predict_readings
from bayesid.validation.prediction import Prediction


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentPosterior(PlotsPredictions, Posterior, Result):
    """The posterior of an experiment, with its predictions.

    Attributes
    ----------
    problem
        The experiment made ready.
    fitted, validation
        Predictions of the fitted motions and of the others by the posterior's mean and covariance.
    rel_std
        Relative standard deviation of the nominal bodies; None with a flat prior or one of the user's own.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    verb = "sample"
    problem: Problem = field(kw_only=True)
    fitted: tuple[Prediction, ...] = ()
    validation: tuple[Prediction, ...] = ()
    rel_std: float | None = None
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    def predict(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None) -> PredictedReadings:
        """Readings of any motion by the posterior's mean, with the 95 % band of its covariance; as `Identification.predict`."""
        columns = self.columns.reshape(-1, self.columns.shape[-1])
        nothing = np.zeros(columns.shape[1], bool)
        covariance = np.atleast_2d(np.cov(columns.T))
        return predict_readings(self.problem, columns.mean(axis=0), covariance, nothing, q, v, a, times)

    def effects(self) -> list[dict[str, Any]]:
        """Every effect of the model with the means and standard deviations (None: fixed) of its parameters, and units."""
        draws = self.effect_draws
        found = by_effect(self.problem.row_model, draws.mean(axis=(0, 1)), draws.std(axis=(0, 1), ddof=1))
        return [
            {
                "name": effect.name, "where": effect.where,
                "parameters": {
                    key: {"value": float(value), "std": float(std) if np.isfinite(std) else None, "unit": unit}
                    for key, unit, value, std in zip(effect.parameters, effect.units, values, stds, strict=True)
                },
            }
            for effect, values, stds in found
        ]  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """What ``posterior.json`` holds."""
        problem, own = self.problem, super().to_dict()
        return {
            "schema": SCHEMA, "experiment": problem.experiment.name, "prior_against_data": own["prior_against_data"],
            "channel": problem.channel, "motions": list(problem.fitted), "robot": robot_section(problem.experiment),
            "effects": self.effects(), "filter": filter_section(problem.row_model), "inertia_rel_std": self.rel_std,
            **own,
            "fit": [p.to_dict() for p in self.fitted], "validation": [p.to_dict() for p in self.validation],
            "warnings": list(self.warnings), "runtime_s": self.seconds,
        }  # fmt: skip

    def _beside(self) -> Files:
        files: dict[str, Callable[[Path], Any]] = {"posterior.nc": lambda path: write_netcdf(self.to_arviz(), path)}
        if (found := posterior_robot(self)) is not None:
            files["identified.urdf"] = lambda path: write_urdf(self.problem.experiment.robot, found[0], path, found[1])
        return files


def posterior_robot(posterior: ExperimentPosterior) -> tuple[np.ndarray, JointDynamics] | None:
    """Links (P,), which can exist, and friction of a posterior's mean, its ``identified.urdf``; None where no links are drawn.

    The mean of bodies that can exist can exist: their pseudo-inertias are a convex set.
    """
    links = posterior.link_draws
    if links is None or not posterior.model.physical:
        return None
    effects = posterior.effect_draws.mean(axis=(0, 1))
    return links.mean(axis=(0, 1)), joint_dynamics(posterior.problem, effects, np.ones(len(effects), bool))
