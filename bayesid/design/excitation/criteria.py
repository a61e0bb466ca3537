"""What a motion is judged by: functions of the information matrix, with their gradients.

``A = L' (X' W X) L + 1`` is the information about the base parameters in units of their typical size, one unit of which is added
for what is known beforehand ([Chaloner1995]_); no choice of units changes it. Functions of its eigenvalues l_i:

    d          sum log l_i / r                  the volume of the uncertainty ellipsoid (to be maximised)
    a          sum 1 / l_i / r                  the mean variance
    e          max 1 / l_i                      the variance of the worst direction
    condition  sqrt(max l_i / min l_i)          how uneven the directions are, here in SI units and with all channels alike
    quantity   trace(C' A^-1 C)                 the variance of chosen quantities ``C' beta``

Largest and smallest eigenvalues are replaced by means of their powers, ``(sum l_i^p)^(1/p)``, which have a gradient where two
meet ([Kiefer1974]_). What is minimised is a logarithm throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError

CRITERIA = {
    "d": "D-optimal: smallest volume of the uncertainty ellipsoid",
    "a": "A-optimal: smallest mean variance",
    "e": "E-optimal: smallest variance of the worst direction",
    "condition": "smallest condition number",
    "quantity": "smallest variance of chosen quantities",
}
_POWER = 8.0

Value = tuple[float, np.ndarray]


def _d(values: np.ndarray) -> tuple[float, np.ndarray]:
    return -float(np.mean(np.log(values))), -1.0 / (values * len(values))


def _a(values: np.ndarray) -> tuple[float, np.ndarray]:
    return _power(values, -1.0)


def _power(values: np.ndarray, p: float) -> tuple[float, np.ndarray]:
    """``log(mean l^p) / |p|``, scaled so that powers neither overflow nor vanish."""
    top = values.max() if p > 0 else values.min()
    ratio = (values / top) ** p
    value = (np.log(np.mean(ratio)) + p * np.log(top)) / abs(p)
    return float(value), np.sign(p) * ratio / values / ratio.sum()


def _e(values: np.ndarray) -> tuple[float, np.ndarray]:
    return _power(values, -_POWER)


def _condition(values: np.ndarray) -> tuple[float, np.ndarray]:
    (high, up), (low, down) = _power(values, _POWER), _power(values, -_POWER)
    return 0.5 * (high + low), 0.5 * (up + down)


_OF_EIGENVALUES: dict[str, Callable[[np.ndarray], tuple[float, np.ndarray]]] = {
    "d": _d, "a": _a, "e": _e, "condition": _condition,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Criterion:
    """A function of the information matrix that is to be as small as possible.

    Attributes
    ----------
    name
        One of `CRITERIA`.
    quantities
        C: linear functions of the scaled base parameters whose variance counts (r, m); for ``quantity`` only.
    """

    name: str = "d"
    quantities: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Check the name.

        Raises
        ------
        InputError
            There is no such criterion, or ``quantity`` without any.
        """
        if self.name not in CRITERIA:
            raise InputError(f"{argument('criterion', self.name)}: choose one of {', '.join(CRITERIA)}")
        if (self.quantities is None) == (self.name == "quantity"):
            raise InputError(
                f"{argument('criterion', 'quantity')} goes with {argument('quantities')}: name the quantities, or choose "
                "another criterion"
            )

    def __call__(self, information: np.ndarray) -> Value:
        """Value and gradient (r, r), both of the scaled information matrix (r, r)."""
        values, vectors = np.linalg.eigh(information)
        values = np.maximum(values, 1e-12 * max(values[-1], 1e-300))
        if self.quantities is not None:
            inside = vectors.T @ self.quantities
            solved = inside / values[:, None]
            variance = float(np.sum(inside * solved))
            solved = vectors @ solved
            return float(np.log(variance)), -(solved @ solved.T) / variance
        value, slope = _OF_EIGENVALUES[self.name](values)
        return value, (vectors * slope) @ vectors.T
