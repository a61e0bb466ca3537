"""Which effects the data demand, in phases: forward selection, refit under the new model's noise, pruning, rivals.

Evidence is counted in units of what the richest linear model leaves unexplained, the dispersion factor: an unmodelled effect in
the data then raises the threshold for all names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from bayesid.diagnosis.candidates import Library, Proposal, make_library, surroundings
from bayesid.diagnosis.data import DiagnosisData, OneValue
from bayesid.diagnosis.fit import Fit, differs_from_zero, distance, fit
from bayesid.diagnosis.forward import State, forward_selection, is_surrogate_combination, measured_dispersion, too_many_to_name
from bayesid.diagnosis.noise import with_noise_of
from bayesid.diagnosis.noise_models import NoiseModels, as_points, prepared, soft_terms
from bayesid.diagnosis.projector import NuisanceProjector, make_projector
from bayesid.diagnosis.rivals import Found, Pruned, as_payload, canonical, essential, prune, with_rivals
from bayesid.effects import Term


@dataclass(frozen=True, eq=False)
class Search:
    """What the search found."""

    #: What is always in, and the user's model fitted alone.
    projector: NuisanceProjector
    base: Fit
    best: Fit  # the model with all effects found
    found: tuple[Found, ...]  # those effects
    #: Mean square of what no model of the library explains, at least 1; evidence and covariances are relative to it.
    dispersion: float
    proposals: tuple[Proposal, ...]  # the first round's, for the report
    library: Library | None = None  # columns of all effects at the user's model, for the report
    #: Effects that the data demanded beside those found, for so small a share that those found may be a little inexact instead.
    dropped: tuple[Term, ...] = ()
    #: Effects that the data demanded beside those found, but whose values do not differ from zero (`certain`).
    vague: tuple[Term, ...] = ()

    @property
    def noise_level(self) -> float:
        """Mean square of whitened residuals that counts as noise when disagreements are looked for."""
        return max(1.0, min(self.dispersion, self.projector.data.settings.unexplained))


def search(projector: NuisanceProjector, terms: Sequence[Term], seed: int, progress: Callable[[str], None]) -> Search:
    """Find what effects the data demand beside the user's ``terms``; ``progress`` is called with the name of every phase."""
    progress("fitting the model as it is")
    state = _start(projector, terms, seed)
    if (points := as_points(state.base, seed)) is not None:
        state = _start(make_projector(points, terms), terms, seed)
    progress("what each effect would explain")
    models, library = state.models.library(state.base)
    first = library.propose(state.base)
    state = forward_selection(replace(state, models=models), progress, first)
    if (points := as_points(state.best, seed)) is not None:
        progress("readings as values at their times")
        again = _start(make_projector(points, terms), terms, seed)
        if too_many_to_name(state):
            state = measured_dispersion(replace(again, best=fit(again.base.projector, state.best.terms, state.best)))
        else:
            state = forward_selection(again, progress)
    return _settled(state, first, progress)


def leaves_noise(s: Search) -> bool:
    """Whether the effects found are few, and leave no more than the noise on the fitted motions."""
    return s.best.leaves_noise and not is_surrogate_combination(s.best, len(s.base.terms))


def search_from(s: Search, terms: Sequence[Term], seed: int, progress: Callable[[str], None]) -> Search:
    """The search once more, from a model that explains the readings better than the one at which it ended."""
    state = _start(s.projector, s.base.terms, seed)
    models, best = state.models.own(fit(state.base.projector, terms, state.base))
    state = forward_selection(replace(state, models=models, best=best), progress)
    return _settled(state, s.proposals, progress)


def with_data(s: Search, data: DiagnosisData) -> Search:
    """The search with its models fitted to other data of the same recordings."""
    projector = make_projector(data, s.base.terms)
    base, best = fit(projector, s.base.terms, s.base), fit(projector, s.best.terms, s.best)
    return replace(s, projector=projector, base=base, best=best, library=make_library(projector, base))


def _settled(state: State, first: Sequence[Proposal], progress: Callable[[str], None]) -> Search:
    """The effects that stay beside each other, under the noise as their model makes it, and their rivals."""
    pruned = prune(state)
    few, dropped = essential(pruned)
    # The exact noise of a model whose effects will not be named anyway is not worth the time.
    if len(pruned.state.best.terms) > pruned.state.known and not too_many_to_name(few.state):
        progress("noise as the new model passes it on")
        few, dropped = essential(prune(refit(pruned.state, progress)))
    progress("rivals")
    state, found = with_rivals(few)
    _, library = state.models.library(state.best)
    return Search(library.projector, library.base, state.best, found, state.dispersion, tuple(first), library, dropped)


def _start(projector: NuisanceProjector, terms: Sequence[Term], seed: int) -> State:
    """The user's model fitted."""
    _, base, library = prepared(projector, terms, None)
    return State(NoiseModels.of(seed, base.terms, library, base.terms), base, base, 1.0)


def refit(state: State, progress: Callable[[str], None]) -> State:
    """The best model under the noise as it passes the encoders' errors on, and effects that come in or stand out then."""
    seed, best, projector = state.models.seed, state.best, state.base.projector
    known = projector.data.floor_known
    data = with_noise_of(projector.data, best.links, best.terms, seed)
    # At the new model's state: how far a tilt is told from heavier links depends on the tilt itself.
    again = make_projector(data, best.terms)
    projector, base, library = prepared(again, state.base.terms, best)
    best = fit(projector, best.terms, best)
    best = best if np.isfinite(best.score) else base  # it holds under the noise of another model only
    models = NoiseModels.of(seed, base.terms, library, best.terms)
    state = State(models, base, best, library.dispersion(best))
    # A better model leaves less to stand in for the noise, and more stands out of it.
    return state if known else forward_selection(state, progress)


def holds_below(s: Search, named: bool) -> float:
    """Frequency [Hz] up to which the effects found hold, where that lies within what is compared; else infinite.

    Where they are not ``named``, that of the effect that promised most.
    """
    data = s.projector.data
    first = [p.term for p in s.proposals if 0.5 * p.gain > data.settings.accept * s.dispersion][:1]
    around = surroundings(data)
    limit = min((t.effect.holds_below(t.values, around) for t in ([f.term for f in s.found] if named else first)), default=inf)
    return limit if limit < data.segments[0].trajectory.bandwidth else inf


def certain(s: Search, seed: int) -> Search:
    """What was found without effects that do not differ from zero: those are not named, whatever the fit gains by them.

    A rival that does differ from zero takes the place of such a one: play that only has to be large enough to look like a spring
    is a flexible joint. Values of those that stay are the ones that fit beside it, and their standard deviations count that it
    may be there. ``seed`` is that of the encoders' repeated rounding.
    """
    known = len(s.base.terms)
    vague = [k for k in range(known, len(s.best.terms)) if not differs_from_zero(s.best, k, s.dispersion)]
    if not vague:
        return s
    least = min(vague, key=lambda k: distance(s.best, k)[0])
    own = s.found[least - known]
    for rival, lack in sorted(own.rivals, key=lambda r: r[1]):
        if isinstance(rival, OneValue) or rival.effect.spec in own.together:
            continue  # what it does is known no better
        best = fit(s.best.projector, (*s.best.terms[:least], rival, *s.best.terms[least + 1 :]), s.best)
        if np.isfinite(best.score) and differs_from_zero(best, least, s.dispersion):
            others = tuple(r for r in own.rivals if r[0] is not rival)
            found = [*s.found]
            found[least - known] = replace(own, gain=own.gain - lack, rivals=others)
            return certain(_of_model(s, best, found, seed), seed)
    terms = tuple(t for k, t in enumerate(s.best.terms) if k != least)
    rest = [f for k, f in enumerate(s.found, known) if k != least]
    fewer = replace(s, vague=(*s.vague, s.best.terms[least]))
    out = certain(_of_model(fewer, fit(s.best.projector, terms, s.best) if rest else s.base, rest, seed), seed)
    beside = {t.effect: k for k, t in enumerate(s.best.terms) if k >= known and k not in vague}
    each = zip(out.found, out.best.terms[known:], strict=True)
    return replace(out, found=tuple(_valued(f, s, beside.get(t.effect)) for f, t in each))


def _valued(found: Found, s: Search, index: int | None) -> Found:
    """An effect with its values in the best model, in which it has an index if it is there."""
    if index is None:
        return found
    return replace(found, term=canonical(as_payload(s.best, index, s.dispersion)[0]), std=s.best.std(index, s.dispersion))


def _of_model(s: Search, best: Fit, found: Sequence[Found], seed: int) -> Search:
    """The search with another best model and its effects, whose values are those of the model, under the noise that it makes."""
    known = len(s.base.terms)
    if s.projector.data.floor_known and soft_terms(best.terms) != soft_terms(s.best.terms):
        projector = make_projector(with_noise_of(s.projector.data, best.links, best.terms, seed), best.terms)
        base, best = fit(projector, s.base.terms, s.base), fit(projector, best.terms, best)
        library = make_library(projector, base)
        s = replace(s, projector=projector, base=base, library=library, dispersion=library.dispersion(best))
    s = replace(s, best=best)
    return replace(s, found=tuple(_valued(f, s, k) for k, f in enumerate(found, known)))


__all__ = ["Found", "Pruned", "Search", "certain", "holds_below", "leaves_noise", "refit", "search", "search_from", "with_data"]
