"""Data and nominal links weighed against each other, and the links nearest to nominal ones within a region."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq

from bayesid.estimators.conic.data import LinkData
from bayesid.estimators.conic.prior_strength import LinkPrior
from bayesid.estimators.conic.problem import Conic, Linear, Solution
from bayesid.estimators.conic.solver import solve_conic
from bayesid.regression.linalg import undetermined


def conic(data: LinkData, prior: LinkPrior, bounds: tuple[Linear, ...] = (), strength: float = 1.0) -> Conic:
    """Data and prior, its precision times ``strength``, as one triangular factor by a QR decomposition; nothing is squared."""
    n = data.matrix.shape[1]
    root = np.sqrt(strength) * prior.root
    rows = np.zeros((len(data.target) + len(root), n + 1))
    rows[: len(data.target), :n], rows[: len(data.target), -1] = data.matrix, data.target
    rows[len(data.target) :, : data.size] = root
    rows[len(data.target) :, -1] = root @ prior.mean
    length = np.linalg.norm(rows[:, :n], axis=0)
    # A prior may be far weaker than the data, and is used in the rows as it stands.
    nothing = undetermined(rows[:, :n], 1e-10)
    if nothing.any():
        # Columns that neither side knows, such as an effect that never acts: held at zero by next to nothing.
        hold = np.zeros((int(nothing.sum()), n + 1))
        hold[np.arange(len(hold)), np.flatnonzero(nothing)] = np.where(length > 0, 1e-6 * length, 1.0)[nothing]
        rows = np.concatenate([rows, hold])
    r = np.asarray(np.linalg.qr(rows, mode="r"))
    r = r * np.where(np.diag(r) < 0, -1.0, 1.0)[: len(r), None]
    return Conic(
        factor=r[:n, :n],
        centre=solve_triangular(r[:n, :n], r[:n, -1]),
        bodies=data.bodies,
        references=prior.references,
        bounds=bounds,
    )


def misfit(data: LinkData, x: np.ndarray) -> float:
    """Squared distance from the unconstrained estimate, which fits its factor exactly."""
    return float(np.sum((data.matrix @ x - data.target) ** 2))


def closest_within(limit: float, data: LinkData, prior: LinkPrior, bounds: tuple[Linear, ...] = ()) -> tuple[Solution, Conic]:
    """The possible links nearest to the nominal ones among those whose misfit is at most the limit, and the problem they solve.

    They minimise misfit and distance weighed with a multiplier, and the misfit grows with the distance's
    weight: so the multiplier is the root of one equation, and the last problem's certificate is this one's.
    """

    def solved(log_strength: float) -> tuple[Solution, Conic]:
        problem = conic(data, prior, bounds, float(np.exp(log_strength)))
        return solve_conic(problem), problem

    def beyond(log_strength: float) -> float:
        return misfit(data, solved(log_strength)[0].x) / limit - 1.0

    low = float(np.log(prior.loosened))
    high = low + 3.0
    while beyond(high) < 0.0:
        if high > low + 40.0:  # the nominal links themselves fit as well as that
            return solved(high)
        low, high = high, high + 3.0
    root: Any = brentq(beyond, low, high, xtol=1e-9)
    return solved(float(root))
