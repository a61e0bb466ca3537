"""Estimators: each takes a regression and gives an estimate with the covariance that belongs to it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from difflib import get_close_matches

from bayesid.errors import InputError
from bayesid.estimators.conic.bounds import Bounds, load_bounds
from bayesid.estimators.conic.physical import Physical
from bayesid.estimators.details import Details, OwnDetails
from bayesid.estimators.errors_in_variables import TotalLeastSquares
from bayesid.estimators.estimator import Estimate, Estimator
from bayesid.estimators.instrumental_variables import InstrumentalVariables
from bayesid.estimators.least_squares import LeastSquares, Ridge, TruncatedSVD
from bayesid.estimators.robust.m_estimators import Huber, Student
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
        No estimator has this name, or it takes no prior.
    """
    chosen = estimator(method)
    if prior is not None:
        if not (is_dataclass(chosen) and "prior" in (f.name for f in fields(chosen))):
            takes = [name for name, other in METHODS.items() if hasattr(other, "prior")]
            raise InputError(f"method '{chosen.name}' takes no prior; leave it out, or choose {' or '.join(takes)}")
        chosen = replace(chosen, prior=prior)
    return chosen.fit(regression)


__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "Bounds",
    "Details",
    "Estimate",
    "Estimator",
    "Huber",
    "InstrumentalVariables",
    "LeastSquares",
    "OwnDetails",
    "Physical",
    "Ridge",
    "Student",
    "TotalLeastSquares",
    "TruncatedSVD",
    "estimator",
    "fit",
    "load_bounds",
]
