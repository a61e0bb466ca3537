"""Under which noise and reading of the samples models are fitted: what was measured, or what a model makes of it itself.

A flexible joint or mount makes much more of encoders' errors than other models do, so it competes under the noise that
it makes itself; under the noise of stiff joints its own errors would count against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.diagnosis.candidates import UNEXPLAINED, Library, make_library
from bayesid.diagnosis.case import Case, at_instants, with_noise_of
from bayesid.diagnosis.fit import Fit, Rigid, fit, make_rigid
from bayesid.diagnosis.floor import with_floor_of
from bayesid.effects import SOFT, Term

#: An effect must gain this much log evidence: the odds of one among a hundred, times a thousand.
ACCEPT = 12.0
#: Residuals this many times the noise in mean square, with everything the library has, are no residuals of a model: the
#: noise was measured wrongly.
HOPELESS = 200.0
#: Other starts of a flexible joint that leaves something unexplained, over where it settled.
_COMPLIANCES = (0.25, 0.5, 2.0, 4.0)
#: Friction that reverses at once; between samples closer than this, where in a sample's time it does makes no difference [s].
DRY, _SHORT = ("coulomb_friction", "stribeck_friction", "load_friction"), 0.0025


def as_points(best: Fit, seed: int) -> Case | None:
    """The case with readings as values at their times, if that suits a model with dry friction better than means do."""
    case = best.rigid.case
    dry = any(t.effect.name in DRY for t in best.terms)
    if not dry or case.instants or not case.floor_known or max(s.step for s in case.stretches) < _SHORT:
        return None
    points = at_instants(case, best.links, best.terms, seed)
    fitted = fit(make_rigid(points, best.terms), best.terms, best)
    return points if fitted.score > best.score + ACCEPT else None


def soft_terms(terms: Sequence[Term]) -> tuple[tuple[str, int], ...]:
    """Those among effects that make much more of encoders' errors, and how soft they are within a factor of two."""
    soft = [t for t in terms if t.effect.name in SOFT]
    return tuple(sorted((t.effect.spec, round(np.log2(max(t.values[0], 1e-12)))) for t in soft))


@dataclass(eq=False)
class Noises:
    """Libraries by the noise that models make: one for each set of soft effects, made when first needed."""

    seed: int
    known: tuple[Term, ...]
    libraries: dict[tuple[tuple[str, int], ...], Library]
    rigids: dict[tuple[tuple[str, int], ...], Rigid] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.rigids = {key: library.rigid for key, library in self.libraries.items()}

    def own(self, fitted: Fit) -> Fit:
        """A model refitted under the noise that it makes itself."""
        key = soft_terms(fitted.terms)
        case = fitted.rigid.case
        if key not in self.rigids:
            if not case.floor_known:
                return fitted  # what the richest model leaves stands in for the noise, whatever makes it
            self.rigids[key] = make_rigid(with_noise_of(case, fitted.links, fitted.terms, self.seed), fitted.terms)
        rigid = self.rigids[key]
        if fitted.rigid is rigid:
            return fitted
        refitted = fit(rigid, fitted.terms, fitted)
        if not key or refitted.chi2 < UNEXPLAINED * rigid.rows or fitted.terms[-1].effect.name != "joint_flexibility":
            return refitted
        # A resonance near the motion's band is found only from nearby, and stiff joints' noise may have put the start afar.
        last = fitted.terms[-1]
        near = [(*fitted.terms[:-1], replace(last, values=(k * last.values[0],))) for k in _COMPLIANCES]
        return max([refitted, *(fit(rigid, terms, fitted) for terms in near)], key=lambda f: f.score)

    def library(self, fitted: Fit) -> Library:
        """All effects' columns under the noise that a model was fitted with."""
        key = next(key for key, rigid in self.rigids.items() if rigid is fitted.rigid)
        if key not in self.libraries:
            self.libraries[key] = make_library(fitted.rigid, fit(fitted.rigid, self.known, fitted))
        return self.libraries[key]


def prepared(rigid: Rigid, terms: Sequence[Term], best: Fit | None) -> tuple[Rigid, Fit, Library]:
    """The user's model fitted, and its library; with a floor of its own where none was measured."""
    base = fit(rigid, terms)
    library = make_library(rigid, base, best)
    if rigid.case.floor_known and library.temper(base) < HOPELESS:
        return rigid, base, library
    rigid = make_rigid(with_floor_of(library, base if best is None else fit(rigid, best.terms, best)), (best or base).terms)
    base = fit(rigid, terms, base)
    return rigid, base, make_library(rigid, base, best)


__all__ = ["ACCEPT", "Noises", "as_points", "prepared", "soft_terms"]
