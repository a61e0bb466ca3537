"""Effects that are a sine of their joint's position: which number of periods fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.spectra import Segment
from bayesid.effects import Effect


class RippleScan:
    """Spectra of sines and cosines of the joints' positions, made once.

    Parameters
    ----------
    data
        The recordings.
    effects
        One a joint, with the same `Effect.harmonics`, in the order of the joints whose torques are compared.
    """

    def __init__(self, data: DiagnosisData, effects: Sequence[Effect]):
        self.data, self.effects = data, tuple(effects)
        self.orders = np.array(effects[0].harmonics)
        channel_of = {joint: channel for channel, joint in data.segments[0].torque_channels}
        self.at = [(channel_of[e.joint], e.joint) for e in self.effects if e.joint is not None]
        self.spectra = [s.scene.basis.get(self._key(s), lambda s=s: self._waves(s)) for s in data.segments]

    def _key(self, segment: Segment) -> tuple:
        """What the coefficients of one segment depend on, whatever its noise."""
        joints, times = tuple(joint for _, joint in self.at), segment.times
        return "waves", tuple(self.orders), joints, len(segment.frequencies), len(times), times[0], times[-1], segment.settings

    def _waves(self, segment: Segment) -> np.ndarray:
        """Coefficients of the sines and cosines (K, joints, orders, 2)."""
        angle = segment.scene.positions[:, [j for _, j in self.at], None] * self.orders
        parts = [segment.course(np.cos(angle)), segment.course(np.sin(angle))]
        return np.stack(parts, axis=-1).astype(np.float32)

    @classmethod
    def of(cls, data: DiagnosisData, effects: Sequence[Effect]) -> tuple[RippleScan, ...]:
        """One scan for each class of effects."""
        kinds = dict.fromkeys(type(e) for e in effects)
        return tuple(cls(data, [e for e in effects if type(e) is kind]) for kind in kinds)

    def best(self, left: np.ndarray) -> Iterator[tuple[Effect, float]]:
        """For every effect the number of periods whose sine and cosine explain most of a residual (rows,)."""
        score, gram = np.zeros(1), np.zeros(1)
        at = 0
        for s, spectrum in zip(self.data.segments, self.spectra, strict=True):
            count = s.shape[0] * s.shape[1]
            mine, at = left[at : at + count].reshape(s.shape), at + count
            pulled = np.einsum("kdc,kd->kc", s.whitener, mine)
            power = np.einsum("kdc,kdc->kc", s.whitener, s.whitener)
            own = [c for c, _ in self.at]
            score = score + np.einsum("kjpa,kj->jpa", spectrum, pulled[:, own], optimize=True)
            gram = gram + np.einsum("kjpa,kjpb,kj->jpab", spectrum, spectrum, power[:, own], optimize=True)
        gram = gram + 1e-9 * np.eye(2)
        gain = np.einsum("jpa,jpa->jp", score, np.linalg.solve(gram, score[..., None])[..., 0])
        for row, effect in enumerate(self.effects):
            yield effect, float(self.orders[int(np.argmax(gain[row]))])
