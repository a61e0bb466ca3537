"""Readings that are shifted: in time against the positions, or by a sensor's zero that moved after its static run.

Of readings and positions on two clocks one is late by what lets the robot's motion explain most. Where no zero moved, the
difference of a motion and its static run, row by row, is free of offset and gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.parts import Motion
from bayesid.regression.linalg import pseudo_inverse
from bayesid.regression.readings import has_readings, make_channels, readings_of
from bayesid.rounding import number
from bayesid.validation.mistakes.candidates import Mistake
from bayesid.validation.mistakes.evidence import FITTED, NEEDED, WORSE, columns_beside, independent_samples, rms
from bayesid.validation.mistakes.samples import MARGIN, splined

_STEP, _LONGEST = 0.01, 0.5  # of the delays that are tried [s]
_SHARE = 0.1  # of the shortest piece, at most
_SHORTEST, _LONG = 2.0, 0.25  # of pieces [s], and as a share of the longest
_SAMPLES, _SMOOTHED = 400, 20_000
_PARTS = 8  # of all recordings, which must agree


@dataclass(frozen=True)
class Profile:
    """What the motion leaves of readings that are taken so much later."""

    delays: np.ndarray  # (k,) [s]
    left: np.ndarray  # rms of each channel (c, k) [unit of the channel]
    gained: np.ndarray  # log likelihood of a sample over that without a delay (k,) [nats]
    worth: float  # how many independent samples there are
    #: Share of each channel's mean square residual at the best delay that is left in each part of the recordings (c, parts, k).
    power: np.ndarray

    @property
    def bend(self) -> float:
        """Curvature of the log likelihood of a sample at the best delay that was tried [nats a step squared]."""
        k = int(np.argmax(self.gained))
        return max(2.0 * self.gained[k] - self.gained[k - 1] - self.gained[k + 1], 1e-12)

    def best(self) -> tuple[float, float] | None:
        """The delay that explains most, and its standard deviation [s]; None where it is the first or last that was tried.

        The top of the parabola through the best delay that was tried and its neighbours. The standard deviation is the largest of
        four: by the curvature there; by the scatter between channels and between parts of the recordings, from how much each of
        them would move the top; and by other delays far from it that are nearly as likely.
        """
        k = int(np.argmax(self.gained))
        if not 0 < k < len(self.delays) - 1:
            return None
        low, top, high = np.moveaxis(self.power[:, :, k - 1 : k + 2], 2, 0)
        away = 0.5 * (self.gained[k + 1] - self.gained[k - 1]) / self.bend  # from the best delay that was tried, in steps
        pull = -0.5 * (0.5 * (high - low) + away * (high - 2.0 * top + low)) / self.bend  # of each channel in each part, in steps
        scatter = [np.sum(p**2) * len(p) / max(len(p) - 1, 1) for p in (pull.sum(axis=1), pull.sum(axis=0))]
        variance = max(1.0 / (self.worth * self.bend), *scatter)
        odds = np.exp((self.gained - self.gained[k]) / (self.bend * variance))
        steps = np.arange(len(odds)) - k
        far = np.sum(np.where(np.abs(steps) > 1, odds, 0.0) * (steps - away) ** 2) / np.sum(odds)
        return float(self.delays[k] + _STEP * away), float(_STEP * np.sqrt(max(variance, far)))

    def evidence(self, std: float) -> float:
        """Log odds against no delay, for a standard deviation of the best one [s]: of as many samples as that is worth [nats]."""
        return float(self.gained.max() * (_STEP / std) ** 2 / self.bend)


def delay_profile(experiment: Experiment, channel: str) -> Profile | None:
    """Explain the readings of each time after the motion by the motion; None where recordings are too short.

    Least squares with bodies, friction and offsets of any size and sign: a wrong sign or unit is no delay.
    """
    pieces = []
    for index, motion in enumerate(experiment.motions):
        if motion.kind == "trajectory" and has_readings(motion.table, channel):
            table, read = motion.table, readings_of(experiment, motion.table, channel)
            parts = [slice(p.start, min(p.stop, p.start + _SMOOTHED)) for p in table.segments()]
            pieces += [(index, table.times[p], table.positions[p], read[p]) for p in parts]
    lengths = [float(times[-1] - times[0]) for _, times, _, _ in pieces]
    shortest = max(_SHORTEST, _LONG * max(lengths, default=0.0))
    pieces = [piece for piece, length in zip(pieces, lengths, strict=True) if length >= shortest]
    if not pieces:
        return None
    durations = [length for length in lengths if length >= shortest]
    steps = int(min(_LONGEST, _SHARE * min(durations)) / _STEP)
    delays = _STEP * np.arange(-steps, steps + 1)
    motions, read, index = [], [], []
    for (recording, times, positions, values), duration in zip(pieces, durations, strict=True):
        count = max(int(_SAMPLES * duration / sum(durations)), 2)
        edge = MARGIN + delays[-1]
        at = np.linspace(times[0] + edge, times[-1] - edge, count)
        motions.append(splined(times, positions, at))
        when = (at + delays[:, None]).ravel()
        order = np.argsort(when)
        later = np.empty((len(when), values.shape[1]))
        later[order] = splined(times, values, when[order])[0]
        read.append(later.reshape(len(delays), count, -1))
        index.append(np.full(count, recording))
    q, v, a = (np.concatenate([m[k] for m in motions]) for k in range(3))
    channels = make_channels(experiment, channel)
    rigid = Kernel.of(experiment.robot, channels).dynamics(q, v, a)
    design = np.concatenate([rigid, columns_beside(channels, v, a, np.concatenate(index))], axis=2)
    return _profile(delays, design, np.concatenate(read, axis=1).transpose(1, 2, 0), len(delays) // 2)


def _profile(delays: np.ndarray, design: np.ndarray, read: np.ndarray, none: int) -> Profile:
    """Least squares of readings of every delay (N, c, k), channels weighted by what they leave without one."""
    count, channels, _ = design.shape
    variation = np.maximum(read[:, :, none].std(axis=0), 1e-9)
    floor = np.maximum(FITTED * variation, 1e-3 * variation.max())
    left, residual = variation, read
    for _ in range(2):
        weights = 1.0 / np.maximum(left, floor)
        columns = (design * weights[:, None]).reshape(count * channels, -1)
        size = np.linalg.norm(columns, axis=0)
        seen = size > 1e-9 * size.max()
        scaled = columns[:, seen] / size[seen]
        power, vectors = np.linalg.eigh(scaled.T @ scaled)
        known = power > 1e-10 * power[-1]
        basis = scaled @ (vectors[:, known] / np.sqrt(power[known]))
        target = (read * weights[:, None]).reshape(count * channels, -1)
        residual = (target - basis @ (basis.T @ target)).reshape(read.shape) / weights[:, None]
        left = rms(residual[:, :, none])
    every = rms(residual)
    likelihood = -np.log(np.maximum(every, floor[:, None])).sum(axis=0)
    best = int(np.argmax(likelihood))
    worth = independent_samples(residual[:, :, best], np.zeros(count))
    power = np.stack([np.sum(part**2, axis=0) for part in np.array_split(residual, _PARTS)], axis=1) / count
    power /= np.maximum(every[:, best], floor)[:, None, None] ** 2
    return Profile(delays, every, likelihood - likelihood[none], worth, power)


def delayed(experiment: Experiment, channel: str) -> Mistake | None:
    """That the readings of a channel, or the positions, are late by a constant time; None where nothing says so."""
    profile = delay_profile(experiment, channel)
    if profile is None:
        return None
    best, none = int(np.argmax(profile.gained)), len(profile.delays) // 2
    found = profile.best()
    if found is None or profile.gained[best] < WORSE or profile.evidence(found[1]) < NEEDED:
        return None
    delay, std = found
    channels = make_channels(experiment, channel)
    k = int(np.argmax(profile.left[:, none] / profile.left[:, best]))
    read, columns = ("The wrench", " (fx ... mz) is") if channel == "wrench" else ("The joint torques", " (tau) are")
    late = f"{read}{columns}" if delay > 0.0 else "The positions (q) are"
    other, moved = ("the positions", read.lower()) if delay > 0.0 else (read.lower(), "the positions")
    text = (
        f"{late} {1e3 * abs(delay):.3g} +- {number(1e3 * max(std, 1e-4), 1)} ms late against {other}: with that undone, what the "
        f"motion does not explain of {channels.names[k]} falls from {profile.left[k, none]:.2g} to {profile.left[k, best]:.2g} "
        f"{channels.units[k]} rms; shift the times of {moved} by {-abs(delay):.3f} s and interpolate, or record on one clock"
    )
    if profile.left[k, best] > 0.5 * profile.left[k, none]:
        text += f". More than half stays, and delays of at most {profile.delays[-1]:.2g} s are tried: clocks may be further apart"
    return Mistake(
        name=f"{channel}_delay", where="", text=text, channel=channel, evidence=profile.evidence(std),
        before=tuple(map(float, profile.left[:, none])), after=tuple(map(float, profile.left[:, best])),
    )  # fmt: skip


#: Samples of the difference of motion and static run in all, and least length of a piece [s].
_OF_DIFFERENCE, _SHORTEST_DIFFERENCE = 300, 2.0
_CLEAR = 3.0  # standard deviations from which on an axis is told


def zeros_moved(experiment: Experiment) -> list[Mistake]:
    """Motions that differ from their static runs, row by row, by a constant wrench.

    Beside it, bodies of any size and a drift since the motion's time zero explain the difference.
    """
    moved = [m for m in experiment.motions if m.kind == "trajectory" and m.stop_and_go and has_readings(m.table, "wrench")]
    return [found for m in moved if (found := _moved(experiment, m)) is not None]


def _moved(experiment: Experiment, motion: Motion) -> Mistake | None:
    table, still = motion.table, motion.static
    if still is None or table.wrench is None or still.wrench is None:
        return None
    parts = [p for p in table.segments() if table.times[p.stop - 1] - table.times[p.start] > _SHORTEST_DIFFERENCE]
    whole, taken, part = sum(table.times[p.stop - 1] - table.times[p.start] for p in parts), [], []
    for k, p in enumerate(parts):
        times, positions, difference = table.times[p], table.positions[p], (table.wrench - still.wrench)[p]
        at = np.linspace(times[0] + MARGIN, times[-1] - MARGIN, max(int(_OF_DIFFERENCE * (times[-1] - times[0]) / whole), 2))
        taken.append((at, *splined(times, positions, at), splined(times, difference, at)[0]))
        part.append(np.full(len(at), k))
    if not taken:
        return None
    times, q, v, a, read = (np.concatenate(x) for x in zip(*taken, strict=True))
    channels = make_channels(experiment, "wrench")
    kernel, count = Kernel.of(experiment.robot, channels), read.shape[1]
    axes = np.tile(np.eye(count), (len(read), 1, 1))
    rigid = kernel.dynamics(q, v, a) - kernel.dynamics(q, 0.0 * v, 0.0 * a)
    beside = np.concatenate([rigid, axes * times[:, None, None]], axis=2)
    floor = np.maximum(FITTED * read.std(axis=0), 1e-9)
    before, _ = _fitted(beside, read, floor)
    after, solution = _fitted(np.concatenate([beside, axes], axis=2), read, floor)
    left = [np.maximum(rms(x), floor) for x in (before, after)]
    gained, worth = float(np.log(left[0] / left[1]).sum()), independent_samples(after, np.concatenate(part))
    evidence = worth * gained - 0.5 * count * np.log(worth)
    if gained < WORSE or evidence < NEEDED:
        return None
    shift, k = solution[-count:], int(np.argmax(left[0] / left[1]))
    clear = np.flatnonzero(np.abs(shift) > _CLEAR * left[1] / np.sqrt(worth))
    by = listed([f"{channels.names[c]} {shift[c]:.3g} {channels.units[c]}" for c in clear], count)
    text = (
        f"The sensor's zero seems to have moved by {by} from the static run of '{motion.name}' to its motion: with that undone, "
        f"what no robot and no drift explain of {channels.names[k]} falls from {left[0][k]:.2g} to {left[1][k]:.2g} "
        f"{channels.units[k]} rms; record the static run again, or leave it out, and the offset is estimated along"
    )
    return Mistake("static_zero", motion.name, text, "wrench", evidence, tuple(map(float, left[0])), tuple(map(float, left[1])))


def _fitted(columns: np.ndarray, read: np.ndarray, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What columns (N, c, p) leave of readings (N, c), and their factors (p,), axes weighted by what they leave."""
    residual, solution = read - read.mean(axis=0), np.zeros(columns.shape[2])
    for _ in range(3):
        weight = 1.0 / np.maximum(rms(residual), floor)
        rows = (columns * weight[:, None]).reshape(-1, columns.shape[2])
        size = np.linalg.norm(rows, axis=0)
        size = np.where(size > 1e-9 * size.max(), size, np.inf)
        solution = pseudo_inverse(rows / size) @ (read * weight).ravel() / size
        residual = read - columns @ solution
    return residual, solution
