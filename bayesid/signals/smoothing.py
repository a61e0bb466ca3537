"""Joint trajectories from encoder counts: positions, velocities and accelerations without phase shift.

A least-squares spline of degree five on uniform knots. Knots a time h apart pass frequencies below
1 / (2 h) and nothing above, without delay; a forward difference would delay velocities by half a sample,
which a six-axis sensor sees at once. The fit is local: a knot's influence falls by 0.43 from knot to knot, so
a long recording is smoothed in pieces with an overlap, and the pieces agree to a small part of the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb, factorial

import numba
import numpy as np
from scipy.linalg import get_lapack_funcs

from bayesid.errors import InputError
from bayesid.signals.arrays import kernel_input

_solve_banded, _factor_banded, _solve_factored = get_lapack_funcs(("pbsv", "pbtrf", "pbtrs"), dtype=np.float64)
#: A gap-free segment: times (N,) [s] and positions (N, n) [rad or m].
Piece = tuple[np.ndarray, np.ndarray]

DEGREE = 5
_ORDER = DEGREE + 1
#: Knots that a piece is widened by on each side: 0.43**28 < 1e-10, of ends that are loose.
OVERLAP = 28
#: Bandwidths searched [Hz]; also kept below a fifth of the sampling rate.
_SEARCHED = 1.0, 20.0


def _basis_polynomials() -> np.ndarray:
    """Coefficients (6 functions, 6 powers of the fraction u) of the uniform quintic B-spline.

    The basis element is ``sum_i (-1)^i (6 choose i) max(x - i, 0)^5 / 5!``; function k of the six that live on one knot
    interval is the element at ``x = u + 5 - k``.
    """
    out = np.zeros((_ORDER, _ORDER))
    for k in range(_ORDER):
        for i in range(_ORDER - k):
            weight = (-1) ** i * comb(_ORDER, i)
            out[k] += [weight * comb(DEGREE, p) * (DEGREE - k - i) ** (DEGREE - p) for p in range(_ORDER)]
    return out / factorial(DEGREE)


#: Coefficients of the six functions on a knot interval by powers of the fraction of it (6, 6).
POLYNOMIALS = _basis_polynomials()


@dataclass(frozen=True)
class Smoother:
    """How a recording's positions are smoothed."""

    bandwidth: float  # frequency up to which motion is kept [Hz]; the knots are 1 / (2 bandwidth) apart
    position_std: np.ndarray  # random error of one position sample around the smooth motion (n,) [rad or m]
    reason: str  # where the bandwidth comes from, one sentence
    automatic: float = 0.0  # the bandwidth that cross-validation chooses [Hz]; 0: there was nothing to choose from
    at_end: bool = False  # whether that is the end of the range searched, so that it is no choice
    resolution: float = 0.0  # encoder count [rad or m]; 0 where it is not known
    stated: float = 0.0  # random error of one position sample on top of the count that is stated [rad or m]; 0: none

    @property
    def stated_error(self) -> float:
        """Error of one position sample by what is stated, the count's and the random one together; 0 without a random one."""
        return float(np.hypot(self.resolution / 12.0**0.5, self.stated)) if self.stated else 0.0


def smooth(
    times: np.ndarray, positions: np.ndarray, bandwidth: float, at: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations of the least-squares spline through noisy positions (N, n) [rad or m].

    Times (N,) [s] strictly increase and need not be even; it is evaluated ``at`` these or others. The ``bandwidth`` is the
    highest frequency kept [Hz]; an `InputError` where there are too few samples for it.
    """
    coefficients, first = _fitted(times, positions, bandwidth)
    q, v, a = _evaluate(kernel_input(times if at is None else at), coefficients, first, 0.5 / bandwidth, POLYNOMIALS)
    still = np.ptp(positions, axis=0) == 0.0  # what rounding makes of a joint at rest would pass for motion
    q[:, still], v[:, still], a[:, still] = positions[0, still], 0.0, 0.0
    return q, v, a


def degrees_of_freedom(times: np.ndarray, bandwidth: float) -> int:
    """Those of what the spline leaves of samples at times (N,) [s]: it takes as many as it has functions."""
    return len(times) - int((times[-1] - times[0]) * 2 * bandwidth) - _ORDER


def _fitted(times: np.ndarray, positions: np.ndarray, bandwidth: float) -> tuple[np.ndarray, float]:
    """Coefficients of the spline (functions, n), and the first knot in units of their spacing."""
    spacing = 0.5 / bandwidth
    # Knots on a grid common to all pieces of a recording, so that pieces agree where they overlap.
    first = np.floor(times[0] / spacing)
    count = int(np.floor(times[-1] / spacing) - first) + _ORDER
    too_few = InputError(
        f"{len(times)} samples in {times[-1] - times[0]:.3g} s are too few or too uneven to be smoothed at "
        f"{bandwidth:.3g} Hz; choose a lower bandwidth"
    )
    if count > len(times) + DEGREE:
        raise too_few
    living, values = _living(kernel_input(times), first, spacing, count, POLYNOMIALS)
    band, right = _normal_equations(living, values, kernel_input(positions), count)
    # A whisper of ridge keeps the outermost functions, of which only a tail lies in the data, determined.
    band[-1] += 1e-14 * band[-1].max()
    # LAPACK itself: hundreds of short pieces are fitted, and the checks of `solveh_banded` take longer than they do.
    _, coefficients, failed = _solve_banded(band, right)
    if failed:
        raise too_few
    return kernel_input(coefficients), float(first)


def choose_smoother(
    pieces: Sequence[Piece],
    resolution: float | None = None,
    noise: float | None = None,
    each: Callable[[Callable, Iterable], Iterable] = map,
) -> Smoother:
    """Choose the bandwidth from gap-free segments, of which there may be samples, by generalised cross-validation [Craven1979]_.

    The error is not taken smaller than encoder count (``resolution``) and random noise [rad or m], if known. ``each`` calls a
    function with every item of a sequence, in order: ``map``, or one that uses more cores.

    ``GCV(h) = prod_j RSS_j(h) / (N - M(h))^2`` over the joints that move. Cross-validation prefers a spline
    that is a little too stiff to one that is too loose only in position; accelerations weigh the bias more, so
    the smallest bandwidth within 2 % of the best score is widened by a quarter.
    """
    (chosen,) = choose_smoothers(pieces, [range(len(pieces))], resolution, noise, each)
    return chosen


def choose_smoothers(
    pieces: Sequence[Piece],
    groups: Sequence[Sequence[int]],
    resolution: float | None = None,
    noise: float | None = None,
    each: Callable[[Callable, Iterable], Iterable] = map,
) -> list[Smoother]:
    """`choose_smoother` for groups of pieces, by the indices of each; a piece of several groups is fitted once."""
    tried = [_candidates([pieces[k][0] for k in group]) for group in groups]
    centred = [(kernel_input(times), kernel_input(positions - positions.mean(axis=0))) for times, positions in pieces]
    wanted: dict[float, dict[int, None]] = {}
    for group, bandwidths in zip(groups, tried, strict=True):
        for bandwidth in bandwidths:
            wanted.setdefault(bandwidth, {}).update(dict.fromkeys(group))
    sums = each(lambda bandwidth: {k: _left(centred[k], bandwidth) for k in wanted[bandwidth]}, wanted)
    left = {(k, b): power for b, powers in zip(wanted, sums, strict=True) for k, power in powers.items()}
    return [
        _chosen(pieces, group, bandwidths, left, resolution or 0.0, noise or 0.0)
        for group, bandwidths in zip(groups, tried, strict=True)
    ]


def _candidates(times: Sequence[np.ndarray]) -> list[float]:
    """Bandwidths to try [Hz]."""
    rates = [float(1.0 / np.median(np.diff(t))) for t in times]
    # A much slower piece has fewer samples than a spline that suits the others has functions.
    highest = min(_SEARCHED[1], 0.2 * float(np.median(rates)), 0.4 * min(rates))
    lowest = min(max(_SEARCHED[0], 2.0 / max(sum(t[-1] - t[0] for t in times), 1e-9)), highest)
    return np.geomspace(lowest, highest, 16).tolist()


def _left(piece: Piece, bandwidth: float) -> np.ndarray:
    """Sums of squares of positions less the spline's (n,)."""
    coefficients, first = _fitted(*piece, bandwidth)
    living, values = _living(piece[0], first, 0.5 / bandwidth, len(coefficients), POLYNOMIALS)
    return _residual_power(living, values, piece[1], coefficients)


def _chosen(
    pieces: Sequence[Piece], group: Sequence[int], candidates: Sequence[float], left_of: Mapping[tuple[int, float], np.ndarray],
    resolution: float, noise: float,
) -> Smoother:  # fmt: skip
    """The smoother of one group, from what splines leave of each of its pieces at a bandwidth (n,)."""
    times, positions = zip(*(pieces[k] for k in group), strict=True)
    lowest, highest = candidates[0], candidates[-1]
    moving = np.max([np.ptp(q, axis=0) for q in positions], axis=0) > 10.0 * max(resolution, 1e-9)
    floor = resolution**2 / 12.0 + noise**2
    samples = sum(map(len, times))
    scores, errors = [], []
    for bandwidth in candidates:
        free = max(sum(degrees_of_freedom(t, bandwidth) for t in times), 1)
        left = np.sum([left_of[k, bandwidth] for k in group], axis=0)
        variance = np.maximum(left / free, max(0.25 * floor, 1e-20))
        errors.append(np.sqrt(variance))
        scores.append(np.sum(np.log(variance[moving])) + moving.sum() * np.log(samples / free))
    best = np.min(scores)
    chosen = int(np.flatnonzero(np.array(scores) <= best + 0.02 * max(moving.sum(), 1))[0])
    bandwidth = float(min(1.25 * candidates[chosen], highest))
    reason = (
        f"cross-validation of the joint positions between {lowest:.2g} and {highest:.2g} Hz"
        if moving.any()
        else "no joint moves; the lowest bandwidth searched"
    )
    error, at_end = np.maximum(errors[chosen], np.sqrt(floor)), bandwidth >= 0.999 * highest
    return Smoother(bandwidth, error, reason, bandwidth, at_end, resolution, noise)


@dataclass(frozen=True, eq=False)
class Splines:
    """The functions that `smooth` fits, six of which live at each time: for fits in which more than positions count."""

    first: np.ndarray  # of the six at each time (M,)
    values: np.ndarray  # of the six, and of their first two derivatives (3, M, 6)
    count: int  # number k of functions

    @classmethod
    def over(cls, times: np.ndarray, bandwidth: float, at: np.ndarray | None = None) -> Splines:
        """Over times (N,) [s] with nothing above a bandwidth [Hz], at these or at others within them (M,)."""
        spacing = 0.5 / bandwidth
        start = np.floor(times[0] / spacing)
        count = int(np.floor(times[-1] / spacing) - start) + _ORDER
        where = (times if at is None else np.clip(at, times[0], times[-1])) / spacing - start
        first = np.minimum(where.astype(int), count - _ORDER)
        powers = (where - first)[:, None] ** np.arange(_ORDER)
        values, polynomial = np.empty((3, len(where), _ORDER)), POLYNOMIALS
        for order in range(3):
            values[order] = powers[:, : _ORDER - order] @ polynomial.T / spacing**order
            polynomial = polynomial[:, 1:] * np.arange(1, _ORDER - order)
        return cls(first, values, count)

    def motion(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (M, ...) of coefficients (k, ...)."""
        if coefficients.ndim == 1:
            out = _sums(self.first, self.values, kernel_input(coefficients))
            return out[0], out[1], out[2]
        own = coefficients[self.first[:, None] + np.arange(_ORDER)]
        q, v, a = np.einsum("dmf,mf...->dm...", self.values, own)
        return q, v, a

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Coefficients (k, ...) of the least-squares spline through values (M, ...)."""
        columns = values.reshape(len(values), -1).T
        return np.stack([self._nearest(column) for column in columns], axis=1).reshape(self.count, *values.shape[1:])

    @cached_property
    def _nearest(self) -> Callable[[np.ndarray], np.ndarray]:
        return self.factored(self.values[0], np.zeros_like(self.values[0]))

    def remainder(self, values: np.ndarray) -> np.ndarray:
        """What the least-squares spline leaves of values (M, ...)."""
        own = self.nearest(values)[self.first[:, None] + np.arange(_ORDER)]
        return values - np.einsum("mf,mf...->m...", self.values[0], own)

    def factored(self, rows: np.ndarray, small: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Coefficients (k,) of least squares ``rows c = values`` by values (M,), beside ``small c = 0``.

        Both kinds of rows (M, 6) multiply the six functions at each time. Of rows that are not finite there are none: NaN.
        """
        rows, nothing = kernel_input(rows), np.zeros((len(rows), 0))
        band, beside = (_normal_equations(self.first, kernel_input(own), nothing, self.count)[0] for own in (rows, small))
        band += beside
        # A whisper of ridge keeps the outermost functions, of which only a tail lies in the data, determined.
        band[-1] += 1e-14 * band[-1].max()
        factor, failed = _factor_banded(band)
        if failed:
            return lambda _: np.full(self.count, np.nan)
        return lambda values: _solve_factored(factor, _along(self.first, rows, kernel_input(values), self.count))[0]

    def newton_step(self, bent: np.ndarray, pull: np.ndarray) -> Callable[[float], np.ndarray]:
        """Change of coefficients (k,) that makes a sum over the times least, by damping: a share that the diagonal grows by.

        ``bent`` are the sum's second derivatives with respect to position twice, position and acceleration, acceleration twice
        (3, M), and ``pull`` the first ones with respect to position and acceleration, with the opposite sign (2, M).
        """
        band, right = _bent_sums(self.first, self.values, bent, pull, self.count)
        whisper = 1e-14 * band[-1].max()

        def step(damping: float) -> np.ndarray:
            damped = band.copy()
            damped[-1] += damping * band[-1] + whisper
            _, solved, failed = _solve_banded(damped, right)  # LAPACK itself, as above
            if failed:
                raise np.linalg.LinAlgError(f"{failed}th leading minor not positive definite")
            return solved

        return step


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _living(times, first, spacing, count, polynomials):
    """The first of the six functions that live at each time (N,), and the values of the six (N, 6)."""
    living, values = np.empty(len(times), np.int64), np.empty((len(times), 6))
    for sample in range(len(times)):
        position = times[sample] / spacing - first
        k = min(max(int(position), 0), count - 6)
        living[sample] = k
        for f in range(6):
            total = polynomials[f, 5]
            for power in range(4, -1, -1):
                total = total * (position - k) + polynomials[f, power]
            values[sample, f] = total
    return living, values


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _normal_equations(living, rows, values, count):
    """Upper banded Gram matrix (6, count) of rows (N, 6), each of functions from its first one on, and right sides (count, n)."""
    band, right = np.zeros((6, count)), np.zeros((count, values.shape[1]))
    for sample in range(len(living)):
        k = living[sample]
        for i in range(6):
            for j in range(i, 6):
                band[5 + i - j, k + j] += rows[sample, i] * rows[sample, j]
            for column in range(values.shape[1]):
                right[k + i, column] += rows[sample, i] * values[sample, column]
    return band, right


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bent_sums(first, values, bent, pull, count):
    """Upper banded matrix (6, count) and right side (count,) of `Splines.newton_step`."""
    band, right = np.zeros((6, count)), np.zeros(count)
    for sample in range(len(first)):
        k, position, acceleration = first[sample], values[0, sample], values[2, sample]
        for i in range(6):
            one = bent[0, sample] * position[i] + bent[1, sample] * acceleration[i]
            other = bent[1, sample] * position[i] + bent[2, sample] * acceleration[i]
            for j in range(i, 6):
                band[5 + i - j, k + j] += one * position[j] + other * acceleration[j]
            right[k + i] += pull[0, sample] * position[i] + pull[1, sample] * acceleration[i]
    return band, right


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _along(first, rows, values, count):
    """Products of values (N,) with every function (count,), of rows (N, 6), each of functions from its first one on."""
    out = np.zeros(count)
    for sample in range(len(first)):
        for i in range(6):
            out[first[sample] + i] += rows[sample, i] * values[sample]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(first, values, coefficients):
    """Sums of coefficients (k,) of the six functions that live at each time (3, N), with values (3, N, 6)."""
    out = np.empty(values.shape[:2])
    for order in range(values.shape[0]):
        for sample in range(len(first)):
            v, k = values[order, sample], first[sample]
            even = v[0] * coefficients[k] + v[2] * coefficients[k + 2] + v[4] * coefficients[k + 4]
            odd = v[1] * coefficients[k + 1] + v[3] * coefficients[k + 3] + v[5] * coefficients[k + 5]
            out[order, sample] = even + odd
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _residual_power(living, rows, positions, coefficients):
    """Sums of squares of positions less the spline's (n,)."""
    power, left = np.zeros(positions.shape[1]), np.zeros(positions.shape[1])
    for sample in range(len(living)):
        left[:] = positions[sample]
        for f in range(6):
            for joint in range(len(left)):
                left[joint] -= rows[sample, f] * coefficients[living[sample] + f, joint]
        for joint in range(len(left)):
            power[joint] += left[joint] * left[joint]
    return power


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(times, coefficients, first, spacing, polynomials):
    n, count = coefficients.shape[1], coefficients.shape[0]
    q, v, a = np.empty((len(times), n)), np.empty((len(times), n)), np.empty((len(times), n))
    # All six functions at once, so that the loops over them compile to vector instructions.
    value, slope, bend, by_power = np.empty(6), np.empty(6), np.empty(6), polynomials.T.copy()
    for sample in range(len(times)):
        position = times[sample] / spacing - first
        k = min(max(int(position), 0), count - 6)
        u = position - k
        for f in range(6):
            value[f], slope[f], bend[f] = by_power[5, f], 0.0, 0.0
        for power in range(4, -1, -1):
            for f in range(6):
                bend[f] = bend[f] * u + slope[f]
                slope[f] = slope[f] * u + value[f]
                value[f] = value[f] * u + by_power[power, f]
        for f in range(6):
            slope[f] *= 1.0 / spacing
            bend[f] *= 2.0 / spacing**2
        for joint in range(n):
            x, y, z = 0.0, 0.0, 0.0
            for f in range(6):
                c = coefficients[k + f, joint]
                x += value[f] * c
                y += slope[f] * c
                z += bend[f] * c
            q[sample, joint], v[sample, joint], a[sample, joint] = x, y, z
    return q, v, a
