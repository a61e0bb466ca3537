"""Rivals: models that explain the recordings so far about as well, with what these know of everything free in them.

How a motion that nobody has made yet would change the evidence between them is known in closed form. Rival i has, from the
recordings so far, an estimate of everything that is free in it (links, offset, its effects) with covariance
``C_i = (R_i' R_i)^-1``. For a planned motion it predicts whitened readings m_i with derivatives J_i, so that under it

    y ~ N(m_i, V_i),    V_i = 1 + J_i C_i J_i'.

What the old recordings know counts through C_i and through the log evidence that they gave. The new motion adds to the log
evidence of i over j

    Delta_ij = [(y - m_j)' V_j^-1 (y - m_j) - (y - m_i)' V_i^-1 (y - m_i)] / 2 - (what the free parameters cost more),

the first part being the same as that of a joint fit of old and new recordings, for ``(y - m)' V^-1 (y - m)`` is by how much the
new rows raise the smallest chi2. If i is true, with d = m_i - m_j, S S' = V_i, and A = S' V_j^-1 S - 1,

    mean = [tr A + d' V_j^-1 d] / 2,    variance = tr(A^2) / 2 + |S' V_j^-1 d|^2.

``lambda_ij = d' V_j^-1 d`` is the noncentrality: what the best fit of j and of all else leaves of i's prediction. Where the
old recordings have settled all but d this is N(lambda / 2, lambda), the expectation of [BoxHill1967]_ and the criterion of
[AtkinsonFedorov1975]_. The motion decides for i against j where Delta_ij and the old evidence together exceed the difference from
which a diagnosis no longer lists j as a rival.

All columns are reduced once to a triangular factor, so that a motion costs the same however long it lasts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr

from bayesid.diagnosis.candidates import Library, make_library
from bayesid.diagnosis.data import DiagnosisData, model_rows
from bayesid.diagnosis.fit import Fit, fit, price
from bayesid.diagnosis.projector import make_projector, offset_columns
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Effect, Term

#: Joint draws of the new evidence of all rivals, reduced to a few numbers each: probabilities to 1 %.
_DRAWN = 4000


@dataclass(frozen=True, eq=False)
class Rival:
    """A model that explains the recordings so far."""

    name: str  # of the effects that tell it from the others
    fit: Fit  # its fit
    #: Log evidence from the recordings so far, over the dispersion factor, but for a constant that all rivals share.
    evidence: float
    #: R, triangular factor of the information on links, offset and its free parameters, in units of the dispersed noise (s + k,
    #: s + k).
    factor: np.ndarray
    dispersion: float  # dispersion factor, by which the noise's power is larger than measured
    rows: int  # rows of the recordings that count

    def cost(self, factor: np.ndarray, rows: int) -> float:
        """What its free parameters cost of the log evidence, over the dispersion factor, with so much information."""
        if not rows:
            return 0.0
        data: DiagnosisData = self.fit.projector.data
        common = self.fit.projector.size
        kept = np.sqrt(self.dispersion) * factor[common:, common:]
        return price(data, rows, self.fit.terms, self.fit.free, kept) / self.dispersion


@dataclass(frozen=True, eq=False)
class PredictedRows:
    """What rivals predict of a motion, in units of the dispersed noise and reduced to a few rows."""

    readings: np.ndarray  # m_i, the first rival's subtracted (rivals, t)
    columns: tuple[np.ndarray, ...]  # j_i of each rival (t, s + k_i)
    count: int  # rows that are data

    @classmethod
    def of(cls, columns: Sequence[np.ndarray], readings: Sequence[np.ndarray], count: int) -> PredictedRows:
        """Reduce each rival's columns (N, s + k_i) and predicted readings (N,)."""
        away = np.column_stack([m - readings[0] for m in readings])
        r = np.asarray(np.linalg.qr(np.hstack([*columns, away]), mode="r"))
        *apart, means = np.split(r, np.cumsum([j.shape[1] for j in columns]), axis=1)
        return cls(means.T, tuple(apart), count)


@dataclass(frozen=True, eq=False)
class Contest:
    """What a motion would do to the evidence between rivals."""

    rivals: tuple[Rival, ...]  # the models
    rows: PredictedRows  # what they predict of it
    needed: float  # difference of log evidence from which one rules the other out
    #: Of the distance between the row's rival and the column's, what exact fits leave of it (rivals, rivals); 1: all.
    shares: np.ndarray
    lost: np.ndarray  # log evidence so far of the row's rival over the column's that exact fits take back (rivals, rivals)

    def _lead(self, i: int, j: int) -> float:
        """Log evidence of rival i over j but for what the motion adds, where i is true."""
        return float(self.constant[i] - self.constant[j] - self.lost[i, j])

    def _away(self, i: int, j: int) -> np.ndarray:
        """What rival i predicts beyond rival j (t,)."""
        return self.shares[i, j] * (self.rows.readings[i] - self.rows.readings[j])

    @cached_property
    def _spreads(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """A root S of each V and the inverse of V (t, t)."""
        out = []
        for rival, j in zip(self.rivals, self.rows.columns, strict=True):
            b = solve_triangular(rival.factor.T, j.T, lower=True).T
            v = np.eye(len(b)) + b @ b.T
            out.append((np.linalg.cholesky(v), np.linalg.inv(v)))
        return out

    @cached_property
    def constant(self) -> np.ndarray:
        """Log evidence of each rival so far, less what its free parameters will cost more (rivals,)."""
        out = []
        for rival, j in zip(self.rivals, self.rows.columns, strict=True):
            after = np.asarray(np.linalg.qr(np.vstack([rival.factor, j]), mode="r"))
            more = rival.cost(after, rival.rows + self.rows.count) - rival.cost(rival.factor, rival.rows)
            out.append(rival.evidence - more)
        return np.array(out)

    @cached_property
    def noncentrality(self) -> np.ndarray:
        """lambda: what the best fit of the column's rival leaves where the row's is true (rivals, rivals)."""
        count = len(self.rivals)
        out = np.zeros((count, count))
        for i in range(count):
            for j in range(count):
                d = self._away(i, j)
                out[i, j] = d @ self._spreads[j][1] @ d
        return out

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the log evidence of the row's rival, which is true, over the column's, old and new."""
        count = len(self.rivals)
        mean, std = np.zeros((2, count, count))
        for i in range(count):
            root = self._spreads[i][0]
            for j in range(count):
                if i == j:
                    continue
                inverse = self._spreads[j][1]
                along = root.T @ (inverse @ self._away(i, j))
                a = root.T @ inverse @ root - np.eye(len(root))
                mean[i, j] = 0.5 * (np.trace(a) + self.noncentrality[i, j]) + self._lead(i, j)
                std[i, j] = np.sqrt(0.5 * np.sum(a**2) + along @ along)
        return mean, std

    def merit(self, weights: np.ndarray) -> float:
        """What is maximised: log probabilities that the row's rival, if true, rules out the column's, of a normal Delta, summed.

        The pair that is hardest to tell counts most.
        """
        mean, std = self.moments
        distance = (mean - self.needed) / np.maximum(std, 1e-9)
        np.fill_diagonal(distance, np.inf)
        return float(weights @ log_ndtr(distance).sum(axis=1))

    def _scores(self, true: int, seed: int) -> np.ndarray:
        """Log evidence of each rival, but for a constant, in joint draws of y where one is true (draws, rivals)."""
        z = np.random.default_rng([seed, true]).normal(size=(_DRAWN, self.rows.readings.shape[1]))
        y = z @ self._spreads[true][0].T  # about what the true one predicts
        left = [(y + self._away(true, j), inverse) for j, (_, inverse) in enumerate(self._spreads)]
        lead = np.array([self._lead(true, j) for j in range(len(self.rivals))])
        return -lead - 0.5 * np.column_stack([np.sum((e @ inverse) * e, axis=1) for e, inverse in left])

    def chances(self, true: int, seed: int = 0) -> np.ndarray:
        """Probability that the true rival rules out each other one: from draws, where `merit` takes a normal law (rivals,)."""
        scores = self._scores(true, seed)
        return np.asarray(np.mean(scores[:, true : true + 1] - scores > self.needed, axis=0))

    def decided(self, weights: np.ndarray, seed: int = 0) -> tuple[float, float]:
        """Probabilities, by joint draws of y, that the true rival alone is left and that a wrong one is."""
        right, wrong = 0.0, 0.0
        for i in map(int, np.flatnonzero(weights > 0)):
            scores = self._scores(i, seed)
            second, first = np.sort(scores, axis=1)[:, -2:].T
            clear, best = first - second > self.needed, np.argmax(scores, axis=1) == i
            right += weights[i] * float(np.mean(clear & best))
            wrong += weights[i] * float(np.mean(clear & ~best))
        return min(right, 1.0), min(wrong, 1.0)  # weights add up to 1 but for rounding


@dataclass(frozen=True, eq=False)
class PredictedSegment(SpectralSegment):
    """A segment whose readings are given by their coefficients, without noise."""

    coefficients: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))  # of the readings (K, c)

    @cached_property
    def measured_readings(self) -> np.ndarray:
        """Coefficients of the readings (K, c)."""
        return self.coefficients


def predicted(
    data: DiagnosisData, segment: SpectralSegment, links: np.ndarray, offset: np.ndarray, terms: Sequence[Term]
) -> SpectralSegment:
    """The segment with the readings that a model predicts in place of its own."""
    read = segment.spectrum(data.predict(segment, links, terms)) + segment.measured_ones * offset
    given = {item.name: getattr(segment, item.name) for item in fields(SpectralSegment) if item.init}
    return PredictedSegment(**given, coefficients=read)


#: Of parameters that recordings say nothing of, prior standard deviations in sizes of the parameter: so wide that it says little.
_WIDE = 10.0


@dataclass(frozen=True, eq=False)
class Case:
    """Rivals, and how probable each is to be the true one."""

    rivals: tuple[Rival, ...]  # at least two
    weights: np.ndarray  # probabilities (rivals,); zero for one that is only looked at as what imitates another


def known(fitted: Fit, name: str, evidence: float, dispersion: float) -> Rival:
    """A fit as a rival: the information of its recordings, in units of the dispersed noise."""
    projector = fitted.projector
    rows = np.vstack([columns(fitted, projector.data.segments), _prior(fitted)])
    r = np.asarray(np.linalg.qr(rows, mode="r"))
    return Rival(name, fitted, evidence, r / np.sqrt(dispersion), dispersion, projector.rows)


def columns(fitted: Fit, segments: Sequence[SpectralSegment]) -> np.ndarray:
    """Whitened derivatives of a fit's readings with respect to links, offset and its free parameters (rows, s + k).

    Links and offset are in the projector's coordinates; their columns are those beside the fit's own effects.
    """
    projector, data = fitted.projector, fitted.projector.data
    parts = []
    for s in segments:
        mine = [np.zeros((s.shape[0] * s.shape[1], 0))]
        if data.prior is not None:
            spectrum = s.whiten(s.spectrum(data.link_columns(s, fitted.terms)))
            mine.append(spectrum.reshape(-1, spectrum.shape[2]) @ projector.root)
        if projector.offset:
            mine.append(offset_columns(s))
        parts.append(np.hstack(mine))
    return np.hstack([np.vstack(parts), model_rows(data, segments, fitted.links, fitted.terms)])


def unknown(rival: Rival) -> Rival:
    """The same rival before any recording: nominal links with their prior, and its effects about where they imitate best."""
    fitted = rival.fit
    nominal = replace(
        fitted,
        links=fitted.projector.data.links,
        offset=np.zeros_like(fitted.offset),
        coordinates=np.zeros_like(fitted.coordinates),
    )
    return replace(rival, fit=nominal, evidence=0.0, factor=_prior(fitted) / np.sqrt(rival.dispersion), rows=0)


def _prior(fitted: Fit) -> np.ndarray:
    """Rows of the prior of links and offset, and of one of the free parameters that says little (s + k, s + k)."""
    projector = fitted.projector
    sizes = np.array([_size(fitted.terms[i], k, projector.data) for i, k in fitted.free])
    return np.diag(np.concatenate([projector.prior_residual(np.ones(projector.size)), 1.0 / (_WIDE * sizes)]))


def _size(term: Term, parameter: int, data: DiagnosisData) -> float:
    """A size of a parameter: its value's or a usual one, whichever is larger."""
    usual = abs(float(term.effect.typical(data.robot)[parameter]))
    return max(usual, abs(term.values[parameter]), 1e-9)


def from_search(search: Search) -> Case | None:
    """The best model of a diagnosis and those with a rival in the place of one of its effects; None where there is no rival."""
    best, first = search.best, len(search.base.terms)
    rivals = [known(best, ", ".join(f.term.effect.spec for f in search.found), 0.0, search.dispersion)]
    for k, found in enumerate(search.found):
        for term, lack in found.rivals:
            if term.effect.spec in found.together:  # no motion tells them
                continue
            terms = (*best.terms[: first + k], term, *best.terms[first + k + 1 :])
            fitted = fit(best.projector, terms, best)
            if np.isfinite(fitted.score):
                names = (*(f.term.effect.spec for f in search.found[:k]), term.effect.spec,
                         *(f.term.effect.spec for f in search.found[k + 1 :]))  # fmt: skip
                rivals.append(known(fitted, ", ".join(names), -lack, search.dispersion))
    if len(rivals) < 2:
        return None
    return Case(tuple(rivals), _weights(rivals))


def _weights(rivals: Sequence[Rival]) -> np.ndarray:
    """Probabilities of rivals from their log evidence (rivals,)."""
    evidence = np.array([r.evidence for r in rivals])
    odds = np.exp(evidence - evidence.max())
    return odds / odds.sum()


def parse_effects(data: DiagnosisData, specs: Sequence[str]) -> tuple[Effect, ...]:
    """Effects to be distinguished, made from their names, as in `bayesid.effects.EffectLibrary.parse_rivals`."""
    e, known = data.experiment, [t.effect.spec for t in data.terms]
    return e.library.parse_rivals(specs, known, e.robot.joint_names, data.channels.names, e.gear_ratio, data.channel)


def from_effects(data: DiagnosisData, effects: Sequence[Effect]) -> tuple[Case, ...]:
    """Rivals by their names: at their estimates where the recordings demand each of them, otherwise at usual sizes.

    At usual sizes there is a case for each effect as the true one. Then the recordings' motions count with the readings that
    this effect would have caused in them, and the others at what imitates it best there.
    """
    projector = make_projector(data, data.terms)
    base = fit(projector, data.terms)
    library = make_library(projector, base, effects=effects)
    fits = _fitted(library, base, effects)
    dispersion = library.dispersion(base)
    needed = data.settings.accept * dispersion
    if len(fits) == len(effects) and all(f.score - base.score > needed for f in fits):
        best = max(f.score for f in fits)
        rivals = tuple(known(f, e.spec, (f.score - best) / dispersion, dispersion) for f, e in zip(fits, effects, strict=True))
        return (Case(rivals, _weights(rivals)),)
    return supposed(data, effects)


def supposed(data: DiagnosisData, effects: Sequence[Effect]) -> tuple[Case, ...]:
    """A case for each effect in which it is there at a usual size, its readings in place of the recorded ones."""
    none, cases = np.zeros(len(data.channels)), []
    for true, effect in enumerate(effects):
        terms = (*data.terms, Term(effect, tuple(map(float, effect.typical(data.robot)))))
        there = replace(data, segments=tuple(predicted(data, s, data.links, none, terms) for s in data.segments))
        projector = make_projector(there, data.terms)
        base = fit(projector, data.terms)
        others = [e for e in effects if e is not effect]
        fits = _fitted(make_library(projector, base, effects=others), base, others)
        fits.insert(true, fit(projector, terms))
        rivals = [known(f, e.spec, f.score - fits[true].score, 1.0) for f, e in zip(fits, effects, strict=True)]
        cases.append(Case(tuple(rivals), np.eye(len(effects))[true]))
    return tuple(cases)


def _fitted(library: Library, base: Fit, effects: Sequence[Effect]) -> list[Fit]:
    """Each effect fitted alone beside the user's model, in order; at its start where the recordings propose no values."""
    proposals = {p.term.effect: p for p in library.propose(base)}
    out = []
    for effect in effects:
        p = proposals.get(effect)
        starts = [Term(effect, effect.starts)] if p is None else [p.term, *p.others]
        fits = [fit(library.projector, (*base.terms, start), base) for start in starts]
        out.append(max(fits, key=lambda f: f.score))
    return out
