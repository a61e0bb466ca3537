"""How the files of each public recording become an experiment, each as its authors say that they are to be read."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from bayesid.recordings.experiment import Experiment
from bayesid.recordings.table import Table
from bayesid.workflows.read_recording import read_recording

_FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
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


UR_JOINTS = tuple(f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
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
_UR10_LINKS = tuple(
    DhLink(a, d, alpha, 330, 3.14, mass, *_NO_BODY)
    for a, d, alpha, mass in [
        (0.0, 0.1273, _QUARTER, 7.778), (-0.612, 0.0, 0.0, 12.93), (-0.5723, 0.0, 0.0, 3.87), (0.0, 0.163941, _QUARTER, 1.96),
        (0.0, 0.1157, -_QUARTER, 1.96), (0.0, 0.0922, 0.0, 0.202),
    ]
)  # fmt: skip
#: Torque over motor current of the UR10e [N m/A]: the controller's own desired torque over its desired current while the arm
#: stands still before it moves, which joints 2 to 4 tell; joint 1 has joint 2's drive, joints 5 and 6 have joint 4's. Perhaps 2 %
#: off each.
UR10E_GAINS = (11.976, 11.976, 9.839, 10.763, 10.763, 10.763)
#: A recording of the UR10e is used while the arm moves [rad/s], and this long [s] before and after, at even steps [s].
UR10E_MOVING, UR10E_MARGIN, UR10E_STEP = 0.005, 0.3, 0.01
#: Gears of the TX40 from its data sheet; its motors' zeros of joints 2 and 3 are a quarter turn off; samples averaged into one.
_TX40_RATIOS, _TX40_ZEROS, _TX40_AVERAGED = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0), (0.0, -0.5, 0.5, 0.0, 0.0, 0.0), 10
_TX40_STEP, _TX40_FITTED = 2e-4, 4.4  # s
_MED7_STEP, _MED7_FITTED = 0.01, 0.7  # s; share of the recording


def kuka_lwr4(files: Mapping[str, Path]) -> Experiment:
    """Positions, velocities and torques of FloBaRoID's arrays as they are."""
    tables = []
    for name in ("measurements_1", "measurements_3"):
        with np.load(files[f"{name}.npz"], allow_pickle=False) as arrays:
            t = arrays["times"].ravel() - arrays["times"].ravel()[0]
            tables.append(Table(t, arrays["positions"], torques=arrays["torques"], velocities=arrays["velocities"], source=name))
    joints = [f"lwr_{k}_joint" for k in range(7)]
    return _experiment("kuka-lwr4", files["robot.urdf"], joints, tables, inertia_rel_std=0.3)


def med7(files: Mapping[str, Path]) -> Experiment:
    """The torques' sign is turned; the file has no times, its authors took 10 ms."""
    rows = np.genfromtxt(files["measurements.csv"], delimiter=",", names=True)
    q, torques = (np.column_stack([rows[f"{kind}_{k}"] for k in range(7)]) for kind in ("q", "tau"))
    t = _MED7_STEP * np.arange(len(q))
    cut = int(_MED7_FITTED * len(q))
    parts = {"identification": slice(cut), "validation": slice(cut, None)}
    tables = [Table(t[part], q[part], torques=-torques[part], source=role) for role, part in parts.items()]
    return _experiment("med7", files["robot.urdf"], [f"A{k}" for k in range(1, 8)], tables)


def tx40(files: Mapping[str, Path]) -> Experiment:
    """Motors over their gears, without the coupling of the wrist, averages of ten samples."""
    motor, torque = (np.loadtxt(files[f"{name}.csv"], delimiter=",", skiprows=1) for name in ("positions", "torques"))
    count = len(motor) // _TX40_AVERAGED * _TX40_AVERAGED
    ratio = np.array(_TX40_RATIOS)
    q = motor / ratio + np.pi * np.array(_TX40_ZEROS)
    t, q, torques = (
        values[:count].reshape(count // _TX40_AVERAGED, _TX40_AVERAGED, -1).mean(axis=1)
        for values in (_TX40_STEP * np.arange(len(motor)), q, torque * ratio)
    )
    t = t.ravel()
    parts = {"identification": t < _TX40_FITTED, "validation": (t > _TX40_FITTED) & (t < _TX40_FITTED + 3.2)}
    tables = [Table(t[part], q[part], torques=torques[part], source=role) for role, part in parts.items()]
    joints = [f"joint_{k}" for k in range(1, 7)]
    return _experiment(
        "tx40", files["robot.urdf"], joints, tables, effects=(*_FRICTION, "rotor_inertia"), position_resolution=3e-6
    )


def ur10(files: Mapping[str, Path]) -> Experiment:
    """Joint states of the bag; efforts are torques already."""
    joints = [f"joint{k}" for k in range(1, 7)]
    with tempfile.TemporaryDirectory() as folder:
        urdf = _written(folder, dh_urdf("ur10", joints, _UR10_LINKS))
        made = read_recording(
            files["ur10.db3"], urdf, joint_names=dict(zip(joints, UR_JOINTS, strict=True)), hold_out=0.4, name="ur10"
        )
    return replace(made.experiment, inertia_rel_std=1.0)


def ur10e(files: Mapping[str, Path], name: str) -> Experiment:
    """Positions, and motor currents times drive gains, while the arm moves, at even times."""
    rows = ur10e_rows(np.loadtxt(files["recording.csv"], delimiter=","))
    table = Table(rows[:, 0], rows[:, 1:7], torques=rows[:, 7:], source="motion")
    with tempfile.TemporaryDirectory() as folder:
        urdf = _written(folder, dh_urdf("ur10e", UR_JOINTS, UR10E_LINKS))
        return _experiment(name, urdf, UR_JOINTS, [table], effects=_FRICTION, position_resolution=1e-4)


def ur10e_rows(raw: np.ndarray) -> np.ndarray:
    """Times [s], joint positions [rad] and torques [N m] at 100 Hz (k, 13) of a recording's rows (N, 31).

    A raw row is the time, then six each of position, velocity, motor current, and the controller's desired current and torque.
    Samples come every 10 or 12 ms, some later; a cubic spline goes through them. Nothing is filtered.
    """
    times, speeds = raw[:, 0] - raw[0, 0], np.abs(raw[:, 7:13]).max(axis=1)
    moving = times[speeds > UR10E_MOVING]
    start, end = max(times[0], moving[0] - UR10E_MARGIN), min(times[-1], moving[-1] + UR10E_MARGIN)
    grid = np.arange(start, end, UR10E_STEP)
    return np.column_stack([grid, CubicSpline(times, np.hstack([raw[:, 1:7], raw[:, 13:19] * UR10E_GAINS]))(grid)])


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


def _experiment(name: str, urdf: Path, joints: tuple[str, ...] | list[str], tables: list[Table], **knowledge) -> Experiment:
    """An experiment whose first table is fitted and whose others are predicted; motions are named by the tables' sources."""
    first = tables[0]
    made = Experiment.from_arrays(
        urdf, first.times, first.positions, torques=first.torques, velocities=first.velocities, validation=tables[1:],
        joints=joints, name=name, **knowledge,
    )  # fmt: skip
    return replace(made, motions=tuple(replace(m, name=table.source) for m, table in zip(made.motions, tables, strict=True)))


def _written(folder: str, text: str) -> Path:
    path = Path(folder) / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return path
