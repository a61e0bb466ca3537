"""What rivals predict of a planned motion: whitened readings and derivatives under the noise of the recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.design.tell.evidence import Contest, Rows
from bayesid.design.tell.motions import Planned
from bayesid.design.tell.rivals import Case
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.encoders import pooled, with_noise
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.prepare import even_grid
from bayesid.diagnosis.projector import NuisanceProjector, offset_columns
from bayesid.diagnosis.rows import model_rows
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import MotionSegment

#: What a planned motion is called.
NAME = "next"


@dataclass(frozen=True, eq=False)
class Bench:
    """Instruments as the recordings show them.

    Attributes
    ----------
    data
        The recordings.
    like
        A moving segment of them: rates, bandwidth and noise are taken from it.
    noise
        Covariance of a sample by frequency, sensors' and what the encoders' errors do to predictions (K, c, c).
    """

    data: DiagnosisData
    like: Segment
    noise: np.ndarray

    @classmethod
    def of(cls, fitted: Fit) -> Bench:
        """The instruments of the recordings that a model was fitted to."""
        data = fitted.projector.data
        like = max((s for s in data.segments if not s.still), key=lambda s: len(s.times))
        # The share that grows with the readings themselves is made anew for another motion.
        signal = like.spectrum(data.predict(like, fitted.links, fitted.terms)) ** 2
        power = pooled(signal[:, :, None], data.settings.pooled_frequencies)[:, :, 0]
        noise = like.covariance.copy()
        at = np.arange(noise.shape[1])
        noise[:, at, at] = np.maximum(noise[:, at, at] - data.settings.accuracy**2 * power, 0.01 * noise[:, at, at])
        weight = like.weight(like.times)
        share = weight.T @ weight / len(weight)
        return cls(data, like, noise / np.where(share > 0, share, 1.0))

    @property
    def rate(self) -> float:
        """Samples a second."""
        return 1.0 / self.like.step

    def segment(self, motion: Planned, fitted: Fit) -> Segment:
        """A motion as it would be recorded, without readings; with the noise that a model makes of it."""
        data, like, old = self.data, self.like, self.like.scene
        times = np.arange(int(round(motion.duration / like.step)) + 1) * like.step
        per_second = (len(old.times) - 1) / (old.times[-1] - old.times[0])
        grid = times if like.instant else even_grid(times, per_second)
        scene = MotionSegment(grid, *motion.at(grid), False, old.bandwidth, old.middle_positions, old.clear, old.cell)
        empty = np.zeros((len(times), len(data.channels)))
        bare = Segment(
            NAME, "identification", times, motion.at(times)[0], empty, scene, False, like.torque_channels, np.zeros(0),
            like.instant, like.settings,
        )  # fmt: skip
        nearest = np.abs(bare.frequencies[:, None] - like.frequencies).argmin(axis=1)
        none, rng = np.zeros(data.robot.n), np.random.default_rng(0)  # encoders' errors are in the noise already
        return with_noise(
            bare, lambda s: data.predict(s, fitted.links, fitted.terms), lambda s, _: s, self.noise[nearest], none, none, rng
        )


def contest(case: Case, bench: Bench, motion: Planned) -> Contest:
    """What a motion would do to the evidence between the rivals of a case."""
    first = case.rivals[0].fit
    segment = bench.segment(motion, first)
    data, projector = first.projector.data, first.projector
    scale = 1.0 / np.sqrt(case.rivals[0].dispersion)
    common = scale * _common(projector, segment, first)
    own, predicted = [], []
    for rival in case.rivals:
        f = rival.fit
        own.append(scale * model_rows(data, [segment], f.links, f.terms))
        with np.errstate(all="ignore"):
            exact = segment.spectrum(data.predict(segment, f.links, f.terms)) + segment.measured_ones * f.offset
        predicted.append(scale * segment.whiten(exact).ravel())
    return Contest(case.rivals, Rows.of(common, own, predicted, segment.count), data.settings.rival)


def _common(projector: NuisanceProjector, segment: Segment, fitted: Fit) -> np.ndarray:
    """Whitened columns of links and offset of a planned segment, in the projector's coordinates (rows, size)."""
    parts = [np.zeros((segment.shape[0] * segment.shape[1], 0))]
    if projector.data.prior is not None:
        spectrum = segment.whiten(segment.spectrum(projector.data.link_columns(segment, fitted.terms)))
        parts.append(spectrum.reshape(-1, spectrum.shape[2]) @ projector.root)
    if projector.offset:
        parts.append(offset_columns(segment))
    return np.hstack(parts)
