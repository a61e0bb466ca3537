"""Torque ripple: which number of periods fits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesid.diagnosis.data import DiagnosisData

#: Periods per radian or metre tried; slower ones than a gear's would pass for any error of weight.
PERIODS = np.concatenate([np.arange(4.0, 40.0, 0.4), np.geomspace(40.0, 200.0, 60)])


class RippleScan:
    """Spectra of sines and cosines of every joint's angle, made once."""

    def __init__(self, data: DiagnosisData):
        self.data = data
        self.at = data.segments[0].torque_channels
        self.spectra = []
        for s in data.segments:
            angle = s.scene.positions[:, [j for _, j in self.at]]
            wave = np.exp(1j * angle[:, :, None] * PERIODS)
            parts = [s.course(wave.real), s.course(wave.imag)]
            self.spectra.append(np.stack(parts, axis=-1).astype(np.float32))  # (K, joints, periods, 2)

    def best(self, left: np.ndarray) -> Iterator[tuple[int, float]]:
        """For every joint the periods whose sine and cosine explain most of a residual (rows,)."""
        if not self.at:
            return
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
        for row, (_, joint) in enumerate(self.at):
            yield joint, float(PERIODS[int(np.argmax(gain[row]))])
