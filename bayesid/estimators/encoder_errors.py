"""What encoder errors add to the covariance of an efficient fit.

Errors u of the positions make rows ``y = X b + e - U b``: they enter through the dynamics, so they come and go with the motion.
The weights of generalised least squares know noise by its mean spectrum alone, and they trust most what that calls quiet. So
with rows whitened by W, ``W'W = S^-1`` for the mean S of all noise, the fit ``A^-1 X' S^-1 y``, ``A = X' S^-1 X``, has not the
covariance A^-1 but

    A^-1 (X' S^-1 Sigma S^-1 X + cov(X' S^-1 U b)) A^-1,

Sigma the sensor's part of the noise (`bayesid.estimators.sensor_noise`) and U b simulated: the smooth motion once more with fresh
encoder noise. Fits weighted by channel do not trust quiet frequencies, and their intervals hold without this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

from bayesid.estimators.factor import gram_rows, on_columns, reduce_whitened
from bayesid.estimators.sensor_noise import sensor_noise
from bayesid.estimators.weights import Weights
from bayesid.regression.blocks import Block, RegressorNoise
from bayesid.regression.linalg import pseudo_inverse, solve, standard_deviations
from bayesid.regression.regression import Regression

#: Draws that tell whether encoder errors matter, and draws that their covariance is taken from.
_FEW, _MANY = 4, 40
#: Draws that the spectrum of encoder errors is averaged over.
SPECTRA = 16
#: Share of a parameter's variance that is left out. Of few draws, the largest share of many parameters is overstated.
_NEGLIGIBLE = 0.1


@dataclass(frozen=True)
class _Draws:
    """Errors that the encoders make in the rows of a recording, or of pieces of it.

    ``errors[d][k]`` (rows, channels) belongs to draw d and ``blocks[k]``; each block stands for ``share`` as many rows.
    """

    blocks: Sequence[Block]
    errors: Sequence[Sequence[np.ndarray]]
    share: Sequence[float]

    @classmethod
    def of(cls, regression: Regression, law: RegressorNoise, values: np.ndarray, count: int) -> _Draws:
        """Simulate ``(X - X*) b``."""
        blocks = list(law.pieces(None))
        errors = [[(b.matrix - p.matrix) @ values for b, p in zip(blocks, law.pieces(d), strict=True)] for d in range(count)]
        moving = sum(len(b.rows) for b in blocks if b.group != "poses")
        poses = sum(len(b.rows) for b in blocks if b.group == "poses")
        more = (regression.row_count - poses) / max(moving, 1)
        return cls(blocks, errors, [1.0 if b.group == "poses" else more for b in blocks])

    def covariance(self, weights: Weights) -> np.ndarray:
        """Covariance of ``X' S^-1 U b`` (p, p)."""
        sums = 0.0
        for k, block in enumerate(self.blocks):
            p = block.matrix.shape[2]
            both = np.concatenate([block.matrix, np.stack([e[k] for e in self.errors], axis=2)], axis=2)
            white = weights.noise[block.group].whiten(both).reshape(-1, both.shape[2])
            sums = sums + np.sqrt(self.share[k]) * (white[:, p:].T @ white[:, :p])
        return covariance_of_sums(np.asarray(sums))


def covariance_of_sums(sums: np.ndarray) -> np.ndarray:
    """Covariance of simulated sums (draws, p), whose mean is known to be zero no better than their own mean says.

    A variance from few draws is uncertain: Student's quantile stands for the normal one.
    """
    count, p = sums.shape
    wider = (t.ppf(0.975, count - 1) / norm.ppf(0.975)) ** 2 if count > 1 else 1.0
    return wider * np.cov(sums.T, ddof=min(count - 1, 1)).reshape(p, p)


def efficient_middle(regression: Regression, weights: Weights) -> np.ndarray | None:
    """``X' S^-1 (Sigma + cov(U b)) S^-1 X`` of rows whitened by their noise (p, p); None where it is ``X' S^-1 X``.

    None also where nothing is known of the regressor's errors, or where they add next to nothing.
    """
    return regression.once("efficient_middle", lambda: _middle(regression, weights))


def _middle(regression: Regression, weights: Weights) -> np.ndarray | None:
    law = regression.regressor_noise
    if law is None or not law.present():
        return None
    pilot = regression.pilot()
    factor = reduce_whitened(pilot, weights.noise)
    values = solve(factor.matrix, factor.target)
    taken = pseudo_inverse(factor.matrix)
    few = _Draws.of(regression, law, values, min(_FEW, law.draws or _FEW))
    inverse = taken @ taken.T / (regression.row_count / max(sum(len(b.rows) for b in pilot), 1))  # A^-1 of all rows
    added = standard_deviations(inverse @ few.covariance(weights) @ inverse)
    if np.all(added**2 <= _NEGLIGIBLE * np.diag(inverse)):
        return None
    draws = _Draws.of(regression, law, values, min(_MANY, law.draws or _MANY))
    sensor = {}
    for group, noise in weights.noise.items():
        own = [b for b in pilot if b.group == group]
        at = [k for k, b in enumerate(draws.blocks) if b.group == group]
        if regression.noise_std is not None or not own or not at:
            sensor[group] = noise
            continue
        sensor[group] = sensor_noise(
            [b.target - b.matrix @ values for b in own],
            [[errors[k] for k in at] for errors in draws.errors[:SPECTRA]],
            [on_columns(b.matrix, taken) for b in own],
            regression.known_poles if group == "trajectory" else None,
            coloured=group != "poses",
        )

    def coloured(block: Block) -> np.ndarray:
        noise = weights.noise[block.group]
        return sensor[block.group].colour_transposed(noise.whiten_transposed(noise.whiten(block.matrix)))

    return gram_rows(regression.blocks(), coloured) + draws.covariance(weights)
