"""Arms as URDF from tables of their makers: Denavit-Hartenberg parameters and mass properties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_QUARTER = 1.57079632679


@dataclass(frozen=True)
class DhLink:
    """A link by the tables of its maker: Denavit-Hartenberg parameters, largest torque and speed, mass properties.

    Lengths in m, angles in rad; the centre of mass and the inertia (ixx, ixy, ixz, iyy, iyz, izz about it) in the link's own
    Denavit-Hartenberg frame.
    """

    a: float
    d: float
    alpha: float
    effort: float
    speed: float
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


#: As Universal Robots publishes them for the UR10e ("DH parameters for calculations of kinematics and dynamics").
UR10E_LINKS = (
    DhLink(0.0, 0.1807, _QUARTER, 330, 2.09, 7.369, (0.021, 0.0, 0.027), (0.0341, 0, -0.0043, 0.0353, 0.0001, 0.0216)),
    DhLink(-0.6127, 0.0, 0.0, 330, 2.09, 13.051, (0.38, 0.0, 0.158), (0.0281, 0.0001, -0.0156, 0.7707, 0, 0.7694)),
    DhLink(-0.57155, 0.0, 0.0, 150, 3.14, 3.989, (0.24, 0.0, 0.068), (0.0101, 0.0001, 0.0092, 0.3093, 0, 0.3065)),
    DhLink(0.0, 0.17415, _QUARTER, 56, 3.14, 2.1, (0.0, 0.007, 0.018), (0.003, 0, 0, 0.0022, -0.0002, 0.0026)),
    DhLink(0.0, 0.11985, -_QUARTER, 56, 3.14, 1.98, (0.0, 0.007, 0.018), (0.003, 0, 0, 0.0022, -0.0002, 0.0026)),
    DhLink(0.0, 0.11655, 0.0, 56, 3.14, 0.615, (0.0, 0.0, -0.026), (0.0006, 0, 0, 0.0006, 0, 0.0004)),
)
_NO_BODY = ((0.0, 0.0, 0.0), (0.001, 0, 0, 0.001, 0, 0.001))
#: The UR10's kinematics and masses; centres of mass and inertias are placeholders, so this is no prior.
UR10_LINKS = tuple(
    DhLink(a, d, alpha, 330, 3.14, mass, *_NO_BODY)
    for a, d, alpha, mass in [
        (0.0, 0.1273, _QUARTER, 7.778), (-0.612, 0.0, 0.0, 12.93), (-0.5723, 0.0, 0.0, 3.87), (0.0, 0.163941, _QUARTER, 1.96),
        (0.0, 0.1157, -_QUARTER, 1.96), (0.0, 0.0922, 0.0, 0.202),
    ]
)  # fmt: skip


def dh_urdf(name: str, joints: tuple[str, ...] | list[str], links: tuple[DhLink, ...]) -> str:
    """An arm as URDF; a joint's frame is the Denavit-Hartenberg frame of the link before it."""
    parts = ['<?xml version="1.0"?>', f'<robot name="{name}">', '  <link name="base_link"/>']
    parent, origin, turn = "base_link", "0 0 0", "0 0 0"
    for joint, link in zip(joints, links, strict=True):
        child = f"{joint.removesuffix('_joint')}_link"
        c, s = np.cos(link.alpha), np.sin(link.alpha)
        x, y, z = link.centre
        centre = (link.a + x, c * y - s * z, link.d + s * y + c * z)
        place = " ".join(f"{round(float(v), 6) + 0.0:g}" for v in centre)
        about = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), link.inertia, strict=True)
        parts += [
            f'  <joint name="{joint}" type="revolute">',
            f'    <parent link="{parent}"/><child link="{child}"/>',
            f'    <origin xyz="{origin}" rpy="{turn}"/><axis xyz="0 0 1"/>',
            f'    <limit lower="-6.2832" upper="6.2832" effort="{link.effort:g}" velocity="{link.speed:g}"/>',
            "  </joint>",
            f'  <link name="{child}"><inertial>',
            f'    <mass value="{link.mass:g}"/>',
            f'    <origin xyz="{place}" rpy="{link.alpha:.12g} 0 0"/>',
            "    <inertia " + " ".join(f'{key}="{value:g}"' for key, value in about) + "/>",
            "  </inertial></link>",
        ]
        parent, origin, turn = child, f"{link.a:g} 0 {link.d:g}", f"{link.alpha:.12g} 0 0"
    return "\n".join([*parts, "</robot>"]) + "\n"
