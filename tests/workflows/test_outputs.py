"""What `identify` hands on to programs: model.toml, covariances, tables, figures, predicted readings."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

import bayesid
from bayesid.recordings.table import Table
from bayesid.regression.problem import prepare
from bayesid.workflows.demo import PAPER_LOCKED
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

EFFECTS = ("viscous_friction", "coulomb_friction")
VISCOUS, COULOMB = np.array([3.0, 1.5]), np.array([2.0, 1.0])


def friction(v: np.ndarray) -> np.ndarray:
    """Torques of friction (N, 2) [N m], written out here."""
    return v * VISCOUS + np.sign(v) * COULOMB


def inverse_dynamics(robot, q, v, a) -> np.ndarray:
    """Torques (N, 2) by Pinocchio's recursion on the URDF itself."""
    whole = pin.buildModelFromUrdf(str(robot.urdf))
    still = pin.neutral(whole)
    locked = [whole.getJointId(name) for name in PAPER_LOCKED]
    for name, position in PAPER_LOCKED.items():
        still[whole.joints[whole.getJointId(name)].idx_q] = position
    model = pin.buildReducedModel(whole, locked, still)
    data = model.createData()
    return np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])


def rubbing(robot, seed: int, role: str) -> Motion:
    motion = fourier(robot, seed)
    table = recording(robot, None, motion, seed=seed, torque_std=0.2)
    return Motion(role, role, replace(table, torques=table.torques + friction(motion[2])))


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    robot = puma2(tmp_path_factory.mktemp("arm"))
    motions = [rubbing(robot, 1, "identification"), rubbing(robot, 2, "validation")]
    return bayesid.identify(experiment(robot, motions, effects=EFFECTS, inertia_rel_std=0.1))


def test_the_model_that_is_written_holds_the_effects_found_and_gives_the_same_estimate(result, tmp_path):
    result.write(tmp_path)
    again = result.problem.experiment.with_model(tmp_path / "model.toml")
    assert again.effects == EFFECTS
    assert again.effect_values["viscous_friction@joint1"]["coefficient"] == pytest.approx(VISCOUS[0], abs=0.1)
    assert set(again.effect_values) == {f"{name}@joint{k}" for name in EFFECTS for k in (1, 2)}
    np.testing.assert_allclose(bayesid.identify(again).values, result.values, rtol=1e-9)


def test_a_fit_that_is_not_linear_starts_from_the_model_written_and_fixed_values_stay(result, tmp_path):
    effects = (*EFFECTS, "encoder_offset@joint2")
    stated = {"viscous_friction@joint2": {"coefficient": 1.5, "fixed": True}}
    motions = tuple(
        replace(m, table=replace(m.table, positions=m.table.positions + [0.0, 0.05])) for m in result.problem.experiment.motions
    )
    loaded = replace(result.problem.experiment, motions=motions, effect_values=stated)
    first = bayesid.identify(loaded, effects=effects)
    first.write(tmp_path)
    again = loaded.with_model(tmp_path / "model.toml")
    assert again.effects == effects
    assert again.effect_values["viscous_friction@joint2"] == {"coefficient": 1.5, "fixed": True}
    start = prepare(again).row_model.point.values
    assert start[-1] == first.effects()[-1]["parameters"]["angle"]["value"] != 0.0


def test_the_covariance_written_has_the_effects_behind_the_base_parameters(result, tmp_path):
    result.write(tmp_path)
    document = json.loads((tmp_path / "estimate.json").read_text())
    whole, rank = np.array(document["full_covariance"]), document["rank"]
    np.testing.assert_array_equal(whole[:rank, :rank], document["covariance"])
    names = document["full_covariance_names"]
    assert names[:rank] == [p["name"] for p in document["base_parameters"]] and len(names) == len(whole) == rank + 4
    for effect in document["effects"]:
        k = names.index(f"{effect['name']}@{effect['where']}.{next(iter(effect['parameters']))}")
        assert np.sqrt(whole[k, k]) == pytest.approx(next(iter(effect["parameters"].values()))["std"])


def test_readings_predicted_are_those_of_inverse_dynamics_with_friction_added(result):
    robot = result.problem.experiment.robot
    _, q, v, a = fourier(robot, 7, duration=4.0)
    found = result.predict(q, v, a)
    expected = inverse_dynamics(robot, q, v, a) + friction(v)
    assert found.values.shape == found.std.shape == q.shape and found.channel_names == ("tau1", "tau2") and found.gravity
    moving = np.abs(v) > 0.05  # Coulomb friction turns around in a ramp
    assert np.abs(found.values - expected)[moving].max() < 0.3  # of some 100 N m
    z = (found.values - expected)[moving] / found.std[moving]
    assert 0.3 < np.sqrt(np.mean(z**2)) < 2.0
    np.testing.assert_allclose(found.high - found.low, 2 * 1.959964 * found.std)
    one = result.predict(q[5], v[5], a[5])
    np.testing.assert_allclose(one.values, found.values[5:6])


def test_the_band_is_the_spread_of_predictions_over_estimates(result):
    """Bands from the covariance against predictions of the same readings by draws of the parameters."""
    robot, rng = result.problem.experiment.robot, np.random.default_rng(0)
    _, q, v, a = fourier(robot, 8, duration=0.4)
    draws = rng.multivariate_normal(result.estimate.solution, result.estimate.full_covariance, size=400)
    each = [replace(result, estimate=replace(result.estimate, solution=d)).predict(q, v, a).values for d in draws]
    np.testing.assert_allclose(np.std(each, axis=0), result.predict(q, v, a).std, rtol=0.2)


def test_readings_that_depend_on_time_ask_for_times(result):
    robot = result.problem.experiment.robot
    times, q, v, a = fourier(robot, 7, duration=2.0)
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    table = recording(robot, sensor, fourier(robot, 1), force_std=0.1, torque_std=0.1)
    motion = Motion("identification", "identification", table)
    drifting = bayesid.identify(experiment(robot, [motion], sensor, effects=["sensor_drift"]), channel="wrench")
    with pytest.raises(bayesid.InputError, match="give times="):
        drifting.predict(q, v, a)
    early, late = (drifting.predict(q, v, a, times=times + t).values for t in (0.0, 10.0))
    rates = [p["value"] for p in drifting.effects()[-1]["parameters"].values()]
    np.testing.assert_allclose(late - early, np.tile(10.0 * np.array(rates), (len(q), 1)), atol=1e-9)


def test_effects_that_are_not_linear_are_predicted_as_the_model_reads(result):
    robot = result.problem.experiment.robot
    motions = tuple(
        replace(m, table=replace(m.table, positions=m.table.positions + [0.0, 0.05])) for m in result.problem.experiment.motions
    )
    bent = bayesid.identify(replace(result.problem.experiment, motions=motions), effects=[*EFFECTS, "encoder_offset@joint2"])
    _, q, v, a = fourier(robot, 7, duration=2.0)
    found = bent.predict(q + [0.0, 0.05], v, a).values  # what the encoders say of the motion q
    expected = inverse_dynamics(robot, q, v, a) + friction(v)
    assert np.abs(found - expected)[np.abs(v) > 0.05].max() < 0.5


def test_poses_at_rest_predict_readings_at_rest_and_say_nothing_of_motions(result):
    """Inertias have no part in poses: a motion's readings are not known to a hundredth by those, and nothing is wrong."""
    known = result.problem.experiment
    robot, rng = known.robot, np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, (40, 2))
    still = np.zeros_like(q)
    table = Table(
        times=np.arange(40.0), positions=q, torques=inverse_dynamics(robot, q, still, still) + rng.normal(0, 0.02, q.shape)
    )
    poses = bayesid.identify(experiment(robot, [Motion("poses", "identification", table, kind="poses"), known["validation"]]))
    at_rest = poses.predict(q, still, still)
    assert np.isfinite(at_rest.std).all() and at_rest.std.max() < 0.1
    v, a = rng.normal(size=(2, *q.shape))
    in_motion = poses.predict(q, v, a)
    assert np.isnan(in_motion.std).all()
    assert np.abs(in_motion.values - inverse_dynamics(robot, q, v, a)).max() < 0.5  # the nominal links, which are the true ones
    (moving,) = poses.validation
    assert moving.relative_error > 0.1 and not poses.unusable
    (said,) = (w for w in poses.warnings if "'validation'" in w)
    assert "poses at rest" in said and said.endswith("Fit a motion for them.")


@pytest.mark.parametrize("q, message", [(np.zeros((3, 5)), r"give \(N, 2\)"), (np.full((3, 2), np.nan), "not finite in row 0")])
def test_states_that_cannot_be_are_refused(result, q, message):
    with pytest.raises(bayesid.InputError, match=message):
        result.predict(q, q, q)


def test_the_error_printed_is_the_one_stored_and_that_of_the_readings(result):
    """All channels together, in the band; every sample of these motions is kept, so plain norms tell it."""
    written, printed = result.to_dict(), str(result)
    for prediction, entry in zip((*result.fitted, *result.validation), (*written["fit"], *written["validation"]), strict=True):
        error = np.linalg.norm(prediction.residuals) / np.linalg.norm(prediction.measured)
        assert prediction.relative_error == pytest.approx(error, rel=1e-9) == entry["relative_error"]
        assert entry["relative_error_raw"] == prediction.relative_error_raw > error
        table = result.problem.experiment[prediction.motion].table
        known = result.predict(*fourier(result.problem.experiment.robot, 1 if prediction.role == "identification" else 2)[1:])
        raw = np.linalg.norm(table.torques - known.values) / np.linalg.norm(table.torques)
        assert prediction.relative_error_raw == pytest.approx(raw, rel=0.05)  # measured states there, exact ones here
        assert f"error {100 * error:.3g} %" in repr(prediction) and f"error {100 * error:.3g} % of the signal" in printed


def test_the_table_has_what_the_json_has(result):
    table, document = result.to_dataframe(), result.to_dict()
    assert list(table.columns) == ["name", "label", "value", "std", "low", "high", "unit", "class"]
    base = table[table["class"] != "effect"]
    assert len(base) == result.base.rank and len(table) == len(base) + 4
    for row, entry in zip(base.to_dict("records"), document["base_parameters"], strict=True):
        assert row == pytest.approx(entry)
    friction = table.set_index("name").loc["viscous_friction@joint1.coefficient"]
    assert friction["value"] == document["effects"][0]["parameters"]["coefficient"]["value"] and friction["unit"] == "N m s/rad"
    assert friction["low"] < VISCOUS[0] < friction["high"]
    assert result.estimate.to_dataframe().equals(table)  # no offset here that weight hides in


def interval_read(text: str) -> tuple[float, float]:
    """Ends of a printed interval, ``1.84 ± 0.22`` or ``0.04 in 0 … 0.17``."""
    number = r"(−?[\d.]+(?:·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?)"

    def plain(text: str) -> float:
        value, _, power = text.replace("−", "-").partition("·10")
        return float(value) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)

    if found := re.search(rf"{number} ± {number}", text):
        value, half = map(plain, found.groups())
        return value - half, value + half
    found = re.search(rf"{number} in {number} … {number}", text)
    assert found, text
    return plain(found[2]), plain(found[3])


def test_one_interval_in_print_html_json_table_and_figure(result):
    """Where bodies and friction that can exist end an interval, as `sdp` does, it ends there in all of them."""
    estimate = result.estimate
    possible = np.tile([[-np.inf], [np.inf]], len(estimate.solution))
    possible[0, ::2] = (estimate.solution - 0.5 * estimate.full_std)[::2]
    possible[1, 1::4] = (estimate.solution + 0.2 * estimate.full_std)[1::4]
    found = replace(result, estimate=replace(estimate, possible=possible))
    document, table = found.to_dict(), found.to_dataframe().set_index("label")
    entries = {p["label"]: p for p in document["base_parameters"]}
    for e in document["effects"]:
        entries |= {f"{e['name']}@{e['where']}.{key}": value for key, value in e["parameters"].items()}
    assert set(entries) == set(table.index)
    cut = 0
    html = re.sub(r"<[^>]+>", " ", found._repr_html_().replace("</tr>", "\n"))
    for label, entry in entries.items():
        if entry["std"] is None:
            continue
        one = found[label]
        assert (one.value, one.std, one.low, one.high) == tuple(entry[k] for k in ("value", "std", "low", "high"))
        for key in ("value", "std", "low", "high"):
            assert table.loc[label, key] == entry[key]
        cut += not np.isclose(entry["high"] - entry["low"], 2 * 1.959964 * entry["std"], rtol=1e-6)
        for text in (str(found), html):
            (line,) = (x for x in text.splitlines() if re.match(rf"\s*{re.escape(label[:58])}\s+−?\d", x))
            ends = interval_read(re.sub(r"\s+", " ", line))
            assert ends == pytest.approx((entry["low"], entry["high"]), abs=0.1 * entry["std"])
    assert cut > 6
    drawn = [c.get_segments() for c in found.plot_intervals().axes[0].collections]
    shown = {k: s for group in drawn for s in group for k in [round(s[0][1])]}
    nominal, scale = (getattr(found.problem.regression, k) for k in ("nominal", "nominal_scale"))
    for k in np.flatnonzero(np.isfinite(found.std)):
        ends = (np.array([found.low[k], found.high[k]]) - nominal[k]) / scale[k]
        np.testing.assert_allclose(shown[k][:, 0], ends, rtol=1e-6)


def test_intervals_of_another_probability_and_parameters_by_their_labels(result, posterior):
    wide, narrow = result.conf_int(0.99), result.conf_int(0.5)
    sure = np.isfinite(result.std)
    for table, z in ((wide, 2.575829), (narrow, 0.674490)):
        np.testing.assert_allclose(table["high"][: len(sure)][sure], (result.values + z * result.std)[sure], rtol=1e-5)
    assert list(wide.index[: len(sure)]) == list(result.base.labels)
    k = int(np.argmax(sure))
    assert result[result.names[k]].value == result[result.base.labels[k]].value == result.values[k]
    draws = posterior.base_draws[..., 0].ravel()
    np.testing.assert_allclose(posterior.conf_int(0.5).iloc[0], np.quantile(draws, [0.25, 0.75]), rtol=1e-5)
    with pytest.raises(KeyError, match="no parameter is called 'mass'; there are .*viscous_friction@joint1"):
        result["mass"]
    with pytest.raises(bayesid.InputError, match="level = 95"):
        result.conf_int(95)


def test_tables_hold_no_rounding_errors(result):
    """A value far below what is known of it reads zero, in text and in tables."""
    solution = result.estimate.solution.copy()
    k = int(np.argmax(np.isfinite(result.std)))
    solution[k] = 3e-14
    tiny = replace(result.estimate, solution=solution)
    assert tiny.to_dataframe()["value"][k] == 0.0 and "e-14" not in str(tiny) and "10⁻¹⁴" not in str(tiny)


@pytest.fixture(scope="module")
def comparison(result):
    return bayesid.compare(result.problem.experiment, methods=["ols", "wls", "ridge"])


@pytest.fixture(scope="module")
def posterior(result):
    return bayesid.sample(result.problem.experiment, draws=1000, seed=1)


def test_tables_of_a_comparison_and_a_posterior(comparison, posterior, result):
    table = comparison.to_dataframe()
    assert list(table.columns)[:2] == ["method", "name"] and set(table["method"]) == {"ols", "wls", "ridge"}
    np.testing.assert_allclose(table[table["method"] == "wls"]["value"], result.estimate.solution, rtol=1e-9)
    assert table[table["method"] == "ridge"]["std"].isna().all()
    drawn = posterior.to_dataframe()
    np.testing.assert_allclose(drawn["value"][: result.base.rank], posterior.values)
    np.testing.assert_allclose(drawn["high"][: result.base.rank], posterior.high)
    assert list(drawn["name"]) == list(result.to_dataframe()["name"])


def test_scores_of_a_comparison_are_a_row_an_estimator_and_motion(comparison):
    scores, document = comparison.to_dataframe("scores"), comparison.to_dict()
    assert len(scores) == (len(document["baselines"]) + 3) * 2  # a fitted motion and one that was not
    written = {e["name"]: e for e in (*document["baselines"], *document["methods"])}
    for row in scores.to_dict("records"):
        predicted = (*written[row["method"]]["fit"], *written[row["method"]]["validation"])
        (entry,) = (p for p in predicted if p["motion"] == row["motion"])
        for key in ("relative_error", "relative_error_raw", "whitened_rms", "expected_rms"):
            assert row[key] == entry[key]
        assert row["coverage"] == entry["interval_coverage"] and row["nrmse_tau2"] == entry["nrmse"]["tau2"]
    assert scores.pivot(index="method", columns="motion", values="relative_error").loc["wls", "validation"] < 0.02
    with pytest.raises(bayesid.InputError, match="give 'parameters' or 'scores'"):
        comparison.to_dataframe("values")


def test_other_recordings_are_predicted_with_the_estimate_as_it_is(result, tmp_path):
    """The same numbers as for a motion of the experiment itself; from a recording, an experiment and its folder."""
    robot, (own,) = result.problem.experiment.robot, result.validation
    (again,) = result.validate(result.problem.experiment["validation"])
    assert again.relative_error == pytest.approx(own.relative_error, rel=1e-9) and again.role == "validation"
    np.testing.assert_allclose(again.residuals, own.residuals, atol=1e-9)
    other = experiment(robot, [rubbing(robot, 5, "identification"), rubbing(robot, 1, "validation")], effects=EFFECTS)
    new, repeats = result.validate(other)
    assert (new.motion, new.role, new.repeats) == ("identification", "validation", None)
    assert new.relative_error < 0.02 and new.whitened_rms == pytest.approx(1.0, abs=0.2)
    assert repeats.repeats == "identification"  # the path that was fitted, under another name
    bayesid.write_experiment(other, tmp_path / "other")
    assert result.validate(tmp_path / "other")[0].relative_error == pytest.approx(new.relative_error, rel=1e-6)
    heavy = replace(other.motions[0], table=replace(other.motions[0].table, torques=1.2 * other.motions[0].table.torques))
    assert result.validate(heavy)[0].relative_error == pytest.approx(0.2 / 1.2, abs=0.01)
    with pytest.raises(bayesid.InputError, match="no motion has the readings that were fitted"):
        result.validate(replace(heavy, table=replace(heavy.table, torques=None, wrench=np.ones((len(heavy.table), 6)))))
    with pytest.raises(bayesid.InputError, match="pass the folder of an experiment, an Experiment or a Motion"):
        result.validate(3)


def test_every_estimator_and_the_posterior_predict(comparison, posterior, result):
    _, q, v, a = fourier(result.problem.experiment.robot, 7, duration=1.0)
    own, each, drawn = result.predict(q, v, a), comparison.predict(q, v, a), posterior.predict(q, v, a)
    np.testing.assert_allclose(each["wls"].values, own.values, rtol=1e-9)
    assert np.isnan(each["ridge"].std).all() and np.isfinite(each["ridge"].values).all()
    every = posterior.columns.reshape(-1, posterior.columns.shape[-1])[::10]
    moved = [replace(result, estimate=replace(result.estimate, solution=x)).predict(q, v, a).values for x in every]
    np.testing.assert_allclose(drawn.values, np.mean(moved, axis=0), atol=5 * drawn.std.max() / np.sqrt(len(every)))
    np.testing.assert_allclose(drawn.std, np.std(moved, axis=0), rtol=0.35)


def test_figures_are_matplotlibs_and_show_what_was_asked_for(comparison, posterior, result):
    for owner in (result, posterior):
        figure = owner.plot_predictions("identification")
        titles = [ax.get_title(loc="left") for ax in figure.axes if ax.get_visible()]
        assert titles == ["tau1 [N m]", "tau2 [N m]"]
        line = figure.axes[0].lines[0].get_ydata()
        (fitted,) = owner.fitted
        assert np.nanmax(line) <= fitted.measured[:, 0].max() and np.isin(line[np.isfinite(line)], fitted.measured[:, 0]).all()
        spectra = [ax for ax in owner.plot_residuals().axes if ax.get_xscale() == "log"]
        assert len(spectra) == 2
        with pytest.raises(bayesid.InputError, match="choose one of validation, identification"):
            owner.plot_predictions("another")
    assert len(result.plot_intervals().axes[0].get_yticks()) == result.base.rank
    assert isinstance(posterior.plot_marginals(), Figure) and len(posterior.plot_marginals().axes) >= result.base.rank
    assert [t.get_text() for t in comparison.plot_errors().axes[0].get_yticklabels()][-3:] == ["ols", "wls", "ridge"]
    assert isinstance(comparison.plot_values(), Figure)


def test_figures_are_drawn_into_axes_of_ones_own(comparison, result):
    figure, axes = plt.subplots(2, 2)
    one, two = axes[0, 0], axes[0]
    assert result.plot_predictions(channels="tau2", ax=one) is figure and one.get_title(loc="left") == "tau2 [N m]"
    (found,) = result.validation
    assert np.isin(one.lines[0].get_ydata(), found.measured[:, 1]).all() and not axes[0, 1].lines
    result.plot_residuals(channels=["tau2", "tau1"], ax=two)
    assert [ax.get_title(loc="left") for ax in two] == ["tau2 [N m]", "tau1 [N m]"]
    result.plot_residuals(ax=axes)  # row by row: in time, and as a spectrum
    assert [ax.get_xscale() for ax in axes.ravel()] == ["linear", "log"] * 2
    figure, one = plt.subplots()
    recorded = result.problem.experiment["validation"]
    for draw in (result.plot_intervals, comparison.plot_errors, comparison.plot_values, recorded.plot):
        one.clear()
        options = {"channels": ["q1", "q2"]} if draw.__name__ == "plot" else {}
        assert draw(ax=one, **options) is figure and len(one.lines) and figure.axes == [one]
    plt.close("all")
    with pytest.raises(bayesid.InputError, match="no 'fx' here; choose of tau1, tau2"):
        result.plot_residuals(channels=["fx"])
    with pytest.raises(bayesid.InputError, match="ax holds 1 axes and the figure has 2 panels"):
        result.plot(ax=one)
    with pytest.raises(bayesid.InputError, match="ax holds a Figure; give Axes"):
        result.plot(ax=figure)


def test_figures_show_themselves_and_can_be_kept(result, tmp_path):
    """A notebook asks for an image, whether or not pyplot or its inline backend was loaded."""
    figure = result.plot(channels="tau1")
    image = figure._repr_png_()
    assert image.startswith(b"\x89PNG") and len(image) > 10_000
    figure.savefig(tmp_path / "kept.pdf")
    assert (tmp_path / "kept.pdf").stat().st_size > 5_000


def test_results_need_neither_matplotlib_nor_pandas_until_they_are_asked():
    code = (
        "import sys, bayesid.results.identification, bayesid.results.comparison, bayesid.results.posterior; "
        "print(*(name for name in ('matplotlib', 'pandas') if name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == ""


def test_a_regression_of_ones_own_has_no_motions_to_show():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(200, 2, 3))
    regression = bayesid.Regression.from_arrays(matrix, matrix @ [1.0, 2.0, 3.0] + rng.normal(size=(200, 2)))
    compared = bayesid.compare(regression, methods=["ols", "wls"])
    assert len(compared.to_dataframe()) == 6 and isinstance(compared.plot_values(), Figure)
    with pytest.raises(bayesid.InputError, match="no motions to predict"):
        compared.plot_errors()
    with pytest.raises(bayesid.InputError, match="needs a robot"):
        compared.predict(np.zeros(2), np.zeros(2), np.zeros(2))
    one_line(regression, compared, compared["ols"], bayesid.sample(regression, draws=400))


def one_line(*things) -> None:
    for thing in things:
        assert "\n" not in repr(thing) and len(repr(thing)) < 160 and "array(" not in repr(thing), repr(thing)[:300]


def test_everything_public_shows_itself_in_one_line(comparison, posterior, result):
    problem = result.problem
    moved = bayesid.fourier_trajectory(problem.experiment.robot, duration=2.0)
    one_line(
        result, result.estimate, result.base, result.urdf, *result.validation, comparison, *comparison.entries, posterior,
        problem, problem.row_model, problem.regression, problem.experiment, problem.experiment.robot, *problem.experiment.motions,
        problem.experiment.motions[0].table, bayesid.check(problem.experiment), moved,
        bayesid.Prior.nominal(result.link_parameters, 0.2), bayesid.Bounds(mass={"joint1": (1.0, 2.0)}),
        bayesid.simulate(problem.experiment.robot, [moved]), result.predict(*np.zeros((3, 2))), bayesid.EffectLibrary(),
        bayesid.Physical(prior=bayesid.Prior.nominal(result.link_parameters, 0.2)), bayesid.estimator("huber"),
    )  # fmt: skip
    assert "test" in repr(result) and "wls" in repr(result) and "2 joints" in repr(problem.experiment)


def test_every_warning_says_what_to_do(tmp_path):
    """One recording short of everything: no validation motion, an offset, links not excited, halves that differ, a flat prior,
    and too few draws."""
    robot = puma2(tmp_path)
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    motions = []
    for k in (1, 2):
        table = recording(robot, sensor, fourier(robot, k, duration=12.0), seed=k, force_std=0.3, torque_std=0.1)
        motions.append(Motion(f"half{k}", "identification", replace(table, wrench=table.wrench * (1.0 + 0.2 * k))))
    short = experiment(robot, motions, sensor)
    results = [
        bayesid.identify(short), bayesid.identify(short, method="iv"), bayesid.identify(short, motions=["half1"]),
        bayesid.compare(short, methods=["ols", "gls"]),
        bayesid.sample(short, draws=200, keep_going=True, sampler=bayesid.Sampler(longest=1)),
        bayesid.sample(short, draws=400, prior="nominal", prior_std=1e-3), bayesid.identify(short, method="sdp"),
    ]  # fmt: skip
    said = {warning for result in results for warning in result.warnings}
    assert len(said) >= 8
    remedy = re.compile(r"\b([Aa]dd|compare|correct|check|fit|looks for|record|state|take|[Pp]redict|validate|leave)\b")
    assert not [warning for warning in said if not remedy.search(warning)]
