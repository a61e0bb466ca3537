"""Gibbs sampling with exact Hamiltonian trajectories inside the cone of bodies that can exist.

Given the scales (and Student's weights), the linear parameters are Gaussian, cut by the walls: one exact trajectory
(`bayesid.posterior.trajectory`) moves them, or a direct draw where there are no walls. Then

    s_c^2 | ... ~ IG(shape + n_c / 2, rate + sum_t w_t r_ct^2 / 2),
    w_t | ... ~ Gamma((nu + C) / 2, rate (nu + sum_c (r_ct / s_c)^2) / 2),

with C channels an instant; nu comes before the weights and without them (slice sampling [Neal2003]_).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import get_blas_funcs, get_lapack_funcs

from bayesid.posterior.likelihood import log_student
from bayesid.posterior.model import PosteriorModel, Quadratic
from bayesid.posterior.trajectory import travel

_WARM_UP = 100
_SLICE_STEP = 0.5

(_OUTER_PRODUCT,), (_SOLVE_TRIANGULAR,) = get_blas_funcs(("syrk",), dtype="d"), get_lapack_funcs(("trtrs",), dtype="d")


@dataclass(eq=False)
class GibbsState:
    """State of a chain; sweeps move it on in place."""

    x: np.ndarray  # linear parameters in the sampler's coordinates (d,)
    #: Of the noise (k,).
    scales: np.ndarray
    dof: float
    rng: np.random.Generator  # the chain's own generator
    #: Reflections so far, and trajectories that were given up.
    bounces: float = 0.0
    lost: float = 0.0


@dataclass(frozen=True, eq=False)
class ReflectiveGibbs:
    """Sampler ``hmc``: exact, without tuning; every chain is one point."""

    model: PosteriorModel
    name: ClassVar[str] = "hmc"
    walkers: ClassVar[int] = 1
    thin: ClassVar[int] = 1
    state_type: ClassVar = GibbsState

    def start(self, rng: np.random.Generator) -> GibbsState:
        """A state inside all walls, after a warm-up of a hundred sweeps."""
        model = self.model
        x = model.interior(rng)
        scales = np.ones(len(model.likelihood.names)) * (1.0 if model.scale_prior.known else np.exp(0.2 * rng.normal()))
        dof = model.dof_prior.fixed or float(np.exp(rng.normal(1.5, 0.3)))
        state = GibbsState(x, scales, dof, rng)
        for _ in range(_WARM_UP):
            self._sweep(state)
        state.bounces = state.lost = 0.0
        return state

    def advance(self, state: GibbsState, count: int, thin: int) -> np.ndarray:
        """Draws (count, 1, names) ``thin`` sweeps apart; the state moves on."""
        model = self.model
        out = np.empty((count, 1, len(model.names)))
        d = len(model.linear_names)
        for i in range(count):
            for _ in range(thin):
                self._sweep(state)
            out[i, 0, :d] = model.from_entries @ state.x
            if not model.scale_prior.known:
                out[i, 0, d : d + len(state.scales)] = state.scales
            if model.dof_free:
                out[i, 0, -1] = state.dof
        return out

    # ---- one sweep ------------------------------------------------------------------------------------------

    @cached_property
    def _maps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sampler's coordinates of z = 0 (d,), the map from z (d, d) and its inverse."""
        q = self.model.quadratic
        outward = self.model.entries @ q.root
        return self.model.entries @ q.centre, outward, np.linalg.inv(outward)

    @cached_property
    def _rows(self) -> _WhitenedRows:
        return _WhitenedRows(self.model)

    @cached_property
    def _fixed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The Gaussian at known scales, which never changes."""
        return self._gaussian(self.model.quadratic, np.ones(len(self.model.likelihood.names)))

    def _gaussian(self, terms: Quadratic, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean in z and x, and a root of the covariance in x."""
        mean, lower = terms.gaussian(scales**-2)
        centre, outward, _ = self._maps
        return mean, centre + outward @ mean, np.ascontiguousarray(_SOLVE_TRIANGULAR(lower, outward.T, lower=1)[0].T)

    def _sweep(self, state: GibbsState) -> None:
        model, rng = self.model, state.rng
        centre, _, inward = self._maps
        terms, counts = model.quadratic, model.likelihood.counts
        if model.noise == "student":
            squares = self._rows.squares(inward @ (state.x - centre), state.scales)
            if model.dof_free:
                squares = self._dof(state, squares)
            terms = self._rows.weighted(squares, state.dof, rng)
        if model.scale_prior.known and model.noise == "gaussian":
            _, mean, root = self._fixed
        else:
            _, mean, root = self._gaussian(terms, state.scales)
        step = root @ rng.normal(size=len(mean))
        if model.bodies or len(model.bounded):
            bounces = travel(state.x, step, mean, root, model.bodies, model.bounded)
            state.lost += bounces < 0
            state.bounces += max(bounces, 0)
        else:
            state.x = mean + step
        if not model.scale_prior.known:
            squares = terms.squares(inward @ (state.x - centre))[:-1]
            prior = model.scale_prior
            shape, rate = prior.shape + 0.5 * counts, prior.rate + 0.5 * np.maximum(squares, 0.0)
            state.scales = np.sqrt(rate / rng.gamma(shape))

    def _dof(self, state: GibbsState, squares: list[np.ndarray]) -> list[np.ndarray]:
        """Slice sampling of log nu with its law given the residuals alone; returns them in units of the new scales.

        Once with the scales held, once with ``s^2 (1 + 2 / nu)`` held, which is about the variance: nu and the scales
        depend on each other strongly. Both are shifts of log s, of unit Jacobian.
        """
        model, prior, rng = self.model, self.model.dof_prior, state.rng
        for along in (0.0, 0.0 if model.scale_prior.known else 1.0):
            now, logs = np.log(state.dof), np.log(state.scales)

            def shift(log: float, now: float = now, along: float = along) -> float:
                return -0.5 * along * (np.log1p(2.0 * np.exp(-log)) - np.log1p(2.0 * np.exp(-now)))

            def density(log: float, shift=shift, logs: np.ndarray = logs, squares=squares) -> float:
                nu, by = float(np.exp(log)), shift(log)
                inner = np.exp(-2.0 * by)
                rows = sum(float(np.sum(log_student(s * inner, self._rows.channels, nu))) for s in squares)
                rows -= by * float(model.likelihood.counts.sum())
                if not model.scale_prior.known:
                    rows += float(model.scale_prior.log_density(logs + by))
                return rows + prior.shape * log - prior.rate * nu

            new = slice_step(density, now, rng)
            by = shift(new)
            state.dof = float(np.exp(new))
            state.scales = state.scales * np.exp(by)
            squares = [s * np.exp(-2.0 * by) for s in squares]
        return squares


def slice_step(density: Callable[[float], float], now: float, rng: np.random.Generator) -> float:
    """One step of slice sampling with stepping out and shrinking [Neal2003]_."""
    level = density(now) - rng.exponential()
    low = now - _SLICE_STEP * rng.uniform()
    high = low + _SLICE_STEP
    while density(low) > level:
        low -= _SLICE_STEP
    while density(high) > level:
        high += _SLICE_STEP
    while True:
        new = rng.uniform(low, high)
        if density(new) > level:
            return float(new)
        low, high = (new, high) if new < now else (low, new)


class _WhitenedRows:
    """Whitened rows in well-conditioned columns, for Student's weights."""

    def __init__(self, model: PosteriorModel):
        self.model = model
        stacked = np.concatenate([f[:, :-1] for f in model.likelihood.factors])
        length = np.linalg.norm(stacked, axis=0)
        # Columns that nothing is said about stay zero.
        scale = 1.0 / np.where(length > 0, length, 1.0)
        factor = np.asarray(np.linalg.qr(stacked * scale, mode="r"))
        _, s, vt = np.linalg.svd(factor)
        keep = s > 1e-13 * s[0]
        turn = scale[:, None] * vt[keep].T / s[keep]
        columns = model.to_columns @ model.quadratic.centre
        # (channels, N, p + 1), a channel's rows side by side.
        self.rows = [
            np.ascontiguousarray(np.swapaxes(np.concatenate(
                [w[:, :, :-1] @ turn, (w[:, :, -1] - w[:, :, :-1] @ columns)[:, :, None]], axis=2), 0, 1))
            for w in model.likelihood.white
        ]  # fmt: skip
        # turn @ onward = (columns of z), exactly where the rows say something.
        self.onward = (vt[keep] * s[keep][:, None] / scale) @ model.to_columns @ model.quadratic.root
        self.channels = len(self.rows[0])

    def squares(self, z: np.ndarray, scales: np.ndarray) -> list[np.ndarray]:
        """Squared lengths of every instant's residual in units of the scales, by group."""
        at = np.append(-(self.onward @ z), 1.0)
        parts = np.split(scales, len(self.rows))
        return [np.sum((rows @ at / s[:, None]) ** 2, axis=0) for rows, s in zip(self.rows, parts, strict=True)]

    def weighted(self, squares: list[np.ndarray], dof: float, rng: np.random.Generator) -> Quadratic:
        """Draw the weights and form the terms of the Gaussian anew."""
        gram, linear, constant = [], [], []
        for rows, s in zip(self.rows, squares, strict=True):
            weight = rng.gamma(0.5 * (dof + self.channels), size=len(s)) / (0.5 * (dof + s))
            weighted = rows * np.sqrt(weight)[:, None]
            for one in weighted:
                whole = _OUTER_PRODUCT(1.0, one.T)  # the upper triangle
                whole = whole + np.triu(whole, 1).T
                gram.append(self.onward.T @ whole[:-1, :-1] @ self.onward)
                linear.append(whole[-1, :-1] @ self.onward)
                constant.append(whole[-1, -1])
        q = self.model.quadratic
        return Quadratic(
            q.centre, q.root, np.array([*gram, q.gram[-1]]), np.array([*linear, q.linear[-1]]),
            np.array([*constant, q.constant[-1]]),
        )  # fmt: skip
