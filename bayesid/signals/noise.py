"""The noise of the rows: correlated in time and between channels; whitening, colouring, estimation.

Each channel's noise is autoregressive, and the innovations of the channels are correlated,

    e_c(t) = sum_k a_ck e_c(t - k) + u_c(t),    cov u = S   (channels x channels).

Rows that passed the low-pass filters start from the zero state together with the filter, and carry its
poles as known factors of the recursion; other rows start in the stationary state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter

#: Orders tried; the smallest score of Schwarz's criterion wins.
ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)


@dataclass(frozen=True)
class NoiseModel:
    """Autoregressive noise with correlated innovations.

    Attributes
    ----------
    coefficients
        Whitening polynomial of each channel, ``1, -a_c1, ..., -a_cp`` (channels, p + 1).
    innovation
        Covariance S of the innovations (channels, channels), squared units of the channels.
    from_zero
        Whether the noise starts from the zero state (filtered rows) or is stationary.
    """

    coefficients: np.ndarray
    innovation: np.ndarray
    from_zero: bool = False

    @property
    def order(self) -> int:
        """Order of the recursion."""
        return self.coefficients.shape[1] - 1

    @property
    def std(self) -> np.ndarray:
        """Stationary standard deviation of each channel's rows (c,)."""
        return np.sqrt(np.diag(self.innovation) * [_autocovariance(a, 0)[0] for a in self.coefficients])

    def uncoloured(self) -> NoiseModel:
        """The same size of noise without its colour, for rows that are not consecutive."""
        return NoiseModel(np.ones((len(self.std), 1)), np.diag(self.std**2))

    def whiten(self, rows: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        """Turn rows with this noise into rows with white noise of unit variance.

        Parameters
        ----------
        rows
            Consecutive rows (k, channels, ...).
        before
            The ``order`` rows before them, or all there are since the recording's start; None at the start.
        """
        if before is not None and len(before) < self.order:  # the start is still within reach
            return self.whiten(np.concatenate([before, rows]))[len(before) :]
        lower = cholesky(self.innovation, lower=True)
        white = self._recursion(rows, before)
        return _mix(np.linalg.inv(lower), white)

    def _recursion(self, rows, before):
        p = self.order
        if p == 0:
            return np.asarray(rows, float)
        tail = (slice(None),) + (None,) * (rows.ndim - 2)
        padded = np.concatenate([np.zeros((p, *rows.shape[1:])) if before is None else before[-p:], rows])
        out = padded[p:].copy()
        for k in range(1, p + 1):
            out += self.coefficients[:, k][tail] * padded[p - k : len(padded) - k]
        if before is None and not self.from_zero:
            first = min(p, len(rows))
            for c, factor in enumerate(self._start(first)):
                head = rows[:first, c].reshape(first, -1)
                out[:first, c] = solve_triangular(factor, head, lower=True).reshape(out[:first, c].shape)
        return out

    def _start(self, first: int) -> list[np.ndarray]:
        """Cholesky factors of each channel's first rows, in units of its innovation."""
        return [cholesky(toeplitz(_autocovariance(a, first - 1)), lower=True) for a in self.coefficients]

    def colour_transposed(self, rows: np.ndarray) -> np.ndarray:
        """Rows Z with ``Z'Z = X' Sigma X`` for one whole recording X (k, channels, ...)."""
        z = _mix(cholesky(self.innovation, lower=True).T, np.asarray(rows, float)) if self.order == 0 else None
        if z is not None:
            return z
        p = self.order
        z = np.empty(rows.shape)
        for c, a in enumerate(self.coefficients):
            z[:, c] = lfilter([1.0], a, rows[::-1, c], axis=0)[::-1]
        if not self.from_zero:
            first = min(p, len(rows))
            for c, factor in enumerate(self._start(first)):
                a, later = self.coefficients[c], z[first : first + p, c]
                head = rows[:first, c].astype(float)
                for t in range(first):
                    for k in range(max(first - t, 1), p + 1):
                        if t + k - first < len(later):
                            head[t] -= a[k] * later[t + k - first]
                z[:first, c] = (factor.T @ head.reshape(first, -1)).reshape(head.shape)
        return _mix(cholesky(self.innovation, lower=True).T, z)


def estimate_noise(
    residuals: Sequence[np.ndarray],
    parameters: int = 0,
    known_poles: np.ndarray | None = None,
    highest_order: int = 24,
    spread: Sequence[np.ndarray] | None = None,
) -> NoiseModel:
    """Estimate the noise from the residuals of recordings.

    Burg's method per channel over all recordings, one order for all channels by Schwarz's criterion. What the
    fitted parameters took from the residuals is given back.

    Parameters
    ----------
    residuals
        One array a recording (k, channels).
    parameters
        How many parameters were fitted to these rows; not used with ``spread``.
    known_poles
        Poles of the filter that the rows passed, from the zero state.
    highest_order
        Highest order tried.
    spread
        One array a recording (k, channels, p): ``X L`` where ``L L'`` is the covariance of the parameters in an
        efficient fit.

    Notes
    -----
    Residuals r of an efficient fit have covariance ``Sigma - X V X'``: noise is missing just where the robot
    moves, and a colour learned from them would call those frequencies quiet. ``r r' + X V X'`` has the right
    mean; repeated with the V of the last colour this is expectation and maximisation of the restricted
    likelihood [Dempster1977]_. Without ``spread`` all variances are enlarged alike.
    """
    known = np.array([1.0]) if known_poles is None else np.real(np.poly(known_poles))
    rows = [moving_average(known, r) for r in residuals]
    total, channels = sum(len(r) for r in rows), rows[0].shape[1]
    orders = [p for p in ORDERS if p <= min(highest_order, total // 10)] or [0]
    taken = [] if spread is None else [moving_average(known, z) for z in spread]
    fits = []
    for c in range(channels):
        own = [np.ascontiguousarray(z[:, c]) for z in taken]
        fits.append(_give_back(_burg([r[:, c] for r in rows], orders[-1]), own, total))
    polynomials, variances = zip(*fits, strict=True)
    scores = [
        total * sum(np.log(max(variances[c][p], 1e-300)) for c in range(channels)) + channels * p * np.log(total) for p in orders
    ]
    p = orders[int(np.argmin(scores))]
    coefficients = np.array([np.convolve(known, polynomials[c][p]) for c in range(channels)])
    shaped = NoiseModel(coefficients, np.eye(channels), from_zero=known_poles is not None)
    white = np.concatenate([shaped.whiten(r) for r in residuals])
    innovation = white.T @ white / len(white)
    if spread is None:
        innovation /= max(1.0 - parameters / white.size, 0.05)
    else:
        innovation += sum(np.einsum("tcj,tdj->cd", z, z) for z in map(shaped.whiten, spread)) / len(white)
    # A channel without any noise (noise-free simulations) must not make the covariance singular.
    scale = np.diag(innovation)
    innovation = innovation + np.diag(1e-10 * scale + 1e-20 * max(scale.max(), 1e-200))
    return NoiseModel(coefficients, innovation, from_zero=known_poles is not None)


def _burg(series: list[np.ndarray], order: int) -> tuple[list[np.ndarray], list[float]]:
    """Whitening polynomials of orders 0 ... order and their innovation variances, by Burg's recursion."""
    forward, backward = [s.copy() for s in series], [s.copy() for s in series]
    polynomial = np.array([1.0])
    variance = float(sum(s @ s for s in series)) / max(sum(len(s) for s in series), 1)
    polynomials, variances = [polynomial], [variance]
    for _ in range(order):
        pairs = [(f[1:], b[:-1]) for f, b in zip(forward, backward, strict=True)]
        power = float(sum(f @ f + b @ b for f, b in pairs))
        reflection = -2.0 * float(sum(f @ b for f, b in pairs)) / power if power > 0 else 0.0
        forward = [f + reflection * b for f, b in pairs]
        backward = [b + reflection * f for f, b in pairs]
        polynomial = _raised(polynomial, reflection)
        variance *= 1.0 - reflection**2
        polynomials.append(polynomial)
        variances.append(variance)
    return polynomials, variances


def _give_back(fits: tuple[list[np.ndarray], list[float]], taken: list[np.ndarray], rows: int):
    """Fits of `_burg` after adding the mean autocovariance of further series, one array (k, p) a recording.

    The polynomials of lower orders follow from the highest one's autocovariance by Levinson's recursion, which
    for Burg's own gives Burg's own back.
    """
    polynomials, variances = fits
    order = len(polynomials) - 1
    if not taken or variances[-1] <= 0:
        return fits
    values = variances[-1] * _autocovariance(polynomials[-1], order)
    for lag in range(order + 1):
        values[lag] += sum(np.vdot(z[lag:], z[: max(len(z) - lag, 0)]) for z in taken) / rows
    polynomial, variance = np.array([1.0]), float(values[0])
    polynomials, variances = [polynomial], [variance]
    for p in range(1, order + 1):
        reflection = -float(polynomial @ values[p:0:-1]) / variance
        polynomial = _raised(polynomial, reflection)
        variance *= 1.0 - reflection**2
        polynomials.append(polynomial)
        variances.append(variance)
    return polynomials, variances


def _raised(polynomial: np.ndarray, reflection: float) -> np.ndarray:
    """Levinson's step to the next order."""
    extended = np.append(polynomial, 0.0)
    return extended + reflection * extended[::-1]


def _autocovariance(polynomial: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariance at lags 0 ... lags of a stationary recursion with unit innovations."""
    p = len(polynomial) - 1
    # Yule-Walker: sum_k a_k g(|j - k|) = [j = 0], for j = 0 ... p.
    system = np.zeros((p + 1, p + 1))
    for j in range(p + 1):
        for k in range(p + 1):
            system[j, abs(j - k)] += polynomial[k]
    values = list(np.linalg.solve(system, np.eye(p + 1)[0]))
    while len(values) <= lags:
        values.append(-float(np.dot(polynomial[1:], values[-1 : -p - 1 : -1])))
    return np.array(values[: lags + 1])


def moving_average(polynomial: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Moving average along the first axis, from the zero state."""
    out = polynomial[0] * rows
    for k in range(1, len(polynomial)):
        out[k:] += polynomial[k] * rows[:-k]
    return out


def _mix(matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Apply a channels x channels matrix to rows (k, channels, ...)."""
    flat = rows.reshape(*rows.shape[:2], -1)
    return np.matmul(matrix, flat).reshape(rows.shape)
