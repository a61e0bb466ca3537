"""Which changes the data demand: the best one, then what else, beside rivals that do as well."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from bayesid.diagnosis.changes.evidence import Marginal, Reduced, best_size, gain, without_change
from bayesid.diagnosis.changes.hypotheses import Hypothesis, beside, gain_columns, hypotheses, warming_columns
from bayesid.diagnosis.changes.recording import LaterRecording
from bayesid.diagnosis.changes.reference import Reference
from bayesid.diagnosis.changes.scales import GAIN_SHARE, WANDER_FACTORS
from bayesid.diagnosis.settings import Settings
from bayesid.regression.linalg import root_of

#: Changes with their log evidence, best first.
Scores = tuple[tuple[Hypothesis, float], ...]


@dataclass(frozen=True, eq=False)
class Accepted:
    """A change that the data demand."""

    change: Hypothesis  # what changed
    size: float  # of its prior, in typical sizes
    evidence: float  # log evidence that it adds to what is known and to the other changes
    rivals: Scores = ()  # other changes that would do as well in its place, and by how much log evidence they are behind
    #: Log evidence by which the best change of another kind or place is behind, and that change.
    lead: tuple[Hypothesis, float] | None = None


@dataclass(frozen=True, eq=False)
class Selection:
    """The changes found."""

    data: Reduced  # the rows
    every: tuple[Hypothesis, ...]  # all changes that competed
    #: What is known: combinations of columns of unit variance (q, k), by the factor by which it is wider than usual.
    tolerance: dict[float, np.ndarray]
    accepted: tuple[Accepted, ...] = ()  # changes, in the order found
    factor: float = 1.0  # by which links and friction are further from the reference than they usually are, beside them
    scores: Scores = ()  # log evidence of every change on its own
    beyond: Scores = ()  # what others add to those accepted

    def marginal(self, accepted: Iterable[Accepted] | None = None, factor: float | None = None) -> Marginal:
        """The data with some of the changes (default all) and a tolerance so many times as wide integrated out."""
        factor = self.factor if factor is None else factor
        parts = [self.tolerance[factor]]
        count = len(parts[0])
        mean = np.zeros(count)
        for a in self.accepted if accepted is None else accepted:
            parts.append(_at(count, a.change.columns, a.size * a.change.root))
            if (both := a.change.shared) is not None:
                parts.append(_at(count, a.change.columns, factor * np.diag(both.wander)))
                parts.append(_at(count, both.columns, both.root))
                mean[both.columns] = both.mean
        return Marginal(self.data, np.hstack(parts), mean, factor, WANDER_FACTORS[factor])

    @property
    def for_values(self) -> Selection:
        """The same changes with the priors by which their values are estimated."""
        free = ((a, a.change.for_values) for a in self.accepted)
        return replace(self, accepted=tuple(a if h is None else replace(a, change=h, size=1.0) for a, h in free))

    @property
    def directions(self) -> tuple[slice, ...]:
        """Which of the directions of `marginal` are each change's."""
        start, out = self.tolerance[self.factor].shape[1], []
        for a in self.accepted:
            count = a.change.root.shape[1]
            out.append(slice(start, start + count))
            start += count if a.change.shared is None else 3 * count
        return tuple(out)

    @cached_property
    def forms(self) -> dict[str, tuple[Hypothesis, ...]]:
        """The changes by ``name@where``: one may have several forms, such as a body near its joint or far from it."""
        specs = dict.fromkeys(h.spec for h in self.every)
        return {spec: tuple(h for h in self.every if h.spec == spec) for spec in specs}

    def ranked(self, accepted: Sequence[Accepted]) -> Scores:
        """What every other change adds, in its best form, best first; all forms of one are equally likely beforehand.

        The tolerance is wider by the best of the factors, with and without it.
        """
        marginals = [self.marginal(accepted, f) for f in WANDER_FACTORS]
        taken, found = {a.change.spec for a in accepted}, []
        for spec, forms in self.forms.items():
            if spec not in taken:
                gains = [gain(marginals, h) for h in forms]
                found.append((forms[int(np.argmax(gains))], float(logsumexp(gains) - np.log(len(forms)))))
        return tuple(sorted(found, key=lambda x: -x[1]))


def select(reference: Reference, recording: LaterRecording, settings: Settings) -> Selection:
    """Add changes between reference and later recording as long as the data demand them."""
    tolerance = {f: _tolerance(reference, recording, f) for f in WANDER_FACTORS}
    s = Selection(Reduced.of(recording.rows, recording.left, recording.correlation), hypotheses(reference), tolerance)
    further = scores = _demanded(s, settings)
    s = replace(s, scores=scores, factor=_factor(s, ()))
    while further and further[0][1] >= settings.accept:
        change, evidence = further[0]
        accepted = (*s.accepted, Accepted(change, best_size(s.marginal(), change), evidence))
        s = replace(s, accepted=accepted, factor=_factor(s, accepted))
        further = _demanded(s, settings)
    return replace(s, accepted=tuple(_judged(s, a, settings) for a in s.accepted), beyond=further)


def _demanded(s: Selection, settings: Settings) -> Scores:
    """What every other change adds, best first; the first has enough only if it has it whatever effect the reference lacks."""
    scores, lacking = list(s.ranked(s.accepted)), _Lacking.beside(s, s.accepted)
    for k, (change, evidence) in enumerate(scores):
        left = lacking.left(change, evidence, settings.accept)
        if evidence < settings.accept or left >= settings.accept:
            break
        scores[k] = change, left
    return tuple(sorted(scores, key=lambda x: -x[1]))


@dataclass(frozen=True, eq=False)
class _Lacking:
    """Effects that the reference's model lacks, and what each of them leaves of a change.

    The reference may not show how large they are: a joint that stands elsewhere later, say, reads otherwise with nothing changed.
    """

    marginals: tuple[Marginal, ...]
    effects: tuple[Hypothesis, ...]

    @classmethod
    def beside(cls, s: Selection, accepted: Sequence[Accepted]) -> _Lacking:
        """Those beside some changes."""
        marginals = tuple(s.marginal(accepted, f) for f in WANDER_FACTORS)
        return cls(marginals, tuple(h for h in s.every if h.shared is not None))

    @cached_property
    def worth(self) -> list[float]:
        """Log evidence that each is in both recordings, with nothing changed."""
        null = max(m.null for m in self.marginals)
        return [without_change(self.marginals, h) - null for h in self.effects]

    def left(self, change: Hypothesis, evidence: float, enough: float) -> float:
        """What is left of a change's log evidence beside that effect of which least is; exact where it is below ``enough``."""
        if evidence < enough:
            return evidence
        # What brings no more than the change has to spare leaves it enough.
        each = [h for h, worth in zip(self.effects, self.worth, strict=True) if h is not change and worth > evidence - enough]
        own = gain(self.marginals, change) if each else 0.0
        return min([evidence, *(evidence - own + gain(self.marginals, beside(change, h)) for h in each)])


def _factor(s: Selection, accepted: Sequence[Accepted]) -> float:
    """How much wider than usual the tolerance is beside some changes."""
    return max(WANDER_FACTORS, key=lambda f: s.marginal(accepted, f).null)


def _judged(s: Selection, one: Accepted, settings: Settings) -> Accepted:
    """A change beside the others that were accepted, with what else would do in its place."""
    others = [a for a in s.accepted if a is not one]
    scores = s.ranked(others)
    taken = {a.change.spec for a in s.accepted}
    own = next(e for h, e in scores if h.spec == one.change.spec)
    lacking = _Lacking.beside(s, others)
    behind = [(h, own - lacking.left(h, e, own - settings.rival)) for h, e in scores if h.spec not in taken]
    behind.sort(key=lambda x: x[1])
    return replace(
        one, evidence=own, rivals=tuple(x for x in behind if x[1] < settings.rival), lead=behind[0] if behind else None
    )


def _tolerance(reference: Reference, recording: LaterRecording, factor: float) -> np.ndarray:
    """Root of the reference's covariance and of what differs from one recording to another, as combinations of columns (q, k)."""
    p, q = len(reference.solution), recording.rows.shape[1]
    friction, gains = factor * reference.wanders(friction=True), reference.wanders(friction=False)
    covariance = factor**2 * reference.covariance + np.diag(friction**2 + gains**2)
    columns = gain_columns(reference)
    warming, sizes = warming_columns(reference, recording.rows)
    return np.hstack([
        _at(q, np.arange(p), root_of(covariance)), _at(q, columns, GAIN_SHARE * np.eye(len(columns))),
        _at(q, warming, factor * np.diag(sizes)),
    ])  # fmt: skip


def _at(count: int, columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (k, m) in some of the rows of zeros (count, m)."""
    out = np.zeros((count, values.shape[1]))
    out[columns] = values
    return out
