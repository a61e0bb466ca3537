"""Robots as URDF text: links and joints written out, and from published numbers the PUMA 560 and the two-joint PUMA of Liu et al.

Kinematics (Craig's modified Denavit-Hartenberg convention), masses and inertias of links 2 to 6:
B. Armstrong, O. Khatib, J. Burdick, "The explicit dynamic model and inertial parameters of the PUMA 560 arm",
IEEE ICRA 1986. The two-joint case: G. Liu, K. Iagnemma, S. Dubowsky, G. Morel, "A base force/torque sensor
approach to robot manipulator inertial parameter estimation", IEEE ICRA 1998.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Link:
    """A URDF link; without mass it is a bare frame."""

    name: str  # name of the link
    mass: float = 0.0  # mass [kg]
    com: Vector = ZERO  # centre of mass in the link frame [m]
    inertia: Sequence[float] = ZERO  # ``Ixx, Iyy, Izz`` or ``Ixx, Ixy, Ixz, Iyy, Iyz, Izz`` about the centre of mass [kg m^2]
    rpy: Vector = ZERO  # orientation of the axes of `inertia` in the link frame [rad]


@dataclass(frozen=True)
class Joint:
    """A URDF joint."""

    #: Names of the joint and the two links.
    name: str
    parent: str
    child: str
    #: Pose of the joint frame in the parent link [m, rad].
    xyz: Vector = ZERO
    rpy: Vector = ZERO
    kind: str = "revolute"  # URDF joint type
    axis: Vector = (0.0, 0.0, 1.0)  # axis in the joint frame
    #: Lower, upper [rad or m], velocity [per second], effort [N m or N]; only the last two matter to a continuous joint.
    limits: tuple[float, float, float, float] = (-math.pi, math.pi, 2.0, 100.0)


def urdf_text(name: str, links: Sequence[Link], joints: Sequence[Joint]) -> str:
    """Write links and joints as URDF; the first link is the root."""
    root = ET.Element("robot", name=name)
    for link in links:
        element = ET.SubElement(root, "link", name=link.name)
        if link.mass:
            inertial = ET.SubElement(element, "inertial")
            _origin(inertial, link.com, link.rpy)
            ET.SubElement(inertial, "mass", value=_text(link.mass))
            values = link.inertia
            if len(values) == 3:
                values = (values[0], 0.0, 0.0, values[1], 0.0, values[2])
            keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            ET.SubElement(inertial, "inertia", {k: _text(v) for k, v in zip(keys, values, strict=True)})
    for joint in joints:
        element = ET.SubElement(root, "joint", name=joint.name, type=joint.kind)
        _origin(element, joint.xyz, joint.rpy)
        ET.SubElement(element, "parent", link=joint.parent)
        ET.SubElement(element, "child", link=joint.child)
        if joint.kind != "fixed":
            ET.SubElement(element, "axis", xyz=_text(*joint.axis))
            lower, upper, velocity, effort = map(_text, joint.limits)
            limits = {"velocity": velocity, "effort": effort}
            if joint.kind != "continuous":
                limits |= {"lower": lower, "upper": upper}
            ET.SubElement(element, "limit", limits)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _text(*values: float) -> str:
    # repr keeps all digits: a right angle written with ten of them would tilt every axis after it.
    return " ".join(repr(float(value) + 0.0) for value in values)


def _origin(parent: ET.Element, xyz: Vector, rpy: Vector) -> None:
    ET.SubElement(parent, "origin", xyz=_text(*xyz), rpy=_text(*rpy))


# Link i-1 to joint i: turn about x (quarter turns), then along x and z [m].
_ALPHA = (0, -1, 0, 1, -1, 1)
_A = (0.0, 0.0, 0.4318, -0.0203, 0.0, 0.0)
_D = (0.672, 0.2435, -0.0934, 0.4331, 0.0, 0.0)  # d1: height of the shoulder above the floor (26.45 inch)
# Mass, centre of mass, principal inertias. Of link 1 only the inertia about its axis is known, 0.35 kg m^2;
# the rest is assumed, its centre of mass set after three numbers of the estimate of Liu et al. (m1 r1x, the
# parameter with m1 r1z, I1yz): agreement in those says nothing.
_LINKS: tuple[tuple[float, Vector, Vector], ...] = (
    (13.0, (0.009, -0.053, -0.15), (0.45, 0.45, 0.35 - 13.0 * (0.009**2 + 0.053**2))),
    (17.4, (0.068, 0.006, -0.016), (0.13, 0.524, 0.539)),
    (4.8, (0.0, -0.07, 0.014), (0.066, 0.0125, 0.066)),
    (0.82, (0.0, 0.0, -0.019), (0.0018, 0.0018, 0.0013)),
    (0.34, (0.0, 0.0, 0.0), (0.0003, 0.0003, 0.0004)),
    (0.09, (0.0, 0.0, 0.032), (0.00015, 0.00015, 0.00004)),
)
_BASE = Link("base", 15.0, (0.01, 0.0, 0.3), (0.6, 0.6, 0.25))  # assumed
_DEGREES = ((-160, 160), (-225, 45), (-45, 225), (-110, 170), (-100, 100), (-266, 266))
# Speeds and efforts are assumed, of the size of the real drives'.
_VELOCITY = (1.8, 1.6, 2.2, 3.0, 3.0, 3.0)
_EFFORT = (97.6, 186.4, 89.4, 24.2, 20.1, 21.3)
_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # exact cosines and sines


def _about_x(quarters: int, v: Vector) -> Vector:
    c, s = _QUARTERS[quarters % 4]
    return v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]


def _puma(name: str, rolls: Sequence[int], axes: Sequence[Vector]) -> str:
    """Write a PUMA whose link frame i is Craig's, turned about its x axis by `rolls[i]` quarter turns."""
    links, joints = [_BASE], []
    parent_roll = 0
    for i, (roll, axis) in enumerate(zip(rolls, axes, strict=True)):
        c, s = _QUARTERS[_ALPHA[i] % 4]
        xyz = _about_x(-parent_roll, (_A[i], -s * _D[i], c * _D[i]))
        turns = _ALPHA[i] - parent_roll + roll
        lower, upper = (math.radians(limit) for limit in _DEGREES[i])
        if _about_x(roll, axis)[2] < 0:  # the joint counts the other way round
            lower, upper = -upper, -lower
        mass, com, inertia = _LINKS[i]
        link = f"link{i + 1}"
        limits = lower, upper, _VELOCITY[i], _EFFORT[i]
        rpy = (turns * math.pi / 2, 0.0, 0.0)
        joints.append(Joint(f"joint{i + 1}", links[-1].name, link, xyz, rpy, axis=axis, limits=limits))
        links.append(Link(link, mass, _about_x(-roll, com), inertia, (-roll * math.pi / 2, 0.0, 0.0)))
        parent_roll = roll
    return urdf_text(name, links, joints)


def puma560_urdf() -> str:
    """Six-joint PUMA 560 in Craig's frames, each joint about its own z axis; joints ``joint1`` to ``joint6``.

    Returns
    -------
    str
        URDF text. Link ``base`` stands on the floor, z up; at q = 0 the upper arm points along x and the
        forearm up.
    """
    return _puma("puma560", (0,) * 6, ((0.0, 0.0, 1.0),) * 6)


PAPER_D2 = -_D[1]
"""Offset of link 2 along the joint-2 axis in the paper's frames [m]."""

PAPER_LABELS = (
    "m1 r1x",
    "m1 r1z + d2 m2 + m2 r2z",
    "(a2 + r2x) m2",
    "m2 r2y",
    "I1xy",
    "I1yy + m2 d2^2 + 2 d2 m2 r2z + I2xx",
    "I1yz",
    "I2xy",
    "I2xz",
    "I2yy - I2xx",
    "I2yz",
    "I2zz",
)
"""The paper's twelve base parameters, in its order."""

PAPER_ESTIMATE = (0.1125, -4.2455, 2.2202, -0.1834, -0.2278, 1.2489, 0.1338, 0.1213, -0.1247, 0.8596, -0.0086, 0.9867)
"""What the paper identified on its PUMA 550, a different arm [kg m, kg m^2]: for orders of magnitude only."""


def puma_two_joint_urdf() -> str:
    """Two-joint PUMA of Liu et al. (1998) in link frames that give the paper's base parameters.

    Joints ``joint1`` and ``joint2`` move; hold the others at `bayesid.workflows.demo.PAPER_LOCKED`, so that their links belong to
    link 2.

    ============  =======================================================================================
    symbol        meaning
    ============  =======================================================================================
    P1            frame of link 1 and joint 1, origin at the shoulder 0.672 m above the floor; y1 points up
                  and is the axis of joint 1, z1 = -y of the base at q1 = 0
    P2            frame of link 2 and joint 2, origin on the axis of joint 2, at d2 along z1; z2 = z1 is
                  the axis, x2 runs along the upper arm; P2 = P1 moved by d2 at q2 = 0
    d2            -0.2435 m: the arm hangs at negative z1, which gives the second parameter the sign of the
                  paper's estimate
    a2            0.4318 m along x2 from P2 to joint 3
    m1, m2        masses of link 1 and of link 2 with everything beyond it
    r1, I1        centre of mass and inertia about the origin, both in P1
    r2y, r2z      centre of mass of link 2 in P2
    r2x           the same along x2, but from the elbow, the far end of link 2: alpha = a2 + r2x is the
                  distance from the axis of joint 2, and alpha m2 is the first moment ``joint2.mcx``
    beta          d2 + r2z: position of that centre of mass along z1
    I2            inertia of link 2 about the origin of P2, as in the paper's equation 2
    q3            about -z2 (Craig's sense): the forearm is folded back under the upper arm
    ============  =======================================================================================

    Two things are a choice made here, not given by the paper. The zero and sense of q3: with the forearm
    upright at zero, -142.1 degrees stretches it out in one sense (alpha m2 = 4.35 kg m) and folds it
    back in the other (3.28), taken because it is nearer to the paper's 2.22. Counted from the straight
    arm, the angle would come a little nearer still (3.13) but lie outside the joint's range. Link 1: its
    mass and centre of mass are not published and were set after the paper's estimate, so m1 r1x, I1yz
    and the second parameter agree with it by construction (link 2 alone gives -4.93 for the second).
    `PAPER_ESTIMATE` is of another arm and checks no more than signs and orders of magnitude of the rest.

    Returns
    -------
    str
        URDF text, that of ``bayesid/robot/puma_two_joint.urdf``.
    """
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    return _puma("puma_two_joint", (1, 2, 0, 0, 0, 0), (y, z, z, z, z, z))


def paper_base_map() -> np.ndarray:
    """Matrix from the two links' standard parameters to the paper's twelve base parameters.

    Returns
    -------
    ndarray
        (12, 20): rows as in `PAPER_LABELS`, columns ``m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz``
        of joint 1, then of joint 2, about the origins of P1 and P2.
    """
    m, mcx, mcy, mcz, ixx, ixy, iyy, ixz, iyz, izz = range(10)
    second = 10
    rows: tuple[dict[int, float], ...] = (
        {mcx: 1},
        {mcz: 1, second + m: PAPER_D2, second + mcz: 1},
        {second + mcx: 1},
        {second + mcy: 1},
        {ixy: 1},
        {iyy: 1, second + m: PAPER_D2**2, second + mcz: 2 * PAPER_D2, second + ixx: 1},
        {iyz: 1},
        {second + ixy: 1},
        {second + ixz: 1},
        {second + iyy: 1, second + ixx: -1},
        {second + iyz: 1},
        {second + izz: 1},
    )
    matrix = np.zeros((12, 20))
    for row, entries in zip(matrix, rows, strict=True):
        row[list(entries)] = list(entries.values())
    return matrix
