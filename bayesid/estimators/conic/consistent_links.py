"""Links that can exist, for the URDF of any estimate: nearest to the nominal ones within the estimate's uncertainty.

With b_hat, V the base parameters and their covariance, e effects, and G the Gram matrix of the fitted rows, each channel in units
of its residuals over the root of their number,

    min ||phi - phi0||^2_M   subject to   P_i(phi) >= eps P_i(phi0)   for every link,
    (b - b_hat)' V^-1 (b - b_hat) / chi2  +  ||(b, e) - (b_hat, e_hat)||^2_G / gamma  <=  1,     b = K phi.

Both terms are at most 1: the base parameters stay in their joint ellipsoid, and predictions of the fitted motions differ
from the estimate's by at most gamma of the residuals' power. The first alone would let links change predictions by much
where intervals are wide because the model lacks something. Effects move along as far as they compensate.
Where no possible links are in that region, predictions may differ by more; where none are in the ellipsoid either, those are
taken whose distance (the left side) is at most a tenth above the least one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.stats import chi2

from bayesid.errors import EstimationError
from bayesid.estimators.conic.links import LinkData, LinkPrior, conic, misfit, nominal_prior
from bayesid.estimators.conic.problem import solve_conic
from bayesid.estimators.estimator import Estimate
from bayesid.estimators.factor import channel_grams
from bayesid.regression.linalg import or_one, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.rounding import LEVEL

#: Pseudo-inertias are at least this share of the nominal ones: then the mass matrix is, too, in every posture, and simulators,
#: which compute principal inertias with rounding errors, find the triangle inequality met.
MARGIN = 1e-4
#: gamma; error norms of the fitted motions then grow by about half of it at most. _ANY: as good as no bound.
LARGEST_LOSS = 0.1
_ANY = 1e3
#: How much further than necessary links may be from the estimate where they cannot be inside its uncertainty (squared distance).
_SLACK = 1.1
#: Base parameters that had to move by more than this many standard deviations are named.
NAMED = 3.0
#: Strengths of the pull towards the nominal links that are tried, strongest first, and steps of the search between two of them.
_STRENGTHS = 10.0 ** np.arange(3.0, -7.0, -1.5)
_STEPS = 6
#: A misfit that a weaker pull leaves above this share is about the least one.
_SETTLED = 0.95
#: Where links are further from the estimate than so many radii, predictions are not what keeps them from it.
_HOPELESS = 2.0
_TOLERANCE = 0.01
#: Range of densities, relative to the guess.
_DENSITIES = (1e-2, 1e2)
# Correlations are trusted to this share of the largest eigenvalue, columns to this share of the longest.
_SMALLEST = 1e-12


@dataclass(frozen=True)
class ConsistentLinks:
    """Possible links, and how far from the estimate they are."""

    links: np.ndarray  # ten parameters a body (10 b,)
    solution: np.ndarray  # their base parameters, and the effects that go with them (p,)
    #: Joint distance of the base parameters from the estimate [sigma], and the radius of their ellipsoid; None where the
    #: estimate has no covariance.
    distance: float | None
    allowed: float | None
    directions: int  # number of base parameters that have one
    #: Base parameter that moved by most of its own standard deviations, and by how many; None without a covariance.
    largest: tuple[str, float] | None
    inside: bool  # whether the base parameters stay in their ellipsoid; False: those of no possible links do
    on_boundary: tuple[str, ...]  # links at the edge of what can exist, that the data would push beyond
    #: Where not inside: base parameters that had to move by more than `NAMED` standard deviations, the furthest first.
    conflicts: tuple[tuple[str, float], ...]


def consistent_links(regression: Regression, estimate: Estimate, nominal: np.ndarray, *, scaled: bool = False) -> ConsistentLinks:
    """Possible links nearest to nominal ones (b, 10) within the uncertainty of an estimate.

    A nominal body without mass counts as a ball of 1 g and 1 cm; where ``scaled``, they are a guess of shapes, whose density
    the estimate is asked for. An `EstimationError` where the solver found no links, with regressors of no use only.
    """
    base, rank = regression.base, regression.base.rank
    bodies = regression.knowledge.bodies
    names = tuple(base.parameter_names[body[0]].rsplit(".", 1)[0] for body in bodies)
    kept, root = _inverse_root(regression, estimate)
    radius = float(chi2.ppf(LEVEL, max(len(kept), 1)))
    spread = np.zeros((len(kept), len(estimate.solution)))
    spread[:, kept] = root
    change = _prediction_root(regression, estimate)

    def away(x: np.ndarray) -> float:
        return float(np.linalg.norm(spread @ (base_solution(x) - estimate.solution)))

    def base_solution(x: np.ndarray) -> np.ndarray:
        return np.concatenate([base.matrix @ x[: base.matrix.shape[1]], x[base.matrix.shape[1] :]])

    found: list[tuple[np.ndarray, np.ndarray]] = []
    for loss in (LARGEST_LOSS, _ANY):
        matrix = np.concatenate([spread / np.sqrt(radius), change / np.sqrt(loss)])
        whole = np.concatenate([matrix[:, :rank] @ base.matrix, matrix[:, rank:]], axis=1)
        data = LinkData(whole, matrix @ estimate.solution, base.matrix.shape[1], bodies, names)
        found.append(_nearest(data, nominal_prior(_solid(nominal, data if scaled else None), bodies)))
        inside = bool(away(found[-1][0]) <= np.sqrt(radius))
        if inside or not len(kept) or away(found[-1][0]) > _HOPELESS * np.sqrt(radius):
            break
    x, ranks = found[-1 if inside else 0]
    solution = base_solution(x)
    moved = np.zeros(rank)
    moved[kept] = np.abs(solution[kept] - estimate.values[kept]) / np.maximum(estimate.std[kept], 1e-300)
    order = kept[np.argsort(-moved[kept])].tolist()
    return ConsistentLinks(
        links=x[: base.matrix.shape[1]],
        solution=solution,
        distance=away(x) if order else None,
        allowed=float(np.sqrt(radius)) if order else None,
        directions=len(kept),
        largest=(base.labels[order[0]], float(moved[order[0]])) if order else None,
        inside=inside,
        on_boundary=tuple(name for name, r in zip(names, ranks, strict=True) if r < 4),
        conflicts=() if inside else tuple((base.labels[k], float(moved[k])) for k in order if moved[k] > NAMED),
    )


def _solid(nominal: np.ndarray, data: LinkData | None) -> np.ndarray:
    """Nominal links (10 b,) that all have mass; with data, in the density that explains these best."""
    if data is not None:
        seen = data.matrix[:, : nominal.size] @ nominal.ravel()
        nominal = nominal * np.clip(seen @ data.target / max(float(seen @ seen), 1e-300), *_DENSITIES)
    return np.concatenate([inertia.from_pseudo_inertia(inertia.solid(b)) if b[0] <= 0.0 else b for b in nominal])


def _inverse_root(regression: Regression, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Base parameters with a standard deviation (k,), and W with ``W'W`` the inverse of their covariance (k, k)."""
    rank = regression.base.rank
    covariance = estimate.covariance
    if covariance is None:
        return np.zeros(0, int), np.zeros((0, 0))
    kept = np.flatnonzero(~estimate.undetermined[:rank] & np.isfinite(np.diag(covariance)))
    if not len(kept):
        return kept, np.zeros((0, 0))
    std = standard_deviations(covariance)[kept]
    # Recordings without any noise: nothing is known better than to rounding.
    size = np.abs(estimate.values[kept]) if regression.nominal_scale is None else regression.nominal_scale[kept]
    std = np.maximum(std, 1e-9 * or_one(size, 0.0))
    values, vectors = np.linalg.eigh(covariance[np.ix_(kept, kept)] / np.outer(std, std))
    return kept, (vectors / np.sqrt(np.maximum(values, _SMALLEST * max(values[-1], 1.0)))).T / std


def _prediction_root(regression: Regression, estimate: Estimate) -> np.ndarray:
    """W with ``||W (x - x_hat)||^2`` the power of the change of predictions relative to the residuals', mean over channels."""
    grams, left = channel_grams(regression.rows), np.append(-estimate.solution, 1.0)
    # The sum of squares of the residuals; the floor is above the rounding of this product.
    power = np.maximum(left @ (grams @ left).T, 1e-12 * grams[:, -1, -1])
    used = power > 0
    gram = np.sum(grams[used, :-1, :-1] / power[used, None, None], axis=0) / max(used.sum(), 1)
    length = or_one(standard_deviations(gram), 0.0)
    values, vectors = eigh(gram / np.outer(length, length))
    keep = values > _SMALLEST * values[-1]
    return np.sqrt(values[keep])[:, None] * vectors[:, keep].T * length


def _nearest(data: LinkData, prior: LinkPrior) -> tuple[np.ndarray, np.ndarray]:
    """The nearest links in the region (misfit at most 1) or, where there are none, about the least misfit; and their ranks.

    Misfit and distance are weighed with a multiplier, as in `bayesid.estimators.conic.links.closest_within`, but from strong
    pulls to weak ones: those are easily solved, and most often one of the first is inside already.
    """
    tried: list[tuple[float, float, np.ndarray, np.ndarray]] = []
    for trial in _trials(data, prior, _STRENGTHS):
        tried.append(trial)
        if trial[1] <= 1.0 or (len(tried) > 1 and trial[1] > _SETTLED * tried[-2][1]):
            break
    if not tried:
        raise EstimationError("the conic solver found no physical links; check units and the conditioning of the motion")
    least = min(t[1] for t in tried)
    limit = max(1.0, _SLACK * least)
    while len(tried) > 1 and tried[-2][1] <= limit:
        tried.pop()
    inner, outer = tried[-1], tried[-2] if len(tried) > 1 else None
    if outer is not None and inner[1] <= limit:
        for _ in range(_STEPS):
            if inner[1] >= (1.0 - _TOLERANCE) * limit:
                break
            # The misfit is about a power of the strength between the two.
            share = np.log(limit / inner[1]) / max(np.log(outer[1] / inner[1]), 1e-12)
            strength = float(np.exp(np.log(inner[0]) + np.clip(share, 0.1, 0.9) * np.log(outer[0] / inner[0])))
            found = next(_trials(data, prior, [strength]), None)
            if found is None:
                break
            inner, outer = (found, outer) if found[1] <= limit else (inner, found)
    return inner[2], inner[3]


def _trials(data: LinkData, prior: LinkPrior, strengths) -> Iterator[tuple[float, float, np.ndarray, np.ndarray]]:
    """Strength, misfit, parameters and ranks of bodies, where the solver finds bodies with half of the margin at least."""
    for strength in strengths:
        problem = replace(conic(data, prior, strength=float(strength)), margin=MARGIN)
        try:
            found = solve_conic(problem)
        except EstimationError:
            continue
        if found.violation <= 0.5 * MARGIN:
            yield float(strength), misfit(data, found.x), found.x, found.ranks
