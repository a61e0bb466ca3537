"""Where joints and base really are: against Pinocchio with the joints and the base there."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import torque_channels
from bayesid.effects import EffectLibrary, Model, MotionSegment, readings
from bayesid.effects.surroundings import surroundings_of
from bayesid.errors import InputError
from tests.effects.arms import at_base, moving, oracle, term


def test_tilt_turns_gravity_and_offset_shifts_the_joint(panda):
    segment, sample = moving(panda), 70
    got = readings(panda, at_base(panda), segment, panda.nominal, [term(panda, "base_tilt", 0.05, -0.08)])[sample]
    gravity = Rotation.from_euler("xy", [0.05, -0.08]).as_matrix() @ panda.gravity
    np.testing.assert_allclose(got, oracle(panda, segment, sample, gravity=gravity), atol=1e-9)
    got = readings(panda, at_base(panda), segment, panda.nominal, [term(panda, "encoder_offset@joint4", 0.03)])[sample]
    shifted = segment.positions[sample] - 0.03 * np.eye(7)[3]
    np.testing.assert_allclose(got, oracle(panda, segment, sample, q=shifted), atol=1e-9)


def test_flexible_joint_bends_under_its_torque(panda):
    """Static pose: a fixed point of q = encoder - compliance x torque(q)."""
    q = moving(panda).positions[:3]
    zero = np.zeros_like(q)
    segment = MotionSegment(np.arange(3.0), q, zero, zero, still=True)
    flexible = term(panda, "joint_flexibility@joint2", 2e-4)
    got = readings(panda, at_base(panda), segment, panda.nominal, [flexible])
    for sample in range(3):
        link = q[sample].copy()
        for _ in range(50):
            link[1] = q[sample, 1] - 2e-4 * oracle(panda, segment, sample, q=link)[6 + 1]
        np.testing.assert_allclose(got[sample], oracle(panda, segment, sample, q=link), atol=1e-6)
    # Moving: the same in position and velocity, at every time.
    segment = moving(panda, 1500)
    model = Model.of(panda, at_base(panda), segment, panda.nominal, [flexible])
    torque = model.readings[:, 7]
    q, v, a = model.link_side(*model.motor)
    inner = slice(200, -200)
    np.testing.assert_allclose((segment.positions - q)[inner, 1], 2e-4 * torque[inner], atol=3e-5)
    np.testing.assert_allclose((segment.velocities - v)[inner, 1], 2e-4 * np.gradient(torque, segment.times)[inner], atol=3e-4)
    others = [0, 2, 3, 4, 5, 6]
    np.testing.assert_array_equal(a[:, others], segment.accelerations[:, others])


def test_mount_obeys_its_equation_of_motion(panda):
    """Pinocchio's robot on two more joints: their torque is that of spring and damper, and the reading is that robot's."""
    segment = replace(moving(panda, 1200, 0.004), middle=np.full(7, 0.3))
    resonance, damping = 9.0, 0.06
    mount = term(panda, "base_compliance", resonance, damping)
    model = Model.of(panda, at_base(panda), segment, panda.nominal, [mount])
    root = model.states[:, panda.n]
    angles = np.stack([np.arctan2(root[:, 7], root[:, 4]), np.arctan2(root[:, 2], root[:, 0])], axis=1)
    # The x and y joints' torques by Pinocchio, with rates from the angles by differences.
    arm = pin.buildModelFromUrdf(str(panda.urdf))
    full = pin.Model()
    full.gravity = arm.gravity
    full.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "tilt_x")
    full.addJoint(1, pin.JointModelRY(), pin.SE3.Identity(), "tilt_y")
    full.appendBodyToJoint(2, pin.Inertia.FromDynamicParameters(panda.static_nominal), pin.SE3.Identity())
    for k in range(7):
        full.addJoint(k + 2, pin.JointModelRZ(), arm.jointPlacements[k + 1], f"j{k}")
        full.appendBodyToJoint(k + 3, arm.inertias[k + 1], pin.SE3.Identity())
    data = full.createData()
    h = 0.004
    rate = (angles[2:] - angles[:-2]) / (2 * h)
    bend = (angles[2:] - 2 * angles[1:-1] + angles[:-2]) / h**2
    tilting = pin.crba(full, data, np.concatenate([[0, 0], np.full(7, 0.3)]))[:2, :2]
    mean, w = 0.5 * np.trace(tilting), 2 * np.pi * resonance
    loads, springs = [], []
    for sample in range(400, 1100, 50):
        q = np.concatenate([angles[sample], segment.positions[sample]])
        v = np.concatenate([rate[sample - 1], segment.velocities[sample]])
        a = np.concatenate([bend[sample - 1], segment.accelerations[sample]])
        tau = pin.rnea(full, data, q, v, a)
        loads.append(tau[:2])
        springs.append(-mean * (w**2 * angles[sample] + 2 * damping * w * rate[sample - 1]))
        # The sensor turns with the base.
        sensor = data.f[2].vector
        np.testing.assert_allclose(model.readings[sample, :6], sensor, atol=0.02)
        np.testing.assert_allclose(model.readings[sample, 6:], tau[2:], atol=0.01)
    np.testing.assert_allclose(loads, springs, atol=0.02 * np.abs(loads).max())
    stiff = readings(panda, at_base(panda), segment, panda.nominal, [term(panda, "base_compliance", 199.0, 0.5)])
    rigid = readings(panda, at_base(panda), segment, panda.nominal)
    assert np.abs(stiff - rigid).max() < 0.05 * np.abs(model.readings - rigid).max()


def test_a_coupled_transmission_shares_power_between_its_motors(panda):
    """Motor 6 turns with joint 4, too: Pinocchio at the joints' places, and the motors' power is the joints'."""
    segment, sample, c = moving(panda), 70, 0.7
    coupled = term(panda, "coupled_transmission@joint4->joint6", c)
    got = readings(panda, at_base(panda), segment, panda.nominal, [coupled])
    q, v, a = (np.array(x[sample]) for x in (segment.positions, segment.velocities, segment.accelerations))
    motors = v.copy()
    for x in (q, v, a):
        x[5] -= c * x[3]
    expected = oracle(panda, segment, sample, q=q, v=v, a=a)
    power = expected[6:] @ v
    expected[6 + 3] -= c * expected[6 + 5]
    np.testing.assert_allclose(got[sample], expected, atol=1e-9)
    np.testing.assert_allclose(got[sample, 6:] @ motors, power, rtol=1e-9)
    # Friction is the motor's: it goes with the motor's speed and is read at that motor alone.
    rough = readings(panda, at_base(panda), segment, panda.nominal, [coupled, term(panda, "viscous_friction@joint6", 2.0)])
    np.testing.assert_allclose((rough - got)[:, 6 + 5], 2.0 * segment.velocities[:, 5], atol=1e-9)
    np.testing.assert_allclose(np.delete(rough - got, 6 + 5, axis=1), 0.0, atol=1e-9)


def test_a_coupled_motors_friction_is_read_at_both_joints(panda):
    """Motor 6 turns with joint 5, too: what it loses and what its rotor takes is work at both, from the equation."""
    segment, c, viscous, coulomb, inertia = moving(panda), -0.7, 2.0, 3.0, 0.1
    rough = term(panda, "coupled_friction@joint5->joint6", c, viscous, coulomb, inertia)
    change = readings(panda, at_base(panda), segment, panda.nominal, [rough]) - readings(
        panda, at_base(panda), segment, panda.nominal
    )
    speed = segment.velocities[:, 5] + c * segment.velocities[:, 4]
    rate = segment.accelerations[:, 5] + c * segment.accelerations[:, 4]
    taken = viscous * speed + coulomb * np.clip(speed / 1e-3, -1.0, 1.0) + inertia * rate
    np.testing.assert_allclose(change[:, 6 + 5], taken, atol=1e-9)
    np.testing.assert_allclose(change[:, 6 + 4], c * taken, atol=1e-9)
    np.testing.assert_allclose(np.delete(change, [6 + 4, 6 + 5], axis=1), 0.0, atol=1e-9)
    # The power at the joints is that at the motor.
    power = np.sum(change[:, 6:] * segment.velocities, axis=1)
    np.testing.assert_allclose(power, taken * speed, atol=1e-9)


def test_a_flexible_joint_holds_up_to_where_its_link_swings_on_a_held_motor(panda):
    """``I q'' + q / c = 0`` about the motor, I by Pinocchio; none is held against a stiff joint or another effect."""
    effect = term(panda, "joint_flexibility@joint2", 2e-4).effect
    model, q = pin.buildModelFromUrdf(str(panda.urdf)), np.full(7, 0.3)
    inertia = pin.crba(model, model.createData(), q)[1, 1]
    times, still = np.arange(30.0), np.zeros((30, 7))
    around = surroundings_of(
        panda, [MotionSegment(times, np.tile(q, (30, 1)), still, still)], panda.nominal.ravel(), "torque", False,
        static_run=False, links_known=True,
    )  # fmt: skip
    np.testing.assert_allclose(effect.holds_below((2e-4,), around), np.sqrt(1.0 / (2e-4 * inertia)) / (2.0 * np.pi), rtol=1e-6)
    assert np.isinf(effect.holds_below((0.0,), around))
    assert np.isinf(term(panda, "base_tilt", 0.05, -0.08).effect.holds_below((0.05, -0.08), around))


def test_a_coupled_transmission_needs_the_torques_that_its_motors_share(panda):
    q, v, a = np.random.default_rng(4).normal(size=(3, 5, panda.n))
    segment = MotionSegment(np.arange(5) / 100.0, q, v, a)
    coupled, every = term(panda, "coupled_transmission@joint4->joint6", 0.8), torque_channels(panda)
    whole = readings(panda, every, segment, panda.nominal, (coupled,))
    some = readings(panda, every.only([1, 4, 5]), segment, panda.nominal, (coupled,))
    np.testing.assert_allclose(some, whole[:, [1, 4, 5]])
    with pytest.raises(InputError, match="take tau6 into other torques"):
        readings(panda, every.only([1, 3]), segment, panda.nominal, (coupled,))


def test_a_coupled_transmission_is_sought_only_where_the_torques_that_its_motors_share_are_read():
    """Asked for by name, it is refused with what lacks instead."""
    library, names = EffectLibrary(), ("a", "b")
    found = {
        k: [e.where for e in library.places("coupled_transmission", names, k)] for k in (("tau1",), ("tau2",), ("tau1", "tau2"))
    }
    assert found == {("tau1",): [], ("tau2",): ["joint1->joint2"], ("tau1", "tau2"): ["joint1->joint2"]}
    assert [e.where for e in library.parse(["coupled_transmission"], names, ["tau1"])] == ["joint1->joint2"]
