"""Short events above the compared band: something hit or shook the robot, which no model of its motion explains.

The readings themselves are looked at, high-passed, in windows of 50 ms. A window's energy is compared with what is usual
beside it, on whichever side is louder, so that a motion that starts or hurries raises no alarm. How far such ratios
scatter when nothing happens is read off the recording itself (an empirical null [Efron2004]_). Where a joint
reverses, starts, stops or rests, friction itself excites the arm: such moments are not looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2, norm

from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import REST_SPEED
from bayesid.signals.arrays import runs
from bayesid.signals.white_noise import quiet_noise

#: Of the high-pass filter.
_ORDER = 4
#: Least samples of a window.
_SAMPLES = 5


@dataclass(frozen=True)
class Event:
    """A moment at which readings are loud above the band."""

    channel: int  # in which most
    #: When, and when most [s].
    start: float
    end: float
    peak: float
    band: tuple[float, float]  # what was looked at [Hz]
    ratio: float  # root mean square over the usual one
    p_value: float  # probability of as much by chance in one of all places looked at
    tap: bool  # whether it is over within `Settings.moment` and its band is broad


def short_events(segments: Sequence[SpectralSegment], level: float) -> tuple[tuple[Event, ...], ...]:
    """Events of each segment; none of a static run, whose samples may be means over long times.

    ``level`` is the probability of a false alarm over all of them.
    """
    moving = [s for s in segments if not s.still and _band(s) is not None]
    if not moving:
        return tuple(() for _ in segments)
    quiet = quiet_noise([s.readings for s in moving])
    looked = sum(len(_edges(s)) - 1 for s in moving) * moving[0].readings.shape[1]
    return tuple(_events(s, quiet, looked, level) if s in moving else () for s in segments)


def _band(segment: SpectralSegment) -> tuple[float, float] | None:
    """The band between the compared one and half the sampling rate [Hz], if that is as wide again."""
    low, high = float(segment.frequencies[-1] + segment.frequencies[min(1, len(segment.frequencies) - 1)]), 0.5 / segment.step
    return (low, high) if high > 2.0 * low else None


def _edges(segment: SpectralSegment) -> np.ndarray:
    length = max(round(0.5 * segment.settings.moment / segment.step), _SAMPLES)
    return np.linspace(0, len(segment.times), max(len(segment.times) // length, 1) + 1).astype(int)


def _events(segment: SpectralSegment, quiet: np.ndarray, looked: int, level: float) -> tuple[Event, ...]:
    band, edges, settings = _band(segment), _edges(segment), segment.settings
    if band is None or len(edges) <= settings.enough:
        return ()
    high = _high(segment, band[0])
    energy, length = np.add.reduceat(high**2, edges[:-1], axis=0) / np.diff(edges)[:, None], float(np.diff(edges).mean())
    share = 1.0 - band[0] / band[1]
    around = max(round(0.5 * settings.window / (segment.step * length)), 3)
    ratio = energy / np.maximum(np.maximum(_usual(energy, around), share * quiet**2), 1e-300)
    judged = _inside(segment, edges) & ~np.maximum.reduceat(kicks(segment), edges[:-1])
    chance = np.ones_like(ratio)
    chance[judged] = np.minimum(unlikely(ratio[judged], share * length, settings) * looked, 1.0)
    usually = np.median(ratio[judged], axis=0) if judged.any() else np.ones(ratio.shape[1])
    marked = chance < level
    out = []
    for first, last in runs(np.asarray(marked.any(axis=1)), max(round(settings.moment / (segment.step * length)), 1)):
        strength = np.where(marked[first:last], ratio[first:last] / usually, 0.0)
        row, channel = (int(k) for k in np.unravel_index(int(np.argmax(strength)), strength.shape))
        start, end = edges[first + row], edges[first + row + 1]
        usually_here = float(np.sqrt(energy[first + row, channel] / strength[row, channel]))
        peak = int(start) + int(np.argmax(np.abs(high[start:end, channel])))
        out.append(
            Event(
                channel, float(segment.times[edges[first]]), float(segment.times[edges[last] - 1]), float(segment.times[peak]),
                band, float(np.sqrt(strength[row, channel])), float(chance[first + row, channel]),
                _is_tap(high[:, channel], peak, segment.step, usually_here, settings),
            )
        )  # fmt: skip
    return tuple(out)


def _high(segment: SpectralSegment, low: float) -> np.ndarray:
    """Readings above a frequency (N, c)."""
    return np.asarray(sosfiltfilt(butter(_ORDER, low, "high", output="sos", fs=1.0 / segment.step), segment.readings, axis=0))


def _inside(segment: SpectralSegment, edges: np.ndarray) -> np.ndarray:
    """Windows that a filter's start and end do not reach (w,)."""
    first, last = segment.times[edges[:-1]], segment.times[edges[1:] - 1]
    return (first > segment.times[0] + segment.settings.ramp) & (last < segment.times[-1] - segment.settings.ramp)


def _usual(energy: np.ndarray, around: int) -> np.ndarray:
    """Median energy before or after each window (w, c), whichever is larger [Hansen1973]_; near an end, of what there is."""
    padded = np.pad(energy, ((around, around), (0, 0)), mode="reflect")
    sides = np.median(np.lib.stride_tricks.sliding_window_view(padded, around, axis=0), axis=2)
    return np.maximum(sides[: len(energy)], sides[around + 1 :])


def unlikely(ratio: np.ndarray, freedom: np.ndarray | float, settings: Settings) -> np.ndarray:
    """Probability of as large ratios (w, c) by chance, from each channel's own median and ninth decile.

    Disturbances are rare, so the lower nine tenths are what happens without. Logarithms of mean squares have a lighter
    upper tail than a normal distribution of that spread, so its probability is a bound; no spread is taken for smaller
    than that of white noise, a chi-squared of ``freedom``. Too few windows give no probability, 1.
    """
    if len(ratio) < settings.enough:
        return np.ones_like(ratio)
    log = np.log(np.maximum(ratio, 1e-300))
    middle, upper = np.quantile(log, [0.5, 0.9], axis=0)
    most = np.max(freedom, axis=0)
    least = np.log(chi2.ppf(0.9, most) / chi2.ppf(0.5, most))
    return norm.sf((log - middle) * norm.ppf(0.9) / np.maximum(upper - middle, least))


def kicks(segment: SpectralSegment) -> np.ndarray:
    """Samples at which friction may kick the arm (N,): a joint reverses, starts or stops, or rests and may creep and slip."""
    trajectory, settings = segment.trajectory, segment.settings
    step = float(np.median(np.diff(trajectory.times)))
    fastest = np.abs(trajectory.velocities).max(axis=0)
    speed = trajectory.velocities[:, fastest > 10.0 * REST_SPEED]
    moves = np.abs(speed) > np.maximum(settings.rest_share * np.abs(speed).max(axis=0), 2.0 * REST_SPEED)
    rests = np.any(binary_opening(~moves, np.ones((max(round(settings.moment / step), 1), 1), bool)), axis=1)
    sign = np.where(moves, np.sign(speed), 0.0)
    turns = np.concatenate([[False], (sign[1:] != sign[:-1]).any(axis=1)])
    near = np.asarray(binary_dilation(turns, iterations=max(round(settings.moment / step), 1)))
    return np.interp(segment.times, trajectory.times, np.where(near, 1.0, rests)) > 0.0


def _is_tap(high: np.ndarray, peak: int, step: float, usual: float, settings: Settings) -> bool:
    """Whether most of what an event adds to the usual readings comes within `Settings.moment`, in a broad band.

    A band's width is one over the sum of squares of its power's shares, times the spacing of frequencies.
    """
    around = max(round(2.0 * settings.moment / step), 8)
    cut = high[max(peak - around, 0) : peak + around]
    steps = max(round(settings.moment / step), 1)
    total = np.concatenate([[0.0], np.cumsum(cut**2 - usual**2)])
    if len(total) <= steps or np.max(total[steps:] - total[:-steps]) < settings.nearly_all * total[-1]:
        return False
    power = np.abs(np.fft.rfft(cut)) ** 2
    width = np.sum(power) ** 2 / np.sum(power**2) / (len(cut) * step)
    return bool(width * settings.moment > 2.0)
