"""Estimators side by side on the same rows: values, predictions, physical consistency, agreement and time."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, call
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.errors import BayesidError, EstimationError, InputError
from bayesid.estimators import DEFAULT_METHOD, METHODS, Estimator, estimator, fit
from bayesid.estimators.attenuation import with_expected_error
from bayesid.estimators.held_shapes import with_held_shapes
from bayesid.estimators.least_squares import LeastSquaresDetails
from bayesid.estimators.nonlinear import settled
from bayesid.estimators.weights import Weights, learn_weights
from bayesid.recordings.complaints import in_words, listed
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import NOT_FOR_REGRESSIONS, FitOptions, fit_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.regression import Regression
from bayesid.results.comparison import Comparison, Entry, equal_estimates
from bayesid.results.fitted_model import impossible_bodies
from bayesid.signals.filters import LowPass
from bayesid.tasks import cluster
from bayesid.validation.agreement import HausmanTest, gaps, hausman, nominal_estimates
from bayesid.validation.noise_floor import NoiseFloor, noise_floor
from bayesid.validation.prediction import judged, predict, useless
from bayesid.workflows.progress import SHOWN, Progress, quiet, shows_progress
from bayesid.workflows.urdf_links import urdf_links
from bayesid.workflows.warnings import (
    beyond_poses,
    incomplete,
    mistaken,
    not_settled,
    quoted,
    repeated_motions,
    too_late,
    unpredicted,
    unseen_effects,
    unusable,
    without_static_run,
)

#: What is compared when nothing is asked for, as far as it is there: plain, default and efficient least squares,
#: and one estimator each against outliers, against encoder noise and for bodies that can exist.
DEFAULT_SET = ("ols", "wls", "gls", "huber", "iv", "sdp")


@shows_progress
def compare(
    experiment: Experiment | Regression | str | Path,
    methods: str | Estimator | Sequence[str | Estimator] | None = None,
    channel: str | None = None,
    *,
    options: FitOptions | None = None,
    low_pass: LowPass | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    static: str | None = None,
    bandwidth: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = SHOWN,
) -> Comparison:
    """Fit the same rows with several estimators and put the results side by side.

    An estimator that cannot work with these data does not stop the others: its entry says why.

    Parameters
    ----------
    experiment
        Loaded, or its folder; or a regression of one's own, which has no motions to validate on.
    methods
        Names of estimators or objects that follow the interface; default `DEFAULT_SET`.
    channel, options, low_pass, motions, effects, static, bandwidth
        As in `bayesid.identify`; not for a regression.
    workers, scheduler
        Processes on this machine that share the work, or the address of a Dask cluster that does; the result depends on neither.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    EstimationError
        No estimator could work with these data.
    """
    chosen, progress = _chosen(methods), progress or quiet
    options = fit_options(options, channel, low_pass, motions, effects, static, bandwidth)
    started = time.perf_counter()
    seconds: dict[str, float] = {}
    with one_blas_thread(), cluster(workers, scheduler):
        if isinstance(experiment, Regression):
            if options != FitOptions():
                raise InputError(NOT_FOR_REGRESSIONS.format("compare"))
            problem, regression = None, experiment
        else:
            progress("reading")
            experiment = as_experiment(experiment, "a Regression")
            progress("regressor")
            problem = prepare(experiment, options)
            problem = settled(problem)
            regression = problem.regression
        regression.rows.pilot()  # makes the rows, whose time is given apart
        seconds["regressor"] = time.perf_counter() - started
        progress("noise")
        weights = learn_weights(regression)
        seconds["noise"] = time.perf_counter() - started - sum(seconds.values())
        entries = []
        for k, (name, method) in enumerate(chosen):
            progress(f"estimate: {name} ({k + 1} of {len(chosen)})")
            entries.append(_attempt(name, method, regression))
        if all(e.estimate is None for e in entries):
            reasons = "; ".join(f"{e.name}: {e.refusal}" for e in entries)
            raise EstimationError(f"no estimator can work with these data: {reasons}")
        seconds["estimate"] = sum(e.seconds for e in entries)
        progress("prediction")
        if problem is None:
            entries, baselines = [_with_own_links(e, regression) for e in entries], []
        else:
            floor = noise_floor(problem)
            told = [_told(e, problem, method) for (_, method), e in zip(chosen, entries, strict=True)]
            entries = [_predicted(e, problem, weights, floor) for e in told]
            baselines = [
                _predicted(Entry(e.method, text, e), own, weights, floor, baseline=True)
                for text, own, e in nominal_estimates(problem, weights)
            ]
        seconds["prediction"] = time.perf_counter() - started - sum(seconds.values())
    # The default estimator where it has intervals, else the first that has; of what nothing determines they are empty.
    measured = [(e.name, e.estimate) for e in entries if e.estimate is not None and e.estimate.full_covariance is not None]
    sure = [name for name, estimate in measured if (estimate.std > 0.0).any()]
    reference = DEFAULT_METHOD if DEFAULT_METHOD in sure else next(iter(sure), None)
    estimates = {e.name: e.estimate for e in entries if e.estimate is not None}
    # Where the model lacks something, gls weights by channel and is no more efficient than wls.
    details = {name: e.details for name, e in estimates.items()}
    efficient = next((n for n, d in details.items() if isinstance(d, LeastSquaresDetails) and d.weights == "noise"), None)
    tests = () if efficient is None else tuple(
        hausman(n, e, efficient, estimates[efficient]) for n, e in estimates.items() if n != efficient
    )  # fmt: skip
    return Comparison(
        regression=regression,
        problem=problem,
        weights=weights,
        entries=tuple(entries),
        baselines=tuple(baselines),
        reference=reference,
        gaps=() if reference is None else tuple(gaps(estimates, reference)),
        tests=tests,
        warnings=_warnings(problem, weights, entries, baselines, tests),
        seconds=seconds,
    )


def _chosen(methods: str | Estimator | Sequence[str | Estimator] | None) -> list[tuple[str, Estimator]]:
    """Estimators with names that differ."""
    if methods is None:
        methods = DEFAULT_SET
    elif isinstance(methods, str) or not isinstance(methods, Iterable):
        methods = [methods]
    if not methods:
        raise InputError(f"{argument('methods')} is empty; choose of {', '.join(METHODS)}")
    out: dict[str, Estimator] = {}
    for method in methods:
        if isinstance(method, str) and method in out:
            continue  # asked for twice
        one = estimator(method)
        name, count = one.name, 1
        while name in out:
            count += 1
            name = f"{one.name} {count}"
        out[name] = one
    return list(out.items())


def _attempt(name: str, method: Estimator, regression: Regression) -> Entry:
    """Fit, timed; whatever an estimator raises because of the data becomes a refusal, anything else is a bug."""
    started = time.perf_counter()
    lines = (type(method).__doc__ or "").strip().splitlines()
    description = lines[0] if lines else ""
    try:
        estimate = fit(regression, method)
    except (BayesidError, ArithmeticError, np.linalg.LinAlgError) as error:
        refusal = " ".join(str(error).split()) or type(error).__name__
        return Entry(name, description, None, refusal, time.perf_counter() - started)
    return Entry(name, description, estimate, seconds=time.perf_counter() - started)


def _told(entry: Entry, problem: Problem, method: Estimator) -> Entry:
    """The entry with what encoders' errors are expected to add to values, and what shapes that are held leave open."""
    if entry.estimate is None:
        return entry
    return replace(entry, estimate=with_held_shapes(problem, with_expected_error(problem, entry.estimate, method)))


def _predicted(entry: Entry, problem: Problem, weights: Weights, floor: NoiseFloor | None, *, baseline: bool = False) -> Entry:
    """Add links and predictions of all motions; residuals are counted in one and the same noise for all."""
    estimate, row_model = entry.estimate, problem.row_model
    if estimate is None:
        return entry
    urdf = None if baseline else urdf_links(problem, estimate)
    kept = ~estimate.undetermined[: row_model.base.rank]
    links = nearest_links(problem.experiment.robot, row_model.base, estimate.values, kept) if urdf is None else urdf.links
    same = replace(estimate, noise=weights.noise)
    predictions = [predict(problem, same, m, floor) for m in problem.experiment.motions if m.name in problem.segments]
    return replace(
        entry,
        links=links,
        urdf=urdf,
        impossible=impossible_bodies(links.reshape(-1, 10), problem.experiment.robot.body_names),
        fitted=tuple(p for p in predictions if p.motion in problem.fitted),
        validation=tuple(p for p in predictions if p.motion not in problem.fitted and p.role == "validation"),
    )


def _with_own_links(entry: Entry, regression: Regression) -> Entry:
    """The entry with its own links: without a robot, they are known only to an estimator that estimates them."""
    if entry.estimate is None or entry.estimate.links is None or not regression.knowledge.bodies:
        return entry
    links = entry.estimate.links
    names = tuple(regression.base.parameter_names[body[0]].rpartition(".")[0] or f"body {k + 1}"
                  for k, body in enumerate(regression.knowledge.bodies))  # fmt: skip
    return replace(entry, links=links, impossible=impossible_bodies(links[np.array(regression.knowledge.bodies)], names))


def _warnings(
    problem: Problem | None, weights: Weights, entries: Sequence[Entry], baselines: Sequence[Entry], tests: Sequence[HausmanTest]
) -> tuple[str, ...]:
    """What the user should know, most important first."""
    done = [e for e in entries if e.estimate is not None]
    out: list[str] = []
    no_use: list[str] = []
    if problem is not None:
        estimates = [e.estimate for e in done if e.estimate is not None]
        sure = next((e for e in estimates if e.full_covariance is not None), estimates[0])
        every = [p for e in done for p in e.validation]
        mistakes = mistaken(problem, every, False) if useless(every) else []
        no_use = unusable(problem, every, mistakes)
        nominal = "nominal model with its effects fitted" if len(baselines) > 1 else "nominal model"
        out = [
            *unseen_effects(problem), *without_static_run(problem), *too_late(problem), *not_settled(problem, sure),
            *repeated_motions(done[0].validation), *beyond_poses(done[0].validation), *mistakes,
            *_beaten(done, baselines[-1], nominal), *([] if no_use else _left(done)),
        ]  # fmt: skip
        if not done[0].validation:
            out.append(
                "No validation motion: the errors are those of fitted motions and say little about others. "
                'Add one with role = "validation".'
            )
    if not weights.complete:
        out.append(incomplete(weights.dispersion, weights.dispersion_by_channel))
    for names in equal_estimates(done):
        because = [w for e in done if e.name in names and e.estimate is not None for w in e.estimate.details.warnings]
        out.append(because[0] if because else f"{in_words(names)} are the same here, to the last digit.")
    by_text: dict[str, list[str]] = {}
    for e in done:
        for text in e.estimate.details.warnings if e.estimate is not None else ():
            by_text.setdefault(text, []).append(e.name)
    named = ((text, "" if text.startswith(f"{names[0]} ") else f"{in_words(names)}: ") for text, names in by_text.items())
    out += [f"{before}{text}" for text, before in named if text not in out]
    apart = [t for t in tests if t.contradiction]
    if apart:
        names, largest = ", ".join(t.method for t in apart), max(t.probability or 0.0 for t in apart)
        size = f"{'' if len(apart) == 1 else 'at most '}{largest:.1g}"
        out.append(
            f"{names} and {apart[0].efficient} differ by more than the noise explains (Hausman test, probability {size}): "
            "something is missing in the model or in the noise, and intervals do not cover it. "
            f"`{call('diagnose')}` looks for it."
        )
    if problem is None:
        return tuple(out)
    return (*no_use, *problem.experiment.with_findings(out, validated=bool(done[0].validation)))


def _left(done: Sequence[Entry]) -> list[str]:
    """That every estimator leaves more than a complete model does, in a line on the one that leaves least."""
    best = min(done, key=lambda e: max((p.relative_error for p in e.predictions), default=0.0))
    if not all(any(judged(p).mood != "good" for p in e.validation) for e in done):
        return []
    return [f"By the best of them, {best.name}: {text}" for text in unpredicted(best.validation)]


def _beaten(done: Sequence[Entry], nominal: Entry, model: str) -> list[str]:
    """Which estimators predict no better than the nominal model, in one line for all motions on which they are the same.

    By the residual over the noise, where something tells the noise, and by the error relative to the signal.
    """
    measures = (("in units of the noise", lambda p: p.times_noise), ("in per cent of the signal", lambda p: p.relative_error))
    motions: dict[tuple[str, str], list[str]] = {}
    for k, yardstick in enumerate(nominal.validation):
        beaten: dict[str, list[str]] = {}
        for unit, error in measures:
            names = [e.name for e in done if error(e.validation[k]) >= error(yardstick)]  # nan, of an unknown noise, never is
            if names and not yardstick.beyond:
                beaten.setdefault(listed(names), []).append(unit)
        if beaten:
            than = ", and than ".join(f"{names} {' and '.join(units)}" for names, units in beaten.items())
            remedy = (
                "neither is of use there" if useless([yardstick])
                else "keep the nominal parameters for such motions, or fit motions like it, too"
            )  # fmt: skip
            motions.setdefault((than, remedy), []).append(yardstick.motion)
    return [
        f"On {quoted(names)} the {model} predicts as well as or better than {than}: {remedy}."
        for (than, remedy), names in motions.items()
    ]
