"""An experiment made ready for diagnosis: segments with their noise, the nominal links and their prior."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.diagnosis.noise_spectrum import Encoders, Spectrum, measure
from bayesid.diagnosis.repeats import find_rests
from bayesid.diagnosis.spectra import Segment, encoder_count, low_passed, sensor_noise, with_noise
from bayesid.dynamics.channels import Channels
from bayesid.effects import Effect, MotionSegment, Term, middle_of, readings, rigid_columns
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import Table, usual_step
from bayesid.regression.problem import default_channel, make_channels
from bayesid.robot.prior import Prior
from bayesid.robot.robot import Robot
from bayesid.signals.smoothing import choose_smoother, smooth

#: Trajectories are smoothed at least this loosely [Hz]; what their noise does above the motion is weighed, not cut.
BANDWIDTH = 12.0
#: Loads that are differentiated again are smoothed to where motion stands out of the encoders' noise, fitted ones to this share
#: of it: what is left of the noise would make an estimate too small, and does no such harm to a prediction.
FITTED = 0.7
#: Prior relative standard deviation of links of which nothing is known: they may be many times their nominal size.
UNKNOWN_REL_STD = 100.0
#: The source of a floor that is measured where nothing moves a sensor: above the motion.
WHITE = "white noise above the band"
#: Predictions are made at this rate [Hz]; friction reverses at once and needs a higher one.
SMOOTH_RATE, FRICTION_RATE = 60.0, 120.0
SHORTEST = 2.0  # segments shorter than this tell no frequencies apart [s]


@dataclass(frozen=True)
class Episode(Term):
    """An effect that happened once, in one recording.

    Attributes
    ----------
    motion
        In which; nothing is known of others.
    """

    motion: str = ""


def active_terms(segment: Segment, terms: Sequence[Term]) -> tuple[Term, ...]:
    """The effects that act in a segment."""
    return tuple(
        t for t in terms
        if not (t.effect.once and (segment.still or segment.role == "validation"))
        and not (isinstance(t, Episode) and t.motion != segment.motion)
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class DiagnosisData:
    """What a diagnosis looks at.

    Attributes
    ----------
    experiment, channel, channels
        The recordings and what of them is compared.
    segments
        Of the identification motions, with their noise.
    unseen
        Of the validation motions, with their noise.
    prior
        Of the links; None where they are exact.
    terms
        Effects of the user's model at their starting values.
    floor_known
        Whether the noise was measured. Where readings were filtered before they were recorded it cannot be, and what the
        richest model leaves stands in for it.
    floor_source
        Where the noise of moving readings comes from: ``white noise above the band``, ``repeats``, ``parked``, ``stated``
        or ``richest model``.
    spectrum
        The noise of moving readings where it was measured by frequency, on repeats or at rest.
    held
        Effects of the user's model, ``name@where``, whose values are kept.
    skipped
        Validation motions that cannot be compared.
    """

    experiment: Experiment
    channel: str
    channels: Channels
    segments: tuple[Segment, ...]
    unseen: tuple[Segment, ...]
    prior: Prior | None
    terms: tuple[Term, ...]
    floor_known: bool = True
    floor_source: str = WHITE
    spectrum: Spectrum | None = None
    held: frozenset[str] = frozenset()
    skipped: tuple[str, ...] = ()

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self.experiment.robot

    @property
    def instants(self) -> bool:
        """Whether readings are taken for values at their times."""
        return any(s.instant for s in self.segments)

    @property
    def offset_free(self) -> bool:
        """Whether a static run removes the sensor's constant offset."""
        return any(s.still for s in self.segments)

    @cached_property
    def links(self) -> np.ndarray:
        """Nominal link parameters (10 b,)."""
        return self.robot.nominal.ravel()

    def fixed(self, term: Term) -> bool:
        """Whether the user's model keeps this effect's values."""
        return term.effect.spec in self.held

    def places(self, name: str) -> tuple[Effect, ...]:
        """Everywhere that an effect can be."""
        return self.experiment.library.places(name, self.robot.joint_names, self.channels.names, self.experiment.gear_ratio)

    def predict(self, segment: Segment, links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
        """Readings of a segment (M, c)."""
        return readings(self.robot, self.channels, segment.scene, links, active_terms(segment, terms))

    def link_columns(self, segment: Segment, terms: Sequence[Term]) -> np.ndarray:
        """Their derivatives with respect to the links, at the nominal ones (N, c, 10 b)."""
        return rigid_columns(self.robot, self.channels, segment.scene, self.links, active_terms(segment, terms))


def prepare_data(
    experiment: Experiment,
    channel: str | None,
    terms: Sequence[Term],
    motions: Sequence[str] | None,
    seed: int,
    held: Collection[str] = (),
) -> DiagnosisData:
    """Cut the recordings into segments, smooth them and measure their noise.

    Parameters
    ----------
    experiment
        The recordings.
    channel
        ``wrench``, ``torque`` or ``both``; default as for `bayesid.identify`.
    terms
        Effects of the user's model.
    motions
        Which to fit; default those with role ``identification``.
    seed
        Of the encoders' repeated rounding.
    held
        Effects among these, ``name@where``, whose values are kept.

    Raises
    ------
    InputError
        Nothing to fit, or samples that are not evenly spaced.
    """
    channel = channel or default_channel(experiment)
    channels = make_channels(experiment, channel)
    names = [m.name for m in experiment.identification] if motions is None else list(motions)
    known = {m.name for m in experiment.motions}
    for name in names:
        if name not in known:
            raise InputError(f"--motions {name}: no such motion in experiment.toml; it has {', '.join(sorted(known))}")
    usable = [m for m in experiment.motions if m.kind == "trajectory" and _has(m.table, channel)]
    chosen = [m for m in usable if m.name in names]
    if not chosen and any(m.name in names and m.kind == "poses" for m in experiment.motions):
        raise InputError("only poses at rest are to be fitted, and a diagnosis needs a trajectory; name one with --motions")
    if not chosen:
        raise InputError(f"no motion with readings for --channel {channel} can be fitted; add one with role identification")
    unseen = [m for m in usable if m.role == "validation" and m.name not in names]
    rate = min(1.0 / usual_step(m.table.times) for m in [*chosen, *unseen])
    bandwidth = min(max(_clear(experiment, [*chosen, *unseen]), BANDWIDTH), 0.2 * rate)
    # One mount, one stiffness: "the middle of the motion" is the same pose for all motions, the first one's.
    middle = middle_of(chosen[0].table.positions)
    fitted = [s for m in chosen for s in _segments(m, channel, bandwidth, middle, FITTED * _clear(experiment, [m]))]
    others = [s for m in unseen for s in _segments(m, channel, bandwidth, middle, _clear(experiment, [m]))]
    if not fitted:
        raise InputError(f"the motions to fit have no segment of {SHORTEST:g} s without a gap; record longer ones")
    rel_std = experiment.inertia_rel_std
    prior = None if rel_std == 0 else Prior.warped(experiment.robot.nominal, UNKNOWN_REL_STD if rel_std is None else rel_std)
    for_validation = {m.name for m in experiment.motions if m.role == "validation" and m.kind == "trajectory"} - set(names)
    data = DiagnosisData(
        experiment, channel, channels, tuple(fitted), tuple(others), prior, tuple(terms), held=frozenset(held),
        skipped=tuple(sorted(for_validation - {s.motion for s in others})),
    )  # fmt: skip
    return with_noise_of(data, data.links, data.terms, seed)


def _has(table: Table, channel: str) -> bool:
    wrench, torque = table.wrench is not None, table.torques is not None
    return {"wrench": wrench, "torque": torque, "both": wrench and torque}[channel]


def _clear(experiment: Experiment, motions: Sequence[Motion]) -> float:
    """Up to where motions stand out of the encoders' noise, at most 20 Hz."""
    pieces = [(m.table.times[p], m.table.positions[p]) for m in motions for p in m.table.segments() if p.stop - p.start > 40]
    pieces = [(t[:5000], q[:5000]) for t, q in pieces]
    return choose_smoother(pieces, experiment.position_resolution, experiment.position_std).bandwidth if pieces else BANDWIDTH


def _segments(motion: Motion, channel: str, bandwidth: float, middle: np.ndarray, clear: float) -> list[Segment]:
    tables = [(motion.table, False)]
    # At rest drives hold with friction whatever it takes; only the wrench of a static run is a measurement.
    if channel == "wrench" and motion.static is not None and motion.static.wrench is not None and motion.stop_and_go:
        tables.append((motion.static, True))
    out = []
    for table, still in tables:
        for part in table.segments():
            times = table.times[part]
            if times[-1] - times[0] < SHORTEST:
                continue
            step = np.diff(times)
            if np.abs(times - np.linspace(times[0], times[-1], len(times))).max() > 2.0 * np.median(step):
                raise InputError(f"{table.source}: samples are not evenly spaced; resample them to a constant rate")
            read = _readings(table, channel)[part]
            rate = FRICTION_RATE if channel != "wrench" else SMOOTH_RATE
            positions = table.positions[part]
            grid = _grid(times, rate)
            scene = smoothed(times, positions, grid, bandwidth, still, middle, clear, float(grid[1] - grid[0]))
            torques = tuple((read.shape[1] - scene.positions.shape[1] + j, j) for j in range(scene.positions.shape[1]))
            torques = () if channel == "wrench" else torques
            out.append(Segment(motion.name, motion.role, times, positions, read, scene, still, torques, np.zeros(0)))
    return out


def _grid(times: np.ndarray, rate: float) -> np.ndarray:
    """Even times at about this rate, the middles of equal parts of a recording's time."""
    step = (times[-1] - times[0]) / (len(times) - 1)
    count = min(int(np.ceil(len(times) * step * rate)), len(times))
    return times[0] - 0.5 * step + (np.arange(count) + 0.5) * (len(times) * step / count)


def smoothed(
    times: np.ndarray,
    positions: np.ndarray,
    grid: np.ndarray,
    bandwidth: float,
    still: bool,
    middle: np.ndarray,
    clear: float | None = None,
    cell: float = 0.0,
) -> MotionSegment:
    """The scene of encoder readings (N, n) on a grid (M,); ``cell`` as in `MotionSegment`."""
    q, v, a = smooth(times, positions, bandwidth, at=np.clip(grid, times[0], times[-1]))
    if still:
        v, a = 0.0 * v, 0.0 * a
    return MotionSegment(grid, q, v, a, still, bandwidth, middle, clear, cell)


def _readings(table: Table, channel: str) -> np.ndarray:
    wanted = [table.wrench if channel != "torque" else None, table.torques if channel != "wrench" else None]
    return np.hstack([a for a in wanted if a is not None])


def at_instants(data: DiagnosisData, links: np.ndarray, terms: Sequence[Term], seed: int) -> DiagnosisData:
    """The data with moving readings taken for the values at their times, not for means over a sample's time.

    To friction that reverses it makes a difference: one sample near the reversal is all of it or half of it.
    """

    def points(segments: Sequence[Segment]) -> tuple[Segment, ...]:
        out = []
        for s in segments:
            old = s.scene
            scene = smoothed(s.times, s.encoders, s.times, old.bandwidth, s.still, old.middle_positions, old.clear)
            out.append(s if s.still else replace(s, scene=scene, instant=True))
        return tuple(out)

    return with_noise_of(replace(data, segments=points(data.segments), unseen=points(data.unseen)), links, terms, seed)


def with_noise_of(data: DiagnosisData, links: np.ndarray, terms: Sequence[Term], seed: int) -> DiagnosisData:
    """Both sets of segments with the covariance of their coefficients, as a model passes the encoders' errors on.

    A model with a resonance or a gain amplifies them; so once effects are found, the noise is measured anew.
    """
    rng = np.random.default_rng(seed)
    everything = [*data.segments, *data.unseen]
    sensor = {still: sensor_noise([s for s in everything if s.still == still]) for still in sorted({s.still for s in everything})}
    moving = [s for s in everything if not s.still]
    n = data.robot.n
    stated = data.experiment.position_resolution
    count = np.array([stated or max(encoder_count(s.encoders[:, j]) for s in moving) for j in range(n)])
    smooth_ = [smooth(s.times, s.encoders, s.scene.bandwidth)[0] for s in moving]
    error = np.sqrt(np.mean([np.mean((s.encoders - q) ** 2, axis=0) for s, q in zip(moving, smooth_, strict=True)], axis=0))
    random = np.sqrt(np.maximum(error**2 - count**2 / 12.0, 0.0))
    random = np.where(random > 0.5 * count, random, 0.0)
    if data.experiment.position_std is not None:
        random = np.full(n, data.experiment.position_std)

    def predict(segment: Segment) -> np.ndarray:
        return data.predict(segment, links, terms)

    def resmooth(segment: Segment, read: np.ndarray) -> Segment:
        old = segment.scene
        at = old.times, old.bandwidth, segment.still, old.middle_positions, old.clear, old.cell
        scene = smoothed(segment.times, read, *at)
        return replace(segment, scene=scene)

    filtered = low_passed(moving)
    spectrum = data.spectrum
    if not moving[0].covariance.size:  # the sensor's noise is the same whatever the model
        encoders = Encoders(predict, resmooth, count, random, seed)
        spectrum = measure(moving, _rests(data, count), sensor[False], filtered, encoders)
    source = spectrum.source if spectrum else WHITE if not filtered else "richest model"
    if filtered and spectrum is None and (stated_noise := _stated_noise(data)) is not None:
        # A filter moves noise into the band: there is no less of it there than of one sample's.
        sensor[False], source = np.maximum(sensor[False], stated_noise), "stated"

    def noisy(segments: Sequence[Segment]) -> tuple[Segment, ...]:
        out = []
        for s in segments:
            noise = spectrum.of(s.motion).at(s.frequencies, sensor[False]) if spectrum and not s.still else sensor[s.still]
            out.append(with_noise(s, predict, resmooth, noise, count, random, rng))
        return tuple(out)

    fitted, unseen, known = noisy(data.segments), noisy(data.unseen), spectrum is not None or not filtered
    return replace(data, segments=fitted, unseen=unseen, floor_known=known, floor_source=source, spectrum=spectrum)


def _rests(data: DiagnosisData, count: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times (N,) and readings (N, c) where the robot stands still, in motions and in static runs sampled like them."""
    moving = [s for s in (*data.segments, *data.unseen) if not s.still]
    names = {s.motion for s in moving}
    step = float(np.median([s.step for s in moving]))
    parts = [(s.times, s.encoders, s.readings) for s in moving]
    for motion in data.experiment.motions:
        table = motion.static
        if motion.name in names and table is not None and not motion.stop_and_go and _has(table, data.channel):
            # Rows of poses that were averaged one by one are no recording.
            pieces = [p for p in table.segments() if p.stop - p.start > 2]
            pieces = [p for p in pieces if abs(usual_step(table.times[p]) / step - 1.0) < 0.1]
            parts += [(table.times[p], table.positions[p], _readings(table, data.channel)[p]) for p in pieces]
    out = []
    for times, encoders, read in parts:
        for start, end in find_rests(times, encoders, count):
            inside = (times >= start) & (times <= end)
            out.append((times[inside], read[inside]))
    return out


def _stated_noise(data: DiagnosisData) -> np.ndarray | None:
    """Noise of one sample from the data sheet (c,), where the sensor is all that is compared."""
    sensor = data.experiment.sensor
    if data.channel != "wrench" or sensor is None or sensor.force_std is None or sensor.torque_std is None:
        return None
    return np.repeat([sensor.force_std, sensor.torque_std], 3)
