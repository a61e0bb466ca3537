"""Instrumental variables, and the test that says whether encoder noise matters.

Instruments Z are rows parallel to the regressor's, close to the true ones, with errors that are independent of this
regressor's: ``E[Z'W U] = 0``. Then

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

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayesid.errors import InputError
from bayesid.estimators.errors_in_variables import LARGEST_SHIFT, Start, begin, largest_shift, noise_of_fit, split_noise
from bayesid.estimators.estimator import Details, Estimate, strongest
from bayesid.estimators.least_squares import completeness, make_estimate
from bayesid.regression.blocks import Pair
from bayesid.regression.hypothesis_tests import ChiSquared, hausman
from bayesid.regression.linalg import at_least, standard_deviations
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel

#: Below this probability the Durbin-Wu-Hausman test sees encoder noise.
SMALLEST_PROBABILITY = 0.01
#: Instruments are weak when the first stage's statistic is below this [Staiger1997]_.
WEAKEST = 10.0


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
            durbin_wu_hausman=ShiftTest(test.statistic, test.degrees, test.probability, shift, _verdict(test.probability, shift)),
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
        p = int(np.count_nonzero(~start.factor.undetermined))
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


def _verdict(p: float, shift: float) -> str:
    size = f"least squares moves by {'up to' if shift > LARGEST_SHIFT else 'at most'} {shift:.2g} of its standard deviations"
    if p >= SMALLEST_PROBABILITY:
        return f"encoder noise does not matter: it is not seen (p = {p:.2g})"
    if shift <= LARGEST_SHIFT:
        return f"encoder noise does not matter: it is seen (p = {p:.2g}), but {size}"
    return f"encoder noise matters: it is seen (p = {p:.2g}), and {size}"
