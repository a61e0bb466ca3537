"""``sdp``: the parameters of bodies that can exist, nearest to what data and nominal model say together.

With x the link parameters phi, then the effects, b = K phi the base parameters, (b_ls, V) the unconstrained estimate and
its covariance, and phi0, M, s the nominal model, its metric and its relative trust,

    min 1/2 ||(b, e) - (b, e)_ls||^2_{V^-1}  +  1/s^2 ||phi - phi0||^2_M
    subject to  P_i(phi) >= 0  for every link, bounds, friction >= 0

[Wensing2018]_, [Lee2020]_. The data's part is the triangular factor of whitened rows where the residuals are noise, else
that of the channel-weighted estimate's own covariance, so that both parts are in units of the noise, and a sum of squares
can be tested. Directions that the data do not see follow the nominal model.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import brentq
from scipy.stats import chi2

from bayesid.errors import BayesidWarning, EstimationError, InputError
from bayesid.estimators.conic.bounds import Bounds
from bayesid.estimators.conic.certificate import certificate, contradiction, explain
from bayesid.estimators.conic.cone import Conic, Infeasible, Linear, Solution, solve_conic
from bayesid.estimators.conic.entropic import solve_entropic
from bayesid.estimators.conic.prior_strength import Trust, trust_of
from bayesid.estimators.estimator import Estimate, unseen
from bayesid.estimators.factor import learn_weights
from bayesid.estimators.least_squares import make_estimate, sandwich_middle, weighted_factor
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior

#: Up to this trust intervals of data and nominal model together hold what they promise in simulation (docs/physical.md).
LARGEST_PROVED = 0.2
#: Where data as far from the nominal links are less probable than this, the trust is doubtful and left out of intervals.
DOUBTFUL = 0.05
_WEIGHTS = ("auto", "channel", "noise")


@dataclass(frozen=True)
class Physical:
    """Estimate of physically consistent links.

    Attributes
    ----------
    prior
        Nominal links and their trust; None: those of the regression.
    bounds
        What is known for sure beyond that bodies exist.
    metric
        ``pullback`` (the prior's own), ``euclidean`` or ``entropic``: how the distance to the nominal links is measured.
    rel_std
        Trust s in the nominal links, which is the strength of the pull towards them; None: as the experiment or the
        prior states it, and where none is stated the value that makes the data most probable.
    closest
        Instead of weighing both, take the links closest to the nominal ones among those that the data do not tell from
        the best physical ones at this confidence, such as 0.95.
    weights
        ``noise`` (as ``gls``), ``channel`` (as ``wls``), or ``auto``: the first where residuals are noise, else the second.
    """

    name: str = "sdp"
    prior: Prior | None = None
    bounds: Bounds = field(default_factory=Bounds)
    metric: str = "pullback"
    rel_std: float | None = None
    closest: float | None = None
    weights: str = "auto"

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with a proof of its optimality in ``details["certificate"]``, and links of its own.

        Raises
        ------
        InputError
            The regression knows no bodies, an option is unknown, or bounds exclude each other.
        EstimationError
            The solver found nothing that proves itself.
        """
        if self.weights not in _WEIGHTS:
            raise InputError(f"sdp weights '{self.weights}': choose one of {', '.join(_WEIGHTS)}")
        if self.closest is not None and not 0 < self.closest < 1:
            raise InputError(f"sdp closest = {self.closest}: give a confidence between 0 and 1, such as 0.95")
        learned = learn_weights(regression)
        kind = self.weights if self.weights != "auto" else "noise" if learned.complete else "channel"
        factor, scale = weighted_factor(regression, learned, kind)
        hidden = unseen(factor.matrix)
        middle = None if kind == "noise" else sandwich_middle(regression, learned.noise, scale)
        matrix, target = _compressed(factor.matrix, factor.target, middle)
        data = Data.of(regression, matrix, target, self.prior)
        trust = trust_of(regression, data, self.prior, self.metric, self.rel_std)
        groups = _bounds(self, regression, data)
        solution, problem, details = _solved(self, data, trust, groups)
        if not solution.certified:
            warnings.warn(
                f"sdp: proved to a relative gap of {abs(solution.gap):.1g}, a violation of {solution.violation:.1g} and a dual "
                f"residual of {solution.stationarity:.1g} only; the motion hardly excites some links",
                BayesidWarning,
                stacklevel=2,
            )
        links = solution.x[: data.size]
        values = np.concatenate([regression.base.matrix @ links, solution.x[data.size :]])
        covariance, reason = None, "the closest body lies on the edge of what the data allow, by construction"
        if self.closest is None:
            joint = trust.stated and trust.probability >= DOUBTFUL and (trust.rel_std or 0.0) <= LARGEST_PROVED
            about = "data and nominal model" if joint else "data"
            covariance = _posterior(data, problem, regression.base.matrix) if joint else _of_data(matrix, hidden)
            reason, details["covariance_of"] = "", about
        estimate = make_estimate(self.name, regression, learned, factor, values, covariance, hidden)
        return replace(
            estimate,
            interval="none" if covariance is None else "credible" if details.get("covariance_of") != "data" else "confidence",
            interval_reason=reason,
            details={**estimate.details, "weights": kind, **details},
            links=links,
        )


@dataclass(frozen=True)
class Data:
    """What the rows say, in units of their noise: ``matrix @ x ~ target`` with unit covariance.

    Attributes
    ----------
    matrix, target
        Of x: link parameters, then effects (k, n), (k,).
    size
        Number of link parameters.
    bodies, names
        Ten columns of each body, and its name.
    """

    matrix: np.ndarray
    target: np.ndarray
    size: int
    bodies: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, regression: Regression, matrix: np.ndarray, target: np.ndarray, prior: Prior | None) -> Data:
        """Through K from base to link parameters."""
        base, r = regression.base, regression.base.rank
        bodies = regression.knowledge.bodies or (prior.bodies if prior is not None else ())
        if not bodies:
            raise InputError("sdp needs to know which columns are a body's ten parameters; give bodies=")
        for k, body in enumerate(bodies):
            if len(body) != 10 or not all(0 <= c < len(base.parameter_names) for c in body):
                raise InputError(f"bodies[{k}] = {list(body)}: give ten columns in the order {', '.join(inertia.PARAMETERS)}")
        names = [base.parameter_names[body[0]].rsplit(".", 1) for body in bodies]
        labels = tuple(n[0] if len(n) == 2 and n[1] == "m" else f"body{k + 1}" for k, n in enumerate(names))
        whole = np.concatenate([matrix[:, :r] @ base.matrix, matrix[:, r:]], axis=1)
        return cls(whole, target, base.matrix.shape[1], tuple(tuple(b) for b in bodies), labels)


def _compressed(matrix: np.ndarray, target: np.ndarray, middle: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """A factor of the inverse covariance of the estimate in the determined directions, and the target it fits exactly.

    With ``R = U S V' D`` the coordinates ``z = S V' D x`` have bread one, so their covariance is their meat.
    """
    length = np.linalg.norm(matrix, axis=0)
    length = np.where(length > 1e-14 * length.max(initial=0.0), length, 1.0)
    u, s, vt = np.linalg.svd(matrix / length)
    keep = s > 1e-11 * s[0]
    rows, rotated = s[keep][:, None] * vt[keep] * length, u.T[keep] @ target
    if middle is None:
        return rows, rotated
    whiten = vt[keep] / s[keep][:, None] / length
    covariance = whiten @ middle @ whiten.T
    lower = cholesky(0.5 * (covariance + covariance.T), lower=True)
    return solve_triangular(lower, rows, lower=True), solve_triangular(lower, rotated, lower=True)


def conic(data: Data, trust: Trust, bounds: tuple[Linear, ...] = (), strength: float = 1.0) -> Conic:
    """Data and prior as one triangular factor, by one QR decomposition; nothing is squared.

    Parameters
    ----------
    data, trust, bounds
        What is known.
    strength
        Factor of the prior's precision.
    """
    n = data.matrix.shape[1]
    root = np.sqrt(strength) * trust.root
    rows = np.zeros((len(data.target) + len(root), n + 1))
    rows[: len(data.target), :n], rows[: len(data.target), -1] = data.matrix, data.target
    rows[len(data.target) :, : data.size] = root
    rows[len(data.target) :, -1] = root @ trust.mean
    length = np.linalg.norm(rows[:, :n], axis=0)
    nothing = unseen(rows[:, :n])
    if nothing.any():
        # Columns that neither side knows, such as an effect that never acts: held at zero by next to nothing.
        hold = np.zeros((int(nothing.sum()), n + 1))
        hold[np.arange(len(hold)), np.flatnonzero(nothing)] = np.where(length > 0, 1e-6 * length, 1.0)[nothing]
        rows = np.concatenate([rows, hold])
    r = np.asarray(np.linalg.qr(rows, mode="r"))
    r = r * np.where(np.diag(r) < 0, -1.0, 1.0)[: len(r), None]
    return Conic(
        factor=r[:n, :n],
        centre=solve_triangular(r[:n, :n], r[:n, -1]),
        bodies=data.bodies,
        references=trust.references,
        bounds=bounds,
    )


def _bounds(method: Physical, regression: Regression, data: Data) -> tuple[Linear, ...]:
    n = data.matrix.shape[1]
    groups = list(method.bounds.linear(data.names, data.bodies, n))
    for k, positive in enumerate(regression.knowledge.effect_non_negative):
        if positive:
            row = np.zeros((1, n))
            row[0, data.size + k] = 1.0
            groups.append(Linear(f"{regression.effect_names[k]} >= 0", row, np.zeros(1)))
    return tuple(groups)


def _solved(method: Physical, data: Data, trust: Trust, groups: tuple[Linear, ...]) -> tuple[Solution, Conic, dict[str, Any]]:
    """The solution, the problem it solves, and what to tell about both."""
    problem = conic(data, trust, groups)
    details: dict[str, Any] = {"trust": trust.to_dict()}
    try:
        if method.metric == "entropic":
            assert trust.rel_std is not None
            solution = solve_entropic(problem, data.matrix, data.target, trust.rel_std)
        else:
            solution = solve_conic(problem)
        # The test is between data and physics alone: the nominal model is all but left out.
        nearest, tested = _nearest(data, trust, groups, solution)
        if method.closest is not None and method.metric == "entropic":
            raise InputError("sdp: closest goes with the metrics pullback and euclidean; choose one of them")
        if method.closest is not None:
            solution, problem, limit = _closest(method.closest, data, trust, groups, nearest)
            details["closest"] = {"confidence": method.closest, "largest_misfit": limit}
    except Infeasible:
        raise explain(problem) from None
    details["misfit"] = _misfit(data, solution.x)
    directions = len(data.target) - _free(data, groups)
    details["physics"] = contradiction(nearest if tested else 0.0, directions) | {"tested": tested}
    if details["physics"]["data_contradict_physics"]:
        details["warnings"] = [
            "The data contradict physics: no body that can exist fits them to their noise (chance at most "
            f"{details['physics']['probability_at_most']:.2g}). The model misses something; the intervals do not cover that."
        ]
    details["certificate"] = certificate(problem, solution, data.names)
    return solution, problem, details


def _nearest(data: Data, trust: Trust, groups: tuple[Linear, ...], solution: Solution) -> tuple[float, bool]:
    """Smallest misfit of any possible body, and whether it was found; otherwise that of the solution, which is larger."""
    own = _misfit(data, solution.x)
    if solution.iterations == 0:
        return own, True
    try:
        return min(own, _misfit(data, solve_conic(conic(data, trust, groups, trust.loosened)).x)), True
    except EstimationError:
        return own, False


def _misfit(data: Data, x: np.ndarray) -> float:
    """Squared distance from the unconstrained estimate, which fits its factor exactly."""
    return float(np.sum((data.matrix @ x - data.target) ** 2))


def _free(data: Data, groups: tuple[Linear, ...]) -> int:
    """Determined combinations of effects that no constraint speaks of."""
    held = np.zeros(data.matrix.shape[1], bool)
    held[: data.size] = True
    for group in groups:
        held |= (group.matrix != 0).any(axis=0)
    free = data.matrix[:, ~held]
    length = np.linalg.norm(free, axis=0)
    return int(np.linalg.matrix_rank(free[:, length > 0] / length[length > 0], tol=1e-9)) if (length > 0).any() else 0


def _closest(
    confidence: float, data: Data, trust: Trust, groups: tuple[Linear, ...], nearest: float
) -> tuple[Solution, Conic, float]:
    """Nearest to the nominal links among those whose misfit is at most a quantile above the best physical one's.

    ``{x: ||A x - t||^2 <= min + chi2}`` is the confidence region of the base parameters by likelihood ratio. Its
    member closest to the nominal links minimises misfit and distance weighed with a multiplier, and the misfit grows with the
    distance's weight: so the multiplier is the root of one equation, and the last problem's proof is this one's.
    """
    effects = np.linalg.matrix_rank(data.matrix[:, data.size :], tol=1e-9) if data.matrix.shape[1] > data.size else 0
    limit = nearest + float(chi2.ppf(confidence, len(data.target) - effects))

    def solved(log_strength: float) -> tuple[Solution, Conic]:
        problem = conic(data, trust, groups, float(np.exp(log_strength)))
        return solve_conic(problem), problem

    def beyond(log_strength: float) -> float:
        return _misfit(data, solved(log_strength)[0].x) / limit - 1.0

    low = float(np.log(trust.loosened))
    high = low + 3.0
    while beyond(high) < 0.0:
        if high > low + 40.0:  # the nominal links themselves fit as well as that
            return (*solved(high), limit)
        low, high = high, high + 3.0
    root: Any = brentq(beyond, low, high, xtol=1e-9)
    return (*solved(float(root)), limit)


def _posterior(data: Data, problem: Conic, base: np.ndarray) -> np.ndarray:
    """Covariance of base parameters and effects from data and nominal model, as if no constraint were there.

    The estimate is the projection of the unconstrained one onto a convex set that holds the truth, in the metric of the
    inverse covariance. A projection brings no two points further apart, so regions of that covariance about the projection
    hold the truth at least as often.
    """
    n = data.matrix.shape[1]
    through = np.zeros((len(base) + n - data.size, n))
    through[: len(base), : data.size] = base
    through[len(base) :, data.size :] = np.eye(n - data.size)
    half = solve_triangular(problem.factor, through.T, trans=1)
    return half.T @ half


def _of_data(matrix: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Covariance of the unconstrained estimate, in the determined columns.

    For a trust that is wide, doubtful or chosen by the data themselves: too cautious about an estimate that the nominal
    model pulls to the truth, but it held the truth in every case simulated (docs/physical.md).
    """
    seen = ~hidden
    length = np.linalg.norm(matrix[:, seen], axis=0)
    inverse = np.linalg.pinv(matrix[:, seen] / length, rcond=1e-12) / length[:, None]
    out = np.zeros((len(hidden), len(hidden)))
    out[np.ix_(seen, seen)] = inverse @ inverse.T
    return out
