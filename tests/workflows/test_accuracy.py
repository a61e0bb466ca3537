"""What `accuracy` writes, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.report.accuracy import accuracy_report
from bayesid.rounding import number
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSORS = '[[sensor]]\nname = "platform"\nkind = "base"\nnoise = [1.0, 0.1]\nrange = [50, 20]\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An experiment folder with a short motion of two joints."""
    place = tmp_path_factory.mktemp("accuracy")
    robot, sensor = puma2(place), Sensor(translation=[0.0, 0.0, -0.1], force_std=0.5, torque_std=0.05)
    noise = dict(force_std=0.5, torque_std=0.05, resolution=1e-4)
    motions = []
    for seed, role in ((1, "identification"), (2, "validation")):
        path = fourier(robot, seed, duration=8.0)
        motions.append(Motion(role, role, recording(robot, sensor, path, seed=seed, offset=3.0, **noise)))
    made = experiment(robot, motions, sensor, position_resolution=1e-4)
    bayesid.write_experiment(made, place / "arm")
    return place


@pytest.fixture(scope="module")
def result(folder):
    (folder / "sensors.toml").write_text(SENSORS, encoding="utf-8")
    return bayesid.accuracy(folder / "arm", runs=5, certificate=20, sensors=folder / "sensors.toml")


def test_everything_is_written(result, tmp_path):
    report = result.write(tmp_path / "out")
    page, document = report.read_text(encoding="utf-8"), json.loads((tmp_path / "out" / "accuracy.json").read_text())
    for title in ("What would buy most", "One factor at a time", "Effects left out", "Coverage certificate", "Candidate sensors"):
        assert title in page
    bias = np.abs(result.sweeps.own.bias / result.std).max()  # in the unit of the estimate, beside what five means scatter by
    assert f"{number(bias, 2)} σ</b><span>largest bias" in page and "can be chance in 5 twins" in page
    assert page.count("<svg") == 3 and "http" not in page.replace("http://www.w3.org", "")
    assert document["schema"] == 1 and len(document["base_parameters"]) == len(result.names)
    assert document["certificate"]["twins"] == 20 and document["sensors"][0]["exceeds_range"] is True
    assert {f["name"] for f in document["factors"]} >= {"sensor_noise", "filter", "offset"}
    assert len(document["bias_susceptibility"][0]["bias"]) == len(result.names)


def test_it_prints_and_shows_itself(result):
    text = str(result)
    assert "half the sensor noise" in text and "Coverage of 95 % intervals" in text and "(too much)" in text
    assert "<table>" in result._repr_html_() and "9 factors" in repr(result)
    assert result.sweep("filter").levels[result.sweep("filter").own].label == "no filter"
    with pytest.raises(bayesid.InputError, match="no factor 'x' was varied"):
        result.sweep("x")
    for figure in (result.plot_sweeps(), result.plot_susceptibility(), result.plot_certificate()):
        assert figure.axes


@pytest.mark.slow
def test_an_identification_is_taken_as_it_is_and_gets_its_certificate(folder, tmp_path):
    found = bayesid.identify(folder / "arm", bandwidth=5.0, method="ols")
    result = bayesid.accuracy(found, runs=0, certificate=20)
    assert result.bench.estimate is found.estimate and result.bench.options.bandwidth == 5.0
    report = found.certified(result.certificate).write(tmp_path / "id")
    assert "Coverage certificate" in report.read_text(encoding="utf-8")
    document = json.loads((tmp_path / "id" / "estimate.json").read_text())
    assert document["certificate"]["coverage"] == result.certificate.overall
    with pytest.raises(bayesid.InputError, match="has its own channel"):
        bayesid.accuracy(found, bandwidth=4.0)


def test_the_certificate_goes_into_an_estimate_that_is_there(folder, tmp_path, capsys):
    arm, there = str(folder / "arm"), tmp_path / "id"
    assert main(["identify", arm, "--out", str(there)]) == 0
    arguments = ["accuracy", arm, "--runs", "0", "--certificate", "--twins", "20", "--out", str(tmp_path / "out")]
    assert main([*arguments, "--estimate", str(there)]) == 0
    document = json.loads((there / "estimate.json").read_text())
    assert document["certificate"] == json.loads((tmp_path / "out" / "accuracy.json").read_text())["certificate"]
    assert "Coverage certificate" in (there / "report.html").read_text(encoding="utf-8")
    assert main(["identify", arm, "--out", str(there)]) == 0  # the files still count as an earlier run's
    assert not list(tmp_path.glob(".*"))
    capsys.readouterr()
    assert main([*arguments, "--estimate", str(there), "--bandwidth", "3"]) == 2
    assert "is another estimate" in capsys.readouterr().err
    assert main([*arguments, "--estimate", str(there), "--method", "gls"]) == 2
    assert "its method is 'wls', not 'gls'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--runs", "3"], "--runs 3: give at least 5"),
        (["--runs", "-5"], "--runs -5"),
        (["--certificate", "--twins", "7"], "--twins 7: give at least 20"),
        (["--certificate", "--method", "ridge"], "method ridge prints no intervals"),
        (["--resume"], "--resume is for --certificate"),
        (["--twins", "50"], "--twins is for --certificate"),
        (["--estimate", "x"], "--estimate is for --certificate"),
        (["--certificate", "--estimate", "nowhere.json"], "cannot be read as JSON"),
        (["--sensors", "nowhere.toml"], "no such file"),
        (["--motions", "nothing"], "no such motion"),
    ],
)
def test_bad_input_is_one_line(options, says, folder, tmp_path, capsys):
    assert main(["accuracy", str(folder / "arm"), "--out", str(tmp_path / "out"), *options]) == 2
    told = capsys.readouterr().err
    assert says in told and told.count("\n") == 1 and not (tmp_path / "out").exists()


def test_nominal_links_may_be_the_truth(folder):
    result = bayesid.accuracy(folder / "arm", runs=0, nominal=True)
    robot = result.bench.experiment.robot
    base = result.bench.problem.row_model.base
    np.testing.assert_allclose(result.bench.truth[: base.rank], base.matrix @ robot.nominal.ravel())
    assert result.certificate is None and result.to_dict()["truth"] == "nominal"
    assert result.to_dataframe()["factor"].unique().tolist() == ["effect left out"]  # nothing was simulated


def test_a_page_without_warnings_claims_no_more_than_was_done(result):
    quiet = replace(result, warnings=())
    assert "formula and simulation agree, and the model is complete" in accuracy_report(quiet)
    assert "No warnings: the model is complete" in accuracy_report(replace(quiet, sweeps=None))
