"""The posterior itself: likelihood on factors, priors, and its density in coordinates that any sampler can take.

Unknowns: link parameters phi (with a prior) or base parameters b (flat), effect parameters a, one scale of the noise a whitened
channel s_c (one of the whole estimate where the model is incomplete), and with Student's t its degrees of freedom nu. Base
parameters are ``b = K phi`` throughout.

Each body's pseudo-inertia P is measured by the nominal one, ``M = N P N'`` with ``N P0 N' = 1`` (P0 is solid, see
`bayesid.robot.inertia.solid`), and the sampler's coordinates are the ten entries of M. For samplers of one's own there are
unconstrained coordinates theta, in this order: for every body its log-Cholesky parameters (with a flat prior the base parameters
instead), effect parameters, logarithms of those that cannot be negative, logarithms of the scales, and that of Student's degrees
of freedom. The log-Cholesky parameters are

    M = U U',   U upper triangular,   theta = (log u_kk, u_ij),

which covers exactly the bodies that can exist [Rucker2022]_; ``log |dM / dtheta| = 4 log 2 + sum_k (k + 1) log u_kk``,
k = 1 ... 4, since column k of U has k entries.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, get_lapack_funcs, solve_triangular

from bayesid.arguments import argument
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError, require_one_of
from bayesid.estimators.dispersion import PARTS
from bayesid.posterior.likelihood import NOISES, DofPrior, Likelihood, ScalePrior, student_log_likelihood, student_slopes
from bayesid.posterior.trajectory import COLUMN, ROW, travel
from bayesid.regression.linalg import column_lengths, or_one, undetermined
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior

_FACTORISE, _SOLVE_FACTORISED = get_lapack_funcs(("potrf", "potrs"), dtype="d")
#: Positions of theta in U: four logarithms of the diagonal, then the entries above it by rows.
_DIAGONAL = np.arange(4)
_ABOVE = (np.array([0, 0, 0, 1, 1, 2]), np.array([1, 2, 3, 2, 3, 3]))
_POWERS = np.array([2.0, 3.0, 4.0, 5.0])
LOG_CHOLESKY = ("log_u11", "log_u22", "log_u33", "log_u44", "u12", "u13", "u14", "u23", "u24", "u34")


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

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Points z of parameters (..., d)."""
        away = np.reshape(theta - self.centre, (-1, len(self.centre)))
        return solve_triangular(self.root, away.T).T.reshape(np.shape(theta))

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
#: Share of the largest singular value below which neither data nor a prior, which may be far weaker, tell an effect.
_IMPROPER = 1e-8


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

        An `InputError` where the noise has no such name, the prior does not fit the links, or the data and a flat prior together
        leave something without any limit.
        """
        require_one_of(noise, NOISES, f"noise '{noise}'")
        links = len(regression.base.parameter_names)
        if prior is not None and len(prior.mean) != links:
            raise InputError(f"prior has {len(prior.mean)} parameters, the links have {links}; give one value for each")
        effects = len(regression.effect_names)
        likelihood = Likelihood.of(regression, keep_rows=noise == "student")
        if likelihood.estimate_only:
            options = {"scale_prior": ScalePrior(0.5 * (PARTS - 1), 0.5 * (PARTS - 1)), **options}
        elif regression.noise_std is not None:
            options = {"scale_prior": ScalePrior(known=True), **options}
        else:
            options = {"scale_prior": _scale_prior(likelihood), **options}
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
        if self.prior is not None:
            size = or_one(np.sqrt(np.diag(self.prior.precision)))
            values = np.linalg.eigvalsh(self.prior.precision / np.outer(size, size))
            if values[0] <= 1e-12 * values[-1]:
                raise InputError("prior: its precision is singular; give every link parameter a limit")
            # What any prior leaves to the data: effects, after the best combination of base parameters.
            stacked = stacked[:, self.base.rank :]
        names = (self.base.labels if self.prior is None else ()) + self.effect_names
        hidden = np.zeros(0, bool)
        if names:
            known = self.prior_factor[self.link_count :, self.link_count : -1]  # of the effects
            rows = np.concatenate([np.asarray(np.linalg.qr(stacked, mode="r")), known])
            hidden = undetermined(rows, _IMPROPER)
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
    def _fixed_dof(self) -> float:
        """Degrees of freedom where they are not sampled."""
        return np.inf if self.noise == "gaussian" else self.dof_prior.fixed or 0.0

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
        dof = draws[..., -1] if self.dof_free else np.full(draws.shape[:-1], self._fixed_dof)
        return draws[..., :d], scales, dof

    @cached_property
    def to_columns(self) -> np.ndarray:
        """Matrix from the linear parameters to the regression's columns (p, d)."""
        k = np.eye(self.base.rank) if self.prior is None else self.base.matrix
        return np.asarray(block_diag(k, np.eye(len(self.effect_names))))

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
        terms = [(f[:, :-1] @ self.to_columns, f[:, -1]) for f in self.likelihood.factors]
        terms.append((self.prior_factor[:, :-1], self.prior_factor[:, -1]))
        whole = np.concatenate([np.column_stack(term) for term in terms])
        d = self.to_columns.shape[1]
        r = np.asarray(np.linalg.qr(whole, mode="r"))
        centre = solve_triangular(r[:d, :d], r[:d, d])
        root = solve_triangular(r[:d, :d], np.eye(d))
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
        squares, logs = self.quadratic.squares(self.quadratic.at(linear)), np.log(scales)
        if self.noise == "gaussian":
            density = -np.sum(self.likelihood.counts * logs + 0.5 * squares[..., :-1] / scales**2, axis=-1)
        else:
            density = self.log_likelihood(linear, scales, dof)
        density = density - 0.5 * squares[..., -1]
        if not self.scale_prior.known:
            density = density + self.scale_prior.log_density(logs)
        if self.dof_free:
            density = density + self.dof_prior.log_density(dof)
        return density

    def log_likelihood(self, linear: np.ndarray, scales: np.ndarray, dof: np.ndarray) -> np.ndarray:
        """Log likelihood (...,) of the whitened rows; needs them with Student's t."""
        if self.noise == "gaussian":
            rows = self.likelihood.counts
            squares = self.quadratic.squares(self.quadratic.at(linear))[..., :-1]
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
                out[10 * k : 10 * k + 10, list(body)] = entries_map(self.prior.mean[list(body)])
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
            ok &= np.all(np.linalg.eigvalsh(matrices(self._by_body(x)))[..., 0] >= 0, axis=-1)
        return ok

    def interior(self, rng: np.random.Generator) -> np.ndarray:
        """A point inside all bounds, spread as the prior is (d,), in the sampler's coordinates.

        Bodies come from the prior, drawn in towards the nominal ones until they can exist.
        """
        q = self.quadratic
        x = self.entries @ (q.centre + q.root @ rng.normal(size=len(q.centre)))
        for k in range(self.bodies):
            noise = 0.2 * rng.normal(size=(4, 4))
            x[10 * k : 10 * k + 10] = (np.eye(4) + np.clip(0.5 * (noise + noise.T), -0.2, 0.2))[ROW, COLUMN]
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

    # ---- unconstrained coordinates, for samplers of one's own ------------------------------------------------

    @property
    def theta_names(self) -> tuple[str, ...]:
        """Names of the coordinates (q,)."""
        names = self.linear_names
        bodies = self.prior.bodies if self.bodies and self.prior is not None else ()
        called = [names[body[0]].rpartition(".")[0] or f"body{k}" for k, body in enumerate(bodies, 1)]
        rest = np.setdiff1d(np.arange(len(names)), [column for body in bodies for column in body]).tolist()
        linear = [f"{body}.{n}" for body in called for n in LOG_CHOLESKY] + [names[k] for k in rest]
        linear = [f"log {n}" if k in self.bounded else n for k, n in enumerate(linear)]
        return (*linear, *(f"log scale {n}" for n in self.scale_names), *(("log nu",) if self.dof_free else ()))

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Logarithm of the posterior density at ``theta`` (..., q), all Jacobians included, up to a constant (...,).

        With Gaussian noise a call costs the same for any number of rows.
        """
        return self._density(np.asarray(theta, float))[0]

    def _density(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Log density (...,), linear parameters, scales and degrees of freedom."""
        d, k, shape = len(self.linear_names), len(self.scale_names), theta.shape[:-1]
        x, jacobian = theta[..., :d].copy(), np.zeros(shape)
        if self.bodies:
            entries, logs = from_log_cholesky(self._by_body(theta))
            x[..., : 10 * self.bodies] = entries.reshape(*shape, -1)
            jacobian = jacobian + logs.sum(axis=-1) + np.linalg.slogdet(self.from_entries)[1]
        x[..., self.bounded] = np.exp(theta[..., self.bounded])
        jacobian = jacobian + theta[..., self.bounded].sum(axis=-1)
        scales = np.exp(theta[..., d : d + k]) if k else np.ones((*shape, len(self.likelihood.names)))
        dof = np.exp(theta[..., -1]) if self.dof_free else np.full(shape, self._fixed_dof)
        if self.dof_free:
            jacobian = jacobian + theta[..., -1]
        linear = x @ self.from_entries.T
        return self.log_joint(linear, scales, dof) + jacobian, linear, scales, dof

    def log_density_gradient(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`log_density` and its gradient in ``theta``, (...,) and (..., q)."""
        theta = np.asarray(theta, float)
        density, linear, scales, dof = self._density(theta)
        by_linear, by_scales, by_dof = self._slopes(linear, scales, dof)
        d, k = len(self.linear_names), len(self.scale_names)
        out = np.empty_like(theta)
        out[..., :d] = in_x = by_linear @ self.from_entries
        if self.bodies:
            bodies = pull_back(self._by_body(theta), self._by_body(in_x))
            out[..., : 10 * self.bodies] = bodies.reshape(*theta.shape[:-1], -1)
        out[..., self.bounded] = in_x[..., self.bounded] * np.exp(theta[..., self.bounded]) + 1.0
        if k:
            out[..., d : d + k] = by_scales + self.scale_prior.slope(np.log(scales))
        if self.dof_free:
            out[..., -1] = by_dof * dof + self.dof_prior.shape - self.dof_prior.rate * dof
        return density, out

    def _slopes(self, linear: np.ndarray, scales: np.ndarray, dof: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of likelihood and normal priors by linear parameters (..., d), log scales (..., k) and dof (...,)."""
        q, z = self.quadratic, self.quadratic.at(linear)
        gaussian = scales**-2 if self.noise == "gaussian" else np.zeros_like(scales)
        weights = np.concatenate([gaussian, np.ones((*scales.shape[:-1], 1))], axis=-1)
        slope = np.einsum("...k,kj->...j", weights, q.linear) - np.einsum("...k,kij,...j->...i", weights, q.gram, z)
        by_linear = np.linalg.solve(q.root.T, slope[..., None])[..., 0]
        if self.noise == "gaussian":
            return by_linear, q.squares(z)[..., :-1] / scales**2 - self.likelihood.counts, np.zeros_like(dof)
        by_scales, by_dof = np.empty_like(scales), np.empty_like(dof)
        for at in np.ndindex(linear.shape[:-1]):
            columns = self.to_columns @ linear[at]
            own, by_scales[at], by_dof[at] = student_slopes(self.likelihood.white, columns, scales[at], float(dof[at]))
            by_linear[at] += self.to_columns.T @ own
        return by_linear, by_scales, by_dof

    def to_theta(self, draws: np.ndarray) -> np.ndarray:
        """Coordinates (..., q) of draws as in ``names``."""
        linear, scales, dof = self.split(draws)
        x = linear @ self.entries.T
        if self.bodies:
            x[..., : 10 * self.bodies] = to_log_cholesky(self._by_body(x)).reshape(*x.shape[:-1], -1)
        x[..., self.bounded] = np.log(x[..., self.bounded])
        parts = [x] + ([np.log(scales)] if self.scale_names else []) + ([np.log(dof)[..., None]] if self.dof_free else [])
        return np.concatenate(parts, axis=-1)

    def _by_body(self, x: np.ndarray) -> np.ndarray:
        """Ten coordinates of each body (..., b, 10) of points (..., at least 10 b)."""
        return x[..., : 10 * self.bodies].reshape(*x.shape[:-1], self.bodies, 10)


def _scale_prior(likelihood: Likelihood) -> ScalePrior:
    """Jeffreys' law of the scales; one row as noisy as was learned beside those of a channel that has few.

    Where parameters can fit all rows of a channel without residuals, Jeffreys' law makes the posterior grow without limit there.
    An `InputError` where they fit all rows of all channels: then no noise was learned.
    """
    matrix = np.concatenate([f[:, :-1] for f in likelihood.factors])
    shown = int(np.linalg.matrix_rank(matrix / column_lengths(matrix)))
    if likelihood.rows <= shown:
        raise InputError(
            f"{likelihood.rows} numbers show {shown} parameters, so no residual is left to tell the noise by; record longer, "
            "or more poses"
        )
    few = 0.5 * (likelihood.counts <= matrix.shape[1])
    return ScalePrior(few, few) if few.any() else ScalePrior()


def normaliser(body: np.ndarray) -> np.ndarray:
    """N (4, 4) with ``N P0 N' = 1`` for the solid neighbour P0 of a nominal body (10,).

    N serves numbers near one only: it changes no density.
    """
    return np.linalg.inv(np.linalg.cholesky(inertia.solid(body)))


def entries_map(body: np.ndarray) -> np.ndarray:
    """Matrix (10, 10) from a body's ten parameters to the entries of M."""
    n = normaliser(body)
    return (n @ inertia.BASIS @ n.T)[:, ROW, COLUMN].T


def matrices(entries: np.ndarray) -> np.ndarray:
    """Symmetric matrices (..., 4, 4) of their entries (..., 10)."""
    out = np.empty((*entries.shape[:-1], 4, 4))
    out[..., ROW, COLUMN] = entries
    out[..., COLUMN, ROW] = entries
    return out


def triangular(theta: np.ndarray) -> np.ndarray:
    """U (..., 4, 4) of log-Cholesky parameters (..., 10)."""
    u = np.zeros((*theta.shape[:-1], 4, 4))
    u[..., _DIAGONAL, _DIAGONAL] = np.exp(theta[..., :4])
    u[(..., *_ABOVE)] = theta[..., 4:]
    return u


def from_log_cholesky(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of M (..., 10) and the logarithm of the Jacobian ``|dM / dtheta|`` (...,)."""
    u = triangular(theta)
    m = u @ np.swapaxes(u, -1, -2)
    return m[..., ROW, COLUMN], 4.0 * np.log(2.0) + theta[..., :4] @ _POWERS


def to_log_cholesky(entries: np.ndarray) -> np.ndarray:
    """The inverse (..., 10); a `numpy.linalg.LinAlgError` where a matrix is not positive definite."""
    flipped = np.linalg.cholesky(matrices(entries)[..., ::-1, ::-1])
    u = flipped[..., ::-1, ::-1]
    return np.concatenate([np.log(u[..., _DIAGONAL, _DIAGONAL]), u[(..., *_ABOVE)]], axis=-1)


def pull_back(theta: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Gradient in theta (..., 10) of a function whose gradient in the entries of M is given, Jacobian's included."""
    u = triangular(theta)
    # An off-diagonal entry stands for two places of M.
    slope = 2.0 * matrices(np.where(ROW == COLUMN, 1.0, 0.5) * gradient) @ u
    out = np.empty_like(theta)
    out[..., :4] = slope[..., _DIAGONAL, _DIAGONAL] * u[..., _DIAGONAL, _DIAGONAL] + _POWERS
    out[..., 4:] = slope[(..., *_ABOVE)]
    return out
