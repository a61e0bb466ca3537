"""A sensor's zero that moved between a motion and its static run is told, and nothing else is taken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.validation.mistakes.search import find_mistakes
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=(0.0, 0.0, -0.1))
OFFSET = np.array([3.0, -2.0, 5.0, 0.2, -0.1, 0.05])


def made(robot, moved, seed=1):
    """A motion and its static run, row by row, whose zeros differ by a wrench (6,)."""
    motions = []
    for k, (name, role) in enumerate((("one", "identification"), ("two", "validation"))):
        path = fourier(robot, seed + k, duration=12.0)
        noise = {"force_std": 0.3, "torque_std": 0.03, "resolution": 2e-5}
        table = recording(robot, SENSOR, path, seed=seed + k, offset=OFFSET + moved, **noise)
        still = recording(robot, SENSOR, path, seed=seed + k + 50, offset=OFFSET, static=True, **noise)
        motions.append(Motion(name, role, replace(table, torques=None), static=replace(still, torques=None)))
    return experiment(robot, motions, SENSOR, inertia_rel_std=0.05, position_resolution=2e-5)


def test_a_zero_that_moved_is_told_by_every_verb_and_its_size(tmp_path):
    """Of a base sensor along gravity: `diagnose` named a drift, and `identify` had no idea."""
    shifted = made(puma2(tmp_path), np.array([0.0, 5.0, 20.0, 0.0, 0.3, 0.0]))
    first, second = find_mistakes(shifted)
    assert {(m.name, m.where) for m in (first, second)} == {("static_zero", "one"), ("static_zero", "two")}
    told = "The sensor's zero seems to have moved by fy"
    assert all(m.text.startswith(told) and "fz 20 N" in m.text for m in (first, second))
    assert any(told in w for w in bayesid.identify(shifted, progress=None).warnings)
    assert any(told in w for w in bayesid.check(shifted, progress=None).warnings)


@pytest.mark.parametrize("effect", [None, "sensor_drift", "payload@joint2", "external_contact@joint2", "sensor_gain@fz"])
def test_nothing_else_is_a_zero_that_moved(tmp_path, effect):
    robot = puma2(tmp_path)
    if effect is None:
        assert all(not find_mistakes(made(robot, np.zeros(6), seed)) for seed in range(10, 30, 2))
        return
    path = bayesid.fourier_trajectory(robot, duration=12.0, seed=1)
    setup = experiment(robot, [], SENSOR, inertia_rel_std=0.05)
    one = bayesid.simulate(setup, [replace(path, static_positions=path.positions)], effects=[effect], seed=3)
    assert one.motions[0].stop_and_go and "static_zero" not in {m.name for m in find_mistakes(one)}
