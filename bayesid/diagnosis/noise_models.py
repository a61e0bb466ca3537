"""Under which noise and reading of the samples models are fitted: what was measured, or what a model makes of it itself.

A flexible joint or mount makes much more of encoders' errors than other models do, so it is compared
under the noise that it makes itself; under that of stiff joints its own errors would count against it. Where the noise cannot be
measured, what the richest model leaves stands in for it, as a function of frequency.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.diagnosis.candidates import Library, make_library
from bayesid.diagnosis.data import FAR, POSES, STATED_POSES, WHITE, DiagnosisData
from bayesid.diagnosis.fit import SWEEPS, Fit, fit
from bayesid.diagnosis.noise import at_instants, with_noise_of
from bayesid.diagnosis.projector import NuisanceProjector, make_projector
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.effects import Term

#: Terms that make much more of encoders' errors, and how soft they are.
Softness = tuple[tuple[str, int], ...]


def as_points(best: Fit, seed: int) -> DiagnosisData | None:
    """The data with readings as values at their times, if that suits a model better than means over a sample's time do.

    Means of a smooth motion are smaller by ``(w h)^2 / 24`` at a rate w and a step h: to a quiet sensor a joint that gives way.
    """
    data = best.projector.data
    if data.instants or not data.floor_known or max(s.step for s in data.segments) < data.settings.short_step:
        return None
    points = at_instants(data, best.links, best.terms, seed)
    fitted = fit(make_projector(points, best.terms), best.terms, best)
    # Where friction reverses it shows whatever else is missing; elsewhere what is missing may suit either by chance.
    dry = any(t.effect.reverses_at_once for t in best.terms)
    return points if (dry or fitted.leaves_noise) and fitted.score > best.score + data.settings.accept else None


def soft_terms(terms: Sequence[Term]) -> Softness:
    """Those among effects that make much more of encoders' errors, and how soft they are within a factor of two."""
    soft = [t for t in terms if t.effect.amplifies_encoder_errors]
    return tuple(sorted((t.effect.spec, round(np.log2(max(t.values[0], 1e-12)))) for t in soft))


@dataclass(frozen=True, eq=False)
class NoiseModels:
    """The noise that models make, and all effects' columns under it: one of each for every set of soft effects.

    Each is made by the first model that needs it, and stays; methods return what was asked for and the noise models with it.
    """

    seed: int  # of the encoders' repeated rounding
    known: tuple[Term, ...]  # effects of the user's model
    #: By softness.
    projectors: Mapping[Softness, NuisanceProjector]
    libraries: Mapping[Softness, Library]

    @classmethod
    def of(cls, seed: int, known: Sequence[Term], library: Library, at: Sequence[Term] = ()) -> NoiseModels:
        """Noise models that begin with one library, made for a model with these terms."""
        key = soft_terms(at)
        return cls(seed, tuple(known), {key: library.projector}, {key: library})

    def own(self, fitted: Fit) -> tuple[NoiseModels, Fit]:
        """A model refitted under the noise that it makes itself."""
        key = soft_terms(fitted.terms)
        data, models = fitted.projector.data, self
        if key not in self.projectors:
            if not data.floor_known:
                return self, fitted  # what the richest model leaves stands in for the noise, whatever makes it
            # A mount that is damped too much rings too little with the errors that made it look so.
            for _ in range(SWEEPS if key else 1):
                own = with_noise_of(data, fitted.links, fitted.terms, self.seed)
                fitted = fit(make_projector(own, fitted.terms), fitted.terms, fitted)
            if not fitted.projector.finite:
                return self, fitted  # what diverged says nothing for other models
            models = replace(self, projectors={**self.projectors, key: fitted.projector})
        elif fitted.projector is self.projectors[key]:
            return self, fitted
        else:
            fitted = fit(self.projectors[key], fitted.terms, fitted)
        projector = models.projectors[key]
        if not key or fitted.leaves_noise or not fitted.terms[-1].effect.restarts:
            return models, fitted
        # A resonance near the motion's band is found only from nearby, and stiff joints' noise may have put the start afar.
        last = fitted.terms[-1]
        near = [(*fitted.terms[:-1], replace(last, values=(k * last.values[0], *last.values[1:]))) for k in last.effect.restarts]
        return models, max([fitted, *(fit(projector, terms, fitted) for terms in near)], key=lambda f: f.score)

    def library(self, fitted: Fit) -> tuple[NoiseModels, Library]:
        """All effects' columns under the noise that a model was fitted with."""
        key = next(key for key, projector in self.projectors.items() if projector is fitted.projector)
        if key in self.libraries:
            return self, self.libraries[key]
        made = make_library(fitted.projector, fit(fitted.projector, self.known, fitted))
        return replace(self, libraries={**self.libraries, key: made}), made


def prepared(projector: NuisanceProjector, terms: Sequence[Term], best: Fit | None) -> tuple[NuisanceProjector, Fit, Library]:
    """The user's model fitted, and its library; with a floor of its own where none was measured."""
    base = fit(projector, terms)
    library, richest = make_library(projector, base, best), base if best is None else fit(projector, best.terms, best)
    if projector.data.floor_known and library.dispersion(richest) < projector.data.settings.hopeless:
        return projector, base, library
    projector = make_projector(with_floor_of(library, richest), richest.terms)
    base = fit(projector, terms, base)
    return projector, base, make_library(projector, base, best)


#: What the report says of the noise floor, by where that comes from.
SOURCES = {
    WHITE: "Nothing of it is assumed: the sensor's noise is read off the quietest moments above the frequencies of the motion.",
    "repeats": "Noise floor measured on repeats: how far readings scatter where the motion repeats, by frequency. What does not "
    "repeat, a single contact or a drive that sticks now and then, counts as noise.",
    "parked": "Noise floor measured at rest: the readings' noise while the robot stands still, by frequency. What shakes only in "
    "motion is not in it.",
    "stated": "Noise floor unknown: the readings were filtered before they were recorded. The data sheet's noise is taken for "
    "the least there is, and what the richest model of the library leaves beyond it for noise, too, so nothing can be said about "
    "effects that the library lacks.",
    "richest model": "Noise floor unknown: the readings were filtered before they were recorded. "
    "What the richest model of the library leaves stands in for it, so nothing can be said about effects that the library lacks.",
    POSES: "Noise floor of the poses: what any bodies and any linear map between the sensor's axes leave of them. "
    "Effects that resemble such a map are no noise; others are, where they are small.",
    STATED_POSES: "Noise floor of the poses: that of the data sheet.",
    FAR: "The readings hold far more than their noise, whatever the library has is added to the model: something stays that "
    "no effect of it explains. What the richest model leaves stands in for the noise, so that effects can be told from the rest.",
}
#: Edges of the frequencies that share a floor [Hz].
_EDGES = np.concatenate([[0.0], np.geomspace(0.15, 10.0, 9)])


def with_floor_of(library: Library, best: Fit) -> DiagnosisData:
    """The data with noise enlarged to what a fit and all columns of the library together leave.

    Never below what was measured. What remains of a model error that no effect of the library resembles counts as noise
    then: names become harder to earn, and whether something unknown is missing can no longer be said.
    """
    data, (left, parameters) = library.projector.data, library.unexplained(best)
    share = library.projector.rows / max(library.projector.rows - parameters, 0.1 * library.projector.rows)
    channels = len(data.channels)
    energy, count = np.zeros((len(_EDGES), channels)), np.zeros((len(_EDGES), 1))
    at = 0
    for s in data.segments:
        mine, at = left[at : at + s.shape[0] * s.shape[1]].reshape(s.shape), at + s.shape[0] * s.shape[1]
        part = np.searchsorted(_EDGES, s.frequencies, side="right") - 1
        np.add.at(energy, part, mine**2)
        np.add.at(count, part, 1.0)
    ratio = np.maximum(share * energy / np.maximum(count, 1.0), 1.0)

    def louder(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
        out = []
        for s in segments:
            root = np.linalg.inv(s.whitener) * np.sqrt(ratio[np.searchsorted(_EDGES, s.frequencies, side="right") - 1])[:, None]
            out.append(s.with_noise(root @ root.transpose(0, 2, 1)))
        return tuple(out)

    source = FAR if data.floor_known else data.floor_source
    fitted, unseen = louder(data.segments), louder(data.unseen)
    return replace(data, segments=fitted, unseen=unseen, floor_known=False, floor_source=source)
