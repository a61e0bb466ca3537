"""What a diagnosis looks at: segments with their noise, links and their prior; whitened rows of residuals and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.diagnosis.noise_spectrum import NoiseSpectrum
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.dynamics.channels import Channels
from bayesid.effects import Effect, Term, columns, readings, rigid_columns
from bayesid.effects.exact import effect_derivatives_at_joint
from bayesid.effects.families import EncoderEffect, JointDelayEffect, JointGainEffect, comes_on_top, needs_no_load
from bayesid.effects.model import Model
from bayesid.recordings.experiment import Experiment
from bayesid.robot.prior import Prior, filled_links
from bayesid.robot.robot import Robot

#: The source of a floor that is measured where nothing moves a sensor: above the motion.
WHITE = "white noise above the band"
#: The sources of the floor of poses at rest: the data sheet's, or what the most general model leaves of them.
STATED_POSES, POSES = "data sheet", "poses"
#: The source of a floor where readings hold so much more than what was measured that names cannot be told under that.
FAR = "far above the noise"


@dataclass(frozen=True)
class Episode(Term):
    """An effect that happened once, in one recording."""

    motion: str = ""  # in which; nothing is known of others


@dataclass(frozen=True)
class OneValue(Term):
    """An effect of several values with one of them alone: the others are zero and stay so."""

    only: int = 0  # index of that value


def fitted_values(term: Term) -> slice:
    """Which of a term's values a fit may change."""
    return slice(term.only, term.only + 1) if isinstance(term, OneValue) else slice(None)


def active_terms(segment: SpectralSegment, terms: Sequence[Term]) -> tuple[Term, ...]:
    """The effects that act in a segment."""
    return tuple(
        t for t in terms
        if not (t.effect.once and (segment.still or segment.role == "validation"))
        and not (isinstance(t, Episode) and t.motion != segment.motion)
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class DiagnosisData:
    """What a diagnosis looks at."""

    #: The recordings and what of them is compared.
    experiment: Experiment
    channel: str
    channels: Channels
    segments: tuple[SpectralSegment, ...]  # of the identification motions, with their noise
    unseen: tuple[SpectralSegment, ...]  # of the validation motions, with their noise
    prior: Prior | None  # of the links; None where they are exact
    terms: tuple[Term, ...]  # effects of the user's model at their starting values
    #: Whether the noise was measured and is what models are fitted under. Where readings were filtered before they were recorded
    #: it cannot be; there, and far above it, what the richest model leaves stands in for it.
    floor_known: bool = True
    #: Where the noise of moving readings comes from: ``white noise above the band``, ``repeats``, ``parked``, ``stated``,
    #: ``richest model`` or ``far above the noise``.
    floor_source: str = WHITE
    #: The noise of moving readings where it was measured by frequency, on repeats or at rest.
    spectrum: NoiseSpectrum | None = None
    #: Makes `attenuation`, which takes as long as the noise and few fits need.
    attenuated: Callable[[DiagnosisData], Mapping[Effect, np.ndarray]] | None = None
    held: frozenset[str] = frozenset()  # effects of the user's model, ``name@where``, whose values are kept
    #: Validation motions that cannot be compared, and why.
    skipped: tuple[tuple[str, str], ...] = ()
    settings: Settings = DEFAULT  # the thresholds

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self.experiment.robot

    @property
    def instants(self) -> bool:
        """Whether readings are taken for values at their times."""
        return any(s.instant for s in self.segments)

    @property
    def poses(self) -> bool:
        """Whether poses at rest were fitted, in which nothing follows in time."""
        return all(s.apart for s in self.segments)

    @property
    def offset_free(self) -> bool:
        """Whether a static run removes the sensor's constant offset."""
        return any(s.still for s in self.segments)

    @cached_property
    def attenuation(self) -> Mapping[Effect, np.ndarray]:
        """What encoders' errors are expected to add to the right side of the normal equations (k,), where the noise was made.

        By effects that make much more of these errors, and their values.
        """
        return {} if self.attenuated is None else self.attenuated(self)

    @cached_property
    def links(self) -> np.ndarray:
        """Nominal link parameters (10 b,); where nothing is known of them, bodies without a mass have that of usual ones."""
        unknown = self.experiment.inertia_rel_std is None
        return (filled_links(self.robot) if unknown else self.robot.nominal).ravel()

    @cached_property
    def travel(self) -> np.ndarray:
        """How far each joint moves over the fitted motions (n,) [rad or m]."""
        return np.ptp(np.vstack([s.trajectory.positions for s in self.segments]), axis=0)

    def fixed(self, term: Term) -> bool:
        """Whether the user's model keeps this effect's values."""
        return term.effect.spec in self.held

    def places(self, name: str) -> tuple[Effect, ...]:
        """Everywhere that an effect can be."""
        return self.experiment.library.places(name, self.robot.joint_names, self.channels.names, self.experiment.gear_ratio)

    def predict(self, segment: SpectralSegment, links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
        """Readings of a segment (M, c)."""
        return readings(self.robot, self.channels, segment.trajectory, links, active_terms(segment, terms))

    def link_columns(self, segment: SpectralSegment, terms: Sequence[Term]) -> np.ndarray:
        """Their derivatives with respect to the links, at the nominal ones (N, c, 10 b)."""
        return rigid_columns(self.robot, self.channels, segment.trajectory, self.links, active_terms(segment, terms))


def residual_rows(
    data: DiagnosisData, segments: Sequence[SpectralSegment], links: np.ndarray, offset: np.ndarray, terms: Sequence[Term]
):
    """Whitened rows of what was measured less what is predicted (rows,)."""
    out = []
    for s in segments:
        measured = s.measured_readings - s.measured_ones * offset
        with np.errstate(all="ignore"):  # a very compliant mount diverges; its fit is then refused
            out.append(s.whiten(measured - s.spectrum(data.predict(s, links, terms))).ravel())
    return np.concatenate(out)


def term_rows(
    data: DiagnosisData, segments: Sequence[SpectralSegment], links: np.ndarray, terms: Sequence[Term], term: Term,
    again: bool = False,
) -> np.ndarray:  # fmt: skip
    """Whitened derivatives of the readings with respect to a term's `fitted_values` beside other terms (rows, k).

    Say whether those at the same values will be asked for ``again``; where neither links nor the other terms have a part in them
    they are kept then.
    """
    parts = []
    for s in segments:
        if active_terms(s, [term]):
            parts.append(_white_columns(data, s, links, active_terms(s, terms), term, again))
        else:
            parts.append(np.zeros((s.shape[0] * s.shape[1], len(term.values))))
    return np.vstack(parts)[:, fitted_values(term)]


def _white_columns(
    data: DiagnosisData, segment: SpectralSegment, links: np.ndarray, terms: tuple[Term, ...], term: Term, again: bool
) -> np.ndarray:
    """Rows of one segment (rows, k); those of what the motion alone says are transformed once."""
    effect, channels = term.effect, {joint: channel for channel, joint in segment.torque_channels}
    if needs_no_load(effect) and effect.joint in channels:
        # What another joint's encoder or drive does is nothing to this joint's torque.
        reads, here = (EncoderEffect, JointDelayEffect, JointGainEffect), (None, effect.joint)
        beside = tuple(t for t in terms if t.effect.joint in here and isinstance(t.effect, reads))
        live = np.arange(len(data.channels)) == channels[effect.joint]

        def made() -> np.ndarray:
            model = Model.of(data.robot, data.channels, segment.trajectory, data.links, beside)
            with np.errstate(all="ignore"):  # as above
                return segment.spectrum(effect_derivatives_at_joint(model, effect, term.values)[:, None], live)

        key = effect, term.values if effect.shape else (), beside
        return segment.white_rows(live, segment.kept.get(key, made))

    def transformed() -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(all="ignore"):  # as above
            found = columns(data.robot, data.channels, segment.trajectory, links, terms, effect, term.values)
        return segment.live_spectrum(found)

    if (again or not effect.shape) and all(comes_on_top(t.effect) for t in (*terms, term)):
        # On top of what links make, and nothing is read otherwise than it is.
        return segment.white_rows(*segment.kept.get((effect, term.values if effect.shape else ()), transformed))
    return segment.white_rows(*transformed())


def model_rows(data: DiagnosisData, segments: Sequence[SpectralSegment], links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
    """Whitened derivatives with respect to all free parameters of a model's effects (rows, k)."""
    parts = [np.zeros((sum(s.shape[0] * s.shape[1] for s in segments), 0))]
    parts += [
        term_rows(data, segments, links, tuple(x for x in terms if x is not t), t) for t in terms if not data.fixed(t)
    ]  # fmt: skip
    return np.hstack(parts)
