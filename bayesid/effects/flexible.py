"""Where the link of a flexible joint is, from where its motor is: q_motor = q_link + compliance x torque(q_link).

The torque depends on the link's acceleration, so this is a differential equation for the link. Putting the last link
motion into the right-hand side in turns diverges where ``compliance I w^2 > 1``, above the joint's resonance, where link and
motor move against each other. So each turn's remainder r is divided by what the joint's own inertia I makes of a change d
of the link's motion, ``r = d + compliance I(q) d''``, in least squares over splines: at the resonance itself the motor stands
still whatever the link does, and nothing can be said.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesid.signals.smoothing import Splines

#: Positions, velocities and accelerations of joints (N, n) each [rad or m and per second (squared)].
MotionArrays = tuple[np.ndarray, np.ndarray, np.ndarray]

#: Turns at most, and the change of the motion, relative to that of the first turn, that ends them.
_TURNS, _SETTLED = 5, 1e-7
#: Near the resonance, where ``|1 - compliance I w^2|`` is less than the root of this, little is corrected.
_DAMPING = 0.05


def link_motion(
    motor: MotionArrays,
    torque: Callable[[MotionArrays, np.ndarray], np.ndarray],
    compliance: np.ndarray,
    inertia: np.ndarray,
    splines: Splines | None,
    stiff: np.ndarray | None = None,
) -> MotionArrays:
    """Link-side positions, velocities and accelerations, (N, n) each, from those of the motors.

    ``torque`` gives the torques (N, k) that a link motion takes of some joints (k,), ``stiff`` those of joints with a
    compliance if they were stiff (N, k); ``compliance`` is zero for stiff joints (n,) [rad/(N m) or m/N], and ``inertia`` what
    each joint feels (N, n) [kg m^2 or kg]. ``splines`` are functions of time in which links move otherwise than motors; None:
    every sample is a pose at rest.
    """
    which = np.flatnonzero(compliance)
    link = (motor[0].copy(), motor[1].copy(), motor[2].copy())
    if splines is None:
        for _ in range(_TURNS):
            link[0][:, which] = motor[0][:, which] - compliance[which] * torque(link, which)
        return link
    systems: list[Callable[[np.ndarray], np.ndarray]] = []
    for j in which:
        own = (compliance[j] * inertia[:, j])[:, None] * splines.values[2]
        systems.append(splines.factored(splines.values[0] + own, np.sqrt(_DAMPING) * own))
    first = np.inf
    for turn in range(_TURNS):
        taken = stiff if turn == 0 and stiff is not None else torque(link, which)
        left = motor[0][:, which] - compliance[which] * taken - link[0][:, which]
        largest = 0.0
        for k, (j, solved) in enumerate(zip(which, systems, strict=True)):
            change = splines.motion(solved(left[:, k]))
            largest = max(largest, float(np.abs(change[0]).max()))
            for mine, part in zip(link, change, strict=True):
                mine[:, j] += part
        first = largest if turn == 0 else first
        if largest <= _SETTLED * first:
            break
    return link


def own_inertia(torque: Callable[[MotionArrays, np.ndarray], np.ndarray], positions: np.ndarray, joint: int) -> np.ndarray:
    """Inertia that a joint feels at positions (N, n), from the torques that link motions take (N,) [kg m^2 or kg]."""
    held = np.zeros_like(positions)
    turning, only = held.copy(), np.array([joint])
    turning[:, joint] = 1.0
    return (torque((positions, held, turning), only) - torque((positions, held, held), only))[:, 0]
