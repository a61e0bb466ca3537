"""Arms, motions and effects for the tests of effects, and Pinocchio's recursion to compare with."""

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import stack_channels, torque_channels, wrench_channels
from bayesid.effects import EffectLibrary, MotionSegment, Term
from bayesid.robot.robot import load_robot
from tests.robots import ROBOTS, write

LIBRARY = EffectLibrary()
TURN = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
SHIFT = np.array([0.1, 0.2, -0.3])


def both(robot, turn=TURN, shift=SHIFT):
    return stack_channels(wrench_channels(robot, turn, shift), torque_channels(robot))


def load(folder, name):
    return load_robot(write(folder, ROBOTS[name]()), sensor_joint="wrist_ft" if name == "wrist_sensor_arm" else None)


def moving(robot, count=400, step=0.01, seed=0):
    """A segment with exact rates: three sines a joint."""
    rng = np.random.default_rng(seed)
    t = step * np.arange(count)
    q, v, a = np.zeros((3, count, robot.n))
    for frequency in (0.13, 0.29, 0.47):
        size, phase = rng.normal(0.0, 0.5, robot.n), rng.uniform(0, 6, robot.n)
        w = 2 * np.pi * frequency * (1 + 0.1 * rng.normal(size=robot.n))
        q += size * np.sin(w * t[:, None] + phase)
        v += size * w * np.cos(w * t[:, None] + phase)
        a -= size * w * w * np.sin(w * t[:, None] + phase)
    return MotionSegment(t, q, v, a)


def term(robot, spec, *values, gear_ratio=None):
    channels = both(robot).names
    (effect,) = LIBRARY.parse([spec], robot.joint_names, channels, gear_ratio)
    return Term(effect, values or tuple(effect.typical(robot)))


def oracle(robot, segment, sample, *, gravity=None, outside=(), q=None, v=None, a=None):
    """Wrench about the base origin, in base axes, and torques of one sample by Pinocchio's recursion.

    ``outside`` holds (joint, point in its frame, force in base axes).
    """
    model = pin.buildModelFromUrdf(str(robot.urdf))
    model.gravity = pin.Motion(np.asarray(robot.gravity if gravity is None else gravity, float), np.zeros(3))
    q = segment.positions[sample] if q is None else q
    v = segment.velocities[sample] if v is None else v
    a = segment.accelerations[sample] if a is None else a
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    forces = [pin.Force.Zero() for _ in range(model.njoints)]
    for joint, point, force in outside:
        local = data.oMi[joint + 1].rotation.T @ force
        forces[joint + 1] += pin.Force(local, np.cross(point, local))
    tau = pin.rnea(model, data, q, v, a, forces)
    wrench = data.oMi[1].act(data.f[1])
    static = pin.Inertia.FromDynamicParameters(robot.static_nominal) * pin.Motion(-model.gravity.linear, np.zeros(3))
    return np.concatenate([(wrench + static).vector, tau])


def at_base(robot):
    """Channels of a sensor at the base origin, and torques."""
    return both(robot, np.eye(3), np.zeros(3))
