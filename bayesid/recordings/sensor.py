"""The force/torque sensor: where it sits, and its noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from bayesid.argument_types import explains_types
from bayesid.errors import InputError


@explains_types
@dataclass(frozen=True, eq=False)
class Sensor:
    """The force/torque sensor.

    Attributes
    ----------
    joint
        The URDF joint it sits in; None: between the world and the base.
    translation, rpy
        Origin (3,) [m] and orientation (3,) [rad] of its frame in the base frame, or in that joint's child link.
    force_std, torque_std
        Noise of one sample [N], [N m], where known.
    """

    joint: str | None = None
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rpy: np.ndarray = field(default_factory=lambda: np.zeros(3))
    force_std: float | None = None
    torque_std: float | None = None

    def __post_init__(self) -> None:
        """Make the vectors read-only and check their length."""
        for name in ("translation", "rpy"):
            vector = np.array(getattr(self, name), dtype=np.float64)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise InputError(f"sensor {name}: {vector.tolist()} will not do; give three numbers")
            vector.setflags(write=False)
            object.__setattr__(self, name, vector)
        for name in ("force_std", "torque_std"):
            std = getattr(self, name)
            if std is not None and not 0.0 < std < np.inf:
                raise InputError(f"sensor {name}: {std} is no sensor's noise; give a number above 0, or None if it is not known")

    @property
    def rotation(self) -> np.ndarray:
        """Orientation of its frame as a matrix (3, 3)."""
        return pin.rpy.rpyToMatrix(*map(float, self.rpy))
