"""A URDF without masses is no nominal model: sdp takes links of usual weight, and says so; sample refuses it as a prior."""

import dataclasses

import numpy as np
import pytest

import bayesid
from bayesid.robot.prior import typical_links
from bayesid.robot.robot import load_robot
from tests.robots import ur5, write
from tests.simulated import Motion, experiment, fourier, recording


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
    assert "states no masses" in prior["rule"] and prior["rel_std"] == 10.0
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
