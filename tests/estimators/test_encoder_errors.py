"""Encoder errors in the covariance of efficient fits, against repeated recordings and plain formulas."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, t

from bayesid import Recorder, fourier_trajectory, load_robot, simulate
from bayesid.estimators import fit
from bayesid.estimators.covariance import may_matter, sandwich_middle, with_encoder_errors
from bayesid.estimators.least_squares import weighted_factor
from bayesid.estimators.weights import learn_weights
from bayesid.posterior.likelihood import Likelihood
from bayesid.regression.encoder_noise import _errors
from bayesid.regression.problem import prepare
from bayesid.regression.regression import Regression
from bayesid.signals.noise import student_factor
from bayesid.simulation.trajectories import Trajectory
from tests.robots import wrist_sensor_arm, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

TRUTH = np.array([1.0, -2.0, 0.5])
SAMPLES, DRAWS = 200, 40


#: Residuals hold the regressor's errors, too, and so exceed noise that is stated without them.
exceeds = pytest.mark.filterwarnings("ignore:[a-z]+. residuals are:bayesid.errors.BayesidWarning")


@pytest.fixture(scope="module")
def motion():
    """A regressor (samples, channels, p), and errors that come and go with it."""
    rng = np.random.default_rng(0)
    exact = rng.normal(size=(SAMPLES, 2, 3)).cumsum(axis=0) / 10
    bursts = (np.sin(np.arange(SAMPLES) / 20) > 0.7) * 0.05

    def errors(rng, count):
        # One error of the motion a sample, which all columns share.
        return bursts[None, :, None, None] * rng.normal(size=(count, SAMPLES, 1, 1)) * exact

    return exact, errors


def corrected(regression, kind):
    """The covariance of the equations, rows weighted or whitened; None where encoder errors do not matter."""
    weights = learn_weights(regression)
    factor, scale = weighted_factor(regression, weights, kind)
    middle = factor.matrix.T @ factor.matrix if scale is None else sandwich_middle(regression, weights.noise, scale)
    return with_encoder_errors(regression, weights, scale, np.linalg.pinv(factor.matrix), middle)


@exceeds
def test_the_covariance_is_that_of_repeated_recordings(motion):
    """Regressors with fresh errors, readings with fresh noise of known size: the scatter of estimates is the judge."""
    exact, errors = motion
    rng = np.random.default_rng(1)
    std, estimates, stated, ignored = np.array([0.05, 0.1]), [], [], []
    for _ in range(160):
        matrix = exact + errors(rng, 1)[0]
        target = exact @ TRUTH + std * rng.normal(size=(SAMPLES, 2))
        plain = Regression.from_arrays(matrix, target, noise_std=std)
        known = Regression.from_arrays(matrix, target, noise_std=std, regressor_noise=errors(rng, DRAWS))
        estimate = fit(known, "gls")
        estimates.append(estimate.values)
        stated.append(estimate.covariance)
        ignored.append(fit(plain, "gls").covariance)
    scatter = np.cov(np.array(estimates).T)
    # A variance of 160 estimates is known to 11 %; Student's factor of 40 draws widens the errors' part by 7 %.
    ratio = np.diag(np.mean(stated, axis=0)) / np.diag(scatter)
    assert np.all((ratio > 0.7) & (ratio < 1.5)), ratio
    assert np.all(np.diag(np.mean(ignored, axis=0)) < 0.6 * np.diag(scatter)), "the errors matter here"


@exceeds
def test_with_stated_noise_it_is_the_plain_formula(motion):
    exact, errors = motion
    rng = np.random.default_rng(2)
    std = np.array([0.05, 0.1])
    draws = errors(rng, DRAWS)
    matrix = exact + errors(rng, 1)[0]
    regression = Regression.from_arrays(
        matrix, exact @ TRUTH + std * rng.normal(size=(SAMPLES, 2)), noise_std=std, regressor_noise=draws
    )
    estimate = fit(regression, "gls")
    white = (matrix / std[:, None]).reshape(-1, 3)
    bread = np.linalg.inv(white.T @ white)
    read = [(d @ learn_weights(regression).solution / std).ravel() for d in draws]
    scatter = (t.ppf(0.975, DRAWS - 1) / norm.ppf(0.975)) ** 2 * np.cov(np.array([white.T @ r for r in read]).T)
    mean = np.mean([(d / std[:, None]).reshape(-1, 3).T @ r for d, r in zip(draws[:4], read[:4], strict=True)], axis=0)
    added = bread @ (scatter + np.outer(mean, mean)) @ bread
    np.testing.assert_allclose(estimate.covariance - bread, added, rtol=1e-6)


@exceeds
@pytest.mark.parametrize(
    "method", [pytest.param("ols", marks=pytest.mark.slow), "wls", pytest.param("gls", marks=pytest.mark.slow)]
)
def test_the_bias_of_attenuation_is_in_the_intervals(method):
    """Repeated recordings with errors of their own in every entry: estimates miss the truth by as much as they say."""
    rng = np.random.default_rng(5)
    exact, std, missed, stated = rng.normal(size=(5 * SAMPLES, 2, 3)), np.array([0.05, 0.1]), [], []
    for _ in range(100):
        own, *draws = 0.07 * rng.normal(size=(1 + DRAWS, *exact.shape))
        target = exact @ TRUTH + std * rng.normal(size=exact.shape[:2])
        estimate = fit(Regression.from_arrays(exact + own, target, noise_std=std, regressor_noise=np.array(draws)), method)
        missed.append(estimate.values - TRUTH)
        stated.append(estimate.covariance)
    missed, variance = np.array(missed), np.diag(np.mean(stated, axis=0))
    # A mean square of 100 errors is known to 14 %; Student's factor of 40 draws widens the errors' part by 7 %.
    ratio = variance / np.mean(missed**2, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 1.5)), ratio
    assert np.any(missed.mean(axis=0) ** 2 > 0.5 * variance), "the bias matters here"


def test_the_likelihood_has_the_same_covariance_and_the_same_maximum(motion):
    exact, errors = motion
    rng = np.random.default_rng(3)
    target = exact @ TRUTH + np.array([0.05, 0.1]) * rng.normal(size=(SAMPLES, 2))
    regression = Regression.from_arrays(exact + errors(rng, 1)[0], target, regressor_noise=errors(rng, DRAWS))
    weights = learn_weights(regression)
    assert weights.complete and corrected(regression, "noise") is not None
    likelihood = Likelihood.of(regression)
    gram = np.einsum("kij,kil->jl", likelihood.factors, likelihood.factors)
    estimate = fit(regression, "gls")
    np.testing.assert_allclose(np.linalg.inv(gram[:3, :3]), estimate.covariance, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.solve(gram[:3, :3], gram[:3, 3]), estimate.values, rtol=1e-6)


def test_counts_of_a_good_encoder_change_nothing(tmp_path):
    robot, sensor = puma2(tmp_path), Sensor(translation=np.array([0.0, 0.0, -0.1]))
    motion = fourier(robot, 3, duration=8.0)
    table = recording(robot, sensor, motion, seed=4, force_std=0.5, torque_std=0.05)
    table = type(table)(table.times, 1e-6 * np.round(motion[1] / 1e-6), wrench=table.wrench)
    arm = experiment(robot, [Motion("m", "identification", table)], sensor, position_resolution=1e-6)
    regression = prepare(arm).regression
    assert regression.regressor_noise is not None and regression.regressor_noise.present()
    assert corrected(regression, "noise") is None and corrected(regression, "channel") is None


def test_counts_of_a_slow_joint_are_not_taken_for_white_noise(tmp_path):
    """Drawn errors are those of rounding: within half a count, and the same from sample to sample where a joint hardly moves."""
    resolution = 1e-3
    positions = np.column_stack([np.linspace(0.0, 1e-2, 2000), 30.0 * np.linspace(0.0, 1.0, 2000) ** 1.37])
    error = _errors(positions, np.zeros(2), resolution, np.random.default_rng(0))
    assert np.abs(error).max() <= 0.5 * resolution + 1e-12
    np.testing.assert_allclose(error.std(axis=0), resolution / 12**0.5, rtol=0.05)
    slow, fast = (np.corrcoef(e[1:], e[:-1])[0, 1] for e in error.T)
    assert slow > 0.95 and fast < 0.3


def test_few_poses_are_as_unsure_beside_a_motion_whose_encoders_err_a_little(tmp_path):
    """Student's factor of their noise counts whether or not encoder errors are told apart from the sensor's noise."""
    robot = load_robot(write(tmp_path, wrist_sensor_arm()), sensor_joint="wrist_ft")
    arm = experiment(robot, [], Sensor("wrist_ft", np.array([0.0, 0.0, 0.02])), position_resolution=1e-5)
    q = np.random.default_rng(1).uniform(-2.5, 2.5, (6, robot.n))
    poses = Trajectory("poses", "identification", np.arange(6.0), q, 0.0 * q, 0.0 * q, kind="poses")
    path = [fourier_trajectory(robot, duration=1.5, seed=3), poses]
    recorder = Recorder(force_std=0.05, torque_std=0.003, resolution=1e-5)
    regression = prepare(simulate(arm, path, recorder=recorder, seed=1)).regression
    weights = learn_weights(regression)
    assert may_matter(regression, weights) and student_factor(weights.noise["poses"].degrees) > 1.1
    beside, without = (fit(r, "wls").std for r in (regression, replace(regression, regressor_noise=None)))
    np.testing.assert_allclose(beside, without, rtol=1e-3)
