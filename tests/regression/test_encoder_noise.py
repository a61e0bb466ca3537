"""Errors of encoders: counts of a known size lie to a motion in ways that one recording does not show."""

import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from threadpoolctl import threadpool_limits

import bayesid
from bayesid import estimators
from bayesid.errors import BayesidWarning
from bayesid.estimators.errors_in_variables import TotalLeastSquares
from bayesid.recordings.experiment import Sensor
from bayesid.regression.encoder_noise import _errors, measure
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.segment import Segment
from bayesid.simulation.trajectories import fourier_trajectory
from tests.simulated import experiment, puma2
from tests.studies import encoder_coverage
from tests.studies.coverage_case import setup


def test_errors_of_counts_are_those_of_rounding():
    rng, times = np.random.default_rng(1), np.linspace(0.0, 20.0, 4001)
    positions = np.column_stack([np.sin(times), 0.01 * times])
    count = 1e-3
    errors = np.array([_errors(positions, np.full(2, count / 12**0.5), count, rng) for _ in range(20)])
    assert np.abs(errors).max() <= count / 2 * (1 + 1e-9)
    np.testing.assert_allclose(errors.std(axis=(0, 1)), count / 12**0.5, rtol=0.02)


@pytest.mark.parametrize("still", [0.3, 0.3 + 1e-7 * np.sin(np.linspace(0.0, 9.0, 500))])
def test_an_idle_joint_has_one_and_the_same_error(still):
    positions = np.column_stack([np.broadcast_to(still, 500), np.linspace(0.0, 1.234, 500)])
    rng = np.random.default_rng(2)
    spread = [np.ptp(_errors(positions, np.full(2, 1e-3 / 12**0.5), 1e-3, rng), axis=0) for _ in range(20)]
    assert np.median(spread, axis=0)[0] < 2.1e-7
    assert np.min(spread, axis=0)[1] > 0.9e-3


def test_noise_of_a_long_recording_is_measured_in_little_memory():
    """Smoothed whole, it takes positions, velocities and accelerations of all samples: 150 bytes a sample on six joints."""
    times = np.arange(400_000) / 125.0
    noise = 1e-4 * np.random.default_rng(3).normal(size=(len(times), 3))
    positions = np.sin(0.3 * times[:, None] + np.arange(3)) + noise
    nothing = np.zeros((len(times), 1))
    segment = Segment(times, positions, readings=nothing, known=nothing, motion=0)
    measure([replace(segment, times=times[:2000], positions=positions[:2000])], 5.0, np.full(3, 1.0))  # compiles
    tracemalloc.start()
    try:
        found = measure([segment], 5.0, np.full(3, 1.0))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < positions.nbytes
    np.testing.assert_allclose(found.std, 1e-4, rtol=0.005)
    assert np.abs(found.correlation).max() < 0.2


def test_recordings_of_one_robot_and_motion_state_like_standard_deviations(monkeypatch):
    """Errors of coarse counts are made where the motion turns; a smoothed recording knows that of its own counts only."""
    monkeypatch.setattr(encoder_coverage, "links_unlike", lambda robot, rng: setup("puma").truth)
    stds = []
    with warnings.catch_warnings(), threadpool_limits(1, user_api="blas"):
        warnings.simplefilter("ignore", BayesidWarning)
        for k in range(16):
            recorded, _ = encoder_coverage.record("puma, counts, 0.0001 rad", np.random.default_rng(k))
            stds.append(estimators.fit(prepare(recorded, FitOptions()).regression, "wls").std)
    spread = np.std(stds, axis=0, ddof=1) / np.mean(stds, axis=0)
    assert spread.max() < 0.17, spread  # 0.22 where the turning points stay as they were smoothed


def test_size_on_a_long_recording_with_many_short_pieces():
    """A part of them is measured, whole pieces each; those too short to tell anything count for nothing."""
    rng = np.random.default_rng(5)
    times = np.arange(100) / 125.0
    few = segment_of(np.arange(20) / 125.0, rng.normal(0.0, 1e-4, (20, 2)))
    many = [segment_of(times, 0.3 * np.sin(4.0 * times)[:, None] + rng.normal(0.0, 1e-4, (100, 2))) for _ in range(3000)]
    found = measure([few, *many], 5.0, np.full(2, 1.0))
    np.testing.assert_allclose(found.std, 1e-4, rtol=0.03)
    np.testing.assert_allclose(found.correlation, measure(many[:300], 5.0, np.full(2, 1.0)).correlation, atol=0.02)
    assert not measure([few], 60.0, np.full(2, 1.0)).std.any()


def segment_of(times, positions):
    nothing = np.zeros((len(times), 1))
    return Segment(times, positions, nothing, np.zeros(1), 0)


def test_noise_that_is_stated_counts_where_filtered_positions_show_less_of_it(tmp_path):
    """A drive's low-pass of 20 Hz takes the noise out of what is seen beside the motion, and leaves that in the motion's band."""
    robot, noise, low_pass = puma2(tmp_path), 2e-4, butter(2, 20.0, fs=200.0, output="sos")
    motion = [fourier_trajectory(robot, duration=16.0, rate=200.0, fundamental=0.5, seed=3)]
    truth, options = robot.nominal.ravel(), FitOptions("wrench", bandwidth=10.0)

    recorder = bayesid.Recorder(resolution=0.0, force_std=0.1, torque_std=0.01, position_std=noise)
    simulated = [bayesid.simulate(experiment(robot, [], Sensor()), motion, recorder=recorder, seed=seed) for seed in range(8)]

    def fitted(stated: float | None, filtered: bool, made):
        (recorded,) = made.motions
        if filtered:
            read = sosfiltfilt(low_pass, recorded.table.positions, axis=0)
            recorded = replace(recorded, table=replace(recorded.table, positions=read))
        known = replace(made, motions=(recorded,), position_std=stated, position_resolution=None)
        estimate = estimators.fit(prepare(known, options).regression, TotalLeastSquares(draws=8))
        return estimate, (estimate.values - estimate.base.matrix @ truth) / estimate.std

    runs = {
        case: [fitted(*case, made) for made in simulated] for case in ((None, False), (None, True), (noise, True), (noise, False))
    }
    std = {case: np.median([e.std for e, _ in found], axis=0) for case, found in runs.items()}
    encoder = {case: np.mean([e.details.encoder_std for e, _ in found]) for case, found in runs.items()}
    bias = {case: np.abs(np.mean([z for _, z in found], axis=0)).max() for case, found in runs.items()}
    assert encoder[None, True] < 0.2 * noise and encoder[noise, True] == pytest.approx(noise)
    assert encoder[None, False] == pytest.approx(noise, rel=0.03)
    np.testing.assert_allclose(std[noise, False], std[None, False], rtol=0.03)  # what is seen already changes nothing
    np.testing.assert_allclose(std[noise, True], std[None, False], rtol=0.15)
    assert bias[noise, True] < 0.6 * bias[None, True]
    held = np.abs([z for _, z in runs[noise, True]]) < 1.96
    assert held.mean() > 0.95
