"""Simulated recordings against Pinocchio, their truth, and the folder they are written to."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

import bayesid
from bayesid.cli import main
from bayesid.effects import REST_SPEED, EffectLibrary, starting_point
from bayesid.effects.friction import ViscousFriction
from bayesid.recordings.experiment import load_setup
from bayesid.recordings.table import WRENCH_COLUMNS
from bayesid.robot import inertia
from bayesid.robot.robot import load_robot, motion_limits
from bayesid.simulation.simulation import complete_effects, default_values, perturbed_links
from bayesid.simulation.trajectories import (
    make_trajectories,
    new_trajectories,
    read_trajectory,
    recorded_trajectories,
    write_trajectory,
)
from bayesid.workflows.demo import demo_experiment, puma_setup
from tests.robots import ROBOTS, ur5, write

CLEAN = bayesid.Recorder(resolution=0.0, position_std=0.0, force_std=0.0, torque_std=0.0, drive_std=0.0)


@pytest.fixture
def setup(tmp_path):
    return puma_setup(tmp_path)


@pytest.fixture
def folder(tmp_path, setup):
    """An experiment folder with a short motion and its stop-and-go run."""
    made = bayesid.simulate(setup, new_trajectories(setup.robot, 6.0, 50.0, static=True), seed=1)
    bayesid.write_simulation(made, tmp_path / "made")
    return tmp_path / "made"


@pytest.mark.parametrize("name", ["ur5", "prismatic_arm", "tree"])
def test_noise_free_torques_are_pinocchios(name, tmp_path):
    robot = bayesid.load_robot(write(tmp_path, ROBOTS[name]()))
    motion = bayesid.fourier_trajectory(robot, duration=2.0, rate=50.0)
    table = bayesid.simulate(robot, [motion], recorder=CLEAN).motions[0].table
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data = model.createData()
    configuration = pin.neutral(model)
    for k in range(0, len(motion.times), 17):
        for i, joint in enumerate(robot.joint_names):
            j = model.joints[model.getJointId(joint)]
            q = motion.positions[k, i]
            configuration[j.idx_q : j.idx_q + j.nq] = q if j.nq == 1 else (np.cos(q), np.sin(q))
        order = [model.joints[model.getJointId(joint)].idx_v for joint in robot.joint_names]
        v, a = np.zeros(model.nv), np.zeros(model.nv)
        v[order], a[order] = motion.velocities[k], motion.accelerations[k]
        tau = pin.rnea(model, data, configuration, v, a)
        np.testing.assert_allclose(table.torques[k], tau[order], atol=1e-9)


def test_at_rest_the_sensor_weighs_the_robot_and_reads_its_offset(setup):
    motions = new_trajectories(setup.robot, 4.0, static=True)
    made = bayesid.simulate(setup, motions, effects={"sensor_offset": {"fx": 5.0}}, recorder=CLEAN)
    static = made.motions[0].static
    weight = 9.81 * (setup.robot.nominal[:, 0].sum() + setup.robot.static_nominal[0])
    np.testing.assert_allclose(static.wrench[:, :3], np.tile([5.0, 0.0, weight], (len(static), 1)), atol=1e-9)
    assert made.motions[0].stop_and_go
    np.testing.assert_array_equal(static.positions, made.motions[0].table.positions)


def test_motion_keeps_limits_and_has_consistent_derivatives(tmp_path):
    for name in ("panda", "prismatic_arm"):
        robot = bayesid.load_robot(write(tmp_path, ROBOTS[name]()))
        lower, upper, speed = motion_limits(robot)
        for seed in range(5):
            m = bayesid.fourier_trajectory(robot, duration=20.0, rate=200.0, seed=seed, share=0.9)
            assert (m.positions >= lower).all() and (m.positions <= upper).all()
            assert (np.abs(m.velocities) <= 0.91 * speed).all()
            step = 1 / 200
            np.testing.assert_allclose(np.gradient(m.positions, step, axis=0)[5:-5], m.velocities[5:-5], atol=2e-3)
            np.testing.assert_allclose(np.gradient(m.velocities, step, axis=0)[5:-5], m.accelerations[5:-5], atol=2e-2)
    assert m.period == pytest.approx(10.0)


def test_encoders_count(setup):
    counts = (1e-3, 2e-3)
    recorder = bayesid.Recorder(resolution=counts, velocity_std=0.01)
    made = bayesid.simulate(setup, new_trajectories(setup.robot, 4.0), recorder=recorder)
    table = made.motions[0].table
    np.testing.assert_allclose(table.positions / counts, np.round(table.positions / counts), atol=1e-9)
    assert made.position_resolution == 2e-3
    true = new_trajectories(setup.robot, 4.0)[0]
    assert np.std(table.velocities - true.velocities) == pytest.approx(0.01, rel=0.1)


def test_noise_is_as_stated(setup):
    motions = new_trajectories(setup.robot, 20.0)
    clean = bayesid.simulate(setup, motions, recorder=CLEAN).motions[0].table
    recorder = bayesid.Recorder(force_std=0.3, torque_std=0.02, drive_std=0.01)
    noisy = bayesid.simulate(setup, motions, recorder=recorder).motions[0].table
    np.testing.assert_allclose(np.std(noisy.wrench - clean.wrench, axis=0), [0.3] * 3 + [0.02] * 3, rtol=0.08)
    np.testing.assert_allclose(np.std(noisy.torques - clean.torques, axis=0), 0.01 * setup.robot.effort_limit, rtol=0.08)


def test_friction_acts_on_torques_only(setup):
    motions = new_trajectories(setup.robot, 10.0, static=True)
    plain = bayesid.simulate(setup, motions, recorder=CLEAN)
    effects = {
        "viscous_friction@joint1": {"coefficient": 2.0}, "coulomb_friction@joint1": {"level": 3.0},
        "torque_offset@joint1": {"offset": 0.5}, "rotor_inertia@joint1": {"inertia": 0.7},
        "stribeck_friction@joint1": {"level": 1.5, "velocity": 0.1}, "load_friction@joint1": {"coefficient": 0.1},
    }  # fmt: skip
    rough = bayesid.simulate(setup, motions, effects=effects, recorder=CLEAN)
    one, two = plain.motions[0].table, rough.motions[0].table
    np.testing.assert_array_equal(one.wrench, two.wrench)
    np.testing.assert_array_equal(one.torques[:, 1], two.torques[:, 1])
    v, a = motions[0].velocities[:, 0], motions[0].accelerations[:, 0]
    sense = np.clip(v / REST_SPEED, -1, 1)
    expected = 2 * v + 3 * sense + 0.5 + 0.7 * a
    expected += (1.5 * np.exp(-((v / 0.1) ** 2)) + 0.1 * np.abs(one.torques[:, 0])) * sense
    np.testing.assert_allclose(two.torques[:, 0] - one.torques[:, 0], expected, atol=1e-10)
    # Stopped, the drive holds anywhere within its friction.
    held = rough.motions[0].static.torques[:, 0] - plain.motions[0].static.torques[:, 0] - 0.5
    assert np.abs(held).max() < 3 + 1.5 + 0.1 * np.abs(one.torques[:, 0]).max() + 0.01 and np.std(held) > 1.0


def test_values_come_from_the_model_then_the_defaults(setup):
    robot = setup.robot
    stated = {"viscous_friction@joint2": {"coefficient": 9.0, "fixed": True}}
    plant = complete_effects(robot, ["viscous_friction", "sensor_offset"], stated)
    assert plant["viscous_friction@joint2"] == {"coefficient": 9.0}
    assert plant["viscous_friction@joint1"] == default_values(ViscousFriction("joint1", 0), robot)
    assert set(plant["sensor_offset@sensor"]) == set(WRENCH_COLUMNS)
    assert complete_effects(robot, "viscous_friction, sensor_offset", stated) == plant
    assert complete_effects(robot, {"sensor_offset": {"fx": 1.0}}, {})["sensor_offset@sensor"]["fz"] == 0.0
    for effects, message in [
        (["friction"], "cannot be simulated"), (["load_friction@elbow"], "no joint 'elbow'"),
        ({"load_friction@joint1": {"level": 1.0}}, "no parameter 'level'"),
        ({"load_friction@joint1": {"coefficient": "0.1"}}, "coefficient = '0.1' is no number"),
        ({"load_friction@joint1": {"coefficient": np.nan}}, "coefficient = nan is no number"),
    ]:  # fmt: skip
        with pytest.raises(bayesid.InputError, match=message):
            complete_effects(robot, effects, {})


def test_values_stated_by_the_urdfs_names_are_those_of_the_joint(tmp_path):
    """Of a whole kind, too, and where an effect couples two joints; estimates start there as simulations do."""
    robot = load_robot(write(tmp_path, ur5()))
    names, coupled = robot.joint_names, "coupled_transmission@wrist_2_joint->wrist_3_joint"
    stated = {"viscous_friction@shoulder_lift_joint": {"coefficient": 7.0}, coupled: {"coupling": 1.0, "fixed": True}}
    plant = complete_effects(robot, ["viscous_friction", "coupled_transmission@joint5->joint6"], stated)
    assert plant["viscous_friction@joint2"] == {"coefficient": 7.0}
    assert plant["coupled_transmission@joint5->joint6"] == {"coupling": 1.0}
    effects = EffectLibrary().parse([coupled, "viscous_friction@joint2"], names, [f"tau{k + 1}" for k in range(6)])
    values, free = starting_point(effects, stated, names)
    assert values.tolist() == [1.0, 7.0] and free.tolist() == [False, True]


def test_perturbed_links_can_exist_and_vary_as_asked(setup):
    robot = setup.robot
    masses = []
    for seed in range(300):
        links = perturbed_links(robot, 0.2, seed)
        assert inertia.is_physically_consistent(links).all()
        masses.append(np.log(links[:, 0] / robot.nominal[:, 0]))
    assert np.std(masses) == pytest.approx(0.2, rel=0.12)
    bad = np.array(robot.nominal)
    bad[0, 4] = -1.0
    with pytest.raises(bayesid.InputError, match="'joint1'"):
        perturbed_links(replace(robot, nominal=bad), 0.1)


def test_same_seed_same_recording(setup):
    motions = new_trajectories(setup.robot, 2.0)
    one, two, three = (bayesid.simulate(setup, motions, perturb=0.1, seed=s).motions[0].table.wrench for s in (4, 4, 5))
    np.testing.assert_array_equal(one, two)
    assert not np.allclose(one, three)


def test_unusable_input_is_refused(setup):
    with pytest.raises(bayesid.InputError, match="at least 20 and at most 10,000,000 samples"):
        bayesid.fourier_trajectory(setup.robot, duration=0.01)
    with pytest.raises(bayesid.InputError, match="samples a second"):
        bayesid.fourier_trajectory(setup.robot, rate=2.0)
    with pytest.raises(bayesid.InputError, match="force_std"):
        bayesid.Recorder(force_std=-1.0)
    with pytest.raises(bayesid.InputError, match="shape"):
        bayesid.simulate(setup, new_trajectories(setup.robot, 2.0), links=np.zeros((3, 10)))
    with pytest.raises(bayesid.InputError, match="seed = -1: give a whole number of at least 0"):
        bayesid.simulate(setup, seed=-1)
    longer = [replace(t, positions=t.positions[:, [0, 1, 1]]) for t in new_trajectories(setup.robot, 2.0)]
    for options, message in [
        ({"perturb": -0.1}, "perturb=-0.1: give a share"), ({"perturb": np.nan}, "perturb=nan: give a share"),
        ({"trajectories": longer}, "'identification' moves 3 joints, the robot has 2"),
        ({"recorder": bayesid.Recorder(resolution=(1e-4, 1e-4, 1e-4))}, "one number, or one for each of 2 joints"),
    ]:  # fmt: skip
        with pytest.raises(bayesid.InputError, match=message):
            bayesid.simulate(setup, **{"trajectories": new_trajectories(setup.robot, 2.0), **options})
    for options in ({"force_std": "1"}, {"force_std": (0.1, 0.1, 0.1)}, {"resolution": "fine"}):
        with pytest.raises(bayesid.InputError, match="give a number from 0"):
            bayesid.Recorder(**options)
    with pytest.raises(bayesid.InputError, match="no such folder"):
        load_setup("no such folder")


def test_a_mount_that_rings_ever_louder_is_refused_without_a_warning(setup):
    """Found by fuzzing: numpy warned of an overflow."""
    motions = new_trajectories(setup.robot, 4.0, 50.0, seed=1)
    with pytest.raises(bayesid.InputError, match="not finite with base_compliance@base"):
        bayesid.simulate(setup, motions, effects={"base_compliance@base": {"damping": -1.0}})


def test_identification_finds_the_truth(tmp_path):
    made = demo_experiment(tmp_path, seed=3)
    for channel, effects in (("wrench", []), ("torque", ["viscous_friction", "coulomb_friction"])):
        drives = {"viscous_friction": {"coefficient": 4.0}, "coulomb_friction": {"level": 6.0}}
        experiment = bayesid.simulate(replace(made, effects=()), None, effects=drives, links=made.truth.links, seed=8)
        result = bayesid.identify(experiment, channel, effects=effects)
        z = (result.values - result.base.matrix @ made.truth.links.ravel()) / result.std
        assert np.abs(z).max() < 4


def test_written_folder_reads_back_with_its_truth(folder, setup):
    loaded = bayesid.load_experiment(folder)
    assert [m.role for m in loaded.motions] == ["identification", "validation"]
    assert loaded.motions[0].stop_and_go and loaded.sensor.force_std == 0.5
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert truth["seed"] == 1 and truth["effects"] == [] and truth["noise"]["torque_std"] == 0.05
    np.testing.assert_array_equal(truth["true_links"]["joint2"], setup.robot.nominal[1])


def test_recorded_motions_again(folder):
    loaded = bayesid.load_experiment(folder)
    again = bayesid.simulate(loaded, recorder=CLEAN, seed=2)
    for old, new in zip(loaded.motions, again.motions, strict=True):
        assert (old.name, old.role, old.stop_and_go) == (new.name, new.role, new.stop_and_go)
        np.testing.assert_allclose(new.table.positions, old.table.positions, atol=3e-4)
    assert len(recorded_trajectories(loaded)) == 2


def test_poses_and_separate_static_poses(setup):
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.5, 1.0, (8, 2))
    poses = bayesid.Trajectory("poses", "identification", np.arange(8.0), q, 0 * q, 0 * q, kind="poses")
    moving = replace(bayesid.fourier_trajectory(setup.robot, duration=3.0), static_positions=q)
    made = bayesid.simulate(setup, [poses, moving], recorder=CLEAN)
    np.testing.assert_allclose(made.motions[0].table.wrench, made.motions[1].static.wrench)
    again = recorded_trajectories(made)
    assert again[0].kind == "poses" and len(again[1].static_positions) == 8


def test_rows_that_a_planned_motion_loses_are_lost_with_their_accelerations(setup, tmp_path):
    """A row twice, and one without a position: accelerations stay with the rows that they are of."""
    motion = bayesid.fourier_trajectory(setup.robot, duration=2.0, rate=50.0, fundamental=0.5)
    bayesid.write_trajectory(motion, tmp_path / "move.csv")
    header, *rows = (tmp_path / "move.csv").read_text(encoding="utf-8").splitlines()
    emptied = rows[20].split(",")
    emptied[1] = ""
    damaged = [header, *rows[:10], rows[9], *rows[10:20], ",".join(emptied), *rows[21:]]
    (tmp_path / "move.csv").write_text("\n".join(damaged), encoding="utf-8")
    back = bayesid.read_trajectory(tmp_path / "move.csv", setup.robot)
    for name in ("times", "positions", "velocities", "accelerations"):
        np.testing.assert_allclose(getattr(back, name), np.delete(getattr(motion, name), 20, axis=0), atol=1e-6)


@pytest.mark.parametrize("name", ["move.parquet", "move.txt"])
def test_accelerations_are_read_of_any_table(name, setup, tmp_path):
    """They are those of the table, here twice those of the positions, and not those of a curve through these."""
    motion = bayesid.fourier_trajectory(setup.robot, duration=2.0, rate=50.0, fundamental=0.5)
    doubled = replace(motion, accelerations=2.0 * motion.accelerations)
    bayesid.write_trajectory(doubled, tmp_path / "move.txt")
    if name == "move.parquet":
        pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
        pd.read_csv(tmp_path / "move.txt").set_index("t").to_parquet(tmp_path / name)
    back = bayesid.read_trajectory(tmp_path / name, setup.robot)
    np.testing.assert_allclose(back.accelerations, doubled.accelerations, atol=1e-6)


def test_simulate_verb(folder, tmp_path, capsys):
    out = tmp_path / "again"
    arguments = ["simulate", str(folder), "--out", str(out), "--seed", "3"]
    assert main([*arguments, "--effects", "coulomb_friction@joint2,sensor_offset", "--perturb", "0.1", "--no-static"]) == 0
    assert str(out) in capsys.readouterr().out
    loaded = bayesid.load_experiment(out)
    assert loaded.effects == () and loaded.motions[0].static is None and loaded.inertia_rel_std == 0.1
    truth = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    assert [(e["name"], e["where"]) for e in truth["effects"]] == [("coulomb_friction", "joint2"), ("sensor_offset", "sensor")]
    assert main(arguments) == 2
    assert "is there already" in capsys.readouterr().err


def test_simulate_verb_needs_no_tables_for_new_motions(folder, tmp_path):
    for table in folder.glob("*.csv"):
        table.unlink()
    (tmp_path / "model.toml").write_text(
        '[model]\neffects = ["viscous_friction@joint1"]\n[model.values."viscous_friction@joint1"]\ncoefficient = 7.5\n',
        encoding="utf-8",
    )
    out = tmp_path / "new"
    options = ["--new", "--duration", "4", "--rate", "100", "--static", "--model", str(tmp_path / "model.toml")]
    assert main(["simulate", str(folder), *options, "--resolution", "0.001", "--out", str(out)]) == 0
    loaded = bayesid.load_experiment(out)
    assert len(loaded.motions[0].table) == 400 and loaded.position_resolution == 1e-3
    truth = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    assert truth["effects"][0]["parameters"]["coefficient"]["value"] == 7.5


@pytest.mark.parametrize(
    "options", [["--duration", "3"], ["--effects", "frog"], ["--perturb", "-1"], ["--force-std", "-2"], ["--new", "--rate", "1"]]
)
def test_simulate_verb_refuses(folder, tmp_path, capsys, options):
    assert main(["simulate", str(folder), "--out", str(tmp_path / "no"), *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith("bayesid: ") and error.count("\n") == 1
    assert not (tmp_path / "no").exists()


def test_demo_verb(tmp_path, capsys):
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--seed", "1"]) == 0
    shown = capsys.readouterr().out
    assert "intervals hold the truth" in shown and str(out / "report.html") in shown
    assert {"report.html", "estimate.json", "identified.urdf", "model.toml", "experiment"} == {p.name for p in out.iterdir()}
    assert bayesid.load_experiment(out / "experiment").validation
    assert main(["demo", "--out", str(out)]) == 0  # an earlier demo's folder is replaced
    (out / "experiment" / "mine.txt").write_text("keep", encoding="utf-8")
    assert main(["demo", "--out", str(out)]) == 2
    assert (out / "experiment" / "mine.txt").exists()


def test_poses_get_no_stop_and_go_run(setup):
    """They are at rest themselves, and would be all subtracted."""
    (poses,) = (replace(t, kind="poses") for t in new_trajectories(setup.robot, 2.0)[:1])
    made = bayesid.simulate(setup, [poses])
    assert [t.static_positions for t in make_trajectories(made, new=False, static=True)] == [None]


def test_a_planned_motion_far_beyond_the_limits_is_refused(setup, tmp_path):
    """Degrees were taken for radians, as in no recording, and bounds told bands of such a motion."""
    planned = new_trajectories(setup.robot, 4.0, 50.0)[0]
    positions = pd.DataFrame({"t": planned.times, "q1": np.degrees(planned.positions[:, 0]), "q2": planned.positions[:, 1]})
    positions.to_csv(tmp_path / "planned.csv", index=False)
    with pytest.raises(bayesid.InputError, match=r"planned.csv: column q1: joint1 is at .* allows .*; is it in degrees"):
        read_trajectory(tmp_path / "planned.csv", setup.robot)
    positions.assign(q1=setup.robot.upper[0] + 0.2).to_csv(tmp_path / "planned.csv", index=False)
    with pytest.warns(bayesid.BayesidWarning, match=r"planned.csv: column q1: joint1 is at .* check the unit"):
        read_trajectory(tmp_path / "planned.csv", setup.robot)


def test_a_planned_motion_with_velocities_in_degrees_is_refused(setup, tmp_path):
    """They were taken for the true ones, beside positions that say something else."""
    planned = new_trajectories(setup.robot, 4.0, 50.0)[0]
    write_trajectory(replace(planned, velocities=np.degrees(planned.velocities)), tmp_path / "planned.csv")
    with pytest.raises(bayesid.InputError, match="planned.csv: column v1: 57.3 times what column q1 .* degrees per second"):
        read_trajectory(tmp_path / "planned.csv", setup.robot)
    write_trajectory(replace(planned, velocities=[1.5, 1.0] * planned.velocities), tmp_path / "planned.csv")
    with pytest.warns(bayesid.BayesidWarning, match="column v1: 1.5 times what column q1"):
        read_trajectory(tmp_path / "planned.csv", setup.robot)
