"""Where model and data disagree: in which channel, when, at which frequencies and with which joint's motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from bayesid.diagnosis.case import Case
from bayesid.diagnosis.spectra import Stretch

#: Level of significance over everything that was looked at.
LEVEL = 0.001
_WINDOW = 1.0  # [s]
#: Bands told apart [Hz].
BANDS = ((0.0, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0))
#: Disagreements listed, strongest first.
_LISTED = 8


@dataclass(frozen=True)
class Disagreement:
    """A channel and time in which the residual is larger than noise.

    Attributes
    ----------
    channel, motion
        Where.
    start, end
        When [s].
    band_hz
        The band with the largest excess there.
    joint
        The joint whose motion goes best with it, or None.
    ratio
        Root mean square over the noise's.
    p_value
        Probability of as much by chance in one of all places looked at.
    still
        Whether it is in the motion's run at rest.
    """

    channel: str
    motion: str
    start: float
    end: float
    band_hz: tuple[float, float]
    joint: str | None
    ratio: float
    p_value: float
    still: bool = False

    def to_dict(self) -> dict:
        """An entry of ``where``."""
        return {
            "channel": self.channel, "motion": self.motion, "start": self.start, "end": self.end, "joint": self.joint,
            "band_hz": list(self.band_hz), "times_noise": self.ratio, "p_value": self.p_value,
            "at_rest": self.still,
        }  # fmt: skip


def locate(case: Case, stretches: Sequence[Stretch], white: Sequence[np.ndarray], temper: float) -> tuple[Disagreement, ...]:
    """Channels and times with more residual than noise explains.

    Coefficients are white, so the energy of a window of a channel is close to chi-squared with as many degrees of
    freedom as coefficients fall to its share, whatever the colour of the noise was; Bonferroni's bound covers all
    windows looked at, which are then merged.

    Parameters
    ----------
    case
        What is compared.
    stretches, white
        Recordings and their whitened residuals (K, c).
    temper
        Mean square of what counts as noise.
    """
    looked = places_looked_at(stretches)
    found = []
    for s, w in zip(stretches, white, strict=True):
        edges, energy, freedom, p = by_window(s, w, temper, looked)
        for c in range(w.shape[1]):
            for first, last in _runs(p[:, c] < LEVEL):
                span = slice(edges[first], edges[last])
                ratio = float(np.sqrt(energy[first:last, c].sum() / (freedom * (last - first))))
                found.append(
                    Disagreement(
                        case.channels.names[c], s.motion, float(s.times[edges[first]]), float(s.times[edges[last] - 1]),
                        _band(s, w[:, c]), _joint(case, s, s.samples(w[:, c])[span], span), ratio, float(p[first:last, c].min()),
                        s.still,
                    )
                )  # fmt: skip
    return tuple(sorted(found, key=lambda d: -d.ratio * np.sqrt(d.end - d.start))[:_LISTED])


def places_looked_at(stretches: Sequence[Stretch]) -> int:
    """Windows of all channels."""
    return sum(_windows(s) * s.shape[1] for s in stretches)


def by_window(
    stretch: Stretch, white: np.ndarray, temper: float, looked: int
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Edges of the windows, in samples (w + 1,), energy over noise (w, c), its expectation, chance of as much in any (w, c)."""
    count = _windows(stretch)
    edges = np.linspace(0, len(stretch.times), count + 1).astype(int)
    energy = np.add.reduceat(stretch.samples(white) ** 2, edges[:-1], axis=0) / temper
    freedom = max(len(white) / count, 1.0)
    return edges, energy, freedom, np.minimum(chi2.sf(energy, freedom) * looked, 1.0)


def by_band(stretch: Stretch, white: np.ndarray) -> np.ndarray:
    """Root mean square of whitened coefficients in each of `BANDS` (b, c); nan where there are none."""
    out = np.full((len(BANDS), white.shape[1]), np.nan)
    for k, (low, high) in enumerate(BANDS):
        inside = (stretch.frequencies >= low) & (stretch.frequencies < high)
        if inside.any():
            out[k] = np.sqrt(np.mean(white[inside] ** 2, axis=0))
    return out


def _windows(stretch: Stretch) -> int:
    return max(int((stretch.times[-1] - stretch.times[0]) / _WINDOW), 1)


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Consecutive true entries as (first, one past the last); a gap of one window is bridged."""
    bridged = flags.copy()
    bridged[1:-1] |= flags[:-2] & flags[2:]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], bridged.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _band(stretch: Stretch, white: np.ndarray) -> tuple[float, float]:
    return BANDS[int(np.argmax(np.nan_to_num(by_band(stretch, white[:, None])[:, 0])))]


def _joint(case: Case, stretch: Stretch, residual: np.ndarray, span: slice) -> str | None:
    """The joint whose motion explains most of a residual by a few smooth functions of it, if that is half."""
    if len(residual) < 20:
        return None
    at = stretch.times[span]
    shares = []
    for j in range(case.robot.n):
        q, v, a = (
            np.interp(at, stretch.scene.times, part[:, j])
            for part in (stretch.scene.positions, stretch.scene.velocities, stretch.scene.accelerations)
        )
        if np.ptp(q) < 1e-3:
            shares.append(0.0)
            continue
        columns = np.stack([np.ones_like(q), q, q**2, np.cos(q), v, np.tanh(v / 0.05), np.abs(v) * v, a], axis=1)
        columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
        shares.append(1.0 - np.sum(left**2) / max(np.sum(residual**2), 1e-300))
    best = int(np.argmax(shares))
    return f"joint{best + 1}" if shares[best] > 0.5 else None
