"""The verb ``bounds``: from runs and experiments to files."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.io import loadmat

import bayesid
from bayesid.cli import main
from bayesid.design.bounds.knowledge import WIDE
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.errors import InputError
from bayesid.robot import inertia
from bayesid.simulation.simulation import perturbed_links
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The two-joint robot with other links than the nominal ones, a sensor under its base and joint torques; and these links."""
    robot = puma2(tmp_path_factory.mktemp("puma"))
    truth = perturbed_links(robot, 0.1, 3).ravel()
    noise = dict(force_std=0.5, torque_std=0.05, phi=truth)
    sensor = Sensor(translation=[0.0, 0.0, -0.1])
    motions = [
        Motion(role, role, recording(robot, sensor, fourier(robot, seed, duration=10.0), seed=seed, **noise))
        for seed, role in enumerate(("identification", "validation"))
    ]
    return experiment(robot, motions, sensor, inertia_rel_std=0.1), truth


@pytest.fixture(scope="module")
def runs(arm, tmp_path_factory):
    """An estimate and a posterior of it, by name."""
    bayesid.write_experiment(arm[0], place := tmp_path_factory.mktemp("runs") / "arm")
    loaded = bayesid.load_experiment(place)
    return {"estimate": bayesid.identify(loaded), "posterior": bayesid.sample(loaded, draws=600, seed=1)}


@pytest.fixture(scope="module")
def folder(arm, runs):
    """The folder of the experiment with their files and a planned motion beside it."""
    place = runs["estimate"].problem.experiment.folder.parent
    bayesid.write_trajectory(bayesid.fourier_trajectory(arm[0].robot, duration=2.0, fundamental=0.5), place / "move.csv")
    for name, run in runs.items():
        run.write(place / name)
    return place


@pytest.fixture(scope="module")
def identified(runs):
    return bayesid.bounds(runs["estimate"], configurations=64)


def test_bounds_of_an_estimate_hold_the_truth(arm, identified):
    robot, truth = arm[0].robot, arm[1]
    region = identified.region
    b = identified.torque_model.base.matrix @ truth
    assert region.distance(b) <= identified.ellipsoid and region.in_box(b)
    assert np.linalg.norm(b - identified.values) <= identified.rho
    assert not region.prior_driven.any() and region.draws is None
    _, q, v, a = fourier(robot, 9, duration=2.0)
    found = identified.torque(q, v, a)
    torques = Kernel.of(robot, torque_channels(robot)).dynamics(q, v, a) @ truth
    assert np.all((torques >= found.low) & (torques <= found.high))
    np.testing.assert_allclose(identified.torque(q[0], v[0], a[0]).values, found.values[:1])
    wrench = identified.wrench(q, v, a)
    assert wrench.names == ("fx", "fy", "fz", "mx", "my", "mz")
    # The total mass looks like the sensor's offset, which is not known: the force's band is that of the prior.
    assert identified.wrench_model is not None and identified.wrench_model.region.prior_driven.any()
    assert "rest on the prior" in " ".join(identified.warnings)
    assert wrench.std[:, 2].max() > 20 * wrench.std[:, 0].max()


def test_torques_are_those_that_act_and_not_what_a_drive_reads(arm):
    """A gain and a delay of the drives' readings, identified beside the wrench, are no error of the model of the torques."""
    whole, truth = arm

    def misread(motion: Motion) -> Motion:
        times, torques = motion.table.times, motion.table.torques
        late = np.stack([np.interp(times - 0.008, times, column) for column in torques.T], axis=1) * [1.0, 1.1]
        return replace(motion, table=replace(motion.table, torques=late))

    recorded = replace(
        whole, motions=tuple(misread(m) for m in whole.motions), effects=("torque_gain@joint2", "torque_delay@robot")
    )
    found = bayesid.bounds(bayesid.identify(recorded, channel="both"), configurations=16)
    assert found.remainder is not None and found.remainder.complete
    assert not any("missing in the model" in w for w in found.warnings)
    assert "torque_gain@joint2" in " ".join(found.assumptions) and "other uncertainty" not in " ".join(found.assumptions)
    robot = whole.robot
    _, q, v, a = fourier(robot, 9, duration=2.0)
    band = found.torque(q, v, a)
    torques = Kernel.of(robot, torque_channels(robot)).dynamics(q, v, a) @ truth
    assert np.all((torques >= band.low) & (torques <= band.high))
    assert band.half_width[:, 1].max() < 0.02 * np.abs(torques[:, 1]).max()


def test_drawn_links_can_exist_and_their_mass_matrices_are_positive_definite(arm, identified):
    assert inertia.is_physically_consistent(identified.links.reshape(-1, 10)).all()
    assert 0.0 < identified.workspace.smallest_drawn <= identified.workspace.eigenvalues[0]
    assert identified.workspace.alpha < 0.05
    spread = (identified.links @ identified.torque_model.base.matrix.T).std(axis=0)
    assert np.all(spread < 1.2 * identified.region.std)


def test_torques_give_the_other_uncertainty(identified):
    left = identified.remainder
    assert left is not None and left.held_out and left.motions == ("validation",)
    # Simulated without friction: what is left below 10 Hz is the noise of 0.05 N m, of which a band of 62.5 Hz keeps a part.
    np.testing.assert_allclose(left.bound, 2.58 * 0.05 * np.sqrt(10 / 62.5), rtol=0.35)
    assert left.complete and not any("Something is missing" in w for w in identified.warnings)
    assert not identified.inside.complete and any("inside the joints" in w for w in identified.warnings)


def test_a_posterior_gives_about_the_same(runs, identified):
    posterior = runs["posterior"]
    found = bayesid.bounds(posterior, configurations=64)
    assert found.known.source == "posterior" and found.region.draws is not None
    np.testing.assert_allclose(found.region.std, identified.region.std, rtol=0.35)
    assert found.ellipsoid == pytest.approx(identified.ellipsoid, rel=0.1)
    np.testing.assert_array_equal(found.parameters.values, posterior.values)


def test_robust_control_stays_within_its_bound(arm, identified):
    """Spong's controller on the true robot, from rest on the path; both shapes, with Pinocchio as the plant."""
    robot, truth = arm[0].robot, arm[1]
    gain, rate, width = 5.0 * identified.workspace.inertia[:, 0], 5.0, 0.02
    model = pin.Model()
    for j in range(2):
        parent = int(robot.parent[j]) + 1
        joint = pin.JointModelRevoluteUnaligned(*map(float, robot.axis[j]))
        model.addJoint(parent, joint, pin.SE3(robot.rotation[j], robot.translation[j]), f"j{j}")
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(truth[10 * j : 10 * j + 10])
    data = model.createData()

    def desired(t):
        return 0.6 * (1 - np.cos(2 * t)) * np.ones(2), 1.2 * np.sin(2 * t) * np.ones(2), 2.4 * np.cos(2 * t) * np.ones(2)

    for shape in ("ellipsoid", "ball"):
        bound = identified.tracking_bound(gain, rate, width, shape)[1]

        def rates(t, x, shape=shape):
            q, v = x[:2], x[2:]
            qd, vd, ad = desired(t)
            vr, ar = vd - rate * (q - qd), ad - rate * (v - vd)
            constant, columns = (part[0] for part in identified.control_columns(q, v, vr, ar))
            change = identified.robust_term(columns.T @ (v - vr), width, shape)
            torque = constant + columns @ (identified.values + change) - gain * (v - vr)
            return np.concatenate([v, pin.aba(model, data, q, v, torque)])

        x, step, worst = np.concatenate(desired(0.0)[:2]), 0.005, np.zeros(2)
        for k in range(120):
            t = step * k
            a = rates(t, x)
            b = rates(t + step / 2, x + step / 2 * a)
            c = rates(t + step / 2, x + step / 2 * b)
            x = x + step / 6 * (a + 2 * b + 2 * c + rates(t + step, x + step * c))
            worst = np.maximum(worst, np.abs(x[:2] - desired(t + step)[0]))
        assert np.all((worst > 0.0) & (worst <= bound))


def test_a_shape_that_there_is_not_is_refused(identified):
    for ask in (identified.robust_term, lambda s, width, shape: identified.tracking_bound(5.0, 5.0, width, shape)):
        with pytest.raises(bayesid.InputError, match="shape 'box': choose ellipsoid or ball"):
            ask(np.ones(len(identified.values)), 0.02, "box")


def test_shapes_that_do_not_fit_are_refused(identified):
    q = np.zeros((3, len(identified.torque_model.robot.joint_names)))
    with pytest.raises(bayesid.InputError, match="times: give 3 increasing times"):
        identified.torque(q, q, q, np.arange(2.0))
    with pytest.raises(bayesid.InputError, match="sliding has shape"):
        identified.robust_term(np.ones(len(identified.values) + 1), 0.02)
    for asked, name in (((np.ones(9), 5.0, 0.02), "gains"), ((5.0, 5.0, 0.02, "ball", np.ones(9)), "other")):
        with pytest.raises(bayesid.InputError, match=f"{name} has shape .9,.: give one number"):
            identified.tracking_bound(*asked)


def test_files_hold_what_was_found(arm, runs, tmp_path):
    result = bayesid.bounds(runs["estimate"], urdfs=2, configurations=32)
    result.write(tmp_path / "out")
    document = json.loads((tmp_path / "out" / "bounds.json").read_text(encoding="utf-8"))
    assert document["rho_V"] == result.ellipsoid and document["sampled_urdfs"] == 2
    assert len(document["joint_torques"]["parameters"]) == len(result.values)
    arrays = loadmat(tmp_path / "out" / "bounds.mat", simplify_cells=True)
    np.testing.assert_array_equal(arrays["V"], result.covariance)
    basis, factor = arrays["basis"], arrays["V_basis_factor"]
    np.testing.assert_allclose(basis @ factor @ factor.T @ basis.T, result.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(arrays["b_hat"], result.values)
    columns = Kernel.of(arm[0].robot, torque_channels(arm[0].robot)).dynamics(*np.ones((3, 1, 2)))
    np.testing.assert_allclose(
        columns[0][:, np.asarray(arrays["base_columns"]) - 1] @ arrays["b_hat"], result.torque(*np.ones((3, 1, 2))).values[0]
    )
    assert arrays["trajectories"]["torque"]["value"].shape == result.trajectories[0].torque.values.shape
    for k, drawn in enumerate((0, len(result.links) - 1)):
        robot = bayesid.load_robot(tmp_path / "out" / f"sampled-{k + 1:03d}.urdf", ["joint1", "joint2"], {"joint3": -2.48})
        np.testing.assert_allclose(robot.nominal.ravel(), result.links[drawn], atol=1e-9)
    assert "positive definite" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "alpha" in str(result) and "<table" in result._repr_html_()


def test_a_run_that_was_made_is_read_back(folder, runs):
    for run, made in runs.items():
        read = bayesid.bounds(folder / "arm", run=folder / run, configurations=16)
        direct = bayesid.bounds(made, configurations=16)
        np.testing.assert_allclose(read.values, direct.values, rtol=1e-9)
        np.testing.assert_allclose(read.known.mean, direct.known.mean, rtol=1e-9)  # the sensor's offset too, as it was fitted
        np.testing.assert_allclose(read.region.std, direct.region.std, rtol=1e-6)
        assert read.known.dispersion == pytest.approx(direct.known.dispersion) and read.known.source == run
        np.testing.assert_allclose(read.trained[0], direct.trained[0], rtol=1e-2)


def test_links_of_the_estimator_are_read_back(folder, tmp_path):
    made = bayesid.identify(folder / "arm", method="sdp", effects="sensor_offset", static="joint")
    made.write(tmp_path / "sdp")
    read = bayesid.bounds(folder / "arm", run=tmp_path / "sdp", effects="sensor_offset", static="joint", configurations=16)
    direct = bayesid.bounds(made, configurations=16)
    np.testing.assert_allclose(read.known.centre, direct.known.centre, rtol=1e-6, atol=1e-9)


def test_what_the_model_lacks_is_in_the_bands_once(arm):
    """A force on the sensor that follows the motion of joint 2, in the validation motion only."""
    setup, _ = arm
    motion = setup.motions[1]
    push = 8.0 * np.sin(3 * motion.table.positions[:, 1:])
    table = replace(motion.table, wrench=motion.table.wrench + push)
    spoiled = replace(setup, motions=(setup.motions[0], replace(motion, table=table)))
    found = bayesid.bounds(bayesid.identify(spoiled), configurations=16)
    plain = bayesid.bounds(bayesid.identify(replace(setup, motions=setup.motions[:1])), configurations=16)
    np.testing.assert_allclose(found.parameters.std, plain.parameters.std, rtol=1e-6)
    assert plain.wrench_remainder is not None and plain.wrench_remainder.complete
    left = found.wrench_remainder
    assert left is not None and left.held_out and not left.complete
    # The band holds 95 % of the force's samples, sorted by speed, and is no wider than the largest of them.
    band = found.trajectories[0].wrench
    assert band is not None and 7.0 / 1.96 < band.model_error[:, 0].max() < 9.5 / 1.96
    np.testing.assert_allclose(band.std, np.hypot(band.model_error, plain.wrench(*states_of(found)).std), rtol=1e-6)


def states_of(found):
    """States of the first trajectory."""
    problem = found.known.problem
    segment = problem.segments[found.trajectories[0].name][0]
    state = problem.row_model.state(segment, *segment.inner(problem.row_model.margin))
    return state.positions, state.velocities, state.accelerations


def test_links_that_contradict_the_data_count_for_nothing(arm):
    heavy = replace(arm[0].robot, nominal=3.0 * arm[0].robot.nominal)
    found = bayesid.bounds(bayesid.identify(replace(arm[0], robot=heavy, inertia_rel_std=0.02)), configurations=16)
    assert found.known.rel_std == WIDE
    spread = (found.links @ found.torque_model.base.matrix.T).mean(axis=0)
    assert np.all(np.abs(spread - found.values) < found.region.std)


def test_bad_input_is_one_line_and_exit_status_two(folder, runs, capsys, tmp_path):
    arm, out = str(folder / "arm"), ["--out", str(tmp_path / "out")]
    cases = {
        "no such file": ["--estimate", str(folder / "nowhere")],
        "name one run": ["--estimate", str(folder / "estimate"), "--posterior", str(folder / "posterior")],
        "leave out --method": ["--estimate", str(folder / "estimate"), "--method", "wls"],
        "has no covariance": ["--method", "ridge"],
        "a positive number": ["--prior-std", "-1"],
        "no such file;": ["--estimate", str(folder / "estimate"), "--trajectory", "nowhere.csv"],
        "not those of this experiment": ["--estimate", str(folder / "estimate"), "--effects", "base_tilt"],
        "another --channel": ["--estimate", str(folder / "estimate"), "--channel", "torque"],
        "another --motions": ["--estimate", str(folder / "estimate"), "--motions", "validation"],
        "another --filter-l": ["--posterior", str(folder / "posterior"), "--filter-l", "1"],
        "that take it; add --method sdp": ["--bounds", "bounds.toml"],
        "keeps to bounds, which wls does not; add": ["--method", "wls", "--bounds", "bounds.toml"],
        "ask for fewer": ["--estimate", str(folder / "estimate"), "--urdfs", "100000"],
    }
    for told, options in cases.items():
        assert main(["bounds", arm, *options, *out]) == 2, told
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1
        assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="was fitted already"):
        bayesid.bounds(runs["estimate"], method="wls")


def test_the_command_line_writes_all_files(folder, capsys, tmp_path):
    out = tmp_path / "out"
    options = ["--estimate", str(folder / "estimate"), "--trajectory", str(folder / "move.csv"), "--configurations", "16"]
    assert main(["bounds", str(folder / "arm"), *options, "--urdfs", "1", "--out", str(out)]) == 0
    assert {p.name for p in out.iterdir()} == {"bounds.json", "bounds.mat", "identified.urdf", "sampled-001.urdf", "report.html"}
    assert "  move, joint torques: " in capsys.readouterr().out
