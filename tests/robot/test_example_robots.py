"""The test robots and the example PUMA: they load, are possible bodies, and have the published structure."""

# (Pinocchio publishes its names at run time.)

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests import example_robots as examples
from tests.robots import ROBOTS, write

# Moving joints, total mass without the root [kg].
EXPECTED = {
    "puma560": (6, 36.5),
    "ur5": (6, 17.0),
    "ur10": (6, 28.7),
    "panda": (7, 16.8),
    "lwr4": (7, 14.4),
    "prismatic_arm": (4, 18.2),
    "tree": (6, 23.7),
    "wrist_sensor_arm": (6, 18.7),
}


def two_joint_model(floating: bool) -> pin.Model:
    root = pin.JointModelFreeFlyer() if floating else None
    text = puma_two_joint_urdf()
    model = pin.buildModelFromXML(text, root) if root is not None else pin.buildModelFromXML(text)
    reference = pin.neutral(model)
    for name, angle in PAPER_LOCKED.items():
        reference[model.joints[model.getJointId(name)].idx_q] = angle
    return pin.buildReducedModel(model, [model.getJointId(n) for n in PAPER_LOCKED], reference)


def link_parameters(model: pin.Model) -> np.ndarray:
    return np.concatenate([np.asarray(model.inertias[model.getJointId(n)].toDynamicParameters()) for n in ("joint1", "joint2")])


def base_wrench_matrix(gravity: bool, samples: int = 60) -> np.ndarray:
    """Regressor (samples * 6, 20) of the wrench about P1's origin: the floating base's rows."""
    model = two_joint_model(floating=True)
    model.gravity.linear = np.array([0.0, 0.0, -9.81 if gravity else 0.0])
    data = model.createData()
    rng = np.random.default_rng(7)
    blocks = []
    for _ in range(samples):
        q = pin.neutral(model)
        q[7:] = rng.uniform(-3, 3, 2)
        v, a = (np.concatenate([np.zeros(6), rng.uniform(-3, 3, 2)]) for _ in range(2))
        matrix = pin.computeJointTorqueRegressor(model, data, q, v, a)
        shoulder = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.672]))  # P1's origin in the floating base's frame
        # Columns: ten per joint, the floating base's first. Wrenches move with the action's transpose.
        blocks.append(shoulder.toActionMatrix().T @ matrix[:6, 10:])
    return np.vstack(blocks)


@pytest.mark.parametrize("name", ROBOTS)
def test_robot_is_a_possible_body(name, tmp_path):
    model = pin.buildModelFromUrdf(str(write(tmp_path, ROBOTS[name]())))
    joints, mass = EXPECTED[name]
    assert model.njoints - 1 == joints
    assert sum(inertia.mass for inertia in list(model.inertias)[1:]) == pytest.approx(mass, abs=0.1)
    for inertia in model.inertias:
        eigenvalues = np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(inertia).toMatrix())
        assert eigenvalues.min() > 1e-7
    speeds, efforts = np.asarray(model.velocityLimit), np.asarray(model.effortLimit)
    assert np.all(np.isfinite(speeds)) and np.all(speeds > 0) and np.all(efforts > 0)
    assert np.all(np.asarray(model.lowerPositionLimit) < np.asarray(model.upperPositionLimit))


@pytest.mark.parametrize("name", ROBOTS)
def test_every_link_is_a_possible_body(name):
    # Link by link, for a merged body can hide an impossible part.
    inertias = ET.fromstring(ROBOTS[name]()).findall("link/inertial/inertia")
    assert len(inertias) > EXPECTED[name][0]
    for element in inertias:
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = (float(element.attrib[key]) for key in keys)
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert moments[0] > 0 and moments[2] < moments[0] + moments[1]


def test_two_joint_puma_is_as_it_is_written_from_the_published_numbers():
    assert puma_two_joint_urdf() == examples.puma_two_joint_urdf()


def test_two_joint_puma_is_the_six_joint_puma_in_other_frames():
    six = pin.buildModelFromXML(examples.puma560_urdf())
    two = pin.buildModelFromXML(puma_two_joint_urdf())
    q, v, a = np.random.default_rng(1).uniform(-1, 1, (3, 6))
    sign = np.array([1, -1, 1, 1, 1, 1])  # joint 2 counts the other way
    torque = pin.rnea(six, six.createData(), q, v, a)
    other = pin.rnea(two, two.createData(), sign * q, sign * v, sign * a)
    np.testing.assert_allclose(other, sign * torque, rtol=1e-10, atol=1e-12)


def test_two_joint_frames():
    model = two_joint_model(floating=False)
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(2))
    first, second = data.oMi[1], data.oMi[2]
    np.testing.assert_allclose(first.rotation[:, 1], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(second.rotation, first.rotation, atol=1e-15)
    np.testing.assert_allclose(first.actInv(second).translation, [0, 0, examples.PAPER_D2], atol=1e-15)


def test_motion_wrench_determines_exactly_the_papers_twelve():
    matrix, base_map = base_wrench_matrix(gravity=False), examples.paper_base_map()
    scale = np.linalg.norm(matrix)
    assert np.linalg.matrix_rank(matrix, tol=1e-9 * scale) == 12
    assert np.linalg.matrix_rank(base_map) == 12
    assert np.linalg.matrix_rank(np.vstack([matrix, base_map]), tol=1e-9 * scale) == 12
    # The reduced regressor reproduces the full one: the map loses nothing.
    reduced = matrix @ np.linalg.pinv(base_map)
    np.testing.assert_allclose(reduced @ base_map, matrix, atol=1e-9 * np.abs(matrix).max())
    assert len(examples.PAPER_LABELS) == len(examples.PAPER_ESTIMATE) == len(base_map)


def test_gravity_adds_the_total_mass_only():
    matrix, base_map = base_wrench_matrix(gravity=True), examples.paper_base_map()
    total = np.zeros((1, 20))
    total[0, [0, 10]] = 1
    scale = np.linalg.norm(matrix)
    assert np.linalg.matrix_rank(matrix, tol=1e-9 * scale) == 13
    assert np.linalg.matrix_rank(np.vstack([matrix, base_map, total]), tol=1e-9 * scale) == 13


def test_regressor_reproduces_inverse_dynamics():
    # Independent of the regressor: the wrench on a floating base at rest, without gravity, is the robot's.
    model = two_joint_model(floating=True)
    model.gravity.linear = np.zeros(3)
    q, v, a = np.random.default_rng(3).uniform(-2, 2, (3, 2))
    q = np.r_[pin.neutral(model)[:7], q]
    v, a = np.r_[np.zeros(6), v], np.r_[np.zeros(6), a]
    wrench = pin.rnea(model, model.createData(), q, v, a)[:6]
    matrix = pin.computeJointTorqueRegressor(model, model.createData(), q, v, a)[:6, 10:]
    np.testing.assert_allclose(matrix @ link_parameters(model), wrench, rtol=1e-10, atol=1e-12)


def test_d2_has_the_sign_of_the_papers_estimate():
    # Link 2 alone, from published numbers: link 1's share was set after the estimate and proves nothing.
    parameters = link_parameters(two_joint_model(floating=False))
    parameters[:10] = 0
    values = examples.paper_base_map() @ parameters
    assert values[1] == pytest.approx(-4.934, abs=1e-3)
    assert np.sign(values[1]) == np.sign(examples.PAPER_ESTIMATE[1])
    # Link 2's larger parameters: sign only, as the estimate is of another arm.
    for row in (2, 3, 5, 7, 8, 9, 11):
        assert np.sign(values[row]) == np.sign(examples.PAPER_ESTIMATE[row])
