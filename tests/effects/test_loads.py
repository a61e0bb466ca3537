"""Pushes, pulls and drag, against Pinocchio's recursion with external forces."""

import numpy as np
import pinocchio as pin
import pytest

from bayesid.dynamics.channels import wrench_channels
from bayesid.effects import columns, readings
from bayesid.robot.robot import load_robot
from tests.effects.arms import at_base, moving, oracle, term
from tests.robots import write


def test_pushes_and_pulls_are_external_forces(panda):
    segment = moving(panda)
    point, anchor = np.array([0.05, -0.02, 0.08]), np.array([0.4, -0.3, 0.9])
    contact = term(panda, "external_contact@joint5", 1.0, 3.0, 7.0, -4.0, 5.0, *point)
    tether = term(panda, "tether@joint7", 60.0, 0.2, *anchor, *point)
    got = readings(panda, at_base(panda), segment, panda.nominal, [contact, tether])
    for sample in (20, 105, 200, 290):
        model = pin.buildModelFromUrdf(str(panda.urdf))
        data = model.createData()
        pin.forwardKinematics(model, data, segment.positions[sample])
        line = anchor - data.oMi[7].act(point)
        size = np.linalg.norm(line)
        pull = 60.0 * max(size - 0.2, 0.0) * line / size
        share = np.clip(min(segment.times[sample] - 1.0, 3.0 - segment.times[sample]) / 0.2, 0, 1)
        push = (0.5 - 0.5 * np.cos(np.pi * share)) * np.array([7.0, -4.0, 5.0])
        expected = oracle(panda, segment, sample, outside=[(4, point, push), (6, point, pull)])
        np.testing.assert_allclose(got[sample], expected, atol=1e-9)
    # Force one way only, and the push only in its window.
    slack = term(panda, "tether@joint7", 60.0, 50.0, *anchor, *point)
    plain = readings(panda, at_base(panda), segment, panda.nominal)
    np.testing.assert_array_equal(readings(panda, at_base(panda), segment, panda.nominal, [slack]), plain)
    pushed = np.abs(readings(panda, at_base(panda), segment, panda.nominal, [contact]) - plain).max(axis=1) > 1e-9
    assert (segment.times[pushed].min(), segment.times[pushed].max()) == pytest.approx((1.0, 3.0), abs=0.02)


def test_drag_acts_along_the_links(panda):
    segment, sample = moving(panda), 130
    got = readings(panda, at_base(panda), segment, panda.nominal, [term(panda, "fluid_drag", 3.0, 8.0)])[sample]
    model = pin.buildModelFromUrdf(str(panda.urdf))
    data = model.createData()
    pin.forwardKinematics(model, data, segment.positions[sample], segment.velocities[sample])
    outside = []
    for joint, (start, end) in zip(panda.rod_joint.tolist(), panda.rods, strict=True):
        pieces = 400
        for k in range(pieces):
            point = start + (k + 0.5) / pieces * (end - start)
            at = pin.SE3(np.eye(3), point)
            velocity = data.oMi[joint + 1].rotation @ at.actInv(data.v[joint + 1]).linear
            force = -(3.0 + 8.0 * np.linalg.norm(velocity)) * velocity * np.linalg.norm(end - start) / pieces
            outside.append((joint, point, force))
    np.testing.assert_allclose(got, oracle(panda, segment, sample, outside=outside), atol=1e-4)
    # The hand is fixed to link 7: its mount is a rod's end, the base's first joint is none.
    lengths = np.linalg.norm(panda.rods[:, 1] - panda.rods[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(0.316 + 0.0825 + np.hypot(0.0825, 0.384) + 0.088 + 0.107)


def test_a_sensor_in_a_link_feels_the_drag_beyond_it_alone(wrist):
    """Of the last link the rods from the sensor's joint over the tool's mount to its tip, not the one before the sensor."""
    segment, sample = moving(wrist), 130
    sensor = wrench_channels(wrist, np.eye(3), np.zeros(3))
    drag = readings(wrist, sensor, segment, wrist.nominal, [term(wrist, "fluid_drag", 3.0, 8.0)])[sample]
    drag -= readings(wrist, sensor, segment, wrist.nominal)[sample]
    model = pin.buildModelFromUrdf(str(wrist.urdf))
    data = model.createData()
    pin.forwardKinematics(model, data, segment.positions[sample], segment.velocities[sample])
    placements = [model.frames[model.getFrameId(name)].placement for name in ("wrist_ft", "tool_mount", "tip")]
    total, pieces = pin.Force.Zero(), 400
    for start, end in zip(placements, placements[1:], strict=False):
        rod = end.translation - start.translation
        for k in range(pieces):
            at = pin.SE3(np.eye(3), start.translation + (k + 0.5) / pieces * rod)
            velocity = at.actInv(data.v[6]).linear
            force = -(3.0 + 8.0 * np.linalg.norm(velocity)) * velocity * np.linalg.norm(rod) / pieces
            total += at.act(pin.Force(force, np.zeros(3)))
    np.testing.assert_allclose(drag, -placements[0].actInv(total).vector, atol=1e-5)
    assert np.linalg.norm(drag[:3]) > 0.1


def test_drag_of_a_single_joint_at_the_base_is_none(tmp_path):
    """A turntable has no rods; the diagnosis of a real one asks for the derivatives all the same."""
    robot = load_robot(write(tmp_path, """
        <robot name="turntable">
          <link name="base"/>
          <link name="table"><inertial><origin xyz="0.01 0 0.1"/><mass value="2"/>
            <inertia ixx="0.02" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
          <joint name="joint1" type="revolute"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/>
            <limit lower="-3" upper="3" effort="10" velocity="3"/></joint>
        </robot>"""))  # fmt: skip
    segment, drag = moving(robot), term(robot, "fluid_drag", 3.0, 8.0)
    plain = readings(robot, at_base(robot), segment, robot.nominal)
    np.testing.assert_array_equal(readings(robot, at_base(robot), segment, robot.nominal, [drag]), plain)
    assert not columns(robot, at_base(robot), segment, robot.nominal, [drag], drag.effect).any()
