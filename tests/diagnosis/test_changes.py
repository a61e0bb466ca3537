"""What changed since a reference: evidence against dense algebra, simulated pairs of recordings, and a real arm."""

import json
from dataclasses import replace
from itertools import permutations
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import bayesid
from bayesid.cli import main
from bayesid.diagnosis.changes.evidence import Marginal, Reduced, amplitudes, expected_gain, gain
from bayesid.diagnosis.changes.findings import ReferenceComparison
from bayesid.diagnosis.changes.hypotheses import Hypothesis, SharedAmplitudes, hypotheses, warming_columns
from bayesid.diagnosis.changes.proposals import make_proposals, with_proposals
from bayesid.diagnosis.changes.recording import read_recording
from bayesid.diagnosis.changes.reference import LearnedParameters, learn_reference
from bayesid.diagnosis.changes.scales import DISPERSIONS, SIZES, WANDER_FACTORS
from bayesid.diagnosis.settings import DEFAULT
from bayesid.effects import EffectLibrary, JointTorqueEffect, Parameter, Term
from bayesid.effects.friction import CoulombFriction
from bayesid.estimators.covariance import Middle
from bayesid.estimators.factor import Factor
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.experiment import Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.regression.problem import prepare, relinearised
from bayesid.report.changes import changes_report, hidden_table
from bayesid.results.changes import Changes, hidden_sentences, next_experiment
from bayesid.robot import inertia
from bayesid.robot.robot import load_robot
from tests.robots import puma560, scara, wrist_sensor_arm, write
from tests.simulated import experiment, fourier, puma2, recording


def _dense(rows, left, known, mean, spread):
    """Best log density over dispersions of a Gaussian with these directions, and of each size of further ones."""
    out = []
    for size in SIZES:
        directions = np.hstack([known, size * spread])
        covariance = rows @ directions @ directions.T @ rows.T
        out.append([multivariate_normal.logpdf(left - rows @ mean, cov=covariance + k * np.eye(len(left))) for k in DISPERSIONS])
    return np.log(np.mean(np.exp(np.array(out) - np.max(out)), axis=0)).max() + np.max(out)


@pytest.mark.parametrize(("standing", "together"), [(False, False), (True, False), (False, True)])
def test_evidence_is_that_of_the_dense_gaussian(standing, together):
    rng = np.random.default_rng(3)
    rows, known = rng.normal(size=(40, 7)), rng.normal(size=(7, 3)) * 0.5
    left = rows @ rng.normal(size=7) + rng.normal(size=40)
    both = None
    always, mean = np.zeros((7, 0)), np.zeros(7)
    if standing:
        root, wander = np.array([[0.4, 0.0], [0.1, 0.2]]), np.array([0.1, 0.3])
        both = SharedAmplitudes(np.array([5, 6]), np.array([0.3, -0.2]), root, wander)
        always = np.zeros((7, 4))
        always[[5, 6], 2:], always[3, 0], always[4, 1] = both.root, 0.1, 0.3
        mean[[5, 6]] = both.mean
    effects, columns = (CoulombFriction("joint1", 0),), np.array([3, 4])
    change = Hypothesis("x", "y", effects, columns, np.array([0.5, 2.0]), both, together=together)
    spread = np.zeros((7, 2))
    spread[3, 0], spread[4, 1] = 0.5, 2.0
    spread = spread.sum(axis=1, keepdims=True) if together else spread
    marginal = Marginal(Reduced.of(rows, left), known, np.zeros(7))
    with_it = _dense(rows, left, np.hstack([known, always]), mean, spread)
    without = _dense(rows, left, np.hstack([known, always]), mean, np.zeros((7, 0)))
    assert gain([marginal], change) == pytest.approx(with_it - without, abs=1e-8)


def test_expected_evidence_is_the_mean_over_noise():
    """Although a larger dispersion, or links further from the reference, may stand in for a small change."""
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(300, 7))
    rows[:, 6] += 2.0 * rows[:, 0]  # links could nearly do what the change does
    known = 0.04 * np.eye(7)[:, :5]
    change = Hypothesis("x", "y", (CoulombFriction("joint1", 0),), np.array([6]), np.array([1.0]))

    def marginals(left):
        return [Marginal(Reduced.of(rows, left), f * known, np.zeros(7), f, p) for f, p in WANDER_FACTORS.items()]

    noise = rng.normal(size=(60, 300))
    for amplitude in (0.2, 0.3, 0.5):
        gains = [gain(marginals(rows[:, 6] * amplitude + e), change) for e in noise]
        told = [expected_gain(marginals(e), change, np.array([0.1]))(10.0 * amplitude) for e in noise]
        assert np.mean(told) == pytest.approx(np.mean(gains), abs=1.0) and np.mean(gains) > 3.0


def test_posterior_is_that_of_bayes_rule():
    rng = np.random.default_rng(4)
    rows, known = rng.normal(size=(30, 5)), rng.normal(size=(5, 4))
    left = rows @ rng.normal(size=5) + 0.5 * rng.normal(size=30)
    marginal = Marginal(Reduced.of(rows, left, correlation=2.0), known, np.full(5, 0.1))
    found = amplitudes(marginal)
    noise = 2.0 * marginal.dispersion * np.eye(30)
    prior = known @ known.T
    kalman = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + noise)
    assert found.all == pytest.approx(0.1 + kalman @ (left - rows @ np.full(5, 0.1)), abs=1e-9)
    spread = found.part_root(slice(None))
    assert spread @ spread.T == pytest.approx(prior - kalman @ rows @ prior, abs=1e-9)


COULOMB, VISCOUS = np.array([6.0, 8.0, 4.0, 1.5, 1.2, 1.0]), np.array([5.0, 7.0, 3.0, 1.0, 0.8, 0.6])


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return load_robot(write(tmp_path_factory.mktemp("arm"), puma560()))


def _recorded(robot, seed, *, body=None, link=5, coulomb=COULOMB, viscous=VISCOUS, masses=True, torque_std=0.3):
    """A recording of the arm with friction, and with a body on a link."""
    motion = fourier(robot, seed, duration=15.0, rate=100.0)
    phi = robot.nominal.copy()
    if body is not None:
        phi[link] += body
    table = recording(robot, None, motion, seed=seed, torque_std=torque_std, resolution=1e-5, phi=phi.ravel())
    torques = table.torques + viscous * motion[2] + coulomb * np.tanh(motion[2] / 1e-3)
    table = Table(times=table.times, positions=table.positions, torques=torques)
    known = robot if masses else replace(robot, nominal=np.zeros_like(robot.nominal))
    return experiment(known, [Motion("run", "identification", table)])


BODY = np.array([1.5, 0.06, 0.03, 0.15, 0.01, 0.0, 0.012, 0.0, 0.0, 0.006])


@pytest.fixture(scope="module")
def with_payload(arm):
    """Both recordings, and what is said of the second."""
    before, after = _recorded(arm, 1), _recorded(arm, 2, body=BODY)
    return before, after, bayesid.diagnose(after, reference=before)


def test_a_payload_is_weighed_where_the_reference_leaves_the_mass_to_a_drive(tmp_path):
    """The weight on a vertical slide may be its drive's offset, and its mass the rotor's: only their sums are known.

    These sums were given up: 1.78 ± 0.17 kg came out of 1.3."""
    robot = load_robot(write(tmp_path, scara()))
    speeds, coulomb = np.array([1.0, 1.0, 0.1, 1.5]), np.array([3.0, 2.0, 5.0, 0.3])
    effects = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")

    def recorded(seed, load):
        times, *motion = fourier(robot, seed, duration=15.0, rate=100.0, speed=1.0)
        _, v, a = motion = [x * speeds for x in motion]
        phi = 1.15 * robot.nominal
        phi[3] += load
        table = recording(robot, None, (times, *motion), phi=phi.ravel())
        drives = np.sign(v) * coulomb + 0.8 * coulomb * v + 0.05 * coulomb * a + 0.1 * coulomb
        noise = 0.03 * coulomb * np.random.default_rng(seed).normal(size=v.shape)
        table = Table(times=times, positions=motion[0], torques=table.torques + drives + noise)
        return experiment(robot, [Motion("run", "identification", table)], effects=effects)

    body = inertia.from_mass_com_inertia(1.3, np.array([0.02, -0.1, 0.05]), np.diag([0.005, 0.008, 0.004]))
    found = bayesid.payload(recorded(2, body), reference=recorded(1, 0.0))
    assert found.mass.low <= 1.3 <= found.mass.high and found.mass.high - found.mass.low < 0.2


def test_readings_that_no_robot_gives_are_not_said_to_be_explained(tmp_path):
    """Two cables of the sensor exchanged: its own fit's residual was the only measure, and crosstalk was all that was named."""
    robot, sensor = puma2(tmp_path), Sensor(rpy=np.array([0.0, 0.3, 0.0]))

    def recorded(seed, columns, std=0.5):
        table = recording(
            robot, sensor, fourier(robot, seed, duration=12.0), seed=seed, force_std=std, torque_std=0.1 * std, resolution=1e-5
        )
        return experiment(robot, [Motion("run", "identification", replace(table, wrench=table.wrench[:, columns]))], sensor)

    before = recorded(1, [0, 1, 2, 3, 4, 5])
    found = bayesid.diagnose(recorded(2, [0, 1, 2, 4, 3, 5]), reference=before, channel="wrench")
    assert found.verdict not in ("named", "nothing_missing")
    (note,) = (x for x in str(found).splitlines() if "exchanged" in x)
    assert "times as much of" in note and "mx, my" in note
    noisier = bayesid.diagnose(recorded(2, [0, 1, 2, 3, 4, 5], std=1.0), reference=before, channel="wrench")
    assert noisier.verdict == "nothing_missing" and noisier.comparison.recording.grown == pytest.approx(2.0, rel=0.2)


def test_the_report_states_the_thresholds_in_use(with_payload):
    found = with_payload[2]
    assert found.comparison.settings == DEFAULT and f"{DEFAULT.accept:g} is asked for" in changes_report(found)
    stricter = replace(found, comparison=replace(found.comparison, settings=replace(DEFAULT, accept=17.5)))
    assert "17.5 is asked for" in changes_report(stricter)


@pytest.mark.parametrize("masses", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_payload_is_named_with_its_mass(arm, with_payload, masses):
    found = with_payload[2]
    if not masses:  # nor are any needed
        found = bayesid.diagnose(_recorded(arm, 2, body=BODY, masses=False), reference=_recorded(arm, 1, masses=False))
    assert found.verdict == "named"
    assert [c.change.spec for c in found.comparison.changes] == ["payload@joint6"]
    mass = found.comparison.changes[0].values[0]
    assert abs(mass.value - 1.5) < 2.5 * mass.std and mass.std < 0.15
    assert found.comparison.changes[0].share_low > 0.9


def test_the_model_with_the_change_leaves_links_as_they_were(with_payload, tmp_path):
    before, after, found = with_payload
    found.write(tmp_path / "out")
    with_change = bayesid.identify(after.with_model(tmp_path / "out" / "model.toml")).estimate
    without = bayesid.identify(after, effects=("viscous_friction", "coulomb_friction", "torque_offset")).estimate
    known = bayesid.identify(before, effects=("viscous_friction", "coulomb_friction", "torque_offset")).estimate
    spread = np.hypot(known.std, without.std)
    off = [float(np.sqrt(np.mean(((e.values - known.values) / spread) ** 2))) for e in (with_change, without)]
    assert off[0] < 3.0 and off[1] > 5.0 * off[0]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "payload at joint6" in page and page.count("<svg") >= 2


def test_what_the_model_lacks_before_and_after_is_no_change(arm):
    """Friction in proportion to the speed's cube: unknown to the model, in both recordings, and large beside the noise."""

    def recorded(seed, **changed):
        made = _recorded(arm, seed, **changed)
        (motion,) = made.motions
        table = motion.table
        assert table.torques is not None
        speed = np.gradient(table.positions, table.times, axis=0)
        table = replace(table, torques=table.torques + 3.0 * speed**3)
        return replace(made, motions=(replace(motion, table=table),))

    assert not bayesid.diagnose(recorded(2), reference=recorded(1)).comparison.changes
    found = bayesid.diagnose(recorded(2, body=2.0 * BODY), reference=recorded(1))
    assert found.comparison.changes[0].change.spec == "payload@joint6"


def test_a_turned_sensor_is_named(tmp_path):
    robot = puma2(tmp_path)
    arm = experiment(robot, [], Sensor(translation=np.array([0.0, 0.0, -0.1])), position_resolution=1e-5)
    path = [bayesid.fourier_trajectory(robot, duration=12.0, seed=1)]
    before = bayesid.simulate(arm, path, seed=3)
    turned = bayesid.simulate(arm, path, effects={"sensor_rotation": {"rx": 0.02, "ry": 0.0, "rz": 0.0}}, seed=4)
    (change,) = bayesid.diagnose(turned, reference=before).comparison.changes
    assert change.change.spec == "sensor_rotation@sensor"
    assert [v.value for v in change.values] == pytest.approx([0.02, 0.0, 0.0], abs=2e-3)
    assert bayesid.diagnose(bayesid.simulate(arm, path, seed=5), reference=before).verdict == "nothing_missing"


@pytest.mark.slow
def test_intervals_hold_a_tool_far_from_its_joint(tmp_path):
    """Priors that weigh names know of no such inertia; values are those of possible bodies all the same."""
    robot, rng = puma2(tmp_path), np.random.default_rng(5)
    arm = experiment(robot, [], Sensor(translation=np.array([0.0, 0.0, -0.1])), position_resolution=1e-5)
    path = [bayesid.fourier_trajectory(robot, duration=12.0, seed=1)]
    before, off = bayesid.simulate(arm, path, seed=3), []
    for seed in range(4, 10):
        mass, centre = rng.uniform(0.5, 1.5), rng.uniform(-0.25, 0.25, 3)
        about = mass * (0.05**2 * np.eye(3) + centre @ centre * np.eye(3) - np.outer(centre, centre))
        tool = dict(zip(inertia.PARAMETERS, [mass, *mass * centre, *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]], strict=True))
        after = bayesid.simulate(arm, path, effects={"payload@joint2": tool}, seed=seed)
        (change,) = bayesid.diagnose(after, reference=before).comparison.changes
        assert change.change.spec == "payload@joint2"
        assert [v.name for v in change.values] == list(tool)
        assert inertia.is_physically_consistent(np.array([v.value for v in change.values]), 0.0)
        off += [(v.value - tool[v.name]) / v.std for v in change.values]
    assert np.mean(np.abs(off) < 1.96) > 0.85 and np.max(np.abs(off)) < 4.0


def test_a_body_beyond_a_sensor_is_told_in_the_frame_of_its_joint(tmp_path):
    """The sensor's fixed joint is turned and shifted against the joint whose link it splits."""
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    arm = experiment(robot, [], Sensor("wrist_ft"))
    assert np.abs(robot.body_rotation[6] - np.eye(3)).max() > 0.5
    path = [bayesid.fourier_trajectory(robot, duration=8.0, rate=60.0, seed=1)]
    tool = dict(zip(inertia.PARAMETERS, (0.5, 0.05, 0.02, 0.01, 0.006, 0.0, 0.02, 0.0, 0.0, 0.02), strict=True))
    loaded = bayesid.simulate(arm, path, effects={"payload@joint6": tool}, seed=4)
    found = bayesid.diagnose(loaded, "wrench", reference=bayesid.simulate(arm, path, seed=3))
    (change,) = found.comparison.changes
    assert change.change.spec == "payload@joint6"
    for v in change.values:
        assert abs(v.value - tool[v.name]) < 4.0 * v.std


def test_friction_of_one_joint_is_named(arm):
    more = COULOMB * np.where(np.arange(6) == 1, 2.0, 1.0)
    found = bayesid.diagnose(_recorded(arm, 2, coulomb=more), reference=_recorded(arm, 1))
    assert [c.change.spec for c in found.comparison.changes] == ["coulomb_friction@joint2"]
    level = found.comparison.changes[0].values[0]
    assert level.before == pytest.approx(8.0, abs=0.8)
    assert abs(level.value - 8.0) < 3.0 * level.std + 0.8


def test_friction_that_differs_is_told_where_it_has_no_name(arm):
    """Ripple of which the model says nothing: friction of a joint that grew by 40 % was "within what it wanders"."""

    def recorded(seed, factor):
        grown = np.where(np.arange(6) == 1, factor, 1.0)
        made = _recorded(arm, seed, coulomb=grown * COULOMB, viscous=grown * VISCOUS)
        (run,) = made.motions
        torques = run.table.torques + 2.0 * np.sin(40.0 * run.table.positions)
        return replace(made, motions=(replace(run, table=replace(run.table, torques=torques)),))

    before = recorded(1, 1.0)
    same, found = (bayesid.diagnose(recorded(2, factor), reference=before) for factor in (1.0, 1.4))
    assert found.verdict == same.verdict == "nothing_missing" and not same.comparison.wandered
    true = {"coulomb_friction@joint2.level": 3.2, "viscous_friction@joint2.coefficient": 2.8}
    assert {v.name for v in found.comparison.wandered} == set(true)
    for v in found.comparison.wandered:
        assert abs(v.value - true[v.name]) < 2.0 * v.std
    assert "friction and gains are within" in str(same) and "friction and gains are within" not in str(found)
    assert "No change is named since ‘test’, but friction differs" in str(found)
    assert [f["name"] for f in found.to_dict()["friction"]] == [v.name for v in found.comparison.wandered]
    assert not any("rotor" in spec for spec in found.model[0])  # fitted to the reference along, and no part of the user's model
    for result in (same, found):
        assert any("its model leaves" in text and "the reference alone" in text for text in result.remarks)


def test_all_friction_of_a_joint_changes_by_one_factor(arm, tmp_path):
    """It was sought one parameter at a time, each beside the other's change: neither had the evidence that both have."""
    twice = np.where(np.arange(6) == 1, 2.0, 1.0)
    found = bayesid.diagnose(_recorded(arm, 2, coulomb=twice * COULOMB, viscous=twice * VISCOUS), reference=_recorded(arm, 1))
    (change,) = found.comparison.changes
    assert (found.verdict, change.change.spec) == ("named", "friction@joint2") and change.found.evidence > 25.0
    (factor,) = change.values
    assert factor.before == 1.0 and abs(factor.value - 1.0) < 2.0 * factor.std
    told = found.to_dict()["effects"]
    assert [(e["name"], e["where"]) for e in told] == [("viscous_friction", "joint2"), ("coulomb_friction", "joint2")]
    assert told[0]["together_with"] == ["coulomb_friction@joint2"]
    assert told[1]["parameters"]["level"]["value"] == pytest.approx(factor.value * told[1]["parameters"]["level"]["reference"])
    text = str(found)
    assert "Changed since ‘test’: friction at joint2." in text and "factor" in text and "coulomb_friction.level" in text
    found.write(tmp_path / "out")
    assert "friction as a whole, by one factor" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8").lower()
    values = found.model[1]["coulomb_friction@joint2"]
    assert values["level"] == pytest.approx(16.0, abs=2.0)


def test_nothing_is_named_where_friction_wanders_by_a_twentieth(arm):
    rng = np.random.default_rng(0)
    coulomb, viscous = (x * (1.0 + 0.05 * rng.normal(size=6)) for x in (COULOMB, VISCOUS))
    found = bayesid.diagnose(_recorded(arm, 2, coulomb=coulomb, viscous=viscous), reference=_recorded(arm, 1))
    assert found.verdict == "nothing_missing"
    assert found.comparison.scores[0][1] < 5.0
    s = found.comparison.selection
    twice = replace(s, every=(*s.every, *s.every))  # that a change has more forms says nothing for it
    np.testing.assert_allclose([e for _, e in twice.ranked(())], [e for _, e in s.ranked(())], atol=1e-9)
    hidden = {h.change.spec: h.value for h in found.comparison.hidden}
    assert 0.01 < hidden["payload@joint6"] < 1.5
    assert 0.8 < hidden["coulomb_friction@joint2"] < 8.0 and 0.1 < hidden["friction@joint2"] < 1.0
    assert "could hide" in str(found)


def test_friction_that_wanders_within_a_recording_is_no_change(arm):
    """All of it grows by 8 % in the first recording and falls by as much in the second."""
    warm = np.linspace(-0.04, 0.04, 1500)[:, None]
    before, after = (
        _recorded(arm, seed, coulomb=COULOMB * (1.0 + way * warm), viscous=VISCOUS * (1.0 + way * warm), torque_std=0.1)
        for seed, way in ((1, 1.0), (2, -1.0))
    )
    assert bayesid.diagnose(after, reference=before).verdict == "nothing_missing"


def test_friction_that_wanders_makes_no_other_robot(arm):
    """What the later recording's own fit leaves grows with friction that it takes for constant."""
    warm = 1.0 + np.linspace(-0.08, 0.08, 1500)[:, None]
    before, after = (
        _recorded(arm, 1, torque_std=0.1),
        _recorded(arm, 2, coulomb=COULOMB * warm, viscous=VISCOUS * warm, torque_std=0.1),
    )
    found = bayesid.diagnose(after, reference=before)
    assert found.comparison.recording.grown.max() > 3.0 and found.verdict == "nothing_missing"


class SlackeningFriction(JointTorqueEffect):
    """Friction that fades in proportion to time, as nobody but this class knows."""

    name = "slackening_friction"
    quantities = (Parameter("rate", "N m/s", typical=0.01, fall_of="coulomb_friction.level"),)
    since_zero = True

    def torque(self, motion, values):
        return -values[0] * motion.time * motion.direction


def test_an_effect_says_itself_what_of_friction_fades_within_a_recording(arm):
    made = _recorded(arm, 1)
    reference = learn_reference(replace(made, library=made.library.with_classes([SlackeningFriction], "test")))
    rows = read_recording(reference, made, None).rows
    columns, sizes = warming_columns(reference, rows)
    friction = {h.spec: h.columns[0] for h in hypotheses(reference)}
    mine, his = (friction[f"{name}@joint1"] for name in ("slackening_friction", "coulomb_friction"))
    assert mine in columns
    # Warming has three time constants, this is a fourth: each has a quarter of a tenth of friction's torque, squared.
    fades, known = np.linalg.norm(rows[:, [mine, his]], axis=0)
    assert sizes[columns == mine] * fades == pytest.approx(0.1 / 2.0 * reference.solution[his] * known)


def test_what_a_robot_is_built_with_stays_and_its_friction_wanders(arm):
    """Shafts and rotor of a motor that two joints turn."""
    effects = ("coupled_friction@joint5->joint6", "rotor_inertia@joint1")
    reference = learn_reference(_recorded(arm, 1), effects=effects)
    names = [name for e in reference.effects for name in e.column_names]
    friction = dict(zip(names, reference.wanders(friction=True)[-len(names) :], strict=True))
    gains = dict(zip(names, reference.wanders(friction=False)[-len(names) :], strict=True))
    own = [n for n in names if n.startswith(effects)]
    assert [n.rpartition(".")[2] for n in own if friction[n] > 0.0] == ["viscous", "coulomb"] and not any(gains.values())
    found = {h.spec: [n for n, _ in h.parameters] for h in hypotheses(reference)}
    assert found["coupled_friction@joint5->joint6"] == ["viscous", "coulomb"]
    assert not any(spec.startswith(("rotor_inertia", "rotor_momentum")) for spec in found)


def test_what_a_joint_shows_only_where_it_stands_is_no_change(arm):
    """A joint that hardly moves, at another angle in each recording, in a field of rest positions of its gear: a ripple."""

    def recorded(seed, angle):
        times, *motion = fourier(arm, seed, duration=15.0, rate=100.0)
        creeps = np.sin(np.outer(times, [1.3, 2.1])) @ [1e-3, 5e-4]
        for values in motion:
            values[:, 5] = creeps
            creeps = np.gradient(creeps, times)
        motion[0][:, 5] += angle
        table = recording(arm, None, (times, *motion), seed=seed, torque_std=0.1, resolution=1e-5)
        torques = table.torques + VISCOUS * motion[1] + COULOMB * np.tanh(motion[1] / 3e-3)
        torques[:, 5] += 0.05 * np.sin(16.0 * motion[0][:, 5])
        table = Table(times=table.times, positions=table.positions, torques=torques)
        return experiment(arm, [Motion("run", "identification", table)])

    found = bayesid.diagnose(recorded(2, 0.1), reference=recorded(1, -0.1))
    assert found.verdict == "nothing_missing"


def test_what_is_learned_is_the_posterior_and_its_error_has_the_covariance_stated():
    """Against stacked least squares and dense algebra, with columns that rows do not show or hardly show."""
    rng = np.random.default_rng(8)
    x, mean, sizes = rng.normal(size=(60, 5)), rng.normal(size=5), np.array([0.5, 1.0, 2.0, 3.0, 4.0])
    x[:, 3], x[:, 4] = 0.0, 1e-6 * x[:, 4]
    y = x @ np.array([1.0, -2.0, 3.0, 4.0, 5.0]) + rng.normal(size=60)
    factor = Factor(np.linalg.qr(np.column_stack([x, y]), mode="r"), 60)
    found = LearnedParameters.of(factor, Middle(None, 4.0), mean, sizes)
    whole = np.vstack([x / 2.0, np.diag(1.0 / sizes)])
    assert found.mean == pytest.approx(np.linalg.lstsq(whole, np.concatenate([y / 2.0, mean / sizes]))[0], rel=1e-9)
    assert found.covariance == pytest.approx(np.linalg.inv(whole.T @ whole), rel=1e-9, abs=1e-12)
    noise = 0.6 ** np.abs(np.subtract.outer(np.arange(60), np.arange(60)))  # that weights know nothing of
    found = LearnedParameters.of(factor, Middle(x.T @ noise @ x, 2.0), mean, sizes)
    gain = np.linalg.solve(x.T @ x + 2.0 * np.diag(sizes**-2.0), x.T)
    missed = np.eye(5) - gain @ x
    error = gain @ noise @ gain.T + missed @ np.diag(sizes**2) @ missed.T
    assert found.covariance == pytest.approx(error, rel=1e-9, abs=1e-12)


def test_what_a_creeping_joint_hardly_shows_is_no_gap(arm):
    """Of a joint that creeps in the reference least squares has any friction: it left 10,000 times what the joint takes."""

    def recorded(seed, speed):
        times, *motion = fourier(arm, seed, duration=15.0, rate=100.0)
        for values in motion:
            values[:, 5] *= speed
        table = recording(arm, None, (times, *motion), seed=seed, torque_std=0.1, resolution=1e-5)
        friction = VISCOUS * motion[1] + COULOMB * np.clip(motion[1] / 1e-3, -1.0, 1.0)
        table = Table(times=times, positions=table.positions, torques=table.torques + friction)
        return experiment(arm, [Motion("run", "identification", table)])

    before, after = recorded(1, 1e-3), recorded(2, 1.0)
    found = bayesid.diagnose(after, reference=before)
    assert found.verdict == "nothing_missing"
    later = found.comparison.recording
    left = np.sqrt(np.mean(later.left[later.channel == 5] ** 2)) * later.scale[5] / np.sqrt(later.samples)
    assert after.motions[0].table.torques is not None
    assert left < np.linalg.norm(after.motions[0].table.torques[:, 5]) / np.sqrt(1500)


def test_rows_with_proposals_are_the_models_with_columns_beside(tmp_path):
    """Also of a mount that gives, whose drive is smoothed to what encoders show."""
    robot, mount = puma2(tmp_path), {"resonance": 8.0, "damping": 0.05}
    table = recording(robot, Sensor(), fourier(robot, 1, 4.0), seed=1, force_std=0.5, torque_std=0.05, resolution=1e-5)
    values = {"base_compliance@base": mount}
    arm = experiment(robot, [Motion("m", "identification", table)], Sensor(), effects=("base_compliance",), effect_values=values)
    problem, _ = solve(prepare(arm))
    model, segment = problem.row_model, problem.segments["m"][0]
    assert model.clear is not None and model.point is not None
    proposals = make_proposals(problem, robot.nominal.ravel())
    rows = with_proposals(model, model.point, proposals).about_point(segment, 100, 200)
    own = model.about_point(segment, 100, 200)
    count = own.shape[2] - 1
    np.testing.assert_array_equal(np.delete(rows, np.s_[count:-1], axis=2), own)
    assert rows.shape[2] - own.shape[2] == sum(int(p.active.sum()) for p in proposals) > 10


def test_what_could_hide_is_in_the_unit_of_its_joint():
    """A rail that slides and an elbow that turns."""
    units = {"joint1": "N s/m", "joint2": "N m s/rad"}
    hidden = [
        SimpleNamespace(
            change=SimpleNamespace(name="viscous_friction", where=j, parameters=(("coefficient", unit),)), value=2.0 + k
        )
        for k, (j, unit) in enumerate(units.items())
    ]
    comparison = cast(ReferenceComparison, SimpleNamespace(hidden=hidden))
    said = ["viscous_friction up to (N s/m): joint1 2.0", "viscous_friction up to (N m s/rad): joint2 3.0"]
    assert hidden_sentences(comparison) == said
    rows = hidden_table(comparison).rows
    assert rows == [["viscous_friction", "coefficient", unit, f"{j} {2 + k}.0"] for k, (j, unit) in enumerate(units.items())]


def test_what_the_reference_keeps_stays_fixed_in_the_model_that_is_written(arm):
    """Stated for all of a kind, or under a joint's own name."""
    names = [f"axis {k}" for k in range(6)]
    stated = {"coulomb_friction": {"level": 2.0, "fixed": True}, "viscous_friction@axis 1": {"coefficient": 3.0, "fixed": True}}
    effects = EffectLibrary().parse(["coulomb_friction@joint1", "viscous_friction"], names, ["tau1", "tau2"])
    made = SimpleNamespace(effect_values=stated, robot=replace(arm, joint_names=tuple(names)))
    compared = SimpleNamespace(
        terms=[Term(e, (4.0,)) for e in effects], reference=SimpleNamespace(effects=effects, hands_on=lambda effect: True),
        recording=SimpleNamespace(problem=SimpleNamespace(experiment=made)),
    )  # fmt: skip
    _, values = Changes(cast(ReferenceComparison, compared)).model
    fixed = [spec for spec, given in values.items() if "@joint" in spec and given.get("fixed", False)]
    assert fixed == ["coulomb_friction@joint1", "viscous_friction@joint2"]


def test_gear_ratios_are_those_of_the_reference(tmp_path):
    """They belong to its model; a later folder need not state them again."""
    robot = puma2(tmp_path)
    table = recording(robot, Sensor(), fourier(robot, 1, duration=4.0), torque_std=0.1, force_std=0.5)
    after = experiment(robot, [Motion("run", "identification", table)], Sensor())
    before = replace(after, effects=("rotor_momentum@joint1",), gear_ratio={"joint1": 60.0})
    reference = learn_reference(before, "both")
    assert next(e for e in reference.effects if e.name == "rotor_momentum").ratio == 60.0
    assert read_recording(reference, after, None).problem.row_model.effects == reference.effects


def test_what_to_record_next():
    """The motion that splits rivals is planned by excite --tell, for effects that it can be asked of."""

    def change(name, where, **more):
        return Hypothesis(name, where, (), np.zeros(1, int), np.ones(1), **more)

    def found(verdict, *pairs):
        changes = [SimpleNamespace(change=a, found=SimpleNamespace(rivals=[(h, 1.0) for h in b])) for a, b in pairs]
        return next_experiment(cast(ReferenceComparison, SimpleNamespace(verdict=verdict, changes=changes)))

    load, hose = change("payload", "joint2"), change("tether", "joint1")
    assert 'bayesid.excite with tell=["payload@joint2", "tether@joint1"] plans' in found("ambiguous", (load, [hose]))
    dry = change("coulomb_friction", "joint2", known=True)
    text = found("ambiguous", (load, [dry]))
    assert "payload@joint2 from coulomb_friction@joint2" in text and "tell=" not in text
    assert "one joint at a time" in found("named_in_part", (load, [])) and found("named", (load, [])) == ""


def test_another_robot_is_refused(arm, tmp_path):
    from tests.robots import ur5

    other = load_robot(write(tmp_path, ur5()))
    with pytest.raises(bayesid.InputError, match="same robot"):
        bayesid.diagnose(_recorded(arm, 1), reference=_recorded(other, 1))
    moved = replace(arm, translation=arm.translation + 0.01)
    with pytest.raises(bayesid.InputError, match="joint frames are not as in"):
        bayesid.diagnose(_recorded(arm, 1), reference=_recorded(moved, 1))


def test_other_readings_than_the_references_are_told(tmp_path):
    """Torques of other joints, and poses beside a motion; neither has anything to do with static readings."""
    robot = puma2(tmp_path)
    table = recording(robot, Sensor(), fourier(robot, 1, duration=6.0, rate=60.0), torque_std=0.1, force_std=0.5)
    few = replace(table, torques=np.where([True, False], table.torques, np.nan))
    q = np.random.default_rng(2).uniform(-2.0, 2.0, (30, 2))
    held = recording(robot, Sensor(), (np.arange(30.0), q, 0.0 * q, 0.0 * q), torque_std=0.1, force_std=0.5)
    whole, part = (experiment(robot, [Motion("run", "identification", t)], Sensor()) for t in (table, few))
    poses = experiment(robot, [Motion("run", "identification", held, kind="poses")], Sensor())
    for after, before, channel, said in (
        (part, whole, "torque", "has tau1, tau2, but test has tau1; leave out"), (poses, whole, "wrench", "poses with poses"),
        (whole, poses, "wrench", "poses with poses"),
    ):  # fmt: skip
        with pytest.raises(bayesid.InputError, match=said):
            bayesid.diagnose(after, channel, reference=before)


def test_a_reference_that_has_not_settled_stays_where_its_equations_hold(tmp_path):
    """Found by fuzzing: the last step of a fit that these motions do not determine left gear teeth without any width."""
    robot = puma2(tmp_path)
    table = recording(robot, None, fourier(robot, 1, duration=4.0), torque_std=0.1)
    setup = experiment(robot, [Motion("run", "identification", table)])
    reference = learn_reference(setup, effects=["backlash@joint1"])
    point = reference.problem.row_model.point
    assert point is not None  # all are estimated again, with whatever values
    problem = relinearised(reference.problem, replace(point, free=np.ones(len(point.free), bool)))
    names = list(problem.row_model.effect_names)
    wild = {"backlash@joint1.gap": -2.0, "backlash@joint1.firm": 0.0, "viscous_friction@joint2.coefficient": -1.0}
    solution = np.concatenate([reference.solution[: problem.row_model.base.rank], point.values])
    for name, value in wild.items():
        solution[len(solution) - len(names) + names.index(name)] = value
    made = replace(reference, problem=problem)
    vars(made)["_posterior"] = LearnedParameters(solution, np.eye(len(solution)), np.eye(len(solution)))
    point = made.point
    assert [point.values[names.index(name)] for name in wild] == [0.0, 1e-3, -1.0]  # a linear equation holds everywhere


def test_the_command_line_takes_a_reference_and_tells_bad_ones_in_one_line(arm, tmp_path, capsys):
    for name, made in (("before", _recorded(arm, 1)), ("after", _recorded(arm, 2, body=BODY))):
        bayesid.write_experiment(made, tmp_path / name)
    out = str(tmp_path / "out")
    assert main(["diagnose", str(tmp_path / "after"), "--reference", str(tmp_path / "before"), "--out", out]) == 0
    assert "payload at joint6" in capsys.readouterr().out
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert told["reference"] == str(tmp_path / "before")
    assert told["effects"][0]["share_low"] > 0.9 and told["remainder"]["share"] < 0.1
    assert main(["diagnose", str(tmp_path / "after"), "--reference", str(tmp_path / "none"), "--out", out]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert main(["diagnose", str(tmp_path / "after"), "--reference", str(tmp_path / "before"), "--channel", "wrench"]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


UNLOADED = ("before", "feb05-20s-12h", "feb05-20s-8h", "feb06-20s-10h", "feb06-20s-5h")
#: One reference in every run, all of them and pairs of two unloaded ones in `make test-slow`.
REFERENCES = [UNLOADED[0], *(pytest.param(name, marks=pytest.mark.slow) for name in UNLOADED[1:])]
PAIRS = [*permutations(UNLOADED, 2)]


@pytest.mark.parametrize("reference", REFERENCES)
def test_a_real_payload_is_named_against_every_reference(shared, reference, tmp_path):
    found = bayesid.diagnose(shared("data/ur10e/after-load"), reference=shared(f"data/ur10e/{reference}"))
    found.write(tmp_path / "out")
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert told["verdict"] in ("named", "named_in_part")
    assert [(e["name"], e["where"]) for e in told["effects"]] == [("payload", "joint6")]
    mass = told["effects"][0]["parameters"]["m"]
    assert abs(mass["value"] - 2.805) < min(0.15, 1.96 * mass["std"])
    assert told["effects"][0]["share_low"] > 0.5
    assert told["gap"]["after"] < 0.5 * told["gap"]["before"]


@pytest.mark.slow
@pytest.mark.parametrize(("reference", "other"), PAIRS)
def test_nothing_is_named_between_unloaded_recordings(shared, reference, other):
    found = bayesid.diagnose(shared(f"data/ur10e/{other}"), reference=shared(f"data/ur10e/{reference}"))
    assert found.verdict == "nothing_missing"
    assert not found.comparison.changes


#: Of the shortest recordings in every run.
SESSIONS = [
    pytest.param(name, backwards, marks=[] if (name, backwards) == ("tx40", False) else pytest.mark.slow)
    for name in ("tx40", "kuka-lwr4", "ur10")
    for backwards in (False, True)
]


@pytest.mark.parametrize(("folder", "backwards"), SESSIONS)
def test_nothing_is_named_between_motions_of_one_session(shared, folder, backwards):
    """Other robots, other motions before and after, up to six times the own fit's residual from what their models lack."""
    whole = bayesid.load_experiment(shared(f"data/{folder}"))
    before, after = (replace(whole, motions=(replace(m, role="identification"),)) for m in whole.motions)
    if backwards:
        before, after = after, before
    assert not bayesid.diagnose(after, reference=before).comparison.changes
