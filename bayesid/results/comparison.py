"""What ``compare`` found, and its tables as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import ByName
from bayesid.drawing import figures_of
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.estimators.parameters import joined
from bayesid.estimators.weights import Weights
from bayesid.regression.problem import Problem
from bayesid.regression.regression import Regression
from bayesid.results.files import SCHEMA, ShownResult, strict
from bayesid.results.fitted_model import UrdfLinks, filter_section, noise_section
from bayesid.rounding import DASH, chance, channel_text, number, percent, with_interval
from bayesid.section import Cell, Part, ShownSection, ShownTable
from bayesid.validation.agreement import EstimatorDifference, HausmanTest
from bayesid.validation.predicted_readings import PredictedReadings, predict_readings
from bayesid.validation.prediction import BAND, Prediction, judged

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


#: Keys of an estimate's document that are the same of all estimators.
_OF_ALL = ("base_map", "weight_in_offset", "link_parameter_names", "rank")


@dataclass(frozen=True, eq=False)
class Entry:
    """What one estimator made of the data."""

    name: str  # the estimator's, made unique
    description: str  # what it is, in one line
    estimate: Estimate | None  # none where the estimator refused; ``refusal`` says why
    refusal: str = ""  # empty where there is an estimate
    seconds: float = 0.0  # time of the fit alone; rows and noise are made once for all
    #: Link parameters (P,), those that `identify` writes: physically consistent; None without a robot.
    links: np.ndarray | None = None
    impossible: tuple[str, ...] | None = None  # names of the bodies that cannot exist; None without ``links``
    urdf: UrdfLinks | None = None  # how far these links are from the estimate; None where that is not known
    #: Predictions of the fitted motions and of the others.
    fitted: tuple[Prediction, ...] = ()
    validation: tuple[Prediction, ...] = ()

    def __repr__(self) -> str:
        return f"<Entry {self.name}: {'refused' if self.refusal else 'fitted'}>"

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
        document = {k: v for k, v in estimate.to_dict().items() if k not in _OF_ALL}
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


class HasEntries(ByName):
    """Estimates by name and their tables, from ``entries`` and ``baselines``."""

    entries: tuple[Entry, ...]
    baselines: tuple[Entry, ...]

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Estimates by the names of their estimators, without those that refused."""
        return {e.name: e.estimate for e in self.entries if e.estimate is not None}

    def same_as(self, name: str) -> tuple[str, ...]:
        """Names of the other estimators whose values and covariance equal those of this one to the last digit."""
        return tuple(n for names in equal_estimates(self.entries) if name in names for n in names if n != name)

    def __getitem__(self, name: str) -> Estimate:
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

    def to_dataframe(self, of: Literal["parameters", "scores"] = "parameters") -> DataFrame:
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

    def plot_errors(self, *, ax: Any = None) -> Figure:
        """Draw what each estimator's predictions miss, motion by motion.

        Parameters
        ----------
        ax
            matplotlib's Axes to draw into: one a motion, or two where the second shows the noise; default a figure of its own.

        Raises
        ------
        InputError
            A regression of one's own was compared, which has no motions to predict; or the number of axes is another.
        """
        if "errors" not in (drawn := figures_of(self)):
            raise InputError("a regression of one's own has no motions to predict; compare estimators on an experiment")
        return drawn["errors"](ax=ax)

    def plot_values(self, *, ax: Any = None) -> Figure:
        """Draw the base parameters by each estimator with their 95 % intervals, around those of the reference.

        Parameters
        ----------
        ax
            matplotlib's Axes to draw into, one; default a figure of its own.

        Raises
        ------
        InputError
            No estimator has intervals.
        """
        if "values" not in (drawn := figures_of(self)):
            raise InputError("no estimator here has intervals to compare by; add wls to the methods")
        return drawn["values"](ax=ax)


#: Errors of at most so many motions stand in the overview.
_SHOWN_MOTIONS = 3


@dataclass(frozen=True, eq=False)
class Comparison(HasEntries, ShownResult):
    """What `compare` found.

    Attributes
    ----------
    regression
        The rows that all estimators had.
    problem
        Where they come from; None for a regression of one's own.
    weights
        Noise that all whitened residuals are counted in.
    entries
        One for each estimator, in the order asked for.
    baselines
        The nominal model, predicted without a fit, and with its effects fitted; empty without one.
    reference
        Name of the estimator in whose standard deviations differences are counted; None without intervals.
    gaps
        Every pair of estimators.
    tests
        Every estimator against the efficient one, where that took part.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    verb, report = "compare", "comparison"
    regression: Regression
    problem: Problem | None
    weights: Weights
    entries: tuple[Entry, ...]
    baselines: tuple[Entry, ...]
    reference: str | None
    gaps: tuple[EstimatorDifference, ...]
    tests: tuple[HausmanTest, ...]
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.regression.base.names

    @explains_types
    def predict(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None
    ) -> dict[str, PredictedReadings]:
        """Readings of any motion by every estimator, with their bands, by its name; as `Identification.predict`.

        Raises
        ------
        InputError
            A regression of one's own was compared, which knows no robot; or as there.
        """
        problem = self.problem
        if problem is None:
            raise InputError("predict needs a robot; compare estimators on an experiment, or multiply your own regressor")
        return {
            name: predict_readings(problem, e.solution, e.full_covariance, e.undetermined, q, v, a, times)
            for name, e in self.estimates.items()
        }

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the errors, or the values where there are no motions; as `plot_errors` and `plot_values`."""
        return self.plot_values(ax=ax) if self.problem is None else self.plot_errors(ax=ax)

    def __repr__(self) -> str:
        of = "a regression" if self.problem is None else self.problem.experiment.name
        return f"<Comparison on {of} of {', '.join(e.name for e in self.entries)}>"

    def _parts(self) -> list[Part]:
        done = [e for e in self.entries if e.estimate is not None]
        legend = []
        if done[0].predictions:
            role = "not fitted" if done[0].validation else "fitted: no validation motion"
            legend.append(f"error: of the signal below {BAND:g} Hz, on motions {role}; x noise: what is left, 1 is perfect")
        if self.reference:
            legend.append(f"interval: median width relative to {self.reference}")
            legend.append(f"from {self.reference}: rms and largest difference in its sigmas")
            if any(e.interval == "credible" for e in self.estimates.values()):
                legend.append("*: credible, counts what was known before")
        if self.tests:
            legend += ["Hausman: chance of so large a difference if the model is complete", *self.untested]
        if self.links_known:
            legend.append("links: whether those that identify writes can exist, and how far off they are")
        refused = [f"{e.name} refused: {e.refusal}" for e in self.entries if e.estimate is None]
        warned = [f"warning: {w}" for w in self.warnings]
        values = ShownSection("Values, ± half of the 95 % interval", [values_table(self)])
        return [_title(self), overview_table(self), *legend, *refused, *warned, values]

    @property
    def untested(self) -> list[str]:
        """Why Hausman's test says nothing, a line for each reason with its estimators."""
        reasons: dict[str, list[str]] = {}
        for test in self.tests:
            if test.probability is None:
                reasons.setdefault(test.reason, []).append(test.method)
        return [f"Hausman {DASH} of {', '.join(methods)}: {reason}" for reason, methods in reasons.items()]

    @property
    def links_known(self) -> bool:
        """Whether it is known for any estimator if its links can exist."""
        return any(e.impossible is not None for e in (*self.baselines, *self.entries))

    def to_dict(self) -> dict[str, Any]:
        """What ``comparison.json`` holds."""
        base, problem = self.regression.base, self.problem
        return {
            "schema": SCHEMA,
            "experiment": None if problem is None else problem.experiment.name,
            "channel": None if problem is None else problem.channel,
            "motions": list(self.regression.motion_names if problem is None else problem.fitted),
            "static": "none" if problem is None else problem.static,
            "filter": {"l": None, "d": None} if problem is None else filter_section(problem.row_model),
            "rank": base.rank, "base_map": base.matrix.tolist(),
            "weight_in_offset": base.absorbed.tolist() if base.absorbed is not None else None,
            "link_parameter_names": list(base.parameter_names),
            "methods": [
                {**e.to_dict(), **({"same_as": list(same)} if (same := self.same_as(e.name)) else {})} for e in self.entries
            ],
            "baselines": [{"name": e.name, "description": e.description, **e.predictions_to_dict()} for e in self.baselines],
            "agreement": {
                "reference": self.reference,
                "unit": None if self.reference is None else f"standard deviations of {self.reference}",
                "interval_widths": {name: interval_width(self, e) for name, e in self.estimates.items()},
                "pairs": [asdict(g) for g in self.gaps],
                "hausman": [asdict(t) for t in self.tests],
            },
            "noise_std": noise_section(self.weights.noise, self.regression.channel_names),
            "model_complete": self.weights.complete, "warnings": list(self.warnings),
            # All times stand here: whatever else there is does not change from run to run.
            "runtime_s": {**self.seconds, "methods": {e.name: e.seconds for e in self.entries}},
        }  # fmt: skip


def _title(result: Comparison) -> str:
    rank, count = result.regression.base.rank, len(result.entries)
    estimators = f"{count} estimator{'s' if count > 1 else ''}"
    if result.problem is None:
        return f"{estimators} on one regression, {rank} base parameters"
    p = result.problem
    return f"{p.experiment.name}: {estimators} on the {channel_text(p.channel, p.fitted)}, {rank} base parameters"


def overview_table(result: Comparison) -> ShownTable:
    """A line for each estimator: errors by motion, links, interval, distance from the reference, test, time of the fit."""
    done = [e for e in result.entries if e.estimate is not None]
    head, columns = ["estimator"], "kb"
    for p in done[0].predictions[:_SHOWN_MOTIONS]:
        head, columns = [*head, f"{p.motion}: error", "x noise"], f"{columns} n nb"
    if result.links_known:
        head, columns = [*head, "links"], f"{columns} k"
    if result.reference:
        head, columns = [*head, "interval", f"from {result.reference}", "largest"], f"{columns} n n n"
    head, columns = [*head, *(f"Hausman {t.efficient}" for t in result.tests[:1])], columns + " n" * bool(result.tests)
    rows = [_overview(result, entry) for entry in (*result.baselines, *done)]
    return ShownTable([*head, "time"], rows, f"{columns} n")


def _overview(result: Comparison, entry: Entry) -> list[Cell]:
    own = None if any(entry is b for b in result.baselines) else entry.estimate
    row: list[Cell] = [" = ".join((entry.name, *(() if own is None else result.same_as(entry.name))))]
    for p in entry.predictions[:_SHOWN_MOTIONS]:
        row += [percent(p.relative_error), (number(p.times_noise, 3), judged(p).mood)]
    if result.links_known:
        none, unfit = entry.impossible is None, entry.impossible or entry.conflicting
        links = DASH if none else f"{len(entry.impossible or ())} impossible" if entry.impossible else "possible"
        if entry.conflicting and entry.urdf is not None and entry.urdf.moved is not None:
            links += f", {number(entry.urdf.moved.distance, 2)} σ away"
        row.append((links, "" if none else "bad" if unfit else "good"))
    if result.reference is not None:
        width = DASH if own is None else "none"
        if own is not None and own.full_covariance is not None:
            ratio = interval_width(result, own)
            width = (DASH if ratio is None else f"{number(ratio, 3)} ×") + " *" * (own.interval == "credible")
        gap = next((g for g in result.gaps if {g.first, g.second} == {entry.name, result.reference}), None)
        row += [width, *([DASH, DASH] if gap is None else [in_sigmas(gap.rms), in_sigmas(gap.largest)])]
    if result.tests:
        test = next((t for t in result.tests if t.method == entry.name), None)
        if test is None or test.probability is None:
            row.append(DASH)
        else:
            row.append((chance(test.probability), "bad" * test.contradiction))
    return [*row, DASH if own is None else f"{number(entry.seconds, 2)} s"]


def interval_width(result: Comparison, estimate: Estimate) -> float | None:
    """Median width of an estimate's intervals relative to those of the reference; None where there is nothing to compare."""
    if result.reference is None:
        return None
    std = result[result.reference].std
    both = (std > 0) & np.isfinite(estimate.std)
    return float(np.median(estimate.std[both] / std[both])) if both.any() else None


def in_sigmas(value: float | None) -> str:
    """A difference in standard deviations."""
    return "< 0.01" if value is not None and value < 0.01 else number(value, 3)


def values_table(result: Comparison, *, whole: bool = False) -> ShownTable:
    """Base and effect parameters by each estimator; ``whole``: numbered, and with those of the nominal model."""
    base, regression = result.regression.base, result.regression
    labels, units = [*base.labels, *base.effect_labels(regression.effect_names)], [*base.units, *regression.effect_units]
    shown = whole and regression.nominal is not None
    rows = []
    for k, (label, unit) in enumerate(zip(labels, units, strict=True)):
        values = []
        for p in (estimate.parameters() for estimate in result.estimates.values()):
            values.append(joined(*with_interval(*(float(x[k]) for x in (p.values, p.std, p.low, p.high)))))
        index = [str(k + 1) if k < base.rank else ""] if whole else []
        nominal = [number(regression.nominal[k]) if k < base.rank else DASH] if shown and regression.nominal is not None else []
        rows.append([*index, label, *values, *nominal, unit])
    head = [*["#"] * whole, "parameter", *result.estimates, *["nominal"] * shown, "unit"]
    numbers = " n" * (len(result.estimates) + shown)
    return ShownTable(head, rows, f"{'nd ' * whole}w{numbers} ku", "tight", {base.rank: "rule"})
