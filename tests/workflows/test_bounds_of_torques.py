"""Bounds from joint torques: centre, sums that no motion takes apart, model error counted once, files for other programs."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html import unescape

import numpy as np
import pinocchio as pin
import pytest
from scipy.io import loadmat

import bayesid
from bayesid.design.bounds.knowledge import held_out_scale
from bayesid.regression.linalg import standard_deviations
from bayesid.regression.problem import prepare
from bayesid.report.bounds import bounds_report
from bayesid.robot.robot import load_robot
from bayesid.validation.noise_floor import noise_floor
from tests.robots import prismatic_arm, write
from tests.simulated import Motion, experiment, fourier, puma2, recording
from tests.studies.page import DOCS

DRIVES = ("viscous_friction", "coulomb_friction", "rotor_inertia")
ROTORS = np.array([0.6, 0.2])
VISCOUS, COULOMB = np.array([4.0, 2.0]), np.array([3.0, 1.0])


def drives(v, a):
    """Torques inside the joints (N, 2) [N m], written out here."""
    return VISCOUS * v + COULOMB * np.clip(v / 1e-3, -1, 1) + ROTORS * a


def gear(q):
    """What no effect of the model explains, at the joints' angles (N, 2) [N m]."""
    return np.array([3.0, 1.5]) * np.sin(23.0 * q)


def recorded(robot, seed, lacking=0.0, duration=20.0):
    motion = fourier(robot, seed, duration)
    table = recording(robot, None, motion, seed=seed, torque_std=0.2)
    return replace(table, torques=table.torques + drives(*motion[2:]) + lacking * gear(motion[1]))


def arm(robot, lacking, roles=("identification", "validation"), effects=DRIVES):
    motions = [Motion(f"m{k}", role, recorded(robot, k, lacking)) for k, role in enumerate(roles)]
    return experiment(robot, motions, inertia_rel_std=0.1, effects=effects)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


@pytest.fixture(scope="module")
def complete(robot):
    estimate = bayesid.identify(arm(robot, 0.0))
    return estimate, bayesid.bounds(estimate, configurations=16)


@pytest.fixture(scope="module")
def lacking(robot):
    estimate = bayesid.identify(arm(robot, 1.0))
    return estimate, bayesid.bounds(estimate, configurations=16)


def test_the_centre_is_the_estimate(robot, complete, lacking):
    for estimate, bounds in (complete, lacking):
        _, q, v, a = fourier(robot, 8, duration=2.0)
        predicted = estimate.predict(q, v, a)
        np.testing.assert_allclose(bounds.torque(q, v, a).values, predicted.values, rtol=1e-9, atol=1e-9)
        rows = predicted.to_dataframe().pivot(index="sample", columns="channel", values="high")
        np.testing.assert_array_equal(rows[list(predicted.channel_names)].to_numpy(), predicted.high)
        np.testing.assert_allclose(bounds.values, estimate.estimate.solution, rtol=1e-9, atol=1e-12)


def test_a_link_and_its_rotor_are_a_sum_that_the_bands_know(robot, complete):
    """A joint's own inertia and its rotor's act alike: neither is known, and torques are as sure as without the rotors."""
    estimate, bounds = complete
    hidden = [n for n, u in zip(bounds.names, bounds.region.undetermined, strict=True) if u]
    assert hidden[2:] == ["rotor_inertia@joint1.inertia", "rotor_inertia@joint2.inertia"] and len(hidden) == 4
    parameters = {p["name"]: p for p in bounds.to_dict()["joint_torques"]["parameters"]}
    effects = {f"{e['name']}@{e['where']}.{k}": p for e in estimate.effects() for k, p in e["parameters"].items()}
    for name in hidden:
        assert parameters[name]["std"] is None and parameters[name]["low"] is None and parameters[name]["high"] is None
        assert parameters[name]["class"] == "sum"
    assert effects["rotor_inertia@joint1.inertia"]["std"] is None
    frame = bounds.to_dataframe().set_index("name")
    assert np.isnan(frame.loc[hidden, ["std", "low", "high"]]).all(axis=None)
    shown = frame.drop(index=hidden)
    np.testing.assert_array_equal(shown["low"], bounds.low[~bounds.region.undetermined])
    assert (shown["low"] < shown["value"]).all() and (shown["value"] < shown["high"]).all() and len(shown) == 10
    same = bayesid.bounds(bayesid.identify(arm(robot, 0.0, effects=DRIVES[:2])), configurations=16)
    assert not same.region.undetermined.any()
    _, q, v, a = fourier(robot, 8, duration=2.0)
    one, other = bounds.torque(q, v, a), same.torque(q, v, a)
    np.testing.assert_allclose(one.values, other.values, atol=1e-6)
    np.testing.assert_allclose(one.std, other.std, rtol=1e-3)
    assert bounds.ellipsoid == pytest.approx(same.ellipsoid)


def test_a_sum_alone_has_bounds(tmp_path):
    """A vertical joint's torque shows its inertia and its rotor's together and nothing else: bounds are those of the sum."""
    text = (
        '<robot name="r"><link name="base"/><link name="l"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous">'
        '<parent link="base"/><child link="l"/><axis xyz="0 0 1"/><limit velocity="5" effort="50"/></joint></robot>'
    )
    (tmp_path / "r.urdf").write_text(text)
    robot = load_robot(tmp_path / "r.urdf", ["j"])
    motion = fourier(robot, 1, 10.0)
    readings = recording(robot, None, motion, seed=1, torque_std=0.02)
    readings = replace(readings, torques=readings.torques + 0.15 * motion[3])
    bounds = bayesid.bounds(
        experiment(robot, [Motion("m", "identification", readings)], effects=["rotor_inertia"]), method="wls", configurations=4
    )
    assert bounds.region.undetermined.all() and "2, only in sums, rho_V" in str(bounds)
    band = bounds.torque(*(x[::50] for x in motion[1:]))
    np.testing.assert_array_less(np.abs(0.25 * motion[3][::50] - band.values), 4.0 * band.std)  # 0.02 + 2 * 0.2^2 + 0.15
    assert 0.0 < band.std.max() < 0.01 * np.abs(band.values).max()


def test_nothing_is_added_to_the_bands_of_a_complete_model(complete):
    left = complete[1].remainder
    assert left is not None and left.held_out and left.complete
    assert "explain all that is left of m1, which was not fitted" in complete[1].headline


@pytest.mark.parametrize("held_out", [True, False])
def test_bands_hold_the_torques_of_motions_that_nobody_has_shown(robot, lacking, held_out):
    """Torques that no parameter explains, of other motions: by the held-out motion, and by the fitted one alone."""
    bounds = lacking[1]
    if not held_out:
        bounds = bayesid.bounds(bayesid.identify(arm(robot, 1.0, roles=("identification",))), configurations=16)
    assert bounds.remainder is not None and bounds.remainder.held_out == held_out and not bounds.remainder.complete
    assert ("no motion was held out" in bounds.headline) == (not held_out)
    inside, whole, share = [], [], []
    for seed in range(20, 26):
        t, q, v, a = fourier(robot, seed, duration=10.0)
        torque = recording(robot, None, (t, q, v, a)).torques + drives(v, a) + gear(q)
        band = bounds.torque(q, v, a, t)
        inside.append(np.mean((torque >= band.pointwise_low) & (torque <= band.pointwise_high)))
        whole.append(np.all((torque >= band.low) & (torque <= band.high)))
        need = np.quantile(np.abs(torque - band.values), 0.95, axis=0)
        share.append(1.96 * band.std.mean(axis=0) / need)
    assert 0.93 < np.mean(inside) < 0.985
    assert np.mean(whole) >= 5 / 6 and np.mean(share) < 1.4
    assert np.sqrt(np.mean(gear(np.linspace(-1, 1, 999)[:, None]) ** 2, axis=0)) == pytest.approx(
        np.sqrt(np.mean(band.model_error**2, axis=0)), rel=0.35
    )


def test_what_is_printed_beside_95_percent_of_the_samples_holds_95_percent(lacking):
    """The held-out motion, by what was recorded: half of each band that is printed beside the errors that it is said to hold."""
    bounds = lacking[1]
    t, q, v, a = fourier(bounds.torque_model.robot, 1)
    error = np.abs(recorded(bounds.torque_model.robot, 1, 1.0).torques - bounds.torque(q, v, a, t).values)
    text, shown = str(bounds), bounds.trajectories[0].torque.to_dict()
    head, *rows = (line for line in text.splitlines() if line.startswith(("  channel ", "  tau")))
    assert "pointwise band" in text and re.split(" {2,}", head.strip())[3:6:2] == ["pointwise ±", "simultaneous ±"]
    for j, row in enumerate(rows):
        pointwise, _, simultaneous = map(float, row.split()[-4:-1])
        assert pointwise == pytest.approx(np.quantile(error[:, j], 0.95), rel=0.4)
        assert (
            0.8 * np.quantile(error[:, j], 0.999)
            < simultaneous
            == pytest.approx(shown["mean_simultaneous_half_width"][j], rel=0.06)
        )
        assert pointwise == pytest.approx(shown["mean_pointwise_half_width"][j], rel=0.06) != simultaneous
        assert shown["largest_simultaneous_half_width"][j] >= shown["mean_simultaneous_half_width"][j]
    assert "Pointwise bands of torques hold 95 % of the samples" in bounds.headline


def test_units_are_those_of_joints_that_slide(tmp_path):
    """Slide, swing, slide, roll: kg and N of those that slide; numbers of all joints together have no unit of their own."""
    slides = load_robot(write(tmp_path, prismatic_arm()))
    motion = Motion("m", "identification", recording(slides, None, fourier(slides, 1), seed=1, torque_std=0.2))
    result = bayesid.bounds(bayesid.identify(experiment(slides, [motion])), configurations=8)
    text = str(result)
    assert re.search(r"Coriolis: error .* \[SI units\]", text) and re.search(
        r"within \S+ N, \S+ N m, \S+ N, \S+ N m$", text, re.M
    )
    for name, inertia, torque in (("rail", "kg", "N"), ("swing", "kg m²", "N m"), ("lift", "kg", "N"), ("roll", "kg m²", "N m")):
        assert re.search(rf"^  {name} .* {inertia}  +\S+ %  .* {torque}  ", text, re.M), name
    page = unescape(bounds_report(result))
    assert "rad/s²" not in page and "N m s²" not in page and "not in these bounds" in page


def test_what_is_said_to_be_missing_is_missing(robot, complete):
    """Of the drives' effects those alone that were not identified, and of recorded torques those alone that were not read."""
    assert complete[1].inside.lacking == () and "not in these bounds" not in bounds_report(complete[1])
    known = arm(robot, 0.0, effects=DRIVES[:2])
    rotors = bayesid.bounds(bayesid.identify(known), configurations=8)
    assert rotors.inside.lacking == ("rotor_inertia",) and "What is inside the joints, rotors, is not" in bounds_report(rotors)
    assert any("without these rotors" in w and "friction" not in w for w in rotors.warnings)
    second = [replace(m, table=replace(m.table, torques=m.table.torques * [np.nan, 1.0])) for m in known.motions]
    partial = bayesid.bounds(bayesid.identify(replace(known, motions=tuple(second))), configurations=8)
    assert partial.remainder is None and "torques of joint1 were not recorded" in partial.headline
    assert not any("No joint torques" in w for w in partial.warnings) and "No joint torques" not in bounds_report(partial)
    poses = [replace(m, kind="poses", table=m.table[::100]) for m in known.motions]
    still = bayesid.bounds(bayesid.identify(replace(known, motions=tuple(poses), effects=())), configurations=8)
    assert still.remainder is None and "torques were recorded of poses at rest only" in still.headline


def test_a_joint_that_mostly_rests_has_a_band_there(robot):
    """Its classes of speed are one and the same, and no class is without a bound where the held-out motion is not that fast."""
    motions, lacking = [], np.array([3.0, 1.5])
    for k, role in enumerate(("identification", "identification", "validation")):
        t, q, v, a = fourier(robot, k, 12.0)
        if k:
            q[:, 1], v[:, 1], a[:, 1] = 0.4, 0.0, 0.0
        table = recording(robot, None, (t, q, v, a), seed=k, torque_std=0.1)
        missing = lacking * np.sin(21.0 * q[:, :1])
        motions.append(Motion(f"m{k}", role, replace(table, torques=table.torques + missing)))
    bounds = bayesid.bounds(bayesid.identify(experiment(robot, motions, inertia_rel_std=0.1)), configurations=8)
    left = bounds.remainder
    assert left is not None and np.all(left.at(np.zeros((1, 2))) > 0.35 * lacking) and np.all(left.by_speed.T > 0.9 * lacking)
    assert np.all(bounds.trajectories[0].torque.std.min(axis=0) > 0.35 * lacking)


def test_noise_is_no_error_of_the_model_where_it_has_none(robot):
    """95 % of what is left is within 1.96 standard deviations, noise included: at speeds without an error it was not."""
    motions = []
    for k, role in enumerate(("identification", "validation")):
        motion = fourier(robot, k, 20.0)
        table = recording(robot, None, motion, seed=k, torque_std=0.5)
        missing = 0.5 * gear(motion[1]) * (np.abs(motion[2]) > 0.9)
        motions.append(Motion(f"m{k}", role, replace(table, torques=table.torques + drives(*motion[2:]) + missing)))
    bounds = bayesid.bounds(bayesid.identify(experiment(robot, motions, inertia_rel_std=0.1, effects=DRIVES)), configurations=8)
    assert not bounds.remainder.complete
    left = np.abs(np.concatenate([path for path, _ in bounds.remainder.paths]))
    assert np.all(np.quantile(left, 0.95, axis=0) < 2.5)


def test_more_data_do_not_make_bounds_useless(robot, lacking):
    """Half bands of a fit with a validation motion are about those of the fit without one."""
    alone = bayesid.bounds(bayesid.identify(arm(robot, 1.0, roles=("identification",))), configurations=16)
    t, q, v, a = fourier(robot, 30, duration=4.0)
    both, one = (bounds.torque(q, v, a, t).std.mean(axis=0) for bounds in (lacking[1], alone))
    np.testing.assert_allclose(both, one, rtol=0.25)


def test_the_noise_of_readings_does_not_explain_what_is_left_of_filtered_ones(robot):
    """Behind low-passes little noise is left, so that errors of a held-out motion above what parameters make of it count."""
    roles, motions = ("identification", "validation"), []
    for k, role in enumerate(roles):
        motion = fourier(robot, k)
        table = recording(robot, None, motion, seed=k, torque_std=0.5)
        lacking = 0.05 * np.array([3.0, 1.5]) * np.sin(3.0 * motion[1])
        motions.append(Motion(role, role, replace(table, torques=table.torques + drives(*motion[2:]) + lacking)))
    made = experiment(robot, motions, inertia_rel_std=0.1, effects=DRIVES[:2])
    problem = prepare(made, bayesid.FitOptions("torque", low_pass=bayesid.LowPass(1.0, 50.0)))
    estimate = bayesid.fit(problem.regression)
    dispersion, covariance = estimate.details.dispersion, estimate.full_covariance
    blocks = list(problem.rows.blocks(["validation"]))
    left = np.mean(np.concatenate([b.residual(estimate.solution) for b in blocks]) ** 2, axis=0)
    own = np.mean(np.concatenate([np.sum((b.matrix @ covariance) * b.matrix, axis=2) for b in blocks]), axis=0)
    assert dispersion > 1.3 and np.all(left > 1.5 * own)
    assert held_out_scale(problem, estimate.solution, covariance, dispersion, noise_floor(problem)) == 1.0


def test_the_same_robot_is_written_by_whichever_verb(robot, lacking, tmp_path):
    estimate, bounds = lacking
    estimate.write(tmp_path / "estimate")
    bounds.write(tmp_path / "bounds")
    text = (tmp_path / "bounds" / "identified.urdf").read_text(encoding="utf-8")
    assert text == (tmp_path / "estimate" / "identified.urdf").read_text(encoding="utf-8")
    assert "rotor_inertia@joint2.inertia" in text
    saved = json.loads((tmp_path / "bounds" / "bounds.json").read_text())["identified_urdf"]
    assert saved["dynamics"] == estimate.urdf.dynamics.friction
    # Pinocchio with the file's links and friction, and what stands beside the file, is the robot that was recorded.
    model = pin.buildModelFromUrdf(str(tmp_path / "bounds" / "identified.urdf"))
    held = [j for j in range(1, model.njoints) if model.names[j] not in ("joint1", "joint2")]
    model = pin.buildReducedModel(model, held, pin.neutral(model))  # bodies beyond are part of the second's
    rotors = [saved["not_in_urdf"][f"rotor_inertia@joint{j}.inertia"]["value"] for j in (1, 2)]
    rates = np.array([[saved["dynamics"][f"joint{j}"][k] for k in ("damping", "friction")] for j in (1, 2)]).T
    _, q, v, a = fourier(robot, 8, duration=2.0)
    data = model.createData()
    found = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    found += rotors * a + rates[0] * v + rates[1] * np.sign(v)
    expected = recording(robot, None, (np.arange(len(q)), q, v, a)).torques + drives(v, a)
    moving = (np.abs(v) > 0.05).all(axis=1)
    error = np.linalg.norm((found - expected)[moving], axis=0) / np.linalg.norm(expected[moving], axis=0)
    assert np.all(error < 0.1)


def test_friction_that_is_stated_is_in_the_robot_that_is_written(robot):
    """As that which is estimated is: without it, a simulation of the file would have none at that joint."""
    stated = {"viscous_friction@joint1": {"coefficient": 4.0, "fixed": True}}
    found = bayesid.identify(replace(arm(robot, 0.0, effects=DRIVES[:2]), effect_values=stated))
    assert "viscous_friction@joint1.coefficient" not in found.estimate.effect_names
    damping = [found.urdf.dynamics.friction[f"joint{j}"]["damping"] for j in (1, 2)]
    assert damping[0] == 4.0 and damping[1] == pytest.approx(2.0, rel=0.01)


@pytest.fixture(scope="module")
def saved(complete, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mat")
    complete[1].write(folder)
    return folder / "bounds.mat"


def test_the_ellipsoid_can_be_used_from_the_file(complete, saved):
    """The lines of docs/howto/controller.md, by scipy; V itself is singular where a sum is all that is known."""
    bounds, s = complete[1], loadmat(saved, simplify_cells=True)
    assert len(s["V_basis"]) == len(s["V"]) - 2
    factor = np.linalg.cholesky(s["V_basis"])
    np.testing.assert_allclose(factor, s["V_basis_factor"], rtol=1e-9)
    np.testing.assert_allclose(s["basis"] @ s["V_basis"] @ s["basis"].T, s["V"], rtol=1e-7, atol=1e-14)
    np.testing.assert_allclose(s["to_basis"] @ s["basis"], np.eye(len(s["V_basis"])), atol=1e-9)
    away = np.linalg.solve(factor, s["to_basis"] @ (0.3 * standard_deviations(s["V"])))
    assert np.linalg.norm(away) == pytest.approx(bounds.region.distance(s["b_hat"] + 0.3 * standard_deviations(s["V"])))
    edge = s["rho_V"] * np.random.default_rng(0).normal(size=(len(factor), 50))
    edge = s["b_hat"] + (s["basis"] @ factor @ (edge / np.linalg.norm(edge, axis=0) * s["rho_V"])).T
    np.testing.assert_allclose([bounds.region.distance(b) for b in edge], s["rho_V"], rtol=1e-6)


def test_the_lines_of_the_page_run_in_octave(saved):
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("octave is not installed")
    page = (DOCS / "howto" / "controller.md").read_text(encoding="utf-8")
    lines = page.split("```matlab\n")[1].split("```")[0]
    done = subprocess.run(
        [octave, "--quiet", "--eval", lines + "\nassert(inside); assert(norm(S.V_basis - L*L') < 1e-9)"],
        cwd=saved.parent, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
