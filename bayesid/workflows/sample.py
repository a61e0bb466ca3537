"""The posterior of an experiment or a regression: draws, held-out validation, files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict, Unpack, overload

import numpy as np
from scipy.linalg import cholesky

from bayesid.arguments import argument, with_given
from bayesid.errors import InputError, require_one_of
from bayesid.estimators import Estimate
from bayesid.estimators.attenuation import expected_error
from bayesid.estimators.conic.physical import Physical, against_prior
from bayesid.estimators.estimator import largest_autocorrelation
from bayesid.estimators.nonlinear import settled
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.predictive import predictive_groups
from bayesid.posterior.result import PRIOR_DRIVEN, Posterior, moments
from bayesid.posterior.run import ConvergenceError, Sampler, choose_engine, run
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.linalg import condition_number
from bayesid.regression.options import NOT_FOR_REGRESSIONS, FitOptions, fit_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.regression import Regression
from bayesid.regression.rows import make_blocks
from bayesid.results.posterior import ExperimentPosterior
from bayesid.robot.prior import Prior
from bayesid.signals.filters import LowPass
from bayesid.signals.noise import NoiseModel
from bayesid.tasks import cluster
from bayesid.validation.flexible import flexible_gaps
from bayesid.validation.noise_floor import noise_floor
from bayesid.validation.prediction import Prediction, predict
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.warnings import incomplete, mistaken, of_fit

PRIORS = ("nominal", "flat")


class SampleChoices(TypedDict, total=False):
    """The keywords of `sample`, for its two signatures; explained there."""

    prior: str | Prior | None
    prior_std: float | None
    noise: str
    chains: int | None
    keep_going: bool
    sampler: Sampler | None
    channel: str | None
    options: FitOptions | None
    low_pass: LowPass | None
    motions: str | Sequence[str] | None
    effects: str | Sequence[str] | None
    static: str | None
    bandwidth: float | None
    workers: int | None
    scheduler: str | None
    progress: Progress | None


@overload
def sample(experiment: Regression, draws: int = ..., seed: int = ..., **choices: Unpack[SampleChoices]) -> Posterior: ...


@overload
def sample(
    experiment: Experiment | str | Path, draws: int = ..., seed: int = ..., **choices: Unpack[SampleChoices]
) -> ExperimentPosterior: ...


@shows_progress
def sample(
    experiment: Experiment | Regression | str | Path,
    draws: int = 2000,
    seed: int = 0,
    *,
    prior: str | Prior | None = None,
    prior_std: float | None = None,
    noise: str = "gaussian",
    chains: int | None = None,
    keep_going: bool = False,
    sampler: Sampler | None = None,
    channel: str | None = None,
    options: FitOptions | None = None,
    low_pass: LowPass | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    static: str | None = None,
    bandwidth: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = SHOWN,
) -> Posterior:
    """Draws from the posterior over base parameters, the links behind them, effects and the noise.

    Parameters
    ----------
    experiment
        Loaded, its folder, or a regression of one's own.
    draws, seed
        Draws in all, rounded up to as many of each chain; the same seed gives the same draws.
    prior
        ``nominal``: links near the nominal ones, and bodies that can exist only; ``flat``: on the base parameters,
        without bounds; or a `Prior`. Default: nominal where the experiment says how far its links are trusted.
    prior_std
        Prior relative standard deviation of every mass, such as 0.3; default the experiment's.
    noise
        ``gaussian``, or ``student`` for outliers that strike all channels of an instant.
    chains
        Independent chains that the draws come from; default those of ``sampler``.
    keep_going
        Return draws that have not converged, with a warning, instead of refusing.
    sampler
        How draws are made: engine, length, and the file that keeps an unfinished run.
    channel, options, low_pass, motions, effects, static, bandwidth
        As in `bayesid.identify`; for experiments.
    workers, scheduler
        Processes on this machine that share the work, or the address of a Dask cluster that does; the result depends on neither.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    ConvergenceError
        The chains did not converge; its ``partial`` holds what there is.
    """
    clock = Clock(progress)
    sampler = with_given(sampler or Sampler(), chains=chains)
    options = fit_options(options, channel, low_pass, motions, effects, static, bandwidth)
    with one_blas_thread(), cluster(workers, scheduler):
        clock("reading")
        problem = None
        if isinstance(experiment, Regression):
            if options != FitOptions():
                raise InputError(NOT_FOR_REGRESSIONS.format("sample"))
            regression = experiment
        else:
            experiment = as_experiment(experiment, "a Regression")
            clock("regressor")
            problem = prepare(experiment, options)
            rel_std = _prior(problem.regression, prior, prior_std)[1]
            # Where the prior pulls all to other values than the data alone, readings are linearised there.
            problem = settled(problem, Physical(rel_std=rel_std) if rel_std else None)
            regression = problem.regression
        chosen, rel_std = _prior(regression, prior, prior_std)
        clock("noise")
        model = PosteriorModel.of(regression, chosen, noise)
        check = None if chosen is None else against_prior(regression, chosen, rel_std)
        if chosen is not None and check is not None:
            model = replace(model, prior=chosen.widened(check.widening))
        clock("sampling")
        result = run(
            model, choose_engine(model, sampler.engine, sampler.moves), draws=draws, chains=sampler.chains, seed=seed,
            longest=sampler.longest, checkpoint=None if sampler.checkpoint is None else Path(sampler.checkpoint),
            resume=sampler.resume, tell=clock.progress,
        )  # fmt: skip
        clock("prediction")
        posterior = Posterior(model, result, seed, prior_check=check)
        posterior = _with_predictions(posterior, regression, problem, rel_std, clock)
    if not result.diagnosis.passed and not keep_going:
        error = ConvergenceError(
            f"the chains did not converge in {sampler.longest} times the usual length: {result.diagnosis.complaint()}; "
            f"draw longer ({argument('longest', 2 * sampler.longest)}), take {argument('engine', 'hmc')}, or look at the draws "
            f"with {argument('keep_going', True)}"
        )
        error.partial = posterior
        raise error
    return posterior


def _prior(regression: Regression, prior: str | Prior | None, std: float | None) -> tuple[Prior | None, float | None]:
    """The prior asked for, or the default one, and its relative standard deviation."""
    if isinstance(prior, Prior):
        if std is not None:
            raise InputError(f"{argument('prior_std', std)} is given with a Prior, which states its own; leave it out")
        return prior, None
    stated = regression.knowledge.inertia_rel_std
    if std is not None and not (np.isfinite(std) and std > 0):
        raise InputError(f"{argument('prior_std', std)}: give a positive number, such as 0.3")
    if prior is None:
        prior = "nominal" if regression.knowledge.states_masses and (std or stated) else "flat"
    require_one_of(prior, PRIORS, argument("prior", prior))
    if prior == "flat":
        if std is not None:
            raise InputError(
                f"{argument('prior_std', std)} is for the nominal prior; leave it out with {argument('prior', 'flat')}"
            )
        return None, None
    if regression.knowledge.nominal_links is None:
        raise InputError(f"{argument('prior', 'nominal')}: there are no nominal links; pass a Prior of your own")
    if not regression.knowledge.states_masses:
        raise InputError(
            f"{argument('prior', 'nominal')}: the URDF states no masses; write them there, or take {argument('prior', 'flat')}"
        )
    rel_std = std or stated
    if not rel_std:
        raise InputError(
            f"{argument('prior', 'nominal')}: the experiment states no inertia_rel_std above 0; add {argument('prior_std', 0.3)}"
        )
    return regression.knowledge.prior(rel_std), rel_std


def _with_predictions(
    posterior: Posterior, regression: Regression, problem: Problem | None, rel_std: float | None, clock: Clock
) -> Posterior:
    if problem is None:
        extra = predictive_groups(posterior, regression.rows.blocks(), regression.rows.pilot(), (), regression.channel_names)
        return replace(posterior, extra=extra)
    judges = problem.judges
    unseen = (problem.segments[m.name] for m in judges)
    blocks = (b for s in unseen for b in make_blocks(problem.row_model, [part for part in s if not part.poses] or s))
    extra = predictive_groups(posterior, regression.rows.blocks(), regression.rows.pilot(), blocks, regression.channel_names)
    estimate = as_estimate(posterior)
    floor = noise_floor(problem)
    fitted = tuple(predict(problem, estimate, m, floor) for m in problem.experiment.motions if m.name in problem.fitted)
    gaps = flexible_gaps(problem, estimate.solution, [m.name for m in judges])
    validation = tuple(replace(predict(problem, estimate, m, floor), flexible=gaps.get(m.name)) for m in judges)
    error, rank = expected_error(problem, estimate.solution), posterior.base.rank
    clock.stop()
    return ExperimentPosterior(
        posterior.model, posterior.chains, posterior.seed, extra, posterior.prior_check, problem=problem, fitted=fitted,
        validation=validation, rel_std=rel_std, warnings=_warnings(posterior, problem, estimate, validation),
        seconds=clock.seconds, expected_error=None if error is None else error[rank:],
    )  # fmt: skip


def as_estimate(posterior: Posterior) -> Estimate:
    """The posterior's mean and covariance as an estimate, for predictions and comparisons."""
    model = posterior.model
    _, solution, covariance = moments(posterior.columns)
    scales = np.sqrt(np.mean(posterior.noise_scales**2, axis=(0, 1)))
    if model.noise == "student":
        nu = model.split(posterior.chains.draws)[2]
        scales = scales * np.sqrt(np.median(nu / np.maximum(nu - 2.0, 0.5)))
    assert model.likelihood.noise is not None
    noise = {}
    for group, part in zip(model.likelihood.groups, np.split(scales, len(model.likelihood.groups)), strict=True):
        was = model.likelihood.noise[group]
        root = cholesky(was.innovation, lower=True) * part
        noise[group] = NoiseModel(was.coefficients, root @ root.T, was.from_zero)
    factor = model.likelihood.factor
    assert factor is not None
    residual = np.sum((factor.matrix @ solution - factor.target) ** 2) + factor.least_squares
    undetermined = np.zeros(len(solution), bool)
    weak = np.zeros(len(solution), bool)
    weak[: posterior.base.rank] = posterior.prior_share > PRIOR_DRIVEN
    return Estimate(
        method="posterior", base=posterior.base, effect_names=model.effect_names, effect_units=model.effect_units,
        solution=solution, full_covariance=covariance, undetermined=undetermined, weak=weak, interval="credible", noise=noise,
        rows=factor.rows, condition_number=condition_number(factor.matrix), residual_rms=float(np.sqrt(residual / factor.rows)),
        whiteness=largest_autocorrelation([w[:, :, -1] - w[:, :, :-1] @ solution for w in model.likelihood.white]),
    )  # fmt: skip


def _warnings(posterior: Posterior, problem: Problem, estimate: Estimate, validation: Sequence[Prediction]) -> tuple[str, ...]:
    converged = () if posterior.diagnosis.passed else (
        f"The chains did not converge: {posterior.diagnosis.complaint()}. Do not use these draws as a posterior; "
        f"draw longer, such as {argument('longest', 64)}, or take {argument('engine', 'hmc')}.",
    )  # fmt: skip
    wrong = [*converged, *mistaken(problem, validation, False)]
    out = of_fit(problem, estimate, posterior.prior_check, wrong, validation)
    if not posterior.model.likelihood.complete:
        out.append(incomplete(posterior.model.likelihood.dispersion))
    driven = [label for label, share in zip(posterior.base.labels, posterior.prior_share, strict=True) if share > PRIOR_DRIVEN]
    if driven:
        out.append(
            f"Driven by the prior, the data hardly narrow them: {listed(driven, 4)}. They are as good as the nominal model: add "
            "motions that move these links in other ways."
        )
    if posterior.model.prior is None:
        out.append(
            "The prior is flat on the base parameters, so links are not sampled and nothing keeps them possible; "
            f"take {argument('prior', 'nominal')} and {argument('prior_std', 0.3)} for both."
        )
    return problem.experiment.with_findings(out, validated=bool(validation))
