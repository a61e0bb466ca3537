"""Joints that stick where they turn, as gearboxes do, of an arm in closed form: neither a delay nor anything unknown."""

from __future__ import annotations

import numpy as np
import pytest

from bayesid import diagnose
from bayesid.recordings.experiment import Experiment, Motion
from bayesid.recordings.table import Table
from bayesid.robot.robot import Robot, load_robot
from tests.robots import write

#: Of a link on a horizontal axis: mass [kg], distance of its centre [m], inertia about the axis [kg m^2], and its friction.
MASS, REACH, INERTIA = 4.0, 0.25, 0.4
COULOMB, VISCOUS = 3.0, 2.0
STEP, RATE = 2.5e-4, 200.0
ARM = f"""<robot name="arm"><link name="base"/><link name="link"><inertial><origin xyz="{REACH} 0 0"/><mass value="{MASS}"/>
<inertia ixx="0.15" iyy="{INERTIA - MASS * REACH**2}" izz="0.15" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
<limit lower="-7" upper="7" effort="100" velocity="5"/></joint></robot>"""


def driven(seed: int, duration: float = 8.0) -> tuple[Table, np.ndarray]:
    """What encoder and drive say of a motion that a position controller of 8 Hz follows, and for how long each halt was [s].

    The friction of a step is what stops the joint, if it can be; otherwise all of it.
    """
    rng = np.random.default_rng(seed)
    times, w = np.arange(0.0, duration, STEP), 2 * np.pi * 0.1 * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5))
    sine, cosine = np.sin(np.outer(times, w)), np.cos(np.outer(times, w))
    position, speed, pull = sine @ a + cosine @ b, (cosine * w) @ a - (sine * w) @ b, -(sine * w**2) @ a - (cosine * w**2) @ b
    wanted = 1.5 / np.abs(speed).max() * np.array([position, speed, pull])
    stiff = (2 * np.pi * 8.0) ** 2
    q, v = wanted[0, 0], wanted[1, 0]
    positions, torques, resting = (np.empty(len(times)) for _ in range(3))
    for k in range(len(times)):
        weight = MASS * 9.81 * REACH * np.cos(q)
        command = wanted[2, k] + stiff * (wanted[0, k] - q) + 1.6 * np.sqrt(stiff) * (wanted[1, k] - v)
        torque = INERTIA * command - weight
        positions[k], torques[k] = q, torque
        free = INERTIA * v + STEP * (torque + weight)
        v = np.sign(free) * max(abs(free) - STEP * COULOMB, 0.0) / (INERTIA + STEP * VISCOUS)
        q, resting[k] = q + STEP * v, v == 0.0
    # A torque that is held for a step is that of the step's middle.
    torques[1:] = 0.5 * (torques[1:] + torques[:-1])
    every = slice(None, None, round(1.0 / (RATE * STEP)))
    count = 2e-5
    read = np.round(positions[every] / count) * count
    noisy = torques[every] + 0.1 * rng.normal(size=len(read))
    change = np.flatnonzero(np.diff(np.concatenate([[0.0], resting, [0.0]])))
    return Table(times=times[every], positions=read[:, None], torques=noisy[:, None]), STEP * np.diff(change)[::2]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return load_robot(write(tmp_path_factory.mktemp("arm"), ARM), ["joint"])


def recorded(robot: Robot) -> Experiment:
    motions = (
        Motion("one", "identification", driven(0)[0]),
        Motion("two", "identification", driven(1)[0]),
        Motion("held", "validation", driven(2)[0]),
    )
    friction = ("viscous_friction", "coulomb_friction")
    return Experiment("arm", robot, motions, effects=friction, inertia_rel_std=0.1, position_resolution=2e-5)


def test_the_joint_sticks_as_gearboxes_do():
    halts = driven(0)[1]
    assert 0.02 < np.median(halts) < 0.05


def test_nothing_is_missing_where_a_joint_only_sticks(arm):
    found = diagnose(recorded(arm), "torque")
    assert found.verdict == "nothing_missing"
    assert any("friction may stick" in remark for remark in found.remarks)


def test_friction_that_sticks_is_named_with_its_size(arm):
    found = diagnose(recorded(arm), "torque", effects=())
    assert found.verdict == "named"
    values = {f.term.effect.name: (f.term.values[0], f.std[0]) for f in found.found}
    assert set(values) == {"viscous_friction", "coulomb_friction"}
    for name, truth in (("viscous_friction", VISCOUS), ("coulomb_friction", COULOMB)):
        value, std = values[name]
        assert abs(value - truth) < 3.0 * std < 0.1 * truth
