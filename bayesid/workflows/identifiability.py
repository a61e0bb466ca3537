"""The verb ``identifiability``: what motions can and cannot determine, per sensor set, before anything is estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, names
from bayesid.design.advice import advise, duration
from bayesid.design.expected import Expected, expected_factors
from bayesid.design.identifiability import PlannedMotions, SetReport, report_of, set_report, shown, with_differences
from bayesid.design.reading_noise import SENSOR_SETS, ReadingNoise, SensorSet, recorded_noise, white_noise
from bayesid.design.separability import pair_of, separations
from bayesid.errors import InputError
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.experiment import Experiment, Motion, Sensor, as_setup, load_experiment, motions_named
from bayesid.regression.options import NOT_FOR_REGRESSIONS, FitOptions, some_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.readings import default_channel
from bayesid.regression.regression import Regression
from bayesid.results.identifiability import Identifiability
from bayesid.robot.robot import Robot
from bayesid.simulation.trajectories import Trajectory, as_trajectory, fourier_trajectory
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress

_READ = {"wrench": "wrench", "torque": "joint torques"}
_TAKES = "the folder of an experiment, an Experiment, a Robot with trajectories, or a Regression"


#: A planned motion: a table's path, or a trajectory.
Planned = str | Path | Trajectory


@shows_progress
def identifiability(
    given: Experiment | Robot | Regression | str | Path,
    trajectories: Planned | Sequence[Planned] | None = None,
    *,
    sensor_sets: str | Sequence[str] | None = None,
    noise: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    bandwidth: float | None = None,
    tell: Sequence[str] | None = None,
    progress: Progress | None = SHOWN,
) -> Identifiability:
    """What motions can and cannot determine, for each sensor set side by side, and what would make the difference.

    Parameters
    ----------
    given
        An experiment or its folder, whose tables need no readings; a robot; or rows of one's own.
    trajectories
        Planned motions in place of the experiment's: tables with columns ``t`` and ``q1`` ..., as `bayesid.excite` writes them,
        or trajectories. A robot without any gets a random motion within its limits.
    sensor_sets
        Names of `bayesid.design.reading_noise.SENSOR_SETS`; default all.
    noise
        Standard deviation of one sample, by ``force``, ``moment``, ``torque`` or the channel's name; default what a fit leaves of
        recorded readings, else the data sheet's, else an assumed one.
    options
        ``motions``, ``effects`` and ``bandwidth`` at once; those that are given beside it stand in its place.
    motions
        Which motions of the experiment count; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    bandwidth
        Of recorded joint motion [Hz]; default chosen as for a fit.
    tell
        Effects, ``name@where``, for which it is asked how well these motions would tell them apart.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    clock = Clock(progress)
    chosen = some_options("identifiability", options, motions=motions, effects=effects, bandwidth=bandwidth)
    with one_blas_thread():
        clock("reading")
        if isinstance(given, Regression):
            if chosen.given() or any(given is not None for given in (trajectories, sensor_sets, noise, tell)):
                raise InputError(NOT_FOR_REGRESSIONS.format("identifiability"))
            return _of_regression(given, clock)
        sets = _sets(names(sensor_sets))
        experiment, planned = _experiment(given, trajectories)
        asked = _motions(experiment, planned, chosen.motions)
        if chosen.effects is not None:
            experiment = replace(experiment, effects=tuple(chosen.effects))
        return _of_motions(experiment, asked, sets, noise, chosen.bandwidth, names(tell), clock)


def _sets(asked: Sequence[str] | None) -> list[SensorSet]:
    """The sensor sets of these names, or all."""
    if asked is not None and not asked:
        raise InputError(f"{argument('sensor_sets')} names none; choose from {', '.join(SENSOR_SETS)}, or leave it out for all")
    for name in asked or ():
        if name not in SENSOR_SETS:
            raise InputError(f"{argument('sensor_sets', name)}: choose from {', '.join(SENSOR_SETS)}")
    return [s for s in SENSOR_SETS.values() if asked is None or s.name in asked]


def _experiment(
    given: object, trajectories: Planned | Sequence[Planned] | None
) -> tuple[Experiment, list[Motion | Trajectory] | None]:
    """The robot and its model, and planned motions where there are any."""
    if trajectories is None and isinstance(given, (str, Path)):
        return load_experiment(given, planned=True), None
    experiment = as_setup(given, _TAKES)
    if trajectories is None:
        return experiment, [fourier_trajectory(given, "random motion")] if isinstance(given, Robot) else None
    several = [trajectories] if isinstance(trajectories, (str, Path, Trajectory)) else list(trajectories)
    made = [as_trajectory(t, experiment.robot) for t in several]
    called = [t.name for t in made]  # tables as `bayesid.excite` writes them have one name
    return experiment, [t if called.count(t.name) == 1 else replace(t, name=f"{t.name} ({k})") for k, t in enumerate(made, 1)]


def _motions(
    experiment: Experiment, planned: list[Motion | Trajectory] | None, asked: Sequence[str] | None
) -> list[Motion | Trajectory]:
    """The motions that are asked about."""
    there: list[Motion | Trajectory] = list(experiment.motions) if planned is None else planned
    if asked is not None:
        there = motions_named(there, list(dict.fromkeys(asked)))
    elif planned is None:
        there = list(experiment.identification)
    if not there:
        raise InputError(
            f'no motion is to be fitted; give one the role "identification", name it with {argument("motions")}, or plan one'
        )
    return there


def _of_motions(
    experiment: Experiment, motions: list[Motion | Trajectory], sets: list[SensorSet], given: Mapping[str, float] | None,
    bandwidth: float | None, tell: Sequence[str] | None, clock: Clock,
) -> Identifiability:  # fmt: skip
    sensor, robot = experiment.sensor, experiment.robot
    noise = white_noise(robot, sensor, given, experiment.torque_joints)
    warnings = list(experiment.warnings)
    clock("noise")
    sheet = noise
    if all(isinstance(m, Motion) for m in motions):
        noise, bandwidth = _recorded(experiment, noise, motions, bandwidth, warnings)
    if sensor is None:
        sensor = Sensor(robot.sensor_joint)
        if any(s.channel != "torque" for s in sets):
            place = "under the base, in the base frame" if robot.sensor_joint is None else f"in {robot.sensor_joint}"
            warnings.append(f"There is no [sensor]: what a wrench would show is told for one {place}.")
    plan = PlannedMotions.of(replace(experiment, sensor=sensor), motions)
    rivals = None if tell is None else pair_of(plan, tell)
    reports = []
    for s in sets:
        clock(s.title)
        reports.append(report_of(plan, s, noise, bandwidth=bandwidth))
    clock("what would make a difference")
    main = _main(experiment, reports)
    reports = with_differences(plan, reports)
    main = reports[[r.sensor_set for r in reports].index(main.sensor_set)]
    assumed = [k for k, source in main.noise.items() if source == "assumed"]
    if assumed:
        which = " and the ".join(_READ[k] for k in assumed)
        warnings.insert(
            0,
            f"The noise of the {which} is assumed: state it with {argument('noise')}, for standard deviations that hold; ranks "
            "and classes hardly depend on it.",
        )
    beside = set(main.noise.values()) == {"readings"} and {sheet.sources[k] for k in main.noise} == {"data sheet"}
    advice = advise(plan, reports, main, noise, sheet if beside else None)
    apart = {}
    if rivals is not None:
        clock("telling effects apart")
        apart = {s.name: separations(plan, s, noise, rivals, bandwidth=bandwidth) for s in sets}
    return Identifiability(
        name=experiment.name,
        source="recorded" if any(isinstance(m, Motion) and m.table.channels() for m in motions) else "planned",
        motions={m.name: duration(m) for m in motions},
        still=tuple(robot.joint_names[j] for j in np.flatnonzero(np.isfinite(plan.still)).tolist()),
        sensor_sets=tuple(reports),
        main=main,
        advice=advice,
        separations=apart,
        warnings=tuple(warnings),
        seconds=clock.stop(),
    )


def _recorded(
    experiment: Experiment, noise: ReadingNoise, motions: Sequence[Motion | Trajectory], bandwidth: float | None,
    warnings: list[str],
) -> tuple[ReadingNoise, float | None]:  # fmt: skip
    """Noise and bandwidth as a fit of the readings has them, where there are any."""
    recorded = [m.name for m in motions]
    if not set(recorded) <= {m.name for m in experiment.motions}:
        return noise, bandwidth
    try:
        noise, problems = recorded_noise(experiment, noise, FitOptions(motions=recorded, bandwidth=bandwidth))
    except InputError as error:
        warnings.append(f"identify will refuse these readings, so their noise is not learned from them: {error}")
        return noise, bandwidth
    first = next(iter(problems.values()), None)
    return noise, bandwidth if first is None else first.row_model.bandwidth


def _main(experiment: Experiment, reports: Sequence[SetReport]) -> SetReport:
    """The readings that an estimate would use: those that `identify` takes by default, or would once they are recorded."""
    channel = default_channel(experiment) if any(r.recorded for r in reports) else "wrench" if experiment.sensor else "torque"
    preferred = [r for r in reports if r.sensor_set.channel == channel]
    recorded = [r for r in preferred if r.recorded]
    stopped = any(m.stop_and_go for m in experiment.identification)
    if not recorded and channel == "wrench" and not stopped:
        preferred = [r for r in preferred if r.sensor_set.offset == "fitted"] or preferred
    return (recorded or preferred or list(reports))[0]


def _of_regression(regression: Regression, clock: Clock) -> Identifiability:
    """Rows of one's own: one sensor set, and no other motion to compare with."""
    clock("noise")
    weights = learn_weights(regression)
    clock("rows")
    factors = expected_factors(regression.rows.blocks, weights.dispersed())
    expected = Expected(regression.base, regression.effect_names, regression.effect_units, *factors)
    found = shown(expected)
    sizes = np.abs(found.base.matrix @ np.linalg.pinv(regression.base.matrix) @ weights.solution[: regression.base.rank])
    rows = SensorSet("rows", "these rows", "rows")
    source = "given" if regression.noise_std is not None else "readings"
    std = next(iter(weights.noise.values())).std.tolist()
    fitted = dict.fromkeys(regression.motion_names[b.motion] for b in regression.rows.pilot())
    stds = dict(zip(regression.channel_names, std, strict=True))
    report = set_report(rows, expected, found, {"rows": source}, stds, sizes=sizes)
    return Identifiability(
        name="regression", source="regression", motions=dict.fromkeys(fitted, 0.0), still=(),
        sensor_sets=(report,), main=report, seconds=clock.stop(),
        warnings=("Rows alone do not tell whether another motion would show what these do not: pass a robot and trajectories.",),
    )  # fmt: skip
