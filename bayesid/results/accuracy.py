"""What ``accuracy`` found: how errors depend on the experiment, what effects left out do, coverage, sensors to choose from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.design.accuracy.bench import Bench
from bayesid.design.accuracy.certificate import CoverageCertificate
from bayesid.design.accuracy.sensor_choice import Outlook, SensorChoice
from bayesid.design.accuracy.susceptibility import Susceptibility
from bayesid.design.accuracy.sweeps import Level, Sweep, Sweeps
from bayesid.drawing import figures_of
from bayesid.errors import InputError
from bayesid.results.files import SCHEMA, ShownResult, strict
from bayesid.results.fitted_model import filter_section
from bayesid.rounding import DASH, channel_text, number, percent
from bayesid.section import Cell, Html, Part, ShownSection, ShownTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: Effects that a summary lists.
_SHOWN_EFFECTS = 10
#: A bias of less than this many standard deviations is none.
NO_BIAS = 0.01


@dataclass(frozen=True, eq=False)
class Accuracy(ShownResult):
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

    verb, report = "accuracy", "accuracy"
    bench: Bench
    std: np.ndarray
    sweeps: Sweeps | None
    susceptibility: tuple[Susceptibility, ...]
    certificate: CoverageCertificate | None
    sensors: SensorChoice | None
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    def __repr__(self) -> str:
        parts = [f"{len(self.sweeps.sweeps)} factors"] if self.sweeps is not None else []
        parts += [f"{len(self.susceptibility)} effects"]
        parts += [f"{self.certificate.twins} twins"] if self.certificate is not None else []
        return f"<Accuracy of {self.bench.experiment.name}: {', '.join(parts)}>"

    def _parts(self) -> list[Part]:
        bench, sweeps, labels = self.bench, self.sweeps, self.labels
        headline = (
            f"{bench.experiment.name}: accuracy of {bench.rank} base parameters by {bench.method.name} from the "
            f"{channel_text(bench.problem.channel, bench.problem.fitted)}"
        )
        parts: list[Part] = [headline]
        if self.improvements:
            parts.append(ShownSection("What would buy most", [improvements_table(self)]))
        if sweeps is not None:  # too long for a terminal
            title = f"One factor at a time, {sweeps.runs} twins a level"
            parts.append(ShownSection(title, [Html(sweeps_table(sweeps).html())]))
        if self.susceptibility:
            worst = worst_places(self.susceptibility, 1)[:_SHOWN_EFFECTS]
            title = "Bias by effects left out of the model, each at its worst place"
            parts.append(ShownSection(title, [effects_table(worst, labels)]))
        if self.sensors is not None:
            parts.append(ShownSection(sensor_title(self.sensors), [sensors_table(self.sensors)]))
        return [*parts, coverage_text(self.certificate), *(f"warning: {w}" for w in self.warnings)]

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
        """What ``accuracy.json`` holds."""
        bench, problem = self.bench, self.bench.problem
        base, truth = problem.row_model.base, bench.truth[: bench.rank]
        document: dict[str, Any] = {
            "schema": SCHEMA, "experiment": bench.experiment.name, "channel": problem.channel, "method": bench.method.name,
            "motions": list(problem.fitted), "predicted_motions": list(bench.predicted_motions),
            "static": problem.static, "filter": filter_section(problem.row_model),
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
            document["sensors_link_trust"] = {"relative_std": self.sensors.rel_std, "assumed": self.sensors.assumed}
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


def improvements_table(result: Accuracy) -> ShownTable:
    """The best step of each factor that lowers the error."""
    rows = [
        [v.improvement, (change(v.ratio), "good"), _sure(v) or DASH, change(v.prediction_ratio), v.source]
        for _, v in result.improvements
    ]
    return ShownTable(["change", "median error", "95 %", "prediction", "by"], rows, "w nb n n -")


def sweeps_table(sweeps: Sweeps) -> ShownTable:
    """Every level of every factor: median error, its interval, error of predictions, parameters lost."""
    rows: list[list[Cell]] = []
    marks = {}
    for s in sweeps.sweeps:
        marks[len(rows)] = "rule"
        for k, v in enumerate(s.levels):
            title, label = s.title if k == 0 else "", f"{v.label}: {v.reason}" if v.reason else v.label
            lost = f"{v.lost} of {len(v.std)}" if v.lost else ""
            if v.source == "refused":
                rows.append([title, label, "cannot be fitted", "", "", ""])
            elif k == s.own:
                rows.append([title, (f"{v.label} (yours)", "sure"), "", "", percent(v.prediction), ""])
            else:
                rows.append([title, label, change(v.ratio), _sure(v) or "formula", percent(v.prediction), lost])
    return ShownTable(["factor", "level", "median error", "95 %", "prediction", "lost"], rows, "b - n n n n", marks=marks)


def _sure(level: Level) -> str:
    """The interval of a simulated level's change; nothing where it is by formula."""
    return "" if level.source == "formula" else f"{change(level.ratio_low)} … {change(level.ratio_high)}"


def change(ratio: float) -> str:
    """A ratio as a change in per cent, or as a factor where it is large."""
    if not np.isfinite(ratio):
        return DASH
    if ratio >= 3.0:
        return f"× {number(ratio, 2)}"
    return f"{100 * (ratio - 1):+.0f} %".replace("-", "−") if abs(ratio - 1) >= 0.005 else "0 %"


def effects_table(found: Sequence[Susceptibility], labels: tuple[str, ...]) -> ShownTable:
    """Effects and places, their sizes, the largest bias in standard deviations, of which parameter, error of predictions."""
    rows = []
    for s in found:
        none = s.largest < NO_BIAS
        bias, of = ("none", "") if none else (f"{number(s.largest, 2)} σ", _short(labels[s.most_biased]))
        rows.append([s.effect.spec, size_text(s), bias, of, percent(s.prediction, 2) if s.prediction > 1e-12 else "0 %"])
    return ShownTable(["effect left out", "size", "largest bias", "of", "prediction"], rows, "k u nb - n")


def worst_places(found: Sequence[Susceptibility], each: int) -> list[Susceptibility]:
    """Places where every kind of effect biases most, largest bias first."""
    counts: dict[str, int] = {}
    out = []
    for s in found:
        counts[s.effect.name] = counts.get(s.effect.name, 0) + 1
        if counts[s.effect.name] <= each:
            out.append(s)
    return out


def size_text(s: Susceptibility) -> str:
    """The effect's first parameters with their units."""
    values = list(zip(s.effect.parameters, s.values, s.effect.units, strict=True))
    shown = [f"{p} {number(v, 2)}{'' if u == '1' else ' ' + u}" for p, v, u in values[:2]]
    return ", ".join(shown) + (" …" if len(values) > 2 else "")


def _short(label: str) -> str:
    first = label.split(" ")
    return label if len(label) <= 24 else " ".join(first[: 2 if first[0][:1] != "I" else 1]) + " …"


def sensor_title(sensors: SensorChoice) -> str:
    """What the table of sensors shows."""
    how = "assumed" if sensors.assumed else "as stated"
    return f"Candidate sensors: share of the links' prior uncertainty ({percent(sensors.rel_std, 2)}, {how}) that would be left"


def sensors_table(sensors: SensorChoice) -> ShownTable:
    """A line for each thing that candidates are compared by, a cell for each candidate."""
    outlooks = sensors.outlooks
    bodies = list(dict.fromkeys(body for o in outlooks for body in o.left))
    rows = [
        ["combinations determined", *(str(o.determined.base.rank) for o in outlooks)],
        ["better than beforehand", *(str(o.better_than_prior) for o in outlooks)],
        *([f"left of {b}", *(percent(o.left[b], 2) if b in o.left else DASH for o in outlooks)] for b in bodies),
        ["range used", *((_range_used(o), "sure bad" if o.load > 1.0 else "") for o in outlooks)],
    ]
    return ShownTable(["", *(o.candidate.name for o in outlooks)], rows, marks={len(rows) - 1: "rule"})


def _range_used(outlook: Outlook) -> str:
    if not np.isfinite(outlook.candidate.limit).any():
        return DASH
    return percent(outlook.load, 2) + (" (too much)" if outlook.load > 1.0 else "")


def coverage_text(c: CoverageCertificate | None) -> str:
    """One sentence on a certificate; empty without."""
    if c is None:
        return ""
    low, high = c.band
    least, most = percent(float(np.nanmin(c.coverage))), percent(float(np.nanmax(c.coverage)))
    return (
        f"Coverage of 95 % intervals on {c.twins} twins: {percent(c.overall)} ± {percent(1.96 * c.overall_error, 2)} overall, "
        f"{least} to {most} by parameter, where exact intervals would show {percent(low)} to {percent(high)}: "
        + ("these hold." if c.holds else "some are too short.")
    )
