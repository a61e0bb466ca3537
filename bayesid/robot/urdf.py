"""A robot's URDF with other link parameters."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.robot import inertia
from bayesid.robot.mjcf import number_text
from bayesid.robot.robot import Robot


@dataclass(frozen=True)
class JointDynamics:
    """What was identified beside the links, as a URDF holds it."""

    friction: dict[str, dict[str, float]]  # attributes of ``<dynamics>`` by joint: the identified damping and friction
    left_out: tuple[str, ...] = ()  # identified friction that is negative, and so not written, ``joint1 damping``
    #: Value and unit, by name, of what a URDF has no place for, such as rotor inertia: a simulator needs it beside the file.
    beside: dict[str, tuple[float, str]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values for JSON."""
        return {
            "dynamics": self.friction, "negative_friction": list(self.left_out),
            "not_in_urdf": {name: {"value": value, "unit": unit} for name, (value, unit) in self.beside.items()},
        }  # fmt: skip


def write_urdf(robot: Robot, parameters: np.ndarray, path: Path, dynamics: JointDynamics | None = None) -> None:
    """Write the robot's URDF with other link parameters, as `urdf_text` makes it."""
    path.write_text(urdf_text(robot, parameters, dynamics), encoding="utf-8")


def urdf_text(robot: Robot, parameters: np.ndarray, dynamics: JointDynamics | None = None) -> str:
    """The robot's URDF with other link parameters.

    Every moving joint's child link gets its body's parameters, merged links beyond fixed or locked joints lose
    theirs (they are in the body's), and a split sensor link's far part goes to the sensor joint's child. Elements that
    a joint or an ``<inertial>`` has twice stay as they are read: the first one (MuJoCo refuses others).

    Parameters are ten a body (b, 10) or (10 b,). Friction of joints that ``dynamics`` does not name stays as it is, what it has
    left out goes; what a URDF has no place for stands in comments. Meshes and textures that stand beside the robot's own file are
    named by their whole paths, for the new file stands elsewhere.
    """
    dynamics = dynamics or JointDynamics({})
    root = robot.description.root
    links = {link.get("name"): link for link in root.findall("link")}
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    owners = [_child(joints[name]) for name in robot.body_names]
    for name in owners:
        for merged in carried(name, joints, robot.body_names):
            for old in links[merged].findall("inertial"):
                links[merged].remove(old)
    for name, body in zip(owners, np.reshape(parameters, (-1, 10)), strict=True):
        links[name].insert(0, _inertial(body))
    for name, values in dynamics.friction.items():
        element = joints[name].find("dynamics")
        if element is None:
            element = ET.SubElement(joints[name], "dynamics")
        for attribute, value in values.items():
            element.set(attribute, repr(float(value)))
    for name, _, attribute in (text.rpartition(" ") for text in dynamics.left_out):
        for element in joints[name].findall("dynamics"):
            element.attrib.pop(attribute, None)  # what the URDF stated is no better than none
    for element in (*root.findall("joint"), *root.iter("inertial")):
        kept = {child.tag: child for child in reversed(element)}
        for child in list(element):
            if kept[child.tag] is not child:
                element.remove(child)
    for element in (*root.iter("mesh"), *root.iter("texture")):
        beside = robot.urdf.parent / element.get("filename", "")
        if beside.is_file():
            element.set("filename", beside.resolve().as_posix())
    add_comments(root, "Identified along, and not part of this robot as a URDF has no place for it:", dynamics.beside)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True).decode("utf-8")


def add_comments(root: ET.Element, title: str, beside: Mapping[str, tuple[float, str]]) -> None:
    """Put values and units (by name) that a file has no place for on top of it as comments, below a title; nothing for none."""
    lines = [f"{name} = {value:.6g} {unit}".rstrip() for name, (value, unit) in beside.items()]
    for line in reversed([title, *lines] if lines else []):
        root.insert(0, ET.Comment(f" {line.replace('--', '- -')} "))


def link_names(robot: Robot) -> tuple[str, ...]:
    """The URDF link that holds each body (b,): the child of the joint that it is named after."""
    joints = {joint.get("name"): joint for joint in robot.description.root.findall("joint")}
    return tuple(_child(joints[name]) for name in robot.body_names)


def _child(joint: ET.Element) -> str:
    child = joint.find("child")
    return "" if child is None else str(child.get("link"))


def carried(link: str, joints: dict, bodies: tuple[str, ...]) -> list[str]:
    """The link and all links that joints without a body of their own attach to it."""
    out = [link]
    for carrier in out:
        for name, joint in joints.items():
            parent = joint.find("parent")
            if name not in bodies and parent is not None and parent.get("link") == carrier:
                out.append(_child(joint))
    return out


def _inertial(body: np.ndarray) -> ET.Element:
    mass, com, about = inertia.to_mass_com_inertia(body)
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=number_text(com), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(float(mass)))
    ET.SubElement(element, "inertia", {n: repr(float(about[i])) for n, i in inertia.ENTRIES.items()})
    return element
