"""Where the link of a flexible joint is, from where its motor is: q_motor = q_link + compliance x torque(q_link).

The torque depends on the link's acceleration, so this is a differential equation for the link. Putting the last link
motion into the right-hand side in turns diverges where ``compliance I w^2 > 1``, above the joint's resonance, where link and
motor move against each other. So each turn's remainder r is divided by what the joint's own inertia I makes of a change d
of the link's motion, ``r = d + compliance I(q) d''``, in least squares over splines: at the resonance itself the motor stands
still whatever the link does, and nothing can be said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numba
import numpy as np

from bayesid.signals.arrays import kernel_input
from bayesid.signals.smoothing import DEGREE

if TYPE_CHECKING:  # sparse matrices take long to import, and few experiments have flexible joints
    from scipy.sparse.linalg import SuperLU

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]

#: Turns at most, and the change of the motion, relative to that of the first turn, that ends them.
_TURNS, _SETTLED = 5, 1e-7
#: Near the resonance, where ``|1 - compliance I w^2|`` is less than the root of this, little is corrected.
_DAMPING = 0.05


@dataclass(frozen=True, eq=False)
class Basis:
    """Functions of time in which links move otherwise than motors, six of which live at each time."""

    first: np.ndarray  # of the six at each time (N,)
    values: np.ndarray  # of the six, and of their first two derivatives (3, N, 6)
    count: int  # number k of functions

    @cached_property
    def pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows and columns of a banded matrix (k, k) where it is not empty, column by column, and where each column starts."""
        columns = np.repeat(np.arange(self.count), 2 * DEGREE + 1)
        rows = columns + np.tile(np.arange(-DEGREE, DEGREE + 1), self.count)
        inside = (rows >= 0) & (rows < self.count)
        return rows[inside], columns[inside], np.append(0, np.cumsum(np.bincount(columns[inside], minlength=self.count)))

    def factor(self, system: np.ndarray, own: np.ndarray) -> SuperLU:
        """Of the damped normal equations of a system (N, 6), ``own`` its part that is damped (N, 6)."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        band = _normal_band(self.first, system, own, _DAMPING, self.count)
        rows, columns, starts = self.pattern
        return splu(sparse.csc_array((band[columns, rows - columns + DEGREE], rows, starts), shape=(self.count, self.count)))

    def moved(self, coefficients: np.ndarray) -> Motion:
        """Position, velocity and acceleration (N,) of coefficients (k,)."""
        out = _sums(self.first, self.values, coefficients)
        return out[0], out[1], out[2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _normal_band(first, system, own, damping, count):
    """Column by column the band (count, 11) of ``S' S + damping O' O`` of rows (N, 6) from their first function on."""
    width = system.shape[1] - 1
    plain, damped = np.zeros((count, 2 * width + 1)), np.zeros((count, 2 * width + 1))
    for n in range(len(first)):
        for j in range(width + 1):
            for i in range(width + 1):
                plain[first[n] + j, i - j + width] += system[n, j] * system[n, i]
                damped[first[n] + j, i - j + width] += own[n, j] * (damping * own[n, i])
    return plain + damped


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(first, values, coefficients):
    """Sums of coefficients (k,) of the functions that live at each time (3, N), with values (3, N, 6)."""
    out = np.zeros(values.shape[:2])
    for order in range(values.shape[0]):
        for n in range(len(first)):
            for i in range(values.shape[2] - 1, -1, -1):  # in the order in which sparse matrices add up
                out[order, n] += values[order, n, i] * coefficients[first[n] + i]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _along(first, rows, values, count):
    """Products of values (N,) with every function (count,), of rows (N, 6)."""
    out = np.zeros(count)
    for n in range(len(first)):
        for i in range(rows.shape[1]):
            out[first[n] + i] += rows[n, i] * values[n]
    return out


def link_motion(
    motor: Motion,
    torque: Callable[[Motion, np.ndarray], np.ndarray],
    compliance: np.ndarray,
    inertia: np.ndarray,
    basis: Basis | None,
    stiff: np.ndarray | None = None,
) -> Motion:
    """Link-side positions, velocities and accelerations, (N, n) each, from those of the motors.

    ``torque`` gives the torques (N, k) that a link motion takes of some joints (k,), ``stiff`` those of joints with a
    compliance if they were stiff (N, k); ``compliance`` is zero for stiff joints (n,) [rad/(N m) or m/N], and ``inertia`` what
    each joint feels (N, n) [kg m^2 or kg]. ``basis`` are functions of time in which links move otherwise than motors,
    `splines`; None: every sample is a pose at rest.
    """
    which = np.flatnonzero(compliance)
    link = (motor[0].copy(), motor[1].copy(), motor[2].copy())
    if basis is None:
        for _ in range(_TURNS):
            link[0][:, which] = motor[0][:, which] - compliance[which] * torque(link, which)
        return link
    systems = []
    for j in which:
        own = (compliance[j] * inertia[:, j])[:, None] * basis.values[2]
        system = basis.values[0] + own
        systems.append((system, basis.factor(system, own)))
    first = np.inf
    for turn in range(_TURNS):
        taken = stiff if turn == 0 and stiff is not None else torque(link, which)
        left = motor[0][:, which] - compliance[which] * taken - link[0][:, which]
        largest = 0.0
        for k, (j, (system, factor)) in enumerate(zip(which, systems, strict=True)):
            change = factor.solve(_along(basis.first, system, kernel_input(left[:, k]), basis.count))
            largest = max(largest, float(np.abs(change).max()))
            for mine, part in zip(link, basis.moved(change), strict=True):
                mine[:, j] += part
        first = largest if turn == 0 else first
        if largest <= _SETTLED * first:
            break
    return link


def own_inertia(torque: Callable[[Motion, np.ndarray], np.ndarray], positions: np.ndarray, joint: int) -> np.ndarray:
    """Inertia that a joint feels at positions (N, n), from the torques that link motions take (N,) [kg m^2 or kg]."""
    held = np.zeros_like(positions)
    turning, only = held.copy(), np.array([joint])
    turning[:, joint] = 1.0
    return (torque((positions, held, turning), only) - torque((positions, held, held), only))[:, 0]


def splines(times: np.ndarray, cutoff: float) -> Basis:
    """Quintic B-splines at times (N,) [s] with nothing above a cutoff [Hz]."""
    from scipy import sparse
    from scipy.interpolate import BSpline

    spacing = 0.5 / cutoff
    pieces = max(int((times[-1] - times[0]) / spacing), 1)
    spacing = (times[-1] - times[0]) / pieces
    knots = times[0] + spacing * np.arange(-DEGREE, pieces + DEGREE + 1)
    inside = np.clip(times, knots[DEGREE], knots[-DEGREE - 1])
    size = pieces + DEGREE
    first = np.clip(np.searchsorted(knots, inside, side="right") - 1 - DEGREE, 0, pieces - 1)
    out = np.zeros((3, len(times), DEGREE + 1))
    for order in range(3):
        part = BSpline.design_matrix(inside, knots[order : len(knots) - order], DEGREE - order)
        # A uniform spline's derivative is one of a degree less, with its coefficients' differences.
        difference = np.diff(np.eye(size), n=order, axis=0) / spacing**order
        columns = sparse.coo_array(part @ sparse.csr_array(difference))
        out[order, columns.row, columns.col - first[columns.row]] = columns.data
    return Basis(first, out, size)
