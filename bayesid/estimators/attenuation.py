"""What encoders' errors are expected to pull the values of mounts and soft joints by.

Such a model passes on less of the errors the more it is damped, the stiffer it is. Errors u change predictions by D u and their
derivatives by D' u: residual and derivatives are correlated, and least squares is off by ``-A^-1 m``, ``m = E (D' u)' W'W D u``
(`bayesid.estimators.covariance`), to first order; attenuation in a model that is linear [Fuller1987]_. Of the links, whose
readings make far less of encoders' errors, m is left to the intervals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.estimators import estimator
from bayesid.estimators.covariance import right_side_lost
from bayesid.estimators.estimator import Estimate, Estimator
from bayesid.estimators.least_squares import LeastSquaresDetails, likelihood_weights, weighted_factor
from bayesid.estimators.nonlinear import COVARIANCE_ALONE
from bayesid.estimators.weights import learn_weights
from bayesid.regression.problem import Problem


def with_expected_error(problem: Problem, estimate: Estimate, method: str | Estimator) -> Estimate:
    """The estimate of a problem linearised there, with its `Estimate.expected_error`, where an effect has one.

    None is known of estimators that correct the regressor themselves, or state no covariance.
    """
    if estimate.full_covariance is None or not isinstance(estimator(method), COVARIANCE_ALONE):
        return estimate
    details = estimate.details
    kind = details.weights if isinstance(details, LeastSquaresDetails) else None
    return replace(estimate, expected_error=expected_error(problem, estimate.solution, kind))


def expected_error(problem: Problem, solution: np.ndarray, kind: str | None = None) -> np.ndarray | None:
    """Expected error of a solution (p,) of a problem linearised there, zero but for mounts and soft joints; None without these.

    ``kind`` says how rows were weighted, as in `weighted_factor`; by default as for a likelihood.
    """
    row_model, regression = problem.row_model, problem.regression
    point, rank = row_model.point, row_model.base.rank
    if point is None:
        return None
    soft = np.concatenate([np.full(len(e.parameters), e.amplifies_encoder_errors) for e in row_model.effects])[point.free]
    if not soft.any():
        return None
    weights = learn_weights(regression)
    factor, scale = weighted_factor(regression, weights, kind or likelihood_weights(weights))
    lost = right_side_lost(regression, weights, scale) * np.append(np.zeros(rank), soft)
    error = -factor.inverse @ (factor.inverse.T @ lost)
    # A value stays within what is possible.
    low, high = (np.concatenate([getattr(e, side) for e in row_model.effects])[point.free] for side in ("lower", "upper"))
    values = solution[rank:]
    within = np.clip(values - error[rank:], np.minimum(low, values), np.maximum(high, values))
    return np.append(np.zeros(rank), np.where(soft, values - within, 0.0))


def without_expected_error(draws: np.ndarray, error: np.ndarray | None) -> np.ndarray:
    """Draws (..., k) less an expected error (k,), as much wider as its own size is not known."""
    if error is None:
        return draws
    flat = draws.reshape(-1, draws.shape[-1])
    mean, std = flat.mean(axis=0), flat.std(axis=0)
    wider = np.where(std > 0.0, np.hypot(std, error) / np.where(std > 0.0, std, 1.0), 1.0)
    return mean - error + (draws - mean) * wider
