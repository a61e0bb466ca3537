"""Which effects the data demand: forwards from proposals, always on exact fits, with every choice taken back once.

Effects are added one by one; after each, every effect found earlier is exchanged against its rivals with the others
held, for a first choice made beside a missing second effect is often the wrong one. Evidence is counted in
units of what the richest linear model leaves unexplained: an unmodelled effect in the data then raises the bar for all names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.diagnosis.bodies import as_payload
from bayesid.diagnosis.candidates import UNEXPLAINED, Library, Proposal, orthonormal
from bayesid.diagnosis.data import with_noise_of
from bayesid.diagnosis.fit import Fit, NuisanceProjector, fit, make_projector, term_rows
from bayesid.diagnosis.noise_models import ACCEPT, NoiseModels, as_points, prepared, soft_terms
from bayesid.diagnosis.surrogates import EXPLAINED, explained, is_surrogate_combination
from bayesid.effects import Term
from bayesid.regression.parallel import in_order

#: Rivals within this log evidence of the best (odds of 20 to 1) cannot be told from it.
RIVAL = 3.0
#: At most this many families of effects are sought, and this many proposals fitted exactly in one round.
MOST = 4
_FITTED = 8
#: Effects of which only one is sought are fitted at this many places.
_PLACES = 4
#: Of one kind at most this many places, and so many rounds of exchanges.
_ALIKE, _SWEEPS = 2, 3
#: An effect that leaves more than this share of an unexplained residual is a surrogate.
_SURROGATE = 0.8
#: Families fitted at once in one round.
_KINDS = 3
#: An effect contains another if its columns leave no more than this share of the other's.
_WITHIN = 0.05


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that the data demand.

    Attributes
    ----------
    term
        The effect with its values.
    gain
        Log evidence lost without it, divided by the dispersion factor.
    std
        Standard deviations of its values, the links' uncertainty included.
    rivals
        Other effects that explain it nearly as well, with the log evidence they lack.
    """

    term: Term
    gain: float
    std: np.ndarray
    rivals: tuple[tuple[Term, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Search:
    """What the search found.

    Attributes
    ----------
    projector, base
        What is always in, and the user's model fitted alone.
    best
        The model with all effects found.
    found
        Those effects.
    dispersion
        Mean square of what no model of the library explains, at least 1; evidence and covariances are relative to it.
    proposals
        The first round's, for the report.
    library
        Columns of all effects at the user's model, for the report.
    dropped
        Effects that the data demanded beside those found, for so small a share that those found may be a little inexact
        instead.
    """

    projector: NuisanceProjector
    base: Fit
    best: Fit
    found: tuple[Found, ...]
    dispersion: float
    proposals: tuple[Proposal, ...]
    library: Library | None = None
    dropped: tuple[Term, ...] = ()


def search(projector: NuisanceProjector, terms: Sequence[Term], seed: int, progress: Callable[[str], None]) -> Search:
    """Find the effects that the data demand beside the user's model."""
    progress("fitting the model as it is")
    projector, base, library = prepared(projector, terms, None)
    if (points := as_points(base, seed)) is not None:
        projector, base, library = prepared(make_projector(points, terms), terms, None)
    progress("what each effect would explain")
    first = library.propose(base)
    noises = NoiseModels(seed, base.terms, {soft_terms(base.terms): library})
    best, dispersion = _grown(noises, base, len(base.terms), progress)
    if (points := as_points(best, seed)) is not None:
        progress("readings as values at their times")
        projector, base, library = prepared(make_projector(points, terms), terms, None)
        noises = NoiseModels(seed, base.terms, {soft_terms(base.terms): library})
        best, dispersion = _grown(noises, base, len(base.terms), progress)
    best = _pruned(noises, best, len(base.terms), dispersion)
    if len(best.terms) > len(base.terms):
        progress("noise as the new model passes it on")
        known = projector.data.floor_known
        data = with_noise_of(projector.data, best.links, best.terms, seed)
        # At the new model's state: how far a tilt is told from heavier links depends on the tilt itself.
        projector, base, library = prepared(make_projector(replace(data, floor_known=known), best.terms), base.terms, best)
        best = fit(projector, best.terms, best)
        best = best if np.isfinite(best.score) else base  # it holds under the noise of another model only
        dispersion = library.dispersion(best)
        noises = NoiseModels(seed, base.terms, {soft_terms(best.terms): library})
        if not known:  # a better model leaves less to stand in for the noise, and more stands out of it
            best, dispersion = _grown(noises, best, len(base.terms), progress)
        best = _pruned(noises, best, len(base.terms), dispersion)
    best, dropped = _essential(noises, base, best, dispersion)
    progress("rivals")
    # Where an unmodelled effect is left, or surrogates stand in for it, nothing will be named, and nothing needs rivals.
    unmodelled = best.chi2 >= UNEXPLAINED * projector.rows and explained(base, best) < EXPLAINED
    unmodelled = unmodelled or is_surrogate_combination(projector.data, best.terms[len(base.terms) :])
    for _ in range(0 if unmodelled else _SWEEPS):
        found, better = _found(noises, best, len(base.terms), dispersion)
        if better is None:
            break
        best = better
    else:
        found, _ = _found(noises, best, len(base.terms), dispersion, exchange=False, rivals=not unmodelled)
    library = noises.library(best)
    return Search(library.projector, library.base, best, found, dispersion, tuple(first), library, dropped)


def _grown(noises: NoiseModels, best: Fit, known: int, progress: Callable[[str], None]) -> tuple[Fit, float]:
    """A model with effects added one by one, each round's choice exchanged against rivals, and what it leaves unexplained."""
    dispersion = noises.library(best).dispersion(best)
    for _ in range(MOST):
        progress("naming what is missing")
        better = _forward(noises, best, dispersion)
        if better is None:
            break
        # Small gains that leave much unexplained are surrogates of an unmodelled effect: nothing would come of more of them.
        before, after = (f.chi2 / f.projector.rows - 1.0 for f in (best, better))
        hopeless, best = after > UNEXPLAINED - 1.0 and after > _SURROGATE * before, better
        if hopeless:
            break
        if _families_of(best.terms[known:]) < MOST:  # so many are surrogates, however well chosen
            best = _exchanged(noises, best, known, dispersion)
        dispersion = noises.library(best).dispersion(best)
    return best, dispersion


def _forward(noises: NoiseModels, best: Fit, dispersion: float) -> Fit | None:
    """The best exact fit with one effect more, or with one kind of effect at several joints, if the data demand it."""
    library = noises.library(best)
    proposals = library.propose(best, resonances=True)
    fits = _exact(noises, best, best.terms, proposals, dispersion)
    fits += [noises.own(fit(best.projector, (*best.terms, *terms), best)) for terms in _families(library, proposals, dispersion)]
    top = max(fits, key=lambda f: f.score, default=None)
    if top is None:
        return None
    as_body = as_payload(top, len(top.terms) - 1, dispersion)[1]
    return None if top.score - best.score + as_body * dispersion < ACCEPT * dispersion else top


def _families(library: Library, proposals: Sequence[Proposal], dispersion: float) -> list[tuple[Term, ...]]:
    """Kinds that act inside joints, at every joint that shows them; the most promising ones.

    Friction is rarely in one joint alone, and joint by joint each might pass for something else.
    """
    kinds: dict[str, list[Proposal]] = {}
    for p in proposals:
        kind = p.term.effect.kind
        if kind.at == "joint" and kind.channels == ("torque",) and 0.5 * p.gain > ACCEPT * dispersion:
            kinds.setdefault(kind.name, []).append(p)
    each = 0.5 * np.log(library.projector.rows)
    worth = {name: sum(0.5 * p.gain - each * len(p.term.values) for p in members) for name, members in kinds.items()}
    order = sorted((name for name in kinds if len(kinds[name]) > 1), key=lambda name: -worth[name])
    return [tuple(p.term for p in kinds[name]) for name in order[:_KINDS]]


def _exact(
    noises: NoiseModels, start: Fit, held: Sequence[Term], proposals: Sequence[Proposal], dispersion: float, most: int = _FITTED
) -> list[Fit]:
    """Exact fits of the most promising proposals beside the effects held, each under its own noise, best first.

    Diverged models are left out.
    """
    terms = [term for p in _shortlist(proposals, dispersion, most) for term in (p.term, *p.others)]
    fits = in_order(lambda term: fit(start.projector, (*held, term), start), terms)
    return sorted((f for f in map(noises.own, fits) if np.isfinite(f.score)), key=lambda f: -f.score)


def _shortlist(proposals: Sequence[Proposal], dispersion: float, most: int) -> list[Proposal]:
    """The best proposals, but few of one kind: neighbouring links explain alike and would crowd out other kinds."""
    kept: list[Proposal] = []
    for p in proposals:
        name = p.term.effect.name
        same = sum(k.term.effect.name == name for k in kept)
        if len(kept) < most and same < (_PLACES if p.term.effect.single else _ALIKE) and 0.5 * p.gain > ACCEPT * dispersion:
            kept.append(p)
    return kept


def _exchanged(noises: NoiseModels, best: Fit, known: int, dispersion: float) -> Fit:
    """Each effect found against its rivals, the others held, until no exchange is for the better.

    An effect with a shape (a contact's time and point, a tether's anchor) is its own rival, too: beside other effects
    it may start better than where it first settled.
    """
    for _ in range(_SWEEPS):
        before = best
        for i in range(known, len(best.terms)):
            own, held = best.terms[i], tuple(t for k, t in enumerate(best.terms) if k != i)
            if not held or _in_family(best.terms, i):
                continue  # the first effect alone has just been chosen against all others, a family by many joints
            without = noises.own(fit(best.projector, held, best, steps=4))
            proposals = noises.library(without).propose(without)
            rivals = [p for p in proposals if p.name != own.effect.spec or len(own.effect.shape) > 1]
            fits = _exact(noises, without, held, rivals, dispersion, most=4)
            if fits and fits[0].score > best.score + dispersion:
                best = fits[0]
        if best is before:
            break
    return best


def _essential(noises: NoiseModels, base: Fit, best: Fit, dispersion: float) -> tuple[Fit, tuple[Term, ...]]:
    """Of a combination of surrogates the few effects that explain nearly everything, and the others; or all of it where none do.

    What a joint's or a mount's real springs do beyond the model of one would otherwise count as one effect more.
    """
    known, few = len(base.terms), best
    while is_surrogate_combination(few.projector.data, few.terms[known:]):
        least = min(range(known, len(few.terms)), key=lambda k: _standing(few, k, dispersion))
        few = noises.own(fit(few.projector, tuple(t for k, t in enumerate(few.terms) if k != least), few))
        if explained(base, few) < EXPLAINED:
            return best, ()
    kept = {t.effect for t in few.terms}
    return few, tuple(t for t in best.terms if t.effect not in kept)


def _families_of(terms: Sequence[Term]) -> int:
    """How many kinds of effects there are."""
    return len({t.effect.name for t in terms})


def _in_family(terms: Sequence[Term], index: int) -> bool:
    """Whether the same kind of effect is in the model at several other joints, too; two may be a coincidence."""
    return sum(t.effect.name == terms[index].effect.name for t in terms) > 2


def _standing(best: Fit, index: int, dispersion: float) -> float:
    """Log evidence of one effect among many from its estimate and covariance alone, without a fit that leaves it out."""
    at = [column for column, (owner, _) in enumerate(best.free) if owner == index]
    values, covariance = np.array(best.terms[index].values), best.covariance[np.ix_(at, at)]
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    squared = float(values / size @ np.linalg.pinv(covariance / np.outer(size, size), hermitian=True) @ (values / size))
    return (0.5 * squared - 0.5 * len(at) * np.log(best.projector.rows)) / dispersion


def _pruned(noises: NoiseModels, best: Fit, known: int, dispersion: float) -> Fit:
    """Without effects that the others have made superfluous."""
    i = known
    while i < len(best.terms):
        if _in_family(best.terms, i) and _standing(best, i, dispersion) > ACCEPT:
            i += 1
            continue
        held = tuple(t for k, t in enumerate(best.terms) if k != i)
        without = noises.own(fit(best.projector, held, best))
        if best.score - without.score + as_payload(best, i, dispersion)[1] * dispersion < ACCEPT * dispersion:
            best = without
        else:
            i += 1
    return best


def _found(
    noises: NoiseModels, best: Fit, known: int, dispersion: float, *, exchange: bool = True, rivals: bool = True
) -> tuple[tuple[Found, ...], Fit | None]:
    """The effects of the best model with their rivals; and a model with a rival that turned out to be better, if any."""
    out = []
    for i in range(known, len(best.terms)):
        at = [column for column, (index, _) in enumerate(best.free) if index == i]
        std = np.sqrt(np.maximum(dispersion * np.diag(best.covariance)[at], 0.0))
        term = _canonical(best.terms[i])
        if not rivals or _in_family(best.terms, i):
            out.append(Found(term, _standing(best, i, dispersion), std))
            continue
        held = tuple(t for k, t in enumerate(best.terms) if k != i)
        without = noises.own(fit(best.projector, held, best))
        proposals = [p for p in noises.library(without).propose(without) if p.name != term.effect.spec]
        fits = _exact(noises, without, held, proposals, dispersion)
        if exchange and fits and fits[0].score > best.score + dispersion:
            return (), fits[0]
        named, bonus = as_payload(best, i, dispersion)
        lacks: dict[str, tuple[Term, float]] = {}
        for f in reversed(fits):
            rival, own = as_payload(f, len(f.terms) - 1, dispersion)
            lacks[f.terms[-1].effect.spec] = (rival, (best.score - f.score) / dispersion + bonus - own)
        near = [(t, lack) for t, lack in lacks.values() if lack < RIVAL and not _contains(without, t, term)]
        term = _canonical(named)
        out.append(Found(term, (best.score - without.score) / dispersion, std, tuple(near)))
    return tuple(out), None


def _canonical(term: Term) -> Term:
    """Of values that mean the same, those that a reader expects."""
    return replace(term, values=term.effect.canonical(term.values))


def _contains(without: Fit, wider: Term, term: Term) -> bool:
    """Whether an effect can do all that another does and more (a spring, an offset): no rival, but a longer name for it."""
    projector, data = without.projector, without.projector.data
    outer, inner = (
        projector.project_out(projector.with_prior_rows(term_rows(data, data.segments, without.links, without.terms, t)))
        for t in (wider, term)
    )
    if outer.shape[1] <= inner.shape[1]:
        return False
    q = orthonormal(outer)
    left = inner - q @ (q.T @ inner)
    return bool(np.linalg.norm(left) < _WITHIN * np.linalg.norm(inner))


__all__ = ["Found", "Search", "make_projector", "search"]
