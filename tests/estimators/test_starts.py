"""Cables tied anywhere and contacts at any time, identified without a start; and what is said of shapes that stay open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bayesid
from bayesid.estimators.least_squares import weighted_factor
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.experiment import Sensor
from bayesid.regression.problem import relinearised
from tests.simulated import experiment, puma2

SEEDS = range(12)
POINT = {"point_x": 0.05, "point_y": 0.02, "point_z": 0.0}


def recorded(folder, seed: int) -> bayesid.Simulation:
    """A two-joint arm on a sensor, and a cable that is tied in any direction and distance."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=3)
    length = rng.uniform(0.6, 2.2)
    anchor = dict(zip(("anchor_x", "anchor_y", "anchor_z"), length * way / np.linalg.norm(way), strict=True))
    cable = {"stiffness": rng.uniform(0.3, 3.0), "rest_length": 0.3 * length, **anchor, **POINT}
    return simulated(folder, {"tether@joint2": cable}, seed)


def simulated(folder, effects: dict[str, dict[str, float]], seed: int) -> bayesid.Simulation:
    """Ten seconds of that arm, and as many to be predicted."""
    robot = puma2(folder)
    setup = experiment(robot, [], Sensor(force_std=0.2, torque_std=0.02), position_resolution=2e-5)
    planned = [
        bayesid.fourier_trajectory(robot, role, role, duration=10.0, rate=100.0, seed=10 * seed + k)
        for k, role in enumerate(("identification", "validation"))
    ]
    recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=2e-5)
    return bayesid.simulate(setup, planned, effects=effects, recorder=recorder, perturb=0.1, seed=seed)


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """Recordings with what is identified from them, without a start."""
    made = [recorded(tmp_path_factory.mktemp("cable"), seed) for seed in SEEDS]
    return [(m, bayesid.identify(m, effects="tether@joint2")) for m in made]


def test_a_cable_tied_anywhere_is_found_without_a_start(identified):
    assert max(found.validation[0].whitened_rms for _, found in identified) < 1.15


def test_intervals_hold_whether_shapes_settle_or_not(identified):
    """Beside shapes that ran away 68 % of 95 % intervals held."""
    z = np.array([(f.values - f.base.matrix @ m.truth.links.ravel()) / f.parameters().std[: f.base.rank] for m, f in identified])
    assert np.isfinite(z).all() and z.shape == (len(SEEDS), 12)
    assert np.mean(np.abs(z) < 1.96) > 0.9


@pytest.mark.parametrize("seed", range(6))
def test_a_contact_at_any_time_is_found_without_a_start(tmp_path, seed):
    """From the usual start, in the first second, none was."""
    rng = np.random.default_rng(seed)
    begin, force = rng.uniform(0.5, 6.0), rng.normal(size=3)
    times = {"start": begin, "end": begin + rng.uniform(0.8, 3.5)}
    push = dict(zip(("fx", "fy", "fz"), rng.uniform(1.0, 8.0) * force / np.linalg.norm(force), strict=True))
    made = simulated(tmp_path, {"external_contact@joint2": {**times, **push, **POINT}}, seed)
    (found,) = [e for e in bayesid.identify(made, effects="external_contact@joint2").effects() if e["name"] == "external_contact"]
    for key, value in times.items():
        assert abs(found["parameters"][key]["value"] - value) < 0.01


def test_a_start_at_the_truth_stays_there(tmp_path):
    """From nominal links the first step was for the better as they became right, and led the cable astray."""
    recording = recorded(tmp_path, 4)
    values = {"tether@joint2": dict(recording.truth.effects["tether@joint2"])}
    found = bayesid.identify(replace(recording, effect_values=values), effects="tether@joint2")
    assert found.validation[0].whitened_rms < 1.1


def test_what_shapes_that_are_held_leave_open_is_in_the_inverse_of_all(identified, tmp_path):
    """``(A + P)^-1`` of all parameters, P what is plausible of those held, in its block of the others."""
    found = next(f for _, f in identified if f.problem.row_model.point.unsettled is not None)
    problem, estimate = found.problem, found.estimate
    point = problem.row_model.point
    free = point.free | point.unsettled
    released = relinearised(problem, replace(point, free=free, unsettled=None))
    matrix = weighted_factor(released.regression, learn_weights(problem.regression), estimate.details.weights)[0].matrix
    held = np.append(np.zeros(problem.row_model.base.rank, bool), point.unsettled[free])
    effects = problem.row_model.effects
    width = np.concatenate([np.subtract(e.upper, e.lower) for e in effects])[point.unsettled]
    wider = estimate.details.dispersion or 1.0
    normal = matrix.T @ matrix / wider
    normal[np.ix_(held, held)] += np.diag(12.0 / width**2)
    size = np.sqrt(np.diag(normal))
    unit = normal / np.outer(size, size)
    whole, alone = np.linalg.inv(unit)[np.ix_(~held, ~held)], np.linalg.inv(unit[np.ix_(~held, ~held)])
    expected = np.diag(whole - alone) / size[~held] ** 2
    assert_allclose(np.diag(estimate.held_covariance), expected, rtol=1e-3, atol=1e-9 * np.diag(estimate.full_covariance).min())
    assert_allclose(estimate.unbiased_std**2, np.diag(estimate.full_covariance) + np.diag(estimate.held_covariance), rtol=1e-9)
    found.write(tmp_path / "kept")
    assert_allclose(bayesid.load(tmp_path / "kept").estimate.unbiased_std, estimate.unbiased_std, rtol=1e-9)
