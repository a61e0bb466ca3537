from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from bayesid.errors import InputError
from bayesid.estimators import fit
from bayesid.estimators.errors_in_variables import InstrumentalVariables, TotalLeastSquares
from bayesid.estimators.sensor_noise import sensor_noise
from bayesid.estimators.weights import learn_weights
from bayesid.recordings.experiment import load_experiment
from bayesid.regression.linalg import at_least
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.regression import Regression
from bayesid.signals.noise import NoiseModel
from bayesid.signals.smoothing import smooth
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording
from tests.studies import encoder_noise

SENSOR = Sensor(translation=np.array([0.0, 0.0, -0.1]))


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return puma2(tmp_path_factory.mktemp("puma"))


def tables(robot, *, std=0.0, commanded=False, period=None, duration=20.0, seed=1):
    """One recording of the two-joint PUMA with white encoder noise."""
    motion = fourier(robot, 3, duration=duration)
    table = recording(robot, SENSOR, motion, seed=seed, force_std=0.5, torque_std=0.05)
    noisy = motion[1] + std * np.random.default_rng(seed + 100).normal(size=motion[1].shape)
    table = type(table)(table.times, noisy, wrench=table.wrench, commanded=motion[1] if commanded else None)
    return experiment(robot, [Motion("m", "identification", table, period=period)], SENSOR, position_std=std or None)


def arrays(rng, samples=500, p=3, error=0.0, draws=0):
    """Rows with known parameters, and errors of the regressor of known law."""
    true = rng.normal(size=(samples, 2, p)).cumsum(axis=0) / 10
    target = true @ np.arange(1.0, p + 1) + rng.normal(size=(samples, 2)) * (1.0, 0.1)
    again = error * rng.normal(size=(samples, 2, p))
    simulated = error * rng.normal(size=(draws, samples, 2, p)) if draws else None
    return true, true + error * rng.normal(size=true.shape), true + again, target, simulated


def test_own_regressors_as_instruments_are_least_squares():
    true, _, _, target, _ = arrays(np.random.default_rng(0))
    plain = fit(Regression.from_arrays(true, target), "wls")
    own = fit(Regression.from_arrays(true, target, instruments=true), "iv")
    np.testing.assert_allclose(own.values, plain.values, rtol=1e-9)
    np.testing.assert_allclose(own.std, plain.std, rtol=0.02)
    assert own.details.durbin_wu_hausman.dof == 0
    assert own.details.durbin_wu_hausman.p == 1.0


@pytest.mark.parametrize("errors", ["array", "encoder"])
def test_tls_without_errors_is_least_squares(errors, robot):
    true, _, _, target, _ = arrays(np.random.default_rng(1))
    if errors == "array":
        regression = Regression.from_arrays(true, target, regressor_noise=np.zeros((3, *true.shape)))
    else:
        problem = prepare(tables(robot, duration=10.0), FitOptions(bandwidth=5.0))
        # Exact positions and a law without noise: what is measured of them is the smoother's own error.
        law = problem.regression.regressor_noise
        regression = replace(problem.regression, regressor_noise=replace(law, present=lambda: False))
    plain, corrected = fit(regression, "wls"), fit(regression, "tls")
    np.testing.assert_allclose(corrected.solution, plain.solution, rtol=1e-9, atol=1e-12)


def test_tls_of_noise_free_encoders_hardly_moves(robot):
    regression = prepare(tables(robot)).regression
    plain, corrected = fit(regression, "wls"), fit(regression, "tls")
    assert corrected.details.encoder_std[0] < 1e-5
    np.testing.assert_allclose(corrected.values, plain.values, atol=0.01 * plain.std.min())


def test_tls_solves_the_corrected_normal_equations():
    """Independent errors of known variance: ``(X'WX - N s^2 sum W) b = X'Wy``, in closed form."""
    rng = np.random.default_rng(2)
    true, noisy, _, target, simulated = arrays(rng, samples=2000, error=0.3, draws=60)
    regression = Regression.from_arrays(noisy, target, regressor_noise=simulated)
    plain, corrected = fit(regression, "wls"), fit(regression, "tls")
    weight = 1.0 / learn_weights(regression).noise["trajectory"].std ** 2
    gram = np.einsum("tcp,c,tcq->pq", noisy, weight, noisy)
    right = np.einsum("tcp,c,tc->p", noisy, weight, target)
    closed = np.linalg.solve(gram - 2000 * 0.09 * weight.sum() * np.eye(3), right)
    np.testing.assert_allclose(corrected.values, closed, rtol=2e-3)
    off = [np.abs((e.values - np.arange(1.0, 4.0)) / corrected.std).max() for e in (plain, corrected)]
    assert off[0] > 3.0 > off[1]


def test_iv_is_the_textbook_formula():
    true, noisy, other, target, _ = arrays(np.random.default_rng(3), error=0.3)
    regression = Regression.from_arrays(noisy, target, instruments=other)
    estimate = fit(regression, "iv")
    scale = 1.0 / learn_weights(regression).noise["trajectory"].std
    x, z = (a * scale[:, None] for a in (noisy, other))
    x, z = x.reshape(-1, 3), z.reshape(-1, 3)
    y = (target * scale).ravel()
    expected = np.linalg.solve(z.T @ x, z.T @ y)
    np.testing.assert_allclose(estimate.values, expected, rtol=1e-9)
    noise = estimate.noise["trajectory"]
    assert noise.order == 0  # so that the covariance of all rows is that of one sample, again and again
    wider = scale * np.sqrt(learn_weights(regression).factors)
    sigma = np.kron(np.eye(len(target)), noise.innovation * np.outer(wider, wider))
    a = np.linalg.inv(z.T @ x)
    np.testing.assert_allclose(estimate.covariance, a @ z.T @ sigma @ z @ a.T, rtol=1e-6)


@pytest.mark.parametrize("method", ["tls", "iv"])
def test_arrays_need_to_say_what_the_errors_are(method):
    true, _, _, target, _ = arrays(np.random.default_rng(4))
    with pytest.raises(InputError, match=f"'{method}' needs.*regressor_noise|'{method}' needs.*instruments"):
        fit(Regression.from_arrays(true, target), method)


@pytest.mark.parametrize(
    ("argument", "shape"), [("instruments", (500, 2, 4)), ("instruments", (500, 3)), ("regressor_noise", (500, 2, 3))]
)
def test_shapes_are_checked(argument, shape):
    true, _, _, target, _ = arrays(np.random.default_rng(5))
    with pytest.raises(InputError, match=f"{argument} has shape"):
        Regression.from_arrays(true, target, **{argument: np.zeros(shape)})


def test_values_of_instruments_are_checked():
    true, _, other, target, _ = arrays(np.random.default_rng(5))
    other[7, 1, 2] = np.nan
    with pytest.raises(InputError, match=r"instruments\[7, 1, 2\] is not finite"):
        Regression.from_arrays(true, target, instruments=other)


def test_the_hausman_test_has_its_size_and_its_power():
    """Errors of the regressor that do not enter the target: p is uniform. Errors that do: it is tiny."""
    rng = np.random.default_rng(6)
    p = []
    for _ in range(100):
        true, _, other, target, _ = arrays(rng, samples=200, error=0.2)
        p.append(fit(Regression.from_arrays(true, target, instruments=other), "iv").details.durbin_wu_hausman.p)
    assert kstest(p, "uniform").pvalue > 0.001
    true, noisy, other, target, _ = arrays(rng, samples=1000, error=0.5)
    test = fit(Regression.from_arrays(noisy, target, instruments=other), "iv").details.durbin_wu_hausman
    assert test.dof == 3
    assert test.p < 1e-6
    assert test.verdict.startswith("encoder noise matters")


def test_weak_instruments_are_called_so():
    rng = np.random.default_rng(7)
    true, _, other, target, _ = arrays(rng)
    other[:, :, 2] = rng.normal(size=other.shape[:2])
    details = fit(Regression.from_arrays(true, target, instruments=other), "iv").details
    assert details.weak_instruments
    assert "hardly follow the motion" in details.warnings[0]
    assert "p3" in details.warnings[0]


@pytest.mark.parametrize(
    ("options", "source"),
    [
        ({"commanded": True}, "commanded"),
        ({"period": 10.0}, "other periods"),
        ({"period": 15.0}, "even samples"),
        ({}, "even samples"),
    ],
)
def test_instruments_are_the_best_there_are(robot, options, source):
    estimate = fit(prepare(tables(robot, std=1e-3, **options), FitOptions(bandwidth=5.0)).regression, "iv")
    assert source in estimate.details.instruments[0]
    assert not estimate.details.weak_instruments


@pytest.mark.parametrize(
    ("method", "options"),
    [
        (TotalLeastSquares(draws=12), {}),
        (InstrumentalVariables(draws=12), {}),
        (InstrumentalVariables(draws=12), {"period": 10.0}),
        (InstrumentalVariables(draws=12), {"commanded": True}),
    ],
)
def test_the_bias_of_least_squares_goes(robot, method, options):
    """A bandwidth of 8 Hz lets most of the encoders' noise of 1e-3 rad through; four times 20 s are enough to see it."""
    truth, errors, stds = None, [], []
    for seed in range(4):
        problem = prepare(tables(robot, std=1e-3, seed=seed, **options), FitOptions(bandwidth=8.0))
        truth = problem.row_model.base.matrix @ robot.nominal.ravel()
        both = [fit(problem.regression, m) for m in ("wls", method)]
        errors.append([e.values - truth for e in both])
        stds.append([e.std for e in both])
    z = np.mean(errors, axis=0) / np.sqrt(np.mean(np.square(stds), axis=0) / 4)
    plain, corrected = np.linalg.norm(np.mean(errors, axis=0) / np.mean(stds, axis=0)[1], axis=1)
    assert np.mean(z[0] ** 2) > 2.5  # a bias that is beyond chance, with the scatter by encoder errors counted
    assert np.mean(z[1] ** 2) < 2.5
    assert corrected < 0.35 * plain


def test_encoder_noise_is_measured(robot):
    problem = prepare(tables(robot, std=1e-3))
    details = fit(problem.regression, "tls").details
    np.testing.assert_allclose(details.encoder_std, 1e-3, rtol=0.05)
    assert details.verdict.startswith("encoder noise does not matter")  # the automatic bandwidth removes it
    assert fit(problem.regression, "tls").values.tolist() == fit(problem.regression, "tls").values.tolist()


def test_where_there_is_only_noise_no_interval_is_given():
    rng = np.random.default_rng(8)
    true, _, _, target, _ = arrays(rng)
    true[:, :, 1] = 0.0
    error = 0.1 * rng.normal(size=(11, *true.shape))
    estimate = fit(Regression.from_arrays(true + error[0], target, regressor_noise=error[1:]), "tls")
    assert estimate.interval == "none"
    assert estimate.covariance is None
    assert "p2" in estimate.interval_reason


def test_splines_pass_the_smoother_unchanged():
    """Instruments are splines on the smoother's own knots: smoothing them again changes them far less than noise does.

    What is left comes from the smoother's whisper of ridge, near the ends; other knots would change them by tenths.
    """
    times = np.arange(0, 10, 0.008) + 3.3
    once = smooth(times, np.random.default_rng(9).normal(size=(len(times), 2)), 4.0)
    again = smooth(times, once[0], 4.0)
    inside = slice(25, -25)  # the margin that rows leave out at both ends
    for a, b in zip(once, again, strict=True):
        np.testing.assert_allclose(a[inside], b[inside], rtol=0.0, atol=1e-4 * np.abs(a).max())


def test_sensor_noise_is_told_from_encoder_noise():
    """White noise of two correlated channels under differenced noise ten times as large."""
    rng = np.random.default_rng(10)
    lower = np.array([[1.0, 0.0], [0.06, 0.08]])

    def encoder(count):
        return np.diff(rng.normal(size=(count + 2, 2)), n=2, axis=0) * (5.0, 0.5)

    estimates = []
    for _ in range(20):
        sensor = rng.normal(size=(800, 2)) @ lower.T
        model = sensor_noise([sensor + encoder(800)], [[encoder(800)] for _ in range(16)], [])
        assert isinstance(model, NoiseModel)
        # Power at low frequencies, where the motion is.
        estimates.append(np.diag(model.innovation) / np.sum(model.coefficients, axis=1) ** 2)
    np.testing.assert_allclose(np.mean(estimates, axis=0), np.diag(lower @ lower.T), rtol=0.2)


def test_draws_are_an_option(robot):
    regression = prepare(tables(robot, std=1e-3), FitOptions(bandwidth=5.0)).regression
    few = fit(regression, TotalLeastSquares(draws=10))
    assert few.details.draws == 10


@pytest.mark.slow
@pytest.mark.parametrize("case", ["puma, 5 Hz", "ur5, 5 Hz"])
def test_encoder_noise_study(case):
    """A part of the study: the bias goes and the intervals cover, whatever the instruments; those of `ols` reach over it."""
    result = encoder_noise.study(count=48, cases=(case,))["cases"][case]
    fits = result["fits"]
    assert fits["ols"]["bias"] > 6.0 * fits["ols"]["chance"]
    for name in ("tls", "iv, commanded trajectory"):
        # What chance alone would show is not counted as bias.
        assert max(fits[name]["bias"] ** 2 - fits[name]["chance"] ** 2, 0.0) ** 0.5 < 0.2 * fits["ols"]["bias"]
    for name in ("ols", "wls (default)", "tls", "iv, commanded trajectory", "iv, other period", "iv, even and odd samples"):
        assert result["band"][0] <= fits[name]["coverage"]["lowest"]
    assert fits["iv, commanded trajectory"]["encoder_noise_seen"] == 1.0


@pytest.mark.slow
def test_the_page_of_the_study_is_written(tmp_path):
    result = encoder_noise.study(count=2, processes=1, cases=("puma, automatic",))
    encoder_noise.write(result, tmp_path)
    assert {f.name for f in tmp_path.iterdir()} == {"README.md", "results.json"}
    assert "iv, commanded trajectory" in (tmp_path / "README.md").read_text(encoding="utf-8")


def test_where_both_give_the_same_numbers_intervals_are_no_narrower_than_those_of_wls(shared):
    """Real recordings: what the model lacks has the motion's colour, which a smooth curve of sensor noise does not follow."""
    problem = prepare(load_experiment(shared("data/tx40")))
    plain, instrumental = (fit(problem.regression, method) for method in ("wls", "iv"))
    assert np.abs((instrumental.solution - plain.solution) / plain.full_std)[~plain.undetermined].max() < 0.1
    assert (instrumental.full_std / plain.full_std)[~plain.undetermined].min() > 0.99


def test_the_larger_of_two_covariances_is_larger_in_every_direction():
    rng = np.random.default_rng(0)
    a, b = (x @ x.T for x in rng.normal(size=(2, 4, 4)))
    larger = at_least(a, b)
    assert np.linalg.eigvalsh(larger - a).min() > -1e-9 and np.linalg.eigvalsh(larger - b).min() > -1e-9
    np.testing.assert_allclose(at_least(b + a, a), b + a, rtol=1e-9)
    assert np.trace(larger) < np.trace(a) + np.trace(b)
