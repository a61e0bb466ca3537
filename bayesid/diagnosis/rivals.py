"""Effects that a model can do without, other effects that would do as well, and combinations that stand in for another.

Payload or inertia error? Both change one link; a payload's change is a body that could exist.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from bayesid.diagnosis.contacts import is_excuse
from bayesid.diagnosis.data import term_rows
from bayesid.diagnosis.fit import SWEEPS, Fit, fit, squared_distance, wald_evidence
from bayesid.diagnosis.forward import State, exact_fits, in_family, is_surrogate_combination
from bayesid.diagnosis.noise_models import NoiseModels
from bayesid.diagnosis.projector import orthonormal
from bayesid.effects import Term
from bayesid.effects.bodies import body_of
from bayesid.errors import EstimationError
from bayesid.estimators.conic.problem import nearest_body
from bayesid.robot import inertia
from bayesid.robot.prior import Prior

#: Times the evidence asked for from which an effect needs no fit without it: nine tenths of what a linear model says of it would
#: have to be made up for by the others.
_CERTAIN = 10.0


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that the data demand."""

    term: Term  # the effect with its values
    gain: float  # log evidence lost without it, divided by the dispersion factor
    std: np.ndarray  # standard deviations of its values, the links' uncertainty included
    rivals: tuple[tuple[Term, float], ...] = ()  # other effects that explain it nearly as well, with the log evidence they lack
    together: tuple[str, ...] = ()  # those of them, ``name@where``, that only together do the same, and then whatever the motion

    @property
    def alternatives(self) -> list[tuple[Term, ...]]:
        """What explains it nearly as well: each rival alone, those that only together do as one."""
        same = tuple(t for t, _ in self.rivals if t.effect.spec in self.together)
        return [*((t,) for t, _ in self.rivals if t not in same), *([same] if same else [])]


@dataclass(frozen=True, eq=False)
class Pruned:
    """A model without superfluous effects."""

    state: State  # with that model as the best
    #: The model without each of its effects, by index, as far as that was fitted.
    without: Mapping[int, Fit] = field(default_factory=dict)


def prune(state: State) -> Pruned:
    """Take out effects that the others have made superfluous."""
    models, best, dispersion, settings = state.models, state.best, state.dispersion, state.settings
    fitted: dict[int, Fit] = {}
    i = state.known
    while i < len(best.terms):
        # Near its best fit a model is almost linear: what stands out so far needs no fit without it.
        least = settings.accept * (1.0 if in_family(best.terms, i) else _CERTAIN)
        excuse = is_excuse(best, i)
        if not excuse and wald_evidence(best, i, dispersion) > least:
            i += 1
            continue
        models, without = _without(models, best, i)
        if excuse or best.score - without.score < settings.accept * dispersion:
            best, fitted = without, {}
        else:
            fitted[i] = without
            i += 1
    return Pruned(replace(state, models=models, best=best), fitted)


def _without(models: NoiseModels, best: Fit, index: int) -> tuple[NoiseModels, Fit]:
    """A model fitted without one of its effects."""
    return models.own(fit(best.projector, tuple(t for k, t in enumerate(best.terms) if k != index), best))


def essential(pruned: Pruned) -> tuple[Pruned, tuple[Term, ...]]:
    """The few of a combination of surrogates that explain nearly everything, and the others; or all of it where none do.

    What a joint's or a mount's real springs do beyond the model of one would otherwise count as one effect more.
    """
    state = pruned.state
    models, few, known = state.models, state.best, state.known
    while is_surrogate_combination(few, known):
        least = min(range(known, len(few.terms)), key=lambda k: wald_evidence(few, k, state.dispersion))
        models, few = _without(models, few, least)
        if explained(state.base, few) < state.settings.nearly_all:
            return replace(pruned, state=replace(state, models=models)), ()
    if few is state.best:
        return pruned, ()
    kept = {t.effect for t in few.terms}
    return Pruned(replace(state, models=models, best=few)), tuple(t for t in state.best.terms if t.effect not in kept)


def with_rivals(pruned: Pruned) -> tuple[State, tuple[Found, ...]]:
    """The effects found with their rivals; where a rival turns out to be better, it takes an effect's place first."""
    state = pruned.state
    # Where an unmodelled effect is left, or surrogates stand in for it, nothing will be named, and nothing needs rivals.
    best, settings = state.best, state.settings
    left = not best.leaves_noise and explained(state.base, best) < settings.nearly_all
    if left or is_surrogate_combination(best, state.known):
        return state, tuple(_alone(state, i) for i in range(state.known, len(best.terms)))
    for attempt in range(SWEEPS + 1):
        state, found, better = _found(pruned, exchange=attempt < SWEEPS)
        if better is None:
            return state, found
        pruned = Pruned(replace(state, best=better))
    raise AssertionError("the last attempt exchanges nothing")


def _alone(state: State, index: int) -> Found:
    """An effect with its evidence from the estimate and its covariance."""
    best = state.best
    return Found(canonical(best.unbiased(index)), wald_evidence(best, index, state.dispersion), best.std(index, state.dispersion))


def _found(pruned: Pruned, *, exchange: bool) -> tuple[State, tuple[Found, ...], Fit | None]:
    """The effects of the best model with their rivals; or a model with a rival that turned out to be better."""
    state, out = pruned.state, []
    models, best, dispersion, settings = state.models, state.best, state.dispersion, state.settings
    for i in range(state.known, len(best.terms)):
        if in_family(best.terms, i):
            out.append(_alone(state, i))
            continue
        term = canonical(best.terms[i])
        held = tuple(t for k, t in enumerate(best.terms) if k != i)
        without = pruned.without.get(i)
        if without is None:
            models, without = _without(models, best, i)
        models, library = models.library(without)
        proposals = [p for p in library.propose(without) if p.name != term.effect.spec]
        models, fits = exact_fits(models, without, held, proposals, dispersion, never=[term])
        fits = [f for f in fits if not is_excuse(f, len(f.terms) - 1)]
        if exchange and fits and fits[0].score > best.score + dispersion:
            return replace(state, models=models), (), fits[0]
        named, bonus = as_payload(best, i, dispersion)
        lacks: dict[str, tuple[Term, float]] = {}
        for f in reversed(fits):
            rival, own = as_payload(f, len(f.terms) - 1, dispersion)
            lacks[f.terms[-1].effect.spec] = (rival, (best.score - f.score) / dispersion + bonus - own)
        # No longer name is one that costs no more: of the first link joint torques show one moment of inertia, as of a rotor.
        close = [(t, lack) for t, lack in lacks.values() if lack < settings.rival]
        near = [(t, lack) for t, lack in close if lack <= 0.0 or not _contains(without, t, term)]
        # A wider effect of which all but one value is zero is no longer name: a sensor that is turned about one axis.
        specs = [term.effect.spec, *(t.effect.spec for t, _ in near)]
        for one in library.with_one_value(without, 2.0 * settings.nearly_all * (best.score - without.score), fits):
            start = next((f for f in fits if f.terms[-1].effect == one.effect), without)
            start = replace(start, derivatives={})  # of all of its values
            models, f = models.own(fit(without.projector, (*held, one), start))
            lack = (best.score - f.score) / dispersion + bonus
            near += [(f.terms[-1], lack)] if lack < settings.rival and one.effect.spec not in specs else []
        fitted = [t.effect for t in held if not best.projector.data.fixed(t)]
        same = term.effect.same_as(term.values, library.around, fitted)
        together = tuple(t.effect.spec for t in same)
        near = [(t, lack) for t, lack in near if t.effect.spec not in together] + [(t, float(np.log(len(same)))) for t in same]
        # Without it another effect may be none: play that makes up for a mount, too.
        gain = (best.score - without.score) / dispersion if np.isfinite(without.score) else wald_evidence(best, i, dispersion)
        out.append(Found(canonical(named), gain, best.std(i, dispersion), tuple(near), together))
    return replace(state, models=models), tuple(out), None


def canonical(term: Term) -> Term:
    """The values that a reader expects, among those that mean the same."""
    return replace(term, values=term.effect.canonical(term.values))


def _contains(without: Fit, wider: Term, term: Term) -> bool:
    """Whether an effect can do all that another does and more (a spring, an offset): no rival, but a longer name for it."""
    projector, data = without.projector, without.projector.data
    outer, inner = (projector.columns(term_rows(data, data.segments, without.links, without.terms, t)) for t in (wider, term))
    if outer.shape[1] <= inner.shape[1]:
        return False
    q = orthonormal(outer)
    left = inner - q @ (q.T @ inner)
    return bool(np.sum(left**2) < (1.0 - data.settings.nearly_all) * np.sum(inner**2))


def explained(base: Fit, best: Fit) -> float:
    """Share of what stands out of the noise on the fitted motions that a model explains."""
    before, after = (f.chi2 / f.projector.rows - 1.0 for f in (base, best))
    return 1.0 - after / before if before > 0.0 else 0.0


_DRAWN = 5000
#: How uncertain is what is not shown, in units of `Fit.unshown`: nothing is known of it.
_HIDDEN = 1e2


def as_payload(fitted: Fit, index: int, dispersion: float) -> tuple[Term, float]:
    """A change of a link as an attached body, if a possible body is near enough, and what that adds to its evidence.

    Among all changes of a link as large as itself few are bodies that could be attached: if the one found is, that speaks
    for a payload by one over their share. Any other effect is returned as it is, without its expected error.
    """
    term = fitted.unbiased(index)
    if (name := term.effect.may_be) is None or not np.isfinite(fitted.score):
        return term, 0.0
    at = fitted.columns_of(index)
    values, hidden = np.array(term.values), _HIDDEN * fitted.unshown[at]
    # What the data do not show, as all inertia of poses at rest, is whatever a possible body needs, and little.
    covariance = dispersion * fitted.covariance[np.ix_(at, at)] + hidden @ hidden.T
    size = np.sqrt(np.diag(covariance))
    try:
        body = nearest_body(values, covariance)
    except EstimationError:
        return term, 0.0
    distance = squared_distance((body - values) / size, covariance / np.outer(size, size))
    count = len(at) - np.linalg.matrix_rank(hidden / size[:, None], 0.1)
    if chi2.sf(distance, count) < 1.0 - fitted.projector.data.settings.interval:
        return term, 0.0
    data = fitted.projector.data
    effect = next(e for e in data.places(name) if e.where == term.effect.where)
    link = data.links.reshape(-1, 10)[body_of(data.robot, effect.joint or 0)]
    return Term(effect, tuple(map(float, body))), _rarity(link)


def _rarity(link: np.ndarray) -> float:
    """Log of one over the share of changes of a link, as large as itself, that are possible bodies."""
    covariance = Prior.warped(link, 1.0).covariance
    size = np.sqrt(np.diag(covariance))
    root = size[:, None] * np.linalg.cholesky(covariance / np.outer(size, size) + 1e-12 * np.eye(10))
    changes = np.random.default_rng(0).normal(size=(_DRAWN, 10)) @ root.T
    possible = np.linalg.eigvalsh(inertia.pseudo_inertia(changes))[:, 0] >= 0.0
    return float(np.log(_DRAWN / max(np.count_nonzero(possible), 1)))
