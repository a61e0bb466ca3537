"""What rows and nominal model say of link parameters, each by itself and weighed against each other.

The rows say a factor of the inverse covariance, and the target it fits exactly.

The distance to the nominal links phi0 is ``(phi - phi0)' C(s)^-1 (phi - phi0)`` with C(s) the covariance of links that are
scaled, shifted and warped by a share s (`Prior.warped`), which is what s means wherever else it counts; or, with ``L = 2 M`` of
the pull-back metric [Lee2020]_ or a multiple of the unit matrix (Euclidean), ``C(s)^-1 = L / s^2``. s is the prior relative
standard deviation. Where it is not stated it is the one that makes the data most probable [Good1965]_: with y the data's
distance from the nominal links, effects projected out, ``y ~ N(0, 1 + G C(s) G')``. Above one, links are further from the
nominal ones than those are large, in some directions (a mass that lies elsewhere) and not in others, which no single s
describes: the nominal links then fill what the data leave open, by the pull-back metric, and pull at nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, get_lapack_funcs, null_space, solve_triangular
from scipy.optimize import brentq, fminbound

from bayesid.errors import InputError, require_one_of
from bayesid.estimators.conic.problem import Conic, Linear, Solution, solve_conic
from bayesid.estimators.prior_check import Evidence, PriorCheck, compared
from bayesid.regression.linalg import column_lengths, undetermined
from bayesid.regression.regression import Regression, checked_bodies
from bayesid.robot import inertia
from bayesid.robot.prior import GUESS_STD, Prior

(_FACTORISE,) = get_lapack_funcs(("potrf",), dtype="d")


@dataclass(frozen=True)
class LinkData:
    """What the rows say, in units of their noise: ``matrix @ x ~ target`` with unit covariance."""

    #: Of x: link parameters, then effects (k, n), (k,).
    matrix: np.ndarray
    target: np.ndarray
    size: int  # number of link parameters
    #: Ten columns of each body, and its name.
    bodies: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, regression: Regression, matrix: np.ndarray, target: np.ndarray, prior: Prior | None) -> LinkData:
        """Through K from base to link parameters."""
        base, r = regression.base, regression.base.rank
        bodies = regression.knowledge.bodies or (prior.bodies if prior is not None else ())
        if not bodies:
            raise InputError("sdp needs to know which columns are a body's ten parameters; give bodies=")
        bodies = checked_bodies(bodies, len(base.parameter_names))
        names = [base.parameter_names[body[0]].rsplit(".", 1) for body in bodies]
        labels = tuple(n[0] if len(n) == 2 and n[1] == "m" else f"body{k + 1}" for k, n in enumerate(names))
        whole = np.concatenate([matrix[:, :r] @ base.matrix, matrix[:, r:]], axis=1)
        return cls(whole, target, base.matrix.shape[1], bodies, labels)


def compressed(matrix: np.ndarray, target: np.ndarray, middle: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """A factor of the inverse covariance of the estimate in the determined directions, and the target it fits exactly.

    With ``R = U S V' D`` the coordinates ``z = S V' D x`` have bread one, so their covariance is their meat.
    """
    length = column_lengths(matrix)
    u, s, vt = np.linalg.svd(matrix / length)
    keep = s > 1e-11 * s[0]
    rows, rotated = s[keep][:, None] * vt[keep] * length, u.T[keep] @ target
    if middle is None:
        return rows, rotated
    whiten = vt[keep] / s[keep][:, None] / length
    covariance = whiten @ middle @ whiten.T
    lower, failed = _FACTORISE(0.5 * (covariance + covariance.T), lower=True)
    known = slice(failed - 1 if failed else None)  # rounding of the squares in it hides directions that are weaker
    lower, rows, rotated = lower[known, known], rows[known], rotated[known]
    return solve_triangular(lower, rows, lower=True), solve_triangular(lower, rotated, lower=True)


METRICS = ("warped", "pullback", "euclidean", "entropic")
#: Relative standard deviations tried when none is stated.
_SMALLEST, _LARGEST = 1e-3, 1e2
#: Below this probability of the distance to the nominal model even the best relative standard deviation explains nothing.
_UNEXPLAINED = 1e-4
#: A relative standard deviation that says next to nothing, for questions to the data alone.
_NEXT_TO_NONE = 30.0
#: Above this relative standard deviation, found from the data, the nominal links describe nothing.
_DESCRIBES = 1.0
#: Logarithm of the distance's weight over the usual one; exp(-10) of the usual standard deviation off the nominal links is none.
_NOMINAL = 20.0
#: Without any nominal model: spheres of 1 kg with a radius of gyration of 0.1 m, known within a factor of ten.
_TYPICAL = np.array([1.0, 0, 0, 0, 0.02, 0, 0.02, 0, 0, 0.02])


@dataclass(frozen=True)
class LinkPrior:
    """A nominal model and its precision."""

    mean: np.ndarray  # nominal link parameters (P,)
    root: np.ndarray  # W with ``W'W`` the precision (q, P)
    references: np.ndarray  # pseudo-inertia of each nominal body, thickened where it has no extent (b, 4, 4)
    metric: str  # ``warped``, ``pullback``, ``euclidean`` or ``entropic``
    rel_std: float | None  # s; None where a precision of one's own is given
    stated: bool  # whether s was stated, not found from the data
    rule: str  # where s is from, in words
    check: PriorCheck | None = None  # how far the data are from the nominal model, given s; None where they determine nothing
    end: str | None = None  # ``smallest`` or ``largest`` where the search for s stopped at that end of its range, else None

    @property
    def probability(self) -> float:
        """Probability of data as far from the nominal model as these."""
        return 1.0 if self.check is None else self.check.probability

    @property
    def loosened(self) -> float:
        """Factor of the precision that all but leaves the nominal model out, yet leaves the problem solvable."""
        return min(1.0, (self.rel_std / _NEXT_TO_NONE) ** 2) if self.rel_std is not None else 1e-3

    def to_dict(self) -> dict[str, Any]:
        """The prior as plain values."""
        return {
            "metric": self.metric,
            "rel_std": self.rel_std,
            "stated": self.stated,
            "rule": self.rule,
            "search_stopped_at": self.end,
            "probability_of_distance_to_nominal": self.probability,
        }


def link_prior(
    regression: Regression, data: LinkData, evidence: Evidence, prior: Prior | None, metric: str, rel_std: float | None
) -> LinkPrior:
    """Nominal model and strength from what is given: a prior, the regression's nominal links, or next to nothing.

    ``data`` and ``evidence`` are what the rows say of link and of base parameters; metric and s are as in `Physical`. An
    `InputError` where an option is unknown, or the prior is for other parameters.
    """
    require_one_of(metric, METRICS, f"sdp metric '{metric}'")
    if rel_std is not None and not (np.isfinite(rel_std) and rel_std > 0):
        raise InputError(f"sdp rel_std = {rel_std}: give a number above 0, such as 0.3")
    known = regression.knowledge
    if prior is not None:
        if len(prior.mean) != data.size:
            raise InputError(f"the prior is for {len(prior.mean)} link parameters, the regression has {data.size}")
        mean = np.asarray(prior.mean, float)
        if metric == "warped" and rel_std is None:
            root = prior.root
            check = compared(regression.base, evidence, mean, root)
            return LinkPrior(mean, root, _references(mean, data.bodies), metric, None, True, "the prior's precision", check)
    elif known.states_masses:
        mean = known.links
        assert mean is not None
    else:
        rel_std = GUESS_STD if rel_std is None else rel_std
        mean = np.zeros(data.size) if known.links is None else known.links
        for body in data.bodies if known.links is None else ():
            mean[list(body)] = _TYPICAL
    guessed = known.guessed if prior is None and known.states_masses else ()
    stated = known.inertia_rel_std if rel_std is None and prior is None else rel_std
    # Exactly known links leave nothing to estimate: whoever asks for an estimate does not take them for exact.
    found = stated is None or stated == 0

    def checked(std: float) -> tuple[np.ndarray, PriorCheck | None]:
        root = _scaled_root(mean, data.bodies, metric, std, guessed)
        return root, compared(regression.base, evidence, mean, root, std, stated=not found)

    if found:
        std, end = _most_probable(data, mean, metric, guessed)
        root, check = checked(std)
        rule = "the value that makes the data most probable"
        if end is not None:
            rule += f", at the {end} that is tried"
        if check is not None and check.probability < _UNEXPLAINED:
            rule += "; no value explains how far the data are from the nominal model: an effect beside the links is missing"
        elif std > _DESCRIBES:
            far = f"{std:.2g} times as far from the nominal links as those are large"
            rule = f"found from the data, {far}: the nominal links fill only what data leave open"
            std = _LARGEST
            root, check = checked(std)
    else:
        assert stated is not None
        std, rule, end = float(stated), "as stated", None
        root, check = checked(std)
    if prior is None and not known.states_masses:
        guess = "bodies of about 1 kg and 0.1 m" if known.links is None else "cylinders of water between the joints"
        why = "no nominal model" if known.links is None else "the URDF states no masses"
        rule = f"{why}: {guess}, within a factor of ten"
    return LinkPrior(mean, root, _references(mean, data.bodies), metric, std, not found, rule, check, end)


def nominal_prior(mean: np.ndarray, bodies: tuple[tuple[int, ...], ...]) -> LinkPrior:
    """Nominal links with relative standard deviation one, by the constant pull-back metric."""
    return LinkPrior(
        mean, _scaled_root(mean, bodies, "pullback", 1.0), _references(mean, bodies), "pullback", 1.0, True, "relative distance"
    )


def _references(mean: np.ndarray, bodies) -> np.ndarray:
    return np.array([inertia.solid(mean[list(body)]) for body in bodies])


def _scaled_root(mean: np.ndarray, bodies, metric: str, rel_std: float, guessed: Sequence[bool] = ()) -> np.ndarray:
    """Root of the precision at a relative standard deviation (10 b, P); of bodies that are guessed see `Prior.around`."""
    size = np.sqrt(np.mean(mean**2)) if mean.any() else 1.0
    rows = np.zeros((10 * len(bodies), len(mean)))
    for k, body in enumerate(bodies):
        part = slice(10 * k, 10 * k + 10)
        near, std = mean[list(body)], rel_std
        if guessed and guessed[k]:
            near, std = mean[np.array(bodies)].mean(axis=0), max(rel_std, GUESS_STD)
        if metric == "euclidean":
            rows[part, list(body)] = np.eye(10) / size / std
        else:
            # A share above one is no change of a shape any more: what is left is to fill what data leave open, evenly.
            like = Prior.warped if metric == "warped" and std <= _DESCRIBES else Prior.nominal
            rows[part, list(body)] = like(near, std).root
    return rows


def _most_probable(data: LinkData, mean: np.ndarray, metric: str, guessed: Sequence[bool]) -> tuple[float, str | None]:
    """Maximiser of the probability of the data over s, by a grid and a search in between, and the end where it lies.

    What the prior says nothing about, effects and free columns, is projected out.
    """
    known = np.linalg.norm(_scaled_root(mean, data.bodies, metric, 1.0), axis=0) > 0
    columns = np.concatenate([known, np.zeros(data.matrix.shape[1] - data.size, bool)])
    free = data.matrix[:, ~columns]
    y = data.target - data.matrix[:, : data.size][:, known] @ mean[known]
    length = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    rest = null_space((free / length).T, rcond=1e-11).T if free.shape[1] else np.eye(len(y))
    y, matrix = rest @ y, (rest @ data.matrix[:, columns]).T

    def cost(log_std: float) -> float:
        # phi - phi0 = W^-1 n with n standard normal; W has full rank in the known columns.
        root = _scaled_root(mean, data.bodies, metric, float(np.exp(log_std)), guessed)[:, known]
        spread = np.linalg.lstsq(root.T, matrix, rcond=None)[0]
        lower = cholesky(np.eye(len(y)) + spread.T @ spread, lower=True)
        return float(2.0 * np.sum(np.log(np.diag(lower))) + np.sum(solve_triangular(lower, y, lower=True) ** 2))

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


def conic(data: LinkData, prior: LinkPrior, bounds: tuple[Linear, ...] = (), strength: float = 1.0) -> Conic:
    """Data and prior, its precision times ``strength``, as one triangular factor by a QR decomposition; nothing is squared."""
    n = data.matrix.shape[1]
    root = np.sqrt(strength) * prior.root
    rows = np.zeros((len(data.target) + len(root), n + 1))
    rows[: len(data.target), :n], rows[: len(data.target), -1] = data.matrix, data.target
    rows[len(data.target) :, : data.size] = root
    rows[len(data.target) :, -1] = root @ prior.mean
    held = held_columns(rows[:, :n])
    rows = np.concatenate([rows, np.column_stack([held, np.zeros(len(held))])])
    r = np.asarray(np.linalg.qr(rows, mode="r"))
    r = r * np.where(np.diag(r) < 0, -1.0, 1.0)[: len(r), None]
    return Conic(
        factor=r[:n, :n],
        centre=solve_triangular(r[:n, :n], r[:n, -1]),
        bodies=data.bodies,
        references=prior.references,
        bounds=bounds,
    )


def held_columns(matrix: np.ndarray) -> np.ndarray:
    """Rows (k, n) that hold at zero, by next to nothing, what neither data nor prior know, such as an effect that never acts.

    ``matrix`` has the rows of both (..., n). A prior may be far weaker than the data, and is used as it stands.
    """
    length = np.linalg.norm(matrix, axis=0)
    return np.diag(np.where(length > 0, 1e-6 * length, 1.0))[undetermined(matrix, 1e-10)]


def misfit(data: LinkData, x: np.ndarray) -> float:
    """Squared distance from the unconstrained estimate, which fits its factor exactly."""
    return float(np.sum((data.matrix @ x - data.target) ** 2))


def closest_within(limit: float, data: LinkData, prior: LinkPrior, bounds: tuple[Linear, ...] = ()) -> tuple[Solution, Conic]:
    """The possible links nearest to the nominal ones among those whose misfit is at most the limit, and the problem they solve.

    They minimise misfit and distance weighed with a multiplier, and the misfit grows with the distance's
    weight: so the multiplier is the root of one equation, and the last problem's certificate is this one's.
    """

    def solved(log_strength: float) -> tuple[Solution, Conic]:
        problem = conic(data, prior, bounds, float(np.exp(log_strength)))
        return solve_conic(problem), problem

    def beyond(log_strength: float) -> float:
        return misfit(data, solved(log_strength)[0].x) / limit - 1.0

    start = low = float(np.log(prior.loosened))
    high = low + 3.0
    while beyond(high) < 0.0:
        if high > start + _NOMINAL:  # the nominal links themselves fit as well as that
            return solved(high)
        low, high = high, high + 3.0
    root: Any = brentq(beyond, low, high, xtol=1e-9)
    return solved(float(root))
