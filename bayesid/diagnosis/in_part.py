"""Effects that are proven although something stays unexplained.

Beside what the best attempt leaves, an effect of the search is kept, and another of the library added, only if it stands out of
that and if recordings that are held out in turn are predicted better with it: the lower end of the share of the gap that is lost
without it is above zero. What is left of the gap then is the remainder.

How much of the gap effects close counts in the channels that they act in, where much stays elsewhere: that other joints do what
no model has says nothing against an effect in this one. So each effect is judged by what all of them close in the channels that
it acts in itself, on recordings held out in turn.

The search is then shown with white noise of the power that was measured. Beside what no model explains, effects are proven with
every frequency counted alike (`bayesid.diagnosis.held_out`). Noise that is measured frequency by frequency would then tell
another story: where readings were filtered before they were recorded next to none is left at some frequencies, and a model that
is better everywhere else seems worse. So each channel keeps its noise's mean square over the band, as white noise, and "times
the noise" keeps its meaning.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.diagnosis.candidates import column_terms, make_library, surroundings
from bayesid.diagnosis.choice import Choice
from bayesid.diagnosis.data import DiagnosisData, residual_rows
from bayesid.diagnosis.fit import FEW_STEPS, SWEEPS, Fit, begin, differs_from_zero, distance, finish, fit, is_another
from bayesid.diagnosis.gap import LEAST_GAP, share_of_gap
from bayesid.diagnosis.held_out import held_out_sums, left_by, scaled
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.rivals import Found
from bayesid.diagnosis.search import Search
from bayesid.effects import Effect, Linearisation, Term

#: An effect acts in a channel if it changes it by more than this share, in mean squares, of what it changes most.
_ACTS = 1e-2


@dataclass(frozen=True)
class ChannelGroup:
    """Effects that act in the same channels."""

    effects: tuple[str, ...]  # ``name@place``
    channels: tuple[str, ...]  # in which they act
    closed: float  # share of the gap in these channels that all effects found close


def channel_groups(s: Search) -> tuple[ChannelGroup, ...]:
    """The effects found by the channels that they act in, and what is closed there."""
    left = tuple(left_by(s.projector.data, f) for f in (s.base, s.best))
    data = scaled(s.projector.data, left[1])
    weight, names = np.sqrt(left[1] / left[0]), np.array(data.channels.names)
    out = []
    for members, mask in _alike(_acting(s, weight)):
        if not mask.any():  # it changes nothing
            out.append(ChannelGroup(tuple(s.found[n].term.effect.spec for n in members), (), 0.0))
            continue
        before = float(_left_out(s, s.base, data, weight * mask).sum())
        after = float(_left_out(s, s.best, data, weight * mask).sum())
        rows = sum(float(x.shape[0] * (x.alive & mask).sum()) for x in (*data.segments, *data.unseen))
        floor = noise_share(s.projector.data, left[0], mask) * rows
        closed = float(share_of_gap(before - after, before, floor)) if before > 0.0 else 0.0
        out.append(ChannelGroup(tuple(s.found[n].term.effect.spec for n in members), tuple(map(str, names[mask])), closed))
    return tuple(out)


def _left_out(s: Search, model: Fit, data: DiagnosisData, weight: np.ndarray) -> np.ndarray:
    """Squared errors of a model on held-out blocks (b,), as `held_out_sums` takes data and weight.

    About its own fit: readings are not linear in a gain beside links, and about another fit a gap may be of any size.
    """
    return held_out_sums(data, s.projector.root, model, [], weight).squares(range(len(model.terms)))


def _acting(s: Search, weight: np.ndarray) -> np.ndarray:
    """Which channels each effect found acts in (effects, c)."""
    data, best, known = scaled(s.projector.data, left_by(s.projector.data, s.best)), s.best, len(s.base.terms)
    out = []
    now = residual_rows(data, data.segments, best.links, best.offset, best.terms)
    for n in range(known, len(best.terms)):
        rest = tuple(t for k, t in enumerate(best.terms) if k != n)
        change = residual_rows(data, data.segments, best.links, best.offset, rest) - now
        edges = np.cumsum([x.shape[0] * x.shape[1] for x in data.segments])[:-1]
        parts = [part.reshape(x.shape) for part, x in zip(np.split(change, edges), data.segments, strict=True)]
        energy = sum(np.sum((part * weight) ** 2, axis=0) for part in parts)
        out.append(energy > _ACTS * np.max(energy))
    return np.array(out)


def _alike(acting: np.ndarray) -> list[tuple[list[int], np.ndarray]]:
    """Effects that act in the same channels, and these (c,)."""
    masks = list(dict.fromkeys(map(tuple, acting)))
    return [([n for n, own in enumerate(acting) if tuple(own) == mask], np.array(mask)) for mask in masks]


#: An effect at the values where its columns are taken, and how amplitudes become values.
_Candidate = tuple[Term, Linearisation]


@dataclass(frozen=True)
class Share:
    """What an effect does on recordings held out in turn."""

    #: Share of the gap that opens again without it while all others stay, and the lower end of its one-sided 95 % interval.
    share: float
    share_low: float


@dataclass(frozen=True, eq=False)
class InPart:
    """Effects that are proven, and what they leave."""

    #: The search with the proven effects as those found, most first, and their exact fit as the best one. Evidence and standard
    #: deviations are those beside what stays unexplained.
    search: Search
    shares: tuple[Share, ...]  # of each effect
    #: Mean squares on recordings held out in turn: of the user's model, with one effect more each, and of the noise, every
    #: channel in units of what the user's model leaves of it on the fitted motions; zero for a noise that is not known.
    courses: tuple[float, ...]
    held_out_parts: int  # how many parts of the recordings were held out in turn
    correlation: float  # how many rows count as one
    near: frozenset[str]  # effects that are named, their rivals, and those that would add anything to them, ``name@place``
    #: What they close in the channels that they act in, where they close too little of the whole gap.
    groups: tuple[ChannelGroup, ...] = ()
    below: float = np.inf  # bandwidth of the motion that it was found at [Hz], where that is not the usual one

    @property
    def names(self) -> frozenset[str]:
        """The proven effects, ``name@place``."""
        return frozenset(f.term.effect.spec for f in self.search.found)

    @property
    def remainder(self) -> float:
        """Share of the gap that stays."""
        before, *_, after, floor = self.courses
        return float(np.clip(1.0 - share_of_gap(before - after, before, floor), 0.0, 1.0))


def proven_effects(s: Search, seed: int) -> InPart | None:
    """The effects that are proven although something stays unexplained, None where none is; the seed is the bootstrap's."""
    part = _proven(s, seed, None)
    exact = tuple(_exact(part.search)) if part else ()
    # Values have moved since the columns were taken, and the less is left, the smaller the effects that stand out of it: anew
    # about what was found, then with those effects that came near, until the same are found or no more comes of it.
    among: frozenset[str] | None = None
    for _ in range(SWEEPS):
        again = part and _proven(part.search, seed, among, exact)
        if part is None or again is None:
            return None  # what was proven does not stand alone
        better, same = part.remainder - again.remainder, part.names == again.names
        part = again if better > 0.0 else part
        if among is not None and (same or better <= LEAST_GAP):
            break
        among = part.near
    last = part and _beyond_offset(part, seed)
    if last is not None and last.remainder > 1.0 - s.projector.data.settings.most:
        last = _where_they_act(last, seed)
    return last and replace(last, search=with_white_noise(last.search))


def _beyond_offset(part: InPart, seed: int) -> InPart:
    """Beside a sensor's offset only effects that close most of what it leaves in the channels that they act in.

    A sensor that was not zeroed reads any offset, and what that closes of a gap says nothing for the others.
    """
    s, known = part.search, len(part.search.base.terms)
    terms = s.best.terms[known:]
    offset = tuple(t for t in terms if t.effect.estimated_without_static_run)
    others = [k for k, t in enumerate(terms) if t not in offset]
    if not offset or not others:
        return part
    users = (*s.base.terms, *offset)
    best = fit(s.projector, (*users, *(terms[k] for k in others)), s.best)
    groups = channel_groups(replace(s, base=fit(s.projector, users, s.base), best=best, found=tuple(s.found[k] for k in others)))
    mostly = [g for g in groups if g.closed >= s.projector.data.settings.most]
    if len(mostly) == len(groups):
        return part
    kept = frozenset(t.effect.spec for t in offset) | {spec for g in mostly for spec in g.effects}
    fewer = fit(s.projector, (*s.base.terms, *(t for t in terms if t.effect.spec in kept)), s.best)
    return _proven(replace(s, best=fewer), seed, kept) or part


def _where_they_act(part: InPart, seed: int) -> InPart:
    """Effects that close most of the gap in the channels that they act in, if any do, where all close too little of the whole."""
    mostly = part.search.projector.data.settings.most
    groups = channel_groups(part.search)
    kept = frozenset(spec for g in groups if g.closed >= mostly for spec in g.effects)
    if not kept:
        return part
    if all(g.closed >= mostly for g in groups):
        return replace(part, groups=groups)
    s = part.search
    terms = (*s.base.terms, *(t for t in s.best.terms[len(s.base.terms) :] if t.effect.spec in kept))
    fewer = _proven(replace(s, best=fit(s.projector, terms, s.best)), seed, kept)
    again = None if fewer is None else _where_they_act(fewer, seed)
    return part if again is None or (not again.groups and again.remainder > 1.0 - mostly) else again


def _proven(
    s: Search, seed: int, among: frozenset[str] | None, exact: Sequence[_Candidate] = (), banned: frozenset[str] = frozenset()
) -> InPart | None:
    """Effects chosen and fitted exactly, and chosen again without those that an exact fit takes to the end of what is plausible.

    Such a one stands in for another: Stribeck friction that reaches to the highest speeds is Coulomb friction. It stays where
    more of the gap stays without it.
    """
    found = _chosen(s, seed, among, exact, banned)
    ended = frozenset(f.term.effect.spec for f in found.search.found if _has_ended(f.term)) if found else frozenset()
    other = _proven(s, seed, among, exact, banned | ended) if ended else None
    return found if other is None or found is None or other.remainder > found.remainder + LEAST_GAP else other


def _has_ended(term: Term) -> bool:
    """Whether a parameter that readings are not linear in lies at the end of what is plausible."""
    effect, values = term.effect, np.array(term.values)
    shape = np.array([not p.linear for p in effect.quantities])
    return bool(np.any(shape & ((values <= effect.lower) | (values >= effect.upper))))


def _needs_exact_fit(effect: Effect) -> bool:
    """Whether the shape, which columns are made for, may make it another effect; of harmonics the best attempt has those."""
    return effect.may_be_another and any(p.linear for p in effect.quantities) and not effect.harmonics


def _chosen(
    s: Search, seed: int, among: frozenset[str] | None, exact: Sequence[_Candidate], banned: frozenset[str]
) -> InPart | None:
    """Effects chosen by columns about the best attempt, of all or some of the library and ``exact``, and fitted exactly."""
    left = tuple(left_by(s.projector.data, f) for f in (s.base, s.best))
    data, known, attempt = scaled(s.projector.data, left[1]), len(s.base.terms), s.best.terms
    found = {t.effect.spec for t in attempt}
    library = [
        x for x in column_terms(data)
        if _confirmable(x[0].effect) and (among is None or x[0].effect.spec in among) and x[0].effect.spec not in banned
        # Whether its values make it another effect only an exact fit tells, as the search makes them.
        and (not _needs_exact_fit(x[0].effect) or x[0].effect.spec in found)
    ]  # fmt: skip
    apart = found | banned
    library += [x for x in exact if x[0].effect.spec not in apart and (among is None or x[0].effect.spec in among)]
    weight = np.sqrt(left[1] / left[0])
    sums = held_out_sums(data, s.projector.root, s.best, [t for t, _ in library], weight)
    settings = data.settings
    choice = Choice(
        sums, tuple(t.effect for t in (*attempt, *(t for t, _ in library))), tuple(range(known)),
        noise_share(s.projector.data, left[0]), settings, seed,
    )  # fmt: skip

    def term(index: int, kept: Sequence[int]) -> Term:
        """An effect at the values that fit beside the others kept."""
        if index < len(attempt):
            return attempt[index]
        one, about = library[index - len(attempt)]
        amplitudes = sums.fitted(sums.whole, [*choice.users, *kept])[1][sums.owners == index]
        return Term(one.effect, tuple(map(float, np.atleast_2d(about.to_values(amplitudes))[0])))

    def possible(kept: Sequence[int], index: int) -> bool:
        effect, values = choice.effects[index], np.array(term(index, kept).values)
        return bool(np.all((values >= effect.lower) & (values <= effect.upper)))

    before = _left_out(s, s.base, data, weight)
    own = [k for k in range(known, len(attempt)) if _confirmable(attempt[k].effect) and attempt[k].effect.spec not in banned]
    kept = choice.without_unproven(own, before)
    others = range(len(attempt), len(choice.effects))
    for _ in range(SWEEPS):
        start = kept
        while (more := choice.with_one_more(kept, others, possible, before)) is not None:
            kept = more
        kept = choice.with_one_instead(choice.from_columns(kept, others), others, possible, before)
        kept = choice.without_unproven(choice.replaced(kept, others, possible, before), before)
        if kept == start:
            break
    if not kept:
        return None
    fewer: list[int] = []
    while among is None and len(kept) > len(fewer):  # each of them has to stand out of what is left then, or goes again
        fewer, kept = kept, choice.with_a_family(kept, others, possible, before)
    kept = choice.in_order(kept)
    many = {name for name in (choice.effects[k].name for k in kept) if sum(choice.effects[k].name == name for k in kept) > 2}
    rivals: list[list[tuple[Term, float]]] = []
    for own in kept:
        near = [] if choice.effects[own].name in many else choice.rivals(kept, own, others, possible, settings.rival)
        rivals.append([(term(k, [*(x for x in kept if x != own), k]), lack) for k, lack in near])
    model = (*attempt[:known], *(term(k, kept) for k in kept))
    return _concluded(s, choice, kept, model, rivals, before)


def _exact(s: Search) -> Iterator[_Candidate]:
    """Effects that may be no more than another one, at the shapes that fit exactly beside those of the best attempt."""
    data, around = s.projector.data, surroundings(s.projector.data)
    users, taken = s.best.terms[: len(s.base.terms)], {t.effect for t in s.best.terms}
    for effect in data.experiment.possible_effects(data.channels.names):
        linear = np.array([p.linear for p in effect.quantities])
        if effect in taken or not (_confirmable(effect) and _needs_exact_fit(effect) and effect.sought(around)):
            continue
        held = (*users, *(t for t in s.best.terms[len(users) :] if not effect.excludes(t.effect)))
        without = fit(s.projector, held, s.best, FEW_STEPS)
        proposals = make_library(s.projector, s.base, without, [effect]).propose(without)
        fits = [fit(s.projector, (*held, t), without, FEW_STEPS) for p in proposals for t in (p.term, *p.others)]
        best = max(fits, key=lambda f: f.score, default=None)
        top = best and fit(s.projector, best.terms, best)
        if top is not None and np.isfinite(top.score):
            yield top.terms[-1], Linearisation.holding(np.array(top.terms[-1].values), ~linear)


def _concluded(
    s: Search, choice: Choice, kept: list[int], model: Sequence[Term], rivals: list[list[tuple[Term, float]]], before: np.ndarray
) -> InPart | None:
    """The model with the effects kept fitted exactly, and their shares."""
    sums, known = choice.sums, len(s.base.terms)
    data = scaled(s.projector.data, left_by(s.projector.data, s.best) * sums.correlation)
    best = fit(make_projector(data, model), model, s.best)
    another = [n for n in range(len(kept)) if is_another(best, known + n)]
    if not another and not np.isfinite(best.score):
        return None
    now = choice.squares(kept)
    shares = [Share(*choice.share(choice.squares([x for x in kept if x != k]), now, before)) for k in kept]
    # Columns promised more than the exact fit beside the others keeps, or what is no more than another effect; and what closes
    # nothing, once effects that it stood beside have gone.
    faint = another or [n for n in range(len(kept)) if not differs_from_zero(best, known + n) or shares[n].share_low <= 0.0]
    if faint:
        least = min(faint, key=lambda n: distance(best, known + n)[0])
        rest = [n for n in range(len(kept)) if n != least]
        model = [t for n, t in enumerate(model) if n != known + least]
        return _concluded(s, choice, [kept[n] for n in rest], model, [rivals[n] for n in rest], before) if rest else None
    left = tuple(left_by(s.projector.data, f) for f in (s.base, s.best))
    after = _left_out(s, best, scaled(s.projector.data, left[1]), np.sqrt(left[1] / left[0]))
    steps = [before, *(choice.squares(kept[: n + 1]) for n in range(len(kept) - 1)), after]
    found = []
    for n, k in enumerate(kept):
        one = best.unbiased(known + n)
        term = Term(one.effect, one.effect.canonical(one.values))
        found.append(Found(term, choice.evidence(kept, k), best.std(known + n, 1.0), tuple(rivals[n])))
    # Residuals in units of the noise, as everywhere else; the covariance beside what stays unexplained.
    shown = replace(finish(begin(s.projector, best.terms, best)), covariance=best.covariance)
    total = sums.counts.sum()
    return InPart(
        replace(s, best=shown, found=tuple(found), dropped=()), tuple(shares),
        (*(float(x.sum() / total) for x in steps), choice.floor), int(sums.groups.max()) + 1, sums.correlation,
        choice.near_by(kept, rivals, range(len(s.best.terms), len(choice.effects))),
    )  # fmt: skip


def _confirmable(effect: Effect) -> bool:
    """Whether other motions can confirm it: a contact does not come again, and changed links stand in for whatever is missing."""
    return not (effect.once or effect.changes_link)


def with_white_noise(s: Search) -> Search:
    """The proven effects of a search with the same values and covariance, and the user's model fitted anew."""
    data = scaled(s.projector.data, mean_noise(s.projector.data))
    users, found = s.base.terms, s.best.terms
    base, projector = fit(make_projector(data, users), users, s.base), make_projector(data, found)
    best = replace(finish(begin(projector, found, s.best)), covariance=s.best.covariance)
    return replace(s, projector=projector, base=base, best=best, library=make_library(projector, base, best))


def mean_noise(data: DiagnosisData) -> np.ndarray:
    """Mean square of every channel's noise over the frequencies compared, on the fitted motions (c,)."""
    powers = [np.diagonal(s.covariance, axis1=1, axis2=2) for s in data.segments]
    return np.asarray(np.concatenate(powers).mean(axis=0))


def noise_share(data: DiagnosisData, square: np.ndarray, channels: np.ndarray | bool = True) -> float:
    """Mean square of the noise in units of what the user's model leaves (c,), no more than that; 0 where it is unknown.

    Of some channels (c,), where they are given.
    """
    if not data.floor_known:
        return 0.0
    ratio = [(np.diagonal(s.covariance, axis1=1, axis2=2) / square)[:, s.alive & channels].ravel() for s in data.segments]
    return min(float(np.concatenate(ratio).mean()), 1.0)
