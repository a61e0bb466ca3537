"""Robust estimators, for recordings with contacts and impacts: Huber's loss and Student's t.

Both are reweighted least squares (`bayesid.estimators.robust.reweighting`) and differ in their losses
(`bayesid.estimators.robust.losses`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from bayesid.errors import InputError
from bayesid.estimators.details import Details
from bayesid.estimators.estimator import Estimate
from bayesid.estimators.robust.losses import WHOLE, HuberLoss, StudentLoss
from bayesid.estimators.robust.reweighting import RobustFit
from bayesid.regression.regression import Regression

_FIRST_NU = 4.0


@dataclass(frozen=True, kw_only=True)
class RobustDetails(Details):
    """What both robust estimators say.

    Attributes
    ----------
    rule
        Where the loss's parameter is from.
    scale
        Of the residuals, in units of the noise.
    rejected_share
        Of all rows.
    rejected_windows
        Times of the first and the last row of each rejected window, by recording [s].
    mean_weight_of_accepted_rows, rows_per_segment, iterations
        Of the fit; the number of rows is ``rows_per_stretch`` in ``estimate.json``.
    diverged, divergence
        Whether the fit cannot be right, and why.
    """

    rule: str
    scale: float
    rejected_share: float
    rejected_windows: dict[str, list[list[float]]]
    mean_weight_of_accepted_rows: float
    rows_per_segment: int = field(metadata={"key": "rows_per_stretch"})
    iterations: int
    diverged: bool
    divergence: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class HuberDetails(RobustDetails):
    """The constant of Huber's loss for one row of all channels, and its efficiency relative to least squares."""

    constant: float
    efficiency_for_normal_noise: float


@dataclass(frozen=True, kw_only=True)
class StudentDetails(RobustDetails):
    """Degrees of freedom of Student's t."""

    nu: float


@dataclass(frozen=True)
class Huber:
    """Huber's loss on segments of rows.

    Attributes
    ----------
    constant
        Mahalanobis length of one row of all channels from which on the loss grows linearly; segments of several rows have
        the length that is as rare. None: 95 % of normal segments keep their whole weight. Infinity: `wls`.
    """

    name: str = "huber"
    constant: float | None = None

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with the sandwich covariance of these weights."""
        channels = len(regression.channel_names)
        if self.constant is not None and not self.constant > 0:
            raise InputError(f"huber constant = {self.constant}: give a positive length; a row of {channels} channels has about "
                             f"{np.sqrt(channels):.2g}")  # fmt: skip
        rare = 1.0 - WHOLE if self.constant is None else float(chi2.sf(self.constant**2, channels))
        loss = HuberLoss(rare)
        fit = RobustFit.of(regression, loss)
        typical = float(np.median(fit.n[fit.n > 0]))
        made = fit.estimate(self.name)
        details = HuberDetails(
            **fit.details(),
            constant=float(np.sqrt(chi2.isf(rare, channels))),
            rule="95 % of normal segments keep their whole weight" if self.constant is None else "as given",
            efficiency_for_normal_noise=loss.efficiency(typical),
            warnings=fit.warnings(self.name),
        )
        return replace(made, details=details)


@dataclass(frozen=True)
class Student:
    """Student's t likelihood of segments of rows, with unknown scale.

    Attributes
    ----------
    nu
        Degrees of freedom. None: of largest likelihood, between 1 and 1000. Infinity: `wls`.
    """

    name: str = "student"
    nu: float | None = None

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with the sandwich covariance of these weights."""
        if self.nu is not None and not self.nu > 0:
            raise InputError(f"student nu = {self.nu}: give positive degrees of freedom, or none to have them estimated")
        fit = RobustFit.of(regression, StudentLoss(_FIRST_NU, True) if self.nu is None else StudentLoss(self.nu))
        assert isinstance(fit.loss, StudentLoss)
        rule = "largest likelihood of all segments" if self.nu is None else "as given"
        details = StudentDetails(**fit.details(), nu=fit.loss.nu, rule=rule, warnings=fit.warnings(self.name))
        return replace(fit.estimate(self.name), details=details)
