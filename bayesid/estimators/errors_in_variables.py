"""Structured total least squares: what encoder noise in the regressor takes from an estimate, given back.

Encoder noise U in the regressor ``X = X0 + U`` attenuates least squares: ``E[b_ls] - b = -(X'WX)^-1 E[U'WU] b``, with W
the channels' weights. The law of U is known: it is what the encoders' noise becomes on its way through smoother,
dynamics and filters (`bayesid.regression.encoder_noise`), all columns from the same few joints. Let X* be the regressor with
that noise once more. ``E[X*'WX*]`` exceeds ``X'WX`` by what X'WX exceeds X0'WX0 on average, curvature of the dynamics
included, up to fourth order in the noise of positions and velocities (and exactly for accelerations, in which X is linear). So

    (2 X'WX - E[X*'WX*]) b = 2 X'Wy - E[X*'Wy]

has the mean of the equations without noise: a corrected score ([Nakamura1990]_, [Novick2002]_). For linear errors of known
covariance it is the total-least-squares estimate of known noise, called adjusted least squares [Kukush2005]_. The mean is
taken over simulated draws +u and -u, so that what is odd in u drops out.

The covariance is a sandwich with the noise of the equations' right side: the sensor's, colour included, and what encoder
errors add, simulated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.errors import InputError
from bayesid.estimators.covariance import SPECTRA, covariance_of_sums, sensor_alone
from bayesid.estimators.estimator import OPTIONAL, Details, Estimate, strongest
from bayesid.estimators.factor import Factor, gram_rows, reduce_whitened
from bayesid.estimators.least_squares import completeness, make_estimate, solved, weighted_factor
from bayesid.estimators.weights import Weights, learn_weights, noise_of_residuals
from bayesid.regression.blocks import Block, Pair, RegressorNoise
from bayesid.regression.linalg import at_least, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel

#: Least squares shifted by this many of its own standard deviations matters: a 95 % interval then covers 92 %.
LARGEST_SHIFT = 0.5
#: Of what a direction shows, noise may be up to this share for `tls` to take it away.
LARGEST_SHARE = 0.9


@dataclass(frozen=True)
class Start:
    """Weighted least squares, and the coordinates in which its regressor has orthonormal columns."""

    weights: Weights
    factor: Factor
    scale: dict[str, np.ndarray]
    solution: np.ndarray

    @property
    def root(self) -> np.ndarray:
        """X root has orthonormal columns (p, p)."""
        return self.factor.inverse

    def rows(self, block: Block) -> tuple[np.ndarray, np.ndarray]:
        """Weighted rows in these coordinates (k channels, p), and residuals of least squares (k channels,)."""
        scale = self.scale[block.group]
        matrix, residual = block.matrix * scale[:, None], (block.target - block.matrix @ self.solution) * scale
        return matrix.reshape(-1, matrix.shape[2]) @ self.root, residual.ravel()

    def project(self, block: Block, error: np.ndarray) -> np.ndarray:
        """Sum of products of a block's regressor with an error of the readings (k, channels), both weighted (p,)."""
        return self.root.T @ np.einsum("tcp,tc->p", block.matrix, error * self.scale[block.group] ** 2)

    def back(self, block: Block, flat: np.ndarray) -> np.ndarray:
        """Weighted rows (k channels, p) as (k, channels, p), with the weights of their sums of products."""
        return flat.reshape(*block.rows.shape[:2], -1) * self.scale[block.group][:, None]

    def spread(self, noise: dict[str, NoiseModel], blocks: Iterable[Block]) -> np.ndarray:
        """``X' W Sigma W X`` of all rows in these coordinates (p, p)."""
        return gram_rows(blocks, lambda b: noise[b.group].colour_transposed(self.back(b, self.rows(b)[0])))


def begin(regression: Regression) -> Start:
    """Fit channel-weighted least squares, as `wls` does."""
    weights = learn_weights(regression)
    factor, scale = weighted_factor(regression, weights, "channel")
    assert scale is not None
    return Start(weights, factor, scale, solved(regression, factor))


@dataclass(frozen=True, kw_only=True)
class TotalLeastSquaresDetails(Details):
    """What total least squares says."""

    #: Standard deviation of single positions [rad or m], and correlation of neighbouring ones, by joint.
    encoder_std: list[float] | None = field(default=None, metadata=OPTIONAL)
    encoder_correlation: list[float] | None = field(default=None, metadata=OPTIONAL)
    regressor_noise: str | None = field(default=None, metadata=OPTIONAL)  # where the errors are from, if not from encoders
    draws: int  # pairs of simulated recordings
    largest_noise_share: float  # of what a direction shows, the largest share that is noise
    shift_from_least_squares: float  # largest shift of a parameter, in standard deviations
    verdict: str  # whether encoder noise matters


@dataclass(frozen=True)
class TotalLeastSquares:
    """Structured total least squares: least squares corrected for the encoder noise in its regressor.

    Attributes
    ----------
    draws
        Pairs of simulated recordings that the correction is averaged over; what is left of their randomness is
        counted in the covariance.
    """

    name: str = "tls"
    draws: int = 40

    def fit(self, regression: Regression) -> Estimate:
        """Estimate; without noise in the regressor this is `wls`.

        Raises
        ------
        InputError
            The errors of the regressor are not known.
        """
        law = regression.regressor_noise
        if law is None:
            raise InputError(
                "method 'tls' needs the errors of the regressor: give Regression.from_arrays(regressor_noise=...), or choose wls"
            )
        start = begin(regression)
        p = len(start.solution)
        count = (self.draws if law.draws is None else law.draws) if law.present() else 0
        # In coordinates h with b = b_ls + root h least squares is h = 0, and the corrected equations are (1 - D) h = -s.
        drawn = [_correction(start, law, k) for k in range(count)]
        share = sum((d for d, _ in drawn), np.zeros((p, p))) / max(count, 1)
        right = sum((s for _, s in drawn), np.zeros(p)) / max(count, 1)
        values, vectors = np.linalg.eigh(0.5 * (share + share.T))
        inverse = (vectors / (1.0 - np.minimum(values, LARGEST_SHARE))) @ vectors.T
        step = -inverse @ right
        solution = start.solution + start.root @ step
        draws = [(Pair(b, b) for b in law.simulated(k)) for k in range(count)]
        noise, extra = split_noise(regression, start, solution, law, draws)
        ordinary = meat = start.spread(noise, regression.rows.blocks()) + extra
        if start.weights.widened:
            meat = start.spread(start.weights.dispersed(noise), regression.rows.blocks()) + start.weights.dispersion * extra
        if not start.weights.complete:
            # What the model lacks has the colour of the motion, as encoder errors have, and looks like them: noise as
            # `wls` takes it is then a lower bound in every direction.
            meat = at_least(meat, start.spread(start.weights.dispersed(), regression.rows.blocks()))
        if count > 1:
            # The equations' right side at the solution differs from draw to draw; its mean by that over their number.
            left = np.array([s - (np.eye(p) - d) @ -step for d, s in drawn])
            meat = meat + np.cov(left.T, ddof=1).reshape(p, p) / count
        covariance = start.root @ inverse @ meat @ inverse @ start.root.T
        estimate = make_estimate(
            self.name, regression, replace(start.weights, noise=noise_of_fit(regression, start, solution)), start.factor,
            solution, covariance,
        )  # fmt: skip
        plain = start.root @ ordinary @ start.root.T
        shift = largest_shift(solution - start.solution, plain, start.factor.undetermined)
        described = law.describe()
        warnings = tuple(described.pop("warnings", ()))
        details = TotalLeastSquaresDetails(
            **completeness(start.weights),
            **described,
            draws=count,
            largest_noise_share=float(values[-1]),
            shift_from_least_squares=shift,
            verdict=_verdict(shift),
            warnings=warnings,
        )
        if values[-1] > LARGEST_SHARE:
            lost = strongest(regression, start.root @ vectors[:, -1], standard_deviations(plain, 1e-300))
            reason = (
                f"the motions show hardly more than encoder noise in the direction of {lost}: "
                f"{100 * min(values[-1], 1.0):.0f} % of its rows; lower the bandwidth"
            )
            estimate = replace(estimate, full_covariance=None, interval="none", interval_reason=reason)
        return replace(estimate, details=details)


def _correction(start: Start, law: RegressorNoise, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean over +u, -u of ``Z*'Z* - Z'Z`` and of ``Z*'r*``, r* the residuals of least squares."""
    p = len(start.solution)
    gram, right = np.zeros((p, p)), np.zeros(p)
    for sign in (1.0, -1.0):
        for block in law.perturbed(k, sign):
            rows, residual = start.rows(block)
            gram += 0.5 * rows.T @ rows
            right += 0.5 * rows.T @ residual
    own = start.factor.matrix @ start.root
    return gram - own.T @ own, right


def split_noise(
    regression: Regression, start: Start, solution: np.ndarray, law: RegressorNoise | None, draws: Sequence[Iterable[Pair]]
) -> tuple[dict[str, NoiseModel], np.ndarray]:
    """Noise of the sensor, and the covariance that encoder errors add to the equations' right side.

    Encoder errors enter rows through the dynamics: they come and go with the motion, and they hardly reach the low frequencies
    where the motion is. No stationary recursion says that, so their part is simulated: about a smooth trajectory with the
    regressor X and the estimate b, ``Z*'W (X - X*) b``. ``draws`` are pairs of X* and Z* with simulated errors; without any,
    the noise of all kinds is that of the residuals.
    """
    p = len(solution)
    if law is None or not draws:
        return noise_of_fit(regression, start, solution), np.zeros((p, p))
    sums, added, truth = [], [], list(law.simulated(None)) if regression.rows.fits_in_memory else None
    for k, pairs in enumerate(draws):
        total, rows = np.zeros(p), []
        for block, pair in zip(law.simulated(None) if truth is None else truth, pairs, strict=True):
            # The target changes, too, where readings are linearised: about a point it is shifted by what the columns are there.
            left = block.residual(solution)
            x, z = pair.regressors, pair.instruments
            error = x.residual(solution) - left
            if pair.symmetric:
                other = z.residual(solution) - left
                total += 0.5 * (start.project(z, error) + start.project(x, other))
                error = 0.5 * (error + other)
            else:
                total += start.project(z, error)
            rows.append((block.group, error))
        sums.append(total)
        if k < SPECTRA:
            added.append(rows)
    return sensor_alone(regression, start.weights, solution, added), covariance_of_sums(np.array(sums))


def noise_of_fit(regression: Regression, start: Start, solution: np.ndarray) -> dict[str, NoiseModel]:
    """Noise of each group of rows from the residuals of a fit other than least squares."""
    blocks = regression.rows.pilot()
    return noise_of_residuals(regression, blocks, solution, reduce_whitened(blocks, start.weights.noise))


def largest_shift(change: np.ndarray, covariance: np.ndarray, hidden: np.ndarray) -> float:
    """Largest change of a parameter in standard deviations of least squares."""
    std = standard_deviations(covariance, 1e-300)
    return float(np.max(np.where(hidden, 0.0, np.abs(change) / std), initial=0.0))


def _verdict(shift: float) -> str:
    if shift > LARGEST_SHIFT:
        return f"encoder noise matters: it moves least squares by up to {shift:.2g} of its standard deviations"
    return f"encoder noise does not matter: it moves least squares by at most {shift:.2g} of its standard deviations"
