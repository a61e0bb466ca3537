"""The noise that no model can remove: the sensor's own, and what the encoders' errors make of a prediction.

Neither depends on what the fit left over nor on its model, so what a model lacks cannot pass for noise, and two models of a
recording are compared with the same. The sensor's noise is read off the readings above the band of the motion; where they were
filtered before they were recorded it is what does not repeat where the motion does (``repeats``), else that of a robot at rest
(``parked``), else the data sheet's, else not known. Encoder errors are simulated: the smoothed motion once more with fresh
encoder noise, and what channel-weighted least squares predicts for both, of rigid bodies with what every drive has. A model that
rings with encoder errors has its own, where those are larger: they are in its prediction however right it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.fft import dct
from scipy.interpolate import CubicSpline
from scipy.signal import detrend
from scipy.signal.windows import tukey

from bayesid.errors import InputError
from bayesid.estimators.weights import learn_weights
from bayesid.regression.encoder_noise import errors_of
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.readings import rests, stated_noise
from bayesid.regression.segment import Segment
from bayesid.signals.repeats import RATE, find_repeats
from bayesid.signals.white_noise import low_passed, steady_noise

#: Where a floor comes from, for reports.
READINGS, REPEATS, AT_REST, DATA_SHEET, RESIDUALS = "readings", "repeats", "parked", "data sheet", "residuals"
#: Samples that encoder errors are simulated on, in so many pieces, and how often.
_SIMULATED_SAMPLES, _PIECES, _DRAWS = 4000, 4, 3
_BINS = 24
#: The effects of the model that noise is measured with.
_DRIVES = ("viscous_friction", "coulomb_friction", "torque_offset")
_USUAL = {"wrench": (), "torque": _DRIVES, "both": _DRIVES}
#: A rest shorter than this shows no noise below the band [s].
_SHORTEST_REST = 1.0
#: Noise is needed up to here at least [Hz]: `bayesid.validation.flexible.BAND`.
_LOWEST_TOP = 10.0
#: Squares that noise is measured from by repeats, at least: a standard deviation to 6 %.
_SQUARES = 120
#: Share of repeats at both ends that a taper takes, and of their power that is left for the sensor beside the encoders.
_TAPERED, _LEAST = 0.2, 0.05


@dataclass(frozen=True)
class NoiseFloor:
    """Noise that is left to a perfect model, in the cosine transform of samples."""

    #: Standard deviation of one sample's noise (c,) [unit of the channel]. Of noise that is not white: of white noise with as
    #: much power below 10 Hz, for filtered readings hold next to none at some frequencies, where no model need hold none.
    sensor: np.ndarray
    encoder: np.ndarray  # power that encoder errors add to a coefficient, by frequency from zero to ``top`` (bins, c)
    source: str  # ``readings``, ``repeats``, ``parked`` or ``data sheet``
    top: float  # highest frequency [Hz]; above, it is as there

    @property
    def power(self) -> np.ndarray:
        """Power of both, by frequency (bins, c)."""
        return self.sensor**2 + self.encoder

    def below(self, band: float, step: float) -> np.ndarray:
        """Variance of this noise in rows ``step`` [s] apart below a frequency [Hz] (c,); rows have the energy of one sample."""
        share = min(2.0 * step * band, 1.0)
        return share * self._at(np.linspace(0.0, share * 0.5 / step, 20 * _BINS)).mean(axis=0)

    def _at(self, frequency: np.ndarray) -> np.ndarray:
        """Power at frequencies (k,) [Hz] (k, c)."""
        return self.power[np.minimum((frequency / self.top * _BINS).astype(int), _BINS - 1)]

    def ratio(self, residuals: Sequence[np.ndarray], step: float, band: float) -> np.ndarray:
        """Root mean square below a frequency [Hz] of residuals of even samples (k, c) in units of this noise (c,)."""
        energy, count = np.zeros(len(self.sensor)), 0
        for rows in residuals:
            z = np.asarray(dct(rows, axis=0, norm="ortho"))
            frequency = np.arange(len(z)) / len(z) * 0.5 / step
            z = z[: max(int(min(2.0 * step * band, 1.0) * len(z)), 1)]
            energy += np.sum(z**2 / self._at(frequency[: len(z)]), axis=0)
            count += len(z)
        return np.sqrt(energy / max(count, 1))


def noise_floor(problem: Problem, channel: str | None = None) -> NoiseFloor | None:
    """The floor of an experiment's moving readings, the same for all models of them; None where nothing tells it.

    ``channel`` is that of other readings than were fitted: ``wrench`` or ``torque``.
    """
    given, problem = problem, _with_usual_model(problem, channel or problem.channel)
    if channel and problem.channel != channel:  # these readings are of no use
        return None
    moving = [s for segments in problem.segments.values() for s in segments if not s.poses]
    samples = [s.measured(0, len(s.times)) for s in moving if len(s.times) >= 32]
    if not samples:
        return None
    top = max(_LOWEST_TOP, 0.5 / problem.row_model.step)
    sensor, source, encoder = steady_noise(samples), READINGS, _encoder_power(problem, moving, top)
    own_model = given.channel == problem.channel
    if own_model and any(e.settling > 0.0 or e.amplifies_encoder_errors for e in given.row_model.effects):
        own = [s for segments in given.segments.values() for s in segments if not s.poses]
        encoder = np.maximum(encoder, _encoder_power(given, own, top))
    if low_passed(samples):
        sources = {
            REPEATS: partial(_by_repeats, problem, moving, encoder, top), AT_REST: partial(_at_rest, problem),
            DATA_SHEET: partial(stated_noise, problem.experiment, problem.channel),
        }  # fmt: skip
        known = next(((name, found) for name, measured in sources.items() if (found := measured()) is not None), None)
        if known is None:
            return None
        source, sensor = known[0], np.maximum(sensor, known[1])
    # Noise-free simulations: a floor of exactly zero would divide by it.
    sensor = np.maximum(sensor, 1e-9 * max(float(np.max([np.abs(y).max() for y in samples])), 1e-300))
    return NoiseFloor(sensor, encoder, source, top)


def pose_floor(problem: Problem, poses: Sequence[Segment], solution: np.ndarray) -> NoiseFloor | None:
    """The floor of readings at rest, the data sheet's and what encoder errors make of a prediction; None where none is stated.

    Averaged one by one, they do not show their noise themselves.
    """
    sensor = stated_noise(problem.experiment, problem.channel)
    if sensor is None:
        return None
    given = problem.experiment
    stated = replace(problem.smoother, resolution=given.position_resolution or 0.0, stated=given.position_std or 0.0)
    law, _ = errors_of(replace(problem.row_model, filters=None), poses, stated)
    drawn = law.misread(_DRAWS, solution) if stated.resolution or stated.stated else []
    encoder = np.mean([np.concatenate(errors) ** 2 for errors in drawn], axis=(0, 1)) if drawn else np.zeros(len(sensor))
    return NoiseFloor(sensor, np.tile(encoder, (_BINS, 1)), DATA_SHEET, _LOWEST_TOP)


def _with_usual_model(problem: Problem, channel: str) -> Problem:
    """Readings with the model that noise is measured with; of a recording that is read in chunks, of its excerpt.

    The problem itself where it is so, or where such a model cannot be made.
    """
    usual, model = _USUAL[channel], problem.row_model
    own = {e.name for e in model.effects} - {"sensor_offset"}
    stored = any(m.stored for m in problem.experiment.motions)
    given = model.filters is not None or problem.smoother.reason == "as given"
    same = channel == problem.channel
    if same and own == set(usual) and model.point is None and not given and not stored:
        return problem
    motions = tuple(replace(m, stored=None) for m in problem.experiment.motions)
    fitted = [m.name for m in motions if m.name in problem.fitted and same] or None
    static = "motion" if problem.subtracts else "joint"
    options = FitOptions(channel, motions=fitted, effects=usual, static=static)
    try:
        return prepare(replace(problem.experiment, motions=motions), options)
    except InputError:  # a joint without torques, a motion that is too short for it
        return problem


def _counts(problem: Problem) -> np.ndarray:
    """One count of each encoder (n,) [rad or m], as stated, or as random as one is."""
    stated = problem.experiment.position_resolution
    random = np.sqrt(12.0) * np.nan_to_num(np.asarray(problem.smoother.position_std, float))
    return np.full(problem.experiment.robot.n, stated) if stated else np.broadcast_to(random, problem.experiment.robot.n)


def _by_repeats(problem: Problem, moving: Sequence[Segment], encoder: np.ndarray, top: float) -> np.ndarray | None:
    """Noise below 10 Hz by what readings do not repeat where the motion does (c,); None without repeats.

    With e = reading - prediction, ``e(t + P) - e(t)`` has twice the noise's power: what the model lacks follows the motion and
    cancels. Encoder errors hardly repeat, so their share comes off.
    """
    row_model = replace(problem.row_model, filters=None)
    margin, solution = row_model.margin, learn_weights(problem.regression).solution
    used = [s for s in moving if np.ptp(s.inner(margin)) >= 2]
    spans = [s.times[slice(*s.inner(margin))] for s in used]
    grids = [np.arange(t[0], t[-1], 1.0 / RATE) for t in spans]
    courses = [(t, row_model.smoothed(s, t).positions) for s, t in zip(used, grids, strict=True) if len(t) > 1]
    if len(courses) < len(used):
        return None
    left: dict[int, CubicSpline] = {}

    def residual(k: int) -> CubicSpline:
        if k not in left:
            a, b = used[k].inner(margin)
            left[k] = CubicSpline(spans[k], used[k].measured(a, b) - row_model.predicted(used[k], a, b, solution))
        return left[k]

    power, count = np.zeros(encoder.shape[1]), 0
    for r in find_repeats(courses, _counts(problem)):
        times = spans[r.first][(spans[r.first] >= r.start) & (spans[r.first] <= r.end)]
        times = times[(times + r.lag >= spans[r.second][0]) & (times + r.lag <= spans[r.second][-1])]
        weight = tukey(len(times), _TAPERED)[:, None]
        difference = detrend(residual(r.second)(times + r.lag) - residual(r.first)(times), axis=0) * weight / np.sqrt(2.0)
        z = np.asarray(dct(difference, axis=0, norm="ortho")) / np.sqrt(np.mean(weight**2))
        step = (times[-1] - times[0]) / (len(times) - 1)
        below = np.arange(len(z)) / len(z) * 0.5 / step < _LOWEST_TOP
        power, count = power + np.sum(z[below] ** 2, axis=0), count + np.count_nonzero(below)
    if count < _SQUARES:
        return None
    mean = power / count
    return np.sqrt(np.maximum(mean - encoder[: int(_BINS * _LOWEST_TOP / top)].mean(axis=0), _LEAST * mean))


def _encoder_power(problem: Problem, moving: Sequence[Segment], top: float) -> np.ndarray:
    """What encoder errors add to rows, whose coefficients are those of samples, by frequency up to a highest [Hz] (bins, c)."""
    row_model = replace(problem.row_model, filters=None)
    power, count = np.zeros((_BINS, len(row_model.channels))), np.zeros(_BINS)
    pieces = []
    for s in sorted(moving, key=lambda s: -len(s.times))[:_PIECES]:
        length = min(len(s.times), _SIMULATED_SAMPLES // _PIECES)
        first = (len(s.times) - length) // 2
        pieces.append(s.part(first, first + length))
    pieces = [p for p in pieces if np.ptp(p.inner(row_model.margin)) >= 2]
    if not pieces:
        return power
    law, _ = errors_of(row_model, pieces, problem.smoother)
    if not law.present():
        return power
    for errors in law.misread(_DRAWS, learn_weights(problem.regression).solution):
        for error in errors:
            z = np.asarray(dct(error, axis=0, norm="ortho"))
            at = (np.arange(len(z)) / len(z) * 0.5 / row_model.step / top * _BINS).astype(int)
            inside = at < _BINS  # a model that rings has rows at a higher rate
            np.add.at(power, at[inside], z[inside] ** 2)
            np.add.at(count, at[inside], 1.0)
    return power / np.maximum(count, 1.0)[:, None]


def _at_rest(problem: Problem) -> np.ndarray | None:
    """Noise of the readings while the robot stands still, as the experiment says or as the encoders do (c,)."""
    motions, parts = {m.name: m for m in problem.experiment.motions}, []
    for name, segments in problem.segments.items():
        for s in segments:
            if s.poses:
                continue
            for start, end in rests(motions[name], s.times, s.positions, _counts(problem)):
                inside = (s.times >= start) & (s.times <= end)
                if inside.sum() > 16 and np.ptp(s.times[inside]) >= _SHORTEST_REST:
                    parts.append(detrend(s.readings[inside], axis=0))
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)) if parts else None
