"""The data's side of a prior-predictive check (`bayesid.estimators.prior_check`), for every estimator and the posterior."""

from __future__ import annotations

from bayesid.estimators.conic.links import compressed
from bayesid.estimators.conic.physical import PhysicalDetails, evidence_of
from bayesid.estimators.covariance import covariance_middle
from bayesid.estimators.estimator import Estimate
from bayesid.estimators.least_squares import likelihood_weights, weighted_factor
from bayesid.estimators.prior_check import Evidence, PriorCheck, compared
from bayesid.estimators.weights import learn_weights
from bayesid.regression.linalg import undetermined
from bayesid.regression.regression import Regression
from bayesid.robot.prior import Prior


def against_prior(regression: Regression, prior: Prior, rel_std: float | None = None) -> PriorCheck | None:
    """Check a prior of the links against what the rows say by themselves; None where they determine nothing."""
    return compared(regression.base, of_data(regression), prior.mean, prior.root, rel_std)


def against_nominal(regression: Regression, estimate: Estimate) -> PriorCheck | None:
    """Check an estimate's data against its prior, or against nominal links with a stated deviation; None without either."""
    details, known = estimate.details, regression.knowledge
    if not known.states_masses:
        return None
    if isinstance(details, PhysicalDetails):
        return details.prior.check
    if known.nominal_links is None or not known.inertia_rel_std:
        return None
    prior, covariance = Prior.warped(known.nominal_links, known.inertia_rel_std), estimate.covariance
    evidence = of_data(regression) if covariance is None else (estimate.values, covariance, estimate.undetermined)
    return compared(regression.base, evidence, prior.mean, prior.root, known.inertia_rel_std)


def of_data(regression: Regression) -> Evidence:
    """Base parameters by the likelihood alone (r,), their covariance (r, r), and which the rows do not determine (r,).

    Weighted as `sdp` and the posterior do: by the noise where the model is complete, else by channel, and then with the
    scatter between parts of the recording in the covariance.
    """
    learned = learn_weights(regression)
    factor, scale = weighted_factor(regression, learned, likelihood_weights(learned))
    middle = covariance_middle(regression, learned, scale, factor)
    matrix, target = compressed(factor.matrix, factor.target, middle.matrix)
    return evidence_of(matrix, target, undetermined(factor.matrix), regression.base.rank)
