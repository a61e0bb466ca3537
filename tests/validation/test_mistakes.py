"""Mistakes of signs, orders, units and frames: named where they are made, and never where they are not."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

import bayesid
from bayesid.dynamics.channels import torque_channels
from bayesid.recordings.examination import check_channels
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.table import Table
from bayesid.regression.readings import make_channels
from bayesid.robot import inertia
from bayesid.robot.robot import load_robot
from bayesid.validation.mistakes.candidates import candidates, of_wrench
from bayesid.validation.mistakes.evidence import Change, Explainer, _non_negative, body_generators, independent_samples
from bayesid.validation.mistakes.from_data import orders
from bayesid.validation.mistakes.samples import low_passed
from bayesid.validation.mistakes.search import MistakeSearch, find_mistakes, unlike_urdf, worded
from tests.example_robots import Joint, Link, urdf_text
from tests.robots import ROBOTS, lwr4, ur5, wrist_sensor_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording
from tests.studies.mistakes import Made, changed, made, magnitudes, times, turned


def arm(folder: Path, masses: bool = True, seed: int = 0) -> Experiment:
    """Torques of a UR5 with friction, drives of their own inertia, and link masses a tenth off the URDF's."""
    robot = load_robot(write(folder, ur5()))
    rng = np.random.default_rng(seed)
    true = robot.nominal * (1.0 + 0.1 * rng.normal(size=(robot.n, 1)))
    motion = fourier(robot, seed, speed=1.0)
    table = recording(robot, None, motion, seed=seed, torque_std=0.3, resolution=1e-4, phi=true.ravel())
    _, _, v, a = motion
    friction = np.linspace(6.0, 1.5, robot.n) * np.tanh(v / 0.02) + 3.0 * v + np.linspace(2.0, 0.2, robot.n) * a
    assert table.torques is not None
    table = replace(table, torques=table.torques + friction, wrench=None)
    if not masses:
        robot = replace(robot, nominal=np.zeros_like(robot.nominal))
    return experiment(robot, [Motion("a", "identification", table)])


def on_sensor(folder: Path, seed: int = 0) -> Experiment:
    """The wrench under the paper's two-joint robot, with an unknown offset."""
    robot = puma2(folder)
    sensor = Sensor(rpy=np.array([0.2, -0.3, 0.5]), translation=np.array([0.0, 0.02, -0.08]))
    table = recording(
        robot,
        sensor,
        fourier(robot, seed),
        seed=seed,
        force_std=1.0,
        torque_std=0.2,
        resolution=1e-4,
        offset=np.array([5.0, -3.0, 20.0, 1.0, 2.0, -1.0]),
    )
    return experiment(robot, [Motion("a", "identification", replace(table, torques=None))], sensor)


@pytest.mark.parametrize("seed", range(2))
def test_recordings_without_a_mistake_raise_no_alarm(seed: int, tmp_path: Path) -> None:
    for whole in (arm(tmp_path, True, seed), arm(tmp_path, False, seed), on_sensor(tmp_path, seed)):
        assert find_mistakes(whole) == ()


@pytest.mark.parametrize(
    ("factors", "cause"), [([0.4] * 6, "currents"), ([0.3, 0.5, 0.4, 0.35, 0.45, 0.4], "currents"), ([2.0] * 6, "a load")]
)
def test_torques_of_another_size_in_every_joint_are_told_and_no_mistake(factors: list[float], cause: str, tmp_path: Path) -> None:
    """Motor-side torques of small gears, or currents, at 0.3 to 0.5 of what the URDF needs passed `check` in silence."""
    whole = changed(arm(tmp_path), times(np.diag(factors), "torques"))
    assert find_mistakes(whole) == ()
    told = unlike_urdf(whole)
    assert told is not None and cause in told
    sizes = {int(j): float(size) for size, j in re.findall(r"([\d.]+) \(tau(\d)\)", told)}
    assert len(sizes) > 1  # the others carry too little
    assert all(size == pytest.approx(factors[j - 1], rel=0.25) for j, size in sizes.items())  # links are a tenth off


def test_check_tells_torques_of_another_size(tmp_path: Path) -> None:
    whole = changed(arm(tmp_path), times(0.4 * np.eye(6), "torques"))
    assert unlike_urdf(whole) in bayesid.check(whole).warnings


def test_torques_of_the_usual_size_or_of_another_in_some_joints_are_not_told(tmp_path: Path) -> None:
    whole = arm(tmp_path)
    assert unlike_urdf(whole) is None and unlike_urdf(arm(tmp_path, masses=False)) is None
    assert unlike_urdf(changed(whole, times(np.diag([0.4, 1.0, 0.4, 0.4, 0.4, 0.4]), "torques"))) is None
    assert unlike_urdf(on_sensor(tmp_path)) is None


def names(whole: Experiment) -> set[tuple[str, str]]:
    return {pair for m in find_mistakes(whole) for pair in ((m.name, m.where), *m.alternatives)}


def one_a_kind(whole: Experiment, left_out: tuple[str, ...] = ()) -> list[Made]:
    """The second mistake of each kind: that of joint 2 where it concerns a joint, which carries the arm."""
    kinds: dict[str, list[Made]] = {}
    for one in made(whole):
        if one.named and one.kind not in left_out:
            kinds.setdefault(one.kind, []).append(one)
    return [every[min(1, len(every) - 1)] for every in kinds.values()]


#: Where the URDF has no masses, a base turned over or a little tilted is not told from masses in other places of the links, nor
#: is a wrist that is turned, nor are motors' torques or currents told from the torques of a toy.
NEEDS_MASSES = (
    "torques of the motors",
    "motor currents for torques",
    "stated to hang on the ceiling",
    "stated to be tilted by 10 degrees",
    "zeros of two joints a quarter turn off",
)


#: One mistake of a sign, of an order, of a unit and of a zero: enough to show that a URDF without masses does as well.
FEW = ("one torque negated", "two torques exchanged", "torques in N mm", "zero of one joint a quarter turn off")


def missed(every: list[Made]) -> list[tuple[str, tuple[tuple[str, str], ...]]]:
    """Kind and right names of mistakes that are not named."""
    return [(one.kind, one.named) for one in every if not set(one.named) & names(one.experiment)]


#: Kinds of which there is another with another number, axis or order.
ALIKE = (
    "stated to be tilted by 30 degrees",
    "stated to hang on a wall (x)",
    "stated to hang on a wall (y)",
    "cyclic order of positions",
    "cyclic order of both",
    "alphabetical order of torques",
    "alphabetical order of both",
    "torques of the motors",
)


@pytest.mark.parametrize(
    ("masses", "left_out"),
    [
        pytest.param(True, ALIKE, id="masses"),
        pytest.param(True, (), id="masses, every kind", marks=pytest.mark.slow),
        pytest.param(False, NEEDS_MASSES, id="no masses", marks=pytest.mark.slow),
    ],
)
def test_mistakes_with_torques_are_named(masses: bool, left_out: tuple[str, ...], tmp_path: Path) -> None:
    every = one_a_kind(arm(tmp_path, masses), left_out)
    assert missed(every) == []
    assert len(every) >= 9


def test_a_few_mistakes_are_named_beside_a_urdf_without_masses(tmp_path: Path) -> None:
    every = [one for one in one_a_kind(arm(tmp_path, False)) if one.kind in FEW]
    assert missed(every) == []
    assert len(every) == len(FEW)


def test_mistakes_with_a_wrench_are_named(tmp_path: Path) -> None:
    every = one_a_kind(on_sensor(tmp_path), ("degrees for radians",))
    assert missed(every) == []
    assert len(every) >= 15


def test_the_line_says_what_by_how_much_and_what_to_do(tmp_path: Path) -> None:
    whole = changed(arm(tmp_path), times(np.diag([1.0, 1, -1, 1, 1, 1]), "torques"))
    (found,) = find_mistakes(whole)
    assert "tau3" in found.text and "opposite sign" in found.text and "change the sign of tau3" in found.text
    assert "\n" not in found.text
    assert found.before[2] > 5.0 * found.after[2]
    inspected = bayesid.check(whole)
    assert inspected.warnings[0] == found.text
    assert inspected.to_dict()["mistakes"][0]["name"] == "torque_sign"
    assert found.text in str(inspected)


def test_fewer_numbers_that_explain_as_much_are_told_as_such(tmp_path: Path) -> None:
    whole = arm(tmp_path)
    samples = low_passed(whole, "torque")
    assert samples is not None
    explainer = Explainer(whole.robot, make_channels(whole, "torque"), samples)
    any_bodies, nominal = explainer.fit()
    alike = [(candidates(whole, "torque", samples)[0], replace(nominal, left=any_bodies.left))]
    text = worded(whole, explainer, any_bodies, alike, 12.0).text
    assert "the URDF's bodies, each times a factor, leave " in text and "falls from" not in text


def test_a_thousandth_may_be_what_large_gears_leave_of_a_torque(tmp_path: Path) -> None:
    """Torques of the motors of an industrial robot, with gears of 400 and more, were said to be in kN m."""
    whole = arm(tmp_path)
    (found,) = find_mistakes(changed(whole, times(np.eye(whole.robot.n) / 450.0, "torques")))
    assert "in kN m instead of N m; or those of the motors" in found.text and "or multiply each by its gear ratio" in found.text


def test_torques_without_signs_are_refused_and_others_are_not(tmp_path: Path) -> None:
    table = arm(tmp_path).motions[0].table
    assert check_channels(table) == []
    with pytest.raises(bayesid.InputError, match="never negative"):
        check_channels(magnitudes(table))
    # At rest they may be: an arm that is lifted from where it hangs, as an exoskeleton's.
    (said,) = check_channels(magnitudes(table), moves=False)
    assert "never negative, as if they were magnitudes; if they are, export them with their signs" in said


def test_two_joints_may_be_loaded_to_one_side(tmp_path: Path) -> None:
    table = recording(puma2(tmp_path), None, fourier(puma2(tmp_path), 1), torque_std=0.05, seed=1)
    assert table.torques is not None
    with pytest.raises(bayesid.InputError, match="never negative"):
        check_channels(magnitudes(table))
    assert check_channels(replace(table, torques=table.torques - table.torques.min(axis=0))) == []


@pytest.mark.parametrize("kind", ["trajectory", "poses"])
def test_gravity_may_load_every_joint_to_one_side(kind: str, tmp_path: Path) -> None:
    """A boom, a stick and a bucket before it, as an excavator has, never reach far enough up or down to be without a load."""
    links = [
        Link(name, mass, (0.4, 0.0, 0.0), (0.1, 0.4, 0.4)) for name, mass in (("boom", 8.0), ("stick", 6.0), ("bucket", 4.0))
    ]
    pairs = (("base", "boom"), ("boom", "stick"), ("stick", "bucket"))
    joints = [Joint(f"j{k}", *pair, (0.8 * (k > 0), 0.0, 0.0), axis=(0.0, -1.0, 0.0)) for k, pair in enumerate(pairs)]
    (tmp_path / "robot.urdf").write_text(urdf_text("boom", [Link("base"), *links], joints), encoding="utf-8")
    robot = bayesid.load_robot(tmp_path / "robot.urdf")
    t = np.arange(2500) / 125.0
    rate = np.array([0.9, 1.3, 1.7])
    q, v, a = (0.25 * rate**k * np.sin(np.outer(t, rate) + 0.5 * k * np.pi) for k in range(3))
    table = recording(robot, None, (t, q, v, a), torque_std=0.05, seed=1)
    if kind == "poses":
        table = recording(robot, None, (t[::50], q[::50], 0.0 * q[::50], 0.0 * q[::50]), torque_std=0.05, seed=1)
    assert table.torques is not None and (table.torques > 0.0).all()
    bayesid.Experiment("boom", robot, (bayesid.Motion("one", "identification", table, kind),))
    turned = bayesid.Motion(
        "one", "identification", replace(table, torques=np.abs(table.torques - table.torques.mean(axis=0))), kind
    )
    if kind == "poses":  # at rest an arm that is lifted from where it hangs reads so, too
        assert any("never negative" in text for text in bayesid.Experiment("boom", robot, (turned,)).warnings)
        return
    with pytest.raises(bayesid.InputError, match="never negative"):
        bayesid.Experiment("boom", robot, (turned,))


def test_generators_hold_the_bodies_of_real_arms(tmp_path: Path) -> None:
    """Uniform ellipsoids about the links are sums of generators, and masses are never negative."""
    for name, text in ROBOTS.items():
        robot = load_robot(write(tmp_path, text()))
        generators = body_generators(robot)
        scale = np.abs(generators).max(axis=1)
        _, left = nnls(generators / scale[:, None], robot.nominal.ravel()[: len(scale)] / scale)
        assert left < 0.1 * np.linalg.norm(robot.nominal.ravel() / scale), name
        mixed = np.random.default_rng(0).uniform(size=generators.shape[1])
        bodies = (generators @ mixed).reshape(-1, 10)
        assert (bodies[:, 0] > 0.0).all()
        assert all(np.linalg.eigvalsh(inertia.inertia_matrix(body))[0] > 0.0 for body in bodies)


def test_undoing_a_candidate_is_its_own_mistake_undone(tmp_path: Path) -> None:
    """Every change of readings can be undone, and no two candidates of a sensor are the same."""
    sensor = Sensor(rpy=np.array([0.2, -0.3, 0.5]), translation=np.array([0.0, 0.02, -0.08]))
    matrices = [c.change.readings for c in of_wrench(sensor) if c.change.readings is not None]
    assert all(abs(np.linalg.det(m)) > 0.0 for m in matrices)
    flat = np.array([m.ravel() for m in matrices])
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2) + np.eye(len(flat))
    assert apart.min() > 1e-6
    assert sum(c.name == "sensor_axes" for c in of_wrench(sensor)) == 46


def test_changes_of_units_alone_are_no_evidence(tmp_path: Path) -> None:
    """The density is that of the readings as recorded: all of them in another unit are exactly as probable."""
    whole = arm(tmp_path)
    samples = low_passed(whole, "torque")
    assert samples is not None
    explainer = Explainer(whole.robot, torque_channels(whole.robot), samples)
    here, there = explainer.fit()[0], explainer.fit(Change(1e3 * np.eye(whole.robot.n)))[0]
    assert there.log_likelihood == pytest.approx(here.log_likelihood, abs=0.05)
    every = candidates(whole, "torque", samples)
    assert len({(c.name, c.where) for c in every}) == len(every)


@pytest.mark.parametrize("channel", ["wrench", "torque"])
def test_no_fit_reaches_beyond_the_highest_score(channel: str, tmp_path: Path) -> None:
    """So nothing is lost with candidates whose highest score is too low; with this noise, some are worth a fit and some not."""
    whole = arm(tmp_path) if channel == "torque" else on_sensor(tmp_path)
    samples = low_passed(whole, channel)
    assert samples is not None
    noise = 0.05 * samples.readings.std(axis=0) * np.random.default_rng(0).normal(size=samples.readings.shape)
    explainer = Explainer(whole.robot, make_channels(whole, channel), replace(samples, readings=samples.readings + noise))
    worth = independent_samples(explainer.fit()[0].residual, explainer.samples.part)
    every = [*candidates(whole, channel, samples), *orders(explainer, np.ones(whole.robot.n, bool))]
    for c in every[:: max(1, len(every) // 25)]:
        score = max(fit.score(worth) for fit in explainer.fit(c.change))
        assert score <= explainer.highest_score(c.change, worth) + 1e-6
        assert score <= explainer.highest_score(None, worth) + 1e-9


@pytest.mark.parametrize("kept", [1, pytest.param(30, marks=pytest.mark.slow), 150])
def test_little_data_and_absurd_numbers_do_no_harm(kept: int, tmp_path: Path) -> None:
    def short(t: Table) -> Table:
        assert t.torques is not None
        return Table(t.times[:kept], t.positions[:kept], torques=t.torques[:kept])

    whole = arm(tmp_path)
    assert find_mistakes(changed(whole, short)) == ()
    for factor in (0.0, 1e6):
        find_mistakes(changed(whole, times(factor * np.eye(6), "positions")))
        find_mistakes(changed(whole, times(factor**2 * np.eye(6), "torques")))
    find_mistakes(replace(whole, robot=replace(whole.robot, gravity=np.zeros(3))))


def test_identify_warns_of_masses_and_friction_with_a_sign_that_nothing_has(tmp_path: Path) -> None:
    whole = arm(tmp_path)
    effects = ["viscous_friction", "coulomb_friction", "rotor_inertia"]
    right = bayesid.identify(whole, method="ols", effects=effects)
    assert not any("cannot be negative" in line or "opposite sign" in line for line in right.warnings)
    negated = changed(whole, times(np.diag([1.0, 1, -1, 1, 1, 1]), "torques"))
    wrong = bayesid.identify(negated, method="ols", effects=effects)
    # That the links are of no use comes first, then why, then what else no robot has.
    useless, mistake, friction = wrong.warnings[:3]
    assert "no usable result" in useless and "change the sign of tau3" in mistake
    assert "Friction that cannot be negative" in friction and "coulomb_friction@joint3" in friction


def test_identify_names_a_mistake_where_a_held_out_motion_is_not_predicted(tmp_path: Path) -> None:
    """With the positions of two joints exchanged no mass need be negative."""
    robot = load_robot(write(tmp_path, ur5()))
    motions = [
        bayesid.fourier_trajectory(robot, "fitted", "identification", duration=10.0, seed=1),
        bayesid.fourier_trajectory(robot, "unseen", "validation", duration=8.0, seed=2),
    ]
    right = bayesid.simulate(robot, motions, recorder=bayesid.Recorder(torque_std=0.3, resolution=1e-4), perturb=0.1, seed=1)
    exchanged = changed(right, times(np.eye(6)[[0, 2, 1, 3, 4, 5]], "positions"))
    said = [any("xchange" in line for line in bayesid.identify(e, "torque").warnings) for e in (right, exchanged)]
    assert said == [False, True]


@pytest.mark.parametrize("centre", [0.0, 0.8, 1.5])
@pytest.mark.parametrize("amplitude", [0.02, 0.1, 0.3])
def test_a_small_motion_without_noise_keeps_its_unit(tmp_path, centre, amplitude):
    """One slow sine a joint hardly tells weight from offset, stiffness and friction; its size must come out all the same."""
    robot = puma2(tmp_path)
    clock = np.arange(0.0, 20.0, 0.008)
    w, phase = 2 * np.pi * 0.2, np.array([0.0, 0.7])
    angle = w * clock[:, None] + phase
    q, v, a = (amplitude * x for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
    table = recording(robot, None, (clock, q + [0.0, centre], v, a))
    whole = experiment(robot, [Motion("slow", "identification", table)])
    assert find_mistakes(whole) == ()
    samples = low_passed(whole, "torque")
    assert samples is not None
    explainer = Explainer(robot, make_channels(whole, "torque"), samples)
    assert explainer.size_beside(robot.nominal) == pytest.approx(1.0, abs=0.01)
    assert explainer.size_beside(2.0 * robot.nominal) == pytest.approx(0.5, abs=0.01)
    assert explainer.gained_by_size(robot.nominal, 1.0) < 0.01


def test_a_tie_names_the_torques_first_and_says_what_decides(tmp_path: Path) -> None:
    """Reversed torques and mirrored positions fit alike on this arm; positions follow the URDF, and a look at a pose decides."""
    robot = load_robot(write(tmp_path, lwr4()))
    table = recording(robot, None, fourier(robot, 1, speed=1.0), torque_std=0.3, resolution=1e-4, seed=1)
    whole = experiment(robot, [Motion("a", "identification", table)])
    (found,) = find_mistakes(changed(whole, times(-np.eye(7), "torques")))
    assert (found.name, found.alternatives) == ("torque_signs", (("position_signs", ""),))
    assert "change the sign of every tau" in found.text and "change the sign of every q" in found.text
    moment = re.search(r"at ([0-9.]+) s of \'a\' the origin of (\S+) stands at \(([^)]*)\) m.*and at \(([^)]*)\) m", found.text)
    assert moment is not None
    k, link = int(np.argmin(np.abs(table.times - float(moment[1])))), robot.joint_names.index(moment[2])
    for sign, said in ((1.0, moment[3]), (-1.0, moment[4])):
        model = pin.buildModelFromUrdf(str(robot.urdf))
        data = model.createData()
        pin.forwardKinematics(model, data, sign * table.positions[k])
        place = data.oMi[link + 1].translation
        assert np.array(list(map(float, said.split(",")))) == pytest.approx(place, abs=0.02)


def test_a_wrench_in_base_axes_is_named_whatever_its_sign(tmp_path: Path) -> None:
    """What a wrist sensor reads, turned into the base's axes by Pinocchio."""
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    sensor = Sensor(rpy=np.array([0.0, 0.0, 0.4]), joint="wrist_ft")
    table = recording(robot, sensor, fourier(robot, 1), force_std=0.05, torque_std=0.005, seed=1)
    whole = experiment(robot, [Motion("a", "identification", replace(table, torques=None))], sensor)
    assert find_mistakes(whole) == ()
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data, frame = model.createData(), model.getFrameId("wrist_ft")

    def turned(q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(model, data, q)
        rotation = data.oMf[frame].rotation @ pin.rpy.rpyToMatrix(0.0, 0.0, 0.4)
        return (wrench.reshape(2, 3) @ rotation.T).ravel()

    def in_base(sign: float, t: Table) -> Table:
        assert t.wrench is not None
        return replace(t, wrench=sign * np.array([turned(*row) for row in zip(t.positions, t.wrench, strict=True)]))

    for sign, where in ((1.0, "base"), (-1.0, "base, opposite")):
        found = find_mistakes(changed(whole, partial(in_base, sign)))
        assert [(m.name, m.where) for m in found] == [("wrench_frame", where)]


def weighed(folder: Path, gravity: np.ndarray, mass: float = 0.3, centre: tuple[float, ...] = (0.025, 0.0, 0.023)) -> Experiment:
    """Poses of the wrist's last joints on a base that is stated to stand upright, weighed under another gravity by Pinocchio."""
    robot = load_robot(write(folder, wrist_sensor_arm()), sensor_joint="wrist_ft")
    lift, five, six = np.radians([0.0, -45.0]), np.radians([0.0, -90.0, -45.0, 45.0]), np.radians([0.0, 90.0, 180.0, -90.0])
    positions = np.array([[0.0, a, 0.0, 0.0, b, c] for a in lift for b in five for c in six])
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data, frame = model.createData(), model.getFrameId("wrist_ft")
    wrench = np.random.default_rng(0).normal(size=(len(positions), 6)) * np.repeat([0.04, 0.001], 3)
    for row, q in zip(wrench, positions, strict=True):
        pin.framesForwardKinematics(model, data, q)
        force = -mass * data.oMf[frame].rotation.T @ gravity
        row += [*force, *np.cross(centre, force)]
    table = Table(np.arange(len(positions), dtype=float), positions, wrench=wrench + [0.4, -3.0, 5.0, -0.07, -0.02, -0.05])
    return experiment(robot, [Motion("a", "identification", table, kind="poses")], Sensor(joint="wrist_ft"))


@pytest.mark.parametrize(("mass", "centre"), [(0.5, (0.02, 0.0, 0.15)), (1.2, (0.01, 0.0, 0.3)), (12.0, (0.0, 0.02, 0.1))])
def test_a_long_tool_or_a_heavy_load_in_the_wrist_is_no_mistake(mass: float, centre: tuple[float, ...], tmp_path: Path) -> None:
    """No URDF tells what a wrist sensor carries: forces of a tool 0.15 m away, or of 12 kg, were said to be in another unit."""
    whole = weighed(tmp_path, np.array([0.0, 0.0, -9.81]), mass, centre)
    assert find_mistakes(whole) == ()
    in_kgf = changed(whole, times(np.diag(np.repeat([1.0 / 9.80665, 1.0], 3)), "wrench"))
    assert mass > 1.2 or ("force_unit", "kgf") in names(in_kgf)


def test_forces_that_a_tool_of_unusual_length_would_read_are_said_to_be_right_there(tmp_path: Path) -> None:
    """At rest a body ten times as far away reads the moments of forces in kgf: no reading tells the two apart."""
    (found,) = find_mistakes(weighed(tmp_path, np.array([0.0, 0.0, -9.81]), 1.2, (0.01, 0.0, 0.6)))
    assert found.name == "force_unit" and "they are right where the centre of mass" in found.text and "over 0.4 m" in found.text


@pytest.mark.parametrize(("axis", "angle"), [("x", 80.0), ("y", 80.0), ("y", 100.0), ("y", 105.0)])
def test_a_base_at_any_angle_is_named_once_where_zeros_of_joints_say_as_much(axis: str, angle: float, tmp_path: Path) -> None:
    """Near a wall, joints that count from another zero explain as much as a wall does: nothing was named then, or gravity upside
    down; and the same direction could be listed as another that is as likely."""
    turned = pin.rpy.rpyToMatrix(*np.radians(angle) * np.array([axis == "x", axis == "y", 0.0])) @ [0.0, 0.0, -9.81]
    (found,) = find_mistakes(weighed(tmp_path, turned))
    assert (found.name, found.alternatives) == ("base_tilt", ())
    match = re.search(r"gravity = \[(.*?)\]", found.text)
    assert match is not None
    np.testing.assert_allclose([float(part) for part in match[1].split(",")], turned, atol=0.03)


def test_what_only_mixes_columns_explains_nothing(tmp_path: Path) -> None:
    """A shear that decorrelates two residuals is no remedy: what is left is counted in the columns as recorded."""
    whole = on_sensor(tmp_path)
    samples = low_passed(whole, "wrench")
    assert samples is not None
    common = samples.readings[:, :1].std() * np.random.default_rng(0).normal(size=(len(samples), 1))
    mixed = replace(samples, readings=samples.readings + common * np.array([1.0, 0, 0, 0, 1.0, 0]))
    explainer = Explainer(whole.robot, make_channels(whole, "wrench"), mixed)
    shear = np.eye(6)
    shear[4, 0] = -1.0  # takes the common error out of my
    null, sheared = explainer.fit()[0], explainer.fit(Change(readings=shear))[0]
    assert sheared.left[4] > 0.9 * null.left[4]
    assert sheared.log_likelihood < null.log_likelihood + 0.1


def test_what_is_not_known_here_gets_no_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrench about a point that moves with nothing, and turned by an angle that no candidate has."""
    whole = on_sensor(tmp_path)
    turn = Rotation.from_euler("xyz", [0.9, -0.7, 0.5]).as_matrix()
    skewed = changed(whole, times(np.kron(np.eye(2), turn), "wrench"))
    found = find_mistakes(skewed)
    assert all(m.name == "not_explained" and "no mistake" in m.text for m in found)
    torques = changed(arm(tmp_path), times(np.diag([1.0, -1, 1, 1, 1, 1]), "torques"))
    assert find_mistakes(torques)[0].name == "torque_sign"
    listed = {("torque_sign", "tau2"), ("position_sign", "q2"), ("torque_scales", "")}
    every = MistakeSearch.try_out
    monkeypatch.setattr(
        MistakeSearch, "try_out", lambda search, given: every(search, [c for c in given if (c.name, c.where) not in listed])
    )
    assert all(m.name == "not_explained" for m in find_mistakes(torques))


@pytest.mark.parametrize(
    "quarters", [(0, -1, 0, -1, 0, 0), pytest.param((0, -1, 0, 0, 1, 0), marks=pytest.mark.slow), (0, 0, 2, 0, 0, 0)]
)
def test_zeros_of_several_joints_are_found_together(quarters: tuple[int, ...], tmp_path: Path) -> None:
    """As angles of Denavit and Hartenberg beside a URDF; what is found is what must be added, and nothing is wrong then."""
    added = 0.5 * np.pi * np.array(quarters)
    recorded = changed(arm(tmp_path), turned(-added))
    (found,) = find_mistakes(recorded)
    assert found.name == ("position_zeros" if np.count_nonzero(added) > 1 else "position_zero")
    told = {int(j): float(angle) for angle, j in re.findall(r"([+-][\d.]+) rad \([+-]\d+ degrees\) to q(\d)", found.text)}
    assert told == {j + 1: pytest.approx(angle, abs=1e-4) for j, angle in enumerate(added) if angle}
    corrected = np.array([told.get(j + 1, 0.0) for j in range(6)])
    assert find_mistakes(changed(recorded, turned(corrected))) == ()


def test_what_mends_little_of_what_is_wrong_is_not_accused(tmp_path: Path) -> None:
    """Readings without a mistake, most of whose variation no robot explains: a better fit of the rest accuses nobody."""
    whole = arm(tmp_path)
    samples = low_passed(whole, "torque")
    assert samples is not None
    # Something that no rigid robot does, as large as what gravity and inertia do, in joints 1 to 3.
    clock = np.linspace(0.0, 40.0, len(samples))[:, None]
    other = samples.readings.std(axis=0) * np.sin(
        clock * [1.0, 1.3, 1.7, 0.0, 0.0, 0.0] + 5.0 * samples.positions[:, [2, 0, 1] * 2]
    )
    wrong = {"tau5": np.diag([1.0, 1, 1, 1, -1, 1]), "": np.eye(6)}
    for where, matrix in wrong.items():
        mixed = replace(samples, readings=(samples.readings + other * [1, 1, 1, 0, 0, 0]) @ matrix)
        explainer = Explainer(whole.robot, torque_channels(whole.robot), mixed)
        worth = independent_samples(explainer.fit()[0].residual, mixed.part)
        mended = {(c.name, c.where) for c in candidates(whole, "torque", mixed) if explainer.mended(c.change, worth, 5.0)}
        assert mended <= {("torque_sign", "tau5"), ("position_sign", "q5")}
        assert (("torque_sign", where) in mended) == bool(where)


def test_a_robot_is_judged_by_what_it_was_not_fitted_to(tmp_path: Path) -> None:
    """Every quarter is predicted by fits to the other three: what is left of noise is no less than the noise."""
    whole = arm(tmp_path)
    samples = low_passed(whole, "torque")
    assert samples is not None
    assert (np.bincount(samples.quarter) >= len(samples) // 4).all() and (np.diff(samples.quarter) >= 0).all()
    noise = np.random.default_rng(0).normal(size=samples.readings.shape)
    explainer = Explainer(whole.robot, torque_channels(whole.robot), replace(samples, readings=noise))
    fitted, foretold = explainer.fit()[0].left, explainer.left_out()[0]
    assert (foretold > fitted).all() and (foretold > 0.99 * noise.std(axis=0)).all()


def test_a_counterbalance_is_no_mistake_of_the_recording(tmp_path: Path) -> None:
    """Weight that is not in one torque: by a controller, or by a part of the robot, in which case nothing is to be added."""
    whole = arm(tmp_path)
    lighter = next(one.experiment for one in made(whole) if ("gravity_removed", "tau2") in one.named)
    (found,) = find_mistakes(lighter)
    assert {("gravity_removed", "tau2"), ("gravity_removed", "tau2 nominal")} == {(found.name, found.where), *found.alternatives}
    assert "counterbalance is part of the robot: add spring@joint2 to [model] effects" in found.text
    assert "and change no torque" in found.text and "if a controller does that" in found.text


def test_torques_of_some_joints_are_looked_at_as_well(tmp_path: Path) -> None:
    whole = changed(arm(tmp_path), times(np.diag([1.0, -1, 1, 1, 1, 1]), "torques"))

    def without(t: Table) -> Table:
        assert t.torques is not None
        return replace(t, torques=np.where(np.arange(6) < 3, t.torques, np.nan))

    assert ("torque_sign", "tau2") in names(changed(whole, without))
    assert find_mistakes(changed(arm(tmp_path), without)) == ()


def test_a_lift_without_its_weight_is_told(tmp_path: Path) -> None:
    """A column on a lift: an offset takes the missing weight in any fit, so only its size tells."""
    robot = load_robot(write(tmp_path, LIFT))
    clock = np.arange(0.0, 20.0, 0.01)
    w, size = 2 * np.pi * np.array([0.21, 0.33]), np.array([0.1, 0.8])
    angle = w * clock[:, None]
    q, v, a = (size * x for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
    table = recording(robot, None, (clock, q, v, a), torque_std=0.05, seed=0)
    whole = experiment(robot, [Motion("a", "identification", table)])
    assert find_mistakes(whole) == ()
    assert table.torques is not None
    weight = 9.81 * (3.0 + 2.0)
    lighter = replace(table, torques=table.torques - [weight, 0.0])
    (found,) = find_mistakes(experiment(robot, [Motion("a", "identification", lighter)]))
    assert (found.name, found.where) == ("gravity_removed", "tau1")
    assert "49 N" in found.text or "49.0 N" in found.text or "49.1 N" in found.text


#: A carriage of 3 kg on a vertical rail, and an arm of 2 kg that swings about a horizontal axis on it.
LIFT = """<robot name="lift"><link name="base"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="500" velocity="5"/></joint>
<link name="carriage"><inertial><mass value="3"/>
<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><origin xyz="0.1 0 0"/><parent link="carriage"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="500" velocity="5"/></joint>
<link name="arm"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/>
</inertial></link></robot>"""


def test_an_angle_that_is_rounded_in_the_urdf_explains_nothing_by_a_thousand_tons(tmp_path: Path) -> None:
    """Gravity along parallel axes pulls at no joint, nor does it where one is off by what 1.5708 leaves of a right angle."""
    left, heaviest = [], []
    for angle in (0.0, 1.5708 - 0.5 * np.pi):
        text = ur5()
        start = text.index('rpy="', text.index('name="shoulder_lift_joint"'))
        text = f'{text[:start]}rpy="{angle} 0 0{text[text.index(chr(34), start + 5) :]}'
        robot = load_robot(write(tmp_path, text), ["shoulder_lift_joint", "elbow_joint"])
        motion = fourier(robot, 0, duration=10.0)
        table = recording(replace(robot, gravity=np.zeros(3)), None, motion, torque_std=0.1)
        table = replace(table, torques=table.torques + 3.0 * np.tanh(motion[2] / 0.05) + 4.0 * np.sin(motion[1] * [9.0, 7.0]))
        whole = experiment(robot, [Motion("a", "identification", table)])
        fit = Explainer(robot, torque_channels(robot), low_passed(whole, "torque")).fit(
            Change(gravity=np.array([0.0, 9.81, 0.0]))
        )[0]
        left.append(fit.left)
        heaviest.append(fit.parameters[: 10 * robot.n : 10].max())
    assert max(heaviest) < 1e4
    np.testing.assert_allclose(left[1], left[0], rtol=1e-3)


def test_what_no_reading_shows_is_rounding_of_either_sign():
    squares = np.diag([4.0, -1e-18, 1.0])
    np.testing.assert_allclose(_non_negative(squares, np.array([8.0, 0.0, -3.0]), 0.0), [2.0, 0.0, 0.0])
    np.testing.assert_array_equal(_non_negative(np.zeros((2, 2)), np.zeros(2), 0.0), 0.0)
