"""The posterior itself: likelihood on factors, priors, and its density in coordinates that any sampler can take.

Unknowns: link parameters phi (with a prior) or base parameters b (flat), effect parameters a, one scale of the noise a whitened
channel s_c (one of the whole estimate where the model is incomplete), and with Student's t its degrees of freedom nu. Base
parameters are ``b = K phi`` throughout.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs, solve_triangular

from bayesid.arguments import argument
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.estimators.dispersion import STRETCHES
from bayesid.posterior import coordinates
from bayesid.posterior.likelihood import NOISES, DofPrior, Likelihood, ScalePrior, student_log_likelihood
from bayesid.posterior.trajectory import travel
from bayesid.regression.linalg import undetermined
from bayesid.regression.regression import Regression
from bayesid.robot.prior import Prior

_FACTORISE, _SOLVE_FACTORISED = get_lapack_funcs(("potrf", "potrs"), dtype="d")


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Squares ``|F_k theta - f_k|^2`` of every term as ``z' G_k z - 2 h_k' z + q_k`` with ``theta = centre + root z``.

    The last term is the prior's. At unit scales the sum of all G is the unit matrix and that of all h is zero, so
    squaring the factors costs no digits.
    """

    centre: np.ndarray
    root: np.ndarray
    gram: np.ndarray
    linear: np.ndarray
    constant: np.ndarray

    def squares(self, z: np.ndarray) -> np.ndarray:
        """All terms (..., k + 1) at points z (..., d)."""
        k, d = self.linear.shape
        turned = (z @ self._side_by_side).reshape(*z.shape[:-1], k, d)
        return np.einsum("...kd,...d->...k", turned - 2.0 * self.linear, z) + self.constant

    @cached_property
    def _side_by_side(self) -> np.ndarray:
        """(d, (k + 1) d), for one product instead of many."""
        return np.ascontiguousarray(np.swapaxes(self.gram, 0, 1).reshape(self.gram.shape[1], -1))

    def gaussian(self, precisions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (d,) and lower Cholesky factor (d, d) of the precision in z, for weights ``1 / s^2`` of the terms (k,)."""
        weights = np.append(precisions, 1.0)
        k, d = self.linear.shape
        lower, trouble = _FACTORISE((weights @ self.gram.reshape(k, d * d)).reshape(d, d), lower=1)
        if trouble:
            raise np.linalg.LinAlgError("the precision is not positive definite")
        return _SOLVE_FACTORISED(lower, weights @ self.linear, lower=1)[0], lower


_SHOWN = 4


@dataclass(frozen=True, eq=False)
class PosteriorModel:
    """Everything that defines the posterior."""

    #: What the columns of the regression are.
    base: BaseParameters
    effect_names: tuple[str, ...]
    effect_units: tuple[str, ...]
    effect_non_negative: np.ndarray
    likelihood: Likelihood  # of the fitted rows
    prior: Prior | None = None  # of the link parameters; None: flat in the base parameters, which any finite value may take
    noise: str = "gaussian"  # ``gaussian`` or ``student``
    #: Of the noise.
    scale_prior: ScalePrior = field(default_factory=ScalePrior)
    dof_prior: DofPrior = field(default_factory=DofPrior)
    #: Standard deviations of normal laws of the effects about zero (e,), cut at zero for those that cannot be negative;
    #: infinite: flat.
    effect_std: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, regression: Regression, prior: Prior | None = None, noise: str = "gaussian", **options) -> PosteriorModel:
        """The posterior of a regression; further options are the class's attributes.

        Raises
        ------
        InputError
            The noise has no such name, the prior does not fit the links, or the data and a flat prior together
            leave something without any limit.
        """
        if noise not in NOISES:
            raise InputError(f"noise '{noise}': choose one of {', '.join(NOISES)}")
        links = len(regression.base.parameter_names)
        if prior is not None and len(prior.mean) != links:
            raise InputError(f"prior has {len(prior.mean)} parameters, the links have {links}; give one value for each")
        effects = len(regression.effect_names)
        likelihood = Likelihood.of(regression, keep_rows=noise == "student")
        if likelihood.estimate_only:
            options = {"scale_prior": ScalePrior(0.5 * (STRETCHES - 1), 0.5 * (STRETCHES - 1)), **options}
        elif regression.noise_std is not None:
            options = {"scale_prior": ScalePrior(known=True), **options}
        model = cls(
            regression.base, regression.effect_names, regression.effect_units,
            np.array(regression.knowledge.effect_non_negative or (False,) * effects, bool),
            likelihood, prior, noise,
            **{"effect_std": np.full(effects, np.inf), **options},
        )  # fmt: skip
        model.require_proper()
        return model

    def require_proper(self) -> None:
        """Refuse a posterior that is flat in some direction for ever, with an `InputError` that names the parameters."""
        stacked = np.concatenate([f[:, :-1] for f in self.likelihood.factors])
        r = self.base.rank
        known = np.zeros((0, stacked.shape[1]))
        if np.isfinite(self.effect_std).any():
            at = np.flatnonzero(np.isfinite(self.effect_std))
            known = np.zeros((len(at), stacked.shape[1]))
            known[np.arange(len(at)), r + at] = 1.0 / self.effect_std[at]
        if self.prior is not None:
            # What any prior leaves to the data: effects, after the best combination of base parameters.
            size = np.maximum(np.sqrt(np.diag(self.prior.precision)), 1e-300)
            values = np.linalg.eigvalsh(self.prior.precision / np.outer(size, size))
            if values[0] <= 1e-12 * values[-1]:
                raise InputError("prior: its precision is singular; give every link parameter a limit")
            stacked = stacked[:, r:]
            known = known[:, r:]
        names = (self.base.labels if self.prior is None else ()) + self.effect_names
        hidden = np.zeros(0, bool)
        if names:
            hidden = undetermined(np.concatenate([np.asarray(np.linalg.qr(stacked, mode="r")), known]))
        if hidden.any():
            shown = [names[k] for k in np.flatnonzero(hidden)[:_SHOWN]]
            more = f" and {hidden.sum() - _SHOWN} more" if hidden.sum() > _SHOWN else ""
            remedy = "leave them out"
            if self.prior is None:
                remedy = f"take a prior ({argument('prior', 'nominal')}, {argument('prior_std', 0.3)}) or leave effects out"
            raise InputError(
                f"these motions say nothing about {', '.join(shown)}{more}, which a flat prior leaves open; {remedy}"
            )

    # ---- names and shapes ---------------------------------------------------------------------------------

    @property
    def physical(self) -> bool:
        """Whether bodies are restricted to those that can exist."""
        return self.prior is not None and self.prior.physical

    @property
    def link_count(self) -> int:
        """Number of link parameters that are sampled; 0 with a flat prior."""
        return 0 if self.prior is None else len(self.prior.mean)

    @property
    def linear_names(self) -> tuple[str, ...]:
        """Parameters that the readings are linear in: links' or base, then effects' (d,)."""
        return (self.base.names if self.prior is None else self.base.parameter_names) + self.effect_names

    @property
    def scale_names(self) -> tuple[str, ...]:
        """Names of the unknown scales; empty where they are known."""
        return () if self.scale_prior.known else self.likelihood.names

    @property
    def dof_free(self) -> bool:
        """Whether Student's degrees of freedom are sampled."""
        return self.noise == "student" and self.dof_prior.fixed is None

    @property
    def names(self) -> tuple[str, ...]:
        """Everything that is sampled: linear parameters, scales, degrees of freedom."""
        return self.linear_names + tuple(f"scale {n}" for n in self.scale_names) + (("nu",) if self.dof_free else ())

    def split(self, draws: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Linear parameters (..., d), scales (..., k) and degrees of freedom (...,) of draws as in ``names``."""
        d, k = len(self.linear_names), len(self.likelihood.names)
        if self.scale_prior.known:
            scales = np.ones((*draws.shape[:-1], k))
        else:
            scales = draws[..., d : d + k]
        fixed = np.inf if self.noise == "gaussian" else self.dof_prior.fixed or 0.0
        dof = draws[..., -1] if self.dof_free else np.full(draws.shape[:-1], fixed)
        return draws[..., :d], scales, dof

    @cached_property
    def to_columns(self) -> np.ndarray:
        """Matrix from the linear parameters to the regression's columns (p, d)."""
        r, e = self.base.rank, len(self.effect_names)
        k = np.eye(r) if self.prior is None else self.base.matrix
        out = np.zeros((r + e, k.shape[1] + e))
        out[:r, : k.shape[1]], out[r:, k.shape[1] :] = k, np.eye(e)
        return out

    @cached_property
    def prior_factor(self) -> np.ndarray:
        """Rows [A | A mean] of the normal priors, ``|A theta - A mean|^2`` (q, d + 1)."""
        d = self.to_columns.shape[1]
        finite = np.flatnonzero(np.isfinite(self.effect_std))
        rows = np.zeros((self.link_count + len(finite), d + 1))
        if self.prior is not None:
            scale = np.sqrt(np.diag(self.prior.precision))
            root = np.linalg.cholesky(self.prior.precision / np.outer(scale, scale)).T * scale
            rows[: self.link_count, : self.link_count] = root
            rows[: self.link_count, -1] = root @ self.prior.mean
        rows[self.link_count + np.arange(len(finite)), d - len(self.effect_names) + finite] = 1.0 / self.effect_std[finite]
        return rows

    @cached_property
    def quadratic(self) -> Quadratic:
        """Every term of the density as a quadratic form in well-conditioned coordinates."""
        matrices = [f[:, :-1] @ self.to_columns for f in self.likelihood.factors]
        targets = [f[:, -1] for f in self.likelihood.factors]
        prior = self.prior_factor
        whole = np.concatenate([np.column_stack([m, t]) for m, t in zip(matrices, targets, strict=True)] + [prior])
        d = self.to_columns.shape[1]
        r = np.asarray(np.linalg.qr(whole, mode="r"))
        centre = solve_triangular(r[:d, :d], r[:d, d])
        root = solve_triangular(r[:d, :d], np.eye(d))
        terms = [*zip(matrices, targets, strict=True), (prior[:, :-1], prior[:, -1])]
        slopes = [m @ root for m, _ in terms]
        rests = [t - m @ centre for m, t in terms]
        return Quadratic(
            centre, root,
            np.array([s.T @ s for s in slopes]),
            np.array([s.T @ t for s, t in zip(slopes, rests, strict=True)]),
            np.array([t @ t for t in rests]),
        )  # fmt: skip

    # ---- densities ------------------------------------------------------------------------------------------

    def log_joint(self, linear: np.ndarray, scales: np.ndarray, dof: np.ndarray) -> np.ndarray:
        """Logarithm of the posterior density of (linear, log scales, dof) without its bounds, up to a constant (...,)."""
        q = self.quadratic
        z = solve_triangular(q.root, np.reshape(linear - q.centre, (-1, len(q.centre))).T).T
        z = z.reshape(np.shape(linear))
        logs = np.log(scales)
        if self.noise == "gaussian":
            squares = q.squares(z)
            density = -np.sum(self.likelihood.counts * logs + 0.5 * squares[..., :-1] / scales**2, axis=-1)
            density = density - 0.5 * squares[..., -1]
        else:
            density = self.log_likelihood(linear, scales, dof) - 0.5 * q.squares(z)[..., -1]
        if not self.scale_prior.known:
            density = density + self.scale_prior.log_density(logs)
        if self.dof_free:
            density = density + self.dof_prior.log_density(dof)
        return density

    def log_likelihood(self, linear: np.ndarray, scales: np.ndarray, dof: np.ndarray) -> np.ndarray:
        """Log likelihood (...,) of the whitened rows; needs them with Student's t."""
        if self.noise == "gaussian":
            z = np.linalg.solve(self.quadratic.root, (linear - self.quadratic.centre)[..., None])[..., 0]
            rows = self.likelihood.counts
            squares = self.quadratic.squares(z)[..., :-1]
            return -np.sum(rows * (np.log(scales) + 0.5 * np.log(2 * np.pi)) + 0.5 * squares / scales**2, axis=-1)
        columns = linear @ self.to_columns.T
        flat, size, nu = columns.reshape(-1, columns.shape[-1]), scales.reshape(-1, scales.shape[-1]), np.ravel(dof)
        white = self.likelihood.white
        out = np.array([student_log_likelihood(white, b, s, n) for b, s, n in zip(flat, size, nu, strict=True)])
        return out.reshape(linear.shape[:-1])

    # ---- the sampler's coordinates ------------------------------------------------------------------------

    @property
    def bodies(self) -> int:
        """How many matrices the cone consists of."""
        return len(self.prior.bodies) if self.physical and self.prior is not None else 0

    @cached_property
    def entries(self) -> np.ndarray:
        """Matrix (d, d) from linear parameters to the sampler's: entries of each body's matrix, then effects."""
        d = self.to_columns.shape[1]
        out = np.eye(d)
        if self.prior is not None and self.physical:
            order = [k for body in self.prior.bodies for k in body]
            out[: self.link_count] = 0.0
            for k, body in enumerate(self.prior.bodies):
                out[10 * k : 10 * k + 10, list(body)] = coordinates.entries_map(self.prior.mean[list(body)])
            rest = np.setdiff1d(np.arange(self.link_count), order)
            out[len(order) + np.arange(len(rest)), rest] = 1.0
        return out

    @cached_property
    def from_entries(self) -> np.ndarray:
        """The inverse of ``entries``, block by block (d, d)."""
        out = np.zeros_like(self.entries)
        taken = 0
        if self.prior is not None and self.physical:
            for k, body in enumerate(self.prior.bodies):
                part = slice(10 * k, 10 * k + 10)
                out[list(body), part] = np.linalg.inv(self.entries[part][:, list(body)])
                taken += 10
        out[:, taken:] = self.entries[taken:].T
        return out

    @cached_property
    def bounded(self) -> np.ndarray:
        """Coordinates that cannot be negative."""
        return self.to_columns.shape[1] - len(self.effect_names) + np.flatnonzero(self.effect_non_negative)

    def inside(self, linear: np.ndarray) -> np.ndarray:
        """Whether linear parameters (..., d) keep to all bounds."""
        x = linear @ self.entries.T
        ok = np.all(x[..., self.bounded] >= 0, axis=-1)
        if self.bodies:
            m = coordinates.matrices(x[..., : 10 * self.bodies].reshape(*x.shape[:-1], self.bodies, 10))
            ok &= np.all(np.linalg.eigvalsh(m)[..., 0] >= 0, axis=-1)
        return ok

    def interior(self, rng: np.random.Generator) -> np.ndarray:
        """A point inside all bounds, spread as the prior is (d,), in the sampler's coordinates.

        Bodies come from the prior, drawn in towards the nominal ones until they can exist.
        """
        q = self.quadratic
        x = self.entries @ (q.centre + q.root @ rng.normal(size=len(q.centre)))
        for k in range(self.bodies):
            unit = coordinates.matrices(np.zeros(10)) + np.eye(4)
            noise = 0.2 * rng.normal(size=(4, 4))
            x[10 * k : 10 * k + 10] = (unit + np.clip(0.5 * (noise + noise.T), -0.2, 0.2))[coordinates.ROW, coordinates.COLUMN]
        x[self.bounded] = np.maximum(x[self.bounded], 0.1 * np.abs(x[self.bounded]) + 1e-6)
        return x

    def prior_draws(self, count: int, rng: np.random.Generator) -> np.ndarray | None:
        """Link parameters from the prior alone, its bounds included (count, P); None with a flat one."""
        if self.prior is None:
            return None
        n, d = self.link_count, self.to_columns.shape[1]
        to, back = self.entries[:n, :n], self.from_entries[:n, :n]
        mean = to @ self.prior.mean
        covariance = to @ self.prior.covariance @ to.T
        covariance = 0.5 * (covariance + covariance.T)
        root = np.linalg.cholesky(covariance)
        if not self.bodies:
            return (mean + rng.normal(size=(count, n)) @ root.T) @ back.T
        x = self.interior(rng)[: d - len(self.effect_names)]
        out = np.empty((count, n))
        none = np.zeros(0, np.int64)
        for i in range(-20, count):
            travel(x, root @ rng.normal(size=n), mean, root, self.bodies, none)
            out[max(i, 0)] = x
        return out @ back.T
