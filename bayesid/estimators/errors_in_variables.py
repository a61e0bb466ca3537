"""Encoder noise in the regressor: total least squares, instrumental variables, and whether it matters.

Encoder noise U in the regressor ``X = X0 + U`` attenuates least squares: ``E[b_ls] - b = -(X'WX)^-1 E[U'WU] b``, with W the
channels' weights.

**Structured total least squares** gives that back. The law of U is known: it is what the encoders' noise becomes on its way
through smoother, dynamics and filters (`bayesid.regression.encoder_noise`), all columns from the same few joints. Let X* be the
regressor with that noise once more. ``E[X*'WX*]`` exceeds ``X'WX`` by what X'WX exceeds X0'WX0 on average, curvature of the
dynamics included, up to fourth order in the noise of positions and velocities (and exactly for accelerations, in which X is
linear). So

    (2 X'WX - E[X*'WX*]) b = 2 X'Wy - E[X*'Wy]

has the mean of the equations without noise: a corrected score ([Nakamura1990]_, [Novick2002]_). For linear errors of known
covariance it is the total-least-squares estimate of known noise, called adjusted least squares [Kukush2005]_. The mean is
taken over simulated draws +u and -u, so that what is odd in u drops out.

The covariance is a sandwich with the noise of the equations' right side: the sensor's, colour included, and what encoder
errors add, simulated.

**Instrumental variables** Z are rows parallel to the regressor's, close to the true ones, with errors that are independent of
this regressor's: ``E[Z'W U] = 0``. Then

    b = (Z'WX)^-1 Z'Wy

is free of the attenuation of least squares ([Janot2014]_; `bayesid.regression.encoder_noise` says where Z comes from).
Where the splines through even and odd samples are the instruments of each other, both orders count:
``(Z'WX + X'WZ) b = Z'Wy + X'Wy``.

The covariance is ``A^-1 M A^-T``, ``A = Z'WX``, with M the covariance of ``Z'W (e - U b)``: the sensor's noise, colour
included, and the encoders', simulated; where their law is not known, that of the residuals. What the model lacks is in neither,
so M is in no direction smaller than with the noise that `wls` takes from residuals.

The Durbin-Wu-Hausman test ([Hausman1978]_, [Janot2016]_) compares both estimates. Their difference is linear in the rows'
noise, ``d = Q'e`` with ``Q = W Z A^-T - W X (X'WX)^-1``, so its covariance is ``Q' Sigma Q``. That is the textbook's
``V_iv - V_ls`` where least squares is efficient, but cannot have negative eigenvalues where it is not;
``d' (Q' Sigma Q)^+ d`` is chi-squared when the errors of X do not enter y. The test sees encoder noise long before it moves
the estimate by much, so the verdict also weighs the shift.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.errors import InputError
from bayesid.estimators.covariance import SPECTRA, covariance_of_sums, sensor_alone
from bayesid.estimators.estimator import OPTIONAL, Details, Estimate, strongest
from bayesid.estimators.factor import Factor, gram_rows, reduce_whitened
from bayesid.estimators.least_squares import completeness, make_estimate, solved, weighted_factor
from bayesid.estimators.weights import Weights, learn_weights, noise_of_residuals
from bayesid.regression.blocks import Block, Pair, RegressorNoise
from bayesid.regression.hypothesis_tests import ChiSquared, hausman
from bayesid.regression.linalg import at_least, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel

#: Least squares shifted by this many of its own standard deviations matters: a 95 % interval then covers 92 %.
LARGEST_SHIFT = 0.5
#: Of what a direction shows, noise may be up to this share for `tls` to take it away.
LARGEST_SHARE = 0.9
#: Below this probability the Durbin-Wu-Hausman test sees encoder noise.
SMALLEST_PROBABILITY = 0.01
#: Instruments are weak when the first stage's statistic is below this [Staiger1997]_.
WEAKEST = 10.0


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


@explains_types
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
        if start.weights.widened or "poses" in noise:
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
            verdict=_tls_verdict(shift),
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


def _tls_verdict(shift: float) -> str:
    if shift > LARGEST_SHIFT:
        return f"encoder noise matters: it moves least squares by up to {shift:.2g} of its standard deviations"
    return f"encoder noise does not matter: it moves least squares by at most {shift:.2g} of its standard deviations"


@dataclass(frozen=True)
class ShiftTest:
    """The Durbin-Wu-Hausman test, the largest shift from least squares in its standard deviations, and what follows."""

    statistic: float
    dof: int
    p: float
    shift_from_least_squares: float
    verdict: str


@dataclass(frozen=True, kw_only=True)
class InstrumentDetails(Details):
    """What instrumental variables say."""

    instruments: list[str]  # where they are from
    #: Cragg and Donald's statistic, and whether it is too small.
    first_stage: float
    weak_instruments: bool
    durbin_wu_hausman: ShiftTest  # whether encoder noise matters


@explains_types
@dataclass(frozen=True)
class InstrumentalVariables:
    """Instrumental variables, with the Durbin-Wu-Hausman test in the details."""

    name: str = "iv"
    draws: int = 40

    def fit(self, regression: Regression) -> Estimate:
        """Estimate; with the regressor as its own instrument this is `wls`.

        Raises
        ------
        InputError
            There are no instruments.
        """
        given = regression.instruments
        if given is None:
            raise InputError("method 'iv' needs instruments: give Regression.from_arrays(instruments=...), or choose wls")
        start = begin(regression)
        pairs = list(given.pairs()) if regression.rows.fits_in_memory else None

        def read() -> Iterator[Pair]:
            yield from given.pairs() if pairs is None else pairs

        sums = _sums(start, read())
        inverse = _pinv(sums.crossed)
        step = inverse @ sums.right
        solution = start.solution + start.root @ step
        law = regression.regressor_noise
        draws = []
        if given.drawn is not None and law is not None and law.present():
            draws = [given.drawn(k) for k in range(self.draws if law.draws is None else law.draws)]
        noise, extra = split_noise(regression, start, solution, law, draws)
        total = noise_of_fit(regression, start, solution)
        one, both = _spreads(start, noise, read())
        p = len(step)
        # Rows of [X Z] that the estimate sums up: Z, or the mean of X and Z where each is the other's instrument.
        alone, mean = np.vstack([np.zeros((p, p)), np.eye(p)]), 0.5 * np.vstack([np.eye(p), np.eye(p)])

        def summed(one: np.ndarray, both: np.ndarray) -> np.ndarray:
            return alone.T @ one @ alone + mean.T @ both @ mean

        wide = _spreads(start, start.weights.dispersed(noise), read()) if start.weights.widened else (one, both)
        meat = summed(*wide) + start.weights.dispersion * extra
        # Residuals also hold what the model lacks: its colour is that of the motion, which no smooth curve of a sensor's
        # noise follows. So the noise as `wls` takes it, encoders' part included, is a lower bound in every direction.
        meat = at_least(meat, summed(*_spreads(start, start.weights.dispersed(), read())))
        covariance = start.root @ inverse @ meat @ inverse.T @ start.root.T
        ordinary = one[:p, :p] + mean.T @ both @ mean  # of X alone
        plain = start.root @ ordinary @ start.root.T
        estimate = make_estimate(self.name, regression, replace(start.weights, noise=total), start.factor, solution, covariance)
        shift = largest_shift(solution - start.solution, plain, start.factor.undetermined)
        test = _hausman(sums, one + both, ordinary)
        verdict = _iv_verdict(test.probability, shift)
        described = given.describe()
        statistic, direction = sums.first_stage(start)
        warnings = list(described.pop("warnings", []))
        if statistic < WEAKEST:
            hardly = strongest(regression, direction, standard_deviations(plain, 1e-300))
            warnings.append(
                f"The instruments hardly follow the motion in the direction of {hardly} "
                f"(first-stage statistic {statistic:.2g}, below {WEAKEST:.0f}): its interval may be too short; "
                "record more motion there, or take wls."
            )
        details = InstrumentDetails(
            **completeness(start.weights),
            **described,
            first_stage=statistic,
            weak_instruments=bool(statistic < WEAKEST),
            durbin_wu_hausman=ShiftTest(test.statistic, test.degrees, test.probability, shift, verdict),
            warnings=tuple(warnings),
        )
        return replace(estimate, details=details)


@dataclass(frozen=True)
class _InstrumentSums:
    """Sums of products of weighted rows in the coordinates of `Start`, and of residuals of least squares.

    ``crossed`` and ``right`` are the estimate's equations; ``x_x``, ``z_z``, ``z_x``, ``x_r``, ``z_r`` those of the pairs in
    one order only. ``rows``: how many scalar rows.
    """

    crossed: np.ndarray
    right: np.ndarray
    x_x: np.ndarray
    z_z: np.ndarray
    z_x: np.ndarray
    x_r: np.ndarray
    z_r: np.ndarray
    rows: int

    def first_stage(self, start: Start) -> tuple[float, np.ndarray]:
        """Cragg and Donald's statistic [Cragg1993]_ and the direction of parameters that it is smallest in.

        With the smallest canonical correlation c of X and Z: ``(N - p) / p * c^2 / (1 - c^2)``.
        """
        roots = []
        for gram in (self.z_z, self.x_x):
            values, vectors = np.linalg.eigh(gram)
            roots.append(vectors / np.sqrt(np.where(values > 1e-10 * values[-1], values, np.inf)) @ vectors.T)
        _, correlations, directions = np.linalg.svd(roots[0] @ self.z_x @ roots[1])
        p = max(int(np.count_nonzero(values > 1e-10 * values[-1])), 1)  # directions that the regressor shows
        smallest = float(min(correlations[p - 1], 1.0))
        statistic = (self.rows - p) / p * smallest**2 / max(1.0 - smallest**2, 1e-12)
        return statistic, start.root @ roots[1] @ directions[p - 1]


def _sums(start: Start, pairs: Iterator[Pair]) -> _InstrumentSums:
    p = len(start.solution)
    crossed, x_x, z_z, z_x = np.zeros((4, p, p))
    right, x_r, z_r = np.zeros((3, p))
    rows = 0
    for pair in pairs:
        (x, own), (z, other) = start.rows(pair.regressors), start.rows(pair.instruments)
        product, toward = z.T @ x, z.T @ own
        crossed += 0.5 * (product + product.T) if pair.symmetric else product
        right += 0.5 * (toward + x.T @ other) if pair.symmetric else toward
        x_x += x.T @ x
        z_z += z.T @ z
        z_x += product
        x_r += x.T @ own
        z_r += toward
        rows += len(own)
    return _InstrumentSums(crossed, right, x_x, z_z, z_x, x_r, z_r, rows)


def _spreads(start: Start, noise: dict[str, NoiseModel], pairs: Iterator[Pair]) -> tuple[np.ndarray, np.ndarray]:
    """``[X Z]'W Sigma W [X Z]`` of the one-sided pairs and of the symmetric ones, (2 p, 2 p) each."""
    p = len(start.solution)
    totals = np.zeros((2, 2 * p, 2 * p))
    for pair in pairs:
        flat = np.hstack([start.rows(pair.regressors)[0], start.rows(pair.instruments)[0]])
        coloured = noise[pair.regressors.group].colour_transposed(start.back(pair.regressors, flat)).reshape(-1, 2 * p)
        totals[int(pair.symmetric)] += coloured.T @ coloured
    return totals[0], totals[1]


def _pinv(matrix: np.ndarray) -> np.ndarray:
    return np.linalg.pinv(matrix, rcond=1e-10)


def _hausman(sums: _InstrumentSums, spreads: np.ndarray, ordinary: np.ndarray) -> ChiSquared:
    """Durbin-Wu-Hausman test of the pairs in one order: of both, first-order differences would cancel."""
    with_instruments, plain = _pinv(sums.z_x), _pinv(sums.x_x)
    difference = with_instruments @ sums.z_r - plain @ sums.x_r
    q = np.vstack([-plain.T, with_instruments.T])
    # Directions that the encoders do not touch (an offset's) have no difference to test.
    return hausman(difference, q.T @ spreads @ q, smallest=1e-10 * np.linalg.eigvalsh(ordinary)[-1])


def _iv_verdict(p: float, shift: float) -> str:
    size = f"least squares moves by {'up to' if shift > LARGEST_SHIFT else 'at most'} {shift:.2g} of its standard deviations"
    if p >= SMALLEST_PROBABILITY:
        return f"encoder noise does not matter: it is not seen (p = {p:.2g})"
    if shift <= LARGEST_SHIFT:
        return f"encoder noise does not matter: it is seen (p = {p:.2g}), but {size}"
    return f"encoder noise matters: it is seen (p = {p:.2g}), and {size}"
