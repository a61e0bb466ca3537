"""A URDF without masses is no nominal model: sdp takes links of usual weight, and says so; sample refuses it as a prior.

A single body without one is left to the data.
"""

import dataclasses
import re

import numpy as np
import pytest

import bayesid
from bayesid.robot import inertia
from bayesid.robot.prior import GUESS_STD, typical_links
from bayesid.robot.robot import load_robot
from tests.robots import ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, recording


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    """An arm whose torques are those of its true links, and whose model states none."""
    robot = load_robot(write(tmp_path_factory.mktemp("arm"), ur5()))
    bare = dataclasses.replace(robot, nominal=np.zeros_like(robot.nominal))
    tables = [recording(robot, None, fourier(robot, k), torque_std=0.2, seed=k) for k in range(2)]
    motions = [Motion("a", "identification", tables[0]), Motion("b", "validation", tables[1])]
    return experiment(bare, motions, inertia_rel_std=0.1)


def test_sdp_takes_usual_links_and_says_so(empty):
    result = bayesid.identify(empty, method="sdp")
    prior = result.estimate.details.to_dict()["trust"]
    assert "states no masses" in prior["rule"] and prior["rel_std"] == GUESS_STD
    assert any("The URDF states no masses: sdp takes links near to cylinders" in w for w in result.warnings)
    assert result.urdf.nominal.startswith("cylinders between the joints")
    assert result.prior_check is None
    # With so little trust the data decide: the unseen motion is predicted to the noise, by links that can exist.
    assert result.physically_consistent
    assert result.validation[0].whitened_rms < 1.15 * result.validation[0].expected_rms
    # What the data say nothing of weighs what such links do, not nothing: the base link's mass.
    guess = typical_links(empty.robot)[0, 0]
    assert guess / 10.0 < result.link_parameters[0] < 10.0 * guess


def test_sample_takes_no_prior_from_it(empty):
    with pytest.raises(bayesid.InputError, match="states no masses"):
        bayesid.sample(empty, prior="nominal")
    assert bayesid.sample(empty, draws=400).model.prior is None


@pytest.mark.parametrize("bare", ["forearm", "tool"])
def test_a_body_whose_mass_is_not_stated_is_left_to_the_data(bare: str, tmp_path):
    """Beside links that are trusted to 5 % one whose ``<inertial>`` is missing is known as little as anything."""
    full = load_robot(write(tmp_path, ur5()))
    text, sensor, true = ur5(), None, 1.05 * full.nominal
    if bare == "forearm":
        inertials = list(re.finditer(r"<inertial>.*?</inertial>", text, flags=re.DOTALL))
        text = text.replace(inertials[full.joint_names.index("elbow_joint") + 1][0], "")
    else:
        mount = '<link name="tool"/><joint name="mount" type="fixed"><parent link="wrist_3_link"/><child link="tool"/></joint>'
        text, sensor = text.replace("</robot>", f"{mount}</robot>"), Sensor(joint="mount")
        tool = inertia.from_mass_com_inertia(2.0, np.array([0.01, 0.02, 0.08]), np.diag([0.01, 0.012, 0.006]))
        true = np.vstack([true, tool])
    robot = load_robot(write(tmp_path, text), sensor_joint="mount" if sensor else None)
    assert (robot.nominal[:, 0] == 0.0).sum() == 1
    noise = {"force_std": 0.1, "torque_std": 0.05}
    tables = [recording(robot, sensor, fourier(robot, k), phi=true.ravel(), seed=k, **noise) for k in range(2)]
    motions = [Motion("a", "identification", tables[0]), Motion("b", "validation", tables[1])]
    stated = experiment(robot, motions, sensor, inertia_rel_std=0.05)
    found = bayesid.identify(stated, method="sdp")
    drawn = bayesid.sample(stated, draws=400, seed=1)
    estimate = found.estimate
    away = estimate.values - estimate.base.matrix @ true.ravel()
    assert np.abs(away / np.sqrt(np.diag(estimate.stated_covariance())[: len(away)])).max() < 4.0
    assert np.abs((drawn.values - drawn.base.matrix @ true.ravel()) / drawn.std).max() < 4.0
    if bare == "forearm":  # its neighbours are trusted, so that data and URDF together show its mass
        mass = drawn.link_draws.reshape(-1, robot.nominal.size)[:, 20]
        assert abs(mass.mean() - true[2, 0]) < 4.0 * mass.std() < 1.5 * true[2, 0]
    assert found.prior_check.probability > 1e-3
