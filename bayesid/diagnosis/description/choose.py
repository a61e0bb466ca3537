"""Which candidates are taken: chosen and adapted on one half of the recordings, tested on the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.diagnosis.candidates import Library
from bayesid.diagnosis.description.candidates import CandidateTerm
from bayesid.diagnosis.description.columns import Half
from bayesid.diagnosis.gap import lower_end, share_of_gap
from bayesid.diagnosis.grams import schwarz
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect

#: Halvings of the step when a number is adapted.
_HALVINGS = 6
#: Forms of the same variables in the same readings that are adapted.
_ALIKE = 4
#: Terms at most: more would be a fit, not a description. Candidates adapted in one round, and compared on the other half.
_TERMS, _ADAPTED, _COMPARED = 3, 10, 40


@dataclass(frozen=True)
class Chosen:
    """A candidate that was taken."""

    candidate: CandidateTerm  # with its numbers adapted
    evidence: float  # log evidence that it adds on the first half, the number of candidates counted
    share: float  # share of what was left on the second half that it closes there, with amplitudes of the first
    share_low: float  # lower end of the one-sided 95 % interval of that, by bootstrap over blocks of time
    #: Other candidates that are no worse there than what counts as a rival, best first, with the log evidence they lack.
    alike: tuple[tuple[CandidateTerm, float], ...] = ()
    library: tuple[tuple[Effect, float], ...] = ()  # the same for effects of the library


def choose(
    first: Half, second: Half, candidates: Sequence[CandidateTerm], settings: Settings, library: Library | None, seed: int,
    least: float,
) -> tuple[Chosen, ...]:  # fmt: skip
    """Terms one after the other, as long as the second half confirms each: the lower end of its share there is above ``least``.

    Of the best candidates the first that is confirmed is taken; how many candidates there are counts against each. ``library``
    holds effects that could do as well; the seed is the bootstrap's.
    """
    sorts = [c.sort for c in candidates]
    bars = Counter(sorts)
    tried = np.array([bars[sort] for sort in sorts], dtype=float)
    free = np.array([c.free for c in candidates], dtype=float)
    among, out = list(range(len(candidates))), []
    state = _State(first, second, np.zeros((len(first.residual), 0)), np.zeros((len(second.residual), 0)))
    while len(out) < _TERMS:
        pool, beside = [candidates[k] for k in among], state.beside
        worth = _evidence(beside, beside.gains(pool), free[among], tried[among])
        order = np.argsort(-worth)
        best = [(*adapted(beside, pool[k]), among[k]) for k in _various(pool, order, _ADAPTED)]
        proven = None
        evidences = [(float(_evidence(beside, np.array(g), free[k], tried[k])), c) for c, g, k in best]
        for evidence, candidate in sorted(evidences, key=lambda x: -x[0]):
            after = state.tried(candidate)
            share, low = closed(second, state.left, after.left, settings, seed)
            if evidence >= settings.accept and low > least and share >= 1.0 - settings.nearly_all:
                proven = candidate, evidence, after, share, low
                break
        if proven is None:
            break
        candidate, evidence, after, share, low = proven
        lacks = [(pool[k], after.lack(state.tried(pool[k]))) for k in order[:_COMPARED]]
        others = _library_lacks(state, after, library)
        out.append(
            Chosen(
                candidate, evidence, share, low,
                tuple(x for x in sorted(lacks, key=lambda x: x[1]) if x[1] < settings.rival and not _same(x[0], candidate)),
                tuple(x for x in sorted(others, key=lambda x: x[1]) if x[1] < settings.rival),
            )
        )  # fmt: skip
        state = after
        among = [among[k] for k in order[: max(len(pool) // 3, _COMPARED)]]
    return tuple(out)


@dataclass(frozen=True, eq=False)
class _State:
    """Terms taken so far: what is left of their columns in both halves (rows + m, k)."""

    first: Half
    second: Half
    here: np.ndarray
    there: np.ndarray

    @property
    def beside(self) -> Half:
        """The first half with them among what is explained."""
        return self.first.with_columns(self.here) if self.here.shape[1] else self.first

    @property
    def left(self) -> np.ndarray:
        """What they leave of the second half's residual, with amplitudes of the first (rows + m,)."""
        amplitudes = np.linalg.lstsq(self.here, self.first.residual, rcond=None)[0]
        return self.second.residual - self.there @ amplitudes

    def with_columns(self, here: np.ndarray, there: np.ndarray) -> _State:
        """The state with the columns of one term more."""
        return _State(self.first, self.second, np.hstack([self.here, here]), np.hstack([self.there, there]))

    def tried(self, candidate: CandidateTerm) -> _State:
        """The state with a candidate, its shape as it is."""
        return self.with_columns(self.first.columns(candidate), self.second.columns(candidate))

    def lack(self, other: _State) -> float:
        """Log likelihood that another choice lacks on the second half, in units of what this one leaves there."""
        mine, theirs = (float(np.sum(s.left[: s.second.rows] ** 2)) for s in (self, other))
        return 0.5 * (theirs - mine) / max(mine / self.second.count, 1.0)


def _various(pool: Sequence[CandidateTerm], order: np.ndarray, count: int) -> list[int]:
    """The best candidates of different forms, a few of each set of variables in the same readings: several ideas."""
    forms: set[tuple] = set()
    ideas: Counter = Counter()
    out: list[int] = []
    for k in map(int, order):
        c = pool[k]
        idea = (c.channels, frozenset(c.shape.variables) - {"t"})
        form = (c.channels, *((f.form, f.variable) for f in c.shape.products[0]))
        if form not in forms and ideas[idea] < _ALIKE:
            forms.add(form)
            ideas[idea] += 1
            out.append(k)
        if len(out) == count:
            break
    return out


def _library_lacks(state: _State, after: _State, library: Library | None) -> list[tuple[Effect, float]]:
    """Log likelihood that each effect of the library lacks in the place of the last term."""
    best: dict[str, tuple[Effect, float]] = {}
    for block in () if library is None else library.blocks:
        other = state.with_columns(*(half.project_out_rows(block.rows) for half in (state.first, state.second)))
        name, lack = block.effect.spec, after.lack(other)
        if name not in best or lack < best[name][1]:
            best[name] = (block.effect, lack)
    return list(best.values())


def _same(one: CandidateTerm, other: CandidateTerm) -> bool:
    """Whether two candidates differ in their numbers only."""
    forms = [[[(f.form, f.variable) for f in p] for p in c.shape.products] for c in (one, other)]
    return one.channels == other.channels and forms[0] == forms[1]


def _evidence(half: Half, gain: np.ndarray, free: np.ndarray, tried: np.ndarray) -> np.ndarray:
    """Log evidence of explained sums of squares (g,).

    Their likelihood under noise at least as large as measured, less what amplitudes and numbers, so many ``free``, and the choice
    among all candidates of their sort, ``tried``, cost.
    """
    n, whole = half.count, float(half.residual @ half.residual)
    before, after = max(whole / n, 1.0), np.maximum((whole - gain) / n, 1.0)
    likelihood = 0.5 * (n * np.log(before / after) + whole / before - (whole - gain) / after)
    return likelihood - schwarz(free, n) - np.log(tried)


def adapted(half: Half, candidate: CandidateTerm) -> tuple[CandidateTerm, float]:
    """A candidate with the numbers that explain most of a half, and how much that is."""
    best = (candidate, half.explained(candidate))
    for index in range(len(candidate.shape.numbers)):
        step = candidate.shape.numbers[index][2]
        for _ in range(_HALVINGS):
            value = best[0].shape.numbers[index][1]
            trials = [CandidateTerm(best[0].shape.moved(index, value + s * step), candidate.channels) for s in (-1.0, 1.0)]
            # A width or a rate stays positive; a threshold has any sign.
            trials = [t for t in trials if t.shape.numbers[index][1] * value > 0.0]
            better = max([best, *((t, half.explained(t)) for t in trials)], key=lambda x: x[1])
            step = step if better is not best else 0.5 * step
            best = better
    return best


def closed(half: Half, before: np.ndarray, after: np.ndarray, settings: Settings, seed: int) -> tuple[float, float]:
    """Share of what stood out of a half's noise that is closed, and the lower end of its one-sided 95 % interval by bootstrap.

    ``before`` and ``after`` are what is left of its residual (rows + m,).
    """
    energy = np.stack([half.by_block(x, settings.window) for x in (before, after)], axis=1)

    def share(pair):
        return share_of_gap(pair[..., 0] - pair[..., 1], pair[..., 0], half.count)

    return float(share(energy.sum(axis=0))), float(lower_end(energy, share, settings, seed))
