"""What rivals predict of a planned motion: whitened readings and derivatives under the noise of the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.design.tell.evidence import Contest, PredictedRows
from bayesid.design.tell.motions import Planned
from bayesid.design.tell.rivals import Case, columns
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.encoders import pooled, with_noise
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.prepare import even_grid
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import MotionSegment

#: What a planned motion is called.
NAME = "next"


@dataclass(frozen=True, eq=False)
class SeenInstruments:
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
    def of(cls, fitted: Fit) -> SeenInstruments:
        """The instruments of the recordings that a model was fitted to."""
        data = fitted.projector.data
        like = max((s for s in data.segments if not s.still), key=lambda s: len(s.times))
        # The share that grows with the readings themselves is made anew for another motion.
        signal = like.spectrum(data.predict(like, fitted.links, fitted.terms)) ** 2
        power = pooled(signal[:, :, None], data.settings.neighbours // 2)[:, :, 0]
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


def contest(case: Case, bench: SeenInstruments, motion: Planned) -> Contest:
    """What a motion would do to the evidence between the rivals of a case."""
    return contest_on(case, [bench.segment(motion, case.rivals[0].fit)])


def contest_on(case: Case, segments: Sequence[Segment]) -> Contest:
    """What segments with known noise, whatever they read, do to the evidence between the rivals of a case."""
    first = case.rivals[0].fit
    data = first.projector.data
    scale = 1.0 / np.sqrt(case.rivals[0].dispersion)
    derivatives, predicted = [], []
    for rival in case.rivals:
        f = rival.fit
        derivatives.append(scale * columns(f, segments))
        with np.errstate(all="ignore"):
            exact = [s.spectrum(data.predict(s, f.links, f.terms)) + s.measured_ones * f.offset for s in segments]
        predicted.append(scale * np.concatenate([s.whiten(e).ravel() for s, e in zip(segments, exact, strict=True)]))
    rows = PredictedRows.of(derivatives, predicted, sum(s.count for s in segments))
    return Contest(case.rivals, rows, data.settings.rival)
