"""Sweeps: how errors of base parameters and predictions depend on one factor at a time.

Where the estimator is linear in the readings, the errors of its parameters are, to first order in the noise,

    e = A^-1 X'W n + e_q,     cov e = k^2 V_s + V_e,

n the sensor's noise, k its factor and e_q what encoder errors make of the fit. V_s is the sandwich covariance of the fit to a
twin with perfect encoders, V_e and the bias come from twins with a perfect sensor. A motion that is repeated m times, with fresh
noise, leaves ``cov e / m`` and the same bias. All else is simulated: twins with fresh noise are made, fitted as the user's own
data are, and compared with the truth. All settings use the same seeds, so that differences between them are less uncertain than
either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bayesid.design.accuracy.bench import OFFSETS, Bench, Setting, own_setting, twin
from bayesid.design.accuracy.fits import Errors, Learned, errors_of, fit_twin, learn, prediction_error, run_twin
from bayesid.errors import BayesidError
from bayesid.estimators.least_squares import LeastSquares
from bayesid.recordings.table import usual_step
from bayesid.regression.parallel import in_order
from bayesid.signals.filters import LowPass
from bayesid.tasks import map_tasks

#: Filters that are tried; the first is the paper's.
FILTERS = (LowPass(1.0, 50.0), LowPass(10.0, 50.0), LowPass(31.0, 63.0))
#: Slower than this, a motion is not sampled [Hz], and than so many times its bandwidth.
_SLOWEST_RATE, _RATE_PER_BANDWIDTH = 10.0, 5.0
_VELOCITIES = {"central": "central differences of the positions", "forward": "forward differences of the positions"}
#: Resamples of the runs that intervals of ratios are taken from.
_RESAMPLES = 300
#: Seeds of runs lie this far from those that other parts of the package draw.
_SEEDS = 1_000_003


@dataclass(frozen=True)
class Trial:
    """One level of a factor."""

    label: str  # what it is, a few words
    value: float | None  # the level as a multiple of the user's own; None where it is no number
    setting: Setting | None  # the whole setting; None where a formula says what it does
    #: Of a formula: the factor of the sensor noise's standard deviation, and that of all standard deviations.
    scale: tuple[float, float] = (1.0, 1.0)
    improvement: str = ""  # what it would be called as an advice; empty where nobody would give it


@dataclass(frozen=True)
class SweptFactor:
    """A property of the experiment or of its evaluation, with the levels that it is tried at."""

    #: Key, and words.
    name: str
    title: str
    own: str  # the user's own level, in words
    trials: tuple[Trial, ...]  # the others


def _if_complete(bench: Bench, advice: str) -> str:
    """An advice that helps against noise, not against model error: empty where the model is incomplete."""
    return "" if bench.estimate.details.model_complete is False else advice


def _has_formula(bench: Bench) -> bool:
    """Whether the fit is linear in the readings, so that covariances scale with noise and length, and has a covariance."""
    return isinstance(bench.method, LeastSquares) and bench.estimate.full_covariance is not None


def _noise(bench: Bench, own: Setting) -> SweptFactor:
    formula = _has_formula(bench)
    half = _if_complete(bench, "half the sensor noise")
    trials = tuple(
        Trial(f"× {k:g}", k, None if formula else replace(own, noise=k), (k, 1.0), half if k == 0.5 else "")
        for k in (0.25, 0.5, 2.0, 4.0)
    )
    by_unit: dict[str, list[float]] = {}  # standard deviations of one reading
    for unit, std in zip(bench.problem.row_model.channels.units, bench.noise.std.tolist(), strict=True):
        by_unit.setdefault(unit, []).append(std)
    sizes = ", ".join(f"{sum(values) / len(values):.2g} {unit}" for unit, values in by_unit.items())
    return SweptFactor("sensor_noise", "Noise of the readings", sizes, trials)


def _resolution(_: Bench, own: Setting) -> SweptFactor:
    trials = tuple(Trial(f"{k:g} noise std", k, replace(own, step=k)) for k in (1.0, 3.0, 10.0))
    return SweptFactor("sensor_resolution", "Resolution of the readings", "as fine as the noise, or finer", trials)


def _encoder(bench: Bench, own: Setting) -> SweptFactor:
    if not bench.resolution and not bench.position_std.any():
        return SweptFactor("encoder", "Encoder errors", "none", ())
    count, trials = bench.resolution, []
    for k in (0.0, 0.25, 4.0, 16.0):
        label = f"× {k:g}" + (f" ({count * k:.2g})" if count and k else "")
        advice = "encoders four times as fine" if k == 0.25 else ""
        trials.append(Trial(label, k, replace(own, encoder=k), improvement=advice))
    what = f"counts of {count:.2g}" if count else f"random errors of {max(bench.position_std):.2g}"
    slides = bench.experiment.robot.prismatic
    unit = "m" if slides.all() else "rad or m" if slides.any() else "rad"
    return SweptFactor("encoder", "Encoder errors", f"{what} {unit}", tuple(trials))


def _rate(bench: Bench, own: Setting) -> SweptFactor:
    rate = min(1.0 / usual_step(m.motion.table.times) for m in bench.motions if m.pieces)
    slowest = max(_SLOWEST_RATE, _RATE_PER_BANDWIDTH * bench.problem.smoother.bandwidth)
    # Of coloured noise nobody knows what it is between the samples.
    levels = (0.125, 0.25, 0.5, 2.0, 4.0) if bench.noise.order == 0 else (0.125, 0.25, 0.5)
    twice = _if_complete(bench, "twice the sampling rate")
    trials = tuple(
        Trial(f"{rate * k:.3g} Hz", k, replace(own, rate=k), improvement=twice if k == 2.0 else "")
        for k in levels
        if rate * k >= slowest
    )
    return SweptFactor("sampling_rate", "Sampling rate", f"{rate:.3g} Hz", trials)


def _length(bench: Bench, own: Setting) -> SweptFactor:
    whole, twice = sum(m.motion.table.duration for m in bench.motions), _if_complete(bench, "the motion twice")
    trials = [Trial(f"first {whole * k:.3g} s", k, replace(own, length=k)) for k in (0.25, 0.5)]
    for k, advice in ((2.0, twice), (4.0, "")):
        trials.append(Trial(f"repeated {k:g} times", k, None, (1.0, k**-0.5), advice))
    return SweptFactor("record_length", "Record length", f"{whole:.3g} s", tuple(trials))


def _filter_text(low_pass: LowPass | None) -> str:
    return "no filter" if low_pass is None else f"l = {low_pass.l:g}, d = {low_pass.d:g} rad/s"


def _filter(bench: Bench, own: Setting) -> SweptFactor:
    used, trials = bench.options.low_pass, []
    for tried in (None, *FILTERS):
        text, setting = _filter_text(tried), replace(own, options=replace(own.options, low_pass=tried))
        trials += [Trial(text, None, setting, improvement=f"filter: {text}")] if tried != used else []
    return SweptFactor("filter", "Low-pass filters", _filter_text(used), tuple(trials))


def _bandwidth(bench: Bench, own: Setting) -> SweptFactor:
    found, trials = bench.problem.smoother.bandwidth, []
    for k in (0.5, 0.71, 1.4, 2.0):
        text, setting = f"{found * k:.3g} Hz", replace(own, options=replace(own.options, bandwidth=found * k))
        trials.append(Trial(text, k, setting, improvement=f"bandwidth {text}"))
    how = "" if bench.options.bandwidth is not None else " (automatic)"
    return SweptFactor("bandwidth", "Bandwidth of the smoothed motion", f"{found:.3g} Hz{how}", tuple(trials))


def _velocity(bench: Bench, own: Setting) -> SweptFactor:
    used = bench.options.low_pass or FILTERS[0]
    filtered = replace(own, options=replace(own.options, low_pass=used))
    text = _filter_text(used)
    trials = [] if bench.options.low_pass else [Trial(f"smoothed positions, {text}", None, filtered)]
    trials += [Trial(f"{words}, {text}", None, replace(filtered, velocity=kind)) for kind, words in _VELOCITIES.items()]
    used_words = f"smoothed positions, {_filter_text(bench.options.low_pass)}"
    return SweptFactor("velocity", "Derivation of velocities", used_words, tuple(trials))


def _offset(bench: Bench, own: Setting) -> SweptFactor:
    title = "Sensor offset and static run"
    if bench.problem.channel != "wrench":
        return SweptFactor("offset", title, "", ())
    treated = {"motion": "subtracted", "joint": "joint", "none": "fitted"}[bench.problem.static]
    trials = tuple(
        Trial(words, None, replace(own, offset=key), improvement="" if key == "ignored" else words)
        for key, words in OFFSETS.items()
        if key != treated
    )
    return SweptFactor("offset", title, OFFSETS[treated], trials)


@dataclass(frozen=True)
class Level:
    """What one level of a factor does to the errors."""

    #: As `bayesid.design.accuracy.sweeps.Trial`; 1 for the user's own level of a factor with numbers.
    label: str
    value: float | None
    source: str  # ``formula`` or ``simulation``; ``refused``: it cannot be fitted, `reason` says why
    #: Of the base parameters (r,); nan where they are not determined.
    bias: np.ndarray
    std: np.ndarray
    rms: np.ndarray
    #: Standard errors of these of a simulation (r,); zero where a formula gives them.
    bias_error: np.ndarray
    std_error: np.ndarray
    #: Root mean square error of predictions as a share of the signal, and its standard error.
    prediction: float
    prediction_error: float
    prediction_ratio: float  # that error over the one of the user's own setting, by formula where a formula says the error
    #: Median over the base parameters of the rms error over that of the user's own setting, with a 95 % interval.
    ratio: float
    ratio_low: float
    ratio_high: float
    lost: int = 0  # how many of the base parameters that the user's own setting determines are not determined
    improvement: str = ""  # what an advice would call it
    reason: str = ""  # why it was refused


@dataclass(frozen=True)
class Sweep:
    """What becomes of the errors while one factor is varied."""

    #: Of the factor.
    name: str
    title: str
    levels: tuple[Level, ...]  # with the user's own among them
    own: int  # index of the user's own


@dataclass(frozen=True)
class Sweeps:
    """All factors, about one setting."""

    own: Level  # the user's own setting, simulated
    formula: np.ndarray | None  # the same by formula, where one holds: the standard deviations (r,), else None
    sweeps: tuple[Sweep, ...]  # by factor
    #: Twins of every simulated level.
    runs: int
    seed: int

    @property
    def agreement(self) -> float:
        """Median ratio of the simulated standard deviations of the user's own setting to those of the formula; nan without."""
        return float("nan") if self.formula is None else float(median_ratio(self.own.std, self.formula))

    def improvements(self) -> tuple[tuple[str, Level], ...]:
        """The best advice of each factor, what lowers the median error most first; only those that lower it beyond chance."""
        out = []
        for sweep in self.sweeps:
            advised = [v for v in sweep.levels if v.improvement and np.isfinite(v.ratio) and v.ratio_high < 1.0 and not v.lost]
            if advised:
                out.append((sweep.name, min(advised, key=lambda v: v.ratio)))
        return tuple(sorted(out, key=lambda pair: pair[1].ratio))


def median_ratio(errors: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Median of ``errors / others`` (..., r) over the parameters that both determine; nan where there is none."""
    both = np.isfinite(errors) & np.isfinite(others) & (others > 0.0)
    ratios, some = np.where(both, errors, np.nan) / np.where(both, others, 1.0), both.any(axis=-1)
    out = np.full(both.shape[:-1], np.nan)
    out[some] = np.nanmedian(ratios[some], axis=-1)
    return out


def sweep(bench: Bench, runs: int, seed: int, tell: Callable[[str], object]) -> Sweeps:
    """Vary one factor at a time, with ``runs`` twins of every level that is simulated."""
    own = own_setting(bench)
    makers = (_noise, _resolution, _encoder, _rate, _length, _filter, _bandwidth, _velocity, _offset)
    factors = [factor for make in makers if (factor := make(bench, own)).trials]  # those that such an experiment has
    settings: list[Setting] = [own]
    formula = _has_formula(bench)
    if formula:
        settings.append(replace(own, noise=0.0))
    settings += [t.setting for f in factors for t in f.trials if t.setting is not None]
    found = _simulated(bench, settings, runs, seed, tell)
    errors = found[repr(own)]
    if isinstance(errors, str):
        raise BayesidError(f"a twin of these recordings cannot be fitted as they are: {errors}")
    own_level = _level(Trial("own", 1.0, own), errors, errors)
    linear = None
    if formula:
        quiet = found[repr(settings[1])]
        assert not isinstance(quiet, str)  # the same recordings with less noise
        linear = linear_errors(bench, quiet, seed)
    biased = prediction_error(bench, errors.columns.mean(axis=0))
    sweeps = tuple(_sweep(f, own_level, errors, found, linear, biased) for f in factors)
    return Sweeps(own_level, None if linear is None else linear.std(1.0, 1.0), sweeps, runs, seed)


def _simulated(
    bench: Bench, settings: list[Setting], runs: int, seed: int, tell: Callable[[str], object]
) -> dict[str, Errors | str]:
    """Errors of all runs of every setting, by its text; a reason where it cannot be fitted."""
    # Equal settings are simulated once; what is in them need not be hashable.
    unique = list({repr(s): s for s in settings}.values())
    seeds = [_SEEDS * (seed + 1) + k for k in range(runs)]

    def learned(setting: Setting) -> Learned | str | None:
        if setting.noise == 0.0:
            return None  # what the user's own setting learns stands in: there is no noise to learn
        try:
            return learn(bench, setting, seeds[0])
        except BayesidError as error:
            return str(error)

    known: list[Learned | str | None] = []
    for k, each in enumerate(map_tasks(learned, unique, locally=in_order)):
        known.append(each)
        tell(f"settings: {k + 1} of {len(unique)}")
    known = [known[0] if each is None else each for each in known]

    def run(job: tuple[int, int]) -> np.ndarray | str:
        which, number = job
        learned = known[which]
        if isinstance(learned, str):
            return learned
        try:
            return run_twin(bench, unique[which], number, learned)
        except BayesidError as error:
            return str(error)

    jobs = list(product(range(len(unique)), seeds))
    results: list[np.ndarray | str] = []
    for k, each in enumerate(map_tasks(run, jobs, locally=in_order)):
        results.append(each)
        tell(f"simulating: {k + 1} of {len(jobs)} twins")
    out: dict[str, Errors | str] = {}
    for k, setting in enumerate(unique):
        own = results[k * runs : (k + 1) * runs]
        refused = next((r for r in own if isinstance(r, str)), None)
        out[repr(setting)] = refused or errors_of(bench, np.array(own))
    return out


@dataclass(frozen=True)
class LinearErrors:
    """Errors of a fit that is linear in the readings: ``cov = k^2 sensor + encoder``."""

    bench: Bench  # the user's own experiment
    #: Covariances by the sensor's noise and by encoder errors (p, p).
    sensor: np.ndarray
    encoder: np.ndarray
    bias: np.ndarray  # without noise (p,)

    def covariance(self, noise: float, every_std: float) -> np.ndarray:
        """Covariance for factors of the sensor noise's standard deviation, and of all standard deviations (p, p)."""
        return every_std**2 * (noise**2 * self.sensor + self.encoder)

    def std(self, noise: float, every_std: float) -> np.ndarray:
        """Standard deviations of the base parameters (r,); nan where they are not determined."""
        std = np.sqrt(np.diag(self.covariance(noise, every_std)))
        return np.where(self.bench.estimate.undetermined, np.nan, std)[: self.bench.rank]

    def rms(self, noise: float, every_std: float) -> np.ndarray:
        """Root mean square errors of the base parameters (r,)."""
        return np.hypot(self.std(noise, every_std), self.bias[: self.bench.rank])

    def predicted(self, noise: float, every_std: float) -> float:
        """Root mean square error of predictions, a share of the signal."""
        scatter = np.sum(self.covariance(noise, every_std) * self.bench.prediction_gram)
        return float(np.hypot(np.sqrt(max(scatter, 0.0)), prediction_error(self.bench, self.bias)))


def linear_errors(bench: Bench, quiet: Errors, seed: int) -> LinearErrors:
    """The formula's parts, from errors of twins with a perfect sensor and one twin with perfect encoders."""
    perfect = replace(own_setting(bench), encoder=0.0)
    _, estimate = fit_twin(bench, perfect, twin(bench, perfect, _SEEDS * (seed + 1)))
    columns = np.nan_to_num(quiet.columns)  # what is not determined has no covariance by the formula, either
    return LinearErrors(bench, estimate.stated_covariance(), np.cov(columns.T), columns.mean(axis=0))


def _sweep(
    factor: SweptFactor, own: Level, errors: Errors, found: dict[str, Errors | str], linear: LinearErrors | None, biased: float
) -> Sweep:
    levels = []
    for trial in factor.trials:
        if trial.setting is None:
            levels.append(_by_formula(trial, own, linear, biased))
        else:
            result = found[repr(trial.setting)]
            levels.append(_refused(trial, own, result) if isinstance(result, str) else _level(trial, result, errors))
    numbered = all(t.value is not None for t in factor.trials)
    here = replace(own, label=factor.own, value=1.0 if numbered else None)
    if factor.name == "sensor_resolution":
        here = replace(here, value=0.0)
    levels = sorted([here, *levels], key=lambda v: -np.inf if v.value is None else v.value) if numbered else [here, *levels]
    return Sweep(factor.name, factor.title, tuple(levels), next(i for i, v in enumerate(levels) if v is here))


def _level(trial: Trial, errors: Errors, own: Errors) -> Level:
    """A level from simulated errors."""
    n = errors.runs
    lost = ~np.isfinite(errors.base).all(axis=0) & np.isfinite(own.base).all(axis=0)
    ratio, low, high = (float(median_ratio(errors.rms, own.rms)),) * 3
    if errors is not own:
        rows = np.random.default_rng(0).integers(n, size=(_RESAMPLES, n))
        ratios = median_ratio(*(np.sqrt(np.mean(e.base[rows] ** 2, axis=1)) for e in (errors, own)))
        low, high = np.quantile(np.append(ratios, ratio), [0.025, 0.975])
    spread = float(np.std(errors.prediction**2, ddof=1) / np.sqrt(n) / (2.0 * max(errors.predicted, 1e-300)))
    over = errors.predicted / max(own.predicted, 1e-300)
    return Level(
        trial.label, trial.value, "simulation", errors.bias, errors.std, errors.rms, errors.std / np.sqrt(n),
        errors.std / np.sqrt(2.0 * (n - 1)), errors.predicted, spread, over, ratio, float(low), float(high),
        int(lost.sum()), trial.improvement,
    )  # fmt: skip


def _by_formula(trial: Trial, own: Level, linear: LinearErrors | None, biased: float) -> Level:
    """A level whose covariance follows from that of the user's own setting; ``biased`` is its bias's error of predictions."""
    noise, every_std = trial.scale
    if linear is None:  # repeats alone: the mean of independent errors, whatever the estimator, with the bias of one
        bias, bias_error, std, std_error = own.bias, own.bias_error, every_std * own.std, every_std * own.std_error
        share = float(np.hypot(biased, every_std * np.sqrt(max(own.prediction**2 - biased**2, 0.0))))
        share_error, over = every_std * own.prediction_error, share / max(own.prediction, 1e-300)
        rms, usual = np.hypot(std, bias), own.rms
    else:
        bias, std, bias_error = linear.bias[: len(own.std)], linear.std(noise, every_std), np.zeros(len(own.std))
        std_error, share, share_error = bias_error, linear.predicted(noise, every_std), 0.0
        over = share / max(linear.predicted(1.0, 1.0), 1e-300)
        rms, usual = linear.rms(noise, every_std), linear.rms(1.0, 1.0)
    ratio = float(median_ratio(rms, usual))
    return Level(
        trial.label, trial.value, "formula", bias, std, rms, bias_error, std_error, share, share_error, over, ratio, ratio, ratio,
        0, trial.improvement,
    )  # fmt: skip


def _refused(trial: Trial, own: Level, reason: str) -> Level:
    nothing, nan = np.full(len(own.std), np.nan), float("nan")
    return Level(
        trial.label, trial.value, "refused", nothing, nothing, nothing, nothing, nothing, nan, nan, nan, nan, nan, nan,
        len(nothing), reason=reason,
    )  # fmt: skip
