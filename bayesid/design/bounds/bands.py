"""Readings of a trajectory with bands: pointwise, and such that the whole trajectory is inside at once.

A reading is ``y = c + A x + e`` with parameters x of mean x_hat and covariance V, and an error e of the model beyond its
parameters, of standard deviation r (`bayesid.design.bounds.remainder`): its standard deviation is ``s = sqrt(A V A' + r^2)``.
The pointwise band holds 95 % of the samples, those with ``|z| <= 1.96`` for ``z = (A (x - x_hat) + e) / s``. The simultaneous one
holds the whole trajectory and all its channels at once with probability 95 %: ``|z| <= c`` with c the 95 % quantile of
``max_t |z|`` over draws of x, each with a piece of the errors that were found in the recordings. How much further a motion goes
than those that were fitted is given by ``sqrt(A V A')`` over its largest value there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.design.bounds.model import ReadingModel, spread
from bayesid.design.bounds.region import left_out, quantile
from bayesid.design.bounds.remainder import Remainder
from bayesid.regression.linalg import or_one
from bayesid.rounding import HALF, LEVEL

#: Standard deviations over those of the fitted motions above this bring a warning.
FAR = 2.0
#: Samples that the factor is taken over, evenly picked of more, draws, and pairs of both worked on at once.
_SAMPLES, _DRAWS, _TOGETHER = 1500, 4000, 2_000_000


@dataclass(frozen=True, eq=False)
class Band:
    """Predicted readings of a trajectory, and their bands."""

    #: Of the channels (c,).
    names: tuple[str, ...]
    units: tuple[str, ...]
    times: np.ndarray  # (N,) [s]
    #: (N, c); ``std`` holds what is uncertain of the parameters and what the model lacks, once each.
    values: np.ndarray
    std: np.ndarray
    model_error: np.ndarray  # the part of ``std`` that no parameter explains (N, c)
    #: Half the simultaneous band over the standard deviation; the whole trajectory is inside with probability `LEVEL`.
    factor: float
    #: Largest standard deviation of each channel by the parameters over its largest in the motions that were fitted (c,).
    extrapolation: np.ndarray

    def __repr__(self) -> str:
        return f"<Band: {len(self.values)} samples of {', '.join(self.names)}, {self.factor:.3g} standard deviations wide>"

    @property
    def half_width(self) -> np.ndarray:
        """Half the simultaneous band, which holds all samples at once (N, c)."""
        return self.factor * self.std

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the simultaneous band (N, c)."""
        return self.values - self.half_width

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the simultaneous band (N, c)."""
        return self.values + self.half_width

    @property
    def pointwise_half_width(self) -> np.ndarray:
        """Half the pointwise band, which holds 95 % of the samples (N, c)."""
        return HALF * self.std

    @property
    def pointwise_low(self) -> np.ndarray:
        """Lower ends of the pointwise band (N, c)."""
        return self.values - self.pointwise_half_width

    @property
    def pointwise_high(self) -> np.ndarray:
        """Upper ends of the pointwise band (N, c)."""
        return self.values + self.pointwise_half_width

    @property
    def far(self) -> tuple[str, ...]:
        """Channels that this motion takes further than those that were fitted."""
        return tuple(name for name, x in zip(self.names, self.extrapolation, strict=True) if x > FAR)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in ``bounds.json``; the band itself is in ``bounds.mat``."""
        return {
            "channels": list(self.names), "units": list(self.units), "samples": len(self.values),
            "pointwise_factor": HALF, "simultaneous_factor": self.factor,
            "extrapolation": self.extrapolation.tolist(),
            "largest_value": np.abs(self.values).max(axis=0).tolist(),
            "mean_pointwise_half_width": self.pointwise_half_width.mean(axis=0).tolist(),
            "mean_simultaneous_half_width": self.half_width.mean(axis=0).tolist(),
            "largest_simultaneous_half_width": self.half_width.max(axis=0).tolist(),
        }  # fmt: skip


def band(
    model: ReadingModel,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    times: np.ndarray | None = None,
    trained: np.ndarray | None = None,
    left: Remainder | None = None,
    seed: int = 0,
) -> Band:
    """Readings of a trajectory (N, n) with their bands.

    Without ``times`` (N,) [s] samples count as far apart. ``trained`` is the largest standard deviation of each channel in the
    fitted motions (c,); what the model has ``left`` is in the bands where it is known.
    """
    region = model.region
    constant, matrix = model.columns(q, v, a)
    own = spread(matrix, region.covariance)
    error = np.zeros_like(own) if left is None else left.at(v)
    std = np.sqrt(own**2 + error**2)
    pick = np.unique(np.linspace(0, len(q) - 1, _SAMPLES).astype(int))
    away = region.deviations(seed)
    away = away[np.linspace(0, len(away) - 1, min(_DRAWS, len(away))).astype(int)]
    size = np.where(std > 0.0, std, np.inf)[pick]
    rows = (matrix[pick] / size[..., None]).transpose(1, 0, 2)  # (c, picked, k)
    # Without times samples count as far apart: then each has an error of its own.
    clock = np.full(len(pick), np.nan) if times is None else np.asarray(times, float)[pick]
    rng, largest = np.random.default_rng([seed, 29]), np.zeros(len(away))
    step = max(_TOGETHER // (len(pick) * len(rows)), 1)
    for first in range(0, len(away), step):
        part = slice(first, first + step)
        deviation = np.einsum("ctk,dk->dtc", rows, away[part], optimize=True)
        if region.draws is not None:  # each is as far from the others as a further one; errors of the model are no draws
            own_largest = np.abs(deviation).max(axis=(1, 2))
            deviation *= (left_out(own_largest, len(region.draws)) / or_one(own_largest, 0.0))[:, None, None]
        if left is not None and not left.complete:
            deviation += error[pick] / size * left.pieces(len(deviation), clock, rng)
        largest[part] = np.abs(deviation).max(axis=(1, 2))
    return Band(
        model.channels.names, model.channels.units, np.arange(len(q), dtype=float) if times is None else np.asarray(times, float),
        constant + matrix @ region.values, std, error, quantile(largest, LEVEL),
        np.full(std.shape[1], np.nan) if trained is None else own.max(axis=0) / np.maximum(trained, 1e-300),
    )  # fmt: skip
