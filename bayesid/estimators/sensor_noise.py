"""The sensor's noise apart from what encoder errors add to the residuals, by Whittle's likelihood.

Residuals are ``e - U b``: sensor noise e, and encoder noise through the dynamics, whose spectrum ``S_u`` is known from
simulation. With the periodogram P of the residuals, each channel's sensor spectrum is the smooth curve

    log S(f) = a_0 + 2 sum_k a_k cos(2 pi k f)      ([Bloomfield1973]_),

that maximises ``-sum_f [log(S + S_u) + P / (S + S_u)]`` [Whittle1953]_; the number of terms is Schwarz's choice. A plain
difference of spectra would be negative wherever encoder noise dominates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import minimize

from bayesid.signals.autoregression import moving_average
from bayesid.signals.noise import NoiseModel

_TERMS = (0, 1, 2, 4)
_GRID = 512
#: Order of the recursion that stands for the curve; four cosines need no more.
_ORDER = 12
_DEEPEST = 1e-3
#: Power of the residuals as a share of what encoder errors add, at least: of a fit that leaves none.
_LEAST = 1e-12


def sensor_noise(
    residuals: Sequence[np.ndarray],
    encoder: Sequence[Sequence[np.ndarray]],
    spread: Sequence[np.ndarray],
    known_poles: np.ndarray | None = None,
    coloured: bool = True,
) -> NoiseModel:
    """Noise of the sensor alone, from residuals (k, channels) and draws of what encoder noise adds to them, by recording.

    ``spread`` (k, channels, p) is ``X L`` with ``L L'`` the covariance of the parameters, which gives back what the fit took
    from the residuals. ``known_poles`` are those of the filter that the rows passed, from the zero state. Rows that are not
    consecutive are not ``coloured``.
    """
    known = np.array([1.0]) if known_poles is None else np.real(np.poly(known_poles))
    rows = [moving_average(known, r) for r in residuals]
    channels = rows[0].shape[1]
    grid = _GRID if coloured else 1
    power, count = np.zeros((grid, channels, channels)), sum(len(r) for r in rows)
    for r in rows:
        power += _cross_spectrum(r[:, :, None], grid)
    for s in spread:
        power += _cross_spectrum(moving_average(known, s), grid)
    added, drawn = np.zeros_like(power), 0
    for draw in encoder:
        for r in draw:
            added += _cross_spectrum(moving_average(known, r)[:, :, None], grid)
            drawn += len(r)
    power, added = power / count, added / max(drawn, 1)
    curves = np.array([_curve(power[:, c, c], added[:, c, c], count if coloured else 0) for c in range(channels)])
    polynomials, scales = zip(*(_recursion(s, min(_ORDER, grid - 1)) for s in curves), strict=True)
    # Wiener's weights leave what is mostly the sensor's; from that, how its channels go together.
    weight = np.sqrt(curves) / (curves + np.einsum("fcc->cf", added))
    mix = np.einsum("cf,fcd,df->cd", weight, power - added, weight)
    share = np.einsum("cf,df->cd", weight * np.sqrt(curves), weight * np.sqrt(curves))
    correlation = np.clip(mix / np.maximum(share, 1e-300), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    correlation = (vectors * np.maximum(values, 1e-3)) @ vectors.T
    size = np.sqrt(scales / np.diag(correlation))
    coefficients = np.array([np.convolve(known, a) for a in polynomials])
    return NoiseModel(coefficients, correlation * np.outer(size, size), from_zero=known_poles is not None)


def _cross_spectrum(rows: np.ndarray, grid: int) -> np.ndarray:
    """Real part of the tapered cross-periodogram times the number of rows (grid, c, c); with grid 1, plain products."""
    if grid == 1:
        return np.einsum("tcp,tdp->cd", rows, rows)[None]
    # Encoder noise rises with the fourth power of frequency: without a taper it would leak to low ones.
    taper = np.sin(np.pi * (np.arange(len(rows)) + 0.5) / len(rows))
    size = 2 * grid * max(int(np.ceil(len(rows) / (2 * grid))), 1)
    spectrum = np.fft.rfft(rows * (taper / np.sqrt(np.mean(taper**2)))[:, None, None], n=size, axis=0)[1:]
    fine = np.real(np.einsum("fcp,fdp->fcd", spectrum, spectrum.conj()))
    return fine.reshape(grid, -1, *fine.shape[1:]).mean(axis=1)


def _curve(power: np.ndarray, added: np.ndarray, rows: int) -> np.ndarray:
    """Sensor spectrum of one channel on the grid; ``rows`` 0: one number."""
    grid = len(power)
    scale = max(power.mean(), _LEAST * added.mean(), 1e-200)
    power, added = power / scale, added / scale
    angle = np.pi * (np.arange(grid) + 1) / grid
    # Grid points are closer than a periodogram's independent frequencies, of which there are rows / 2.
    weight = 0.5 * max(rows, 1) / grid
    best, chosen, start = np.inf, np.ones(grid), np.array([np.log(max(0.5 * np.median(power), 1e-12))])
    for terms in _TERMS if rows else (0,):
        basis = np.column_stack([np.ones(grid), *(2 * np.cos(k * angle) for k in range(1, terms + 1))])
        start = np.append(start, np.zeros(terms + 1 - len(start)))

        def misfit(a: np.ndarray, basis=basis) -> tuple[float, np.ndarray]:
            s = np.exp(np.clip(basis @ a, -40.0, 40.0))
            total = s + added
            slope = s / total * (1.0 - power / total)
            return weight * float(np.sum(np.log(total) + power / total)), weight * basis.T @ slope

        found = minimize(misfit, start, jac=True, method="L-BFGS-B")
        start = found.x
        score = 2.0 * found.fun + (terms + 1) * np.log(max(rows, 2))
        if score < best:
            best, chosen = score, np.exp(np.clip(basis @ found.x, -40.0, 40.0))
    # A recursion cannot follow a deeper notch, and no sensor has one.
    return scale * np.maximum(chosen, _DEEPEST * chosen.max())


def _recursion(curve: np.ndarray, order: int) -> tuple[np.ndarray, float]:
    """Whitening polynomial and innovation variance of a spectrum."""
    if order < 1:
        return np.array([1.0]), float(curve.mean())
    whole = np.concatenate([curve[:1], curve, curve[-2::-1]])
    values = np.real(np.fft.ifft(whole))[: order + 1]
    rest = solve_toeplitz(values[:order], -values[1:])
    return np.append(1.0, rest), float(values[0] + values[1:] @ rest)
