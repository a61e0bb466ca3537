"""Under which noise and reading of the samples models are fitted: what was measured, or what a model makes of it itself.

A flexible joint or mount makes much more of encoders' errors than other models do, so it competes under the noise that
it makes itself; under the noise of stiff joints its own errors would count against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.diagnosis.candidates import UNEXPLAINED, Library, make_library
from bayesid.diagnosis.data import DiagnosisData, at_instants, with_noise_of
from bayesid.diagnosis.fit import Fit, NuisanceProjector, fit, make_projector
from bayesid.diagnosis.residual_floor import with_floor_of
from bayesid.effects import Term

#: An effect must gain this much log evidence: the odds of one among a hundred, times a thousand.
ACCEPT = 12.0
#: Residuals this many times the noise in mean square, with everything the library has, are no residuals of a model: the
#: noise was measured wrongly.
HOPELESS = 200.0
#: Between samples closer than this it makes no difference where in a sample's time friction reverses [s].
_SHORT = 0.0025


def as_points(best: Fit, seed: int) -> DiagnosisData | None:
    """The data with readings as values at their times, if that suits a model with dry friction better than means do."""
    data = best.projector.data
    dry = any(t.effect.reverses_at_once for t in best.terms)
    if not dry or data.instants or not data.floor_known or max(s.step for s in data.segments) < _SHORT:
        return None
    points = at_instants(data, best.links, best.terms, seed)
    fitted = fit(make_projector(points, best.terms), best.terms, best)
    return points if fitted.score > best.score + ACCEPT else None


def soft_terms(terms: Sequence[Term]) -> tuple[tuple[str, int], ...]:
    """Those among effects that make much more of encoders' errors, and how soft they are within a factor of two."""
    soft = [t for t in terms if t.effect.amplifies_encoder_errors]
    return tuple(sorted((t.effect.spec, round(np.log2(max(t.values[0], 1e-12)))) for t in soft))


@dataclass(eq=False)
class NoiseModels:
    """Libraries by the noise that models make: one for each set of soft effects, made when first needed."""

    seed: int
    known: tuple[Term, ...]
    libraries: dict[tuple[tuple[str, int], ...], Library]
    projectors: dict[tuple[tuple[str, int], ...], NuisanceProjector] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.projectors = {key: library.projector for key, library in self.libraries.items()}

    def own(self, fitted: Fit) -> Fit:
        """A model refitted under the noise that it makes itself."""
        key = soft_terms(fitted.terms)
        data = fitted.projector.data
        if key not in self.projectors:
            if not data.floor_known:
                return fitted  # what the richest model leaves stands in for the noise, whatever makes it
            self.projectors[key] = make_projector(with_noise_of(data, fitted.links, fitted.terms, self.seed), fitted.terms)
        projector = self.projectors[key]
        if fitted.projector is projector:
            return fitted
        refitted = fit(projector, fitted.terms, fitted)
        if not key or refitted.chi2 < UNEXPLAINED * projector.rows or not fitted.terms[-1].effect.restarts:
            return refitted
        # A resonance near the motion's band is found only from nearby, and stiff joints' noise may have put the start afar.
        last = fitted.terms[-1]
        near = [(*fitted.terms[:-1], replace(last, values=(k * last.values[0], *last.values[1:]))) for k in last.effect.restarts]
        return max([refitted, *(fit(projector, terms, fitted) for terms in near)], key=lambda f: f.score)

    def library(self, fitted: Fit) -> Library:
        """All effects' columns under the noise that a model was fitted with."""
        key = next(key for key, projector in self.projectors.items() if projector is fitted.projector)
        if key not in self.libraries:
            self.libraries[key] = make_library(fitted.projector, fit(fitted.projector, self.known, fitted))
        return self.libraries[key]


def prepared(projector: NuisanceProjector, terms: Sequence[Term], best: Fit | None) -> tuple[NuisanceProjector, Fit, Library]:
    """The user's model fitted, and its library; with a floor of its own where none was measured."""
    base = fit(projector, terms)
    library = make_library(projector, base, best)
    if projector.data.floor_known and library.dispersion(base) < HOPELESS:
        return projector, base, library
    projector = make_projector(
        with_floor_of(library, base if best is None else fit(projector, best.terms, best)), (best or base).terms
    )
    base = fit(projector, terms, base)
    return projector, base, make_library(projector, base, best)


__all__ = ["ACCEPT", "NoiseModels", "as_points", "prepared", "soft_terms"]
