"""What a mount that gives makes of the readings of a planned motion.

The joints' own frequencies stay below a fifth of the resonance f_n, but products of joint motions in the wrench reach higher. A
mount with little damping d enlarges a component at f by ``H = 1 / (1 - (f / f_n)^2 + 2 i d f / f_n)``.
"""

from __future__ import annotations

import numpy as np

from bayesid.design.excitation.options import BELOW_RESONANCE

#: Damping ratio where none is known; it matters near the resonance only.
_DAMPING = 0.02


def mount_response(readings: np.ndarray, period: float, resonance: float) -> tuple[float, float]:
    """Share of the readings above a fifth of the resonance, and by how much the mount changes all of them.

    Parameters
    ----------
    readings
        One period, evenly sampled (N, c), all in one unit.
    period, resonance
        [s], [Hz].

    Returns
    -------
    above, change
        Root mean squares over that of the readings about their mean.
    """
    spectrum = np.fft.rfft(readings - readings.mean(axis=0), axis=0)
    frequency = np.fft.rfftfreq(len(readings), period / len(readings))
    power = np.sum(np.abs(spectrum) ** 2, axis=1)
    ratio = frequency / resonance
    response = 1.0 / (1.0 - ratio**2 + 2j * _DAMPING * ratio)
    total = max(float(power.sum()), 1e-300)
    above = float(power[frequency > resonance / BELOW_RESONANCE].sum()) / total
    return float(np.sqrt(above)), float(np.sqrt(np.sum(np.abs(response - 1.0) ** 2 * power) / total))
