"""What an estimate does not know because a shape of an effect was held where its fit stopped.

Shapes h that a fit runs away with are held (`bayesid.estimators.nonlinear`), and all else is fitted beside them. To first order
the others follow a shape by ``-S``, ``S = A_oo^-1 A_oh`` of the normal matrix A, and the shapes themselves have the variance

    V = (A_hh - A_ho A_oo^-1 A_oh + P)^-1,

P that of any value within what is plausible, ``12 / (high - low)^2`` each: so the covariance of the others has ``S V S'`` more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.estimators.estimator import Estimate
from bayesid.estimators.least_squares import LeastSquaresDetails, likelihood_weights, weighted_factor
from bayesid.estimators.weights import learn_weights
from bayesid.regression.linalg import UNSEEN, or_one, solve
from bayesid.regression.problem import Problem, relinearised

#: Share of the most certain combination of shapes below which one is not known at all.
_NOTHING = 1e-12


def with_held_shapes(problem: Problem, estimate: Estimate) -> Estimate:
    """The estimate of a problem linearised there, with its `Estimate.held_covariance` where a shape is held."""
    point, rank = problem.row_model.point, problem.row_model.base.rank
    if point is None or point.unsettled is None or estimate.full_covariance is None:
        return estimate
    details, free = estimate.details, point.free | point.unsettled
    weights = learn_weights(problem.regression)
    kind = details.weights if isinstance(details, LeastSquaresDetails) else likelihood_weights(weights)
    released = relinearised(problem, replace(point, free=free, unsettled=None))
    matrix = weighted_factor(released.regression, weights, kind)[0].matrix
    held = np.append(np.zeros(rank, bool), point.unsettled[free])
    others, shapes = matrix[:, ~held], matrix[:, held]
    slope = solve(others, shapes, UNSEEN)
    left = shapes - others @ slope
    low, high = (np.concatenate([getattr(e, side) for e in problem.row_model.effects]) for side in ("lower", "upper"))
    certain = left.T @ left / (details.dispersion or 1.0) + np.diag(12.0 / (high - low)[point.unsettled] ** 2)
    size = or_one(np.sqrt(np.diag(certain)))
    # What changes no reading and may be anything, as the rest of a spring without stiffness, moves no other value.
    variance = np.linalg.pinv(certain / np.outer(size, size), rcond=_NOTHING, hermitian=True) / np.outer(size, size)
    return replace(estimate, held_covariance=slope @ variance @ slope.T)
