"""How an experiment and options become an exciting trajectory.

A mount that gives changes the readings of a planned motion: the joints' own frequencies stay below a fifth of the resonance
f_n, but products of joint motions in the wrench reach higher. A mount with little damping d enlarges a component at f by
``H = 1 / (1 - (f / f_n)^2 + 2 i d f / f_n)``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayesid.arguments import argument
from bayesid.design.excitation.collision import clearance
from bayesid.design.excitation.diagnosability import Diagnosability, diagnosability
from bayesid.design.excitation.information import Information, criterion_of, parse_quantity
from bayesid.design.excitation.limits import Limits, LoadLimit
from bayesid.design.excitation.optimise import Task, TrajectorySearch, search
from bayesid.design.excitation.options import BELOW_RESONANCE, ExcitationOptions, largest_accelerations, sensor_ranges
from bayesid.design.excitation.series import Coordinates, FourierSeries, fitted_series
from bayesid.design.reading_noise import SENSOR_SETS, ReadingNoise, SensorSet, white_noise
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.errors import EstimationError, InputError, require_one_of
from bayesid.recordings.experiment import Experiment
from bayesid.regression.readings import CHANNELS, default_channel, make_channels
from bayesid.robot.prior import states_masses
from bayesid.robot.robot import joint_index, motion_limits
from bayesid.rounding import number
from bayesid.simulation.trajectories import Trajectory

#: Damping ratio where none is known; it matters near the resonance only.
_DAMPING = 0.02


def mount_response(readings: np.ndarray, period: float, resonance: float) -> tuple[float, float]:
    """Share of a period of readings (N, c) above a fifth of the resonance [Hz], and by how much the mount changes all.

    Both are root mean squares over that of the readings about their mean; the period is in seconds.
    """
    spectrum = np.fft.rfft(readings - readings.mean(axis=0), axis=0)
    frequency = np.fft.rfftfreq(len(readings), period / len(readings))
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    ratio = frequency / resonance
    response = 1.0 / (1.0 - ratio**2 + 2j * _DAMPING * ratio)
    total = max(float(power.sum()), 1e-300)
    above = float(power[frequency > resonance / BELOW_RESONANCE].sum()) / total
    return float(np.sqrt(above)), float(np.sqrt(np.sum(np.abs(response - 1.0) ** 2 * power) / total))


#: Samples of a period that the optimiser looks at, at least and per harmonic; how many times more where limits are restored;
#: how many times finer than recorded limits are tested.
_SAMPLES, _PER_HARMONIC, _DENSER, FINER = 120, 16, 3, 10
_SPECTRUM = 2048


@dataclass(frozen=True, eq=False)
class Plan:
    """An exciting trajectory, and all that says why."""

    #: What was asked.
    experiment: Experiment
    options: ExcitationOptions
    #: What was optimised, and how that went.
    task: Task
    search: TrajectorySearch
    series: FourierSeries  # the motion
    trajectory: Trajectory  # the same, sampled as it will be recorded
    worst: dict[str, np.ndarray]  # largest ratios to the limits, by kind, at ten times the rate
    diagnosability: Diagnosability | None  # what it could show beyond the model, where that was asked for
    notes: tuple[str, ...]  # what was assumed or left out, one line each


def sensor_set_of(experiment: Experiment, options: ExcitationOptions) -> SensorSet:
    """What is read: the channel asked for, or the wrench where there is a sensor."""
    channel = options.channel or default_channel(replace(experiment, motions=()))
    require_one_of(channel, CHANNELS, argument("channel", channel))
    if channel == "wrench":
        return SENSOR_SETS["wrench-static" if options.static or options.kind == "liu1998" else "wrench-offset"]
    if options.static:
        raise InputError(f"{argument('static', True)} goes with the wrench: leave it out with {argument('channel', channel)}")
    return SENSOR_SETS["torque" if channel == "torque" else "both-offset"]


def _assumed(kind: str, noise: ReadingNoise) -> str:
    """Which noise is assumed, and what that means for the plan."""
    if kind == "wrench":
        return "The noise of the wrench is assumed, as experiment.toml states none ([sensor] force_std and torque_std)."
    std = noise.torque["trajectory"].std
    size = " to ".join(dict.fromkeys(number(float(x), 2) for x in (std.min(), std.max())))
    return f"The noise of the torque is assumed, {size} N m by joint: expected errors grow with it, all by one factor."


def make_task(experiment: Experiment, options: ExcitationOptions, seed: int = 0) -> tuple[Task, tuple[str, ...]]:
    """What is to be optimised, and notes of what was assumed; an `InputError` where an option does not fit the robot."""
    robot, notes = experiment.robot, []
    moving = _moving(experiment, options)
    sensor_set = sensor_set_of(experiment, options)
    noise = white_noise(robot, experiment.sensor, joints=experiment.torque_joints)
    kinds = ("wrench", "torque") if sensor_set.channel == "both" else (sensor_set.channel,)
    notes += [_assumed(k, noise) for k in kinds if noise.sources[k] == "assumed"]
    lower, upper, fastest = motion_limits(robot)
    middle, half = 0.5 * (lower + upper), 0.5 * options.share * (upper - lower)
    held = middle.copy()
    held[moving] = np.nan
    information = Information.of(experiment, sensor_set, noise, held)
    if information.left_out:
        left_out = ", ".join(information.left_out)
        notes.append(f"Effects of the model that need more than the joint motion do not count for the plan: {left_out}.")
    for name, found in (("position", robot.lower), ("speed", robot.velocity_limit)):
        unlimited = [robot.joint_names[j] for j in moving if not np.isfinite(found[j])]
        if unlimited:
            notes.append(f"The URDF states no {name} limit of {', '.join(unlimited)}: those of a small arm are taken.")
    if options.acceleration is None:
        notes.append(f"Acceleration limits are assumed: full speed in 0.25 s; {argument('acceleration')} gives others.")
    bodies, said = clearance(robot, experiment.locked, options.margin, options.ground, seed) if options.collisions else (None, ())
    loads, more = _loads(experiment, options)
    limits = Limits(
        middle - half, middle + half, options.share * fastest,
        options.share * largest_accelerations(robot, options.acceleration), loads, bodies, moving,
    )  # fmt: skip
    if bodies is None:
        left_out = argument("collisions", False)
        why = "the URDF has no collision geometry of bodies that could meet" if options.collisions else left_out
        notes.append(f"No collision is checked: {why}.")
    rank = information.base.rank
    asked = tuple(parse_quantity(text, experiment, information) for text in options.quantities)
    criterion, information = criterion_of(options.criterion, asked, information)
    period = options.repeats_after
    samples = max(_SAMPLES, _PER_HARMONIC * options.harmonics)
    coordinates, dense = (
        Coordinates(period, options.harmonics, moving, middle, half, limits.speed, count)
        for count in (samples, _DENSER * samples)
    )
    fine = int(np.ceil(FINER * options.rate * period))
    task = Task(information, criterion, limits, coordinates, dense, options.rate * options.duration, fine, rank, asked)
    return task, tuple([*notes, *more, *said])


def make_plan(
    experiment: Experiment,
    options: ExcitationOptions,
    warm: Trajectory | None = None,
    seed: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Search an exciting trajectory for an experiment's robot, sensor, noise and model, from a ``warm`` motion if any.

    An `InputError` where an option does not fit the robot, or the limits leave no room; an `EstimationError` where it was
    interrupted before any motion was found.
    """
    task, notes = make_task(experiment, options, seed)
    start = None if warm is None else fitted_series(warm.times, warm.positions, task.coordinates.period, options.harmonics)
    if start is not None:
        start = task.coordinates.series(task.coordinates.numbers(start))
    found = search(task, options, start, seed, tell)
    if found.best is None:
        if found.interrupted:
            raise EstimationError("interrupted before any motion within all limits was found; let it run longer")
        _explain(task, seed)
    assert found.best is not None
    series, shown, notes = _chosen(experiment, task, options, found, notes, tell)
    mount = _mount_note(experiment, series, options.mount_frequency)
    name = "trajectory"
    times = np.arange(int(round(options.duration * options.rate)) + 1) / options.rate
    q, v, a = series.at(times)
    static = q if task.information.sensor_set.offset == "static run" else None
    trajectory = Trajectory(
        name, "identification", times, q, v, a, static_positions=static,
        period=series.period if options.periods > 1 else None,
    )  # fmt: skip
    worst = task.limits.worst(series, task.fine)
    return Plan(experiment, options, task, found, series, trajectory, worst, shown, (*notes, *mount))


def _chosen(
    experiment: Experiment, task: Task, options: ExcitationOptions, found: TrajectorySearch, notes: tuple[str, ...],
    tell: Callable[[str], None],
) -> tuple[FourierSeries, Diagnosability | None, tuple[str, ...]]:  # fmt: skip
    """The best motion: of those that the starts ended with, by the criterion and the diagnosability together."""
    assert found.best is not None
    if options.diagnosability is None:
        return found.best, None, notes
    tell("diagnosability")
    finalists = [(found.value, found.best)]
    if options.diagnosability > 0.0:
        finalists += [(value, series) for value, series in found.finalists if series is not found.best]
    shown = [diagnosability(experiment, task.information, series, task.recorded) for _, series in finalists]
    totals = [value + options.diagnosability * d.value for (value, _), d in zip(finalists, shown, strict=True)]
    k = int(np.argmin(totals))
    if k:
        worse, better = finalists[k][0] - found.value, shown[0].value - shown[k].value
        why = f"Of {len(finalists)} motions not the best by the criterion was taken ({worse:.2g} less), but for diagnosability"
        notes = (*notes, f"{why} ({better:.2g} better).")
    return finalists[k][1], shown[k], notes


def _mount_note(experiment: Experiment, series: FourierSeries, resonance: float | None) -> tuple[str, ...]:
    """What the mount makes of the moments, where its resonance is known and the links are."""
    if resonance is None or experiment.sensor is None or not states_masses(experiment.robot):
        return ()
    motion = series.at(np.linspace(0.0, series.period, _SPECTRUM, endpoint=False))
    channels = make_channels(experiment, "wrench")
    moments = Kernel.of(experiment.robot, channels).readings(*motion, experiment.robot.nominal)[:, 3:]
    above, change = mount_response(moments, series.period, resonance)
    share = f"{100 * above:.2g} % of the moments (root mean square) lie above a fifth of the mount's {resonance:g} Hz"
    return (f"{share}, which changes them by {100 * change:.2g} %.",)


def _moving(experiment: Experiment, options: ExcitationOptions) -> np.ndarray:
    names = experiment.robot.joint_names
    if options.joints is None:
        return np.arange(len(names))
    if not options.joints:
        raise InputError(f"{argument('joints')} names none; write some of {', '.join(names)}")
    found = {name: joint_index(name, names) for name in options.joints}
    if unknown := [name for name, k in found.items() if k is None]:
        raise InputError(f"{argument('joints', unknown[0])}: no such joint; write some of {', '.join(names)}")
    return np.array(sorted({k for k in found.values() if k is not None}))


def _loads(experiment: Experiment, options: ExcitationOptions) -> tuple[tuple[LoadLimit, ...], list[str]]:
    """Torque and sensor limits, with nominal links."""
    robot, loads, notes = experiment.robot, [], []
    ranges = sensor_ranges(options.sensor_range)
    if np.isfinite(ranges).any() and experiment.sensor is None:
        raise InputError(f"{argument('sensor_range')}: experiment.toml has no [sensor]; add it, or leave it out")
    if not states_masses(robot):
        if np.isfinite(ranges).any():
            raise InputError(
                f"{argument('sensor_range')}: the URDF states no masses, so that nobody knows the load; write them there"
            )
        return (), ["The URDF states no masses: neither joint torques nor the sensor's load are limited."]
    if np.isfinite(robot.effort_limit).any():
        channels, most = torque_channels(robot), options.torque_share * robot.effort_limit
        loads.append(LoadLimit("torque", channels, most, robot.nominal, Kernel.of(robot, channels)))
    else:
        notes.append("The URDF states no effort limits: joint torques are not limited.")
    if np.isfinite(ranges).any():
        channels, most = make_channels(experiment, "wrench"), options.sensor_share * ranges
        loads.append(LoadLimit("wrench", channels, most, robot.nominal, Kernel.of(robot, channels)))
    elif experiment.sensor is not None:
        notes.append(f"No {argument('sensor_range')} is given: what the sensor reads is not limited.")
    return tuple(loads), notes


def _explain(task: Task, seed: int) -> None:
    """Raise an `InputError` that says which limit leaves no room: the one that random poses at rest break most often."""
    limits, rng = task.limits, np.random.default_rng(seed)
    q = rng.uniform(limits.lower, limits.upper, (500, len(limits.lower)))
    q[:, np.setdiff1d(np.arange(q.shape[1]), limits.moving)] = limits.middle[np.setdiff1d(np.arange(q.shape[1]), limits.moving)]
    rest = np.zeros_like(q)
    broken = {}
    for load in limits.loads:
        worst = np.abs(load.ratios((q, rest, rest)))
        c = int(np.argmax(worst.min(axis=0)))
        broken[f"{load.kind} {load.channels.names[c]}"] = float(np.mean(worst.max(axis=1) > 1.0))
        if worst[:, c].min() > 1.0:
            raise InputError(
                f"no pose keeps the {load.kind} within its limit: {load.channels.names[c]} reads at least "
                f"{worst[:, c].min() * load.most[c]:.4g} at rest and may read {load.most[c]:.4g}; raise "
                + (
                    f"{argument('sensor_range')} or {argument('sensor_share')}"
                    if load.kind == "wrench"
                    else f"{argument('torque_share')} or the URDF's effort limit"
                )
            )
    if limits.clearance is not None:
        near = limits.clearance.ratios(q) > 1.0
        pair = limits.clearance.names[int(np.argmax(near.mean(axis=0)))]
        broken[f"distances, that of {pair} most often"] = float(np.mean(near.any(axis=1)))
    most = max(broken, key=lambda k: broken[k], default="joint limits")
    raise InputError(
        f"no motion within all limits was found; most poses break the limit of {most} "
        f"({100 * broken.get(most, 0.0):.0f} % of random ones): widen it, or start from a motion that fits "
        f"({argument('warm_start')})"
    )
