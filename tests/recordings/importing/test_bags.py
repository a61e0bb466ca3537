"""Bags of ROS 1 and 2 and MCAP files, written by rosbags' own writers, read back as the arrays that went in."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.errors import InputError
from bayesid.recordings.table import Table
from tests.recordings.importing.logs import JOINTS, START, Bag, Known, make_known, write_bag


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    return make_known(tmp_path_factory.mktemp("known"))


def _is(table: bayesid.Table, known: Known, rows: slice | np.ndarray = slice(None)) -> None:
    """The table holds the known arrays, to the last digit."""
    assert table.torques is not None and table.velocities is not None
    np.testing.assert_array_equal(table.times, (known.ns[rows] - known.ns[rows][0]) / 1e9)
    np.testing.assert_array_equal(table.positions, known.q[rows])
    np.testing.assert_array_equal(table.velocities, known.v[rows])
    np.testing.assert_array_equal(table.torques, known.tau[rows])


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_a_bag_is_read_as_it_was_written(kind, known, tmp_path):
    """Joints are joined by name, though the bag has them sorted; the frame of the wrench says where the sensor sits."""
    bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), known, kind, late=1_500_000)
    imported = bayesid.read_recording(bag, known.urdf)
    (motion,) = imported.experiment.motions
    assert imported.experiment.robot.joint_names == JOINTS and motion.name == "run"
    _is(motion.table, known)
    np.testing.assert_array_equal(motion.table.wrench, known.wrench)
    assert imported.experiment.sensor is not None and imported.experiment.sensor.joint == "wrist_ft"
    (told,) = imported.recordings
    assert told.recording.start == START and {s.clock.kind for s in told.recording.signals} == {"header"}
    assert told.recording.signals[0].clock.late == pytest.approx((1.5e-3, 0.0))
    text = str(imported)
    assert "the log's times are 1.50 +- 0 ms later" in text and "no positions of gripper: locked at 0" in text
    assert "2023-11-14T22:13:20.000Z" in text and "at 125.0 Hz" in text


def test_stamps_of_a_simulation_are_no_dates(known, tmp_path):
    """They count from its start: nothing was recorded in 1970, and no message was logged fifty years late."""
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(known.ns):
            bag.joints(ns + 10**10, JOINTS, known.q[k], known.v[k], known.tau[k], log=START + ns)
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    _is(imported.experiment.motions[0].table, known)
    (told,) = imported.to_dict()["recordings"]
    assert told["start"] is None and all(signal["log_late_s"] is None for signal in told["signals"])
    assert "1970" not in str(imported) and "later" not in str(imported)


def test_the_folder_written_is_taken_by_check_and_identify(known, tmp_path):
    other = make_known(tmp_path, seed=2)
    first, later = write_bag(tmp_path / "first", known, "mcap"), write_bag(tmp_path / "later", other, "sqlite3")
    imported = bayesid.read_recording([first, later], known.urdf, name="arm")
    assert [m.role for m in imported.experiment.motions] == ["identification", "validation"]
    folder = imported.write(tmp_path / "arm")
    again = bayesid.load_experiment(folder)
    np.testing.assert_array_equal(again["first"].table.positions, known.q)
    assert again.locked == {"gripper": 0.0}
    assert bayesid.check(imported).channel == "wrench"
    result = bayesid.identify(again)
    assert result.to_dict()["validation"][0]["relative_error"] < 0.05
    assert not any("delay" in text or "late" in text for text in again.warnings)


def test_a_bare_file_of_a_bag_is_enough(known, tmp_path):
    for kind, end in (("mcap", "*.mcap"), ("sqlite3", "*.db3")):
        folder = write_bag(tmp_path / kind, known, kind)
        (file,) = folder.glob(end)
        _is(bayesid.read_recording(file, known.urdf).experiment.motions[0].table, known)


def test_a_bag_without_definitions_and_a_compressed_one_are_read(known, tmp_path):
    """ROS 2 before Iron wrote SQLite files without definitions; messages are compressed by ``--compression-mode message``."""
    for name in ("old", "compressed"):
        with Bag(tmp_path / name, "sqlite3", compressed=name == "compressed") as bag:
            for k, ns in enumerate(START + known.ns):
                bag.joints(ns, JOINTS, known.q[k], known.v[k], known.tau[k])
    with contextlib.closing(sqlite3.connect(tmp_path / "old" / "old.db3")) as file:
        file.executescript("DROP TABLE message_definitions; UPDATE schema SET schema_version = 2;")
    for name in ("old", "compressed"):
        _is(bayesid.read_recording(tmp_path / name, known.urdf).experiment.motions[0].table, known)


@pytest.mark.parametrize("kind", ["ros1", "mcap", "csv"])
def test_a_recording_that_was_split_into_files_is_one_again(kind, known, tmp_path):
    parts = [tmp_path / ("a.bag" if kind == "ros1" else "a"), tmp_path / ("b.bag" if kind == "ros1" else "b")]
    for path, rows in zip(parts, (slice(0, 400), slice(400, None)), strict=True):
        part = replace(known, ns=known.ns[rows], **{k: getattr(known, k)[rows] for k in ("q", "v", "tau", "wrench")})
        if kind == "csv":
            Table(part.t, part.q, part.v, torques=part.tau).to_dataframe().to_csv(path.with_suffix(".csv"), index=False)
        else:
            write_bag(path, part, kind)
    files = [path.with_suffix(".csv") for path in parts] if kind == "csv" else parts
    imported = bayesid.read_recording(files, known.urdf, joints=JOINTS, join_files=True)
    _is(imported.experiment.motions[0].table, known)
    assert imported.experiment.motions[0].name == "a" and len(imported.experiment.motions) == 1


def test_order_may_differ_from_message_to_message_and_parts_may_be_empty(known, tmp_path):
    """Shuffled names, no velocities at all, efforts that are all NaN for one publisher, and a gripper on the same topic."""
    rng = np.random.default_rng(0)
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            order = rng.permutation(2)
            bag.joints(ns, [JOINTS[j] for j in order], known.q[k, order], tau=known.tau[k, order])
            if k % 10 == 0:
                bag.joints(ns + 1_000_000, ["gripper"], [0.01], tau=[np.nan])
    imported = bayesid.read_recording(tmp_path / "run", known.urdf, joints=JOINTS)
    (motion,) = imported.experiment.motions
    np.testing.assert_array_equal(motion.table.positions, known.q)
    np.testing.assert_array_equal(motion.table.torques, known.tau)
    assert motion.table.velocities is None
    assert imported.recordings[0].recording.left_over == ("/joint_states/gripper/position",)
    assert imported.experiment.locked == {"gripper": 0.01}
    assert any("gripper is not used and stands: locked at 0.01" in text for text in imported.done)


def test_topics_of_other_rates_meet_at_the_times_of_the_slower(known, tmp_path):
    """Joints at 125 Hz, a wrench at 500 Hz: the wrench is averaged about each row, without a delay."""
    fast = make_known(tmp_path, seed=1, rate=500.0)
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, known.q[k], tau=known.tau[k])
        for k, ns in enumerate(START + fast.ns):
            bag.wrench(ns, fast.wrench[k])
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    table = imported.experiment.motions[0].table
    np.testing.assert_array_equal(table.positions, known.q[: len(table)])
    exact = make_known(tmp_path, seed=1, rate=500.0).wrench[::4][: len(table)]
    assert table.wrench is not None
    inner = slice(2, -2)
    left = (table.wrench - exact)[inner]
    assert np.abs(left.mean(axis=0)).max() < 0.02 and left[:, :3].std() < 0.15  # 0.1 N of noise in a sample of either
    assert any("mean over 8 ms about each row (4 samples)" in text for text in imported.recordings[0].recording.done)
    (delay,) = imported.recordings[0].delays
    assert abs(delay.value) < 4.0 * delay.std < 4e-3


def test_a_delay_between_topics_is_told(known, tmp_path):
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, known.q[k], tau=known.tau[k])
            bag.wrench(ns + 30_000_000, known.wrench[k])
    (delay,) = bayesid.read_recording(tmp_path / "run", known.urdf).recordings[0].delays
    assert abs(delay.value - 0.03) < max(4.0 * delay.std, 1e-3) and delay.std < 2e-3
    assert "later than positions of /joint_states" in str(delay)
    imported = bayesid.read_recording(tmp_path / "run", known.urdf, shift={"wrench": -0.03})
    np.testing.assert_allclose(imported.experiment.motions[0].table.wrench, known.wrench, rtol=0.0, atol=1e-6)
    assert any("wrench: times shifted by -0.03 s" in text for text in imported.recordings[0].recording.done)
    with pytest.raises(InputError, match="shift: fx = 1 is no shift of a quantity"):
        bayesid.read_recording(tmp_path / "run", known.urdf, shift={"fx": 1.0})


def test_velocities_and_commands_of_other_topics_are_told_to_be_late(known, tmp_path):
    """Commands lead by 40 ms, velocities are 15 ms late; the standard deviation is no smaller than the error."""
    rng = np.random.default_rng(3)
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, known.q[k] + 1e-4 * rng.normal(size=2), tau=known.tau[k])
            bag.joints(ns + 15_000_000, JOINTS, [], v=known.v[k] + 0.05 * rng.normal(size=2), topic="/drives")
            bag.joints(ns - 40_000_000, JOINTS, known.q[k] + 1e-3 * rng.normal(size=2), topic="/controller/reference")
    columns = {"q": "/joint_states/{joint}/position", "qr": "/controller/reference/{joint}/position"}
    imported = bayesid.read_recording(tmp_path / "run", known.urdf, columns=columns, joints=JOINTS)
    late = {delay.late: delay for delay in imported.recordings[0].delays}
    for name, truth in (("velocities of /drives", 0.015), ("commands of /controller/reference", -0.04)):
        delay = late[name]
        assert delay.method == "cross-correlation" and 1e-6 < delay.std < 1e-3
        assert abs(delay.value - truth) < 4.0 * delay.std


def test_repeated_samples_are_told_with_the_true_rate(known, tmp_path):
    """A topic at 125 Hz that has a new sample in every fifth message."""
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, known.q[k // 5 * 5], tau=known.tau[k // 5 * 5])
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    assert any("repeated for 5 rows; the true rate is 25 Hz" in text for text in imported.recordings[0].recording.done)
    np.testing.assert_array_equal(imported.experiment.motions[0].table.positions, known.q[::5])


def test_headers_that_count_nothing_leave_the_log(known, tmp_path):
    with Bag(tmp_path / "run", "sqlite3") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(0, JOINTS, known.q[k], known.v[k], known.tau[k], log=ns)
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    _is(imported.experiment.motions[0].table, known)
    assert any("stamps of headers are zero or stand still" in text for text in imported.recordings[0].recording.done)
    with pytest.raises(InputError, match="clock="):
        bayesid.read_recording(tmp_path / "run", known.urdf, clock="header")


def test_clocks_of_different_kinds_and_messages_that_lack_a_number_are_told(known, tmp_path):
    """The wrench has no stamps, so that it is late by the transport of the joints' messages; one position is NaN."""
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, [np.nan, 0.0] if k == 100 else known.q[k], tau=known.tau[k], log=ns + 2_000_000)
            bag.wrench(0, known.wrench[k], log=ns + 2_000_000)
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    done = imported.recordings[0].recording.done
    assert any("/ft by times of the log, /joint_states by stamps of headers (one for all: clock=" in text for text in done)
    assert any("/joint_states: 1 messages lack a number" in text for text in done)
    table = bayesid.read_recording(tmp_path / "run", known.urdf, clock="log").experiment.motions[0].table
    np.testing.assert_array_equal(table.wrench, known.wrench)


def test_a_gap_and_stamps_out_of_order_are_told(known, tmp_path):
    kept = np.flatnonzero((known.t < 3.0) | (known.t > 3.5))
    shuffled = kept.copy()
    shuffled[[10, 11]] = shuffled[[11, 10]]
    with Bag(tmp_path / "run", "mcap") as bag:
        for at, k in enumerate(shuffled):
            ns = START + known.ns[k]
            bag.joints(ns, JOINTS, known.q[k], known.v[k], known.tau[k], log=START + known.ns[at])
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    _is(imported.experiment.motions[0].table, known, kept)
    assert "1 gap (2.992 to 3.504 s)" in str(imported) or "1 gap (3 to 3.504 s)" in str(imported)
    said = " ".join(imported.recordings[0].recording.done)
    assert "1 message came out of order, by up to 0.008 s; sorted by stamps of headers" in said and "set back" not in said


def test_a_clock_that_was_set_back_is_told_with_the_remedy(known, tmp_path):
    """Stamps step back by 2 s: two stretches were laid over each other, and the encoder was blamed."""
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(known.ns):
            back = 2_000_000_000 if k > len(known.ns) // 2 else 0
            bag.joints(START + ns - back, JOINTS, known.q[k], known.v[k], known.tau[k], log=START + ns)
    said = " ".join(bayesid.read_recording(tmp_path / "run", known.urdf).recordings[0].recording.done)
    assert "came out of order, by up to 1.99 s" in said and 'set back, two stretches lie over each other, and clock="log"' in said
    kept = bayesid.read_recording(tmp_path / "run", known.urdf, clock="log")
    assert len(kept.experiment.motions[0].table) == len(known.ns)


_CUSTOM = """
std_msgs/Header header
float64[2] q
float64[2] dq
float64[2] tau_J
float64[6] ft
"""


def test_custom_messages_are_read_by_the_definition_in_the_bag(known, tmp_path):
    """The type is not known to any store; its topic is read when it is named, and its arrays are found by their names."""
    with Bag(tmp_path / "run", "mcap", _CUSTOM, "arm_msgs/msg/State") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.write(
                "/arm/state", "arm_msgs/msg/State", ns, header=bag.header(ns), q=known.q[k], dq=known.v[k], tau_J=known.tau[k],
                ft=known.wrench[k],
            )  # fmt: skip
    with pytest.raises(InputError, match=r"no joint states; its topics are /arm/state \(arm_msgs/msg/State\)"):
        bayesid.read_recording(tmp_path / "run", known.urdf)
    for given in (dict(topics=["/arm/state"]), dict(columns={"q": "/arm/state/q", "tau": "/arm/state/tau_J"})):
        imported = bayesid.read_recording(tmp_path / "run", known.urdf, joints=JOINTS, sensor="wrist_ft", **given)
        _is(imported.experiment.motions[0].table, known)
        np.testing.assert_array_equal(imported.experiment.motions[0].table.wrench, known.wrench)


def test_times_that_a_message_holds_are_those_that_are_stated(known, tmp_path):
    """A controller's own array with its time in it: the stated column was passed over, and the log's times taken."""
    with Bag(tmp_path / "run", "mcap") as bag:
        layout = bag.store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        late = np.random.default_rng(0).integers(0, 3_000_000, len(known.ns))
        for k, ns in enumerate(START + known.ns + late):
            data = np.array([*known.q[k], *known.tau[k], known.t[k]])
            bag.write("/arm", "std_msgs/msg/Float64MultiArray", ns, layout=layout, data=data)
    options = dict(joints=JOINTS, topics=["/arm"])
    columns = {"t": "/arm/data[4]", "q": "/arm/data[0:2]", "tau": "/arm/data[2:4]"}
    imported = bayesid.read_recording(tmp_path / "run", known.urdf, columns=columns, **options)
    np.testing.assert_array_equal(imported.experiment.motions[0].table.times, known.t)
    assert "/arm/data[4]" not in imported.recordings[0].recording.left_over
    with pytest.raises(InputError, match=r'no column "/arm/data\[7\]"'):
        bayesid.read_recording(tmp_path / "run", known.urdf, columns={**columns, "t": "/arm/data[7]"}, **options)
    with pytest.raises(InputError, match="has times of its own, those of /arm; leave out rate"):
        without = {"q": columns["q"], "tau": columns["tau"]}
        bayesid.read_recording(tmp_path / "run", known.urdf, columns=without, rate=500.0, **options)


def test_other_names_of_joints_are_stated(known, tmp_path):
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, ["arm_b", "arm_a"], known.q[k, ::-1], known.v[k, ::-1], known.tau[k, ::-1])
    with pytest.raises(InputError, match=r"the log's joints are arm_b, arm_a: say which is which \(joint_names="):
        bayesid.read_recording(tmp_path / "run", known.urdf)
    imported = bayesid.read_recording(tmp_path / "run", known.urdf, joint_names={"shoulder": "arm_a", "elbow": "arm_b"})
    _is(imported.experiment.motions[0].table, known)
    with pytest.raises(InputError, match='"shouldr" is no moving joint'):
        bayesid.read_recording(tmp_path / "run", known.urdf, joint_names={"shouldr": "arm_a"})


def test_two_topics_with_the_same_joints_are_told_apart_by_the_user(known, tmp_path):
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, known.q[k], known.v[k], known.tau[k])
            bag.joints(ns, JOINTS, known.q[k] + 0.1, known.v[k], known.tau[k], topic="/filtered")
    with pytest.raises(InputError, match="q of shoulder could be /filtered/shoulder/position, /joint_states/shoulder/position"):
        bayesid.read_recording(tmp_path / "run", known.urdf)
    _is(bayesid.read_recording(tmp_path / "run", known.urdf, topics=["/joint_states"]).experiment.motions[0].table, known)
    with pytest.raises(InputError, match='no topic /joint_state; did you mean "/joint_states"'):
        bayesid.read_recording(tmp_path / "run", known.urdf, topics=["/joint_state"])


def test_a_wrench_of_an_unknown_frame_is_kept_but_not_used(known, tmp_path):
    with Bag(tmp_path / "run", "mcap") as bag:
        for k, ns in enumerate(START + known.ns):
            bag.joints(ns, JOINTS, known.q[k], tau=known.tau[k])
            bag.wrench(ns, known.wrench[k], frame="ati")
    imported = bayesid.read_recording(tmp_path / "run", known.urdf)
    assert imported.experiment.sensor is None
    assert any('its frame "ati" is no child link' in text for text in imported.done)
    assert bayesid.read_recording(tmp_path / "run", known.urdf, sensor="base").experiment.sensor is not None
    with pytest.raises(InputError, match="no joint of that name"):
        bayesid.read_recording(tmp_path / "run", known.urdf, sensor="wrist_tf")


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_cut_off_and_damaged_files_end_in_one_line(kind, known, tmp_path):
    """A file that ends at any place, or has bytes changed, is either read or refused in one line; nothing else happens."""
    few = replace(known, ns=known.ns[:200])
    path = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), few, kind)
    file = path if kind == "ros1" else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))
    whole, rng = file.read_bytes(), np.random.default_rng(1)
    refused = 0
    for k in range(24):
        content = bytearray(whole[: int(len(whole) * rng.uniform(0.0, 0.98))] if k % 2 else whole)
        if not k % 2:
            for at in rng.integers(len(content), size=60):
                content[at] = rng.integers(256)
        file.write_bytes(content)
        try:
            bayesid.read_recording(path, known.urdf)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 600
    assert refused >= 12


def test_a_message_with_more_numbers_than_names_is_refused(known, tmp_path):
    with Bag(tmp_path / "run", "mcap") as bag:
        bag.joints(START, JOINTS, [0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="run: /joint_states: message 0: 2 names but 3 in position"):
        bayesid.read_recording(tmp_path / "run", known.urdf)


def test_reading_a_bag_without_rosbags_says_what_to_install(known, tmp_path, monkeypatch):
    bag = write_bag(tmp_path / "run", replace(known, ns=known.ns[:30]), "mcap")
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r'pip install "bayesid\[import\]"'):
        bayesid.read_recording(bag, Path(known.urdf))


def test_a_verb_that_is_given_a_bag_says_what_to_do(known, tmp_path, capsys):
    bag = write_bag(tmp_path / "run", replace(known, ns=known.ns[:30]), "mcap")
    for path in (bag, next(bag.glob("*.mcap"))):
        assert main(["check", str(path)]) == 2
        assert "is a log of another tool and no experiment folder; make one of it and the robot's URDF with bayesid import" in (
            capsys.readouterr().err
        )
    with pytest.raises(InputError, match=r"with bayesid\.read_recording"):
        bayesid.check(bag)
    folder = bayesid.read_recording(write_bag(tmp_path / "whole", known, "mcap"), known.urdf).write(tmp_path / "arm")
    (folder / "whole.csv").unlink()
    write_bag(folder / "whole", replace(known, ns=known.ns[:30]), "mcap")
    toml = (folder / "experiment.toml").read_text(encoding="utf-8")
    (folder / "experiment.toml").write_text(toml.replace('"whole.csv"', '"whole"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"whole: is a log of another tool and no table; .*bayesid\.read_recording"):
        bayesid.load_experiment(folder)
