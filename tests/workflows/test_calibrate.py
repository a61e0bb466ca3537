"""What a force/torque sensor in place has: known faults of simulated ones, a real one, and what weight leaves of readings."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import bayesid
from bayesid.cli import main
from bayesid.recordings.experiment import Sensor
from bayesid.simulation.trajectories import Trajectory
from tests.robots import wrist_sensor_arm, write
from tests.simulated import experiment, puma2

NOISE = bayesid.Recorder(force_std=0.05, torque_std=0.003, resolution=1e-5)
OFFSET = (3.0, -2.0, 5.0, 0.2, -0.1, 0.05)
FAULTS = {
    "sensor_offset": dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), OFFSET, strict=True)),
    "sensor_crosstalk@fz->my": {"coefficient": 0.01}, "sensor_gain@fx": {"gain": 0.03},
}  # fmt: skip


@pytest.fixture(scope="module")
def wrist(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("wrist"), wrist_sensor_arm())
    return experiment(bayesid.load_robot(path, sensor_joint="wrist_ft"), [], Sensor("wrist_ft", np.array([0.0, 0.0, 0.02])))


def recorded(arm, effects, *, count=40, seed=1, links=None):
    q = np.random.default_rng(seed).uniform(-2.5, 2.5, (count, arm.robot.n))
    path = Trajectory("poses", "identification", np.arange(float(count)), q, 0.0 * q, 0.0 * q, kind="poses")
    return bayesid.simulate(arm, [path], effects=effects, recorder=NOISE, seed=seed, links=links)


@pytest.fixture(scope="module")
def faulty(wrist):
    return bayesid.calibrate(recorded(wrist, FAULTS))


def test_faults_are_found_with_intervals_that_hold_them(faulty):
    assert faulty.verdict in ("named", "ambiguous")  # what else explains the readings as well stands beside
    assert set(faulty.found) == {"sensor_offset@sensor", "sensor_crosstalk@fz->my", "sensor_gain@fx"}
    for spec, values in FAULTS.items():
        for q, value in zip(faulty.found[spec if "@" in spec else f"{spec}@sensor"], values.values(), strict=True):
            assert q.shown and abs(q.value - value) < 4.0 * q.std
    kinds = {h.kind: h.size for h in faulty.hidden}
    assert {"sensor_rotation", "base_tilt"} <= set(kinds) and "sensor_gain" not in kinds and kinds["base_tilt"] < 0.02


def test_what_is_no_fault_is_not_found(wrist):
    clean = bayesid.calibrate(recorded(wrist, {"sensor_offset": FAULTS["sensor_offset"]}, seed=2))
    assert set(clean.found) == {"sensor_offset@sensor"} and clean.verdict == "nothing_missing" and not clean.warnings
    hidden = [(h.kind, h.parameter) for h in clean.hidden]
    assert {kind for kind, _ in hidden} >= {"sensor_gain", "sensor_crosstalk"}
    for kind, parameters in (("sensor_rotation", "rx ry rz"), ("base_tilt", "x y"), ("sensor_drift", "fx fy fz mx my mz")):
        assert [p for k, p in hidden if k == kind] == parameters.split()
    assert len({h.unit for h in clean.hidden if h.kind == "sensor_crosstalk"}) == 3
    assert "cannot be told from another mass" in clean.sentences[0]


def test_weight_and_offset_are_taken_out_of_readings(wrist, faulty):
    """A push at the sensor's origin is what stays, at poses that took no part; without one, noise."""
    other = recorded(wrist, FAULTS, count=15, seed=9).motions[0].table
    left = faulty.compensate(other.positions, other.wrench)
    assert (np.std(left, axis=0) < 1.6 * np.repeat([0.05, 0.003], 3)).all()
    push = np.array([2.0, -1.0, 0.5, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(faulty.compensate(other.positions, other.wrench - push) - left, np.tile(-push, (15, 1)), atol=1e-9)
    assert faulty.compensate(other.positions[0], other.wrench[0]).shape == (6,)
    with pytest.raises(bayesid.InputError, match="give six readings for each"):
        faulty.compensate(other.positions, other.wrench[:3])


def test_a_known_mass_tells_a_common_gain(wrist):
    """All force and moment axes 2 % too much: one recording with the tool alone, one with 1.5 kg hung on."""
    gains = {f"sensor_gain@{axis}": {"gain": 0.02} for axis in ("fx", "fy", "fz", "mx", "my", "mz")}
    links = wrist.robot.nominal.copy()
    links[6] += np.concatenate([[1.5], 1.5 * np.array([0.0, 0.0, 0.12]), 1.5 * np.array([0.0144, 0.0, 0.0144, 0.0, 0.0, 0.0])])
    alone, heavy = recorded(wrist, gains), recorded(wrist, gains, seed=3, links=links)
    assert bayesid.calibrate(heavy).common_gain is None  # and no axis is named for what all share
    told = bayesid.calibrate(heavy, reference=alone, mass=1.5)
    assert told.common_gain.low < 0.02 < told.common_gain.high and told.common_gain.low > 0.0
    with pytest.raises(bayesid.InputError, match="carries 1.53 kg more there .*with the known mass first"):
        bayesid.calibrate(alone, reference=heavy, mass=1.5)
    grams = bayesid.calibrate(heavy, reference=alone, mass=1500.0)
    assert "No sensor has such a gain: mass is in kilograms" in grams.sentences[0] and "No sensor" not in told.sentences[0]
    whole = bayesid.calibrate(alone, mass=float(wrist.robot.nominal[6, 0]), mass_std=0.002)
    assert abs(whole.common_gain.value - 0.02) < 4.0 * whole.common_gain.std and "differs from none" in str(whole)
    doubted = bayesid.calibrate(alone, mass=float(wrist.robot.nominal[6, 0]), mass_std=0.1).common_gain
    assert doubted.std > 10.0 * whole.common_gain.std


def test_a_reference_that_does_not_show_its_mass_tells_no_gain(wrist):
    """Poses that never turn gravity; ``effects`` replace those of both recordings."""
    q = np.zeros((12, wrist.robot.n)) + 0.2
    q[:, 0] = np.linspace(-1.0, 1.0, 12)
    still = Trajectory("poses", "identification", np.arange(12.0), q, 0.0 * q, 0.0 * q, kind="poses")
    bare = replace(bayesid.simulate(wrist, [still], recorder=NOISE, seed=1), effects=("unheard_of",))
    told = bayesid.calibrate(recorded(wrist, {}, count=20), reference=bare, mass=1.5, effects=["sensor_offset"])
    assert told.common_gain is None and told.mass.shown and "do not show the mass" in told.sentences[0]


def test_a_motion_tells_the_delay(wrist):
    path = [bayesid.fourier_trajectory(wrist.robot, duration=10.0, seed=2)]
    made = bayesid.simulate(wrist, path, effects={"sensor_delay": {"delay": 0.006}}, recorder=NOISE, seed=4)
    (delay,) = bayesid.calibrate(made).found["sensor_delay@sensor"]
    assert abs(delay.value - 0.006) < 4.0 * delay.std


@pytest.mark.slow
def test_a_real_sensor_has_the_offset_that_is_known(shared, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["calibrate", str(shared("data/kuka-med-wrist")), "--mass", "0.932", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    written = json.loads((out / "calibration.json").read_text(encoding="utf-8"))
    (offset,) = [e for e in written["effects"] if e["name"] == "sensor_offset"]
    for p, value in zip(offset["parameters"].values(), (-9.0765, 1.0181, -9.9848, -0.43250, 0.69155, 0.15703), strict=True):
        assert p["low"] < value < p["high"]
    gain = written["common_gain"]
    assert gain["low"] < 0.0 < gain["high"] < 0.01 and "may be none" in printed
    assert {p.name for p in out.iterdir()} == {
        "calibration.json", "report.html", "gravity_compensation.yaml", "ros2_gravity_filter.yaml", "ros2_admittance.yaml"
    }  # fmt: skip
    again = bayesid.load(out)
    assert str(again) in printed and again.verdict == written["verdict"]


def test_a_sensor_under_the_base_carries_the_arm(tmp_path):
    robot = puma2(tmp_path)
    arm = experiment(robot, [], Sensor(translation=np.array([0.0, 0.0, -0.1])), inertia_rel_std=0.02)
    result = bayesid.calibrate(recorded(arm, {"sensor_crosstalk@mx->fz": {"coefficient": 0.1}}, count=100))
    assert result.mass is None and result.exports() == {} and "whole arm" in result.sentences[0]
    (coefficient,) = result.found["sensor_crosstalk@mx->fz"]
    assert abs(coefficient.value - 0.1) < 4.0 * coefficient.std
    assert repr(result).startswith("<Calibration of test: ") and "<table" in result._repr_html_()
    with pytest.raises(bayesid.InputError, match="of use where the sensor carries one body"):
        bayesid.calibrate(recorded(arm, {}, count=20), mass=1.0)


def test_what_cannot_be_used_is_refused(wrist, tmp_path):
    poses = recorded(wrist, {}, count=12)
    for given, said in (
        (dict(mass=-1.0), "give the known mass in kilograms, above 0"), (dict(mass=1.0, mass_std=-1.0), "0 or more"),
        (dict(mass_std=0.01), "is of a known mass"),
        (dict(reference=poses), "says how much was hung on only with that mass"),
    ):  # fmt: skip
        with pytest.raises(bayesid.InputError, match=said):
            bayesid.calibrate(poses, **given)
    with pytest.raises(bayesid.InputError, match="has no force/torque sensor"):
        bayesid.calibrate(replace(poses, sensor=None))


def test_the_yaml_is_of_the_sensors_own_frame(faulty, wrist):
    load = faulty.load
    assert load.sensor == "sensor_plate"
    np.testing.assert_allclose(load.centre_in_sensor, load.centre - np.array([0.0, 0.0, 0.02]), atol=1e-12)
    np.testing.assert_allclose(load.offset, OFFSET, atol=0.1)
    model = pin.buildModelFromUrdf(str(wrist.robot.urdf))
    assert load.mass == pytest.approx(sum(f.inertia.mass for f in model.frames if f.name in ("wrist_ft", "tool_mount")), rel=0.01)
