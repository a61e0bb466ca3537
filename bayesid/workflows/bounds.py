"""The verb ``bounds``: what a controller may rely on after a posterior or an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, call
from bayesid.design.bounds.bands import FAR, Band, band
from bayesid.design.bounds.knowledge import PRIOR_DRAWS, Known, known_from, prior_links
from bayesid.design.bounds.model import ReadingModel, left_out_effects, possible_parameters, sensor_model, spread, torque_model
from bayesid.design.bounds.region import effort_ratio
from bayesid.design.bounds.remainder import Remainder, remainder
from bayesid.design.bounds.workspace import CONFIGURATIONS, inside_joints, sobol_configurations, workspace_bounds
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects import Effect, MotionSegment
from bayesid.effects.families import only_read
from bayesid.errors import InputError
from bayesid.estimators import Estimator
from bayesid.posterior.result import Posterior, moments
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, fit_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.readings import make_channels
from bayesid.results.bounds import ControllerBounds, TrajectoryBands
from bayesid.results.fitted_model import joint_dynamics
from bayesid.results.identification import Identification
from bayesid.results.loaded import LoadedIdentification, LoadedPosterior, load
from bayesid.results.posterior import ExperimentPosterior, posterior_robot
from bayesid.robot.robot import motion_limits
from bayesid.rounding import number
from bayesid.signals.filters import LowPass
from bayesid.simulation.trajectories import Trajectory, as_trajectory
from bayesid.validation.noise_floor import noise_floor
from bayesid.workflows.identify import identify
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.sample import sample


def assumptions(result: ControllerBounds, dropped: Sequence[Effect]) -> tuple[str, ...]:
    """What the bounds rest on."""
    known, w = result.known, result.workspace
    robot = known.problem.experiment.robot
    law = (
        f"Parameters follow a normal law with the covariance of the {known.source} ({known.method})."
        if known.draws is None
        else f"Parameters follow {len(known.draws)} posterior draws ({known.method})."
    )
    out = [law]
    if known.dispersion > 1.0:
        out.append(
            f"The scatter between parts of the recording is counted: the covariance is {known.dispersion:.3g} times what noise "
            "alone would give."
        )
    if known.held_out_scale < 1.0:
        out.append(
            f"Motions that were not fitted are predicted better than that, so {known.held_out_scale:.3g} of that covariance "
            "is kept."
        )
    out.append(
        f"Mass matrix, Coriolis terms and gravity are bounded over {w.draws} robots that can exist, drawn within the "
        f"uncertainty, at {w.configurations} configurations. What the data do not determine is as uncertain as nominal links are "
        f"with a relative standard deviation of {known.rel_std:.3g} of every mass, and bodies that can exist allow."
    )
    unlimited = ~(np.isfinite(robot.lower) & np.isfinite(robot.upper))
    if unlimited.any():
        names = [n for n, u in zip(robot.joint_names, unlimited, strict=True) if u]
        out.append(f"The URDF states no position limits of {listed(names, 4)}: half a turn to both sides is taken (0.25 m).")
    out.append(
        "Links are rigid, and the robot's geometry is as the URDF says. Configurations may collide; nobody looks out for that."
    )
    if read := [e.spec for e in dropped if only_read(e)]:
        out.append(f"Torques are those that act, not what drives read of them: {listed(read, 4)} is taken out of the readings.")
    if acting := [e.spec for e in dropped if not only_read(e)]:
        out.append(
            f"Not in the torques: {listed(acting, 4)}, which depend on more than the joint's own motion. They count as other "
            "uncertainty."
        )
    return tuple(out)


def warnings(result: ControllerBounds) -> list[str]:
    """What the user should know, most important first."""
    known, w, out = result.known, result.workspace, []
    if known.links.complaint:
        out.append(
            f"The draws of links that can exist did not converge ({known.links.complaint}): bounds of the workspace are not sure."
        )
    left = result.remainder
    if left is not None and left.held_out and not left.complete:
        out.append(
            f"Something is missing in the model: {listed(left.motions, 3)}, not fitted, is predicted worse than noise and "
            "parameters explain. Bands of torques hold what is left as other uncertainty; sets of parameters do not. "
            f"`{call('diagnose')}` looks for what is missing."
        )
    if w.nominal_eigenvalue <= 0.0:
        out.append(
            "The mass matrix of the estimate itself is not positive definite everywhere: mass matrix, Coriolis terms and "
            "gravity are those of identified.urdf, whose links can exist. Take these for a controller that inverts it."
        )
    if w.alpha >= 1.0:
        out.append(
            f"alpha = {w.alpha:.3g} is not below 1: no gain of a computed-torque controller is certain to be stable. Identify "
            "with motions that move all links in other ways."
        )
    driven = [label for label, d in zip(result.region.labels, result.region.prior_driven, strict=True) if d]
    if driven:
        out.append(
            f"Driven by the prior, the data hardly narrow them: {listed(driven, 4)}. Bounds that depend on them are as good as "
            "the nominal model and its stated uncertainty."
        )
    if result.wrench_model is not None:
        region = result.wrench_model.region
        beyond = [label for label, d in zip(region.labels, region.prior_driven, strict=True) if d]
        if beyond:
            out.append(f"The wrench's bands, not those of the torques, rest on the prior for {listed(beyond, 3)}.")
    if not result.inside.complete:
        rotor = np.nanmax(np.append(result.inside.rotor_share, 0.0))
        sees = "does not see" if known.problem.channel == "wrench" else "could see, but the model has not all of"
        extra = f"; rotors usually add up to {number(rotor, 2)} times a joint's inertia" if rotor > 0.0 else ""
        out.append(
            f"The {'sensor' if known.problem.channel == 'wrench' else 'torque reading'} {sees} what is inside the joints{extra}. "
            f"Bounds are without these {result.inside.unknown}: identify them from the torques (effects "
            f"{', '.join(result.inside.lacking)}), or add a data sheet's numbers."
        )
    if result.remainder is None:
        unread = f"{result.unread[0].upper()}{result.unread[1:]}"
        out.append(f"{unread}, so nothing says how large the other uncertainty is: friction, rotors, flexibility.")
    elif not result.remainder.held_out:
        out.append(
            "Other uncertainty is that of motions that were fitted, which hides some of it: record a validation motion's torques."
        )
    for t in result.trajectories:
        far = [*t.torque.far, *(() if t.wrench is None else t.wrench.far)]
        if far:
            out.append(
                f"Trajectory '{t.name}' goes beyond the fitted motions: standard deviations are more than {FAR:g} times those "
                f"there in {listed(far, 6)}. Such a motion tests what was hardly fitted."
            )
    return out


#: Samples of the fitted motions that standard deviations are looked at in, and motions of the experiment that get bands.
_TRAINED, _SHOWN = 2000, 2
#: Links that are drawn.
DRAWS = 2000


@shows_progress
def bounds(
    source: ExperimentPosterior | Identification | Experiment | str | Path,
    *,
    run: str | Path | None = None,
    method: str | Estimator | None = None,
    trajectory: Trajectory | str | Path | None = None,
    urdfs: int = 0,
    prior_std: float | None = None,
    configurations: int = CONFIGURATIONS,
    seed: int = 0,
    channel: str | None = None,
    options: FitOptions | None = None,
    low_pass: LowPass | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    static: str | None = None,
    bandwidth: float | None = None,
    progress: Progress | None = SHOWN,
) -> ControllerBounds:
    """Bounds for the design of a controller: of parameters, mass matrix, Coriolis terms, gravity and torques.

    Parameters
    ----------
    source
        A posterior or an identification; or an experiment or its folder, which is sampled, where the experiment says how far
        its links are trusted, or identified.
    run
        Folder in which `bayesid.sample` or `bayesid.identify` wrote their files, of the experiment in ``source``.
    method
        Of an experiment: identify it with this estimator and do not sample.
    trajectory
        A planned motion whose torques and wrench get bands, or a table of it as `bayesid.read_trajectory` takes it; default the
        motions that were not fitted.
    urdfs
        How many URDFs of links that can exist are written, drawn within the uncertainty.
    prior_std
        Relative standard deviation of every nominal mass, where the data do not decide; default what the experiment states,
        else 1.
    configurations
        Joint positions that the workspace is looked at in.
    seed
        Of everything random.
    channel, options, low_pass, motions, effects, static, bandwidth
        As in `bayesid.identify`; for experiments.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    clock = Clock(progress)
    if urdfs < 0 or configurations < 1:
        raise InputError(f"{argument('urdfs', urdfs)}, {argument('configurations', configurations)}: give at least 0 and 1")
    if prior_std is not None and not (np.isfinite(prior_std) and prior_std > 0):
        raise InputError(f"{argument('prior_std', prior_std)}: give a positive number, such as 0.3")
    done = isinstance(source, (ExperimentPosterior, Identification))
    chosen = fit_options(options, channel, low_pass, motions, effects, static, bandwidth)
    if done and (run is not None or method is not None or chosen.given()):
        named = ", ".join(chosen.given()) or ("run" if run is not None else "method")
        raise InputError(f"{named}: is for experiments; a {type(source).__name__} was fitted already")
    clock("reading")
    if not isinstance(source, (ExperimentPosterior, Identification)):
        source = as_experiment(source, "a posterior or an identification")
    robot = source.robot if isinstance(source, Experiment) else source.problem.experiment.robot
    planned = None if trajectory is None else as_trajectory(trajectory, robot)
    with one_blas_thread():
        if run is not None and isinstance(source, Experiment):
            known, warned = _known_from_run(source, Path(run), chosen, prior_std, seed)
        else:
            if isinstance(source, Experiment):
                clock("posterior or estimate")
                source = _fitted(source, method, prior_std, seed, clock, chosen)
            clock("links that can exist")
            known, warned = _known(source, prior_std, seed), source.warnings
        return _bounded(known, warned, planned, urdfs, configurations, seed, clock)


def _fitted(
    experiment: Experiment, method: str | Estimator | None, prior_std: float | None, seed: int, clock: Clock, options: FitOptions
) -> ExperimentPosterior | Identification:
    """The experiment sampled, or identified where a method is named or nothing is said of its links."""
    known = bool(prior_std or experiment.inertia_rel_std) and bool((experiment.robot.nominal[:, 0] > 0.0).any())
    if method is None and known:
        return sample(experiment, draws=DRAWS, prior_std=prior_std, seed=seed, progress=clock.progress, options=options)
    return identify(experiment, method=method, progress=clock.progress, options=options)


def _known(source: ExperimentPosterior | Identification, prior_std: float | None, seed: int) -> Known:
    """What is known after a fit just made."""
    if isinstance(source, Identification):
        e, urdf = source.estimate, source.urdf
        return known_from(
            source.problem, source="estimate", method=e.method, mean=e.solution, covariance=e.full_covariance,
            undetermined=e.undetermined, centre=urdf.unconstrained, urdf=urdf.links, dynamics=urdf.dynamics, rel_std=prior_std,
            conflict=source.prior_check is not None and source.prior_check.conflict, dispersion=e.details.dispersion or 1.0,
            floor=source.floor, count=DRAWS, seed=seed,
        )  # fmt: skip
    model, kept = source.model, source.model.physical and source.link_draws is not None
    robot = posterior_robot(source)
    return _known_of_draws(
        source.problem, source, f"{'flat' if model.prior is None else 'nominal'} prior, {model.noise} noise",
        source.link_draws if kept else None,
        model.prior_draws(DRAWS, np.random.default_rng(source.seed)) if kept else None,
        None if robot is None else robot[0], prior_std or source.rel_std, model.likelihood.dispersion, seed,
    )  # fmt: skip


def _known_from_run(
    experiment: Experiment, run: Path, options: FitOptions, prior_std: float | None, seed: int
) -> tuple[Known, tuple[str, ...]]:
    """What is known after an earlier run, by its folder, ``estimate.json`` or ``posterior.json``, and the warnings it had.

    Effects, static and bandwidth of ``options`` count where the run was given others than the experiment has. An `InputError`
    where files are missing, are no run's, or belong to another experiment or model.
    """
    named = [run / name for name in ("estimate.json", "posterior.json")]
    file = run if run.suffix == ".json" else next((f for f in named if f.is_file()), named[0])
    if not file.is_file():
        raise InputError(f"{file}: no such file; name a folder that identify or sample wrote")
    found, model = load(file), file.parent / "model.toml"
    if not isinstance(found, (LoadedIdentification, LoadedPosterior)):
        raise InputError(f"{file}: is not as a run of bayesid writes it; name a folder of identify or sample")
    if options.effects is None and isinstance(found, LoadedIdentification) and model.is_file():
        experiment = experiment.with_model(model)
    try:
        return _known_of_loaded(experiment, found, options, prior_std, seed), tuple(found.document["warnings"])
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(f"{file}: is not as a run of bayesid writes it ({error}); run it again") from None


def _known_of_loaded(
    experiment: Experiment, found: LoadedIdentification | LoadedPosterior, options: FitOptions, prior_std: float | None, seed: int
) -> Known:
    document, file = found.document, found.path
    if document["experiment"] != experiment.name:
        other = document["experiment"]
        raise InputError(f"{file}: is of experiment '{other}', not of '{experiment.name}'; name a run of this one")
    filters = document["filter"]
    low_pass = None if filters["l"] is None else LowPass(filters["l"], filters["d"])
    fitted = {"channel": document["channel"], "low_pass": low_pass, "motions": tuple(document["motions"])}
    for name, value in fitted.items():
        if name in options.given() and getattr(options, name) != value:
            raise InputError(f"{file}: was fitted with another {argument(name)}; leave that out, or run it again with it")
    static = "joint" if "joint" in (document.get("static", "none"), options.static) else "motion"
    bandwidth = options.bandwidth or filters.get("bandwidth_hz")
    problem = prepare(experiment, FitOptions(**fitted, effects=options.effects, static=static, bandwidth=bandwidth))
    base, effects = problem.row_model.base, problem.regression.effect_names
    names = [p["name"] for p in (*document["base_parameters"], *document["effect_parameters"])]
    if names != [*base.names, *effects]:
        raise InputError(
            f"{file}: its parameters are not those of this experiment and model; give the {argument('effects')} and "
            f"{argument('static')} of that run, or run it again"
        )
    if isinstance(found, LoadedPosterior):
        prior, links, rel_std = None, None, prior_std or document["inertia_rel_std"]
        if found.physical and rel_std:
            if (links := found.link_draws) is None:
                raise KeyError("link")
            prior = prior_links(base, problem.regression.knowledge.prior(rel_std), PRIOR_DRAWS, seed)
        method = f"{'flat' if document['prior'].startswith('flat') else 'nominal'} prior, {document['noise']} noise"
        return _known_of_draws(problem, found, method, links, prior, None, rel_std, float(document["dispersion"]), seed)
    e, links = found.estimate, found.link_parameters
    if document["identified_urdf"]["moved"] is None:  # the estimator's own
        centre = links
    else:
        centre = nearest_links(experiment.robot, base, e.values, ~e.undetermined[: base.rank])
    return known_from(
        problem, source="estimate", method=e.method, mean=e.solution, covariance=e.full_covariance, undetermined=e.undetermined,
        centre=centre, urdf=links,
        dynamics=found.dynamics, rel_std=prior_std, conflict=bool((document["prior_against_data"] or {}).get("conflict")),
        dispersion=e.details.dispersion or 1.0, floor=noise_floor(problem), count=DRAWS, seed=seed,
    )  # fmt: skip


def _known_of_draws(
    problem: Problem, posterior: Posterior | LoadedPosterior, method: str, links: np.ndarray | None, prior: np.ndarray | None,
    urdf: np.ndarray | None, rel_std: float | None, dispersion: float, seed: int,
) -> Known:  # fmt: skip
    """What is known after a posterior, by draws of links (chains, draws, P) and of their prior (m, P)."""
    draws, mean, covariance = moments(np.concatenate([posterior.base_draws, posterior.effect_draws], axis=-1))
    nothing, rank = np.zeros(len(mean), bool), problem.row_model.base.rank
    known = known_from(
        problem, source="posterior", method=method, mean=mean, covariance=covariance, undetermined=nothing,
        draws=draws, urdf=urdf, link_draws=None if links is None else links.reshape(-1, links.shape[-1]), prior_draws=prior,
        rel_std=rel_std, dispersion=dispersion, count=DRAWS, seed=seed,
    )  # fmt: skip
    return replace(known, dynamics=joint_dynamics(problem, known.urdf, mean[rank:], ~nothing[rank:]))


def _bounded(
    known: Known, warned: Sequence[str], planned: Trajectory | None, urdfs: int, configurations: int, seed: int, clock: Clock
) -> ControllerBounds:
    problem, experiment = known.problem, known.problem.experiment
    if urdfs > len(known.links.links):
        raise InputError(f"{argument('urdfs', urdfs)}: there are {len(known.links.links)} draws; ask for fewer")
    moves = [planned] if planned is not None else _recorded(problem)
    clock("parameters")
    torque = torque_model(known, seed)
    wrench = None if experiment.sensor is None else sensor_model(known, make_channels(experiment, "wrench"), seed)
    states = _trained_states(problem)

    moved = np.sqrt(np.mean(torque.columns(*states)[1] ** 2, axis=0)).max(axis=0)

    def largest(model: ReadingModel) -> np.ndarray:
        return spread(model.columns(*states)[1], model.region.covariance).max(axis=0)

    def banded(model: ReadingModel, t: Trajectory, std: np.ndarray, left: Remainder | None) -> Band:
        return band(model, t.positions, t.velocities, t.accelerations, t.times, std, left, seed)

    trained = largest(torque), np.zeros(0) if wrench is None else largest(wrench)
    clock("other uncertainty")
    floor = noise_floor(problem)
    left, wrench_left = (None if m is None else remainder(problem, m, floor) for m in (torque, wrench))
    clock("trajectories")
    bands = tuple(
        TrajectoryBands(
            t.name, planned is not None, t.positions, banded(torque, t, trained[0], left),
            None if wrench is None else banded(wrench, t, trained[1], wrench_left),
        )
        for t in moves
    )  # fmt: skip
    clock("workspace")
    possible = possible_parameters(known, torque)
    workspace = workspace_bounds(torque, configurations=configurations, seed=seed, possible=possible, progress=clock.progress)
    inside = inside_joints(torque, workspace)
    result = ControllerBounds(
        known=known, parameters=known.parameters(seed), torque_model=torque, wrench_model=wrench, trained=trained,
        torque_per_unit=moved, effort_ratio=_effort(torque, seed), workspace=workspace, remainder=left,
        wrench_remainder=wrench_left, inside=inside, trajectories=bands, urdfs=urdfs, assumptions=(), warnings=(),
        seconds=clock.stop(), seed=seed,
    )  # fmt: skip
    dropped = left_out_effects(known, torque)
    return replace(result, assumptions=assumptions(result, dropped), warnings=(*warnings(result), *warned))


def _effort(model: ReadingModel, seed: int) -> float:
    """`effort_ratio` at states of the workspace that move as fast as the joints may."""
    q, lower, upper = sobol_configurations(model.robot, 256, seed)
    fastest = motion_limits(model.robot)[2]
    rng = np.random.default_rng([seed, 19])
    v, a = (size * rng.uniform(-1.0, 1.0, q.shape) for size in (fastest, 2.0 * fastest))
    return effort_ratio(model.columns(q, v, a)[1], model.region.covariance, model.region.ellipsoid, model.region.rho, seed)


def _trained_states(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint positions, velocities and accelerations of the motions that were fitted, at most `_TRAINED` (N, n)."""
    every = np.concatenate(
        [np.stack([s.positions, s.velocities, s.accelerations]) for s in _states(problem, problem.fitted)], axis=1
    )
    q, v, a = every[:, np.unique(np.linspace(0, every.shape[1] - 1, _TRAINED).astype(int))]
    return q, v, a


def _recorded(problem: Problem) -> list[Trajectory]:
    """Motions of the experiment that were not fitted, or one that was."""
    moving = [m for m in problem.experiment.motions if m.name in problem.segments and m.kind != "poses"]
    out = []
    for motion in [m for m in problem.judges if m.kind != "poses"][:_SHOWN] or moving[:1]:
        if parts := [s for s in _states(problem, [motion.name]) if len(s.times) > 1]:  # as far as the trajectory is sound
            columns = ("times", "positions", "velocities", "accelerations")
            times, q, v, a = (np.concatenate([getattr(s, name) for s in parts]) for name in columns)
            out.append(Trajectory(motion.name, motion.role, times, q, v, a))
    return out


def _states(problem: Problem, motions: Sequence[str]) -> list[MotionSegment]:
    """Smoothed segments of motions, poses as they are, where their trajectory is sound."""
    out = []
    for segment in (s for name in motions for s in problem.segments[name]):
        first, last = (0, len(segment.times)) if segment.poses else segment.inner(problem.row_model.margin)
        if last > first:
            out.append(problem.row_model.state(segment, first, last))
    return out
