"""What five newcomers bring along: a UR5 recorded by Pinocchio, and files of it by writers that bayesid has no part in.

The robot's links are up to 10 % off the URDF's, and its joints have friction.
``python -m tests.newcomers.files FOLDER`` writes all.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pandas as pd
import pinocchio
from scipy.io import savemat

from tests.recordings.importing.logs import START, Bag
from tests.robots import ur5

#: The URDF's order, base to tool; sorted by name the elbow comes first.
JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
VISCOUS, COULOMB = np.array([6.0, 6.0, 4.0, 1.5, 1.5, 1.0]), np.array([5.0, 6.0, 4.0, 1.5, 1.2, 1.0])


@dataclass(frozen=True)
class Log:
    """One motion in SI units: times (N,), positions, velocities, accelerations, torques and the wrench under the base (N, 6)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    wrench: np.ndarray


def robot(folder: Path) -> tuple[Path, pinocchio.Model]:
    """The URDF that everybody has, and the robot as it really is."""
    urdf = folder / "ur5.urdf"
    urdf.write_text(ur5(), encoding="utf-8")
    model = pinocchio.buildModelFromUrdf(str(urdf))
    rng = np.random.default_rng(0)
    for inertia in list(model.inertias)[1:]:
        factor = 1.0 + 0.1 * rng.uniform(-1.0, 1.0)
        inertia.mass, inertia.inertia = factor * inertia.mass, factor * inertia.inertia
        inertia.lever = inertia.lever + 0.01 * rng.uniform(-1.0, 1.0, 3)
    return urdf, model


def record(model: pinocchio.Model, seed: int, duration: float = 12.0, rate: float = 125.0) -> Log:
    """A motion of five harmonics, its torques with friction, and the wrench that a sensor under the base applies."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    w = 2.0 * np.pi * 0.1 * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, 6))
    s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    q, v, acceleration = s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b
    scale = 1.5 / np.abs(v).max(axis=0)
    q, v, acceleration = q * scale, v * scale, acceleration * scale
    data = model.createData()
    tau, wrench = np.empty_like(q), np.empty_like(q)
    for k in range(len(t)):
        tau[k] = pinocchio.rnea(model, data, q[k], v[k], acceleration[k])
        wrench[k] = (data.liMi[1].act(data.f[1])).vector  # on the first link, about the base's origin
    weight = model.inertias[0]  # of what is fixed to the base
    wrench += np.concatenate([weight.mass * -model.gravity.linear, np.cross(weight.lever, weight.mass * -model.gravity.linear)])
    tau += VISCOUS * v + COULOMB * np.sign(v)
    tau += 0.1 * rng.normal(size=tau.shape)
    wrench += np.repeat([0.5, 0.05], 3) * rng.normal(size=wrench.shape)
    return Log(t, np.round(q / 1e-5) * 1e-5, v, acceleration, tau, wrench)


def write_bags(folder: Path, logs: list[Log]) -> list[Path]:
    """ROS 2 bags: JointState with joints sorted by name, as controllers publish them, and a WrenchStamped that is 2 ms late."""
    order = np.argsort(JOINTS)
    names = [JOINTS[k] for k in order]
    paths = [folder / f"rosbag2_2026_05_0{day}" for day, _ in enumerate(logs, 4)]
    for path, log in zip(paths, logs, strict=True):
        with Bag(path, "mcap") as bag:
            for k, ns in enumerate(START + np.round(1e9 * log.t).astype(np.int64)):
                bag.joints(ns, names, log.q[k, order], log.v[k, order], log.tau[k, order], log=ns + 800_000)
                bag.wrench(ns, log.wrench[k], topic="/ft_sensor/wrench", frame="ft_base", log=ns + 900_000)
    return paths


def write_csv(folder: Path, logs: list[Log]) -> list[Path]:
    """A controller's log: milliseconds, degrees, torques under other names, and a column that nobody needs."""
    paths = [folder / f"log_{k:03d}.csv" for k, _ in enumerate(logs, 1)]
    for path, log in zip(paths, logs, strict=True):
        columns = {"Zeitstempel": np.round(1e3 * log.t, 3)}
        columns |= {f"A{k + 1}_Ist": np.round(np.rad2deg(log.q[:, k]), 5) for k in range(6)}
        columns |= {f"A{k + 1}_Moment": np.round(log.tau[:, k], 4) for k in range(6)}
        pd.DataFrame(columns | {"Programmzeile": 17}).to_csv(path, index=False)
    return paths


def write_mat(folder: Path, logs: list[Log]) -> list[Path]:
    """A structure as Simulink's ``To Workspace`` saves one: samples in columns."""
    paths = [folder / f"run{k}.mat" for k, _ in enumerate(logs, 1)]
    for path, log in zip(paths, logs, strict=True):
        savemat(path, {"log": {"time": log.t[None, :], "q": log.q.T, "dq": log.v.T, "tau": log.tau.T}, "Ts": 0.008})
    return paths


def write_mjcf(folder: Path) -> Path:
    """A model of MuJoCo, made of the URDF by MuJoCo itself, that states friction and rotors, not all of them right."""
    urdf, _ = robot(folder)
    compiled = folder / "compiled.xml"
    mujoco.mj_saveLastXML(str(compiled), mujoco.MjModel.from_xml_path(str(urdf)))
    tree = ElementTree.parse(compiled)
    for joint, viscous, coulomb in zip(tree.iter("joint"), VISCOUS, COULOMB, strict=True):
        joint.attrib |= {"damping": str(0.5 * viscous), "frictionloss": str(0.5 * coulomb), "armature": "0.3"}
    path = folder / "ur5.xml"
    tree.write(path)
    return path


def write_parquet(folder: Path, logs: list[Log]) -> list[Path]:
    """What a simulator logs: MuJoCo's inverse dynamics of the motions, bodies 8 % heavier than its file says, in nanoseconds."""
    real = mujoco.MjModel.from_xml_path(str(write_mjcf(folder)))
    real.body_mass *= 1.08
    real.body_inertia *= 1.08
    real.dof_damping[:] = VISCOUS
    real.dof_frictionloss[:] = 0.0  # MuJoCo's is soft about zero speed; Coulomb's is added below
    data = mujoco.MjData(real)
    paths = [folder / f"episode_{k}.parquet" for k, _ in enumerate(logs)]
    for path, log in zip(paths, logs, strict=True):
        tau = np.empty_like(log.q)
        for k in range(len(log.t)):
            data.qpos[:], data.qvel[:], data.qacc[:] = log.q[k], log.v[k], log.a[k]
            mujoco.mj_inverse(real, data)
            tau[k] = data.qfrc_inverse + COULOMB * np.sign(log.v[k])
        tau += 0.1 * np.random.default_rng(len(tau)).normal(size=tau.shape)
        columns = {"timestamp": START + np.round(1e9 * log.t).astype(np.int64)}
        columns |= {f"{name}_position": log.q[:, k] for k, name in enumerate(JOINTS)}
        columns |= {f"{name}_effort": tau[:, k] for k, name in enumerate(JOINTS)}
        pd.DataFrame(columns).to_parquet(path)
    return paths


def main(folder: Path) -> None:
    """Write everything."""
    folder.mkdir(parents=True, exist_ok=True)
    _, model = robot(folder)
    logs = [record(model, seed) for seed in (1, 2)]
    for write in (write_bags, write_csv, write_mat, write_parquet):
        write(folder, logs)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
