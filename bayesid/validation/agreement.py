"""Whether estimates agree: from the same rows by several methods, of motions among each other, wrench and torque, stop-and-go.

Estimates from the same rows are correlated: their difference is not as large as both intervals together say. So differences are
given in one stated unit, and tested only against the efficient estimate, where the covariance of the difference is known. Those
from different data are independent.

The nominal model, its effects fitted or not, is the yardstick for every estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.dynamics.base_parameters import spanned, structural_base
from bayesid.effects import starting_point, stated_of, with_places
from bayesid.errors import BayesidError
from bayesid.estimators import Estimate, Estimator, fit
from bayesid.estimators.factor import reduce_scaled
from bayesid.estimators.nonlinear import solve
from bayesid.estimators.weights import SMALLEST_AGREEMENT, Weights
from bayesid.regression import hypothesis_tests, linalg
from bayesid.regression.parallel import in_order
from bayesid.regression.problem import Problem, absorbed_offset, prepare, relinearised, restrict, weight_columns
from bayesid.regression.readings import make_channels

#: Eigenvalues of a difference of covariances, relative to the larger one, below which it says nothing.
_SMALLEST_GAP = 0.05


@dataclass(frozen=True)
class EstimatorDifference:
    """How far apart two estimators are, parameter by parameter, in standard deviations of the reference.

    Estimates from the same rows are correlated, so this is no test: 1 says that the choice of the estimator
    moves the result by as much as the noise does.
    """

    #: Which estimators.
    first: str
    second: str
    compared: int  # how many base parameters both and the reference determine
    #: Of the differences [standard deviations of the reference].
    rms: float
    largest: float
    where: str  # label of the base parameter that differs most


@dataclass(frozen=True)
class HausmanTest:
    """Whether an estimator differs from the efficient one by more than the noise explains [Hausman1978]_."""

    #: Which estimators.
    method: str
    efficient: str
    #: ``d' (V - V_efficient)^-1 d`` and how many directions it sums; 0 where no direction can be tested.
    statistic: float = 0.0
    degrees: int = 0
    #: Of a statistic at least as large if both are consistent; None where the test does not apply.
    probability: float | None = None
    reason: str = ""  # why it does not apply

    @property
    def contradiction(self) -> bool:
        """Whether chance cannot explain the difference; there are several tests, so the level is low."""
        return self.probability is not None and self.probability < SMALLEST_AGREEMENT


def gaps(estimates: dict[str, Estimate], reference: str) -> list[EstimatorDifference]:
    """Differences of all pairs, in standard deviations of the reference, so that they can be compared with each other."""
    names, std = list(estimates), estimates[reference].std
    rank, labels, out = len(std), estimates[reference].base.labels, []
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            one, other = estimates[first], estimates[second]
            at = np.flatnonzero((std > 0) & ~one.undetermined[:rank] & ~other.undetermined[:rank])
            if not len(at):
                continue
            z = np.abs(one.values - other.values)[at] / std[at]
            k = int(np.argmax(z))
            out.append(EstimatorDifference(first, second, len(at), float(np.sqrt(np.mean(z**2))), float(z[k]), labels[at[k]]))
    return out


def hausman(method: str, estimate: Estimate, efficient: str, best: Estimate) -> HausmanTest:
    """Test an estimate against the efficient one (generalised least squares) from the same rows.

    The difference of a consistent estimate and the efficient one is uncorrelated with the latter, so its covariance is ``V -
    V_efficient`` [Hausman1978]_. That fails for a biased estimate, and for one that knows more than the rows say, such as a
    prior or a constraint: then ``V - V_efficient`` is not positive semidefinite.
    """
    if estimate.full_covariance is None or best.full_covariance is None:
        return HausmanTest(method, efficient, reason="an estimator without intervals cannot be tested")
    if estimate.interval != "confidence":
        return HausmanTest(method, efficient, reason="its intervals hold a prior")
    seen = ~(estimate.undetermined | best.undetermined) & (np.diag(estimate.full_covariance) > 0)
    if not seen.any():
        return HausmanTest(method, efficient, reason="nothing is determined by both")
    covariance = estimate.full_covariance[np.ix_(seen, seen)]
    size = np.sqrt(np.diag(covariance))
    gap = (covariance - best.full_covariance[np.ix_(seen, seen)]) / np.outer(size, size)
    # Where both are almost equally sure, the tiny difference is one of estimated weights, not of fits.
    test = hypothesis_tests.hausman((estimate.solution - best.solution)[seen] / size, gap, smallest=_SMALLEST_GAP)
    if test.lowest < -_SMALLEST_GAP:
        return HausmanTest(method, efficient, reason=f"it claims to be surer than {efficient} in some direction")
    if not test.degrees:
        return HausmanTest(method, efficient, reason=f"it is as efficient as {efficient}: there is nothing to test")
    return HausmanTest(method, efficient, test.statistic, test.degrees, test.probability)


def nominal_estimates(problem: Problem, weights: Weights) -> list[tuple[str, Problem, Estimate]]:
    """The nominal model as it is, and if it has effects with these fitted to the data, each with a line on what it is.

    Each with its own problem, for readings are linearised at the nominal links, and without a fit at the values that are stated.
    The fit of effects weights every channel by the noise of ``weights``.
    """
    plain, robot = _as_stated(problem), problem.experiment.robot
    point, links = plain.row_model.point, robot.nominal.ravel()
    if point is None:
        values, _ = starting_point(plain.row_model.effects, plain.experiment.effect_values, robot.joint_names)
        if offset := weight_columns(plain.row_model):
            values[offset] += absorbed_offset(plain.row_model.base, links)[: len(offset)]
    else:
        values = point.values[point.free]
    out = [("nominal", "the nominal model as it is, nothing fitted", plain, values)]
    if problem.regression.effect_names:
        fitted = _at_nominal(problem)
        factor = reduce_scaled(fitted.regression.rows, {group: 1.0 / model.std for group, model in weights.noise.items()})
        base = fitted.row_model.base
        rest = factor.target - factor.matrix[:, : base.rank] @ (base.matrix @ links)
        effects = linalg.solve(factor.matrix[:, base.rank :], rest)
        out.append(("nominal + effects", "nominal links; only effects such as offsets and friction are fitted", fitted, effects))
    return [(text, own, _not_fitted(name, own, values, weights)) for name, text, own, values in out]


def _as_stated(problem: Problem) -> Problem:
    """The problem with the effects of which values are stated, linearised there; the same where all effects are columns alone."""
    row_model, experiment = problem.row_model, problem.experiment
    if row_model.point is None:
        return problem
    values = {}
    for e in row_model.effects:
        if given := stated_of(e, experiment.effect_values, experiment.robot.joint_names):
            values[e.spec] = {**{q.name: 0.0 for q in e.quantities if q.linear}, **given}
    return prepare(replace(experiment, effect_values=values), replace(problem.options, effects=list(values)))


def _at_nominal(problem: Problem) -> Problem:
    """The problem linearised at the nominal links, where it is linearised at all."""
    row_model, links = problem.row_model, problem.experiment.robot.nominal
    if row_model.point is None:
        return problem
    absorbed, values = absorbed_offset(row_model.base, links), row_model.point.values.copy()
    for effect, places in with_places(row_model.effects):
        if effect.absorbs_weight:
            values[places] += absorbed - row_model.point.absorbed
    base = row_model.base.matrix @ links.ravel()
    return relinearised(problem, replace(row_model.point, links=links, base=base, values=values, absorbed=absorbed))


def _not_fitted(name: str, problem: Problem, effects: np.ndarray, weights: Weights) -> Estimate:
    """The nominal links and these values of effects as an estimate."""
    base, links = problem.row_model.base, problem.experiment.robot.nominal.ravel()
    nothing = np.zeros(base.rank + len(effects), bool)
    return Estimate(
        method=name, base=base, effect_names=problem.regression.effect_names, effect_units=problem.regression.effect_units,
        solution=np.append(base.matrix @ links, effects), full_covariance=None, undetermined=nothing, weak=nothing,
        interval="none", interval_reason="not fitted to these data", noise=weights.noise, rows=0,
        condition_number=np.nan, residual_rms=np.nan, whiteness=np.nan, links=links,
    )  # fmt: skip


@dataclass(frozen=True)
class Agreement:
    """Whether two independent estimates of the same numbers agree."""

    #: What was compared.
    first: str
    second: str
    compared: int  # how many independent numbers both determine
    rms: float  # root mean square of their differences in standard deviations; 1 is expected
    probability: float  # of differences at least as large, if both were right
    worst: str  # the number that differs most, with both values

    @property
    def contradiction(self) -> bool:
        """Whether chance cannot explain the difference."""
        return self.probability < 1e-3

    def to_dict(self) -> dict:
        """The comparison as plain data for JSON."""
        return {**self.__dict__, "contradiction": self.contradiction}


def compare_estimates(first: str, one: Estimate, second: str, other: Estimate) -> Agreement | None:
    """Compare two independent estimates of the same base and effect parameters; None without covariance."""
    if one.full_covariance is None or other.full_covariance is None:
        return None
    mine, theirs = (e.base.names + e.effect_names for e in (one, other))
    places = [(mine.index(name), theirs.index(name)) for name in mine if name in theirs]
    places = [(i, j) for i, j in places if not (one.undetermined[i] or other.undetermined[j])]
    held = [np.zeros(0) if e.base.absorbed is None else e.base.absorbed for e in (one, other)]
    if held[0].shape != held[1].shape or not np.allclose(held[0], held[1]):  # offsets with other weight in them
        places = [(i, j) for i, j in places if not mine[i].startswith("sensor_offset@")]
    if not places:
        return None
    a, b = np.transpose(places)
    covariance = one.full_covariance[np.ix_(a, a)] + other.full_covariance[np.ix_(b, b)]
    labels = [(one.base.labels + one.effect_names)[i] for i in a]
    return _judge(first, second, covariance, labels, one.solution[a], other.solution[b])


def _judge(first, second, covariance, labels, left, right) -> Agreement | None:
    size, difference = np.sqrt(np.diag(covariance)), left - right
    test = hypothesis_tests.hausman(difference, covariance, size, 1e-9)
    if not test.degrees:
        return None
    worst = int(np.argmax(np.abs(difference / size)))
    return Agreement(
        first=first,
        second=second,
        compared=test.degrees,
        rms=float(np.sqrt(test.statistic / test.degrees)),
        probability=test.probability,
        worst=f"{labels[worst]}: {left[worst]:.4g} against {right[worst]:.4g} ({abs(difference[worst] / size[worst]):.1f} sigma)",
    )


#: Estimates from single motions by their names; None where a motion cannot be fitted alone.
Alone = Mapping[str, Estimate | None]


def fits_alone(problem: Problem, method: str | Estimator, motions: Iterable[str]) -> Alone:
    """Fit each of these motions by itself."""
    return {name: _fit_of(problem, method, [name]) for name in motions if problem.segments[name]}


def _fit_of(problem: Problem, method: str | Estimator, motions: Sequence[str]) -> Estimate | None:
    moves = any(not segment.poses for name in motions for segment in problem.segments[name])
    try:
        if problem.at_rest and moves:  # its parameters are those of poses, without inertias
            options = replace(problem.options, motions=motions, bandwidth=None)
            return fit(prepare(problem.experiment, options).regression, method)
        return fit(restrict(problem, motions).regression, method)
    except (BayesidError, ArithmeticError, np.linalg.LinAlgError):
        return None


def motions_apart(problem: Problem, estimate: Estimate, method: str | Estimator, made: Alone | None = None) -> list[Agreement]:
    """Fit every motion by itself and compare it with the estimate from all fitted motions but it.

    Validation motions take part, too; nothing that is estimated depends on what comes out. ``made`` are fits of single motions
    that are there already.
    """
    alone = dict(made or {})

    def compared(name: str) -> Agreement | None:
        rest = [n for n in problem.fitted if n != name]
        if not problem.segments[name] or not rest:
            return None
        one = alone[name] if name in alone else _fit_of(problem, method, [name])
        others = estimate if len(rest) == len(problem.fitted) else _fit_of(problem, method, rest)
        if one is None or others is None:
            return None
        return compare_estimates(f"motion {name}", one, f"motion{'s' * (len(rest) > 1)} {', '.join(rest)}", others)

    return [agreement for agreement in in_order(compared, problem.segments) if agreement is not None]


def wrench_against_torque(problem: Problem, method: str | Estimator) -> Agreement | None:
    """Compare the torque's base parameters with those that the wrench implies.

    The wrench never sees friction, and its base parameters contain the torque's.
    """
    experiment = problem.experiment
    options = replace(problem.options, effects=[e.spec for e in problem.row_model.effects], static="joint")
    wrench, torque = (solve(prepare(experiment, replace(options, channel=c)), method)[1] for c in ("wrench", "torque"))
    if wrench.full_covariance is None or wrench.covariance is None or torque.covariance is None:
        return None
    full = structural_base(experiment.robot, make_channels(experiment, "torque"), at_rest=problem.at_rest)
    # Rows of K_torque as combinations of K_wrench.
    relation, inside = spanned(full.matrix, wrench.base.matrix)
    hidden = linalg.unshown(wrench.full_covariance, wrench.undetermined)[: wrench.base.rank]
    inside &= ~(linalg.takes(relation, hidden) | torque.undetermined[: torque.base.rank])
    implied = (relation @ wrench.values)[inside]
    covariance = (relation @ wrench.covariance @ relation.T + torque.covariance)[np.ix_(inside, inside)]
    labels = [label for label, ok in zip(torque.base.labels, inside, strict=True) if ok]
    return _judge("wrench", "torque", covariance, labels, implied, torque.values[inside])


def static_both_ways(problem: Problem, method: str | Estimator) -> Estimate | None:
    """The estimate with the stop-and-go run fitted along instead of subtracted, where there is one."""
    if problem.static != "motion":
        return None
    effects = [e.spec for e in problem.row_model.effects if not e.estimated_without_static_run]
    return solve(prepare(problem.experiment, replace(problem.options, effects=effects, static="joint")), method)[1]
