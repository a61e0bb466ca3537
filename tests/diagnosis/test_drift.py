"""A drift beside static runs: `diagnose` and `identify` have the same rows of it, on recordings simulated with known slopes."""

from __future__ import annotations

import pytest

import bayesid
from bayesid.recordings.experiment import Sensor
from bayesid.simulation.trajectories import fourier_trajectory
from tests.simulated import experiment, puma2

SLOPES = {"fx": 0.05, "fy": -0.04, "fz": 0.06, "mx": 0.004, "my": -0.003, "mz": 0.005}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bayesid.Simulation:
    """Two motions of 12 s, each with its static run, links known to 3 %; an offset is there, too."""
    robot = puma2(tmp_path_factory.mktemp("drift"))
    setup = experiment(robot, [], Sensor(), inertia_rel_std=0.03)
    planned = [
        fourier_trajectory(robot, role, role, duration=12.0, fundamental=0.25, static=True, seed=seed)
        for seed, role in enumerate(("identification", "validation"))
    ]
    recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=5e-5)
    return bayesid.simulate(setup, planned, effects={"sensor_drift": SLOPES, "sensor_offset": {}}, recorder=recorder, seed=1)


def test_a_drift_with_static_runs_is_named(recorded: bayesid.Simulation) -> None:
    found = bayesid.diagnose(recorded)
    assert found.verdict == "named" and [f.term.effect.spec for f in found.found] == ["sensor_drift@sensor"]
    (said,) = found.to_dict()["effects"]
    for axis, slope in SLOPES.items():
        assert abs(said["parameters"][axis]["value"] - slope) < 4.0 * said["parameters"][axis]["std"]
    assert found.gap is not None and found.gap.before > 2.0 and found.gap.after < 1.1 and found.gap.closed_low > 0.9


@pytest.mark.parametrize("static", ["motion", "joint"])
def test_identify_has_the_same_slopes_whether_static_runs_are_subtracted_or_fitted(
    recorded: bayesid.Simulation, static: str
) -> None:
    estimate = bayesid.identify(recorded, effects="sensor_drift", static=static).to_dict()
    (said,) = [e for e in estimate["effects"] if e["name"] == "sensor_drift"]
    for axis, slope in SLOPES.items():
        assert abs(said["parameters"][axis]["value"] - slope) < 4.0 * said["parameters"][axis]["std"]
