"""Standard deviations expected before any reading, against Monte-Carlo, fits, and dense algebra."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid import estimators
from bayesid.design.expected import expect, expected_factors, rows_of
from bayesid.design.reading_noise import SENSOR_SETS, recorded_noise, white_noise
from bayesid.dynamics.regressors import Kernel
from bayesid.errors import InputError
from bayesid.recordings.experiment import Motion, Sensor
from bayesid.recordings.table import Table
from bayesid.regression.rows import make_blocks
from bayesid.signals.noise import NoiseModel
from tests.design.plant import readings, recorded
from tests.studies.coverage_case import ARMS
from tests.studies.expected import GIVEN, STD, monte_carlo, planned


@pytest.mark.parametrize("name, draws", [("puma", 24), ("ur5", 6)])
def test_what_is_expected_is_what_fits_of_pinocchios_readings_scatter_by(name, draws, tmp_path):
    errors, stated = monte_carlo(name, tmp_path, draws)
    count = errors.size / 3  # parameters go together, so there are fewer independent ones
    assert abs(np.sqrt(np.mean(errors**2)) - 1.0) < 4.0 / np.sqrt(2.0 * count)
    # What a fit says of itself is learned from residuals of a few hundred rows.
    np.testing.assert_allclose(np.median(stated, axis=0), 1.0, atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name, draws", [("puma", 1500), ("ur5", 800)])
def test_every_parameter_scatters_within_five_percent_of_what_is_expected(name, draws, tmp_path):
    errors, _ = monte_carlo(name, tmp_path, draws)
    chance = 3.0 / np.sqrt(2.0 * draws)  # of one parameter's scatter over so many draws
    assert np.abs(np.sqrt(np.mean(errors**2, axis=0)) - 1.0).max() < 0.05 + chance
    assert abs(np.sqrt(np.mean(errors**2)) - 1.0) < 0.02


def test_the_factor_is_that_of_every_sample(tmp_path):
    """Rows in the motion's band keep what all samples tell, but for the two ends; dense algebra says what that is."""
    bare, motion, _ = planned("ur5", tmp_path)
    given = {"fx": 0.3, "moment": 0.05, "torque": 2.0, "tau2": 5.0}
    for name in ("wrench", "wrench-offset", "both", "torque"):
        sensor_set = SENSOR_SETS[name]
        expected = expect(bare, sensor_set, white_noise(bare.robot, Sensor(force_std=0.7), given), [motion])
        model, _ = rows_of(bare, sensor_set, [motion])
        ends = model.margin
        inside = (motion.times >= ends) & (motion.times <= motion.times[-1] - ends)
        state = (motion.positions[inside], motion.velocities[inside], motion.accelerations[inside])
        x = Kernel.of(bare.robot, model.channels, expected.base.independent).dynamics(*state)
        wrench = [0.3, 0.7, 0.7, 0.05, 0.05, 0.05]
        torque = [2.0, 5.0, 2.0, 2.0, 2.0, 2.0]
        std = {"wrench": wrench, "torque": torque, "both": wrench + torque}[sensor_set.channel]
        if sensor_set.offset == "fitted":
            x = np.concatenate([x, np.broadcast_to(np.eye(6), (len(x), 6, 6))], axis=2)
        flat = (x / np.array(std)[:, None]).reshape(-1, x.shape[2])
        dense = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)))
        np.testing.assert_allclose(expected.std, dense, rtol=0.02)


def test_two_readings_where_a_static_run_is_subtracted(tmp_path):
    bare, motion, sensor_set = planned("puma", tmp_path)
    noise = white_noise(bare.robot, given=GIVEN)
    double = white_noise(bare.robot, given={"force": 0.5 * 2**0.5, "moment": 0.1 * 2**0.5})
    both, model = expect(bare, sensor_set, noise, [motion]), rows_of(bare, sensor_set, [motion])
    one, _ = expected_factors(lambda: make_blocks(*model), double.of(SENSOR_SETS["wrench"]))
    np.testing.assert_allclose(np.abs(both.factor), np.abs(one), rtol=1e-9, atol=1e-9 * np.abs(one).max())


def test_a_recordings_own_noise_gives_what_identify_states(tmp_path):
    """Coloured noise: the sandwich of `wls`, from the noise that it learned."""
    bare, motion, sensor_set = planned("puma", tmp_path)
    rng = np.random.default_rng(3)
    still = 0.0 * motion.velocities
    exact = readings(bare.robot, ARMS["puma"].locked, motion.positions, motion.velocities, motion.accelerations)[:, :6]
    rest = readings(bare.robot, ARMS["puma"].locked, motion.positions, still, still)[:, :6]
    coloured = STD * rng.normal(size=(2, *exact.shape))
    for k in range(1, len(exact)):
        coloured[:, k] += 0.95 * coloured[:, k - 1]
    made = recorded(bare, motion, exact + coloured[0], rest + coloured[1])
    noise, problems = recorded_noise(made, white_noise(bare.robot))
    assert noise.sources == {"wrench": "readings", "torque": "assumed"}
    estimate = estimators.fit(problems["wrench"].regression, "wls")
    bandwidth = problems["wrench"].row_model.bandwidth
    expected = expect(made, sensor_set, noise, made.motions, bandwidth=bandwidth)
    np.testing.assert_allclose(expected.std, estimate.full_std, rtol=1e-4)
    white = {g: NoiseModel.stated(m.std) for g, m in noise.of(sensor_set).items()}
    rows = rows_of(made, sensor_set, made.motions, bandwidth=bandwidth)
    plain, _ = expected_factors(lambda: make_blocks(*rows), white)
    assert np.median(expected.std / np.sqrt(np.diag(np.linalg.inv(plain.T @ plain)))) > 1.2  # colour matters here


def test_effects_in_the_model_count_and_poses_alone_have_their_own_structure(tmp_path):
    bare, motion, _ = planned("ur5", tmp_path)
    noise = white_noise(bare.robot)
    plain = expect(bare, SENSOR_SETS["torque"], noise, [motion])
    friction = expect(replace(bare, effects=("viscous_friction", "sensor_offset")), SENSOR_SETS["torque"], noise, [motion])
    assert friction.effect_names[0] == "viscous_friction@joint1.coefficient" and len(friction.effect_names) == 6
    assert np.all(friction.std[:36] >= plain.std) and np.max(friction.std[:36] / plain.std) > 1.02
    assert friction.base_factor.shape == (36, 36)
    inverse = np.linalg.inv(friction.base_factor)
    np.testing.assert_allclose(np.linalg.norm(inverse, axis=1), friction.std[:36], rtol=1e-8)
    table = Table(motion.times[::100], motion.positions[::100])
    poses = [Motion("poses", "identification", table, "poses")]
    assert expect(bare, SENSOR_SETS["wrench"], noise, poses).base.rank < 41
    nothing = expect(bare, SENSOR_SETS["wrench-static"], noise, poses)
    assert nothing.hidden.all() and np.isinf(nothing.std).all()


def test_noise_that_cannot_be_is_refused(tmp_path):
    robot = planned("ur5", tmp_path)[0].robot
    for given, said in [({"fz1": 0.1}, "noise 'fz1'"), ({"force": 0.0}, "noise force = 0.0"), ({"tau9": 1.0}, "noise 'tau9'")]:
        with pytest.raises(InputError, match=said):
            white_noise(robot, given=given)
    sheet = white_noise(robot, Sensor(force_std=0.3, torque_std=0.02))
    assert sheet.sources == {"wrench": "data sheet", "torque": "assumed"}
    np.testing.assert_allclose(sheet.wrench["trajectory"].std, [0.3] * 3 + [0.02] * 3)
    np.testing.assert_allclose(sheet.torque["poses"].std, [0.75] * 3 + [0.14] * 3)  # 0.5 % of the effort limits
    assert sheet.of(SENSOR_SETS["both"])["trajectory"].std.shape == (12,)


def test_noise_that_is_given_of_some_channels_stands_and_the_others_learn_it_from_the_readings(tmp_path):
    bare, motion, _ = planned("puma", tmp_path)
    exact = readings(bare.robot, ARMS["puma"].locked, motion.positions, motion.velocities, motion.accelerations)[:, :6]
    made = recorded(bare, motion, exact + STD * np.random.default_rng(3).normal(size=exact.shape))
    learned = recorded_noise(made, white_noise(bare.robot))[0].wrench["trajectory"]
    noise = recorded_noise(made, white_noise(bare.robot, given={"force": 5.0, "my": 2.0}))[0]
    assert noise.sources["wrench"] == "readings"
    own = noise.wrench["trajectory"]
    np.testing.assert_allclose(own.std, [5.0, 5.0, 5.0, learned.std[3], 2.0, learned.std[5]])
    np.testing.assert_allclose(own.innovation[3, [3, 5]], learned.innovation[3, [3, 5]])
    np.testing.assert_array_equal(own.innovation[0, 1:], np.zeros(5))
