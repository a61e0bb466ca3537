"""Periodic motions that start and end at rest: Fourier series, and the numbers that an optimiser changes.

    q_j(t) = c_j + sum_k  s_jk sin(k w t) + r_jk cos(k w t),   w = 2 pi / period                      [Swevers1997]_

They start and end without speed and acceleration where ``sum_k k s_jk = 0`` and ``sum_k k^2 r_jk = 0``: linear equalities,
which are solved once, so that every point of the optimiser's space holds them exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """A periodic joint motion."""

    period: float  # [s]
    centre: np.ndarray  # mean positions (n,) [rad or m]
    #: Coefficients s and r of each multiple of the fundamental frequency (K, n) [rad or m].
    sine: np.ndarray
    cosine: np.ndarray

    def __repr__(self) -> str:
        return f"<FourierSeries: {self.sine.shape[1]} joints, {self.harmonics} harmonics, period {self.period:g} s>"

    @property
    def harmonics(self) -> int:
        """Number of multiples of the fundamental frequency."""
        return len(self.sine)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations (N, n) at times (N,) [s]."""
        parts = trigonometric(times, self.period, self.harmonics)
        q, v, a = (s @ self.sine + r @ self.cosine for s, r in parts)
        return self.centre + q, v, a

    def scaled(self, factor: float | np.ndarray) -> FourierSeries:
        """The same motion with all amplitudes times a factor, one number or one a joint (n,)."""
        return replace(self, sine=factor * self.sine, cosine=factor * self.cosine)

    def extremes(self, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Bounds for all times on every joint's lowest and highest position, speed and acceleration, (n,) each.

        No trigonometric polynomial of degree K exceeds ``1 / cos(pi K / samples)`` times the largest of its magnitudes at so
        many even samples of a period [Ehlich1964]_; positions are taken from the middle of their range. More than 2 K samples
        are needed.
        """
        q, v, a = self.at(np.arange(samples) * (self.period / samples))
        guard = np.cos(np.pi * self.harmonics / samples)
        middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0) / guard
        return middle - half, middle + half, np.abs(v).max(axis=0) / guard, np.abs(a).max(axis=0) / guard


def trigonometric(times: np.ndarray, period: float, harmonics: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sines and cosines (N, K) of the multiples of the fundamental frequency, and their first two derivatives."""
    rate = 2.0 * np.pi / period * np.arange(1, harmonics + 1)
    s, c = np.sin(np.outer(times, rate)), np.cos(np.outer(times, rate))
    return [(s, c), (rate * c, -rate * s), (-(rate**2) * s, -(rate**2) * c)]


class Coordinates:
    """The ``count`` numbers that an optimiser changes: all of about one size, and every choice of them starts and ends at rest.

    Joints that are not ``moving`` stay at ``rest`` (n,). Half the range and the largest speed of each joint (n,) are the unit of
    its coordinates. ``times`` (N,) [s] are so many samples of one period.
    """

    def __init__(
        self, period: float, harmonics: int, moving: np.ndarray, rest: np.ndarray, reach: np.ndarray, speed: np.ndarray,
        samples: int,
    ):  # fmt: skip
        self.period, self.harmonics, self.moving, self.rest = period, harmonics, np.asarray(moving, int), np.asarray(rest, float)
        self.times = np.arange(samples) * (period / samples)
        k, rate = np.arange(1, harmonics + 1), 2.0 * np.pi / period
        # Coefficients of velocity shares: s = a / (k w), r = b / (k w); sum a = 0 and sum k b = 0.
        self._sine = null_space(np.ones((1, harmonics))) / (rate * k)[:, None]
        self._cosine = null_space(k[None].astype(float)) / (rate * k)[:, None]
        self._unit = np.minimum(speed, reach * rate * 0.5 * (harmonics + 1))[self.moving]
        self._reach = reach[self.moving]
        parts = trigonometric(self.times, period, harmonics)
        self._bases = [np.hstack([s @ self._sine, r @ self._cosine]) for s, r in parts]
        self._free = 2 * (harmonics - 1)
        self.count = len(self.moving) * (self._free + 1)

    def series(self, x: np.ndarray) -> FourierSeries:
        """The motion of these numbers."""
        x = x.reshape(self._free + 1, len(self.moving))
        half = self.harmonics - 1
        sine, cosine = np.zeros((2, self.harmonics, len(self.rest)))
        sine[:, self.moving] = self._sine @ (x[1 : half + 1] * self._unit)
        cosine[:, self.moving] = self._cosine @ (x[half + 1 :] * self._unit)
        centre = self.rest.copy()
        centre[self.moving] = x[0] * self._reach
        return FourierSeries(self.period, centre, sine, cosine)

    def numbers(self, series: FourierSeries) -> np.ndarray:
        """The numbers of a motion, or of the nearest that starts and ends at rest."""
        x = np.empty((self._free + 1, len(self.moving)))
        half = self.harmonics - 1
        x[0] = series.centre[self.moving] / self._reach
        x[1 : half + 1] = np.linalg.lstsq(self._sine, series.sine[:, self.moving], rcond=None)[0] / self._unit
        x[half + 1 :] = np.linalg.lstsq(self._cosine, series.cosine[:, self.moving], rcond=None)[0] / self._unit
        return x.ravel()

    def motion(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations (N, n) at `times`."""
        x = x.reshape(self._free + 1, len(self.moving))
        out = []
        for basis in self._bases:
            values = np.zeros((len(self.times), len(self.rest)))
            values[:, self.moving] = basis @ (x[1:] * self._unit)
            out.append(values)
        out[0] += self.rest
        out[0][:, self.moving] += x[0] * self._reach - self.rest[self.moving]
        return out[0], out[1], out[2]

    def gradient(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Derivatives with respect to the numbers, from those with respect to the motion (N, n) each."""
        out = np.empty((self._free + 1, len(self.moving)))
        out[0] = q[:, self.moving].sum(axis=0) * self._reach
        out[1:] = sum(basis.T @ part[:, self.moving] for basis, part in zip(self._bases, (q, v, a), strict=True)) * self._unit
        return out.ravel()

    def jacobian(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Derivatives of each of some samples' numbers, (rows, count), from those with respect to that sample's motion (N, n)."""
        out = np.empty((len(rows), self._free + 1, len(self.moving)))
        out[:, 0] = q[np.ix_(rows, self.moving)] * self._reach
        out[:, 1:] = sum(
            basis[rows][:, :, None] * part[np.ix_(rows, self.moving)][:, None, :]
            for basis, part in zip(self._bases, (q, v, a), strict=True)
        ) * self._unit  # fmt: skip
        return out.reshape(len(rows), -1)


def fitted_series(times: np.ndarray, positions: np.ndarray, period: float, harmonics: int) -> FourierSeries:
    """The series nearest to positions (N, n) at times (N,), by least squares; what is not periodic is averaged."""
    s, c = trigonometric(times - times[0], period, harmonics)[0]
    x = np.linalg.lstsq(np.hstack([np.ones((len(times), 1)), s, c]), positions, rcond=None)[0]
    return FourierSeries(period, x[0], x[1 : harmonics + 1], x[harmonics + 1 :])
