"""Five newcomers get from their files to an estimate that holds the truth, by the commands and lines of the documentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.cli import main
from tests.newcomers import files

FRICTION = ["viscous_friction", "coulomb_friction"]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two motions of the robot as it really is."""
    _, real = files.robot(tmp_path_factory.mktemp("real"))
    return [files.record(real, seed) for seed in (1, 2)]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with the URDF, in which the newcomer sits; the base parameters are those of ``real``."""
    monkeypatch.chdir(tmp_path)
    return files.robot(tmp_path)


def run(command: str) -> None:
    assert main(command.split()) == 0


def assert_true(result, model) -> None:
    """The validation motion is predicted down to the noise, and intervals hold the truth, links by Pinocchio's own order."""
    (prediction,) = result.validation
    assert prediction.relative_error < 0.01 and prediction.whitened_rms < 1.3
    truth = result.base.matrix @ np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])
    r = len(truth)
    assert np.abs((result.values[:r] - truth) / result.std[:r]).max() < 4.5
    assert ((result.low[:r] < truth) & (truth < result.high[:r])).mean() > 0.8


def test_bags_with_joints_in_alphabetical_order_and_a_wrench(desk, logs, capsys):
    urdf, real = desk
    first, second = (path.name for path in files.write_bags(urdf.parent, logs))
    run(f"import {first} {second} --urdf ur5.urdf --out asked")
    assert "say it (--sensor base" in capsys.readouterr().out
    run(f"import {first} {second} --urdf ur5.urdf --sensor base --out my-arm")
    run("check my-arm")
    assert "rank 40 from the wrench" in capsys.readouterr().out
    arm = bayesid.load_experiment("my-arm")
    assert arm.robot.joint_names == files.JOINTS
    assert_true(bayesid.identify(arm), real)
    assert_true(bayesid.identify(arm, channel="torque", effects=FRICTION), real)


def test_a_csv_in_degrees_and_milliseconds_under_other_names(desk, logs, capsys):
    urdf, real = desk
    files.write_csv(urdf.parent, logs)
    call, columns = "import log_001.csv log_002.csv --urdf ur5.urdf --out my-arm", "t=Zeitstempel,q=A{1}_Ist,tau=A{1}_Moment"
    assert main(call.split()) == 2
    assert "--columns" in capsys.readouterr().err
    assert main(f"{call} --columns {columns}".split()) == 2
    assert "--units q=deg" in capsys.readouterr().err
    assert main(f"{call} --columns {columns} --units q=deg".split()) == 2
    assert "--units t=ms" in capsys.readouterr().err
    run(f"{call} --columns {columns} --units t=ms,q=deg")
    assert "not used: Programmzeile" in capsys.readouterr().out
    run("identify my-arm --out without")
    assert "--effects viscous_friction,coulomb_friction,rotor_inertia" in capsys.readouterr().out
    run("identify my-arm --effects viscous_friction,coulomb_friction --out identified")
    assert Path("identified/report.html").exists()
    assert_true(bayesid.identify("my-arm", effects=FRICTION), real)


def test_a_mat_file(desk, logs):
    urdf, real = desk
    files.write_mat(urdf.parent, logs)
    run("import run1.mat run2.mat --urdf ur5.urdf --out my-arm")
    assert_true(bayesid.identify("my-arm", effects=FRICTION), real)


def test_an_mjcf_and_a_parquet_log(desk, logs, capsys):
    """MuJoCo's bodies are 8 % heavier than the file says, and friction is twice as large."""
    urdf, _ = desk
    files.write_parquet(urdf.parent, logs)
    run("import episode_0.parquet episode_1.parquet --urdf ur5.xml --out my-arm")
    assert "states viscous_friction, coulomb_friction, rotor_inertia" in capsys.readouterr().out
    arm = bayesid.load_experiment("my-arm")
    result = bayesid.identify(arm)
    (prediction,) = result.validation
    assert prediction.relative_error < 0.01 and prediction.whitened_rms < 1.3
    frame = result.to_dataframe().set_index("name")
    for k, (viscous, coulomb) in enumerate(zip(files.VISCOUS, files.COULOMB, strict=True), 1):
        for name, truth in ((f"viscous_friction@joint{k}.coefficient", viscous), (f"coulomb_friction@joint{k}.level", coulomb)):
            assert frame.loc[name, "value"] == pytest.approx(truth, abs=4.5 * frame.loc[name, "std"])
    truth = result.base.matrix @ (1.08 * arm.robot.nominal).ravel()
    known = np.isfinite(result.std[: len(truth)])  # two links' inertia cannot be told from a rotor's about the same axis
    z = (result.values[: len(truth)] - truth)[known] / result.std[: len(truth)][known]
    assert known.sum() == len(truth) - 2 and np.abs(z).max() < 4.5
    run("identify my-arm --out identified")
    run("export identified --to mjcf --out exported")
    assert Path("exported/identified.xml").exists()


def test_arrays_in_a_notebook(desk, logs):
    urdf, real = desk
    files.write_csv(urdf.parent, logs)
    first, later = pd.read_csv("log_001.csv"), pd.read_csv("log_002.csv")
    q, tau = [f"A{k}_Ist" for k in range(1, 7)], [f"A{k}_Moment" for k in range(1, 7)]
    with pytest.raises(bayesid.InputError, match="is it in degrees"):
        bayesid.Experiment.from_arrays("ur5.urdf", first["Zeitstempel"] / 1e3, first[q], torques=first[tau])
    later = dict(t=later["Zeitstempel"] / 1e3, q=np.deg2rad(later[q]), torques=later[tau])
    arm = bayesid.Experiment.from_arrays(
        "ur5.urdf", first["Zeitstempel"] / 1e3, np.deg2rad(first[q]), torques=first[tau], validation=later
    )
    assert 'effects=["viscous_friction", "coulomb_friction", "rotor_inertia"]' in bayesid.identify(arm).unusable[0]
    assert_true(bayesid.identify(arm, effects="viscous_friction,coulomb_friction"), real)
