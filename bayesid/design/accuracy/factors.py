"""What is varied, one factor at a time about the user's own setting."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bayesid.design.accuracy.bench import Bench
from bayesid.design.accuracy.twins import OFFSETS, Setting, own_setting
from bayesid.estimators.least_squares import LeastSquares
from bayesid.recordings.table import usual_step
from bayesid.signals.filters import LowPass

#: Filters that are tried; the first is the paper's.
FILTERS = (LowPass(1.0, 50.0), LowPass(10.0, 50.0), LowPass(31.0, 63.0))
#: Slower than this, a motion is not sampled [Hz], and than so many times its bandwidth.
_SLOWEST_RATE, _RATE_PER_BANDWIDTH = 10.0, 5.0
_VELOCITIES = {
    "central": "central differences of the positions",
    "forward": "forward differences of the positions",
}


@dataclass(frozen=True)
class Trial:
    """One level of a factor.

    Attributes
    ----------
    label
        What it is, a few words.
    value
        The level as a multiple of the user's own; None where it is no number.
    setting
        The whole setting; None where a formula says what it does.
    scale
        Of a formula: the factor of the sensor noise's standard deviation, and that of all standard deviations.
    improvement
        What it would be called as an advice; empty where nobody would give it.
    """

    label: str
    value: float | None
    setting: Setting | None
    scale: tuple[float, float] = (1.0, 1.0)
    improvement: str = ""


@dataclass(frozen=True)
class SweptFactor:
    """A property of the experiment or of its evaluation, with the levels that it is tried at.

    Attributes
    ----------
    name, title
        Key, and words.
    own
        The user's own level, in words.
    trials
        The others.
    """

    name: str
    title: str
    own: str
    trials: tuple[Trial, ...]


def has_formula(bench: Bench) -> bool:
    """Whether the estimator is linear in the readings, so that covariances scale with noise and length."""
    return isinstance(bench.method, LeastSquares)


def all_factors(bench: Bench) -> tuple[SweptFactor, ...]:
    """Every factor that such an experiment has."""
    factors = [
        _noise(bench), _resolution(bench), _encoder(bench), _rate(bench), _length(bench), _filter(bench), _bandwidth(bench),
        _velocity(bench), _offset(bench),
    ]  # fmt: skip
    return tuple(f for f in factors if f.trials)


def _if_complete(bench: Bench, advice: str) -> str:
    """An advice that helps against noise, not against model error: empty where the model is incomplete."""
    return "" if bench.estimate.details.model_complete is False else advice


def _noise(bench: Bench) -> SweptFactor:
    own, formula = own_setting(bench), has_formula(bench)
    half = _if_complete(bench, "half the sensor noise")
    trials = tuple(
        Trial(f"× {k:g}", k, None if formula else replace(own, noise=k), (k, 1.0), half if k == 0.5 else "")
        for k in (0.25, 0.5, 2.0, 4.0)
    )
    return SweptFactor("sensor_noise", "Noise of the readings", _sizes(bench, 1.0), trials)


def _resolution(bench: Bench) -> SweptFactor:
    own = own_setting(bench)
    trials = [Trial(f"{k:g} noise std", k, replace(own, step=k)) for k in (1.0, 3.0, 10.0)]
    return SweptFactor("sensor_resolution", "Resolution of the readings", "as fine as the noise, or finer", tuple(trials))


def _sizes(bench: Bench, scale: float) -> str:
    """Standard deviations of one reading by unit."""
    units = bench.problem.row_model.channels.units
    std = scale * bench.noise.std
    by_unit = {unit: [s for s, u in zip(std, units, strict=True) if u == unit] for unit in dict.fromkeys(units)}
    return ", ".join(f"{sum(values) / len(values):.2g} {unit}" for unit, values in by_unit.items())


def _encoder(bench: Bench) -> SweptFactor:
    if not bench.resolution and not bench.position_std.any():
        return SweptFactor("encoder", "Encoder errors", "none", ())
    own, count = own_setting(bench), bench.resolution
    what = f"counts of {count:.2g}" if count else f"random errors of {max(bench.position_std):.2g}"
    trials = tuple(
        Trial(
            f"× {k:g}" + (f" ({count * k:.2g})" if count and k else ""),
            k,
            replace(own, encoder=k),
            improvement="encoders four times as fine" if k == 0.25 else "",
        )
        for k in (0.0, 0.25, 4.0, 16.0)
    )
    return SweptFactor("encoder", "Encoder errors", what, trials)


def _rate(bench: Bench) -> SweptFactor:
    own = own_setting(bench)
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


def _length(bench: Bench) -> SweptFactor:
    own = own_setting(bench)
    whole = sum(m.motion.table.duration for m in bench.motions)
    shorter = [Trial(f"first {whole * k:.3g} s", k, replace(own, length=k)) for k in (0.25, 0.5)]
    longer = [
        Trial(
            f"repeated {k:g} times",
            k,
            None,
            (1.0, k**-0.5),
            _if_complete(bench, "the motion twice") if k == 2.0 else "",
        )
        for k in (2.0, 4.0)
    ]
    return SweptFactor("record_length", "Record length", f"{whole:.3g} s", (*shorter, *longer))


def _filter_text(low_pass: LowPass | None) -> str:
    return "no filter" if low_pass is None else f"l = {low_pass.l:g}, d = {low_pass.d:g} rad/s"


def _filter(bench: Bench) -> SweptFactor:
    own, used = own_setting(bench), bench.options.low_pass
    trials = tuple(
        Trial(
            text := _filter_text(tried),
            None,
            replace(own, options=replace(own.options, low_pass=tried)),
            improvement=f"filter: {text}",
        )
        for tried in (None, *FILTERS)
        if tried != used
    )
    return SweptFactor("filter", "Low-pass filters", _filter_text(used), trials)


def _bandwidth(bench: Bench) -> SweptFactor:
    own, found = own_setting(bench), bench.problem.smoother.bandwidth
    how = "" if bench.options.bandwidth is not None else " (automatic)"
    trials = tuple(
        Trial(
            f"{found * k:.3g} Hz",
            k,
            replace(own, options=replace(own.options, bandwidth=found * k)),
            improvement=f"bandwidth {found * k:.3g} Hz",
        )
        for k in (0.5, 0.71, 1.4, 2.0)
    )
    return SweptFactor("bandwidth", "Bandwidth of the smoothed motion", f"{found:.3g} Hz{how}", trials)


def _velocity(bench: Bench) -> SweptFactor:
    own = own_setting(bench)
    used = bench.options.low_pass or FILTERS[0]
    filtered = replace(own, options=replace(own.options, low_pass=used))
    text = _filter_text(used)
    trials = [] if bench.options.low_pass else [Trial(f"smoothed positions, {text}", None, filtered)]
    trials += [Trial(f"{words}, {text}", None, replace(filtered, velocity=kind)) for kind, words in _VELOCITIES.items()]
    used_words = f"smoothed positions, {_filter_text(bench.options.low_pass)}"
    return SweptFactor("velocity", "Derivation of velocities", used_words, tuple(trials))


def _offset(bench: Bench) -> SweptFactor:
    title = "Sensor offset and static run"
    if bench.problem.channel != "wrench":
        return SweptFactor("offset", title, "", ())
    own = own_setting(bench)
    treated = {"motion": "subtracted", "joint": "joint", "none": "fitted"}[bench.problem.static]
    trials = tuple(
        Trial(words, None, replace(own, offset=key), improvement="" if key == "ignored" else words)
        for key, words in OFFSETS.items()
        if key != treated
    )
    return SweptFactor("offset", title, OFFSETS[treated], trials)
