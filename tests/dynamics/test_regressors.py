"""Regressors against Pinocchio's inverse dynamics, and the momentum form against the dynamics form."""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.robot.robot import load_robot
from tests.robots import ROBOTS, write

GRAVITY = (1.5, -2.0, -9.3)


def trajectory(n, samples=21, seed=0):
    return np.random.default_rng(seed).uniform(-2, 2, (3, samples, n))


def pose(seed=0):
    rng = np.random.default_rng(seed)
    return Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.4, 0.4, 3)


def model_of(path, gravity=True, floating=False):
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()) if floating else pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array(GRAVITY) * gravity
    return model


def turning(path, joint):
    """The URDF with a fixed joint made revolute, so that Pinocchio reports the wrench through it."""
    root = ET.parse(path).getroot()
    element = root.find(f"joint[@name='{joint}']")
    element.set("type", "revolute")
    ET.SubElement(element, "axis", xyz="0 0 1")
    ET.SubElement(element, "limit", lower="-1", upper="1", effort="1", velocity="1")
    other = path.with_name("turning.urdf")
    ET.ElementTree(root).write(other)
    return other


def rnea(model, names, q, v, a, locked=None):
    """Torques of the named joints, and the wrenches through all joints in the joints' frames, of each sample."""
    data = model.createData()
    ids = [model.joints[model.getJointId(name)] for name in names]
    torques, wrenches = [], []
    for sample in range(len(q)):
        full, rates, accelerations = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        positions = {**dict(zip(names, q[sample], strict=True)), **(locked or {})}
        for name, x in positions.items():
            joint = model.joints[model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
        for k, joint in enumerate(ids):
            rates[joint.idx_v], accelerations[joint.idx_v] = v[sample, k], a[sample, k]
        tau = pin.rnea(model, data, full, rates, accelerations)
        torques.append([tau[joint.idx_v] for joint in ids])
        wrenches.append([np.array(f.vector) for f in data.f])
    return np.array(torques), np.array(wrenches)


def in_sensor(wrench, rotation, translation):
    force = wrench[:, :3]
    return np.hstack([force @ rotation, (wrench[:, 3:] - np.cross(translation, force)) @ rotation])


def reading(robot, channels, q, v, a, gravity=True):
    y = Kernel.of(robot, channels).dynamics(q, v, a, gravity=gravity) @ robot.nominal.ravel()
    return y + channels.static_wrench * gravity


def assert_equal(actual, expected, tolerance=1e-10):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * np.abs(expected).max())


@pytest.fixture(params=ROBOTS)
def path(request, tmp_path):
    return write(tmp_path, ROBOTS[request.param]())


@pytest.mark.parametrize("gravity", [True, False])
def test_torques(path, gravity):
    robot = load_robot(path, gravity=GRAVITY)
    q, v, a = trajectory(robot.n)
    expected, _ = rnea(model_of(path, gravity), robot.joint_names, q, v, a)
    assert_equal(reading(robot, torque_channels(robot), q, v, a, gravity), expected)


@pytest.mark.parametrize("gravity", [True, False])
def test_base_wrench(path, gravity):
    robot, sensor = load_robot(path, gravity=GRAVITY), pose(1)
    q, v, a = trajectory(robot.n)
    _, wrenches = rnea(model_of(path, gravity, floating=True), robot.joint_names, q, v, a)
    assert_equal(reading(robot, wrench_channels(robot, *sensor), q, v, a, gravity), in_sensor(wrenches[:, 1], *sensor))


@pytest.mark.parametrize("gravity", [True, False])
def test_wrench_of_a_sensor_in_a_moving_joint(path, gravity):
    plain = load_robot(path)
    for seed, name in enumerate(plain.joint_names):
        robot, sensor = load_robot(path, gravity=GRAVITY, sensor_joint=name), pose(seed)
        q, v, a = trajectory(robot.n, 5, seed)
        model = model_of(path, gravity)
        _, wrenches = rnea(model, robot.joint_names, q, v, a)
        expected = in_sensor(wrenches[:, model.getJointId(name)], *sensor)
        assert_equal(reading(robot, wrench_channels(robot, *sensor), q, v, a, gravity), expected)


@pytest.mark.parametrize("name, joint", [
    ("wrist_sensor_arm", "wrist_ft"), ("wrist_sensor_arm", "tool_mount"), ("tree", "left_bracket"), ("tree", "left_clamp"),
    ("tree", "right_mount"), ("panda", "panda_joint8"), ("panda", "panda_hand_joint"),
])  # fmt: skip
@pytest.mark.parametrize("gravity", [True, False])
def test_wrench_of_a_sensor_in_a_fixed_joint(name, joint, gravity, tmp_path):
    path, sensor = write(tmp_path, ROBOTS[name]()), pose(2)
    robot = load_robot(path, gravity=GRAVITY, sensor_joint=joint)
    q, v, a = trajectory(robot.n)
    model = model_of(turning(path, joint), gravity)
    torques, wrenches = rnea(model, robot.joint_names, q, v, a)
    expected = in_sensor(wrenches[:, model.getJointId(joint)], *sensor)
    assert_equal(reading(robot, wrench_channels(robot, *sensor), q, v, a, gravity), expected)
    assert_equal(reading(robot, torque_channels(robot), q, v, a, gravity), torques)


LOCKED = {"left_extension": 0.2, "left_wrist": 0.7}


@pytest.mark.parametrize("sensor_joint, locked", [
    ("waist", {"waist": 0.4}), ("waist", {"waist": -1.1, **LOCKED}), ("left_wrist", LOCKED), ("left_extension", LOCKED),
    ("left_shoulder_joint", {"left_shoulder_joint": 0.5}),
])  # fmt: skip
def test_wrench_of_a_sensor_in_a_locked_joint(sensor_joint, locked, tmp_path):
    path, sensor = write(tmp_path, ROBOTS["tree"]()), pose(3)
    names = [name for name in load_robot(path).joint_names if name not in locked][::-1]
    robot = load_robot(path, names, locked, GRAVITY, sensor_joint)
    q, v, a = trajectory(robot.n)
    model = model_of(path)
    torques, wrenches = rnea(model, names, q, v, a, locked)
    expected = in_sensor(wrenches[:, model.getJointId(sensor_joint)], *sensor)
    assert_equal(reading(robot, wrench_channels(robot, *sensor), q, v, a), expected)
    assert_equal(reading(robot, torque_channels(robot), q, v, a), torques)


def channels_of(robot):
    return torque_channels(robot), wrench_channels(robot, *pose(4))


@pytest.mark.parametrize("sensor", [False, True])
@pytest.mark.parametrize("gravity", [True, False])
def test_momentum_form_is_the_dynamics_form(path, sensor, gravity):
    robot = load_robot(path, gravity=GRAVITY, sensor_joint=load_robot(path).joint_names[2] if sensor else None)
    q, v, a = trajectory(robot.n)
    h = 1e-3

    def momentum(channels, t):
        return Kernel.of(robot, channels).momentum(q + t * v + t * t / 2 * a, v + t * a, gravity=gravity)[0]

    for channels in channels_of(robot):
        # Central difference of fourth order; its error is near 1e-9.
        rate = 8 * (momentum(channels, h) - momentum(channels, -h)) - momentum(channels, 2 * h) + momentum(channels, -2 * h)
        _, rest = Kernel.of(robot, channels).momentum(q, v, gravity=gravity)
        assert_equal(rate / (12 * h) - rest, Kernel.of(robot, channels).dynamics(q, v, a, gravity=gravity), 1e-7)


def test_column_subsets_and_reused_output(path):
    robot = load_robot(path)
    q, v, a = trajectory(robot.n, 37)
    rng = np.random.default_rng(5)
    for channels in channels_of(robot):
        full = Kernel.of(robot, channels).dynamics(q, v, a)
        full_momentum = Kernel.of(robot, channels).momentum(q, v)
        everything = np.arange(full.shape[2])
        for columns in (everything[::3], rng.permutation(everything)[:13], np.array([7]), everything[:0]):
            out = np.full((*full.shape[:2], len(columns)), np.nan)
            assert Kernel.of(robot, channels, columns).dynamics(q, v, a, out=out) is out
            np.testing.assert_array_equal(out, full[:, :, columns])
            for part, whole in zip(Kernel.of(robot, channels, columns).momentum(q, v), full_momentum, strict=True):
                np.testing.assert_array_equal(part, whole[:, :, columns])


@pytest.mark.parametrize("gravity", [True, False])
def test_readings_are_the_regressor_times_any_links(path, gravity):
    robot = load_robot(path)
    q, v, a = trajectory(robot.n, 37)
    for channels in channels_of(robot):
        kernel = Kernel.of(robot, channels)
        links = np.random.default_rng(6).normal(size=robot.nominal.size)
        expected = kernel.dynamics(q, v, a, gravity=gravity) @ links
        assert_equal(kernel.readings(q, v, a, links, gravity=gravity), expected, 1e-12)


@pytest.mark.parametrize("samples", [0, 1, 15, 16, 17, 33])
def test_samples_do_not_influence_each_other(samples, tmp_path):
    robot = load_robot(write(tmp_path, ROBOTS["tree"]()))
    q, v, a = trajectory(robot.n, 40)
    for channels in channels_of(robot):
        whole = Kernel.of(robot, channels).dynamics(q, v, a)
        part = Kernel.of(robot, channels).dynamics(q[:samples], v[:samples], a[:samples])
        np.testing.assert_array_equal(part, whole[:samples])


@pytest.mark.parametrize("name", ["panda", "prismatic_arm", "tree"])
def test_power_of_the_momentum_is_twice_the_kinetic_energy(name, tmp_path):
    path = write(tmp_path, ROBOTS[name]())
    robot, model = load_robot(path), model_of(path, gravity=False)
    channels, numbers = torque_channels(robot), st.floats(-3, 3, allow_subnormal=False)
    vectors = st.lists(numbers, min_size=robot.n, max_size=robot.n).map(np.array)

    @settings(max_examples=50, deadline=None, derandomize=True, database=None)
    @given(vectors, vectors)
    def holds(q, v):
        momentum, _ = Kernel.of(robot, channels).momentum(q[None], v[None])
        # The generalised momentum M v is the torque of the acceleration v from rest, without gravity.
        expected, _ = rnea(model, robot.joint_names, q[None], np.zeros((1, robot.n)), v[None])
        np.testing.assert_allclose(momentum[0] @ robot.nominal.ravel(), expected[0], rtol=1e-10, atol=1e-11)
        full = np.concatenate([[x] if j.nq == 1 else [np.cos(x), np.sin(x)] for x, j in zip(q, model.joints[1:], strict=True)])
        energy = pin.computeKineticEnergy(model, model.createData(), full, v)
        assert v @ momentum[0] @ robot.nominal.ravel() == pytest.approx(2 * energy, rel=1e-10, abs=1e-11)

    holds()
