"""A payload in the form that each controller takes: units, frames and order of each maker's own document.

Every function turns a `Load` into the text of one file. An inertia that is not known is left out, or zero (a point mass) where
the format has no other way. Addresses of the makers' documents stand in docs/howto/payload.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayesid.errors import InputError

#: Digits after the point of kilograms, metres and kilogram square metres.
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class Load:
    """What controllers ask for."""

    mass: float  # [kg]
    centre: np.ndarray  # centre of mass in the flange's frame (3,) [m]
    inertia: np.ndarray | None  # about the centre of mass in the flange's axes (3, 3) [kg m^2]; None where it is not known
    #: Names of the frame that ``centre`` is in, and of the robot's root.
    frame: str
    world: str
    gravity: np.ndarray  # in the root's frame (3,) [m/s^2]
    sensor: str | None = None  # name of the link that the sensor is on; None without one
    #: Centre of mass in the sensor's frame (3,) [m], and its constant reading (6,) [N, N m].
    centre_in_sensor: np.ndarray | None = None
    offset: np.ndarray | None = None
    #: Where its frame is in that of the link: origin [m], then angles about the link's fixed axes x, y, z [rad], (6,).
    mounted: np.ndarray | None = None


@dataclass(frozen=True)
class Format:
    """How a controller takes a payload."""

    file: str  # name of the file
    write: Callable[[Load], str]  # from a load to the file's text
    of_sensor: bool = False  # whether it is for a force/torque sensor


def ur(load: Load) -> str:
    """URScript: kg, m from the tool mount, kg m^2 about the centre of mass as Ixx, Iyy, Izz, Ixy, Ixz, Iyz.

    Universal Robots, *Script manual*, ``set_target_payload``. Without an inertia the controller takes a zero matrix.
    """
    cog = _listed(load.centre)
    if load.inertia is None:
        return f"set_target_payload({_number(load.mass)}, {cog})\n"
    i = load.inertia
    moments = _listed([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
    return f"set_target_payload({_number(load.mass)}, {cog}, {moments})\n"


def franka(load: Load) -> str:
    """JSON of an end effector: kg, m in the flange's frame, kg m^2 about the centre of mass as nine numbers by columns.

    Franka, *RIDE CLI*, "End effector commissioning". The tool's own frame (``transformation``, sixteen numbers by columns) is
    left at the flange.
    """
    inertia = np.zeros((3, 3)) if load.inertia is None else load.inertia
    document = {
        "id": "tool", "name": "tool", "mass": _rounded(load.mass), "centerOfMass": _rounded(load.centre),
        "inertia": _rounded(inertia.ravel(order="F")), "transformation": np.eye(4).ravel(order="F").tolist(),
    }  # fmt: skip
    return json.dumps(document, indent=1) + "\n"


def kuka(load: Load) -> str:
    """KRL: kg, mm in the flange's frame, principal axes by angles A, B, C [deg] about z, y, x in turn, kg m^2 about these.

    KUKA, *MA KR IONTEC V4*, "Load center of gravity and moment of inertia", and the structure LOAD of KRL.
    """
    moments, (a, b, c) = principal_axes(np.zeros((3, 3)) if load.inertia is None else load.inertia)
    x, y, z = 1e3 * load.centre
    return (
        f"LOAD_DATA[1]={{M {load.mass:.4f},CM {{X {x:.3f},Y {y:.3f},Z {z:.3f},A {a:.4f},B {b:.4f},C {c:.4f}}},"
        f"J {{X {moments[0]:.6f},Y {moments[1]:.6f},Z {moments[2]:.6f}}}}}\n"
    )


def xarm(load: Load) -> str:
    """Python, UFACTORY, *xArm-Python-SDK*, ``XArmAPI.set_tcp_load``: kg, and mm in the flange's frame; it takes no inertia."""
    centre = ", ".join(f"{1e3 * c:.3f}" for c in load.centre)
    return f"arm.set_tcp_load({load.mass:.4f}, [{centre}])\n"


def ros(load: Load) -> str:
    """YAML of ROS 1: kg, m in the sensor's frame with no rotation, and the sensor's constant reading as bias.

    KTH, *force_torque_tools*, parameters of ``gravity_compensation``.
    """
    centre, offset = _of_sensor(load)
    frame, where = _sensor_frame(load, lambda x, y, z, roll, pitch, yaw, *names: ("rosrun", x, y, z, yaw, pitch, roll, *names))
    return where + _yaml({
        "bias": _listed(offset), "gripper_com_frame_id": frame, "gripper_com_pose": _listed([*centre, 0.0, 0.0, 0.0]),
        "gripper_mass": _number(load.mass),
    })  # fmt: skip


def ros2(load: Load) -> str:
    """YAML of ROS 2, a filter of a chain: kg, m in the sensor's frame, gravity in the world's frame [m/s^2].

    ros-controls, *control_toolbox*, parameters of ``gravity_compensation_filter``.
    """
    centre, _ = _of_sensor(load)
    frame, where = _sensor_frame(load, _in_ros2)
    return where + _yaml({"world_frame": load.world, "sensor_frame": frame}) + "tool:\n" + _yaml({
        "  pos": _listed(centre), "  gravity_field": _listed(load.gravity), "  mass": _number(load.mass),
    })  # fmt: skip


def admittance(load: Load) -> str:
    """YAML of ROS 2, ros-controls, *ros2_controllers*, ``admittance_controller``: the weight [N], and m in the sensor's frame."""
    centre, _ = _of_sensor(load)
    weight = load.mass * float(np.linalg.norm(load.gravity))
    frame, where = _sensor_frame(load, _in_ros2)
    return (
        f"{where}gravity_compensation:\n  frame:\n    id: {frame}\n    external: false\n"
        f"  CoG:\n    pos: {_listed(centre)}\n    force: {_number(weight)}\n"
    )


#: Formats by name.
FORMATS: Mapping[str, Format] = {
    "ur": Format("ur.script", ur), "franka": Format("endeffector-config.json", franka), "kuka": Format("kuka.dat", kuka),
    "xarm": Format("xarm.py", xarm), "ros": Format("gravity_compensation.yaml", ros, True),
    "ros2": Format("ros2_gravity_filter.yaml", ros2, True), "admittance": Format("ros2_admittance.yaml", admittance, True),
}  # fmt: skip


def principal_axes(inertia: np.ndarray) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Principal moments (3,) and the angles A, B, C [deg] of their axes, ``R = Rz(A) Ry(B) Rx(C)``, ``I = R diag(J) R'``.

    Of the orders and directions of the axes that there are, the one turned least from the frame's.
    """
    moments, vectors = np.linalg.eigh(inertia)
    if np.allclose(inertia, np.diag(np.diag(inertia)), rtol=0.0, atol=1e-12 * max(np.abs(inertia).max(), 1e-300)):
        return np.diag(inertia).copy(), (0.0, 0.0, 0.0)
    best, order = vectors, [0, 1, 2]
    for candidate in ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]):
        turned = vectors[:, candidate] * np.where(np.diag(vectors[:, candidate]) < 0.0, -1.0, 1.0)
        if np.linalg.det(turned) > 0.0 and (best is vectors or np.trace(turned) > np.trace(best)):
            best, order = turned, candidate
    a, c = np.arctan2(best[1, 0], best[0, 0]), np.arctan2(best[2, 1], best[2, 2])
    b = np.arctan2(-best[2, 0], np.hypot(best[0, 0], best[1, 0]))
    return moments[order], (float(np.degrees(a)), float(np.degrees(b)), float(np.degrees(c)))


def _of_sensor(load: Load) -> tuple[np.ndarray, np.ndarray]:
    if load.sensor is None or load.centre_in_sensor is None or load.offset is None:
        raise InputError("export: no force/torque sensor carries this payload, so there is none whose readings to compensate")
    return load.centre_in_sensor, load.offset


def _in_ros2(*values: str) -> tuple[str, ...]:
    names = ("x", "y", "z", "roll", "pitch", "yaw", "frame-id", "child-frame-id")
    return "ros2 run", *(f"--{name} {value}" for name, value in zip(names, values, strict=True))


def _sensor_frame(load: Load, arguments: Callable[..., tuple[str, ...]]) -> tuple[str, str]:
    """Name of the frame of the sensor's axes, and comment lines that say where it is, if it is not that of its link.

    ``arguments`` gives how the publisher of such a frame is run, and its arguments, from pose, link and frame.
    """
    if load.sensor is None or load.mounted is None or not load.mounted.any():
        return load.sensor or "", ""
    frame = f"{load.sensor}_sensor"
    run, *given = arguments(*map(_number, load.mounted), load.sensor, frame)
    said = f"# {frame}: the sensor's own axes, as they are turned on {load.sensor}. Publish it, and stamp the wrench with it:\n"
    return frame, f"{said}# {run} tf2_ros static_transform_publisher {' '.join(given)}\n"


def _rounded(values):
    return (np.round(np.asarray(values, float), _DIGITS) + 0.0).tolist()


def _number(value: float) -> str:
    return f"{_rounded(value):.{_DIGITS}f}"


def _listed(values) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _yaml(entries: Mapping[str, str]) -> str:
    return "".join(f"{key}: {value}\n" for key, value in entries.items())
