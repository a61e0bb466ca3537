"""Twins of an experiment: the same motion and truth with fresh noise, under the user's own setting or a changed one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.design.accuracy.bench import Bench
from bayesid.effects import Effect
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import Table
from bayesid.regression.options import FitOptions
from bayesid.simulation.simulation import Recorder, encoder_readings, simulate
from bayesid.simulation.trajectories import RecordedMotion, Trajectory

#: What is done about a sensor's constant offset: as in the user's experiment, or one of these.
OFFSETS = {
    "subtracted": "static run subtracted",
    "joint": "static run fitted along",
    "fitted": "no static run, offset fitted",
    "ignored": "no static run, offset ignored",
}
_PERFECT = Recorder(resolution=0.0, position_std=0.0, force_std=0.0, torque_std=0.0, drive_std=0.0)


@dataclass(frozen=True)
class Setting:
    """How an experiment is recorded and fitted, relative to the user's own.

    Attributes
    ----------
    noise, encoder
        Factors of the readings' noise, and of encoder counts and random encoder errors.
    step
        Resolution of the readings in standard deviations of the user's own noise; 0: none.
    rate
        Factor of the sampling rate: a whole number, or one over one.
    length
        Share of each motion that is recorded, from its start.
    velocity
        One of `bayesid.design.accuracy.fits.VELOCITIES`.
    offset
        A key of `OFFSETS`, or empty for the user's own treatment.
    options
        How it is fitted.
    """

    noise: float = 1.0
    encoder: float = 1.0
    step: float = 0.0
    rate: float = 1.0
    length: float = 1.0
    velocity: str = "smoothed"
    offset: str = ""
    options: FitOptions = field(default_factory=FitOptions)


def own_setting(bench: Bench) -> Setting:
    """The user's own setting."""
    return Setting(options=bench.options)


def twin(bench: Bench, setting: Setting, seed: int) -> Experiment:
    """One recording of the fitted motions with fresh noise.

    The same motion would be rounded to counts in the same way every time; each twin starts a random part of a sample later and
    runs a random part of a count beside the motion, so that rounding is fresh, too.

    Parameters
    ----------
    bench, setting
        What is recorded, and how.
    seed
        Of everything random; the same for different settings draws the same noise where sizes are the same.
    """
    rng = np.random.default_rng(seed)
    shift = rng.uniform(0.0, 1.0)
    aside = setting.encoder * bench.resolution * rng.uniform(-0.5, 0.5, bench.experiment.robot.n)
    trajectories = [_shifted(m, setting, shift, aside) for m in bench.motions]
    plant = {t.effect.spec: dict(zip(t.effect.parameters, t.values, strict=True)) for t in bench.terms}
    for effect in _offsets(bench) if setting.offset else ():
        plant.setdefault(effect.spec, dict(zip(effect.parameters, effect.typical(bench.experiment.robot), strict=True)))
    exact = simulate(bench.experiment, trajectories, effects=plant, links=bench.links, recorder=_PERFECT)
    motions = [
        _recorded(bench, setting, m, own, rng) for m, own in zip(exact.motions, bench.motions, strict=True)
    ]  # fmt: skip
    return replace(bench.experiment, motions=tuple(motions), **_model(bench, setting))


def fit_options(setting: Setting) -> FitOptions:
    """How a twin is fitted: the setting's choices, with what its treatment of offsets asks for."""
    static = {"subtracted": "motion", "joint": "joint"}.get(setting.offset, setting.options.static)
    return replace(setting.options, static=static, effects=None)  # a twin's own model says which


def _offsets(bench: Bench) -> tuple[Effect, ...]:
    """Constants of a sensor that every model has unless a static run removes them."""
    experiment, names = bench.experiment, bench.problem.row_model.channels.names
    classes = [c for c in experiment.library.classes.values() if c.estimated_without_static_run]
    return tuple(e for c in classes for e in experiment.library.places(c.name, experiment.robot.joint_names, names))


def _model(bench: Bench, setting: Setting) -> dict:
    """The model that the user has, started at the truth: twins need not find it from afar."""
    values = {t.effect.spec: dict(zip(t.effect.parameters, t.values, strict=True)) for t in bench.terms}
    stated = bench.experiment.effect_values
    for spec in values:
        if any(stated.get(key, {}).get("fixed", False) for key in (spec, spec.partition("@")[0])):
            values[spec]["fixed"] = True
    effects = bench.experiment.effects if bench.options.effects is None else tuple(bench.options.effects)
    if setting.offset == "ignored":
        offsets = _offsets(bench)
        values |= {e.spec: {**dict.fromkeys(e.parameters, 0.0), "fixed": True} for e in offsets}
        others = [e for e in effects if e.partition("@")[0] not in {o.name for o in offsets}]
        effects = (*(o.spec for o in offsets), *others)
    elif not any(e.shape or not e.from_motion_alone for e in bench.problem.row_model.effects):
        values = {}
    encoder = None if not bench.resolution else bench.resolution * setting.encoder or None
    scatter = bench.experiment.position_std
    return {
        "effects": effects, "effect_values": {**stated, **values}, "position_resolution": encoder,
        "position_std": None if scatter is None else scatter * setting.encoder or None,
    }  # fmt: skip


def _shifted(motion: RecordedMotion, setting: Setting, shift: float, aside: np.ndarray) -> Trajectory:
    """The true motion at this setting's times, a part of a sample later and a part of a count aside."""
    made = motion.trajectory(_times(setting, shift))
    q = made.positions + aside
    static = made.static_positions
    if setting.offset:
        static = q if setting.offset in ("subtracted", "joint") and made.kind != "poses" else None
    elif static is made.positions:
        static = q
    return replace(made, positions=q, static_positions=static)


def _times(setting: Setting, shift: float) -> Callable[[np.ndarray], np.ndarray]:
    def times(recorded: np.ndarray) -> np.ndarray:
        kept = recorded[: max(int(round(setting.length * len(recorded))), 2)]
        if setting.rate > 1.0:
            fine = np.arange(round((len(kept) - 1) * setting.rate)) / setting.rate
            at = np.interp(fine, np.arange(len(kept)), kept)
            return at + shift * np.append(np.diff(at), kept[-1] - at[-1])
        at = kept[:-1] + shift * np.diff(kept)
        return at[:: max(round(1.0 / setting.rate), 1)]

    return times


def _recorded(bench: Bench, setting: Setting, exact: Motion, own: RecordedMotion, rng: np.random.Generator) -> Motion:
    static = None if exact.static is None else _read(bench, setting, exact.static, own, rng)
    return replace(exact, table=_read(bench, setting, exact.table, own, rng), static=static)


def _read(bench: Bench, setting: Setting, exact: Table, own: RecordedMotion, rng: np.random.Generator) -> Table:
    """What the instruments make of a table of exact values."""
    q = encoder_readings(exact.positions, setting.encoder * bench.resolution, setting.encoder * bench.position_std, rng)
    names = bench.problem.row_model.channels.names
    # Faster than recorded, noise is taken for independent from sample to sample.
    model = bench.noise.uncoloured() if setting.rate > 1.0 else bench.noise
    every = max(round(1.0 / setting.rate), 1)
    noise = setting.noise * model.drawn(len(exact) * every, rng)[::every]
    size = setting.step * bench.noise.std
    columns = dict(exact.channels())
    read = {}
    for k, name in enumerate(names):
        value = columns[name] + noise[:, k]
        read[name] = np.round(value / size[k]) * size[k] if size[k] > 0 else value
    wrench = [read[n] for n in names if not n.startswith("tau")]
    torques = [read[n] for n in names if n.startswith("tau")]
    given = own.motion.table
    commanded = None
    if given.commanded is not None and len(exact) > 1:
        commanded = np.stack([np.interp(exact.times, given.times, column) for column in given.commanded.T], axis=1)
    return Table(
        exact.times, q, None, commanded, np.stack(torques, axis=1) if torques else None,
        np.stack(wrench, axis=1) if wrench else None, source=exact.source,
    )  # fmt: skip
