"""Where a sensor cuts a tree of joints in two, and the straight lines between joints."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.errors import InputError


@dataclass(frozen=True)
class SensorPlace:
    """Where the sensor sits in the tree.

    Attributes
    ----------
    parent
        The moving joint whose frame it moves with; -1: the root.
    placement
        Of the sensor joint's child link in that joint's frame.
    bodies
        Which bodies it carries.
    far
        Inertia of a split link's far part, in the sensor joint's child frame; None where no link is split.
    """

    parent: int
    placement: Any
    bodies: np.ndarray
    far: Any | None


def locate_sensor(urdf: Path, model, name: str, index, parent, anchor, frame) -> SensorPlace:
    """Find the sensor's joint.

    Parameters
    ----------
    urdf, model
        The file, for messages, and Pinocchio's model of it.
    name
        The sensor's joint.
    index
        Moving joints by name: their index.
    parent
        Moving joint before each moving joint, -1 for the root (n,).
    anchor, frame
        The moving joint that carries each of the model's joints, and that joint's frame in it.

    Raises
    ------
    InputError
        The URDF has no such joint.
    """
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    found = [k for k, f in enumerate(model.frames) if f.name == name and f.type in kinds]
    if not found:
        known = [f.name for f in model.frames if f.type in kinds and f.name != "universe"]
        close = get_close_matches(name, known, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"its joints are: {', '.join(known)}"
        raise InputError(f"experiment.toml: [sensor] joint '{name}' is not in {urdf.name}; {hint}")
    n = len(parent)
    if name in index:
        i = index[name]
        return SensorPlace(i, pin.SE3.Identity(), np.array([_descends(parent, k, i) for k in range(n)]), None)
    # The sensor sits in a fixed or locked joint: all frames beyond it, through fixed or locked joints, are
    # its far part; moving joints beyond it keep their own bodies.
    here = found[0]
    beyond = [k for k in range(len(model.frames)) if _frame_descends(model, k, here)]
    own_joint = int(model.frames[here].parentJoint)
    mover = anchor[own_joint]
    placement = frame[own_joint] * model.frames[here].placement
    far, bodies = pin.Inertia.Zero(), np.zeros(n + (mover >= 0), bool)
    joints_beyond = {int(model.frames[k].parentJoint) for k in beyond} - {own_joint}
    if model.frames[here].type == pin.FrameType.JOINT:  # a locked joint carries its whole own link
        joints_beyond.add(own_joint)
    else:
        for k in beyond:
            f = model.frames[k]
            if int(f.parentJoint) == own_joint:
                far = far + (placement.inverse() * frame[own_joint] * f.placement).act(f.inertia)
    for j in joints_beyond:
        if anchor[j] == mover:
            far = far + (placement.inverse() * frame[j]).act(model.inertias[j])
        else:
            bodies[[k for k in range(n) if _descends(parent, k, anchor[j])]] = True
    bodies[n:] = True
    return SensorPlace(mover, placement, bodies, far)


def joint_rods(model, anchor, frame) -> tuple[np.ndarray, np.ndarray]:
    """Lines between the origins of neighbouring joints of moving links, none on the root: their joints (r,), ends (r, 2, 3)."""
    joint, ends = [], []
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    for k, child in enumerate(model.frames):
        if child.type not in kinds or k == 0:
            continue
        up = int(child.parentFrame)
        while up and model.frames[up].type not in kinds:
            up = int(model.frames[up].parentFrame)
        # A joint's own frame sits in that joint; the line to it belongs to the link before.
        holder = model.frames[up]
        mover = int(holder.parentJoint)
        if anchor[mover] < 0:
            continue
        if child.type == pin.FrameType.JOINT:
            tip = frame[mover] * model.jointPlacements[int(child.parentJoint)].translation
        else:
            tip = frame[mover] * child.placement.translation
        joint.append(anchor[mover])
        ends.append([frame[mover] * holder.placement.translation, tip])
    return np.array(joint, int), np.array(ends, float).reshape(-1, 2, 3)


def _descends(parent: np.ndarray, joint: int, ancestor: int) -> bool:
    while joint >= 0:
        if joint == ancestor:
            return True
        joint = int(parent[joint])
    return False


def _frame_descends(model, frame: int, ancestor: int) -> bool:
    while frame != ancestor:
        up = int(model.frames[frame].parentFrame)
        if up == frame or frame == 0:
            return False
        frame = up
    return True
