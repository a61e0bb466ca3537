"""Channels: what a sensor or a drive measures, each as a twist fixed in a link.

A channel's reading is the power-conjugate of the wrench transmitted to the bodies beyond, ``y = S' w``: the six unit
twists of a sensor frame give a wrench, a joint's axis gives its torque. Spatial vectors are (linear; angular).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesid.robot.robot import Robot, fingerprint

WRENCH_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True)
class Channels:
    """What is measured: twists, each fixed in a link."""

    #: A name and unit a channel (c,).
    names: tuple[str, ...]
    units: tuple[str, ...]
    joint: np.ndarray  # joint whose frame each twist is fixed in, -1 for the root (c,)
    twist: np.ndarray  # the twist in that frame, linear part at the frame's origin (c, 6)
    bodies: np.ndarray  # which bodies each channel carries (c, b)
    #: Pose in the base frame of the frame all computing is done in (3, 3), (3,); a base sensor's own frame, so that its rows
    #: need no projection.
    reference_rotation: np.ndarray
    reference_translation: np.ndarray
    static_wrench: np.ndarray  # constant reading of what hangs on the sensor and does not move (c,)

    def __len__(self) -> int:
        return len(self.names)

    def only(self, rows: Sequence[int] | np.ndarray) -> Channels:
        """The channels with these indices (k,), in their order."""
        rows = np.asarray(rows, int)
        return replace(
            self, names=tuple(self.names[k] for k in rows), units=tuple(self.units[k] for k in rows), joint=self.joint[rows],
            twist=self.twist[rows], bodies=self.bodies[rows], static_wrench=self.static_wrench[rows],
        )  # fmt: skip

    @cached_property
    def fingerprint(self) -> bytes:
        """Digest of all that it holds, the same for equal channels."""
        return fingerprint(self)

    @cached_property
    def root_twists(self) -> np.ndarray:
        """Twists in their joint's frame, those on the root in the base frame (c, 6)."""
        # From the frame of computing, whose pose in the base is (R, p), to the base frame: (R l + p x R w; R w).
        rotation, translation = self.reference_rotation, self.reference_translation
        angular = self.twist[:, 3:] @ rotation.T
        moved = np.hstack([self.twist[:, :3] @ rotation.T + np.cross(translation, angular), angular])
        return np.where((self.joint < 0)[:, None], moved, self.twist)


def wrench_channels(robot: Robot, rotation: np.ndarray, translation: np.ndarray) -> Channels:
    """Channels of the robot's force/torque sensor: force before moment, in the sensor frame.

    ``rotation`` (3, 3) and ``translation`` (3,) [m] are its pose in the sensor joint's child link, or in the base frame.
    """
    frame_rotation = robot.sensor_rotation @ rotation
    frame_translation = robot.sensor_rotation @ translation + robot.sensor_translation
    on_root = robot.sensor_parent < 0
    twist = np.eye(6)
    if not on_root:
        # Columns: a unit force pairs with translation along a sensor axis, a unit moment with rotation
        # about it through the sensor origin p, whose velocity at the link frame's origin is p x w.
        twist = np.zeros((6, 6))
        twist[:3, :3] = twist[3:, 3:] = frame_rotation.T
        twist[3:, :3] = np.cross(frame_translation, frame_rotation.T)
    reference = (frame_rotation, frame_translation) if on_root else (np.eye(3), np.zeros(3))
    static = np.zeros(6)
    if on_root:
        mass, first_moment = robot.static_nominal[0], robot.static_nominal[1:4]
        # The sensor holds the root link up: force -m g, moment -(mc - m p) x g about the sensor origin.
        static[:3] = -mass * (frame_rotation.T @ robot.gravity)
        static[3:] = -frame_rotation.T @ np.cross(first_moment - mass * frame_translation, robot.gravity)
    return Channels(
        names=WRENCH_NAMES,
        units=("N",) * 3 + ("N m",) * 3,
        joint=np.full(6, robot.sensor_parent),
        twist=twist,
        bodies=np.tile(robot.sensor_bodies, (6, 1)),
        reference_rotation=reference[0],
        reference_translation=reference[1],
        static_wrench=static,
    )


def torque_channels(robot: Robot) -> Channels:
    """Channels of the joint torques (forces, for sliding joints) that move the rigid links."""
    twist = np.zeros((robot.n, 6))
    twist[robot.prismatic, :3] = robot.axis[robot.prismatic]
    twist[~robot.prismatic, 3:] = robot.axis[~robot.prismatic]
    return Channels(
        names=tuple(f"tau{i + 1}" for i in range(robot.n)),
        units=tuple("N" if slides else "N m" for slides in robot.prismatic),
        joint=np.arange(robot.n),
        twist=twist,
        bodies=robot.moves_with,
        reference_rotation=np.eye(3),
        reference_translation=np.zeros(3),
        static_wrench=np.zeros(robot.n),
    )


def stack_channels(wrench: Channels, torque: Channels) -> Channels:
    """Both sets of channels together, computed in the base frame."""
    return Channels(
        names=wrench.names + torque.names,
        units=wrench.units + torque.units,
        joint=np.concatenate([wrench.joint, torque.joint]),
        twist=np.vstack([wrench.root_twists, torque.twist]),
        bodies=np.vstack([wrench.bodies, torque.bodies]),
        reference_rotation=torque.reference_rotation,
        reference_translation=torque.reference_translation,
        static_wrench=np.concatenate([wrench.static_wrench, torque.static_wrench]),
    )
