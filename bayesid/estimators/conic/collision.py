"""Boxes that hold the collision geometry of a robot's bodies."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import pinocchio as pin

from bayesid.errors import InputError
from bayesid.robot.robot import Robot


def collision_boxes(robot: Robot, locked: Mapping[str, float] | None = None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """For each body with collision geometry the box along its frame's axes that holds all of it.

    Parameters
    ----------
    robot
        Loaded from a URDF with ``<collision>`` elements; a split sensor link has no box.
    locked
        Positions of the locked joints, as for `bayesid.load_robot`.

    Returns
    -------
    dict
        Body's name: lower and upper corner (3,), (3,) [m], for `Bounds.box`.

    Raises
    ------
    InputError
        The URDF has no collision geometry, or its meshes cannot be read.
    """
    model = pin.buildModelFromXML(robot.description.text)
    try:
        folder = str(robot.urdf.parent)
        shapes = pin.buildGeomFromUrdfString(model, robot.description.text, pin.GeometryType.COLLISION, package_dirs=folder)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{robot.urdf.name}: collision geometry cannot be read ({reason}); give boxes in numbers") from None
    data, q = model.createData(), pin.neutral(model)
    for name, position in (locked or {}).items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [position] if joint.nq == 1 else [np.cos(position), np.sin(position)]
    pin.forwardKinematics(model, data, q)
    ids = {model.getJointId(name): name for name in robot.joint_names if name in robot.body_names}
    out: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for shape in shapes.geometryObjects:
        joint = int(shape.parentJoint)
        while joint and joint not in ids:
            joint = int(model.parents[joint])
        if not joint:
            continue
        placement = data.oMi[joint].inverse() * data.oMi[shape.parentJoint] * shape.placement
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        low, high = np.asarray(box.min_).reshape(3), np.asarray(box.max_).reshape(3)
        corners = np.array(list(product(*zip(low, high, strict=True))))
        corners = corners @ placement.rotation.T + placement.translation
        name = ids[joint]
        before = out.get(name, (corners[0], corners[0]))
        out[name] = np.minimum(before[0], corners.min(axis=0)), np.maximum(before[1], corners.max(axis=0))
    if not out:
        raise InputError(f"{robot.urdf.name} has no <collision> geometry on moving links; give boxes in numbers")
    return out
