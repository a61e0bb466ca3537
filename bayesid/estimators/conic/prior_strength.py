"""The prior of the links: its metric, and its relative standard deviation where nobody states one.

The distance to the nominal links phi0 is ``(phi - phi0)' L (phi - phi0) / s^2`` with ``L = 2 M`` of the pull-back metric
[Lee2020]_ (relative changes of the mass distribution), or a multiple of the unit matrix (Euclidean). s is the prior
relative standard deviation. Where it is not stated it is the one that makes the data most probable [Good1965]_: with y the
data's distance from the nominal links, effects projected out, ``y ~ N(0, 1 + s^2 G G')``. Above one, links are further from the
nominal ones than those are large, in some directions (a mass that lies elsewhere) and not in others, which no single s
describes: the nominal links then fill what the data leave open, and pull at nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, null_space
from scipy.optimize import fminbound
from scipy.stats import chi2

from bayesid.errors import InputError
from bayesid.estimators.conic.data import LinkData
from bayesid.regression.linalg import or_one, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior

METRICS = ("pullback", "euclidean", "entropic")
#: Relative standard deviations tried when none is stated.
_SMALLEST, _LARGEST = 1e-3, 1e2
#: Below this probability of the distance to the nominal model even the best relative standard deviation explains nothing.
_UNEXPLAINED = 1e-4
#: A relative standard deviation that says next to nothing, for questions to the data alone.
_NEXT_TO_NONE = 30.0
#: Above this relative standard deviation, found from the data, the nominal links describe nothing.
_DESCRIBES = 1.0
#: Without any nominal model: spheres of 1 kg with a radius of gyration of 0.1 m, known within a factor of ten.
_TYPICAL = np.array([1.0, 0, 0, 0, 0.02, 0, 0.02, 0, 0, 0.02])
_TYPICAL_STD = 10.0


@dataclass(frozen=True)
class LinkPrior:
    """A nominal model and its precision.

    Attributes
    ----------
    mean
        Nominal link parameters (P,).
    root
        W with ``W'W`` the precision (q, P).
    references
        Pseudo-inertia of each nominal body, thickened where it has no extent (b, 4, 4).
    metric
        ``pullback``, ``euclidean`` or ``entropic``.
    rel_std
        s; None where a precision of one's own is given.
    stated
        Whether s was stated, not found from the data.
    rule
        Where s is from, in words.
    probability
        Of data as far from the nominal model as these, given s.
    end
        ``smallest`` or ``largest`` where the search for s stopped at that end of its range, else None.
    """

    mean: np.ndarray
    root: np.ndarray
    references: np.ndarray
    metric: str
    rel_std: float | None
    stated: bool
    rule: str
    probability: float = 1.0
    end: str | None = None

    @property
    def loosened(self) -> float:
        """Factor of the precision that all but leaves the nominal model out, yet leaves the problem solvable."""
        return min(1.0, (self.rel_std / _NEXT_TO_NONE) ** 2) if self.rel_std is not None else 1e-3

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "metric": self.metric,
            "rel_std": self.rel_std,
            "stated": self.stated,
            "rule": self.rule,
            "search_stopped_at": self.end,
            "probability_of_distance_to_nominal": self.probability,
        }


def link_prior(regression: Regression, data: LinkData, prior: Prior | None, metric: str, rel_std: float | None) -> LinkPrior:
    """Nominal model and strength from what is given: a prior, the regression's nominal links, or next to nothing.

    Raises
    ------
    InputError
        An option is unknown, or the prior is for other parameters.
    """
    if metric not in METRICS:
        raise InputError(f"sdp metric '{metric}': choose one of {', '.join(METRICS)}")
    if rel_std is not None and not (np.isfinite(rel_std) and rel_std > 0):
        raise InputError(f"sdp rel_std = {rel_std}: give a number above 0, such as 0.3")
    known = regression.knowledge
    if prior is not None:
        if len(prior.mean) != data.size:
            raise InputError(f"the prior is for {len(prior.mean)} link parameters, the regression has {data.size}")
        mean = np.asarray(prior.mean, float)
        references = _references(mean, data.bodies)
        if metric == "pullback" and rel_std is None:
            root = _root(prior.precision)
            probability = _probability(data, mean, root, 1.0)
            return LinkPrior(mean, root, references, metric, None, True, "the prior's precision", probability)
    elif known.states_masses:
        mean = known.nominal_links
        assert mean is not None
        references = _references(mean, data.bodies)
    elif known.guessed_links is not None:
        mean, rel_std = known.guessed_links, _TYPICAL_STD if rel_std is None else rel_std
        references = _references(mean, data.bodies)
    else:
        mean = np.zeros(data.size)
        for body in data.bodies:
            mean[list(body)] = _TYPICAL
        references = _references(mean, data.bodies)
        rel_std = _TYPICAL_STD if rel_std is None else rel_std
    unit = _unit_root(mean, data.bodies, metric)
    stated = known.inertia_rel_std if rel_std is None and prior is None else rel_std
    # Exactly known links leave nothing to estimate: whoever asks for an estimate does not take them for exact.
    found = stated is None or stated == 0
    if found:
        std, end = _most_probable(data, mean, unit)
        rule = "the value that makes the data most probable"
        if end is not None:
            rule += f", at the {end} that is tried"
        if _probability(data, mean, unit, std) < _UNEXPLAINED:
            rule += "; no value explains how far the data are from the nominal model: an effect beside the links is missing"
        elif std > _DESCRIBES:
            far = f"{std:.2g} times as far from the nominal links as those are large"
            rule = f"found from the data, {far}: the nominal links fill only what data leave open"
            std = _LARGEST
    else:
        assert stated is not None
        std, rule, end = float(stated), "as stated", None
    if prior is None and not known.states_masses:
        guess = "bodies of about 1 kg and 0.1 m" if known.guessed_links is None else "cylinders of water between the joints"
        why = "no nominal model" if known.guessed_links is None else "the URDF states no masses"
        rule = f"{why}: {guess}, within a factor of ten"
    return LinkPrior(mean, unit / std, references, metric, std, not found, rule, _probability(data, mean, unit, std), end)


def nominal_prior(mean: np.ndarray, bodies: tuple[tuple[int, ...], ...]) -> LinkPrior:
    """Nominal links with relative standard deviation one, by the constant pull-back metric."""
    return LinkPrior(
        mean, _unit_root(mean, bodies, "pullback"), _references(mean, bodies), "pullback", 1.0, True, "relative distance"
    )


def _references(mean: np.ndarray, bodies) -> np.ndarray:
    return np.array([inertia.solid(mean[list(body)]) for body in bodies])


def _unit_root(mean: np.ndarray, bodies, metric: str) -> np.ndarray:
    """Root of the precision for s = 1."""
    size = np.sqrt(np.mean(mean**2)) if mean.any() else 1.0
    rows = np.zeros((10 * len(bodies), len(mean)))
    for k, body in enumerate(bodies):
        part = slice(10 * k, 10 * k + 10)
        if metric == "euclidean":
            rows[part, list(body)] = np.eye(10) / size
        else:
            rows[part, list(body)] = _root(2.0 * inertia.pullback_metric(mean[list(body)]))
    return rows


def _root(precision: np.ndarray) -> np.ndarray:
    """W with ``W'W = precision``; directions without any are left out."""
    size = or_one(standard_deviations(precision), 0.0)
    scaled = precision / np.outer(size, size)
    try:
        return cholesky(0.5 * (scaled + scaled.T)) * size
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        keep = values > 1e-13 * values[-1]
        return np.sqrt(values[keep])[:, None] * vectors[:, keep].T * size


def _distance(data: LinkData, mean: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Independent ``y_k ~ N(0, 1 + s^2 g_k)``: y (k,) and g (k,).

    What the prior says nothing about, effects and free columns, is projected out.
    """
    known = np.linalg.norm(unit, axis=0) > 0
    columns = np.concatenate([known, np.zeros(data.matrix.shape[1] - data.size, bool)])
    free = data.matrix[:, ~columns]
    y = data.target - data.matrix[:, : data.size][:, known] @ mean[known]
    length = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    rest = null_space((free / length).T, rcond=1e-11).T if free.shape[1] else np.eye(len(y))
    # phi - phi0 = W^-1 n with n standard normal; W has full rank in the known columns.
    spread = np.linalg.lstsq(unit[:, known].T, (rest @ data.matrix[:, columns]).T, rcond=None)[0].T
    u, s, _ = np.linalg.svd(spread)
    values = np.zeros(len(rest))
    values[: len(s)] = s**2
    return u.T @ (rest @ y), values


def _most_probable(data: LinkData, mean: np.ndarray, unit: np.ndarray) -> tuple[float, str | None]:
    """Maximiser of the probability of the data over s, by a grid and a search in between, and the end where it lies."""
    y, g = _distance(data, mean, unit)

    def cost(log_std: float) -> float:
        variance = 1.0 + np.exp(2.0 * log_std) * g
        return float(np.sum(np.log(variance) + y**2 / variance))

    grid = np.linspace(np.log(_SMALLEST), np.log(_LARGEST), 47)
    best = int(np.argmin([cost(x) for x in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found = float(fminbound(cost, low, high, full_output=True)[0])
    # A search within bounds stops a little beside them.
    if best == 0 and cost(grid[0]) <= cost(found):
        return _SMALLEST, "smallest"
    if best == len(grid) - 1 and cost(grid[-1]) <= cost(found):
        return _LARGEST, "largest"
    return float(np.exp(found)), None


def _probability(data: LinkData, mean: np.ndarray, unit: np.ndarray, std: float) -> float:
    """Of data at least as far from the nominal model as these, if ``std`` is right."""
    y, g = _distance(data, mean, unit)
    return float(chi2.sf(np.sum(y**2 / (1.0 + std**2 * g)), len(y))) if len(y) else 1.0
