"""An identified robot as a model of MuJoCo.

MuJoCo itself reads the identified URDF and writes the file; armature, damping and frictionloss are set from the effects that were
found. Before the file is believed, its mass matrix and its bias forces are compared with Pinocchio's at random states.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bayesid.errors import InputError
from bayesid.robot.mjcf import compare, load_mujoco
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics, urdf_text

#: The effect that MuJoCo calls armature.
ARMATURE = "rotor_inertia"


@dataclass(frozen=True)
class JointConstants:
    """What MuJoCo has inside a joint, by joint name, and what it has no place for.

    Attributes
    ----------
    damping, frictionloss, armature
        Of joints that any was identified of [N m s/rad, N m, kg m^2, or those of a slide].
    left_out
        Negative ones, ``joint1 armature``: MuJoCo takes none.
    beside
        Value and unit of everything else that was identified, by name.
    """

    damping: dict[str, float]
    frictionloss: dict[str, float]
    armature: dict[str, float]
    left_out: tuple[str, ...]
    beside: dict[str, tuple[float, str]]


def joint_constants(robot: Robot, dynamics: JointDynamics) -> JointConstants:
    """What of the identified effects MuJoCo can hold."""
    armature, negative, beside = {}, list(dynamics.left_out), {}
    own = {f"{ARMATURE}@joint{k + 1}.inertia": name for k, name in enumerate(robot.joint_names)}
    for name, (value, unit) in dynamics.beside.items():
        if name not in own:
            beside[name] = (value, unit)
        elif value >= 0.0:
            armature[own[name]] = value
        else:
            negative.append(f"{own[name]} armature")
    damping, friction = (
        {joint: values[key] for joint, values in dynamics.friction.items() if key in values} for key in ("damping", "friction")
    )
    return JointConstants(damping, friction, armature, tuple(negative), beside)


def mjcf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> str:
    """The text of an MJCF file.

    Parameters
    ----------
    robot
        Loaded from the URDF whose links and joints it has; visuals, collision shapes and meshes are left out.
    locked
        Where joints stand that are not among the robot's [rad or m]; they are fixed there.
    links
        Ten parameters a body (10 b,).
    dynamics
        What was identified inside the joints.

    Raises
    ------
    InputError
        The package mujoco is missing, MuJoCo refuses the robot, or both libraries do not agree on it.
    """
    mujoco = load_mujoco()
    urdf = _plain_urdf(robot, locked, links, dynamics)
    constants = joint_constants(robot, dynamics)
    try:
        spec = mujoco.MjSpec.from_string(urdf)
        spec.option.gravity = robot.gravity
        for name in robot.joint_names:
            spec.joint(name).armature = constants.armature.get(name, 0.0)
        model = spec.compile()
        text = _with_all_digits(mujoco, spec.to_xml(), model, constants.beside)
        written = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"MuJoCo refuses the identified robot ({reason})", file=robot.urdf.name,
            remedy="a moving link without mass and inertia is no body for it: identify with more motion, or write a URDF instead",
        ) from None  # fmt: skip
    armature = np.array([constants.armature.get(name, 0.0) for name in robot.joint_names])
    compare(
        written, urdf, robot.joint_names, armature, robot.gravity.tolist(), robot.urdf.name, "write a URDF instead, and report it"
    )
    return text


def _plain_urdf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> str:
    """The identified URDF without shapes, with the joints that do not move fixed where they stand."""
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
            _move_limits(joint, robot, robot.joint_names.index(name))
    settings = ET.Element("mujoco")
    ET.SubElement(settings, "compiler", fusestatic="false", discardvisual="true", balanceinertia="false")
    root.insert(0, settings)
    return ET.tostring(root, encoding="unicode")


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


def _move_limits(joint: ET.Element, robot: Robot, k: int) -> None:
    """A joint without limits of its position is one that turns without end: MuJoCo would hold it at zeros."""
    if joint.get("type") == "revolute" and not np.isfinite([robot.lower[k], robot.upper[k]]).all():
        joint.set("type", "continuous")


def _with_all_digits(mujoco: Any, text: str, model: Any, beside: Mapping[str, tuple[float, str]]) -> str:
    """MuJoCo's file with all digits of its compiled model, of which it writes six, and comments on what it does not hold."""
    root = ET.fromstring(text)
    for element in root.iter("body"):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, element.get("name"))
        _put(element, {"pos": model.body_pos[body], "quat": model.body_quat[body]})
        inertial = element.find("inertial")
        if inertial is not None:
            for key in ("fullinertia", "quat"):
                inertial.attrib.pop(key, None)
            _put(inertial, {
                "pos": model.body_ipos[body], "quat": model.body_iquat[body], "mass": model.body_mass[body],
                "diaginertia": model.body_inertia[body],
            })  # fmt: skip
    for element in root.iter("joint"):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, element.get("name"))
        dof = model.jnt_dofadr[joint]
        _put(element, {
            "axis": model.jnt_axis[joint], "armature": model.dof_armature[dof], "damping": model.dof_damping[dof],
            "frictionloss": model.dof_frictionloss[dof],
        })  # fmt: skip
        if model.jnt_limited[joint]:
            _put(element, {"range": model.jnt_range[joint]})
    option = root.find("option")
    _put(ET.SubElement(root, "option") if option is None else option, {"gravity": model.opt.gravity})
    lines = [f"{name} = {value:.6g} {unit}".rstrip() for name, (value, unit) in beside.items()]
    for line in reversed(["Identified along, and not part of this model:", *lines] if lines else []):
        root.insert(0, ET.Comment(f" {line.replace('--', '- -')} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _put(element: ET.Element, values: Mapping[str, Any]) -> None:
    for key, value in values.items():
        element.set(key, " ".join(repr(float(x)) for x in np.atleast_1d(value)))
