"""Two numbers of a held-out motion: the relative error, and the residual over noise that no model can claim for itself."""

import dataclasses

import numpy as np
import pytest

import bayesid
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from bayesid.validation.headline import judged, over_noise
from bayesid.validation.noise_floor import noise_floor
from tests.robots import ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, recording

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
    assert judged(result.validation[0]).mood == "good" and "the sensor's noise" in over_noise(result.validation[0])


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
    told = judged(bayesid.identify(wrong).validation[0])
    proven = bayesid.identify(wrong)
    assert proven.validation[0].whitened_rms > 3.0 and told.mood != "good"
    assert any("is predicted with an error of" in w for w in proven.warnings)


def test_readings_that_were_filtered_tell_no_floor(arm):
    from scipy.signal import butter, sosfilt

    def filtered(table):
        return dataclasses.replace(table, wrench=sosfilt(butter(2, 10.0, fs=125.0, output="sos"), table.wrench, axis=0))

    motions = tuple(dataclasses.replace(m, table=filtered(m.table)) for m in arm.motions)
    blind = dataclasses.replace(arm, motions=motions)
    assert noise_floor(prepare(blind, FitOptions())) is None
    prediction = bayesid.identify(blind).validation[0]
    assert prediction.noise_source == "residuals" and judged(prediction).mood != "good"
    assert "not known" in over_noise(prediction) and "not known" in judged(prediction).text


def test_noise_alone_proves_little():
    """A residual at the noise on a motion that holds nothing else is no praise."""
    one = np.ones(2)
    from bayesid.validation.prediction import Prediction

    quiet = Prediction(
        "still", "validation", ("fx", "fy"), ("N", "N"), np.arange(2.0), np.zeros((2, 2)), np.zeros((2, 2)), one, one, one, one,
        1.0, one, 0.95, 1.0, "readings",
    )  # fmt: skip
    assert judged(quiet).mood == "fair" and "prove little" in judged(quiet).text
    good = dataclasses.replace(quiet, nrmse=0.02 * one, nrmse_raw=0.02 * one)
    assert judged(good).mood == "good"
    assert judged(dataclasses.replace(good, whitened_rms=4.0)).mood == "fair"
    poor = judged(dataclasses.replace(quiet, nrmse=np.array([0.1, 0.89]), whitened_rms=4.0))
    assert poor.mood == "bad" and "fy is wrong by 89 %" in poor.text
