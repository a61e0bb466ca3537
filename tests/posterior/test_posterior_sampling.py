"""The verb: from an experiment to draws, files, ArviZ and a report."""

import json
import warnings
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose

import bayesid
from bayesid import cli
from bayesid.errors import InputError
from bayesid.posterior.convert import before_trees, load_arviz
from bayesid.posterior.run import ConvergenceError
from tests.posterior_cases import interrupted_in, one_body, regression
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A two-joint arm with a wrench sensor, one motion to fit and another for validation."""
    robot = puma2(tmp_path_factory.mktemp("robot"))
    motions = [
        Motion(name, role, recording(
            robot, Sensor(), fourier(robot, seed, seconds, 100.0), seed=seed, force_std=0.5, torque_std=0.1, resolution=2e-5,
            offset=3.0))
        for name, role, seed, seconds in (("one", "identification", 1, 16.0), ("two", "validation", 2, 10.0))
    ]  # fmt: skip
    return experiment(robot, motions, Sensor(), inertia_rel_std=0.2)


@pytest.fixture(scope="module")
def posterior(recorded):
    return bayesid.sample(recorded, draws=1200, seed=3)


def test_default_prior_is_the_experiments(recorded, posterior):
    assert posterior.model.physical and posterior.rel_std == 0.2 and posterior.chains.engine == "hmc"
    assert posterior.diagnosis.passed and len(posterior.warnings) <= 1
    assert all(w.startswith("Driven by the prior") for w in posterior.warnings)
    truth = posterior.base.matrix @ recorded.robot.nominal.ravel()
    assert np.abs((posterior.values - truth) / posterior.std).max() < 4.5
    assert np.all(posterior.low < posterior.high)
    assert posterior.covariance.shape == (len(posterior.names),) * 2
    unstated = bayesid.sample(replace(recorded, inertia_rel_std=None), draws=400)
    assert unstated.model.prior is None and unstated.chains.engine == "emcee"
    assert any("flat" in w for w in unstated.warnings)
    stated = bayesid.sample(replace(recorded, inertia_rel_std=None), draws=400, prior_std=0.2)
    assert stated.rel_std == 0.2


def test_flat_prior_gives_generalised_least_squares(recorded):
    flat = bayesid.sample(recorded, draws=2000, prior="flat")
    gls = bayesid.identify(recorded, method="gls")
    assert np.abs((flat.values - gls.values) / gls.std).max() < 0.15
    assert_allclose(flat.std, gls.std, rtol=0.1)


def test_validation_is_predicted_as_often_as_stated(posterior):
    (motion,) = posterior.validation
    assert motion.motion == "two" and 0.9 < motion.whitened_rms < 1.1 and 0.92 < motion.coverage < 0.98


def test_arviz_opens_summarises_and_plots(posterior, tmp_path):
    """On ArviZ 0.x and 1.x alike, without a warning."""
    az = load_arviz()
    posterior.write(tmp_path / "out")
    data = az.from_netcdf(tmp_path / "out" / "posterior.nc")
    groups = {str(g).strip("/") for g in (data.groups() if callable(data.groups) else data.groups)}
    assert groups >= {"posterior", "sample_stats", "posterior_predictive", "log_likelihood", "observed_data"}
    assert list(data["posterior"]["base"].coords["base_parameter"].values) == posterior.base.short_names
    assert list(data["posterior"].attrs["base_parameters"]) == list(posterior.names)
    assert list(data["posterior"]["link"].coords["link_parameter"].values) == list(posterior.base.parameter_names)
    assert_allclose(data["posterior"]["base"].values, posterior.base_draws)
    replicated = data["posterior_predictive"]["validation"]
    assert replicated.dims == ("chain", "draw", "validation_row", "channel")
    measured = data["observed_data"]["validation"]
    low, high = np.quantile(replicated, [0.05, 0.95], axis=(0, 1))
    assert 0.85 < np.mean((measured.values > low) & (measured.values < high)) < 0.95
    assert "bodies that can exist" in data["posterior"].attrs["prior"]
    few = posterior.base.short_names[:3]
    with warnings.catch_warnings():
        if before_trees(az):
            table = az.summary(data, var_names=["base", "scale"], hdi_prob=0.95)
            az.plot_pair(data, var_names=["base"], coords={"base_parameter": few})
        else:
            table = az.summary(data, var_names=["base", "scale"], ci_kind="eti", ci_prob=0.95)
            az.plot_pair(data, var_names=["base"], coords={"base_parameter": few})
    assert len(table) == len(posterior.names) + 6
    assert_allclose(table["mean"].astype(float).to_numpy()[: len(posterior.names)], posterior.values, rtol=0.05, atol=0.01)
    matplotlib.pyplot.close("all")


def test_results_as_datasets(posterior):
    draws = posterior.to_xarray()
    assert draws["base"].dims == ("chain", "draw", "base_parameter")
    assert_allclose(draws["base"].mean(("chain", "draw")), posterior.values)
    (motion,) = posterior.validation
    data = motion.to_xarray()
    assert data["residual"].dims == ("time", "channel") and data["unit"].sel(channel="mz").item() == "N m"
    assert_allclose(data["residual"].sel(channel="fy"), data["measured"].sel(channel="fy") - data["predicted"].sel(channel="fy"))


def test_log_likelihood_terms_add_up_to_the_models(posterior):
    terms = np.asarray(posterior.to_arviz()["log_likelihood"]["rows"], float)
    whole = posterior.model.log_likelihood(*posterior.model.split(posterior.chains.draws))
    summed = terms.sum(axis=2)
    assert 300 < terms.shape[2] <= 1000
    assert_allclose(summed - summed.mean(), whole - whole.mean(), atol=0.05)


def test_leave_one_out_counts_the_parameters(posterior):
    """As many as are fitted, and no instant that one cannot leave out [Vehtari2017]."""
    loo = load_arviz().loo(posterior.to_arviz(), pointwise=True)
    effective = float(loo.p_loo if "p_loo" in dir(loo) else loo.p)
    assert effective == pytest.approx(len(posterior.names) + posterior.scales.shape[2], rel=0.5)
    assert float(np.mean(np.asarray(loo.pareto_k) > 0.7)) < 0.01


def test_predicted_rows_are_drawn_with_their_band(posterior):
    figure = posterior.plot_predictive(channels=["fx", "mz"])
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    measured = figure.axes[0].lines[0].get_ydata()
    replicated = posterior.extra.arrays["posterior_predictive"]["validation"][..., 0]
    assert band[:, 1].max() == pytest.approx(np.quantile(replicated, 0.975, axis=(0, 1)).max(), rel=1e-6)
    assert_allclose(measured, posterior.extra.arrays["observed_data"]["validation"][:, 0])
    with pytest.raises(InputError, match="rows 'held' were not predicted; choose one of fitted, validation"):
        posterior.plot_predictive("held")


def test_files_and_report(posterior, tmp_path):
    report = posterior.write(tmp_path / "out")
    entry = json.loads((tmp_path / "out" / "posterior.json").read_text(encoding="utf-8"))
    assert entry["schema"] == 1 and entry["sampler"]["converged"] and entry["interval"] == "credible"
    assert [b["name"] for b in entry["base_parameters"]] == list(posterior.names)
    text = report.read_text(encoding="utf-8")
    assert "<svg" in text and "http" not in text.replace("http-equiv", "") and "R-hat" in text


def test_command_line(recorded, tmp_path, capsys):
    folder = tmp_path / "experiment"
    bayesid.write_experiment(recorded, folder)
    arguments = ["sample", str(folder), "--draws", "400", "--prior", "flat", "--out", str(tmp_path / "out")]
    assert cli.main(arguments) == 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"posterior.json", "posterior.nc", "report.html"}
    assert not list(tmp_path.glob(".*checkpoint*"))
    capsys.readouterr()
    for extra, status, text in (
        (["--prior", "wide"], 2, "--prior wide: choose one of nominal, flat"),
        (["--prior-std", "-1"], 2, "--prior-std -1: give a positive number"),
        (["--draws", "10"], 2, "--draws 10: give at least 200"),
        (["--noise", "cauchy"], 2, "noise 'cauchy': choose one of"),
    ):
        assert cli.main([*arguments[:2], *extra, "--out", str(tmp_path / "bad")]) == status
        assert text in capsys.readouterr().err
        assert not (tmp_path / "bad").exists()


def test_an_interrupted_verb_says_how_to_go_on(recorded, tmp_path, capsys, monkeypatch):
    folder, out = tmp_path / "experiment", tmp_path / "out"
    bayesid.write_experiment(recorded, folder)
    from bayesid.workflows import sample as sampling

    whole = sampling.run
    monkeypatch.setattr(sampling, "run", lambda *a, **k: whole(*a, **{**k, "tell": interrupted_in(round=2)}))
    arguments = ["sample", str(folder), "--draws", "400", "--out", str(out)]
    assert cli.main(arguments) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1 and "add --resume to go on from" in told[0] and not out.exists()
    monkeypatch.setattr(sampling, "run", whole)
    assert cli.main([*arguments, "--resume"]) == 0


def test_chains_that_did_not_converge_are_refused_unless_asked_for():
    data = regression(0)
    options = {"draws": 200, "chains": 2, "sampler": bayesid.Sampler(engine="emcee", moves="stretch", longest=1)}
    with pytest.raises(ConvergenceError, match="did not converge") as refused:
        bayesid.sample(data, **options)
    assert refused.value.partial.base_draws.shape == (2, 100, 4)
    kept = bayesid.sample(data, **options, keep_going=True)
    assert not kept.diagnosis.passed and not kept.to_dict()["sampler"]["converged"]


def test_a_regression_of_ones_own_and_a_prior_of_ones_own():
    data = regression(1)
    posterior = bayesid.sample(data, draws=800)
    assert posterior.model.prior is None and posterior.diagnosis.passed
    assert set(posterior.extra.arrays) == {"posterior_predictive", "log_likelihood", "observed_data"}
    with pytest.raises(InputError, match="there are no nominal links"):
        bayesid.sample(data, prior="nominal")
    with pytest.raises(InputError, match='leave it out with prior="flat"'):
        bayesid.sample(data, prior="flat", prior_std=0.3)
    with pytest.raises(InputError, match="prior has 10 parameters"):
        bayesid.sample(data, prior=one_body().prior)


def test_a_mistake_in_the_data_is_told_as_identify_tells_it(tmp_path):
    """A torque with the wrong sign: the posterior is of no robot."""
    robot = puma2(tmp_path)
    motions = []
    for k, role in enumerate(("identification", "validation")):
        table = recording(robot, None, fourier(robot, k + 1, 10.0), seed=k, torque_std=0.05)
        motions.append(Motion(role, role, replace(table, torques=table.torques * [1.0, -1.0])))
    wrong = experiment(robot, motions)
    told = [w for w in bayesid.identify(wrong, progress=None).warnings if "opposite sign" in w]
    short = dict(draws=200, keep_going=True, sampler=bayesid.Sampler(longest=1), progress=None)
    assert told and set(told) <= set(bayesid.sample(wrong, **short).warnings)
