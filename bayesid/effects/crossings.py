"""Where a link crosses the play of its gear, sought anew in intervals in which a fit of the encoders' readings went wrong.

Such a fit has a minimum wherever a crossing is assumed at a wrong time, and one in which the link chatters between the teeth
instead of resting on them. Then the readings are missed by far more than their errors, but in these intervals only. There, at
most two crossings at any times, from any side to any other, are tried, the rest of the motion as it was: with splines B that
the link moves by, a change s of how far it is behind leaves ``|(1 - P)(r - s)|^2`` of the readings r, P projecting on B. The
best is taken if it leaves less, and not much more than elsewhere: where there is next to no torque, the side is told by the
encoder, not by the splines' own torque.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from bayesid.signals.splines import Splines

#: Where the root mean square over so many seconds is so many times its median, a crossing may be at a wrong time.
_STRETCH, _STANDS_OUT = 0.25, 2.0
#: Two crossings cannot be all of a longer interval [s].
_LONGEST = 3.0
#: Crossings that are right leave no more than so many times the usual; one sample on the wrong side of a wide play makes ten.
_EXPLAINED = 15.0
#: Seconds around an interval that are looked at with it, for splines reach beyond it.
_AROUND = 1.0
#: Times tried in an interval, before every sample about the best of them is.
_TRIED = 250


def local_energy(left: np.ndarray, step: float) -> np.ndarray:
    """Mean square about each sample (M,) of what is left of readings (M,) that are so far apart [s]."""
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(left**2, max(int(round(_STRETCH / step)), 1))


def intervals_that_stand_out(energy: np.ndarray) -> list[tuple[int, int]]:
    """First sample of each, and the one after the last, by the mean square about each sample (M,)."""
    high = energy > _STANDS_OUT**2 * np.median(energy)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], high, [False]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def crossed_anew(
    encoders: np.ndarray,
    behind: np.ndarray,
    sides: np.ndarray,
    splines: Splines,
    still: np.ndarray,
    step: float,
    intervals: list[tuple[int, int]],
) -> np.ndarray:
    """On which side the link is in each interval (M,), -1 elsewhere, with the crossings that leave least of the readings.

    Parameters
    ----------
    encoders
        Readings (M,) [rad or m].
    behind
        How far the link is behind by the fit (M,) [rad or m].
    sides
        How far it may be behind (k,) [rad or m].
    splines
        That the link moves by, at the samples.
    still
        Where it is known, because nothing moves (M,).
    step
        Time between samples [s].
    intervals
        First sample of each, and the one after the last.
    """
    if not intervals:
        return np.full(len(behind), -1)
    usual = np.median(local_energy(splines.remainder(encoders - behind), step))
    out, found, around = behind.copy(), np.full(len(behind), -1), int(round(_AROUND / step))
    for a, b in intervals:
        if (b - a) * step > _LONGEST:
            continue
        near = slice(max(a - around, 0), min(b + around, len(encoders)))
        samples, some = np.arange(near.start, near.stop), splines.part(near)
        inside = (samples >= a) & (samples < b) & ~still[near]
        now = some.remainder(encoders[near] - out[near])
        outside = some.remainder(encoders[near] - np.where(inside, 0.0, out[near]))
        every = int(np.ceil((b - a) / _TRIED))
        times = np.append(np.arange(a, b, every), b)
        while True:
            until = some.remainder((inside[:, None] & (samples[:, None] < times)).astype(float))
            energy, (one, two, three), i, j = _least(until, outside, sides)
            if every == 1:
                break
            # Then every sample about those.
            close = [np.arange(max(times[k] - every, a), min(times[k] + every, b) + 1) for k in (i, j)]
            times, every = np.unique(np.concatenate([*close, [a, b]])), 1
        crossed = np.where(samples < times[i], one, np.where(samples < times[j], two, three))
        left = some.remainder(encoders[near] - np.where(inside, sides[crossed], out[near]))
        if energy < now @ now and local_energy(left, step)[inside].max(initial=0.0) < _EXPLAINED**2 * usual:
            found[near] = np.where(inside, crossed, found[near])
            out[near] = np.where(inside, sides[crossed], out[near])
    return found


def _least(until: np.ndarray, outside: np.ndarray, sides: np.ndarray) -> tuple[float, tuple[int, ...], int, int]:
    """The least sum of squares, which its three sides are, and which of the times the two crossings between them are.

    Parameters
    ----------
    until
        What the splines leave of a unit step that lasts from the interval's start to each time, the last one its end (M, k).
    outside
        What they leave of the readings if the link is not behind in the interval (M,).
    sides
        How far it may be behind (k,).
    """
    gram, along, alone = until.T @ until, until.T @ outside, outside @ outside
    own, whole = np.diag(gram), gram[:, -1]
    in_order = np.triu(np.ones(gram.shape, bool))
    found: tuple[float, tuple[int, ...], int, int] = (np.inf, (0, 0, 0), 0, 0)
    for which in product(range(len(sides)), repeat=3):
        if which[0] == which[1] or which[1] == which[2]:  # as one crossing less, at the interval's start or end
            continue
        one, two, three = sides[list(which)]
        x, y = one - two, two - three  # ``x until_i + y until_j + three until_end``
        first = x * (x * own + 2.0 * three * whole - 2.0 * along)
        second = y * (y * own + 2.0 * three * whole - 2.0 * along)
        energy = first[:, None] + second[None, :] + 2.0 * x * y * gram
        i, j = np.unravel_index(int(np.argmin(np.where(in_order, energy, np.inf))), energy.shape)
        total = float(energy[i, j] + three * (three * own[-1] - 2.0 * along[-1]) + alone)
        if total < found[0]:
            found = total, which, int(i), int(j)
    return found
