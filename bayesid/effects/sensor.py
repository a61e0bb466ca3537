"""What a force/torque sensor makes of the wrench, and what drives make of the joint torque.

A wrench is read about the shifted origin, turned by exp([r])', a moment ago; gains and cross-talk mix that, offset
and drift come on top. Friction, springs and rotors inside a joint add to its torque, then its gain scales the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import Channels
from bayesid.effects.effect import Scene, Term, sense
from bayesid.robot.robot import Robot

SENSOR = (
    "sensor_offset", "sensor_drift", "sensor_gain", "sensor_crosstalk", "sensor_rotation", "sensor_translation", "sensor_delay",
)  # fmt: skip
DRIVE = (
    "viscous_friction", "coulomb_friction", "torque_offset", "stribeck_friction", "load_friction", "rotor_inertia", "torque_gain",
    "torque_ripple", "spring",
)  # fmt: skip
_SPLINE = 5  # degree of the interpolation that a delay is made with


@dataclass(frozen=True)
class SensorChain:
    """Steps from the true wrench to the reading.

    Attributes
    ----------
    pose
        Of shifted origin and turned axes (6, 6).
    delay
        [s].
    mix
        Gains and cross-talk (6, 6).
    offset, drift
        (6,) [N, N m], [.../s].
    """

    pose: np.ndarray
    delay: float
    mix: np.ndarray
    offset: np.ndarray
    drift: np.ndarray

    def sensed(self, scene: Scene, wrench: np.ndarray) -> np.ndarray:
        """Wrenches (N, 6, k) before gains and cross-talk."""
        turned = _mixed(self.pose, wrench)
        return turned if self.delay == 0.0 or scene.still else delayed(scene.times, turned, self.delay)

    def linear(self, scene: Scene, wrench: np.ndarray) -> np.ndarray:
        """All but offset and drift, (N, 6, k)."""
        return _mixed(self.mix, self.sensed(scene, wrench))

    def reading(self, scene: Scene, wrench: np.ndarray) -> np.ndarray:
        """What the sensor reads (N, 6)."""
        return self.linear(scene, wrench[:, :, None])[:, :, 0] + self.offset + scene.times[:, None] * self.drift


def sensor_chain(robot: Robot, channels: Channels, wrench: np.ndarray, terms: Sequence[Term]) -> SensorChain:
    """The sensor's own effects; ``wrench`` holds the indices of the six axes in the channels."""
    shift, turn = np.zeros(3), np.zeros(3)
    delay, mix, offset, drift = 0.0, np.eye(6), np.zeros(6), np.zeros(6)
    for term in terms:
        values, axes = np.array(term.values), term.effect.axes
        match term.effect.name:
            case "sensor_translation":
                shift = shift + values
            case "sensor_rotation":
                turn = turn + values
            case "sensor_delay":
                delay += values[0]
            case "sensor_gain":
                mix[axes[0], axes[0]] += values[0]
            case "sensor_crosstalk":
                mix[axes[1], axes[0]] += values[0]
            case "sensor_offset":
                offset = offset + values
            case "sensor_drift":
                drift = drift + values
    pose = np.eye(6)
    if len(wrench):
        # The axes of the sensor in its joint's frame, or in the base frame, are the twists of its force channels.
        axes_rows = channels.twist[wrench[:3], :3]
        if channels.joint[wrench[0]] < 0:
            axes_rows = axes_rows @ channels.reference_rotation.T
        d = axes_rows @ robot.sensor_rotation @ shift
        pose[3:, :3] = -np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])
        back = Rotation.from_rotvec(turn).as_matrix().T
        pose = np.kron(np.eye(2), back) @ pose
    return SensorChain(pose, delay, mix, offset, drift)


def _mixed(matrix: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """A matrix (6, 6) times wrenches (N, 6, k)."""
    if np.array_equal(matrix, np.eye(6)):
        return wrench
    return np.einsum("ij,njk->nik", matrix, wrench) if wrench.shape[2] < 4 else np.matmul(matrix, wrench)


def delayed(times: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """Values at ``t - delay``: a spline through the samples, its ends prolonged straight."""
    if len(times) <= _SPLINE:
        return values
    flat = values.reshape(len(times), -1)
    spline = make_interp_spline(times, flat, k=_SPLINE)
    at = times - delay
    out = spline(np.clip(at, times[0], times[-1]))
    beyond = (at < times[0]) | (at > times[-1])
    if beyond.any():
        ends = np.clip(at[beyond], times[0], times[-1])
        out[beyond] += (at[beyond] - ends)[:, None] * spline(ends, 1)
    return out.reshape(values.shape)


def inside_joint(scene: Scene, motion: tuple[np.ndarray, np.ndarray, np.ndarray], torque: np.ndarray, term: Term) -> np.ndarray:
    """What friction, a spring or a rotor adds to a joint's torque (N,).

    Parameters
    ----------
    scene
        Times.
    motion
        The motor's positions, velocities and accelerations (N, n).
    torque
        What the joint moves and carries (N,).
    term
        The effect.
    """
    joint, values = term.effect.joint, term.values
    assert joint is not None
    q, v, a = (x[:, joint] for x in motion)
    match term.effect.name:
        case "viscous_friction":
            return values[0] * v
        case "coulomb_friction":
            return values[0] * sense(v, a, scene.cell)
        case "torque_offset":
            return np.full(len(v), values[0])
        case "stribeck_friction":
            return values[0] * np.exp(-((v / max(values[1], 1e-9)) ** 2)) * sense(v, a, scene.cell)
        case "load_friction":
            return values[0] * np.abs(torque) * sense(v, a, scene.cell)
        case "rotor_inertia":
            return values[0] * a
        case "torque_ripple":
            return values[0] * np.sin(values[1] * q + values[2])
        case "spring":
            return values[0] * (q - values[1])
    return np.zeros(len(v))
