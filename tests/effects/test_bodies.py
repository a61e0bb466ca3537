"""The rigid model without effects, bodies more or less, and spinning rotors, against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.effects import MotionSegment, columns, readings, rigid_columns
from bayesid.effects.bodies import InertiaError, Payload
from bayesid.robot import inertia
from bayesid.robot.robot import load_robot
from tests.effects.arms import SHIFT, TURN, at_base, both, load, moving, term
from tests.example_robots import ZERO, Joint, urdf_text
from tests.robots import body, write


@pytest.mark.parametrize("name", ["panda", "tree", "prismatic_arm", "wrist_sensor_arm"])
def test_without_effects_they_are_the_rigid_model(tmp_path, name):
    robot = load(tmp_path, name)
    rng = np.random.default_rng(1)
    segment = MotionSegment(np.arange(50.0), *rng.normal(size=(3, 50, robot.n)))
    for channels in (wrench_channels(robot, TURN, SHIFT), torque_channels(robot), both(robot)):
        kernel, motion = Kernel.of(robot, channels), (segment.positions, segment.velocities, segment.accelerations)
        regressor = kernel.dynamics(*motion)
        expected = regressor @ robot.nominal.ravel() + channels.static_wrench
        np.testing.assert_allclose(readings(robot, channels, segment, robot.nominal), expected, atol=1e-11)
        np.testing.assert_allclose(rigid_columns(robot, channels, segment, robot.nominal), regressor, atol=1e-11)
        lifted = kernel.dynamics(*motion, gravity=False) @ robot.nominal.ravel()
        np.testing.assert_allclose(readings(robot, channels, segment, robot.nominal, gravity=False), lifted, atol=1e-11)


def test_payload_is_a_body_more(wrist):
    """In the joint's frame, on the part beyond a sensor that splits the link."""
    segment = moving(wrist, 40)
    more = term(wrist, "payload@joint6").effect.typical(wrist)
    got = readings(wrist, both(wrist), segment, wrist.nominal, [term(wrist, "payload@joint6", *more)])
    links = wrist.nominal.copy()
    inverse = wrist.body_rotation[6].T
    links[6] += inertia.transform(more, inverse, -inverse @ wrist.body_translation[6])
    np.testing.assert_allclose(got, readings(wrist, both(wrist), segment, links), atol=1e-10)
    got = readings(wrist, both(wrist), segment, wrist.nominal, [term(wrist, "inertia_error@joint2", *(-0.1 * wrist.nominal[1]))])
    links = wrist.nominal.copy()
    links[1] *= 0.9
    np.testing.assert_allclose(got, readings(wrist, both(wrist), segment, links), atol=1e-10)


def test_rotor_is_a_body_that_spins_fast(panda):
    """A disc on its own joint, turned by gear ratio x joint rate, against the same disc held."""
    segment, joint, ratio, disc = moving(panda), 3, 50.0, 2e-4
    got = readings(
        panda, at_base(panda), segment, panda.nominal,
        [term(panda, "rotor_momentum@joint4", ratio * disc, gear_ratio={"panda_joint4": ratio})],
    ) - readings(panda, at_base(panda), segment, panda.nominal)  # fmt: skip
    for sample in (10, 222):
        q, v, a = segment.positions[sample], segment.velocities[sample], segment.accelerations[sample]
        out = []
        for gear in (ratio, 0.0):
            model = pin.buildModelFromUrdf(str(panda.urdf))
            placement = model.jointPlacements[joint + 1]
            extra = model.addJoint(joint, pin.JointModelRZ(), placement, "rotor")
            model.appendBodyToJoint(extra, pin.Inertia(0.0, np.zeros(3), np.diag([0.0, 0.0, disc])), pin.SE3.Identity())
            data = model.createData()
            k = model.joints[extra].idx_v
            full = [np.insert(x, k, gear * x[joint] if i else 0.0) for i, x in enumerate((q, v, a))]
            pin.forwardKinematics(model, data, full[0])
            tau = pin.rnea(model, data, *full)
            own = np.delete(tau, k)
            own[joint] += gear * tau[k]
            out.append(np.concatenate([data.oMi[1].act(data.f[1]).vector, own]))
        np.testing.assert_allclose(got[sample], out[0] - out[1], atol=1e-9)


def test_a_sensor_under_one_branch_reads_the_rotors_of_that_branch_alone(tmp_path):
    """Two arms on one root: the couple of the other's first motor goes past the sensor."""
    limbs = [(side, k) for side in ("left", "right") for k in (1, 2)]
    links = [body("root", 5.0, ZERO, (0.2, 0.2, 0.1)), body("plate", 1.0, ZERO, (0.1, 0.1, 0.02))]
    links += [body(f"{side}{k}", 2.0, (0.1, 0.02, 0.03), (0.2, 0.06, 0.08)) for side, k in limbs]
    joints = [Joint("under_left", "root", "plate", (0.0, 0.3, 0.1), (0.2, 0.1, -0.3), "fixed")]
    for side, under in (("left", "plate"), ("right", "root")):
        joints += [Joint(f"{side}_a", under, f"{side}1", (0.0, -0.1, 0.2), (0.3, 0.2, 0.1))]
        joints += [Joint(f"{side}_b", f"{side}1", f"{side}2", (0.3, 0.0, 0.0), (0.4, 0.0, 0.2))]
    robot = load_robot(write(tmp_path, urdf_text("two", links, joints)), sensor_joint="under_left")
    segment, channels = moving(robot, 40), both(robot)
    plain = readings(robot, channels, segment, robot.nominal)
    for k, name in enumerate(robot.joint_names, 1):
        spin = term(robot, f"rotor_momentum@joint{k}", 0.01)
        read = np.abs(readings(robot, channels, segment, robot.nominal, [spin]) - plain)[:, :6].max()
        slope = np.abs(columns(robot, channels, segment, robot.nominal, (), spin.effect, spin.values))[:, :6].max()
        assert (read > 1e-3) == (slope > 1e-3) == name.startswith("left"), name


def test_a_payload_tells_its_centre_of_mass():
    """With the standard deviations that draws of mass and first moments have."""
    rng = np.random.default_rng(0)
    values, root = np.array([2.0, 0.2, -0.1, 0.4, *np.zeros(6)]), 0.02 * rng.normal(size=(10, 10)) / np.sqrt(10)
    found = Payload("joint1", 0).derived(values.tolist(), root @ root.T)
    drawn = values + rng.normal(size=(200_000, 10)) @ root.T
    centres = drawn[:, 1:4] / drawn[:, :1]
    assert [(name, unit) for name, _, _, unit in found] == [("cx", "m"), ("cy", "m"), ("cz", "m")]
    np.testing.assert_allclose([c for _, c, _, _ in found], [0.1, -0.05, 0.2], atol=1e-12)
    np.testing.assert_allclose([s for _, _, s, _ in found], centres.std(axis=0), rtol=0.01)
    assert Payload("joint1", 0).derived((-values).tolist(), root @ root.T) == found  # what was taken away has one, too
    assert all(np.isnan(c) for _, c, _, _ in Payload("joint1", 0).derived([0.0] * 10, root @ root.T))
    assert InertiaError("joint1", 0).derived(values.tolist(), root @ root.T) == ()
