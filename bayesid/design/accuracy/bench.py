"""The user's own experiment as a bench for twins: its motion, its estimate taken for the truth, and the noise that was found.

Everything is relative to it. Its smoothed positions are the true motion, the links that have the estimated base parameters (or
the nominal ones) the true links, the effects of the model with their estimated values the plant, and the residuals of single
samples the noise: autoregressive in time and correlated between channels, model error included where there is any.

Twins are the same motion and truth with fresh noise, under the user's own setting or a changed one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesid.arguments import argument
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects import Effect, MotionSegment, Term, middle_of, with_places
from bayesid.effects.library import by_number
from bayesid.errors import InputError
from bayesid.estimators import Estimate, Estimator
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.table import Table, of_every_joint
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, absorbed_offset, prepare
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import Segment
from bayesid.signals.noise import NoiseModel, estimate_noise
from bayesid.simulation.simulation import Recorder, encoder_readings, simulate
from bayesid.simulation.trajectories import RecordedMotion, Trajectory

#: Samples of long recordings that noise and predictions are taken from.
_MOST = 20_000
_CHUNK = 4096
#: What is done about a sensor's constant offset: as in the user's experiment, or one of these.
OFFSETS = {
    "subtracted": "static run subtracted",
    "joint": "static run fitted along",
    "fitted": "no static run, offset fitted",
    "ignored": "no static run, offset ignored",
}


@dataclass(frozen=True, eq=False)
class Bench:
    """What twins of an experiment are made from."""

    experiment: Experiment  # the user's
    #: Its fit, linearised at the solution.
    problem: Problem
    estimate: Estimate
    #: How it was fitted.
    method: Estimator
    options: FitOptions
    links: np.ndarray  # true link parameters (b, 10)
    terms: tuple[Term, ...]  # effects of the plant with their true values
    noise: NoiseModel  # of single samples of one reading, in the problem's channels
    #: Encoder counts, 0 where they are not known, and random errors (n,) [rad or m].
    resolution: float
    position_std: np.ndarray
    nominal: bool = False  # whether the true links are the nominal ones

    @property
    def rank(self) -> int:
        """Number of base parameters."""
        return self.problem.row_model.base.rank

    @cached_property
    def truth(self) -> np.ndarray:
        """True base and effect parameters, in the order of the estimate's solution (p,)."""
        every = np.concatenate([np.ones(self.rank, bool), self.problem.row_model.free])
        return true_solution(self, self.problem)[every]

    @cached_property
    def motions(self) -> tuple[RecordedMotion, ...]:
        """The fitted motions as functions of time."""
        return tuple(RecordedMotion.of(m, self.experiment) for m in self.experiment.motions if m.name in self.problem.fitted)

    @cached_property
    def middle(self) -> np.ndarray:
        """Joint positions at the middle of the first motion (n,)."""
        return middle_of(next(m for m in self.motions if m.pieces).trajectory().positions)

    def smoothed(self, segment: Segment, row_model: RowModel) -> MotionSegment:
        """The motion of a segment that exact readings are made of."""
        state = row_model.state(segment, 0, len(segment.times))
        return replace(state, still=segment.poses, bandwidth=row_model.bandwidth, middle=self.middle)

    @property
    def plant(self) -> dict[str, dict[str, Any]]:
        """Values of the plant's effects by name and parameter."""
        return {t.effect.spec: dict(zip(t.effect.parameters, t.values, strict=True)) for t in self.terms}

    @cached_property
    def predicted_motions(self) -> tuple[str, ...]:
        """Motions that predictions are judged on: those that were not fitted, or the fitted ones where there is no other."""
        return tuple(motion.name for motion in self.problem.judges) or self.problem.fitted

    @cached_property
    def prediction_gram(self) -> np.ndarray:
        """``G = sum X'X / sum |y|^2`` over readings of the predicted motions (p, p).

        An error e of the solution makes a prediction wrong by ``sqrt(e'G e)`` of the signal.
        """
        gram, power = 0.0, 0.0
        for segment in (s for name in self.predicted_motions for s in self.problem.segments[name]):
            for rows, y in _samples(self.problem, segment):
                x = rows[:, :, :-1].reshape(-1, rows.shape[2] - 1)
                gram, power = gram + x.T @ x, power + float(np.sum(y**2))
        return np.asarray(gram) / max(power, 1e-300)


def make_bench(
    experiment: Experiment,
    method: Estimator,
    options: FitOptions,
    problem: Problem | None = None,
    estimate: Estimate | None = None,
    *,
    nominal: bool = False,
) -> Bench:
    """Fit an experiment, unless ``problem`` and ``estimate`` are of such a fit, and take what was found for the truth.

    With ``nominal`` the nominal links are the true ones instead of the estimated. An `InputError` as for `bayesid.identify`, or
    where expressions of the model have values that are not finite.
    """
    if problem is None or estimate is None:
        problem, estimate = solve(prepare(experiment, options), method)
    row_model, robot = problem.row_model, experiment.robot
    if problem.at_rest:
        raise InputError(f"accuracy: only poses at rest are fitted, and it varies a motion; name one with {argument('motions')}")
    rank = row_model.base.rank
    if nominal:
        links = robot.nominal.ravel()
    elif estimate.links is not None:
        links = estimate.links
    else:
        known = ~(estimate.undetermined[:rank] | estimate.weak[:rank])
        links = nearest_links(robot, row_model.base, estimate.values, known)
    values, absorbed = row_model.every_value(estimate.solution[rank:]), absorbed_offset(row_model.base, links)
    own = ((effect, values[places]) for effect, places in with_places(row_model.effects))
    terms = tuple(Term(effect, tuple(v - absorbed if effect.absorbs_weight else v)) for effect, v in own)
    count = experiment.position_resolution or 0.0
    if experiment.position_std is not None:
        scatter = np.full(robot.n, experiment.position_std)
    else:
        scatter = np.sqrt(np.maximum(problem.smoother.position_std**2 - count**2 / 12.0, 0.0))
        scatter = np.where(scatter > 0.1 * count, scatter, 0.0)  # rounding, as far as the residuals can tell
    return Bench(
        experiment, problem, estimate, method, replace(options, channel=problem.channel, motions=problem.fitted),
        links.reshape(-1, 10), terms, _sample_noise(problem, estimate), float(count), scatter, nominal,
    )  # fmt: skip


def missing_effects(experiment: Experiment, row_model: RowModel) -> tuple[Term, ...]:
    """Every effect of the library that acts on the channels and is not in the model, at every place, of usual size."""
    known, possible = {e.spec for e in row_model.effects}, experiment.possible_effects(row_model.channels.names)
    return tuple(Term(e, tuple(e.typical(experiment.robot))) for e in possible if e.spec not in known)


def true_solution(bench: Bench, problem: Problem) -> np.ndarray:
    """True base parameters and those of all effects, held ones too, of any problem made of a twin (r + effect parameters,).

    Effects that the problem estimates and the plant has not are zero, or hold the weight that looks like them.
    """
    base, known = problem.row_model.base, {t.effect.spec: t for t in bench.terms}
    absorbed = absorbed_offset(base, bench.links)
    values: list[float] = []
    for effect in problem.row_model.effects:
        term = known.get(effect.spec)
        own = np.zeros(len(effect.parameters)) if term is None else np.array(term.values)
        values += list(own + absorbed if effect.absorbs_weight else own)
    return np.concatenate([base.matrix @ bench.links.ravel(), values])


def _samples(problem: Problem, segment: Segment):
    """Unfiltered rows of a segment's samples (k, c, p + 1) and what was measured (k, c), piece by piece, spread over a long one.

    Where the model is linearised, the target of the rows is not what was measured.
    """
    a, b = segment.inner(0.0 if segment.poses else problem.row_model.margin)
    pieces = max((b - a) // _CHUNK, 1)
    every = max(pieces * _CHUNK // _MOST, 1)
    for first in range(a, b, _CHUNK * every):
        last = min(first + _CHUNK, b)
        if last - first > 1:
            yield problem.row_model.samples(segment, first, last), segment.measured(first, last)


def _sample_noise(problem: Problem, estimate: Estimate) -> NoiseModel:
    """Noise of single samples of one reading, from what the estimate leaves of the fitted motions."""
    left = []
    for segment in (s for s in problem.fitted_segments if not s.poses):
        a, b = segment.inner(problem.row_model.margin)
        b = min(b, a + _MOST)
        if b - a > 1:
            left.append(segment.measured(a, b) - problem.row_model.predicted(segment, a, b, estimate.solution))
    model = estimate_noise(left, parameters=len(estimate.solution))
    # The motion wrench is the difference of two readings, each with noise of its own.
    return replace(model, innovation=0.5 * model.innovation) if problem.static == "motion" else model


_PERFECT = Recorder(resolution=0.0, position_std=0.0, force_std=0.0, torque_std=0.0, drive_std=0.0)


@dataclass(frozen=True)
class Setting:
    """How an experiment is recorded and fitted, relative to the user's own."""

    #: Factors of the readings' noise, and of encoder counts and random encoder errors.
    noise: float = 1.0
    encoder: float = 1.0
    step: float = 0.0  # resolution of the readings in standard deviations of the user's own noise; 0: none
    rate: float = 1.0  # factor of the sampling rate: a whole number, or one over one
    length: float = 1.0  # share of each motion that is recorded, from its start
    velocity: str = "smoothed"  # or ``central`` or ``forward`` differences of the positions
    offset: str = ""  # a key of `OFFSETS`, or empty for the user's own treatment
    options: FitOptions = field(default_factory=FitOptions)  # how it is fitted


def own_setting(bench: Bench) -> Setting:
    """The user's own setting."""
    return Setting(options=bench.options)


def twin(bench: Bench, setting: Setting, seed: int) -> Experiment:
    """One recording of the fitted motions with fresh noise; a seed draws the same noise for settings with the same sizes.

    The same motion would be rounded to counts in the same way every time; each twin starts a random part of a sample later and
    runs a random part of a count beside the motion, so that rounding is fresh, too.
    """
    rng = np.random.default_rng(seed)
    shift = rng.uniform(0.0, 1.0)
    aside = setting.encoder * bench.resolution * rng.uniform(-0.5, 0.5, bench.experiment.robot.n)
    trajectories = [_shifted(m, setting, shift, aside) for m in bench.motions]
    plant = bench.plant
    for effect in _offsets(bench) if setting.offset else ():
        plant.setdefault(effect.spec, {})  # of usual size
    exact = simulate(bench.experiment, trajectories, effects=plant, links=bench.links, recorder=_PERFECT)
    motions = []
    for m, own in zip(exact.motions, bench.motions, strict=True):
        static = None if m.static is None else _read(bench, setting, m.static, own, rng)
        motions.append(replace(m, table=_read(bench, setting, m.table, own, rng), static=static))
    return replace(bench.experiment, motions=tuple(motions), **_model(bench, setting))


def _offsets(bench: Bench) -> tuple[Effect, ...]:
    """Constants of a sensor that every model has unless a static run removes them."""
    possible = bench.experiment.possible_effects(bench.problem.row_model.channels.names)
    return tuple(e for e in possible if e.estimated_without_static_run)


def _model(bench: Bench, setting: Setting) -> dict:
    """The model that the user has, started at the truth: twins need not find it from afar."""
    values = bench.plant
    stated, joints = bench.experiment.effect_values, bench.experiment.robot.joint_names
    fixed = {by_number(key, joints) for key, given in stated.items() if given.get("fixed", False)}
    for spec in values:
        if {spec, spec.partition("@")[0]} & fixed:
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
    drives = [n for n in names if n.startswith("tau")]
    torques = [read[n] for n in drives]
    given = own.motion.table
    commanded = None
    if given.commanded is not None and len(exact) > 1:
        commanded = np.stack([np.interp(exact.times, given.times, column) for column in given.commanded.T], axis=1)
    return Table(
        exact.times, q, None, commanded, of_every_joint(np.stack(torques, axis=1), drives, q.shape[1]) if torques else None,
        np.stack(wrench, axis=1) if wrench else None, source=exact.source,
    )  # fmt: skip
