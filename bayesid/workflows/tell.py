"""The verb ``excite`` with ``--tell``: the motion within limits that best tells effects apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bayesid.arguments import argument, names, with_given
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.tell.choose import tell_effects
from bayesid.diagnosis.prepare import known_terms, prepare_data
from bayesid.diagnosis.settings import DEFAULT
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, as_experiment, load_experiment
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.readings import default_channel, has_readings
from bayesid.results.excitation import DistinguishingMotion
from bayesid.simulation.simulation import simulate
from bayesid.simulation.trajectories import fourier_trajectory
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress


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
        Loaded, or its folder. What recorded motions tell already counts, and noise is as in them; without any it is as stated.
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
            experiment = simulate(experiment, [fourier_trajectory(experiment.robot, seed=seed)], effects=(), seed=seed)
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
