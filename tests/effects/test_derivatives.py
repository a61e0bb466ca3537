"""Columns against differences of readings."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.effects import MotionSegment, PlayEffect, Term, columns, readings, rigid_columns
from bayesid.signals.smoothing import smooth
from tests.effects.arms import LIBRARY, both, moving, term


def behind_teeth(robot, channels, link, effect, values):
    """What encoders read of a link with play: of motors that move smoothly there is more than one link motion."""
    torque = readings(robot, channels, link, robot.nominal)[:, channels.names.index(f"tau{effect.joint + 1}")]
    read = link.positions + effect.lean(torque, values)[:, None] * np.eye(robot.n)[effect.joint]
    return MotionSegment(link.times, *smooth(link.times, read, 10.0), bandwidth=10.0, encoders=(link.times, read))


@pytest.mark.parametrize("name", LIBRARY.classes)
@pytest.mark.parametrize("arm", ["panda", "wrist"])
def test_columns_are_derivatives(arm, name, request):
    robot = request.getfixturevalue(arm)
    channels, segment = both(robot), moving(robot, 600)
    others = [
        term(robot, "sensor_rotation", 0.1, 0.2, -0.1), term(robot, "sensor_gain@fx", 0.1), term(robot, "sensor_delay", 0.01),
        term(robot, "torque_gain@joint2", 0.1), term(robot, "load_friction@joint2", 0.1),
    ]  # fmt: skip
    found = LIBRARY.places(name, robot.joint_names, channels.names, {robot.joint_names[1]: 80.0})
    effect = found[min(1, len(found) - 1)]
    values = np.array(effect.typical(robot), float)
    if isinstance(effect, PlayEffect):
        segment = behind_teeth(robot, channels, segment, effect, values)
    terms = [t for t in others if t.effect != effect] + [Term(effect, values)]
    got = columns(robot, channels, segment, robot.nominal, terms, effect)
    assert got.shape == (600, len(channels), len(values)) and np.isfinite(got).all()
    for k, value in enumerate(values):
        step = {"compliance": 1e-7, "resonance": 1e-3}.get(effect.parameters[k], 1e-4 * max(abs(value), 0.1))
        shift = step * np.eye(len(values))[k]
        ends = [
            readings(robot, channels, segment, robot.nominal, [*terms[:-1], Term(effect, values + s * shift)]) for s in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / (2 * step)
        tolerance = 2e-2 if effect.parameters[k] in ("start", "end") else 2e-3
        assert np.linalg.norm(got[:, :, k] - slope) <= tolerance * np.linalg.norm(slope) + 1e-7
    # From anywhere else: the value asked for, not the term's.
    there = columns(robot, channels, segment, robot.nominal, terms, effect, values)
    np.testing.assert_array_equal(got, there)


@pytest.mark.parametrize("kind", ["moving", "few samples", "poses"])
@pytest.mark.parametrize("arm", ["panda", "slider"])
def test_the_first_play_is_what_a_little_play_makes(arm, kind, request):
    """At a play of zero, where the closed form is taken, against the readings with less than encoders show."""
    robot = request.getfixturevalue(arm)
    channels, segment = both(robot), moving(robot, 6 if kind == "few samples" else 600)
    if kind == "poses":
        segment = replace(segment, still=True)
    noise = 1e-5 * np.random.default_rng(0).normal(size=segment.positions.shape)
    segment = replace(segment, encoders=(segment.times, segment.positions + noise))
    effect = LIBRARY.places("backlash", robot.joint_names, channels.names, {})[1]
    other = term(robot, "load_friction@joint2", 0.1)
    got = columns(robot, channels, segment, robot.nominal, [other], effect, (0.0, 0.5))
    ends = [readings(robot, channels, segment, robot.nominal, [other, Term(effect, (s * 1e-7, 0.5))]) for s in (1, -1)]
    slope = (ends[0] - ends[1]) / 2e-7
    assert np.linalg.norm(slope) > 0.0
    assert np.linalg.norm(got[:, :, 0] - slope) <= 1e-4 * np.linalg.norm(slope)
    np.testing.assert_array_equal(got[:, :, 1], 0.0)


def test_rigid_columns_go_through_the_instruments(wrist):
    channels, segment = both(wrist), moving(wrist, 50)
    terms = [
        term(wrist, "sensor_rotation", 0.1, 0.2, -0.1), term(wrist, "sensor_crosstalk@fz->my", 0.1),
        term(wrist, "sensor_delay", 0.01), term(wrist, "torque_gain@joint2", 0.1), term(wrist, "load_friction@joint2", 0.1),
        term(wrist, "encoder_offset@joint2", 0.1), term(wrist, "base_tilt", 0.1, 0.1),
    ]  # fmt: skip
    got = rigid_columns(wrist, channels, segment, wrist.nominal, terms)
    change = 1e-3 * np.random.default_rng(0).normal(size=wrist.nominal.shape)
    ends = [readings(wrist, channels, segment, wrist.nominal + s * change, terms) for s in (1, -1)]
    np.testing.assert_allclose(got @ change.ravel(), 0.5 * (ends[0] - ends[1]), atol=1e-9)
