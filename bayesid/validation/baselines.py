"""What the nominal model predicts: the yardstick for every estimate."""

from __future__ import annotations

import numpy as np

from bayesid.estimators import Estimate
from bayesid.estimators.factor import factor_of, stacked
from bayesid.estimators.weights import Weights
from bayesid.regression.linalg import solve
from bayesid.regression.problem import Problem, weight_columns


def nominal_estimates(problem: Problem, weights: Weights) -> list[tuple[str, Estimate]]:
    """The nominal model as it is, and with its effects fitted to the data, each with a line on what it is.

    Parameters
    ----------
    problem
        Its rows, nominal links and the effect values that the experiment states.
    weights
        Noise of the rows: the fit of effects weights every channel by it.

    Returns
    -------
    estimates
        Two, or one where the model has no effects.
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
        scale = {group: 1.0 / model.std for group, model in weights.noise.items()}
        factor = regression.rows.total(factor_of(lambda b: b.rows * scale[b.group][:, None]), stacked)
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
