"""What ``accuracy`` found: how errors depend on the experiment, what effects left out do, coverage, sensors to choose from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.design.accuracy.bench import Bench
from bayesid.design.accuracy.certificate import Certificate
from bayesid.design.accuracy.sensor_choice import SensorChoice
from bayesid.design.accuracy.susceptibility import Susceptibility
from bayesid.design.accuracy.sweeps import Level, Sweep, Sweeps
from bayesid.drawing import figures_of
from bayesid.errors import InputError
from bayesid.results.accuracy_text import accuracy_text
from bayesid.results.files import Result, strict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class Accuracy(Result):
    """What `accuracy` found.

    Attributes
    ----------
    bench
        The experiment, its fit, and what was taken for the truth.
    std
        Standard deviations that biases are counted in (r,): the estimate's, or those of simulated fits where it has none.
    sweeps
        How errors depend on one factor at a time; None where no runs were asked for.
    susceptibility
        What each effect left out of the model does, largest bias first.
    certificate
        Coverage on twins, where it was asked for.
    sensors
        What candidate sensors would tell, where any were given.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    verb = "accuracy"
    bench: Bench
    std: np.ndarray
    sweeps: Sweeps | None
    susceptibility: tuple[Susceptibility, ...]
    certificate: Certificate | None
    sensors: SensorChoice | None
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    def __repr__(self) -> str:
        parts = [f"{len(self.sweeps.sweeps)} factors"] if self.sweeps is not None else []
        parts += [f"{len(self.susceptibility)} effects"]
        parts += [f"{self.certificate.twins} twins"] if self.certificate is not None else []
        return f"<Accuracy of {self.bench.experiment.name}: {', '.join(parts)}>"

    def __str__(self) -> str:
        """What buys most, what effects left out would do, and coverage."""
        return self._text()

    def _repr_html_(self) -> str:
        """The same tables for notebooks."""
        return self._text(html=True)

    def _text(self, *, html: bool = False) -> str:
        parts = self.bench, self.sweeps, self.susceptibility, self.certificate, self.sensors
        return accuracy_text(*parts, self.warnings, html=html)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.bench.problem.row_model.base.names

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the base parameters for reading (r,)."""
        return self.bench.problem.row_model.base.labels

    @property
    def improvements(self) -> tuple[tuple[str, Level], ...]:
        """What would lower the median error, best first: the factor's name and the level."""
        return () if self.sweeps is None else self.sweeps.improvements()

    def sweep(self, name: str) -> Sweep:
        """One factor by its name, such as ``sensor_noise``.

        Raises
        ------
        InputError
            There is none of that name.
        """
        found = {} if self.sweeps is None else {s.name: s for s in self.sweeps.sweeps}
        if name not in found:
            raise InputError(f"no factor '{name}' was varied; there are {', '.join(found) or 'none, as runs = 0'}")
        return found[name]

    def plot_sweeps(self, *, ax: Any = None) -> Figure:
        """Draw the errors over each factor, into one axis a factor; InputError where nothing was simulated."""
        return self._figure("sweeps", self.sweeps is not None, "give runs", ax)

    def plot_susceptibility(self, *, ax: Any = None) -> Figure:
        """Draw the bias of every base parameter by every effect left out, as a map."""
        return self._figure("susceptibility", bool(self.susceptibility), "the model has every effect there is", ax)

    def plot_certificate(self, *, ax: Any = None) -> Figure:
        """Draw the coverage of every base parameter; InputError where none was asked for."""
        return self._figure("certificate", self.certificate is not None, "give certificate=400", ax)

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the errors over each factor where they were simulated, else what effects left out do."""
        return self.plot_susceptibility(ax=ax) if self.sweeps is None else self.plot_sweeps(ax=ax)

    def _figure(self, name: str, there: bool, remedy: str, ax: Any) -> Figure:
        if not there:
            raise InputError(f"there is nothing to draw: {remedy}")
        return figures_of(self)[name](ax=ax)

    def to_dict(self) -> dict[str, Any]:
        """``accuracy.json``."""
        bench, problem = self.bench, self.bench.problem
        low_pass = problem.row_model.filters
        base, truth = problem.row_model.base, bench.truth[: bench.rank]
        document: dict[str, Any] = {
            "schema": SCHEMA,
            "experiment": bench.experiment.name,
            "channel": problem.channel,
            "method": bench.method.name,
            "motions": list(problem.fitted),
            "predicted_motions": list(bench.predicted_motions),
            "static": problem.static,
            "filter": {"l": None if low_pass is None else low_pass.l, "d": None if low_pass is None else low_pass.d},
            "truth": "nominal" if bench.nominal else "estimate",
            "base_parameters": [
                {"name": n, "unit": u, "label": label, "value": v, "std": s}
                for n, u, label, v, s in zip(base.names, base.units, base.labels, truth, self.std, strict=True)
            ],
            "noise": {
                "std": dict(zip(problem.row_model.channels.names, bench.noise.std, strict=True)), "order": bench.noise.order,
                "position_resolution": bench.resolution, "position_std": bench.position_std,
            },
            "bias_susceptibility": [
                {
                    "effect": s.effect.name, "where": s.effect.where,
                    "parameters": dict(zip(s.effect.parameters, s.values, strict=True)), "bias": s.bias, "sigmas": s.sigmas,
                    "largest_sigmas": s.largest, "prediction": s.prediction,
                }
                for s in self.susceptibility
            ],
            "warnings": list(self.warnings),
            "runtime_s": self.seconds,
        }  # fmt: skip
        if self.sweeps is not None:
            document["runs"], document["seed"] = self.sweeps.runs, self.sweeps.seed
            document["own"] = _level(self.sweeps.own)
            document["formula_std"], document["simulated_over_formula"] = self.sweeps.formula, self.sweeps.agreement
            document["factors"] = [
                {"name": s.name, "title": s.title, "own": s.own, "levels": [_level(v) for v in s.levels]}
                for s in self.sweeps.sweeps
            ]
            document["improvements"] = [
                {
                    "factor": name, "change": v.improvement, "median_rms_ratio": v.ratio, "low": v.ratio_low,
                    "high": v.ratio_high, "prediction_ratio": v.prediction_ratio,
                }
                for name, v in self.improvements
            ]  # fmt: skip
        if self.sensors is not None:
            document["sensors"] = [o.to_dict() for o in self.sensors.outlooks]
            document["sensors_link_trust"] = {"relative_std": self.sensors.trust, "assumed": self.sensors.assumed}
        if self.certificate is not None:
            document["certificate"] = self.certificate.to_dict()
        return strict(document)


def _level(level: Level) -> dict[str, Any]:
    out = {
        "label": level.label, "value": level.value, "source": level.source, "median_rms_ratio": level.ratio,
        "low": level.ratio_low, "high": level.ratio_high, "prediction": level.prediction,
        "prediction_std": level.prediction_error, "undetermined": level.lost, "bias": level.bias, "std": level.std,
        "rms": level.rms, "bias_std": level.bias_error, "std_std": level.std_error,
    }  # fmt: skip
    return {**out, "reason": level.reason} if level.reason else out
