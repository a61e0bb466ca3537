"""The user's own experiment as a bench: its motion, its estimate taken for the truth, and the noise that was found.

Everything is relative to it. Its smoothed positions are the true motion, the links that have the estimated base parameters (or
the nominal ones) the true links, the effects of the model with their estimated values the plant, and the residuals of single
samples the noise: autoregressive in time and correlated between channels, model error included where there is any.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.arguments import argument
from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects import Term, middle_of
from bayesid.errors import InputError
from bayesid.estimators import Estimate, Estimator
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.experiment import Experiment
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import Problem, prepare
from bayesid.regression.segment import Segment
from bayesid.regression.structure import absorbed_offset
from bayesid.signals.noise import NoiseModel, estimate_noise
from bayesid.simulation.trajectories import RecordedMotion

#: Samples of long recordings that noise and predictions are taken from.
_MOST = 20_000
_CHUNK = 4096


@dataclass(frozen=True, eq=False)
class Bench:
    """What twins of an experiment are made from.

    Attributes
    ----------
    experiment
        The user's.
    problem, estimate
        Its fit, linearised at the solution.
    method, options
        How it was fitted.
    links
        True link parameters (b, 10).
    terms
        Effects of the plant with their true values.
    noise
        Of single samples of one reading, in the problem's channels.
    resolution, position_std
        Encoder counts, 0 where they are not known, and random errors (n,) [rad or m].
    nominal
        Whether the true links are the nominal ones.
    """

    experiment: Experiment
    problem: Problem
    estimate: Estimate
    method: Estimator
    options: FitOptions
    links: np.ndarray
    terms: tuple[Term, ...]
    noise: NoiseModel
    resolution: float
    position_std: np.ndarray
    nominal: bool = False

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

    @cached_property
    def predicted_motions(self) -> tuple[str, ...]:
        """Motions that predictions are judged on: those that were not fitted, or the fitted ones where there is no other."""
        others = [m.name for m in self.experiment.motions if m.role == "validation" and m.name in self.problem.segments]
        return tuple(name for name in others if name not in self.problem.fitted) or self.problem.fitted

    @cached_property
    def prediction_gram(self) -> np.ndarray:
        """``G = sum X'X / sum |y|^2`` over readings of the predicted motions (p, p).

        An error e of the solution makes a prediction wrong by ``sqrt(e'G e)`` of the signal.
        """
        gram, power = 0.0, 0.0
        for segment in (s for name in self.predicted_motions for s in self.problem.segments[name]):
            for rows in _samples(self.problem, segment):
                x, y = rows[:, :, :-1].reshape(-1, rows.shape[2] - 1), rows[:, :, -1]
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
    """Fit an experiment, unless that is done already, and take what was found for the truth.

    Parameters
    ----------
    experiment, method, options
        What is fitted, and how.
    problem, estimate
        Of a fit that was made with these.
    nominal
        Take the nominal links for the true ones instead of the estimated.

    Raises
    ------
    InputError
        Bad input, as for `bayesid.identify`; or the model has expressions whose values are not finite.
    """
    if problem is None or estimate is None:
        problem, estimate = solve(prepare(experiment, options), method)
    row_model, robot = problem.row_model, experiment.robot
    if all(s.poses for name in problem.fitted for s in problem.segments[name]):
        raise InputError(f"accuracy: only poses at rest are fitted, and it varies a motion; name one with {argument('motions')}")
    rank = row_model.base.rank
    if nominal:
        links = robot.nominal.ravel()
    elif estimate.links is not None:
        links = estimate.links
    else:
        known = ~(estimate.undetermined[:rank] | estimate.weak[:rank])
        links = nearest_links(robot, row_model.base, estimate.values, known)
    values = row_model.free.astype(float)
    values[row_model.free] = estimate.solution[rank:]
    if row_model.point is not None:
        values[~row_model.free] = row_model.point.values[~row_model.free]
    absorbed = absorbed_offset(row_model.base, links)
    terms, start = [], 0
    for effect in row_model.effects:
        own = values[start : start + len(effect.parameters)]
        terms.append(Term(effect, tuple(own - absorbed if effect.absorbs_weight else own)))
        start += len(own)
    count = experiment.position_resolution or 0.0
    if experiment.position_std is not None:
        scatter = np.full(robot.n, experiment.position_std)
    else:
        scatter = np.sqrt(np.maximum(problem.smoother.position_std**2 - count**2 / 12.0, 0.0))
        scatter = np.where(scatter > 0.1 * count, scatter, 0.0)  # rounding, as far as the residuals can tell
    return Bench(
        experiment, problem, estimate, method, replace(options, channel=problem.channel, motions=problem.fitted),
        links.reshape(-1, 10), tuple(terms), _sample_noise(problem, estimate), float(count), scatter, nominal,
    )  # fmt: skip


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
    """Unfiltered rows of a segment's samples (k, c, p + 1), piece by piece, evenly spread over a long one."""
    a, b = segment.inner(0.0 if segment.poses else problem.row_model.margin)
    pieces = max((b - a) // _CHUNK, 1)
    every = max(pieces * _CHUNK // _MOST, 1)
    for first in range(a, b, _CHUNK * every):
        last = min(first + _CHUNK, b)
        if last - first > 1:
            yield problem.row_model.samples(segment, first, last)


def _sample_noise(problem: Problem, estimate: Estimate) -> NoiseModel:
    """Noise of single samples of one reading, from what the estimate leaves of the fitted motions."""
    left = []
    for segment in (s for name in problem.fitted for s in problem.segments[name] if not s.poses):
        a, b = segment.inner(problem.row_model.margin)
        b = min(b, a + _MOST)
        if b - a > 1:
            left.append(segment.measured(a, b) - problem.row_model.predicted(segment, a, b, estimate.solution))
    model = estimate_noise(left, parameters=len(estimate.solution))
    # The motion wrench is the difference of two readings, each with noise of its own.
    return replace(model, innovation=0.5 * model.innovation) if problem.static == "motion" else model
