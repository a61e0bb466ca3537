"""Whether a sensor's zero moved between a motion and its static run, whose difference is free of offset and gravity else."""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.regressors import Kernel
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.motion import Motion
from bayesid.regression.linalg import pseudo_inverse
from bayesid.regression.readings import has_readings, make_channels
from bayesid.validation.mistakes.candidates import Mistake
from bayesid.validation.mistakes.evidence import FITTED, WORSE, independent_samples, rms
from bayesid.validation.mistakes.samples import MARGIN, splined

_SAMPLES, _SHORTEST = 300, 2.0  # in all, and of a piece [s]
_CLEAR = 3.0  # standard deviations from which on an axis is told


def zeros_moved(experiment: Experiment, needed: float) -> list[Mistake]:
    """Motions that differ from their static runs, row by row, by a constant wrench; each has ``needed`` log evidence [nats].

    Beside it, bodies of any size and a drift since the motion's time zero explain the difference.
    """
    moved = [m for m in experiment.motions if m.kind == "trajectory" and m.stop_and_go and has_readings(m.table, "wrench")]
    return [found for m in moved if (found := _moved(experiment, m, needed)) is not None]


def _moved(experiment: Experiment, motion: Motion, needed: float) -> Mistake | None:
    table, still = motion.table, motion.static
    if still is None or table.wrench is None or still.wrench is None:
        return None
    parts = [p for p in table.segments() if table.times[p.stop - 1] - table.times[p.start] > _SHORTEST]
    whole, taken, part = sum(table.times[p.stop - 1] - table.times[p.start] for p in parts), [], []
    for k, p in enumerate(parts):
        times, positions, difference = table.times[p], table.positions[p], (table.wrench - still.wrench)[p]
        at = np.linspace(times[0] + MARGIN, times[-1] - MARGIN, max(int(_SAMPLES * (times[-1] - times[0]) / whole), 2))
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
    if gained < WORSE or evidence < needed:
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
