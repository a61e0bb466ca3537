"""The experiment folder: what is read, what is doubted, and that writing and reading are inverse."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bayesid.errors import InputError
from bayesid.recordings import table_reader
from bayesid.recordings.experiment import Experiment, Motion, Sensor, load_experiment, load_setup
from bayesid.recordings.schema import read_model, write_model
from bayesid.recordings.table import Table, write_table
from bayesid.recordings.table_reader import read_table
from bayesid.recordings.writer import write_experiment
from bayesid.robot.robot import load_robot
from tests.malformed import DATA, FOLDERS, recording, table, toml, write_good
from tests.simulated import experiment, puma2


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_good(tmp_path / "arm")


def table_arrays(table: Table) -> dict[str, np.ndarray]:
    values = {f.name: getattr(table, f.name) for f in fields(table) if f.name not in ("source", "dropped", "notes")}
    return {name: value for name, value in values.items() if value is not None}


# Reading.


def test_a_setup_needs_no_motion_yet(folder: Path) -> None:
    """The first motion is planned before anything is recorded; what needs recordings says so."""
    whole = load_setup(folder)
    text = (folder / "experiment.toml").read_text(encoding="utf-8")
    (folder / "experiment.toml").write_text(text.partition("[[motion]]")[0], encoding="utf-8")
    bare = load_setup(folder)
    assert not bare.motions and bare.robot.joint_names == whole.robot.joint_names
    with pytest.raises(InputError, match=r"experiment.toml: motion: is missing; write a \[\[motion\]\] with name and table"):
        load_experiment(folder)


@pytest.mark.parametrize(
    ("listed", "stated", "doubted"),
    [
        ("tether@joint2", "tether@elbow", False),
        ("tether@elbow", "tether@joint2", False),
        ("tether@elbow", "tether", False),
        ("tether", "tether@elbow", False),
        ("sensor_crosstalk@fx->mz", "sensor_crosstalk@fx->mz", False),
        ("load_torque@shoulder->elbow", "load_torque@joint1->joint2", False),
        ("tether@shoulder", "tether@joint2", True),
        ("spring", "tether", True),
    ],
)
def test_values_are_those_of_an_effect_by_any_of_its_names(folder: Path, listed: str, stated: str, doubted: bool) -> None:
    text = (folder / "experiment.toml").read_text(encoding="utf-8")
    assert text.count('effects = ["sensor_offset"]') == 1
    text = text.replace('effects = ["sensor_offset"]', f'effects = ["{listed}"]\n\n[model.values."{stated}"]\nfixed = true')
    (folder / "experiment.toml").write_text(text, encoding="utf-8")
    assert any("effects does not list it" in w for w in load_experiment(folder).warnings) == doubted


def test_a_joint_named_like_the_place_of_another_is_told(folder: Path) -> None:
    for name in ("experiment.toml", "robot.urdf"):
        text = (folder / name).read_text(encoding="utf-8").replace("shoulder", "joint2").replace("elbow", "joint1")
        text = text.replace('effects = ["sensor_offset"]', 'effects = ["tether@joint2"]')
        (folder / name).write_text(text, encoding="utf-8")
    (said,) = [w for w in load_experiment(folder).warnings if "tether" in w]
    assert said == (
        'experiment.toml: [model] "tether@joint2": joint2 is place 2 of joints, joint1, and not the URDF\'s joint2; '
        "write joint1, if that is meant"
    )


def test_everything_in_the_file_is_read(folder: Path) -> None:
    toml("[[motion]]", "[model.values.sensor_offset]\nfx = 2\nfixed = true\n\n[[motion]]")(folder)
    experiment = load_experiment(str(folder))
    assert experiment.name == "two-joint"
    assert experiment.robot.joint_names == ("shoulder", "elbow")
    assert experiment.locked == {"wrist": 0.1} and experiment.gear_ratio == {"elbow": 100.0}
    assert (experiment.inertia_rel_std, experiment.position_resolution, experiment.position_std) == (0.1, 1e-5, None)
    assert experiment.effects == ("sensor_offset",)
    assert experiment.effect_values == {"sensor_offset": {"fx": 2.0, "fixed": True}}
    sensor = experiment.sensor
    assert sensor is not None and sensor.joint is None and (sensor.force_std, sensor.torque_std) == (0.5, 0.05)
    np.testing.assert_array_equal(sensor.translation, [0.0, 0.0, -0.1])
    assert [motion.name for motion in experiment.identification] == ["identification"]
    assert [motion.name for motion in experiment.validation] == ["validation"]
    motion = experiment.motions[0]
    assert motion.parked == ((0.0, 0.5),) and motion.period is None and motion.stop_and_go
    assert motion.table.torques is None and motion.static is not None and motion.static.velocities is None
    assert not experiment.motions[1].stop_and_go
    expected = np.genfromtxt(folder / "identification.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(motion.table.wrench, np.column_stack([expected[c] for c in "fx fy fz mx my mz".split()]))
    np.testing.assert_array_equal(motion.table.positions, np.column_stack([expected["q1"], expected["q2"]]))


def test_arrays_are_read_only_and_float64(folder: Path) -> None:
    experiment = load_experiment(folder)
    assert experiment.sensor is not None
    for array in [experiment.sensor.rpy, *table_arrays(experiment.motions[0].table).values()]:
        assert array.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_a_table_leaves_the_callers_arrays_alone() -> None:
    times = np.arange(3.0)
    kept = Table(times=times, positions=np.zeros((3, 1)))
    assert np.shares_memory(kept.times, times)  # a view: recordings are long
    assert times.flags.writeable and not kept.times.flags.writeable


def test_column_order_other_columns_and_blank_lines_do_not_matter(folder: Path) -> None:
    before = load_experiment(folder).motions[0].table
    table(lambda d: d.assign(note="a, b", temperature=np.nan)[["note", *d.columns[::-1], "temperature"]])(folder)
    path = folder / "identification.csv"
    path.write_text("\ufeff" + path.read_text().replace("\n", "\n\n").replace(",", ", "), encoding="utf-8")
    after = load_experiment(folder)
    assert after.warnings == ()
    for name, array in table_arrays(before).items():
        np.testing.assert_array_equal(array, getattr(after.motions[0].table, name))


def test_blocks_of_rows_are_joined_in_order(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = load_experiment(folder).motions[0].table
    monkeypatch.setattr(table_reader, "_BLOCK_ROWS", 7)
    monkeypatch.setattr(table_reader, "_BLOCK_BYTES", 100)
    pieces = load_experiment(folder).motions[0].table
    for name, array in table_arrays(whole).items():
        np.testing.assert_array_equal(array, getattr(pieces, name))
    (folder / "identification.csv").write_text((folder / "identification.csv").read_text() + "9,9,9,9,9,9,9,9,9,9,9,9\n")
    with pytest.raises(InputError, match="line 403: 12 cells"):
        load_experiment(folder)


def test_static_poses_may_have_other_rows(folder: Path) -> None:
    table(lambda d: d.iloc[::40], "static.csv")(folder)
    motion = load_experiment(folder).motions[0]
    assert motion.static is not None and len(motion.static) == 11 and not motion.stop_and_go


def test_poses_need_neither_many_rows_nor_even_times(folder: Path) -> None:
    poses = recording(0).iloc[[60, 130, 200]].assign(t=[0, 1, 50], v1=0.0, v2=0.0)
    poses.to_csv(folder / "identification.csv", index=False)
    toml('static = "static.csv"\nparked = [[0.0, 0.5]]', 'kind = "poses"')(folder)
    experiment = load_experiment(folder)
    assert experiment.motions[0].kind == "poses" and experiment.warnings == ()


def test_segments_are_cut_at_gaps_only() -> None:
    steps = np.array([0.01] * 10 + [0.03] + [0.01] * 10 + [1.0] + [0.01] * 5)
    times = np.append(0.0, np.cumsum(steps))
    table = Table(times=times, positions=np.zeros((len(times), 1)))
    assert table.segments() == [slice(0, 22), slice(22, 28)]
    assert table.step == pytest.approx(0.01) and len(table) == 28
    assert Table(times=times[:1], positions=np.zeros((1, 1))).segments() == [slice(0, 1)]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (dict(times=np.arange(3.0), positions=np.zeros(3)), "positions have shape"),
        (dict(times=np.arange(2.0), positions=np.zeros((3, 1))), "times have shape"),
        (dict(times=np.arange(3.0), positions=np.zeros((3, 2)), torques=np.zeros((3, 1))), "torques have shape"),
        (dict(times=np.arange(3.0), positions=np.array([[0.0], [np.inf], [0.0]])), "row 1: not finite"),
        (dict(times=np.array([0.0, 1.0, 0.5]), positions=np.zeros((3, 1))), "row 2: time goes back"),
        (dict(times=np.zeros(3), positions=np.zeros((3, 1))), "row 1: time is repeated"),
        (dict(times=np.arange(3.0), positions=np.zeros((1, 3)).T, wrench=np.zeros((6, 3))), "samples first"),
        (dict(times=np.arange(3.0), positions=np.zeros((2, 3))), "give \\(3, 2\\), samples first"),
        (dict(times=["a", "b"], positions=np.zeros((2, 1))), "times: are no array of numbers"),
        (dict(times=np.arange(2.0), positions=[[1.0], [1.0, 2.0]]), "positions: are no array of numbers"),
        (dict(times=[], positions=np.zeros((0, 1))), "no rows"),
    ],
)
def test_a_table_made_in_memory_is_checked(arguments: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Table(**arguments)


def test_objects_made_in_memory_are_checked(folder: Path) -> None:
    experiment = load_experiment(folder)
    with pytest.raises(InputError, match="translation"):
        Sensor(translation=np.zeros(2))
    motion = Motion("one", "identification", experiment.motions[0].table)
    with pytest.raises(InputError, match='two motions are named "one"'):
        Experiment("twice", experiment.robot, (motion, motion))
    narrow = Motion("one", "identification", Table(times=np.arange(3.0), positions=np.zeros((3, 1))))
    with pytest.raises(InputError, match="1 joints but the robot has 2"):
        Experiment("narrow", experiment.robot, (narrow,))


# Parquet.


def test_parquet_without_pyarrow_says_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (folder / "validation.parquet").write_bytes(b"PAR1")
    toml("validation.csv", "validation.parquet")(folder)
    with pytest.raises(InputError, match=r"validation.parquet: .*bayesid\[parquet\]"):
        load_experiment(folder)


def test_parquet_reads_as_csv_does(folder: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    expected = load_experiment(folder).validation[0].table
    pd.read_csv(folder / "validation.csv").assign(note="x").to_parquet(folder / "validation.parquet")
    toml("validation.csv", "validation.parquet")(folder)
    read = load_experiment(folder).validation[0].table
    for name, array in table_arrays(expected).items():
        np.testing.assert_array_equal(array, getattr(read, name))


@pytest.mark.parametrize("text", ["-nan", "nan(ind)", "-nan(ind)", "+NaN"])
def test_a_number_that_c_prints_as_none_is_a_reading_that_is_missing(text: str, folder: Path) -> None:
    rows = (folder / "validation.csv").read_text(encoding="utf-8").splitlines()
    cells = rows[10].split(",")
    rows[10] = ",".join([*cells[:1], text, *cells[2:]])
    (folder / "validation.csv").write_text("\n".join(rows), encoding="utf-8")
    assert load_experiment(folder).validation[0].table.dropped.tolist() == [9]


def test_parquet_with_an_index_is_read_by_its_columns(folder: Path) -> None:
    """pandas writes the index as a column, and makes one of it again on reading: times were no column then."""
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    expected = load_experiment(folder).validation[0].table
    pd.read_csv(folder / "validation.csv").set_index("t").to_parquet(folder / "validation.parquet")
    toml("validation.csv", "validation.parquet")(folder)
    np.testing.assert_array_equal(load_experiment(folder).validation[0].table.times, expected.times)


@pytest.mark.parametrize("name", ["validation.csv", "validation.parquet"])
def test_torques_of_no_joint_at_all_are_none(name: str, folder: Path) -> None:
    """Columns that a logger writes and never fills; they ended in a warning of numpy's."""
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    frame = pd.read_csv(folder / "validation.csv").assign(tau1=np.nan, tau2=np.nan)
    frame.to_csv(folder / name, index=False) if name.endswith("csv") else frame.to_parquet(folder / name)
    toml("validation.csv", name)(folder)
    assert load_experiment(folder).validation[0].table.torques is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.assign(q1="a"), "column q1: holds"),
        (lambda d: d.assign(q1=np.nan), "column q1: no reading in any row"),
        (lambda d: d.assign(q1=np.inf), "column q1, row 0: inf"),
        (lambda d: d.drop(columns="q2"), "column q2 is missing"),
        (lambda d: d.iloc[:0], "no rows"),
        (lambda d: d.assign(t=1.0), "row 1: time is repeated"),
    ],
)
def test_malformed_parquet(change: Callable[[pd.DataFrame], pd.DataFrame], says: str, folder: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    change(pd.read_csv(folder / "validation.csv")).to_parquet(folder / "validation.parquet")
    toml("validation.csv", "validation.parquet")(folder)
    with pytest.raises(InputError, match=f"validation.parquet: .*{says}"):
        load_experiment(folder)


def test_a_file_that_is_no_parquet(folder: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    (folder / "validation.parquet").write_bytes(b"t,q1,q2\n")
    toml("validation.csv", "validation.parquet")(folder)
    with pytest.raises(InputError, match="validation.parquet: not a Parquet file"):
        load_experiment(folder)


# Writing.

FINITE = st.floats(-1e12, 1e12)


@settings(max_examples=100, deadline=None)
@given(data=st.data(), rows=st.integers(1, 8), joints=st.integers(1, 3))
def test_any_table_survives_csv_to_the_last_bit(data: st.DataObject, rows: int, joints: int) -> None:
    times = np.sort(data.draw(arrays(np.float64, rows, elements=st.floats(-1e12, 1e12), unique=True)))
    optional = {}
    for name, width in dict(velocities=joints, commanded=joints, torques=joints, wrench=6).items():
        if data.draw(st.booleans()):
            optional[name] = data.draw(arrays(np.float64, (rows, width), elements=FINITE))
    positions = data.draw(arrays(np.float64, (rows, joints), elements=FINITE))
    written = Table(times=times, positions=positions, source="table.csv", **optional)
    with tempfile.TemporaryDirectory() as folder:
        write_table(written, Path(folder) / "table.csv")
        read, warnings = read_table(Path(folder) / "table.csv", "table.csv", joints)
    assert warnings == [] and table_arrays(read).keys() == table_arrays(written).keys()
    for name, array in table_arrays(written).items():
        np.testing.assert_array_equal(array, getattr(read, name))


STD = st.none() | st.floats(1e-9, 10.0)
NUMBER = st.floats(-3.0, 3.0)
NAME = st.text(st.characters(blacklist_characters='/\\,"', blacklist_categories=["C", "Z"]), min_size=1, max_size=12).filter(
    lambda text: not text.startswith(".") and text.isprintable()
)


@st.composite
def experiments(draw: st.DrawFn, robot_folder: Path) -> Experiment:
    gravity = draw(st.lists(NUMBER, min_size=3, max_size=3))
    joint = draw(st.sampled_from([None, "shoulder", "elbow", "flange_joint"]))
    robot = load_robot(robot_folder / "robot.urdf", ["elbow", "shoulder"], {"wrist": 0.2}, gravity, joint)
    source = load_experiment(robot_folder)
    names = draw(st.lists(NAME, min_size=1, max_size=3, unique=True))
    motions = []
    for index, name in enumerate(names):
        motion = source.motions[draw(st.integers(0, 1))]
        role = "identification" if index == 0 else draw(st.sampled_from(["identification", "validation"]))
        static = replace(motion.table, wrench=motion.table.wrench + 1.0) if draw(st.booleans()) else None
        parked = draw(st.lists(st.tuples(st.floats(0.0, 0.5), st.floats(1.0, 4.0)), max_size=2))
        motions.append(
            Motion(name, role, motion.table, static=static, period=draw(STD.filter(_possible_period)), parked=tuple(parked))
        )
    sensor = Sensor(
        joint=joint,
        translation=np.array(draw(st.lists(NUMBER, min_size=3, max_size=3))),
        rpy=np.array(draw(st.lists(NUMBER, min_size=3, max_size=3))),
        force_std=draw(STD),
        torque_std=draw(STD),
    )
    values = draw(
        st.dictionaries(st.sampled_from(["tether@elbow", "a@b->c"]), st.dictionaries(st.sampled_from("abc"), FINITE), max_size=2)
    )
    return Experiment(
        name=draw(NAME), robot=robot, sensor=sensor, motions=tuple(motions),
        effects=tuple(draw(st.lists(st.sampled_from(["spring", "tether@elbow", "sensor_crosstalk@fx->mz"]), unique=True))),
        effect_values=values, inertia_rel_std=draw(STD), position_resolution=draw(STD), position_std=draw(STD),
        gear_ratio=draw(st.dictionaries(st.sampled_from(["elbow", "shoulder"]), st.floats(0.1, 200.0))),
    )  # fmt: skip


def _possible_period(period: float | None) -> bool:
    return period is None or 0.02 <= period <= 4.0


@pytest.fixture(scope="module")
def robot_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_good(tmp_path_factory.mktemp("source") / "arm")


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_an_experiment_survives_its_folder(data: st.DataObject, robot_folder: Path) -> None:
    written = data.draw(experiments(robot_folder))
    with tempfile.TemporaryDirectory() as parent:
        target = Path(parent) / "new" / "folder"
        write_experiment(written, target)
        assert [path.name for path in target.parent.iterdir()] == ["folder"]
        read = load_experiment(target)
        assert (target / "robot.urdf").read_bytes() == written.robot.urdf.read_bytes()
    same = "name effects effect_values inertia_rel_std position_resolution position_std gear_ratio locked".split()
    for key in same:
        assert getattr(read, key) == getattr(written, key), key
    assert read.robot.joint_names == written.robot.joint_names
    np.testing.assert_array_equal(read.robot.gravity, written.robot.gravity)
    assert read.sensor is not None and written.sensor is not None
    for f in fields(Sensor):
        np.testing.assert_array_equal(getattr(read.sensor, f.name), getattr(written.sensor, f.name))
    assert len(read.motions) == len(written.motions)
    for one, other in zip(read.motions, written.motions, strict=True):
        for key in ("name", "role", "kind", "period", "parked", "stop_and_go"):
            assert getattr(one, key) == getattr(other, key), key
        for name, array in table_arrays(other.table).items():
            np.testing.assert_array_equal(array, getattr(one.table, name))


def test_an_experiment_of_parts_is_of_the_robot_as_it_was_read(robot_folder: Path, tmp_path: Path) -> None:
    """Locked joints stand where `load_robot` was told, behind a folder, too; a sensor must be where it was told."""
    robot = load_robot(robot_folder / "robot.urdf", ["elbow", "shoulder"], {"wrist": 0.2}, sensor_joint="flange_joint")
    (motion,) = load_experiment(robot_folder).identification
    whole = Experiment("parts", robot, (motion,), Sensor("flange_joint"))
    write_experiment(whole, tmp_path / "parts")
    np.testing.assert_array_equal(load_experiment(tmp_path / "parts").robot.nominal, robot.nominal)
    arrays = Experiment.from_arrays(robot, motion.table.times, motion.table.positions, wrench=motion.table.wrench)
    assert arrays.locked == {"wrist": 0.2} and arrays.sensor is not None and arrays.sensor.joint == "flange_joint"
    with pytest.raises(InputError, match=r"sensor is under the base, but the robot was read for one in flange_joint"):
        replace(whole, sensor=Sensor())
    with pytest.raises(InputError, match=r"locked = \{'wrist': 0.3\}, but the robot was read with \{'wrist': 0.2\}"):
        replace(whole, locked={"wrist": 0.3})


def test_nothing_is_overwritten(folder: Path, tmp_path: Path) -> None:
    experiment = load_experiment(folder)
    before = (folder / "experiment.toml").read_bytes()
    with pytest.raises(InputError, match="is there already"):
        write_experiment(experiment, folder)
    assert (folder / "experiment.toml").read_bytes() == before
    with pytest.raises(InputError, match="is there already"):
        write_experiment(experiment, folder / "robot.urdf")
    with pytest.raises(InputError, match="cannot be written"):
        write_experiment(experiment, folder / "robot.urdf" / "below")
    empty = tmp_path / "empty"
    empty.mkdir()
    write_experiment(experiment, empty)
    assert load_experiment(empty).warnings == ()


def test_a_failed_write_leaves_nothing(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = load_experiment(folder)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bayesid.recordings.writer.write_table", full)
    with pytest.raises(InputError, match="cannot be written"):
        write_experiment(experiment, tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["arm"]


def test_a_model_file_replaces_the_model(folder: Path, tmp_path: Path) -> None:
    values: dict[str, dict[str, float | bool]] = {"tether@elbow": {"stiffness": 40.0, "fixed": True}, "spring": {}}
    write_model(("spring", "tether@elbow"), values, tmp_path / "model.toml")
    assert read_model(tmp_path / "model.toml") == (("spring", "tether@elbow"), values, {})
    changed = load_experiment(folder).with_model(tmp_path / "model.toml")
    assert changed.effects == ("spring", "tether@elbow") and changed.effect_values == values
    assert changed.sensor is not None and changed.name == "two-joint"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[model]\neffects = ['a', 'a']", "listed twice"),
        ("effects = ['a']", "effects: unknown key"),
        ("format = 1", "model: is missing"),
        ("[model]\nefects = []", 'did you mean "effects"'),
        ("[model.values.spring]\nfixed = 1", r"\[model.values.spring\] fixed: 1 is not true or false"),
        ("[model.values]\nspring = 1", r"\[model.values\] spring: 1 is not a table"),
    ],
)
def test_a_malformed_model_file(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(text)
    with pytest.raises(InputError, match=f"model.toml: .*{says}"):
        read_model(tmp_path / "model.toml")


# Real recordings.


@pytest.mark.skipif(not FOLDERS, reason=f"no experiment folders under {DATA}; set BAYESID_DATA")
@pytest.mark.parametrize("path", FOLDERS, ids=lambda path: path.name)
def test_recordings_load_without_doubts(path: Path) -> None:
    """But for a hidden clipped channel, and for a URDF with points for links: these are told, and nothing else."""
    experiment = load_experiment(path)
    right = {"practice-15": ("column mx", "as if clipped"), "ur10": ("links j2, j3", "mass within 20 mm of one point")}
    if path.name in right:
        (said,) = experiment.warnings
        assert all(part in said for part in right[path.name])
    else:
        assert experiment.warnings == ()
    assert experiment.identification and experiment.validation
    assert all(len(motion.table) for motion in experiment.motions)


def test_an_experiment_is_a_collection_of_its_motions(tmp_path: Path) -> None:
    """A motion by its name, all one after the other, and a row each in a table."""
    table = Table(0.01 * np.arange(50), np.zeros((50, 2)), torques=np.ones((50, 2)))
    motions = [Motion("one", "identification", table), Motion("two", "validation", table[::2])]
    loaded = experiment(puma2(tmp_path), motions)
    assert loaded["two"] is loaded.motions[1] and list(loaded) == list(loaded.motions)
    with pytest.raises(KeyError, match="no motion is named 'three'; there are one, two"):
        loaded["three"]
    rows = loaded.to_dataframe()
    assert list(rows["motion"]) == ["one", "two"] and list(rows["samples"]) == [50, 25]
    assert rows["rate_hz"].tolist() == pytest.approx([100.0, 50.0]) and set(rows["readings"]) == {"tau1, tau2"}


def test_samples_of_a_table_are_picked_as_those_of_an_array(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    table = Table(0.01 * np.arange(50), rng.normal(size=(50, 2)), wrench=rng.normal(size=(50, 6)), source="arm.csv")
    first, mask = table[:20], table.positions[:, 0] > 0
    assert len(first) == 20 and first.velocities is None and first.source == "arm.csv"
    np.testing.assert_array_equal(first.wrench, table.wrench[:20])
    np.testing.assert_array_equal(table[mask].positions, table.positions[mask])
    np.testing.assert_array_equal(table[-1].times, table.times[-1:])
    with pytest.raises(IndexError):
        table[50]
    with pytest.raises(InputError, match="times must strictly increase"):
        table[::-1]
    frame = table.to_dataframe()
    assert list(frame.columns) == ["t", "q1", "q2", "fx", "fy", "fz", "mx", "my", "mz"]
    np.testing.assert_array_equal(frame[["q1", "q2"]], table.positions)
