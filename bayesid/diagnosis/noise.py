"""The noise of the segments: sensors', encoders' as a model passes it on, and how readings are taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as f_ratio

from bayesid.diagnosis.data import POSES, STATED_POSES, WHITE, DiagnosisData, fitted_values, residual_rows, term_rows
from bayesid.diagnosis.encoders import Encoders, encoder_count, with_noise
from bayesid.diagnosis.noise_spectrum import measure
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import Effect, MotionSegment, Term, columns
from bayesid.effects.loads import Tether
from bayesid.recordings.table import usual_step
from bayesid.regression.readings import has_readings, readings_of, rests, stated_noise
from bayesid.signals.arrays import runs
from bayesid.signals.repeats import find_rests
from bayesid.signals.smoothing import degrees_of_freedom, smooth
from bayesid.signals.white_noise import low_passed, quiet_noise

#: Poses for each column that is fitted to them, at least, before what is left is taken for noise.
_POSES_A_COLUMN = 2
#: A drift or a cable is taken out of poses where it leaves less than chance alone would this often.
_CLEARLY = 0.99


def at_instants(data: DiagnosisData, links: np.ndarray, terms: Sequence[Term], seed: int) -> DiagnosisData:
    """The data with moving readings taken for the values at their times, not for means over a sample's time.

    To friction that reverses it makes a difference, for one sample near the reversal is all of it or half of it; and to a quiet
    sensor, for means of a smooth motion are smaller.
    """

    def points(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
        out = []
        for s in segments:
            if not s.still:
                old = s.trajectory
                trajectory = smoothed(s.times, s.encoders, s.times, old.bandwidth, s.still, old.middle_positions, old.clear)
                s = replace(s, trajectory=trajectory, instant=True)
            out.append(s)
        return tuple(out)

    return with_noise_of(replace(data, segments=points(data.segments), unseen=points(data.unseen)), links, terms, seed)


def with_noise_of(data: DiagnosisData, links: np.ndarray, terms: Sequence[Term], seed: int) -> DiagnosisData:
    """Both sets of segments with the covariance of their coefficients, as a model passes the encoders' errors on.

    A model with a resonance or a gain amplifies them; so once effects are found, the noise is measured anew.
    """
    rng = np.random.default_rng(seed)
    everything = [*data.segments, *data.unseen]
    if all(s.apart for s in everything):
        return _poses_with_noise(data, links, terms, rng)
    # Recordings made in the same way have the same white noise of one sample.
    readings = {still: [s.readings for s in everything if s.still == still] for still in sorted({s.still for s in everything})}
    sensor = {still: quiet_noise(read) for still, read in readings.items()}
    moving = [s for s in everything if not s.still]
    count = _encoder_counts(data, moving)
    # What is more than a count's rounding is random: less than half a count of it may be most of an encoder's error.
    left = [s.encoders - smooth(s.times, s.encoders, s.trajectory.bandwidth)[0] for s in moving]
    free = sum(degrees_of_freedom(s.times, s.trajectory.bandwidth) for s in moving)
    variance = sum(np.sum(x**2, axis=0) for x in left) / max(free, 1)
    random = np.sqrt(np.maximum(variance - count**2 / 12.0, 0.0))
    if data.experiment.position_std is not None:
        random = np.full(data.robot.n, data.experiment.position_std)

    def predict(segment: SpectralSegment) -> np.ndarray:
        return data.predict(segment, links, terms)

    encoders = Encoders(predict, _resmoothed, count, random, seed)
    filtered = low_passed([s.readings for s in moving])
    spectrum = data.spectrum
    if not moving[0].covariance.size:  # the sensor's noise is the same whatever the model
        spectrum = measure(moving, _rests(data, count), sensor[False], filtered, encoders)
    source = spectrum.source if spectrum else WHITE if not filtered else "richest model"
    if filtered and spectrum is None and (sheet := stated_noise(data.experiment, data.channel)) is not None:
        # A filter moves noise into the band: there is no less of it there than of one sample's.
        sensor[False], source = np.maximum(sensor[False], sheet), "stated"

    def noisy(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
        out = []
        for s in segments:
            noise = sensor[s.still]
            if spectrum and not s.still:
                noise = spectrum.of(s.motion).at(s.frequencies, s.step, noise)
            out.append(with_noise(s, predict, _resmoothed, noise, count, random, rng))
        return tuple(out)

    fitted, unseen, known = noisy(data.segments), noisy(data.unseen), spectrum is not None or not filtered
    data = replace(data, segments=fitted, unseen=unseen, floor_known=known, floor_source=source, spectrum=spectrum)
    return replace(data, attenuated=_Attenuation(links, tuple(terms), count, random, seed))


def _resmoothed(segment: SpectralSegment, read: np.ndarray) -> SpectralSegment:
    """A segment as its encoders' other readings (N, n) would show it."""
    old = segment.trajectory
    at = old.times, old.bandwidth, segment.still, old.middle_positions, old.clear, old.cell
    return replace(segment, trajectory=smoothed(segment.times, read, *at))


@dataclass(frozen=True, eq=False)
class _Attenuation:
    """What encoders' errors are expected to add to the right side of the normal equations, by effects that make much of them.

    Errors u change whitened predictions by D u and their derivatives by D' u, both of the values: residuals and derivatives are
    correlated, and ``-E (D' u)' (D u)`` is added to J' r. Least squares so takes a mount for damped too much and a joint for too
    stiff, as those pass on less of the errors: attenuation in a model that is linear [Fuller1987]_.
    """

    #: The model (10 b,), and its effects.
    links: np.ndarray
    terms: tuple[Term, ...]
    #: One encoder count and random noise on top, by joint (n,) [rad or m]; of the roundings.
    count: np.ndarray
    random: np.ndarray
    seed: int

    def __call__(self, data: DiagnosisData) -> dict[Effect, np.ndarray]:
        """By effect (k,), with the noise that data have."""
        links, terms, offset = self.links, self.terms, np.zeros(len(data.channels))
        soft = [t for t in terms if t.effect.amplifies_encoder_errors and not data.fixed(t)]
        segments = [s for s in data.segments if not (s.still or s.apart)] if soft else []
        out = {t.effect: np.zeros(len(t.values)) for t in soft}
        encoders = Encoders(lambda s: data.predict(s, links, terms), _resmoothed, self.count, self.random, self.seed)
        for k, others in encoders.roundings(segments, set(range(len(segments)))).items():
            read = residual_rows(data, [segments[k]], links, offset, terms)
            for t in soft:
                beside = tuple(x for x in terms if x is not t)
                slopes = term_rows(data, [segments[k]], links, beside, t)
                for s in others:
                    error = read - residual_rows(data, [s], links, offset, terms)
                    out[t.effect][fitted_values(t)] -= (term_rows(data, [s], links, beside, t) - slopes).T @ error / len(others)
        return out


def _encoder_counts(data: DiagnosisData, segments: Sequence[SpectralSegment]) -> np.ndarray:
    """One count of each encoder (n,) [rad or m], as stated or as its readings show."""
    stated = data.experiment.position_resolution
    counts = [[encoder_count(column, data.settings) for column in s.encoders.T] for s in segments]
    return np.full(data.robot.n, stated) if stated else np.max(counts, axis=0)


def _poses_with_noise(data: DiagnosisData, links: np.ndarray, terms: Sequence[Term], rng: np.random.Generator) -> DiagnosisData:
    """The same for poses at rest: their readings have white noise."""
    noise, count = pose_noise(data), _encoder_counts(data, [*data.segments, *data.unseen])
    random = np.full(data.robot.n, data.experiment.position_std or 0.0)

    def noisy(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
        return tuple(
            with_noise(
                s, lambda segment: data.predict(segment, links, terms),
                lambda segment, read: replace(segment, trajectory=replace(segment.trajectory, positions=read)), noise, count,
                random, rng,
            )
            for s in segments
        )  # fmt: skip

    source = STATED_POSES if stated_noise(data.experiment, data.channel) is not None else POSES
    return replace(data, segments=noisy(data.segments), unseen=noisy(data.unseen), floor_known=True, floor_source=source)


def pose_noise(data: DiagnosisData) -> np.ndarray:
    """Noise of the wrench of poses (c,): the data sheet's, or what any bodies and any linear map of their wrench leave.

    Of a sensor in the arm also what a cable leaves that pulls what it carries, where there are poses enough to tell. A drift from
    pose to pose is taken out where it leaves clearly less; so is, at few poses of such a sensor, one body with either of both.
    """
    stated = stated_noise(data.experiment, data.channel)
    if stated is not None:
        return stated
    every = [*data.segments, *data.unseen]
    q, read = (np.concatenate([getattr(s, name) for s in every]) for name in ("encoders", "readings"))
    rigid = Kernel.of(data.robot, data.channels).dynamics(q, 0.0 * q, 0.0 * q)
    beside = np.column_stack([rigid @ data.robot.nominal.ravel(), np.ones(len(q))])
    elapsed = np.concatenate([s.trajectory.elapsed for s in every])
    drift, pulls = elapsed - elapsed.mean(), _pulls(data, every)
    plain, freedom, enough = _axis_noise(rigid, beside, pulls, read)
    others = [_axis_noise(rigid, np.column_stack([beside, drift]), pulls, read)[:2]]
    if not enough and pulls.shape[2]:
        each = drift[:, None, None] * np.eye(3)
        others += [_halves((rigid, each, read), (rigid, each, read)), _cable_noise(rigid, pulls, read)]
    # By how much each is clearer than chance makes it.
    clear = [np.mean((plain / out) ** 2) / f_ratio.ppf(_CLEARLY, freedom, left) for out, left in others]
    return others[int(np.argmax(clear))][0] if max(clear) > 1.0 else plain


def _axis_noise(rigid: np.ndarray, beside: np.ndarray, pulls: np.ndarray, read: np.ndarray) -> tuple[np.ndarray, int, bool]:
    """What columns leave of each axis by itself (c,), the degrees of freedom, and whether there were poses enough for pulls."""
    out, freedom, every = np.empty(read.shape[1]), 0, True
    for c in range(len(out)):
        fitted = np.column_stack([rigid[:, c], beside])
        if enough := len(read) >= _POSES_A_COLUMN * (np.linalg.matrix_rank(fitted) + pulls.shape[2]):
            fitted = np.column_stack([fitted, pulls[:, c]])
        left, rank = _left(fitted, read[:, c])
        out[c] = np.sqrt(np.sum(left**2) / max(len(read) - rank, 1))
        freedom, every = freedom + max(len(read) - rank, 1), every and bool(enough)
    return out, freedom, every


def _left(matrix: np.ndarray, read: np.ndarray) -> tuple[np.ndarray, int]:
    """What columns (N, p) leave of readings (N,), and their rank."""
    length = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    basis, power, _ = np.linalg.svd(matrix / length, full_matrices=False)
    basis = basis[:, power > 1e-9 * power[0]]
    return read - basis @ (basis.T @ read), basis.shape[1]


def _halves(*each: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, int]:
    """What one body, an offset and other columns (N, 3, k) leave of forces, and of moments (6,), and the degrees of freedom."""
    out, freedom = [], 0
    for k, (rigid, more, read) in enumerate(each):
        axes, count = slice(3 * k, 3 * k + 3), 3 * len(read)
        matrix = np.concatenate([rigid[:, axes], np.tile(np.eye(3), (len(read), 1, 1)), more], axis=2).reshape(count, -1)
        left, rank = _left(matrix, read[:, axes].ravel())
        freedom += max(count - rank, 1)
        out.append(np.sqrt(np.sum(left.reshape(-1, 3) ** 2, axis=0) * 3.0 / max(count - rank, 1)))
    return np.concatenate(out), freedom


def _cable_noise(rigid: np.ndarray, pulls: np.ndarray, read: np.ndarray) -> tuple[np.ndarray, int]:
    """What one body, offsets and a cable without length leave (6,), and the degrees of freedom.

    The forces tell the pull F, the moments then the point p that it acts on: they are linear in it, ``p x F``.
    """
    offset = np.tile(np.eye(3), (len(read), 1, 1))
    force = np.concatenate([rigid[:, :3], offset, pulls[:, :3]], axis=2).reshape(3 * len(read), -1)
    found = np.linalg.lstsq(force, read[:, :3].ravel(), rcond=1e-9)[0][-pulls.shape[2] :]
    pull = pulls @ found  # (N, 6), at the link's origin
    arm = np.cross(np.eye(3), pull[:, None, :3]).transpose(0, 2, 1)  # (N, 3, 3): moment of the pull a metre along each axis
    less = read - np.concatenate([0.0 * pull[:, :3], pull[:, 3:]], axis=1)
    return _halves((rigid, pulls[:, :3], read), (rigid, arm, less))


def _pulls(data: DiagnosisData, segments: Sequence[SpectralSegment]) -> np.ndarray:
    """Readings of a cable without length at the one body that a sensor in the arm carries, by stiffness and pull (N, c, 4)."""
    carried = np.flatnonzero(data.robot.sensor_bodies)
    if data.robot.sensor_parent < 0 or len(carried) > 1:
        return np.zeros((sum(len(s.times) for s in segments), len(data.channels), 0))
    joint = int(data.robot.body_joint[carried[0]])
    cable = Tether(f"joint{joint + 1}", joint)
    taut = (1.0, *(0.0,) * (len(cable.parameters) - 1))
    each = [columns(data.robot, data.channels, s.trajectory, data.links, (), cable, taut) for s in segments]
    return np.concatenate(each)[:, :, [0, 2, 3, 4]]


def _rests(data: DiagnosisData, count: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Times (N,) and readings (N, c) where the robot stands still, in motions and in static runs sampled like theirs."""
    moving = [s for s in (*data.segments, *data.unseen) if not s.still]
    motions = {m.name: m for m in data.experiment.motions if m.name in {s.motion for s in moving}}
    steps = {s.motion: s.step for s in moving}
    parts = [(s.times, s.readings, rests(motions[s.motion], s.times, s.encoders, count), s.used(s.times)) for s in moving]
    for motion in motions.values():
        table = motion.static
        if table is not None and not motion.stop_and_go and has_readings(table, data.channel):
            # Rows of poses that were averaged one by one are no recording.
            pieces = [p for p in table.segments() if p.stop - p.start > 2]
            pieces = [p for p in pieces if abs(usual_step(table.times[p]) / steps[motion.name] - 1.0) < 0.1]
            read = readings_of(data.experiment, table, data.channel)
            for p in pieces:
                times = table.times[p]
                parts.append((times, read[p], find_rests(times, table.positions[p], count), np.full(len(times), True)))
    out = []
    for times, read, still, used in parts:
        for start, end in still:
            inside = (times >= start) & (times <= end) & used
            for part in runs(inside):
                if part[1] - part[0] > 2:  # what the experiment states may lie in another segment
                    out.append((times[slice(*part)], read[slice(*part)]))
    return out


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
    """The trajectory of encoder readings (N, n) on a grid (M,); ``cell`` as in `MotionSegment`."""
    q, v, a = smooth(times, positions, bandwidth, at=np.clip(grid, times[0], times[-1]))
    if still:
        v, a = 0.0 * v, 0.0 * a
    return MotionSegment(grid, q, v, a, still, bandwidth, middle, clear, cell, None if still else (times, positions))
