"""Robots for the tests, written as URDF text; real arms by their lengths and about their masses.

The inertias are those of uniform ellipsoids of about the links' size, tilted so that all products count:
always possible bodies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from tests.example_robots import ZERO, Joint, Link, Vector, puma560_urdf, urdf_text

PI, HALF = math.pi, math.pi / 2
Y: Vector = (0.0, 1.0, 0.0)
Z: Vector = (0.0, 0.0, 1.0)


def write(folder: Path, text: str) -> Path:
    """Write the URDF into the folder as robot.urdf."""
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def body(name: str, mass: float, com: Vector, half_axes: Vector, rpy: Vector = (0.15, -0.1, 0.2)) -> Link:
    """Uniform solid ellipsoid with the given half axes [m]."""
    x, y, z = (h * h * mass / 5 for h in half_axes)
    return Link(name, mass, com, (y + z, z + x, x + y), rpy)


def puma560() -> str:
    """PUMA 560, 6R, frames of Craig's convention, joints joint1 to joint6."""
    return puma560_urdf()


def ur5() -> str:
    """Universal Robots UR5, 6R."""
    return urdf_text("ur5", *_ur5_parts())


def ur10() -> str:
    """Universal Robots UR10, 6R."""
    sizes = (0.1273, 0.220941, -0.1719, 0.612, 0.5723, 0.1149, 0.1157)
    masses = (7.778, 12.93, 3.87, 1.96, 1.96, 0.202)
    efforts = (330.0, 330.0, 150.0, 54.0, 54.0, 54.0)
    return urdf_text("ur10", *_universal(sizes, masses, efforts, 2.16))


def _ur5_parts() -> tuple[list[Link], list[Joint]]:
    sizes = (0.089159, 0.13585, -0.1197, 0.425, 0.39225, 0.093, 0.09465)
    masses = (3.7, 8.393, 2.275, 1.219, 1.219, 0.1879)
    return _universal(sizes, masses, (150.0, 150.0, 150.0, 28.0, 28.0, 28.0), 3.15)


def _universal(
    sizes: tuple[float, ...], masses: tuple[float, ...], efforts: tuple[float, ...], speed: float
) -> tuple[list[Link], list[Joint]]:
    """Arm of the UR family; sizes: shoulder height and offset, elbow offset, two of arm and of wrist."""
    height, shoulder, elbow, upper, fore, wrist1, wrist2 = sizes
    quarter: Vector = (0.0, HALF, 0.0)
    table: tuple[tuple[str, str, Vector, Vector, Vector, float, Vector, Vector], ...] = (
        ("shoulder_pan", "shoulder", (0, 0, height), ZERO, Z, 2 * PI, (0, 0.04, 0.003), (0.08, 0.1, 0.07)),
        (
            "shoulder_lift",
            "upper_arm",
            (0, shoulder, 0),
            quarter,
            Y,
            2 * PI,
            (0.006, -0.02, 0.65 * upper),
            (0.08, 0.1, 0.75 * upper),
        ),
        ("elbow", "forearm", (0, elbow, upper), ZERO, Y, PI, (0.004, 0, 0.6 * fore), (0.06, 0.07, 0.7 * fore)),
        ("wrist_1", "wrist_1", (0, 0, fore), quarter, Y, 2 * PI, (-0.003, 0.08, 0.005), (0.05, 0.07, 0.06)),
        ("wrist_2", "wrist_2", (0, wrist1, 0), ZERO, Z, 2 * PI, (0.002, 0.004, 0.07), (0.05, 0.06, 0.07)),
        ("wrist_3", "wrist_3", (0, 0, wrist2), ZERO, Y, 2 * PI, (0.001, 0.06, -0.002), (0.04, 0.03, 0.045)),
    )
    links, joints = [body("base_link", 4.0, (0, 0, 0.02), (0.09, 0.09, 0.05))], []
    for row, mass, effort in zip(table, masses, efforts, strict=True):
        joint, link, xyz, rpy, axis, reach, com, half_axes = row
        name, limits = f"{link}_link", (-reach, reach, speed, effort)
        joints.append(Joint(f"{joint}_joint", links[-1].name, name, xyz, rpy, axis=axis, limits=limits))
        links.append(body(name, mass, com, half_axes))
    return links, joints


def wrist_sensor_arm() -> str:
    """UR5-like arm with a sensor joint ``wrist_ft`` within its last link, and a turned tool beyond it."""
    links, joints = _ur5_parts()
    links += [
        body("sensor_plate", 0.35, (0.002, -0.001, 0.012), (0.04, 0.045, 0.02)),
        body("tool", 1.4, (0.03, -0.015, 0.09), (0.05, 0.07, 0.12), (0.3, 0.5, -0.4)),
        Link("tool_tip"),
    ]
    joints += [
        Joint("wrist_ft", "wrist_3_link", "sensor_plate", (0.004, 0.095, 0), (-HALF, 0.2, 0.35), "fixed"),
        Joint("tool_mount", "sensor_plate", "tool", (-0.01, 0.02, 0.03), (0.4, -0.3, 0.7), "fixed"),
        Joint("tip", "tool", "tool_tip", (0.0, 0.0, 0.2), ZERO, "fixed"),
    ]
    return urdf_text("wrist_sensor_arm", links, joints)


def panda() -> str:
    """Franka Emika Panda, 7R with hand, in the maker's modified Denavit-Hartenberg frames."""
    slow, fast = (2.175, 87.0), (2.61, 12.0)
    table: tuple[tuple[Vector, float, float, float, tuple[float, float], float, Vector, Vector], ...] = (
        # origin in the parent, quarter turns about x, range, speed and effort, mass, com, half axes
        ((0, 0, 0.333), 0, -2.8973, 2.8973, slow, 4.97, (0.004, 0.002, -0.048), (0.07, 0.07, 0.14)),
        ((0, 0, 0), -1, -1.7628, 1.7628, slow, 0.647, (-0.003, -0.029, 0.003), (0.06, 0.12, 0.07)),
        ((0, -0.316, 0), 1, -2.8973, 2.8973, slow, 3.229, (0.028, 0.039, -0.067), (0.08, 0.08, 0.14)),
        ((0.0825, 0, 0), 1, -3.0718, -0.0698, slow, 3.588, (-0.053, 0.104, 0.027), (0.09, 0.14, 0.07)),
        ((-0.0825, 0.384, 0), -1, -2.8973, 2.8973, fast, 1.226, (-0.012, 0.041, -0.038), (0.06, 0.09, 0.17)),
        ((0, 0, 0), 1, -0.0175, 3.7525, fast, 1.667, (0.06, -0.014, -0.01), (0.09, 0.06, 0.07)),
        ((0.088, 0, 0), 1, -2.8973, 2.8973, fast, 0.735, (0.01, -0.004, 0.062), (0.05, 0.045, 0.06)),
    )
    links, joints = [body("panda_link0", 2.92, (-0.041, 0, 0.05), (0.13, 0.09, 0.07))], []
    for i, (xyz, quarters, lower, upper, rate, mass, com, half_axes) in enumerate(table, 1):
        name, rpy = f"panda_link{i}", (quarters * HALF, 0.0, 0.0)
        joints.append(Joint(f"panda_joint{i}", links[-1].name, name, xyz, rpy, limits=(lower, upper, *rate)))
        links.append(body(name, mass, com, half_axes))
    joints.append(Joint("panda_joint8", "panda_link7", "panda_link8", (0, 0, 0.107), kind="fixed"))
    joints.append(Joint("panda_hand_joint", "panda_link8", "panda_hand", rpy=(0, 0, -PI / 4), kind="fixed"))
    links += [Link("panda_link8"), body("panda_hand", 0.73, (-0.01, 0, 0.03), (0.03, 0.1, 0.07))]
    return urdf_text("panda", links, joints)


def lwr4() -> str:
    """KUKA LWR 4+, 7R, joints alternately about z and y."""
    table: tuple[tuple[float, int, float, float, float, Vector, Vector, float], ...] = (
        # height in the parent, sense about y or 0 for z, range [degrees], speed, effort, com, half axes, mass
        (0.11, 0, 170, 1.92, 176, (0, -0.06, 0.13), (0.06, 0.08, 0.15), 2.7),
        (0.2005, -1, 120, 1.92, 176, (0, 0.06, 0.07), (0.06, 0.08, 0.15), 2.7),
        (0.2, 0, 170, 2.23, 100, (0, 0.06, 0.13), (0.06, 0.08, 0.15), 2.7),
        (0.2, 1, 120, 2.23, 100, (0, -0.06, 0.07), (0.06, 0.08, 0.15), 2.7),
        (0.2, 0, 170, 3.56, 100, (0, 0.02, 0.124), (0.06, 0.07, 0.12), 1.7),
        (0.19, -1, 120, 3.21, 38, (0, -0.01, 0.02), (0.06, 0.07, 0.08), 1.6),
        (0.078, 0, 170, 3.21, 38, (0.002, 0, 0.02), (0.04, 0.045, 0.03), 0.3),
    )
    links, joints = [body("lwr_base_link", 1.6, (0, 0, 0.055), (0.09, 0.1, 0.06))], []
    for i, (height, sense, degrees, speed, effort, com, half_axes, mass) in enumerate(table):
        axis = (0.0, float(sense), 0.0) if sense else Z
        limits = (-math.radians(degrees), math.radians(degrees), speed, effort)
        link = f"lwr_{i + 1}_link"
        joints.append(Joint(f"lwr_{i}_joint", links[-1].name, link, (0, 0, height), axis=axis, limits=limits))
        links.append(body(link, mass, com, half_axes))
    return urdf_text("lwr4", links, joints)


def prismatic_arm() -> str:
    """Slide, revolute, slide, revolute about oblique axes in turned frames."""
    links = [
        body("frame", 30.0, (0.1, 0, 0.4), (0.5, 0.3, 0.5)),
        body("carriage", 8.0, (0.05, -0.02, 0.1), (0.2, 0.15, 0.1)),
        body("boom", 6.0, (0.25, 0.03, -0.02), (0.35, 0.08, 0.1), (0.3, 0.2, -0.5)),
        body("ram", 3.0, (0.04, -0.05, 0.2), (0.06, 0.07, 0.3), (-0.2, 0.4, 0.1)),
        body("flange", 1.2, (0.06, 0.02, 0.05), (0.1, 0.06, 0.05)),
    ]
    joints = [
        Joint(
            "rail", "frame", "carriage", (0, 0.1, 0.8), (0.1, 0.2, -0.3), "prismatic", (0.8, 0.0, 0.6), (-0.6, 0.6, 1.0, 800.0)
        ),
        Joint(
            "swing", "carriage", "boom", (0.1, 0, 0.15), (0.2, -0.3, 0.5), axis=(0.0, 0.6, 0.8), limits=(-2.4, 2.4, 2.5, 150.0)
        ),
        Joint("lift", "boom", "ram", (0.5, 0.05, 0), (-0.4, 0.3, 0.2), "prismatic", (0.48, 0.6, -0.64), (-0.3, 0.4, 0.8, 400.0)),
        Joint("roll", "ram", "flange", (0, 0.05, 0.4), (0.7, 0.1, -0.2), axis=(-0.36, 0.48, 0.8), limits=(-3.0, 3.0, 4.0, 30.0)),
    ]
    return urdf_text("prismatic_arm", links, joints)


def scara() -> str:
    """Two revolute joints, a slide, a revolute one, all vertical: a drive's offset may be the weight on the slide."""
    links = [
        body("base", 20.0, (0, 0, 0.2), (0.2, 0.2, 0.3)),
        body("upper", 8.0, (0.2, 0, 0), (0.3, 0.08, 0.08)),
        body("fore", 5.0, (0.15, 0, 0), (0.25, 0.07, 0.07)),
        body("quill", 2.0, (0, 0, -0.1), (0.03, 0.03, 0.25)),
        body("flange", 0.7, (0, 0, 0.01), (0.06, 0.06, 0.06)),
    ]
    joints = [
        Joint("turn", "base", "upper", (0, 0, 0.4), limits=(-2.5, 2.5, 5.0, 150.0)),
        Joint("swing", "upper", "fore", (0.4, 0, 0), limits=(-2.4, 2.4, 6.0, 80.0)),
        Joint("slide", "fore", "quill", (0.35, 0, 0), kind="prismatic", limits=(-0.2, 0.05, 1.0, 400.0)),
        Joint("spin", "quill", "flange", (0, 0, -0.2), kind="continuous", limits=(0.0, 0.0, 10.0, 20.0)),
    ]
    return urdf_text("scara", links, joints)


def tree() -> str:
    """Torso with two arms: fixed, prismatic and continuous joints in the left, two revolute in the right."""
    links = [
        body("pelvis", 12.0, (0, 0, 0.1), (0.15, 0.2, 0.15)),
        body("torso", 10.0, (0.02, 0.01, 0.25), (0.15, 0.2, 0.3)),
        body("left_shoulder", 1.5, (0.01, 0.03, 0), (0.06, 0.07, 0.08)),
        body("left_upper", 3.0, (0.12, 0.02, -0.03), (0.2, 0.07, 0.08)),
        body("left_sleeve", 0.8, (0.03, 0, 0.01), (0.06, 0.04, 0.05)),
        body("left_slide", 1.6, (0.15, -0.02, 0.02), (0.18, 0.05, 0.06)),
        body("left_wheel", 0.9, (0.02, 0.03, 0.04), (0.08, 0.09, 0.03)),
        body("right_upper", 3.2, (0.13, -0.03, 0.02), (0.2, 0.06, 0.09)),
        body("right_fore", 2.1, (0.1, 0.01, -0.04), (0.17, 0.06, 0.05)),
        body("right_tool", 0.6, (0.03, 0.02, 0.05), (0.05, 0.04, 0.08)),
    ]
    joints = [
        Joint("waist", "pelvis", "torso", (0, 0, 0.2), limits=(-2.0, 2.0, 1.5, 200.0)),
        Joint("left_bracket", "torso", "left_shoulder", (0, 0.22, 0.45), (0.3, 0, 0.2), "fixed"),
        Joint(
            "left_shoulder_joint",
            "left_shoulder",
            "left_upper",
            (0, 0.06, 0),
            (0.1, 0.4, 0.2),
            axis=Y,
            limits=(-2.2, 2.2, 2.5, 90.0),
        ),
        Joint("left_clamp", "left_upper", "left_sleeve", (0.28, 0, 0), (0, 0.2, -0.3), "fixed"),
        Joint(
            "left_extension",
            "left_sleeve",
            "left_slide",
            (0.05, 0.01, 0),
            (0.2, 0, 0.1),
            "prismatic",
            (1.0, 0.0, 0.0),
            (0.0, 0.3, 0.8, 250.0),
        ),
        Joint("left_wrist", "left_slide", "left_wheel", (0.3, 0, 0), (0, 0.5, 0), "continuous", limits=(0.0, 0.0, 5.0, 20.0)),
        Joint(
            "right_shoulder_joint",
            "torso",
            "right_upper",
            (0, -0.22, 0.45),
            (-0.3, 0, -0.2),
            axis=(0.0, 0.6, 0.8),
            limits=(-2.2, 2.2, 2.5, 90.0),
        ),
        Joint(
            "right_elbow_joint",
            "right_upper",
            "right_fore",
            (0.28, 0, 0.02),
            (0.1, 0.1, -0.4),
            axis=Y,
            limits=(-0.2, 2.4, 3.0, 60.0),
        ),
        Joint("right_mount", "right_fore", "right_tool", (0.25, 0, 0), (0, HALF, 0.3), "fixed"),
    ]
    return urdf_text("tree", links, joints)


ROBOTS: dict[str, Callable[[], str]] = {
    make.__name__: make for make in (puma560, ur5, ur10, panda, lwr4, prismatic_arm, tree, wrist_sensor_arm)
}
