"""The verb ``accuracy``: what errors depend on, what effects left out of the model do, whether intervals hold the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, call
from bayesid.design.accuracy.bench import Bench, make_bench
from bayesid.design.accuracy.certificate import CoverageCertificate, certify, check_certifiable
from bayesid.design.accuracy.sensor_choice import choose_sensor, read_sensors
from bayesid.design.accuracy.susceptibility import susceptibility
from bayesid.design.accuracy.sweeps import Sweeps, sweep
from bayesid.errors import InputError
from bayesid.estimators import METHODS, Estimator, estimator
from bayesid.estimators.nonlinear import default_method, solve
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, fit_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.problem import prepare
from bayesid.results.accuracy import Accuracy
from bayesid.results.files import amend, read_document
from bayesid.results.identification import Identification
from bayesid.signals.filters import LowPass
from bayesid.tasks import cluster
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.warnings import incomplete, of_recordings

#: Fewest twins of a level that a standard deviation can be taken of.
_FEWEST_RUNS = 5
#: Simulation and formula of the user's own setting may differ by this many standard errors.
_FAR = 4.0
#: Estimates are the same up to this share of a standard deviation.
_SAME = 0.01


@shows_progress
def accuracy(
    experiment: Experiment | Identification | str | Path,
    channel: str | None = None,
    method: str | Estimator | None = None,
    *,
    runs: int = 20,
    certificate: int = 0,
    sensors: str | Path | None = None,
    nominal: bool = False,
    options: FitOptions | None = None,
    low_pass: LowPass | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    static: str | None = None,
    bandwidth: float | None = None,
    seed: int = 0,
    kept: str | Path | None = None,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = SHOWN,
) -> Accuracy:
    """How accurate an identification is, and what its accuracy depends on.

    Parameters
    ----------
    experiment
        Loaded, its folder, or what `bayesid.identify` found of it; then the options of the fit are its own.
    channel, options, low_pass, motions, effects, static, bandwidth
        As in `bayesid.identify`.
    method
        Name of an estimator, or an object with ``fit(regression)``; default that of the identification, or
        what `bayesid.identify` takes.
    runs
        Twins that are simulated of every level of a factor; 0: no factor is varied.
    certificate
        Twins that coverage is counted on; 0: none.
    sensors
        Candidate sensors to compare before one is bought: a ``sensors.toml``.
    nominal
        Take the nominal links for the true ones, instead of the estimated.
    seed
        Of everything random.
    kept, resume
        File that keeps the certificate's twins while it runs, and whether to go on from it.
    workers, scheduler
        Processes on this machine that share the work, or the address of a Dask cluster that does; the result depends on neither.
    progress
        Called with what is going on; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    if runs and runs < _FEWEST_RUNS:
        raise InputError(f"{argument('runs', runs)}: give at least {_FEWEST_RUNS}, or 0 to vary nothing")
    if certificate < 0 or runs < 0:
        raise InputError(
            f"{argument('runs', runs) if runs < 0 else argument('certificate', certificate)}: give a positive number, or 0"
        )
    clock = Clock(progress)
    with one_blas_thread(), cluster(workers, scheduler):
        clock("reading")
        options = fit_options(options, channel, low_pass, motions, effects, static, bandwidth)
        bench = _bench(experiment, method, options, nominal, clock)
        if certificate:
            check_certifiable(bench, certificate)
        candidates = () if sensors is None else read_sensors(sensors, bench.experiment.robot)
        varied = None
        if runs:
            clock("simulating")
            varied = sweep(bench, runs, seed, clock.progress)
        std = bench.estimate.std
        if varied is not None:
            std = np.where(np.isfinite(std), std, varied.own.std)
        clock("effects left out")
        biases = susceptibility(bench, std, tell=clock.progress)
        choice = None
        if candidates:
            clock("sensors")
            choice = choose_sensor(bench, candidates, clock.progress)
        found = None
        if certificate:
            clock("certificate")
            found = certify(bench, certificate, seed, clock.progress, None if kept is None else Path(kept), resume)
    return Accuracy(bench, std, varied, biases, found, choice, _warnings(bench, varied, found), clock.stop())


def check_estimate(path: str | Path, experiment: Experiment, method: Estimator | None) -> tuple[Path, Estimator]:
    """The ``estimate.json`` (or its folder's) of an earlier run of ``identify`` with this experiment and method, and that method.

    It is refused early where a certificate cannot be written into it. Without a method, that is the one of the file.
    """
    path = Path(path)
    path = path / "estimate.json" if path.is_dir() else path
    document = read_document(path)
    method = estimator(str(document.get("method"))) if method is None else method
    for key, own in (("experiment", experiment.name), ("method", method.name)):
        if document.get(key) != own:
            raise InputError(
                f"{argument('estimate', str(path))}: its {key} is {document.get(key)!r}, not {own!r}; give the same {key} here"
            )
    return path, method


def add_certificate(path: Path, result: Accuracy) -> bool:
    """Write a certificate into its own ``estimate.json`` and report; whether the report was as written, and changed, too."""
    found, base = result.certificate, result.bench.problem.row_model.base
    assert found is not None
    listed = read_document(path).get("base_parameters", ())
    values = {p["name"]: p["value"] for p in listed}
    own = dict(zip(found.names, result.bench.estimate.values, strict=True))
    scale = dict(zip(found.names, np.nan_to_num(result.std), strict=True))
    if values.keys() != own.keys() or any(abs(values[n] - own[n]) > _SAME * scale[n] + 1e-9 * abs(own[n]) for n in own):
        raise InputError(
            f"{argument('estimate', str(path))}: is another estimate than that of these recordings and options; give the "
            "options that it "
            f"was made with, or run {call('identify')} again"
        )
    from bayesid.report.accuracy import with_certificate

    return amend(path, {"certificate": found.to_dict()}, lambda page: with_certificate(page, found, base))


def _bench(
    given: Experiment | Identification | str | Path, method: str | Estimator | None, options: FitOptions, nominal: bool,
    clock: Clock,
) -> Bench:  # fmt: skip
    """The bench of an experiment that is fitted now, or of one that was."""
    chosen = None if method is None else estimator(method)  # refused before any work is done
    if not isinstance(given, Identification):
        experiment = as_experiment(given, "an Identification")
        clock("estimate")
        problem = prepare(experiment, options)
        chosen = estimator(default_method(problem)) if chosen is None else chosen
        return make_bench(experiment, chosen, options, *solve(problem, chosen), nominal=nominal)
    if options != FitOptions():
        raise InputError("accuracy: an identification has its own channel, motions, effects and filter; leave them out")
    problem, estimate = given.problem, given.estimate
    if method is None and estimate.method not in METHODS:
        raise InputError(f"accuracy: the estimator '{estimate.method}' is your own; pass it as method, too")
    own = problem.options if problem.smoother.reason == "as given" else replace(problem.options, bandwidth=None)
    return make_bench(problem.experiment, chosen or estimator(estimate.method), own, problem, estimate, nominal=nominal)


def _warnings(bench: Bench, varied: Sweeps | None, found: CoverageCertificate | None) -> tuple[str, ...]:
    """What the user should know, most important first."""
    out = []
    if found is not None and not found.holds:
        short = [n for n, c in zip(found.names, found.coverage, strict=True) if c < found.band[0]]
        out.append(
            f"The intervals of {len(short)} of {len(found.names)} base parameters hold the truth less often than 95 % intervals "
            f"should ({', '.join(short[:3])}{' …' if len(short) > 3 else ''}): take them for longer than they are printed, or "
            f"choose another {argument('method')}."
        )
    details = bench.estimate.details
    if details.model_complete is False:
        out.append(incomplete(details.dispersion, details.dispersion_by_channel))
        out.append(
            "What the model misses is in the twins as noise of the same spectrum, without its dependence on the motion: real "
            "errors may be larger than simulated ones, and neither repeats nor a better sensor take it away. Look for the "
            f"missing effect first (`{call('diagnose')}`)."
        )
    if varied is not None and varied.formula is not None:
        doubt = _FAR / np.sqrt(2.0 * (varied.runs - 1))
        if abs(np.log(varied.agreement)) > doubt:
            out.append(
                f"Simulated standard deviations are {varied.agreement:.2f} times those of the formula: what the formula says of "
                "noise and record length holds in proportion only."
            )
    if bench.predicted_motions == bench.problem.fitted:
        out.append(
            "No validation motion: errors of predictions are those of the fitted motions, which are predicted best. "
            'Add a motion with role = "validation".'
        )
    return of_recordings(bench.experiment, out, [t.effect.name for t in bench.terms])
