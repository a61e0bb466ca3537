"""Residuals of a problem, exact in the values of its effects, and a descent on them that does not go astray.

A step of Gauss-Newton in all parameters at once may be for the better as links become right, and lead a shape astray. Steps
within a trust region [Branch1999]_ are as long as the linearisation holds, and no value leaves what is plausible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf

import numpy as np
from scipy.optimize import least_squares

from bayesid.dynamics.base_parameters import nearest_links
from bayesid.effects import Point
from bayesid.regression.problem import Problem, absorbed_offset, relinearised


def point_of(problem: Problem) -> Point:
    """Where a problem with effects that readings are not linear in is linearised."""
    point = problem.row_model.point
    assert point is not None
    return point


def shapes(problem: Problem) -> np.ndarray:
    """Which of all effects' parameters readings are not linear in (e,)."""
    return np.array([key in e.shape for e in problem.row_model.effects for key in e.parameters], bool)


def plausible(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Plausible ranges of the effects' parameters that are estimated.

    What readings are linear in has none on a side where it is out already, as a negative friction near zero speed is that a
    diagnosis found. A step back to the bound would make all else worse, so that nothing moved.
    """
    here = point_of(problem)
    effects, now = problem.row_model.effects, here.values[here.free]
    low, high = (np.array([v for e in effects for v in getattr(e, side)])[here.free] for side in ("lower", "upper"))
    linear = ~shapes(problem)[here.free]
    return np.where(linear & (now < low), -inf, low), np.where(linear & (now > high), inf, high)


def point_with(problem: Problem, base: np.ndarray, values: np.ndarray, seen: np.ndarray | None = None) -> Point:
    """The point with links nearest to the nominal ones that have those base parameters (r,), all or those ``seen`` (r,).

    ``values`` are those of all effects' parameters (e,).
    """
    model = problem.row_model
    links = nearest_links(model.robot, model.base, base, seen)
    there = replace(point_of(problem), links=links.reshape(-1, 10), values=values, absorbed=absorbed_offset(model.base, links))
    return replace(there, base=model.base.matrix @ links)


@dataclass(eq=False)
class ExactRows:
    """Predictions less readings in units of the noise, and their derivatives."""

    problem: Problem  # linearised anywhere
    std: Mapping[str, np.ndarray]  # of the noise of each channel (c,), by group of rows
    _last: tuple[np.ndarray, Problem, np.ndarray, np.ndarray] | None = field(default=None, init=False)

    @cached_property
    def start(self) -> np.ndarray:
        """All that is estimated, where the problem is linearised (p,)."""
        point = point_of(self.problem)
        return np.concatenate([point.base, point.values[point.free]])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """What is plausible of that (p,)."""
        free = np.full(self.problem.row_model.base.rank, inf)
        low, high = plausible(self.problem)
        return np.concatenate([-free, low]), np.concatenate([free, high])

    def at(self, values: np.ndarray) -> Problem:
        """The problem linearised where all that is estimated has other values (p,)."""
        self.rows(values)
        assert self._last is not None
        return self._last[1]

    def rows(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals there (n,), and their derivatives (n, p)."""
        if self._last is None or not np.array_equal(self._last[0], values):
            model, left, slopes = self.problem.row_model, [], []
            base, effects = values[: model.base.rank], model.every_value(values[model.base.rank :])
            problem = relinearised(self.problem, point_with(self.problem, base, effects))
            for block in problem.regression.rows.pilot():
                std = self.std[block.group]
                left.append((-block.residual(values) / std).ravel())
                slopes.append((block.matrix / std[:, None]).reshape(-1, len(values)))
            self._last = values.copy(), problem, np.concatenate(left), np.concatenate(slopes)
        return self._last[2:]

    def least(
        self, start: np.ndarray, kept: np.ndarray | None = None, basis: np.ndarray | None = None,
        offset: np.ndarray | float = 0.0, *, tolerance: float = 1e-6, most: int = 60,
    ) -> tuple[np.ndarray, float]:  # fmt: skip
        """Values (p,) of the least sum of squares near a start, and that sum.

        Of ``basis z + offset``, z those values that are ``kept`` (p,) and vary; by default all do.
        """
        kept = np.ones(len(start), bool) if kept is None else kept
        basis = np.eye(len(start)) if basis is None else basis
        low, high = (side[kept] for side in self.bounds)
        room = 1e-9 * np.minimum(1.0, np.where(np.isfinite(high - low), high - low, 1.0))
        found = least_squares(
            lambda z: self.rows(basis @ z + offset)[0], np.clip(start[kept], low + room, high - room),
            lambda z: self.rows(basis @ z + offset)[1] @ basis,  # pyright: ignore[reportArgumentType]
            bounds=(low, high), x_scale="jac", ftol=tolerance, xtol=1e-9, gtol=1e-9, max_nfev=most,
        )  # fmt: skip
        return basis @ found.x + offset, 2.0 * float(found.cost)
