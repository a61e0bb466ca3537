"""The verb ``identify``: base parameters with uncertainty, link parameters, and validation on unfitted motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bayesid.arguments import argument
from bayesid.dynamics.base_parameters import structural_base, unseen
from bayesid.estimators import Estimate, Estimator, estimator
from bayesid.estimators.attenuation import with_expected_error
from bayesid.estimators.conic.physical import against_nominal
from bayesid.estimators.factor import channel_grams, pilot_of
from bayesid.estimators.held_shapes import with_held_shapes
from bayesid.estimators.nonlinear import default_method, solve
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.linalg import UNSEEN, pseudo_inverse, undetermined
from bayesid.regression.options import FitOptions, fit_options
from bayesid.regression.parallel import both, in_order, one_blas_thread
from bayesid.regression.problem import Problem, prepare
from bayesid.results.fitted_model import own_offset
from bayesid.results.identification import Identification, NotShown
from bayesid.signals.filters import LowPass
from bayesid.tasks import cluster
from bayesid.validation.agreement import Alone, fits_alone, motions_apart, static_both_ways, wrench_against_torque
from bayesid.validation.flexible import FlexibleModel, flexible_gaps
from bayesid.validation.noise_floor import NoiseFloor, noise_floor
from bayesid.validation.prediction import predict
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.urdf_links import missing_rotors, urdf_links
from bayesid.workflows.warnings import contradictions, impossible_signs, left_of_fit, mistaken, of_fit, unusable


@shows_progress
def identify(
    experiment: Experiment | str | Path,
    channel: str | None = None,
    method: str | Estimator | None = None,
    *,
    options: FitOptions | None = None,
    low_pass: LowPass | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    static: str | None = None,
    bandwidth: float | None = None,
    unconstrained_urdf: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = SHOWN,
) -> Identification:
    """Base parameters with uncertainty, link parameters, and held-out validation.

    Parameters
    ----------
    experiment
        Loaded, or its folder.
    channel
        ``wrench``, ``torque`` or ``both``; default the wrench where there is a sensor, else the torques.
    method
        Name of an estimator, or an object with ``fit(regression)``; default ``wls``, with a mount that rings ``gls``.
    options
        All of ``channel``, ``low_pass``, ``motions``, ``effects``, ``static`` and ``bandwidth`` at once; those that are given
        beside it stand in its place.
    low_pass
        The paper's filters; default: rows straight from the smoothed trajectory.
    motions
        Names of the motions to fit; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    static
        ``motion`` (default) subtracts a stop-and-go run, ``joint`` fits it along.
    bandwidth
        Of the joint motion [Hz]; default chosen from the positions.
    unconstrained_urdf
        Also write ``identified-unconstrained.urdf``: links with exactly the estimated base parameters, possible or not.
    workers, scheduler
        Processes on this machine that share the work, or the address of a Dask cluster that does; the result depends on neither.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    method = None if method is None else estimator(method)  # refused before any work is done
    options = fit_options(options, channel, low_pass, motions, effects, static, bandwidth)
    clock = Clock(progress)
    with one_blas_thread(), cluster(workers, scheduler):
        clock("reading")
        experiment = as_experiment(experiment)
        clock("regressor")
        problem = prepare(experiment, options)
        method = estimator(default_method(problem)) if method is None else method
        unfitted = problem.judges
        unseen, estimating = [motion.name for motion in unfitted], partial(clock, "estimate")  # rows are timed apart
        if problem.row_model.point is None:
            # What needs the motions' rows alone is done beside the fit: while its own rows are made, another core has time.
            (problem, estimate), (alone, floor, flexible) = both(
                partial(solve, problem, method, estimating), partial(_beside, problem, method, unseen)
            )
        else:  # everything is linearised at the estimate, which comes first
            problem, estimate = solve(problem, method, estimating)
            estimate = with_held_shapes(problem, with_expected_error(problem, estimate, method))
            alone, floor, flexible = {}, noise_floor(problem), None
        clock("prediction")
        # Fits of single motions and links need none of the predictions: all at once, the longest first.
        flexibly = partial(flexible_gaps, problem, estimate.solution, unseen, flexible)
        fits, possible = partial(motions_apart, problem, estimate, method, alone), partial(urdf_links, problem, estimate)
        predicted = [partial(predict, problem, estimate, motion, floor) for motion in unfitted]
        gaps, *predictions, links, agreements = in_order(lambda job: job(), [flexibly, *predicted, possible, fits])
        validation = tuple(replace(p, flexible=gaps.get(p.motion)) for p in predictions)
        clock("consistency")
        alternative = static_both_ways(problem, method)
        if problem.channel == "both":
            across = wrench_against_torque(problem, method)
            agreements += [across] if across is not None else []
        not_shown = _not_shown(problem, estimate)
        check = against_nominal(problem.regression, estimate)
        signs = impossible_signs(estimate, problem)
        # A base that hangs upside down predicts a reversed wrench as well as the robot would, of bodies that cannot exist.
        none_possible = problem.channel == "wrench" and links.moved is not None and not links.moved.inside
        mistakes = mistaken(problem, validation, bool(signs) or none_possible)
        of_rotors = missing_rotors(problem, estimate, method, options, links, bool(mistakes))
    of_links = [*(of_rotors if links.usable else []), *links.warnings()]
    no_use = (*unusable(problem, validation, mistakes), *(() if links.usable else of_rotors))
    rank = estimate.base.rank
    result = Identification(
        problem=problem,
        estimate=estimate,
        urdf=links,
        validation=validation,
        agreements=tuple(agreements),
        static_alternative=alternative,
        offset=own_offset(problem, estimate.solution[rank:], estimate.unbiased_std[rank:], links.unconstrained),
        not_shown=not_shown,
        warnings=no_use,
        seconds=clock.stop(),
        prior_check=check,
        unconstrained_urdf=unconstrained_urdf,
        floor=floor,
        unusable=no_use,
    )
    return replace(result, warnings=(*no_use, *_warnings(result, [*mistakes, *signs], of_links)))


def _beside(problem: Problem, method: Estimator, unseen: list[str]) -> tuple[Alone, NoiseFloor | None, FlexibleModel | None]:
    """Fits of motions alone that are not fitted together, the noise that is left to any estimate, and a flexible model's rows."""
    others = [name for name in problem.segments if name not in problem.fitted]
    alone, encoders = fits_alone(problem, method, others), problem.regression.regressor_noise
    if encoders is not None:  # the end of the fit will ask
        encoders.present()
    floor, flexible = noise_floor(problem), FlexibleModel.of(problem, unseen)
    if problem.regression.rows.fits_in_memory:  # the links will
        channel_grams(problem.regression.rows)
    return alone, floor, flexible


def _not_shown(problem: Problem, estimate: Estimate) -> NotShown:
    """What these readings do not show, and whether that is for the motions, the static run or an effect in the model."""
    row_model = problem.row_model
    base = rich = row_model.base
    # Otherwise the base parameters are those of a rich motion already.
    if all(s.poses or not s.gravity for s in problem.fitted_segments):
        rich = structural_base(row_model.robot, row_model.channels, offset=base.absorbed is not None)
    hidden = unseen(rich, base)
    if hidden and problem.at_rest:
        return NotShown(motions=hidden, invisible=tuple(rich.invisible))
    with_offset = structural_base(row_model.robot, row_model.channels, offset=True) if hidden else base
    gone = unseen(rich, with_offset)
    along = tuple(label for label in hidden if label not in gone)
    weak = [label for label, kind in zip(base.labels, estimate.classes, strict=True) if kind in ("weak", "prior")]
    effects = _lost_to_effects(problem, estimate)
    motions = tuple(label for label in weak if label not in effects)
    return NotShown(motions, hidden, along, effects, tuple((rich if problem.at_rest else base).invisible))


def _lost_to_effects(problem: Problem, estimate: Estimate) -> dict[str, tuple[str, ...]]:
    """Base parameters that the rows show without effects and not beside them: which effects take each, by its label.

    Not beside them: they are not determined, or known no better than the size of a body, and most of that variance is of not
    knowing the effect. Where only a rounded right angle of the URDF tells a rotor from its link, that is thousands of kg m^2.
    """
    regression, rank = problem.regression, estimate.base.rank
    poorly = estimate.undetermined[:rank] | estimate.weak[:rank]
    if not poorly.any() or not regression.effect_names:
        return {}
    matrix = pilot_of(regression.rows).whitened(learn_weights(regression).noise).matrix
    specs = np.array([*[""] * rank, *(name.rpartition(".")[0] for name in regression.effect_names)])
    hidden = estimate.undetermined[:rank] | undetermined(matrix)[:rank]
    variance = _variances(matrix)[:rank]

    def shown_without(out: np.ndarray) -> np.ndarray:
        rest = matrix[:, ~out]
        return ~undetermined(rest)[:rank] & (hidden | (_variances(rest)[:rank] < 0.5 * variance))

    # Where it takes several to hide a parameter, as a drive's offset and rotor do a load, these are not determined either.
    several = tuple(dict.fromkeys(specs[rank:][estimate.undetermined[rank:]].tolist()))
    alone = shown_without(specs != "")
    beside = {spec: shown_without(specs == spec) for spec in dict.fromkeys(specs.tolist()) if spec}
    out: dict[str, tuple[str, ...]] = {}
    for k in np.flatnonzero(poorly & alone).tolist():
        if taking := tuple(spec for spec, shown in beside.items() if shown[k]) or (several if hidden[k] else ()):
            out[estimate.base.labels[k]] = taking
    return out


def _variances(matrix: np.ndarray) -> np.ndarray:
    """Variances of the parameters of a whitened factor (k, p) with noise of one (p,)."""
    return np.sum(pseudo_inverse(matrix, UNSEEN) ** 2, axis=1)


def _of_what_is_not_shown(lost: NotShown) -> list[str]:
    """What the readings do not show and what helps, a line for each reason."""
    out = []
    if lost.motions:
        out.append(
            f"Not excited by these motions: {listed(lost.motions, 6)}. "
            "The data say no more there than the size of a body does: add motions that move these links in other ways, or rely "
            "on the nominal model there."
        )
    if lost.effects:
        specs = listed(dict.fromkeys(spec for effects in lost.effects.values() for spec in effects), 6)
        out.append(
            f"Not told from an effect in the model ({specs}): {listed(lost.effects, 6)}. These motions show them only together: "
            "state what is known of the effect in [model.values], as a data sheet gives it, or rely on the sum alone."
        )
    if lost.static_run:
        remedy = "Rely on the nominal model or a scale there."
        if lost.fitted_along:
            what = "them" if len(lost.fitted_along) == len(lost.static_run) else listed(lost.fitted_along, 6)
            remedy = f"Fitted along ({argument('static', 'joint')}), it shows {what}."
        out.append(f"The static run takes gravity with it, so that no motion shows {listed(lost.static_run, 6)}. {remedy}")
    return out


def _warnings(result: Identification, wrong: Sequence[str], of_links: Sequence[str]) -> tuple[str, ...]:
    """What the user should know, most important first."""
    problem, estimate = result.problem, result.estimate
    out = of_fit(problem, estimate, result.prior_check, wrong, result.validation)
    smoother = problem.smoother
    highest = smoother.at_end and smoother.bandwidth >= 0.999 * smoother.automatic
    if highest and not problem.at_rest and smoother.reason != "as given":  # poses at rest have no bandwidth
        half = float(f"{0.5 * smoother.bandwidth:.2g}")
        out.append(
            f"The bandwidth of the motion is {smoother.bandwidth:.3g} Hz, the end of the range searched: the positions hold more "
            f"than motion and white encoder noise up to there. Compare with {argument('bandwidth', half)}; a difference says "
            "that the estimate depends on it."
        )
    out += contradictions(result.agreements)
    out += left_of_fit(estimate, result.fitted, alone=not result.validation)
    # What the estimator itself has to say, such as weak instruments.
    out += estimate.details.warnings
    out += _of_what_is_not_shown(result.not_shown)
    out += of_links
    if estimate.links is not None and not problem.regression.knowledge.states_masses:
        out.append(
            f"The URDF states no masses: {estimate.method} takes links near to cylinders between the joints, within a factor of "
            "ten, where the data say nothing. Write the masses of a data sheet into the URDF, or bound them "
            f"({argument('bounds', 'FILE')})."
        )
    if problem.row_model.base.weight_in_offset:
        out.append(
            "No static run removes the sensor's offset, so it is estimated along: what looks like an offset, "
            "above all the total mass, cannot be identified. Where a scale says the mass, state it "
            f"({argument('bounds', 'FILE')})."
        )
    return problem.experiment.with_findings(out, validated=bool(result.validation))
