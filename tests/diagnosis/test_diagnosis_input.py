"""Diagnosis of recordings and models that are unusual, but legal; made with bayesid's own simulation."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import bayesid
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.robot.robot import load_robot
from bayesid.workflows.demo import PAPER_LOCKED, puma_two_joint_urdf

DRY = ("coulomb_friction", "viscous_friction")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("puma") / "puma.urdf"
    path.write_text(puma_two_joint_urdf(), encoding="utf-8")
    return load_robot(path, ["joint1", "joint2"], PAPER_LOCKED)


def motion(robot, name="first", role="identification", *, seconds=8.0, seed=1):
    return bayesid.fourier_trajectory(robot, name, role, duration=seconds, seed=seed)


def recorded(robot, motions, effects=(), *, seed=1, force=0.3):
    recorder = bayesid.Recorder(force_std=force, torque_std=0.1 * force, resolution=2e-5)
    return bayesid.simulate(robot, motions, effects=effects, recorder=recorder, perturb=0.03, seed=seed)


def both(robot, seed=1):
    return [motion(robot, seed=seed), motion(robot, "unseen", "validation", seed=seed + 50)]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_known_friction_of_sampled_readings_leaves_nothing(robot, seed):
    """`simulate` samples, it does not average: near a reversal that is all of the friction or half of it."""
    found = bayesid.diagnose(recorded(robot, both(robot, seed), DRY, seed=seed), "torque", effects=DRY)
    assert found.verdict == "nothing_missing"
    assert any("values at their times" in r for r in found.remarks)


def test_a_fast_motion_of_a_rigid_robot_sampled_slowly_is_not_soft(robot):
    """Means over a sample's time are smaller than the values that `simulate` makes: it was called a compliant base."""
    fast = [
        bayesid.fourier_trajectory(robot, name, role, duration=8.0, rate=50.0, fundamental=0.25, seed=seed)
        for name, role, seed in (("first", "identification", 1), ("unseen", "validation", 2))
    ]
    recorder = bayesid.Recorder(force_std=0.1, torque_std=0.01, resolution=1e-7)
    found = bayesid.diagnose(bayesid.simulate(robot, fast, recorder=recorder, perturb=0.03, seed=1))
    assert found.verdict == "nothing_missing"
    assert any("values at their times" in r for r in found.remarks)


def test_unknown_friction_of_sampled_readings_is_named(robot):
    named = bayesid.diagnose(recorded(robot, both(robot), DRY), "torque")
    assert named.verdict == "named" and {f.term.effect.name for f in named.found} == set(DRY)


@pytest.mark.parametrize("seed", [10, pytest.param(20, marks=pytest.mark.slow)])
def test_a_quiet_sensor_shows_no_contact_in_the_taper(robot, seed):
    """The mean over a sample's time belongs to the reading, not to the weight that it gets afterwards."""
    found = bayesid.diagnose(recorded(robot, both(robot, seed), force=0.005, seed=seed))
    assert found.verdict == "nothing_missing"


def test_a_joint_that_rests_all_the_time_says_nothing(robot):
    """One joint at a time, as the report itself asks for."""

    def one(name, role, joint, seed):
        whole = motion(robot, name, role, seconds=6.0, seed=seed)
        moves = np.arange(robot.n) == joint
        q = np.where(moves, whole.positions, whole.positions[0])
        return replace(whole, positions=q, velocities=moves * whole.velocities, accelerations=moves * whole.accelerations)

    motions = [one("first", "identification", 0, 1), one("unseen", "validation", 0, 2)]
    found = bayesid.diagnose(recorded(robot, motions, ("viscous_friction@joint1",)), "torque")
    assert [f.term.effect.spec for f in found.found] == ["viscous_friction@joint1"]
    assert found.search.projector.rows == found.search.projector.length / 2


def test_values_that_are_kept_are_those_of_the_model_in_use(robot):
    """A fixed value counts under every spelling of its name, and only while its effect is in the model."""
    given = recorded(robot, both(robot), {"sensor_gain@fz": {"gain": 0.1}})
    for key in ("sensor_gain@fz", "sensor_gain"):
        held = replace(given, effects=("sensor_gain@fz",), effect_values={key: {"gain": 0.1, "fixed": True}})
        found = bayesid.diagnose(held)
        assert found.verdict == "nothing_missing" and found.terms[0].values == (0.1,)
    without = bayesid.diagnose(held, effects=())  # the spelling without a place, which other effects share
    assert [f.term.effect.spec for f in without.found] == ["sensor_gain@fz"] and without.found[0].std[0] > 0
    wrong = replace(given, effects=("sensor_gain@fz",), effect_values={"sensor_gain@fz": {"gian": 0.1}})
    with pytest.raises(bayesid.InputError, match="no parameter 'gian'"):
        bayesid.diagnose(wrong)


def test_a_rejected_attempt_leaves_the_users_model_alone(robot):
    """Values that hold only beside effects that were not named are not handed on."""
    given = replace(recorded(robot, both(robot), ("sensor_gain@fz", "base_tilt")), effects=("sensor_gain@fz",))
    found = bayesid.diagnose(given)
    rejected = replace(found, verdict="unknown", found=())
    assert rejected.terms == found.search.base.terms != found.terms[:1]
    assert rejected.model[1]["sensor_gain@fz"]["gain"] == found.search.base.terms[0].values[0]


def test_a_validation_motion_that_cannot_be_compared_is_named(robot):
    motions = [motion(robot, seconds=6.0), motion(robot, "brief", "validation", seconds=1.9)]
    found = bayesid.diagnose(recorded(robot, motions, ("sensor_gain@fz",)))
    assert found.gap is None and found.data.skipped == (("brief", "no segment of 2 s without a gap"),)
    assert any("brief (no segment of 2 s without a gap)" in r for r in found.remarks)


def test_without_a_gap_there_is_no_share_of_it(robot):
    """Nothing hidden: the unseen motion is as good as a complete model's."""
    gaps = [bayesid.diagnose(recorded(robot, both(robot, seed), seed=seed)).gap for seed in range(1, 6)]
    assert any(gap.before <= gap.floor for gap in gaps)
    for gap in gaps:
        said = json.loads(json.dumps(gap.to_dict(), allow_nan=False))
        assert (said["closed"] is None) == (gap.before <= gap.floor)


def test_what_takes_no_part_is_said(robot):
    """An effect of the other channel, and times since some day in 1970."""
    given = recorded(robot, both(robot))
    later = [replace(m, table=replace(m.table, times=m.table.times + 1.7e9)) for m in given.motions]
    found = bayesid.diagnose(replace(given, motions=tuple(later)), effects=["viscous_friction@joint1"])
    assert found.verdict == "nothing_missing"
    assert any("viscous_friction@joint1 of the model cannot be seen" in r for r in found.remarks)
    assert any("Times start at 1.7e+09 s" in r for r in found.remarks)


def test_identify_says_that_a_drift_is_lost_in_late_times(robot):
    """Only of an effect that counts from time zero, and in the words of `diagnose`."""
    given = recorded(robot, both(robot))
    late = replace(given, motions=tuple(replace(m, table=replace(m.table, times=m.table.times + 1.7e9)) for m in given.motions))
    said = {
        (when, effects): any(
            "Times start at 1.7e+09 s" in w for w in bayesid.identify(x, channel="wrench", effects=effects).warnings
        )
        for when, x in (("early", given), ("late", late))
        for effects in ("sensor_drift", "sensor_offset")
    }
    assert said == {("early", "sensor_drift"): False, ("early", "sensor_offset"): False, ("late", "sensor_drift"): True,
                    ("late", "sensor_offset"): False}  # fmt: skip


def test_a_payload_that_links_can_hide_is_explained(robot):
    """The same motions, carrying more than the trust in the last link allows: no residual, but links far from nominal."""
    body = {"m": 3.0, "mcx": 1.0, "mcy": 0.2, "Ixx": 0.1, "Iyy": 0.5, "Izz": 0.5}
    given = recorded(robot, both(robot), {"payload@joint2": body})
    found = bayesid.diagnose(given)
    assert [f.term.effect.where for f in found.found] == ["joint2"]
    assert found.gap.before < 1.05 * found.gap.floor
    assert any("What speaks for it is the links' prior" in r for r in found.remarks)


def test_what_a_known_effect_hides_is_not_determined(robot):
    """Where a spring rests cannot be told from an offset of the same joint's torque; how stiff it is can."""
    plant = {"spring@joint2": {"stiffness": 20.0, "rest": 0.3}, "torque_offset@joint2": {"offset": 0.5}}
    whole = replace(recorded(robot, both(robot), plant), effects=("torque_offset",))
    found = bayesid.diagnose(whole, "torque")
    (spring,) = (f for f in found.found if f.term.effect.spec == "spring@joint2")
    values = dict(zip(spring.term.effect.parameters, zip(spring.term.values, spring.std, strict=True), strict=True))
    stiffness, std = values["stiffness"]
    assert abs(stiffness - 20.0) < 3.0 * std < 3.0
    assert values["rest"][1] == np.inf
    assert "rest not determined" in next(line for line in str(found).splitlines() if "rest" in line)


@pytest.mark.parametrize("seed", [1, 2])
def test_what_shakes_the_readings_far_above_their_noise_is_no_noise(robot, seed):
    """A table that is shaken with twenty times the noise: it was taken for noise, nothing missing or a contact "ambiguous"."""
    rng, seconds, rate = np.random.default_rng(seed), 16.0, 100.0
    motions = [
        bayesid.fourier_trajectory(
            robot, name, role, duration=seconds, rate=rate, fundamental=1.0 / seconds, seed=place + 10 * seed
        )
        for name, role, place in (("first", "identification", 1), ("unseen", "validation", 51))
    ]
    experiment = recorded(robot, motions, seed=seed)
    slow = butter(2, [0.3, 3.0], "band", fs=rate, output="sos")

    def shaken(m):
        shakes = sosfiltfilt(slow, rng.normal(size=m.table.wrench.shape), axis=0)
        wrench = m.table.wrench + 20.0 * shakes / shakes.std() * [0.3, 0.3, 0.3, 0.03, 0.03, 0.03]
        return replace(m, table=replace(m.table, wrench=wrench))

    found = bayesid.diagnose(replace(experiment, motions=tuple(shaken(m) for m in experiment.motions)), "wrench")
    assert (found.verdict, found.data.floor_source) == ("unknown", "far above the noise")
    assert "no effect of the library explains it" in str(found) and not found.found


def test_what_is_far_above_the_noise_until_it_is_named_is_named_without_reserve(robot):
    """A sensor that is turned by 40 degrees, which no sum of small effects is: it was named in part, beside a gain of 1e-4."""
    turned, sensor = {"rx": 0.49, "ry": -0.3, "rz": 0.4}, Sensor(force_std=0.1, torque_std=0.01)
    setup = Experiment("turned", robot, (), sensor, inertia_rel_std=0.05, position_resolution=1e-5)
    motions = [
        bayesid.fourier_trajectory(robot, role, role, duration=12.0, rate=125.0, fundamental=0.25, seed=seed)
        for seed, role in enumerate(("identification", "validation"))
    ]
    recorder = bayesid.Recorder(force_std=0.1, torque_std=0.01, resolution=1e-5)
    found = bayesid.diagnose(
        bayesid.simulate(setup, motions, effects={"sensor_rotation": turned}, recorder=recorder, perturb=0.05)
    )
    assert (found.verdict, found.data.floor_source) == ("named", "white noise above the band")
    ((name, values),) = [(f.term.effect.name, f.term.values) for f in found.found]
    assert name == "sensor_rotation" and values == pytest.approx(tuple(turned.values()), abs=1e-4)
