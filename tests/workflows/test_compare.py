import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest

import bayesid
from bayesid.cli import main
from bayesid.estimators import weights
from bayesid.regression.problem import prepare
from bayesid.report.comparison import comparison_report, errors_figure
from bayesid.robot.robot import load_robot
from bayesid.validation.agreement import gaps, hausman, nominal_estimates
from bayesid.workflows import compare as module
from bayesid.workflows.compare import DEFAULT_SET
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests.report_pages import read
from tests.robots import write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

NOISE = dict(force_std=0.5, torque_std=0.1, resolution=2e-5)
SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))


def made(robot, offset=3.0, scale=1.0, names=("identification", "validation")):
    phi = scale * robot.nominal.ravel()
    return experiment(
        robot,
        [Motion(n, n, recording(robot, SENSOR, fourier(robot, k + 1), seed=k + 1, offset=np.full(6, offset), phi=phi, **NOISE))
         for k, n in enumerate(names)],
        SENSOR, inertia_rel_std=0.1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


@pytest.fixture(scope="module")
def heavier(robot):
    """Links 20 % heavier than the nominal ones."""
    return made(robot, scale=1.2)


class Halved:
    """Half of ordinary least squares, which is nobody's estimator but the test's."""

    name = "halved"

    def fit(self, regression):
        plain = bayesid.fit(regression, "ols")
        links = -np.abs(regression.knowledge.nominal_links)
        details = bayesid.CustomDetails(entries={"share": np.float64(0.5), "lost": np.nan, "at": np.arange(2)})
        return replace(plain, method=self.name, solution=plain.solution / 2, links=links, full_covariance=None, interval="none",
                       interval_reason="it is wrong", details=details)  # fmt: skip


class Refuses:
    name = "refuses"

    def fit(self, regression):
        raise bayesid.EstimationError("it never works;\n try another")


class Broken:
    name = "broken"

    def fit(self, regression):
        return replace(bayesid.fit(regression, "ols"), solution=np.full(len(regression.column_names), np.nan))


@pytest.fixture(scope="module")
def compared(heavier):
    return bayesid.compare(heavier, ["ols", "wls", Refuses(), "gls", Halved(), bayesid.Ridge(), bayesid.Ridge(strength=1e-6)])


def strictly(path):
    def refuse(constant):
        raise AssertionError(constant)

    return json.loads(path.read_text(), parse_constant=refuse)


def test_each_is_what_it_would_be_alone(compared, heavier):
    alone = bayesid.identify(heavier, method="gls")
    assert (compared["gls"].values == alone.values).all() and (compared["gls"].std == alone.std).all()
    entry = next(e for e in compared.entries if e.name == "gls")
    assert entry.validation[0].whitened_rms == alone.validation[0].whitened_rms
    np.testing.assert_array_equal(entry.links, alone.urdf.links)
    assert entry.physically_consistent == alone.physically_consistent
    assert list(compared.estimates) == ["ols", "wls", "gls", "halved", "ridge", "ridge 2"]
    assert compared.names == alone.names


def test_rows_and_noise_are_made_once(heavier, monkeypatch):
    calls = {"prepare": 0, "noise": 0}
    prepare, learned = module.prepare, weights._learned

    def counted(*args, **options):
        calls["prepare"] += 1
        return prepare(*args, **options)

    def counted_noise(regression):
        calls["noise"] += 1
        return learned(regression)

    monkeypatch.setattr(module, "prepare", counted)
    monkeypatch.setattr(weights, "_learned", counted_noise)
    stages = []
    bayesid.compare(heavier, ["ols", "wls", "gls", "ridge"], progress=stages.append)
    assert calls == {"prepare": 1, "noise": 1}
    assert [s for s in stages if s.startswith("estimate")][1] == "estimate: wls (2 of 4)"


def test_own_estimators_and_refusals_stand_beside_the_others(compared):
    refused, halved = compared.entries[2], compared.entries[4]
    assert refused.estimate is None and refused.refusal == "it never works; try another"
    np.testing.assert_array_equal(compared["halved"].solution, compared["ols"].solution / 2)
    assert "nobody's estimator" in halved.description
    # It came with links of its own, of negative mass.
    assert halved.impossible == compared.problem.experiment.robot.body_names
    with pytest.raises(KeyError, match="it never works"):
        compared["refuses"]
    with pytest.raises(KeyError, match="there are ols, wls"):
        compared["tasty"]


def test_an_estimate_that_is_not_finite_counts_as_a_refusal(heavier):
    found = bayesid.compare(heavier, ["ols", Broken()])
    assert "finite" in found.entries[1].refusal
    with pytest.raises(bayesid.EstimationError, match="broken: .* gave a solution that is not finite.* refuses: it never works"):
        bayesid.compare(heavier, [Broken(), Refuses()])


def test_nominal_model_is_the_yardstick(robot, compared):
    # Links as nominal: only the offset keeps the nominal model from being perfect, and it is perfect once that is fitted.
    offset, none = (bayesid.compare(made(robot, offset=o), ["wls"]).baselines for o in (3.0, 0.0))
    assert [b.name for b in offset] == ["nominal", "nominal + effects"]
    assert offset[0].validation[0].whitened_rms > 3.0
    assert offset[1].validation[0].whitened_rms == pytest.approx(1.0, abs=0.03)
    # Without an offset the nominal weight explains the constant readings, though base parameters cannot hold it.
    assert none[0].validation[0].whitened_rms == pytest.approx(1.0, abs=0.03)
    # Links off by a fifth: worse than what is fitted.
    errors = [e.validation[0].whitened_rms for e in (*compared.baselines, compared.entries[1])]
    assert errors[0] > errors[1] > 2.0 and errors[2] == pytest.approx(1.0, abs=0.05)
    assert any("as well as or better than halved in" in w and "effects fitted" in w for w in compared.warnings)


def test_where_the_noise_is_not_known_the_error_alone_judges(compared):
    nominal, best = compared.baselines[-1], next(e for e in compared.entries if e.name == "wls")

    def with_noise(entry, source, white):
        return replace(entry, validation=tuple(replace(p, noise_source=source, whitened_rms=white) for p in entry.validation))

    known, unknown = (
        module._beaten([with_noise(best, source, 2.0)], with_noise(nominal, source, 1.0), "nominal model")
        for source in ("readings", "residuals")
    )
    assert len(known) == 1 and "wls in units of the noise" in known[0] and unknown == []
    silent = replace(compared, entries=(with_noise(best, "residuals", 2.0),), baselines=(with_noise(nominal, "residuals", 1.0),))
    text = read(comparison_report(silent)).text
    assert "wls leaves least" in text and "times the noise" not in text and "in units of the noise, where" not in text
    assert len(errors_figure(silent).axes) == len(best.validation) and len(errors_figure(compared).axes) == 2 * len(
        best.validation
    )


def test_weight_that_looks_like_an_offset_is_told_from_it(compared, heavier, tmp_path):
    """An upright sensor's fz is fitted with the links' weight in it, and was called its offset."""
    compared.write(tmp_path / "out")
    back = bayesid.load(tmp_path / "out")
    for found in (compared, back):
        labels = found["wls"].parameters().labels[-6:]
        assert labels == [f"sensor_offset@sensor.{a}{' + weight' * (a == 'fz')}" for a in ("fx", "fy", "fz", "mx", "my", "mz")]
        links = 1.2 * heavier.robot.nominal.ravel()
        table = found.to_dataframe()
        assert table[table["method"] == "wls"]["name"].tolist()[-6:] == labels  # `identify` has the offset alone by that name
        np.testing.assert_allclose(found["wls"].solution[-6:], 3.0 + found["wls"].base.absorbed @ links, atol=0.1)


def test_nothing_is_said_of_a_nominal_model_that_there_is_not(compared):
    text = read(comparison_report(replace(compared, warnings=()))).text
    assert "every estimator predicts better than the nominal model" in text
    without = read(comparison_report(replace(compared, warnings=(), baselines=()))).text
    assert "No warnings: no test finds" in without


def test_stated_values_of_effects_are_part_of_the_nominal_model(robot):
    stated = replace(made(robot, names=("identification",)), effects=("sensor_offset",),
                     effect_values={"sensor_offset": dict.fromkeys(("fx", "fy", "fz", "mx", "my", "mz"), 3.0)})  # fmt: skip
    found = bayesid.compare(stated, ["wls"])
    assert found.baselines[0].fitted[0].whitened_rms == pytest.approx(1.0, abs=0.03)
    assert not found.baselines[0].validation and found.entries[0].predictions == found.entries[0].fitted
    assert any("No validation motion" in w for w in found.warnings)
    text = " ".join(read(comparison_report(found)).text.split())
    assert "There is no validation motion" in text and "fitted: no validation motion" in str(found)


def test_stated_values_by_names_of_joints_are_part_of_the_nominal_model(tmp_path):
    text = puma_two_joint_urdf().replace('"joint1"', '"shoulder"').replace('"joint2"', '"elbow"')
    arm = load_robot(write(tmp_path, text), ["shoulder", "elbow"], PAPER_LOCKED)
    stated = {"viscous_friction@shoulder": {"coefficient": 4.0}, "viscous_friction": {"coefficient": 2.0}}
    table = recording(arm, None, fourier(arm, 0, 10.0), torque_std=0.1)
    motions = [Motion("only", "identification", table)]
    problem = prepare(experiment(arm, motions, effects=("viscous_friction",), effect_values=stated))
    (_, _, nominal), _ = nominal_estimates(problem, weights.learn_weights(problem.regression))
    np.testing.assert_array_equal(nominal.solution[problem.row_model.base.rank :], [4.0, 2.0])


def test_the_nominal_model_has_what_is_stated_of_effects_that_readings_are_not_linear_in(robot):
    """Without values there is no such friction in it, with the true ones it is perfect."""
    path = [bayesid.fourier_trajectory(robot, duration=8.0, seed=1)]
    true = {f"stribeck_friction@joint{k}": {"level": 5.0, "velocity": 0.3} for k in (1, 2)}
    made = replace(bayesid.simulate(experiment(robot, []), path, effects=true, seed=1), effects=("stribeck_friction",))
    bare = replace(made, effects=())
    without, absent, half, stated = (
        bayesid.compare(e, ["wls"], channel="torque").baselines[0].fitted[0]
        for e in (bare, made, *(replace(made, effect_values=v) for v in ({"stribeck_friction": {"velocity": 0.1}}, true)))
    )
    assert absent.relative_error == pytest.approx(without.relative_error, rel=0.01) and without.relative_error > 0.1
    assert half.relative_error == pytest.approx(without.relative_error, rel=0.01)
    assert stated.relative_error < 0.1 * without.relative_error


def test_motions_without_the_run_that_is_subtracted_are_not_predicted(robot):
    """Gravity and the sensor's offset are in their readings, and not in an estimate from which a run took them."""
    motions = []
    for k, name in enumerate(("identification", "plain", "validation"), 1):
        moving, rest = (
            recording(robot, SENSOR, fourier(robot, k), seed=seed, offset=np.full(6, 3.0), static=still, **NOISE)
            for seed, still in ((k, False), (k + 9, True))
        )
        motions.append(Motion(name, "identification" if k == 1 else "validation", moving, static=None if k == 2 else rest))
    runs = experiment(robot, motions, SENSOR)
    found = bayesid.identify(runs)
    assert found.problem.static == "motion" and [p.motion for p in found.validation] == ["validation"]
    assert found.validation[0].whitened_rms == pytest.approx(1.0, abs=0.05)
    assert any("'plain' has no static run" in w for w in found.warnings)
    assert any("'plain' has no static run" in w for w in bayesid.compare(runs, ["wls"]).warnings)
    with pytest.raises(bayesid.InputError, match="'plain' has no static run"):
        found.validate(motions[1])
    along = bayesid.identify(runs, static="joint")
    assert all(p.whitened_rms == pytest.approx(1.0, abs=0.05) for p in along.validation) and len(along.validation) == 2


def test_what_identify_warns_of_in_the_model_is_warned_of_here(robot):
    late = made(robot, names=("identification",))
    motion = late.motions[0]
    table = replace(motion.table, times=motion.table.times + 1.7e9)
    late = replace(late, motions=(replace(motion, table=table),), effects=("sensor_drift",))
    assert [w for w in bayesid.compare(late, ["wls"]).warnings if "subtract the start" in w]


def test_what_every_estimator_leaves_is_told(robot):
    """Where `identify` said that something is missing, a comparison of the same fits said nothing."""
    lacking, complete = made(robot), made(robot)
    motions = tuple(
        replace(m, table=replace(m.table, wrench=m.table.wrench + np.sin(3.0 * m.table.positions[:, :1]) * 2.0))
        for m in lacking.motions
    )
    told = [w for w in bayesid.compare(replace(lacking, motions=motions), ["ols", "wls"]).warnings if w.startswith("By the best")]
    assert len(told) == 1 and "something is missing in the model" in told[0]
    assert not any(w.startswith("By the best") for w in bayesid.compare(complete, ["ols", "wls"]).warnings)


def test_differences_are_counted_in_sigmas_of_the_reference(compared):
    assert compared.reference == "wls"
    pair = next(g for g in compared.gaps if (g.first, g.second) == ("ols", "gls"))
    z = np.abs(compared["ols"].values - compared["gls"].values) / compared["wls"].std
    assert pair.rms == pytest.approx(np.linalg.norm(z) / np.sqrt(len(z))) and pair.largest == z.max()
    assert pair.where == compared["wls"].base.labels[int(z.argmax())] and pair.compared == len(z)
    # What an estimator could not determine is not compared.
    hidden = compared["ols"].undetermined.copy()
    hidden[int(z.argmax())] = True
    (less,) = gaps({"wls": compared["wls"], "ols": replace(compared["ols"], undetermined=hidden)}, "wls")
    assert less.compared == len(z) - 1
    assert bayesid.compare(compared.regression, ["ridge"]).reference is None


def test_hausman_statistic_is_the_textbooks(compared):
    small, large = np.diag([1.0, 4.0, 9.0]), np.array([[3.0, 0.5, 0.0], [0.5, 8.0, 1.0], [0.0, 1.0, 10.0]])
    template = compared["ols"]
    p = len(template.solution)

    def of(values, covariance):
        wide = np.zeros((p, p))
        wide[:3, :3] = covariance
        solution = np.zeros(p)
        solution[:3] = values
        return replace(template, solution=solution, full_covariance=wide, undetermined=np.arange(p) > 2)

    difference = np.array([0.7, -1.0, 1.5])
    found = hausman("a", of(difference + 1.0, large), "b", of(np.ones(3), small))
    expected = difference @ np.linalg.solve(large - small, difference)
    assert found.statistic == pytest.approx(expected) and found.degrees == 3 and not found.contradiction
    # Where the other one claims to be surer than the efficient one, the theory does not hold.
    assert hausman("b", of(np.ones(3), small), "a", of(difference, large)).probability is None
    assert "nothing to test" in hausman("a", of(difference, large), "b", of(np.zeros(3), large)).reason
    credible = replace(of(difference, large), interval="credible")
    assert "prior" in hausman("a", credible, "b", of(np.zeros(3), small)).reason
    assert compared.tests[0].efficient == "gls" and {t.method for t in compared.tests} == set(compared.estimates) - {"gls"}
    assert next(t for t in compared.tests if t.method == "ridge").probability is None


def test_hausman_probabilities_are_uniform_when_the_model_is_complete():
    rng = np.random.default_rng(5)
    found = []
    for _ in range(80):
        x = rng.normal(size=(300, 2, 3))
        y = x @ [1.0, -2.0, 3.0] + rng.normal(size=(300, 2)) * [1.0, 10.0]
        compared = bayesid.compare(bayesid.Regression.from_arrays(x, y), ["ols", "gls"])
        found.append(compared.tests[0].probability)
    assert kstest(found, "uniform").pvalue > 0.01
    assert min(found) > 1e-4


def test_weights_that_a_missing_effect_sees_through_are_not_used():
    # A slow term that the model lacks and that its first column partly follows: whitening sees through it, wls does not.
    rng = np.random.default_rng(0)
    slow = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], rng.normal(size=2000))
    x = np.stack([slow + rng.normal(size=2000), rng.normal(size=2000)], axis=1)[:, None, :]
    y = x @ [1.0, 1.0] + 2.0 * slow[:, None] + 0.1 * rng.normal(size=(2000, 1))
    found = bayesid.compare(bayesid.Regression.from_arrays(x, y), ["wls", "gls"])
    wls, gls = (found.estimates[name] for name in ("wls", "gls"))
    assert np.array_equal(wls.values, gls.values) and not gls.details.model_complete
    assert any("gls is the same as wls" in w for w in gls.details.warnings)


def test_two_names_of_one_estimate_are_told():
    # A coefficient that wanders between parts: no noise explains it, so gls weights by channel as wls does.
    rng = np.random.default_rng(3)
    x = rng.normal(size=(1600, 2, 3))
    wandering = 1.0 + 0.3 * np.repeat(rng.normal(size=8), 200)
    y = x @ [0.0, -2.0, 3.0] + wandering[:, None] * x[:, :, 0] + rng.normal(size=(1600, 2)) * [0.1, 0.3]
    found = bayesid.compare(bayesid.Regression.from_arrays(x, y), ["ols", "wls", "gls"])
    assert not found.weights.complete
    assert np.array_equal(found["gls"].solution, found["wls"].solution)
    assert np.array_equal(found["gls"].full_covariance, found["wls"].full_covariance)
    assert [found.same_as(name) for name in ("ols", "wls", "gls")] == [(), ("gls",), ("wls",)]
    assert [m.get("same_as") for m in found.to_dict()["methods"]] == [None, ["gls"], ["wls"]]
    assert [m["details"]["weights"] for m in found.to_dict()["methods"]] == ["none", "channel", "channel"]
    assert sum("gls is the same as wls here" in w for w in found.warnings) == 1 and found["gls"].details.warnings
    assert "gls = wls" in str(found) and not found.tests and not found["wls"].details.warnings


def test_what_an_estimator_says_of_itself_is_said_with_its_name():
    """`identify` told of weak instruments and this did not, beside an interval a thousand times as wide."""
    rng = np.random.default_rng(0)
    matrix = np.cumsum(rng.normal(size=(400, 2)), axis=0)[:, None]
    instruments = np.stack([matrix[:, :, 0], rng.normal(size=(400, 1))], axis=-1)
    target = matrix @ [1.0, 2.0] + rng.normal(0.0, 0.1, (400, 1))
    regression = bayesid.Regression.from_arrays(matrix, target, instruments=instruments)
    (own,) = bayesid.fit(regression, "iv").details.warnings
    assert bayesid.compare(regression, ["wls", "iv"]).warnings == (f"iv: {own}",)


def test_a_motion_does_not_judge_fits_of_poses(robot):
    """All were given 20 % and 36 times the noise, the nominal model too, without a word: none of them had inertias."""
    poses = recording(robot, SENSOR, fourier(robot, 1), seed=1, static=True, **NOISE)[::40]
    moving = recording(robot, SENSOR, fourier(robot, 2), seed=2, **NOISE)
    roles = [Motion("poses", "identification", poses, kind="poses"), Motion("val", "validation", moving)]
    found = bayesid.compare(experiment(robot, roles, SENSOR), ["ols", "wls"])
    assert sum("are those of gravity alone, the nominal model's, too" in w for w in found.warnings) == 1
    assert not any("predicts as well as or better" in w for w in found.warnings)


def test_estimators_that_differ_are_not_called_the_same():
    rng = np.random.default_rng(4)
    x = rng.normal(size=(800, 2, 3))
    found = bayesid.compare(bayesid.Regression.from_arrays(x, x @ [1.0, -2.0, 3.0] + rng.normal(size=(800, 2)) * [0.1, 1.0]))
    assert found.weights.complete and found["gls"].details.weights == "noise"
    assert not any(found.same_as(e.name) for e in found.entries) and " = " not in str(found).split("value ±")[0]


def test_regressions_of_ones_own_have_no_robot(tmp_path):
    rng = np.random.default_rng(1)
    regression = bayesid.Regression.from_arrays(
        rng.normal(size=(200, 2, 3)), rng.normal(size=(200, 2)), parameter_names=["a", "b", "c"]
    )
    found = bayesid.compare(regression, ["ols", "gls"])
    assert found.problem is None and not found.baselines and found.entries[0].impossible is None
    head = str(found).splitlines()[1]
    assert "noise" not in head and "links" not in head and "Hausman gls" in head
    report = found.write(tmp_path / "out")
    document = strictly(tmp_path / "out" / "comparison.json")
    assert document["channel"] is None and "validation" not in document["methods"][0]
    assert "physically_consistent" not in document["methods"][0]
    text = read(report.read_text()).text
    assert "no motion to validate on" in text and "Errors by channel" not in text
    with pytest.raises(bayesid.InputError, match="leave them out with a Regression"):
        bayesid.compare(regression, ["ols"], "torque")


def test_document_is_strict_and_complete(compared, tmp_path):
    compared.write(tmp_path)
    document = strictly(tmp_path / "comparison.json")
    assert document["schema"] == 1 and document["channel"] == "wrench" and document["rank"] == compared.regression.base.rank
    methods = {m["name"]: m for m in document["methods"]}
    assert methods["refuses"] == {"name": "refuses", "status": "refused", "reason": "it never works; try another"}
    assert set(document["runtime_s"].pop("methods")) == set(methods) and "seconds" not in json.dumps(document)
    assert methods["halved"]["details"] == {"share": 0.5, "lost": None, "at": [0, 1]}
    assert methods["halved"]["base_parameters"][0]["std"] is None and methods["halved"]["physically_consistent"] is False
    predictions = methods["wls"]["validation"][0]
    assert predictions["motion"] == "validation" and predictions["whitened_rms"] > 0
    assert set(predictions["rmse"]) == set(predictions["nrmse"]) == {"fx", "fy", "fz", "mx", "my", "mz"}
    assert [b["name"] for b in document["baselines"]] == ["nominal", "nominal + effects"]
    values = [p["value"] for p in methods["gls"]["base_parameters"]]
    np.testing.assert_allclose(values, compared["gls"].values)
    assert document["agreement"]["reference"] == "wls" and len(document["agreement"]["pairs"]) == 15
    assert len(methods["wls"]["effects"]) == 6 and methods["wls"]["effects"][0]["std"] > 0


def test_report_shows_all_that_took_part(compared):
    html = comparison_report(compared)
    text = " ".join(read(html).text.split())
    for part in (
        "Side by side", "How well each one predicts", "Do the estimators agree?", "Errors by channel", "it is wrong", "Hausman",
        "refuses refused: it never works", "ridge 2", "nominal + effects", "nobody's estimator",
        *compared.regression.effect_names,
    ):  # fmt: skip
        assert part in text, part
    assert text.index("as well as or better than halved") < text.index("Side by side")
    assert comparison_report(compared) == html


def test_prints_and_shows_in_a_notebook(compared):
    text = str(compared)
    for part in ("7 estimators on the sensor's wrench of identification", "validation: error", "refuses refused: it never works"):
        assert part in text
    row = next(line for line in text.splitlines() if line.split()[:1] == ["gls"])
    assert "±" not in row and " s" in row
    html = compared._repr_html_()
    assert html.count("<table") == 2 and "it never works" in html


def test_default_set_and_names(heavier):
    found = bayesid.compare(heavier)
    assert [e.name for e in found.entries] == [m for m in DEFAULT_SET if m in bayesid.METHODS]
    assert {"ols", "wls", "gls"} <= set(found.estimates)
    with pytest.raises(bayesid.InputError, match="did you mean 'gls'"):
        bayesid.compare(heavier, ["ols", "glss"])
    with pytest.raises(bayesid.InputError, match="empty"):
        bayesid.compare(heavier, [])
    with pytest.raises(bayesid.InputError, match="no estimator"):
        bayesid.compare(heavier, [3])
    assert [e.name for e in bayesid.compare(heavier, ["wls", "wls"]).entries] == ["wls"]


def test_command_line(heavier, tmp_path, capsys):
    folder = tmp_path / "arm"
    bayesid.write_experiment(heavier, folder)
    out = tmp_path / "out"
    assert main(["compare", str(folder), "--methods", "ols, gls", "--seed", "1", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"report: {out / 'report.html'}" in said and "Hausman gls" in said
    assert sorted(p.name for p in out.iterdir()) == ["comparison.json", "report.html"]
    document = strictly(out / "comparison.json")
    assert [m["name"] for m in document["methods"]] == ["ols", "gls"] and document["filter"] == {"l": None, "d": None}
    assert main(["compare", str(folder), "--methods", "ols", "--filter-l", "1", "--filter-d", "50", "--out", str(out)]) == 0
    assert strictly(out / "comparison.json")["filter"] == {"l": 1.0, "d": 50.0}
    capsys.readouterr()
    for wrong in (["--methods", "ols,olss"], ["--methods", ","], ["--motions", "nowhere"], ["--effects", "oil"]):
        assert main(["compare", str(folder), *wrong, "--out", str(tmp_path / "no")]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "no").exists()


def test_an_estimate_of_which_nothing_is_determined_is_no_reference(heavier, tmp_path):
    """Beside free changes of every link no base parameter has an interval: its picture had no row, and could not be drawn."""
    alone = bayesid.compare(heavier, methods=["sdp"], effects=["inertia_error"])
    assert alone.reference is None
    alone.write(tmp_path)
    assert "in units of its standard deviation" not in (tmp_path / "report.html").read_text(encoding="utf-8")
