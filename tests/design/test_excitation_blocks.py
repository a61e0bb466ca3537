"""Scripted blocks, the static run, and the verb on the command line."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest

import bayesid
from bayesid.cli.verbs import run
from bayesid.design.excitation.blocks import BLOCKS
from tests.design.test_excitation import QUICK, experiment_of
from tests.report_pages import read
from tests.robots import ROBOTS, write


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    experiment = experiment_of("puma560", tmp_path_factory.mktemp("arm"))
    return bayesid.excite(experiment, static=True, blocks=("all",), rate=50.0, seed=0, settle=0.4, read=0.1, **QUICK)


def test_report_reads_as_a_page(result, tmp_path):
    """Tags match, nothing points outside, and what the result says is in it."""
    page = read(result.write(tmp_path / "out").read_text(encoding="utf-8"))
    assert {"motion", "what-else-to-record", "limits", "expected-deviations", "coefficients"} <= set(page.ids)
    for text in ("Static run", "parked.csv", f"{result.base.rank} of {result.possible}", "keeps all limits"):
        assert text in page.text


def test_blocks_are_motions_of_their_kind(result):
    assert {b.kind for b in result.blocks} == set(BLOCKS)
    motions = {b.trajectory.name: b.trajectory for b in result.blocks}
    t = result.trajectory
    for motion in motions.values():
        if motion.kind == "poses":
            continue
        # Rates are those of the positions, by central differences.
        step = motion.times[1] - motion.times[0]
        speed = (motion.positions[2:] - motion.positions[:-2]) / (2 * step)
        np.testing.assert_allclose(motion.velocities[1:-1], speed, atol=1e-2)
        rate = (motion.velocities[2:] - motion.velocities[:-2]) / (2 * step)
        np.testing.assert_allclose(motion.accelerations[1:-1], rate, atol=5e-2)
        for part in (motion.velocities, motion.accelerations):
            np.testing.assert_allclose(part[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motions["reversed"].positions, t.positions[::-1])
    assert motions["parked"].parked == ((0.0, 25.0),) and np.ptp(motions["parked"].positions) == np.ptp(t.positions[0])
    assert motions["speed-33"].times[-1] == pytest.approx(30.0)


def test_poses_tell_more_of_gravity_than_even_ones(result, tmp_path):
    """Eight chosen poses determine everything that poses can, better conditioned than eight evenly spaced ones."""
    from bayesid.dynamics.base_parameters import structural_base
    from bayesid.dynamics.channels import wrench_channels
    from bayesid.dynamics.regressors import Kernel

    robot = experiment_of("puma560", tmp_path).robot
    channels = wrench_channels(robot, np.eye(3), np.array([0.0, 0.0, -0.1]))
    base = structural_base(robot, channels, at_rest=True)
    poses = next(b.trajectory for b in result.blocks if b.kind == "poses").positions
    even = result.series.at(np.arange(8) * result.series.period / 8)[0]

    def determinant(q):
        still = np.zeros_like(q)
        rows = Kernel.of(robot, channels, base.independent).dynamics(q, still, still).reshape(-1, base.rank)
        return np.linalg.slogdet(rows.T @ rows)

    assert determinant(poses)[0] == 1.0 and determinant(poses)[1] > determinant(even)[1]


def test_static_run_stops_at_every_sample_and_keeps_the_limits(result):
    stops = result.static_run
    assert stops.every_sample and len(stops.rows) == 500
    np.testing.assert_allclose(stops.positions, result.trajectory.positions[:500], atol=1e-12)
    np.testing.assert_allclose(stops.start - stops.arrive, 0.4)
    np.testing.assert_allclose(stops.end - stops.start, 0.1)
    way, time = np.diff(stops.positions, axis=0), (stops.arrive[1:] - stops.end[:-1])[:, None]
    x = np.linspace(0, 1, 201)
    speed, rate = 30 * x**2 * (1 - x) ** 2, 60 * x - 180 * x**2 + 120 * x**3  # of the polynomial of degree five
    for kind, most in (("velocity", np.abs(way / time).max(axis=0) * speed.max()),
                       ("acceleration", np.abs(way / time**2).max(axis=0) * np.abs(rate).max())):  # fmt: skip
        limits = np.array([use.limit for use in result.limits if use.kind == kind])
        assert (most <= limits * (1 + 1e-6)).all()
    assert stops.seconds == stops.end[-1] > 500 * 0.5


def test_the_papers_set_up_has_its_twelve_parameters(tmp_path):
    """Two joints of a PUMA, one pass, a stop at every sample, judged by the motion wrench [Liu1998]_."""
    experiment = experiment_of("puma560", tmp_path)
    plan = bayesid.excite(experiment, kind="liu1998", joints=("joint1", "joint2"), duration=10.0, seed=0, **QUICK)
    assert plan.base.rank == plan.possible == 12
    assert plan.trajectory.period is None and plan.static_run is not None and plan.static_run.every_sample
    assert np.ptp(plan.trajectory.positions[:, 2:], axis=0).max() == 0.0
    np.testing.assert_allclose(np.diff(plan.trajectory.times), 0.008)


def test_command_line_writes_all_or_nothing(tmp_path, capsys):
    """A folder with experiment.toml and the URDF alone; what is written is what simulate takes."""
    folder = tmp_path / "arm"
    folder.mkdir()
    write(folder, ROBOTS["ur5"]())
    joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
    (folder / "experiment.toml").write_text(
        f'format = 1\nname = "arm"\n[robot]\nurdf = "robot.urdf"\njoints = {joints}\n[sensor]\nforce_std = 0.3\n'
        'torque_std = 0.03\n[[motion]]\nname = "a"\nrole = "identification"\ntable = "a.csv"\n'.replace("'", '"'),
        encoding="utf-8",
    )
    out = tmp_path / "out"
    quick = ["--starts", "1", "--randoms", "3", "--seconds", "0.5", "--rate", "50", "--duration", "10", "--period", "10"]
    assert run(["excite", str(folder), "--out", str(out), "--blocks", "poses,parked", *quick]) == 0
    said = capsys.readouterr().out
    assert "within the same limits" in said and "trajectory.csv" in said
    written = json.loads((out / "excitation.json").read_text(encoding="utf-8"))
    assert written["within_limits"] and written["rank"] == 40 and written["readings"] == "wrench, offsets fitted"
    with (out / "motions.toml").open("rb") as file:
        assert [m["table"] for m in tomllib.load(file)["motion"]] == ["trajectory.csv", "poses.csv", "parked.csv"]
    tables = [str(out / name) for name in ("poses.csv", "parked.csv", "trajectory.csv")]
    given = [word for table in tables for word in ("--trajectory", table)]
    assert run(["simulate", str(folder), *given, "--out", str(tmp_path / "recorded")]) == 0
    recorded = bayesid.load_experiment(tmp_path / "recorded")
    assert [m.kind for m in recorded.motions] == ["poses", "trajectory", "trajectory"]
    assert recorded.motions[1].parked and recorded.motions[2].role == "validation"
    assert run(["excite", str(folder), "--out", str(tmp_path / "none"), "--blocks", "nap", *quick]) == 2
    assert "--blocks nap" in capsys.readouterr().err and not (tmp_path / "none").exists()
