"""How much a robot differs from itself without anything having changed, and how large changes may be.

Friction of real joints wanders from day to day with load, temperature and grease, and the gain from motor current to torque is
known to a few per cent. Neither is a change worth a name. Recordings of one UR10e over three weeks
(docs/studies/before-after): with 10 % of friction and 2 % of drive gains as nuisances nothing is named between any two unloaded
ones, and intervals of a known payload hold.
"""

from __future__ import annotations

import numpy as np

from bayesid.effects import Effect, JointGainEffect
from bayesid.effects.sizes import mass_beyond, reach
from bayesid.robot.robot import Robot

#: Friction wanders by this share of its value, and by this share of a typical size where its value is near zero.
FRICTION_SHARE, FRICTION_FLOOR = 0.1, 1e-3
#: Drive gains differ from those of the reference by this share.
GAIN_SHARE = 0.02
#: Friction of all joints may wander this many times as much, on a cold day or under a load, and the reference's intervals may be
#: that much too short for another motion; each doubling at odds of 1 to 20 beforehand. What changed must stand out of that.
WANDER_FACTORS = {1.0: 0.0, 2.0: -3.0, 4.0: -6.0}
#: Dispersion: factors on the variance of AFTER's own noise that every hypothesis may choose from.
DISPERSIONS = np.geomspace(0.5, 8.0, 41)
#: Sizes of a change as multiples of a typical one, equally likely beforehand; so no evidence hangs on one guess of a size.
SIZES = (0.03, 0.1, 0.3, 1.0, 3.0)
#: A payload is of the order of this share of the arm's mass; its middle is near the joint or, on a long tool, further out: by
#: these shares of the arm's reach, equally likely beforehand.
PAYLOAD_MASS, PAYLOAD_REACHES = 0.1, (0.1, 0.3)


def wander(effect: Effect, values: np.ndarray, robot: Robot) -> np.ndarray:
    """Standard deviation of an effect's values (k,) from one recording to another with nothing changed; zero: it stays."""
    if isinstance(effect, JointGainEffect):
        return np.full(len(values), GAIN_SHARE)
    free = np.array([effect.wanders and p.linear and not p.lasting for p in effect.quantities])
    return np.where(free, FRICTION_SHARE * np.abs(values) + FRICTION_FLOOR * np.abs(effect.typical(robot)), 0.0)


def body_sizes(robot: Robot, mass_share: float, reach_share: float) -> np.ndarray:
    """Size of the ten parameters of something attached to a link (10,), by its shares of the arm's mass and reach."""
    mass, arm = mass_share * mass_beyond(robot, None), reach_share * reach(robot)
    return mass * np.array([1.0, *(arm,) * 3, *(arm**2,) * 6])
