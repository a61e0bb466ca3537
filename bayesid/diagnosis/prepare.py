"""Recordings cut into segments and smoothed, with the noise of both their sensors and encoders."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.fft import next_fast_len

from bayesid.arguments import argument
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.noise import smoothed, with_noise_of
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import MotionSegment, Term, middle_of, starting_point
from bayesid.errors import InputError
from bayesid.recordings.complaints import columns_of
from bayesid.recordings.examination import dead_channels
from bayesid.recordings.experiment import Experiment, Motion, motions_named
from bayesid.recordings.table import WRENCH_COLUMNS, usual_step
from bayesid.regression.readings import default_channel, has_readings, make_channels, readings_of
from bayesid.robot.prior import Prior, filled_links
from bayesid.signals.resampling import resample_evenly, uneven
from bayesid.signals.smoothing import choose_smoothers

#: Predictions are made at so many times the highest frequency compared; at twice that where friction reverses at once.
_RATE, _FRICTION_RATE = 6.0, 12.0
#: Prior relative standard deviation of links of which nothing is stated: so wide that it says nothing.
_UNKNOWN_REL_STD = 100.0


def known_terms(experiment: Experiment, channel: str, effects: Sequence[str] | None) -> tuple[tuple[Term, ...], frozenset[str]]:
    """The user's effects at their starting values, and which of them (``name@where``) keep those."""
    names = make_channels(experiment, channel).names
    specs = experiment.effects if effects is None else effects
    parsed = experiment.library.parse(specs, experiment.robot.joint_names, names, experiment.gear_ratio)
    values, free = starting_point(parsed, experiment.effect_values, experiment.robot.joint_names)
    terms, held, start = [], set(), 0
    for effect in parsed:
        own = slice(start, start + len(effect.parameters))
        terms.append(Term(effect, tuple(map(float, values[own]))))
        if not free[own].all():
            held.add(effect.spec)
        start = own.stop
    return tuple(terms), frozenset(held)


def prepare_data(
    experiment: Experiment,
    channel: str | None,
    terms: Sequence[Term],
    motions: Sequence[str] | None,
    seed: int,
    held: Collection[str] = (),
    settings: Settings = DEFAULT,
    below: float = np.inf,
) -> DiagnosisData:
    """Cut the recordings into segments, smooth them to a bandwidth of ``below`` [Hz] at most, and measure their noise.

    ``channel`` and ``motions`` are by default those that `bayesid.identify` takes. Of the user's effects, those in ``held``,
    ``name@where``, keep their values; the seed is that of the encoders' repeated rounding. An `InputError` where there is
    nothing to fit.
    """
    channel = channel or default_channel(experiment)
    channels = make_channels(experiment, channel)
    asked = experiment.identification if motions is None else motions_named(experiment.motions, motions)
    names = {m.name for m in asked}
    readable = [m for m in experiment.motions if has_readings(m.table, channel)]
    at_rest = not any(m.kind == "trajectory" for m in readable if m.name in names)
    usable = [m for m in readable if (m.kind == "poses") == at_rest]
    chosen = [m for m in usable if m.name in names]
    if chosen and at_rest and channel != "wrench":
        sensed = experiment.sensor is not None
        raise InputError(
            "only poses at rest are to be fitted, where friction holds with whatever torque it takes; record a trajectory"
            + (f", or take the wrench of the sensor with {argument('channel', 'wrench')}" if sensed else "")
        )
    if not chosen:
        raise InputError(
            f"no motion with readings for {argument('channel', channel)} can be fitted; add one with role identification"
        )
    for motion in chosen:
        dead = {name: value for name, value in dead_channels(motion.table).items() if name in WRENCH_COLUMNS}
        if dead and channel != "torque":
            raise InputError(
                f"{motion.table.source}: {columns_of(list(dead))}: {next(iter(dead.values())):g} in every row; a reading without "
                "noise is none, and what is missing cannot be looked for beside it: record all six axes"
            )
    unseen = [m for m in usable if m.role == "validation" and m.name not in names]
    if at_rest:
        each, bandwidth = [np.inf] * len([*chosen, *unseen]), np.inf
    else:
        rate = min(1.0 / usual_step(m.table.times) for m in [*chosen, *unseen])
        clearest, *each = _clear(experiment, [*chosen, *unseen], settings)
        bandwidth = min(max(clearest, settings.smoothing_bandwidth), 0.2 * rate, below)
    # One mount, one stiffness: "the middle of the motion" is the same pose for all motions, the first one's.
    middle = middle_of(chosen[0].table.positions)
    # What is left of encoders' noise makes estimates of a compliance too small: loads are smoothed to most of the clear band.
    share = settings.most
    clear = dict(zip((m.name for m in [*chosen, *unseen]), each, strict=True))
    fitted = [s for m in chosen for s in _segments(experiment, m, channel, bandwidth, middle, share * clear[m.name], settings)]
    others = [s for m in unseen for s in _segments(experiment, m, channel, bandwidth, middle, clear[m.name], settings)]
    if not fitted:
        shortest = f"{settings.shortest_segment:g} s"
        raise InputError(f"the motions to fit have no segment of {shortest} without a gap; record longer ones")
    rel_std = experiment.inertia_rel_std
    # Nothing known is a width beside the bodies' own: one without a mass would have none, and be exact.
    known = Prior.warped(filled_links(experiment.robot), _UNKNOWN_REL_STD) if rel_std is None else None
    prior = known if not rel_std else Prior.warped(experiment.robot.nominal, rel_std)
    compared = {s.motion for s in (*fitted, *others)}
    left_out = [m for m in experiment.motions if m.role == "validation" and m.name not in {*names, *compared}]
    data = DiagnosisData(
        experiment, channel, channels, tuple(fitted), tuple(others), prior, tuple(terms), held=frozenset(held),
        skipped=tuple(sorted((m.name, _why_skipped(m, channel, at_rest, settings)) for m in left_out)), settings=settings,
    )  # fmt: skip
    with np.errstate(all="ignore"):
        finite = all(np.isfinite(data.predict(s, data.links, data.terms)).all() for s in data.segments)
    if not finite:
        specs = ", ".join(t.effect.spec for t in data.terms)
        raise InputError(f"readings are not finite where {specs or 'the links'} start; state other values in [model.values]")
    return with_noise_of(data, data.links, data.terms, seed)


def _why_skipped(motion: Motion, channel: str, at_rest: bool, settings: Settings) -> str:
    """Why a validation motion cannot be compared, where poses ``at_rest`` or trajectories are fitted."""
    poses = motion.kind == "poses"
    if not has_readings(motion.table, channel):
        return "the readings that are fitted are missing"
    if poses != at_rest:
        return "poses at rest are fitted, not trajectories" if at_rest else "trajectories are fitted, not poses at rest"
    least = f"{settings.shortest_segment:g}"
    return f"no more than {least} poses" if poses else f"no segment of {least} s without a gap"


def _clear(experiment: Experiment, motions: Sequence[Motion], settings: Settings) -> list[float]:
    """Up to where motions stand out of the encoders' noise, all together and then each, at most 20 Hz."""
    pieces, groups = [], []
    for m in motions:
        long = [p for p in m.table.segments() if p.stop - p.start > 40]
        groups.append(range(len(pieces), len(pieces) + len(long)))
        pieces += [(m.table.times[p][:5000], m.table.positions[p][:5000]) for p in long]
    some = [g for g in (range(len(pieces)), *groups) if len(g)]
    found = iter(choose_smoothers(pieces, some, experiment.position_resolution, experiment.position_std))
    return [next(found).bandwidth if len(g) else settings.smoothing_bandwidth for g in (range(len(pieces)), *groups)]


def _segments(
    experiment: Experiment,
    motion: Motion,
    channel: str,
    bandwidth: float,
    middle: np.ndarray,
    clear: float,
    settings: Settings,
) -> list[SpectralSegment]:
    """Gap-free recordings of a motion and of its static run."""
    if motion.kind == "poses":
        return _poses(experiment, motion, channel, middle, settings)
    tables = [(motion.table, False)]
    # At rest drives hold with friction whatever it takes; only the wrench of a static run is a measurement.
    if channel == "wrench" and motion.static is not None and motion.static.wrench is not None and motion.stop_and_go:
        tables.append((motion.static, True))
    out = []
    for table, still in tables:
        for part in table.segments():
            times = table.times[part]
            if times[-1] - times[0] < settings.shortest_segment:
                continue
            positions, read = table.positions[part], readings_of(experiment, table, channel)[part]
            if uneven(times):  # a frequency basis needs even times
                both = np.hstack([positions, read])
                times, both = resample_evenly(times, both, bandwidth)
                positions, read = both[:, : positions.shape[1]], both[:, positions.shape[1] :]
            whole = slice(0, _fast_count(len(times)))
            times, positions, read = times[whole], positions[whole], read[whole]
            rate = (_FRICTION_RATE if channel != "wrench" else _RATE) * settings.band
            grid = even_grid(times, rate)
            trajectory = smoothed(times, positions, grid, bandwidth, still, middle, clear, float(grid[1] - grid[0]))
            joints = () if channel == "wrench" else experiment.torque_joints
            torques = tuple((read.shape[1] - len(joints) + k, j) for k, j in enumerate(joints))
            out.append(
                SpectralSegment(
                    motion.name, motion.role, times, positions, read, trajectory, still, torques, np.zeros(0), settings=settings
                )
            )
    return out


def _poses(experiment: Experiment, motion: Motion, channel: str, middle: np.ndarray, settings: Settings) -> list[SpectralSegment]:
    """Poses as recorded, one after the other at even times: cosines of their order are as good as any basis."""
    table = motion.table
    times, still = np.arange(len(table), dtype=float), np.zeros_like(table.positions)
    if len(table) <= settings.shortest_segment:
        return []
    trajectory = MotionSegment(table.times, table.positions, still, still, True, np.inf, middle, in_turn=True)
    read = readings_of(experiment, table, channel)
    return [
        SpectralSegment(
            motion.name, motion.role, times, table.positions, read, trajectory, True, (), np.zeros(0), settings=settings
        )
    ]


def _fast_count(count: int) -> int:
    """The largest number of samples up to this one that cosine transforms are fast of: without a prime factor above 50.

    Of a prime number of samples one takes ten times as long. The few at the end that are left out have hardly any weight.
    """
    primes = [p for p in range(2, 50) if all(p % d for d in range(2, p))]
    for n in range(count, 0, -1):
        left = n
        for p in primes:
            while left % p == 0:
                left //= p
        if left == 1:
            return n
    return count


def even_grid(times: np.ndarray, rate: float) -> np.ndarray:
    """Even times at about this rate, the middles of equal parts of a recording's time; so many that transforms are fast."""
    step = (times[-1] - times[0]) / (len(times) - 1)
    count = int(next_fast_len(min(int(np.ceil(len(times) * step * rate)), len(times)), real=True) or 1)
    return times[0] - 0.5 * step + (np.arange(count) + 0.5) * (len(times) * step / count)
