"""A compliant, underdamped mount: two small base angles on springs and dampers, driven by the robot.

The base turns about its x axis by theta_1, then about the turned y axis by theta_2. With h the moment that the robot
asks of a rigid mount, I its inertia about the base origin and g the gravity vector,

    I(q) theta'' + (c + ...) theta' + (k + G) theta = -h,     G theta = sum c x (theta x g),

k and c from resonance and damping. What this linear equation leaves out (velocity coupling, large angles) is found
from the exact dynamics of the turned robot and put on its right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from bayesid.dynamics.kinematics import link_states
from bayesid.effects.flexible import MotionArrays
from bayesid.effects.segment import MotionSegment
from bayesid.robot.robot import Robot
from bayesid.signals.smoothing import smooth

_PASSES = 3
#: Largest phase of the ringing that one integration step covers [rad].
_PHASE = 0.2
#: Loose end of a smoothed trajectory, in periods of its bandwidth.
_LOOSE = 1.5
#: What drives the mount is kept up to this many times the frequency up to which motion is clear: a resonance shows tails, too.
_TAIL = 2.0


@dataclass(frozen=True, eq=False)
class RigidMountLoad:
    """What a robot asks of a mount that does not give."""

    inertia: np.ndarray  # about the base's x and y axes (N, 2, 2) [kg m^2]
    middle: np.ndarray  # the same at the middle of the motion (2, 2)
    weight: np.ndarray  # moment of the weight about them by base angles, G of the module (N, 2, 2) [N m/rad]
    #: Moment about them while the robot is held, and as it moves (N, 2) [N m].
    held: np.ndarray
    moving: np.ndarray

    @classmethod
    def of(
        cls, robot: Robot, segment: MotionSegment, motion: MotionArrays, row_of: np.ndarray, links: np.ndarray,
        gravity: np.ndarray, moment: Callable[[np.ndarray], np.ndarray],
    ) -> RigidMountLoad:  # fmt: skip
        """The mount of links that move so: bodies (b, 10), root included, in the frames of their rows of the state (b,)."""
        still = np.zeros((1, robot.n))
        middle, _ = _tilting(link_states(robot, segment.middle_positions[None], still, still), row_of, links)
        states = link_states(robot, *motion)
        inertia, first = _tilting(states, row_of, links)
        weight = np.zeros((len(segment.times), 2, 2))
        for k in range(2):
            weight[:, :, k] = np.cross(first, np.cross(np.eye(3)[k], gravity))[:, :2]
        moving = moment(states)[:, :2]
        zero = np.zeros_like(motion[0])
        held = moving if segment.still else moment(link_states(robot, motion[0], zero, zero))[:, :2]
        return cls(inertia, middle[0], weight, held, moving)


def mount_motion(
    robot: Robot,
    segment: MotionSegment,
    motion: MotionArrays,
    load: RigidMountLoad,
    resonance: float,
    damping: float,
    moment: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Attitude of the base (N, 18): rotation, origin, spin and its rate.

    ``motion`` is that of the links, ``load`` what it asks of a mount that does not give; ``resonance`` [Hz] and ``damping`` [1]
    are for the mean tilting inertia at the middle of the motion. ``moment`` takes states to the moment about the base origin
    that moves and holds all that the mount carries (N, 3).
    """
    rate = 2.0 * np.pi * max(resonance, 1e-3)
    mean = 0.5 * (load.middle[0, 0] + load.middle[1, 1])
    stiffness, damper = rate**2 * mean, 2.0 * damping * rate * mean
    inertia, held = load.inertia, load.held
    spring = load.weight + stiffness * np.eye(2)
    if segment.still:
        rise = np.ones((len(held), 1))
    else:
        # The ringing starts in balance. Accelerations at the loose end of a smoothed trajectory would strike the
        # mount like a hammer: they come in gradually.
        share = np.clip((segment.times - segment.times[0]) * segment.bandwidth / _LOOSE, 0.0, 1.0)[:, None]
        rise = share * share * (3.0 - 2.0 * share)
    drive = _clear(segment, held + rise * (load.moving - held))
    root = np.zeros((0, 18))
    for _ in range(_PASSES):
        if segment.still:
            angle = -np.linalg.solve(spring, drive[:, :, None])[:, :, 0]
            speed, bend = np.zeros_like(angle), np.zeros_like(angle)
        else:
            steps = int(np.ceil(np.median(np.diff(segment.times)) * rate / _PHASE)) if len(segment.times) > 1 else 1
            angle, speed, bend = _ring(segment.times, inertia, spring, damper, drive, max(steps, 1))
        root, axis = _attitude(angle, speed, bend)
        full = moment(link_states(robot, *motion, root))
        exact = np.stack([full[:, 0], np.sum(full * axis, axis=1)], axis=1)
        # What the linear equation did not know of, for the next pass.
        linear = (inertia @ bend[:, :, None] + load.weight @ angle[:, :, None])[:, :, 0]
        drive = _clear(segment, held + rise * (exact - linear - held))
    return root


def _clear(segment: MotionSegment, drive: np.ndarray) -> np.ndarray:
    """What shakes the mount, without the encoders' noise that a resonance would ring with."""
    if segment.still or segment.clear is None or len(drive) < 8:
        return drive
    return smooth(segment.times, drive, min(_TAIL * segment.clear, segment.bandwidth))[0]


def _tilting(states: np.ndarray, row_of: np.ndarray, links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inertia about the base's x and y axes (N, 2, 2) and first moment of mass (N, 3) about the base origin."""
    out, first = np.empty((len(states), 2, 2)), np.empty((len(states), 3))
    _tilting_kernel(states, np.ascontiguousarray(row_of), np.ascontiguousarray(links), out, first)
    return out, first


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tilting_kernel(states, row_of, links, out, first):
    for s in range(len(states)):
        xx = xy = yy = fx = fy = fz = 0.0
        for b in range(len(links)):
            x, phi = states[s, row_of[b]], links[b]
            m, px, py, pz = phi[0], x[9], x[10], x[11]
            ax = x[0] * phi[1] + x[1] * phi[2] + x[2] * phi[3]
            ay = x[3] * phi[1] + x[4] * phi[2] + x[5] * phi[3]
            az = x[6] * phi[1] + x[7] * phi[2] + x[8] * phi[3]
            # Rows of I R', for R I R'.
            for i in range(3):
                for j in range(3):
                    k = 4 + (0, 1, 3, 1, 2, 4, 3, 4, 5)[3 * i + j]
                    xx += x[i] * phi[k] * x[j]
                    xy += x[i] * phi[k] * x[3 + j]
                    yy += x[3 + i] * phi[k] * x[3 + j]
            # Parallel axes about an origin that is no centre of mass: m (p.p 1 - p p') + 2 (p.a) 1 - (p a' + a p').
            xx += m * (py * py + pz * pz) + 2.0 * (py * ay + pz * az)
            yy += m * (px * px + pz * pz) + 2.0 * (px * ax + pz * az)
            xy -= m * px * py + px * ay + ax * py
            fx, fy, fz = fx + m * px + ax, fy + m * py + ay, fz + m * pz + az
        out[s, 0, 0], out[s, 0, 1], out[s, 1, 0], out[s, 1, 1] = xx, xy, xy, yy
        first[s, 0], first[s, 1], first[s, 2] = fx, fy, fz


def _attitude(angle: np.ndarray, speed: np.ndarray, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root rows (N, 18) of the two angles, and the second axis in the base frame (N, 3)."""
    a, b = angle.T
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    zero = np.zeros_like(a)
    root = np.zeros((len(a), 18))
    root[:, :9] = np.stack([cb, zero, sb, sa * sb, ca, -sa * cb, -ca * sb, sa, ca * cb], axis=1)
    axis = np.stack([zero, ca, sa], axis=1)
    turned = np.stack([zero, -sa, ca], axis=1)  # d axis / d theta_1
    root[:, 12:15] = speed[:, 1:] * axis
    root[:, 12] += speed[:, 0]
    root[:, 15:18] = bend[:, 1:] * axis + (speed[:, 0] * speed[:, 1])[:, None] * turned
    root[:, 15] += bend[:, 0]
    return root, axis


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _ring(times, inertia, spring, damper, drive, steps):
    """Runge-Kutta of fourth order from rest in balance; the drive as a cubic, the rest linear between samples."""
    samples = len(times)
    angle, speed, bend = np.zeros((samples, 2)), np.zeros((samples, 2)), np.zeros((samples, 2))
    x = np.zeros(4)
    s = spring[0]
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    x[0] = -(s[1, 1] * drive[0, 0] - s[0, 1] * drive[0, 1]) / det
    x[1] = -(s[0, 0] * drive[0, 1] - s[1, 0] * drive[0, 0]) / det
    rates, y = np.zeros((4, 4)), np.zeros(4)
    for k in range(samples):
        _rate(x, inertia, spring, damper, drive, k, 0.0, rates[0])
        angle[k, 0], angle[k, 1], speed[k, 0], speed[k, 1] = x[0], x[1], x[2], x[3]
        bend[k, 0], bend[k, 1] = rates[0, 2], rates[0, 3]
        if k == samples - 1:
            break
        h = (times[k + 1] - times[k]) / steps
        for step in range(steps):
            u = step / steps
            half, whole = u + 0.5 / steps, u + 1.0 / steps
            _rate(x, inertia, spring, damper, drive, k, u, rates[0])
            for i in range(4):
                y[i] = x[i] + 0.5 * h * rates[0, i]
            _rate(y, inertia, spring, damper, drive, k, half, rates[1])
            for i in range(4):
                y[i] = x[i] + 0.5 * h * rates[1, i]
            _rate(y, inertia, spring, damper, drive, k, half, rates[2])
            for i in range(4):
                y[i] = x[i] + h * rates[2, i]
            _rate(y, inertia, spring, damper, drive, k, whole, rates[3])
            for i in range(4):
                x[i] += h / 6.0 * (rates[0, i] + 2.0 * rates[1, i] + 2.0 * rates[2, i] + rates[3, i])
    return angle, speed, bend


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rate(x, inertia, spring, damper, drive, k, u, out):
    """Rate of (theta, theta') at a share u of the way from sample k to the next."""
    last = len(drive) - 1
    a, b, c, d = max(k - 1, 0), k, min(k + 1, last), min(k + 2, last)
    # Cubic through the four samples around (Lagrange on even spacing); at the ends a sample counts twice.
    wa, wb = -u * (u - 1.0) * (u - 2.0) / 6.0, (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0
    wc, wd = -(u + 1.0) * u * (u - 2.0) / 2.0, (u + 1.0) * u * (u - 1.0) / 6.0
    force0 = -(wa * drive[a, 0] + wb * drive[b, 0] + wc * drive[c, 0] + wd * drive[d, 0])
    force1 = -(wa * drive[a, 1] + wb * drive[b, 1] + wc * drive[c, 1] + wd * drive[d, 1])
    s00 = (1.0 - u) * spring[b, 0, 0] + u * spring[c, 0, 0]
    s01 = (1.0 - u) * spring[b, 0, 1] + u * spring[c, 0, 1]
    s10 = (1.0 - u) * spring[b, 1, 0] + u * spring[c, 1, 0]
    s11 = (1.0 - u) * spring[b, 1, 1] + u * spring[c, 1, 1]
    m00 = (1.0 - u) * inertia[b, 0, 0] + u * inertia[c, 0, 0]
    m01 = (1.0 - u) * inertia[b, 0, 1] + u * inertia[c, 0, 1]
    m11 = (1.0 - u) * inertia[b, 1, 1] + u * inertia[c, 1, 1]
    r0 = force0 - s00 * x[0] - s01 * x[1] - damper * x[2]
    r1 = force1 - s10 * x[0] - s11 * x[1] - damper * x[3]
    det = m00 * m11 - m01 * m01
    out[0], out[1] = x[2], x[3]
    out[2], out[3] = (m11 * r0 - m01 * r1) / det, (m00 * r1 - m01 * r0) / det
