"""An identified robot as simulators take it: a tree without shapes, and what is inside its joints."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics, urdf_text

#: The effect that simulators call armature.
ARMATURE = "rotor_inertia"


@dataclass(frozen=True)
class JointConstants:
    """What simulators have inside a joint, by joint name, and what they have no place for."""

    #: Of joints that any was identified of [N m s/rad, N m, kg m^2, or those of a slide].
    damping: dict[str, float]
    frictionloss: dict[str, float]
    armature: dict[str, float] = field(default_factory=dict)
    #: Stiffness and rest position [N m/rad, rad, or those of a slide].
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    #: By how much torques are read later than positions [s]; negative where they are read before they act.
    delays: dict[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # negative ones, ``joint1 armature``: simulators take none
    #: Value and unit of everything else that was identified, by name.
    beside: dict[str, tuple[float, str]] = field(default_factory=dict)


def joint_constants(robot: Robot, dynamics: JointDynamics, holds: tuple[str, ...]) -> JointConstants:
    """What of the identified effects a simulator can hold, of ``armature``, ``springs`` and ``delays``, beside friction."""
    damping, friction = (
        {joint: values[key] for joint, values in dynamics.friction.items() if key in values} for key in ("damping", "friction")
    )
    beside, negative = dict(dynamics.beside), list(dynamics.left_out)
    armature, springs, delays = {}, {}, {}
    both = beside.pop("torque_delay@robot.delay", None) if "delays" in holds else None
    for k, joint in enumerate(robot.joint_names):
        place = f"@joint{k + 1}"
        if "armature" in holds and (found := beside.pop(f"{ARMATURE}{place}.inertia", None)):
            if found[0] >= 0.0:
                armature[joint] = found[0]
            else:
                negative.append(f"{joint} armature")
        if "springs" in holds and beside.get(f"spring{place}.stiffness", (-1.0, ""))[0] >= 0.0:
            springs[joint] = (beside.pop(f"spring{place}.stiffness")[0], beside.pop(f"spring{place}.rest")[0])
        if "delays" in holds:
            own = beside.pop(f"torque_delay{place}.delay", None)
            if own or both:
                delays[joint] = sum(found[0] for found in (own, both) if found)
    return JointConstants(damping, friction, armature, springs, delays, tuple(negative), beside)


def plain_urdf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> ET.Element:
    """The identified URDF without shapes and comments, with the joints that do not move fixed where they stand."""
    root = ET.fromstring(urdf_text(robot, links, dynamics))
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for element in (e for tag in ("material", "transmission", "gazebo", "mujoco") for e in root.findall(tag)):
        root.remove(element)
    for joint in root.findall("joint"):
        name, kind = str(joint.get("name")), str(joint.get("type"))
        for element in joint.findall("mimic"):
            joint.remove(element)
        if name not in robot.joint_names and kind != "fixed":
            _fix(joint, kind, locked.get(name, 0.0))
        elif name in robot.joint_names:
            k = robot.joint_names.index(name)
            if kind == "revolute" and not np.isfinite([robot.lower[k], robot.upper[k]]).all():
                joint.set("type", "continuous")  # without limits it turns without end: others would hold it at zeros
    return root


def _fix(joint: ET.Element, kind: str, position: float) -> None:
    """Make a joint fixed where it stands."""
    origin, axis = joint.find("origin"), joint.find("axis")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
    along = np.array("1 0 0".split() if axis is None else str(axis.get("xyz")).split(), float)
    along = along / np.linalg.norm(along)
    turn = Rotation.from_euler("xyz", rpy)
    if kind == "prismatic":
        xyz = xyz + turn.apply(position * along)
    else:
        turn = turn * Rotation.from_rotvec(position * along)
    origin.set("xyz", " ".join(repr(float(x)) for x in xyz))
    origin.set("rpy", " ".join(repr(float(x)) for x in turn.as_euler("xyz")))
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "calibration", "safety_controller"):
        for element in joint.findall(tag):
            joint.remove(element)


def with_comments(root: ET.Element, constants: JointConstants) -> str:
    """The text of a file, with comments on what was identified and the format does not hold."""
    lines = [f"{name} = {value:.6g} {unit}".rstrip() for name, (value, unit) in constants.beside.items()]
    for line in reversed(["Identified along, and not part of this model:", *lines] if lines else []):
        root.insert(0, ET.Comment(f" {line.replace('--', '- -')} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
