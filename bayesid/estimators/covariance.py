"""The covariance of a weighted fit: a sandwich with what is known of the noise of its equations' right side.

With rows weighted by W and ``A = X' W'W X``, the fit is ``A^-1 X' W'W y`` and its covariance ``A^-1 M A^-1``, M the covariance
of the right side: ``X' W'W Sigma W'W X`` for noise of covariance Sigma (`sandwich_middle`). Two things are more than that.

**What whitening leaves.** Rows whitened by a recursion a channel (`bayesid.signals.noise`) should have noise of unit covariance
at every frequency. The recursion is fitted to the whole band, though, and the motion is in its lowest part: where little noise
from the sensor meets much from the encoders, whose accelerations grow with the square of the frequency, a short recursion
follows the high frequencies and misses the low ones by half and more; and encoder errors reach all channels together, so that
innovations are correlated at high frequencies and not at low ones. Intervals from ``(X' Sigma^-1 X)^-1`` alone are then too
short, by up to two in the standard deviation. So the covariance S(f) of the whitened residuals u is taken octave by octave of
the orthonormal cosine transform of each recording,

    S_b = s_b 1/n_b sum_{f in b} (u_f u_f' + X_f V X_f'),

V the covariance of the fit, which gives back what it took from the residuals, s_b `student_factor`, and M is
``sum_b sum_{f in b} Z_f' S_b Z_f``, Z the rows in units of these innovations: that of [White1980]_, stationary within a band.

**Encoder errors.** Errors u of the positions make rows ``y = X b + e - U b``: they enter through the dynamics, so they come and
go with the motion. The noise that is learned from residuals knows their mean spectrum alone. And they are in the regressor
``X = X0 + U`` of the very same rows, so that a fit that takes it for exact is attenuated. The mean square error is that with

    M = X' W'W Sigma W'W X + cov(X0' W'W U b) + m m',    m = E[U' W'W U b],

Sigma the sensor's part of the noise (`bayesid.estimators.sensor_noise`) and U simulated: the smooth motion once more with fresh
encoder errors, rounded to counts where their size is known. ``-A^-1 m`` is the bias [Fuller1987]_: an interval about a biased
estimate has to be as much wider. Where all that changes no variance by more than a tenth, the covariance of noise alone stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.fft import dct

from bayesid.estimators.dispersion import Dispersion
from bayesid.estimators.factor import Factor, gram_of, pilot_of, reduce_whitened, regressor_times, whitened
from bayesid.estimators.sensor_noise import sensor_noise
from bayesid.estimators.weights import Weights, stated_noise
from bayesid.regression.blocks import Block, RegressorNoise
from bayesid.regression.linalg import pseudo_inverse, solve
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel, memoryless, student_factor

#: Coefficients in the lowest octave, at least: a variance from so many is sure to 22 %, a standard deviation to 11 %.
LEAST = 40
_PASSES = 2
#: Draws that tell whether encoder errors matter, and draws that their covariance is taken from.
_FEW, _MANY = 4, 40
#: Draws that an expected error is taken from: to a fifth of it where errors come and go with the motion.
_EXPECTED = 12
#: Draws that the spectrum of encoder errors is averaged over.
SPECTRA = 16
#: Share of a parameter's variance that is left out. Of few draws, the largest share of many parameters is overstated.
_NEGLIGIBLE = 0.1


class Middle(NamedTuple):
    """Covariance of the weighted equations' right side."""

    matrix: np.ndarray | None  # (p, p); None where it is the equations' matrix
    dispersion: float  # factor in it for the scatter between parts of the recording beyond what noise alone makes


def covariance_middle(regression: Regression, weights: Weights, scale: dict[str, np.ndarray] | None, factor: Factor) -> Middle:
    """Covariance of the weighted equations' right side.

    ``scale`` is what each channel (c,) of a group of rows was weighted with; None: rows were whitened.
    """
    if scale is not None and not may_matter(regression, weights):
        return Middle(sandwich_middle(regression, weights.dispersed(), scale), weights.dispersion)
    if scale is None and weights.by_noise:  # encoder errors are in the noise that rows were whitened with
        wider = weights.efficient.factor
        return Middle(wider * factor.matrix.T @ factor.matrix, wider)
    exact = scale is None and regression.noise_std is not None  # whitened with noise that is known
    if exact:
        middle = factor.matrix.T @ factor.matrix
    else:
        middle = whitened_middle(regression, weights) if scale is None else sandwich_middle(regression, weights.unsure(), scale)
    corrected = with_encoder_errors(regression, weights, scale, factor.inverse, middle)
    if exact:
        return Middle(corrected, 1.0)
    # A complete model's dispersion is the same for all channels.
    wider = weights.dispersion if scale is not None else _scattered(factor, middle, weights.efficient)
    return Middle(wider * (middle if corrected is None else corrected), wider)


def _scattered(factor: Factor, middle: np.ndarray, efficient: Dispersion) -> float:
    """Factor by which an efficient fit scatters more between parts than the spectrum of its whitened rows says; one at least.

    The dispersion is relative to rows R that are white, ``trace(R^-T R'R R^-1)``, the spectrum's M likewise: what both see
    counts once.
    """
    inverse = factor.inverse
    spread = float(np.vdot(inverse, middle @ inverse)) / float(np.sum((factor.matrix @ inverse) ** 2) or 1.0)
    return max(efficient.found / spread, 1.0) if spread > 0.0 else 1.0


def sandwich_middle(regression: Regression, noise: dict[str, NoiseModel], scale: dict[str, np.ndarray]) -> np.ndarray:
    """Sum of ``X' W'W S W'W X`` over all blocks (p, p), S the mean covariance of the noise.

    Blocks are long against the noise's memory; its correlation across their borders is left out.
    """

    def colour(block: Block) -> np.ndarray:
        return noise[block.group].colour_transposed(block.matrix * scale[block.group].reshape(-1, 1) ** 2)

    return regression.rows.total(gram_of(colour, row_by_row=memoryless(noise)), np.add)


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
    parts = whitened(regression.rows.blocks(), weights.noise)
    return np.sum([spectra[b.group].gram(b.group, white[:, :, :-1]) for b, white in parts], axis=0)


def _found(regression: Regression, weights: Weights) -> dict[str, InnovationSpectrum]:
    factor = pilot_of(regression.rows).whitened(weights.noise)
    solution, bread = solve(factor.matrix, factor.target), factor.inverse @ factor.inverse.T
    groups: dict[str, list[np.ndarray]] = {}
    for block, white in whitened(regression.rows.pilot(), weights.noise):
        groups.setdefault(block.group, []).append(white)
    covariance, out = bread, {}
    for _ in range(_PASSES):
        out = {group: _estimated(weights.noise[group], group, parts, solution, covariance) for group, parts in groups.items()}
        middle = sum(out[group].gram(group, part[:, :, :-1]) for group, parts in groups.items() for part in parts)
        covariance = bread @ middle @ bread
    return out


def _estimated(
    noise: NoiseModel, group: str, parts: Sequence[np.ndarray], solution: np.ndarray, covariance: np.ndarray
) -> InnovationSpectrum:
    """The spectrum of whitened rows [X y] (k, c, p + 1) of recordings, with a fit (p,) and its covariance (p, p).

    Poses have no colour that whitening could leave; how large their noise is, these few tell best together, as ``noise`` has it.
    """
    channels = parts[0].shape[1]
    if group != "trajectory":
        return InnovationSpectrum(np.ones(1), student_factor(noise.degrees) * np.eye(channels)[None])
    octaves = int(np.log2(max(sum(map(len, parts)) / LEAST, 1.0)))
    edges = 2.0 ** -np.arange(octaves, -1, -1)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # One more column a parameter: what the fit took, beside the residual.
    taken = np.column_stack([np.append(-solution, 1.0), np.vstack([root, np.zeros((1, len(root)))])])
    power, rows = np.zeros((len(edges), channels, channels)), np.zeros(len(edges))
    for part in parts:
        for k, band in enumerate(_bands(_coefficients(group, part @ taken), edges)):
            power[k] += np.einsum("kcj,kdj->cd", band, band)
            rows[k] += len(band)
    rows = np.maximum(rows, 1.0)
    return InnovationSpectrum(edges, power * (student_factor(rows) / rows)[:, None, None])


def _coefficients(group: str, rows: np.ndarray) -> np.ndarray:
    """Orthonormal cosine coefficients of consecutive rows along time; poses are in no order and stay as they are."""
    return np.asarray(dct(rows, axis=0, norm="ortho")) if group == "trajectory" else rows


def _bands(coefficients: np.ndarray, edges: np.ndarray) -> list[np.ndarray]:
    """Parts of the coefficients (k, ...) between edges that are shares of the highest frequency."""
    cuts = np.ceil(edges[:-1] * len(coefficients)).astype(int)
    return np.split(coefficients, cuts)


@dataclass(frozen=True)
class _Draws:
    """Errors that the encoders make in the rows of a recording, or of pieces of it.

    ``errors[d][k]`` (rows, channels) belongs to draw d and ``blocks[k]``, ``regressors[d][k]`` (rows, channels, p) to the first
    few of these draws; each block stands for ``share`` as many rows.
    """

    blocks: Sequence[Block]
    errors: Sequence[Sequence[np.ndarray]]
    regressors: Sequence[Sequence[np.ndarray]]
    share: Sequence[float]

    @classmethod
    def few(cls, regression: Regression, law: RegressorNoise, values: np.ndarray, draws: int) -> _Draws:
        """Simulate U and ``U b`` a few times, which the mean of ``U' W'W U b``, a sum of squares, needs no more than."""
        blocks, count = list(law.pieces(None)), min(draws, law.draws or draws)
        regressors = [[x.matrix - b.matrix for x, b in zip(law.pieces(k), blocks, strict=True)] for k in range(count)]
        moving = sum(len(b.rows) for b in blocks if b.group != "poses")
        poses = sum(len(b.rows) for b in blocks if b.group == "poses")
        more = (regression.rows.count - poses) / max(moving, 1)
        return cls(blocks, law.misread(count, values), regressors, [1.0 if b.group == "poses" else more for b in blocks])

    def mean_square(self, weighted: Callable[[Block, np.ndarray], np.ndarray]) -> np.ndarray:
        """Mean square of what errors add to the right side, ``cov(X0' W'W U b) + m m'`` with ``m = E[U' W'W U b]`` (p, p).

        ``weighted`` weights rows of a block (k, channels, any).
        """
        sums, mean = 0.0, self.mean(weighted)
        for k, block in enumerate(self.blocks):
            p = block.matrix.shape[2]
            both = np.concatenate([block.matrix, np.stack([e[k] for e in self.errors], axis=2)], axis=2)
            rows = weighted(block, both).reshape(-1, both.shape[2])
            sums = sums + np.sqrt(self.share[k]) * (rows[:, p:].T @ rows[:, :p])
        return covariance_of_sums(np.asarray(sums)) + np.outer(mean, mean)

    def mean(self, weighted: Callable[[Block, np.ndarray], np.ndarray]) -> np.ndarray:
        """``m = E[U' W'W U b]`` (p,); ``weighted`` as for `mean_square`."""
        total = np.zeros(self.blocks[0].matrix.shape[2])
        for k, block in enumerate(self.blocks):
            for errors, regressor in zip(self.errors, self.regressors, strict=False):
                both = weighted(block, np.concatenate([regressor[k], errors[k][:, :, None]], axis=2)).reshape(-1, len(total) + 1)
                total += self.share[k] / len(self.regressors) * (both[:, :-1].T @ both[:, -1])
        return total


def covariance_of_sums(sums: np.ndarray) -> np.ndarray:
    """Covariance of simulated sums (draws, p), whose mean is known to be zero no better than their own mean says."""
    count, p = sums.shape
    return (student_factor(count - 1) if count > 1 else 1.0) * np.cov(sums.T, ddof=min(count - 1, 1)).reshape(p, p)


def may_matter(regression: Regression, weights: Weights) -> bool:
    """Whether anything is known of the regressor's errors, and the model lacks nothing.

    What residuals of an incomplete model hold beside encoder errors is no sensor's noise, and the scatter between parts
    counts it all. Nor need they be told apart where the noise holds what is simulated of them.
    """
    law = regression.regressor_noise
    return law is not None and law.present() and weights.complete and not weights.by_noise


def with_encoder_errors(
    regression: Regression, weights: Weights, scale: dict[str, np.ndarray] | None, inverse: np.ndarray, middle: np.ndarray
) -> np.ndarray | None:
    """Mean square of the weighted equations' right side, ``X' W'W Sigma W'W X + cov(X0' W'W U b) + m m'`` (p, p).

    ``scale`` is what each channel (c,) of a group of rows was weighted with; None: rows were whitened. ``inverse`` is that of a
    factor of the weighted rows, zero in columns that these do not determine (p, p); ``middle`` is ``X' W'W S W'W X``, which is
    the same without encoder errors. None where encoder errors add next to nothing, or `may_matter` denies it.
    """
    law = regression.regressor_noise
    if law is None or not may_matter(regression, weights):
        return None

    weighted, few = _weighting(weights, scale), _few(regression, law, weights, _FEW)
    bread = inverse @ inverse.T
    own, added = (np.diag(bread @ m @ bread) for m in (middle, few.mean_square(weighted)))
    if np.all(added <= _NEGLIGIBLE * own):
        return None
    draws, sensor = regression.rows.derived("encoder_errors", lambda: _split(regression, weights, law, few))

    def coloured(block: Block) -> np.ndarray:
        model, rows = weights.noise[block.group], weighted(block, block.matrix)
        # W' of weighted rows: the transpose of whitening, or the same factors again.
        back = model.whiten_transposed(rows) if scale is None else rows * scale[block.group].reshape(-1, 1)
        return sensor[block.group].colour_transposed(back)

    return regression.rows.total(gram_of(coloured), np.add) + draws.mean_square(weighted)


def right_side_lost(regression: Regression, weights: Weights, scale: dict[str, np.ndarray] | None) -> np.ndarray:
    """``m = E[U' W'W U b]`` (p,): what encoder errors take from the weighted equations' right side on average.

    ``scale`` as for `with_encoder_errors`; zero where nothing is known of the errors.
    """
    law = regression.regressor_noise
    if law is None or not law.present():
        return np.zeros(len(weights.solution))
    return _few(regression, law, weights, _EXPECTED).mean(_weighting(weights, scale))


def _weighting(weights: Weights, scale: dict[str, np.ndarray] | None) -> Callable[[Block, np.ndarray], np.ndarray]:
    """Weights rows (k, channels, any) of a block; ``scale`` as for `with_encoder_errors`."""

    def weighted(block: Block, rows: np.ndarray) -> np.ndarray:
        return weights.noise[block.group].whiten(rows) if scale is None else rows * scale[block.group].reshape(-1, 1)

    return weighted


def _few(regression: Regression, law: RegressorNoise, weights: Weights, draws: int) -> _Draws:
    """A few draws of encoder errors, made once."""
    return regression.rows.derived(f"{draws}_encoder_errors", lambda: _Draws.few(regression, law, weights.solution, draws))


def encoder_growth(regression: Regression, weights: Weights, scale: dict[str, np.ndarray], inverse: np.ndarray) -> np.ndarray:
    """Factors of the variances of a fit weighted by channel (p,) by encoder errors, for fits with other weights still.

    Arguments are those of `with_encoder_errors`.
    """
    middle = sandwich_middle(regression, weights.unsure(), scale)
    corrected = with_encoder_errors(regression, weights, scale, inverse, middle)
    if corrected is None:
        return np.ones(len(inverse))
    bread = inverse @ inverse.T
    without, beside = (np.diag(bread @ m @ bread) for m in (middle, corrected))
    return np.where(without > 0.0, beside / np.where(without > 0.0, without, 1.0), 1.0)


def sensor_alone(
    regression: Regression, weights: Weights, values: np.ndarray, drawn: Sequence[Sequence[tuple[str, np.ndarray]]]
) -> dict[str, NoiseModel]:
    """Noise of each group of rows without what encoder errors add to it, from an estimate (p,) that leaves the residuals.

    ``drawn`` holds, for each draw, the groups of blocks and what errors add to their rows (k, channels).
    """
    known = stated_noise(regression)
    if known is not None:
        return known
    pilot = regression.rows.pilot()
    taken = pseudo_inverse(reduce_whitened(pilot, weights.noise).matrix)
    noise = {}
    for group in weights.noise:
        own = [b for b in pilot if b.group == group]
        found = sensor_noise(
            [b.target - b.matrix @ values for b in own],
            [[error for g, error in rows if g == group] for rows in drawn[:SPECTRA]],
            [regressor_times(b, taken) for b in own],
            regression.rows.known_poles if group == "trajectory" else None,
            coloured=group != "poses",
        )
        noise[group] = replace(found, degrees=weights.noise[group].degrees)
    return noise


def _split(regression: Regression, weights: Weights, law: RegressorNoise, few: _Draws) -> tuple[_Draws, dict[str, NoiseModel]]:
    """Many draws, and the noise of the sensor alone."""
    draws = replace(few, errors=law.misread(min(_MANY, law.draws or _MANY), weights.solution))
    drawn = [[(b.group, e) for b, e in zip(draws.blocks, errors, strict=True)] for errors in draws.errors]
    return draws, weights.unsure(sensor_alone(regression, weights, weights.solution, drawn))
