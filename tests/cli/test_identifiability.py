"""The verb from a terminal: recordings, plans without readings, tables of motions, and bad input."""

import json
import shutil

import pandas as pd
import pytest

import bayesid
from bayesid.cli import main
from bayesid.recordings.experiment import load_experiment
from bayesid.simulation.trajectories import write_trajectory
from tests.malformed import write_good


@pytest.fixture
def folder(tmp_path):
    return write_good(tmp_path / "arm")


def read(out):
    return json.loads((out / "identifiability.json").read_text(encoding="utf-8"))


def test_a_recording(folder, tmp_path, capsys):
    assert main(["identifiability", str(folder), "--out", str(tmp_path / "out")]) == 0
    printed, document = capsys.readouterr().out, read(tmp_path / "out")
    assert document["schema"] == 1 and document["source"] == "recorded"
    assert [s["name"] for s in document["sensor_sets"]] == [
        "wrench-static", "wrench-offset", "wrench", "torque", "both-offset", "both"
    ]  # fmt: skip
    main_set = next(s for s in document["sensor_sets"] if s["name"] == document["default_sensor_set"])
    assert main_set["recorded"] and main_set["rank"] == len(main_set["base_parameters"]) == len(main_set["covariance"])
    for p in main_set["parameters"]:
        assert p["class"] in document["classes"] and p["text"] == document["classes"][p["class"]]
        assert (p["expected_std"] is None) == (p["class"] in ("not_excited", "never_visible", "effect"))
    assert "What would make a difference" in printed and "report.html" in printed
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for text in ("Sensors side by side", "Every link parameter", "never visible to this sensor"):
        assert text in page


def test_what_is_expected_of_an_offset_with_weight_in_it_is_not_called_that_of_the_offset(folder, tmp_path, capsys):
    command = ["identifiability", str(folder), "--sensor-sets", "wrench-offset", "--out", str(tmp_path / "out")]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "sensor_offset.fx: standard" in printed and "sensor_offset.fz + weight: standard" in printed  # it stands upright


def test_a_plan_whose_tables_have_no_readings(folder, tmp_path):
    """The same positions without readings: the same ranks and classes, only their errors are expected from the data sheet."""
    out = tmp_path / "recorded"
    assert main(["identifiability", str(folder), "--noise", "force=0.5,moment=0.05,torque=1", "--out", str(out)]) == 0
    for path in folder.glob("*.csv"):
        table = pd.read_csv(path)
        table[[c for c in table.columns if c == "t" or c[0] == "q" and c[1:].isdigit()]].to_csv(path, index=False)
    with pytest.raises(bayesid.InputError, match="missing"):
        load_experiment(folder)
    plan = tmp_path / "plan"
    assert main(["identifiability", str(folder), "--noise", "force=0.5,moment=0.05,torque=1", "--out", str(plan)]) == 0
    before, after = read(out), read(plan)
    assert after["source"] == "planned" and not any(s["recorded"] for s in after["sensor_sets"])
    for one, other in zip(before["sensor_sets"], after["sensor_sets"], strict=True):
        assert one["rank"] == other["rank"] and one["rank_of_any_motion"] == other["rank_of_any_motion"]
        for p, q in zip(one["base_parameters"], other["base_parameters"], strict=True):
            # The bandwidth may be another, and with it what the ends lose.
            assert p["name"] == q["name"] and q["expected_std"] == pytest.approx(p["expected_std"], rel=0.2)


def test_a_planned_motion_in_place_of_the_tables(folder, tmp_path, capsys):
    setup = load_experiment(folder)
    path = tmp_path / "trajectory.csv"
    write_trajectory(bayesid.fourier_trajectory(setup.robot, duration=10.0, seed=3), path)
    for table in folder.glob("*.csv"):
        table.unlink()  # a plan needs none of them
    command = ["identifiability", str(folder), "--trajectory", str(path), "--sensor-sets", "wrench-static,torque"]
    assert main([*command, "--tell", "sensor_delay,sensor_rotation", "--out", str(tmp_path / "out")]) == 0
    document = read(tmp_path / "out")
    assert document["motions"][0]["name"] == "trajectory" and len(document["sensor_sets"]) == 2
    assert {s["sensor_set"]: len(s["pairs"]) for s in document["tell"]} == {"wrench-static": 2, "torque": 0}
    assert "Telling effects apart" in capsys.readouterr().out


@pytest.mark.parametrize(
    "options, says",
    [
        (["--sensor-sets", "sonar"], "--sensor-sets sonar"), (["--noise", "force"], "--noise force"),
        (["--noise", "force=-1"], "noise force = -1"), (["--trajectory", "none.csv"], "none.csv: no such file"),
        (["--motions", "none"], "--motions none"), (["--tell", "base_tilt"], "give at least two"),
        (["--effects", "nothing"], "nothing"), (["--bandwidth", "-1"], "-1"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_nothing_is_written(options, says, folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["identifiability", str(folder), *options, "--out", str(out)]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1 and told[0].startswith("bayesid: ") and says in told[0]
    assert not out.exists()


def test_files_of_others_are_not_replaced(folder, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "identifiability.json").write_text("mine", encoding="utf-8")
    assert main(["identifiability", str(folder), "--out", str(out)]) == 2
    assert (out / "identifiability.json").read_text(encoding="utf-8") == "mine"
    assert "identifiability.json" in capsys.readouterr().err
    shutil.rmtree(out)
