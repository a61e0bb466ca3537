"""``sdp``: the parameters of bodies that can exist, nearest to what data and nominal model say together.

With x the link parameters phi, then the effects, b = K phi the base parameters, (b_ls, V) the unconstrained estimate and
its covariance, and phi0, s, C(s) the nominal model, its prior relative standard deviation and the covariance that this means,

    min 1/2 ||(b, e) - (b, e)_ls||^2_{V^-1}  +  1/2 ||phi - phi0||^2_{C(s)^-1}
    subject to  P_i(phi) >= 0  for every link, bounds, friction >= 0

[Wensing2018]_, [Lee2020]_. The data's part is the triangular factor of whitened rows where the residuals are noise, else
that of the channel-weighted estimate's own covariance, so that both parts are in units of the noise, and a sum of squares
can be tested. Directions that the data do not see follow the nominal model.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.stats import chi2

from bayesid.argument_types import explains_types
from bayesid.arguments import call
from bayesid.errors import BayesidWarning, EstimationError, InputError, require_one_of
from bayesid.estimators.conic.bounds import Bounds
from bayesid.estimators.conic.links import (
    LinkData,
    LinkPrior,
    closest_within,
    compressed,
    conic,
    held_columns,
    link_prior,
    misfit,
)
from bayesid.estimators.conic.problem import Conic, Infeasible, Linear, Solution, Unsolved, solve_conic, solve_entropic
from bayesid.estimators.covariance import covariance_middle
from bayesid.estimators.estimator import OPTIONAL, Details, Estimate
from bayesid.estimators.least_squares import completeness, likelihood_weights, make_estimate, weighted_factor
from bayesid.estimators.prior_check import Evidence, PriorCheck, compared
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.complaints import in_words, listed
from bayesid.regression.linalg import UNSEEN, determined_inverse, pseudo_inverse
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior

#: Data contradict physics when the test's probability is below this.
CONTRADICTION = 0.01


@dataclass(frozen=True)
class BodyCertificate:
    """Eigenvalues of a body's pseudo-inertia relative to its nominal size (4,), and its rank."""

    relative_eigenvalues: tuple[float, ...]
    rank: int


@dataclass(frozen=True)
class Certificate:
    """The certificate of an optimum as plain numbers; see `bayesid.estimators.conic.problem.Solution`."""

    certified: bool  # whether gap, violation and residual are below their limits
    #: Of the optimum: its value here, and what no feasible point can be below.
    objective: float
    lower_bound: float
    relative_gap: float
    largest_error_std: float  # how far the optimum can be, in standard deviations
    #: Residuals of the optimality conditions, and iterations of the solver.
    primal_violation: float
    dual_residual: float
    complementarity: float
    iterations: int
    margin: float  # how far inside the boundary every body is kept, relative to its size
    bodies: dict[str, BodyCertificate]  # by name
    on_boundary: tuple[str, ...]  # names of bodies on the boundary of those that can exist
    active_bounds: tuple[str, ...]  # names of bounds that hold with equality and push

    @classmethod
    def of(cls, problem: Conic, solution: Solution, names: Sequence[str]) -> Certificate:
        """The certificate of a solution; ``names`` are the bodies'."""
        gap = max(solution.objective - solution.bound, 0.0)
        return cls(
            certified=solution.certified,
            objective=solution.objective,
            lower_bound=solution.bound,
            relative_gap=solution.gap,
            largest_error_std=float(np.sqrt(2.0 * gap)),
            primal_violation=solution.violation,
            dual_residual=solution.stationarity,
            complementarity=solution.complementarity,
            iterations=solution.iterations,
            margin=problem.margin,
            bodies={
                name: BodyCertificate(tuple(values.tolist()), int(rank))
                for name, values, rank in zip(names, solution.eigenvalues, solution.ranks, strict=True)
            },
            on_boundary=tuple(name for name, rank in zip(names, solution.ranks, strict=True) if rank < 4),
            active_bounds=tuple(solution.active),
        )


@dataclass(frozen=True)
class PhysicsTest:
    """Whether the unconstrained estimate and bodies that can exist are further apart than noise explains."""

    distance: float  # squared, in units of the noise; where the nearest body was not found, a lower bound of it
    directions: int  # number of determined combinations that the constraints speak of
    probability_at_most: float  # upper bound on the probability of such a distance when bodies can exist
    data_contradict_physics: bool  # whether that is below `CONTRADICTION`
    tested: bool  # whether the nearest body that can exist was found

    @classmethod
    def of(cls, distance: float, directions: int, tested: bool) -> PhysicsTest:
        """Test whether a distance from possible bodies is more than noise explains.

        ``distance = min (x - x_ls)' V^-1 (x - x_ls)`` over all possible bodies is at most the distance of the true ones,
        which is chi-squared; its own law is a mixture of chi-squared ones with fewer degrees [Shapiro1988]_. So the
        probability is an upper bound, whatever the truth and wherever on the cone: the test never errs more often than it says.
        """
        probability = float(chi2.sf(distance, directions)) if directions else 1.0
        return cls(float(distance), directions, probability, probability < CONTRADICTION, tested)


def explain(problem: Conic) -> InputError:
    """The smallest set of bounds that no body can meet together, found by leaving out one after the other."""
    # Any regular objective will do; in units of the body's size the solver is well conditioned.
    plain = replace(problem, factor=np.diag(1.0 / problem.units))
    conflicting = list(problem.bounds)
    for group in problem.bounds:
        rest = [g for g in conflicting if g is not group]
        if not _feasible(plain, rest):
            conflicting = rest
    if not conflicting:
        return InputError("bounds: no body can meet them; leave some out")
    if len(conflicting) == 1:
        return InputError(f"bounds: no body that can exist has {conflicting[0].name}; widen it")
    return InputError(f"bounds: {in_words([g.name for g in conflicting])} exclude each other; widen one of them")


def _feasible(problem: Conic, bounds: Sequence[Linear]) -> bool:
    try:
        return solve_conic(replace(problem, bounds=tuple(bounds))).violation < 1e-6
    except (Infeasible, EstimationError):
        return False


_TOLERANCE = 1e-9


def possible_range(base: np.ndarray, bodies: Sequence[Sequence[int]], bounds: Sequence[Linear], effects: int) -> np.ndarray:
    """Smallest and largest value that base parameters and effects of a possible robot can have (2, r + e), with K (r, P).

    A combination ``k' phi`` is the sum of ``tr(A_i P_i)`` over bodies with pseudo-inertias ``P_i >= 0``. These are free of each
    other and of any size, so it is at least 0 exactly when every ``A_i >= 0``, at most 0 when every ``A_i <= 0``, and otherwise
    any number. Bounds of one parameter, over links and effects (P + e), narrow that. An interval for a true value that is
    possible covers it no less often without what lies outside.
    """
    rank, size = base.shape
    through = np.asarray(block_diag(base, np.eye(effects)))
    out = np.tile([[-np.inf], [np.inf]], rank + effects)
    others = np.setdiff1d(np.arange(size), np.concatenate([list(b) for b in bodies]) if bodies else [])
    for k, row in enumerate(base):
        if np.any(row[others]):
            continue
        # A with ``tr(A P)`` the sum of a body's ten parameters times these coefficients.
        values = np.linalg.eigvalsh(np.array([np.tensordot(row[list(b)], _DUAL, 1) for b in bodies]))
        slack = _TOLERANCE * np.abs(values).max()
        if values.min() >= -slack:
            out[0, k] = 0.0
        elif values.max() <= slack:
            out[1, k] = 0.0
    length = np.linalg.norm(through, axis=1)
    for group in bounds:
        for row, low in zip(group.matrix, group.low, strict=True):
            along = through @ row
            for k in np.flatnonzero(np.abs(along) >= (1.0 - _TOLERANCE) * length * np.linalg.norm(row)):
                limit = low * length[k] ** 2 / along[k]
                side = 0 if along[k] > 0 else 1
                out[side, k] = max(out[0, k], limit) if side == 0 else min(out[1, k], limit)
    return out


#: ``tr(_DUAL[k] BASIS[l])`` is 1 where k = l, else 0 (10, 4, 4).
_DUAL = np.tensordot(np.linalg.inv(np.einsum("kij,lij->kl", inertia.BASIS, inertia.BASIS)), inertia.BASIS, 1)


#: Up to this prior relative standard deviation intervals of data and nominal model together cover as often as they say in
#: simulation (docs/studies/physical).
LARGEST_VALIDATED = 0.2
#: Where data as far from the nominal links are less probable than this, the prior is doubtful and left out of intervals.
DOUBTFUL = 0.05
_WEIGHTS = ("auto", "channel", "noise")


@explains_types
@dataclass(frozen=True)
class Physical:
    """Estimate of physically consistent links.

    Attributes
    ----------
    prior
        Nominal links and how uncertain they are; None: those of the regression.
    bounds
        What is known for sure beyond that bodies exist.
    metric
        How the distance to the nominal links is measured: ``warped`` (the prior's own: links scaled, shifted and warped),
        ``pullback``, ``euclidean`` or ``entropic``.
    rel_std
        Prior relative standard deviation s of the nominal links, which sets the strength of the pull towards them; None: as
        the experiment or the prior states it, and where none is stated the value that makes the data most probable;
        one above 1 found so means next to no pull.
    closest
        Instead of weighing both, take the links closest to the nominal ones among those that the data do not tell from
        the best physical ones at this confidence, such as 0.95.
    weights
        ``noise`` (as ``gls``), ``channel`` (as ``wls``), or ``auto``: the first where residuals are noise, else the second.
    """

    name: str = "sdp"
    prior: Prior | None = None
    bounds: Bounds = field(default_factory=Bounds)
    metric: str = "warped"
    rel_std: float | None = None
    closest: float | None = None
    weights: str = "auto"

    def fit(self, regression: Regression) -> Estimate:
        """Estimate with a certificate of its optimality in ``details.certificate``, and links of its own.

        Raises
        ------
        InputError
            The regression knows no bodies, an option is unknown, or bounds exclude each other.
        EstimationError
            The solver found nothing whose certificate holds.
        """
        require_one_of(self.weights, _WEIGHTS, f"sdp weights '{self.weights}'")
        if self.closest is not None and not 0 < self.closest < 1:
            raise InputError(f"sdp closest = {self.closest}: give a confidence between 0 and 1, such as 0.95")
        learned = learn_weights(regression)
        kind = self.weights if self.weights != "auto" else likelihood_weights(learned)
        factor, scale = weighted_factor(regression, learned, kind)
        middle = covariance_middle(regression, learned, scale, factor)
        matrix, target = compressed(factor.matrix, factor.target, middle.matrix)
        data = LinkData.of(regression, matrix, target, self.prior)
        evidence = evidence_of(matrix, target, factor.undetermined, regression.base.rank)
        prior = link_prior(regression, data, evidence, self.prior, self.metric, self.rel_std)
        groups = _bounds(self, regression, data)
        solution, problem, physics, closest = _solved(self, data, prior, groups)
        if not solution.certified:
            warnings.warn(
                f"sdp: certified to a relative gap of {abs(solution.gap):.1g}, a violation of {solution.violation:.1g} and "
                f"a dual residual of {solution.stationarity:.1g} only; the motion hardly excites some links: "
                "add motions, or state how far the nominal links are to be trusted (inertia_rel_std)",
                BayesidWarning,
                stacklevel=2,
            )
        links = solution.x[: data.size]
        values = np.concatenate([regression.base.matrix @ links, solution.x[data.size :]])
        covariance, reason, about = None, "the closest body lies on the edge of what the data allow, by construction", None
        if self.closest is None:
            joint = prior.stated and prior.probability >= DOUBTFUL and (prior.rel_std or 0.0) <= LARGEST_VALIDATED
            about, reason = "data and nominal model" if joint else "data", ""
            # Of the data alone, for a prior that is wide, doubtful or chosen by the data themselves: too cautious about an
            # estimate that the nominal model pulls to the truth, but it held that in every case simulated
            # (docs/studies/physical).
            inverse = pseudo_inverse(matrix, UNSEEN)
            covariance = _posterior(data, problem, regression.base.matrix) if joint else inverse @ inverse.T
        estimate = make_estimate(self.name, regression, learned, factor, values, covariance)
        details = PhysicalDetails(
            **completeness(learned, middle.dispersion),
            weights=kind,
            prior=prior,
            closest=closest,
            misfit=misfit(data, solution.x),
            physics=physics,
            certificate=Certificate.of(problem, solution, data.names),
            covariance_of=about,
            warnings=(_contradiction(physics, solution.active),) if physics.data_contradict_physics else (),
        )
        return replace(
            estimate,
            interval="none" if estimate.covariance is None else "credible" if about != "data" else "confidence",
            interval_reason=reason or estimate.interval_reason,
            details=details,
            links=links,
            possible=possible_range(regression.base.matrix, data.bodies, groups, len(regression.effect_names)),
        )


@dataclass(frozen=True)
class Closest:
    """The confidence that was asked for, and the misfit that it allows."""

    confidence: float
    largest_misfit: float


@dataclass(frozen=True, kw_only=True)
class PhysicalDetails(Details):
    """What a physically consistent estimate says."""

    weights: str  # ``noise`` or ``channel``
    prior: LinkPrior = field(metadata={"key": "trust"})  # the nominal model and its strength; ``trust`` in ``estimate.json``
    closest: Closest | None = field(default=None, metadata=OPTIONAL)  # with `Physical.closest`
    misfit: float  # squared distance from the unconstrained estimate, in units of the noise
    physics: PhysicsTest  # whether the data contradict physics
    certificate: Certificate  # of the optimum
    #: ``data and nominal model`` or ``data``; None: there is no covariance.
    covariance_of: str | None = field(default=None, metadata=OPTIONAL)


def _bounds(method: Physical, regression: Regression, data: LinkData) -> tuple[Linear, ...]:
    n = data.matrix.shape[1]
    groups = list(method.bounds.linear(data.names, data.bodies, n))
    for k, positive in enumerate(regression.knowledge.effect_non_negative):
        if positive:
            row = np.zeros((1, n))
            row[0, data.size + k] = 1.0
            groups.append(Linear(f"{regression.effect_names[k]} >= 0", row, np.zeros(1)))
    return tuple(groups)


def _solved(
    method: Physical, data: LinkData, prior: LinkPrior, groups: tuple[Linear, ...]
) -> tuple[Solution, Conic, PhysicsTest, Closest | None]:
    """The solution, the problem it solves, and what the data say of physics."""
    if method.closest is not None and method.metric == "entropic":
        raise InputError("sdp: closest goes with the metrics warped, pullback and euclidean; choose one of them")
    problem, closest = conic(data, prior, groups), None
    try:
        if method.metric == "entropic":
            assert prior.rel_std is not None
            root = np.zeros((len(prior.root), data.matrix.shape[1]))
            root[:, : data.size] = prior.root
            held = held_columns(np.concatenate([data.matrix, root]))
            rows, target = np.concatenate([data.matrix, held]), np.append(data.target, np.zeros(len(held)))
            solution = solve_entropic(problem, rows, target, prior.rel_std)
        else:
            solution = solve_conic(problem)
        # The test is between data and physics alone: the nominal model is all but left out.
        least, nearest = _nearest(data, prior, groups, solution)
        if method.closest is not None:
            # Among those whose misfit is at most a quantile above the best physical one's: ``{x: ||A x - t||^2 <= min + chi2}``
            # is the confidence region of the base parameters by likelihood ratio.
            effects = np.linalg.matrix_rank(data.matrix[:, data.size :], tol=1e-9) if data.matrix.shape[1] > data.size else 0
            limit = nearest + float(chi2.ppf(method.closest, len(data.target) - effects))
            solution, problem = closest_within(limit, data, prior, groups)
            closest = Closest(method.closest, limit)
    except Infeasible:
        raise explain(problem) from None
    directions = len(data.target) - _free(data, groups)
    return solution, problem, PhysicsTest.of(least, directions, nearest == least), closest


def _contradiction(physics: PhysicsTest, bounds: Sequence[str]) -> str:
    chance = f"(chance at most {physics.probability_at_most:.2g})"
    if bounds:
        return (
            f"The data contradict what is stated: within {listed(bounds, 4)}, where the estimate ends, no body fits them to "
            f"their noise {chance}, and the intervals do not cover that. Is the bound right? Else the model misses something; "
            f"`{call('diagnose')}` looks for it."
        )
    return (
        f"The data contradict physics: no body that can exist fits them to their noise {chance}. The model misses something, "
        f"which the intervals do not cover; `{call('diagnose')}` looks for it."
    )


def _nearest(data: LinkData, prior: LinkPrior, groups: tuple[Linear, ...], solution: Solution) -> tuple[float, float]:
    """Least misfit that a possible body can have, and that of the nearest one found: the same where that is the optimum."""
    own = misfit(data, solution.x)
    if solution.iterations == 0:
        return own, own
    try:
        nearest = min(own, misfit(data, solve_conic(conic(data, prior, groups, prior.loosened)).x))
    except Unsolved as error:
        # Twice the objective is the misfit with what is left of the prior, above that of the unconstrained minimiser.
        return min(own, 2.0 * max(error.bound, 0.0)), own
    return nearest, nearest


def _free(data: LinkData, groups: tuple[Linear, ...]) -> int:
    """Determined combinations of effects that no constraint speaks of."""
    held = np.zeros(data.matrix.shape[1], bool)
    held[: data.size] = True
    for group in groups:
        held |= (group.matrix != 0).any(axis=0)
    free = data.matrix[:, ~held]
    length = np.linalg.norm(free, axis=0)
    return int(np.linalg.matrix_rank(free[:, length > 0] / length[length > 0], tol=1e-9)) if (length > 0).any() else 0


def _posterior(data: LinkData, problem: Conic, base: np.ndarray) -> np.ndarray:
    """Covariance of base parameters and effects from data and nominal model, as if no constraint were there.

    The estimate is the projection of the unconstrained one onto a convex set that holds the truth, in the metric of the
    inverse covariance. A projection brings no two points further apart, so regions of that covariance about the projection
    hold the truth at least as often.
    """
    through = np.asarray(block_diag(base, np.eye(data.matrix.shape[1] - data.size)))
    half = solve_triangular(problem.factor, through.T, trans=1)
    return half.T @ half


def evidence_of(matrix: np.ndarray, target: np.ndarray, hidden: np.ndarray, rank: int) -> Evidence:
    """Base parameters by the data alone, of what `compressed` gives; ``hidden`` are columns that they do not determine (p,)."""
    inverse = determined_inverse(matrix, hidden)
    return (inverse @ target)[:rank], (inverse @ inverse.T)[:rank, :rank], hidden[:rank]


def against_prior(regression: Regression, prior: Prior, rel_std: float | None = None) -> PriorCheck | None:
    """Check a prior of the links against what the rows say by themselves; None where they determine nothing."""
    return compared(regression.base, _evidence_of_data(regression), prior.mean, prior.root, rel_std)


def against_nominal(regression: Regression, estimate: Estimate) -> PriorCheck | None:
    """Check an estimate's data against its prior, or against nominal links with a stated deviation; None without either."""
    details, known = estimate.details, regression.knowledge
    if not known.states_masses:
        return None
    if isinstance(details, PhysicalDetails):
        return details.prior.check
    if known.nominal_links is None or not known.inertia_rel_std:
        return None
    prior, covariance = known.prior(known.inertia_rel_std), estimate.covariance
    evidence = _evidence_of_data(regression) if covariance is None else (estimate.values, covariance, estimate.undetermined)
    return compared(regression.base, evidence, prior.mean, prior.root, known.inertia_rel_std)


def _evidence_of_data(regression: Regression) -> Evidence:
    """Base parameters by the likelihood alone.

    Weighted as `sdp` and the posterior do: by the noise where the model is complete, else by channel, and then with the
    scatter between parts of the recording in the covariance.
    """
    learned = learn_weights(regression)
    factor, scale = weighted_factor(regression, learned, likelihood_weights(learned))
    middle = covariance_middle(regression, learned, scale, factor)
    matrix, target = compressed(factor.matrix, factor.target, middle.matrix)
    return evidence_of(matrix, target, factor.undetermined, regression.base.rank)
