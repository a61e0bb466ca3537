from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from bayesid.errors import InputError
from bayesid.estimators import fit
from bayesid.regression import row_cache
from bayesid.regression import rows as rows_module
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.regression import Regression
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from bayesid.validation.noise_floor import noise_floor
from bayesid.validation.prediction import predict
from tests.robots import panda, prismatic_arm, tree, ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

SENSOR = Sensor(translation=np.array([0.02, -0.01, -0.1]), rpy=np.array([3.1, 0.1, 0.4]))


def noise_free(robot, sensor=SENSOR, **options):
    one, two = fourier(robot, 1), fourier(robot, 2, speed=1.2)
    return experiment(
        robot,
        [
            Motion("identification", "identification", recording(robot, sensor, one, **options)),
            Motion("validation", "validation", recording(robot, sensor, two, **options)),
        ],
        sensor,
    )


@pytest.mark.parametrize("l, d", [(1.0, 50.0), (5.0, 50.0), (20.0, 50.0), (50.0, 100.0)])
def test_noise_free_puma_predicts_another_motion(l, d, tmp_path):
    robot = puma2(tmp_path)
    problem = prepare(noise_free(robot), FitOptions(low_pass=LowPass(l, d)))
    estimate = fit(problem.regression, "ols")
    prediction = predict(problem, estimate, problem.experiment.validation[0], noise_floor(problem))
    assert prediction.nrmse.max() < 2e-4 and prediction.nrmse_raw.max() < 2e-4


#: Robots and channels; of a second and third robot the rows of both channels are the rows of each.
KINDS = [
    pytest.param(
        text(),
        channel,
        id=f"{channel}-{name}",
        marks=() if name == "ur5" or (channel == "both" and name != "panda") else pytest.mark.slow,
    )
    for name, text in {"ur5": ur5, "panda": panda, "prismatic": prismatic_arm, "tree": tree}.items()
    for channel in ("wrench", "torque", "both")
]


@pytest.mark.parametrize(("text", "channel"), KINDS)
@pytest.mark.parametrize("filters", [None, LowPass(2.0, 50.0)], ids=["direct", "filtered"])
def test_noise_free_rows_give_the_true_parameters(text, channel, filters, tmp_path):
    robot = load_robot(write(tmp_path, text))
    problem = prepare(noise_free(robot), FitOptions(channel, low_pass=filters))
    base = problem.row_model.base
    truth = base.matrix @ robot.nominal.ravel()
    estimate = fit(problem.regression, "ols")
    prediction = predict(problem, estimate, problem.experiment.validation[0], noise_floor(problem))
    assert prediction.nrmse_raw.max() < 2e-3
    size = problem.regression.nominal_scale
    assert np.abs((estimate.values - truth) / size).max() < 5e-3


def test_rows_do_not_depend_on_chunks(tmp_path, monkeypatch):
    robot = load_robot(write(tmp_path, ur5()))
    one = noise_free(robot)
    for filters in (None, LowPass(1.0, 50.0)):
        monkeypatch.setattr(rows_module, "_CHUNK", 1 << 20)
        whole = list(prepare(one, FitOptions(low_pass=filters)).regression.rows.blocks())
        monkeypatch.setattr(rows_module, "_CHUNK", 333)
        monkeypatch.setattr(rows_module, "_PANEL", 100)
        monkeypatch.setattr(rows_module, "_BLOCK_ROWS", 50)
        parts = list(prepare(one, FitOptions(low_pass=filters)).regression.rows.blocks())
        assert len(parts) > 5 and [b.start for b in parts] == [True] + [False] * (len(parts) - 1)
        np.testing.assert_allclose(np.concatenate([b.times for b in parts]), whole[0].times, rtol=1e-12)
        joined = np.concatenate([b.rows for b in parts])
        np.testing.assert_allclose(joined, whole[0].rows, atol=1e-6 * np.abs(joined).max())
        monkeypatch.undo()


def test_gaps_are_not_filtered_across(tmp_path):
    robot = load_robot(write(tmp_path, ur5()))
    motion = fourier(robot, 1)
    keep = (motion[0] < 8.0) | (motion[0] > 9.0)
    cut = tuple(part[keep] for part in motion)
    holed = experiment(robot, [Motion("a", "identification", recording(robot, SENSOR, cut))], SENSOR)
    for filters in (None, LowPass(1.0, 50.0)):
        problem = prepare(holed, FitOptions(low_pass=filters))
        blocks = list(problem.regression.rows.blocks())
        assert [b.start for b in blocks] == [True, True]
        truth = problem.row_model.base.matrix @ robot.nominal.ravel()
        np.testing.assert_allclose(fit(problem.regression, "ols").values, truth, atol=2e-3)


def test_static_run_removes_offset_and_gravity(tmp_path):
    robot = puma2(tmp_path)
    motion, offset = fourier(robot, 1), np.array([10.0, -20, 30, 1, 2, -3])
    moving = recording(robot, SENSOR, motion, offset=offset)
    still = recording(robot, SENSOR, motion, offset=offset, static=True)
    with_static = experiment(robot, [Motion("a", "identification", moving, static=still)], SENSOR)
    subtracted = prepare(with_static)
    assert subtracted.static == "motion" and not subtracted.row_model.effects and subtracted.row_model.base.rank == 12
    along = prepare(with_static, FitOptions(static="joint"))
    assert along.static == "joint" and [e.name for e in along.row_model.effects] == ["sensor_offset"]
    poses = recording(robot, SENSOR, tuple(x[::50] for x in motion), offset=offset, static=True)
    with_poses = prepare(replace(with_static, motions=(replace(with_static.motions[0], static=poses),)))
    assert with_poses.static == "joint" and any(s.poses for s in with_poses.segments["a"])
    assert prepare(with_static, FitOptions("both")).static == prepare(with_static, FitOptions("torque")).static == "none"
    for problem in (subtracted, along, with_poses):
        estimate = fit(problem.regression, "ols")
        np.testing.assert_allclose(estimate.values, problem.row_model.base.matrix @ robot.nominal.ravel(), atol=1e-3)


def test_arrays_of_ones_own(tmp_path):
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(300, 3, 5))
    matrix[:, :, 4] = matrix[:, :, 0] + 2 * matrix[:, :, 1]
    truth = np.array([1.0, -2, 3, 4, 0.5])
    target = matrix @ truth + 0.1 * rng.normal(size=(300, 3))
    regression = Regression.from_arrays(matrix, target, parameter_names=list("abcde"), channel_names=["x", "y", "z"])
    estimate = fit(regression, "ols")
    assert estimate.base.rank == 4 and estimate.base.names[0] == "a + e"
    flat = matrix.reshape(-1, 5)[:, :4]
    reference, *_ = np.linalg.lstsq(flat, target.ravel(), rcond=None)
    np.testing.assert_allclose(estimate.values, reference, rtol=1e-10)
    assert np.abs((estimate.values - estimate.base.matrix @ truth) / estimate.std).max() < 4


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(target=np.zeros((3, 2))), "give .samples, channels, parameters."),
        (dict(matrix=np.full((10, 2, 3), np.nan)), r"matrix\[0, 0, 0\] is not finite"),
        (
            dict(target=np.ma.masked_array(np.zeros((10, 2)), mask=np.arange(20).reshape(10, 2) == 7)),
            r"target\[3, 1\] is not finite",
        ),
        (dict(parameter_names=["a"]), "1 names for 3 columns"),
        (dict(parameter_names=["a", "b", "a"]), "parameter_names: 'a' is there twice"),
        (dict(bodies=[[0, 1]]), r"bodies\[0\] = \[0, 1\]: give ten columns"),
        (dict(matrix=np.ones((10, 2, 19)), bodies=[range(10), range(9, 19)]), "a column is there twice"),
        (dict(times=np.arange(3)), "one entry for each"),
        (dict(motions=np.zeros((10, 1))), "one entry for each"),
        (dict(motions=[*range(9), np.nan]), r"motions\[9\] is not finite"),
        (dict(low_pass=(1, 50), times=np.arange(10.0)), r"low_pass is a tuple; give bayesid.LowPass"),
        (dict(low_pass=LowPass(1, 50)), "without times"),
        (dict(times=[0, 1, 2, 3, 4, 0, 1, 2, 3, 4]), r"times\[5\] = 0 comes after 4 in the same recording; sort"),
        (dict(low_pass=LowPass(1, 50), times=np.repeat([0.0, 1.0], 5)), "times do not increase"),
        (dict(times=np.zeros(10)), "times are all 0, which is no order"),
        (dict(times=np.append(np.arange(9.0), np.nan)), r"times\[9\] is not finite"),
        (dict(matrix=np.ones((0, 2, 3)), target=np.ones((0, 2))), "is empty"),
        (dict(matrix=np.zeros((10, 2, 3))), "matrix is zero"),
    ],
)
def test_bad_arrays_are_refused(change, message):
    good = dict(matrix=np.ones((10, 2, 3)), target=np.zeros((10, 2)))
    good.update(change)
    with pytest.raises(InputError, match=message):
        Regression.from_arrays(**good)


def test_recordings_are_named_by_anything_and_each_has_a_clock_of_its_own():
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(40, 2, 3))
    target = matrix @ [1.0, 2.0, 3.0] + 0.1 * rng.normal(size=(40, 2))
    times, runs = np.tile(np.arange(20.0), 2), pd.Series(["first"] * 20 + ["second"] * 20)
    given = [
        Regression.from_arrays(matrix, target, times=times, motions=ids)
        for ids in (runs, runs.astype("category"), [0] * 20 + [1] * 20)
    ]
    assert given[0].motion_names == given[1].motion_names == ("first", "second")
    for regression in given:
        np.testing.assert_array_equal(fit(regression, "gls").values, fit(given[0], "gls").values)
    assert Regression.from_arrays(matrix, target, parameter_names=[1, 2, 3]).base.names == ("1", "2", "3")
    white = Regression.from_arrays(matrix, target, times=times, noise_std=[0.1, 0.1])  # whose order does not count
    assert len(fit(white, "wls").values) == 3


@pytest.mark.parametrize("filters", [None, LowPass(1.0, 50.0)])
def test_a_recording_too_long_to_keep_gives_the_same_estimate(filters, tmp_path, monkeypatch):
    robot = load_robot(write(tmp_path, ur5()))
    long = fourier(robot, 1, duration=300.0)
    noise = dict(force_std=0.5, torque_std=0.1, resolution=2e-5, seed=1)
    one = experiment(robot, [Motion("a", "identification", recording(robot, SENSOR, long, **noise))], SENSOR)
    kept = fit(prepare(one, FitOptions(low_pass=filters)).regression)
    monkeypatch.setattr(row_cache, "CACHE_BYTES", 0)
    streamed_problem = prepare(one, FitOptions(low_pass=filters))
    streamed = fit(streamed_problem.regression)
    assert not streamed_problem.regression.rows.fits_in_memory
    assert next(streamed_problem.regression.rows.blocks()) is not next(streamed_problem.regression.rows.blocks())
    # Both weigh the channels by a noise learned from parts, which differ a little in their ends.
    assert np.abs((streamed.values - kept.values) / kept.std).max() < 0.2
    np.testing.assert_allclose(streamed.std, kept.std, rtol=0.1)


@pytest.mark.parametrize("rate", [2_000.0, 20_000.0])
def test_fast_recordings_are_cut_into_pieces_that_are_long_enough(rate, tmp_path):
    robot = load_robot(write(tmp_path, ur5()))
    motion = fourier(robot, 3, 6.0, rate, 1.0)
    made = experiment(robot, [Motion("a", "identification", recording(robot, None, motion, torque_std=0.1, resolution=2e-5))])
    problem = prepare(made, FitOptions("torque"))
    estimate = fit(problem.regression)
    truth = problem.row_model.base.matrix @ robot.nominal.ravel()
    assert np.sqrt(np.mean(((estimate.values - truth) / estimate.std) ** 2)) < 2.0
