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
    point, rank = problem.row_model.point, problem.row_model.base.rank
    if point is None or estimate.full_covariance is None or not isinstance(estimator(method), COVARIANCE_ALONE):
        return estimate
    effects = problem.row_model.effects
    soft = np.concatenate([np.full(len(e.parameters), e.amplifies_encoder_errors) for e in effects])[point.free]
    if not soft.any():
        return estimate
    regression, weights, details = problem.regression, learn_weights(problem.regression), estimate.details
    kind = details.weights if isinstance(details, LeastSquaresDetails) else likelihood_weights(weights)
    factor, scale = weighted_factor(regression, weights, kind)
    lost = right_side_lost(regression, weights, scale)
    lost[:rank] = 0.0
    lost[rank:] *= soft
    error = -factor.inverse @ (factor.inverse.T @ lost)
    error[:rank] = 0.0
    # A value stays within what is possible.
    low, high = (np.concatenate([getattr(e, side) for e in effects])[point.free] for side in ("lower", "upper"))
    values = estimate.solution[rank:]
    error[rank:] = np.where(soft, values - np.clip(values - error[rank:], np.minimum(low, values), np.maximum(high, values)), 0.0)
    return replace(estimate, expected_error=error)
