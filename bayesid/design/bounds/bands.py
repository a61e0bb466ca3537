"""Readings of a trajectory with bands: pointwise, and such that the whole trajectory is inside at once.

A reading is ``y = c + A x`` with parameters x of mean x_hat and covariance V, so its standard deviation is
``s = sqrt(A V A')``. Pointwise, 95 % of x have ``|z| <= 1.96`` with ``z = A (x - x_hat) / s``; for the whole trajectory and all
its channels at once, ``|z| <= c`` with c the 95 % quantile of ``max_t |z|``. How much further a motion goes than those that
were fitted is told by ``s`` over its largest value there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesid.design.bounds.model import ReadingModel
from bayesid.design.bounds.simultaneous import largest_deviation, left_out, quantile
from bayesid.estimators.estimator import LEVEL

#: Standard deviations over those of the fitted motions above this are told.
FAR = 2.0
#: Samples that the factor is taken over, evenly picked of more, and draws.
_SAMPLES, _DRAWS = 1500, 4000


@dataclass(frozen=True, eq=False)
class Band:
    """Predicted readings of a trajectory, and their bands.

    Attributes
    ----------
    names, units
        Of the channels (c,).
    times
        (N,) [s].
    values, std
        (N, c).
    factor
        Half the simultaneous band over the standard deviation; the whole trajectory is inside with probability `LEVEL`.
    extrapolation
        Largest standard deviation of each channel over its largest in the motions that were fitted (c,).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    times: np.ndarray
    values: np.ndarray
    std: np.ndarray
    factor: float
    extrapolation: np.ndarray

    def __repr__(self) -> str:
        return f"<Band: {len(self.values)} samples of {', '.join(self.names)}, {self.factor:.3g} standard deviations wide>"

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the simultaneous band (N, c)."""
        return self.values - self.factor * self.std

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the simultaneous band (N, c)."""
        return self.values + self.factor * self.std

    @property
    def pointwise_low(self) -> np.ndarray:
        """Lower ends of the band that holds 95 % sample by sample (N, c)."""
        return self.values - norm.ppf(0.5 + LEVEL / 2) * self.std

    @property
    def pointwise_high(self) -> np.ndarray:
        """Upper ends of the band that holds 95 % sample by sample (N, c)."""
        return self.values + norm.ppf(0.5 + LEVEL / 2) * self.std

    @property
    def far(self) -> tuple[str, ...]:
        """Channels that this motion takes further than those that were fitted."""
        return tuple(name for name, x in zip(self.names, self.extrapolation, strict=True) if x > FAR)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``; the band itself is in ``bounds.mat``."""
        return {
            "channels": list(self.names), "units": list(self.units), "samples": len(self.values),
            "simultaneous_factor": self.factor, "extrapolation": self.extrapolation.tolist(),
            "largest_value": np.abs(self.values).max(axis=0).tolist(), "largest_half_width": (
                self.factor * self.std.max(axis=0)).tolist(),
        }  # fmt: skip


def band(
    model: ReadingModel, q: np.ndarray, v: np.ndarray, a: np.ndarray, times: np.ndarray | None = None,
    trained: np.ndarray | None = None, seed: int = 0,
) -> Band:
    """Readings of a trajectory with their bands.

    Parameters
    ----------
    model
        What is read.
    q, v, a
        Joint positions, velocities and accelerations (N, n).
    times
        (N,) [s]; default the number of the sample.
    trained
        Largest standard deviation of each channel in the fitted motions (c,).
    seed
        Of the draws of a normal law.
    """
    region = model.region
    constant, matrix = model.columns(q, v, a)
    std = spread(matrix, region.covariance)
    pick = np.unique(np.linspace(0, len(q) - 1, _SAMPLES).astype(int))
    away = region.deviations(seed)
    away = away[np.linspace(0, len(away) - 1, min(_DRAWS, len(away))).astype(int)]
    largest = largest_deviation(matrix[pick].reshape(-1, matrix.shape[2]), std[pick].ravel(), away)
    if region.draws is not None:
        largest = left_out(largest, len(region.draws))
    return Band(
        model.channels.names, model.channels.units, np.arange(len(q), dtype=float) if times is None else np.asarray(times, float),
        constant + matrix @ region.values, std, quantile(largest, LEVEL),
        np.full(std.shape[1], np.nan) if trained is None else std.max(axis=0) / np.maximum(trained, 1e-300),
    )  # fmt: skip


def spread(matrix: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations of ``matrix @ parameters`` (N, c)."""
    return np.sqrt(np.maximum(np.sum((matrix @ covariance) * matrix, axis=2), 0.0))
