"""Experiments from arrays: the same numbers as from files, and the same checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Motion, Sensor, load_experiment
from bayesid.recordings.table import Table
from bayesid.recordings.writer import write_experiment
from tests.malformed import write_good
from tests.simulated import experiment, fourier, puma2, recording

Q, TAU = ["q1", "q2"], ["tau1", "tau2"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.DataFrame, pd.DataFrame]:
    """A folder with a robot that carries no sensor, and its two recordings as data frames."""
    folder = tmp_path_factory.mktemp("arrays")
    (folder / "model").mkdir()
    robot = puma2(folder / "model")
    motions = [
        Motion(
            name, role, recording(robot, None, fourier(robot, seed, duration=12.0), seed=seed, torque_std=0.05, resolution=1e-4)
        )
        for name, role, seed in (("identification", "identification", 1), ("validation", "validation", 2))
    ]
    write_experiment(experiment(robot, motions, None, position_resolution=1e-4), folder / "arm")
    return folder / "arm", *(pd.read_csv(folder / "arm" / f"{motion.name}.csv") for motion in motions)


def made(arm: tuple[Path, pd.DataFrame, pd.DataFrame], change=lambda frame: frame, **more) -> Experiment:
    folder, first, later = arm
    first = change(first.copy())
    given = dict(
        torques=first[TAU], validation=dict(t=later.t, q=later[Q], torques=later[TAU]), joints=["joint1", "joint2"],
        locked=load_experiment(folder).locked, position_resolution=1e-4, name="arm",
    )  # fmt: skip
    return Experiment.from_arrays(folder / "robot.urdf", first["t"], first[Q], **(given | more))


def test_arrays_and_files_give_the_same_estimate(arm) -> None:
    from_file, from_arrays = bayesid.identify(arm[0]), bayesid.identify(made(arm))
    np.testing.assert_array_equal(from_arrays.values, from_file.values)
    np.testing.assert_array_equal(from_arrays.covariance, from_file.covariance)
    assert from_arrays.warnings == from_file.warnings


def test_a_buffer_that_is_read_into_again_leaves_the_experiment_as_it_was(arm) -> None:
    """Arrays were views: the next recording, read into the same memory, changed the one that was made before."""
    folder, first, _ = arm
    robot, buffers = load_experiment(folder).robot, {key: first[names].to_numpy() for key, names in (("q", Q), ("torques", TAU))}
    one = Experiment.from_arrays(robot, first["t"].to_numpy(), buffers["q"], torques=buffers["torques"])
    before = one.motions[0].table.positions.copy(), one.motions[0].table.torques.copy()
    for buffer in buffers.values():
        buffer[:] = 0.0
    np.testing.assert_array_equal(one.motions[0].table.positions, before[0])
    np.testing.assert_array_equal(one.motions[0].table.torques, before[1])


@pytest.mark.parametrize("kind", [list, np.asarray, pd.DataFrame])
def test_lists_arrays_and_frames_are_one(arm, kind) -> None:
    _, first, _ = arm
    t = list(first.t) if kind is list else first.t
    q, tau = (first[names].values.tolist() if kind is list else kind(first[names]) for names in (Q, TAU))
    table = Table(t, q, torques=tau)
    np.testing.assert_array_equal(table.positions, first[Q])
    np.testing.assert_array_equal(table.torques, first[TAU])
    assert all(type(array) is np.ndarray for array in (table.times, table.positions, table.torques))


def test_dates_and_durations_count_from_the_first(arm) -> None:
    _, first, _ = arm
    dates = pd.Timestamp("2026-03-01") + pd.to_timedelta(first.t, unit="s")
    there = pd.DatetimeIndex(dates).tz_localize("Europe/Rome")  # the clocks of a country, and Python's own
    kinds = (dates, pd.DatetimeIndex(dates), dates.to_numpy(), pd.to_timedelta(first.t, unit="s"), there, pd.Series(there))
    for times in kinds:
        np.testing.assert_allclose(Table(times, first[Q]).times, first.t - first.t[0], atol=1e-8)
    np.testing.assert_allclose(Table(list(there.to_pydatetime()), first[Q]).times, first.t - first.t[0], atol=1e-6)
    late = dates.to_numpy().copy()
    late[0] = "NaT"
    np.testing.assert_allclose(Table(late, first[Q]).times, first.t[1:] - first.t[1], atol=1e-8)


def test_what_numpy_masks_is_a_reading_that_is_missing(arm) -> None:
    _, first, _ = arm
    positions = np.ma.masked_array(first[Q].to_numpy(), mask=False)
    positions[4, 1] = np.ma.masked
    times = np.ma.masked_array(first.t.to_numpy(), mask=np.arange(len(first)) == 7)
    table = Table(times, positions, torques=first[TAU])
    np.testing.assert_array_equal(table.times, np.delete(first.t, [4, 7]))
    np.testing.assert_array_equal(table.torques, np.delete(first[TAU], [4, 7], axis=0))


def test_what_pandas_calls_missing_is_a_reading_that_is_missing(arm) -> None:
    _, first, _ = arm
    torques = first[TAU].astype("Float64")
    torques.loc[4, "tau1"] = pd.NA
    np.testing.assert_array_equal(Table(first.t, first[Q], torques=torques).torques, np.delete(first[TAU], 4, axis=0))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.assign(t=1e3 * d.t), "identification: column t.*milliseconds"),
        (lambda d: d.assign(**np.rad2deg(4.0 * d[Q])), "identification: column q1.*degrees"),
        (lambda d: d.iloc[::-1], "row 1: time goes back"),
        (lambda d: d.assign(tau1=0.0, tau2=0.0), "0 in every row"),
        (lambda d: d.assign(tau1=np.inf), "torques, row 0: not finite"),
        (lambda d: d.head(10), "10 rows are no trajectory"),
        (lambda d: d.head(1), "1 rows are no trajectory"),
    ],
)
def test_what_a_file_is_refused_for_arrays_are(change, says: str, arm) -> None:
    with pytest.raises(InputError, match=says):
        made(arm, change)
    frame = change(arm[1].copy())  # and put together by hand
    with pytest.raises(InputError):
        motion = Motion("identification", "identification", Table(frame.t, frame[Q], torques=frame[TAU]))
        Experiment("by hand", load_experiment(arm[0]).robot, (motion,))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (dict(joints=None, locked=None), "q has 2 columns but robot.urdf has 6 moving joints"),
        (dict(torques=None), "torques and wrench are missing; give one"),
        (dict(torques=None, sensor=Sensor()), "wrench is missing although a sensor is given"),
        (dict(torques=np.zeros((5, 2))), "torques have shape"),
        (dict(validation=dict(t=[0.0], q=[[0.0, 0.0]], tau=[[1.0, 1.0]])), "validation: tau: no such array"),
        (dict(validation=dict(t=[0.0])), "validation: q is missing"),
        (dict(kind="pose"), "kind = 'pose'"),
        (dict(validation=pd.DataFrame({"t": [0.0]})), "validation: is a DataFrame; give dict"),
        (dict(joints=["joint1", "joint1"], locked={}), "joint 'joint1' is listed twice"),
        (dict(joints=["joint1", "joint2"], locked={"joint2": 0.0}), "joint 'joint2' is one of joints and locked, too"),
        (dict(locked={"joint3": np.nan}), "joint 'joint3' is locked at nan; write where it stands"),
        (dict(locked={"joint3": "-2.48"}), "joint 'joint3' is locked at -2.48; write where it stands"),
        (dict(joints="joint9"), "joint 'joint9' is not in robot.urdf"),
        (dict(gravity=-9.81), "gravity: -9.81 will not do; give three numbers"),
        (dict(sensor={"joint": "joint9"}), "sensor: is a dict; give a Sensor"),
        (dict(gravity=[0.0, -9.81]), "gravity: .* will not do; give three numbers"),
        (dict(gravity=[0.0, 0.0, np.nan]), "gravity: .* will not do"),
        (dict(sensor="joint9"), "sensor joint 'joint9' is not in robot.urdf"),
        (dict(inertia_rel_std=-0.1), "inertia_rel_std: -0.1 is out of range"),
        (dict(position_resolution=np.nan), "position_resolution: nan is out of range"),
        (dict(gear_ratio={"joint9": 100.0}), 'gear_ratio: "joint9" is not one of joints; did you mean'),
        (dict(gear_ratio={"joint1": 0.0}), "gear_ratio: joint1 = 0.0 is out of range"),
    ],
)
def test_wrong_arguments_are_told_in_python_s_words(arguments: dict, says: str, arm) -> None:
    with pytest.raises(InputError, match=says) as caught:
        made(arm, **arguments)
    assert "experiment.toml" not in str(caught.value) and "\n" not in str(caught.value)


def test_columns_that_are_called_as_the_joints_stand_in_their_order(arm) -> None:
    """As those of a JointState often do not: the numbers of one joint were taken for those of another."""
    _, first, _ = arm
    ours, turned = ["joint1", "joint2"], ["joint2", "joint1"]
    torques = first[TAU].set_axis(ours, axis=1)
    with pytest.raises(
        InputError, match="identification: torques: the columns are joint2, joint1, not joint1, joint2; give them"
    ):
        made(arm, torques=torques[turned])
    made(arm, torques=torques)
    wrench = pd.DataFrame(np.ones((len(first), 6)), columns=["mx", "my", "mz", "fx", "fy", "fz"])
    with pytest.raises(InputError, match="wrench: the columns are mx, .*, not fx, .*; give them in this order$"):
        made(arm, wrench=wrench)


def test_parts_of_another_kind_are_refused_in_one_line(arm) -> None:
    folder, first, _ = arm
    setup = load_experiment(folder)
    motion = setup.motions[0]
    for said, parts in {
        "robot is a str; give bayesid.load_robot": ("robot.urdf", (motion,)),
        "a motion is a Table; give bayesid.Motion": (setup.robot, (motion.table,)),
        "the table of a is a DataFrame; give bayesid.Table": (setup.robot, (Motion("a", "identification", first),)),
        "sensor is a str; give bayesid.Sensor": (setup.robot, (motion,), "base"),
    }.items():
        with pytest.raises(InputError, match=f"experiment parts: {said}"):
            Experiment("parts", *parts)
    one = Experiment("parts", setup.robot, motion, effects="viscous_friction, coulomb_friction")
    assert one.motions == (motion,) and one.effects == ("viscous_friction", "coulomb_friction")


def test_locked_may_be_a_series(arm) -> None:
    locked = pd.Series(load_experiment(arm[0]).locked)
    assert made(arm, locked=locked, validation=None).locked == dict(locked)


@pytest.mark.parametrize("asked", [dict(joints=["joint2", "joint1"]), dict(gravity=[0.0, 0.0, 9.81])])
def test_a_robot_that_was_loaded_otherwise_is_refused(asked: dict, arm) -> None:
    """Joints and gravity beside such a robot were ignored."""
    folder, first, _ = arm
    setup = load_experiment(folder)
    given = dict(torques=first[TAU], joints=["joint1", "joint2"], locked=setup.locked)
    assert Experiment.from_arrays(setup.robot, first.t, first[Q], **given).robot is setup.robot
    with pytest.raises(InputError, match=f"{next(iter(asked))} = .*, but the robot was loaded with"):
        Experiment.from_arrays(setup.robot, first.t, first[Q], **(given | asked))


def test_joints_that_are_locked_are_not_among_those_that_move(arm) -> None:
    """Unless all that move are named, these are all others; that they are locked was ignored."""
    expected = made(arm)
    found = made(arm, joints=None, locked={f"joint{k}": 0.0 for k in (3, 4, 5, 6)} | expected.locked)
    assert found.robot.joint_names == ("joint1", "joint2")
    np.testing.assert_array_equal(found.robot.nominal, expected.robot.nominal)


def test_effects_and_a_sensor_are_named_as_elsewhere(arm) -> None:
    assert made(arm, effects="viscous_friction, coulomb_friction").effects == ("viscous_friction", "coulomb_friction")
    assert made(arm, sensor="base", torques=None, wrench=np.ones((len(arm[1]), 6)) * arm[1].t.to_numpy()[:, None]).sensor
    for key in ("force_std", "torque_std"):
        for std in (0.0, -1.0, np.nan):
            with pytest.raises(InputError, match=f"sensor {key}: .* is no sensor's noise"):
                Sensor(**{key: std})


def test_what_could_not_be_read_again_is_not_written(arm, tmp_path: Path) -> None:
    """A folder that was written had a name which `load_experiment` refuses."""
    with pytest.raises(InputError, match='experiment.toml: name: "a/b" will not do'):
        write_experiment(made(arm, name="a/b"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_holes_and_repeats_are_left_out_and_told_once(arm) -> None:
    def damaged(frame: pd.DataFrame) -> pd.DataFrame:
        frame.loc[200:260, "q2"] = np.nan
        frame.loc[700, "t"] = frame.loc[699, "t"]
        return frame

    found = made(arm, damaged)
    table, whole = found.motions[0].table, made(arm).motions[0].table
    rows = np.delete(np.arange(len(whole)), [*range(200, 261), 700])
    np.testing.assert_array_equal(table.positions, whole.positions[rows])
    assert [s.stop - s.start for s in table.segments()] == [200, len(rows) - 200]
    assert len(found.findings) == 2 and found.warnings == tuple(f.text for f in found.findings)
    assert bayesid.check(found).warnings == found.warnings
    estimate, reference = bayesid.identify(found), bayesid.identify(made(arm))
    assert estimate.warnings[:2] == found.warnings
    np.testing.assert_allclose(estimate.values, reference.values, atol=5.0 * float(np.max(reference.std)))


def test_an_experiment_changed_in_part_is_not_examined_again(arm) -> None:
    from dataclasses import replace

    one = made(arm, lambda d: d.assign(q1=d.q1.where(d.index != 5)))
    again = replace(one, motions=one.motions[:1], effects=("viscous_friction",))
    assert again.warnings == one.warnings and again.motions[0].table is one.motions[0].table


def test_a_wrench_without_a_sensor_is_one_under_the_base(tmp_path: Path) -> None:
    folder = write_good(tmp_path / "arm")
    frame = pd.read_csv(folder / "identification.csv")
    given = Experiment.from_arrays(
        folder / "robot.urdf", frame.t, frame[Q], wrench=frame[["fx", "fy", "fz", "mx", "my", "mz"]],
        joints=["shoulder", "elbow"], locked={"wrist": 0.1},
    )  # fmt: skip
    assert given.sensor is not None and given.sensor.joint is None
    assert given.warnings == ('no motion has role "validation"; pass validation=..., to test the estimate on a held-out motion',)
