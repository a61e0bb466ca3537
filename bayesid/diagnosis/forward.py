"""Forward selection: effects added one by one, always on exact fits, each choice exchanged against rivals.

After each effect, every one found earlier is exchanged against its rivals with the others held, for a first choice made beside a
missing second effect is often the wrong one. Exact fits race: those far behind the best after a few steps are given up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.diagnosis.candidates import Library, Proposal
from bayesid.diagnosis.fit import FEW_STEPS, STEPS, SWEEPS, Fit, Iterate, advance, begin, finish, fit, is_another
from bayesid.diagnosis.grams import schwarz
from bayesid.diagnosis.noise_models import NoiseModels
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect, Term
from bayesid.regression.parallel import in_order

#: Proposals fitted exactly in one round, in the place of an effect that was chosen from as many before, and of one kind at most;
#: kinds fitted at all joints at once. More find nothing else, and cost time.
_FITTED, _EXCHANGED, _ALIKE, _FAMILIES = 8, 4, 3, 3
#: Models with another effect in the place of one found that are tried with one effect more.
_AHEAD = 2
#: Exact fits race: those that have gained less than this share of the best one's gain after a few steps are given up.
_BEHIND = 0.2


@dataclass(frozen=True, eq=False)
class State:
    """What one phase of the search hands on to the next."""

    models: NoiseModels  # the noise that models make, as far as it is known by now
    base: Fit  # the user's model fitted alone
    best: Fit  # the best model so far
    dispersion: float  # dispersion factor: mean square of what no model of the library explains, at least 1

    @property
    def known(self) -> int:
        """Number of the user's effects, the first in every model."""
        return len(self.base.terms)

    @property
    def settings(self) -> Settings:
        """The thresholds of the diagnosis."""
        return self.best.projector.data.settings


def forward_selection(state: State, progress: Callable[[str], None], first: Sequence[Proposal] | None = None) -> State:
    """Add effects while the data demand them, and say anew what nothing explains.

    ``progress`` is called with the name of every phase; ``first`` are proposals beside the best model, if made already.
    """
    state, rivals = measured_dispersion(state), list[Fit]()
    while True:
        progress("naming what is missing")
        models, fits = _with_one_more(state, first)
        first, state = None, replace(state, models=models)
        enough = state.best.score + state.settings.accept * state.dispersion
        better = fits[0] if fits and fits[0].score >= enough else None
        surrogate = better is not None and _is_surrogate(state, better)
        if better is None or (surrogate and len(state.best.terms) > state.known):
            models, better = _two_for_one(state, rivals)
            fits, surrogate, state = [], False, replace(state, models=models)
            if better is None:
                break
        state = replace(state, best=better)
        if surrogate:
            break
        state, others = _exchanged(state)
        state, rivals = measured_dispersion(state), [*others, *(f for f in fits if f is not better)]
        if too_many_to_name(state):  # nothing would be named, however many more came in
            break
    return state


def _is_surrogate(state: State, better: Fit) -> bool:
    """Whether one effect more gains little and leaves much unexplained.

    It stands in for an unmodelled effect or for what the effects found are inexact by: nothing would come of more of them.
    """
    before, after = (f.chi2 / f.projector.rows - 1.0 for f in (state.best, better))
    return after > state.settings.unexplained - 1.0 and after > state.settings.nearly_all * before


def too_many_to_name(state: State) -> bool:
    """Whether the best model's effects are too many to be named: they stand in for what the library lacks."""
    return is_surrogate_combination(state.best, state.known)


def measured_dispersion(state: State) -> State:
    """The state with the dispersion factor of its best model."""
    models, library = state.models.library(state.best)
    return replace(state, models=models, dispersion=library.dispersion(state.best))


def _with_one_more(state: State, first: Sequence[Proposal] | None) -> tuple[NoiseModels, list[Fit]]:
    """Exact fits with one effect more, or with one kind of effect at several joints, best first."""
    best, dispersion = state.best, state.dispersion
    models, library = state.models.library(best)
    proposals = library.propose(best) if first is None else first
    if dispersion >= state.settings.unexplained:
        proposals = library.with_last_resorts(proposals, best)
    models, fits = exact_fits(models, best, best.terms, proposals, dispersion)
    for terms in _families(library, proposals, dispersion):
        models, fitted = models.own(fit(best.projector, (*best.terms, *terms), best))
        fits.append(fitted)
    return models, sorted(fits, key=lambda f: -f.score)


def _two_for_one(state: State, rivals: Sequence[Fit]) -> tuple[NoiseModels, Fit | None]:
    """The best of the rivals of the best model with one effect more, if the data demand two effects for one.

    Two effects may look like a third, which hides both: Coulomb friction that is higher near zero speed looks like friction that
    falls with speed, beside which neither is missed.
    """
    models, least = state.models, state.best.score + state.settings.accept * state.dispersion
    for rival in sorted(rivals, key=lambda f: -f.score)[:_AHEAD]:
        models, library = models.library(rival)
        proposals = library.propose(rival)
        if rival.score + 0.5 * max((p.gain for p in proposals), default=0.0) < least:
            continue
        models, fits = _with_one_more(replace(state, models=models, best=rival), proposals)
        if fits and fits[0].score >= least:
            return models, fits[0]
    return models, None


def _families(library: Library, proposals: Sequence[Proposal], dispersion: float) -> list[tuple[Term, ...]]:
    """Kinds that act inside joints, at every joint that shows them; the most promising ones.

    Friction is rarely in one joint alone, and joint by joint each might pass for something else.
    """
    settings = library.projector.data.settings
    kinds: dict[str, list[Proposal]] = {}
    for p in proposals:
        kind = p.term.effect
        if kind.at == "joint" and kind.channels == ("torque",) and 0.5 * p.gain > settings.accept * dispersion:
            kinds.setdefault(kind.name, []).append(p)
    rows = library.projector.rows
    worth = {name: sum(0.5 * p.gain - schwarz(len(p.term.values), rows) for p in members) for name, members in kinds.items()}
    order = sorted((name for name in kinds if len(kinds[name]) > 1), key=lambda name: -worth[name])
    return [tuple(p.term for p in kinds[name]) for name in order[:_FAMILIES]]


def exact_fits(
    models: NoiseModels,
    start: Fit,
    held: Sequence[Term],
    proposals: Sequence[Proposal],
    dispersion: float,
    most: int = _FITTED,
    never: Sequence[Term] = (),
) -> tuple[NoiseModels, list[Fit]]:
    """Exact fits of the ``most`` promising proposals beside the effects held, each under its own noise, best first.

    Diverged models are left out, and those that are far behind the best after a few steps. An effect that comes out as no more
    than another one is fitted as that, if it is none of ``never``. ``start`` is a fit of the effects held.
    """
    settings = start.projector.data.settings
    terms = [term for p in _shortlist(proposals, dispersion, settings, most) for term in (p.term, *p.others)]
    fits = []
    for fitted in _raced(start, held, terms):
        if is_another(fitted, len(held)):
            other = fitted.terms[-1].effect.as_another(fitted.terms[-1].values)
            if other is None or any(other.effect == t.effect for t in (*held, *never)):
                continue
            fitted = fit(start.projector, (*held, other), start)
        models, own = models.own(fitted)
        fits += [own] if np.isfinite(own.score) else []
    return models, sorted(fits, key=lambda f: -f.score)


def _raced(start: Fit, held: Sequence[Term], terms: Sequence[Term]) -> list[Fit]:
    """Fits of one term each beside those held, without those that are far behind after a few steps."""
    early = list(in_order(lambda t: advance(begin(start.projector, (*held, t), start), FEW_STEPS), terms))
    gains = [start.chi2 - now.chi2 for now in early]
    least = _BEHIND * max((g for g in gains if np.isfinite(g)), default=0.0)
    kept = [now for now, gain in zip(early, gains, strict=True) if least <= 0.0 or gain >= least]
    return list(in_order(lambda now: finish(_ended(advance(now, STEPS - FEW_STEPS))), kept))


def _ended(now: Iterate) -> Iterate:
    """A fit that goes on while it gains more than the odds by which rivals are told apart.

    The end of a contact moves by no more than its ramp in a step, and at one joint it may have come further than at the next.
    """
    least = 2.0 * now.projector.data.settings.rival
    for _ in range(SWEEPS):
        before, now = now, advance(now, STEPS)
        if before.chi2 - now.chi2 < least:
            break
    return now


def _shortlist(proposals: Sequence[Proposal], dispersion: float, settings: Settings, most: int) -> list[Proposal]:
    """The best proposals, but few of one kind: neighbouring links explain alike and would crowd out other kinds.

    Those whose values were tried come on top: what they gain as they are says little of what they would gain fitted.
    """
    kept: list[Proposal] = []
    for p in proposals:
        name = p.term.effect.name
        same = sum(k.term.effect.name == name for k in kept)
        room = p.tried or sum(not k.tried for k in kept) < most
        if room and same < _ALIKE and 0.5 * p.gain > settings.accept * dispersion:
            kept.append(p)
    return kept


def _exchanged(state: State) -> tuple[State, list[Fit]]:
    """Each effect found against its rivals, the others held, until no exchange is for the better; and models with these rivals.

    An effect with a shape (a contact's time and point, a tether's anchor) is its own rival, too: beside other effects
    it may start better than where it first settled.
    """
    models, best, dispersion = state.models, state.best, state.dispersion
    others = list[Fit]()
    stays: dict[Effect, Fit] = {}  # by effect that was no worse than its rivals, the model in which it was asked
    for _ in range(SWEEPS):
        before = best
        for i in range(state.known, len(best.terms)):
            own, held = best.terms[i], tuple(t for k, t in enumerate(best.terms) if k != i)
            if not held or in_family(best.terms, i):
                continue  # the first effect alone has just been chosen against all others, a family by many joints
            if stays.get(own.effect) is best:
                continue
            models, without = models.own(fit(best.projector, held, best, steps=FEW_STEPS))
            models, library = models.library(without)
            rivals = [p for p in library.propose(without) if p.name != own.effect.spec or len(own.effect.shape) > 1]
            models, fits = exact_fits(models, without, held, rivals, dispersion, _EXCHANGED)
            if fits and fits[0].score > best.score + dispersion:
                best, fits = fits[0], [best, *fits[1:]]
            else:
                stays[own.effect] = best
            others += fits
        if best is before:
            break
    return replace(state, models=models, best=best), others


def in_family(terms: Sequence[Term], index: int) -> bool:
    """Whether the same kind of effect is in the model at several other joints, too; two may be a coincidence."""
    return sum(t.effect.name == terms[index].effect.name for t in terms) > 2


def unrelated(best: Fit, known: int) -> int:
    """How many unrelated effects a model has beside the user's; one kind in half of the joints, two at least, counts once.

    Where nothing else is missing, all kinds of friction in so many joints, and offsets of their torques, count once between them:
    what drives have of it is missing where nobody put it into the model. Otherwise they may imitate something together. What
    every model of readings has without a static run, a sensor's offset, counts as none.
    """
    terms = [t for t in best.terms[known:] if not t.effect.estimated_without_static_run]
    names = [t.effect.name for t in terms]
    many = {n for n in names if names.count(n) >= max(2, best.projector.data.robot.n / 2)}
    friction = {t.effect.name for t in terms if t.effect.wanders and t.effect.name in many} if best.leaves_noise else set[str]()
    return len(many - friction) + bool(friction) + sum(n not in many for n in names)


def is_surrogate_combination(best: Fit, known: int) -> bool:
    """Whether a model needs more effects beside the user's than a robot is likely to hide."""
    return unrelated(best, known) > best.projector.data.settings.likely_effects
