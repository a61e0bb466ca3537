"""The verbs: each a short composition of the modules below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.dynamics.base_parameters import BaseParameters, structural_base
from bayesid.dynamics.nearest_links import nearest_links
from bayesid.estimators import DEFAULT_METHOD, Estimate, Estimator, estimator
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.experiment import Experiment, load_experiment
from bayesid.regression.problem import Problem, prepare
from bayesid.report import identification_report
from bayesid.results.files import write_results
from bayesid.robot import inertia
from bayesid.robot.urdf import write_urdf
from bayesid.signals.filters import LowPass
from bayesid.validation.cross_checks import Agreement, motions_apart, static_both_ways, wrench_against_torque
from bayesid.validation.prediction import Prediction, predict, relative_error
from bayesid.workflows.progress import Clock, Progress, quiet

SCHEMA = 1
#: Whitened residuals on a motion that was not fitted above this say that something is missing in the model.
TOLERATED = 1.15


@dataclass(frozen=True)
class Identification:
    """What `identify` found.

    Attributes
    ----------
    problem, estimate
        The model and its parameters.
    link_parameters
        Those of the estimator, or the nearest to the nominal ones with these base parameters (10 bodies,).
    fitted, validation
        Predictions of the fitted motions and of the others.
    agreements
        Comparisons of the data with themselves.
    static_alternative
        With a stop-and-go run subtracted: the estimate with the run fitted along instead, or None.
    offset
        Constant reading of the sensor (6,), its standard deviation (nan where the nominal mass it rests on has
        no stated trust), or None without one.
    unexcited
        Parameters that other motions of this robot could show and these cannot.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    problem: Problem
    estimate: Estimate
    link_parameters: np.ndarray
    fitted: tuple[Prediction, ...]
    validation: tuple[Prediction, ...]
    agreements: tuple[Agreement, ...]
    static_alternative: Estimate | None
    offset: tuple[np.ndarray, np.ndarray] | None
    unexcited: tuple[str, ...]
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.estimate.names

    @property
    def values(self) -> np.ndarray:
        """Base parameters (r,)."""
        return self.estimate.values

    @property
    def std(self) -> np.ndarray:
        """Their standard deviations (r,)."""
        return self.estimate.std

    @property
    def covariance(self) -> np.ndarray | None:
        """Their covariance (r, r)."""
        return self.estimate.covariance

    @property
    def base(self) -> BaseParameters:
        """What they are combinations of."""
        return self.estimate.base

    @property
    def physically_consistent(self) -> bool:
        """Whether every link of ``link_parameters`` can exist."""
        bodies = self.link_parameters.reshape(-1, 10)
        # A frame without mass in the URDF, that the motion cannot weigh, is no body.
        heavy = np.abs(bodies).max(axis=1) > 1e-9
        return bool(inertia.is_physically_consistent(bodies[heavy]).all())

    def __str__(self) -> str:
        """Summary with the table of parameters."""
        return f"{summary(self)}\n\n{self.estimate}"

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        return f"<pre>{summary(self)}</pre>{self.estimate._repr_html_()}"

    def to_dict(self) -> dict[str, Any]:
        """``estimate.json``."""
        filters, smoother = self.problem.row_model.filters, self.problem.smoother
        return {
            "schema": SCHEMA,
            "experiment": self.problem.experiment.name,
            "channel": self.problem.channel,
            "motions": list(self.problem.fitted),
            "static": self.problem.static,
            "filter": {
                "l": None if filters is None else filters.l,
                "d": None if filters is None else filters.d,
                "bandwidth_hz": smoother.bandwidth,
                "row_rate_hz": 1.0 / self.problem.row_model.step,
                "reason": smoother.reason,
            },
            **self.estimate.to_dict(),
            "link_parameters": self.link_parameters.tolist(),
            "effects": self._effects(),
            "physically_consistent": self.physically_consistent,
            "unexcited": list(self.unexcited),
            "noise_std": {
                group: dict(zip(self.problem.row_model.channels.names, map(float, model.std), strict=True))
                for group, model in self.estimate.noise.items()
            },
            "fit": [p.to_dict() for p in self.fitted],
            "validation": [p.to_dict() for p in self.validation],
            "agreement": [a.to_dict() for a in self.agreements],
            "warnings": list(self.warnings),
            "runtime_s": self.seconds,
        }

    def _effects(self) -> list[dict[str, Any]]:
        row_model = self.problem.row_model
        values = np.zeros(len(row_model.free)) if row_model.point is None else row_model.point.values.copy()
        stds = np.full(len(row_model.free), np.nan)
        values[row_model.free] = self.estimate.solution[self.base.rank :]
        stds[row_model.free] = self.estimate.full_std[self.base.rank :]
        out, column = [], 0
        for effect in row_model.effects:
            parameters = {}
            for k, (key, unit) in enumerate(zip(effect.kind.parameters, effect.units, strict=True)):
                value, std = values[column], stds[column]
                if effect.name == "sensor_offset" and self.offset is not None:
                    value, std = self.offset[0][k], self.offset[1][k]
                parameters[key] = {"value": float(value), "std": float(std) if np.isfinite(std) else None, "unit": unit}
                column += 1
            out.append({"name": effect.name, "where": effect.where, "parameters": parameters})
        return out

    def write(self, folder: str | Path) -> Path:
        """Write ``estimate.json``, ``identified.urdf`` and ``report.html``; returns the report's path."""
        return write_results(
            folder,
            {"estimate.json": self.to_dict()},
            {"identified.urdf": lambda path: write_urdf(self.problem.experiment.robot, self.link_parameters, path)},
            identification_report(self),
        )


def identify(
    experiment: Experiment | str | Path,
    channel: str | None = None,
    method: str | Estimator = DEFAULT_METHOD,
    *,
    low_pass: LowPass | None = None,
    motions: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    static: str = "motion",
    bandwidth: float | None = None,
    progress: Progress = quiet,
) -> Identification:
    """Base parameters with uncertainty, link parameters, and proof on the validation motions.

    Parameters
    ----------
    experiment
        Loaded, or its folder.
    channel
        ``wrench``, ``torque`` or ``both``; default the wrench where there is a sensor, else the torques.
    method
        Name of an estimator, or an object with ``fit(regression)``.
    low_pass
        The paper's filters; default: rows straight from the smoothed trajectory.
    motions
        Which motions to fit; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    static
        ``motion`` subtracts a stop-and-go run, ``joint`` fits it along.
    bandwidth
        Of the joint motion [Hz]; default chosen from the positions.
    progress
        Called with the name of every stage.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    method = estimator(method)
    clock = Clock(progress)
    # The matrices are small: threads inside the linear algebra cost more than they gain here.
    with threadpool_limits(1, user_api="blas"):
        clock("reading")
        if not isinstance(experiment, Experiment):
            experiment = load_experiment(experiment)
        clock("regressor")
        problem = prepare(
            experiment, channel, filters=low_pass, motions=motions, effects=effects, static=static, bandwidth=bandwidth
        )
        for _ in problem.regression.blocks():
            pass
        clock("estimate")
        problem, estimate = solve(problem, method)
        clock("prediction")
        predictions = [predict(problem, estimate, m) for m in experiment.motions if m.name in problem.segments]
        clock("consistency")
        agreements = motions_apart(problem, method)
        alternative = static_both_ways(problem, method)
        if problem.channel == "both":
            across = wrench_against_torque(problem, method)
            agreements += [across] if across is not None else []
        kept = ~estimate.undetermined[: problem.row_model.base.rank]
        links = estimate.links
        if links is None:
            links = nearest_links(experiment.robot, problem.row_model.base, estimate.values, kept)
        unexcited = _unexcited(problem, estimate)
    result = Identification(
        problem=problem,
        estimate=estimate,
        link_parameters=links,
        fitted=tuple(p for p in predictions if p.motion in problem.fitted),
        validation=tuple(p for p in predictions if p.motion not in problem.fitted and p.role == "validation"),
        agreements=tuple(agreements),
        static_alternative=alternative,
        offset=_offset(problem, estimate, links),
        unexcited=unexcited,
        warnings=(),
        seconds=clock.stop(),
    )
    return Identification(**{**result.__dict__, "warnings": _warnings(result)})


def _unexcited(problem: Problem, estimate: Estimate) -> tuple[str, ...]:
    """Base parameters of a rich motion that these motions do not show, and those the data say nothing about."""
    row_model = problem.row_model
    rich = structural_base(row_model.robot, row_model.channels, offset=row_model.base.absorbed is not None)
    if len(rich.names) > row_model.base.rank:
        seen = np.linalg.lstsq(row_model.base.matrix.T, rich.matrix.T, rcond=None)[0].T @ row_model.base.matrix
        hidden = np.linalg.norm(seen - rich.matrix, axis=1) > 1e-6 * np.linalg.norm(rich.matrix, axis=1)
        return tuple(label for label, h in zip(rich.labels, hidden, strict=True) if h)
    kinds = estimate.classes
    return tuple(label for label, kind in zip(row_model.base.labels, kinds, strict=True) if kind in ("weak", "prior"))


def _offset(problem: Problem, estimate: Estimate, links: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The sensor's offset, freed from the weight that looks like one, which only the nominal model knows."""
    names = [n for n in estimate.effect_names if n.startswith("sensor_offset@")]
    if not names:
        return None
    at = [estimate.base.rank + estimate.effect_names.index(n) for n in names]
    value, std = estimate.solution[at].copy(), estimate.full_std[at].copy()
    absorbed = problem.row_model.base.absorbed
    if absorbed is not None:
        rows = absorbed[: len(at)]
        value -= rows @ links
        trust = problem.experiment.inertia_rel_std
        share = np.sqrt(np.sum((rows * links).reshape(len(rows), -1, 10).sum(axis=2) ** 2, axis=1))
        unknown = share > 1e-9
        std = np.where(unknown, np.nan if trust is None else np.hypot(std, (trust or 0.0) * share), std)
    return value, std


def _warnings(result: Identification) -> tuple[str, ...]:
    """What the user should know, most important first."""
    out = []
    for p in result.validation:
        if p.repeats:
            out.append(f"Motion '{p.motion}' repeats the fitted motion '{p.repeats}': its error says little about other motions.")
        if p.whitened_rms > TOLERATED:
            worst = int(np.argmax(p.whitened_rms_by_channel))
            out.append(
                f"Motion '{p.motion}' is not predicted to the noise: residuals are {p.whitened_rms:.3g} times as large "
                f"(most in {p.channel_names[worst]}, {p.whitened_rms_by_channel[worst]:.3g} times; relative error "
                f"{100 * relative_error(p):.3g} %). The model misses something there; the intervals do not cover that."
            )
    if not result.validation:
        out.append("No validation motion: nothing proves that the estimate holds for another motion.")
    for a in result.agreements:
        if a.contradiction:
            out.append(
                f"{a.first[0].upper()}{a.first[1:]} and {a.second} contradict each other: {a.rms:.3g} sigma rms over "
                f"{a.compared} numbers; most in {a.worst}. They are not noise apart; do not average them."
            )
    if result.estimate.details.get("model_complete") is False:
        out.append(
            "Efficient and plain least squares differ by more than the noise explains: something is missing in the model. "
            "Model error is counted as noise, so intervals hold for motions like the fitted ones only."
        )
    # What the estimator itself has to say, such as weak instruments.
    out += result.estimate.details.get("warnings", [])
    if result.unexcited:
        shown = ", ".join(result.unexcited[:6]) + (f" and {len(result.unexcited) - 6} more" if len(result.unexcited) > 6 else "")
        lost = " (the static run takes gravity with it)" if result.problem.static == "motion" else ""
        out.append(f"Not excited by these motions{lost}: {shown}. The data say no more there than the size of a body does.")
    if not result.physically_consistent:
        out.append(
            "The link parameters nearest to the nominal ones are not those of a body that can exist; do not simulate with them."
        )
    if result.problem.row_model.base.absorbed is not None:
        out.append(
            "No static run removes the sensor's offset, so it is estimated along: what looks like an offset, "
            "above all the total mass, cannot be identified."
        )
    return tuple([*out, *result.problem.experiment.warnings])


def summary(result: Identification) -> str:
    """A few lines for the terminal."""
    e, p = result.estimate, result.problem
    lines = [
        f"{p.experiment.name}: {e.base.rank} base parameters from the {p.channel} of {', '.join(p.fitted)} ({e.method})",
        f"  bandwidth of the motion {p.smoother.bandwidth:.3g} Hz ({p.smoother.reason})",
    ]
    for prediction in (*result.fitted, *result.validation):
        lines.append(
            f"  {prediction.role} '{prediction.motion}': relative error {100 * relative_error(prediction):.3g} %, "
            f"residual {prediction.whitened_rms:.3g} x noise"
        )
    lines += [f"  warning: {w}" for w in result.warnings]
    return "\n".join(lines)
