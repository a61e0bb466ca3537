"""A UR10e's recordings as experiment folders.

Recordings come from a clone of github.com/shamilmamedov/dynamic_calibration, or from folders that were made of them before.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

COMMIT = "11af40e7"
#: Below the clone; how a clone is told from ready folders.
RAW = Path("dataset_ur10e") / "identification_data"
#: Torque over motor current [N m/A]: the controller's own desired torque over its desired current while the arm stands still
#: before it moves, which joints 2 to 4 tell; joint 1 has joint 2's drive, joints 5 and 6 have joint 4's. Perhaps 2 % off each.
DRIVE_GAINS = (11.976, 11.976, 9.839, 10.763, 10.763, 10.763)
STEP_S = 0.01
#: A recording is used while the arm moves [rad/s], and this long [s] before and after.
MOVING, MARGIN_S = 0.005, 0.3
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")


@dataclass(frozen=True)
class Link:
    """One row of the maker's tables: Denavit-Hartenberg parameters, largest torque and speed, mass properties.

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


QUARTER = 1.57079632679
#: As Universal Robots publishes them for the UR10e ("DH parameters for calculations of kinematics and dynamics").
LINKS = (
    Link(0.0, 0.1807, QUARTER, 330, 2.09, 7.369, (0.021, 0.0, 0.027), (0.0341, 0, -0.0043, 0.0353, 0.0001, 0.0216)),
    Link(-0.6127, 0.0, 0.0, 330, 2.09, 13.051, (0.38, 0.0, 0.158), (0.0281, 0.0001, -0.0156, 0.7707, 0, 0.7694)),
    Link(-0.57155, 0.0, 0.0, 150, 3.14, 3.989, (0.24, 0.0, 0.068), (0.0101, 0.0001, 0.0092, 0.3093, 0, 0.3065)),
    Link(0.0, 0.17415, QUARTER, 56, 3.14, 2.1, (0.0, 0.007, 0.018), (0.003, 0, 0, 0.0022, -0.0002, 0.0026)),
    Link(0.0, 0.11985, -QUARTER, 56, 3.14, 1.98, (0.0, 0.007, 0.018), (0.003, 0, 0, 0.0022, -0.0002, 0.0026)),
    Link(0.0, 0.11655, 0.0, 56, 3.14, 0.615, (0.0, 0.0, -0.026), (0.0006, 0, 0, 0.0006, 0, 0.0004)),
)


@dataclass(frozen=True)
class Recording:
    """One recording: the experiment folder's name, the raw file, the ready table, and whether the payload was on."""

    name: str
    file: str
    ready: str | None = None
    loaded: bool = False


BEFORE = Recording("before", "ur-20_01_31-unload.csv", "before/unload.csv")
AFTER = Recording("after", "ur-20_01_31-load.csv", "after-load/load.csv", loaded=True)
#: In the order in which they were recorded, after BEFORE; names are dates. ur-20_02_19_15harm50secLoad.csv is left out, because
#: rows of it are broken.
SERIES = (
    AFTER,
    Recording("feb05-12", "ur-20_02_05-20sec_12harm.csv", "feb05-20s-12h/motion.csv"),
    Recording("feb05-8", "ur-20_02_05-20sec_8harm.csv", "feb05-20s-8h/motion.csv"),
    Recording("feb06-10", "ur-20_02_06-20sec_10harm.csv", "feb06-20s-10h/motion.csv"),
    Recording("feb06-5", "ur-20_02_06-20sec_5harm.csv", "feb06-20s-5h/motion.csv"),
    Recording("feb10-7", "ur-20_02_10-20sec_7harm.csv"),
    Recording("feb10-12", "ur-20_02_10-30sec_12harm.csv"),
    Recording("feb12-40s", "ur-20_02_12-40sec_12harm.csv"),
    Recording("feb12-50s", "ur-20_02_12-50sec_12harm.csv"),
    Recording("feb19-14", "ur-20_02_19_14harm50sec.csv"),
    Recording("feb19-14-load", "ur-20_02_19_14harm50secLoad.csv", loaded=True),
    Recording("feb19-15", "ur-20_02_19_15harm50sec.csv"),
)
#: Another day's motion, which the unloaded arm's model has to predict.
OTHER_DAY = SERIES[2]


def is_clone(source: Path) -> bool:
    """Whether a folder is the clone, and not one of ready folders."""
    return (source / RAW).is_dir()


def available(source: Path, recording: Recording) -> bool:
    """Whether a source has a recording."""
    if is_clone(source):
        return (source / RAW / recording.file).exists()
    return recording.ready is not None and (source / recording.ready).exists()


def table(source: Path, recording: Recording) -> np.ndarray:
    """Times [s], joint positions [rad] and torques [N m] of a recording, 100 Hz (k, 13).

    A raw row is the time, then six each of position, velocity, motor current, and the controller's desired current and torque.
    Samples come every 10 or 12 ms, some later; a cubic spline goes through them. Nothing is filtered.
    """
    if not is_clone(source):
        return np.genfromtxt(source / str(recording.ready), delimiter=",", skip_header=1)
    raw = np.loadtxt(source / RAW / recording.file, delimiter=",")
    times, speeds = raw[:, 0] - raw[0, 0], np.abs(raw[:, 7:13]).max(axis=1)
    moving = times[speeds > MOVING]
    start, end = max(times[0], moving[0] - MARGIN_S), min(times[-1], moving[-1] + MARGIN_S)
    grid = np.arange(start, end, STEP_S)
    readings = np.hstack([raw[:, 1:7], raw[:, 13:19] * DRIVE_GAINS])
    return np.column_stack([grid, CubicSpline(times, readings)(grid)])


def write_folder(folder: Path, motions: dict[str, tuple[str, np.ndarray]]) -> None:
    """Write an experiment folder: the role and the table of every motion by its name."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf(), encoding="utf-8")
    lines = [
        "format = 1", f'name = "{folder.name}"', "", "[robot]", 'urdf = "robot.urdf"',
        f"joints = {_listed(f'{name}_joint' for name in JOINTS)}",
        "position_resolution = 1e-4   # the recording holds four decimals", "",
        "[model]", f"effects = {_listed(EFFECTS)}",
    ]  # fmt: skip
    heads = ["t", *(f"{kind}{j + 1}" for kind in ("q", "tau") for j in range(len(JOINTS)))]
    for name, (role, columns) in motions.items():
        lines += ["", "[[motion]]", f'name = "{name}"', f'role = "{role}"', f'table = "{name}.csv"']
        formats = ["%.3f"] + 6 * ["%.5f"] + 6 * ["%.4f"]
        np.savetxt(folder / f"{name}.csv", columns, fmt=formats, delimiter=",", header=",".join(heads), comments="")
    (folder / "experiment.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _listed(names: Iterable[str]) -> str:
    return json.dumps(list(names))  # TOML writes a list of strings as JSON does


def prepare(source: Path, target: Path) -> list[Recording]:
    """Write a folder for every recording there is; the recordings.

    Two more hold the unloaded recording and one to be predicted: another day's in ``arm``, the loaded one in ``surprise``.

    Raises
    ------
    FileNotFoundError
        Where the source lacks one of the three recordings of the case study's first part.
    """
    needed = (BEFORE, AFTER, OTHER_DAY)
    if missing := [r.file for r in needed if not available(source, r)]:
        raise FileNotFoundError(f"{source}: neither a clone of dynamic_calibration nor ready folders, it lacks {missing[0]}")
    found = [r for r in SERIES if available(source, r)]
    tables = {r.name: table(source, r) for r in (BEFORE, *found)}
    for name, columns in tables.items():
        write_folder(target / name, {"motion": ("identification", columns)})
    first = ("identification", tables[BEFORE.name])
    write_folder(target / "arm", {"jan31": first, "feb05": ("validation", tables[OTHER_DAY.name])})
    write_folder(target / "surprise", {"unloaded": first, "loaded": ("validation", tables[AFTER.name])})
    return found


def urdf() -> str:
    """The arm as URDF; a joint's frame is the Denavit-Hartenberg frame of the link before it."""
    parts = ['<?xml version="1.0"?>', '<robot name="ur10e">', '  <link name="base_link"/>']
    parent, origin = "base_link", "0 0 0"
    turn = "0 0 0"
    for name, link in zip(JOINTS, LINKS, strict=True):
        c, s = np.cos(link.alpha), np.sin(link.alpha)
        x, y, z = link.centre
        centre = (link.a + x, c * y - s * z, link.d + s * y + c * z)
        place = " ".join(f"{round(float(v), 6) + 0.0:g}" for v in centre)
        named = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), link.inertia, strict=True)
        parts += [
            f'  <joint name="{name}_joint" type="revolute">',
            f'    <parent link="{parent}"/><child link="{name}_link"/>',
            f'    <origin xyz="{origin}" rpy="{turn}"/><axis xyz="0 0 1"/>',
            f'    <limit lower="-6.2832" upper="6.2832" effort="{link.effort:g}" velocity="{link.speed:g}"/>',
            "  </joint>",
            f'  <link name="{name}_link"><inertial>',
            f'    <mass value="{link.mass:g}"/>',
            f'    <origin xyz="{place}" rpy="{link.alpha:.12g} 0 0"/>',
            "    <inertia " + " ".join(f'{key}="{value:g}"' for key, value in named) + "/>",
            "  </inertial></link>",
        ]
        parent = f"{name}_link"
        origin, turn = f"{link.a:g} 0 {link.d:g}", f"{link.alpha:.12g} 0 0"
    return "\n".join([*parts, "</robot>"]) + "\n"
