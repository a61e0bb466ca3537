"""The verb ``excite``: an exciting trajectory within limits, before anything is recorded, or one that tells effects apart."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, names, with_given
from bayesid.design.excitation.blocks import StopAndGo, check_blocks, scripted_blocks, stop_and_go
from bayesid.design.excitation.information import CRITERIA
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import Plan, make_plan
from bayesid.design.expected import expect
from bayesid.design.identifiability import shown
from bayesid.design.reading_noise import white_noise
from bayesid.design.tell.choose import tell_effects
from bayesid.diagnosis.prepare import known_terms, prepare_data
from bayesid.diagnosis.settings import DEFAULT
from bayesid.dynamics.regressors import Kernel
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, as_experiment, as_setup, load_experiment
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.readings import default_channel, has_readings, make_channels
from bayesid.results.excitation import DistinguishingMotion, Excitation, LimitUse
from bayesid.robot.prior import states_masses
from bayesid.robot.robot import Robot
from bayesid.simulation.simulation import simulate
from bayesid.simulation.trajectories import Trajectory, fourier_trajectory, read_trajectory, recorded_trajectories
from bayesid.tasks import cluster
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress


@shows_progress
def excite(
    setup: Experiment | Robot | str | Path,
    options: ExcitationOptions | None = None,
    *,
    warm_start: Trajectory | str | Path | None = None,
    seed: int = 0,
    channel: str | None = None,
    static: bool | None = None,
    criterion: str | None = None,
    quantities: str | Sequence[str] | None = None,
    kind: str | None = None,
    duration: float | None = None,
    period: float | None = None,
    harmonics: int | None = None,
    rate: float | None = None,
    joints: str | Sequence[str] | None = None,
    share: float | None = None,
    torque_share: float | None = None,
    sensor_share: float | None = None,
    acceleration: float | Sequence[float] | None = None,
    sensor_range: Sequence[float] | None = None,
    mount_frequency: float | None = None,
    collisions: bool | None = None,
    margin: float | None = None,
    ground: float | None = None,
    diagnosability: float | None = None,
    blocks: str | Sequence[str] | None = None,
    stops: int | None = None,
    settle: float | None = None,
    read: float | None = None,
    starts: int | None = None,
    randoms: int | None = None,
    seconds: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = SHOWN,
) -> Excitation:
    """Find the motion within limits that determines a robot's parameters best.

    Parameters
    ----------
    setup
        An experiment or its folder, whose tables need not exist yet; or a robot, with a sensor under its base.
    options
        Everything that is asked for at once; keywords stand in the place of its parts.
    warm_start
        A motion to start from: a table with columns ``t, q1 ...``, the name of one of the experiment's motions, or a trajectory.
    seed
        Of everything random.
    channel, static, criterion, quantities, kind, duration, period, harmonics, rate, joints
    share, torque_share, sensor_share, acceleration, sensor_range, mount_frequency, collisions, margin, ground
    diagnosability, blocks, stops, settle, read, starts, randoms, seconds
        As in `bayesid.ExcitationOptions`, which explains them.
    workers, scheduler
        Processes on this machine that share the work, or the address of a Dask cluster that does; the result depends on neither.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input, or limits that leave no room; the message says which, and what to do.
    EstimationError
        It was interrupted before any motion within all limits was found.
    """
    clock = Clock(progress)
    clock("reading")
    experiment = as_setup(setup, "its folder, an Experiment, or a Robot")
    chosen = with_given(
        options or ExcitationOptions(), channel=channel, static=static, criterion=criterion, quantities=quantities, kind=kind,
        duration=duration, period=period, harmonics=harmonics, rate=rate, joints=joints, share=share,
        torque_share=torque_share, sensor_share=sensor_share, acceleration=acceleration,
        sensor_range=sensor_range, mount_frequency=mount_frequency, collisions=collisions, margin=margin,
        ground=ground, diagnosability=diagnosability, blocks=blocks, stops=stops, settle=settle, read=read,
        starts=starts, randoms=randoms, seconds=seconds,
    )  # fmt: skip
    warm = _warm(warm_start, experiment) if isinstance(warm_start, (str, Path)) else warm_start
    with one_blas_thread(), cluster(workers, scheduler):
        clock("searching")
        check_blocks(chosen.blocks)
        plan = make_plan(experiment, chosen, warm, seed, clock.progress)
        clock("expected deviations")
        return _result(plan, clock)


def _warm(given: str | Path, experiment: Experiment) -> Trajectory:
    """The motion of a table, or a recorded one by its name."""
    if Path(given).is_file():
        return read_trajectory(given, experiment.robot)
    if not experiment.motions and experiment.folder is not None:
        with contextlib.suppress(InputError):  # without its tables there is nothing to name
            experiment = load_experiment(experiment.folder, experiment.library, planned=True)
    named = [m for m in experiment.motions if m.name == str(given)]
    if not named:
        there = ", ".join(m.name for m in experiment.motions) or "none"
        raise InputError(
            f"{argument('warm_start', str(given))}: no such file, and no motion of that name; recorded motions: {there}"
        )
    return recorded_trajectories(replace(experiment, motions=tuple(named)))[0]


def _result(plan: Plan, clock: Clock) -> Excitation:
    experiment, information = plan.experiment, plan.task.information
    noise = white_noise(experiment.robot, experiment.sensor, joints=experiment.torque_joints)
    found = shown(expect(experiment, information.sensor_set, noise, [plan.trajectory]))
    blocks, left_out = scripted_blocks(plan, plan.options.blocks)
    return Excitation(
        name=experiment.name, joint_names=experiment.robot.joint_names, prismatic=experiment.robot.prismatic,
        readings=information.sensor_set.title, criterion=plan.options.criterion, criterion_text=CRITERIA[plan.options.criterion],
        value=-plan.task.judged(plan.series), random=-np.array(plan.search.random),
        history=tuple((seconds, -value) for seconds, value in plan.search.history), interrupted=plan.search.interrupted,
        options=plan.options.to_dict(), series=plan.series, trajectory=plan.trajectory, blocks=blocks,
        static_run=_static_run(plan), limits=tuple(limit_uses(plan)),
        loads=_loads(experiment, plan.trajectory), base=found.base, std=found.std,
        possible=plan.task.rank,
        quantities=tuple(
            (q.name, q.unit, std)
            for q, std in zip(plan.task.quantities, plan.task.quantity_stds(plan.series), strict=True)
        ),
        diagnosability=plan.diagnosability, condition_number=found.condition,
        notes=(*plan.notes, *left_out, *experiment.warnings), seconds=dict(clock.stop()),
    )  # fmt: skip


def _static_run(plan: Plan) -> StopAndGo | None:
    """Plan a static run where one is subtracted, or stops are asked for."""
    o = plan.options
    if plan.task.information.sensor_set.offset != "static run" and o.stops is None:
        return None
    return stop_and_go(plan.series, plan.task.limits, o.rate, stops=o.stops, settle=o.settle, read=o.read)


def _loads(experiment: Experiment, trajectory: Trajectory) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Joint torques and the sensor's readings of nominal links along the motion: channel names and values (N, c)."""
    robot = experiment.robot
    if not states_masses(robot):
        return {}
    motion, out = (trajectory.positions, trajectory.velocities, trajectory.accelerations), {}
    for kind in ("torque",) if experiment.sensor is None else ("torque", "wrench"):
        channels = make_channels(experiment, kind)
        values = Kernel.of(robot, channels).readings(*motion, robot.nominal) + channels.static_wrench
        out[kind] = channels.names, values
    return out


def limit_uses(plan: Plan) -> list[LimitUse]:
    """How near a motion comes to every limit."""
    limits, robot = plan.task.limits, plan.experiment.robot
    names = [robot.joint_names[j] for j in limits.moving]
    units = ["m" if robot.prismatic[j] else "rad" for j in limits.moving]
    low, high, speed, acceleration = (part[limits.moving] for part in plan.series.extremes(plan.task.fine))
    m, worst, out = limits.moving, plan.worst, []
    above = high - limits.middle[m] >= limits.middle[m] - low
    ends = np.where(above, high, low), np.where(above, limits.upper[m], limits.lower[m])
    kinds: list[tuple[str, np.ndarray, np.ndarray, Sequence[str]]] = [
        ("position", *ends, units),
        ("velocity", speed, limits.speed[m], [f"{u}/s" for u in units]),
        ("acceleration", acceleration, limits.acceleration[m], [f"{u}/s²" for u in units]),
    ]
    for kind, reached, most, unit in kinds:
        out += _uses(kind, names, reached, most, unit, worst[kind])
    for load in limits.loads:
        limited = np.flatnonzero(np.isfinite(load.most)).tolist()
        where = [robot.joint_names[k] if load.kind == "torque" else load.channels.names[k] for k in limited]
        ratio = worst[load.kind][limited]
        unit = [load.channels.units[k] for k in limited]
        out += _uses(load.kind, where, ratio * load.most[limited], load.most[limited], unit, ratio)
    if limits.clearance is not None:
        bodies, ratio = limits.clearance, worst["collision"]
        distance = bodies.margins + (1.0 - ratio) * bodies.scale
        out += _uses("collision", bodies.names, distance, bodies.margins, ["m"] * len(ratio), ratio)
    return out


def _uses(kind: str, *columns) -> list[LimitUse]:
    """Uses of limits of a kind: where, reached, limit, unit and ratio of each."""
    return [LimitUse(kind, w, float(a), float(b), u, float(c)) for w, a, b, u, c in zip(*columns, strict=True)]


@shows_progress
def tell(
    experiment: Experiment | str | Path,
    effects: Sequence[str],
    options: ExcitationOptions | None = None,
    *,
    motions: str | Sequence[str] | None = None,
    seed: int = 0,
    channel: str | None = None,
    duration: float | None = None,
    period: float | None = None,
    harmonics: int | None = None,
    rate: float | None = None,
    joints: str | Sequence[str] | None = None,
    share: float | None = None,
    torque_share: float | None = None,
    acceleration: float | Sequence[float] | None = None,
    sensor_range: Sequence[float] | None = None,
    collisions: bool | None = None,
    progress: Progress | None = SHOWN,
) -> DistinguishingMotion:
    """Find the motion within limits that best tells effects apart, and how probably it decides.

    Parameters
    ----------
    experiment
        Loaded, or its folder. What recorded motions tell already counts, and noise and rate are theirs; without any as stated.
    effects
        Two or more: ``name@where``, or ``name`` where there is one place.
    options
        Readings, limits and length of the motion, as for `bayesid.excite`; keywords stand in the place of its parts.
    motions
        Names of the recordings that count; default those with role ``identification``.
    seed
        Of everything random.
    channel, duration, period, harmonics, rate, joints, share, torque_share, acceleration, sensor_range, collisions
        As in `bayesid.ExcitationOptions`, which explains them.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        Bad input, or limits that leave no room; the message says what to do.
    """
    chosen = with_given(
        options or ExcitationOptions(), channel=channel, duration=duration, period=period, harmonics=harmonics, rate=rate,
        joints=joints, share=share, torque_share=torque_share, acceleration=acceleration, sensor_range=sensor_range,
        collisions=collisions,
    )  # fmt: skip
    clock = Clock(progress)
    with one_blas_thread():
        clock("reading")
        experiment = (
            load_experiment(experiment, planned=True) if isinstance(experiment, (str, Path)) else as_experiment(experiment)
        )
        channel = chosen.channel or default_channel(experiment)
        clock("noise of sensors and encoders")
        recorded = any(m.kind == "trajectory" and has_readings(m.table, channel) for m in experiment.motions)
        if not recorded:  # for its noise alone
            experiment = simulate(
                experiment, [fourier_trajectory(experiment.robot, rate=chosen.rate, seed=seed)], effects=(), seed=seed
            )
        terms, held = known_terms(experiment, channel, None)
        data = prepare_data(experiment, channel, terms, names(motions) if recorded else None, seed, held, DEFAULT)
        clock("the motion that tells them apart")
        asked = replace(chosen, channel=channel)
        telling = tell_effects(data, names(effects) or (), recorded=recorded, options=asked, seed=seed)
    if telling is None:
        raise InputError(
            f"no motion within all limits was found: widen {argument('share')}, {argument('torque_share')} or "
            f"{argument('acceleration')}"
        )
    recordings = tuple(dict.fromkeys(s.motion for s in data.segments)) if recorded else ()
    return DistinguishingMotion(experiment.name, channel, recordings, telling, clock.stop())
