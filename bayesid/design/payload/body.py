"""One body's mass, centre of mass and inertia about it, from what is known of its ten parameters.

The ten parameters ``p = (m, h, I_o)`` with the first moment ``h = m c`` are what readings are linear in: they are known as a
normal law, and not at all along some directions (poses at rest say nothing of ``I_o``). What a controller asks for follows.

**Mass.** ``m`` with its interval, which ends at zero.

**Centre of mass.** For a ratio ``c = h / m`` of two normal numbers the values that the data do not contradict are those with

    (h - c m)^2 <= t^2 (V_hh - 2 c V_hm + c^2 V_mm),

an interval where ``m^2 > t^2 V_mm`` and everything otherwise [Fieller1954]_: it holds the truth as often as it says also where
the mass is hardly known.

**Inertia about the centre of mass.** ``I_c = I_o - (h'h 1 - h h') / m``, linearised at the estimate. A moment is shown where the
data tell it from zero, that of a point mass; a product where those of its two axes are.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, isfinite

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from bayesid.dynamics.kinematics import transform_matrix
from bayesid.estimators.conic.problem import nearest_body
from bayesid.regression.linalg import correlations
from bayesid.robot import inertia
from bayesid.rounding import HALF

#: Typical size of the ten parameters, by which directions are measured: a kilogram, a tenth of a metre.
_SIZES = np.array([1.0, *(0.1,) * 3, *(0.01,) * 6])
#: Share of a direction that has to be left beside what the data say, for it to count as not shown.
_SMALLEST = 1e-7
#: Share of the largest variance, in standard deviations, below which one is a zero.
_OPEN = 1e-11
#: An end of the mass's interval below this share of the other is zero but for rounding.
_ROUNDED = 1e-9
#: Chains side by side, steps between two draws of one, and steps left out at the beginning.
_CHAINS, _THIN, _BURN_IN = 200, 20, 400
_MOMENTS = ("Ixx", "Iyy", "Izz")


@dataclass(frozen=True)
class Quantity:
    """A number of the body with its interval."""

    #: Such as ``x`` and ``m``.
    name: str
    unit: str
    #: Estimate and standard deviation; nan where the data do not show it.
    value: float
    std: float
    #: Ends of the central 95 % interval; infinite or nan where there is none.
    low: float
    high: float
    shown: bool  # whether the data show it

    @classmethod
    def unknown(cls, name: str, unit: str, low: float = -inf, high: float = inf) -> Quantity:
        """A number that the data do not show, with what bounds it."""
        return cls(name, unit, np.nan, np.nan, low, high, False)

    @classmethod
    def of(cls, name: str, unit: str, value: float, std: float) -> Quantity:
        """A number with its standard deviation; one that is not finite is not shown."""
        if not isfinite(std):
            return cls.unknown(name, unit)
        return cls(name, unit, float(value), float(std), float(value - HALF * std), float(value + HALF * std), True)

    def joined(self, others: tuple[Quantity, ...]) -> Quantity:
        """The same with an interval that holds those of other models, too, which the data cannot tell from its own."""
        ends = [(q.low, q.high) for q in (self, *others)]
        return replace(
            self, low=min(low for low, _ in ends), high=max(high for _, high in ends),
            shown=self.shown and all(q.shown for q in others),
        )  # fmt: skip

    def to_dict(self) -> dict[str, float | str | bool | None]:
        """Plain values for JSON; None where there is no number."""
        numbers = {key: float(getattr(self, key)) for key in ("value", "std", "low", "high")}
        return {**{key: x if isfinite(x) else None for key, x in numbers.items()}, "unit": self.unit, "shown": self.shown}


@dataclass(frozen=True, eq=False)
class BodyKnowledge:
    """What is known of a body's ten parameters."""

    #: In the order of `bayesid.robot.inertia.PARAMETERS` (10,), (10, 10); along ``hidden`` they say nothing.
    mean: np.ndarray
    covariance: np.ndarray
    hidden: np.ndarray = field(default_factory=lambda: np.zeros((10, 0)))  # directions of which nothing is known (10, k)

    @classmethod
    def of(cls, matrix: np.ndarray, values: np.ndarray, covariance: np.ndarray) -> BodyKnowledge:
        """Knowledge from ``values = matrix @ p + e``, e ~ N(0, covariance), (r, 10) and (r,), by generalised least squares."""
        # Where data determine only sums of parameters, a covariance is zero along what they leave open: no knowledge either.
        size, variances, vectors = correlations(covariance, _OPEN)
        turn = (vectors / np.sqrt(variances)).T / size
        white, target = turn @ matrix * _SIZES, turn @ values
        # A combination that is known far better than the others still has its say in the rank: rows of unit length.
        length = np.maximum(np.linalg.norm(white, axis=1), 1e-300)
        _, s, rows = np.linalg.svd(white / length[:, None])
        rank = int(np.count_nonzero(s > _SMALLEST * s.max(initial=0.0)))
        seen, unseen = rows[:rank].T, rows[rank:].T
        q, r = np.linalg.qr(white @ seen)
        root = _SIZES[:, None] * (seen @ np.linalg.inv(r))
        return cls(root @ (q.T @ target), root @ root.T, _SIZES[:, None] * unseen)

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> BodyKnowledge:
        """The same in another frame, in which this one sits at a rotation (3, 3) and translation (3,) [m]."""
        change = transform_matrix(rotation, translation)
        return replace(self, mean=change @ self.mean, covariance=change @ self.covariance @ change.T, hidden=change @ self.hidden)

    @cached_property
    def shown(self) -> np.ndarray:
        """Whether each of the ten parameters is determined (10,)."""
        if not self.hidden.shape[1]:
            return np.ones(10, bool)
        basis, _ = np.linalg.qr(self.hidden / _SIZES[:, None])
        return np.linalg.norm(basis, axis=1) < 1e-6

    @property
    def negative(self) -> bool:
        """Whether the mass comes out below zero for certain: readings are not what they are taken for."""
        return bool(self.shown[0] and self.mean[0] + HALF * np.sqrt(self.covariance[0, 0]) < 0.0)

    @cached_property
    def possible(self) -> BodyKnowledge:
        """The same about the nearest body that can exist, see `nearest_body`; as it is where none is near."""
        if self.negative or not self.shown.all():
            return self
        return replace(self, mean=nearest_body(self.mean, self.covariance))

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """Draws of the ten parameters of bodies that can exist (count, 10); nan where nothing is known.

        Hit and run [Smith1984]_: along a random direction, in units of the covariance's root, the law is a normal one cut off
        where the pseudo-inertia P ceases to be positive definite. With ``P = L L'`` and the direction's D the ends are -1 over
        the extreme eigenvalues of ``L^-1 D L^-T``.
        """
        rng = np.random.default_rng(seed)
        if not self.shown.all():  # of an inertia that is not known there always is one: only the mass is bounded
            out = np.full((count, 10), np.nan)
            at = np.flatnonzero(self.shown)
            root = np.linalg.cholesky(self.covariance[np.ix_(at, at)])
            out[:, at] = self.mean[at] + rng.normal(size=(count, len(at))) @ root.T
            if self.shown[0] and (bad := out[:, 0] <= 0.0).any():
                std = np.sqrt(self.covariance[0, 0])
                least = np.full(int(bad.sum()), -self.mean[0] / std)
                mass = self.mean[0] + std * _cut_normal(least, np.full_like(least, inf), rng.uniform(size=len(least)))
                # The others go with the mass, and scatter about that as they did.
                out[np.ix_(bad, at)] += np.outer(mass - out[bad, 0], self.covariance[0, at] / std**2)
            return out
        size = np.sqrt(np.diag(self.covariance))
        root = size[:, None] * np.linalg.cholesky(self.covariance / np.outer(size, size))
        inside = inertia.from_pseudo_inertia(inertia.solid(self.possible.mean))
        chains = min(count, _CHAINS)
        z = np.tile(np.linalg.solve(root, inside - self.mean), (chains, 1))
        kept: list[np.ndarray] = []
        for k in range(_BURN_IN + _THIN * -(-count // chains)):
            way = rng.normal(size=z.shape)
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            lower = np.linalg.cholesky(inertia.pseudo_inertia(self.mean + z @ root.T))
            once = np.linalg.solve(lower, inertia.pseudo_inertia(way @ root.T))
            values = np.linalg.eigvalsh(np.linalg.solve(lower, np.swapaxes(once, 1, 2)))
            with np.errstate(divide="ignore"):
                first = np.where(values[:, -1] > 0.0, -1.0 / values[:, -1], -inf)
                last = np.where(values[:, 0] < 0.0, -1.0 / values[:, 0], inf)
            along = np.sum(z * way, axis=1)
            step = _cut_normal(first + along, last + along, rng.uniform(size=chains)) - along
            z = z + (1.0 - 1e-9) * step[:, None] * way
            if k >= _BURN_IN and (k - _BURN_IN) % _THIN == _THIN - 1:
                kept.append(self.mean + z @ root.T)
        return np.concatenate(kept)[:count]

    @cached_property
    def mass(self) -> Quantity:
        """The mass [kg]."""
        if not self.shown[0]:
            return Quantity.unknown("m", "kg", 0.0)
        m, std = float(self.mean[0]), float(np.sqrt(self.covariance[0, 0]))
        low, high = max(m - HALF * std, 0.0), max(m + HALF * std, 0.0)
        if low < _ROUNDED * high:
            low = 0.0
        return Quantity("m", "kg", max(m, 0.0), std, low, high, low > 0.0)

    @cached_property
    def first_moment(self) -> tuple[Quantity, ...]:
        """Mass times centre of mass [kg m]: readings may show it where they show neither alone (3,)."""
        stds = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))  # what is not shown has none but for rounding
        return tuple(
            Quantity.of(inertia.PARAMETERS[k], "kg m", self.mean[k], stds[k] if self.shown[k] else inf) for k in (1, 2, 3)
        )

    @cached_property
    def centre(self) -> tuple[Quantity, Quantity, Quantity]:
        """The centre of mass [m]."""
        x, y, z = (self._ratio(axis, k) for k, axis in enumerate("xyz", 1))
        return x, y, z

    def _ratio(self, name: str, k: int) -> Quantity:
        v, m, h, t = self.covariance, self.mean[0], self.mean[k], HALF
        if not (self.mass.shown and self.shown[k]):
            return Quantity.unknown(name, "m")
        c = h / m
        std = np.sqrt(max(v[k, k] - 2.0 * c * v[0, k] + c**2 * v[0, 0], 0.0)) / m
        a, b, d = m**2 - t**2 * v[0, 0], m * h - t**2 * v[0, k], h**2 - t**2 * v[k, k]
        root = np.sqrt(max(b**2 - a * d, 0.0))
        return Quantity(name, "m", float(c), float(std), float((b - root) / a), float((b + root) / a), True)

    @cached_property
    def inertia(self) -> tuple[Quantity, ...]:
        """Inertia about the centre of mass in the frame's axes [kg m^2], in the order of the parameters (6,)."""
        names = inertia.PARAMETERS[4:]
        if not (self.shown.all() and self.mass.shown):
            return tuple(Quantity.unknown(n, "kg m^2", 0.0 if n in _MOMENTS else -inf) for n in names)
        values, slopes = about_centre(self.mean)
        stds = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes), 0.0))
        low, high = values - HALF * stds, values + HALF * stds
        visible = {n: bool(lo > 0.0) for n, lo in zip(names, low, strict=True) if n in _MOMENTS}
        out = []
        for n, value, std, lo, hi in zip(names, values, stds, low, high, strict=True):
            shown = visible[f"I{n[1]}{n[1]}"] and visible[f"I{n[2]}{n[2]}"]
            lo, hi = (max(lo, 0.0), max(hi, 0.0)) if n in _MOMENTS else (lo, hi)
            made = Quantity(n, "kg m^2", float(value), float(std), float(lo), float(hi), True)
            out.append(made if shown else Quantity.unknown(n, "kg m^2", float(lo), float(hi)))
        return tuple(out)


def _cut_normal(low: np.ndarray, high: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Quantiles of standard normal laws cut off at both ends (n,)."""
    flipped = low > 0.0  # in the tail where probabilities keep their digits
    a, b = np.where(flipped, -high, low), np.where(flipped, -low, high)
    share, last = np.where(flipped, 1.0 - share, share), log_ndtr(b)
    found = np.clip(ndtri_exp(last + np.log(share + (1.0 - share) * np.exp(log_ndtr(a) - last))), a, b)
    return np.where(flipped, -found, found)


def about_centre(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inertia about the centre of mass (6,) [kg m^2] and its derivatives with respect to the ten parameters (6, 10)."""
    m, h = parameters[0], parameters[1:4]
    six = inertia.ROW, inertia.COLUMN
    shift = (h @ h) * np.eye(3) - np.outer(h, h)
    slopes = np.zeros((6, 10))
    slopes[:, 0] = shift[six] / m**2
    for k, unit in enumerate(np.eye(3)):
        slopes[:, 1 + k] = -(2.0 * h[k] * np.eye(3) - np.outer(unit, h) - np.outer(h, unit))[six] / m
    slopes[:, 4:] = np.eye(6)
    return parameters[4:] - shift[six] / m, slopes
