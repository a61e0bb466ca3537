"""Estimators: each takes a regression and gives an estimate with the covariance that belongs to it."""

from __future__ import annotations

from difflib import get_close_matches

from bayesid.errors import InputError
from bayesid.estimators.estimator import Estimate, Estimator
from bayesid.estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from bayesid.regression import Regression

#: Estimators by the names that the command line and `fit` understand.
METHODS: dict[str, Estimator] = {
    "ols": LeastSquares("ols", "none"),
    "wls": LeastSquares("wls", "channel"),
    "gls": LeastSquares("gls", "noise"),
    "ridge": Ridge(),
    "tsvd": TruncatedSVD(),
}
DEFAULT_METHOD = "wls"


def estimator(method: str | Estimator) -> Estimator:
    """The estimator of a name; an object that follows the interface is returned as it is.

    Raises
    ------
    InputError
        No estimator has this name.
    """
    if not isinstance(method, str):
        return method
    if method not in METHODS:
        close = get_close_matches(method, METHODS, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"choose one of {', '.join(METHODS)}"
        raise InputError(f"method '{method}' is unknown; {hint}")
    return METHODS[method]


def fit(regression: Regression, method: str | Estimator = DEFAULT_METHOD) -> Estimate:
    """Estimate the parameters of a regression.

    Parameters
    ----------
    regression
        From an experiment or from `Regression.from_arrays`.
    method
        A name of `METHODS`, or an object with ``fit(regression) -> Estimate``.

    Raises
    ------
    InputError
        No estimator has this name.
    """
    return estimator(method).fit(regression)


__all__ = ["DEFAULT_METHOD", "METHODS", "Estimate", "Estimator", "LeastSquares", "Ridge", "TruncatedSVD", "estimator", "fit"]
