"""Whether data and prior can both be right: a prior-predictive check of the base parameters [Box1980]_.

With b the data's own estimate of the determined base parameters and V its covariance, links ``phi ~ N(mean, C)`` beforehand
and ``b_prior = K mean``, both being right means

    d = b - b_prior ~ N(0, V + K C K'),   d' (V + K C K')^-1 d ~ chi2(number of base parameters).

The normal law leaves out that bodies must be able to exist, which hardly matters up to a relative standard deviation of 0.3.

Where they contradict each other, one of the two spreads is wrong. That of the data is measured; the prior's is a statement, so
the prior is widened by the factor k >= 1 that makes the data most probable [Good1965]_:

    k = argmax  log N(d; 0, V + k^2 K C K').

Every verb and estimator asks `compared`, so that a conflict has one size; `bayesid.estimators.conic.physical` brings the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import fminbound
from scipy.stats import chi2

from bayesid.arguments import argument, call
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.regression.linalg import correlations, pseudo_inverse, standard_deviations

#: Prior and data contradict each other where a distance like theirs is less probable than this.
CONFLICT = 1e-3
#: Largest factor that a prior is widened by.
_WIDEST = 1e3
#: Coefficients of combinations that are no more than rounding.
_ROUNDING = 1e-9
#: Base parameters by the data (r,), their covariance (r, r), and which of them the data say nothing about (r,) or more.
Evidence = tuple[np.ndarray, np.ndarray, np.ndarray]
_WORDS = {"m": "mass", "mcx": "first moment along x", "mcy": "first moment along y", "mcz": "first moment along z"}


@dataclass(frozen=True)
class PriorDisagreement:
    """One base parameter as the prior and as the data have it, each with its standard deviation."""

    #: ``mass of link2``, or the combination's label; its unit.
    label: str
    unit: str
    #: [unit].
    prior: float
    prior_std: float
    data: float
    data_std: float

    @property
    def prior_sigmas(self) -> float:
        """How far the data's value is from the prior's, in standard deviations of the prior."""
        return abs(self.data - self.prior) / self.prior_std

    @property
    def sigmas(self) -> float:
        """The same in standard deviations of the difference, which counts both."""
        return abs(self.data - self.prior) / np.hypot(self.data_std, self.prior_std)


@dataclass(frozen=True)
class PriorCheck:
    """How far the data are from the prior, and how probable that is where both are right."""

    distance: float  # joint distance, root of ``d' (V + K C K')^-1 d``
    base_parameters: int  # how many were compared
    probability: float  # of a distance at least as large
    largest: PriorDisagreement  # the base parameter that is furthest off, by the standard deviation of the difference
    rel_std: float | None = None  # relative standard deviation of the nominal links; None with a prior of one's own
    #: Whether it was stated beforehand; otherwise the data chose it, and do not fit even so where they contradict it.
    stated: bool = True
    #: Where a stated prior and the data contradict each other, the factor of all its standard deviations that makes the data
    #: most probable, and that `sample` widens it by; else 1.
    widening: float = 1.0

    @property
    def conflict(self) -> bool:
        """Whether prior and data contradict each other."""
        return self.probability < CONFLICT

    def text(self) -> str:
        """What is said where they do."""
        one, chance = self.largest, "below 1e-12" if self.probability < 1e-12 else f"{self.probability:.2g}"
        stated = "" if self.rel_std is None else f" at a relative standard deviation of {self.rel_std:.3g}"
        chosen = "" if self.stated else ", the one that suits the data best"
        less = f"inertia_rel_std, {argument('prior_std')}"
        wider = ""
        if self.widening > 1.0:
            wider = f"A prior {self.widening:.2g} times as wide makes the data most probable: `{call('sample')}` takes that. "
        remedy = (
            f"{wider}What weighs one against the other is doubtful then. "
            f"Check the readings (`{call('check')}`) and the URDF, look for "
            f"what is missing in the model (`{call('diagnose')}`), or trust the links less ({less})."
        )
        return (
            f"Prior and data contradict each other{stated}{chosen}: {one.label} is {one.prior:.3g} +- {one.prior_std:.2g} "
            f"{one.unit} by the prior and {one.data:.3g} +- {one.data_std:.2g} {one.unit} by the data, {one.prior_sigmas:.3g} "
            f"standard deviations of the prior apart ({one.sigmas:.3g} sigma with the data's own); over all "
            f"{self.base_parameters} base parameters {self.distance:.3g} sigma (chance {chance} if both are right). {remedy}"
        )

    def brief(self) -> str:
        """The figures alone, for the list of what was done."""
        verdict = "they contradict each other" if self.conflict else "no contradiction"
        return (
            f"{self.distance:.3g} sigma apart over {self.base_parameters} base parameters, probability "
            f"{self.probability:.2g}: {verdict}"
        )

    def to_dict(self) -> dict[str, Any]:
        """``prior_against_data`` in ``estimate.json`` and ``posterior.json``."""
        one = self.largest
        return {
            "conflict": self.conflict,
            "probability": self.probability,
            "sigma": self.distance,
            "base_parameters": self.base_parameters,
            "rel_std": self.rel_std,
            "rel_std_stated": self.stated,
            "widening": self.widening,
            "largest": {**one.__dict__, "prior_sigmas": one.prior_sigmas, "sigmas": one.sigmas},
        }


def conflicts(check: PriorCheck | None) -> list[str]:
    """What is said before anything else: that prior and data contradict each other, where they do."""
    return [check.text()] if check is not None and check.conflict else []


def compared(
    base: BaseParameters,
    evidence: Evidence,
    mean: np.ndarray,
    root: np.ndarray,
    rel_std: float | None = None,
    *,
    stated: bool = True,
) -> PriorCheck | None:
    """Compare an estimate of the data alone with a prior; None where there is nothing to compare.

    ``evidence`` holds base parameters by the data (r,), their covariance (r, r), and which of them the data say nothing about
    (r,) or more. The prior of the links has a mean (P,) and a root W with ``W'W`` its precision (q, P), with zero columns where
    it says nothing.
    """
    values, covariance, undetermined = evidence
    known = np.linalg.norm(root, axis=0) > 0
    reaches = np.all((np.abs(base.matrix) <= _ROUNDING) | known, axis=1)  # of links that the prior speaks of alone
    k = np.flatnonzero(~undetermined[: base.rank] & reaches)
    if not len(k):
        return None
    rows = base.matrix[k]
    half = rows[:, known] @ pseudo_inverse(root[:, known])
    prior, spread = rows @ mean, half @ half.T
    difference, total = values[k] - prior, covariance[np.ix_(k, k)] + spread
    size, spreads, directions = correlations(total)  # in other directions, neither says anything
    z, white = difference / size, (directions / np.sqrt(spreads)).T
    squared = float(np.sum((white @ z) ** 2))
    probability = float(chi2.sf(squared, len(white)))
    widening = 1.0
    if stated and probability < CONFLICT:
        widening = _most_probable_widening(white @ z, white @ (spread / np.outer(size, size)) @ white.T)
    worst = int(np.argmax(np.abs(z)))
    at = int(k[worst])
    return PriorCheck(
        distance=squared**0.5,
        base_parameters=len(k),
        probability=probability,
        largest=PriorDisagreement(
            _words(base, at), base.units[at], float(prior[worst]), float(standard_deviations(spread)[worst]),
            float(values[at]), float(standard_deviations(covariance)[at]),
        ),
        rel_std=rel_std,
        stated=stated,
        widening=widening,
    )  # fmt: skip


def _most_probable_widening(difference: np.ndarray, share: np.ndarray) -> float:
    """The factor k of the prior's standard deviations, in coordinates where data and prior together have unit covariance.

    There the prior's part S (n, n) of the covariance makes it ``1 - S + k^2 S`` for any other k, and the eigenvectors stay.
    """
    values, vectors = np.linalg.eigh(share)
    squares = (vectors.T @ difference) ** 2

    def cost(log_factor: float) -> float:
        variances = 1.0 + np.expm1(2.0 * log_factor) * np.clip(values, 0.0, 1.0)
        return float(np.sum(np.log(variances) + squares / variances))

    # Of one hump for one direction; for several, the best of a grid is on the right one.
    grid = np.linspace(0.0, np.log(_WIDEST), 60)
    best = int(np.argmin([cost(x) for x in grid]))
    found = float(fminbound(cost, grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], full_output=True)[0])
    return float(np.exp(found)) if cost(found) < cost(0.0) else 1.0


def _words(base: BaseParameters, k: int) -> str:
    """``mass of link2`` where a base parameter is one of one link, else its label."""
    link, _, kind = base.names[k].rpartition(".")
    if np.count_nonzero(np.abs(base.matrix[k]) > _ROUNDING) > 1 or not link:
        return base.labels[k]
    return f"{_WORDS.get(kind, kind)} of {link}"
