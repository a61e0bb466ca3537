"""Bodies for robots whose URDF states no masses: about what links of these lengths weigh."""

from __future__ import annotations

import numpy as np

from bayesid.robot import inertia
from bayesid.robot.robot import Robot

#: A link is about this many times as long as it is thick, and about as dense as water [kg/m^3].
_SLENDERNESS, _DENSITY = 4.0, 1000.0
#: Radius of the links of a robot whose joints are all at one place [m].
_RADIUS = 0.05


def states_masses(robot: Robot) -> bool:
    """Whether the URDF gives any moving link a mass."""
    return bool((robot.nominal[:, 0] > 0.0).any())


def typical_links(robot: Robot) -> np.ndarray:
    """Ten parameters a body (b, 10): cylinders of water along the lines from each joint to the next, balls where there is none.

    A guess of shapes, to be near to where nothing else is known; all share one thickness, a quarter of their mean length.
    """
    length = np.linalg.norm(robot.rods[:, 1] - robot.rods[:, 0], axis=1)
    real = length > 1e-3
    radius = float(length[real].mean()) / (2.0 * _SLENDERNESS) if real.any() else _RADIUS
    out = np.zeros((len(robot.body_names), 10))
    for k in range(len(out)):
        own = np.flatnonzero(real & (robot.rod_joint == k)) if k < robot.n else []
        ends = [(robot.rods[i, 0], robot.rods[i, 1], np.pi * radius**2 * length[i]) for i in own]
        ends = ends or [(np.zeros(3), np.zeros(3), 4.0 / 3.0 * np.pi * radius**3)]
        pseudo = np.zeros((4, 4))
        for a, b, volume in ends:
            # Second moment of a uniform line from a to b, and of its thickness.
            line = (np.outer(a, a) + np.outer(b, b)) / 3.0 + (np.outer(a, b) + np.outer(b, a)) / 6.0
            middle = 0.5 * (a + b)
            second = line + 0.25 * radius**2 * np.eye(3)
            pseudo += _DENSITY * volume * np.block([[second, middle[:, None]], [middle[None], np.ones((1, 1))]])
        out[k] = inertia.from_pseudo_inertia(pseudo)
    return out


def assumed_links(robot: Robot) -> np.ndarray:
    """Nominal parameters of every body (b, 10), or typical ones where the URDF states no masses."""
    return robot.nominal if states_masses(robot) else typical_links(robot)
