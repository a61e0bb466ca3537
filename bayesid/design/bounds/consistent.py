"""Links that can exist, drawn from an estimate with a covariance.

A covariance of base parameters knows nothing of masses that are positive. So links phi are drawn from

    N(b_hat, V) of their base parameters b = K phi   x   links scaled, shifted and warped by a share s   x   P_i(phi) >= 0,

(`bayesid.robot.prior.Prior.warped`) by the exact reflected trajectories of the posterior. Every draw is a robot that can exist;
what the data determine is as uncertain as the estimate says, cut to what such robots can have; what they do not determine is as
uncertain as the nominal model is stated to be. Effects are drawn along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.design.bounds.simultaneous import root_of
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.posterior.likelihood import Likelihood, ScalePrior
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.reflective_gibbs import ReflectiveGibbs
from bayesid.posterior.run import run
from bayesid.regression.linalg import pseudo_inverse
from bayesid.robot.prior import Prior

#: Draws of the prior that its spread is taken from.
PRIOR_DRAWS = 2000


def prior_links(base: BaseParameters, prior: Prior, count: int, seed: int) -> np.ndarray:
    """Links by a prior alone, its bounds included (count, P)."""
    nothing = Likelihood(np.zeros((1, base.rank + 1, base.rank + 1)), np.zeros(1, int), ("nothing",))
    model = PosteriorModel(base, (), (), np.zeros(0, bool), nothing, prior, scale_prior=ScalePrior(known=True))
    draws = model.prior_draws(count, np.random.default_rng([seed, 7]))
    assert draws is not None  # there is a prior
    return draws


@dataclass(frozen=True, eq=False)
class LinkDraws:
    """Links that can exist."""

    links: np.ndarray  # ten parameters a body (n, P)
    effects: np.ndarray  # effect parameters that go with them (n, e)
    prior: np.ndarray | None  # links by the prior alone, its bounds included (m, P); None where there was none
    complaint: str = ""  # what is doubtful about the draws; empty where nothing is


def consistent_draws(
    base: BaseParameters,
    mean: np.ndarray,
    covariance: np.ndarray,
    determined: np.ndarray,
    non_negative: np.ndarray,
    prior: Prior,
    count: int,
    seed: int,
) -> LinkDraws:
    """Links, and the effects that go with them, within an estimate's uncertainty.

    Parameters
    ----------
    base
        What the first parameters of the estimate are combinations of.
    mean, covariance
        Base parameters, then effects (p,), (p, p).
    determined
        Which of them the data say anything of, alone or in sums (p,); effects without stay at their mean.
    non_negative
        Which effects cannot be negative (e,).
    prior
        Of the links; physical.
    count, seed
        How many draws, and of what generator.
    """
    rank = base.rank
    effects = np.flatnonzero(determined[rank:])
    kept = np.concatenate([np.flatnonzero(determined[:rank]), rank + effects])
    columns = np.concatenate([np.arange(rank), rank + effects])
    inverse = pseudo_inverse(root_of(covariance[np.ix_(kept, kept)]))  # W with W'W = V^-1
    size = len(columns) + 1
    rows = np.zeros((max(size, len(inverse)), size))
    rows[: len(inverse), np.searchsorted(columns, kept)] = inverse
    rows[: len(inverse), -1] = inverse @ mean[kept]
    model = PosteriorModel(
        base, tuple(f"effect {k}" for k in effects), ("",) * len(effects), np.asarray(non_negative, bool)[effects],
        Likelihood(rows[None], np.array([len(inverse)]), ("estimate",)), prior, scale_prior=ScalePrior(known=True),
        effect_std=np.full(len(effects), np.inf),
    )  # fmt: skip
    chains = run(model, ReflectiveGibbs(model), draws=count, seed=seed)
    linear = model.split(chains.draws)[0].reshape(-1, len(model.linear_names))[:count]
    drawn = np.tile(mean[rank:], (len(linear), 1))
    drawn[:, effects] = linear[:, model.link_count :]
    return LinkDraws(
        linear[:, : model.link_count], drawn, prior_links(base, prior, PRIOR_DRAWS, seed),
        "" if chains.diagnosis.passed else chains.diagnosis.complaint(),
    )  # fmt: skip
