"""How an effect enters a search for effects: by columns at some values, or by values tried exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesid.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What an effect may want to know of the recordings that it is sought in.

    Attributes
    ----------
    robot
        The nominal robot.
    mean_places
        Mean position of each link's frame over the fitted motions, in the base frame (n, 3) [m].
    joint_inertia
        Mean inertia that each joint feels over the first fitted motion (n,) [kg m^2 or kg].
    moving
        Whether each joint moves in the fitted motions (n,).
    links_known
        Whether a prior standard deviation of the nominal links is stated.
    both_channels
        Whether wrench and torques are compared together.
    static_run
        Whether static readings are among those compared, which remove a constant offset.
    base_sensor
        Whether the readings of a sensor under the base are compared.
    """

    robot: Robot
    mean_places: np.ndarray
    joint_inertia: np.ndarray
    moving: np.ndarray
    links_known: bool
    both_channels: bool
    static_run: bool
    base_sensor: bool


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Values at which an effect's derivatives are taken as columns, and what amplitudes of these columns mean.

    Attributes
    ----------
    at
        The values (k,).
    to_values
        From amplitudes of the columns (k,) to values (k,), or to several starts (m, k).
    to_amplitudes
        From values (k,) to amplitudes (k,).
    """

    at: np.ndarray
    to_values: Callable[[np.ndarray], np.ndarray]
    to_amplitudes: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def holding(cls, at: np.ndarray, held: np.ndarray, away: np.ndarray | float = 0.0) -> Linearisation:
        """Amplitudes are what values differ from ``away``, but for those that are held where the columns are taken."""
        return cls(at, partial(_values, at, held, away), partial(_amplitudes, held, away))


def _values(at: np.ndarray, held: np.ndarray, away: np.ndarray | float, amplitudes: np.ndarray) -> np.ndarray:
    return np.where(held, at, away + amplitudes)


def _amplitudes(held: np.ndarray, away: np.ndarray | float, values: np.ndarray) -> np.ndarray:
    return np.where(held, 0.0, values - away)
