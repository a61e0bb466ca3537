"""Estimators: each takes a regression and gives an estimate with the covariance that belongs to it."""

from __future__ import annotations

import warnings
from dataclasses import fields, is_dataclass, replace

import numpy as np
from scipy.stats import chi2

from bayesid.argument_types import explains_types
from bayesid.errors import BayesidWarning, EstimationError, InputError, did_you_mean
from bayesid.estimators.conic.physical import Physical
from bayesid.estimators.errors_in_variables import InstrumentalVariables, TotalLeastSquares
from bayesid.estimators.estimator import Estimate, Estimator
from bayesid.estimators.factor import pilot_of
from bayesid.estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from bayesid.estimators.robust.m_estimators import Huber, Student
from bayesid.estimators.weights import learn_weights
from bayesid.regression.regression import Regression
from bayesid.robot.prior import Prior

#: Estimators by the names that the command line and `fit` understand.
METHODS: dict[str, Estimator] = {
    "ols": LeastSquares("ols", "none"),
    "wls": LeastSquares("wls", "channel"),
    "gls": LeastSquares("gls", "noise"),
    "ridge": Ridge(),
    "tsvd": TruncatedSVD(),
    "tls": TotalLeastSquares(),
    "iv": InstrumentalVariables(),
    "huber": Huber(),
    "student": Student(),
    "sdp": Physical(),
}
DEFAULT_METHOD = "wls"
#: Residuals less likely than this under the noise that was stated contradict it.
UNLIKELY = 1e-4


@explains_types
def estimator(method: str | Estimator) -> Estimator:
    """The estimator of a name; an object that follows the interface is returned as it is.

    Raises
    ------
    InputError
        No estimator has this name, or the object has no name or no ``fit``.
    """
    if isinstance(method, type):
        raise InputError(f"method {method.__name__} is a class: pass one of it, {method.__name__}(...)")
    if not isinstance(method, str):
        lacks = [] if isinstance(getattr(method, "name", None), str) else ['a name: write name = "my-estimator" into its class']
        lacks += [] if callable(getattr(method, "fit", None)) else ["fit(regression) that returns a bayesid.Estimate"]
        if lacks:
            raise InputError(f"method {type(method).__name__} is no estimator: it lacks {' and '.join(lacks)}")
        return method
    if method not in METHODS:
        raise InputError(f"method '{method}' is unknown; {did_you_mean(method, METHODS)}")
    return METHODS[method]


@explains_types
def fit(regression: Regression, method: str | Estimator = DEFAULT_METHOD, prior: Prior | None = None) -> Estimate:
    """Estimate the parameters of a regression.

    Parameters
    ----------
    regression
        From an experiment or from `Regression.from_arrays`.
    method
        A name of `METHODS`, or an object with ``fit(regression) -> Estimate``.
    prior
        Replaces what the regression says about the nominal model, for estimators with a field ``prior``.

    Raises
    ------
    InputError
        No estimator has this name, it takes no prior, or the regression is none.
    EstimationError
        An estimator of one's own returns no `Estimate`, or one without a finite solution.
    """
    if not isinstance(regression, Regression):
        given = type(regression).__name__
        raise InputError(f"fit: a {given} is given for the regression; for an experiment or its folder take bayesid.identify")
    chosen = estimator(method)
    if prior is not None:
        if not (is_dataclass(chosen) and "prior" in (f.name for f in fields(chosen))):
            takes = [name for name, other in METHODS.items() if hasattr(other, "prior")]
            raise InputError(f"method '{chosen.name}' takes no prior; leave it out, or choose {' or '.join(takes)}")
        chosen = replace(chosen, prior=prior)
    estimate = chosen.fit(regression)
    _require_estimate(chosen, estimate, regression)
    doubt = _stated_noise_doubted(regression, estimate)
    if doubt:
        warnings.warn(f"{chosen.name}: {doubt}", BayesidWarning, stacklevel=2)
        estimate = replace(estimate, details=replace(estimate.details, warnings=(*estimate.details.warnings, doubt)))
    return estimate


def _require_estimate(method: Estimator, estimate: object, regression: Regression) -> None:
    """Refuse what an estimator of one's own returns, where it is no estimate of this regression."""
    if not isinstance(estimate, Estimate):
        raise EstimationError(
            f"method '{method.name}': fit returned a {type(estimate).__name__}, not a bayesid.Estimate; change one that another "
            'estimator made, as in dataclasses.replace(bayesid.fit(regression, "wls"), solution=...)'
        )
    count = len(regression.column_names)
    if np.shape(estimate.solution) != (count,) or not np.isfinite(estimate.solution).all():
        got = f"of shape {np.shape(estimate.solution)}" if np.shape(estimate.solution) != (count,) else "that is not finite"
        raise EstimationError(f"method '{method.name}': gave a solution {got}; it needs {count} finite numbers, one a parameter")


def _stated_noise_doubted(regression: Regression, estimate: Estimate) -> str:
    """What to say where residuals contradict the noise that was stated; empty where they do not, or none was."""
    if regression.noise_std is None:
        return ""
    efficient = pilot_of(regression.rows).whitened(learn_weights(regression).noise)
    degrees = efficient.rows - len(estimate.solution)
    if degrees <= 0:  # no residuals are left
        return ""
    # Of the efficient fit, whose residuals are the smallest; but not of outliers that this estimator leaves out.
    square = min(efficient.least_squares, degrees * estimate.residual_rms**2)
    ratio = f"{(square / degrees) ** 0.5:.3g} times the stated noise_std"
    if chi2.sf(square, degrees) < UNLIKELY:
        return (
            f"residuals are {ratio}: the model misses something, and intervals do not cover it, or the noise is larger; complete "
            "the model, correct noise_std, or leave it out to have noise and model error estimated from the residuals"
        )
    if chi2.cdf(square, degrees) < UNLIKELY:
        return f"residuals are {ratio}, so intervals are too long; correct noise_std, or leave it out"
    return ""
