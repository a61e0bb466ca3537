"""MuJoCo's arm reads what Pinocchio's inverse dynamics says of the same motion."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.studies.coverage_case import ARMS, links_unlike, setup
from tests.studies.encoder_coverage import plant, wrench

pytest.importorskip("mujoco")
STEP, COUNT = 5e-4, 2000


@pytest.mark.parametrize("arm", ARMS)
def test_the_wrench_is_that_of_the_motion(arm):
    from tests.studies import mujoco_plant

    case, model, step = setup(arm), plant(arm), STEP
    links = links_unlike(case.robot, np.random.default_rng(1))
    still = np.zeros(case.robot.n)
    fixed = pin.buildReducedModel(model, [1], pin.neutral(model))
    for joint, link in enumerate(links.reshape(-1, 10)):
        fixed.inertias[joint + 1] = pin.Inertia.FromDynamicParameters(link)
    data = fixed.createData()

    def drive(k: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        asked = 3.0 * np.cos(6.0 * k * step + np.arange(len(q))) + 900.0 * (case.centre - q) - 40.0 * v
        return pin.rnea(fixed, data, q, v, asked)

    drives = (partial(drive, k) for k in range(COUNT))
    q, read = mujoco_plant.recorded(fixed, links, 0.0, step, (case.centre, still), drives)
    v = (q[2:] - q[:-2]) / (2.0 * step)
    a = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / step**2
    expected = wrench(arm, links, q[1:-1], v, a)
    weight = expected[0] - read[1]  # of the base, which MuJoCo's has not
    assert_allclose(weight[[0, 1, 5]], 0.0, atol=0.05)
    moving = read[1:-1] - read[1]
    assert np.all(moving.std(axis=0) > 0.1)
    assert_allclose(moving, expected - expected[0], atol=0.01 * moving.std(axis=0).max())
