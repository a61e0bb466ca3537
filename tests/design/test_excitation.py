"""Exciting trajectories: gradients, limits by independent means, and what comes out of the verb."""

from __future__ import annotations

import json
import struct

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.design.excitation.collision import clearance
from bayesid.design.excitation.information import Criterion
from bayesid.design.excitation.optimise import random_feasible, restored, scaled_to_fit
from bayesid.design.excitation.options import ExcitationOptions
from bayesid.design.excitation.plan import make_task, mount_response
from bayesid.design.excitation.series import Coordinates, fitted_series
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.report.check import check_report
from bayesid.report.excitation import excitation_report
from bayesid.robot.robot import load_robot
from tests.robots import ROBOTS, write

QUICK = dict(starts=1, randoms=6, seconds=1.0)
FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")


def experiment_of(name, folder, **more) -> Experiment:
    robot = load_robot(write(folder, ROBOTS[name]()))
    return Experiment(name, robot, (), Sensor(translation=np.array([0.0, 0.0, -0.1])), **more)


def slope(function, x, direction, step=1e-6):
    return (function(x + step * direction) - function(x - step * direction)) / (2 * step)


@pytest.mark.parametrize("criterion", ["d", "a", "e", "condition"])
@pytest.mark.parametrize(("name", "channel", "effects"), [("ur5", "wrench", ()), ("puma560", "torque", FRICTION)])
def test_gradient_of_criteria_is_that_of_central_differences(criterion, name, channel, effects, tmp_path):
    """From the numbers that the optimiser changes to the criterion, in random directions."""
    experiment = experiment_of(name, tmp_path, effects=effects)
    task, _ = make_task(experiment, ExcitationOptions(channel=channel, criterion=criterion))
    rng = np.random.default_rng(3)
    x = 0.3 * rng.normal(size=task.coordinates.count)

    def value(x):
        return task.information.judged(task.coordinates.motion(x), task.recorded, task.step, task.criterion)

    gradient = task.coordinates.gradient(*value(x)[1])
    for _ in range(3):
        direction = rng.normal(size=len(x))
        expected = slope(lambda x: value(x)[0], x, direction)
        assert gradient @ direction == pytest.approx(expected, rel=2e-4, abs=1e-4 * np.linalg.norm(gradient))


def test_gradient_of_the_variance_of_quantities():
    """The matrix function alone."""
    rng = np.random.default_rng(0)
    root, chosen = rng.normal(size=(9, 6)), rng.normal(size=(6, 2))
    a, criterion, change = root.T @ root, Criterion("quantity", chosen), rng.normal(size=(6, 6))
    change = change + change.T
    value, gradient = criterion(a)
    assert np.exp(value) == pytest.approx(np.trace(chosen.T @ np.linalg.inv(a) @ chosen))
    assert np.sum(gradient * change) == pytest.approx(slope(lambda e: criterion(a + e * change)[0], 0.0, 1.0), rel=1e-6)


def test_every_choice_of_numbers_starts_and_ends_at_rest():
    rng = np.random.default_rng(1)
    coordinates = Coordinates(8.0, 4, np.array([0, 2]), np.array([0.1, 0.2, 0.3]), np.ones(3), np.full(3, 2.0), 100)
    series = coordinates.series(rng.normal(size=coordinates.count))
    _, v, a = series.at(np.array([0.0, 8.0, 16.0]))
    np.testing.assert_allclose(v, 0.0, atol=1e-12)
    np.testing.assert_allclose(a, 0.0, atol=1e-12)
    assert np.ptp(series.at(np.linspace(0, 8, 50))[0], axis=0)[1] == 0.0
    np.testing.assert_allclose(coordinates.numbers(series), coordinates.numbers(coordinates.series(coordinates.numbers(series))))
    times = np.linspace(0, 12, 700)
    found = fitted_series(times, series.at(times)[0], 8.0, 4)
    np.testing.assert_allclose(found.at(times)[0], series.at(times)[0], atol=1e-10)


def test_bounds_between_samples_hold():
    """Bounds from few samples against very many."""
    rng = np.random.default_rng(2)
    coordinates = Coordinates(10.0, 5, np.arange(3), np.zeros(3), np.ones(3), np.full(3, 2.0), 40)
    for _ in range(20):
        series = coordinates.series(rng.normal(size=coordinates.count))
        low, high, speed, acceleration = series.extremes(40)
        q, v, a = series.at(np.linspace(0, 10, 20_001))
        assert (q.max(axis=0) <= high).all() and (q.min(axis=0) >= low).all()
        assert (np.abs(v).max(axis=0) <= speed).all() and (np.abs(a).max(axis=0) <= acceleration).all()
        assert (speed <= 1.1 * np.abs(v).max(axis=0)).all()


@pytest.mark.parametrize("name", ["puma560", pytest.param("panda", marks=pytest.mark.slow)])
def test_motion_keeps_all_limits_by_pinocchio(name, tmp_path):
    """Joint torques and the base wrench from Pinocchio's own recursion, at ten times the recorded rate."""
    experiment = experiment_of(name, tmp_path)
    robot = experiment.robot
    ranges = np.array([400.0, 400.0, 700.0, 250.0, 250.0, 120.0])
    result = bayesid.excite(
        experiment, duration=10.0, period=10.0, sensor_range=tuple(ranges), acceleration=(8.0,), torque_share=0.5, seed=1, **QUICK
    )
    assert result.within_limits
    times = np.arange(12_501) / 1250.0
    q, v, a = result.series.at(times)
    span = 0.45 * (robot.upper - robot.lower)
    middle = 0.5 * (robot.upper + robot.lower)
    assert (np.abs(q - middle) <= span + 1e-9).all()
    assert (np.abs(v) <= 0.9 * robot.velocity_limit + 1e-9).all() and (np.abs(a) <= 0.9 * 8.0 + 1e-9).all()
    model = pin.buildModelFromUrdf(str(robot.urdf))
    free = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelFreeFlyer())
    data, free_data = model.createData(), free.createData()
    for k in range(0, len(times), 5):
        torque = pin.rnea(model, data, q[k], v[k], a[k])
        assert (np.abs(torque) <= 0.5 * robot.effort_limit).all()
        # The base's own wrench is that of a free root that does not move; the sensor is 0.1 m below it.
        wrench = pin.rnea(free, free_data, np.r_[np.zeros(6), 1.0, q[k]], np.r_[np.zeros(6), v[k]], np.r_[np.zeros(6), a[k]])[:6]
        moment = wrench[3:] - np.cross([0.0, 0.0, -0.1], wrench[:3])
        assert (np.abs(np.r_[wrench[:3], moment]) <= 0.8 * ranges).all()


def test_reports_of_sliding_joints_say_that_their_readings_may_be_forces(tmp_path):
    experiment = experiment_of("prismatic_arm", tmp_path)
    planned = bayesid.excite(experiment, duration=8.0, period=8.0, channel="torque", seed=1, **QUICK)
    assert "joint torques of the nominal links [N m or N]" in excitation_report(planned)
    recorded = bayesid.simulate(experiment, [planned.trajectory], seed=0)
    assert "joint torques [N m or N]" in check_report(bayesid.check(recorded))


def test_optimised_beats_random_motions_within_the_same_limits(tmp_path):
    """The determinant of the information; random motions are scaled as large as the limits allow."""
    experiment = experiment_of("ur5", tmp_path)
    result = bayesid.excite(experiment, channel="wrench", seed=0, **QUICK | {"seconds": 6.0})
    task, _ = make_task(experiment, ExcitationOptions(channel="wrench"))
    rng = np.random.default_rng(99)
    others = [random_feasible(task.coordinates, task.limits, rng, 240) for _ in range(60)]
    values = [np.linalg.slogdet(task.matrix(s))[1] for s in others if s is not None]
    assert len(values) == 60
    assert np.linalg.slogdet(task.matrix(result.series))[1] > max(values) + 20.0
    assert result.history[-1][1] == result.value == pytest.approx(np.linalg.slogdet(task.matrix(result.series))[1] / 40)


def test_warm_start_is_never_made_worse(tmp_path):
    experiment = experiment_of("ur5", tmp_path)
    first = bayesid.excite(experiment, seed=0, **QUICK)
    bayesid.write_trajectory(first.trajectory, tmp_path / "start.csv")
    again = bayesid.excite(experiment, seed=5, warm_start=tmp_path / "start.csv", **QUICK | {"randoms": 1})
    assert again.value >= first.value - 1e-6
    recorded = bayesid.simulate(experiment, [first.trajectory])
    named = bayesid.excite(recorded, seed=6, warm_start="trajectory", **QUICK | {"randoms": 1})
    assert named.value >= first.value - 0.05  # positions went through an encoder
    with pytest.raises(bayesid.InputError, match="no motion of that name; recorded motions: trajectory"):
        bayesid.excite(recorded, warm_start="nope", **QUICK)


def test_shrinking_to_fit_ends_at_the_limit(tmp_path):
    """A motion that is too fast and strong meets one of its limits and breaks none."""
    task, _ = make_task(experiment_of("puma560", tmp_path), ExcitationOptions(torque_share=0.2))
    rng = np.random.default_rng(0)
    for _ in range(5):
        series = task.coordinates.series(3.0 * rng.normal(size=task.coordinates.count))
        series.centre[:] = [0.0, -1.57, 1.57, 0.0, 0.0, 0.0]
        fitted = scaled_to_fit(series, task.limits, 1000)
        assert fitted is not None
        most = max(worst.max() for worst in task.limits.worst(fitted, 1000).values())
        assert 0.99 < most <= 1.0


BOXES = """<robot name="two"><link name="base"><collision><geometry><box size="0.3 0.3 0.1"/></geometry></collision></link>
<link name="upper"><inertial><mass value="2"/><origin xyz="0 0 0.2"/><inertia ixx="0.03" iyy="0.03" izz="0.01" ixy="0" ixz="0"
iyz="0"/></inertial>
<collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.04" length="0.3"/></geometry></collision></link>
<link name="fore"><inertial><mass value="1"/><origin xyz="0 0 0.2"/><inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0"
iyz="0"/></inertial><collision><origin xyz="0 0 0.25"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.05"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="3" effort="100"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0.1 0.4"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="3" effort="100"/></joint></robot>"""


def test_bodies_are_kept_apart(tmp_path):
    """The sphere from the box by hand, gradients by differences, and a motion that keeps the margin."""
    path = tmp_path / "boxes.urdf"
    path.write_text(BOXES, encoding="utf-8")
    robot = load_robot(path)
    bodies, notes = clearance(robot, {}, 0.03, ground=-0.2)
    assert bodies is not None and not notes
    assert set(bodies.names) == {"base and fore", "upper and ground", "fore and ground"}
    q = np.array([[1.2, 1.3], [0.4, 2.4], [1.9, -0.3]])
    pair = bodies.names.index("base and fore")
    centre = np.stack([0.4 * np.sin(q[:, 0]) + 0.25 * np.sin(q.sum(axis=1)), np.full(3, 0.1),
                       0.05 + 0.4 * np.cos(q[:, 0]) + 0.25 * np.cos(q.sum(axis=1))], axis=1)  # fmt: skip
    outside = np.maximum(np.abs(centre) - np.array([0.15, 0.15, 0.05]), 0.0)
    np.testing.assert_allclose(bodies.distances(q)[:, pair], np.linalg.norm(outside, axis=1) - 0.05, atol=1e-6)
    np.testing.assert_allclose(bodies.distances(q)[:, bodies.names.index("fore and ground")], centre[:, 2] + 0.15, atol=1e-6)
    weights = np.random.default_rng(0).uniform(size=(3, 3)) * (bodies.ratios(q) > 0)
    gradient = bodies.gradient(q, weights)
    for j in range(2):
        step = np.zeros((3, 2))
        step[:, j] = 1e-6
        difference = (bodies.ratios(q + step) - bodies.ratios(q - step)) / 2e-6
        np.testing.assert_allclose(gradient[:, j], np.sum(weights * difference, axis=1), atol=1e-4 * (1 + abs(difference).max()))
    result = bayesid.excite(robot, margin=0.03, ground=-0.2, rate=50.0, seed=0, **QUICK)
    q = result.series.at(np.linspace(0, 10, 3000))[0]
    assert bodies.distances(q).min() >= 0.03
    free = bayesid.excite(robot, collisions=False, rate=50.0, seed=0, **QUICK)
    assert bodies.distances(free.series.at(np.linspace(0, 10, 500))[0]).min() < 0.03  # else the limit would mean nothing


def box_mesh(path, half, height):
    """A box of triangles, centred at a height, as binary STL."""
    corners = np.array([[x, y, height + z] for x in (-half, half) for y in (-half, half) for z in (-half, half)])
    faces = "013 032 467 475 045 051 237 276 026 064 157 173".split()
    cells = b"".join(struct.pack("<12fH", 0, 0, 0, *corners[[int(c) for c in face]].ravel(), 0) for face in faces)
    path.write_bytes(b" " * 80 + struct.pack("<I", len(faces)) + cells)


def test_meshes_are_found_beside_the_urdf_and_told_when_missing(tmp_path):
    """A box as a mesh has the distances of a box; a mesh that is not there leaves its link unchecked, with a note."""
    (tmp_path / "meshes").mkdir()
    box_mesh(tmp_path / "meshes" / "box.stl", 0.05, 0.25)
    sphere = '<origin xyz="0 0 0.25"/><geometry><sphere radius="0.05"/></geometry>'
    shapes = {
        "box": '<origin xyz="0 0 0.25"/><geometry><box size="0.1 0.1 0.1"/></geometry>',
        "mesh": '<geometry><mesh filename="package://two/meshes/box.stl"/></geometry>',
        "missing": '<geometry><mesh filename="package://two/meshes/none.stl"/></geometry>',
    }
    found = {}
    for name, shape in shapes.items():
        path = tmp_path / f"{name}.urdf"
        path.write_text(BOXES.replace(sphere, shape), encoding="utf-8")
        found[name] = clearance(load_robot(path), {}, 0.02, ground=-0.2)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 2))
    box, mesh = found["box"][0], found["mesh"][0]
    assert box is not None and mesh is not None and box.names == mesh.names and not found["mesh"][1]
    apart = box.distances(q) > 0.0  # depths of overlap may differ
    np.testing.assert_allclose(mesh.distances(q)[apart], box.distances(q)[apart], atol=1e-5)
    assert found["missing"][0].names == ("upper and ground",)
    assert "collision meshes of fore are not there" in found["missing"][1][0]


def test_mount_enlarges_a_sine_by_its_response():
    """Of a slow and a faster sine, in closed form."""
    t = np.arange(1000) / 100.0
    readings = np.stack([2.0 * np.sin(2 * np.pi * 0.5 * t), 3.0 + np.sin(2 * np.pi * 3.0 * t)], axis=1)
    above, change = mount_response(readings, 10.0, 10.0)
    assert above == pytest.approx(np.sqrt(1.0 / 5.0))
    slow, fast = (abs(1 / (1 - r**2 + 0.04j * r) - 1) for r in (0.05, 0.3))
    assert change == pytest.approx(np.sqrt((4 * slow**2 + fast**2) / 5.0))


def test_interrupt_keeps_the_best_motion(tmp_path, monkeypatch):
    from bayesid.design.excitation import optimise

    calls, whole = [0], optimise.improve

    def stopped(*args):
        calls[0] += 1
        if calls[0] == 2:
            raise KeyboardInterrupt
        whole(*args)

    monkeypatch.setattr(optimise, "improve", stopped)
    monkeypatch.setattr(optimise, "_ROUNDS", 1)
    result = bayesid.excite(experiment_of("ur5", tmp_path), seed=0, **QUICK | {"starts": 3, "seconds": 60.0})
    assert result.interrupted and result.within_limits
    report = result.write(tmp_path / "out")
    assert "interrupted" in report.read_text(encoding="utf-8")
    written = json.loads((tmp_path / "out" / "excitation.json").read_text(encoding="utf-8"))
    assert written["interrupted"] and written["within_limits"]


def test_interrupt_among_random_motions_keeps_the_best_of_them(tmp_path, monkeypatch):
    from bayesid.design.excitation import optimise

    whole, seen = optimise.random_feasible, []

    def stopped(*args):
        if len(seen) == 3:
            raise KeyboardInterrupt
        seen.append(whole(*args))
        return seen[-1]

    monkeypatch.setattr(optimise, "random_feasible", stopped)
    result = bayesid.excite(experiment_of("ur5", tmp_path), seed=0, **QUICK)
    assert result.interrupted and result.within_limits and len(result.random) == 3
    assert result.value == pytest.approx(result.random.max(), abs=0.05)


def test_trajectory_can_be_simulated_and_identified(tmp_path):
    """What is written is a motion that can be recorded: the table reads back, and the estimate has every base parameter."""
    experiment = experiment_of("puma560", tmp_path)
    result = bayesid.excite(experiment, seed=0, rate=50.0, **QUICK)
    result.write(tmp_path / "out")
    back = bayesid.read_trajectory(tmp_path / "out" / "trajectory.csv", experiment.robot)
    np.testing.assert_allclose(back.accelerations, result.trajectory.accelerations, atol=1e-6)
    bare = bayesid.Trajectory("x", "identification", back.times, back.positions, back.velocities, back.accelerations)
    recorded = bayesid.simulate(experiment, [bare], seed=1)
    estimate = bayesid.identify(recorded, channel="wrench")
    assert estimate.estimate.base.rank == result.base.rank == result.possible == len(result.std)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (dict(criterion="x"), 'criterion="x"'),
        (dict(duration=20.0, period=7.0), "period=7"),
        (dict(harmonics=1), "harmonics=1"),
        (dict(rate=3.0), "rate=3"),
        (dict(joints=("nope",)), 'joints="nope"'),
        (dict(share=1.5), "share=1.5"),
        (dict(sensor_range=(100.0,)), "sensor_range"),
        (dict(sensor_range=(50.0, 500.0)), "fz reads at least"),
        (dict(mount_frequency=2.0), "mount_frequency=2"),
        (dict(acceleration=(1.0, 2.0)), r"acceleration=\[1, 2\]"),
        (dict(channel="torque", static=True), "static=True"),
    ],
)
def test_bad_options_are_told_in_one_line(options, said, tmp_path):
    with pytest.raises(bayesid.InputError, match=said.replace("(", "\\(")) as told:
        bayesid.excite(experiment_of("ur5", tmp_path), **QUICK | {"randoms": 1} | options)
    assert "\n" not in str(told.value)


def test_excess_is_taken_back_to_the_nearest_motion_within_limits(tmp_path):
    """A feasible motion blown up by a tenth is brought back within limits at all samples, and nearer than by shrinking."""
    task, _ = make_task(experiment_of("puma560", tmp_path), ExcitationOptions(torque_share=0.25))
    start = random_feasible(task.coordinates, task.limits, np.random.default_rng(4), 240)
    assert start is not None
    x = task.coordinates.numbers(start.scaled(1.1))
    assert max(np.abs(part).max() for part in task.limits.ratios(task.dense.motion(x))) > 1.05
    back = restored(task.limits, task.dense, x, 0.01)
    assert back is not None
    assert max(np.abs(part).max() for part in task.limits.ratios(task.dense.motion(back))) <= 0.995
    assert np.linalg.norm(back - x) < np.linalg.norm(task.coordinates.numbers(start) - x)


@pytest.mark.parametrize("given", [dict(stops=1), dict(stops=1251), dict(settle=-0.1), dict(read=float("nan"))])
def test_a_static_run_that_cannot_be_is_refused_before_the_search(given):
    with pytest.raises(bayesid.InputError, match=f"{next(iter(given))}="):
        bayesid.ExcitationOptions(duration=20.0, rate=125.0, **given)
