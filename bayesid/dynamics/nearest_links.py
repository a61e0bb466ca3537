"""From base parameters back to links: nearest to the nominal ones."""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.robot import inertia
from bayesid.robot.robot import Robot


def nearest_links(robot: Robot, base: BaseParameters, values: np.ndarray, determined: np.ndarray | None = None) -> np.ndarray:
    """Link parameters that have these base parameters and are nearest to the nominal ones.

    Minimises ``(phi - phi0)' M (phi - phi0)`` subject to ``K phi = b`` with M the constant pull-back metric of
    the nominal bodies [Lee2020]_, so that "near" means a small relative change of every link's mass
    distribution: ``phi = phi0 + M^-1 K' (K M^-1 K')^-1 (b - K phi0)``.

    Parameters
    ----------
    robot
        Its nominal parameters.
    base, values
        K and b (r,).
    determined
        Which base parameters to meet (r,); the others may stay nominal. Default all.

    Returns
    -------
    parameters
        (10 bodies,).
    """
    keep = np.ones(base.rank, bool) if determined is None else determined
    matrix = base.matrix[keep]
    nominal = robot.nominal.ravel()
    scaled = np.zeros_like(matrix)
    for k, body in enumerate(robot.nominal):
        part = slice(10 * k, 10 * k + 10)
        scaled[:, part] = np.linalg.solve(inertia.pullback_metric(body), matrix[:, part].T).T
    gram = scaled @ matrix.T
    size = np.sqrt(np.diag(gram))
    step = np.linalg.solve(gram / np.outer(size, size), (values[keep] - matrix @ nominal) / size) / size
    return nominal + scaled.T @ step
