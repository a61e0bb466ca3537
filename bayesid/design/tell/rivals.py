"""Rivals: models that explain the recordings so far about as well, with what these know of everything free in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from bayesid.design.tell.evidence import Rival
from bayesid.diagnosis.candidates import Library, make_library
from bayesid.diagnosis.data import DiagnosisData, model_rows
from bayesid.diagnosis.fit import Fit, fit
from bayesid.diagnosis.projector import make_projector, offset_columns
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Effect, Term


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
    return tuple(_supposed(data, effects, true) for true in range(len(effects)))


def _supposed(data: DiagnosisData, effects: Sequence[Effect], true: int) -> Case:
    """The case of one of the effects."""
    term = Term(effects[true], tuple(map(float, effects[true].typical(data.robot))))
    none, terms = np.zeros(len(data.channels)), (*data.terms, term)
    there = replace(data, segments=tuple(predicted(data, s, data.links, none, terms) for s in data.segments))
    projector = make_projector(there, data.terms)
    base = fit(projector, data.terms)
    others = [e for k, e in enumerate(effects) if k != true]
    fits = _fitted(make_library(projector, base, effects=others), base, others)
    fits.insert(true, fit(projector, terms))
    best = fits[true].score
    rivals = tuple(known(f, e.spec, f.score - best, 1.0) for f, e in zip(fits, effects, strict=True))
    return Case(rivals, np.eye(len(effects))[true])


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
