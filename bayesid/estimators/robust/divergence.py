"""What keeps a robust fit from running away, and how it is noticed when it does.

Rows that disagree lose weight. Where they are the only ones that show a direction of the parameters (a joint that moves in one
part of the recording, and is modelled worst there), the others say nothing of it: the fit then follows their noise, the rows
disagree by even more, and the iteration has converged on nonsense. So the information that weights leave is compared with
that of all rows, ``min v'G_w v / v'G v`` over directions v, G the Gram matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from bayesid.estimators.estimator import strongest
from bayesid.estimators.factor import Factor, gram_rows
from bayesid.estimators.robust.segments import Residuals
from bayesid.regression.blocks import Block
from bayesid.regression.linalg import UNSEEN, column_lengths, correlations
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel

#: Rejected rows must leave this share of what all rows say of every direction; half of ordinary rows leave about half.
SMALLEST_SHARE = 0.02
#: With less than this share left by the weights, a direction follows the noise of a few rows.
_LOST = 1e-3
#: Errors above the signal itself, and so many times those of least squares, are no fit.
_WORSE = 3.0
#: The typical segment fits better than with least squares, or contamination is not why others have no weight.
_WORSE_MEDIAN = 2.0
#: Base parameters so many body sizes from the nominal ones, and so many times as far as those of least squares.
_IMPLAUSIBLE, _FURTHER = 100.0, 10.0
_COLLAPSED = 1e-3
_DETERMINED = 1e-10


@dataclass(frozen=True)
class Directions:
    """Directions of the parameters that all rows together determine."""

    basis: np.ndarray  # T (p, r), in which the unweighted factor is orthonormal

    @classmethod
    def of(cls, matrix: np.ndarray) -> Directions:
        """The directions of an unweighted factor (k, p)."""
        length = column_lengths(matrix)
        _, s, vt = np.linalg.svd(matrix / length, full_matrices=False)
        keep = s > UNSEEN * s[0]
        return cls((vt[keep] / s[keep, None]).T / length[:, None])

    def solve(self, factor: Factor, target: np.ndarray) -> np.ndarray:
        """Weighted least squares in these directions alone: weights take no part in the choice of the rank."""
        return self.basis @ np.linalg.lstsq(factor.matrix @ self.basis, target, rcond=1e-12)[0]

    def least(self, factor: Factor) -> tuple[float, np.ndarray]:
        """Smallest share of the information that the weights leave, and its direction in parameters (p,)."""
        _, s, vt = np.linalg.svd(factor.matrix @ self.basis)
        share = 0.0 if len(s) < self.basis.shape[1] else float(s[-1] ** 2)
        return share, self.basis @ vt[-1]


def informative(
    read: Callable[[], Iterable[Block]], residual: Residuals, accepted_rows: np.ndarray, noise: dict[str, NoiseModel]
) -> np.ndarray:
    """Accepted rows (N,), with those rejected windows that hold nearly all that is known of some direction.

    One window after the other is restored, the one that tells most of the least known direction for how unusual it is, until
    what is accepted leaves `SMALLEST_SHARE` of the information on every direction.
    """

    def scaled(block: Block) -> np.ndarray:
        return block.matrix / noise[block.group].std[:, None]

    whole = gram_rows(read(), scaled)
    length, values, vectors = correlations(whole, _DETERMINED)
    whiten = vectors / np.sqrt(values) / length[:, None]
    begins = ~accepted_rows & np.append(True, accepted_rows[:-1] | (residual.run[1:] != residual.run[:-1]))
    window = np.where(accepted_rows, -1, np.cumsum(begins) - 1)
    grams, power = np.zeros((int(begins.sum()), whiten.shape[1], whiten.shape[1])), np.zeros(int(begins.sum()))
    for block, own, rest in zip(read(), residual.split(window), residual.split(residual.values), strict=True):
        for k in np.unique(own[own >= 0]):
            rows = (scaled(block)[own == k] @ whiten).reshape(-1, whiten.shape[1])
            grams[k] += rows.T @ rows
            power[k] += np.sum((rest[own == k] / noise[block.group].std) ** 2)
    power /= np.bincount(window[window >= 0], minlength=len(power))
    left, restored = np.eye(whiten.shape[1]) - grams.sum(axis=0), np.zeros(len(power), bool)
    while not restored.all():
        shares, directions = np.linalg.eigh(left)
        if shares[0] >= SMALLEST_SHARE:
            break
        power_along = np.einsum("i,kij,j->k", directions[:, 0], grams, directions[:, 0]) / power
        best = int(np.argmax(np.where(restored, -np.inf, power_along)))
        restored[best] = True
        left = left + grams[best]
    return accepted_rows | np.append(restored, False)[window]


@dataclass(frozen=True)
class ResidualSizes:
    """Sizes of a fit's residuals: of the typical segment (squared, in units of the noise), and of all rows over the signal."""

    typical: float
    relative: float

    @classmethod
    def of(cls, residual: Residuals, q: np.ndarray, n: np.ndarray, blocks: Iterable[Block]) -> ResidualSizes:
        """Make it from residuals and lengths of all segments."""
        signal = sum((np.sum(b.target**2, axis=0) for b in blocks), np.zeros(residual.values.shape[1]))
        used = signal > 0
        error = np.sum(residual.values**2, axis=0)
        return cls(float(np.median(q / n)), float(np.sqrt(np.mean(error[used] / signal[used]))) if used.any() else 0.0)


def reasons(
    regression: Regression,
    share: float,
    direction: np.ndarray,
    scale: float,
    robust: ResidualSizes,
    plain: ResidualSizes,
    values: np.ndarray,
    least_squares: np.ndarray,
) -> tuple[str, ...]:
    """Why the fit cannot be right, in words; empty where nothing says so.

    ``share`` is the smallest share of the information that the weights left, in ``direction`` (p,); ``scale`` is that of the
    residuals, in units of the noise. ``plain`` and ``least_squares`` (p,) are residuals and solution of least squares with
    weights of channels alone, ``robust`` and ``values`` those of this fit.
    """
    out = []
    scales, sizes = regression.nominal_scale, np.ones(len(direction))
    if scales is not None:
        sizes[: len(scales)] = np.where(scales > 0, scales, np.inf)
    if share < _LOST:
        out.append(f"the weights leave {share:.1g} of the information on {strongest(regression, direction, sizes)}")
    if robust.relative > 1.0 and robust.relative > _WORSE * plain.relative:
        errors = (f"{100 * fit.relative:.3g} %" for fit in (robust, plain))
        out.append("its error is {} of the signal, that of least squares {}".format(*errors))
    if robust.typical > _WORSE_MEDIAN**2 * plain.typical:
        out.append("it fits most of the recording worse than least squares does")
    if scales is not None and regression.nominal is not None:
        rank = len(scales)
        away, usual = (np.abs(x[:rank] - regression.nominal) / sizes[:rank] for x in (values, least_squares))
        worst = int(np.argmax(away))
        if away[worst] > max(_IMPLAUSIBLE, _FURTHER * usual.max()):
            out.append(f"{regression.column_names[worst]} = {values[worst]:.3g} is no body's")
    if scale < _COLLAPSED:
        out.append(f"the scale of the residuals collapsed to {scale:.1g} of the noise")
    return tuple(out)
