"""The choice of the bandwidth by predictions of parts left out."""

from dataclasses import replace

import numpy as np
import pytest

import bayesid
from bayesid import estimators
from bayesid.recordings.experiment import Sensor
from bayesid.regression.bandwidth import LOWEST, candidates, choose_bandwidth
from bayesid.regression.blocks import Block
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import chosen_again, prepare, relinearised, row_step
from bayesid.simulation.simulation import Recorder, simulate
from bayesid.simulation.trajectories import fourier_trajectory
from tests.simulated import experiment, puma2


def rows_at(bandwidth, spoilt_above=np.inf, blurred_below=0.0):
    """Rows of three slow columns at the rate of a bandwidth, whose regressor is wrong outside a range of bandwidths."""
    rng = np.random.default_rng(5)
    step = row_step(bandwidth)
    times = np.arange(0.0, 40.0, step)
    matrix = np.stack([np.sin(2 * np.pi * f * times + f) for f in (0.3, 0.7, 1.1)], axis=1)[:, None, :]
    size = np.sqrt(100.0 * step)  # a row has the noise of one sample: a signal is larger in fewer rows
    target = size * matrix @ np.array([1.0, 2.0, -1.0]) + 0.05 * rng.normal(size=(len(times), 1))
    wrong = 0.3 * (bandwidth > spoilt_above) + 0.3 * (bandwidth < blurred_below)
    matrix = size * (matrix + wrong * rng.normal(size=matrix.shape))
    return (Block(np.concatenate([matrix, target[:, :, None]], axis=2), times, 0, True),)


def test_candidates_fall_to_the_lowest():
    assert candidates(4.0) == pytest.approx([4.0])
    np.testing.assert_allclose(candidates(20.0), [20.0, 14.1421, 10.0, 7.0711, 5.0], rtol=1e-4)
    for highest in np.geomspace(LOWEST, 40.0, 23):  # the lowest is tried whatever the highest is
        tried = candidates(highest)
        assert tried[0] == pytest.approx(highest) and tried[-1] == pytest.approx(LOWEST)
        assert np.all(tried[:-1] / tried[1:] <= 2.0**0.5 + 1e-9)


def test_nothing_changes_where_lower_bandwidths_predict_no_better():
    choice = choose_bandwidth(rows_at, 18.0)
    assert choice is not None and choice.chosen == 0
    np.testing.assert_allclose(choice.error, 1.0, atol=0.15)  # the same noise in the same band, whatever the rate of rows


def test_bandwidths_that_spoil_predictions_are_left():
    choice = choose_bandwidth(lambda b: rows_at(b, spoilt_above=12.0), 20.0)
    assert choice is not None and choice.bandwidths[choice.chosen] < 12.0
    assert choice.error[choice.chosen] < 0.3
    higher = choose_bandwidth(lambda b: rows_at(b, blurred_below=12.0), 20.0)
    assert higher is not None and higher.bandwidths[higher.chosen] >= 14.0


def test_what_predicts_best_is_taken_where_the_positions_chose_the_end_of_their_range():
    for spoilt in ({"blurred_below": 8.0}, {"spoilt_above": 12.0}):
        choice = choose_bandwidth(lambda b, spoilt=spoilt: rows_at(b, **spoilt), 20.0, at_end=True)
        assert choice is not None and choice.error[choice.chosen] == choice.error.min()
        assert (8.0 if "blurred_below" in spoilt else 0.0) <= choice.bandwidths[choice.chosen]
        assert choice.bandwidths[choice.chosen] <= (12.0 if "spoilt_above" in spoilt else 20.0)


def test_nothing_is_chosen_of_a_slow_motion_or_a_short_one():
    assert choose_bandwidth(rows_at, LOWEST) is None
    assert choose_bandwidth(lambda b: tuple(Block(x.rows[:20], x.times[:20], 0, True) for x in rows_at(b)), 20.0) is None


def test_a_real_arm_at_the_end_of_the_grid_predicts_another_day_as_well_as_at_any_bandwidth(shared):
    """Positions with four decimals, resampled, have no white noise: their own cross-validation goes to 20 Hz."""
    effects = ["viscous_friction", "coulomb_friction", "torque_offset"]
    one, other = (bayesid.load_experiment(shared(f"data/ur10e/{name}")) for name in ("before", "feb06-20s-5h"))
    judge = prepare(other, FitOptions(effects=effects, bandwidth=8.0)).regression
    rows = np.concatenate([block.rows for block in judge.rows.blocks()])

    def error(bandwidth: float | None) -> float:
        problem = prepare(one, FitOptions(effects=effects, bandwidth=bandwidth))
        assert bandwidth is not None or problem.bandwidths is not None and problem.smoother.at_end
        left = rows @ np.append(-estimators.fit(problem.regression, "wls").solution, 1.0)
        return float(np.mean(np.sqrt(np.sum(left**2, axis=0) / np.sum(rows[:, :, -1] ** 2, axis=0))))

    assert error(None) < 1.01 * min(error(b) for b in (20.0, 14.14, 10.0, 7.07, 5.0))


def test_it_is_chosen_again_where_effects_are_known_as_if_their_values_had_been_stated(tmp_path):
    """What a late sensor leaves grows with frequency: at the start, without delay, a bandwidth that is too low seems best."""
    robot = puma2(tmp_path)
    setup = experiment(robot, [], Sensor(), position_resolution=1e-6)
    motions = [fourier_trajectory(robot, duration=20.0, fundamental=0.8, harmonics=10)]
    late = simulate(setup, motions, effects={"sensor_delay": {"delay": 0.06}}, recorder=Recorder(resolution=1e-6), seed=1)
    options = FitOptions("wrench", effects=["sensor_delay"])
    start, known = (prepare(replace(late, effect_values=v), options) for v in ({}, {"sensor_delay": {"delay": 0.06}}))
    again = chosen_again(relinearised(start, known.row_model.point))
    assert again.smoother.reason == known.smoother.reason and again.row_model.step == known.row_model.step
    np.testing.assert_array_equal(again.bandwidths.error, known.bandwidths.error)
    assert again.smoother.bandwidth > start.smoother.bandwidth
    given = prepare(late, replace(options, bandwidth=7.0))
    assert chosen_again(given) is given
