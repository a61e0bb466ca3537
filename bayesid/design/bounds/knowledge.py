"""What is known of a robot after a posterior or an estimate, in one form: the start of every bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.design.bounds.consistent import LinkDraws, consistent_draws
from bayesid.design.bounds.region import Region, region_of_draws, region_of_normal
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.effects import Effect
from bayesid.errors import InputError
from bayesid.posterior.result import PRIOR_DRIVEN
from bayesid.regression.problem import Problem
from bayesid.robot.prior import Prior
from bayesid.validation.prediction import TOLERATED

#: Relative standard deviation of masses where nobody says how far the nominal links are trusted: as good as none.
WIDE = 1.0
#: What of a combination of link parameters may lie outside those that are determined, relative to its length.
_OUTSIDE = 1e-4


@dataclass(frozen=True, eq=False)
class Known:
    """A robot as the data leave it.

    Attributes
    ----------
    problem
        Its model, and the motions that were fitted.
    source
        ``posterior`` or ``estimate``.
    method
        The estimator's name; of a posterior its prior.
    mean, covariance
        Base parameters, then the effects that were estimated (p,), (p, p); counted up by ``inflation``.
    draws
        Posterior draws of them (n, p); None: a normal law.
    seen, determined
        Which base parameters the data say anything of, and which they determine better than the size of a body does (r,).
    effect_values
        Of all effects of the model, the fixed ones included (q,).
    links
        Links that can exist.
    centre
        The links that stand for all of them (P,).
    inflation
        Factor of the covariance for held-out motions that are predicted worse than the covariance says; 1: none.
    dispersion
        Factor that the covariance had already for what the model lacks; 1: none.
    trust
        Relative standard deviation of the prior on links; None: one of the user's own.
    """

    problem: Problem
    source: str
    method: str
    mean: np.ndarray
    covariance: np.ndarray
    draws: np.ndarray | None
    seen: np.ndarray
    determined: np.ndarray
    effect_values: np.ndarray
    links: LinkDraws
    centre: np.ndarray
    inflation: float
    dispersion: float
    trust: float | None

    @property
    def base(self) -> BaseParameters:
        """What the base parameters are combinations of."""
        return self.problem.row_model.base

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of the model."""
        return self.problem.row_model.effects

    def parameters(self, seed: int = 0) -> Region:
        """The sets of the identified base parameters."""
        r, base, driven = self.base.rank, self.base, self.prior_driven(self.base)
        if self.draws is not None:
            return region_of_draws(base.names, base.labels, base.units, self.draws[:, :r], driven)
        if self.determined.all():
            mean, covariance = self.mean[:r], self.covariance[:r, :r]
            return region_of_normal(base.names, base.labels, base.units, mean, covariance, np.zeros(r, bool), seed)
        return region_of_draws(base.names, base.labels, base.units, self.links.links @ base.matrix.T, driven)

    def transfer(self, base: BaseParameters) -> tuple[np.ndarray, np.ndarray]:
        """T with ``other base = T identified base`` (k, r), and which of the others the data determine so (k,)."""
        found, inside = self._by(base, self.determined)
        out = np.zeros((base.rank, self.base.rank))
        out[:, self.determined] = found
        return out, inside

    def prior_driven(self, base: BaseParameters) -> np.ndarray:
        """Which of other base parameters the prior drives (k,).

        They are no combination of those that the data say anything of, or draws of them are nearly as wide as the prior's.
        """
        driven = ~self._by(base, self.seen)[1]
        if self.links.prior is None:
            return driven
        spread = (self.links.links @ base.matrix.T).std(axis=0)
        return driven | (spread > PRIOR_DRIVEN * (self.links.prior @ base.matrix.T).std(axis=0))

    def _by(self, base: BaseParameters, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Other base parameters as combinations of some of the identified ones (k, m), and which of them are such (k,)."""
        own = self.base.matrix[kept]
        found = np.linalg.lstsq(own.T, base.matrix.T, rcond=None)[0].T
        outside = np.linalg.norm(found @ own - base.matrix, axis=1)
        return found, outside <= _OUTSIDE * np.linalg.norm(base.matrix, axis=1)


def inflation_of(validation: tuple[Mapping[str, Any], ...], dispersion: float) -> tuple[float, str]:
    """How much covariances must grow for held-out motions, and which motion says so.

    The mean square of whitened residuals over what a complete model has, as far as it is beyond chance and beyond the
    dispersion that the covariance counts already.

    Parameters
    ----------
    validation
        ``motion``, ``whitened_rms`` and ``expected_rms`` of each.
    dispersion
        Factor that the covariance has for model error.
    """
    worst, motion = 1.0, ""
    for entry in validation:
        ratio = entry["whitened_rms"] / max(entry["expected_rms"], 1e-300)
        if ratio > max(TOLERATED, worst):
            worst, motion = ratio, str(entry["motion"])
    return max(worst**2 / max(dispersion, 1.0), 1.0), motion


def known_from(
    problem: Problem,
    *,
    source: str,
    method: str,
    mean: np.ndarray,
    covariance: np.ndarray | None,
    undetermined: np.ndarray,
    weak: np.ndarray,
    draws: np.ndarray | None = None,
    link_draws: np.ndarray | None = None,
    prior_draws: np.ndarray | None = None,
    centre: np.ndarray | None = None,
    trust: float | None = None,
    conflict: bool = False,
    inflation: float = 1.0,
    dispersion: float = 1.0,
    count: int = 1000,
    seed: int = 0,
) -> Known:
    """One form for what a posterior or an estimate says.

    Where links were not drawn, or the covariance has to grow, links that can exist are drawn about the mean
    (`bayesid.design.bounds.consistent`).

    Parameters
    ----------
    problem, source, method
        As in `Known`.
    mean, covariance
        Base parameters, then the effects that were estimated (p,), (p, p).
    undetermined, weak
        Which of them the data say nothing of, and little (p,).
    draws, link_draws, prior_draws
        Of the parameters (n, p), of the links behind them (n, P), and of these by the prior alone, where there are any.
    centre
        Links that stand for the estimate (P,); default the mean of the draws.
    trust
        Relative standard deviation of the nominal links; None: what the experiment says, else next to nothing is known.
    conflict
        Whether data and that trust contradict each other: then next to nothing is taken to be known, where none is given.
    inflation, dispersion
        Factors of the covariance, see `Known`.
    count, seed
        Links to draw, and of what generator.

    Raises
    ------
    InputError
        There is no covariance, or nothing is determined.
    """
    if covariance is None:
        raise InputError(
            f"method {method} has no covariance, so nothing can be bounded with it; take another, such as wls, or sample"
        )
    rank = problem.row_model.base.rank
    if undetermined.all():
        raise InputError("these motions determine no parameter, so nothing can be bounded; record other motions")
    covariance = inflation * np.where(np.isfinite(covariance), covariance, 0.0)
    values = np.zeros(len(problem.row_model.free))
    if problem.row_model.point is not None:
        values[:] = problem.row_model.point.values
    values[problem.row_model.free] = mean[rank:]
    trust = trust or (None if conflict else problem.experiment.inertia_rel_std) or WIDE
    if link_draws is None or inflation > 1.0:
        knowledge = problem.regression.knowledge
        nominal = knowledge.guessed_links if knowledge.guessed_links is not None else knowledge.nominal_links
        assert nominal is not None  # of an experiment there always are some
        links = consistent_draws(
            problem.row_model.base, mean, covariance, ~undetermined, np.array(knowledge.effect_non_negative, bool),
            Prior.warped(nominal, trust), count, seed,
        )  # fmt: skip
        if inflation > 1.0:
            draws = None
    else:
        assert draws is not None  # links are drawn with the parameters
        even = np.linspace(0, len(link_draws) - 1, min(count, len(link_draws))).astype(int)
        links = LinkDraws(link_draws[even], draws[even, rank:], prior_draws)
    return Known(
        problem=problem, source=source, method=method, mean=mean, covariance=covariance, draws=draws,
        seen=~undetermined[:rank], determined=~(undetermined | weak)[:rank], effect_values=values, links=links,
        centre=links.links.mean(axis=0) if centre is None else centre,
        inflation=inflation, dispersion=dispersion, trust=trust,
    )  # fmt: skip
