"""Coupled transmissions: motors at m = (1 + C) q of their gears' outputs, joints at q.

Where no power is lost, ``tau' dq = tau_m' dm``, the motors give ``tau_m = (1 + C)'^-1 tau`` for the joints' torques.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.effects.families import TransmissionEffect
from bayesid.robot.robot import Robot


def coupling_matrix(robot: Robot, coupled: Sequence[tuple[TransmissionEffect, Sequence[float]]]) -> np.ndarray:
    """From joint positions to the motors', 1 + C (n, n)."""
    out = np.eye(robot.n)
    for effect, values in coupled:
        out[effect.joint, effect.driver] += effect.coupling(values)
    return out


def motor_torques(transmission: np.ndarray, order: Sequence[int], true: np.ndarray) -> np.ndarray:
    """Readings, or changes of them, with what the motors give for the joints' torques.

    Parameters
    ----------
    transmission
        From the motors' positions to the joints', (1 + C)^-1 (n, n).
    order
        Channel of each joint's torque (n,).
    true
        With the joints' torques (N, c, ...).
    """
    out = np.array(true)
    out[:, order] = np.einsum("kj,nk...->nj...", transmission, true[:, order])
    return out
