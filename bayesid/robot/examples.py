"""The robot of the demonstration: the two-joint PUMA of [Liu1998]_."""

from __future__ import annotations

import math
from importlib.resources import files

#: Angles of the joints that the paper's experiment held still [rad]; q3 = -142.1 degrees is a full turn below 217.9 degrees,
#: which is within the joint's range.
PAPER_LOCKED = {"joint3": math.radians(-142.1), "joint4": 0.0, "joint5": 0.0, "joint6": 0.0}


def puma_two_joint_urdf() -> str:
    """URDF text of a PUMA 560 in link frames that give the paper's base parameters; written by ``tests/example_robots.py``.

    Joints ``joint1`` and ``joint2`` move; hold the others at `PAPER_LOCKED`, so their links belong to link 2.
    """
    return files("bayesid.robot").joinpath("puma_two_joint.urdf").read_text(encoding="utf-8")
