from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesid.errors import InputError
from bayesid.estimators import LeastSquares, Physical, Ridge, TruncatedSVD, fit
from bayesid.estimators.weights import learn_weights
from bayesid.regression.blocks import Block
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.regression import Regression
from bayesid.regression.row_cache import RowCache
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from tests.robots import panda, ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording

NAMES = ["fx", "mx"]


def make(rng, samples=400, p=4, colour=None, scales=(1.0, 0.1)):
    """Rows with known parameters; ``colour`` filters both sides from the zero state."""
    matrix = rng.normal(size=(samples, 2, p)).cumsum(axis=0) / 10
    noise = rng.normal(size=(samples, 2)) * scales
    target = matrix @ np.arange(1.0, p + 1) + noise
    if colour is not None:
        matrix, target = lfilter([1 - colour], [1, -colour], matrix, axis=0), lfilter([1 - colour], [1, -colour], target, axis=0)
    return matrix, target


def dense_weights(matrix, target, covariance):
    """Textbook generalised least squares on flattened rows."""
    x, y = matrix.reshape(-1, matrix.shape[2]), target.ravel()
    inverse = np.linalg.inv(covariance)
    normal = x.T @ inverse @ x
    return np.linalg.solve(normal, x.T @ inverse @ y), np.linalg.inv(normal)


def test_ols_is_least_squares_with_the_sandwich():
    matrix, target = make(np.random.default_rng(0))
    estimate = fit(Regression.from_arrays(matrix, target), "ols")
    x = matrix.reshape(-1, 4)
    np.testing.assert_allclose(estimate.values, np.linalg.lstsq(x, target.ravel(), rcond=None)[0], rtol=1e-9)
    noise = estimate.noise["trajectory"]
    assert noise.order == 0
    sigma = np.kron(np.eye(len(target)), noise.innovation)
    bread = np.linalg.inv(x.T @ x)
    middle = estimate.details.dispersion * x.T @ sigma @ x
    np.testing.assert_allclose(estimate.covariance, bread @ middle @ bread, rtol=1e-6)


def test_gls_is_generalised_least_squares():
    """Values of the textbook with the noise that was found, its covariance where the noise is stated."""
    matrix, target = make(np.random.default_rng(1))
    estimate = fit(Regression.from_arrays(matrix, target), "gls")
    sigma = np.kron(np.eye(len(target)), estimate.noise["trajectory"].innovation)
    np.testing.assert_allclose(estimate.values, dense_weights(matrix, target, sigma)[0], rtol=1e-8)
    std = estimate.noise["trajectory"].std
    stated = fit(Regression.from_arrays(matrix, target, noise_std=std), "gls")
    values, covariance = dense_weights(matrix, target, np.kron(np.eye(len(target)), np.diag(std**2)))
    np.testing.assert_allclose(stated.values, values, rtol=1e-8)
    np.testing.assert_allclose(stated.covariance, covariance, rtol=1e-8)


def test_weak_regularisation_and_full_rank_are_least_squares():
    matrix, target = make(np.random.default_rng(2))
    regression = Regression.from_arrays(matrix, target)
    for weights, method in (("none", "ols"), ("channel", "wls"), ("noise", "gls")):
        reference = fit(regression, LeastSquares(method, weights)).values
        np.testing.assert_allclose(fit(regression, Ridge(strength=0.0, weights=weights)).values, reference, rtol=1e-8)
        np.testing.assert_allclose(fit(regression, Ridge(strength=1e-14, weights=weights)).values, reference, rtol=1e-8)
        np.testing.assert_allclose(fit(regression, TruncatedSVD(rank=4, weights=weights)).values, reference, rtol=1e-8)


def test_equal_white_noise_makes_all_methods_agree():
    matrix, target = make(np.random.default_rng(3), samples=4000, scales=(0.01, 0.01))
    regression = Regression.from_arrays(matrix, target)
    values = [fit(regression, m).values for m in ("ols", "wls", "gls", "ridge", "tsvd")]
    for v in values[1:]:
        np.testing.assert_allclose(v, values[0], rtol=1e-3)


@pytest.mark.parametrize("method", ["ridge", "tsvd"])
def test_biased_estimators_state_no_interval(method):
    matrix, target = make(np.random.default_rng(4))
    estimate = fit(Regression.from_arrays(matrix, target), method)
    assert estimate.interval == "none" and estimate.interval_reason and np.isnan(estimate.std).all()
    entry = estimate.to_dict()
    assert entry["covariance"] is None and len(entry["base_parameters"]) == len(estimate.values)
    assert all(b["std"] is None and b["low"] is None and b["high"] is None for b in entry["base_parameters"])


def test_regularisation_helps_where_least_squares_is_hopeless():
    rng = np.random.default_rng(5)
    errors = {m: [] for m in ("ols", "ridge", "tsvd")}
    for _ in range(20):
        matrix = rng.normal(size=(60, 2, 6))
        matrix[:, :, 5] = matrix[:, :, 4] + 1e-3 * rng.normal(size=(60, 2))
        truth = np.array([1.0, 1, 1, 1, 1, 1])
        target = matrix @ truth + 0.5 * rng.normal(size=(60, 2))
        for m in errors:
            errors[m].append(np.linalg.norm(fit(Regression.from_arrays(matrix, target), m).values - truth))
    assert np.median(errors["ridge"]) < 0.2 * np.median(errors["ols"])
    assert np.median(errors["tsvd"]) < 0.2 * np.median(errors["ols"])


@pytest.mark.parametrize("method", [pytest.param("ols", marks=pytest.mark.slow), "wls", "gls"])
def test_intervals_cover_with_a_known_filter_and_white_noise_ones_do_not(method):
    """Filtered noise is coloured: intervals must allow for it; textbook ones are several times too short."""
    rng = np.random.default_rng(6)
    times, inside, naive = np.arange(400) * 0.01, [], []
    pole = 0.98
    for _ in range(150):
        matrix, target = make(rng, colour=pole)
        low_pass = LowPass(l=-np.log(pole) / 0.01, d=1e5)
        estimate = fit(Regression.from_arrays(matrix, target, times=times, low_pass=low_pass), method)
        truth = np.arange(1.0, 5.0)
        inside.append(np.abs(estimate.values - truth) <= 1.96 * estimate.std)
        x, y = matrix.reshape(-1, 4), target.ravel()
        b = np.linalg.lstsq(x, y, rcond=None)[0]
        white = np.sqrt(np.sum((y - x @ b) ** 2) / (len(y) - 4) * np.diag(np.linalg.inv(x.T @ x)))
        naive.append(np.abs(b - truth) <= 1.96 * white)
    assert 0.92 <= np.mean(inside) <= 0.98
    assert np.mean(naive) < 0.7


def test_colour_is_found_where_no_filter_is_named():
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(100):
        matrix, target = make(rng, samples=1500, colour=0.7)
        estimate = fit(Regression.from_arrays(matrix, target), "wls")
        assert estimate.noise["trajectory"].order >= 1
        inside.append(np.abs(estimate.values - np.arange(1.0, 5.0)) <= 1.96 * estimate.std)
    assert 0.91 <= np.mean(inside) <= 0.98


@pytest.mark.slow
def test_a_complete_model_is_seldom_called_incomplete():
    """Also where the noise is coloured and there are few rows, so that the weights are rough."""
    rng = np.random.default_rng(8)
    for colour, samples in ((None, 400), (0.7, 200), (0.9, 400)):
        made = [make(rng, samples=samples, colour=colour) for _ in range(100)]
        assert sum(not fit(Regression.from_arrays(*rows), "wls").details.model_complete for rows in made) <= 2


def _repeated(rng, size):
    """Eight times the same motion, and an error of the model that repeats with it: all parts of the recording agree."""
    at = 2.0 * np.pi * np.arange(4000) / 500.0
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 4, 3))
    matrix = sum(np.cos((k + 1) * at[:, None, None] + phase[:, :, k]) / (k + 1) for k in range(3))
    error = np.stack([np.tanh(4.0 * np.sin(at + 0.3)), np.tanh(4.0 * np.sin(2.0 * at))], axis=1)
    return matrix, matrix @ np.array([1.0, -2.0, 0.5, 1.5]) + size * error + 0.1 * rng.normal(size=(4000, 2))


def test_an_error_that_repeats_with_the_motion_makes_a_model_incomplete():
    """Where weightings differ by standard deviations, all estimators and the posterior weight rows alike."""
    found = []
    for seed in range(12):
        regression = Regression.from_arrays(*_repeated(np.random.default_rng(seed), 0.5))
        wls, gls = fit(regression, "wls"), fit(regression, "gls")
        found.append(wls.details.model_complete)
        apart = np.max(np.abs(gls.solution - wls.solution) / wls.std)
        assert apart < (2.5 if found[-1] else 1e-9)
    assert sum(found) <= 4


def test_whether_a_model_is_complete_depends_neither_on_units_nor_on_what_no_row_tells_apart():
    matrix, target = make(np.random.default_rng(2), samples=1500, colour=0.7)
    agreement = learn_weights(Regression.from_arrays(matrix, target)).agreement
    assert 1e-3 < agreement < 0.999
    units = np.array([1.0, 1e4, 1e-4, 1.0])
    other = np.concatenate([matrix * units, np.zeros((1500, 2, 1))], axis=2)
    assert learn_weights(Regression.from_arrays(other, target)).agreement == pytest.approx(agreement, rel=1e-6)


def test_directions_without_information_stay_nominal_and_say_so(tmp_path):
    robot = load_robot(write(tmp_path, ur5()))
    sensor = Sensor()
    times, q, v, a = fourier(robot, 1)
    q[:, 3:], v[:, 3:], a[:, 3:] = 0.3, 0.0, 0.0  # the wrist never moves
    table = recording(robot, sensor, (times, q, v, a), force_std=0.1, torque_std=0.01, seed=1)
    estimate = fit(prepare(experiment(robot, [Motion("a", "identification", table)], sensor)).regression)
    kinds = estimate.classes
    assert "prior" in kinds and "alone" in kinds
    hidden = [k for k, kind in enumerate(kinds) if kind == "prior"]
    assert np.isnan(estimate.std[hidden]).all()
    seen = [k for k, kind in enumerate(kinds) if kind in ("alone", "combination")]
    truth = estimate.base.matrix @ robot.nominal.ravel()
    assert np.abs((estimate.values - truth)[seen] / estimate.std[seen]).max() < 4.5


def test_unknown_methods_and_options_are_refused():
    regression = Regression.from_arrays(*make(np.random.default_rng(0)))
    with pytest.raises(InputError, match="did you mean 'ridge'"):
        fit(regression, "rigde")
    with pytest.raises(InputError, match="at least 0"):
        fit(regression, Ridge(strength=-1.0))
    with pytest.raises(InputError, match="give a whole number, 0 to 4"):
        fit(regression, TruncatedSVD(rank=9))
    with pytest.raises(InputError, match="rank = 2.5: give a whole number"):
        fit(regression, TruncatedSVD(rank=2.5))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="choose one of"):
        fit(regression, LeastSquares("x", "wrong"))


def test_estimates_print_as_text_html_and_json():
    estimate = fit(Regression.from_arrays(*make(np.random.default_rng(0))))
    assert "p1" in str(estimate) and "<table>" in estimate._repr_html_()
    assert estimate.to_dict()["base_parameters"][0]["name"] == "p1"


@pytest.mark.parametrize("method", ["ols", "wls", "gls", "huber", "student", pytest.param("tls", marks=pytest.mark.slow), "sdp"])
def test_columns_that_cannot_be_told_apart_make_no_other_surer(method, tmp_path):
    """A rotor at the first joint has the column of a base parameter: the others are known as without it, not better."""
    robot = load_robot(write(tmp_path, panda()))
    table = recording(robot, None, fourier(robot, 3, 30.0, 125.0), torque_std=0.1)
    made = experiment(robot, [Motion("a", "identification", table)])
    options = [FitOptions("torque", effects=effects, bandwidth=8.0) for effects in ((), ("rotor_inertia@joint1",))]
    plain, both = (fit(prepare(made, each).regression, method) for each in options)
    hidden = both.undetermined[: both.base.rank]
    assert 0 < hidden.sum() < 6 and both.undetermined[-1] and not plain.undetermined.any()
    if method != "sdp":  # its values are pulled to the nominal ones
        np.testing.assert_allclose(both.values[~hidden], plain.values[~hidden], atol=float(0.05 * plain.std.max()))
        np.testing.assert_allclose(both.std[~hidden], plain.std[~hidden], rtol=0.05)
    assert np.all(both.std[~hidden] > 0.9 * plain.std[~hidden]) and np.isnan(both.std[hidden]).all()


@pytest.mark.parametrize("method", ["wls", "gls", "huber", "student", "tsvd"])
def test_as_many_readings_as_parameters_leave_no_interval(method):
    """No residual tells the noise: standard deviations were those of rounding, 1e-15."""
    matrix, target = make(np.random.default_rng(0), samples=2)
    estimate = fit(Regression.from_arrays(matrix, target), method)
    assert estimate.interval == "none" and estimate.interval_reason
    assert np.isnan(estimate.std).all() and np.isnan(estimate.low).all()
    with pytest.raises(InputError, match=f"{method} has no covariance: "):
        estimate.stated_covariance()
    if method != "tsvd":
        np.testing.assert_allclose(estimate.values, np.linalg.solve(matrix.reshape(4, 4), target.ravel()), rtol=1e-6)
        assert fit(Regression.from_arrays(matrix, target, noise_std=[1.0, 0.1]), "wls").interval == "confidence"


FEW = [
    ("poses", 3, "gls"),
    ("poses", 8, "gls"),
    ("poses", 3, "wls"),
    ("poses", 5, "wls"),
    ("poses", 5, "huber"),
    ("trajectory", 20, "gls"),
]


@pytest.mark.parametrize(("group", "rows", "method"), FEW)
def test_of_few_rows_no_more_is_known_than_there_is_to_know(group, rows, method):
    """Chance correlates six channels of few rows, so that a combination seems noiseless, and makes some seem quiet."""
    rng, errors = np.random.default_rng(1), []
    for _ in range(40):
        numbers = rng.normal(size=(rows, 6, 5))
        numbers[:, :, -1] += numbers[:, :, :-1] @ np.arange(1.0, 5.0)
        block = Block(numbers, np.arange(float(rows)), 0, True, group)
        plain = Regression.from_arrays(numbers[:, :, :-1], numbers[:, :, -1])
        estimate = fit(replace(plain, rows=RowCache(partial(iter, (block,)), rows, 30)), method)
        errors.append((estimate.values - np.arange(1.0, 5.0)) / estimate.std)
    assert np.mean(np.abs(errors) < 1.96) > 0.9


def test_regularised_estimators_leave_what_no_row_shows_nominal(tmp_path):
    """At full rank, and without a penalty, they are least squares there, too: base parameters of 1e14 and of nan were given."""
    robot = puma2(tmp_path)
    times, *motion = fourier(robot, 1, duration=6.0, rate=60.0)
    parked = (times, *(x * [0.0, 1.0] for x in motion))  # the first joint stands still
    table = recording(robot, None, parked, torque_std=0.05)
    motions = [Motion("identification", "identification", table)]
    arm = experiment(robot, motions, effects=("viscous_friction",), inertia_rel_std=0.1)
    rows = prepare(arm, FitOptions(channel="torque")).regression
    plain = fit(rows, "ols")
    assert plain.undetermined.any()
    for method in (Ridge(strength=0.0), TruncatedSVD(rank=rows.base.rank)):
        np.testing.assert_allclose(fit(rows, method).solution, plain.solution, rtol=1e-5, atol=1e-7)
    assert "as ols is" in fit(rows, TruncatedSVD(rank=rows.base.rank)).interval_reason
    # Friction of the joint that stands still is what no prior knows, either.
    entropic = fit(rows, Physical(metric="entropic"))
    assert entropic.solution[rows.column_names.index("viscous_friction@joint1.coefficient")] == pytest.approx(0.0, abs=1e-9)
    assert entropic.details.certificate.certified
