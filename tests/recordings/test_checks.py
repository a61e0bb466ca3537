"""Checks of recorded data: doubts become warnings that say where, while the numbers stay as they are."""

from __future__ import annotations

import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Motion, Sensor, load_experiment
from bayesid.recordings.motion_checks import Timing, wraps
from bayesid.recordings.table import Table
from bayesid.recordings.writer import write_experiment
from tests.malformed import DATA, FOLDERS, cell, table, toml, urdf, write_good
from tests.simulated import puma2


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_good(tmp_path / "arm")


def gap(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.drop(index=range(200, 230))


def lost(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.drop(index=[150, 160])


def clip(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(fx=frame["fx"].clip(upper=5.0))


def freeze(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[201:290, "q2"] = frame.loc[200, "q2"]
    return frame


def freeze_without_velocities(frame: pd.DataFrame) -> pd.DataFrame:
    return freeze(frame).drop(columns=["v1", "v2"])


def freeze_where_slow(frame: pd.DataFrame) -> pd.DataFrame:
    """From where the joint hardly moves: only the jump at the end tells."""
    slowest = int(np.argmin(np.abs(np.gradient(frame["q2"])[100:200]))) + 100
    frame.loc[slowest : slowest + 150, "q2"] = frame.loc[slowest, "q2"]
    return frame.drop(columns=["v1", "v2"])


def stall(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[201:206, "q1":] = frame.loc[200, "q1":].to_numpy()
    return frame


def stall_at_the_end(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[301:, "q1":] = frame.loc[300, "q1":].to_numpy()
    return frame


def read_too_fast(frame: pd.DataFrame) -> pd.DataFrame:
    rows = np.arange(150, 250, 20)
    frame.loc[rows, "q1":] = frame.loc[rows - 1, "q1":].to_numpy()
    return frame


def slip(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[300:, "q1"] += 1.5
    return frame


def beyond(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(q2=frame["q2"] + 2.5)


def no_masses(folder: Path) -> None:
    path = folder / "robot.urdf"
    path.write_text(re.sub(r"<inertial>.*?</inertial>", "", path.read_text(), flags=re.DOTALL))


def milligrams(folder: Path) -> None:
    path = folder / "robot.urdf"
    number = re.compile(r'(value|i[xyz]{2})="([^"]+)"')
    path.write_text(number.sub(lambda m: f'{m[1]}="{float(m[2]) * 1e-6!r}"', path.read_text()))


def against_the_stop(folder: Path) -> None:
    """A joint that is driven against its lower stop: it moves until there and goes no further."""
    toml('lower="-2.5"', 'lower="-0.31"', "robot.urdf")(folder)
    for name in ("identification.csv", "static.csv", "validation.csv"):
        table(lambda d: d.assign(q2=0.5 * d["q2"]).drop(columns=["v1", "v2"], errors="ignore"), name)(folder)
    table(lambda d: d.assign(q2=(2.0 * d["q2"]).clip(lower=-0.3)), "validation.csv")(folder)


def locked_beyond(folder: Path) -> None:
    """Limits of the locked joint, the last in the file, that end below the angle at which it stands."""
    path = folder / "robot.urdf"
    before, _, after = path.read_text().rpartition('upper="3.')
    path.write_text(f'{before}upper="-0.5{after}')


def zeros(frame: pd.DataFrame) -> pd.DataFrame:
    """Rows in which a logger wrote 0 for the angle that it did not get, one in fifty."""
    return frame.assign(q1=frame["q1"].where(frame.index % 50 != 7, 0.0))


def marked(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(fx=frame["fx"].where(frame.index % 50 != 7, -9999.0))


def no_inertial(folder: Path) -> None:
    """The link beyond the elbow keeps its shape, and loses its mass."""
    path = folder / "robot.urdf"
    text = path.read_text()
    at = text.index('<link name="lower"')
    path.write_text(text[:at] + re.sub(r"<inertial>.*?</inertial>", "<visual />", text[at:], count=1, flags=re.DOTALL))


def no_reading(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(q2=frame["q2"].where(~frame.index.isin(range(200, 221))))


def doubled(frame: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([frame, frame.iloc[50:401:50]]).sort_values("t", kind="stable")


def one_lost(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.drop(index=[150])


def lost_beside_a_gap(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.drop(index=[150, *range(200, 230)])


def late_reading(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(q1=np.where(frame.index > 0, 0.3, 0.27), v1=0.005)


DOUBTS: list[tuple[str, Callable[[Path], None], tuple[str, ...]]] = [
    ("an end stop", against_the_stop, ("validation.csv: column q2: elbow stands at -0.3", "lower end stop", "-0.31")),
    ("no inertial", no_inertial, ("robot.urdf: link lower: no <inertial>",)),
    ("gap", table(gap, "validation.csv"), ("validation.csv: column t", "gap at 1.99 to 2.3 s", "0.01 s")),
    ("lost samples", table(lost, "validation.csv"), ("validation.csv: column t: 2 samples are missing, the first after 1.49 s",)),
    ("a lost sample", table(one_lost, "validation.csv"), ("1 sample is missing, after 1.49 s", "leave rows out?")),
    ("a lost sample and a gap", table(lost_beside_a_gap, "validation.csv"),
     ("gap at 1.99 to 2.3 s; 1 sample is missing elsewhere, after 1.49 s", "pieces between gaps")),
    ("clipped channel", table(clip), ("column fx", "stays at 5", "places", "clipped")),
    ("frozen encoder", table(freeze, "validation.csv"), ("column q2: elbow stands", "from 2 to 2.9 s", "frozen")),
    ("frozen encoder, no velocities", table(freeze_without_velocities, "validation.csv"), ("column q2: elbow stands", "2.9 s")),
    ("frozen where slow", table(freeze_where_slow, "validation.csv"), ("column q2: elbow stands", "frozen")),
    ("logger stall", table(stall, "validation.csv"), ("validation.csv: 6 rows repeat", "2.01 to 2.06 s")),
    ("logger stall at the end", table(stall_at_the_end, "validation.csv"), ("rows repeat the row before", "from 3.01 to")),
    ("read too fast", table(read_too_fast, "validation.csv"), ("5 rows repeat", "each alone, the first at 1.5 s")),
    ("encoder slips", table(slip, "validation.csv"), ("column q1: shoulder jumps by 1.4", "2.99 s", "encoder")),
    ("never moves", table(lambda d: d.assign(q1=0.3, v1=0.0), "validation.csv"), ("column q1: shoulder never moves",)),
    ("at rest but for its first row", table(late_reading, "validation.csv"), ("column q1: shoulder stands at 0.3 from 0.01",)),
    ("beyond a limit", table(beyond, "validation.csv"), ("column q2: elbow", "-2.5 to 2.5 rad", "its zero")),
    ("velocity off by 1.5", table(lambda d: d.assign(v1=1.5 * d["v1"])),
     ("column v1: 1.5 times", "q1 of shoulder", "whether t is")),
    ("times 1.25 times too long", table(lambda d: d.assign(t=1.25 * d["t"]), "validation.csv"),
     ("columns v1, v2: all 1.25 times", "column t is 1.25 times too long: a sample every 0.01 s, not 0.0125 s")),
    ("times 2 times too short", table(lambda d: d.assign(t=0.5 * d["t"]), "validation.csv"),
     ("columns v1, v2: all 0.5 times", "column t is 2 times too short: a sample every 0.01 s, not 0.005 s")),
    ("dead channel", table(lambda d: d.assign(my=0.25), "validation.csv"), ("column my: 0.25 in every row",)),
    ("one empty cell", cell(7, "fz", None), ("identification.csv: column fz: 1 row without a reading (line 9, 0.07 s)",)),
    ("nan in several columns", lambda f: cell(55, "mx", "nan")(f) or cell(70, "q1", "NaN")(f),
     ("columns q1, mx: 2 rows without a reading (the first: line 57, 0.55 s)",)),
    ("nan in the static table", cell(12, "fx", "nan", "static.csv"), ("static.csv: column fx: 1 row", "line 14")),
    ("a run without readings", table(no_reading, "validation.csv"), ("validation.csv: column q2: 21 rows", "line 202, 2 s")),
    ("doubled stamps", table(doubled, "validation.csv"), ("validation.csv: column t: 8 rows at the time", "line 53, 0.5 s")),
    ("one velocity missing", table(lambda d: d.drop(columns="v1")), ("columns v2 are not used", "v1 is missing")),
    ("moving while parked", toml("[[0.0, 0.5]]", "[[0.0, 0.5], [1.0, 2.0]]"), ("[motion.0] parked: [1, 2]", "stand?")),
    ("no such period", toml("parked", "period = 1.1\nparked"), ("[motion.0] period: 1.1 s", "does not repeat")),
    ("gravity of the Moon", toml("-9.81", "-1.62"), ("[robot] gravity", "1.62")),
    ("values unused", toml("[[motion]]", '[model.values."spring@elbow"]\nrest = 0\n\n[[motion]]'), ("spring@elbow",)),
    ("noise of zero", toml("force_std = 0.5", "force_std = 0"), ("[sensor] force_std: 0",)),
    ("no validation", toml('role = "validation"', 'role = "identification"'), ('no motion has role "validation"',)),
    ("a joint too many", table(lambda d: d.assign(q3=0.0, v3=0.0)), ("columns q3, v3 are not used",)),
    ("torques for a wrench", table(lambda d: d[["t", "q1", "q2"]].assign(tau1=d.fx, tau2=d.fy), "validation.csv"),
     ("validation.csv: columns fx ... mz are missing",)),
    ("mass 0 with an inertia", urdf('<mass value="4.0"', '<mass value="0"'), ("mass 0 but an inertia: link upper",)),
    ("no masses", lambda folder: no_masses(folder), ("robot.urdf: no link but the root has a mass",)),
    ("milligrams", lambda folder: milligrams(folder), ("robot.urdf: all moving links weigh 6.5e-06 kg together",)),
    ("a joint that follows another", urdf('<axis xyz="0.0 1', '<mimic joint="shoulder" /><axis xyz="0.0 1'),
     ("robot.urdf: joint elbow mimics shoulder", "own column")),
    ("a locked joint that follows", urdf('<axis xyz="1.0 0', '<mimic joint="elbow" /><axis xyz="1.0 0'),
     ("robot.urdf: joint wrist mimics elbow", "locked")),
    ("locked in degrees", toml("wrist = 0.1", "wrist = 90"), ("[robot] locked: wrist = 90 rad", "degrees")),
    ("zeros for lost rows", table(zeros, "validation.csv"),
     ("validation.csv: column q1: shoulder jumps by", "check the encoder")),
    ("a mark for a lost reading", table(marked, "validation.csv"),
     ("validation.csv: column fx: -9999 at", "leave the cell empty")),
    ("locked beyond its limits", lambda folder: locked_beyond(folder),
     ("[robot] locked: wrist = 0.1, robot.urdf allows -3.1", "rad")),
    ("translation in millimetres", toml("[0.0, 0.0, -0.1]", "[0.0, 0.0, -100.0]"), ("[sensor] translation", "millimetres")),
    ("rpy in degrees", toml("force_std", "rpy = [0, 0, 90]\nforce_std"), ("[sensor] rpy", "degrees")),
    ("trust of ten", toml("inertia_rel_std = 0.1", "inertia_rel_std = 10"), ("[robot] inertia_rel_std: 10", "share")),
    ("impossible body", toml('ixx="0.05"', 'ixx="5.0"', "robot.urdf"), ("robot.urdf: no body can have", "link upper")),
]  # fmt: skip


#: Words that begin what is to be done about it.
REMEDY = re.compile(
    r"[;:,?] (?:or |\S+ on it says .*; )?(add|check|correct|cut|give|leave|list|lock|record|remove|unwrap|use|write)\b"
)


@pytest.mark.parametrize(("damage", "says"), [case[1:] for case in DOUBTS], ids=[case[0] for case in DOUBTS])
def test_doubts_are_warnings_that_say_where(damage: Callable[[Path], None], says: tuple[str, ...], folder: Path) -> None:
    damage(folder)
    warnings = load_experiment(folder).warnings
    assert len(warnings) == 1, warnings
    for text in says:
        assert text in warnings[0]
    assert "\n" not in warnings[0]
    assert REMEDY.search(warnings[0]), warnings[0]


def test_a_joint_that_is_held_by_a_drive_that_never_reads_zero_speed_is_not_frozen(folder: Path) -> None:
    """It dithers by a few counts late in the recording; the drive reads half a count of speed, or one more, where it stands."""

    def held(frame: pd.DataFrame) -> pd.DataFrame:
        late, count = np.arange(len(frame)) > 250, 0.0147
        speed = count * (np.arange(len(frame)) % 7 == 0) - 0.5 * count
        return frame.assign(q2=2e-4 * late * (np.arange(len(frame)) // 20 % 4), v2=speed)

    table(held, "validation.csv")(folder)
    assert not [text for text in load_experiment(folder).warnings if "frozen" in text]


def test_a_recording_of_the_parked_robot_is_meant(folder: Path) -> None:
    """Held-out readings at rest, whose joints other motions move: none of them is to be locked."""
    noise = np.random.default_rng(1).normal(size=1000)

    def parked(frame: pd.DataFrame) -> pd.DataFrame:
        read = {name: frame[name].mean() + 0.01 * noise[: len(frame)] for name in ("fx", "fy", "fz", "mx", "my", "mz")}
        return frame.assign(q1=0.3, v1=0.0, q2=-0.2, v2=0.0, **read)

    table(parked, "validation.csv")(folder)
    assert not load_experiment(folder).warnings


@pytest.mark.parametrize("header", ["t, q1 ,q2", ' t,"q1",q2 '], ids=["blanks", "quotes"])
def test_blanks_and_quotes_around_names_do_not_matter(header: str, folder: Path) -> None:
    expected = load_experiment(folder).motions[0].table
    path = folder / "identification.csv"
    path.write_text(path.read_text().replace("t,q1,q2", header, 1))
    np.testing.assert_array_equal(load_experiment(folder).motions[0].table.wrench, expected.wrench)


def test_an_error_carries_its_evidence(folder: Path) -> None:
    cell(7, "fz", "n/a")(folder)
    with pytest.raises(InputError) as caught:
        load_experiment(folder)
    error = caught.value
    assert (error.file, error.value) == ("identification.csv", "n/a") and "line 9" in error.key and "correct it" in error.remedy
    copied = pickle.loads(pickle.dumps(error))
    assert (str(copied), copied.key) == (str(error), error.key)


def test_messages_do_not_copy_what_a_table_holds(folder: Path) -> None:
    (folder / "identification.csv").write_text("SECRET=" + "x" * 500 + ",b\n1,2\n")
    with pytest.raises(InputError) as caught:
        load_experiment(folder)
    assert len(str(caught.value)) < 200 and "x" * 50 not in str(caught.value)


def test_rows_that_are_left_out_are_left_out_of_the_static_run_too(folder: Path) -> None:
    whole = load_experiment(folder).motions[0]
    cell(12, "fx", "nan", "static.csv")(folder)
    cell(70, "q1", "nan")(folder)
    motion = load_experiment(folder).motions[0]
    assert motion.static is not None and whole.static is not None and motion.stop_and_go
    rows = np.delete(np.arange(401), [12, 70])
    np.testing.assert_array_equal(motion.table.wrench, whole.table.wrench[rows])
    np.testing.assert_array_equal(motion.static.wrench, whole.static.wrench[rows])


def test_a_run_without_readings_cuts_the_recording(folder: Path) -> None:
    table(no_reading, "validation.csv")(folder)
    assert load_experiment(folder).validation[0].table.segments() == [slice(0, 200), slice(200, 380)]


def wrap(frame: pd.DataFrame) -> pd.DataFrame:
    """Both angles as an encoder of one turn counts them, from a start near its end."""
    turned = frame[["q1", "q2"]] + [2.9, -3.0]
    return frame.assign(**np.mod(turned + np.pi, 2.0 * np.pi) - np.pi)


def test_commands_that_wrap_follow_positions_that_do_not(tmp_path: Path) -> None:
    """A drive counts its turns and a planner does not: instruments of method iv jumped by a turn, and told nothing any more."""
    robot = puma2(tmp_path)
    t = np.arange(1000) / 125.0
    q = np.column_stack([1.2 * np.sin(t), 1.5 * t])
    free = replace(robot, lower=np.full(2, -np.inf), upper=np.full(2, np.inf))
    wrapped = (q + np.pi) % (2.0 * np.pi) - np.pi
    for commanded, notes in ((q, []), (wrapped, ["one: column qr2: whole turns off the positions; taken off: the same poses"])):
        motion = Motion("one", "identification", Table(t, q, torques=np.cos(q), commanded=commanded, source="one"))
        experiment = Experiment("free", free, (motion,))
        np.testing.assert_allclose(experiment.motions[0].table.commanded, q, atol=1e-12)
        assert [finding.text for finding in experiment.findings] == notes


def test_an_angle_that_wraps_is_unwrapped_and_told_once(folder: Path) -> None:
    for joint in ("-3.141592653589793", "-2.5"):
        toml(f'lower="{joint}" upper="{joint[1:]}"', 'lower="-9" upper="9"', "robot.urdf")(folder)
    expected = pd.read_csv(folder / "identification.csv")[["q1", "q2"]] + [2.9, -3.0]
    for name in ("identification.csv", "static.csv"):
        table(wrap, name)(folder)
    assert (np.abs(np.diff(pd.read_csv(folder / "identification.csv")["q1"])) > 6.0).sum() > 1
    experiment = load_experiment(folder)
    motion = experiment.motions[0]
    assert motion.static is not None
    for read in (motion.table.positions, motion.static.positions):
        np.testing.assert_allclose(read, expected, atol=1e-4)
    assert [f.text for f in experiment.findings] == list(experiment.warnings) and len(experiment.warnings) == 2
    told = experiment.warnings[0]
    assert told.startswith("identification.csv: columns q1, q2: shoulder, elbow") and "unwrapped" in told


def test_a_spike_of_many_turns_is_no_wrap() -> None:
    """One row of 3.1e5 rad was unwrapped to "the same poses", and never told."""
    t = 0.01 * np.arange(100)
    spike = np.where(np.arange(100) == 50, 3.1e5, np.sin(t))
    assert not wraps(t, spike, 0.01).any() and wraps(t, np.mod(4.0 * t + 3.0, 2.0 * np.pi), 0.01).sum() == -1.0


def test_a_whole_turn_outside_the_limits_is_taken_off(folder: Path) -> None:
    expected = load_experiment(folder).validation[0].table.positions
    table(lambda d: d.assign(q2=np.mod(d["q2"], 2.0 * np.pi)), "validation.csv")(folder)
    experiment = load_experiment(folder)
    np.testing.assert_allclose(experiment.validation[0].table.positions, expected, atol=1e-12)
    assert len(experiment.warnings) == 1 and "q2" in experiment.warnings[0]


def test_the_same_motion_cannot_validate_unnoticed(folder: Path) -> None:
    (folder / "validation.csv").write_bytes((folder / "identification.csv").read_bytes())
    assert ["the same motion" in warning for warning in load_experiment(folder).warnings] == [True]


def test_a_wrench_without_a_sensor_is_not_used(folder: Path) -> None:
    for name in ("identification.csv", "static.csv", "validation.csv"):
        table(lambda d: d.assign(tau1=d["fx"], tau2=d["fy"]), name)(folder)
    path = folder / "experiment.toml"
    text = path.read_text()
    path.write_text(text[: text.index("[sensor]")] + text[text.index("[model]") :])
    experiment = load_experiment(folder)
    assert experiment.sensor is None and experiment.motions[0].table.wrench is None
    assert len(experiment.warnings) == 3 and all("no [sensor]" in warning for warning in experiment.warnings)


def test_a_torque_of_zero_is_to_be_left_out(folder: Path) -> None:
    for name in ("identification.csv", "static.csv", "validation.csv"):
        table(lambda d: d.assign(tau1=d["fx"], tau2=0.0), name)(folder)
    (told,) = (text for text in load_experiment(folder).warnings if text.startswith("validation.csv"))
    assert "column tau2: 0 in every row" in told and "leave it out, for it is fitted as a reading" in told


def test_nothing_is_repaired(folder: Path) -> None:
    table(freeze, "validation.csv")(folder)
    expected = pd.read_csv(folder / "validation.csv")
    read = load_experiment(folder).validation[0].table
    np.testing.assert_array_equal(read.positions, expected[["q1", "q2"]])
    np.testing.assert_array_equal(read.times, expected["t"])


def test_a_smooth_peak_or_a_rest_is_not_clipping(folder: Path) -> None:
    """A noise-free reading in coarse counts holds its peaks, and its rests, without being clipped."""

    def coarse(frame: pd.DataFrame) -> pd.DataFrame:
        smooth = np.sin(np.outer(frame["t"], np.arange(1.0, 7.0)))
        names = ["fx", "fy", "fz", "mx", "my", "mz"]
        return frame.assign(**{name: np.round(column, 2) for name, column in zip(names, smooth.T, strict=True)})

    table(coarse, "validation.csv")(folder)
    assert load_experiment(folder).warnings == ()


def test_a_slow_encoder_is_not_a_wrong_velocity(folder: Path) -> None:
    """Encoder counts as large as a sample's step must not look like another unit."""
    table(lambda d: d.assign(q1=d["q1"].round(2), q2=d["q2"].round(2)), "validation.csv")(folder)
    assert load_experiment(folder).warnings == ()


def has_velocities(table: Path) -> bool:
    """Whether a file has columns v1 ... vn."""
    with table.open(encoding="utf-8") as lines:
        return "v1" in lines.readline().rstrip("\n").split(",")


WITH_VELOCITIES = [path for path in FOLDERS if any(map(has_velocities, path.glob("*.csv")))]


@pytest.mark.skipif(not FOLDERS, reason=f"no experiment folders under {DATA}; set BAYESID_DATA")
@pytest.mark.parametrize("path", WITH_VELOCITIES, ids=lambda path: path.name)
def test_velocities_in_degrees_are_found_in_recordings(path: Path, tmp_path: Path) -> None:
    experiment = load_experiment(path)
    trajectories = [m for m in experiment.motions if m.kind == "trajectory" and m.table.velocities is not None]
    copied = tmp_path / "copy"
    write_experiment(experiment, copied)
    names = [f"v{j + 1}" for j in range(experiment.robot.n)]
    frame = pd.read_csv(copied / f"{trajectories[0].name}.csv")
    frame[names] *= 180.0 / math.pi
    frame.to_csv(copied / f"{trajectories[0].name}.csv", index=False)
    with pytest.raises(InputError, match="degrees per second"):
        load_experiment(copied)


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_samples_that_are_missing_are_counted_whatever_the_stamps_jitter(late: float) -> None:
    """A clock of 1 kHz with stamps off by up to a third of a step, a hundred samples lost; stamps alone lose none."""
    rng = np.random.default_rng(4)
    ticks = np.arange(8000)
    kept = np.setdiff1d(ticks, np.concatenate([rng.choice(np.arange(50, 7950, 20), 98, replace=False), [4001, 4002]]))
    for rows, missing in ((ticks, 0), (kept, 100)):
        times = 1e-3 * (rows + late * rng.uniform(-1.0, 1.0, len(rows)))
        timing = Timing.of(Table(times=times, positions=np.zeros((len(times), 1))))
        rounded = np.round(np.diff(times) / np.median(np.diff(times))) - 1.0
        assert abs(np.maximum(rounded, 0.0).sum() - missing) > 50 or late == 0.0  # step by step they look lost
        assert abs(timing.dropped - missing) <= (5 if late else 0)
        assert timing.jitter == pytest.approx(1e-3 * late / 3**0.5, rel=0.1, abs=1e-9)


def test_all_that_is_said_of_missing_samples_has_one_count(folder: Path) -> None:
    table(lost, "validation.csv")(folder)
    inspection = bayesid.check(folder)
    said = [w for w in inspection.warnings if "missing" in w and "validation.csv" in w]
    assert len(said) == 1 and "2 samples are missing" in said[0] and "2 samples missing" in str(inspection)


def test_a_static_table_that_is_cut_out_of_its_motion_is_refused_where_the_robot_moves_there(tmp_path: Path) -> None:
    """Every other row, or all but the last; what was cut out while the robot stood still is a static table."""
    robot, rng = puma2(tmp_path), np.random.default_rng(1)
    t = np.arange(1500) / 100.0
    moved = np.where(t > 5.0, t - 5.0, 0.0)
    q = np.round(np.column_stack([np.sin(moved), np.cos(0.7 * moved)]), 4)
    whole = Table(t, q, wrench=q @ rng.normal(size=(2, 6)) + rng.normal(size=(len(t), 6)), source="one.csv")

    def given(rows: slice) -> Experiment:
        part = Table(t[rows], q[rows], wrench=whole.wrench[rows], source="still.csv")
        return Experiment("copied", robot, (Motion("one", "identification", whole, static=part),), Sensor())

    for rows in (slice(None, None, 2), slice(0, -1)):
        with pytest.raises(InputError, match="^still.csv: holds rows of one.csv in which the robot moves"):
            given(rows)
    assert given(slice(0, 480)).motions[0].static is not None
    rounded = replace(whole, wrench=np.round(whole.wrench, 3), source="still.csv")
    with pytest.raises(InputError, match="^still.csv: holds the same wrench as one.csv"):
        Experiment("copied", robot, (Motion("one", "identification", whole, static=rounded),), Sensor())
    other = replace(rounded, wrench=rounded.wrench + np.round(rng.normal(size=rounded.wrench.shape), 3))
    assert Experiment("run", robot, (Motion("one", "identification", whole, static=other),), Sensor()).motions[0].stop_and_go
