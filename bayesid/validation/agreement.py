"""How far estimates from the same rows lie apart, and whether the noise explains it.

Such estimates are correlated: their difference is not as large as both intervals together say. So differences are
given in one stated unit, and tested only against the efficient estimate, where the covariance of the difference is known.

The nominal model, its effects fitted or not, is the yardstick for every estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.estimators import Estimate
from bayesid.estimators.factor import reduce_scaled
from bayesid.estimators.weights import SMALLEST_AGREEMENT, Weights
from bayesid.regression import hypothesis_tests
from bayesid.regression.linalg import solve
from bayesid.regression.problem import Problem, weight_columns

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


def nominal_estimates(problem: Problem, weights: Weights) -> list[tuple[str, Estimate]]:
    """The nominal model as it is, and if it has effects with these fitted to the data, each with a line on what it is.

    The fit of effects weights every channel by the noise of ``weights``.
    """
    robot, base, regression = problem.experiment.robot, problem.row_model.base, problem.regression
    links, names = robot.nominal.ravel(), regression.effect_names
    values = problem.experiment.effect_values
    effects = np.zeros(len(names))
    for k, name in enumerate(names):
        spec, _, parameter = name.rpartition(".")
        given = {**values.get(spec.partition("@")[0], {}), **values.get(spec, {})}
        effects[k] = given.get(parameter, 0.0)
    offset = weight_columns(problem.row_model)
    if base.absorbed is not None and offset:  # that column also holds the weight that looks like an offset
        effects[offset] += base.absorbed[: len(offset)] @ links
    nominal = base.matrix @ links
    out = [("nominal", "the nominal model as it is, nothing fitted", effects)]
    if names:
        factor = reduce_scaled(regression.rows, {group: 1.0 / model.std for group, model in weights.noise.items()})
        rest = factor.target - factor.matrix[:, : base.rank] @ nominal
        fitted = solve(factor.matrix[:, base.rank :], rest)
        out.append(("nominal + effects", "nominal links; only effects such as offsets and friction are fitted", fitted))
    nothing = np.zeros(base.rank + len(names), bool)
    return [
        (
            text,
            Estimate(
                method=name, base=base, effect_names=names, effect_units=regression.effect_units,
                solution=np.append(nominal, values), full_covariance=None, undetermined=nothing, weak=nothing,
                interval="none", interval_reason="not fitted to these data", noise=weights.noise, rows=0,
                condition_number=np.nan, residual_rms=np.nan, whiteness=np.nan, links=links,
            ),
        )
        for name, text, values in out
    ]  # fmt: skip
