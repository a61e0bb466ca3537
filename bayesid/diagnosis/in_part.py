"""Effects that are proven although something stays unexplained.

Beside what the best attempt leaves, an effect of the search is kept, and another of the library added, only if it stands out of
that and if recordings that are held out in turn are predicted better with it: the lower end of the share of the gap that is lost
without it is above zero. What is left of the gap then is the remainder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.diagnosis.bootstrap import lower_end
from bayesid.diagnosis.candidates import column_terms
from bayesid.diagnosis.fit import begin, finish, fit
from bayesid.diagnosis.held_out import HeldOutSums, held_out_sums, left_by, scaled
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.rivals import Found
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.significance import distance, stands_out
from bayesid.diagnosis.white_noise import noise_share, with_white_noise
from bayesid.effects import Effect, Term

#: Whether an effect's values are possible beside the others kept.
Possible = Callable[[Sequence[int], int], bool]
#: Of the effects that would add most, how many are tried on held-out recordings in one round.
_TRIED = 6
#: Log evidence that makes no difference.
_AS_MUCH = 0.1
#: A gap is no less than this share of the mean square that the user's model leaves.
_LEAST_GAP = 1e-3


@dataclass(frozen=True)
class Share:
    """What an effect does on recordings held out in turn.

    Attributes
    ----------
    share, share_low
        Share of the gap that it closes beside those before it, and the lower end of its one-sided 95 % interval.
    own, own_low
        Share that is lost without it while all others stay, and its lower end.
    """

    share: float
    share_low: float
    own: float
    own_low: float


@dataclass(frozen=True, eq=False)
class InPart:
    """Effects that are proven, and what they leave.

    Attributes
    ----------
    search
        The search with the proven effects as those found, most first, and their exact fit as the best one. Evidence and standard
        deviations are those beside what stays unexplained.
    shares
        Of each effect.
    courses
        Mean squares on recordings held out in turn: of the user's model, with one effect more each, and of the noise, every
        channel in units of what the user's model leaves of it on the fitted motions; zero for a noise that is not known.
    stretches
        How many parts were held out in turn.
    correlation
        How many rows count as one.
    near
        Effects that are named, their rivals, and those that would add anything to them, ``name@place``.
    """

    search: Search
    shares: tuple[Share, ...]
    courses: tuple[float, ...]
    stretches: int
    correlation: float
    near: frozenset[str]

    @property
    def remainder(self) -> float:
        """Share of the gap that stays."""
        return max(1.0 - sum(s.share for s in self.shares), 0.0)


@dataclass(frozen=True, eq=False)
class _Choice:
    """Effects chosen among those that may be, by index: the best attempt's first, then the library's.

    Attributes
    ----------
    sums, effects
        Of all.
    users
        Those of the user's model.
    floor
        Mean square of the noise.
    settings
        The thresholds.
    seed
        Of the bootstrap.
    """

    sums: HeldOutSums
    effects: tuple[Effect, ...]
    users: tuple[int, ...]
    floor: float
    settings: Settings
    seed: int

    def squares(self, kept: Sequence[int]) -> np.ndarray:
        """Squared errors on held-out blocks."""
        return self.sums.squares([*self.users, *kept])

    def share(self, worse: np.ndarray, better: np.ndarray, before: np.ndarray) -> tuple[float, float]:
        """Share of the gap between user's model and noise by which one prediction is better than another, and its lower end."""

        def closed(sums: np.ndarray) -> np.ndarray:
            """From sums of rows, of what is closed and of the gap (draws, 3)."""
            rows, closed, gap = sums.T
            return closed / np.maximum(gap - self.floor * rows, _LEAST_GAP * gap)

        blocks = np.column_stack([self.sums.counts, worse - better, before])
        low = lower_end(blocks, closed, self.settings, self.seed)
        return float(closed(blocks.sum(axis=0)[None])[0]), float(low)

    def proof(self, worse: np.ndarray, better: np.ndarray, before: np.ndarray) -> float:
        """Lower end of that share; no more than what motions that were never fitted say of it."""
        _, low = self.share(worse, better, before)
        return min(low, float((worse - better)[self.sums.unseen].sum())) if self.sums.unseen.any() else low

    def evidence(self, kept: Sequence[int], index: int) -> float:
        """Log evidence that one of the effects kept adds to the others."""
        others = [*self.users, *(k for k in kept if k != index)]
        return 0.5 * (self.sums.cost(others) - self.sums.cost([*others, index])) - self.sums.price(index)

    def without_unproven(self, kept: list[int], before: np.ndarray) -> list[int]:
        """Leave out the effect whose loss costs least on held-out recordings until all of them are proven."""
        while kept:
            now = self.squares(kept)
            own = {k: self.proof(self.squares([x for x in kept if x != k]), now, before) for k in kept}
            unproven = [k for k in kept if own[k] <= 0.0 or self.evidence(kept, k) < self.settings.accept]
            if not unproven:
                break
            kept = [k for k in kept if k != min(unproven, key=lambda k: own[k])]
        return kept

    def beside(self, kept: Sequence[int], others: Sequence[int]) -> list[int]:
        """Other effects that may be in a model beside those kept."""
        return [k for k in others if not any(self.effects[k].excludes(self.effects[x]) for x in kept)]

    def with_one_more(self, kept: list[int], others: Sequence[int], possible: Possible, before: np.ndarray) -> list[int] | None:
        """The effect added that the data demand most, if held-out recordings confirm it."""
        open_ = self.beside(kept, others)
        if not open_:
            return None
        gains = self.sums.evidence([*self.users, *kept], open_)
        now = self.squares(kept)
        for i in np.argsort(-gains)[:_TRIED]:
            if gains[i] < self.settings.accept:
                return None
            more = [*kept, open_[i]]
            if possible(more, open_[i]) and self.proof(now, self.squares(more), before) > 0.0:
                return more
        return None

    def with_a_family(self, kept: list[int], others: Sequence[int], possible: Possible, before: np.ndarray) -> list[int]:
        """One kind of effect added at every joint that shows it, where the data demand them together.

        Beside what friction of five other joints leaves, that of the sixth is small.
        """
        open_ = self.beside(kept, others)
        gains = dict(zip(open_, self.sums.evidence([*self.users, *kept], open_), strict=True)) if open_ else {}
        families: dict[str, dict[str, int]] = {}
        for k in sorted(open_, key=lambda k: gains[k]):  # of one place the best values come last
            if self.effects[k].at == "joint" and gains[k] > 0.0:
                families.setdefault(self.effects[k].name, {})[self.effects[k].where] = k
        cost, now, best = self.sums.cost([*self.users, *kept]), self.squares(kept), (self.settings.accept, kept)
        for members in families.values():
            more = [*kept, *members.values()]
            gain = 0.5 * (cost - self.sums.cost([*self.users, *more])) - sum(map(self.sums.price, members.values()))
            if gain >= best[0] and all(possible(more, k) for k in members.values()):
                if self.proof(now, self.squares(more), before) > 0.0:
                    best = gain, more
        return best[1]

    def from_columns(self, kept: list[int], others: Sequence[int]) -> list[int]:
        """The best attempt's effects by the library's columns of the same, which say as much and tell values from anywhere."""
        out = list(kept)
        for n, k in enumerate(kept):
            same = [j for j in others if self.effects[j].spec == self.effects[k].spec]
            own, *gains = self.sums.evidence([*self.users, *(x for x in out if x != k)], [k, *same])
            if gains and max(gains) >= own - _AS_MUCH:
                out[n] = same[int(np.argmax(gains))]
        return out

    def in_order(self, kept: list[int]) -> list[int]:
        """The effects by what each adds to those before it, most first."""
        out: list[int] = []
        while len(out) < len(kept):
            rest = [k for k in kept if k not in out]
            out.append(rest[int(np.argmax(self.sums.evidence([*self.users, *out], rest)))])
        return out

    def rivals(
        self, kept: Sequence[int], index: int, others: Sequence[int], possible: Possible, near: float
    ) -> list[tuple[int, float]]:
        """Other effects that lack no more than so much log evidence in one's place, best first, and what each lacks.

        What another adds beside all those kept, too, is none of what it would do in one's place.
        """
        rest = [k for k in kept if k != index]
        (own, *gains), open_ = self.standing(rest, index, others)
        beside = np.maximum(self.sums.evidence([*self.users, *kept], open_), 0.0)
        best: dict[str, tuple[int, float]] = {}
        for k, lack in sorted(zip(open_, own - (np.array(gains) - beside), strict=True), key=lambda x: x[1]):
            new = self.effects[k].spec not in (self.effects[index].spec, *best)
            if lack < near and new and possible([*rest, k], k):
                best[self.effects[k].spec] = (k, float(lack))
        return list(best.values())

    def near_by(self, kept: Sequence[int], rivals: list[list[tuple[Term, float]]], others: Sequence[int]) -> frozenset[str]:
        """``name@place`` of the effects kept, of their rivals, and of those that would add anything."""
        gains = self.sums.evidence([*self.users, *kept], others)
        adding = {self.effects[k].spec for k, gain in zip(others, gains, strict=True) if gain > 0.0}
        return frozenset({self.effects[k].spec for k in kept} | {t.effect.spec for x in rivals for t, _ in x} | adding)

    def replaced(self, kept: list[int], others: Sequence[int], possible: Possible) -> list[int]:
        """Effects exchanged for others that do better in their place; clearly better, where that takes more parameters."""
        for k in list(kept):
            size = len(self.effects[k].parameters)
            for other, lack in self.rivals(kept, k, others, possible, 0.0):
                if lack < -self.settings.rival or len(self.effects[other].parameters) <= size:
                    kept = [other if x == k else x for x in kept]
                    break
        return kept

    def standing(self, rest: Sequence[int], index: int, others: Sequence[int]) -> tuple[list[float], list[int]]:
        """Log evidence of an effect beside the rest, then of each other that could stand in its place; and which those are."""
        open_ = [k for k in self.beside(rest, others) if k != index]
        return self.sums.evidence([*self.users, *rest], [index, *open_]).tolist(), open_


def proven_effects(s: Search, seed: int) -> InPart | None:
    """The effects that are proven although something stays unexplained; None where none is.

    Parameters
    ----------
    s
        What the search found.
    seed
        Of the bootstrap over blocks of time.
    """
    first = _proven(s, seed, None)
    # Values have moved since the columns were taken: once more about them, with those that came near.
    last = first and _proven(first.search, seed, first.near)
    return last and replace(last, search=with_white_noise(last.search))


def _proven(s: Search, seed: int, among: frozenset[str] | None) -> InPart | None:
    """Effects chosen by columns about the best attempt, of all or some of the library, and fitted exactly."""
    left = tuple(left_by(s.projector.data, f) for f in (s.base, s.best))
    data, known, attempt = scaled(s.projector.data, left[1]), len(s.base.terms), s.best.terms
    library = [x for x in column_terms(data) if _confirmable(x[0].effect) and (among is None or x[0].effect.spec in among)]
    sums = held_out_sums(data, s.projector.root, s.best, [t for t, _ in library], np.sqrt(left[1] / left[0]))
    settings = data.settings
    choice = _Choice(
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

    before = choice.squares([])
    kept = choice.without_unproven([k for k in range(known, len(attempt)) if _confirmable(attempt[k].effect)], before)
    others = range(len(attempt), len(choice.effects))
    for _ in range(settings.sweeps):
        start = kept
        while (more := choice.with_one_more(kept, others, possible, before)) is not None:
            kept = more
        kept = choice.without_unproven(choice.replaced(choice.from_columns(kept, others), others, possible), before)
        if kept == start:
            break
    if not kept:
        return None
    if among is None:  # each of them has to stand out of what is left then, or goes again
        kept = choice.with_a_family(kept, others, possible, before)
    kept = choice.in_order(kept)
    many = {name for name in (choice.effects[k].name for k in kept) if sum(choice.effects[k].name == name for k in kept) > 2}
    rivals: list[list[tuple[Term, float]]] = []
    for own in kept:
        near = [] if choice.effects[own].name in many else choice.rivals(kept, own, others, possible, settings.rival)
        rivals.append([(term(k, [*(x for x in kept if x != own), k]), lack) for k, lack in near])
    model = (*attempt[:known], *(term(k, kept) for k in kept))
    return _concluded(s, choice, kept, model, rivals, before)


def _concluded(
    s: Search, choice: _Choice, kept: list[int], model: Sequence[Term], rivals: list[list[tuple[Term, float]]], before: np.ndarray
) -> InPart | None:
    """The model with the effects kept fitted exactly, and their shares."""
    sums, known = choice.sums, len(s.base.terms)
    data = scaled(s.projector.data, left_by(s.projector.data, s.best) * sums.correlation)
    best = fit(make_projector(data, model), model, s.best)
    if not np.isfinite(best.score):
        return None
    faint = [n for n in range(len(kept)) if not stands_out(best, known + n)]
    if faint:  # its columns promised more than the exact fit beside the others keeps
        least = min(faint, key=lambda n: distance(best, known + n)[0])
        rest = [n for n in range(len(kept)) if n != least]
        model = [t for n, t in enumerate(model) if n != known + least]
        return _concluded(s, choice, [kept[n] for n in rest], model, [rivals[n] for n in rest], before) if rest else None
    steps = [before, *(choice.squares(kept[: n + 1]) for n in range(len(kept)))]
    found, shares = [], []
    for n, k in enumerate(kept):
        at = [column for column, (owner, _) in enumerate(best.free) if owner == known + n]
        one, std = best.terms[known + n], np.sqrt(np.maximum(np.diag(best.covariance)[at], 0.0))
        term = Term(one.effect, one.effect.canonical(one.values))
        found.append(Found(term, choice.evidence(kept, k), std, tuple(rivals[n])))
        without = choice.squares([x for x in kept if x != k])
        shares.append(Share(*choice.share(steps[n], steps[n + 1], before), *choice.share(without, steps[-1], before)))
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
