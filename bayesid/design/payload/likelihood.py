"""A payload's mass beside a load whose shape trades weight for its own, by the profile of the likelihood.

A cable without length pulls a point p of the payload with ``k (a - x)``. Its share ``k a_z`` is a constant force along
gravity, as weight is: a mass that is larger by d with a first moment larger by ``d p``, and an anchor that is higher by
``d g / k``, read the same in every pose. Only the cable's length tells them apart, and that by little. The sum of squares then
has a valley, flat and as long as anchors may be high, along which a linearised standard deviation says nothing.

So the mass is held at values m on both sides, all else is fitted, and those of

    chi2(m) - min chi2 <= t^2 f

are what the readings do not contradict [Venzon1988]_: t is half a central interval in standard deviations, f the ratio of the
estimate's variances to those of white noise. All other parameters follow the mass along the valley, and scatter about it as
they do with the mass known: ``theta = theta(m) + e``, ``V = V_m + s^2 v v'``, v the valley's direction, s the mass's
interval over 2 t.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from scipy.optimize import least_squares

from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects.families import LoadEffect
from bayesid.estimators import Estimate
from bayesid.regression.problem import Problem, absorbed_offset, relinearised

#: First step along the mass as a share of it, at least and at most; how each next one grows; most steps each way.
_FIRST, _GROWTH, _STEPS = (1e-4, 0.05), 1.7, 20
#: The search goes on this far above the level: beyond a ridge there may be another valley.
_ABOVE = 30.0
#: A valley is another one where it is lower by this, and how often the search begins again there.
_LOWER, _ROUNDS = 0.1, 3
#: Steps towards where the profile crosses the level, and how near to that is enough, in standard deviations.
_CROSSINGS, _NEAR = 12, 0.02


@dataclass(frozen=True, eq=False)
class ProfilePoint:
    """A point of the profile: the mass, what is least with it held, and where."""

    mass: float
    chi2: float
    at: np.ndarray


@dataclass(eq=False)
class HeldCombination:
    """Sums of squares with a combination of the base parameters held."""

    #: A fit to readings that are not linear in its effects.
    problem: Problem
    estimate: Estimate
    slope: np.ndarray  # the combination that is held (p,), of base parameters alone
    _last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = field(default=None, init=False)

    def __post_init__(self):
        model, point = self.problem.row_model, self.problem.row_model.point
        assert point is not None
        free = np.full(model.base.rank, inf)
        self.start = np.concatenate([point.base, point.values[point.free]])
        self.low = np.concatenate([-free, np.array([v for e in model.effects for v in e.lower])[point.free]])
        self.high = np.concatenate([free, np.array([v for e in model.effects for v in e.upper])[point.free]])
        pivot = int(np.argmax(np.abs(self.slope)))
        self.kept = np.arange(len(self.slope)) != pivot
        # All parameters from those that are kept: theta = basis z + offset m.
        self.basis = np.eye(len(self.slope))[:, self.kept]
        self.basis[pivot] = -self.slope[self.kept] / self.slope[pivot]
        self.offset = np.where(self.kept, 0.0, 1.0 / self.slope[pivot])

    def rows(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prediction less readings in units of the noise (n,), and its derivatives (n, p)."""
        if self._last is not None and np.array_equal(self._last[0], at):
            return self._last[1:]
        model, point = self.problem.row_model, self.problem.row_model.point
        assert point is not None
        rank, values = model.base.rank, point.values.copy()
        values[point.free] = at[rank:]
        links = nearest_links(model.robot, model.base, at[:rank])
        absorbed = absorbed_offset(model.base, links)
        there = replace(point, links=links.reshape(-1, 10), base=at[:rank], values=values, absorbed=absorbed)
        left, slopes = [], []
        for block in relinearised(self.problem, there).regression.rows.blocks():
            std = (self.estimate.noise.get(block.group) or next(iter(self.estimate.noise.values()))).std
            left.append((-block.residual(at) / std).ravel())
            slopes.append((block.matrix / std[:, None]).reshape(-1, len(at)))
        self._last = at.copy(), np.concatenate(left), np.concatenate(slopes)
        return self._last[1:]

    def least(self, mass: float, start: np.ndarray) -> ProfilePoint:
        """The least sum of squares with the mass held, from a start or from where its tangent leads, whichever is lower."""
        along = self._inverse(start) @ self.slope
        ahead = start + along * (mass - self.slope @ start) / (self.slope @ along)
        tried = [np.clip(x, self.low, self.high) for x in (start, ahead)]
        heights = [np.sum(self.rows(self.basis @ x[self.kept] + self.offset * mass)[0] ** 2) for x in tried]
        return self._least(tried[int(np.argmin(heights))], self.basis, self.offset * mass)

    def _least(self, start: np.ndarray, basis: np.ndarray, offset: np.ndarray) -> ProfilePoint:
        kept = np.ones(len(start), bool) if basis.shape[1] == len(start) else self.kept
        low, high = self.low[kept], self.high[kept]
        room = 1e-9 * np.minimum(1.0, np.where(np.isfinite(high - low), high - low, 1.0))
        found = least_squares(
            lambda z: self.rows(basis @ z + offset)[0], np.clip(start[kept], low + room, high - room),
            lambda z: self.rows(basis @ z + offset)[1] @ basis,  # pyright: ignore[reportArgumentType]
            bounds=(low, high), x_scale="jac", ftol=1e-6, xtol=1e-9, gtol=1e-9, max_nfev=60,
        )  # fmt: skip
        at = basis @ found.x + offset
        return ProfilePoint(float(self.slope @ at), 2.0 * float(found.cost), at)

    def free(self) -> ProfilePoint:
        """The least sum of squares with nothing held, in the valley of the fit."""
        found = self._least(self.start, np.eye(len(self.start)), np.zeros(len(self.start)))
        mass = max(float(self.slope @ found.at), 0.0)
        return self.least(mass, found.at)

    def variance(self, at: np.ndarray) -> float:
        """Variance of the mass by white noise, linearised."""
        return float(self.slope @ self._inverse(at) @ self.slope)

    def _inverse(self, at: np.ndarray) -> np.ndarray:
        """Inverse of the normal matrix at a point (p, p)."""
        return _normal_inverse(self.rows(at)[1])

    def covariance(self, at: np.ndarray) -> np.ndarray:
        """Of all parameters beside the mass, by white noise (p, p); those at their bounds are known."""
        inside = ((at > self.low + 1e-6) & (at < self.high - 1e-6))[self.kept]
        basis = self.basis[:, inside]
        return basis @ _normal_inverse(self.rows(at)[1] @ basis) @ basis.T


def _normal_inverse(x: np.ndarray) -> np.ndarray:
    """``(X'X)^+`` (p, p) of columns (n, p) of any units."""
    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    return np.linalg.pinv((x / size).T @ (x / size), rcond=1e-12) / np.outer(size, size)


def has_valley(problem: Problem) -> bool:
    """Whether the model has a load on poses whose shape is estimated, so that it may trade weight for its own."""
    point = problem.row_model.point
    if point is None or not all(s.poses for name in problem.fitted for s in problem.segments[name]):
        return False
    return any(isinstance(e, LoadEffect) and len(e.shape) > 1 for e in problem.row_model.effects) and bool(point.free.all())


def along_mass(
    problem: Problem, estimate: Estimate, slope: np.ndarray, half: float, factor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Base parameters (r,) and covariance (r, r) by which the mass's interval is where the readings do not contradict it.

    ``slope`` gives the mass from the base parameters (r,), ``half`` is half a central interval in standard deviations, and
    ``factor`` variances over those of white noise of the estimate's size.
    """
    rank = len(slope)
    held = HeldCombination(problem, estimate, np.concatenate([slope, np.zeros(len(estimate.solution) - rank)]))
    known = [held.free()]
    for _ in range(_ROUNDS):  # from the lowest point so far, until none is lower
        first = min(known, key=_height)
        known = [first, *_outwards(held, first, -1.0, half), *_outwards(held, first, 1.0, half)]
        if min(known, key=_height).chi2 > first.chi2 - _LOWER:
            break
    known.sort(key=lambda p: p.mass)
    best = min(known, key=_height)
    # Noise that was estimated in another valley is another one.
    factor *= best.chi2 / max(len(held.rows(best.at)[0]) - len(best.at), 1)
    level = half**2 * factor
    within = [k for k, p in enumerate(known) if p.chi2 <= best.chi2 + level]
    low, high = (
        _crossing(held, known[k], known[k + way] if 0 <= k + way < len(known) else None, best.chi2, level)
        for k, way in ((within[0], -1), (within[-1], 1))
    )
    width = max(high.mass - low.mass, 1e-12)
    along = (high.at - low.at)[:rank] / width
    middle = 0.5 * (low.mass + high.mass)
    covariance = factor * held.covariance(best.at)[:rank, :rank] + (0.5 * width / half) ** 2 * np.outer(along, along)
    return best.at[:rank] + along * (middle - best.mass), covariance


def _height(p: ProfilePoint) -> float:
    return p.chi2


def _outwards(held: HeldCombination, first: ProfilePoint, way: float, half: float) -> list[ProfilePoint]:
    """Points of the profile one way from the first, until the sum of squares is well above the level."""
    known, now, size = [first], first, max(abs(first.mass), 0.01)
    step = float(np.clip(0.5 * np.sqrt(held.variance(first.at)), _FIRST[0] * size, _FIRST[1] * size))
    for _ in range(_STEPS):
        mass = max(now.mass + way * step, 0.0)  # there is no body below
        if way * (mass - now.mass) <= 0.0:
            break
        now = held.least(mass, now.at)
        known.append(now)
        step *= _GROWTH
        if now.chi2 > min(map(_height, known)) + half**2 + _ABOVE:
            break
    return known[1:]


def _crossing(held: HeldCombination, inner: ProfilePoint, outer: ProfilePoint | None, least: float, level: float) -> ProfilePoint:
    """Where the profile crosses the level between a point below it and one above; the inner one where there is none above."""
    if outer is None:
        return inner

    def height(p: ProfilePoint) -> float:  # linear in the mass where the profile is a parabola
        return float(np.sqrt(max(p.chi2 - least, 0.0)) - np.sqrt(level))

    below, above = height(inner), height(outer)
    for _ in range(_CROSSINGS):
        share = np.clip(below / (below - above), 0.05, 0.95)
        tried = held.least(inner.mass + float(share) * (outer.mass - inner.mass), inner.at)
        now = height(tried)
        if abs(now) < _NEAR:
            return tried
        if now < 0.0:
            inner, below = tried, now
        else:
            outer, above = tried, now
    return inner
