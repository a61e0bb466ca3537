"""An identified robot as SDF, the format of Gazebo and Drake."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from bayesid.errors import InputError
from bayesid.results.export.plain import joint_constants, plain_urdf, with_comments
from bayesid.robot.robot import Robot
from bayesid.robot.urdf import JointDynamics

#: What of `joint_constants` it has a place for.
HELD = ("springs",)
_PLACEHOLDER = "0.001"  # kg, of a root without mass, which does not move: without a number readers take 1 kg


def sdf(robot: Robot, locked: Mapping[str, float], links: np.ndarray, dynamics: JointDynamics) -> str:
    """The text of an SDF file, version 1.9: links and joints with friction and springs, the root fixed to the world.

    Visuals, collision shapes and meshes are left out; ``locked`` are positions of joints that are fixed there [rad or m]. A
    link of no mass that is fixed to another becomes a frame: a reader would give it a kilogram. An `InputError` where a moving
    link has no mass, which SDF has no word for.
    """
    tree, constants = plain_urdf(robot, locked, links, dynamics), joint_constants(robot, dynamics, HELD)
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
        _add_joint(model, joint, name, constants.springs)
    return with_comments(root, constants)


def _add_inertial(link: ET.Element, stated: ET.Element | None) -> None:
    inertial = ET.SubElement(link, "inertial")
    if stated is None:
        ET.SubElement(inertial, "mass").text = _PLACEHOLDER
        return
    ET.SubElement(inertial, "pose").text = _pose(stated)
    ET.SubElement(inertial, "mass").text = _part(stated, "mass").get("value")
    inertia = ET.SubElement(inertial, "inertia")
    for key, value in _part(stated, "inertia").attrib.items():
        ET.SubElement(inertia, key).text = value


def _add_joint(model: ET.Element, joint: ET.Element | None, child: str, springs: Mapping[str, tuple[float, float]]) -> None:
    """The joint above a link: its frame is that of the link, placed in the parent's."""
    if joint is None:
        element = ET.SubElement(model, "joint", name="fixed_to_world", type="fixed")
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
    ET.SubElement(axis, "xyz").text = "1 0 0" if along is None else along.get("xyz")
    if (limit := joint.find("limit")) is not None:
        stated = ET.SubElement(axis, "limit")
        for key in ("lower", "upper") if kind != "continuous" else ():
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
