"""Exact fits of the links and any effects, and how much the data prefer one set of effects to another.

Links and offset are projected out (`bayesid.diagnosis.projector`). What is left are a handful of parameters, found by
Gauss-Newton steps on the exact readings. An effect that has hardly moved keeps its derivatives from step to step and from one
fit to the next; a fit ends only where derivatives of all effects, made anew, find nothing to gain. Fits can be taken a few steps
at a time, so that hopeless ones are given up early.

Models are compared by ``score = -chi2 / 2 - log det S / 2 - k / 2 log n`` over n rows: the evidence under a prior with the
information of one row for each of the k parameters [Schwarz1978]_. The noise S matters where a model makes more of it than
another does: a flexible joint differentiates the encoders' errors twice more. How far an effect differs from zero is told by one
rule for every verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from scipy.stats import chi2, norm

from bayesid.diagnosis.data import DiagnosisData, fitted_values, term_rows
from bayesid.diagnosis.grams import schwarz
from bayesid.diagnosis.projector import NuisanceProjector
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect, Term
from bayesid.effects.bodies import body_of, split_matrix
from bayesid.robot.prior import Prior, typical_links

#: Gauss-Newton steps at most; and of a start that is to be compared with others first. Few fits need half of them.
STEPS, FEW_STEPS = 15, 5
#: Rounds at most of what is repeated until nothing changes; most settle in the first.
SWEEPS = 3
#: A fit has settled where chi2 changes by less than this, in units of its mean: a hundredth of a log evidence.
_SETTLED = 0.02
#: Damping of the first step, in units of a column's squared length, and how often a step is damped more.
_DAMPING, _TRIALS = 1e-3, 6
#: Sizes that a change of a link is tried with, over its own; the last link of an arm may carry a hundred times its own weight.
WIDTHS = np.array([0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0])
#: Share of a column's length that must be left once the links are projected out.
ALIVE = 1e-5
#: A column in sigmas per SI unit this small is rounding: a million newtons or radians would not be seen.
_ROUNDING = 1e-6
#: A parameter with this share in a direction that the data do not show is not determined; less is rounding of that direction.
_HIDDEN = 1e-3


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Whitened derivatives of the readings with respect to a term's `fitted_values`."""

    values: np.ndarray  # these (k,), where they were taken
    rows: np.ndarray  # (rows, k)

    def changed_by(self, term: Term) -> float:
        """Sum of squares of the change of whitened readings from those values to a term's."""
        return float(np.sum((self.rows @ (np.array(term.values)[fitted_values(term)] - self.values)) ** 2))


@dataclass(frozen=True, eq=False)
class Fit:
    """A model fitted to the identification motions."""

    projector: NuisanceProjector  # what it was fitted with
    terms: tuple[Term, ...]  # effects with their values
    links: np.ndarray  # (10 b,)
    offset: np.ndarray  # constant offset (c,), zero where none is fitted
    chi2: float  # sum of squares of whitened rows and of the links against their prior
    parameters: int  # how many of the effects' parameters the data determine
    score: float  # see the module
    covariance: np.ndarray  # of the effects' free parameters in the order of ``terms`` (k, k), the links' uncertainty included
    by_noise: np.ndarray  # the same by the noise alone, however the residuals scatter (k, k)
    determined: np.ndarray  # whether the data tell each of them from the others (k,)
    #: Changes of them that the data do not show (k, m), each as large as one of them is known that shows alone, or one unit.
    unshown: np.ndarray
    free: tuple[tuple[int, int], ...]  # (term, parameter) of each of them
    coordinates: np.ndarray  # the links and the offset in the coordinates of `NuisanceProjector` (size,)
    residual: np.ndarray  # whitened rows (rows,)
    derivatives: Mapping[Effect, Derivatives]  # of the readings, by effect that is fitted

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Whitened derivatives of the readings with respect to all free parameters (rows, k)."""
        return _side_by_side(self.projector, self.terms, self.derivatives)

    @cached_property
    def bias(self) -> np.ndarray:
        """Expected error of the effects' free parameters by `DiagnosisData.attenuation`, to first order (k,), in their values."""
        found = self.projector.data.attenuation
        added = [found[self.terms[i].effect][k] if self.terms[i].effect in found else 0.0 for i, k in self.free]
        return self.by_noise @ np.array(added)

    @property
    def leaves_noise(self) -> bool:
        """Whether it leaves no more than the noise."""
        return self.chi2 < self.projector.data.settings.unexplained * self.projector.rows

    def std(self, index: int, dispersion: float) -> np.ndarray:
        """Standard deviations of one term's free parameters, by its index; infinite where the data do not determine them.

        An expected error that is taken out (`unbiased`) is known about to its own size.
        """
        at = self.columns_of(index)
        std = np.sqrt(np.maximum(dispersion * np.diag(self.covariance)[at], 0.0) + self.bias[at] ** 2)
        return np.where(self.determined[at], std, np.inf)

    def unbiased(self, index: int) -> Term:
        """One term, by its index, with the expected error taken out of its values."""
        at = self.columns_of(index)
        change = np.zeros(len(self.free))
        change[at] = -self.bias[at]
        return _moved(self.terms, self.free, change)[index] if change.any() else self.terms[index]

    def columns_of(self, index: int) -> list[int]:
        """Which free parameters are those of one term."""
        return [column for column, (owner, _) in enumerate(self.free) if owner == index]


@dataclass(frozen=True, eq=False)
class Iterate:
    """A fit under way."""

    projector: NuisanceProjector  # the columns that are always in
    terms: tuple[Term, ...]  # effects with their values so far
    free: tuple[tuple[int, int], ...]  # (term, parameter) of those that are fitted
    coordinates: np.ndarray  # links and offset (size,)
    #: Whitened residual (rows,) and that of the prior (size,).
    rows: np.ndarray
    prior: np.ndarray
    chi2: float  # sum of squares of both
    damping: float = _DAMPING  # of the next step
    steps: int = 0  # taken so far
    settled: bool = False  # whether no step is left to take
    #: Of the readings, by effect that is fitted; some may be those of values close by.
    derivatives: Mapping[Effect, Derivatives] = field(default_factory=dict)
    exact: bool = False  # whether all of them are those of the values and links as they are
    made: Mapping[Effect, Derivatives] = field(default_factory=dict)  # those that are known to be


def begin(projector: NuisanceProjector, terms: Sequence[Term], start: Fit | None = None) -> Iterate:
    """A fit before its first step, from the links and the offset of another one."""
    data, terms = projector.data, tuple(terms)
    u = np.zeros(projector.size) if start is None else start.coordinates.copy()
    free = tuple((i, k) for i, t in enumerate(terms) if not data.fixed(t) for k in range(len(t.values))[fitted_values(t)])
    rows, prior = projector.residual(u, terms), projector.prior_residual(u)
    known = start.derivatives if start is not None and start.projector is projector else {}
    return Iterate(projector, terms, free, u, rows, prior, float(rows @ rows + prior @ prior), derivatives=known)


def advance(now: Iterate, steps: int) -> Iterate:
    """The fit after so many Gauss-Newton steps more, fewer if it settles."""
    for _ in range(steps):
        if now.settled:
            break
        now = _stepped(now)
    return now


def _stepped(now: Iterate) -> Iterate:
    """One damped Gauss-Newton step; or none, where derivatives from close by find none and all are to be made anew."""
    projector, free, terms, u = now.projector, now.free, now.terms, now.coordinates
    damping = now.damping
    # What matters is a change beside all that no model explains, as evidence is judged.
    left_over = max(now.chi2 / max(projector.rows, 1), 1.0)
    links, _ = projector.split(u)
    derivatives, made = _derivatives(projector, links, terms, now.derivatives, left_over, now.made)
    exact = len(made) == len(derivatives)
    anew = replace(now, derivatives={}, made=made)
    jacobian = _side_by_side(projector, terms, derivatives)
    if not np.isfinite(jacobian).all():
        return replace(now, settled=True)
    stacked = np.concatenate([now.rows, -now.prior])
    kept = projector.columns(jacobian)
    length = np.linalg.norm(kept, axis=0)
    alive = _alive(length, jacobian)
    scale = np.where(alive, length, np.inf)
    settled = _SETTLED * left_over
    scaled, left = kept / scale, projector.project_out(stacked)
    gram, pull = scaled.T @ scaled, scaled.T @ left
    limits = _at_limits(terms, free)
    # What is left if the readings are linear: a fit that comes down to just that is done, and its values are a
    # hundredth of their standard deviation from the best ones.
    changed = _changes(gram, pull, alive, limits)
    best = changed(0.0)
    least, close = float(left @ left - best @ (2.0 * pull - gram @ best)), 0.01 * settled
    if now.chi2 - least < close:
        return replace(now, settled=True, derivatives=derivatives, exact=True) if exact else anew
    for _ in range(_TRIALS if exact else 1):
        # [Levenberg1944]_, [Marquardt1963]_: where a direction says nothing yet (a point without a force), hold it back.
        trial = _moved(terms, free, changed(damping) / scale)
        taken = np.array([trial[i].values[k] - terms[i].values[k] for i, k in free])
        moved = u
        if projector.size:
            back = stacked.copy()
            back[: projector.length] -= jacobian @ taken
            moved = u + np.linalg.solve(projector.r, projector.q.T @ back)
        rows, prior = projector.residual(moved, trial), projector.prior_residual(moved)
        chi2 = float(rows @ rows + prior @ prior)
        if now.chi2 - chi2 > -settled:
            done = now.chi2 - chi2 < settled or abs(chi2 - least) < close
            return replace(
                now, terms=trial, coordinates=moved, rows=rows, prior=prior, chi2=chi2, steps=now.steps + 1,
                damping=0.1 * damping if damping > 1e-7 else 0.0, settled=done and exact,
                derivatives={} if done else derivatives, exact=False, made={},
            )  # fmt: skip
        damping = max(10.0 * damping, 1e-4)
    return replace(now, settled=True, derivatives=derivatives, exact=True) if exact else anew


def _derivatives(
    projector: NuisanceProjector, links: np.ndarray, terms: tuple[Term, ...], known: Mapping[Effect, Derivatives], change: float,
    made: Mapping[Effect, Derivatives],
) -> tuple[dict[Effect, Derivatives], dict[Effect, Derivatives]]:  # fmt: skip
    """Derivatives by effect that is fitted, and those among them that are of the values and links as they are.

    Those that are ``made`` already are; those that are ``known`` stay where the effect's values have changed the whitened
    readings by less since.
    """
    data, out, anew = projector.data, {}, {}
    for t in terms:
        if data.fixed(t):
            continue
        own = known.get(t.effect)
        if t.effect in made:
            out[t.effect] = anew[t.effect] = made[t.effect]
        elif own is not None and own.changed_by(t) < change:
            out[t.effect] = own
        else:
            beside = tuple(x for x in terms if x is not t)
            rows = term_rows(data, data.segments, links, beside, t)
            out[t.effect] = anew[t.effect] = Derivatives(np.array(t.values)[fitted_values(t)], rows)
    return out, anew


def _side_by_side(projector: NuisanceProjector, terms: tuple[Term, ...], derivatives: Mapping[Effect, Derivatives]) -> np.ndarray:
    """Derivatives with respect to all free parameters (rows, k)."""
    none = np.zeros((projector.length, 0))
    return np.hstack([none, *(derivatives[t.effect].rows for t in terms if t.effect in derivatives)])


def _at_limits(terms: tuple[Term, ...], free: Sequence[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Which parameters are at their lower and at their upper limit (k,)."""
    values = np.array([terms[i].values[k] for i, k in free])
    lower, upper = (np.array([getattr(terms[i].effect, end)[k] for i, k in free]) for end in ("lower", "upper"))
    return values <= lower, values >= upper


def _changes(
    gram: np.ndarray, pull: np.ndarray, alive: np.ndarray, limits: tuple[np.ndarray, np.ndarray]
) -> Callable[[float], np.ndarray]:
    """The change of those alive among scaled parameters (k,), by the damping.

    What is at a limit and would pass it stays, and the others are found without it: else they would make up for a change that is
    not made. What only comes to a limit is cut off there later: held from here on, more fits end in a poor place.
    """
    lower, upper = limits

    @cache
    def eigen(some: bytes) -> tuple[np.ndarray, np.ndarray]:
        open_ = np.frombuffer(some, bool)
        return _eigen(gram[np.ix_(open_, open_)])

    def changed(damping: float) -> np.ndarray:
        open_ = alive
        while True:
            out = np.zeros(len(pull))
            if not open_.any():
                return out
            values, vectors = eigen(open_.tobytes())
            out[open_] = (vectors / (values + damping)) @ (vectors.T @ pull[open_])
            stays = (lower & (out < 0.0)) | (upper & (out > 0.0))
            if not stays.any():
                return out
            open_ = open_ & ~stays

    return changed


def finish(now: Iterate) -> Fit:
    """The fit as it stands, with its covariance and score; without a score where it diverged or an effect is another one."""
    projector, free, terms = now.projector, now.free, now.terms
    data, rows, chi2 = projector.data, now.rows, now.chi2
    links, offset = projector.split(now.coordinates)
    derivatives = now.derivatives if now.exact else _derivatives(projector, links, terms, {}, 0.0, now.made)[0]
    jacobian = _side_by_side(projector, terms, derivatives)
    possible = bool(np.isfinite(chi2) and projector.finite and np.isfinite(jacobian).all())
    if not possible:  # diverged: refused
        jacobian, rows, chi2, derivatives = np.zeros(jacobian.shape), np.zeros(len(rows)), np.inf, {}
    kept = projector.columns(jacobian) if possible else np.zeros((len(projector.q), len(free)))
    length = np.linalg.norm(kept, axis=0)
    safe = np.where(_alive(length, jacobian), length, np.inf)
    values, vectors = _eigen((kept / safe).T @ (kept / safe))
    determined = np.sum(vectors**2, axis=1) > 1.0 - _HIDDEN**2
    silent = np.linalg.qr(vectors, mode="complete")[0][:, len(values) :]
    unshown = silent / np.where(np.isfinite(safe), safe, 1.0)[:, None]
    covariance = (vectors / values) @ vectors.T / np.outer(safe, safe)
    widened = _widened(projector, covariance, kept, rows)
    cost = price(data, projector.rows, terms, free, kept)
    score = -0.5 * chi2 - 0.5 * projector.volume - cost if possible else -np.inf
    out = Fit(
        projector, terms, links, offset, chi2, len(values), score, widened, covariance, determined, unshown, free,
        now.coordinates, rows, derivatives,
    )  # fmt: skip
    return replace(out, score=-np.inf) if possible and any(is_another(out, k) for k in range(len(terms))) else out


def is_another(best: Fit, index: int) -> bool:
    """Whether an effect that is not the user's has values at which it is no more than other effects are.

    A value is known to where it brings the odds by which rivals are told apart.
    """
    term, data = best.terms[index], best.projector.data
    if not term.effect.may_be_another or any(t.effect == term.effect for t in data.terms):
        return False
    sigmas = np.sqrt(2.0 * (data.settings.rival + schwarz(1, best.projector.rows)))
    travel = 0.0 if term.effect.joint is None else float(data.travel[term.effect.joint])
    return term.effect.is_another(term.values, sigmas * best.std(index, 1.0), travel)


def fit(projector: NuisanceProjector, terms: Sequence[Term], start: Fit | None = None, steps: int | None = None) -> Fit:
    """Fit links, offset and the effects' free parameters from their starting values, links and offset from those of ``start``.

    At most ``steps`` Gauss-Newton steps are taken; default `STEPS`.
    """
    return finish(advance(begin(projector, terms, start), STEPS if steps is None else steps))


def _widened(projector: NuisanceProjector, covariance: np.ndarray, kept: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The covariance, no smaller than what the residuals' own scatter makes of it.

    The sandwich ``C (sum_g s_g s_g' + P'P) C`` with the scores s_g of groups of neighbouring frequencies and the prior's
    rows P holds also where the noise is louder in some band than was thought [White1980]_. Where its standard deviation is
    larger, it replaces the model's, with the model's correlations.
    """
    if not covariance.size:
        return covariance
    scores, at = [], 0
    for s in projector.data.segments:
        size = s.shape[0] * s.shape[1]
        product = kept[at : at + size] * rows[at : at + size, None]
        edges = np.arange(0, size, projector.data.settings.neighbours * s.shape[1])
        scores.append(np.add.reduceat(product, edges, axis=0))
        at += size
    groups = np.vstack(scores)
    prior = kept[projector.length :]
    middle = groups.T @ groups * len(groups) / max(len(groups) - kept.shape[1], 1) + prior.T @ prior
    sandwich = np.diag(covariance @ middle @ covariance)
    own = np.diag(covariance)
    factor = np.sqrt(np.maximum(sandwich / np.where(own > 0, own, np.inf), 1.0))
    return covariance * np.outer(factor, factor)


def price(data: DiagnosisData, rows: int, terms: Sequence[Term], free: Sequence[tuple[int, int]], kept: np.ndarray) -> float:
    """What the free parameters cost: ``k / 2 log n``; for a changed link what its prior takes away from the evidence.

    The change is ``w R y`` with y ~ N(0, 1), R R' a prior as wide as the body itself and the width w that suits the estimate
    best. In the eigenvectors of ``R' Z' Z R``, eigenvalues l and Z the columns, estimates x = R y of least squares cost

        sum of [l y^2 / (1 + w^2 l) + log(1 + w^2 l)] / 2,  and the logarithm of the number of widths tried.

    ``free`` holds (term, parameter) of what is fitted, and ``kept`` what links and offset leave of its columns, whitened, or a
    triangular factor of that (rows, k).
    """
    total = 0.0
    for i, t in enumerate(terms):
        mine = kept[:, [column for column, (term, _) in enumerate(free) if term == i]]
        if t.effect.changes_link and mine.shape[1]:
            prior = _body_covariance(data, t.effect.joint or 0)
            size = np.sqrt(np.diag(prior))
            root = size[:, None] * np.linalg.cholesky(prior / np.outer(size, size) + 1e-12 * np.eye(10))
            energy, vectors = np.linalg.eigh(root.T @ (mine.T @ mine) @ root)
            y, energy = vectors.T @ np.linalg.solve(root, np.array(t.values)), np.maximum(energy, 0.0)
            spread = 1.0 + WIDTHS[:, None] ** 2 * energy
            total += 0.5 * float(np.min(np.sum(energy * y**2 / spread + np.log(spread), axis=1))) + np.log(len(WIDTHS))
        elif mine.shape[1]:
            length = np.linalg.norm(mine, axis=0)
            unit = mine / np.where(length > 0, length, 1.0)
            total += schwarz(len(_eigen(unit.T @ unit)[0]), rows)
    return total


def _body_covariance(data: DiagnosisData, joint: int) -> np.ndarray:
    """Covariance of changes as wide as the body that changes at a joint, in the joint's frame (10, 10).

    Of a body without mass nothing is known but about what links of its length weigh.
    """
    robot, at = data.robot, body_of(data.robot, joint)
    body = data.links[10 * at : 10 * at + 10]
    own = Prior.warped(body if body[0] > 0.0 else typical_links(robot)[at], 1.0).covariance
    if at == joint:
        return own
    moved = split_matrix(robot, at)
    return moved @ own @ moved.T


def _alive(length: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Whether what is left of columns can say anything: a share of them, and more than rounding (k,)."""
    return (length > ALIVE * np.linalg.norm(jacobian, axis=0)) & (length > _ROUNDING)


def _eigen(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and vectors of the Gram matrix of scaled columns, without directions that are not there."""
    values, vectors = np.linalg.eigh(gram) if len(gram) else (np.zeros(0), np.zeros((0, 0)))
    keep = values > 1e-9
    return values[keep], vectors[:, keep]


def _moved(terms: tuple[Term, ...], free: Sequence[tuple[int, int]], change: np.ndarray) -> tuple[Term, ...]:
    """The terms with their free parameters changed, inside what is possible."""
    values = [np.array(t.values, float) for t in terms]
    for (i, k), d in zip(free, change, strict=True):
        effect = terms[i].effect
        values[i][k] = np.clip(values[i][k] + d, effect.lower[k], effect.upper[k])
    return tuple(replace(t, values=tuple(v)) for t, v in zip(terms, values, strict=True))


def distance(best: Fit, index: int) -> tuple[float, int]:
    """Squared distance from zero of what makes an effect one, in units of its covariance, and how many values that takes.

    That are the parameters that readings are linear in: without a force there is no contact, however well its window and its
    point are known, and without stiffness no tether. An effect that has none of them, as a delay, is measured by all of its
    parameters that are determined: how firm teeth are that are firmer than readings show says nothing of the gap between them.

    Where the interval of its shape lies within what is plausible, the covariance is that at this shape, whose values count, too:
    of a friction that is the larger the smaller its coupling is, no single number is known, yet it is there, and beside an
    uncertain shape the usual distance becomes the smaller the more there is [Hauck1977]_. Else another shape would do with
    another size. Of what happens once the values that fit stand for the interval: torques of few joints do not tell a force from
    its arm, yet something pushes.
    """
    term, settings = best.terms[index], best.projector.data.settings
    effect, shape = term.effect, set(term.effect.shape)
    linear = set(effect.parameters) - shape
    own = np.array([(column, k) for column, (owner, k) in enumerate(best.free) if owner == index], int).reshape(-1, 2)
    at, free = own.T
    sizes, determined = np.array([effect.parameters[k] in (linear or shape) for k in free], bool), best.determined[at]
    if shape and not effect.once and not determined[sizes].all():
        if linear or not determined.any():
            return 0.0, int(sizes.sum())  # another shape would do with any size
        at, free, sizes = at[determined], free[determined], sizes[determined]
    values = np.array(best.unbiased(index).values)[free]
    covariance = best.covariance[np.ix_(at, at)] + np.outer(best.bias[at], best.bias[at])
    half = norm.ppf(0.5 + 0.5 * settings.interval) * np.sqrt(np.maximum(np.diag(covariance), 0.0)) * (not effect.once)
    low, high = (np.array(end)[free] for end in (effect.lower, effect.upper))
    within = (values - half > low) & (values + half < high)
    if sizes.all() or not np.all(within | sizes):
        return squared_distance(values[sizes], covariance[np.ix_(sizes, sizes)]), int(sizes.sum())
    return float(values[sizes] @ _precision(covariance)[np.ix_(sizes, sizes)] @ values[sizes]), len(own)


def squared_distance(values: np.ndarray, covariance: np.ndarray) -> float:
    """Squared distance from zero of values (k,) in units of their covariance (k, k), along what that determines."""
    return float(values @ _precision(covariance) @ values)


def _precision(covariance: np.ndarray) -> np.ndarray:
    """Inverse of a covariance (k, k), zero along what that does not determine, whatever the units."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.linalg.pinv(covariance / np.outer(size, size), hermitian=True) / np.outer(size, size)


def wald_evidence(best: Fit, index: int, dispersion: float) -> float:
    """Log evidence of one effect among many from its estimate and covariance alone, without a fit that leaves it out."""
    squared, count = distance(best, index)
    return (0.5 * squared - schwarz(count, best.projector.rows)) / dispersion


def differs_from_zero(best: Fit, index: int, dispersion: float = 1.0) -> bool:
    """Whether an effect's values together leave the interval about zero that is stated for them.

    A fit without an effect may be much worse although its value is not known: the interval counts how the residuals scatter
    from frequency to frequency, the evidence only how many and how large they are.
    """
    squared, count = distance(best, index)
    return count == 0 or outside(squared / dispersion, count, best.projector.data.settings)


def outside(squared: float, count: int, settings: Settings) -> bool:
    """Whether so many values together lie outside the interval about zero, by their squared distance from it."""
    return squared >= float(chi2.ppf(settings.interval, count))
