"""Mounts that ring, identified from motions with coarse encoders without starting values, against those simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.estimators.covariance import right_side_lost
from bayesid.estimators.errors_in_variables import TotalLeastSquares
from bayesid.estimators.nonlinear import solve
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.experiment import Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare, relinearised
from bayesid.simulation.trajectories import Trajectory, fourier_trajectory
from tests.simulated import experiment, puma2

#: Time in which a motion comes up from rest and goes back to it [s].
RAMP = 1.5


def from_rest(motion: Trajectory) -> Trajectory:
    """The motion with its departure from the mean position times a window w, polynomials of degree 7 at both ends."""
    x = np.clip(np.minimum(motion.times, motion.times[-1] - motion.times) / RAMP, 0.0, 1.0)[:, None]
    sign = np.where(motion.times < motion.times[-1] / 2.0, 1.0, -1.0)[:, None] / RAMP
    w = x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)
    rate, bend = 140.0 * x**3 * (1.0 - x) ** 3 * sign, 420.0 * x**2 * (1.0 - x) ** 2 * (1.0 - 2.0 * x) * sign**2
    middle = motion.positions.mean(axis=0)
    d, v, a = motion.positions - middle, motion.velocities, motion.accelerations
    return replace(
        motion, positions=middle + w * d, velocities=rate * d + w * v, accelerations=bend * d + 2.0 * rate * v + w * a
    )  # fmt: skip


def recorded(folder, resonance: float, damping: float, count: float, seed: int) -> bayesid.Simulation:
    robot = puma2(folder)
    setup = experiment(robot, [], Sensor(force_std=0.2, torque_std=0.02), inertia_rel_std=0.05, position_resolution=count)
    planned = [
        from_rest(fourier_trajectory(robot, role, role, duration=14.0, rate=150.0, fundamental=0.25, seed=10 * seed + k))
        for k, role in enumerate(("identification", "validation"))
    ]
    recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=count)
    effects = {"base_compliance": {"resonance": resonance, "damping": damping}}
    return bayesid.simulate(setup, planned, effects=effects, recorder=recorder, perturb=0.05, seed=seed)


@pytest.mark.parametrize(
    ("resonance", "damping", "count", "seed"), [(5.5, 0.06, 5e-5, 1), pytest.param(4.0, 0.05, 2e-4, 6, marks=pytest.mark.slow)]
)
def test_a_mount_is_found_without_a_start_and_predicts_to_the_floor(tmp_path, resonance, damping, count, seed):
    recording = recorded(tmp_path, resonance, damping, count, seed)
    found = bayesid.identify(recording, effects="base_compliance")
    assert found.estimate.method == bayesid.accuracy(recording, effects="base_compliance", runs=0).bench.method.name == "gls"
    assert found.validation[0].whitened_rms < 1.15
    (entry,) = [e for e in found.to_dict()["effects"] if e["name"] == "base_compliance"]
    mount = {key: entry["parameters"][key]["value"] for key in ("resonance", "damping")}
    assert mount["resonance"] == pytest.approx(resonance, rel=0.01)
    assert mount["damping"] == pytest.approx(damping, rel=0.3)


def test_total_least_squares_is_as_sure_of_a_resonance_as_its_errors_are_large(tmp_path):
    """Its target moves with the columns where readings are linearised: 4 Hz were stated where the error was 0.02."""
    simulation = recorded(tmp_path, 8.0, 0.1, 1e-4, 2)
    simulation = replace(simulation, effect_values={"base_compliance": {"resonance": 8.0, "damping": 0.1}})
    problem, estimate = solve(
        prepare(simulation, FitOptions(effects=["base_compliance"], bandwidth=8.0)), TotalLeastSquares(draws=4)
    )
    at = problem.row_model.base.rank + problem.regression.effect_names.index("base_compliance@base.resonance")
    assert abs(estimate.solution[at] - 8.0) < 4.0 * estimate.full_std[at] < 1.0


def test_what_encoders_take_from_the_equations_is_the_slope_of_what_they_add_to_the_rows(tmp_path):
    """``E (D' u)' W'W D u`` is half the derivative of ``E |W D u|^2``, here by central differences in each value of a mount."""
    simulation = recorded(tmp_path, 9.0, 0.1, 1e-4, 2)
    simulation = replace(simulation, effect_values={"base_compliance": {"resonance": 9.0, "damping": 0.1}})
    problem = prepare(simulation, FitOptions(effects=["base_compliance"], bandwidth=10.0))
    weights, point = learn_weights(problem.regression), problem.row_model.point
    scale = {"trajectory": 1.0 / np.array([0.2, 0.2, 0.2, 0.02, 0.02, 0.02])}
    found = right_side_lost(problem.regression, weights, scale)[-2:]
    share = problem.regression.rows.count / sum(len(b.rows) for b in problem.regression.regressor_noise.pieces(None))

    def squares(step) -> float:
        there = relinearised(problem, replace(point, values=point.values + np.append(np.zeros(len(point.values) - 2), step)))
        solution = np.append(weights.solution[:-2], there.row_model.point.values[-2:])
        errors = there.regression.regressor_noise.misread(12, solution)
        return share * float(np.mean([sum(np.sum((e * scale["trajectory"]) ** 2) for e in draw) for draw in errors]))

    slopes = [(squares(step) - squares(-step)) / (4.0 * step.max()) for step in (np.array([1e-2, 0.0]), np.array([0.0, 1e-3]))]
    np.testing.assert_allclose(found, slopes, rtol=0.05)


def test_intervals_of_a_mount_hold_what_encoders_make_of_it(tmp_path):
    """Least squares alone takes a mount for damped too much, for it then passes on less of the encoders' errors."""
    plain, unbiased = [], []
    for seed in range(5):
        (folder := tmp_path / str(seed)).mkdir()
        found = bayesid.identify(recorded(folder, 9.0, 0.05, 1e-4, seed), effects="base_compliance")
        estimate = found.estimate
        error = estimate.solution[-2:] - (9.0, 0.05)
        assert estimate.effect_names[-1] == "base_compliance@base.damping"
        plain.append(error / estimate.full_std[-2:])
        unbiased.append((error - estimate.expected_error[-2:]) / estimate.unbiased_std[-2:])
        assert estimate.parameters().std[-2:] == pytest.approx(estimate.unbiased_std[-2:])
        assert found.model[1]["base_compliance@base"]["damping"] == estimate.unbiased[-1]
    found.write(folder / "kept")
    kept = bayesid.load(folder / "kept").estimate
    for one in ("solution", "unbiased", "full_std", "unbiased_std"):
        np.testing.assert_allclose(getattr(kept, one), getattr(estimate, one), rtol=1e-12)
    assert np.sqrt(np.mean(np.square(plain), axis=0))[1] > 2.0
    assert np.all(np.sqrt(np.mean(np.square(unbiased), axis=0)) < 1.3)


def test_a_posterior_of_a_mount_is_told_without_what_encoders_make_of_it(tmp_path):
    """`sample` told another mount than `identify`; weights, readings and errors are the same."""
    recording = recorded(tmp_path, 9.0, 0.05, 1e-4, 3)
    estimate = bayesid.identify(recording, effects="base_compliance").estimate
    posterior = bayesid.sample(recording, 1000, effects="base_compliance", prior="flat", keep_going=True)
    found, error = posterior.parameters(), estimate.expected_error[-2:]
    np.testing.assert_allclose(posterior.expected_error[-2:], error, rtol=0.1)
    assert error[1] > estimate.full_std[-1]
    assert np.all(np.abs(found.values[-2:] - estimate.unbiased[-2:]) < 0.2 * estimate.unbiased_std[-2:])
    np.testing.assert_allclose(found.std[-2:], estimate.unbiased_std[-2:], rtol=0.15)
    np.testing.assert_allclose(posterior.effect_draws[..., -2:].mean(axis=(0, 1)), estimate.solution[-2:], rtol=0.02)
    posterior.write(tmp_path / "kept")
    for kept in (bayesid.load(tmp_path / "kept"), bayesid.load(tmp_path / "kept" / "posterior.nc")):
        np.testing.assert_allclose(kept.parameters().values[-2:], found.values[-2:], rtol=1e-9)
        np.testing.assert_allclose(kept.parameters(0.9).low[-2:], posterior.parameters(0.9).low[-2:], rtol=1e-9)
