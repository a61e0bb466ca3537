"""What ``identify`` found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.design.accuracy.certificate import CoverageCertificate
from bayesid.effects import Term, with_places
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.estimators.parameters import Parameters, central_interval
from bayesid.estimators.prior_check import PriorCheck, conflicts
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.recordings.parts import Motion
from bayesid.recordings.schema import EffectParameters, write_model
from bayesid.regression.parallel import in_order, one_blas_thread
from bayesid.regression.problem import Problem
from bayesid.results.estimated import HasEstimate, PlotsPredictions
from bayesid.results.files import SCHEMA, Files, Result
from bayesid.results.fitted_model import (
    UrdfLinks,
    by_effect,
    filter_section,
    fitted_model,
    impossible_bodies,
    joint_dynamics,
    noise_section,
    robot_section,
)
from bayesid.robot.urdf import write_urdf
from bayesid.rounding import LEVEL, channel_name
from bayesid.section import as_html, as_text
from bayesid.validation.agreement import Agreement
from bayesid.validation.noise_floor import NoiseFloor
from bayesid.validation.predicted_readings import PredictedReadings, predict_readings
from bayesid.validation.prediction import Prediction, of_signal, over_noise, predict, predict_elsewhere, still_predictable


@dataclass(frozen=True)
class NotShown:
    """What the fitted readings do not show, by why not."""

    motions: tuple[str, ...] = ()  # labels of combinations that other motions of this robot could show
    static_run: tuple[str, ...] = ()  # labels of those that subtracting the static run takes away, whatever the motion
    fitted_along: tuple[str, ...] = ()  # those of ``static_run`` that are shown where the run is fitted along
    effects: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # effects of the model that take them, by label
    invisible: tuple[str, ...] = ()  # names of parameters that no motion shows


@dataclass(frozen=True, eq=False)
class Identification(PlotsPredictions, HasEstimate, Result):
    """What `identify` found.

    Attributes
    ----------
    problem, estimate
        The model and its parameters.
    urdf
        Links and friction of ``identified.urdf``, and how far they are from the estimate.
    validation
        Predictions of the motions that were not fitted.
    agreements
        Comparisons of the data with themselves.
    static_alternative
        With a stop-and-go run subtracted: the estimate with the run fitted along instead, or None.
    offset
        Constant reading of the sensor (6,), its standard deviation (nan where the nominal mass it rests on has
        no stated standard deviation), or None without one.
    not_shown
        Parameters that the fitted readings do not show, by why not.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    prior_check
        How far the data are from the nominal links, where their prior is stated or the estimator takes it from the data.
    unconstrained_urdf
        Whether ``identified-unconstrained.urdf`` is written, too.
    certificate
        Coverage of the intervals on simulated twins, where `bayesid.accuracy` counted it.
    floor
        Noise that no model can remove, where something tells it.
    unusable
        Why the model, or its links, are of no use, and what to try: printed first, and the first of ``warnings``.
    """

    verb, report = "identify", "identification"
    problem: Problem
    estimate: Estimate
    urdf: UrdfLinks
    validation: tuple[Prediction, ...]
    agreements: tuple[Agreement, ...]
    static_alternative: Estimate | None
    offset: tuple[np.ndarray, np.ndarray] | None
    not_shown: NotShown
    warnings: tuple[str, ...]
    seconds: dict[str, float]
    prior_check: PriorCheck | None = None
    unconstrained_urdf: bool = False
    certificate: CoverageCertificate | None = None
    floor: NoiseFloor | None = None
    unusable: tuple[str, ...] = ()

    @property
    def unexcited(self) -> tuple[str, ...]:
        """Parameters that other motions of this robot could show and these cannot."""
        return self.not_shown.motions

    @cached_property
    def fitted(self) -> tuple[Prediction, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Predictions of the fitted motions, made when they are first asked for."""
        problem = self.problem
        motions = [m for m in problem.experiment.motions if m.name in problem.fitted]
        with one_blas_thread():
            return tuple(in_order(lambda motion: predict(problem, self.estimate, motion, self.floor), motions))

    @property
    def link_parameters(self) -> np.ndarray:
        """Ten parameters a body (10 b,), those of ``identified.urdf``: physically consistent, ``urdf`` says how near."""
        return self.urdf.links

    @property
    def physically_consistent(self) -> bool:
        """Whether every link of ``link_parameters`` can exist."""
        return not impossible_bodies(self.link_parameters.reshape(-1, 10), self.problem.experiment.robot.body_names)

    @explains_types
    def predict(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None) -> PredictedReadings:
        """Readings of any motion, friction and other effects included, with their 95 % band.

        Parameters
        ----------
        q, v, a
            Joint positions, velocities and accelerations as the encoders say (N, n), or (n,) for one sample [rad or m, and
            per second (squared)].
        times
            (N,) [s]; needed only with effects to which time matters.

        Returns
        -------
        PredictedReadings
            ``values``, ``std``, ``low`` and ``high`` (N, c) [N, N m], in the order of its ``channel_names`` (c,).

        Raises
        ------
        InputError
            Shapes do not fit, values are not finite, or times are missing.
        """
        e = self.estimate
        return predict_readings(self.problem, e.solution, e.full_covariance, e.undetermined, q, v, a, times)

    def validate(self, other: Experiment | Motion | str | Path) -> tuple[Prediction, ...]:
        """Predict recordings that were not part of this, of another day for example, with this estimate as it is.

        Parameters
        ----------
        other
            An experiment of the same robot with the same readings, its folder, or one recording.

        Returns
        -------
        predictions
            One for each motion that has the readings: `Prediction.relative_error`, ``whitened_rms``, ``residuals`` and more.

        Raises
        ------
        InputError
            The joints differ, or no motion has the readings that were fitted.
        """
        problem = self.problem
        given = replace(problem.experiment, motions=(other,)) if isinstance(other, Motion) else as_experiment(other, "a Motion")
        with one_blas_thread():
            return predict_elsewhere(problem, self.estimate, given)

    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then every effect as in ``estimate.json``, with central intervals of a probability.

        Raises
        ------
        InputError
            The level is no probability.
        """
        base, rank, model = self.estimate.parameters(level), self.base.rank, self.problem.row_model
        values, std, low, high = np.full((4, len(model.free)), np.nan)
        low[model.free], high[model.free] = base.low[rank:], base.high[rank:]
        for (effect, at), (term, own) in zip(with_places(model.effects), self._fitted_effects(), strict=True):
            values[at], std[at] = term.values, own
            if effect.absorbs_weight and self.offset is not None:
                low[at], high[at] = central_interval(values[at], own, level)
        names = [name for effect in model.effects for name in effect.column_names]
        units = [unit for effect in model.effects for unit in effect.units]
        return Parameters(
            [*self.names, *names], [*self.base.labels, *names], np.append(base.values[:rank], values),
            np.append(base.std[:rank], std), np.append(base.low[:rank], low), np.append(base.high[:rank], high),
            [*self.base.units, *units], [*self.estimate.classes, *["effect"] * len(names)],
        )  # fmt: skip

    def __repr__(self) -> str:
        p = self.problem
        return (
            f"<Identification of {p.experiment.name} by {self.estimate.method}: {self.base.rank} base parameters from the "
            f"{channel_name(p.channel)} of {', '.join(p.fitted)}>"
        )

    def __str__(self) -> str:
        """Summary with the table of parameters."""
        e = self.estimate
        head = f"{e.method}: {e.base.rank} base parameters, {e.rows} rows"
        return "\n".join([summary(self), "", head, *as_text([self.parameters().table(), *e.no_intervals])])

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        e = self.estimate
        return f"<pre>{escape(summary(self))}</pre>{as_html([self.parameters().table(e.method), *e.no_intervals])}"

    def to_dict(self) -> dict[str, Any]:
        """What ``estimate.json`` holds."""
        problem, nominal = self.problem, self.problem.regression.knowledge.nominal_links
        smoother, tried = problem.smoother, problem.bandwidths
        return {
            "schema": SCHEMA, "experiment": problem.experiment.name,
            "prior_against_data": None if self.prior_check is None else self.prior_check.to_dict(),
            "channel": problem.channel, "motions": list(problem.fitted), "robot": robot_section(problem.experiment),
            "static": problem.static,
            "filter": {
                **filter_section(problem.row_model), "bandwidth_hz": smoother.bandwidth,
                "row_rate_hz": 1.0 / problem.row_model.step, "reason": smoother.reason,
                "bandwidths_tried": None if tried is None else {
                    "bandwidth_hz": tried.bandwidths.tolist(), "error_over_first": np.sqrt(tried.error).tolist(),
                },
            },
            **self.estimate.to_dict(),
            "link_parameters": self.link_parameters.tolist(), "nominal_links": None if nominal is None else nominal.tolist(),
            "effects": self.effects(), "physically_consistent": self.physically_consistent,
            "identified_urdf": self.urdf.to_dict(), "unexcited": list(self.unexcited),
            "lost_to_static_run": list(self.not_shown.static_run),
            "lost_to_effects": {label: list(effects) for label, effects in self.not_shown.effects.items()},
            "noise_std": noise_section(self.estimate.noise, problem.row_model.channels.names),
            "fit": [p.to_dict() for p in self.fitted], "validation": [p.to_dict() for p in self.validation],
            "agreement": [a.to_dict() for a in self.agreements], "warnings": list(self.warnings), "runtime_s": self.seconds,
            **({} if self.certificate is None else {"certificate": self.certificate.to_dict()}),
        }  # fmt: skip

    def _beside(self) -> Files:
        robot, urdf = self.problem.experiment.robot, self.urdf
        files = {"identified.urdf": lambda path: write_urdf(robot, urdf.links, path, urdf.dynamics)}
        if self.unconstrained_urdf:
            e, rank = self.estimate, self.base.rank
            along = joint_dynamics(self.problem, urdf.unconstrained, e.solution[rank:], ~e.undetermined[rank:])
            files["identified-unconstrained.urdf"] = lambda path: write_urdf(robot, urdf.unconstrained, path, along)
        effects, values = self.model
        expressions = self.problem.experiment.library.expressions
        return files | {"model.toml": lambda path: write_model(effects, values, path, expressions)}

    def certified(self, certificate: CoverageCertificate) -> Identification:
        """The same with coverage that `bayesid.accuracy` found, to be written into ``estimate.json`` and the report.

        Raises
        ------
        InputError
            It is of other base parameters.
        """
        if certificate.names != self.names:
            raise InputError("the certificate is of other base parameters; make it from this identification")
        return replace(self, certificate=certificate)

    def effects(self) -> list[dict[str, Any]]:
        """Every effect of the model with values, standard deviations and 95 % intervals (None without) and units."""
        entries = self.parameters().to_list()[self.base.rank :]
        return [
            {
                "name": effect.name, "where": effect.where,
                "parameters": {
                    key: {k: entry[k] for k in ("value", "std", "low", "high", "unit")}
                    for key, entry in zip(effect.parameters, entries[at], strict=True)
                },
            }
            for effect, at in with_places(self.problem.row_model.effects)
        ]  # fmt: skip

    @property
    def model(self) -> tuple[tuple[str, ...], EffectParameters]:
        """The model that was fitted, with the effects' values found: what ``model.toml`` holds."""
        terms = [term for term, _ in self._fitted_effects()]
        return fitted_model(self.problem.experiment, self.problem.effects, terms)

    def _fitted_effects(self) -> list[tuple[Term, np.ndarray]]:
        """Every effect with its values, and their standard deviations (k,), nan where there is none."""
        rank, e, out = self.base.rank, self.estimate, []
        for effect, *found in by_effect(self.problem.row_model, e.unbiased[rank:], e.unbiased_std[rank:]):
            values, std = self.offset if effect.absorbs_weight and self.offset is not None else found
            out.append((Term(effect, tuple(values)), std))
        return out


@explains_types
def summary(result: Identification) -> str:
    """A few lines for the terminal."""
    e, p, first = result.estimate, result.problem, [*result.unusable, *conflicts(result.prior_check)]
    lines = [
        *(f"warning: {text}" for text in first),
        f"{p.experiment.name}: {e.base.rank} base parameters from the {channel_name(p.channel)} of {', '.join(p.fitted)} "
        f"({e.method})",
        f"  bandwidth of the motion {p.smoother.bandwidth:.3g} Hz ({p.smoother.reason})",
    ]
    for prediction in (*result.fitted, *result.validation):
        lines.append(
            f"  {prediction.role} '{prediction.motion}': error {100 * prediction.relative_error:.3g} % of {of_signal(prediction)}"
            f"{'' if prediction.poses else f' ({100 * prediction.relative_error_raw:.3g} % raw)'}, residual "
            f"{over_noise(prediction)}"
        )
        if prediction.flexible is not None:
            lines.append(f"    {still_predictable(prediction)}")
    lines += [f"  warning: {w}" for w in result.warnings if w not in first]
    return "\n".join(lines)
