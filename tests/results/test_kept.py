"""Results are kept: pickled, copied, sent to another process, written and loaded again."""

import copy
import json
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace

import joblib
import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.posterior.convert import write_netcdf
from bayesid.results.files import strict
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))
KINDS = ["identification", "estimate", "prediction", "comparison", "posterior", "own_posterior", "bounds", "diagnosis", "changes",
         "accuracy", "identifiability", "excitation", "telling", "watch", "payload", "calibration", "inspection", "experiment",
         "simulation", "regression", "table"]  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A two-joint robot recorded in two motions, with viscous friction that the model states."""
    robot = puma2(tmp_path_factory.mktemp("puma"))
    motions = []
    for k, name in enumerate(("identification", "validation")):
        table = recording(
            robot, SENSOR, fourier(robot, k + 1, duration=8.0), seed=k, force_std=0.5, torque_std=0.1, resolution=2e-5
        )
        velocity = np.gradient(table.positions, table.times, axis=0)
        motions.append(Motion(name, name, replace(table, torques=table.torques + 3.0 * velocity)))
    return experiment(robot, motions, SENSOR, inertia_rel_std=0.1, effects=("viscous_friction",))


def own_regression():
    """Rows of one's own, with instruments and errors."""
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(200, 2, 4))
    return bayesid.Regression.from_arrays(
        matrix, matrix @ np.ones(4) + 0.1 * rng.normal(size=(200, 2)), instruments=matrix,
        regressor_noise=1e-3 * rng.normal(size=(3, 200, 2, 4)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def results(arm):
    """One result of every kind; the costly ones small."""
    identified = bayesid.identify(arm, "torque")
    posterior = bayesid.sample(arm, draws=200, chains=2, channel="torque", keep_going=True)
    quick = dict(starts=1, randoms=3, seconds=0.2, rate=50.0)
    return {
        "identification": identified,
        "estimate": identified.estimate,
        "prediction": identified.validation[0],
        "comparison": bayesid.compare(arm, ["wls", "ols", "iv", "tls"], "torque"),
        "posterior": posterior,
        "own_posterior": bayesid.sample(own_regression(), draws=200, chains=2, keep_going=True),
        "bounds": bayesid.bounds(identified, configurations=8),
        "diagnosis": bayesid.diagnose(arm, "torque", effects=()),
        "changes": bayesid.diagnose(arm, "torque", reference=arm),
        "accuracy": bayesid.accuracy(identified, runs=5),
        "identifiability": bayesid.identifiability(arm),
        "excitation": bayesid.excite(arm, duration=10.0, period=5.0, **quick),
        "telling": bayesid.tell(arm, ["base_tilt", "sensor_rotation"], bayesid.ExcitationOptions(duration=6.0, **quick)),
        "watch": bayesid.watch(arm, [arm], "torque"),
        "calibration": bayesid.calibrate(arm),
        "payload": bayesid.payload(arm, "torque", diagnosis=False),
        "inspection": bayesid.check(arm),
        "experiment": arm,
        "simulation": bayesid.simulate(arm, seed=1),
        "regression": own_regression(),
        "table": arm.motions[0].table,
    }


def said(result):
    """What a result says, as numbers and words in lists and dictionaries."""
    if isinstance(result, bayesid.Regression):
        law, instruments = result.regressor_noise, result.instruments
        read = [*result.rows.blocks(), *law.perturbed(1, 1.0), *(p.instruments for p in instruments.pairs())]
        return [b.rows for b in read]
    if isinstance(result, bayesid.Experiment):
        return [said(m.table) for m in result.motions], result.robot.nominal, result.effects
    if isinstance(result, bayesid.Table):
        return result.times, result.positions, result.torques
    return result.to_dict(), str(result), repr(result)


def assert_same(one, other, where=""):
    """Equal up to rounding: sums over an array depend on how it lies in memory."""
    if isinstance(one, dict):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        if one and all(type(x) is float for x in (*one, *other)):  # at once: there are many
            one, other = [np.array(one)], [np.array(other)]
        for k, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{where}[{k}]")
    elif isinstance(one, (float, np.floating, np.ndarray)):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-12, err_msg=where)
    else:
        assert one == other, where


def sent(result):
    """The result as another process gives it back."""
    (back,) = joblib.Parallel(n_jobs=2)([joblib.delayed(copy.copy)(result)])
    return back


@pytest.mark.parametrize("kind", KINDS)
def test_a_result_is_pickled_copied_and_sent(results, kind):
    result = results[kind]
    for back in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result), sent(result)):
        assert type(back) is type(result) and back is not result
        assert_same(said(result), said(back))


def test_an_unpickled_or_loaded_result_finds_its_figures_in_a_process_that_ran_no_verb(results, tmp_path):
    (tmp_path / "changes").write_bytes(pickle.dumps(results["changes"]))
    results["identification"].write(tmp_path / "out")
    script = "import bayesid, pickle, pathlib, sys; here = pathlib.Path(sys.argv[1]); bayesid.load(here / 'out').plot(); "
    script += "pickle.loads((here / 'changes').read_bytes()).write(here / 'changed')"
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=True)
    assert (tmp_path / "changed" / "report.html").is_file()


WRITTEN = {
    "identification": "estimate.json", "comparison": "comparison.json", "posterior": "posterior.nc", "bounds": "bounds.json",
    "diagnosis": "diagnosis.json", "changes": "diagnosis.json", "accuracy": "accuracy.json", "excitation": "excitation.json",
    "identifiability": "identifiability.json", "telling": "excitation.json", "watch": "watch.json",
    "payload": "payload.json", "calibration": "calibration.json", "inspection": "check.json",
}  # fmt: skip
NUMBERS = ("names", "values", "std", "low", "high", "covariance", "link_parameters", "base_draws", "link_draws", "rho", "verdict")


@pytest.fixture(scope="module")
def loaded(results, tmp_path_factory):
    """Every result, written and read back from its folder."""
    out = {}
    for kind in WRITTEN:
        folder = tmp_path_factory.mktemp("out") / kind
        results[kind].write(folder)
        out[kind] = bayesid.load(folder)
    return out


@pytest.mark.parametrize("kind", WRITTEN)
def test_a_result_is_loaded_from_its_folder_and_its_file(results, loaded, kind):
    live, back = results[kind], loaded[kind]
    # Whatever a JSON file cannot hold was made plain when it was written.
    assert_same(strict(live.to_dict()), strict(back.to_dict()))
    assert str(back) == str(live)
    assert str(bayesid.load(back.path.with_name(WRITTEN[kind]))) == str(live)
    told = [name for name in NUMBERS if hasattr(type(live), name) and (name != "names" or kind != "accuracy")]
    for name in told:
        assert_same(getattr(live, name), getattr(back, name), name)
    assert back.warnings == list(live.warnings) if hasattr(live, "warnings") else "warnings" not in told
    again = pickle.loads(pickle.dumps(back))
    assert type(again) is type(back) and again.to_dict() == back.to_dict() and str(again) == str(back)
    assert_same(copy.deepcopy(back).to_dict(), back.to_dict())


@pytest.mark.parametrize("kind", WRITTEN)
def test_the_numbers_of_a_result_are_a_table_also_when_it_is_loaded(results, loaded, kind):
    table = results[kind].to_dataframe()
    pd.testing.assert_frame_equal(loaded[kind].to_dataframe()[[*table]], table, check_dtype=False)
    if kind != "changes":  # of which there are none
        assert len(table) and table.notna().any(axis=None)


@pytest.mark.parametrize("kind", ["identification", "posterior"])
def test_a_loaded_result_is_asked_for_its_effects_as_the_result_is(results, loaded, kind):
    assert_same(loaded[kind].effects(), results[kind].effects())


def test_tables_hold_the_numbers_of_what_was_found(results):
    found = results["diagnosis"].to_dataframe().set_index(["name", "where", "parameter"])
    for effect in results["diagnosis"].to_dict()["effects"]:
        for name, number in effect["parameters"].items():
            row = found.loc[(effect["name"], effect["where"], name)]
            assert (row["value"], row["std"], row["unit"]) == (number["value"], number["std"], number["unit"])
    payload = results["payload"].to_dataframe().set_index(["quantity", "parameter"])
    assert [*payload.index.get_level_values(0).unique()] == ["mass", "centre_of_mass", "first_moment", "inertia"]
    assert payload.loc[("first_moment", "mcx"), "value"] == results["payload"].first_moment[0].value
    motions = results["inspection"].to_dataframe().set_index("name")
    assert motions.loc["validation", "samples"] == len(results["table"].times) and motions["times_noise"].notna().all()


def test_a_loaded_estimate_has_what_the_estimate_has(results, loaded):
    live, back = results["identification"], loaded["identification"]
    pd.testing.assert_frame_equal(live.to_dataframe(), back.to_dataframe())
    pd.testing.assert_frame_equal(live.conf_int(0.8), back.conf_int(0.8))
    assert repr(back["I2zz"]) == repr(live["I2zz"])
    assert_same(live.estimate.to_dict(), back.estimate.to_dict())
    assert str(back.estimate) == str(live.estimate)
    assert_same(live.base.matrix, back.base.matrix)
    assert list(back.base.independent) == list(live.base.independent)
    (one,), (other,) = live.validation, back.validation
    assert (other.motion, other.relative_error) == (one.motion, pytest.approx(one.relative_error))
    assert_same(one.nrmse, other.nrmse)
    assert one.flexible is not None and other.flexible == one.flexible
    assert_same(drawn(live.plot_intervals()), drawn(back.plot_intervals()))
    assert back.plot() is not None


def test_a_loaded_comparison_has_what_the_comparison_has(results, loaded):
    live, back = results["comparison"], loaded["comparison"]
    assert list(back.estimates) == list(live.estimates) == ["wls", "ols", "iv", "tls"]
    for of in ("parameters", "scores"):
        pd.testing.assert_frame_equal(live.to_dataframe(of), back.to_dataframe(of))
    assert_same(live["iv"].to_dict(), back["iv"].to_dict())
    for figure in ("plot_values", "plot_errors"):
        assert_same(drawn(getattr(live, figure)()), drawn(getattr(back, figure)()))


def test_a_loaded_posterior_has_its_draws(results, loaded, tmp_path):
    live, back = results["posterior"], loaded["posterior"]
    pd.testing.assert_frame_equal(live.to_dataframe(), back.to_dataframe())
    pd.testing.assert_frame_equal(live.conf_int(0.5), back.conf_int(0.5))
    assert_same(live.effect_draws, back.effect_draws)
    assert back.plot_marginals() is not None
    assert_same(np.asarray(back.to_arviz()["posterior"]["base"]), live.base_draws)
    alone = shutil.copy(back.path.with_name("posterior.nc"), tmp_path / "draws.nc")
    bare = bayesid.load(alone)  # without posterior.json
    assert_same(live.base_draws, bare.base_draws)
    assert_same([live.values, live.low, live.covariance], [bare.values, bare.low, bare.covariance])
    for name in ("base", "fitted", "validation"):
        with pytest.raises(bayesid.NeedsRecording, match=f"does not hold what {name} of .* needs"):
            getattr(bare, name)
    assert back.classes == live.classes and [p.fitted for p in (*back.fitted, *back.validation)] == [True, False]
    assert_same(np.asarray(back.to_xarray()["base"]), live.base_draws)
    assert_same(drawn(live.plot_predictive()), drawn(back.plot_predictive()))
    back.path.with_name("posterior.nc").unlink()
    with pytest.raises(bayesid.InputError, match="posterior.nc: no such file, and the draws are in it; sample again"):
        bayesid.load(back.path).conf_int(0.5)


def test_the_draws_of_a_single_base_parameter_are_loaded_without_the_numbers(tmp_path):
    matrix, rng = np.linspace(1.0, 2.0, 40)[:, None, None], np.random.default_rng(0)
    target = matrix[:, :, 0] + 0.1 * rng.normal(size=(40, 1))
    live = bayesid.sample(bayesid.Regression.from_arrays(matrix, target), 200)
    write_netcdf(live.to_arviz(), tmp_path / "posterior.nc")
    back = bayesid.load(tmp_path)
    assert back.names == live.names == ("p1",)
    assert_same(live.values, back.values)


@pytest.mark.parametrize(
    ("kind", "name"), [("identification", "predict"), ("identification", "plot_predictions"), ("comparison", "predict"),
                       ("posterior", "log_density"), ("bounds", "torque"), ("diagnosis", "search"), ("watch", "sentences"),
                       ("payload", "export"), ("calibration", "compensate")]
)  # fmt: skip
def test_what_needs_the_recording_says_so(loaded, kind, name):
    with pytest.raises(bayesid.NeedsRecording, match=f"does not hold what {name} of .* needs, which is the recording"):
        getattr(loaded[kind], name)
    assert not hasattr(loaded[kind], name) and not hasattr(loaded[kind], "nothing_of_that_name")


def test_what_is_no_result_is_refused(loaded, arm, tmp_path):
    folder = tmp_path / "arm"
    bayesid.write_experiment(arm, folder)
    both = tmp_path / "both"
    both.mkdir()
    for kind in ("identification", "comparison"):
        shutil.copy(loaded[kind].path, both)
    (tmp_path / "other.json").write_text("{}")
    (tmp_path / "broken.json").write_text("{")
    estimate = json.loads(loaded["identification"].path.read_text(encoding="utf-8"))
    (tmp_path / "later.json").write_text(json.dumps({**estimate, "schema": 2}))
    for path, said in (
        (folder, "is an experiment, no result; give the folder that a verb wrote"),
        (tmp_path / "nowhere.json", "No such file"),
        (tmp_path, "holds no result of bayesid"),
        (both, "holds comparison.json and estimate.json; name one of them"),
        (tmp_path / "other.json", "is no document of bayesid"),
        (tmp_path / "broken.json", "cannot be read as JSON"),
        (tmp_path / "later.json", "later.json: is of schema 2, this bayesid knows 1; read it with the bayesid that wrote it"),
        (folder / "robot.urdf", "name the folder, or its JSON or NetCDF file"),
    ):
        with pytest.raises(bayesid.InputError, match=said):
            bayesid.load(path)


def drawn(figure):
    """Numbers of the lines of a figure."""
    return [line.get_xydata().tolist() for ax in figure.axes for line in ax.lines]


def test_identified_urdf_is_the_same_robot_whichever_verb_writes_it(results, loaded, arm, tmp_path):
    """Of the estimate, of bounds around it, and of bounds by its files; of the posterior, and of bounds around that."""

    def written(result, name):
        return (result.write(tmp_path / name).parent / "identified.urdf").read_text(encoding="utf-8")

    folders = {kind: loaded[kind].path.parent for kind in ("identification", "bounds", "posterior")}
    text = {kind: (folder / "identified.urdf").read_text(encoding="utf-8") for kind, folder in folders.items()}
    again = bayesid.bounds(arm, run=folders["identification"], configurations=8)
    assert text["identification"] == text["bounds"] == written(again, "again")
    assert text["posterior"] == written(bayesid.bounds(results["posterior"], configurations=8), "around")
    for one in text.values():
        assert one.count("damping=") == 2  # the viscous friction of both joints


@pytest.mark.parametrize("kind", ["identification", "comparison", "posterior", "prediction", "estimate"])
def test_results_are_compared_by_identity(results, kind):
    """Equality of the arrays within is no yes or no."""
    result = results[kind]
    copied = copy.deepcopy(result)
    assert result == result and result != copied
    assert len({result, copied}) == 2


@pytest.mark.parametrize(
    ("kind", "there"),
    [
        ("identification", "m2 r2x"), ("estimate", "m2 r2x"), ("posterior", "m2 r2x"), ("comparison", "wls"),
        ("bounds", "m2 r2x"), ("identifiability", "torque"), ("experiment", "validation"),
    ],
)  # fmt: skip
def test_a_name_is_in_a_result_or_not(kind, there, results):
    """Python counted the parts, 0, 1 and so on, and an error said that no parameter is called 0."""
    assert there in results[kind] and "nonsense" not in results[kind]
    if kind != "experiment":
        with pytest.raises(TypeError, match="not iterable"):
            iter(results[kind])
    else:
        assert list(results[kind]) == list(results[kind].motions) and results[kind].motions[0] in results[kind]
