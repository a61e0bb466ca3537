"""The verb ``check``: what an experiment folder contains, what its readings could show, and how much a fit would leave."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from bayesid.dynamics.base_parameters import structural_base
from bayesid.errors import BayesidError, InputError
from bayesid.recordings.experiment import Experiment, Motion, as_experiment
from bayesid.recordings.motion_checks import Timing
from bayesid.recordings.table import WRENCH_COLUMNS, Table
from bayesid.regression.options import FitOptions
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.problem import prepare
from bayesid.regression.readings import default_channel, make_channels
from bayesid.results.inspection import InspectedReadings, Inspection, MotionSummary
from bayesid.signals.smoothing import smooth
from bayesid.validation.mistakes.search import find_mistakes, unlike_urdf
from bayesid.validation.own_fit import fit_and_predict
from bayesid.validation.prediction import useless
from bayesid.workflows.progress import SHOWN, Progress, quiet, shows_progress
from bayesid.workflows.warnings import lacks_drives, left_of_fit, unpredicted, unusable, without_static_run

_GROUPS = {"positions": "q", "velocities": "v", "commanded": "qr", "torques": "tau", "wrench": "wrench"}
#: Samples of a long recording that speeds are taken from.
_SMOOTHED = 50_000


@shows_progress
def check(experiment: Experiment | str | Path, progress: Progress | None = SHOWN) -> Inspection:
    """Say what an experiment contains: robot, motions, noise, and what each set of readings could show.

    Parameters
    ----------
    experiment
        Loaded, or its folder.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Raises
    ------
    InputError
        The folder cannot be read, or ``[model] effects`` names an effect or a place that does not exist.
    """
    progress = progress or quiet
    progress("reading")
    experiment = as_experiment(experiment)
    progress("motions")
    warnings: list[str] = []
    channel = default_channel(experiment)
    bandwidth, reason, position_std = None, "", np.full(experiment.robot.n, np.nan)
    problem, estimate, left = None, None, ()
    try:
        experiment.library.parse(experiment.effects, experiment.robot.joint_names, [*WRENCH_COLUMNS, "tau1"])
    except InputError as error:
        raise InputError(f"experiment.toml: [model] effects: {error}") from None
    try:
        with one_blas_thread():
            problem = prepare(experiment, FitOptions(channel))
            bandwidth, reason, position_std = problem.smoother.bandwidth, problem.smoother.reason, problem.smoother.position_std
            if problem.regression.rows.fits_in_memory:
                progress("what a fit would leave")
                estimate, left = fit_and_predict(problem)
    except BayesidError as error:
        reason = reason or str(error)
        warnings.append(f"identify will refuse this folder as it is: {error}")
    motions = tuple(_summary(m, bandwidth) for m in experiment.motions)
    progress("signs, frames and units")
    mistakes = find_mistakes(experiment)
    if problem is not None and not mistakes:
        # What `identify` would say of motions that it does not fit and that its model does not predict.
        unseen = [p for p in left if not p.fitted]
        no_use = useless(unseen) and lacks_drives(problem)
        warnings += unusable(problem, unseen, [], takes_effects=False) if no_use else unpredicted(unseen)
        warnings += [] if unseen or estimate is None else left_of_fit(estimate, left, alone=True)
        warnings += without_static_run(problem)
    if not mistakes and (unlike := unlike_urdf(experiment)) is not None:
        warnings.append(unlike)
    progress("base parameters")
    return Inspection(
        experiment=experiment,
        motions=motions,
        sensor_sets=_sensor_sets(experiment),
        channel=channel,
        bandwidth=bandwidth,
        bandwidth_reason=reason,
        position_std=position_std,
        mistakes=mistakes,
        left=left,
        warnings=experiment.with_findings([*(m.text for m in mistakes), *warnings]),
    )


def sample_noise(table: Table) -> dict[str, float]:
    """Standard deviation of one sample of each channel from the median of third differences.

    A motion is smooth over four samples and leaves its third differences nearly untouched; white noise of
    standard deviation s gives them ``s sqrt(20)``. The median does not see outliers. Where more than half the
    differences are zero (coarse digits), their root mean square stands in.
    """
    found = dict(table.channels())
    pieces = [p for p in table.segments() if p.stop - p.start > 20]
    if not found or not pieces:
        return {}
    third = np.concatenate([np.diff(np.column_stack([values[p] for values in found.values()]), 3, axis=0) for p in pieces])
    robust = np.median(np.abs(third), axis=0) / 0.674490
    plain = np.sqrt(np.mean(third**2, axis=0))
    return dict(zip(found, map(float, np.where(robust > 0, robust, plain) / np.sqrt(20.0)), strict=True))


def noise_at_rest(motion: Motion) -> dict[str, float]:
    """Standard deviation of each channel about its mean of every parked interval, all intervals together.

    Unlike `sample_noise` it holds slow noise, too.
    """
    times, found = motion.table.times, dict(motion.table.channels())
    inside = [(times >= start) & (times <= end) for start, end in motion.parked]
    parked = [np.column_stack([values[k] for values in found.values()]) for k in inside if found and np.count_nonzero(k) > 2]
    if not parked:
        return {}
    squares = np.sum([np.sum((values - values.mean(axis=0)) ** 2, axis=0) for values in parked], axis=0)
    freedom = sum(len(values) - 1 for values in parked)
    return dict(zip(found, map(float, np.sqrt(squares / freedom)), strict=True))


def _summary(motion: Motion, bandwidth: float | None) -> MotionSummary:
    table, poses = motion.table, motion.kind == "poses"
    timed = not poses and len(table) > 1
    pieces = table.segments() if timed else []
    columns = tuple(short for field, short in _GROUPS.items() if getattr(table, field) is not None)
    return MotionSummary(
        motion=motion,
        gaps=tuple((float(table.times[a.stop - 1]), float(table.times[b.start])) for a, b in pairwise(pieces)),
        timing=Timing.of(table) if timed else None,
        rate=1.0 / table.step if timed else np.nan,
        columns=columns,
        lowest=table.positions.min(axis=0),
        highest=table.positions.max(axis=0),
        speed=_speed(table, bandwidth) if not poses and bandwidth else np.full(table.positions.shape[1], np.nan),
        static="none" if motion.static is None else "stop-and-go" if motion.stop_and_go else "poses",
        noise={} if poses else sample_noise(table),
        noise_at_rest=noise_at_rest(motion),
    )


def _speed(table: Table, bandwidth: float) -> np.ndarray:
    """Largest speeds of the smoothed positions, but for one sample in a thousand: ends are loose (n,)."""
    speeds = []
    for piece in table.segments():
        piece = slice(piece.start, min(piece.stop, piece.start + _SMOOTHED))
        try:
            speeds.append(np.abs(smooth(table.times[piece], table.positions[piece], bandwidth)[1]))
        except InputError:
            continue  # too short to be smoothed
    return np.quantile(np.concatenate(speeds), 0.999, axis=0) if speeds else np.full(table.positions.shape[1], np.nan)


def _sensor_sets(experiment: Experiment) -> tuple[InspectedReadings, ...]:
    fitted = experiment.identification
    wrench = experiment.sensor is not None and all(m.table.wrench is not None for m in fitted)
    torque = all(m.table.torques is not None for m in fitted)
    at_rest = wrench and all(m.kind == "poses" for m in fitted)
    stopped = wrench and all(m.stop_and_go for m in fitted)
    poses = wrench and any(m.static is not None for m in fitted)
    # What is read, in which channel, whether it was, and what is known of offset and gravity.
    cases = [
        ("the wrench of poses at rest, with an unknown sensor offset", "wrench", at_rest, dict(offset=True, at_rest=True)),
        ("the wrench, with an unknown sensor offset", "wrench", wrench and not at_rest, dict(offset=True)),
        ("the wrench and readings at rest fitted along, offset unknown", "wrench", poses, dict(offset=True)),
        ("the motion wrench: readings at rest subtracted sample by sample", "wrench", stopped, dict(gravity=False)),
        ("the wrench of a sensor without offset", "wrench", False, {}),
        ("the joint torques", "torque", torque, {}),
        ("wrench and torques, with an unknown sensor offset", "both", wrench and torque, dict(offset=True)),
    ]
    read_only = cases[0], cases[2]  # shown where they were read
    shown = [c for c in cases if (c[2] or c not in read_only) and (c[1] == "torque" or experiment.sensor is not None)]
    return tuple(
        InspectedReadings(name, structural_base(experiment.robot, make_channels(experiment, channel), **options), here)
        for name, channel, here, options in shown
    )
