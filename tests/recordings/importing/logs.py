"""A recording that is known, and the logs that other tools would have written of it, by writers that bayesid has no part in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bayesid.robot.robot import Robot, load_robot
from tests.example_robots import Joint, Link, urdf_text
from tests.simulated import Sensor, fourier, recording

START = 1_700_000_000_000_000_000  # [ns since 1970]
#: By name, elbow comes before shoulder, as controllers that sort joints publish them.
JOINTS = ("shoulder", "elbow")
URDF = urdf_text(
    "two-joint",
    [
        Link("base"),
        Link("upper", 4.0, (0.2, 0.01, 0.02), (0.05, 0.06, 0.06)),
        Link("lower", 2.0, (0.15, 0.0, 0.01), (0.01, 0.02, 0.02)),
        Link("flange"),
        Link("tool", 0.8, (0.0, 0.02, 0.1), (0.002, 0.002, 0.001)),
        Link("finger", 0.1, (0.0, 0.0, 0.02), (1e-4, 1e-4, 1e-4)),
    ],
    [
        Joint("shoulder", "base", "upper", (0.0, 0.0, 0.3)),
        Joint("elbow", "upper", "lower", (0.4, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),
        Joint("flange_joint", "lower", "flange", (0.3, 0.0, 0.0), kind="fixed"),
        Joint("wrist_ft", "flange", "tool", kind="fixed"),
        Joint("gripper", "tool", "finger", axis=(0.0, 1.0, 0.0)),
    ],
)


@dataclass(frozen=True)
class Known:
    """What was recorded: times since the start [ns], and arrays in SI units."""

    urdf: Path
    robot: Robot
    ns: np.ndarray
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    wrench: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Times (N,) [s]."""
        return self.ns / 1e9


def make_known(folder: Path, seed: int = 1, sensor: str | None = "wrist_ft", duration: float = 8.0, rate: float = 125.0) -> Known:
    """A motion of the two joints, with the torques and the wrench that Newton and Euler give, and noise."""
    urdf = folder / "robot.urdf"
    urdf.write_text(URDF, encoding="utf-8")
    robot = load_robot(urdf, JOINTS, sensor_joint=sensor)
    motion = fourier(robot, seed, duration, rate)
    table = recording(robot, Sensor(joint=sensor), motion, seed=seed, force_std=0.1, torque_std=0.02)
    assert table.wrench is not None and table.torques is not None
    return Known(urdf, robot, np.round(motion[0] * 1e9).astype(np.int64), motion[1], motion[2], table.torques, table.wrench)


class Bag:
    """A bag that is written message by message."""

    def __init__(self, path: Path, kind: str, definitions: str = "", of: str = "", compressed: bool = False) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
        if definitions:
            self.store.register(get_types_from_msg(definitions, of))
        self.ros1 = kind == "ros1"
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer: Any = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        if compressed:
            self.writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        self.connections: dict[str, Any] = {}

    def __enter__(self) -> Bag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def write(self, topic: str, kind: str, log: int, **fields: Any) -> None:
        """Write one message at a time of the log [ns]."""
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        message = self.store.types[kind](**fields)
        to_bytes = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], int(log), to_bytes(message, kind))

    def header(self, ns: int, frame: str = "") -> Any:
        """A header with a stamp [ns]."""
        stamp = self.store.types["builtin_interfaces/msg/Time"](sec=int(ns) // 10**9, nanosec=int(ns) % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self.store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **sequence)

    def joints(
        self, ns: int, names: Sequence[str], q: Any, v: Any = (), tau: Any = (), topic: str = "/joint_states",
        log: int | None = None,
    ) -> None:  # fmt: skip
        """Write a JointState."""
        arrays = {k: np.array(x, dtype=np.float64) for k, x in (("position", q), ("velocity", v), ("effort", tau))}
        self.write(
            topic, "sensor_msgs/msg/JointState", ns if log is None else log, header=self.header(ns), name=list(names), **arrays
        )

    def wrench(self, ns: int, wrench: np.ndarray, topic: str = "/ft", frame: str = "tool", log: int | None = None) -> None:
        """Write a WrenchStamped."""
        vector = self.store.types["geometry_msgs/msg/Vector3"]
        force, torque = (vector(**dict(zip("xyz", map(float, part), strict=True))) for part in (wrench[:3], wrench[3:]))
        self.write(
            topic, "geometry_msgs/msg/WrenchStamped", ns if log is None else log, header=self.header(ns, frame),
            wrench=self.store.types["geometry_msgs/msg/Wrench"](force=force, torque=torque),
        )  # fmt: skip


def write_bag(path: Path, known: Known, kind: str, late: int = 0) -> Path:
    """A bag with the joints sorted by name, and the wrench; the log's times are ``late`` [ns] after the stamps."""
    order = np.argsort(JOINTS)
    names = [JOINTS[k] for k in order]
    with Bag(path, kind) as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, names, known.q[k, order], known.v[k, order], known.tau[k, order], log=ns + late)
            bag.wrench(ns, known.wrench[k], log=ns + late)
    return path
