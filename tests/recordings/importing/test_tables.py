"""CSV and Parquet tables of other tools: other names, units, clocks and separators; written by pandas, pyarrow and by hand."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from array import array
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

import bayesid
from bayesid.cli import main
from bayesid.errors import InputError
from bayesid.recordings.table import WRENCH_COLUMNS, Table
from bayesid.results.imported import _span
from tests.recordings.importing.logs import JOINTS, START, Known, make_known

DEGREE = 180.0 / np.pi


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    return make_known(tmp_path_factory.mktemp("known"))


def by_joint(known: Known, **more: np.ndarray) -> pd.DataFrame:
    """Columns as PlotJuggler names them, in radians."""
    columns: dict[str, np.ndarray] = dict(more)
    for word, values in (("position", known.q), ("velocity", known.v), ("effort", known.tau)):
        columns |= {f"/joint_states/{joint}/{word}": values[:, k] for k, joint in enumerate(JOINTS)}
    return pd.DataFrame(columns)


def only(source: Path, known: Known, **options) -> Table:
    """The table of the only recording."""
    return bayesid.read_recording(source, known.urdf, **options).experiment.motions[0].table


def test_our_own_names_need_no_mapping(known, tmp_path):
    frame = pd.DataFrame(
        {"t": known.t, "q1": known.q[:, 0], "q2": known.q[:, 1], "tau1": known.tau[:, 0], "tau2": known.tau[:, 1]}
    )
    frame[list(WRENCH_COLUMNS)] = known.wrench
    frame["mode"] = "run"
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, joints=JOINTS, sensor="wrist_ft")
    table = imported.experiment.motions[0].table
    for name, values in (("times", known.t), ("positions", known.q), ("torques", known.tau), ("wrench", known.wrench)):
        np.testing.assert_array_equal(getattr(table, name), values)
    assert imported.recordings[0].recording.left_over == ("mode",) and imported.recordings[0].recording.start is None
    with pytest.raises(InputError, match=r"2 positions \(q1 ... q2\) but 3 joints \(shoulder, elbow, gripper\); name those of"):
        bayesid.read_recording(tmp_path / "log.csv", known.urdf)


MAPPING = """
[columns]
t = "Zeit"
q = "{joint} ist"
tau = ["Strom A", "Strom B"]
wrench = "kms"

[units]
t = "ms"
q = "deg"
tau = "A"
m = "N mm"

[units.scale]
shoulder = 11.5
tau2 = -9.25
"""


def test_a_mapping_names_columns_units_and_a_constant_a_joint(known, tmp_path):
    """Degrees, milliseconds, N mm and ampere, in a Parquet file with one array; read to rounding."""
    wrench = known.wrench * np.repeat([1.0, 1e3], 3)
    frame = pd.DataFrame({"Zeit": known.t * 1e3, "kms": list(wrench)})
    for k, joint in enumerate(JOINTS):
        frame[f"{joint} ist"] = known.q[:, k] * DEGREE
    frame["Strom A"], frame["Strom B"] = known.tau[:, 0] / 11.5, known.tau[:, 1] / -9.25
    frame.to_parquet(tmp_path / "log.parquet")
    (tmp_path / "mapping.toml").write_text(MAPPING, encoding="utf-8")
    table = only(tmp_path / "log.parquet", known, mapping=tmp_path / "mapping.toml", sensor="wrist_ft", joints=JOINTS)
    for name, values in (("times", known.t), ("positions", known.q), ("torques", known.tau), ("wrench", known.wrench)):
        np.testing.assert_allclose(getattr(table, name), values, rtol=1e-13, atol=1e-13)
    frame.drop(columns="kms").to_csv(tmp_path / "log.csv", index=False)
    stated = tomllib.loads(MAPPING)
    columns = {key: value for key, value in stated["columns"].items() if key != "wrench"}
    scale = stated["units"].pop("scale")
    options = dict(columns=columns, units=stated["units"], scale=scale, joints=JOINTS)
    np.testing.assert_allclose(only(tmp_path / "log.csv", known, **options).torques, known.tau, rtol=1e-13)
    with pytest.raises(InputError, match=r"units tau1: torques in A say nothing without a constant; .* shoulder=11.2"):
        only(tmp_path / "log.csv", known, **options | {"scale": {}})


CLOCKS = {
    "seconds": lambda known: known.t + 12.5,
    "milliseconds": lambda known: known.ns // 10**6,
    "seconds since 1970": lambda known: START / 1e9 + known.t,
    "milliseconds since 1970": lambda known: (START + known.ns) // 10**6,
    "nanoseconds since 1970": lambda known: START + known.ns,
    "dates": lambda known: pd.to_datetime(START + known.ns, utc=True).strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_times_of_any_kind(clock, known, tmp_path):
    """What can only be a date of a computer is recognised; other milliseconds are stated, by the name or by the user."""
    by_joint(known, timestamp=CLOCKS[clock](known)).to_csv(tmp_path / "log.csv", index=False)
    units = {"t": "ms"} if clock == "milliseconds" else None
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, units=units)
    (told,), (motion,) = imported.recordings, imported.experiment.motions
    dated = clock not in ("seconds", "milliseconds")
    assert told.recording.start == (START if dated else None)
    exact = known.t + (12.5 if clock == "seconds" else 0.0)
    np.testing.assert_allclose(motion.table.times, exact, rtol=0.0, atol=3e-7 if clock == "seconds since 1970" else 1e-12)
    assert clock in told.recording.signals[0].clock.text


@pytest.mark.parametrize("since", [400, 40_000, 4_000_000])
def test_nanoseconds_since_a_computer_started_are_no_date_in_longer_units(since, known, tmp_path):
    """4e11 ns would be a date in milliseconds, but with steps of hours: the advice is the true unit."""
    frame = by_joint(known, time=since * 10**9 + known.ns)
    frame.drop(columns=[c for c in frame if c.endswith("velocity")]).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=r"t seems to be in nanoseconds, steps of 0.00\d+ s; .* units t=ns"):
        only(tmp_path / "log.csv", known)
    np.testing.assert_allclose(only(tmp_path / "log.csv", known, units={"t": "ns"}).times, since + known.t, rtol=0, atol=1e-9)


def test_units_in_brackets_after_a_name_are_taken(known, tmp_path):
    frame = pd.DataFrame({"Time (ms)": known.t * 1e3})
    for k in range(2):
        frame[f"q{k + 1} [deg]"], frame[f"torque_{k + 1} [Nm]"] = known.q[:, k] * DEGREE, known.tau[:, k]
    frame.to_csv(tmp_path / "log.csv", index=False)
    table = only(tmp_path / "log.csv", known, joints=JOINTS)
    np.testing.assert_allclose(table.positions, known.q, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(table.times, known.t, rtol=1e-13)
    np.testing.assert_array_equal(table.torques, known.tau)


def test_a_stated_unit_that_is_not_the_one_of_the_name_is_told(known, tmp_path):
    """What is stated wins over a header that is wrong."""
    frame = pd.DataFrame({"t": known.t, **{f"q{k + 1} [rad]": known.q[:, k] * DEGREE for k in range(2)}})
    frame = frame.assign(**{f"tau{k + 1} [Nm]": known.tau[:, k] for k in range(2)})
    frame.to_csv(tmp_path / "log.csv", index=False)
    made = bayesid.read_recording(tmp_path / "log.csv", known.urdf, joints=JOINTS, units={"q": "deg", "tau": "N m"})
    np.testing.assert_allclose(made.experiment.motions[0].table.positions, known.q, rtol=1e-13, atol=1e-13)
    (told,) = (text for text in made.recordings[0].recording.done if "as stated" in text)
    assert told == "q1 [rad], q2 [rad]: read in deg, as stated, and not in the rad of the name"


def test_short_words_of_ros_controllers_are_known(known, tmp_path):
    frame = by_joint(known, time=known.t)
    for word, short in (("position", "pos"), ("velocity", "vel"), ("effort", "eff")):
        frame.columns = [f"{short}_{c.split('/')[2]}" if c.endswith(word) else c for c in frame.columns]
    frame.to_csv(tmp_path / "log.csv", index=False)
    table = only(tmp_path / "log.csv", known)
    for name, values in (("positions", known.q), ("velocities", known.v), ("torques", known.tau)):
        np.testing.assert_array_equal(getattr(table, name), values)


def test_words_of_a_single_joint_need_no_number(known, tmp_path):
    frame = pd.DataFrame({"time": known.t, "position": known.q[:, 1], "velocity": known.v[:, 1], "torque": known.tau[:, 1]})
    frame.assign(**{"desired.position": 0.0}).to_csv(tmp_path / "log.csv", index=False)
    table = only(tmp_path / "log.csv", known, joints=["elbow"])
    for values, said in ((table.positions, known.q), (table.velocities, known.v), (table.torques, known.tau)):
        np.testing.assert_array_equal(values, said[:, 1:])
    frame.assign(theta=0.0).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match="q could be position, theta"):
        only(tmp_path / "log.csv", known, joints=["elbow"])
    with pytest.raises(InputError, match="no positions of"):
        only(tmp_path / "log.csv", known, joints=JOINTS)


def test_a_word_beside_another_joints_name_is_no_single_joints(known, tmp_path):
    frame = by_joint(known, time=known.t)
    frame[[c for c in frame if "elbow" not in c]].to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match="no positions of elbow|the log's joints are shoulder"):
        only(tmp_path / "log.csv", known, joints=["elbow"])


def test_recordings_that_follow_each_other_in_a_file_are_told(known, tmp_path):
    half = len(known.t) // 2
    times = np.concatenate([known.t[:half], known.t[: len(known.t) - half]])
    by_joint(known, time=times).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(
        InputError, match=r"time goes back, .* \(1 such row\); do recordings follow each other there\? give each a"
    ):
        only(tmp_path / "log.csv", known)


def test_numbers_within_names_make_the_example(known, tmp_path):
    """As drives and spreadsheets write them; the example is what to write, with the names' own units."""
    frame = pd.DataFrame({"Time(ms)": known.t * 1e3})
    for k in range(2):
        frame[f"J{k + 1}_Angle(deg)"], frame[f"J{k + 1}_Torque(Nm)"] = known.q[:, k] * DEGREE, known.tau[:, k]
    frame.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(
        InputError, match=re.escape("q=J{1}_Angle(deg)); its columns are: J{1}_Angle(deg), J{1}_Torque(Nm), Time")
    ):
        only(tmp_path / "log.csv", known, joints=JOINTS)
    with pytest.raises(InputError, match=re.escape("such as tau=J{1}_Torque(Nm))")):
        only(tmp_path / "log.csv", known, joints=JOINTS, columns={"q": "J{1}_Angle(deg)"})
    stated = {"q": "J{1}_Angle(deg)", "tau": "J{1}_Torque(Nm)"}
    table = only(tmp_path / "log.csv", known, joints=JOINTS, columns=stated)
    np.testing.assert_allclose(table.positions, known.q, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(table.times - table.times[0], known.t - known.t[0], atol=1e-9)


def test_a_unit_that_is_not_stated_is_asked_for(known, tmp_path):
    frame = by_joint(known, time=known.t)
    positions = [column for column in frame if column.endswith("position")]
    frame[positions] *= DEGREE
    frame.drop(columns=[c for c in frame if c.endswith("velocity")]).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=r"degrees\? write radians.* \(or say so: units q=deg\)"):
        only(tmp_path / "log.csv", known)
    np.testing.assert_allclose(only(tmp_path / "log.csv", known, units={"q": "deg"}).positions, known.q, rtol=1e-13, atol=1e-13)


def test_separators_and_decimals_of_other_countries(known, tmp_path):
    frame = by_joint(known, time=known.t)
    for name, options in (("semicolon.csv", dict(sep=";", decimal=",")), ("tab.txt", dict(sep="\t")), ("bar.csv", dict(sep="|"))):
        frame.to_csv(tmp_path / name, index=False, **options)
        np.testing.assert_array_equal(only(tmp_path / name, known).positions, known.q)
    plain = pd.DataFrame({"timestamp": known.t, "actual_q_0": known.q[:, 0], "actual_q_1": known.q[:, 1], "target_q_0": 0.0})
    plain["torque_0"], plain["torque_1"] = known.tau.T
    plain.to_csv(tmp_path / "blank.csv", sep=" ", index=False)
    np.testing.assert_array_equal(only(tmp_path / "blank.csv", known, joints=JOINTS).positions, known.q)
    text = (tmp_path / "tab.txt").read_text(encoding="utf-8").replace("\t", ",")
    (tmp_path / "remarks.csv").write_text("# made by a logger\n# rate 125\n# " + text, encoding="utf-8-sig")
    np.testing.assert_array_equal(only(tmp_path / "remarks.csv", known).positions, known.q)
    (tmp_path / "plain.csv").write_text("# made by a logger\n\n# rate: 125, even\n" + text, encoding="utf-8-sig")
    np.testing.assert_array_equal(only(tmp_path / "plain.csv", known).positions, known.q)


def test_any_name_of_a_file_becomes_one_that_a_folder_takes(known, tmp_path):
    for name in ('.,a "b" c\u0007', "Aufnahme ä" * 20, "x" * 200, "run.1"):
        by_joint(known, time=known.t).to_csv(tmp_path / f"{name}.csv", index=False)
        imported = bayesid.read_recording(tmp_path / f"{name}.csv", known.urdf, name=name)
        again = bayesid.load_experiment(imported.write(tmp_path / "arm"))
        assert len(again.motions[0].table) == len(known.t)
        shutil.rmtree(tmp_path / "arm")


def test_the_end_of_a_recording_may_be_held_out(known, tmp_path):
    by_joint(known, time=known.t).to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, hold_out=0.25)
    first, end = imported.experiment.motions
    assert (first.name, first.role, end.name, end.role) == ("log", "identification", "log-end", "validation")
    assert len(end.table) == 250
    for quantity, values in (("times", known.t), ("positions", known.q)):
        np.testing.assert_array_equal(np.concatenate([getattr(m.table, quantity) for m in (first, end)]), values)
    assert "validation 'log-end' (log.csv): 250 rows" in str(imported)
    again = bayesid.load_experiment(imported.write(tmp_path / "arm"))
    assert [len(m.table) for m in again] == [750, 250]
    with pytest.raises(InputError, match="give a share between 0 and 1"):
        bayesid.read_recording(tmp_path / "log.csv", known.urdf, hold_out=25.0)


def test_a_recording_that_source_and_validation_name_is_only_predicted(known, tmp_path):
    for name in ("run1.csv", "run2.csv"):
        by_joint(known, t=known.t).to_csv(tmp_path / name, index=False)
    every, kept = sorted(tmp_path.glob("run*.csv")), str(tmp_path / ".." / tmp_path.name / "run1.csv")  # a name by another way
    imported = bayesid.read_recording(every, known.urdf, units={"q": "rad"}, validation=kept)
    assert [(m.name, m.role) for m in imported.experiment.motions] == [("run2", "identification"), ("run1", "validation")]
    with pytest.raises(InputError, match=r"every recording is for validation; name one that is not \(source\)"):
        bayesid.read_recording(every, known.urdf, units={"q": "rad"}, validation=every)


def test_old_samples_at_the_times_of_new_ones_are_left_out(known, tmp_path):
    """A logger that now and then reads before the robot has written, and stalls in the end; a robot at rest repeats rows, too."""
    frame = by_joint(known, time=known.t).iloc[:900]
    rest, old = np.arange(400, 500), np.concatenate([np.arange(20, 380, 6), np.arange(880, 900)])
    speed = np.interp(frame.index, [0, 390, 396, 500, 506], [1.0, 1.0, 0.0, 0.0, 1.0])  # slows down to a rest, and goes on
    at = np.cumsum(speed) * (known.t[1] - known.t[0])
    for column in frame.columns[1:]:
        frame[column] = np.interp(at, known.t, by_joint(known)[column])
    for row in old:
        frame.iloc[row, 1:] = frame.iloc[row - 1, 1:]
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, units={"q": "rad"})
    times = imported.experiment.motions[0].table.times
    left_out = np.setdiff1d(frame["time"], times)
    np.testing.assert_allclose(left_out, frame["time"].to_numpy()[old], atol=1e-9)
    assert np.isin(frame["time"].to_numpy()[rest], times).all()
    assert any("80 of 900 rows repeat the row before" in text for text in imported.recordings[0].recording.done)


def test_old_samples_of_a_slow_end_that_is_held_out_are_left_out_as_check_finds_them(known, tmp_path):
    """Beside a fast start its end seems to rest: import left there what `check` then asked to be cut out."""
    frame = by_joint(known, time=known.t).iloc[:900]
    at = np.cumsum(np.where(frame.index < 450, 1.0, 0.02)) * (known.t[1] - known.t[0])
    for column in frame.columns[1:]:
        frame[column] = np.interp(at, known.t, by_joint(known)[column])
    for row in range(500, 880, 6):
        frame.iloc[row, 1:] = frame.iloc[row - 1, 1:]
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, units={"q": "rad"}, hold_out=0.5)
    left_out = np.setdiff1d(frame["time"].iloc[460:], imported.experiment.motions[1].table.times)
    np.testing.assert_allclose(left_out, frame["time"].to_numpy()[500:880:6], atol=1e-9)
    assert not any("repeat the row before" in text for text in imported.experiment.warnings)
    assert sum("repeat the row before" in text for text in imported.done) == 1


def test_velocities_of_zeros_are_not_used(known, tmp_path):
    """A controller that does not fill in a velocity: the whole log was refused, which has the positions."""
    frame = pd.DataFrame({"t": known.t} | {f"q{k + 1}": known.q[:, k] for k in range(2)} | {"v1": known.v[:, 0], "v2": 0.0})
    frame["tau1"], frame["tau2"] = known.tau.T
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, locked={"gripper": 0.0})
    assert imported.experiment.motions[0].table.velocities is None
    assert any("velocities are 0 in every row of elbow, which moves: not used" in text for text in imported.done)


def test_joints_that_are_not_used_stand_where_they_were_recorded(known, tmp_path):
    """Only the shoulder is identified: the elbow, which moves, is locked in the middle, and that is told."""
    by_joint(known, time=known.t).to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, joints=["shoulder"], units={"q": "rad"})
    assert imported.experiment.locked == {"elbow": np.median(known.q[:, 1]), "gripper": 0.0}
    assert any("elbow is not used but moves by" in text for text in imported.done)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, locked={"elbow": 0.5})
    assert imported.experiment.locked == {"elbow": 0.5, "gripper": 0.0}
    assert imported.experiment.robot.joint_names == ("shoulder",)
    frame = pd.DataFrame({"t": known.t, "q1": known.q[:, 0], "q2": known.q[:, 1]})
    frame["tau1"], frame["tau2"] = known.tau.T
    frame.to_csv(tmp_path / "numbered.csv", index=False)
    files = [tmp_path / "numbered.csv", tmp_path / "log.csv"]
    with pytest.raises(InputError, match=r"2 positions \(q1 ... q2\) but 1 joints \(elbow\)"):
        bayesid.read_recording(files[0], known.urdf, joints=["elbow"])
    imported = bayesid.read_recording(files, known.urdf, joints=JOINTS, locked={"shoulder": 0.5})
    for motion in imported.experiment:
        np.testing.assert_array_equal(motion.table.positions, known.q[:, 1:])
        np.testing.assert_array_equal(motion.table.torques, known.tau[:, 1:])
    by_joint(known, time=known.t).filter(regex="time|elbow").to_csv(tmp_path / "elbow.csv", index=False)
    with pytest.raises(InputError, match="elbow: has positions of elbow, but log of shoulder, elbow"):
        bayesid.read_recording([tmp_path / "log.csv", tmp_path / "elbow.csv"], known.urdf)
    with pytest.raises(InputError, match="shoulder, elbow are locked, all that have positions"):
        bayesid.read_recording(tmp_path / "log.csv", known.urdf, locked={"shoulder": 0.5, "elbow": 0.0})


def test_a_table_of_merged_topics_has_the_times_of_the_slower(known, tmp_path):
    """PlotJuggler writes a row at every message: cells of the other topic are empty."""
    joints = by_joint(known, __time=known.t)
    slow = slice(2, None, 4)
    wrench = pd.DataFrame(
        known.wrench[slow], columns=[f"/ft/wrench/{part}/{axis}" for part in ("force", "torque") for axis in "xyz"]
    )
    wrench["__time"] = known.t[slow] + 0.001
    pd.concat([joints, wrench]).sort_values("__time").to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, sensor="wrist_ft")
    table = imported.experiment.motions[0].table
    np.testing.assert_array_equal(table.wrench, known.wrench[slow][: len(table)])
    np.testing.assert_array_equal(table.times, (known.t[slow] + 0.001)[: len(table)])
    at = np.interp(table.times, known.t, known.q[:, 1])
    assert np.abs(table.positions[:, 1] - at).max() < 1e-4  # straight lines lack a tenth of a milliradian here
    assert any("rows are at the times of wrench" in text for text in imported.recordings[0].recording.done)


def test_velocities_that_are_differences_of_held_positions_are_not_used(known, tmp_path):
    """A logger three times as fast as the robot that differences what it logs: 0 in two rows of three."""
    step, count = known.t[1] - known.t[0], len(known.t[::3])
    for ahead in (0, 1):
        frame = pd.DataFrame({"t": step * np.arange(3 * count)})
        for k in range(2):
            held = np.repeat(known.q[::3, k], 3)
            frame[f"q{k + 1}"], frame[f"tau{k + 1}"] = held, np.repeat(known.tau[::3, k], 3)
            steps = np.diff(held) / step
            frame[f"v{k + 1}"] = np.append(steps, 0.0) if ahead else np.append(0.0, steps)
        frame.to_csv(tmp_path / "log.csv", index=False)
        imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, joints=JOINTS)
        table = imported.experiment.motions[0].table
        assert table.velocities is None and "times what the positions say" not in str(imported)
        assert any("0 in all but one of the 3 rows" in text for text in imported.recordings[0].recording.done)
        np.testing.assert_allclose(table.positions, known.q[::3], atol=1e-12)
        frame[["v1", "v2"]] = np.repeat(known.v[::3], 3, axis=0)  # a drive's own are held as the positions are, and are used
        frame.to_csv(tmp_path / "log.csv", index=False)
        table = only(tmp_path / "log.csv", known, joints=JOINTS)
        np.testing.assert_allclose(table.velocities, known.v[::3], atol=1e-12)


def test_files_of_topics_are_joined(known, tmp_path):
    by_joint(known, time=START / 1e9 + known.t).to_csv(tmp_path / "joints.csv", index=False)
    wrench = pd.DataFrame(known.wrench, columns=list(WRENCH_COLUMNS))
    wrench["stamp"] = START + known.ns
    wrench.to_csv(tmp_path / "sensor.csv", index=False)
    files = [tmp_path / "joints.csv", tmp_path / "sensor.csv"]
    imported = bayesid.read_recording(files, known.urdf, join_files=True, sensor="wrist_ft")
    (motion,) = imported.experiment.motions
    assert motion.table.wrench is not None and imported.recordings[0].files == ("joints.csv", "sensor.csv")
    (delay,) = imported.recordings[0].delays
    assert abs(delay.value) < max(4.0 * delay.std, 1e-4)
    wrench["stamp"] = known.t
    wrench.to_csv(tmp_path / "sensor.csv", index=False)
    with pytest.raises(InputError, match="clocks cannot be brought together"):
        bayesid.read_recording(files, known.urdf, join_files=True, sensor="wrist_ft")


def matrix(path: Path, values: np.ndarray) -> None:
    """A matrix alone in a file, in the format that its ending says."""
    if path.suffix == ".mat":
        scipy.io.savemat(path, {path.stem: values.reshape(len(values), -1)})
    elif path.suffix == ".npy":
        np.save(path, values)
    else:
        np.savetxt(path, values)


def test_the_names_of_files_without_names_of_columns_stand_in_one_mapping(known, tmp_path):
    files = [tmp_path / "first.csv", tmp_path / "second.npy"]
    both = np.hstack([known.q, known.tau])
    np.savetxt(files[0], both, delimiter=",")
    np.save(files[1], both[:900])
    hint = r'In columns, "\{file\}" stands for the name of each file, such as in q=\{file\}\[0:6\] of six joints$'
    for columns in ({}, {"q": "first[0:2]", "tau": "first[2:4]"}):
        with pytest.raises(InputError, match=hint):
            bayesid.read_recording(files, known.urdf, joints=JOINTS, columns=columns, rate=100)
    columns = {"q": "{file}[0:2]", "tau": ["{file}[2]", "{file}[3]"]}
    with pytest.raises(InputError, match=r"write N m per A at the joint, scale shoulder=11.2$"):
        bayesid.read_recording(files, known.urdf, joints=JOINTS, columns=columns, units={"tau": "A"}, rate=100)
    motions = bayesid.read_recording(files, known.urdf, joints=JOINTS, columns=columns, rate=100).experiment.motions
    for motion, rows in zip(motions, (both, both[:900]), strict=True):
        np.testing.assert_array_equal(motion.table.positions, rows[:, :2])
        np.testing.assert_array_equal(motion.table.torques, rows[:, 2:])


@pytest.mark.parametrize("ending", [".txt", ".npy", ".mat"])
def test_files_of_a_quantity_each_are_joined(ending, known, tmp_path):
    """One without times has those of the file that has some; they could not be named, and those of one width were put on end."""
    files = [tmp_path / f"{name}{ending}" for name in ("t", "q", "qDot", "tau")]
    for path, values in zip(files, (known.t, known.q, known.v, known.tau), strict=True):
        matrix(path, values)
    with pytest.raises(InputError, match="no positions .* Together the files are one recording: join_files=True reads them so"):
        bayesid.read_recording(files, known.urdf, joints=JOINTS)
    table = bayesid.read_recording(files, known.urdf, joints=JOINTS, join_files=True).experiment.motions[0].table
    for name, values in (("times", known.t), ("positions", known.q), ("velocities", known.v), ("torques", known.tau)):
        np.testing.assert_allclose(getattr(table, name), values, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("dates", [False, True])
def test_files_of_a_quantity_each_with_the_joints_as_columns_are_joined(dates, known, tmp_path):
    """Their columns are the same and their times, too: they are no parts of one after the other."""
    times = [f"2026-01-01 10:{int(t) // 60:02d}:{t % 60:09.6f}" for t in known.t] if dates else known.t
    for name, values in (("position", known.q), ("effort", known.tau)):
        frame = pd.DataFrame(values, columns=list(JOINTS))
        frame.insert(0, "t", times)
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    files = [tmp_path / "position.csv", tmp_path / "effort.csv"]
    columns = {"q": "position/{joint}", "tau": "effort/{joint}"}
    table = bayesid.read_recording(files, known.urdf, joints=JOINTS, columns=columns, join_files=True).experiment.motions[0].table
    for name, values in (("times", known.t - known.t[0]), ("positions", known.q), ("torques", known.tau)):
        np.testing.assert_allclose(getattr(table, name), values, rtol=0.0, atol=1e-6 if name == "times" else 0.0)


def test_a_file_that_goes_on_where_another_ends_is_told(known, tmp_path):
    frame, half = by_joint(known, time=known.t), len(known.t) // 2
    files = [tmp_path / "first.csv", tmp_path / "second.csv"]
    for path, part in zip(files, (frame[:half], frame[half:]), strict=True):
        part.to_csv(path, index=False)
    imported = bayesid.read_recording(files, known.urdf, join_files=True)
    assert len(imported.experiment.motions[0].table) == len(known.t)
    assert "second after first, as one recording: the same columns at later times" in str(imported)


@pytest.mark.parametrize(
    ("name", "said"),
    [("log.xlsx", "save the sheet as CSV"), ("log.json", "save its records as CSV"), ("echo.txt", "record a bag")],
)
def test_what_is_no_table_is_told_with_what_to_do(name, said, known, tmp_path):
    (tmp_path / name).write_text("header:\n  stamp:\n    sec: 1\nposition:\n- 0.1\n---\n", encoding="utf-8")
    with pytest.raises(InputError, match=said):
        bayesid.read_recording(tmp_path / name, known.urdf)


def test_rows_without_times_have_those_of_the_rate_that_is_stated(known, tmp_path):
    np.savetxt(tmp_path / "log.txt", np.hstack([known.q, known.tau]))
    columns = {"q": "log[0:2]", "tau": "log[2:4]"}
    with pytest.raises(InputError, match=r"state how many samples a second there are \(rate=500 of bayesid.read_recording\)"):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS, columns=columns)
    rate = 1.0 / known.t[1]
    imported = bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS, columns=columns, rate=rate)
    np.testing.assert_allclose(imported.experiment.motions[0].table.times, known.t, rtol=1e-12)
    assert imported.to_dict()["recordings"][0]["signals"][0]["clock"] == "rows"
    np.savetxt(tmp_path / "log.txt", np.hstack([known.q, known.tau, known.t[:, None]]))
    columns["t"] = "log[4]"
    with pytest.raises(InputError, match=r'has times of its own, column "log\[4\]"; leave out rate'):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS, columns=columns, rate=rate)
    with pytest.raises(InputError, match="give samples a second"):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS, columns=columns, rate=0.0)


def test_poses_at_rest_are_imported_as_such_and_need_no_times(known, tmp_path):
    """A row a pose: a file of few was refused with what no import could say, and one of more was taken for a trajectory."""
    rows = slice(None, None, len(known.t) // 15)
    np.savetxt(tmp_path / "log.txt", np.hstack([known.q[rows], known.wrench[rows]]))
    options = dict(joints=JOINTS, columns={"q": "log[0:2]", "wrench": "log[2:8]"}, sensor="wrist_ft")
    with pytest.raises(InputError, match=r'no trajectory .* say kind="poses" if each row is a pose at rest'):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, rate=1.0, **options)
    imported = bayesid.read_recording(tmp_path / "log.txt", known.urdf, kind="poses", **options)
    (motion,) = imported.experiment.motions
    assert motion.kind == "poses" and f"{len(motion.table)} poses\n" in str(imported)
    np.testing.assert_allclose(motion.table.wrench, known.wrench[rows], rtol=0.0, atol=1e-12)
    written = bayesid.load_experiment(imported.write(tmp_path / "written"))
    assert written.motions[0].kind == "poses"


def test_a_joint_state_of_rostopic_is_read_by_its_names(known, tmp_path):
    """``rostopic echo -p`` writes names in columns of their own, and positions by number in the message's order."""
    frame = pd.DataFrame({"%time": START + known.ns})
    for k, j in enumerate((1, 0)):
        frame[f"field.name{k}"] = JOINTS[j]
        frame[f"field.position{k}"], frame[f"field.effort{k}"] = known.q[:, j], known.tau[:, j]
    frame.to_csv(tmp_path / "log.csv", index=False)
    np.testing.assert_array_equal(only(tmp_path / "log.csv", known).positions, known.q)


@pytest.mark.parametrize(
    "write", [list, tuple, np.array, lambda row: array("d", row), lambda row: list(np.array(row))],
    ids=["list", "tuple", "numpy", "array", "numbers of numpy"],
)  # fmt: skip
def test_cells_that_are_lists_are_arrays(write, known, tmp_path):
    frame = pd.DataFrame({"time": known.t, "position": [write(row.tolist()) for row in known.q], "velocity": "[]"})
    frame["effort"] = [write(row.tolist()) for row in known.tau]
    frame.to_csv(tmp_path / "log.csv", index=False)
    table = only(tmp_path / "log.csv", known, joints=JOINTS)
    np.testing.assert_allclose(table.positions, known.q, atol=1e-8)  # numpy prints eight digits
    np.testing.assert_allclose(table.torques, known.tau, rtol=1e-7, atol=1e-7)
    frame.insert(1, "name", [list(JOINTS[::-1])] * len(frame))
    frame.to_csv(tmp_path / "named.csv", index=False)
    named = only(tmp_path / "named.csv", known)
    np.testing.assert_array_equal(named.positions, table.positions[:, ::-1])
    frame["position"] = [f"[{', '.join(['0.1'] * (k % 3))}]" for k in range(len(frame))]
    frame.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match="no positions of"):
        only(tmp_path / "log.csv", known, joints=JOINTS)


@pytest.mark.parametrize("names", [("header.stamp.sec", "header.stamp.nanosec"), ("secs", "nsecs"), ("stamp_sec", "stamp_nsec")])
def test_stamps_in_two_columns_are_one(names, known, tmp_path):
    """Messages of ROS as rows have seconds and nanoseconds apart: seconds alone repeat."""
    frame = by_joint(known)
    frame[names[0]], frame[names[1]] = (START + known.ns) // 10**9, (START + known.ns) % 10**9
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf)
    assert imported.recordings[0].recording.start == START
    np.testing.assert_array_equal(imported.experiment.motions[0].table.times, known.t)


def frame_with(known: Known, change) -> str:
    frame = by_joint(known, time=known.t).astype(object)
    change(frame)
    return frame.to_csv(index=False)


#: What is wrong with a file, and what the line must hold.
BROKEN = {
    "empty": (lambda known: "", "is empty"),
    "a header alone": (lambda known: "time,q1\n", "no rows"),
    "zero bytes": (lambda known: "t,q1\0", "zero bytes"),
    "cut off in a row": (
        lambda known: by_joint(known, time=known.t).to_csv(index=False)[:-40], "line 1001: 5 cells where the header has 7",
    ),
    "a text in a column": (
        lambda known: frame_with(known, lambda f: f.__setitem__("/joint_states/elbow/position", ["x", *known.q[1:, 1]])),
        'column "/joint_states/elbow/position", row 0: "x" is no number',
    ),
    "a number that overflows": (
        lambda known: frame_with(known, lambda f: f.__setitem__("/joint_states/elbow/position", [1e300, *known.q[1:, 1]])),
        "1e+300 is no reading",
    ),
    "a column twice": (lambda known: "time,q1,q1\n0,1,2\n", "column q1: there are 2 of it"),
    "no times": (lambda known: by_joint(known).to_csv(index=False), "no column of times is found"),
    "two columns of times": (
        lambda known: by_joint(known, time=known.t, stamp=known.t).to_csv(index=False), "times could be time, stamp",
    ),
    "a date that is none": (lambda known: by_joint(known, time=["noon", *known.t[1:]]).to_csv(index=False), '"noon" is neither'),
    "no positions": (lambda known: "time,speed\n0,1\n1,2\n", "no positions of shoulder, elbow, gripper are found"),
    "time that goes back": (lambda known: by_joint(known, time=known.t[::-1]).to_csv(index=False), "time goes back"),
    "no readings": (
        lambda known: pd.DataFrame({"t": known.t, "shoulder/pos": known.q[:, 0]}).to_csv(index=False), "no torques and no",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_a_table_is_said_in_one_line(case, known, tmp_path):
    make, said = BROKEN[case]
    (tmp_path / "log.csv").write_text(make(known), encoding="utf-8")
    with pytest.raises(InputError) as error:
        only(tmp_path / "log.csv", known)
    assert said in str(error.value) and "\n" not in str(error.value) and "log" in str(error.value)


#: What is wrong with what a user states, and what the line must hold.
STATED = {
    "a column that is not there": (dict(columns={"q": "{joint}/positon"}), 'no column "shoulder/positon"; did you mean'),
    "a key that is none": (dict(columns={"p1": "time"}), '"p1" is no column of ours'),
    "a unit that is none": (dict(units={"q": "grad"}), '"grad" is no unit here'),
    "a unit of nothing": (dict(units={"angle": "deg"}), '"angle" is no quantity'),
    "a factor of nothing": (dict(scale={"elbw": 2.0}), '"elbw" is neither a column nor a joint; did you mean "elbow"'),
    "a factor of zero": (dict(scale={"tau": 0.0}), "units.scale: tau = 0 is no factor"),
    "too few columns": (dict(columns={"tau": ["a"]}), "1 columns for 2 joints"),
    "a part of the wrench": (dict(columns={"fx": "time"}), "fy, fz, mx, my, mz are missing although fx"),
    "an array that is none": (dict(columns={"wrench": "kms"}), 'no column "kms"'),
    "several columns for one": (dict(columns={"q1": ["time", "time"]}), "several columns for one"),
    "times that are not there": (dict(columns={"t": ["zeit", "stunde"]}), 'no column "zeit", "stunde"'),
    "a column of a joint too many": (dict(columns={"q3": "x"}), "columns q3: there are 2 joints; write one up to q2"),
    "a unit of a joint too many": (dict(units={"tau3": "N"}), "units tau3: there are 2 joints; write one up to tau2"),
    "a factor of a joint too many": (dict(scale={"v9": 2.0}), "units.scale v9: there are 2 joints"),
    "topics of a table": (dict(topics="/joint_states"), "topics: holds for bags only, and none is given"),
    "a clock of a table": (dict(clock="header"), "clock: holds for bags only"),
    "episodes of a table": (dict(episodes=[0]), "episodes: holds for data sets of LeRobot only"),
    "a joint that is none": (dict(joints=["shoulder", "wrist"]), "joints: wrist is no moving joint of robot.urdf; known: "),
    "a locked joint that is none": (dict(locked={"elbw": 0.0}), "locked: elbw is no moving joint of robot.urdf; did you mean"),
}


@pytest.mark.parametrize("case", STATED)
def test_what_is_wrong_with_what_is_stated_is_said_in_one_line(case, known, tmp_path):
    options, said = STATED[case]
    options = {"joints": JOINTS} | options
    by_joint(known, time=known.t).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError) as error:
        only(tmp_path / "log.csv", known, **options)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("delimiter", [",", " "])
def test_a_matrix_of_numbers_with_a_row_for_each_joint_is_turned(delimiter, known, tmp_path):
    np.savetxt(tmp_path / "log.txt", np.hstack([known.q, known.tau]).T, delimiter=delimiter)
    np.savetxt(tmp_path / "clock.txt", known.t[None], delimiter=delimiter)
    meant = {"q": "log[0:2]", "tau": "log[2:4]", "t": "clock"}
    whole = bayesid.read_recording(
        [tmp_path / "log.txt", tmp_path / "clock.txt"], known.urdf, joints=JOINTS, columns=meant, join_files=True
    )
    table = whole.experiment.motions[0].table
    np.testing.assert_allclose(table.positions, known.q)
    np.testing.assert_allclose(table.torques, known.tau)
    np.testing.assert_allclose(table.times, known.t)


@pytest.mark.parametrize("there", [0, 1])
def test_torques_of_some_joints_under_our_own_names_are_read_as_a_folder_reads_them(there, known, tmp_path):
    frame = pd.DataFrame({"t": known.t, "q1": known.q[:, 0], "q2": known.q[:, 1], f"tau{there + 1}": known.tau[:, there]})
    frame.to_csv(tmp_path / "log.csv", index=False)
    table = only(tmp_path / "log.csv", known, joints=JOINTS)
    assert table.torque_joints == (there,)
    np.testing.assert_array_equal(table.torques[:, there], known.tau[:, there])
    frame.rename(columns={f"tau{there + 1}": "tau_1"}).to_csv(tmp_path / "log.csv", index=False)  # the first, or the second
    with pytest.raises(InputError, match="no torques and no wrench are found"):
        only(tmp_path / "log.csv", known, joints=JOINTS)


def test_torques_that_are_not_found_are_asked_for_with_what_there_is(known, tmp_path):
    np.savez(tmp_path / "log.npz", t=known.t, q=known.q, tau_command=known.tau, tau_measured=known.tau)
    with pytest.raises(InputError, match=r"such as tau=tau_measured\[0:2\].*columns are: tau_command\[0:2\], tau_m"):
        only(tmp_path / "log.npz", known, joints=JOINTS)
    only(tmp_path / "log.npz", known, joints=JOINTS, columns={"tau": "tau_measured[0:2]"})


def test_a_wrench_that_is_not_whole_is_missed_where_a_sensor_is_stated(known, tmp_path):
    frame = by_joint(known, time=known.t)
    frame[["fx", "fy", "fz", "mx", "my"]] = known.wrench[:, :5]
    frame.to_csv(tmp_path / "log.csv", index=False)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, sensor="wrist_ft")
    assert "log: no wrench of all six axes is found although a sensor is stated: torques alone are used" in imported.done


@pytest.mark.parametrize("gripper", ["twice", "open", np.inf])
def test_a_joint_that_is_not_used_may_be_locked_whatever_is_recorded_of_it(gripper, known, tmp_path):
    frame = by_joint(known, time=known.t)
    for topic in ("state", "raw")[: 1 + (gripper == "twice")]:
        frame[f"{topic}/gripper/position"] = 0.1 if gripper == "twice" else gripper
    frame.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=r"; a joint that is not used may be locked \(locked gripper=...\)"):
        only(tmp_path / "log.csv", known, joints=JOINTS)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, joints=JOINTS, locked={"gripper": 0.2})
    assert imported.experiment.locked["gripper"] == 0.2
    np.testing.assert_array_equal(imported.experiment.motions[0].table.positions, known.q)


def test_numbers_may_be_of_the_joints_that_are_not_locked(known, tmp_path):
    """The refusal said that ``locked`` leaves out what is not used, and the same was said with it."""
    frame = pd.DataFrame({"t": known.t, "q1": known.q[:, 0], "q2": known.q[:, 1], "a": known.tau[:, 0], "b": known.tau[:, 1]})
    frame.to_csv(tmp_path / "log.csv", index=False)
    for columns in ({"tau": ["a", "b"]}, {"q": ["q1", "q2"], "tau": ["a", "b"]}):
        imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, locked={"gripper": 0.1}, columns=columns)
        assert imported.experiment.robot.joint_names == JOINTS and imported.experiment.locked == {"gripper": 0.1}
        np.testing.assert_array_equal(imported.experiment.motions[0].table.torques, known.tau)
        with pytest.raises(InputError, match="2 (positions|columns) .* 3 joints"):
            bayesid.read_recording(tmp_path / "log.csv", known.urdf, columns=columns)


def test_several_columns_are_named_with_commas_between_as_on_the_command_line(known, tmp_path):
    """Names of columns are listed, or numbered as a refusal lists them: ``q_{0}``, of a wrench, too."""
    frame = pd.DataFrame({"at": known.t, "a": known.q[:, 0], "b, turned": known.q[:, 1], "tau_0": known.tau[:, 0]})
    frame["tau_1"] = known.tau[:, 1]
    frame[[f"tcp_{k}" for k in range(6)]] = known.wrench
    frame.to_csv(tmp_path / "log.csv", index=False)
    arguments = ["import", str(tmp_path / "log.csv"), "--urdf", str(known.urdf), "--out", str(tmp_path / "arm")]
    arguments += ["--joints", "shoulder,elbow", "--sensor", "wrist_ft", "--columns", "t=at,q=a,wrench=tcp_{0}"]
    assert main(arguments) == 2
    frame.rename(columns={"b, turned": "b"}).to_csv(tmp_path / "log.csv", index=False)
    arguments[-1] = "t=at,q=a,b,wrench=tcp_{0}"
    assert main(arguments) == 0
    table = bayesid.load_experiment(tmp_path / "arm").motions[0].table
    for name, values in (("positions", known.q), ("torques", known.tau), ("wrench", known.wrench)):
        np.testing.assert_array_equal(getattr(table, name), values)


@pytest.mark.parametrize("given", ["nan", "0.7", "inf", "1,x"])
def test_episodes_are_whole_numbers(given, known, tmp_path, capsys):
    """The first of them ended in an error of Python's, and 0.7 was read as 0."""
    assert main(["import", str(tmp_path), "--urdf", str(known.urdf), "--out", str(tmp_path / "arm"), "--episodes", given]) == 2
    assert f"--episodes {given}: write whole numbers with commas between, 0,3" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["log.csv", "log.mat", "log.npz", "log.parquet", "log.bag", "set/data/file-000.parquet"])
def test_what_git_lfs_leaves_in_place_of_a_file_is_told(name, known, tmp_path):
    file = tmp_path / name
    if name.startswith("set"):
        for folder in (file.parent, tmp_path / "set/meta"):
            folder.mkdir(parents=True)
        (tmp_path / "set/meta/info.json").write_text('{"codebase_version": "v3.0"}')
    file.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 427016\n")
    with pytest.raises(InputError, match=f"^{file.name}: is a pointer of Git LFS, not the file itself; fetch it: git lfs pull$"):
        bayesid.read_recording(tmp_path / Path(name).parts[0], known.urdf)


def test_a_file_that_is_no_parquet_or_a_pickle_is_refused(known, tmp_path):
    for name, said in (
        ("log.parquet", "cannot be read as Parquet"),
        ("log.pkl", "pickle"),
        ("log.xlsx", '".xlsx" are not known'),
    ):
        (tmp_path / name).write_bytes(b"PAR1 but not really PAR1")
        with pytest.raises(InputError, match=said):
            only(tmp_path / name, known)
    with pytest.raises(InputError, match="no such file or folder"):
        only(tmp_path / "absent.csv", known)
    with pytest.raises(
        InputError, match=r"folder holds no metadata.yaml.*name its files; join_files where they are parts of one"
    ):
        only(tmp_path, known)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="meta/info.json; give a ROS bag"):
        only(tmp_path / "empty", known)


def test_files_that_are_called_as_joints_make_the_example(known, tmp_path):
    files = [tmp_path / f"{joint}_joint_states.csv" for joint in JOINTS]
    for k, file in enumerate(files):
        np.savetxt(file, np.column_stack([known.q[:, k], known.tau[:, k]]), delimiter=",")
    pattern = "{joint}_joint_states[0]"
    with pytest.raises(InputError, match=re.escape(f"such as q={pattern})")):
        bayesid.read_recording(files, known.urdf, joints=JOINTS, join_files=True, rate=125.0)
    made = bayesid.read_recording(
        files, known.urdf, joints=JOINTS, join_files=True, rate=125.0, columns={"q": pattern, "tau": pattern.replace("0", "1")}
    )
    np.testing.assert_allclose(made.experiment.motions[0].table.torques, known.tau, rtol=1e-12, atol=1e-12)


def test_the_command_line_does_the_same(known, tmp_path, capsys):
    """Options as on the page; the folder passes ``check``, and nothing is left where something is wrong."""
    frame = pd.DataFrame({"Zeit": known.t * 1e3})
    for k, joint in enumerate(JOINTS):
        frame[f"pos_{joint}"], frame[f"current_{k}"] = known.q[:, k] * DEGREE, known.tau[:, k] / 11.5
    frame.to_csv(tmp_path / "log.csv", index=False)
    command = [
        "import",
        str(tmp_path / "log.csv"),
        "--urdf",
        str(known.urdf),
        "--out",
        str(tmp_path / "arm"),
        "--joints",
        "shoulder,elbow",
    ]
    stated = ["--columns", "t=Zeit,q=pos_{joint},tau=current_{0}", "--units", "t=ms,q=deg,tau=A"]
    assert main([*command, *stated]) == 2
    assert "--scale shoulder=11.2" in capsys.readouterr().err and not (tmp_path / "arm").exists()
    assert main([*command, *stated, "--scale", "tau=11.5"]) == 0
    printed = capsys.readouterr().out
    assert "q1 shoulder, q2 elbow" in printed and "torques" in printed and "current_0 ... current_1 [A]" in printed
    document = json.loads((tmp_path / "arm" / "import.json").read_text(encoding="utf-8"))
    assert document["recordings"][0]["signals"][0]["columns"]["q1"] == {"from": "pos_shoulder", "unit": "deg", "scale": 1.0}
    np.testing.assert_allclose(bayesid.load_experiment(tmp_path / "arm")["log"].table.torques, known.tau, rtol=1e-12)
    assert main(["check", str(tmp_path / "arm"), "--out", str(tmp_path / "checked")]) == 0
    assert main([*command, *stated, "--scale", "tau=11.5"]) == 2 and "is there already" in capsys.readouterr().err


STATED_IN_THE_FOLDER = """
[columns]
t = "Zeit"
q = "pos_{joint}"
tau = "current_{0}"

[units]
t = "ms"
q = "deg"
tau = "A"

[units.scale]
shoulder = 11.5
elbow = 9.25
"""


@pytest.fixture
def folder(known, tmp_path) -> Path:
    """An experiment folder whose table is another tool's."""
    frame = pd.DataFrame({"Zeit": known.t * 1e3})
    for k, (joint, constant) in enumerate(zip(JOINTS, (11.5, 9.25), strict=True)):
        frame[f"pos_{joint}"], frame[f"current_{k}"] = known.q[:, k] * DEGREE, known.tau[:, k] / constant
    frame.to_csv(tmp_path / "log.csv", sep=";", decimal=",", index=False)
    (tmp_path / "robot.urdf").write_text(known.urdf.read_text(encoding="utf-8"), encoding="utf-8")
    head = 'format = 1\nname = "arm"\n[robot]\nurdf = "robot.urdf"\njoints = ["shoulder", "elbow"]\n'
    motion = '[[motion]]\nname = "id"\nrole = "identification"\ntable = "log.csv"\n'
    (tmp_path / "experiment.toml").write_text(head + STATED_IN_THE_FOLDER + motion, encoding="utf-8")
    return tmp_path


def test_a_mapping_may_stand_in_experiment_toml(folder, known):
    table = bayesid.load_experiment(folder)["id"].table
    for name, values in (("times", known.t), ("positions", known.q), ("torques", known.tau)):
        np.testing.assert_allclose(getattr(table, name), values, rtol=1e-12, atol=1e-13)
    assert table.source == "log.csv"


def test_columns_with_our_names_go_with_those_that_are_named_one_by_one(folder, known):
    frame = pd.DataFrame({"t": known.t, "erste": known.q[:, 0], "q2": known.q[:, 1], "Drehmoment": known.tau[:, 0]})
    frame["tau2"] = known.tau[:, 1]
    frame.to_csv(folder / "log.csv", index=False)
    toml = (folder / "experiment.toml").read_text(encoding="utf-8")
    stated = '[columns]\nq1 = "erste"\ntau1 = "Drehmoment"\n'
    (folder / "experiment.toml").write_text(toml.replace(STATED_IN_THE_FOLDER, stated), encoding="utf-8")
    table = bayesid.load_experiment(folder)["id"].table
    np.testing.assert_array_equal(table.positions, known.q)
    np.testing.assert_array_equal(table.torques, known.tau)


def test_times_of_poses_may_be_dates_with_long_steps(folder, known):
    """Milliseconds since 1970 half a minute apart: a drift goes with the times of poses."""
    log = pd.read_csv(folder / "log.csv", sep=";", decimal=",").iloc[::100]
    log["Zeit"] = START // 10**6 + 30_000 * np.arange(len(log))
    log.to_csv(folder / "log.csv", sep=";", decimal=",", index=False)
    toml = (folder / "experiment.toml").read_text(encoding="utf-8").replace('t = "ms"\n', "")
    (folder / "experiment.toml").write_text(toml + 'kind = "poses"\n', encoding="utf-8")
    np.testing.assert_array_equal(bayesid.load_experiment(folder)["id"].table.times, 30.0 * np.arange(len(log)))


def test_what_is_wrong_with_a_mapping_in_experiment_toml_is_said_in_one_line(folder):
    toml = (folder / "experiment.toml").read_text(encoding="utf-8")
    for old, new, said in (
        ("pos_{joint}", "ps_{joint}", 'log.csv: columns q: no column "ps_shoulder"; did you mean "pos_shoulder"'),
        ('"deg"', '"dgr"', 'experiment.toml: units q: "dgr" is no unit here; did you mean "deg"'),
        ('q = "deg"', "q = 3", "experiment.toml: [units] q: 3 is not a text"),
        ("shoulder = 11.5", "shouldr = 11.5", 'experiment.toml: units.scale: "shouldr" is neither a column nor a joint'),
        ('t = "Zeit"', "t = 3", "[columns] t: 3 will not do; write a column's name"),
        ("[columns]", "[colums]", "experiment.toml: colums: unknown key"),
        ('tau = "A"', 'tau = "N m"', ""),
        ("log.csv", "lag.csv", "lag.csv: no such file"),
    ):
        (folder / "experiment.toml").write_text(toml.replace(old, new), encoding="utf-8")
        if said:
            with pytest.raises(InputError) as error:
                bayesid.load_experiment(folder)
            assert said in str(error.value)
        else:
            assert bayesid.load_experiment(folder)["id"].table.torques is not None


def test_currents_are_offered_where_there_are_no_torques_and_their_factors_are_told(known, tmp_path):
    """As Universal Robots' RTDE calls them; what the controller aims at is no measurement."""
    frame = pd.DataFrame({"timestamp": known.t})
    for k in range(2):
        frame[f"actual_q_{k}"], frame[f"target_current_{k}"] = known.q[:, k], 0.0
        frame[f"actual_current_{k}"] = known.tau[:, k] / (10.0, 12.5)[k]
    frame.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(
        InputError, match=r"no torques.*; actual_current_\{0\} may be motor currents: columns tau=actual_cur"
    ) as said:
        only(tmp_path / "log.csv", known, joints=JOINTS)
    assert "target_current" not in str(said.value) and "scale shoulder=" in str(said.value)
    stated = dict(columns={"tau": "actual_current_{0}"}, units={"tau": "A"}, joints=JOINTS)
    imported = bayesid.read_recording(tmp_path / "log.csv", known.urdf, scale={"shoulder": 10.0, "elbow": 12.5}, **stated)
    np.testing.assert_allclose(imported.experiment.motions[0].table.torques, known.tau, rtol=1e-12)
    assert "tau1 ... tau2 from actual_current_0 ... actual_current_1 [A], times 10, 12.5\n" in str(imported)
    columns = imported.to_dict()["recordings"][0]["signals"][-1]["columns"]
    assert [columns[name]["scale"] for name in ("tau1", "tau2")] == [10.0, 12.5]
    alike = bayesid.read_recording(tmp_path / "log.csv", known.urdf, scale={"tau": 11.5}, **stated)
    assert "[A], times 11.5\n" in str(alike) and "q1 ... q2 from actual_q_0 ... actual_q_1\n" in str(alike)


def test_a_refusal_of_the_clock_has_the_logs_own_names(known, tmp_path):
    frame = pd.DataFrame({"Time": known.t * 1e3})
    for k in range(2):
        frame[f"Position{k + 1}"], frame[f"Velocity{k + 1}"], frame[f"Torque{k + 1}"] = (
            known.q[:, k],
            known.v[:, k],
            known.tau[:, k],
        )
    frame.to_csv(tmp_path / "log.csv", index=False)
    said = r'column "Velocity1": .* what column "Position1" of shoulder says; column "Time" looks like milliseconds.*units t=ms'
    with pytest.raises(InputError, match=said):
        only(tmp_path / "log.csv", known, joints=JOINTS)
    np.testing.assert_allclose(only(tmp_path / "log.csv", known, joints=JOINTS, units={"t": "ms"}).times, known.t, rtol=1e-12)


def test_columns_between_which_one_is_missing_are_told_one_by_one():
    """Torques of joints 1 and 3 were "tau1 ... tau3"."""
    assert _span(["tau1", "tau2", "tau3"]) == "tau1 ... tau3" and _span(["tau1", "tau3"]) == "tau1, tau3"
    assert _span(["effort[0]", "effort[2]"]) == "effort[0] ... effort[2]" and _span(["q4"]) == "q4"
