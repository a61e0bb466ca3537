"""The exact effects: against Pinocchio, closed forms, finite differences and recordings of another physics engine."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from bayesid.dynamics.channels import torque_channels, wrench_channels
from bayesid.dynamics.kinematics import link_states
from bayesid.dynamics.regressors import dynamics_regressor
from bayesid.effects import (  # fmt: skip
    KINDS,
    PLAIN,
    Scene,
    Term,
    columns,
    parse_effects,
    places,
    readings,
    rigid_columns,
    starting_point,
    typical,
)
from bayesid.effects.effect import sense
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.recordings.experiment import load_experiment
from bayesid.regression.problem import make_channels, stack_channels
from bayesid.robot import inertia
from bayesid.robot.robot import load_robot
from bayesid.signals.smoothing import smooth
from tests.robots import ROBOTS, write

TURN = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
SHIFT = np.array([0.1, 0.2, -0.3])


def both(robot, turn=TURN, shift=SHIFT):
    return stack_channels(wrench_channels(robot, turn, shift), torque_channels(robot))


def load(folder, name):
    return load_robot(write(folder, ROBOTS[name]()), sensor_joint="wrist_ft" if name == "wrist_sensor_arm" else None)


@pytest.fixture(scope="module")
def panda(tmp_path_factory):
    return load(tmp_path_factory.mktemp("panda"), "panda")


@pytest.fixture(scope="module")
def wrist(tmp_path_factory):
    return load(tmp_path_factory.mktemp("wrist"), "wrist_sensor_arm")


def moving(robot, count=400, step=0.01, seed=0):
    """A scene with exact rates: three sines a joint."""
    rng = np.random.default_rng(seed)
    t = step * np.arange(count)
    q, v, a = np.zeros((3, count, robot.n))
    for frequency in (0.13, 0.29, 0.47):
        size, phase = rng.normal(0.0, 0.5, robot.n), rng.uniform(0, 6, robot.n)
        w = 2 * np.pi * frequency * (1 + 0.1 * rng.normal(size=robot.n))
        q += size * np.sin(w * t[:, None] + phase)
        v += size * w * np.cos(w * t[:, None] + phase)
        a -= size * w * w * np.sin(w * t[:, None] + phase)
    return Scene(t, q, v, a)


def term(robot, spec, *values, gear_ratio=None):
    channels = both(robot).names
    (effect,) = parse_effects([spec], robot.joint_names, channels, gear_ratio)
    return Term(effect, values or tuple(typical(effect, robot)))


def oracle(robot, scene, sample, *, gravity=None, outside=(), q=None):
    """Wrench about the base origin, in base axes, and torques of one sample by Pinocchio's recursion.

    ``outside`` holds (joint, point in its frame, force in base axes).
    """
    model = pin.buildModelFromUrdf(str(robot.urdf))
    model.gravity = pin.Motion(np.asarray(robot.gravity if gravity is None else gravity, float), np.zeros(3))
    q = scene.positions[sample] if q is None else q
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    forces = [pin.Force.Zero() for _ in range(model.njoints)]
    for joint, point, force in outside:
        local = data.oMi[joint + 1].rotation.T @ force
        forces[joint + 1] += pin.Force(local, np.cross(point, local))
    tau = pin.rnea(model, data, q, scene.velocities[sample], scene.accelerations[sample], forces)
    wrench = data.oMi[1].act(data.f[1])
    static = pin.Inertia.FromDynamicParameters(robot.static_nominal) * pin.Motion(-model.gravity.linear, np.zeros(3))
    return np.concatenate([(wrench + static).vector, tau])


def at_base(robot):
    """Channels of a sensor at the base origin, and torques."""
    return both(robot, np.eye(3), np.zeros(3))


@pytest.mark.parametrize("name", ["panda", "tree", "prismatic_arm", "wrist_sensor_arm"])
def test_without_effects_they_are_the_rigid_model(tmp_path, name):
    robot = load(tmp_path, name)
    rng = np.random.default_rng(1)
    scene = Scene(np.arange(50.0), *rng.normal(size=(3, 50, robot.n)))
    for channels in (wrench_channels(robot, TURN, SHIFT), torque_channels(robot), both(robot)):
        regressor = dynamics_regressor(robot, channels, scene.positions, scene.velocities, scene.accelerations)
        expected = regressor @ robot.nominal.ravel() + channels.static_wrench
        np.testing.assert_allclose(readings(robot, channels, scene, robot.nominal), expected, atol=1e-11)
        np.testing.assert_allclose(rigid_columns(robot, channels, scene, robot.nominal), regressor, atol=1e-11)
        lifted = dynamics_regressor(
            robot, channels, scene.positions, scene.velocities, scene.accelerations, gravity=False
        ) @ robot.nominal.ravel()  # fmt: skip
        np.testing.assert_allclose(readings(robot, channels, scene, robot.nominal, gravity=False), lifted, atol=1e-11)


def test_pushes_and_pulls_are_external_forces(panda):
    scene = moving(panda)
    point, anchor = np.array([0.05, -0.02, 0.08]), np.array([0.4, -0.3, 0.9])
    contact = term(panda, "external_contact@joint5", 1.0, 3.0, 7.0, -4.0, 5.0, *point)
    tether = term(panda, "tether@joint7", 60.0, 0.2, *anchor, *point)
    got = readings(panda, at_base(panda), scene, panda.nominal, [contact, tether])
    for sample in (20, 105, 200, 290):
        model = pin.buildModelFromUrdf(str(panda.urdf))
        data = model.createData()
        pin.forwardKinematics(model, data, scene.positions[sample])
        line = anchor - data.oMi[7].act(point)
        size = np.linalg.norm(line)
        pull = 60.0 * max(size - 0.2, 0.0) * line / size
        share = np.clip(min(scene.times[sample] - 1.0, 3.0 - scene.times[sample]) / 0.2, 0, 1)
        push = (0.5 - 0.5 * np.cos(np.pi * share)) * np.array([7.0, -4.0, 5.0])
        expected = oracle(panda, scene, sample, outside=[(4, point, push), (6, point, pull)])
        np.testing.assert_allclose(got[sample], expected, atol=1e-9)
    # Force one way only, and the push only in its window.
    slack = term(panda, "tether@joint7", 60.0, 50.0, *anchor, *point)
    plain = readings(panda, at_base(panda), scene, panda.nominal)
    np.testing.assert_array_equal(readings(panda, at_base(panda), scene, panda.nominal, [slack]), plain)
    pushed = np.abs(readings(panda, at_base(panda), scene, panda.nominal, [contact]) - plain).max(axis=1) > 1e-9
    assert (scene.times[pushed].min(), scene.times[pushed].max()) == pytest.approx((1.0, 3.0), abs=0.02)


def test_drag_acts_along_the_links(panda):
    scene, sample = moving(panda), 130
    got = readings(panda, at_base(panda), scene, panda.nominal, [term(panda, "fluid_drag", 3.0, 8.0)])[sample]
    model = pin.buildModelFromUrdf(str(panda.urdf))
    data = model.createData()
    pin.forwardKinematics(model, data, scene.positions[sample], scene.velocities[sample])
    outside = []
    for joint, (start, end) in zip(panda.rod_joint.tolist(), panda.rods, strict=True):
        pieces = 400
        for k in range(pieces):
            point = start + (k + 0.5) / pieces * (end - start)
            at = pin.SE3(np.eye(3), point)
            velocity = data.oMi[joint + 1].rotation @ at.actInv(data.v[joint + 1]).linear
            force = -(3.0 + 8.0 * np.linalg.norm(velocity)) * velocity * np.linalg.norm(end - start) / pieces
            outside.append((joint, point, force))
    np.testing.assert_allclose(got, oracle(panda, scene, sample, outside=outside), atol=1e-4)
    # The hand is fixed to link 7: its mount is a rod's end, the base's first joint is none.
    lengths = np.linalg.norm(panda.rods[:, 1] - panda.rods[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(0.316 + 0.0825 + np.hypot(0.0825, 0.384) + 0.088 + 0.107)


def test_tilt_turns_gravity_and_offset_shifts_the_joint(panda):
    scene, sample = moving(panda), 70
    got = readings(panda, at_base(panda), scene, panda.nominal, [term(panda, "base_tilt", 0.05, -0.08)])[sample]
    gravity = Rotation.from_euler("xy", [0.05, -0.08]).as_matrix() @ panda.gravity
    np.testing.assert_allclose(got, oracle(panda, scene, sample, gravity=gravity), atol=1e-9)
    got = readings(panda, at_base(panda), scene, panda.nominal, [term(panda, "encoder_offset@joint4", 0.03)])[sample]
    shifted = scene.positions[sample] - 0.03 * np.eye(7)[3]
    np.testing.assert_allclose(got, oracle(panda, scene, sample, q=shifted), atol=1e-9)


def test_payload_is_a_body_more(wrist):
    """In the joint's frame, on the part beyond a sensor that splits the link."""
    scene = moving(wrist, 40)
    body = typical(term(wrist, "payload@joint6").effect, wrist)
    got = readings(wrist, both(wrist), scene, wrist.nominal, [term(wrist, "payload@joint6", *body)])
    links = wrist.nominal.copy()
    inverse = wrist.body_rotation[6].T
    links[6] += inertia.transform(body, inverse, -inverse @ wrist.body_translation[6])
    np.testing.assert_allclose(got, readings(wrist, both(wrist), scene, links), atol=1e-10)
    got = readings(wrist, both(wrist), scene, wrist.nominal, [term(wrist, "inertia_error@joint2", *(-0.1 * wrist.nominal[1]))])
    links = wrist.nominal.copy()
    links[1] *= 0.9
    np.testing.assert_allclose(got, readings(wrist, both(wrist), scene, links), atol=1e-10)


def test_rotor_is_a_body_that_spins_fast(panda):
    """A disc on its own joint, turned by gear ratio x joint rate, against the same disc held."""
    scene, joint, ratio, disc = moving(panda), 3, 50.0, 2e-4
    got = readings(
        panda, at_base(panda), scene, panda.nominal,
        [term(panda, "rotor_momentum@joint4", ratio * disc, gear_ratio={"panda_joint4": ratio})],
    ) - readings(panda, at_base(panda), scene, panda.nominal)  # fmt: skip
    for sample in (10, 222):
        q, v, a = scene.positions[sample], scene.velocities[sample], scene.accelerations[sample]
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


def test_flexible_joint_bends_under_its_torque(panda):
    """Static pose: a fixed point of q = encoder - compliance x torque(q)."""
    q = moving(panda).positions[:3]
    zero = np.zeros_like(q)
    scene = Scene(np.arange(3.0), q, zero, zero, still=True)
    flexible = term(panda, "joint_flexibility@joint2", 2e-4)
    got = readings(panda, at_base(panda), scene, panda.nominal, [flexible])
    for sample in range(3):
        link = q[sample].copy()
        for _ in range(50):
            link[1] = q[sample, 1] - 2e-4 * oracle(panda, scene, sample, q=link)[6 + 1]
        np.testing.assert_allclose(got[sample], oracle(panda, scene, sample, q=link), atol=1e-6)
    # Moving: the same in position and velocity, at every time.
    scene = moving(panda, 1500)
    model = Model.of(panda, at_base(panda), scene, panda.nominal, [flexible])
    torque = model.readings[:, 7]
    q, v, a = model._flexed(*model.motor, model.named("joint_flexibility"))
    inner = slice(200, -200)
    np.testing.assert_allclose((scene.positions - q)[inner, 1], 2e-4 * torque[inner], atol=3e-5)
    np.testing.assert_allclose((scene.velocities - v)[inner, 1], 2e-4 * np.gradient(torque, scene.times)[inner], atol=3e-4)
    others = [0, 2, 3, 4, 5, 6]
    np.testing.assert_array_equal(a[:, others], scene.accelerations[:, others])


def test_mount_obeys_its_equation_of_motion(panda):
    """Pinocchio's robot on two more joints: their torque is that of spring and damper, and the reading is that robot's."""
    scene = replace(moving(panda, 1200, 0.004), middle=np.full(7, 0.3))
    resonance, damping = 9.0, 0.06
    mount = term(panda, "base_compliance", resonance, damping)
    model = Model.of(panda, at_base(panda), scene, panda.nominal, [mount])
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
        q = np.concatenate([angles[sample], scene.positions[sample]])
        v = np.concatenate([rate[sample - 1], scene.velocities[sample]])
        a = np.concatenate([bend[sample - 1], scene.accelerations[sample]])
        tau = pin.rnea(full, data, q, v, a)
        loads.append(tau[:2])
        springs.append(-mean * (w**2 * angles[sample] + 2 * damping * w * rate[sample - 1]))
        # The sensor turns with the base.
        sensor = data.f[2].vector
        np.testing.assert_allclose(model.readings[sample, :6], sensor, atol=0.02)
        np.testing.assert_allclose(model.readings[sample, 6:], tau[2:], atol=0.01)
    np.testing.assert_allclose(loads, springs, atol=0.02 * np.abs(loads).max())
    stiff = readings(panda, at_base(panda), scene, panda.nominal, [term(panda, "base_compliance", 199.0, 0.5)])
    rigid = readings(panda, at_base(panda), scene, panda.nominal)
    assert np.abs(stiff - rigid).max() < 0.05 * np.abs(model.readings - rigid).max()


@pytest.mark.parametrize("name", ["panda", "wrist"])
def test_sensor_pose_is_that_of_another_sensor(name, request):
    """A turned or shifted sensor reads what a sensor that is stated there would."""
    robot = request.getfixturevalue(name)
    scene = moving(robot, 60)
    stated = wrench_channels(robot, TURN, SHIFT)
    r, d = np.array([0.05, -0.1, 0.2]), np.array([0.02, -0.03, 0.01])
    terms = [term(robot, "sensor_rotation", *r), term(robot, "sensor_translation", *d)]
    true = wrench_channels(robot, TURN @ Rotation.from_rotvec(r).as_matrix(), SHIFT + d)
    np.testing.assert_allclose(
        readings(robot, stated, scene, robot.nominal, terms), readings(robot, true, scene, robot.nominal), atol=1e-10
    )


def test_sensor_chain_in_its_order(panda):
    scene, channels = moving(panda), both(panda)
    true = readings(panda, channels, scene, panda.nominal)
    offset, drift = np.arange(1.0, 7.0), 0.1 * np.arange(6.0, 0.0, -1.0)
    terms = [
        term(panda, "sensor_gain@mz", 0.1), term(panda, "sensor_crosstalk@fx->mz", 0.03),
        term(panda, "sensor_offset", *offset), term(panda, "sensor_drift", *drift),
    ]  # fmt: skip
    expected = true.copy()
    expected[:, 5] = 1.1 * true[:, 5] + 0.03 * true[:, 0]
    expected[:, :6] += offset + scene.times[:, None] * drift
    np.testing.assert_allclose(readings(panda, channels, scene, panda.nominal, terms), expected, atol=1e-10)
    # A delay moves all six, and the motion a moment ago gives the wrench of that moment.
    fine = moving(panda, 4000, 0.001)
    late = readings(panda, channels, fine, panda.nominal, [term(panda, "sensor_delay", 0.005)])
    now = readings(panda, channels, fine, panda.nominal)
    np.testing.assert_allclose(late[5:, :6], now[:-5, :6], atol=1e-6)
    np.testing.assert_array_equal(late[:, 6:], now[:, 6:])
    # With a static run subtracted, offsets and pulls go, drift and pushes stay.
    tether = term(panda, "tether@joint5", 50.0, 0.1, 0.3, 0.2, 1.0, 0.0, 0.0, 0.0)
    apart = readings(panda, channels, scene, panda.nominal, [*terms, tether], gravity=False)
    plain = readings(panda, channels, scene, panda.nominal, terms[:2], gravity=False)
    np.testing.assert_allclose((apart - plain)[:, :6], scene.times[:, None] * drift, atol=1e-9)


def test_inside_a_joint(panda):
    scene, channels = moving(panda), both(panda)
    true = readings(panda, channels, scene, panda.nominal)
    values = {
        "viscous_friction": (2.0,), "coulomb_friction": (3.0,), "torque_offset": (0.7,), "stribeck_friction": (1.5, 0.2),
        "load_friction": (0.1,), "rotor_inertia": (0.4,), "torque_gain": (0.2,),
        "torque_ripple": (0.5, 12.0, 0.4), "spring": (8.0, 0.3),
    }  # fmt: skip
    got = readings(panda, channels, scene, panda.nominal, [term(panda, f"{k}@joint3", *v) for k, v in values.items()])
    q, v, a, tau = scene.positions[:, 2], scene.velocities[:, 2], scene.accelerations[:, 2], true[:, 8]
    sense = np.clip(v / 1e-3, -1, 1)
    inside = 2 * v + (3 + 1.5 * np.exp(-((v / 0.2) ** 2)) + 0.1 * np.abs(tau)) * sense + 0.7 + 0.4 * a
    expected = true.copy()
    expected[:, 8] = 1.2 * (tau + inside + 0.5 * np.sin(12 * q + 0.4) + 8 * (q - 0.3))
    np.testing.assert_allclose(got, expected, atol=1e-10)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("arm", ["panda", "wrist"])
def test_columns_are_derivatives(arm, name, request):
    robot = request.getfixturevalue(arm)
    channels, scene = both(robot), moving(robot, 600)
    others = [
        term(robot, "sensor_rotation", 0.1, 0.2, -0.1), term(robot, "sensor_gain@fx", 0.1), term(robot, "sensor_delay", 0.01),
        term(robot, "torque_gain@joint2", 0.1), term(robot, "load_friction@joint2", 0.1),
    ]  # fmt: skip
    found = places(name, robot.joint_names, channels.names, {robot.joint_names[1]: 80.0})
    effect = found[min(1, len(found) - 1)]
    values = typical(effect, robot)
    terms = [t for t in others if t.effect != effect] + [Term(effect, values)]
    got = columns(robot, channels, scene, robot.nominal, terms, effect)
    assert got.shape == (600, len(channels), len(values)) and np.isfinite(got).all()
    for k, value in enumerate(values):
        step = {"compliance": 1e-7, "resonance": 1e-3}.get(effect.kind.parameters[k], 1e-4 * max(abs(value), 0.1))
        shift = step * np.eye(len(values))[k]
        ends = [
            readings(robot, channels, scene, robot.nominal, [*terms[:-1], Term(effect, values + s * shift)]) for s in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / (2 * step)
        tolerance = 2e-2 if effect.kind.parameters[k] in ("start", "end") else 2e-3
        assert np.linalg.norm(got[:, :, k] - slope) <= tolerance * np.linalg.norm(slope) + 1e-7
    # From anywhere else: the value asked for, not the term's.
    there = columns(robot, channels, scene, robot.nominal, terms, effect, values)
    np.testing.assert_array_equal(got, there)


def test_rigid_columns_go_through_the_instruments(wrist):
    channels, scene = both(wrist), moving(wrist, 50)
    terms = [
        term(wrist, "sensor_rotation", 0.1, 0.2, -0.1), term(wrist, "sensor_crosstalk@fz->my", 0.1),
        term(wrist, "sensor_delay", 0.01), term(wrist, "torque_gain@joint2", 0.1), term(wrist, "load_friction@joint2", 0.1),
        term(wrist, "encoder_offset@joint2", 0.1), term(wrist, "base_tilt", 0.1, 0.1),
    ]  # fmt: skip
    got = rigid_columns(wrist, channels, scene, wrist.nominal, terms)
    change = 1e-3 * np.random.default_rng(0).normal(size=wrist.nominal.shape)
    ends = [readings(wrist, channels, scene, wrist.nominal + s * change, terms) for s in (1, -1)]
    np.testing.assert_allclose(got @ change.ravel(), 0.5 * (ends[0] - ends[1]), atol=1e-9)


# -- structure: METHODS of what a base sensor can and cannot tell


def outside(column, span):
    """Share of a column that other columns do not reach."""
    left = column - span @ np.linalg.lstsq(span, column, rcond=None)[0]
    return np.linalg.norm(left) / np.linalg.norm(column)


@pytest.fixture(scope="module")
def rigid(panda):
    scene = moving(panda, 500)
    channels = wrench_channels(panda, np.eye(3), SHIFT * [0, 0, 1])
    constants = np.tile(np.eye(6), (500, 1))
    return scene, channels, rigid_columns(panda, channels, scene, panda.nominal).reshape(3000, -1), constants


@pytest.mark.parametrize("joint", range(1, 8))
def test_rotor_momentum_is_an_inertia_in_the_wrench(panda, rigid, joint):
    scene, channels, span, _ = rigid
    spin = term(panda, f"rotor_momentum@joint{joint}", 0.01)
    column = columns(panda, channels, scene, panda.nominal, [], spin.effect).ravel()
    # It is +c z z' on link i and -c z z' on link i - 1, of which the root has none to give.
    assert outside(column, span) < 1e-6
    # With the torques too, the rotor's reflected inertia is left over once the gear ratio is known.
    torques = both(panda)
    (effect,) = parse_effects([f"rotor_momentum@joint{joint}"], panda.joint_names, torques.names, {f"panda_joint{joint}": 50.0})
    full = rigid_columns(panda, torques, scene, panda.nominal)
    column = columns(panda, torques, scene, panda.nominal, [], effect)
    inertia = columns(panda, torques, scene, panda.nominal, [], term(panda, f"rotor_inertia@joint{joint}", 1.0).effect)
    flat = full.reshape(-1, full.shape[2])
    assert outside(column.ravel(), flat) > 0.1
    assert outside(column.ravel(), np.column_stack([flat, inertia.ravel()])) < 1e-6


def test_what_no_wrench_can_tell(panda, rigid):
    scene, channels, span, constants = rigid
    # The same gain on all axes is a scale of all links (and of the root, which is constant).
    axes = places("sensor_gain", panda.joint_names, channels.names)
    gains = sum(columns(panda, channels, scene, panda.nominal, [], e) for e in axes)
    assert outside(gains.ravel(), np.hstack([span, constants])) < 1e-8
    one = columns(panda, channels, scene, panda.nominal, [], axes[3])
    assert outside(one.ravel(), np.hstack([span, constants])) > 0.01
    # A payload is its link's parameters.
    load = columns(panda, channels, scene, panda.nominal, [], term(panda, "payload@joint7").effect)
    np.testing.assert_allclose(load.reshape(3000, 10), span[:, 60:70], atol=1e-10)
    # A vertical offset is weight; the other five axes are not.
    left = [outside(constants[:, k], span) for k in range(6)]
    assert left[2] < 1e-6 and min(np.delete(left, 2)) > 0.01
    # The first encoder's zero turns the sensor about the vertical.
    angle = columns(panda, channels, scene, panda.nominal, [], term(panda, "encoder_offset@joint1").effect).ravel()
    yaw = columns(panda, channels, scene, panda.nominal, [], term(panda, "sensor_rotation").effect)[:, :, 2].ravel()
    # The root's own weight and moment turn along only with the sensor: constants.
    assert outside(angle, np.column_stack([yaw, constants])) < 1e-6
    np.testing.assert_allclose(np.linalg.lstsq(np.column_stack([yaw, constants]), angle, rcond=None)[0][0], 1.0, atol=1e-6)
    second = columns(panda, channels, scene, panda.nominal, [], term(panda, "encoder_offset@joint2").effect).ravel()
    assert outside(second, np.column_stack([yaw, constants])) > 0.5


# -- names


def test_effects_are_found_where_they_can_be(panda):
    names, channels = panda.joint_names, both(panda).names
    assert len(places("sensor_crosstalk", names, channels)) == 30
    assert [e.where for e in places("external_contact", names, channels)][-2:] == ["joint7", "robot"]
    assert places("viscous_friction", names, channels[:6]) == ()
    assert parse_effects(["sensor_gain"], names, channels[6:]) == ()
    (cross,) = parse_effects(["sensor_crosstalk@fx->mz"], names, channels)
    assert cross.axes == (0, 5) and cross.units == ("N m per N",)
    (tether,) = parse_effects(["tether@panda_joint3"], names, channels)
    assert (tether.where, tether.joint) == ("joint3", 2)
    for spec, message in [
        ("sensor_gain@fq", "no axis 'fq'"), ("sensor_crosstalk@fx", "as in fx->mz"), ("tether@elbow", "no joint 'elbow'"),
        ("base_tilt@joint1", "acts at the base"), ("fluid_drags", "did you mean 'fluid_drag'"),
        ("fluid_drag@joint2", "whole robot"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            parse_effects([spec], names, channels)
    values, free = starting_point([tether, cross], {"tether@panda_joint3": {"stiffness": 40.0, "fixed": True}}, names)
    assert values[0] == 40.0 and list(free) == [False] * 8 + [True]
    with pytest.raises(InputError, match="no parameter 'length'"):
        starting_point([tether], {"tether": {"length": 1.0}}, names)


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_is_complete(panda, name):
    kind = KINDS[name]
    count = len(kind.parameters)
    assert [len(x) for x in (kind.units, kind.lower, kind.upper, kind.starts, kind.non_negative)] == [count] * 5
    assert set(kind.confusable_with) <= set(KINDS) and set(kind.shape) <= set(kind.parameters)
    assert kind.linear or name not in PLAIN
    for effect in places(name, panda.joint_names, both(panda).names):
        size = typical(effect, panda)
        assert np.all(size >= kind.lower) and np.all(size <= kind.upper) and np.isfinite(size).all() and size.any()
    assert np.all(np.array(kind.starts) >= kind.lower) and np.all(np.array(kind.starts) <= kind.upper)


# -- recordings of another physics engine, whose truth is known

#: What the answers do not say is found from the recording: a ripple's phase, a mount's stiffness (its middle).
_UNKNOWN = {"07": 2}


@pytest.mark.parametrize("case", ["03", "04", "05", "06", "07", "09", "10", "11", "12", "13"])
def test_truth_explains_recordings_to_the_floor(shared, case):
    answer = json.loads(shared(f"practice/answers/practice-{case}.json").read_text())
    experiment = load_experiment(shared(f"practice/practice-{case}"))
    robot, channels = experiment.robot, make_channels(experiment, answer["channel"])
    links = np.array([answer["true_links"][f"joint{i + 1}"] for i in range(robot.n)])
    terms = []
    for entry in answer["effects"]:
        (effect,) = parse_effects([f"{entry['name']}@{entry['where']}"], robot.joint_names, channels.names, experiment.gear_ratio)
        terms.append(Term(effect, tuple(entry["parameters"].get(k, {}).get("value", 0.0) for k in effect.kind.parameters)))
    name = "identification" if case in ("12", "13") else "validation"  # contacts, and no long stop
    (motion,) = [m for m in experiment.motions if m.name == name]
    table = motion.table
    parts = {"wrench": [table.wrench], "torque": [table.torques], "both": [table.wrench, table.torques]}
    measured, gravity = np.hstack(parts[answer["channel"]]), True
    if motion.static is not None:
        measured, gravity = measured - motion.static.wrench, False
    step = float(np.median(np.diff(table.times)))
    trim, low = round(0.6 / step), butter(4, 10.0, fs=1 / step, output="sos")
    scene = Scene(table.times, *smooth(table.times, table.positions, 12.0), bandwidth=12.0)

    def error(terms):
        left = measured - readings(robot, channels, scene, links, terms, gravity=gravity)
        return sosfiltfilt(low, left, axis=0)[trim:-trim]

    if case in _UNKNOWN:
        k = _UNKNOWN[case]

        def changed(x):
            return [Term(terms[0].effect, (*terms[0].values[:k], float(x[0]), *terms[0].values[k + 1 :]))]

        best = min((least_squares(lambda x: error(changed(x)).ravel(), [s]) for s in (0.0, 2.0, 4.0)), key=lambda f: f.cost)
        terms = changed(best.x)
    floor = np.array([answer["floor_filtered"][n] for n in channels.names])
    ratio = np.sqrt(np.mean(error(terms) ** 2, axis=0)) / floor
    without = np.sqrt(np.mean(error([]) ** 2, axis=0)) / floor
    # The smoothing differs from the answers' filter: quantised encoders and contacts leave a little more.
    assert ratio.max() < (1.9 if case == "13" else 1.25)
    assert without.max() > 1.4 and np.sqrt(np.mean(ratio**2)) < 0.9 * np.sqrt(np.mean(without**2))


def test_states_are_made_once_a_scene(panda, monkeypatch):
    """Sensor-side and linear effects do not evaluate the dynamics again."""
    import bayesid.effects.model as module

    calls = []
    monkeypatch.setattr(module, "link_states", lambda *a: calls.append(1) or link_states(*a))
    scene, channels = moving(panda, 50), both(panda)
    terms = [term(panda, "payload@joint7"), term(panda, "sensor_gain@fx"), term(panda, "viscous_friction@joint1")]
    readings(panda, channels, scene, panda.nominal, terms)
    for t in terms:
        columns(panda, channels, scene, panda.nominal, terms, t.effect)
    rigid_columns(panda, channels, scene, 1.1 * panda.nominal, terms)
    assert len(calls) == 1
    readings(panda, channels, scene, panda.nominal, [*terms, term(panda, "encoder_offset@joint2")])
    assert len(calls) == 2


def test_friction_that_reverses_within_a_sample_is_its_mean_there():
    """Against the mean of many signs of ``v + a t`` over the sample's time; without that time, the sign at its middle."""
    v, a, cell = np.array([-0.03, -0.004, 0.0, 0.002, 0.009, 0.5]), np.array([2.0, 2.0, 3.0, -1.0, 2.0, 4.0]), 8e-3
    inside = cell * (np.arange(20001) / 20000 - 0.5)
    want = np.sign(v[:, None] + a[:, None] * inside).mean(axis=1)
    np.testing.assert_allclose(sense(v, a, cell), want, atol=2e-4)
    np.testing.assert_array_equal(sense(v, a, 0.0), np.sign(v))
