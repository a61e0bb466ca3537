"""What is known of a robot after a posterior or an estimate, in one form: the start of every bound.

A covariance of base parameters knows nothing of masses that are positive. So links phi that can exist are drawn from

    N(b_hat, V) of their base parameters b = K phi   x   links scaled, shifted and warped by a share s   x   P_i(phi) >= 0,

(`bayesid.robot.prior.Prior.warped`) by the exact reflected trajectories of the posterior. Every draw is a robot that can exist;
what the data determine is as uncertain as the estimate says, cut to what such robots can have; what they do not determine is as
uncertain as the nominal model is stated to be. Effects are drawn along.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.design.bounds.region import Region, region_of_draws, region_of_normal
from bayesid.dynamics.base_parameters import BaseParameters, spanned
from bayesid.errors import InputError
from bayesid.estimators.factor import channel_grams
from bayesid.posterior.likelihood import Likelihood, ScalePrior
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.reflective_gibbs import ReflectiveGibbs
from bayesid.posterior.result import PRIOR_DRIVEN
from bayesid.posterior.run import run
from bayesid.regression.linalg import or_one, pseudo_inverse, root_of
from bayesid.regression.problem import Problem
from bayesid.robot.prior import Prior
from bayesid.robot.urdf import JointDynamics
from bayesid.validation.noise_floor import NoiseFloor

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
    """So many links, and the effects that go with them, within an estimate's uncertainty and a physical prior of the links.

    ``mean`` and ``covariance`` are of base parameters, then effects (p,), (p, p); ``determined`` are those that the data say
    anything of, alone or in sums (p,), effects without stay at their mean; ``non_negative`` effects cannot be negative (e,).
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


#: Relative standard deviation of masses where nobody says how well the nominal links are known: as good as none.
WIDE = 1.0
#: What of a change among effects may be of links, relative to its length.
_OUTSIDE = 1e-4
#: Eigenvalues of the rows' Gram matrix, columns at unit length, that count as none: rounding of a product.
_NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Known:
    """A robot as the data leave it."""

    problem: Problem  # its model, and the motions that were fitted
    source: str  # ``posterior`` or ``estimate``
    method: str  # the estimator's name; of a posterior its prior
    #: Base parameters, then the effects that were estimated (p,), (p, p); multiplied by ``held_out_scale``.
    mean: np.ndarray
    covariance: np.ndarray
    draws: np.ndarray | None  # posterior draws of them (n, p); None: a normal law
    undetermined: np.ndarray  # which of them the data say nothing of, or only in sums with others (p,)
    effect_values: np.ndarray  # of all effects of the model, the fixed ones included (q,)
    links: LinkDraws  # links that can exist, drawn within the uncertainty
    centre: np.ndarray  # links whose base parameters are ``mean``, possible or not (P,)
    urdf: np.ndarray  # links of ``identified.urdf``, which can exist (P,)
    dynamics: JointDynamics  # what stands beside these in ``identified.urdf``: friction, and what it has no place for
    dispersion: float  # factor that the covariance has for what the model lacks; 1: none
    held_out_scale: float  # share of that covariance which held-out motions leave; 1: all of it
    rel_std: float | None  # relative standard deviation of the prior on links; None: one of the user's own

    @property
    def base(self) -> BaseParameters:
        """What the base parameters are combinations of."""
        return self.problem.row_model.base

    @cached_property
    def open_directions(self) -> np.ndarray:
        """Changes of base and effect parameters that the fitted rows do not show (p, m); none of a posterior."""
        if self.draws is not None:
            return np.zeros((len(self.mean), 0))
        return open_directions(self.problem)

    def parameters(self, seed: int = 0) -> Region:
        """The sets of the identified base parameters."""
        r, base = self.base.rank, self.base
        if self.draws is not None:
            return region_of_draws(base.names, base.labels, base.units, self.draws[:, :r], self.prior_driven(base))
        return region_of_normal(
            base.names, base.labels, base.units, self.mean[:r], self.covariance[:r, :r], self.undetermined[:r], seed
        )

    def prior_driven(self, base: BaseParameters) -> np.ndarray:
        """Which of other base parameters the prior drives (k,).

        They are no combination of those that the data say anything of, or draws of them are nearly as wide as the prior's.
        """
        driven = ~spanned(base.matrix, self.base.matrix[~self.undetermined[: self.base.rank]])[1]
        if self.links.prior is None:
            return driven
        spread = (self.links.links @ base.matrix.T).std(axis=0)
        return driven | (spread > PRIOR_DRIVEN * (self.links.prior @ base.matrix.T).std(axis=0))


def open_directions(problem: Problem) -> np.ndarray:
    """Changes of base and effect parameters that no fitted row shows, such as from a link's inertia to its rotor's (p, m)."""
    gram = channel_grams(problem.regression.rows)
    power = or_one(gram[:, -1, -1], 0.0)
    whole = np.sum(gram[:, :-1, :-1] / power[:, None, None], axis=0)
    length = or_one(np.sqrt(np.diag(whole)))
    values, vectors = np.linalg.eigh(whole / np.outer(length, length))
    return vectors[:, values <= _NOTHING * values[-1]] / length[:, None]


def held_out_scale(
    problem: Problem, mean: np.ndarray, covariance: np.ndarray, dispersion: float, floor: NoiseFloor | None
) -> float:
    """Share of a dispersed covariance that motions which were not fitted leave.

    How far parameters scatter between parts of one recording is known to a factor of two or so, and errors of a held-out motion
    are those of the parameters and more. So these cannot be larger: the variance that the covariance (of base parameters, then
    effects) predicts for the rows of motions of role ``validation`` is cut down to what is left of them, mean over channels,
    though not below that of noise alone, as far as a ``floor`` tells it. ``dispersion`` is the factor that the covariance has
    for what the model lacks.
    """
    blocks = [b for b in problem.rows.blocks([m.name for m in problem.judges]) if b.group == "trajectory"]
    if dispersion <= 1.0 or not blocks:
        return 1.0
    left = np.mean(np.concatenate([b.residual(mean) for b in blocks]) ** 2, axis=0)
    own = np.concatenate([np.sum((b.matrix @ covariance) * b.matrix, axis=2) for b in blocks]).mean(axis=0)
    # The floor is that of readings as they are: of filtered ones it is unknown, and far smaller.
    noise = 0.0 if floor is None or problem.row_model.filters is not None else floor.power.mean(axis=0)
    return float(np.clip(np.mean(np.maximum(left - noise, 0.0) / np.maximum(own, 1e-300)), 1.0 / dispersion, 1.0))


def known_from(
    problem: Problem,
    *,
    source: str,
    method: str,
    mean: np.ndarray,
    covariance: np.ndarray | None,
    undetermined: np.ndarray,
    draws: np.ndarray | None = None,
    link_draws: np.ndarray | None = None,
    prior_draws: np.ndarray | None = None,
    centre: np.ndarray | None = None,
    urdf: np.ndarray | None = None,
    dynamics: JointDynamics | None = None,
    rel_std: float | None = None,
    conflict: bool = False,
    dispersion: float = 1.0,
    floor: NoiseFloor | None = None,
    count: int = 1000,
    seed: int = 0,
) -> Known:
    """One form for what a posterior or an estimate says, as in `Known`.

    Where links were not drawn, so many that can exist are drawn about the mean. ``draws``, ``link_draws`` and ``prior_draws``
    are of the parameters (n, p), of the links behind them (n, P), and of these by the prior alone, where there are any;
    ``centre`` and ``urdf`` are by default the mean of the draws. ``rel_std`` is that of the nominal links; None: what the
    experiment says, else next to nothing is known, and so it is where data and that prior are in ``conflict``. An `InputError`
    where there is no covariance, or nothing is determined.
    """
    if covariance is None:
        raise InputError(
            f"method {method} has no covariance, so nothing can be bounded with it; take wls, or sample, of more readings than "
            "parameters"
        )
    rank = problem.row_model.base.rank
    if not np.any(np.diag(covariance) > 0.0):
        raise InputError("these motions determine no parameter, so nothing can be bounded; record other motions")
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    rel_std = rel_std or (None if conflict else problem.experiment.inertia_rel_std) or WIDE
    scale = 1.0
    if link_draws is None:
        # A posterior's draws hold the prior, too, and stay as they are.
        scale = held_out_scale(problem, mean, covariance, dispersion, floor) if draws is None else 1.0
        covariance = scale * covariance
        knowledge = problem.regression.knowledge
        links = consistent_draws(
            problem.row_model.base, mean, covariance, _drawn(problem, covariance), np.array(knowledge.effect_non_negative, bool),
            knowledge.prior(rel_std), count, seed,
        )  # fmt: skip
    else:
        assert draws is not None  # links are drawn with the parameters
        even = np.linspace(0, len(link_draws) - 1, min(count, len(link_draws))).astype(int)
        links = LinkDraws(link_draws[even], draws[even, rank:], prior_draws)
    middle = links.links.mean(axis=0)
    return Known(
        problem=problem, source=source, method=method, mean=mean, covariance=covariance, draws=draws, undetermined=undetermined,
        effect_values=problem.row_model.every_value(mean[rank:]), links=links, centre=middle if centre is None else centre,
        urdf=middle if urdf is None else urdf, dynamics=dynamics or JointDynamics({}), dispersion=dispersion,
        held_out_scale=scale, rel_std=rel_std,
    )  # fmt: skip


def _drawn(problem: Problem, covariance: np.ndarray) -> np.ndarray:
    """Parameters that links are drawn with (p,).

    Those with a variance; but no effects that the data tell from each other as little as from nothing, and no prior holds.
    """
    out, rank = np.diag(covariance) > 0.0, problem.row_model.base.rank
    held, among_effects = np.split(open_directions(problem), [rank])
    size = np.linalg.norm(among_effects, axis=0)
    free = np.linalg.norm(held, axis=0) <= _OUTSIDE * size
    out[rank:] &= ~np.any(np.abs(among_effects[:, free]) > _OUTSIDE * size[free], axis=1)
    return out
