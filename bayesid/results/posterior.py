"""What ``sample`` found on an experiment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.estimators.attenuation import without_expected_error
from bayesid.estimators.parameters import Parameters, central_interval, tails
from bayesid.posterior.convert import write_netcdf
from bayesid.posterior.result import Posterior, moments
from bayesid.regression.problem import Problem, weight_columns
from bayesid.results.estimated import PlotsPredictions
from bayesid.results.files import SCHEMA, Files, Result
from bayesid.results.fitted_model import by_effect, filter_section, joint_dynamics, own_offset, own_values, robot_section
from bayesid.robot.urdf import JointDynamics, write_urdf
from bayesid.rounding import LEVEL
from bayesid.validation.predicted_readings import PredictedReadings, predict_readings
from bayesid.validation.prediction import Prediction

#: Attribute of the draws' group that keeps `ExperimentPosterior.expected_error`.
EXPECTED_ERROR = "expected_error_of_effects"


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
    expected_error
        What encoders' errors are expected to pull the effect parameters by (e,), in the draws of mounts and soft joints; None
        without these (`bayesid.estimators.attenuation`).
    """

    verb = "sample"
    problem: Problem = field(kw_only=True)
    fitted: tuple[Prediction, ...] = ()
    validation: tuple[Prediction, ...] = ()
    rel_std: float | None = None
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    expected_error: np.ndarray | None = None

    @explains_types
    def predict(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None) -> PredictedReadings:
        """Readings of any motion by the posterior's mean, with the 95 % band of its covariance; as `Identification.predict`."""
        _, mean, covariance = moments(self.columns)
        return predict_readings(self.problem, mean, covariance, np.zeros(len(mean), bool), q, v, a, times)

    @property
    def own_effect_draws(self) -> np.ndarray:
        """Draws of the effect parameters, less the weight of the drawn links and ``expected_error``, (chains, draws, e).

        As `effect_draws`, but for two. From the offset of a sensor no static run takes the weight: what looks like an offset is
        fitted as one. Weight stays where a flat prior draws no links. And mounts and soft joints are pulled by encoders' errors.
        """
        links, draws = self.link_draws, self.effect_draws
        return without_expected_error(draws if links is None else own_values(self.problem, draws, links), self.expected_error)

    def _attributes(self) -> dict[str, Any]:
        own = super()._attributes()
        return own if self.expected_error is None else {**own, EXPECTED_ERROR: self.expected_error}

    def to_arviz(self) -> Any:
        """As `Posterior.to_arviz`, with ``sensor_offset`` where links are drawn: the sensor's offset without their weight."""
        data, at = super().to_arviz(), weight_columns(self.problem.row_model)
        if at and self.link_draws is not None:
            from xarray import DataArray  # takes long to import

            own = DataArray(
                self.own_effect_draws[..., at], dims=("chain", "draw", "axis"), coords={"axis": list(WRENCH_NAMES[: len(at)])}
            )
            data["posterior"]["sensor_offset"] = own.assign_coords({k: data["posterior"][k] for k in ("chain", "draw")})
        return data

    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then effect parameters by `own_effect_draws`, with central intervals of a probability.

        A sensor's offset is without weight, by the nominal links where none are drawn.
        """
        found, rank = super().parameters(level), self.base.rank
        values, std, low, high = (x.copy() for x in (found.values, found.std, found.low, found.high))
        draws = np.concatenate(self.own_effect_draws)
        values[rank:], std[rank:] = draws.mean(axis=0), draws.std(axis=0, ddof=1)
        low[rank:], high[rank:] = np.quantile(draws, tails(level), axis=0)
        if self.link_draws is None:
            links = nearest_links(self.problem.experiment.robot, self.base, values[:rank])
            if (offset := own_offset(self.problem, values[rank:], std[rank:], links)) is not None:
                at = [rank + k for k in weight_columns(self.problem.row_model)]
                values[at], std[at] = offset
                low[at], high[at] = central_interval(*offset, level)
        return replace(found, values=values, std=std, low=low, high=high)

    def effects(self) -> list[dict[str, Any]]:
        """Every effect of the model with the means and standard deviations (None: fixed) of its parameters, and units."""
        own, rank = self.parameters(), self.base.rank
        found = by_effect(self.problem.row_model, own.values[rank:], own.std[rank:])
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
    mean, effects = links.mean(axis=(0, 1)), posterior.effect_draws.mean(axis=(0, 1))
    return mean, joint_dynamics(posterior.problem, mean, effects, np.ones(len(effects), bool))
