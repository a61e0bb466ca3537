"""The gap to the best flexible predictor: large where friction is hidden, none where nothing is, not asked without a judge."""

import dataclasses

import numpy as np
import pytest

import bayesid
from bayesid.regression.row_cache import PILOT_ROWS
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from bayesid.validation import flexible
from bayesid.validation.prediction import still_predictable
from tests.robots import ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, recording

COULOMB, STD = 4.0, 0.1


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return load_robot(write(tmp_path_factory.mktemp("arm"), ur5()))


def arm(robot, *, friction, duration=30.0, sensor=None, roles=("identification", "validation")):
    """Joint torques with friction that no model of the library has: it rises with speed and depends on position."""
    motions = []
    for k, role in enumerate(roles):
        motion = fourier(robot, k + 1, duration=duration)
        table = recording(robot, sensor, motion, seed=k, torque_std=STD, force_std=0.3, resolution=2e-5)
        _, q, v, _ = motion
        lost = friction * np.tanh(v / 0.02) * (1.0 + 0.3 * np.cos(q)) / np.sqrt(1.0 + np.abs(v))
        table = dataclasses.replace(table, torques=table.torques + lost)
        motions.append(Motion(f"{role}-{k}", role, table))
    return experiment(robot, motions, sensor, position_resolution=2e-5)


@pytest.mark.parametrize("low_pass", [None, LowPass(1.0, 50.0)])
def test_hidden_friction_is_a_large_gap(robot, low_pass):
    result = bayesid.identify(arm(robot, friction=COULOMB), channel="torque", low_pass=low_pass)
    gap = result.validation[0].flexible
    assert gap is not None and gap.certain
    # What is left can be checked by hand: sensor noise is a hundredth of this friction's power.
    assert gap.removed > 0.6
    said = still_predictable(result.validation[0])
    assert f"would still remove {100 * gap.removed:.2g} % of this error: something predictable is missing" in said
    assert said in bayesid.summary(result)
    assert result.to_dict()["validation"][0]["flexible_model"]["beyond_chance"] is True
    assert result.fitted[0].flexible is None


@pytest.mark.parametrize("channel", ["torque", "wrench"])
def test_a_complete_model_leaves_nothing(robot, channel):
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    certain = 0
    for duration in (12.0, 30.0):
        made = arm(robot, friction=0.0, sensor=sensor, duration=duration, roles=("identification", "validation", "validation"))
        result = bayesid.identify(made, channel=channel)
        for p in result.validation:
            assert p.flexible is not None and p.flexible.removed < 0.05
            certain += p.flexible.certain
    assert certain == 0
    assert "finds nothing more" in still_predictable(result.validation[0])


def test_of_friction_that_is_in_the_model_nothing_is_left(robot):
    """Viscous friction, identified as such: the flexible model could say no more of it."""
    made = arm(robot, friction=0.0)
    motions = []
    for m in made.motions:
        speed = np.gradient(m.table.positions, m.table.times, axis=0)
        assert m.table.torques is not None
        motions.append(dataclasses.replace(m, table=dataclasses.replace(m.table, torques=m.table.torques + 5.0 * speed)))
    viscous = dataclasses.replace(made, motions=tuple(motions))
    without, modelled = (
        bayesid.identify(viscous, channel="torque", effects=effects).validation[0].flexible
        for effects in ((), ("viscous_friction",))
    )
    assert without is not None and without.certain and without.removed > 0.5
    assert modelled is not None and not modelled.certain


def test_without_a_motion_to_judge_by_there_is_none(robot):
    result = bayesid.identify(arm(robot, friction=COULOMB, roles=("identification",)), channel="torque")
    assert result.validation == () and "flexible" not in bayesid.summary(result)


@pytest.mark.slow
def test_as_many_rows_of_a_long_recording_as_of_a_short_one(robot, monkeypatch):
    seen = []
    monkeypatch.setattr(flexible, "_gap", lambda rows, *rest, gap=flexible._gap: seen.append(rows) or gap(rows, *rest))
    for duration in (60.0, 280.0):
        bayesid.identify(arm(robot, friction=COULOMB, duration=duration), channel="torque")
    assert 1000 < len(seen[0].target) < len(seen[-1].target) <= 2 * PILOT_ROWS
    assert seen[-1].state[0].shape == (len(seen[-1].target), 6)


SAID = [
    (0.3, 0.02, "still remove 30 %"), (0.998, 0.02, "still remove 100 %"), (0.01, 0.1, "nothing"),
    (0.3, 0.2, "remove 30 +- 20 % of this error, which is within chance"),
]  # fmt: skip


@pytest.mark.parametrize("removed, std, said", SAID)
def test_the_sentence(robot, removed, std, said):
    result = bayesid.identify(arm(robot, friction=0.0, duration=12.0), channel="torque").validation[0]
    gap = flexible.FlexibleGap(removed, std)
    assert said in still_predictable(dataclasses.replace(result, flexible=gap))
