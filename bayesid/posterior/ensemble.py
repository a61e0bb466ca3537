"""emcee [Foreman2013]_ with an independence move from the Laplace approximation.

Stretch and differential-evolution moves alone fail in 40 to 60 dimensions. This posterior is nearly Gaussian in
(z, log s), so proposals drawn from the Gaussian at its mode, whatever the walker's place, are accepted most of the time:
a Metropolis-Hastings step with the weight ``p / q`` [Tierney1994]_. One step in ten is one of differential evolution
[TerBraak2006]_, which needs no approximation at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import emcee
import numpy as np
from emcee.moves import DEMove, Move, StretchMove
from numpy.random import mtrand
from scipy.linalg import cho_solve, solve_triangular

from bayesid.errors import InputError, require_one_of
from bayesid.posterior.model import PosteriorModel

MOVES = ("laplace", "de", "stretch")
#: Stretch and differential evolution alone are refused above this many dimensions.
MOST_DIMENSIONS = 25
_WARM_UP = 60
_WARM_UP_ALONE = 1000


@dataclass(eq=False)
class EnsembleState:
    """State of an ensemble; steps move it on in place."""

    #: Walkers in (z, log scales) (w, d), and the logarithm of their density (w,).
    points: np.ndarray
    log_density: np.ndarray
    random: Any  # state of emcee's generator


class LaplaceMove(Move):
    """Proposals from a fixed Gaussian for all walkers at once: its mean (d,) and the lower L with precision ``L L'`` (d, d)."""

    def __init__(self, mean: np.ndarray, lower: np.ndarray):
        self.mean, self.lower = mean, lower

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """One Metropolis-Hastings step of every walker."""
        count, d = state.coords.shape
        draw = model.random.randn(count, d)
        points = self.mean + solve_triangular(self.lower.T, draw.T).T
        new, _ = model.compute_log_prob_fn(points)
        before = (state.coords - self.mean) @ self.lower
        ratio = new - state.log_prob + 0.5 * np.sum(draw**2, axis=1) - 0.5 * np.sum(before**2, axis=1)
        accepted = np.log(model.random.rand(count)) < ratio
        state.coords[accepted] = points[accepted]
        state.log_prob[accepted] = new[accepted]
        return state, accepted


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Sampler ``emcee``; a chain is a whole ensemble of walkers, which are no chains of their own."""

    model: PosteriorModel
    moves: str = "laplace"  # ``laplace`` (with differential evolution one step in ten), ``de`` or ``stretch`` alone
    thin: int = 4
    name: ClassVar[str] = "emcee"
    state_type: ClassVar = EnsembleState

    def __post_init__(self) -> None:
        require_one_of(self.moves, MOVES, f"moves '{self.moves}'")
        if self.moves != "laplace" and self.dimensions > MOST_DIMENSIONS:
            raise InputError(
                f"moves '{self.moves}' alone do not mix in {self.dimensions} dimensions (at most {MOST_DIMENSIONS}); "
                "use 'laplace'"
            )
        if self.model.noise == "student":
            raise InputError("engine 'emcee' takes Gaussian noise only; use engine 'hmc' for Student's t")

    @property
    def dimensions(self) -> int:
        """Number of coordinates of a walker: linear parameters and log scales."""
        return len(self.model.linear_names) + len(self.model.scale_names)

    @property
    def walkers(self) -> int:
        """Number of walkers in an ensemble, even and above twice the dimensions."""
        return 2 * self.dimensions + 2

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Log density of walkers (w, z and log scales), minus infinity outside the bounds (w,)."""
        model, d = self.model, len(self.model.linear_names)
        z, logs = points[:, :d], points[:, d:]
        squares = model.quadratic.squares(z)
        out = -0.5 * squares[:, -1]
        if model.scale_prior.known:
            out = out - 0.5 * squares[:, :-1].sum(axis=1)
        else:
            out = out - logs @ model.likelihood.counts - 0.5 * np.sum(squares[:, :-1] * np.exp(-2.0 * logs), axis=1)
            out = out + model.scale_prior.log_density(logs)
        if model.bodies or len(model.bounded):
            out = np.where(model.inside(self._linear(z)), out, -np.inf)
        return out

    def _linear(self, z: np.ndarray) -> np.ndarray:
        return self.model.quadratic.centre + z @ self.model.quadratic.root.T

    @cached_property
    def laplace(self) -> tuple[np.ndarray, np.ndarray]:
        """Mode of (z, log s) without its bounds, and the root of the negative Hessian there.

        The scales are those at the mode of their marginal density, with z integrated out, ``s_c^2 = (|r_c|^2 + tr(G_c V)) /
        n_c``: the joint mode's are a little too small, by what z takes from the residuals.
        """
        model, q = self.model, self.model.quadratic
        counts, prior = model.likelihood.counts, model.scale_prior
        weights = np.ones(len(counts))
        for _ in range(200):
            z, lower = q.gaussian(weights)
            if prior.known:
                break
            covariance = cho_solve((lower, True), np.eye(len(z)))
            taken = np.einsum("kij,ij->k", q.gram[:-1], covariance)
            new = (counts + 2.0 * prior.shape) / (q.squares(z)[:-1] + taken + 2.0 * prior.rate)
            done, weights = np.max(np.abs(new / weights - 1.0)) < 1e-12, new
            if done:
                break
        z, _ = q.gaussian(weights)
        d = len(z)
        hessian = np.zeros((self.dimensions, self.dimensions))
        hessian[:d, :d] = np.tensordot(np.append(weights, 1.0), q.gram, 1)
        if not prior.known:
            slope = q.gram[:-1] @ z - q.linear[:-1]  # half the gradient of each square
            hessian[d:, :d] = -2.0 * weights[:, None] * slope
            hessian[:d, d:] = hessian[d:, :d].T
            hessian[d:, d:] = np.diag(2.0 * weights * (q.squares(z)[:-1] + 2.0 * prior.rate))
        logs = np.zeros(0) if prior.known else -0.5 * np.log(weights)
        return np.append(z, logs), np.linalg.cholesky(hessian)

    def start(self, rng: np.random.Generator) -> EnsembleState:
        """Walkers around the mode, wider than the posterior, inside the bounds."""
        mean, lower = self.laplace
        points = np.empty((0, self.dimensions))
        for width in np.geomspace(1.5, 1e-3, 60):
            draws = rng.normal(size=(self.dimensions, 8 * self.walkers))
            new = mean + width * solve_triangular(lower.T, draws).T
            points = np.concatenate([points, new[np.isfinite(self.log_density(new))]])
            if len(points) >= self.walkers:
                break
        else:
            raise InputError("engine 'emcee' finds no start inside the bounds; use engine 'hmc'")
        points = points[: self.walkers]
        random = mtrand.RandomState(rng.integers(2**32)).get_state()  # emcee knows no other generator
        state = EnsembleState(points, self.log_density(points), random)
        self._run(state, 1, _WARM_UP if self.moves == "laplace" else _WARM_UP_ALONE)
        return state

    def advance(self, state: EnsembleState, count: int, thin: int) -> np.ndarray:
        """Draws (count, walkers, names) ``thin`` steps apart; the state moves on."""
        points = self._run(state, count, thin * self.thin)
        d = len(self.model.linear_names)
        return np.concatenate([self._linear(points[..., :d]), np.exp(points[..., d:])], axis=-1)

    def _run(self, state: EnsembleState, count: int, thin: int) -> np.ndarray:
        """Walkers after every ``thin`` steps (count, walkers, dimensions)."""
        mixed = [(LaplaceMove(*self.laplace), 0.9), (DEMove(), 0.1)]
        moves: Any = {"laplace": mixed, "de": DEMove(), "stretch": StretchMove()}[self.moves]
        sampler = emcee.EnsembleSampler(self.walkers, self.dimensions, self.log_density, moves=moves, vectorize=True)
        now = emcee.State(state.points, log_prob=state.log_density, random_state=state.random)
        steps = sampler.sample(now, iterations=count, thin_by=thin, store=False, skip_initial_state_check=True)
        out = np.empty((count, *state.points.shape))
        for k, now in enumerate(steps):
            out[k] = now.coords
        state.points, state.log_density, state.random = now.coords, np.asarray(now.log_prob), now.random_state
        return out
