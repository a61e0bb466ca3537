"""Estimators side by side on the same rows: values, proof, physical consistency, agreement and time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from bayesid.errors import EstimationError, InputError
from bayesid.estimators import DEFAULT_METHOD, METHODS, Estimate, Estimator, LeastSquares, estimator
from bayesid.estimators.factor import Weights, learn_weights
from bayesid.estimators.nonlinear import settled
from bayesid.recordings.experiment import Experiment, load_experiment
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.regression import Regression
from bayesid.report import comparison_report
from bayesid.report.comparison import comparison_text
from bayesid.results.files import write_results
from bayesid.signals.filters import LowPass
from bayesid.validation.agreement import Gap, HausmanTest, gaps, hausman
from bayesid.validation.baselines import nominal_estimates
from bayesid.validation.prediction import band_error
from bayesid.workflows.comparison_entry import Entry, attempt, prove, with_own_links
from bayesid.workflows.progress import Progress, quiet

SCHEMA = 1
#: What is compared when nothing is asked for, as far as it is there: plain, default and efficient least squares,
#: and one estimator each against outliers, against encoder noise and for bodies that can exist.
DEFAULT_SET = ("ols", "wls", "gls", "huber", "iv", "sdp")


@dataclass(frozen=True)
class Comparison:
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

    regression: Regression
    problem: Problem | None
    weights: Weights
    entries: tuple[Entry, ...]
    baselines: tuple[Entry, ...]
    reference: str | None
    gaps: tuple[Gap, ...]
    tests: tuple[HausmanTest, ...]
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Estimates by the names of their estimators, without those that refused."""
        return {e.name: e.estimate for e in self.entries if e.estimate is not None}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.regression.base.names

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

    def __str__(self) -> str:
        """The estimators in a table, then their values."""
        return comparison_text(self)

    def _repr_html_(self) -> str:
        """The same tables for notebooks."""
        return comparison_text(self, html=True)

    def to_dict(self) -> dict[str, Any]:
        """``comparison.json``."""
        base, problem = self.regression.base, self.problem
        filters = None if problem is None else problem.row_model.filters
        return {
            "schema": SCHEMA,
            "experiment": None if problem is None else problem.experiment.name,
            "channel": None if problem is None else problem.channel,
            "motions": list(self.regression.motion_names if problem is None else problem.fitted),
            "static": "none" if problem is None else problem.static,
            "filter": {"l": None if filters is None else filters.l, "d": None if filters is None else filters.d},
            "rank": base.rank,
            "base_map": base.matrix.tolist(),
            "link_parameter_names": list(base.parameter_names),
            "methods": [e.to_dict() for e in self.entries],
            "baselines": [{"name": e.name, "description": e.description, **e.proof_to_dict()} for e in self.baselines],
            "agreement": {
                "reference": self.reference,
                "unit": None if self.reference is None else f"standard deviations of {self.reference}",
                "pairs": [vars(g) for g in self.gaps],
                "hausman": [vars(t) for t in self.tests],
            },
            "noise_std": {
                group: dict(zip(self.regression.channel_names, map(float, model.std), strict=True))
                for group, model in self.weights.noise.items()
            },
            "model_complete": self.weights.complete,
            "warnings": list(self.warnings),
            "runtime_s": self.seconds,
        }

    def write(self, folder: str | Path) -> Path:
        """Write ``comparison.json`` and ``report.html``; returns the report's path."""
        return write_results(folder, {"comparison.json": self.to_dict()}, {}, comparison_report(self))


def compare(
    experiment: Experiment | Regression | str | Path,
    methods: Sequence[str | Estimator] | None = None,
    channel: str | None = None,
    *,
    low_pass: LowPass | None = None,
    motions: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    static: str = "motion",
    bandwidth: float | None = None,
    progress: Progress = quiet,
) -> Comparison:
    """Fit the same rows with several estimators and put the results side by side.

    An estimator that cannot work with these data does not stop the others: its entry says why.

    Parameters
    ----------
    experiment
        Loaded, or its folder; or a regression of one's own, which has no motions to validate on.
    methods
        Names of estimators or objects that follow the interface; default `DEFAULT_SET`.
    channel, low_pass, motions, effects, static, bandwidth
        As in `identify`; not for a regression.
    progress
        Called with the name of every stage.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    EstimationError
        No estimator could work with these data.
    """
    chosen = _chosen(methods)
    started = time.perf_counter()
    seconds: dict[str, float] = {}
    with threadpool_limits(1, user_api="blas"):
        if isinstance(experiment, Regression):
            if any(o is not None for o in (channel, low_pass, motions, effects, bandwidth)) or static != "motion":
                raise InputError("compare: channel, filters, motions, effects and static are for an experiment, not a Regression")
            problem, regression = None, experiment
        else:
            progress("reading")
            if not isinstance(experiment, Experiment):
                experiment = load_experiment(experiment)
            progress("regressor")
            problem = prepare(
                experiment, channel, filters=low_pass, motions=motions, effects=effects, static=static, bandwidth=bandwidth
            )
            problem = settled(problem)
            regression = problem.regression
        for _ in regression.blocks():
            pass
        seconds["regressor"] = time.perf_counter() - started
        progress("noise")
        weights = learn_weights(regression)
        seconds["noise"] = time.perf_counter() - started - sum(seconds.values())
        entries = []
        for k, (name, method) in enumerate(chosen):
            progress(f"estimate: {name} ({k + 1} of {len(chosen)})")
            entries.append(attempt(name, method, regression))
        if all(e.estimate is None for e in entries):
            reasons = "; ".join(f"{e.name}: {e.refusal}" for e in entries)
            raise EstimationError(f"no estimator can work with these data: {reasons}")
        seconds["estimate"] = sum(e.seconds for e in entries)
        progress("prediction")
        if problem is None:
            entries, baselines = [with_own_links(e, regression) for e in entries], []
        else:
            entries = [prove(e, problem, weights) for e in entries]
            baselines = [
                prove(Entry(e.method, text, e), problem, weights) for text, e in nominal_estimates(problem, weights)
            ]
        seconds["prediction"] = time.perf_counter() - started - sum(seconds.values())
    reference = _reference(entries)
    estimates = {e.name: e.estimate for e in entries if e.estimate is not None}
    best = [name for name, m in chosen if name in estimates and isinstance(m, LeastSquares) and m.weights == "noise"]
    efficient = best[0] if best else None
    result = Comparison(
        regression=regression,
        problem=problem,
        weights=weights,
        entries=tuple(entries),
        baselines=tuple(baselines),
        reference=reference,
        gaps=() if reference is None else tuple(gaps(estimates, reference)),
        tests=() if efficient is None else tuple(
            hausman(n, e, efficient, estimates[efficient]) for n, e in estimates.items() if n != efficient
        ),
        warnings=(),
        seconds=seconds,
    )  # fmt: skip
    return replace(result, warnings=_warnings(result))


def _chosen(methods: Sequence[str | Estimator] | None) -> list[tuple[str, Estimator]]:
    """Estimators with names that differ."""
    if isinstance(methods, str):
        methods = [methods]
    if methods is None:
        methods = [m for m in DEFAULT_SET if m in METHODS]
    if not methods:
        raise InputError(f"--methods is empty; choose of {', '.join(METHODS)}")
    out: dict[str, Estimator] = {}
    for method in methods:
        if isinstance(method, str) and method in out:
            continue  # asked for twice
        one = estimator(method)
        if not hasattr(one, "name") or not callable(getattr(one, "fit", None)):
            raise InputError(f"method {one!r} is no estimator: it needs a name and fit(regression)")
        name, count = one.name, 1
        while name in out:
            count += 1
            name = f"{one.name} {count}"
        out[name] = one
    return list(out.items())


def _reference(entries: Sequence[Entry]) -> str | None:
    """The default estimator where it has intervals, else the first that has."""
    sure = [e.name for e in entries if e.estimate is not None and e.estimate.full_covariance is not None]
    return DEFAULT_METHOD if DEFAULT_METHOD in sure else next(iter(sure), None)


def _warnings(result: Comparison) -> tuple[str, ...]:
    out = []
    done = [e for e in result.entries if e.estimate is not None]
    nominal = result.baselines[-1] if result.baselines else None
    for k, p in enumerate(done[0].validation):
        if p.repeats:
            out.append(f"Motion '{p.motion}' repeats the fitted motion '{p.repeats}': its error says little about other motions.")
        if nominal is None:
            continue
        yardstick = nominal.validation[k]
        beaten = {
            what: ", ".join(e.name for e in done if error(e.validation[k]) >= error(yardstick))
            for what, error in (("in units of the noise", lambda q: q.whitened_rms), ("in per cent of the signal", band_error))
        }
        model = "nominal model with its effects fitted" if len(result.baselines) > 1 else "nominal model"
        for names in dict.fromkeys(n for n in beaten.values() if n):
            where = " and ".join(what for what, those in beaten.items() if those == names)
            out.append(f"On '{p.motion}' the {model} predicts as well as or better than {names}, {where}.")
    if result.problem is not None and not done[0].validation:
        out.append("No validation motion: errors are those of fitted motions, which prove little.")
    apart = [t for t in result.tests if t.contradiction]
    if apart:
        names, largest = ", ".join(t.method for t in apart), max(t.probability or 0.0 for t in apart)
        size = f"{'' if len(apart) == 1 else 'at most '}{largest:.1g}"
        out.append(
            f"{names} and {apart[0].efficient} differ by more than the noise explains (Hausman test, probability {size}): "
            "something is missing in the model or in the noise, and intervals do not cover it."
        )
    if result.problem is not None:
        out += result.problem.experiment.warnings
    return tuple(out)
