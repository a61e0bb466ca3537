"""An identified robot as a model of MuJoCo.

MuJoCo itself reads the identified URDF and writes the file; armature, damping and frictionloss are set from the effects that were
found. Before the file is believed, its mass matrix and its bias forces are compared with Pinocchio's at random states.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.results.export.plain import JointConstants, joint_constants, plain_urdf, with_comments
from bayesid.robot.mjcf import compare, load_mujoco
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics

#: Time step of a simulation [s] down to which delays have room for their history.
FINEST_STEP = 5e-4


def held() -> tuple[str, ...]:
    """What of `joint_constants` the MuJoCo that is installed has a place for; delays from version 3.5 on."""
    return ("armature", "springs", *(["delays"] if hasattr(load_mujoco().MjsActuator, "delay") else []))


def mjcf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> str:
    """The text of an MJCF file with links (10 b,); visuals, collision shapes and meshes are left out.

    ``locked`` are positions of joints that are not among the robot's [rad or m]; they are fixed there. An `InputError` where
    the package mujoco is missing, MuJoCo refuses the robot, or both libraries do not agree on it.
    """
    mujoco = load_mujoco()
    root = plain_urdf(robot, locked, links, dynamics)
    settings = ET.Element("mujoco")
    ET.SubElement(settings, "compiler", fusestatic="false", discardvisual="true", balanceinertia="false")
    root.insert(0, settings)
    urdf = ET.tostring(root, encoding="unicode")
    constants = joint_constants(robot, dynamics, held())
    try:
        spec = mujoco.MjSpec.from_string(urdf)
        spec.option.gravity = robot.gravity
        for name in robot.joint_names:
            spec.joint(name).armature = constants.armature.get(name, 0.0)
        model = spec.compile()
        text = _with_all_digits(mujoco, spec.to_xml(), model, constants)
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


def _with_all_digits(mujoco: Any, text: str, model: Any, constants: JointConstants) -> str:
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
        if spring := constants.springs.get(str(element.get("name"))):
            _put(element, {"stiffness": spring[0], "springref": spring[1]})
        if model.jnt_limited[joint]:
            _put(element, {"range": model.jnt_range[joint]})
    option = root.find("option")
    _put(ET.SubElement(root, "option") if option is None else option, {"gravity": model.opt.gravity})
    _add_delays(root, constants.delays)
    return with_comments(root, constants)


def _add_delays(root: ET.Element, delays: Mapping[str, float]) -> None:
    """Torques that are read late are a sensor's, those that act later than they are read a motor's."""
    for joint, delay in delays.items():
        if delay > 0.0:
            element = ET.SubElement(_section(root, "sensor"), "jointactuatorfrc", name=f"{joint}_torque", joint=joint)
        elif delay < 0.0:
            element = ET.SubElement(_section(root, "actuator"), "motor", name=joint, joint=joint)
        else:
            continue
        element.set("nsample", str(int(np.ceil(abs(delay) / FINEST_STEP)) + 1))
        element.set("interp", "linear")
        _put(element, {"delay": abs(delay)})


def _section(root: ET.Element, name: str) -> ET.Element:
    found = root.find(name)
    return ET.SubElement(root, name) if found is None else found


def _put(element: ET.Element, values: Mapping[str, Any]) -> None:
    for key, value in values.items():
        element.set(key, " ".join(repr(float(x)) for x in np.atleast_1d(value)))
