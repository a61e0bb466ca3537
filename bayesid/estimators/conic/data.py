"""What rows say of link parameters: a factor of the inverse covariance, and the target it fits exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from bayesid.errors import InputError
from bayesid.regression.linalg import column_lengths
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior


@dataclass(frozen=True)
class LinkData:
    """What the rows say, in units of their noise: ``matrix @ x ~ target`` with unit covariance."""

    #: Of x: link parameters, then effects (k, n), (k,).
    matrix: np.ndarray
    target: np.ndarray
    size: int  # number of link parameters
    #: Ten columns of each body, and its name.
    bodies: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, regression: Regression, matrix: np.ndarray, target: np.ndarray, prior: Prior | None) -> LinkData:
        """Through K from base to link parameters."""
        base, r = regression.base, regression.base.rank
        bodies = regression.knowledge.bodies or (prior.bodies if prior is not None else ())
        if not bodies:
            raise InputError("sdp needs to know which columns are a body's ten parameters; give bodies=")
        for k, body in enumerate(bodies):
            if len(body) != 10 or not all(0 <= c < len(base.parameter_names) for c in body):
                raise InputError(f"bodies[{k}] = {list(body)}: give ten columns in the order {', '.join(inertia.PARAMETERS)}")
        names = [base.parameter_names[body[0]].rsplit(".", 1) for body in bodies]
        labels = tuple(n[0] if len(n) == 2 and n[1] == "m" else f"body{k + 1}" for k, n in enumerate(names))
        whole = np.concatenate([matrix[:, :r] @ base.matrix, matrix[:, r:]], axis=1)
        return cls(whole, target, base.matrix.shape[1], tuple(tuple(b) for b in bodies), labels)


def compressed(matrix: np.ndarray, target: np.ndarray, middle: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """A factor of the inverse covariance of the estimate in the determined directions, and the target it fits exactly.

    With ``R = U S V' D`` the coordinates ``z = S V' D x`` have bread one, so their covariance is their meat.
    """
    length = column_lengths(matrix)
    u, s, vt = np.linalg.svd(matrix / length)
    keep = s > 1e-11 * s[0]
    rows, rotated = s[keep][:, None] * vt[keep] * length, u.T[keep] @ target
    if middle is None:
        return rows, rotated
    whiten = vt[keep] / s[keep][:, None] / length
    covariance = whiten @ middle @ whiten.T
    lower = cholesky(0.5 * (covariance + covariance.T), lower=True)
    return solve_triangular(lower, rows, lower=True), solve_triangular(lower, rotated, lower=True)
