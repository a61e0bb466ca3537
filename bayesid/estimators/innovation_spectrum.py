"""The cross-spectrum of whitened rows: the colour of the noise that recursions, one a channel, leave.

Rows whitened by a recursion a channel (`bayesid.signals.noise`) should have noise of unit covariance at every frequency. The
recursion is fitted to the whole band, though, and the motion is in its lowest part: where little noise from the sensor meets
much from the encoders, whose accelerations grow with the square of the frequency, a short recursion follows the
high frequencies and misses the low ones by half and more; and encoder errors reach all channels together, so that innovations are
correlated at high frequencies and not at low ones. Intervals from ``(X' Sigma^-1 X)^-1`` alone are then too short, by up to
two in the standard deviation. So the covariance S(f) of the whitened residuals u is taken octave by octave of the orthonormal
cosine transform of each recording,

    S_b = 1/n_b sum_{f in b} (u_f u_f' + X_f V X_f'),

V the covariance of the fit, which gives back what it took from the residuals, and the covariance of any linear fit is the
sandwich of ``sum_b sum_{f in b} Z_f' S_b Z_f`` with Z its rows in units of these innovations: the estimator of [White1980]_
with the noise stationary within a band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from bayesid.estimators.factor import whitened
from bayesid.estimators.weights import Weights, pilot_of
from bayesid.regression.linalg import UNSEEN, pseudo_inverse, solve
from bayesid.regression.regression import Regression

#: Coefficients in the lowest octave, at least: a variance from so many is sure to 22 %, a standard deviation to 11 %.
LEAST = 40
_PASSES = 2


@dataclass(frozen=True)
class InnovationSpectrum:
    """Covariance of whitened noise by octave."""

    #: Upper edges of the bands as shares of the highest frequency, rising (b,); one band where rows are not consecutive.
    edges: np.ndarray
    covariance: np.ndarray  # of the channels' innovations in each band (b, c, c); the identity where whitening is right

    def gram(self, group: str, rows: np.ndarray) -> np.ndarray:
        """``sum_b sum_{f in b} Z_f' S_b Z_f`` of consecutive rows Z in units of the innovations (k, c, p) -> (p, p)."""
        total = np.zeros((rows.shape[2], rows.shape[2]))
        for part, covariance in zip(_bands(_coefficients(group, rows), self.edges), self.covariance, strict=True):
            flat = part.reshape(-1, part.shape[2])
            total += flat.T @ np.matmul(covariance, part).reshape(flat.shape)
        return total


def innovation_spectra(regression: Regression, weights: Weights) -> dict[str, InnovationSpectrum]:
    """The spectrum of each group of rows, from a pilot of them whitened with the noise of the weights; found once."""
    return regression.rows.derived("innovation_spectra", lambda: _found(regression, weights))


def whitened_middle(regression: Regression, weights: Weights) -> np.ndarray:
    """Covariance of the right side of the equations of whitened rows, ``X' W' W Sigma W' W X`` (p, p)."""
    spectra = innovation_spectra(regression, weights)
    parts = whitened(regression.blocks(), weights.noise)
    return np.sum([spectra[b.group].gram(b.group, white[:, :, :-1]) for b, white in parts], axis=0)


def _found(regression: Regression, weights: Weights) -> dict[str, InnovationSpectrum]:
    factor = pilot_of(regression).whitened(weights.noise)
    solution, inverse = solve(factor.matrix, factor.target), pseudo_inverse(factor.matrix, UNSEEN)
    bread = inverse @ inverse.T
    groups: dict[str, list[np.ndarray]] = {}
    for block, white in whitened(regression.pilot(), weights.noise):
        groups.setdefault(block.group, []).append(white)
    covariance, out = bread, {}
    for _ in range(_PASSES):
        out = {group: _estimated(group, parts, solution, covariance) for group, parts in groups.items()}
        middle = sum(out[group].gram(group, part[:, :, :-1]) for group, parts in groups.items() for part in parts)
        covariance = bread @ middle @ bread
    return out


def _estimated(group: str, parts: Sequence[np.ndarray], solution: np.ndarray, covariance: np.ndarray) -> InnovationSpectrum:
    """The spectrum of whitened rows [X y] (k, c, p + 1) of recordings, with a fit (p,) and its covariance (p, p)."""
    count = sum(map(len, parts))
    octaves = int(np.log2(max(count / LEAST, 1.0))) if group == "trajectory" else 0
    edges = 2.0 ** -np.arange(octaves, -1, -1)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # One more column a parameter: what the fit took, beside the residual.
    taken = np.column_stack([np.append(-solution, 1.0), np.vstack([root, np.zeros((1, len(root)))])])
    channels = parts[0].shape[1]
    power, rows = np.zeros((len(edges), channels, channels)), np.zeros(len(edges))
    for part in parts:
        for k, band in enumerate(_bands(_coefficients(group, part @ taken), edges)):
            power[k] += np.einsum("kcj,kdj->cd", band, band)
            rows[k] += len(band)
    return InnovationSpectrum(edges, power / np.maximum(rows, 1.0)[:, None, None])


def _coefficients(group: str, rows: np.ndarray) -> np.ndarray:
    """Orthonormal cosine coefficients of consecutive rows along time; poses are in no order and stay as they are."""
    return np.asarray(dct(rows, axis=0, norm="ortho")) if group == "trajectory" else rows


def _bands(coefficients: np.ndarray, edges: np.ndarray) -> list[np.ndarray]:
    """Parts of the coefficients (k, ...) between edges that are shares of the highest frequency."""
    cuts = np.ceil(edges[:-1] * len(coefficients)).astype(int)
    return np.split(coefficients, cuts)
