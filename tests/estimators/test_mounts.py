"""Mounts that ring, identified from motions with coarse encoders without starting values, against those simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid.estimators.errors_in_variables import TotalLeastSquares
from bayesid.estimators.nonlinear import solve
from bayesid.recordings.experiment import Sensor
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
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
