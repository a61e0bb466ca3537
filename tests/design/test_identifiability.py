"""Classes and ranks against the null space of Pinocchio's own regressors, advice against motions that follow it."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.effects.surroundings import STILL
from bayesid.regression.problem import prepare
from bayesid.results.identifiability import effect_lines
from bayesid.robot.robot import load_robot
from bayesid.rounding import number
from bayesid.simulation.trajectories import fourier_trajectory
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf
from tests import robots
from tests.example_robots import paper_base_map
from tests.robots import write
from tests.simulated import experiment, fourier, puma2, recording

TWO = (puma_two_joint_urdf, ["joint1", "joint2"], PAPER_LOCKED)
ARMS = {"puma2": TWO, "ur5": (robots.ur5,), "panda": (robots.panda,), "lwr4": (robots.lwr4,)}
#: Known ranks: wrench less a static run, offsets fitted, offsets known; torque; both, offsets fitted, offsets known.
RANKS = {
    "puma2": (12, 12, 13, 8, 12, 13), "ur5": (40, 40, 41, 36, 40, 41),
    "panda": (47, 47, 48, 43, 47, 48), "lwr4": (47, 47, 48, 43, 47, 48),
}  # fmt: skip


def load(name, folder):
    urdf, *selected = ARMS[name]
    return load_robot(write(folder, urdf()), *selected)


def pinocchio_rows(robot, wrench, torque, gravity, offset, q, v, a):
    """Rows of the links beyond the base, by `pin.computeJointTorqueRegressor` of a floating robot; offsets projected out."""
    model = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelFreeFlyer())
    model.gravity.linear = robot.gravity
    data, rows = model.createData(), []
    for k in range(len(q)):
        full = pin.neutral(model)
        full[7:] = q[k]
        rate = np.concatenate([np.zeros(6), v[k]])
        y = pin.computeJointTorqueRegressor(model, data, full, rate, np.concatenate([np.zeros(6), a[k]]))
        if not gravity:
            y = y - pin.computeJointTorqueRegressor(model, data, full, 0 * rate, 0 * rate)
        rows.append(np.concatenate([y[:6] if wrench else y[:0], y[6:] if torque else y[:0]])[:, 10:])
    stacked = np.array(rows)
    if offset:
        stacked[:, :6] -= stacked[:, :6].mean(axis=0)
    return stacked.reshape(-1, stacked.shape[2])


def classes_of(rows):
    """Rank, and the class of every column by the null space alone: a parameter is alone where no null vector has any of it."""
    length = np.linalg.norm(rows, axis=0)
    seen = length > 1e-8 * length.max()
    _, s, vt = np.linalg.svd(rows[:, seen] / length[seen])
    rank = int((s > 1e-6 * s[0]).sum())
    alone = np.linalg.norm(vt[rank:], axis=0) < 1e-4
    out = np.full(len(length), "never_visible", dtype=object)
    out[seen] = np.where(alone, "alone", "combination")
    return rank, out


SETS = {
    "wrench-static": (True, False, False, False), "wrench-offset": (True, False, True, True),
    "wrench": (True, False, True, False), "torque": (False, True, True, False),
    "both-offset": (True, True, True, True), "both": (True, True, True, False),
}  # fmt: skip


@pytest.mark.parametrize("name", ["ur5", "panda", "lwr4"])
def test_ranks_and_classes_are_those_of_pinocchios_regressors(name, tmp_path):
    robot = load(name, tmp_path)
    motion = fourier_trajectory(robot, duration=20.0, rate=60.0)
    found = bayesid.identifiability(robot, motion, noise={"force": 1e-4, "moment": 1e-5, "torque": 1e-5})
    assert tuple(r.rank for r in found.sensor_sets) == tuple(r.rank_of_any_motion for r in found.sensor_sets) == RANKS[name]
    states = motion.positions[::16], motion.velocities[::16], motion.accelerations[::16]
    for report in found.sensor_sets:
        rank, kinds = classes_of(pinocchio_rows(robot, *SETS[report.sensor_set.name], *states))
        assert rank == report.rank
        mine = [p.kind for p in report.parameters]
        wrong = [(p.name, m, str(k)) for p, m, k in zip(report.parameters, mine, kinds, strict=True) if m != k]
        assert not wrong


def test_the_papers_two_joints(tmp_path):
    """Twelve combinations by the wrench, nine of them one parameter alone, the rest in the paper's three sums."""
    robot = load("puma2", tmp_path)
    found = bayesid.identifiability(robot, fourier_trajectory(robot, duration=20.0))
    assert tuple(r.rank for r in found.sensor_sets) == RANKS["puma2"]
    main = found["wrench-static"]
    published = paper_base_map() != 0  # the paper's combinations, printed
    names = np.array([p.name for p in main.parameters])
    alone = published[published.sum(axis=1) == 1].any(axis=0)
    assert [p.name for p in main.parameters if p.kind == "alone"] == names[alone].tolist() and alone.sum() == 9
    assert [p.name for p in main.parameters if p.kind == "never_visible"] == names[~published.any(axis=0)].tolist()
    torque = next(p for p in found["torque"].parameters if p.name == "joint1.mcx")
    assert torque.kind == "never_visible" and torque.sensor_sets[0] == "wrench-static"


def test_a_joint_that_stands_still_is_named_and_moving_it_shows_what_was_said(tmp_path):
    robot = load("ur5", tmp_path)
    rich = fourier_trajectory(robot, duration=20.0, rate=60.0, seed=3)
    held = np.arange(robot.n) == 3
    q = np.where(held, 0.4, rich.positions)
    motion = replace(
        rich, positions=q, velocities=np.where(held, 0.0, rich.velocities), accelerations=np.where(held, 0.0, rich.accelerations)
    )
    before = bayesid.identifiability(robot, motion)
    assert before.still == (robot.joint_names[3],)
    main = before.main
    states = (x[::16] for x in (q, motion.velocities, motion.accelerations))
    rank, _ = classes_of(pinocchio_rows(robot, *SETS[main.sensor_set.name], *states))
    assert main.rank == rank < main.rank_of_any_motion
    advice = [a for a in before.advice if a.about == "joint"]
    assert len(advice) == 1 and robot.joint_names[3] in advice[0].text
    after = bayesid.identifiability(robot, rich)
    assert after.main.rank - main.rank == advice[0].gain and not [a for a in after.advice if a.about == "joint"]
    for b, a in zip(main.parameters, after.main.parameters, strict=True):
        if robot.joint_names[3] in b.joints:
            assert b.kind != a.kind
    assert any(p.joints for p in main.parameters)


def test_a_held_joint_that_gives_way_a_little_still_stands_still(tmp_path):
    robot = puma2(tmp_path)
    times, q, v, a = fourier(robot, 1)
    sway = np.array([0.0, 1.0])
    q = np.where(sway, 0.3 + 0.4 * STILL * np.sin(9.0 * times)[:, None], q)
    table = recording(robot, bayesid.Sensor(), (times, q, v * (1 - sway), a * (1 - sway)), force_std=0.5, torque_std=0.05)
    found = bayesid.identifiability(experiment(robot, [bayesid.Motion("one", "identification", table)], bayesid.Sensor()))
    assert found.still == ("joint2",)
    assert found.main.sensor_set.name == "wrench-offset" and found.main.rank < 12
    assert any("joint2 stood still" in x.text for x in found.advice)


def found_row(text, body):
    """The line of a body in the table of classes."""
    return next(line for line in text.splitlines() if line.strip().startswith(f"{body} "))


def test_poses_are_told_to_move(tmp_path):
    robot = load("ur5", tmp_path)
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (30, 6))
    zero = np.zeros_like(q)
    table = recording(robot, bayesid.Sensor(), (np.arange(30.0), q, zero, zero), force_std=0.5, torque_std=0.05)
    motion = bayesid.Motion("poses", "identification", table, "poses")
    found = bayesid.identifiability(experiment(robot, [motion], bayesid.Sensor()))
    for report in found.sensor_sets:
        if report.sensor_set.name != "wrench-static":
            rank, _ = classes_of(pinocchio_rows(robot, *SETS[report.sensor_set.name], q, zero, zero))
            assert report.rank == rank
    assert found["wrench-static"].rank == 0 and found["wrench-static"].rank_of_any_motion == 40
    assert any("only stands" in a.text for a in found.advice)
    text = str(found)
    # The last joint turns about y: its first moment along y goes with its mass.
    assert "Side by side (m mcx mcy mcz" in text and "caca––––––" in found_row(text, robot.joint_names[-1])
    assert "not excited by this motion" in text and "never visible to this sensor" in text


def test_errors_of_sliding_joints_have_their_own_unit(tmp_path):
    """Slide, swing, slide, roll."""
    robot = load_robot(write(tmp_path, robots.prismatic_arm()))
    found = bayesid.identifiability(
        robot, fourier_trajectory(robot, duration=4.0), sensor_sets=["torque"], effects=["viscous_friction"]
    )
    std = {e.name.partition("@")[2].partition(".")[0]: e.std for e in found.main.effects}
    lines = [text for name, text in effect_lines(found.main) if name == "viscous_friction.coefficient"]
    for (one, other), unit, line in zip((("joint1", "joint3"), ("joint2", "joint4")), ("N s/m", "N m s/rad"), lines, strict=True):
        low, high = sorted((std[one], std[other]))
        assert line == f"standard deviation {number(low, 3)} to {number(high, 3)} {unit}"


def test_effects_that_look_like_links_are_told(tmp_path):
    """In torques the first joint's rotor inertia is the links' inertia about it: exactly one combination goes."""
    robot = load("ur5", tmp_path)
    setup = experiment(robot, [], bayesid.Sensor())
    motion = fourier_trajectory(robot, duration=20.0)
    found = bayesid.identifiability(setup, motion, sensor_sets=["torque"], effects=["rotor_inertia@joint1", "viscous_friction"])
    main = found.main
    assert main.rank == 35 and main.rank_of_any_motion == 36
    assert {p.name: p.kind for p in main.parameters}[f"{robot.joint_names[0]}.Izz"] == "effect"
    hidden = [e.name for e in main.effects if e.std is None]
    assert hidden == ["rotor_inertia@joint1.inertia"] and any(a.about == "effect" for a in found.advice)
    assert not any("independently" in a.text for a in found.advice)
    # A wrench besides knows the links by itself: then the rotor is told from them.
    wider = bayesid.identifiability(setup, motion, sensor_sets=["torque", "both-offset"], effects=["rotor_inertia@joint1"])
    assert all(e.std is not None for e in wider["both-offset"].effects)


def test_expected_errors_are_those_that_identify_states(tmp_path):
    robot = puma2(tmp_path)
    motion = fourier(robot, 5)
    sensor = bayesid.Sensor(force_std=0.5, torque_std=0.05)
    table = recording(robot, sensor, motion, force_std=0.5, torque_std=0.05, offset=3.0, seed=2)
    setup = experiment(robot, [bayesid.Motion("one", "identification", table)], sensor, inertia_rel_std=0.1)
    found = bayesid.identifiability(setup)
    estimate = bayesid.identify(setup).estimate
    assert found.main.sensor_set.name == "wrench-offset" and found.main.noise == {"wrench": "readings"}
    expected = np.array([b.std for b in found.main.base_parameters])
    np.testing.assert_allclose(expected, estimate.std, rtol=1e-6)
    assert tuple(b.kind for b in found.main.base_parameters) == estimate.classes
    assert found.main.condition_number == pytest.approx(estimate.condition_number, rel=1e-6)
    share = np.array([b.prior_share for b in found.main.base_parameters])
    assert ((share > 0) & (share < 1)).all()
    # The data sheet's noise is that of the recording here, and planning takes it.
    bare = [replace(m, table=replace(m.table, wrench=None, torques=None)) for m in setup.motions]
    planned = bayesid.identifiability(replace(setup, motions=tuple(bare)))
    assert planned.source == "planned" and planned.main.noise == {"wrench": "data sheet"}
    np.testing.assert_allclose([b.std for b in planned["wrench-offset"].base_parameters], expected, rtol=0.1)


def test_poses_read_beside_a_motion_are_one_reading_each(tmp_path):
    """No run is subtracted, so that the noise of a row is that of one reading and not half of a difference's."""
    robot = puma2(tmp_path)
    motion, sensor = fourier(robot, 5), bayesid.Sensor(translation=np.array([0.0, 0.0, -0.1]))
    noise = {"force_std": 0.5, "torque_std": 0.05}
    table = recording(robot, sensor, motion, **noise, offset=3.0, seed=2)
    still = recording(robot, sensor, tuple(x[::100] for x in motion), **noise, offset=3.0, seed=3, static=True)
    found = bayesid.identifiability(experiment(robot, [bayesid.Motion("one", "identification", table, static=still)], sensor))
    report = found["wrench-offset"]
    assert report.recorded and found.main is report
    np.testing.assert_allclose(list(report.noise_std.values()), np.repeat([0.5, 0.05], 3), rtol=0.1)


def test_advice_names_as_many_combinations_as_it_counts(tmp_path):
    robot = load_robot(write(tmp_path, robots.prismatic_arm()))
    found = bayesid.identifiability(robot, sensor_sets=["wrench-offset", "wrench"])
    (known,) = (a for a in found.advice if a.about == "sensor" and a.gain)
    _, _, named = known.text.partition(" more: ")
    assert known.gain == 1 and named and ";" not in named


@pytest.mark.parametrize("rate", [50.0, 400.0])
def test_a_random_motion_is_compared_at_the_rate_of_the_motions(rate, tmp_path):
    """A motion of the very kind tells neither more nor less, however often both are sampled."""
    robot = load("ur5", tmp_path)
    motion = fourier_trajectory(robot, duration=20.0, rate=rate, share=0.8, seed=5)
    found = bayesid.identifiability(robot, motion, sensor_sets=["torque"], noise={"torque": 1.0})
    assert found.main.rank == 36 and not any("a random motion" in a.text for a in found.advice)


def test_planned_motions_of_the_same_name_are_told_apart(tmp_path):
    robot, tables = puma2(tmp_path), [tmp_path / folder / "trajectory.csv" for folder in ("one", "two")]
    for seed, table in enumerate(tables):
        table.parent.mkdir()
        bayesid.write_trajectory(fourier_trajectory(robot, duration=4.0 + seed, rate=50.0, seed=seed), table)
    found = bayesid.identifiability(robot, tables, sensor_sets=["torque"])
    assert found.motions == pytest.approx({"trajectory (1)": 3.98, "trajectory (2)": 4.98})
    second = bayesid.identifiability(robot, tables, sensor_sets=["torque"], motions="trajectory (2)")
    assert list(second.motions) == ["trajectory (2)"]


def test_rows_without_a_robot(tmp_path):
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(400, 2, 5))
    matrix[:, :, 2] = matrix[:, :, 0] - 2.0 * matrix[:, :, 1]
    matrix[:, :, 4] = 0.0
    truth = np.array([1.0, 2.0, 0.5, 3.0, 0.0])
    target = matrix @ truth + [0.1, 0.3] * rng.normal(size=(400, 2))
    names = ["a", "b", "c", "d", "e"]
    rows = bayesid.Regression.from_arrays(matrix, target, parameter_names=names, noise_std=[0.1, 0.3])
    found = bayesid.identifiability(rows)
    kinds = {p.name: p.kind for p in found.main.parameters}
    assert kinds == {"a": "combination", "b": "combination", "c": "combination", "d": "alone", "e": "not_excited"}
    assert found.main.rank == 3 and found.main.rank_of_any_motion is None and found.source == "regression"
    np.testing.assert_allclose([b.std for b in found.main.base_parameters], bayesid.fit(rows, "gls").std, rtol=1e-6)
    assert "robot" in found.warnings[0]
    assert "relative to the values" in str(found) and "a body" not in str(found)
    json.dumps(found.to_dict(), allow_nan=False)
    found.write(tmp_path / "out")
    with pytest.raises(bayesid.InputError, match="identifiability: channel"):
        bayesid.identifiability(rows, motions=["one"])


def test_bad_input_is_told_in_one_line(tmp_path):
    robot = puma2(tmp_path)
    other = load("ur5", tmp_path)
    for call, said in (
        (lambda: bayesid.identifiability(3), "a int is given"),
        (lambda: bayesid.identifiability(robot, sensor_sets=["force"]), 'sensor_sets="force"'),
        (lambda: bayesid.identifiability(robot, sensor_sets=[]), "sensor_sets names none"),
        (lambda: bayesid.identifiability(robot, motions=[]), "motions names none"),
        (lambda: bayesid.identifiability(robot, motions=["none"]), 'motions="none"'),
        (lambda: bayesid.identifiability(robot, noise={"force": -1.0}), "noise force"),
        (lambda: bayesid.identifiability(robot, [3]), "a int is given among the trajectories"),
        (lambda: bayesid.identifiability(robot, fourier_trajectory(other)), "6 joints but the robot has 2"),
        (lambda: bayesid.identifiability(experiment(robot, [])), "no motion is to be fitted"),
    ):
        with pytest.raises(bayesid.InputError, match=said) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_a_regression_with_a_robot_behind_it(tmp_path):
    """The rows of an experiment: what effects in its model take is told, and only the motions that are fitted are named."""
    robot = puma2(tmp_path)
    tables = [recording(robot, None, fourier(robot, k), torque_std=0.1, seed=k) for k in (1, 2)]
    roles = ("identification", "validation")
    motions = [bayesid.Motion(role, role, table) for role, table in zip(roles, tables, strict=True)]
    setup = experiment(robot, motions, effects=("rotor_inertia@joint1",))
    rows = prepare(setup).regression
    found = bayesid.identifiability(rows)
    assert found.main.rank == 7 and list(found.motions) == ["identification"]
    assert {p.name: p.kind for p in found.main.parameters}["joint1.Iyy"] == "effect"  # joint 1 turns about y here
    assert str(found).splitlines()[1].strip().startswith("These rows determine 7 combinations")
    assert bayesid.identifiability(setup)["torque"].rank == 7


def test_torques_of_some_joints_are_planned_for_by_their_own_noise(tmp_path):
    robot = puma2(tmp_path)
    table = recording(robot, None, fourier(robot, 5), torque_std=0.05, seed=2)
    table = replace(table, torques=np.where([True, False], np.nan, table.torques))
    setup = experiment(robot, [bayesid.Motion("one", "identification", table)])
    assert setup.torque_joints == (1,)
    found = bayesid.identifiability(setup, sensor_sets="torque", noise={"tau2": 1.5})
    assert found.main.noise_std == {"tau2": 1.5} and found.main.noise == {"torque": "given"}
    plan = bayesid.excite(setup, channel="torque", starts=1, randoms=2, seconds=0.1, duration=5.0)
    assert len(plan.std) == plan.possible


def test_a_robot_with_a_sensor_in_a_joint_is_asked_about_by_that_sensor(tmp_path):
    """As `excite` and `simulate` take it; nothing speaks of a sensor under the base."""
    robot = load_robot(write(tmp_path, robots.wrist_sensor_arm()), sensor_joint="wrist_ft")
    found = bayesid.identifiability(robot, sensor_sets="wrench-offset")
    assert found.main.rank_of_any_motion == 10 and found.main.sensor_set.name == "wrench-offset"
    assert not any("under the base" in line for line in found.warnings)
