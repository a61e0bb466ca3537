"""Which effects to keep beside what stays unexplained: those that stand out of it and that held-out recordings confirm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.diagnosis.gap import lower_end, share_of_gap
from bayesid.diagnosis.held_out import HeldOutSums
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect, Term

#: Whether an effect's values are possible beside the others kept.
Possible = Callable[[Sequence[int], int], bool]
#: Of the effects that would add most, how many are tried on held-out recordings in one round.
_TRIED = 6
#: Log evidence that makes no difference.
_AS_MUCH = 0.1


@dataclass(frozen=True, eq=False)
class Choice:
    """Effects chosen among those that may be, by index: the best attempt's first, then the library's."""

    #: Sums with all effects that may be, and these effects.
    sums: HeldOutSums
    effects: tuple[Effect, ...]
    users: tuple[int, ...]  # those of the user's model
    floor: float  # mean square of the noise
    settings: Settings  # the thresholds
    seed: int  # of the bootstrap

    def squares(self, kept: Sequence[int]) -> np.ndarray:
        """Squared errors on held-out blocks."""
        return self.sums.squares([*self.users, *kept])

    def share(self, worse: np.ndarray, better: np.ndarray, before: np.ndarray) -> tuple[float, float]:
        """Share of the gap between user's model and noise by which one prediction is better than another, and its lower end."""

        def closed(sums: np.ndarray) -> np.ndarray:
            """Share that is closed, from sums of rows, of what is closed and of the gap (draws, 3)."""
            rows, closed, gap = sums.T
            return share_of_gap(closed, gap, self.floor * rows)

        blocks = np.column_stack([self.sums.counts, worse - better, before])
        low = lower_end(blocks, closed, self.settings, self.seed)
        return float(closed(blocks.sum(axis=0)[None])[0]), float(low)

    def share_low(self, worse: np.ndarray, better: np.ndarray, before: np.ndarray) -> float:
        """Lower end of that share; no more than what motions that were never fitted say of it."""
        _, low = self.share(worse, better, before)
        return min(low, float((worse - better)[self.sums.unseen].sum())) if self.sums.unseen.any() else low

    def evidence(self, kept: Sequence[int], index: int) -> float:
        """Log evidence that one of the effects kept adds to the others."""
        return self.gain([k for k in kept if k != index], kept)

    def without_unproven(self, kept: list[int], before: np.ndarray) -> list[int]:
        """Leave out the effect whose loss costs least on held-out recordings until all of them are proven."""
        while kept:
            now = self.squares(kept)
            own = {k: self.share_low(self.squares([x for x in kept if x != k]), now, before) for k in kept}
            unproven = [k for k in kept if own[k] <= 0.0 or self.evidence(kept, k) < self.settings.accept]
            if not unproven:
                break
            kept = [k for k in kept if k != min(unproven, key=lambda k: own[k])]
        return kept

    def beside(self, kept: Sequence[int], others: Sequence[int]) -> list[int]:
        """Other effects that may be in a model beside those kept."""
        among = np.array(others, int)
        return among[~self._excludes[np.ix_(among, np.array(kept, int))].any(axis=1)].tolist()

    @cached_property
    def _excludes(self) -> np.ndarray:
        """Which effect excludes which (effects, effects)."""
        each = list(dict.fromkeys(self.effects))  # an effect stands there once for every shape that is tried
        at = [each.index(effect) for effect in self.effects]
        return np.array([[own.excludes(other) for other in each] for own in each])[np.ix_(at, at)]

    def with_one_more(self, kept: list[int], others: Sequence[int], possible: Possible, before: np.ndarray) -> list[int] | None:
        """The effect added that the data demand most, if held-out recordings confirm it."""
        open_ = [k for k in self.beside(kept, others) if self.effects[k] not in self._containing]
        if not open_:
            return None
        gains = self.sums.evidence([*self.users, *kept], open_)
        now = self.squares(kept)
        for i in np.argsort(-gains)[:_TRIED]:
            if gains[i] < self.settings.accept:
                return None
            more = [*kept, open_[i]]
            if possible(more, open_[i]) and self.share_low(now, self.squares(more), before) > 0.0:
                return more
        return None

    def with_one_instead(self, kept: list[int], others: Sequence[int], possible: Possible, before: np.ndarray) -> list[int]:
        """An effect in place of those that it excludes, where the data demand it most and held-out recordings confirm it.

        In place of a single one only where it contains that one (`Effect.comes_after`), as coupled friction contains friction of
        its joint; other exchanges of one for one are `replaced`.
        """
        now, best = self.squares(kept), (self.settings.accept, kept)
        for k in others:
            out = [x for x in kept if self.effects[k].excludes(self.effects[x])]
            contains_them = len(out) > 1 or any(self.effects[k].comes_after(self.effects[x]) for x in out)
            if not contains_them or any(self.effects[k].spec == self.effects[x].spec for x in out):
                continue
            more = [*(x for x in kept if x not in out), k]
            gain = self.gain(kept, more)
            if gain >= best[0] and possible(more, k) and self.share_low(now, self.squares(more), before) > 0.0:
                best = gain, more
        return best[1]

    @cached_property
    def _containing(self) -> frozenset[Effect]:
        """Effects that contain others that may be kept instead; only `with_one_instead` weighs them against all of these."""
        others = {e for k, e in enumerate(self.effects) if k not in self.users}
        return frozenset(own for own in self.effects if any(own.comes_after(e) and own.excludes(e) for e in others))

    def price_of(self, effects: Sequence[int]) -> float:
        """Log evidence that the parameters of effects cost."""
        return float(self.sums.prices[list(effects)].sum())

    def with_a_family(self, kept: list[int], others: Sequence[int], possible: Possible, before: np.ndarray) -> list[int]:
        """One kind of effect added at every joint that shows it, where the data demand it at all of its joints together.

        Beside what friction of five other joints leaves, that of the sixth is small; and where they have it, it is likely to have
        it, too. So those of the kind that are kept already are part of the hypothesis.
        """
        open_ = self.beside(kept, others)
        gains = dict(zip(open_, self.sums.evidence([*self.users, *kept], open_), strict=True)) if open_ else {}
        families: dict[str, dict[str, int]] = {}
        for k in sorted(open_, key=lambda k: gains[k]):  # of one place the best values come last
            if self.effects[k].at == "joint" and gains[k] > 0.0:
                families.setdefault(self.effects[k].name, {})[self.effects[k].where] = k
        now, best = self.squares(kept), (0.0, kept)
        for name, members in families.items():
            more, rest = [*kept, *members.values()], [k for k in kept if self.effects[k].name != name]
            gain, whole = (self.gain(without, more) for without in (kept, rest))
            if gain > best[0] and whole >= self.settings.accept and all(possible(more, k) for k in members.values()):
                if self.share_low(now, self.squares(more), before) > 0.0:
                    best = gain, more
        return best[1]

    def gain(self, fewer: Sequence[int], more: Sequence[int]) -> float:
        """Log evidence of a model with effects over one with fewer, or others."""
        cost, less = (self.sums.cost([*self.users, *effects]) for effects in (fewer, more))
        return float(0.5 * (cost - less)) - self.price_of(more) + self.price_of(fewer)

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
        """The effects by what each closes on held-out recordings beside those before it, most first.

        From the last one, the one whose loss costs least: two that close something only together stand next to each other.
        """
        rest, out = list(kept), []
        while rest:
            least = min(rest, key=lambda k: float(self.squares([x for x in rest if x != k]).sum()))
            rest.remove(least)
            out.insert(0, least)
        return out

    def rivals(
        self, kept: Sequence[int], index: int, others: Sequence[int], possible: Possible, near: float
    ) -> list[tuple[int, float]]:
        """Other effects that lack no more than so much log evidence in one's place, best first, and what each lacks.

        What another adds beside all those kept, too, is none of what it would do in one's place.
        """
        rest = [k for k in kept if k != index]
        (own, *gains), open_ = self.evidence_beside(rest, index, others)
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

    def replaced(self, kept: list[int], others: Sequence[int], possible: Possible, before: np.ndarray) -> list[int]:
        """Effects exchanged for others that do better in their place, if held-out recordings confirm these there.

        Clearly better, where that takes more parameters.
        """
        for k in list(kept):
            size, without = len(self.effects[k].parameters), self.squares([x for x in kept if x != k])
            plain = [x for x in others if self.effects[x] not in self._containing]
            for other, lack in self.rivals(kept, k, plain, possible, 0.0):
                if lack < -self.settings.rival or len(self.effects[other].parameters) <= size:
                    changed = [other if x == k else x for x in kept]
                    if self.share_low(without, self.squares(changed), before) > 0.0:
                        kept = changed
                        break
        return kept

    def evidence_beside(self, rest: Sequence[int], index: int, others: Sequence[int]) -> tuple[list[float], list[int]]:
        """Log evidence of an effect beside the rest, then of each other that could stand in its place; and which those are."""
        open_ = [k for k in self.beside(rest, others) if k != index]
        return self.sums.evidence([*self.users, *rest], [index, *open_]).tolist(), open_
