"""Effects that no motion tells apart stand beside each other, whatever else the wider one could do."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid import Recorder, calibrate, diagnose, fourier_trajectory, load_robot, payload, simulate
from tests.robots import panda, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

QUIET = {"force_std": 0.3, "torque_std": 0.03, "resolution": 1e-5}


def recorded(robot, change=lambda table, motion: table, sensor=True, **options):
    """An experiment of two motions, of the sensor's wrench with the robot stopped as well."""
    under, motions = Sensor(translation=np.array([0.0, 0.0, -0.1]), rpy=np.zeros(3)) if sensor else None, []
    for k, (name, role) in enumerate((("fit", "identification"), ("unseen", "validation"))):
        motion = fourier(robot, k + 1, 12.0, 100.0)
        both = [recording(robot, under, motion, seed=10 * k + s, static=s, **QUIET, **options) for s in (False, True)]
        tables = [change(table, motion) for table in both]
        motions.append(Motion(name, role, tables[0], static=tables[1] if sensor else None))
    return experiment(robot, motions, under, inertia_rel_std=0.03, position_resolution=1e-5)


def names(found):
    """What was found, and what does as well in its place."""
    return found.found[0].term.effect.spec, {t.effect.spec for t, _ in found.found[0].rivals}


def test_a_sensor_turned_about_the_first_axis_is_as_likely_as_a_wrong_zero(tmp_path):
    """That a sensor may be turned about other axes, too, does not speak against its being turned about this one."""

    def shifted(table, motion):
        return replace(table, positions=table.positions + np.array([0.01, 0.0]))

    found = diagnose(recorded(puma2(tmp_path), shifted), "wrench")
    assert found.verdict == "ambiguous"
    assert names(found) == ("encoder_offset@joint1", {"sensor_rotation@sensor"})
    ((rival, _),) = found.found[0].rivals
    assert rival.values == pytest.approx((0.0, 0.0, 0.01), abs=3e-4)
    assert "none tells" in found.next_experiment


@pytest.mark.parametrize("turn", [pytest.param(0.09, marks=pytest.mark.slow), 0.42])
def test_a_wrist_sensor_turned_about_the_last_axis_is_as_likely_as_that_encoders_zero(turn, tmp_path):
    """Whatever the angle, and beside an offset and a drift: the load's centre of mass is then known to both readings of it."""
    arm = load_robot(write(tmp_path, panda()), sensor_joint="panda_joint8")
    setup = experiment(arm, [], Sensor("panda_joint8"))
    moved = fourier_trajectory(arm, "run", "identification", duration=12.0, rate=50.0, seed=3)
    hidden = {
        "sensor_rotation": {"rx": 0.0, "ry": 0.0, "rz": turn}, "sensor_offset": {"fx": 3.0, "my": 0.2},
        "sensor_drift": {"fx": 0.02, "fz": -0.02, "mx": 0.001},
    }  # fmt: skip
    recorder = Recorder(force_std=0.1, torque_std=0.005, resolution=1e-5)
    made = simulate(setup, [moved], effects=hidden, recorder=recorder, seed=5)
    found = diagnose(made, "wrench")
    assert found.verdict == "ambiguous"
    turned = next(f for f in found.found if f.term.effect.name not in ("sensor_offset", "sensor_drift"))
    assert {turned.term.effect.name, *(t.effect.name for t, _ in turned.rivals)} == {"encoder_offset", "sensor_rotation"}
    weighed, calibrated = payload(made, frame="panda_link8"), calibrate(made)
    assert not any("unexplained" in w for w in weighed.warnings)
    assert not {h.kind for h in calibrated.hidden} & {"encoder_offset", "sensor_rotation"}
    quiet = simulate(setup, [moved], recorder=Recorder(force_std=1e-3, torque_std=1e-5, resolution=0.0), seed=1)
    true = payload(quiet, diagnosis=False, frame="panda_link8")
    for told in (weighed, calibrated):
        assert told.mass is not None
        for q, exact in zip((told.mass, *told.centre), (true.mass, *true.centre), strict=True):
            assert q.low - q.std < exact.value < q.high + q.std


def test_a_rotors_momentum_is_the_inertia_of_two_links_in_a_wrench(tmp_path):
    robot = puma2(tmp_path)
    axis = robot.axis[1]
    phi, about = robot.nominal.copy(), {1: 0.3 * np.outer(axis, axis), 0: -0.3 * np.outer(up := robot.rotation[1] @ axis, up)}
    for link, inertia in about.items():
        phi[link, 4:] += inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    found = diagnose(recorded(robot, phi=phi.ravel()), "wrench")
    assert found.verdict == "ambiguous"
    assert names(found) == ("rotor_momentum@joint2", {"inertia_error@joint2", "inertia_error@joint1"})
    values = {t.effect.where: np.array(t.values) for t, _ in found.found[0].rivals}
    size = found.found[0].term.values[0]
    assert size == pytest.approx(0.3, abs=0.03)
    for link, where in enumerate(("joint1", "joint2")):
        np.testing.assert_allclose(values[where], size / 0.3 * (phi - robot.nominal)[link], atol=1e-12)
    assert "No motion tells rotor_momentum@joint2 from inertia_error@joint2 and inertia_error@joint1" in found.next_experiment


def test_of_the_first_link_torques_show_one_inertia_which_a_rotor_has_as_well(tmp_path):
    def geared(table, motion):
        return replace(table, torques=table.torques + 0.5 * motion[3] * np.array([1.0, 0.0]))

    found = diagnose(recorded(puma2(tmp_path), geared, sensor=False), "torque")
    assert found.verdict == "ambiguous"
    own, others = names(found)
    assert {own, *others} & {"payload@joint1", "inertia_error@joint1"} and "rotor_inertia@joint1" in {own, *others}
