"""The seven-joint arm: its parts against independent ones, and the page against its numbers."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.robot import inertia

STUDY = Path(__file__).parents[2] / "case_studies" / "seven_joint_arm"
MODULES = ("run", "present", "arm")


@pytest.fixture(scope="module")
def arm(study):
    return sys.modules["arm"]


@pytest.fixture(scope="module")
def results():
    return json.loads((STUDY / "results.json").read_text(encoding="utf-8"))


def test_page_is_that_of_the_results(study, results):
    page = (STUDY / "README.md").read_text(encoding="utf-8")
    assert study.fill(page, study.tables(results)) == page


def test_promises_were_kept(results):
    bounds, workspace = results["bounds"], results["workspace"]
    assert bounds["distance"] <= bounds["rho_V"] and bounds["norm"] <= bounds["rho"] and bounds["band_holds"]
    assert workspace["true_alpha"] <= workspace["alpha"] < 1.0 and workspace["smallest_eigenvalue_of_draws"] > 0.0
    assert all(c["kept"] for name, c in results["control"].items() if name.startswith("robust"))
    errors = {name: c["largest_error"] for name, c in results["control"].items()}
    assert errors["computed torque, identified"] < 0.1 * errors["computed torque, drawing"]
    assert results["plan"]["within_limits"]


def test_task_starts_at_rest_and_keeps_to_the_limits(study, arm, tmp_path):
    robot = arm.setup(tmp_path).robot
    move = study.planned(robot)
    assert not move.velocities[0].any() and not move.accelerations[0].any()
    assert np.all((move.positions >= robot.lower) & (move.positions <= robot.upper))
    assert np.all(np.abs(move.velocities) <= robot.velocity_limit)
    np.testing.assert_allclose(np.gradient(move.positions, move.times, axis=0)[1:-1], move.velocities[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.gradient(move.velocities, move.times, axis=0)[1:-1], move.accelerations[1:-1], atol=1e-2)


def test_the_true_arm_is_the_one_that_is_recorded(arm, tmp_path):
    known = arm.setup(tmp_path)
    links = arm.true_links(known.robot)
    assert inertia.is_physically_consistent(links).all() and not np.allclose(links, known.robot.nominal)
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, 7))
    model = arm.plant(known.robot, links)
    expected = Kernel.of(known.robot, torque_channels(known.robot)).dynamics(q, v, a) @ links.ravel()
    torques = arm.true_torques(model, q, v, a)
    np.testing.assert_allclose(torques, expected + arm.FRICTION * v + arm.ROTORS * a, atol=1e-9)
    # Forward dynamics undo it: the arm under this torque accelerates as it should.
    data = model.createData()
    for k in range(len(q)):
        still = arm.true_torques(model, q[k : k + 1], v[k : k + 1], np.zeros((1, 7)))[0]
        np.testing.assert_allclose(np.linalg.solve(arm.mass_matrix(model, data, q[k]), torques[k] - still), a[k], atol=1e-8)
