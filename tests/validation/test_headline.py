"""Two numbers of a held-out motion: the relative error, and the residual over noise that no model can claim for itself."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

import bayesid
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from bayesid.validation.agreement import Agreement
from bayesid.validation.noise_floor import noise_floor
from bayesid.validation.prediction import Prediction, _largest_over_mean, judged, over_noise, useless, worse_than_nothing
from bayesid.workflows.warnings import contradictions, repeated_motions, unpredicted
from tests.robots import ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

FORCE, TORQUE = 0.5, 0.1


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    robot = load_robot(write(tmp_path_factory.mktemp("arm"), ur5()))
    sensor = Sensor(translation=np.array([0.0, 0.0, -0.1]))
    options = {"force_std": FORCE, "torque_std": TORQUE, "resolution": 2e-5}
    motions = [
        Motion(role, role, recording(robot, sensor, fourier(robot, k + 1), seed=k, **options))
        for k, role in enumerate(("identification", "validation"))
    ]
    return experiment(robot, motions, sensor, inertia_rel_std=0.1, position_resolution=2e-5)


@pytest.mark.parametrize("low_pass", [None, LowPass(1.0, 50.0)])
def test_the_floor_is_the_sensors_noise(arm, low_pass):
    floor = noise_floor(prepare(arm, FitOptions(low_pass=low_pass)))
    assert floor is not None and floor.source == "readings"
    np.testing.assert_allclose(floor.sensor, [FORCE] * 3 + [TORQUE] * 3, rtol=0.08)
    result = bayesid.identify(arm, low_pass=low_pass)
    # The paper's filter leaves the parameters less sure, and its prediction with them.
    motion = result.validation[0]
    assert motion.whitened_rms == pytest.approx(motion.expected_rms, rel=0.1)
    assert motion.expected_rms < (1.15 if low_pass is None else 1.4)
    assert judged(result.validation[0]).mood == "good" and "the measurement noise" in over_noise(result.validation[0])


@pytest.mark.parametrize("effects", [("viscous_friction", "coulomb_friction", "torque_offset"), ()])
def test_the_floor_is_the_same_at_any_bandwidth(arm, effects):
    """Fits of two bandwidths are compared with one noise, whatever their effects."""
    floors = [noise_floor(prepare(arm, FitOptions("torque", effects=effects, bandwidth=b))) for b in (None, 15.0)]
    powers = [floor.power for floor in floors if floor is not None]
    np.testing.assert_array_equal(*powers)


def test_what_a_biased_estimator_leaves_need_not_be_missing_in_the_model(arm):
    """Ridge and truncated SVD have no covariance that would say what they leave by themselves."""
    (kept,), (drawn,) = (bayesid.identify(arm, method=method).validation for method in ("wls", "ridge"))
    assert not kept.biased and drawn.biased
    for prediction, said in (
        (kept, "noise: something is missing"),
        (drawn, "noise: the estimator is biased, or something is missing"),
    ):
        assert said in judged(dataclasses.replace(prediction, whitened_rms=2.0, expected_rms=1.0)).text


def test_a_model_that_lacks_something_cannot_call_it_noise(arm):
    """Half of the links' inertia is not in the model: the fit's own residuals hide it, the floor does not."""
    shift = np.random.default_rng(1).normal(size=6)
    tables = [
        dataclasses.replace(m.table, wrench=m.table.wrench + 20.0 * shift * np.sin(5.0 * m.table.positions[:, :1]))
        for m in arm.motions
    ]
    wrong = dataclasses.replace(
        arm, motions=tuple(dataclasses.replace(m, table=t) for m, t in zip(arm.motions, tables, strict=True))
    )
    proven = bayesid.identify(wrong)
    told = judged(proven.validation[0])
    assert proven.validation[0].whitened_rms > 3.0 and told.mood != "good"
    assert any("is predicted with an error of" in w for w in proven.warnings)


def filtered(arm, seconds: float):
    """The first seconds of all recordings, their readings filtered before they were recorded."""
    slow, motions = butter(2, 10.0, fs=125.0, output="sos"), []
    for m in arm.motions:
        wrench, count = sosfilt(slow, m.table.wrench, axis=0), int(125 * seconds)
        table = dataclasses.replace(
            m.table, times=m.table.times[:count], positions=m.table.positions[:count], wrench=wrench[:count],
            torques=m.table.torques[:count],
        )  # fmt: skip
        motions.append(dataclasses.replace(m, table=table))
    return dataclasses.replace(arm, motions=tuple(motions))


def test_filtered_readings_tell_the_noise_where_the_motion_repeats(arm):
    """White noise of power s^2 behind a Butterworth filter, |H|^2 = 1 / (1 + (f / f0)^4), below 10 Hz; a period of 10 s."""
    floor = noise_floor(prepare(filtered(arm, 20.0), FitOptions()))
    assert floor is not None and floor.source == "repeats"
    below = np.linspace(0.0, 10.0, 1000)
    share = np.sqrt(np.mean(1.0 / (1.0 + (below / 10.0) ** 4)))
    np.testing.assert_allclose(floor.sensor, share * np.array([FORCE] * 3 + [TORQUE] * 3), rtol=0.15)


def test_filtered_readings_of_a_motion_that_never_repeats_tell_no_floor(arm):
    blind = filtered(arm, 9.0)
    assert noise_floor(prepare(blind, FitOptions())) is None
    prediction = bayesid.identify(blind).validation[0]
    assert prediction.noise_source == "residuals" and judged(prediction).mood != "good"
    assert "not known" in over_noise(prediction) and "not known" in judged(prediction).text


def test_noise_alone_proves_little():
    """A residual at the noise on a motion that holds nothing else is no praise."""
    one = np.ones(2)
    quiet = Prediction(
        "still", "validation", ("fx", "fy"), ("N", "N"), np.arange(2.0), np.zeros((2, 2)), np.zeros((2, 2)), one, one, one, one,
        1.0, one, 0.95, 1.0, "readings",
    )  # fmt: skip
    assert judged(quiet).mood == "fair" and "prove little" in judged(quiet).text
    wild = judged(dataclasses.replace(quiet, nrmse=300.0 * one, nrmse_raw=300.0 * one, rmse=300.0 * one, whitened_rms=0.01))
    assert wild.mood == "fair" and "no prediction at all would be closer" in wild.text and "hold little else" not in wild.text
    good = dataclasses.replace(quiet, nrmse=0.02 * one, nrmse_raw=0.02 * one)
    assert judged(good).mood == "good"
    assert judged(dataclasses.replace(good, whitened_rms=4.0)).mood == "fair"
    poor = judged(dataclasses.replace(quiet, nrmse=np.array([0.1, 0.89]), whitened_rms=4.0))
    assert poor.mood == "bad" and "fy is wrong by 89 %" in poor.text


def test_errors_of_uncertain_parameters_are_not_called_the_sensors_noise():
    """A hundred times the noise, where the covariance of the parameters explains a thousand: joints move that hardly did."""
    for error, others, said in (
        (0.527, 0.3, "the fitted motions say little of what this one needs"),
        (1.4, 0.3, "errors that uncertain parameters make are as large"),
        (0.05, 0.6, "tau2 is wrong by 60 % of its signal"),
        (0.05, 1.3, "tau2 is predicted worse than by nothing at all"),
    ):
        one = _prediction(np.array([error, others]), 100.0, np.array([10.0, 0.1]), expected_rms=900.0, largest_rms=1900.0)
        told = judged(one)
        assert told.mood == "fair" and said in told.text
        (warning,) = unpredicted([one])
        assert warning.endswith("Fit a motion like it, too.") and "diagnose" not in warning
        for noise in ("is the measurement noise", "hold little else", "encoders' errors", "holds little but noise"):
            assert noise not in told.text
    held = judged(_prediction(np.array([0.02, 0.02]), 100.0, np.array([10.0, 0.1]), expected_rms=900.0, largest_rms=1900.0))
    assert held.mood == "good" and "what noise and uncertain parameters leave" in held.text


def _prediction(error: np.ndarray, white: float, signal: np.ndarray, **more) -> Prediction:
    """Of constant size by channel, in units of the signal's."""
    names, one = tuple(f"tau{k + 1}" for k in range(len(error))), np.ones((1, len(error)))
    return Prediction(
        motion="unseen", role="validation", channel_names=names, channel_units=("N m",) * len(names), times=np.zeros(1),
        measured=one, predicted=one, rmse=error * signal, rmse_raw=error * signal, nrmse=error, nrmse_raw=error,
        whitened_rms=white, whitened_rms_by_channel=np.full(len(error), white), coverage=0.95, noise_source="readings",
        **more,
    )  # fmt: skip


@pytest.mark.parametrize("white", [0.983, 4.0])
def test_no_verdict_is_good_beside_a_channel_that_is_predicted_in_antiphase(white):
    """An error of 119 % of the signal is more than a prediction of zero leaves, whatever counts as noise."""
    t = np.linspace(0.0, 10.0, 1000)
    measured, predicted = np.sin(t), -0.19 * np.sin(t)
    share = float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))
    assert share == pytest.approx(1.19) and worse_than_nothing(share) and not worse_than_nothing(1.004)
    found = judged(_prediction(np.array([0.02, share]), white, np.array([10.0, 0.1])))
    assert found.mood != "good" and "tau2" in found.text and "119 %" in found.text and "small" not in found.text
    assert judged(_prediction(np.array([0.02, 0.9]), 0.983, np.array([10.0, 0.1]))).mood == "good"


def test_a_model_is_useless_where_no_motion_is_predicted():
    """One motion that is predicted well is a use; readings that hold little but noise say nothing."""
    poor, close = (_prediction(np.array([e]), 40.0, np.ones(1)) for e in (0.45, 0.05))
    assert useless([poor, poor]) and not useless([poor, close]) and not useless([])
    assert not useless([_prediction(np.array([0.9]), 1.0, np.ones(1))])


def test_one_line_a_kind_of_warning():
    """Four motions that repeat fitted ones and are predicted poorly, and three that contradict others: three lines."""
    motions = [
        dataclasses.replace(_prediction(np.array([e]), 40.0, np.ones(1), repeats="m1"), motion=f"m{k}")
        for k, e in enumerate((0.45, 0.81, 0.5), 30)
    ]
    (said,) = unpredicted(motions)
    assert "3 of 3 motions" in said and "'m31'" in said and "45 to 81 %" in said
    (again,) = repeated_motions(motions)
    assert "'m30', 'm31', 'm32'" in again and "'m1'" in again
    pairs, worst = ((50, 2.67), (60, 2.47)), "m2 r2y: 5 against 2"
    apart = [Agreement(f"motion m{k}", "motions m1, m2", 36, rms, 1e-9, worst) for k, rms in pairs]
    across = Agreement("wrench", "torque", 36, 3.0, 1e-9, "m3: 5 against 2")
    (first, second) = contradictions([*apart, across, dataclasses.replace(across, probability=0.5)])
    assert first.startswith("Motion m50") and "worst of 2 motions" in first and "m50, m60" in first and "2.67" in first
    assert second.startswith("Wrench and torque contradict")
    # Friction of another day sets estimates apart, too, and a comparison with a reference allows for it.
    assert "what the model lacks" in first and "friction and gains" in first and "with reference" in first
    assert contradictions(apart[:1])[0].count("m50") == 1


def test_uncertain_parameters_are_not_something_that_is_missing(tmp_path):
    """Of a complete model that was fitted to 1.6 s, errors of few parameters, all at once, are far from their average."""
    robot = puma2(tmp_path)
    for seed in range(12):
        motions = [
            Motion(role, role, recording(robot, None, fourier(robot, k, duration=d), seed=7 * seed + k, torque_std=0.3))
            for k, role, d in ((1, "identification", 1.6), (2, "validation", 8.0))
        ]
        (found,) = bayesid.identify(experiment(robot, motions)).validation
        assert judged(found).mood == "good" and found.largest_rms > 1.1 * found.expected_rms
        if found.whitened_rms > 1.15:
            assert "uncertain parameters" in judged(found).text


def test_the_largest_residual_of_a_complete_model_is_that_of_its_draws():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * [1.0, 1.0, 1.0, 1.0, 0.1, 0.1]
    rows = rng.normal(size=(200, 6)) * [1.0, 0.5, 0.2, 0.1, 0.1, 0.1]
    power = np.mean((rng.normal(size=(20_000, 6)) @ root.T @ rows.T) ** 2, axis=1)
    found = _largest_over_mean(root @ root.T, rows.T @ rows)
    assert found == pytest.approx(np.quantile(power, 0.95) / power.mean(), rel=0.05) and found > 1.5
    assert _largest_over_mean(None, rows.T @ rows) == 1.0
