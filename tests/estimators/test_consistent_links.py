"""Links of `identified.urdf`: possible, nearest to the nominal ones, and within the estimate's uncertainty."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import cvxpy as cp
import numpy as np
import pinocchio as pin
import pytest
from scipy.stats import chi2

import bayesid
from bayesid.cli import main
from bayesid.estimators.conic.consistent_links import LARGEST_LOSS, MARGIN, consistent_links
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot import inertia
from bayesid.robot.prior import states_masses, typical_links
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import perturbed_links
from bayesid.workflows.identify import identify
from tests.robots import ROBOTS, write
from tests.simulated import Motion, experiment, fourier, recording

FRICTION = ["viscous_friction", "coulomb_friction", "torque_offset"]


def simulated(folder, *, name="ur5", std=2.0, sign=1.0, friction=(0.0, 0.0), duration=20.0):
    """Torques of a robot whose links are not the nominal ones, so noisy that plain links are impossible; two motions."""
    robot = load_robot(write(folder, ROBOTS[name]()))
    truth = perturbed_links(robot, 0.3, 4).ravel()
    motions = []
    for k, role in enumerate(("identification", "validation")):
        motion = fourier(robot, 4 + k, duration)
        table = recording(robot, None, motion, torque_std=std, resolution=1e-5, phi=truth, seed=k)
        drag = friction[0] * motion[2] + friction[1] * np.sign(motion[2])
        motions.append(Motion(role, role, replace(table, torques=sign * (table.torques + drag))))
    return robot, truth, experiment(robot, motions, inertia_rel_std=0.3)


def mass_matrices(path, count, seed=0):
    model = pin.buildModelFromUrdf(str(path))
    data, rng = model.createData(), np.random.default_rng(seed)
    out = []
    for _ in range(count):
        upper = pin.crba(model, data, rng.uniform(-np.pi, np.pi, model.nq))
        out.append(np.triu(upper) + np.triu(upper, 1).T)
    return np.array(out)


def test_links_are_the_optimum_of_the_problem_as_a_person_would_write_it(tmp_path):
    """Distance to the nominal links against cvxpy, within the accuracy of the search for the multiplier."""
    robot, _, made = simulated(tmp_path)
    regression = prepare(made, FitOptions("torque")).regression
    estimate = bayesid.fit(regression, "wls")
    found = consistent_links(regression, estimate, robot.nominal)
    rows = np.concatenate([b.matrix for b in regression.rows.blocks()])
    power = np.sum(np.concatenate([b.target for b in regression.rows.blocks()]) - rows @ estimate.solution, axis=0) * 0.0
    for b in regression.rows.blocks():
        power += np.sum((b.target - b.matrix @ estimate.solution) ** 2, axis=0)
    weighted = (rows / np.sqrt(power * rows.shape[1] * LARGEST_LOSS)[:, None]).reshape(-1, rows.shape[2])
    scatter = np.linalg.qr(weighted, mode="r")
    spread = np.linalg.inv(np.linalg.cholesky(estimate.covariance)) / np.sqrt(chi2.ppf(0.95, regression.base.rank))
    parts, cost, rules = [], 0.0, []
    for body in robot.nominal:
        root = np.linalg.cholesky(inertia.pseudo_inertia(body))
        inner = cp.Variable((4, 4), symmetric=True)  # relative to the nominal body
        rules.append(inner >> MARGIN * np.eye(4))
        cost += cp.sum_squares(inner - np.eye(4))
        whole = root @ inner @ root.T
        second = whole[:3, :3]
        turned = cp.trace(second) * np.eye(3) - second
        entries = [whole[3, 3], whole[0, 3], whole[1, 3], whole[2, 3]]
        entries += [turned[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
        parts.append(cp.hstack(entries))
    away = regression.base.matrix @ cp.hstack(parts) - estimate.values
    rules.append(cp.sum_squares(spread @ away) + cp.sum_squares(scatter @ away) <= 1.0)
    task = cp.Problem(cp.Minimize(cost), rules)
    task.solve(solver=cp.CLARABEL)
    distance = 0.0
    for body, nominal in zip(found.links.reshape(-1, 10), robot.nominal, strict=True):
        root = np.linalg.inv(np.linalg.cholesky(inertia.pseudo_inertia(nominal)))
        distance += np.sum((root @ inertia.pseudo_inertia(body) @ root.T - np.eye(4)) ** 2)
    assert found.inside and task.status == "optimal"
    assert distance == pytest.approx(task.value, rel=0.02)


def test_urdf_of_an_estimate_whose_own_links_are_impossible_is_a_robot(tmp_path):
    robot, truth, made = simulated(tmp_path, friction=(0.5, 2.0))
    result = identify(made, "torque", effects=FRICTION)
    assert not inertia.is_physically_consistent(result.urdf.unconstrained.reshape(-1, 10)).all()
    moved = result.urdf.moved
    assert result.physically_consistent and moved.inside and not moved.conflicts and moved.largest[1] < moved.distance
    path = result.write(tmp_path / "out").parent / "identified.urdf"
    # The margin passes from bodies to the mass matrix, whatever the posture.
    found, nominal = mass_matrices(path, 200), mass_matrices(robot.urdf, 200)
    least = [np.linalg.eigvalsh(a - 0.99 * MARGIN * b).min() for a, b in zip(found, nominal, strict=True)]
    assert min(least) > 0
    # Links and friction of the file together predict the other motion about as well as the estimate.
    (estimate, urdf) = result.urdf.errors["validation"]
    assert urdf < 1.05 * estimate
    for joint in ET.parse(path).getroot().findall("joint"):
        written = joint.find("dynamics")
        if joint.get("name") in robot.joint_names:
            assert float(written.get("damping")) == pytest.approx(0.5, abs=0.3)
            assert float(written.get("friction")) == pytest.approx(2.0, abs=0.3)


def test_conflict_is_told_with_its_size(tmp_path):
    """Torques of the wrong sign: nothing that can exist explains them."""
    _, _, made = simulated(tmp_path, std=0.1, sign=-1.0, friction=(0.5, 2.0))
    result = identify(made, "torque", effects=FRICTION)
    moved = result.urdf.moved
    assert not moved.inside and moved.distance > moved.allowed and result.physically_consistent
    sigmas = [sigma for _, sigma in moved.conflicts]
    assert sigmas == sorted(sigmas, reverse=True) and sigmas[-1] > 3.0 and moved.on_boundary
    (warning,) = [w for w in result.warnings if "No bodies that can exist" in w]
    assert moved.on_boundary[0] in warning and moved.conflicts[0][0] in warning
    assert any("Friction that cannot be negative" in w for w in result.warnings) and not result.urdf.dynamics.friction
    told = result.to_dict()["identified_urdf"]
    assert told["moved"]["inside"] is False and len(told["negative_friction"]) == 12


def test_without_masses_in_the_urdf_links_are_about_as_heavy_as_the_robot(tmp_path):
    robot, truth, made = simulated(tmp_path, std=0.2)
    bare = replace(robot, nominal=np.zeros_like(robot.nominal))
    assert states_masses(robot) and not states_masses(bare)
    guess = typical_links(bare)
    assert inertia.is_physically_consistent(guess, tolerance=0.0).all() and 1.0 < guess[:, 0].sum() < 100.0
    result = identify(replace(made, robot=bare), "torque")
    assert result.physically_consistent and result.urdf.moved.inside and "no masses" in result.urdf.nominal
    # All but the first link are carried against gravity.
    carried = result.link_parameters.reshape(-1, 10)[1:, 0].sum()
    assert 0.3 < carried / truth.reshape(-1, 10)[1:, 0].sum() < 3.0
    (estimate, urdf) = result.urdf.errors["validation"]
    assert urdf < 1.05 * estimate


def test_estimates_without_covariance_are_held_by_their_predictions(tmp_path):
    robot, _, made = simulated(tmp_path)
    result = identify(made, "torque", "ridge")
    moved = result.urdf.moved
    assert moved.distance is None and moved.inside and result.physically_consistent
    regression, estimate = result.problem.regression, result.estimate
    ratios = []
    for solution in (estimate.solution, moved.solution):
        ratios.append(sum(np.sum((b.target - b.matrix @ solution) ** 2, axis=0) for b in regression.rows.blocks()))
    assert np.mean(ratios[1] / ratios[0]) < 1.0 + 1.2 * LARGEST_LOSS


def test_command_line_writes_unconstrained_links_beside_the_others(tmp_path, capsys):
    _, _, made = simulated(tmp_path, duration=8.0)
    bayesid.write_experiment(made, tmp_path / "arm")
    out = tmp_path / "out"
    assert main(["identify", str(tmp_path / "arm"), "--channel", "torque", "--unconstrained-urdf", "--out", str(out)]) == 0
    masses = {
        name: [float(mass.get("value")) for mass in ET.parse(out / name).getroot().iter("mass")]
        for name in ("identified.urdf", "identified-unconstrained.urdf")
    }
    assert inertia.is_physically_consistent(load_robot(out / "identified.urdf").nominal, tolerance=0.0).all()
    assert min(masses["identified.urdf"]) > 0.0 > min(masses["identified-unconstrained.urdf"])
