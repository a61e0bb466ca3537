import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import bayesid
from bayesid.cli import main
from bayesid.effects import with_places
from bayesid.results.files import report_of
from bayesid.robot.robot import load_robot
from bayesid.validation.agreement import fits_alone, motions_apart
from bayesid.validation.noise_floor import noise_floor
from bayesid.validation.prediction import predict
from tests.robots import panda, puma560, scara, ur5, wrist_sensor_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

NOISE = dict(force_std=0.5, torque_std=0.1, resolution=2e-5)
OFFSET = np.array([12.0, -7.0, 30.0, 1.0, -2.0, 0.5])


def two_motions(robot, sensor, **options):
    return experiment(
        robot,
        [
            Motion("identification", "identification", recording(robot, sensor, fourier(robot, 1), seed=1, **options)),
            Motion("validation", "validation", recording(robot, sensor, fourier(robot, 2, speed=1.0), seed=2, **options)),
        ],
        sensor,
        inertia_rel_std=0.1,
        position_resolution=2e-5,
    )


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    robot = load_robot(write(tmp_path_factory.mktemp("arm"), ur5()))
    return two_motions(robot, Sensor(translation=np.array([0.0, 0.0, -0.1])), offset=OFFSET, **NOISE)


@pytest.fixture(scope="module")
def result(arm):
    return bayesid.identify(arm)


def test_truth_lies_in_the_intervals_and_the_validation_is_predicted_to_the_noise(result, arm):
    truth = result.base.matrix @ arm.robot.nominal.ravel()
    z = (result.values - truth) / result.std
    assert result.base.rank == 40 and np.abs(z).max() < 4.5 and 0.6 < np.sqrt(np.mean(z**2)) < 1.4
    prediction = result.validation[0]
    assert 0.9 < prediction.whitened_rms < 1.1 and 0.93 < prediction.coverage < 0.97
    assert prediction.repeats is None
    np.testing.assert_allclose(prediction.rmse_raw, [0.5] * 3 + [0.1] * 3, rtol=0.1)


def test_effects_that_the_readings_do_not_show_are_named(tmp_path):
    robot, sensor = puma2(tmp_path), Sensor()
    arm = two_motions(robot, sensor, **NOISE)
    fit = bayesid.FitOptions(channel="wrench", effects=["sensor_gain@fx", "viscous_friction", "coulomb_friction@joint1"])
    for found in (bayesid.identify(arm, options=fit), bayesid.compare(arm, ["ols"], options=fit)):
        said = [w for w in found.warnings if "viscous_friction" in w]
        assert len(said) == 1 and "coulomb_friction@joint1" in said[0] and "sensor_gain" not in said[0]
    stated = replace(arm, effects=("viscous_friction",))
    assert not any("viscous_friction" in w for w in bayesid.identify(stated, channel="wrench").warnings)


def test_effects_that_hide_a_parameter_together_are_named_and_no_others(tmp_path):
    """The load on a vertical slide is its drive's offset and rotor: every effect was named. Their sums are predicted."""
    robot = load_robot(write(tmp_path, scara()))
    table = recording(robot, None, fourier(robot, 1, speed=1.0), seed=1, torque_std=0.1, resolution=1e-5)
    drives = experiment(robot, [Motion("identification", "identification", table)])
    found = bayesid.identify(drives, effects=["viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia"])
    named = {spec for specs in found.not_shown.effects.values() for spec in specs}
    # What the rotor of the last joint may be is most of what its link's small inertia may be.
    assert named == {"torque_offset@joint3", "rotor_inertia@joint1", "rotor_inertia@joint3", "rotor_inertia@joint4"}
    assert np.isfinite(found.predict(*np.random.default_rng(0).normal(size=(3, 50, 4))).std).all()


@pytest.mark.parametrize("angle", ["1.5708", "1.57"])
def test_rotors_that_a_rounded_right_angle_tells_from_their_links_are_said_not_to_be(angle, tmp_path):
    """Axes tilted by the rounding show the two apart in principle: as hundreds of kg m^2, in a table without a word."""
    robot = load_robot(write(tmp_path, panda().replace(str(np.pi / 2), angle)))
    table = recording(robot, None, fourier(robot, 1, speed=1.0), seed=1, torque_std=0.1, resolution=1e-5)
    found = bayesid.identify(experiment(robot, [Motion("identification", "identification", table)]), effects=["rotor_inertia"])
    std = found.estimate.full_std[found.base.rank :]
    assert not (std[:2] < 10.0).any() and (std[2:] < 0.01).all()
    assert {spec for specs in found.not_shown.effects.values() for spec in specs} == {f"rotor_inertia@joint{k}" for k in (1, 2)}
    assert not {*found.not_shown.effects} & {*found.unexcited}
    assert report_of(found).count("not told from links") == 2


def test_what_no_motion_shows_is_not_called_unexcited(tmp_path):
    """An effect in the model and a subtracted static run hide parameters for reasons of their own."""
    robot = puma2(tmp_path)
    motion = fourier(robot, 1)
    moving = recording(robot, None, motion, seed=1, torque_std=0.1, resolution=1e-5)
    drives = experiment(
        robot, [Motion("identification", "identification", moving)], None, gear_ratio={"joint1": 50.0, "joint2": 50.0}
    )
    found = bayesid.identify(drives, effects=["rotor_inertia"])
    lost = found.not_shown.effects
    assert {spec for specs in lost.values() for spec in specs} == {"rotor_inertia@joint1", "rotor_inertia@joint2"}
    assert not {*lost} & {*found.unexcited} and found.to_dict()["lost_to_effects"].keys() == lost.keys()
    assert sum("Not told from an effect in the model" in w for w in found.warnings) == 1
    assert not bayesid.identify(drives, effects=[]).not_shown.effects
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    table, rest = (recording(robot, sensor, motion, seed=2, static=static, **NOISE) for static in (False, True))
    still = bayesid.identify(experiment(robot, [Motion("identification", "identification", table, static=rest)], sensor))
    assert "m1 + m2" in still.not_shown.static_run and "m1 + m2" not in still.unexcited
    assert not any("add motions" in w and "m1 + m2" in w for w in still.warnings)
    # Nothing is held out: that is told once.
    assert sum("validation" in w for w in found.warnings) == 1


def test_offset_is_told_from_the_weight_by_the_nominal_mass(result):
    value, std = result.offset
    assert (np.abs(value - OFFSET)[[0, 1, 3, 4, 5]] < 4 * std[[0, 1, 3, 4, 5]]).all()
    # The total mass cannot be seen beside an offset: its uncertainty is that of the nominal masses.
    assert abs(value[2] - OFFSET[2]) < 2 * std[2] and std[2] > 2.0


def test_what_is_written_beside_the_links_holds_none_of_their_weight(result, arm, tmp_path):
    """What is fitted as the offset of a sensor that stays upright is offset and weight."""
    standing = 9.81 * arm.robot.nominal[:, 0].sum() + OFFSET[2]
    two = two_motions(puma2(tmp_path), Sensor(), offset=OFFSET, **NOISE)
    prior, flat = (bayesid.sample(two, draws=400, seed=0, keep_going=True, prior=prior) for prior in ("nominal", "flat"))
    written = [(result, standing), (prior, 9.81 * two.robot.nominal[:, 0].sum() + OFFSET[2])]
    for k, (found, weighs) in enumerate(written):
        found.write(tmp_path / str(k))
        text = (tmp_path / str(k) / "identified.urdf").read_text()
        mass = load_robot(tmp_path / str(k) / "identified.urdf", found.problem.experiment.robot.joint_names).nominal[:, 0].sum()
        beside = float(re.search(r"sensor_offset@sensor.fz = (\S+) N", text)[1])
        assert 9.81 * mass + beside == pytest.approx(weighs, abs=0.05)
    for found in (result, prior, flat):
        fz = found.effects()[0]["parameters"]["fz"]
        assert abs(fz["value"] - OFFSET[2]) < 3 * fz["std"]
        assert found.parameters()["sensor_offset@sensor.fz"].std == pytest.approx(fz["std"])
        out = tmp_path / ("again" if found is result else "drawn")
        found.write(out)
        back = bayesid.load(out)
        for level in (0.5, 0.95):
            here, there = (r.parameters(level)["sensor_offset@sensor.fz"] for r in (found, back))
            assert (here.low, here.value, here.high) == pytest.approx((there.low, there.value, there.high))


def test_an_offset_that_is_known_leaves_the_weight_to_the_links(tmp_path):
    """It was held at what is stated and the nominal links' weight, whatever the links weigh, and was written as that."""
    robot, sensor = puma2(tmp_path), Sensor()
    stated = dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), OFFSET.tolist(), strict=True))
    held = {"sensor_offset": {**stated, "fixed": True}}
    heavier = dict(phi=1.1 * robot.nominal.ravel(), offset=OFFSET, **NOISE)
    arm = replace(two_motions(robot, sensor, **heavier), effects=("sensor_offset",), effect_values=held)
    found = bayesid.identify(arm)
    truth = found.base.matrix @ (1.1 * robot.nominal.ravel())
    assert "m1 + m2" in found.base.labels and np.abs((found.values - truth) / found.std).max() < 4
    assert not found.base.weight_in_offset and found.offset is None
    assert {k: v["value"] for k, v in found.effects()[0]["parameters"].items()} == pytest.approx(stated)
    found.write(tmp_path / "out")
    again = bayesid.identify(arm.with_model(tmp_path / "out" / "model.toml"))
    np.testing.assert_allclose(again.values, found.values, rtol=1e-9)


def test_links_are_as_near_to_the_estimate_as_stated_and_the_urdf_loads_back(result, arm, tmp_path):
    np.testing.assert_allclose(result.base.matrix @ result.urdf.unconstrained, result.values, rtol=1e-8, atol=1e-10)
    away, moved = result.base.matrix @ result.link_parameters - result.values, result.urdf.moved
    assert moved.distance == pytest.approx(np.sqrt(away @ np.linalg.solve(result.covariance, away)), rel=1e-6)
    assert moved.inside and moved.distance < moved.allowed == pytest.approx(np.sqrt(chi2.ppf(0.95, 40)))
    result.write(tmp_path / "out")
    again = load_robot(tmp_path / "out" / "identified.urdf", arm.robot.joint_names)
    np.testing.assert_allclose(again.nominal.ravel(), result.link_parameters, rtol=1e-9, atol=1e-12)


def test_motions_fitted_beside_the_estimate_are_compared_as_if_fitted_after_it(result):
    (found,), (expected,) = result.agreements, motions_apart(result.problem, result.estimate, "wls")
    assert "validation" in found.first and not found.contradiction
    assert found.to_dict() == expected.to_dict()


def test_a_motion_that_cannot_be_fitted_alone_is_compared_with_nothing(result):
    """Whatever the estimator says of it: the estimate from all motions stands."""

    class Picky:
        name = "picky"

        def fit(self, regression):
            raise bayesid.EstimationError("the conic solver found no physical solution")

    assert fits_alone(result.problem, Picky(), ["validation"]) == {"validation": None}
    assert motions_apart(result.problem, result.estimate, Picky()) == []


def test_json_holds_what_is_promised(result, tmp_path):
    report = result.write(tmp_path / "out")
    assert report.name == "report.html" and "http" not in report.read_text().replace("http://www.w3.org", "")
    document = json.loads((tmp_path / "out" / "estimate.json").read_text())
    promised = {
        "schema", "experiment", "channel", "method", "filter", "base_parameters", "covariance", "base_map",
        "link_parameter_names", "link_parameters", "effects", "rank", "condition_number", "physically_consistent", "validation",
        "runtime_s", "interval",
    }  # fmt: skip
    assert promised <= set(document)
    first = document["base_parameters"][0]
    assert set(first) == {"name", "unit", "value", "std", "low", "high", "class", "label"}
    assert first["low"] < first["value"] < first["high"]
    assert np.shape(document["base_map"]) == (document["rank"], len(document["link_parameter_names"]))
    assert document["effects"][0]["name"] == "sensor_offset"
    assert set(document["effects"][0]["parameters"]) == {"fx", "fy", "fz", "mx", "my", "mz"}
    assert {"motion", "rmse", "nrmse", "whitened_rms"} <= set(document["validation"][0])


def test_weight_in_the_offset_of_a_base_sensor_is_told(result):
    assert result.base.weight_in_offset and any("above all the total mass, cannot be identified" in w for w in result.warnings)


def test_results_print(result):
    assert "40 base parameters" in str(result) and "<table>" in result._repr_html_()


def test_wrist_sensor_splits_the_link_and_is_identified(tmp_path):
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    sensor = Sensor(joint="wrist_ft", translation=np.array([0.01, 0.02, 0.03]), rpy=np.array([0.3, 0.2, 0.1]))
    found = bayesid.identify(two_motions(robot, sensor, offset=OFFSET, **NOISE))
    # It turns under the tool: no weight looks like its offset, so nothing is said of a total mass that cannot be known.
    assert not found.base.weight_in_offset and not any("total mass" in w for w in found.warnings)
    assert set(found.names) == {f"wrist_ft.{p}" for p in ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")}
    truth = found.base.matrix @ robot.nominal.ravel()
    assert np.abs((found.values - truth) / found.std).max() < 4
    value, std = found.offset
    assert (np.abs(value - OFFSET) < 4 * std).all()
    found.write(tmp_path / "out")
    again = load_robot(tmp_path / "out" / "identified.urdf", sensor_joint="wrist_ft")
    np.testing.assert_allclose(again.nominal.ravel(), found.link_parameters, rtol=1e-8, atol=1e-12)


def test_both_channels_together_agree_unless_one_is_wrong(tmp_path):
    robot = load_robot(write(tmp_path, ur5()))
    clean = two_motions(robot, Sensor(), offset=OFFSET, **NOISE)
    found = bayesid.identify(clean, "both")
    assert found.base.rank == 40 and not found.agreements[-1].contradiction and found.agreements[-1].first == "wrench"
    truth = found.base.matrix @ robot.nominal.ravel()
    assert np.abs((found.values - truth) / found.std).max() < 4.5

    from dataclasses import replace

    def too_large(motion):
        return replace(motion, table=replace(motion.table, torques=1.05 * motion.table.torques))

    spoiled = replace(clean, motions=tuple(too_large(m) for m in clean.motions))
    last = bayesid.identify(spoiled, "both")
    assert last.agreements[-1].contradiction and any("Wrench and torque contradict" in w for w in last.warnings)


def test_a_joint_that_never_moves_stays_nominal_and_contradicts_nothing(tmp_path):
    """Its encoder reads one number, whose spline is no motion; what nothing shows is not compared."""
    robot, motions = puma2(tmp_path), []
    links = 1.3 * robot.nominal.ravel()
    for k in range(2):
        t, q, v, a = fourier(robot, k)
        for rows, still in ((q, 0.4), (v, 0.0), (a, 0.0)):
            rows[:, 1] = still
        table = recording(robot, Sensor(), (t, q, v, a), phi=links, seed=k, **NOISE)
        motions.append(Motion(f"m{k}", "validation" if k else "identification", table))
    arm = experiment(robot, motions, Sensor())
    found = bayesid.identify(arm, "both")
    nominal = found.base.matrix @ robot.nominal.ravel()
    assert found.estimate.undetermined[found.base.rank - 1] and found.values[-1] == pytest.approx(nominal[-1])
    assert np.abs(found.values - nominal).max() < np.abs(nominal).max()
    assert not any(a.contradiction for a in found.agreements)
    moved = found.predict(*np.random.default_rng(3).normal(size=(3, 5, 2)))
    assert np.abs(moved.values).max() < 1e4 and np.isnan(moved.std).any()
    for method in ("iv", "sdp"):
        assert np.abs(bayesid.identify(arm, "torque", method).values).max() < 2.0 * np.abs(nominal).max()


def test_a_joint_that_trembles_by_next_to_nothing_leaves_values_nominal(tmp_path):
    """As one does that a simulator holds: directions that rounding hides stay where the fit began, and none breaks it."""
    robot, motions = puma2(tmp_path), []
    rate, small = 8.0, 1e-10
    for k in range(2):
        t, q, v, a = fourier(robot, k)
        q[:, 1], v[:, 1] = 0.4 + small * np.sin(rate * t + k), small * rate * np.cos(rate * t + k)
        a[:, 1] = -small * rate**2 * np.sin(rate * t + k)
        table = recording(robot, Sensor(), (t, q, v, a), phi=1.3 * robot.nominal.ravel(), seed=k, force_std=0.5, torque_std=0.05)
        motions.append(Motion(f"m{k}", "validation" if k else "identification", table))
    arm = experiment(robot, motions, Sensor())
    for method in ("wls", "huber", "sdp"):
        found = bayesid.identify(arm, "wrench", method)
        unsure = found.estimate.undetermined[: found.base.rank]
        assert unsure.sum() > 5 and np.abs(found.values[unsure]).max() < 10.0


def test_static_run_is_reported_both_ways(tmp_path):
    robot = puma2(tmp_path)
    sensor, motion = Sensor(), fourier(robot, 1)
    moving = recording(robot, sensor, motion, seed=1, offset=OFFSET, **NOISE)
    still = recording(robot, sensor, motion, seed=2, offset=OFFSET, static=True, **NOISE)
    found = bayesid.identify(experiment(robot, [Motion("a", "identification", moving, static=still)], sensor))
    assert found.base.rank == 12 and found.static_alternative is not None
    truth = found.base.matrix @ robot.nominal.ravel()
    assert np.abs((found.values - truth) / found.std).max() < 4
    # Gravity, which the subtraction throws away, makes the other way at least as sure.
    assert np.mean(found.static_alternative.std[:12]) < np.mean(found.std)


def test_command_line_writes_all_or_nothing(arm, tmp_path, capsys):
    folder = tmp_path / "arm"
    bayesid.write_experiment(arm, folder)
    out = tmp_path / "out"
    assert main(["identify", str(folder), "--out", str(out), "--method", "gls", "--filter-l", "1", "--filter-d", "50"]) == 0
    assert {p.name for p in out.iterdir()} == {"estimate.json", "identified.urdf", "model.toml", "report.html"}
    document = json.loads((out / "estimate.json").read_text())
    assert document["method"] == "gls" and document["filter"]["l"] == 1.0
    assert "report.html" in capsys.readouterr().out
    assert main(["identify", str(folder), "--out", str(tmp_path / "no"), "--filter-d", "50"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "--filter-l" in error and not (tmp_path / "no").exists()


def test_an_effect_that_ran_away_is_told(arm):
    """There is no tether: stiffness and length of one run off together, and base parameters with them."""
    found = bayesid.identify(arm, channel="torque", effects=["tether@joint2"])
    told = [w for w in found.warnings if "tether@joint2 did not settle" in w]
    assert len(told) == 1 and "[model.values]" in told[0]
    plain = bayesid.identify(arm, channel="torque", effects=["spring@joint2"])
    assert not [w for w in plain.warnings if "settle" in w]


@pytest.mark.parametrize("effects", [["tether@joint2"], ["tether@joint4", "stribeck_friction@joint2"], ["torque_ripple@joint2"]])
def test_what_is_not_there_has_no_size_and_runs_away_nowhere(arm, effects):
    """An estimate along a linearisation that says nothing there has a stiffness of -1e8 N/m, and lengths of as many metres."""
    found = bayesid.identify(arm, channel="torque", effects=effects)
    held = found.problem.row_model.point.unsettled
    for (effect, own), told in zip(with_places(found.problem.row_model.effects), found.effects(), strict=True):
        assert told["parameters"][effect.parameters[0]]["low"] < 0.0 < told["parameters"][effect.parameters[0]]["high"]
        for k, (key, low, high) in enumerate(zip(effect.parameters, effect.lower, effect.upper, strict=True)):
            entry = told["parameters"][key]
            std = entry["std"]
            assert low - 4 * (std or 0.0) <= entry["value"] <= high + 4 * (std or 0.0)
            assert (std is None) == (held is not None and held[own][k])
    assert found.validation[0].whitened_rms < 1.1


def test_a_bristle_that_is_coulomb_friction_is_told_to_be_like_it(tmp_path):
    """It was said that the motions do not tell its distance, where they tell that it is next to none."""
    robot, motion = puma2(tmp_path), fourier(puma2(tmp_path), 1)
    table = recording(robot, None, motion, seed=1, torque_std=0.3)
    table = replace(table, torques=table.torques + 8.0 * np.sign(motion[2]))
    found = bayesid.identify(
        experiment(robot, [Motion("a", "identification", table)]), "torque", effects=["dahl_friction@joint2"]
    )
    (told,) = [w for w in found.warnings if "did not settle" in w]
    assert "distance kept at the end of what is plausible" in told and "try coulomb_friction in its place" in told


def test_a_level_that_starts_out_of_what_is_plausible_may_stay_there(tmp_path):
    """Friction that rises with speed, as a diagnosis states it: no step led to a positive level, so that nothing moved."""
    robot, motions = puma2(tmp_path), []
    for seed, role in ((1, "identification"), (2, "validation")):
        moved = fourier(robot, seed)
        table = recording(robot, None, moved, seed=seed, torque_std=0.1)
        friction = (8.0 - 6.0 * np.exp(-((moved[2] / 0.4) ** 2))) * np.sign(moved[2])
        motions.append(Motion(role, role, replace(table, torques=table.torques + friction)))
    stated = {f"stribeck_friction@joint{k}": {"level": -5.0, "velocity": 0.6} for k in (1, 2)}
    rising = replace(experiment(robot, motions), effects=("coulomb_friction", "stribeck_friction"), effect_values=stated)
    found = bayesid.identify(rising, "torque")
    assert not [w for w in found.warnings if "did not settle" in w] and found.validation[0].relative_error < 0.01
    for told in found.effects()[2:]:
        for key, truth in (("level", -6.0), ("velocity", 0.4)):
            assert told["parameters"][key]["value"] == pytest.approx(truth, rel=0.01)


@pytest.mark.parametrize("robot", [puma560, panda])
def test_right_angles_that_a_urdf_rounds_tell_no_link_from_its_rotor(robot, tmp_path):
    """By the 4e-6 between 1.5708 and a right angle a fit took 48 000 and 133 000 kg m^2 for friction that its model lacked."""
    found = []
    for text in (robot(), re.sub(r"1\.57079\d+", "1.5708", robot())):
        arm = load_robot(write(tmp_path, text))
        moved = fourier(arm, 1)
        table = recording(arm, None, moved, seed=1, torque_std=0.1)
        table = replace(table, torques=table.torques + 0.1 * np.sign(moved[2]) * np.abs(table.torques))
        made = experiment(arm, [Motion("a", "identification", table)])
        found.append(bayesid.identify(made, "torque", effects=["torque_offset", "rotor_inertia"]).estimate)
    exact, rounded = found
    assert exact.undetermined.sum() == 4 and np.array_equal(exact.undetermined, rounded.undetermined)
    told = ~exact.undetermined
    assert np.abs((rounded.solution - exact.solution)[told] / exact.full_std[told]).max() < 0.1
    np.testing.assert_allclose(rounded.solution[~told], exact.solution[~told], atol=0.1)


def test_an_effect_of_which_the_motions_say_nothing_is_told(shared):
    """With the nominal links of its light wrist, which `sdp` stays near, nothing shows a TX40's coupling."""
    experiment = bayesid.load_experiment(shared("data/tx40"))
    effect = "coupled_transmission@joint5->joint6"
    found = bayesid.identify(experiment, method="sdp", effects=[*experiment.effects, effect])
    std = found.estimate.full_std[list(found.estimate.effect_names).index(f"{effect}.coupling") + found.base.rank]
    told = [w for w in found.warnings if f"{effect} did not settle" in w]
    assert len(told) == (std > 10.0) == 1


def test_fitted_motions_are_predicted_when_asked_for_as_the_others_are(arm):
    found = bayesid.identify(arm)
    assert "fitted" not in vars(found)
    assert found.plot_predictions() is not None and "fitted" not in vars(found)
    (fitted,) = found.fitted
    assert found.fitted[0] is fitted
    expected = predict(found.problem, found.estimate, arm.identification[0], noise_floor(found.problem))
    assert fitted.to_dict() == expected.to_dict()


def test_another_bandwidth_is_advised_than_the_one_that_was_taken(tmp_path):
    """A motion that is as fast as the search for its bandwidth goes."""
    robot = puma2(tmp_path)
    times, w = np.arange(0.0, 20.0, 0.02), 2 * np.pi * 0.8 * np.arange(1, 15)
    a = np.random.default_rng(1).normal(size=(14, 2)) / (1.0 + np.arange(14))[:, None]
    s, c = np.sin(np.outer(times, w)), np.cos(np.outer(times, w))
    motion = (times, 0.1 * s @ a, 0.1 * (c * w) @ a, -0.1 * (s * w**2) @ a)
    made = experiment(robot, [Motion("quick", "identification", recording(robot, None, motion, seed=1, torque_std=0.2))])
    result = bayesid.identify(made, "torque")
    (said,) = [w for w in result.warnings if "the end of the range searched" in w]
    advised = float(re.search(r"Compare with bandwidth=([\d.]+);", said)[1])
    assert advised == pytest.approx(0.5 * result.problem.smoother.bandwidth, rel=0.05)
    other = bayesid.identify(made, "torque", bandwidth=advised)
    assert np.abs(other.estimate.solution - result.estimate.solution).max() > 0.0


def _with_friction(robot, viscous, noise=1.0):
    motions = []
    for seed, role in ((1, "identification"), (2, "validation")):
        motion = fourier(robot, seed)
        exact = recording(robot, None, motion).torques
        read = exact + noise * (recording(robot, None, motion, seed=seed, torque_std=0.3).torques - exact)
        read = read + 3.0 * np.sign(motion[2]) + viscous * motion[2]
        motions.append(Motion(role, role, replace(recording(robot, None, motion), torques=read)))
    return bayesid.identify(experiment(robot, motions), "torque", effects=["viscous_friction", "coulomb_friction"])


def test_the_sign_is_blamed_for_negative_friction_where_all_of_the_joint_is_negative(tmp_path):
    """Friction that falls with speed has a negative viscous part beside a positive dry one: the sign is right."""
    robot = puma2(tmp_path)
    falls = _with_friction(robot, -0.5)
    said = [w for w in falls.warnings if "cannot be negative" in w]
    assert len(said) == 1 and "viscous_friction@joint1.coefficient = -0." in said[0] and "falls with speed" not in said[0]
    assert "sign is not to blame" in said[0] and "Stribeck" in said[0] and "Check signs" not in str(falls)
    assert "own friction compensation" in said[0]
    # Next to no viscous friction comes out of either sign by noise, which is no fault.
    either = [_with_friction(robot, 0.0, noise=sign) for sign in (1.0, -1.0)]
    viscous = [r.effects()[0]["parameters"]["coefficient"]["value"] for r in either]
    assert min(viscous) < 0.0 < max(viscous) and not any("egative" in w for r in either for w in r.warnings)


def test_a_reversed_wrench_is_named_though_validation_predicts_it(arm):
    """Bodies that cannot exist predict it as well as those of the robot do of what it reads."""
    motions = tuple(replace(m, table=replace(m.table, wrench=-m.table.wrench)) for m in arm.motions)
    found = bayesid.identify(replace(arm, inertia_rel_std=None, motions=motions))
    assert found.validation[0].relative_error < 0.05
    assert found.warnings[0].startswith("The wrench seems to be that of the robot on the sensor")
