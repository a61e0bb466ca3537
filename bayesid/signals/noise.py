"""The noise of the rows: correlated in time and between channels; whitening, colouring, estimation.

Each channel's noise is autoregressive, and the innovations of the channels are correlated,

    e_c(t) = sum_k a_ck e_c(t - k) + u_c(t),    cov u = S   (channels x channels).

Rows that passed the low-pass filters start from the zero state together with the filter, and carry its
poles as known factors of the recursion; other rows start in the stationary state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter
from scipy.stats import norm, t

from bayesid.signals.autoregression import autocovariance, channel_products, fit, mix, moving_average

#: Orders tried; the smallest score of Schwarz's criterion wins.
ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)


@dataclass(frozen=True)
class NoiseModel:
    """Autoregressive noise with correlated innovations."""

    coefficients: np.ndarray  # whitening polynomial of each channel, ``1, -a_c1, ..., -a_cp`` (channels, p + 1)
    innovation: np.ndarray  # covariance S of the innovations (channels, channels), squared units of the channels
    from_zero: bool = False  # whether the noise starts from the zero state (filtered rows) or is stationary
    degrees: float = np.inf  # degrees of freedom that its size rests on, where these are few

    @classmethod
    def stated(cls, std: np.ndarray, known_poles: np.ndarray | None = None) -> NoiseModel:
        """Noise of known standard deviations (c,): white, or white noise that went through low-passes with these poles."""
        polynomial = np.array([1.0]) if known_poles is None else np.real(np.poly(known_poles))
        innovation = np.asarray(std, float) ** 2 / autocovariance(polynomial, 0)[0]
        return cls(np.tile(polynomial, (len(innovation), 1)), np.diag(innovation), from_zero=known_poles is not None)

    @property
    def order(self) -> int:
        """Order of the recursion."""
        return self.coefficients.shape[1] - 1

    @property
    def std(self) -> np.ndarray:
        """Stationary standard deviation of each channel's rows (c,)."""
        return np.sqrt(np.diag(self.innovation) * [autocovariance(a, 0)[0] for a in self.coefficients])

    def scaled(self, factor: float | np.ndarray) -> NoiseModel:
        """Noise of so many times the variance, the same for all channels or one for each (c,)."""
        root = np.broadcast_to(np.sqrt(factor), len(self.innovation))
        return replace(self, innovation=self.innovation * np.outer(root, root))

    def with_sure_correlations(self, rows: float) -> NoiseModel:
        """The same sizes, correlations of the channels shrunk by the share of their squares that chance makes of so few rows.

        Fewer rows than channels would make a combination of channels look noiseless [Schaefer2005]_.
        """
        size = np.sqrt(np.diag(self.innovation))
        correlation = self.innovation / np.outer(size, size)
        apart = ~np.eye(len(size), dtype=bool)
        squares = correlation[apart] ** 2
        chance = np.sum((1.0 - np.minimum(squares, 1.0)) ** 2) / max(rows - 1.0, 1.0)
        correlation[apart] *= 1.0 - min(chance / max(float(squares.sum()), 1e-300), 1.0)
        return replace(self, innovation=correlation * np.outer(size, size))

    def with_sure_sizes(self, rows: float, units: Sequence[str]) -> NoiseModel:
        """Variances of channels of the same unit brought together by the share of their differences that chance makes.

        Weighting by channel trusts what few rows happen to leave quiet. The logarithm of a variance that so many rows tell
        varies by 2 / rows; as correlations are shrunk, so are these, towards the mean variance [Schaefer2005]_, which rests on
        the rows of all of these channels.
        """
        size = np.diag(self.innovation)
        sure, degrees = size.copy(), np.inf
        for unit in dict.fromkeys(units):
            own = np.array([u == unit for u in units])
            apart, count = np.log(size[own]) - np.mean(np.log(size[own])), own.sum()
            kept = 1.0 - min(2.0 / rows * (count - 1) / max(float(np.sum(apart**2)), 1e-300), 1.0)
            ratio = np.exp(kept * apart)
            sure[own] = ratio * np.mean(size[own]) / np.mean(ratio)
            degrees = min(degrees, rows / (kept**2 + (1.0 - kept**2) / count))
        return replace(self.scaled(sure / size), degrees=degrees)

    def of_channel(self, channel: int) -> NoiseModel:
        """The noise of one channel alone."""
        only = slice(channel, channel + 1)
        return replace(self, coefficients=self.coefficients[only], innovation=self.innovation[only, only])

    def uncoloured(self) -> NoiseModel:
        """The same size of noise without its colour, for rows that are not consecutive."""
        return NoiseModel(np.ones((len(self.std), 1)), np.diag(self.std**2))

    def drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """So many consecutive rows of such noise (count, c)."""
        settled = 0 if self.from_zero or not self.order else 2000
        fresh = rng.normal(size=(count + settled, len(self.innovation))) @ cholesky(self.innovation, lower=True).T
        return np.stack([lfilter([1.0], a, u) for a, u in zip(self.coefficients, fresh.T, strict=True)], axis=1)[settled:]

    def whiten(self, rows: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        """Turn consecutive rows (k, channels, ...) with this noise into rows with white noise of unit variance.

        ``before`` are the ``order`` rows before them, or all there are since the recording's start; None at the start.
        """
        if before is not None and len(before) < self.order:  # the start is still within reach
            return self.whiten(np.concatenate([before, rows]))[len(before) :]
        return mix(np.linalg.inv(cholesky(self.innovation, lower=True)), self.innovations(rows, before))

    def innovations(self, rows: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        """The rows' innovations, channel by channel, with covariance S where `whiten` gives the identity."""
        p = self.order
        if p == 0:
            return np.asarray(rows, float)
        tail = (slice(None),) + (None,) * (rows.ndim - 2)
        padded = np.concatenate([np.zeros((p, *rows.shape[1:])) if before is None else before[-p:], rows])
        out = padded[p:].copy()
        for k in range(1, p + 1):
            out += self.coefficients[:, k][tail] * padded[p - k : len(padded) - k]
        if before is None and not self.from_zero:
            self._whiten_start(out, rows, min(p, len(rows)))
        return out

    def _start(self, first: int) -> list[np.ndarray]:
        """Cholesky factors of each channel's first rows, in units of its innovation."""
        return [cholesky(toeplitz(autocovariance(a, first - 1)), lower=True) for a in self.coefficients]

    def _whiten_start(self, out: np.ndarray, rows: np.ndarray, first: int, transposed: bool = False) -> None:
        """Whiten the first rows of a stationary recording, channel by channel, into ``out``."""
        for c, factor in enumerate(self._start(first)):
            head = rows[:first, c].reshape(first, -1)
            out[:first, c] = solve_triangular(factor, head, trans=int(transposed), lower=True).reshape(out[:first, c].shape)

    def whiten_transposed(self, white: np.ndarray) -> np.ndarray:
        """The transpose of `whiten` for a whole recording: ``sum(whiten_transposed(z) * x) = sum(z * whiten(x))``."""
        out = mix(np.linalg.inv(cholesky(self.innovation, lower=True)).T, white)
        p = self.order
        if p == 0:
            return out
        recursion, first = out.copy(), 0 if self.from_zero else min(p, len(out))
        # The first rows of a stationary start were not made by the recursion.
        recursion[:first] = 0.0
        if first:
            self._whiten_start(out, out, first, transposed=True)
        tail = (slice(None),) + (None,) * (out.ndim - 2)
        for k in range(1, p + 1):
            out[: len(out) - k] += self.coefficients[:, k][tail] * recursion[k:]
        return out

    def colour_transposed(self, rows: np.ndarray) -> np.ndarray:
        """Rows Z with ``Z'Z = X' Sigma X`` for one whole recording X (k, channels, ...)."""
        root, p = cholesky(self.innovation, lower=True).T, self.order
        if p == 0:
            return mix(root, np.asarray(rows, float))
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
        return mix(root, z)


def student_factor(degrees: np.ndarray | float) -> np.ndarray:
    """Factor of a variance that so many degrees of freedom tell, for Student's quantile in place of the normal one.

    Intervals of 95 % are 1.96 standard deviations on either side everywhere: a deviation that is not sure is made larger.
    """
    return np.asarray((t.ppf(0.975, degrees) / norm.ppf(0.975)) ** 2)


def noise_of_group(noise: Mapping[str, NoiseModel], group: str) -> NoiseModel:
    """The noise of a group of rows; of one that was not fitted, another's without its colour."""
    return noise[group] if group in noise else next(iter(noise.values())).uncoloured()


def memoryless(noise: Mapping[str, NoiseModel]) -> bool:
    """Whether no row's noise depends on the rows before it, for any group of rows."""
    return all(model.order == 0 for model in noise.values())


def estimate_noise(
    residuals: Sequence[np.ndarray],
    parameters: int = 0,
    known_poles: np.ndarray | None = None,
    highest_order: int = 24,
    spread: Sequence[np.ndarray] | None = None,
) -> NoiseModel:
    """Estimate the noise from the residuals of recordings, one array each (k, channels).

    Burg's method per channel over all recordings, one order for all channels, up to a highest, by Schwarz's criterion.
    ``known_poles`` are those of the filter that the rows passed, from the zero state. What the fitted parameters took from the
    residuals is given back: residuals r of an efficient fit have covariance ``Sigma - X V X'``, so that noise is missing just
    where the robot moves, and a colour learned from them would call those frequencies quiet. ``r r' + X V X'`` has the right
    mean; repeated with the V of the last colour this is expectation and maximisation of the restricted likelihood
    [Dempster1977]_. For it ``spread`` has ``X L`` of each recording (k, channels, p), with V = L L'. Without it all variances are
    enlarged alike, by how many ``parameters`` were fitted to these rows.
    """
    known = np.array([1.0]) if known_poles is None else np.real(np.poly(known_poles))
    rows = [moving_average(known, r) for r in residuals]
    total, channels = sum(len(r) for r in rows), rows[0].shape[1]
    orders = [p for p in ORDERS if p <= min(highest_order, total // 10)] or [0]
    taken = [] if spread is None else [moving_average(known, z) for z in spread]
    polynomials, variances = fit(rows, orders[-1], taken)
    scores = [total * np.sum(np.log(np.maximum(variances[:, p], 1e-300))) + channels * p * np.log(total) for p in orders]
    p = orders[int(np.argmin(scores))]
    coefficients = np.array([np.convolve(known, polynomials[c, p, : p + 1]) for c in range(channels)])
    shaped = NoiseModel(coefficients, np.eye(channels), from_zero=known_poles is not None)
    white = np.concatenate([shaped.innovations(r) for r in residuals])
    innovation = white.T @ white / len(white)
    if spread is None:
        innovation /= max(1.0 - parameters / white.size, 0.05)
    else:
        innovation += sum(channel_products(shaped.innovations(z)) for z in spread) / len(white)
    # A channel without any noise (noise-free simulations) must not make the covariance singular.
    scale = np.diag(innovation)
    innovation = innovation + np.diag(1e-10 * scale + 1e-20 * max(scale.max(), 1e-200))
    return NoiseModel(coefficients, innovation, from_zero=known_poles is not None)
