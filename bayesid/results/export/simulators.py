"""An identified robot as simulators take it: what is inside its joints, and models of MuJoCo (MJCF), Gazebo and Drake (SDF)."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from bayesid.errors import InputError
from bayesid.robot import inertia
from bayesid.robot.mjcf import compare, load_mujoco, number_text
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics, add_comments, carried, urdf_text
from bayesid.robot.urdf_file import stated_body

#: Time step of a simulation [s] down to which delays have room for their history.
FINEST_STEP = 5e-4
#: What of `joint_constants` SDF has a place for.
HELD_BY_SDF = ("springs",)
_PLACEHOLDER = "0.001"  # kg, of an SDF's root without mass, which does not move: without a number readers take 1 kg
#: The effect that simulators call armature.
ARMATURE = "rotor_inertia"


@dataclass(frozen=True)
class JointConstants:
    """What simulators have inside a joint beside friction, by joint name, and what they have no place for."""

    armature: dict[str, float] = field(default_factory=dict)  # of joints that any was identified of [kg m^2, or kg of a slide]
    #: Stiffness and rest position [N m/rad, rad, or those of a slide].
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    #: By how much torques are read later than positions [s]; negative where they are read before they act.
    delays: dict[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # negative ones, ``joint1 armature``: simulators take none
    #: Value and unit of everything else that was identified, by name.
    beside: dict[str, tuple[float, str]] = field(default_factory=dict)


def joint_constants(robot: Robot, dynamics: JointDynamics, holds: tuple[str, ...]) -> JointConstants:
    """What of the identified effects a simulator can hold, of ``armature``, ``springs`` and ``delays``, beside friction."""
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
    return JointConstants(armature, springs, delays, tuple(negative), beside)


def plain_urdf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> ET.Element:
    """The identified URDF without shapes and comments, with the joints that do not move fixed where they stand."""
    root = ET.fromstring(urdf_text(robot, links, dynamics))
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for element in (e for tag in ("material", "transmission", "gazebo", "mujoco") for e in root.findall(tag)):
        root.remove(element)
    links_by_name, joints = ({e.get("name"): e for e in root.findall(tag)} for tag in ("link", "joint"))
    for link in (links_by_name[name] for name in carried(robot.description.root_link, joints, robot.body_names)):
        # Simulators refuse what no body can have, here of links that do not move, so that nothing depends on it.
        if not inertia.is_physically_consistent(stated_body(link, partial(InputError, file=robot.urdf.name))):
            link.remove(_part(link, "inertial"))
    for joint in joints.values():
        name, kind = str(joint.get("name")), str(joint.get("type"))
        for element in joint.findall("mimic"):
            joint.remove(element)
        if name not in robot.joint_names and kind != "fixed":
            _fix(joint, kind, locked.get(name, 0.0))
        elif name in robot.joint_names:
            k = robot.joint_names.index(name)
            if not np.isfinite([robot.lower[k], robot.upper[k]]).all():
                # Without limits it moves without end: zeros, which mean none in a URDF, would hold it, or be warned of.
                joint.set("type", "continuous" if kind == "revolute" else kind)
                for limit in joint.findall("limit"):
                    limit.attrib.pop("lower", None)
                    limit.attrib.pop("upper", None)
    return root


def _fix(joint: ET.Element, kind: str, position: float) -> None:
    """Make a joint fixed where it stands."""
    origin, axis = joint.find("origin"), joint.find("axis")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
    along = np.array("1 0 0".split() if axis is None else axis.get("xyz", "1 0 0").split(), float)
    along = along / np.linalg.norm(along)
    turn = pin.rpy.rpyToMatrix(*map(float, rpy))
    if kind == "prismatic":
        xyz = xyz + turn @ (position * along)
    else:
        turn = turn @ pin.exp3(position * along)
    origin.set("xyz", number_text(xyz))
    origin.set("rpy", number_text(pin.rpy.matrixToRpy(turn)))  # at a pitch of a right angle, too
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "calibration", "safety_controller"):
        for element in joint.findall(tag):
            joint.remove(element)


def with_comments(root: ET.Element, constants: JointConstants) -> str:
    """The text of a file, with comments on what was identified and the format does not hold."""
    add_comments(root, "Identified along, and not part of this model:", constants.beside)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def held_by_mujoco() -> tuple[str, ...]:
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
    constants = joint_constants(robot, dynamics, held_by_mujoco())
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
        element.set(key, number_text(value))


def sdf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> str:
    """The text of an SDF file, version 1.9: links and joints with friction and springs, the root fixed to the world.

    Visuals, collision shapes and meshes are left out; ``locked`` are positions of joints that are fixed there [rad or m]. A
    link of no mass that is fixed to another becomes a frame: a reader would give it a kilogram. A link that is called ``world``,
    or as a joint, gets ``_link`` behind its name. An `InputError` where a moving link has no mass, which SDF has no word for.
    """
    tree, constants = plain_urdf(robot, locked, links, dynamics), joint_constants(robot, dynamics, HELD_BY_SDF)
    anchor = _name_apart(tree)
    root = ET.Element("sdf", version="1.9")
    model = ET.SubElement(root, "model", name=tree.get("name") or "robot")
    above = {_link(joint, "child"): joint for joint in tree.findall("joint")}
    for link in tree.findall("link"):
        name = str(link.get("name"))
        joint, inertial = above.get(name), link.find("inertial")
        mass = "0" if inertial is None else _part(inertial, "mass").get("value", "0")
        if float(mass) == 0.0 and joint is not None:
            if joint.get("type") != "fixed":
                raise InputError(
                    f"link {name} moves and has no mass, which SDF has no word for", file=robot.urdf.name,
                    remedy="identify with more motion, or write a URDF instead",
                )  # fmt: skip
            frame = ET.SubElement(model, "frame", name=name, attached_to=_link(joint, "parent"))
            ET.SubElement(frame, "pose").text = _pose(joint)
            continue
        element = ET.SubElement(model, "link", name=name)
        if joint is not None:
            ET.SubElement(element, "pose", relative_to=str(joint.get("name")))
        _add_inertial(element, inertial if float(mass) > 0.0 else None)
        _add_joint(model, joint, name, constants.springs, anchor)
    return with_comments(root, constants)


def _add_inertial(link: ET.Element, stated: ET.Element | None) -> None:
    inertial = ET.SubElement(link, "inertial")
    if stated is None:
        ET.SubElement(inertial, "mass").text = _PLACEHOLDER
        return
    ET.SubElement(inertial, "pose").text = _pose(stated)
    ET.SubElement(inertial, "mass").text = _part(stated, "mass").get("value")
    about = ET.SubElement(inertial, "inertia")
    for key, value in _part(stated, "inertia").attrib.items():
        ET.SubElement(about, key).text = value


def _name_apart(tree: ET.Element) -> str:
    """Rename links whose names SDF reserves or has for joints, too; returns a name for the joint that holds the root.

    Links and joints share their names there, which a URDF keeps apart, and ``world`` is the world itself.
    """
    taken = {str(element.get("name")) for tag in ("joint", "link") for element in tree.findall(tag)}

    def free(name: str, ending: str) -> str:
        while name in taken:
            name += ending
        taken.add(name)
        return name

    joints = {joint.get("name") for joint in tree.findall("joint")}
    ends = [end for joint in tree.findall("joint") for end in (_part(joint, "parent"), _part(joint, "child"))]
    for link in tree.findall("link"):
        name = str(link.get("name"))
        if name in joints or name == "world" or re.fullmatch("__.*__", name):
            new = free(name, "_link")
            for element, key in ((link, "name"), *((end, "link") for end in ends if end.get("link") == name)):
                element.set(key, new)
    return free("fixed_to_world", "_joint")


def _add_joint(
    model: ET.Element, joint: ET.Element | None, child: str, springs: Mapping[str, tuple[float, float]], anchor: str
) -> None:
    """The joint above a link, named ``anchor`` above the root: its frame is that of the link, placed in the parent's."""
    if joint is None:
        element = ET.SubElement(model, "joint", name=anchor, type="fixed")
        ET.SubElement(element, "parent").text = "world"
        ET.SubElement(element, "child").text = child
        return
    name, kind = str(joint.get("name")), str(joint.get("type"))
    element = ET.SubElement(model, "joint", name=name, type=kind)
    ET.SubElement(element, "parent").text = _link(joint, "parent")
    ET.SubElement(element, "child").text = child
    ET.SubElement(element, "pose", relative_to=_link(joint, "parent")).text = _pose(joint)
    if kind == "fixed":
        return
    axis, along = ET.SubElement(element, "axis"), joint.find("axis")
    ET.SubElement(axis, "xyz").text = "1 0 0" if along is None else along.get("xyz", "1 0 0")
    if (limit := joint.find("limit")) is not None:
        stated = ET.SubElement(axis, "limit")
        for key in ("lower", "upper") if {"lower", "upper"} & {*limit.keys()} else ():
            ET.SubElement(stated, key).text = limit.get(key, "0")
        for key in ("effort", "velocity"):
            if float(limit.get(key, "0")) > 0.0:
                ET.SubElement(stated, key).text = limit.get(key)
    inside = dict(() if (friction := joint.find("dynamics")) is None else friction.items())
    if name in springs:
        inside |= {"spring_stiffness": repr(springs[name][0]), "spring_reference": repr(springs[name][1])}
    if inside:
        dynamics = ET.SubElement(axis, "dynamics")
        for key, value in inside.items():
            ET.SubElement(dynamics, key).text = value


def _pose(element: ET.Element) -> str:
    """``x y z roll pitch yaw`` of an ``<origin>``, whose angles both formats count alike."""
    origin = element.find("origin")
    return "0 0 0 0 0 0" if origin is None else f"{origin.get('xyz', '0 0 0')} {origin.get('rpy', '0 0 0')}"


def _link(joint: ET.Element, end: str) -> str:
    return str(_part(joint, end).get("link"))


def _part(element: ET.Element, name: str) -> ET.Element:
    found = element.find(name)
    assert found is not None, name  # the URDF was checked
    return found
