"""Torques of drives with rotors, identified without them: links must be impossibly heavy, and the remedy is said."""

import dataclasses

import numpy as np
import pytest

import bayesid
from bayesid.robot.robot import load_robot
from tests.robots import ur5, write
from tests.simulated import Motion, experiment, fourier, puma2, recording

ROTORS = np.array([2.0, 2.5, 1.5, 0.4, 0.3, 0.2])  # reflected to the joints, about those of an arm of this size [kg m^2]


@pytest.fixture(scope="module")
def geared(tmp_path_factory):
    robot = load_robot(write(tmp_path_factory.mktemp("arm"), ur5()))
    motions = []
    for k, role in enumerate(("identification", "validation")):
        motion = fourier(robot, k)
        table = recording(robot, None, motion, torque_std=0.2, seed=k)
        motions.append(Motion(f"m{k}", role, dataclasses.replace(table, torques=table.torques + motion[3] * ROTORS)))
    return experiment(robot, motions)


def told(result):
    return [w for w in result.warnings if "rotor_inertia to [model] effects" in w]


@pytest.mark.parametrize("method", ["wls", "sdp"])
def test_rotors_that_the_model_lacks_are_named(geared, method):
    (line,) = told(bayesid.identify(geared, method=method))
    assert "the rotors of the drives seem to be missing" in line and "'m1'" in line


def test_rotors_of_some_joints_alone_are_told_as_well(geared):
    """A diagnosis names those that are told from links; what the others add to these made links of 1.5 times the mass."""
    result = bayesid.identify(geared, effects=[f"rotor_inertia@joint{k}" for k in (3, 4, 5, 6)])
    (line,) = (w for w in result.warnings if "of the others seems to be missing" in w)
    assert "Put rotor_inertia, of all, in place of rotor_inertia@joint" in line and not result.urdf.usable


def test_nothing_is_said_with_them_in_the_model(geared):
    result = bayesid.identify(geared, effects=["rotor_inertia"])
    assert not told(result)
    stated = geared.robot.nominal[:, 0].sum()
    assert result.link_parameters[::10].sum() == pytest.approx(stated, rel=0.1)


def test_nothing_is_said_of_an_arm_without(geared):
    motions = [
        dataclasses.replace(m, table=recording(geared.robot, None, fourier(geared.robot, k), torque_std=0.2, seed=k))
        for k, m in enumerate(geared.motions)
    ]
    assert not told(bayesid.identify(dataclasses.replace(geared, motions=tuple(motions))))


@pytest.mark.parametrize("rotors, ripple, lines", [(6.0, 0.0, 1), (0.0, 5.0, 0)], ids=["rotors", "ripple"])
def test_what_lets_links_exist_is_a_rotor_only_with_an_inertia_of_one(rotors, ripple, lines, tmp_path):
    """Beside parallel axes a rotor is told from no link: whatever spoilt the links, a negative one let them exist."""
    robot, motions = puma2(tmp_path), []
    for k, role in enumerate(("identification", "validation")):
        motion = fourier(robot, 300 + k, duration=10.0)
        table = recording(robot, None, motion, torque_std=0.3, seed=300 + k)
        torques = table.torques + rotors * motion[3] + ripple * np.sin(motion[1] * [4.0, 3.0])
        motions.append(Motion(f"m{k}", role, dataclasses.replace(table, torques=torques)))
    result = bayesid.identify(experiment(robot, motions))
    assert len(told(result)) == lines and not result.urdf.usable


@pytest.mark.parametrize(
    "name", ["before", *(pytest.param(name, marks=pytest.mark.slow) for name in ("feb05-20s-12h", "feb06-20s-5h"))]
)
def test_real_arm_without_its_rotors(shared, name):
    experiment = bayesid.load_experiment(shared(f"data/ur10e/{name}"))
    (line,) = told(bayesid.identify(experiment))
    result = bayesid.identify(experiment, effects=[*experiment.effects, "rotor_inertia"])
    assert not told(result)
    # The maker's masses, which no unloaded arm departs from by much.
    assert result.link_parameters[::10].sum() == pytest.approx(experiment.robot.nominal[:, 0].sum(), rel=0.05)


def test_poses_at_rest_ask_for_no_inertia(tmp_path):
    """Torques of five times the weight, as of an arm with a heavy tool: nothing in them is of inertias, or has a frequency."""
    robot = puma2(tmp_path)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (60, 2))
    table = recording(robot, None, (np.arange(60.0), q, 0.0 * q, 0.0 * q), torque_std=0.02, seed=0)
    table = dataclasses.replace(table, torques=5.0 * table.torques)
    result = bayesid.identify(experiment(robot, [Motion("one", "identification", table, kind="poses")]))
    assert not result.urdf.usable
    (line,) = (w for w in result.warnings if "no usable result" in w)
    assert "to have the first moments that the estimate asks for" in line and "inertia that" not in line and "rotor" not in line
    (said,) = (text for text in str(result).splitlines() if "identification 'one'" in text)
    assert "% of the signal, residual" in said and "Hz" not in said
