"""What a diagnosis looks at: segments of recordings with their noise, the nominal links and their prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesid.diagnosis.noise_spectrum import Spectrum
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.diagnosis.spectra import Segment
from bayesid.dynamics.channels import Channels
from bayesid.effects import Effect, Term, readings, rigid_columns
from bayesid.recordings.experiment import Experiment
from bayesid.robot.prior import Prior
from bayesid.robot.robot import Robot

#: The source of a floor that is measured where nothing moves a sensor: above the motion.
WHITE = "white noise above the band"


@dataclass(frozen=True)
class Episode(Term):
    """An effect that happened once, in one recording."""

    motion: str = ""  # in which; nothing is known of others


def active_terms(segment: Segment, terms: Sequence[Term]) -> tuple[Term, ...]:
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
    segments: tuple[Segment, ...]  # of the identification motions, with their noise
    unseen: tuple[Segment, ...]  # of the validation motions, with their noise
    prior: Prior | None  # of the links; None where they are exact
    terms: tuple[Term, ...]  # effects of the user's model at their starting values
    #: Whether the noise was measured. Where readings were filtered before they were recorded it cannot be, and what the richest
    #: model leaves stands in for it.
    floor_known: bool = True
    #: Where the noise of moving readings comes from: ``white noise above the band``, ``repeats``, ``parked``, ``stated`` or
    #: ``richest model``.
    floor_source: str = WHITE
    spectrum: Spectrum | None = None  # the noise of moving readings where it was measured by frequency, on repeats or at rest
    held: frozenset[str] = frozenset()  # effects of the user's model, ``name@where``, whose values are kept
    skipped: tuple[str, ...] = ()  # validation motions that cannot be compared
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
    def offset_free(self) -> bool:
        """Whether a static run removes the sensor's constant offset."""
        return any(s.still for s in self.segments)

    @cached_property
    def links(self) -> np.ndarray:
        """Nominal link parameters (10 b,)."""
        return self.robot.nominal.ravel()

    def fixed(self, term: Term) -> bool:
        """Whether the user's model keeps this effect's values."""
        return term.effect.spec in self.held

    def places(self, name: str) -> tuple[Effect, ...]:
        """Everywhere that an effect can be."""
        return self.experiment.library.places(name, self.robot.joint_names, self.channels.names, self.experiment.gear_ratio)

    def predict(self, segment: Segment, links: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
        """Readings of a segment (M, c)."""
        return readings(self.robot, self.channels, segment.scene, links, active_terms(segment, terms))

    def link_columns(self, segment: Segment, terms: Sequence[Term]) -> np.ndarray:
        """Their derivatives with respect to the links, at the nominal ones (N, c, 10 b)."""
        return rigid_columns(self.robot, self.channels, segment.scene, self.links, active_terms(segment, terms))
