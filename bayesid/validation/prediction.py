"""Held-out validation: what the estimate predicts, what was measured, how far apart they are, and what that means.

Two numbers of a held-out motion say together how good a model is: the relative error, and the residual over the sensor's own
noise. Neither says enough alone. A residual at the noise is perfect only where the readings hold more than noise; a relative
error of one per cent may be a model that lacks something, seen by a quiet sensor, and still serve.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import butter, correlate, sosfiltfilt, welch
from scipy.stats import chi2

from bayesid.arguments import call
from bayesid.estimators import Estimate
from bayesid.estimators.factor import whitened
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.regression.blocks import Block
from bayesid.regression.parallel import both, in_order
from bayesid.regression.problem import Problem, elsewhere
from bayesid.regression.row_cache import few_of, row_count
from bayesid.regression.segment import Segment
from bayesid.rounding import LEVEL, number
from bayesid.signals.noise import NoiseModel, noise_of_group
from bayesid.validation.flexible import BAND, FlexibleGap
from bayesid.validation.noise_floor import RESIDUALS, NoiseFloor, noise_floor, pose_floor

if TYPE_CHECKING:
    from xarray import Dataset

#: Whitened residuals on a motion that was not fitted above this say that something is missing in the model.
TOLERATED = 1.15
_CHUNK = 8192
#: Two motions whose joint paths agree to this correlation at some shift count as the same motion.
REPEATED = 0.98
_PLOTTED = 4000


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Residual of a motion by frequency beside the noise that the intervals are built on."""

    frequencies: np.ndarray  # (f,) [Hz], above zero, up to half the row rate
    #: One-sided amplitude spectral density of what was measured less what was predicted, and of the noise model (f, c) [unit of
    #: the channel / sqrt(Hz)].
    residual: np.ndarray
    noise: np.ndarray
    filtered: bool = False  # whether both are those of rows behind the paper's low-passes, and so smaller than the sensor's


@dataclass(frozen=True, eq=False)
class Prediction:
    """Measured and predicted readings of one motion."""

    #: Which recording.
    motion: str
    role: str
    #: What is measured (c,).
    channel_names: tuple[str, ...]
    channel_units: tuple[str, ...]
    #: In the band, at most 4000 evenly picked samples (k,), (k, c), (k, c).
    times: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    #: Root mean square error in the band and on raw samples (c,) [unit of the channel].
    rmse: np.ndarray
    rmse_raw: np.ndarray
    #: The same over the root mean square of what was measured (c,).
    nrmse: np.ndarray
    nrmse_raw: np.ndarray
    #: Of the residual below 10 Hz in units of the noise floor, the measurement noise and what encoder errors make of a
    #: prediction; 1 is perfect.
    whitened_rms: float
    whitened_rms_by_channel: np.ndarray  # (c,)
    coverage: float  # share of whitened residuals inside their central 95 % prediction interval
    #: What ``whitened_rms`` is on average of a complete model: noise, and the uncertainty of the parameters (the mean of some
    #: rows, where there are many).
    expected_rms: float = 1.0
    #: Where the floor comes from: ``readings``, ``parked`` or ``data sheet``; ``residuals`` where none of these tells it, and
    #: the noise that the fit itself left stands in for it: model error counts as noise then.
    noise_source: str = RESIDUALS
    repeats: str | None = None  # name of a fitted motion that this motion repeats, or None
    poses: bool = False  # whether the samples are poses at rest, one by one, rather than a motion
    #: Residual and noise by frequency; None for poses and segments too short to tell frequencies apart.
    spectrum: ResidualSpectrum | None = None
    #: What a flexible model would take from the error of a motion that was not fitted; None where nothing tells.
    flexible: FlexibleGap | None = None
    fitted: bool = False  # whether the estimate was fitted to this motion
    biased: bool = False  # whether the estimate has no covariance, as it is biased by nobody knows how much
    beyond: bool = False  # whether it moves, and the fitted poses at rest show gravity alone
    #: What ``whitened_rms`` of a complete model stays below with probability 95 %, as far as its parameters go: a few uncertain
    #: ones err together, far more or less than they do on average. None where that is not known: then ``expected_rms`` counts.
    largest_rms: float | None = None

    @property
    def noise_known(self) -> bool:
        """Whether anything but the fit's own residual tells the noise."""
        return self.noise_source != RESIDUALS

    @property
    def times_noise(self) -> float:
        """``whitened_rms``; nan where the noise is not known: what the fit itself leaves is no measure of the model."""
        return self.whitened_rms if self.noise_known else float("nan")

    @property
    def signal(self) -> np.ndarray:
        """Root mean square of what was measured, in the band (c,) [unit of the channel]; zero where nothing was."""
        return _signal(self.rmse, self.nrmse)

    @property
    def relative_error(self) -> float:
        """The headline: error norm over signal norm of all channels together, in the zero-phase band of 10 Hz."""
        return _together(self.rmse, self.nrmse)

    @property
    def relative_error_raw(self) -> float:
        """Error norm over signal norm of all channels together, on raw samples."""
        return _together(self.rmse_raw, self.nrmse_raw)

    @property
    def residuals(self) -> np.ndarray:
        """What was measured less what was predicted, in the band (k, c) [unit of the channel]."""
        return self.measured - self.predicted

    def __repr__(self) -> str:
        return f"<Prediction of {self.motion}: {len(self.channel_names)} channels, error {100 * self.relative_error:.3g} %>"

    def to_xarray(self) -> Dataset:
        """``measured``, ``predicted`` and ``residual`` (time, channel) with their units, as an xarray Dataset."""
        from xarray import Dataset

        dimensions = ("pose" if self.poses else "time", "channel")
        arrays = {"measured": self.measured, "predicted": self.predicted, "residual": self.residuals}
        return Dataset(
            {name: (dimensions, values) for name, values in arrays.items()},
            {dimensions[0]: self.times, "channel": list(self.channel_names), "unit": ("channel", list(self.channel_units))},
            {"motion": self.motion, "role": self.role},
        )

    def to_dict(self) -> dict:
        """An entry of ``validation`` in ``estimate.json``."""

        def by_channel(values):
            return {n: float(v) for n, v in zip(self.channel_names, values, strict=True)}

        return {
            "motion": self.motion,
            "role": self.role,
            **{name: by_channel(getattr(self, name)) for name in ("rmse", "nrmse", "rmse_raw", "nrmse_raw")},
            "band_hz": BAND,
            "relative_error": self.relative_error,
            "relative_error_raw": self.relative_error_raw,
            "whitened_rms": float(self.whitened_rms),
            "whitened_rms_by_channel": by_channel(self.whitened_rms_by_channel),
            "expected_rms": float(self.expected_rms),
            "largest_rms": float(self.largest_rms or self.expected_rms),
            "noise_source": self.noise_source,
            "interval_coverage": float(self.coverage),
            "flexible_model": None if self.flexible is None else self.flexible.to_dict(),
            "repeats": self.repeats,
        }


def _together(rmse: np.ndarray, nrmse: np.ndarray) -> float:
    """Error norm over signal norm of all channels together, from those of each channel (c,)."""
    return float(np.linalg.norm(rmse) / max(np.linalg.norm(_signal(rmse, nrmse)), 1e-300))


def _signal(rmse: np.ndarray, nrmse: np.ndarray) -> np.ndarray:
    """Root mean squares (c,) that errors are the shares of."""
    known = nrmse > 0
    return np.where(known, rmse / np.where(known, nrmse, 1), 0)


def predict(problem: Problem, estimate: Estimate, motion: Motion, floor: NoiseFloor | None = None) -> Prediction:
    """Predict a motion's readings with an estimate and compare.

    The motion is any of the experiment whose columns allow it; ``floor`` is noise that no model can remove, for which the
    estimate's own stands in where it is not known.
    """
    segments = problem.segments[motion.name]
    margin = problem.row_model.margin
    moving = [r for r in segments if not r.poses and np.ptp(r.inner(margin)) >= 2] or [r for r in segments if r.poses]
    error, raw, times, measured, residuals = [], [], [], [], []
    for segment in moving:
        a, b = segment.inner(0.0 if segment.poses else margin)  # where the smoothed trajectory is sound
        t, y = segment.times[a:b], segment.measured(a, b)
        slow = partial(in_band, t, poses=segment.poses)
        prediction, smooth_y = both(partial(_predicted, problem, estimate, segment, a, b), partial(slow, y))
        prediction -= y
        raw.append([_squares(prediction), _squares(y)])
        residuals.append(prediction)
        error.append(slow(prediction))
        times.append(t)
        measured.append(smooth_y)
    all_error, y = np.concatenate(error), np.concatenate(measured)
    rmse_raw, scale_raw = np.sqrt(np.sum(raw, axis=0) / len(y))
    pick = slice(None, None, max(-(-len(y) // _PLOTTED), 1))
    if all(r.poses for r in moving):
        floor = pose_floor(problem, moving, estimate.solution)
    by_channel, expected, largest, coverage, spectrum = _whitened(problem, estimate, motion.name, moving)
    if floor is not None:
        by_channel = floor.ratio(residuals, float(np.median(np.diff(times[0]))), BAND)
    scale, rmse = (np.sqrt(_squares(values) / len(values)) for values in (y, all_error))
    return Prediction(
        motion=motion.name,
        role=motion.role,
        channel_names=problem.row_model.channels.names,
        channel_units=problem.row_model.channels.units,
        times=np.concatenate(times)[pick],
        measured=y[pick],
        predicted=y[pick] + all_error[pick],
        rmse=rmse,
        rmse_raw=rmse_raw,
        nrmse=rmse / np.where(scale > 0, scale, np.inf),
        nrmse_raw=rmse_raw / np.where(scale_raw > 0, scale_raw, np.inf),
        whitened_rms=float(np.sqrt(np.mean(by_channel**2))),
        whitened_rms_by_channel=by_channel,
        coverage=coverage,
        expected_rms=expected,
        largest_rms=largest,
        noise_source=RESIDUALS if floor is None else floor.source,
        repeats=repeated(problem.experiment, motion, problem.fitted),
        poses=all(r.poses for r in moving),
        spectrum=spectrum,
        fitted=motion.name in problem.fitted,
        biased=estimate.full_covariance is None,
        beyond=estimate.noise.keys() == {"poses"} and not all(r.poses for r in moving),
    )


def predict_elsewhere(problem: Problem, estimate: Estimate, other: Experiment) -> tuple[Prediction, ...]:
    """Predict every motion of another experiment of the same joints; nothing is fitted, so all count as validation."""
    there = elsewhere(problem, other)
    floor = noise_floor(there)
    motions = [m for m in other.motions if m.name in there.segments]

    def one(motion: Motion) -> Prediction:
        repeats = repeated(problem.experiment, motion, problem.fitted)
        return replace(predict(there, estimate, motion, floor), role="validation", repeats=repeats, fitted=False)

    return tuple(in_order(one, motions))


def _predicted(problem: Problem, estimate: Estimate, segment: Segment, a: int, b: int) -> np.ndarray:
    """Predicted raw samples a ... b - 1 (b - a, c)."""

    def predicted(first: int) -> np.ndarray:
        return problem.row_model.predicted(segment, first, min(first + _CHUNK, b), estimate.solution)

    return np.concatenate(list(in_order(predicted, range(a, b, _CHUNK))))


def in_band(times: np.ndarray, values: np.ndarray, poses: bool) -> np.ndarray:
    """Zero-phase low-pass to the common band; poses and slow recordings are left as they are."""
    if poses or len(times) < 60:
        return values
    rate = 1.0 / np.median(np.diff(times))
    if rate <= 2.5 * BAND:
        return values
    filters, out = butter(4, BAND, fs=rate, output="sos"), np.empty_like(values)
    for c, series in enumerate(values.T):  # one after the other: a channel of a long recording stays in the processor's cache
        out[:, c] = sosfiltfilt(filters, series)
    return out


def _squares(values: np.ndarray) -> np.ndarray:
    """Sum of squares of each channel (c,)."""
    return np.einsum("kc,kc->c", values, values)


def _whitened(
    problem: Problem, estimate: Estimate, motion: str, segments: list[Segment]
) -> tuple[np.ndarray, float, float, float, ResidualSpectrum | None]:
    """Root mean square of residual rows over the fit's noise (c,), and what a complete model leaves: on average, and at most.

    Then the share inside 95 % intervals, and the spectrum.
    """
    group = "poses" if all(s.poses for s in segments) else "trajectory"
    noise = {group: noise_of_group(estimate.noise, group)}
    blocks = (block for block in problem.rows.blocks([motion]) if block.group == group)
    # Zero for the target: whole rows need no copy.
    covariance = None if estimate.full_covariance is None else np.pad(estimate.full_covariance, (0, 1))
    left: list[Block] = []

    def noted() -> Iterator[Block]:
        for block in blocks:
            left.append(replace(block, rows=block.residual(estimate.solution)))
            yield block

    # How sure the prediction of a row is changes little along a motion: evenly spread rows of a long one tell it. All are read.
    parts, gram = [], np.zeros(())
    for block, white in whitened(few_of(noted(), row_count(problem.row_model, segments)), noise):
        for panel in replace(block, rows=white).panels():
            x = panel.rows.reshape(-1, white.shape[2])
            share = np.zeros(len(x)) if covariance is None else np.maximum(np.sum(x @ covariance * x, axis=1), 0.0)
            parts.append(share.reshape(panel.rows.shape[:2]))
            gram = gram + x.T @ x
    variance, residual = np.concatenate(parts), np.concatenate([white for _, white in whitened(left, noise)])
    mean = float(variance.mean())
    expected, largest = (float(np.sqrt(1.0 + share)) for share in (mean, mean * _largest_over_mean(covariance, gram)))
    if len(variance) < len(residual):
        variance = variance.mean(axis=0)
    inside = float(np.mean(np.abs(residual) <= 1.959964 * np.sqrt(1.0 + variance)))
    raw = [block.rows for block in left]
    channels = np.sqrt(np.mean(residual**2, axis=0))
    spectrum = None
    if group == "trajectory":
        rate = 1.0 / float(np.median(np.diff(next(r.times for r in segments if not r.poses))))
        spectrum = _spectrum(raw, noise["trajectory"], problem.row_model.step, rate, problem.row_model.filters is not None)
    return channels, expected, largest, inside, spectrum


def _largest_over_mean(covariance: np.ndarray | None, gram: np.ndarray) -> float:
    """95 % quantile of what errors of parameters (p, p) add to the power of rows, by their Gram matrix (p, p), over its mean.

    A sum of squares of normal numbers, as many and as unequal as the directions that the errors have in the rows: a chi-squared
    law with the same mean and variance [Satterthwaite1946]_.
    """
    share = np.zeros((1, 1)) if covariance is None else covariance @ gram
    square = float(np.sum(share * share.T))
    degrees = float(np.trace(share)) ** 2 / square if square > 0.0 else np.inf
    return float(chi2.ppf(LEVEL, degrees) / degrees) if np.isfinite(degrees) else 1.0


def _spectrum(
    residuals: list[np.ndarray], noise: NoiseModel, step: float, rate: float, filtered: bool
) -> ResidualSpectrum | None:
    """Welch's estimate over all segments of rows (k, c), and the same of the recursion that models the noise.

    A row has the energy of one sample: white noise keeps its standard deviation, though rows are fewer. A
    slow signal is therefore larger in rows by the root of the samples per row, which is divided out here.
    """
    length = int(np.clip(max(map(len, residuals)) // 4, 32, 256))
    long = [r for r in residuals if len(r) >= length]
    if not long:
        return None
    frequencies = np.fft.rfftfreq(length, step)[1:]
    total = sum(len(r) for r in long)
    keep: Any = False  # do not detrend; SciPy's annotation knows names only
    power = sum(len(r) / total * welch(r, 1.0 / step, nperseg=length, detrend=keep, axis=0)[1][1:] for r in long)
    gain = np.abs(np.fft.rfft(noise.coefficients, length, axis=1))[:, 1:].T
    model = 2.0 * step * np.diag(noise.innovation) / gain**2
    samples_per_row = max(rate * step, 1.0)
    return ResidualSpectrum(frequencies, np.sqrt(power / samples_per_row), np.sqrt(model / samples_per_row), filtered)


def repeated(experiment: Experiment, motion: Motion, fitted: tuple[str, ...]) -> str | None:
    """Name of a fitted motion whose joint path this motion follows, at some shift in time, or None.

    A "validation" on the motion that was fitted says little about any other motion: on repeats of its
    training motion a published estimate was off by 2 %, on another motion by 14 %.
    """
    others = [m for m in experiment.motions if m.name in fitted]
    if motion.kind == "poses" or any(m is motion for m in others):
        return None
    return next((m.name for m in others if m.kind != "poses" and _same_path(motion, m)), None)


def _same_path(one: Motion, other: Motion) -> bool:
    """Whether the shorter path is found in the longer one: largest normalised cross-correlation."""
    step = max(max(one.table.duration, other.table.duration) / 4000, 0.02)
    a, b = (_resampled(m, step) for m in (one, other))
    if len(a) > len(b):
        a, b = b, a
    if len(a) < 10:
        return False
    a = a - a.mean(axis=0)
    product = np.sum([correlate(b[:, j], a[:, j], mode="valid") for j in range(a.shape[1])], axis=0)
    # a has no mean, so only the variance of b's window matters.
    sums = np.vstack([np.zeros(b.shape[1]), np.cumsum(b, axis=0)])
    squares = np.vstack([np.zeros(b.shape[1]), np.cumsum(b**2, axis=0)])
    n = len(a)
    variance = np.sum(squares[n:] - squares[:-n] - (sums[n:] - sums[:-n]) ** 2 / n, axis=1)
    norm = np.sqrt(np.maximum(variance, 1e-12) * max(float(np.sum(a**2)), 1e-12))
    return bool(np.max(product / norm) > REPEATED)


def _resampled(motion: Motion, step: float) -> np.ndarray:
    table = motion.table
    grid = np.arange(table.times[0], table.times[-1], step)
    return np.stack([np.interp(grid, table.times, q) for q in table.positions.T], axis=1)


#: Relative errors below which a prediction is close, and above which it predicts little.
CLOSE, POOR = 0.1, 0.3
#: A share of the error that a flexible model removes is worth looking for above this.
WORTH = 0.05
#: A channel that is wrong by more than this share of its signal is named.
_NAMED = 0.5


#: What is said of a motion where poses at rest are all that is fitted.
BEYOND_POSES = "it moves, and poses at rest, which are all that is fitted, show nothing of inertias: an error without any"


@dataclass(frozen=True)
class Judgement:
    """A verdict in words."""

    mood: str  # ``good``, ``fair`` or ``bad``
    text: str  # a clause that goes on after what was predicted


def judged(prediction: Prediction) -> Judgement:
    """The verdict on one motion that was not fitted."""
    error, white = prediction.relative_error, prediction.whitened_rms
    worst = int(np.argmax(prediction.nrmse))
    share = float(prediction.nrmse[worst])
    wrong = f"; {prediction.channel_names[worst]} is wrong by {100 * share:.0f} % of its signal" if share > _NAMED else ""
    largest = _largest(prediction)
    if prediction.beyond and (prediction.noise_source == RESIDUALS or white > largest):
        return Judgement("fair", BEYOND_POSES)
    if prediction.noise_source == RESIDUALS:
        # The only noise at hand is what the fit left over: it cannot tell model error from noise.
        mood = "fair" if error <= CLOSE else "bad"
        return Judgement(
            mood, f"the measurement noise is not known here, so nothing says how much of that is missing in the model{wrong}"
        )
    if white <= largest:
        noise = not left_by_uncertain_parameters(prediction)
        left = "the measurement noise" if noise else "what noise and uncertain parameters leave"
        if worse_than_nothing(error):
            size = "measurement noise and what encoders' errors make of it" if noise else "errors that uncertain parameters make"
            return Judgement("fair", f"no prediction at all would be closer, though {size} are as large")
        if error > _NAMED and noise:
            return Judgement(
                "fair", "that is the measurement noise: the readings of this motion hold little else, and prove little"
            )
        if error > _NAMED:
            text = f"that is {left}, {white:.3g} times the noise: the fitted motions say little of what this one needs"
            return Judgement("fair", text)
        if worse_than_nothing(share):
            name = prediction.channel_names[worst]
            text = (
                f"what is left is {left} ({white:.3g} times the noise) in all channels together, but {name} is predicted "
                f"worse than by nothing at all: the error is {100 * share:.0f} % of its signal"
            )
            return Judgement("fair", text)
        if not noise:
            text = f"what is left, {white:.3g} times the measurement noise, is {left}"
            return Judgement("good" if not wrong else "fair", f"{text}{wrong}")
        where = f", though {prediction.channel_names[worst]} holds little but noise" if share > _NAMED else ""
        return Judgement("good", f"what is left is {left} ({white:.3g} times){where}")
    times, missing = f"{white:.3g} times the measurement noise", "something is missing in the model"
    if prediction.biased:
        missing = f"the estimator is biased, or {missing}"
    if error <= CLOSE:
        small = "" if wrong else ", small beside the readings"
        return Judgement("fair", f"what is left is {times}: {missing}{small}{wrong}")
    if error <= POOR:
        return Judgement("fair" if not wrong else "bad", f"what is left is {times}: {missing}{wrong}")
    return Judgement("bad", f"what is left is {times}: the model predicts this motion poorly{wrong}")


def _largest(prediction: Prediction) -> float:
    """Residual in units of the noise up to which a complete model may leave it."""
    return TOLERATED * (prediction.largest_rms or prediction.expected_rms)


def leaves_more(prediction: Prediction) -> bool:
    """Whether more is left than noise and uncertain parameters make, as far as the noise is known."""
    return prediction.noise_source != RESIDUALS and prediction.whitened_rms > _largest(prediction)


def left_by_uncertain_parameters(prediction: Prediction) -> bool:
    """Whether more is left than noise, and no more than parameters that the fitted motions leave uncertain may make."""
    return prediction.noise_source != RESIDUALS and TOLERATED < prediction.whitened_rms <= _largest(prediction)


def worse_than_nothing(share: float) -> bool:
    """Whether a prediction adds error to a channel, so that zero would be a better one, to the digits that are printed.

    No noise excuses that: what is in the readings as noise is in their size, too.
    """
    return round(100 * share) > 100


def useless(predictions: Sequence[Prediction]) -> bool:
    """Whether no motion is predicted so well that a model is of use."""
    return bool(predictions) and all(p.relative_error > POOR and judged(p).mood == "bad" for p in predictions)


def still_predictable(prediction: Prediction) -> str:
    """What a flexible model of the joints' motion would still remove of the error, a sentence; empty where nothing tells."""
    gap = prediction.flexible
    if gap is None or prediction.beyond:
        return ""
    if not gap.certain and gap.removed > WORTH:
        share = f"{number(100 * gap.removed, 2)} +- {number(100 * gap.std, 1)} % of this error"
        return f"A flexible model of position, speed and acceleration would remove {share}, which is within chance."
    if not gap.certain:
        return "A flexible model of position, speed and acceleration finds nothing more that depends smoothly on them."
    missing = f"something predictable is missing (see `{call('diagnose')}`)"
    lack = missing if gap.removed > WORTH else "little predictable is missing"
    share = f"{number(100 * gap.removed, 2)} % of this error"
    return f"A flexible model of position, speed and acceleration would still remove {share}: {lack}."


def of_signal(prediction: Prediction) -> str:
    """What an error is a share of; poses one by one have no frequencies."""
    return "the signal" if prediction.poses else f"the signal below {BAND:.2g} Hz"


def over_noise(prediction: Prediction) -> str:
    """The residual over the noise, and which noise that is."""
    if prediction.noise_source == RESIDUALS:
        return "not compared with the measurement noise, which is not known"
    return f"{prediction.whitened_rms:.3g} times the measurement noise"
