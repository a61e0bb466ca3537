"""What fits of twins get wrong: errors of the base parameters and of predictions, setting by setting."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from bayesid.design.accuracy.bench import Bench, Setting, true_solution, twin
from bayesid.dynamics.base_parameters import BaseParameters, spanned
from bayesid.effects import MotionSegment
from bayesid.estimators import Estimate
from bayesid.estimators.least_squares import LeastSquares
from bayesid.estimators.nonlinear import solve
from bayesid.estimators.weights import Weights, learn_weights
from bayesid.recordings.experiment import Experiment
from bayesid.regression.problem import Problem, prepare, restrict
from bayesid.regression.row_cache import MotionRows
from bayesid.regression.row_model import RowModel
from bayesid.regression.segment import Segment


@dataclass(frozen=True, repr=False)
class DifferencedRows(RowModel):
    """Rows whose velocities, and accelerations where there is no filter, are differences of the encoders' positions."""

    #: ``central``: ``v_k = (q_{k+1} - q_{k-1}) / (t_{k+1} - t_{k-1})``; ``forward``: ``v_k = (q_{k+1} - q_k) / (t_{k+1} -
    #: t_k)``, which is the velocity half a sample later.
    kind: str = "central"

    def state(self, segment: Segment, first: int, last: int) -> MotionSegment:
        """Trajectory of samples first ... last - 1 by differences."""
        if segment.poses:
            return super().state(segment, first, last)
        a, b = max(first - 3, 0), min(last + 3, len(segment.times))
        times, q = segment.times[a:b], segment.positions[a:b]
        v = _differences(times, q, self.kind)
        acceleration = _differences(times, v, self.kind)
        part = slice(first - a, last - a)
        return MotionSegment(times[part], q[part], v[part], acceleration[part])


def differenced(problem: Problem, kind: str) -> Problem:
    """The same problem with velocities by differences."""
    own = {f.name: getattr(problem.row_model, f.name) for f in fields(RowModel)}
    row_model = DifferencedRows(**own, kind=kind)
    return restrict(problem, problem.fitted, MotionRows(row_model, problem.segments, problem.fitted))


def _differences(times: np.ndarray, values: np.ndarray, kind: str) -> np.ndarray:
    """Rates of values (N, n), those at the ends one-sided."""
    step = np.diff(times)[:, None]
    slope = np.diff(values, axis=0) / step
    if kind == "forward":
        return np.concatenate([slope, slope[-1:]])
    inner = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
    return np.concatenate([slope[:1], inner, slope[-1:]])


#: Share of a row of one base that rows of another leave, from which it is not among them.
_OUTSIDE = 1e-6


@dataclass(frozen=True)
class Learned:
    """What a fit of one twin learns beside the parameters, so that fits of its like need not learn it again."""

    bandwidth: float  # of the joint motion [Hz]
    weights: Weights  # noise of the rows


@dataclass(frozen=True)
class Errors:
    """Errors of fits of twins."""

    #: Estimate less truth of the user's base and effect parameters (runs, p); nan where a fit cannot determine one.
    columns: np.ndarray
    prediction: np.ndarray  # error of the predicted motions as a share of their signal (runs,)
    rank: int  # how many of the columns are base parameters

    @property
    def runs(self) -> int:
        """Number of twins that were fitted."""
        return len(self.columns)

    @property
    def base(self) -> np.ndarray:
        """Errors of the base parameters (runs, r)."""
        return self.columns[:, : self.rank]

    @property
    def bias(self) -> np.ndarray:
        """Mean error of the base parameters (r,)."""
        return self.base.mean(axis=0)

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of the errors of the base parameters (r,)."""
        return self.base.std(axis=0, ddof=1)

    @property
    def rms(self) -> np.ndarray:
        """Root mean square error of the base parameters (r,)."""
        return np.sqrt(np.mean(self.base**2, axis=0))

    @property
    def predicted(self) -> float:
        """Root mean square error of predictions, a share of the signal."""
        return float(np.sqrt(np.mean(self.prediction**2)))


def fit_twin(bench: Bench, setting: Setting, recorded: Experiment, learned: Learned | None = None) -> tuple[Problem, Estimate]:
    """Fit a twin as its setting says; with what is learned already, bandwidth and weights are not looked for again."""
    static = {"subtracted": "motion", "joint": "joint"}.get(setting.offset, setting.options.static)
    options = replace(setting.options, static=static, effects=None)  # a twin's own model says which
    if learned is not None:
        options = replace(options, bandwidth=learned.bandwidth)
    problem = prepare(recorded, options)
    if setting.velocity != "smoothed":
        problem = differenced(problem, setting.velocity)
    if learned is not None:
        if isinstance(bench.method, LeastSquares):  # whose estimate, unlike its covariance, needs no law of encoder errors
            problem = replace(problem, regression=replace(problem.regression, regressor_noise=None))
        problem.regression.rows.derived("weights", lambda: learned.weights)
    return solve(problem, bench.method)


def learn(bench: Bench, setting: Setting, seed: int) -> Learned:
    """What a fit of one twin of a setting learns beside the parameters."""
    problem, _ = fit_twin(bench, setting, twin(bench, setting, seed))
    return Learned(problem.smoother.bandwidth, learn_weights(problem.regression))


def error_of(bench: Bench, problem: Problem, estimate: Estimate) -> np.ndarray:
    """Error of a twin's fit in the columns of the user's solution (p,).

    Another treatment of static readings has other base parameters b' = K'phi; those of the user, b = K phi, are combinations
    of them where rows of K lie in the row space of K', and are not determined elsewhere (nan).
    """
    own, row_model = bench.problem, problem.row_model
    full = true_solution(bench, problem)
    rank = row_model.base.rank
    estimated = np.concatenate([np.ones(rank, bool), row_model.free])
    error = np.where(estimate.undetermined, np.nan, estimate.solution - full[estimated])
    found = np.full(len(bench.truth), np.nan)
    for k, row in enumerate(combinations(own.row_model.base, row_model.base)):
        if np.isfinite(row).all():  # parts that it does not have may be undetermined
            found[k] = row[row != 0.0] @ error[:rank][row != 0.0]
    # What is held at a value is wrong by how far that is from the truth; what the fit has not, its static run took away.
    names = [n for e in row_model.effects for n in e.column_names]
    held = np.zeros(len(names)) if row_model.point is None else row_model.point.values - full[rank:]
    held[row_model.free] = error[rank:]
    others = dict(zip(names, held, strict=True))
    found[bench.rank :] = [others.get(n, 0.0) for n in own.regression.effect_names]
    return found


def prediction_error(bench: Bench, error: np.ndarray) -> float:
    """Error of the predicted motions that an error of the solution (p,) makes, as a share of the signal.

    What the user's own fit does not determine is left out: it stays nominal, and so it is in the truth.
    """
    error = np.where(bench.estimate.undetermined, 0.0, error)
    return float(np.sqrt(max(error @ bench.prediction_gram @ error, 0.0)))


def combinations(wanted: BaseParameters, known: BaseParameters) -> np.ndarray:
    """Wanted base parameters as combinations of known ones (r, r'); nan in rows that are none."""
    if wanted.matrix.shape == known.matrix.shape and np.allclose(wanted.matrix, known.matrix, rtol=0.0, atol=1e-9):
        return np.eye(wanted.rank)
    rows, inside = spanned(wanted.matrix, known.matrix, _OUTSIDE)
    rows[np.abs(rows) < 1e-9] = 0.0
    rows[~inside] = np.nan
    return rows


def run_twin(bench: Bench, setting: Setting, seed: int, learned: Learned | None) -> np.ndarray:
    """Make one twin, fit it, and tell its error as `error_of` (p,)."""
    return error_of(bench, *fit_twin(bench, setting, twin(bench, setting, seed), learned))


def errors_of(bench: Bench, columns: np.ndarray) -> Errors:
    """Errors of several runs (runs, p), with those of predictions."""
    return Errors(columns, np.array([prediction_error(bench, e) for e in columns]), bench.rank)
