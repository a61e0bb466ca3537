"""A tap or a contact does not move robust estimates, and their intervals know what was rejected."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.stats import chi2, multivariate_t, norm

import bayesid
from bayesid.errors import InputError
from bayesid.estimators import fit
from bayesid.estimators.robust.m_estimators import Huber, Student
from bayesid.estimators.robust.segments import HuberLoss, Metric, StudentLoss, accepted, residuals
from bayesid.regression.blocks import Block
from bayesid.regression.problem import prepare
from bayesid.regression.regression import Regression
from bayesid.robot.robot import load_robot
from bayesid.signals.filters import LowPass
from bayesid.signals.noise import NoiseModel
from tests.robots import ur5, write
from tests.simulated import Motion, Sensor, experiment, fourier, recording
from tests.studies import outliers
from tests.studies.coverage_case import record, setup

TRUTH = np.arange(1.0, 5.0)
LIMITS = [Huber(constant=1e9), Huber(constant=np.inf), Student(nu=1e13), Student(nu=np.inf)]
ROBUST = [Huber(), Student()]


def arrays(rng, samples=600, colour=0.0):
    """Two channels, 20 rows a second."""
    matrix = rng.normal(size=(samples, 2, 4)).cumsum(axis=0) / 10
    noise = lfilter([1.0], [1.0, -colour], rng.normal(size=(samples, 2)) * [1.0, 0.1], axis=0)
    return matrix, matrix @ TRUTH + noise, np.arange(samples) * 0.05


def touched(target):
    """A contact from 100 to 120 with a quiet middle, and two taps."""
    out = target.copy()
    out[100:120] += [40.0, -5.0]
    out[106:110] = target[106:110]
    out[300:302] += [-300.0, 20.0]
    out[450] += [0.0, 100.0]
    return out


@pytest.mark.parametrize("method", LIMITS, ids=lambda m: f"{m.name} {m}")
@pytest.mark.parametrize("touch", [False, True])
def test_far_limits_are_least_squares(method, touch):
    matrix, target, times = arrays(np.random.default_rng(0))
    regression = Regression.from_arrays(matrix, touched(target) if touch else target, times=times)
    reference, estimate = fit(regression, "wls"), fit(regression, method)
    np.testing.assert_allclose(estimate.values, reference.values, rtol=1e-8)
    np.testing.assert_allclose(estimate.covariance, reference.covariance, rtol=1e-8)
    assert estimate.details.rejected_windows == {} and estimate.details.rejected_share == 0


@pytest.mark.parametrize("method", LIMITS, ids=lambda m: f"{m.name} {m}")
def test_far_limits_of_a_robot_are_least_squares(method):
    clean = record(setup("ur5"), np.random.default_rng(1))
    for case in (clean, outliers.disturb(clean, np.random.default_rng(2))[0]):
        regression = prepare(case).regression
        reference, estimate = fit(regression, "wls"), fit(regression, method)
        assert np.abs((estimate.values - reference.values) / reference.std).max() < 1e-8
        np.testing.assert_allclose(estimate.std, reference.std, rtol=1e-8)


def test_known_filters_are_undone_first():
    """Behind a slow filter the limit is least squares on the rows in front of it, and taps are as short as there."""
    matrix, target, times = arrays(np.random.default_rng(3))
    target = touched(target)
    pole = 0.97
    slow = [lfilter([1 - pole], [1, -pole], x, axis=0) for x in (matrix, target)]
    filtered = Regression.from_arrays(*slow, times=times, low_pass=LowPass(l=-np.log(pole) / 0.05, d=1e5))
    direct = Regression.from_arrays(matrix, target, times=times)
    np.testing.assert_allclose(fit(filtered, Huber(constant=np.inf)).values, fit(direct, "wls").values, rtol=1e-8)
    one, other = fit(filtered, "huber"), fit(direct, "huber")
    np.testing.assert_allclose(one.values, other.values, rtol=1e-6)
    np.testing.assert_allclose(one.std, other.std, rtol=1e-6)
    assert one.details.rejected_windows == other.details.rejected_windows
    # The noise that is handed on is that of the filtered rows.
    model = one.noise["trajectory"]
    assert model.from_zero and model.order == other.noise["trajectory"].order + 2


@pytest.mark.parametrize("method", ["huber", "student"])
def test_filters_of_a_recording_in_chunks_are_undone_across_them(method):
    """Rows that can be read in parts anywhere are weighed without the filters, too."""
    matrix, target, times = arrays(np.random.default_rng(8))
    pole = 0.9
    slow = [lfilter([1.0 - pole], [1.0, -pole], x, axis=0) for x in (matrix, touched(target))]
    whole = Regression.from_arrays(*slow, times=times, low_pass=LowPass(l=-np.log(pole) / 0.05, d=1e5))
    [block] = whole.rows.blocks()
    halves = [replace(block, rows=block.rows[a:b], times=block.times[a:b], start=a == 0) for a, b in ((0, 300), (300, 600))]
    rows = replace(whole.rows, blocks=lambda: halves, parts=[lambda h=h: [h] for h in halves])
    parted = replace(whole, rows=rows)
    one, other = fit(whole, method), fit(parted, method)
    np.testing.assert_allclose(other.values, one.values, rtol=1e-8)
    np.testing.assert_allclose(other.std, one.std, rtol=1e-8)


@pytest.mark.parametrize("method", ROBUST, ids=lambda m: m.name)
def test_touches_are_rejected_as_windows_with_their_quiet_samples(method):
    matrix, target, times = arrays(np.random.default_rng(4))
    estimate = fit(Regression.from_arrays(matrix, touched(target), times=times), method)
    spans = estimate.details.rejected_windows["0"]
    assert len(spans) == 3
    for (a, b), (first, last) in zip(spans, [(100, 119), (300, 301), (450, 450)], strict=True):
        assert a <= times[first] and times[last] <= b and b - a <= times[last] - times[first] + 0.7
    assert 0.04 < estimate.details.rejected_share < 0.1
    assert (np.abs(estimate.values - TRUTH) < 4 * estimate.std).all()
    json.dumps(estimate.to_dict())
    clean = fit(Regression.from_arrays(matrix, target, times=times), method)
    assert np.sqrt(np.mean(((estimate.values - clean.values) / clean.std) ** 2)) < 1.0
    assert clean.details.rejected_share == 0
    # Rejected rows do not make the noise, either.
    np.testing.assert_allclose(estimate.noise["trajectory"].std, clean.noise["trajectory"].std, rtol=0.1)


@pytest.mark.parametrize("method", [Huber(), pytest.param(Student(), marks=pytest.mark.slow)], ids=lambda m: m.name)
def test_disturbed_recordings_of_robots(method):
    """Over a few recordings; the study has many."""
    for name in outliers.ARMS:
        case = setup(name)
        error: dict[str, list] = {"clean": [], "robust": [], "ols": []}
        for seed in range(2):
            rng = np.random.default_rng([50, seed])
            clean = record(case, rng)
            disturbed, times = outliers.disturb(clean, rng)
            one, two = prepare(clean), prepare(disturbed)
            truth = one.row_model.base.matrix @ case.truth
            unit = fit(one.regression, "wls").std
            robust = fit(two.regression, method)
            for key, estimate in (
                ("clean", fit(one.regression, method)),
                ("robust", robust),
                ("ols", fit(two.regression, "ols")),
            ):
                error[key].append((estimate.values - truth) / unit)
            spans = robust.details.rejected_windows["fourier"]
            inner = times[(times[:, 0] > 1.0) & (times[:, 1] < 19.0)].mean(axis=1)
            assert len(inner) and all(any(a - 0.05 <= t <= b + 0.05 for a, b in spans) for t in inner)
        rms = {key: np.sqrt(np.mean(np.square(e))) for key, e in error.items()}
        assert rms["robust"] < 1.5 * rms["clean"] and rms["ols"] > 5 * rms["clean"]


@pytest.mark.slow
@pytest.mark.parametrize("method", ROBUST, ids=lambda m: m.name)
@pytest.mark.parametrize("colour", [0.0, 0.7])
def test_intervals_cover_on_clean_and_touched_rows_with_colour(method, colour):
    rng = np.random.default_rng(5)
    inside = []
    for k in range(40):
        matrix, target, times = arrays(rng, colour=colour)
        estimate = fit(Regression.from_arrays(matrix, touched(target) if k % 2 else target, times=times), method)
        inside.append(np.abs(estimate.values - TRUTH) <= 1.96 * estimate.std)
    assert 0.89 <= np.mean(inside) <= 0.99


@pytest.mark.parametrize("method", [Huber(), pytest.param(Student(), marks=pytest.mark.slow)], ids=lambda m: m.name)
def test_heavy_tails_of_segments_are_weighed_down_and_intervals_cover(method):
    """Noise whose size changes from segment to segment, Student's t with 2 degrees of freedom: better than least squares.

    Standardised errors tell intervals that are too long, too; their root mean square has a standard error of 0.07.
    """
    rng = np.random.default_rng(6)
    standardised, error, plain = [], [], []
    for _ in range(30):
        matrix, target, times = arrays(rng, samples=400)
        size = np.repeat(np.sqrt(2.0 / rng.chisquare(2, size=100)), 4)
        target = matrix @ TRUTH + (target - matrix @ TRUTH) * size[:, None]
        regression = Regression.from_arrays(matrix, target, times=times)
        estimate = fit(regression, method)
        error.append(estimate.values - TRUTH)
        standardised.append(error[-1] / estimate.std)
        plain.append(fit(regression, "wls").values - TRUTH)
    assert 0.79 < np.sqrt(np.mean(np.square(standardised))) < 1.21
    assert np.sqrt(np.mean(np.square(error))) < 0.85 * np.sqrt(np.mean(np.square(plain)))


@pytest.mark.parametrize("method", ROBUST, ids=lambda m: m.name)
def test_motions_poses_and_columns_without_information(method, tmp_path):
    """A contact in one of two motions and a wrong pose among static ones; then a wrist that never moves."""
    robot, options = load_robot(write(tmp_path, ur5())), {"force_std": 0.1, "torque_std": 0.01}
    motions = [
        Motion(f"m{k}", "identification", recording(robot, Sensor(), fourier(robot, k), seed=k, **options)) for k in range(2)
    ]
    table = motions[1].table
    wrench = np.array(table.wrench)
    wrench[1000:1150] += [20.0, 5.0, 10.0, 1.0, 2.0, 3.0]
    motions[1] = replace(motions[1], table=replace(table, wrench=wrench))
    times, q, v, a = fourier(robot, 3)
    still = recording(robot, Sensor(), (times[::50], q[::50], v[::50], a[::50]), seed=9, static=True, **options)
    wrench = np.array(still.wrench)
    wrench[17] += [30.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    poses = Motion("poses", "identification", replace(still, wrench=wrench), kind="poses")
    problem = prepare(experiment(robot, [*motions, poses], Sensor()))
    estimate = fit(problem.regression, method)
    spans = estimate.details.rejected_windows
    assert set(spans) == {"m1", "poses"}
    assert spans["m1"][0][0] < 8.1 and spans["m1"][0][1] > 9.1 and len(spans["m1"]) == 1
    assert [still.times[17]] * 2 in [list(np.round(s, 4)) for s in spans["poses"]]
    assert set(estimate.noise) == {"trajectory", "poses"}
    truth = estimate.base.matrix @ robot.nominal.ravel()
    seen = np.isfinite(estimate.std)
    assert np.abs((estimate.values - truth)[seen] / estimate.std[seen]).max() < 4.5
    times, q, v, a = fourier(robot, 1)
    q[:, 3:], v[:, 3:], a[:, 3:] = 0.3, 0.0, 0.0
    table = recording(robot, Sensor(), (times, q, v, a), seed=1, **options)
    wrench = np.array(table.wrench)
    wrench[1000:1150] += [20.0, 5.0, 10.0, 1.0, 2.0, 3.0]
    frozen = Motion("frozen", "identification", replace(table, wrench=wrench))
    estimate = fit(prepare(experiment(robot, [frozen], Sensor())).regression, method)
    assert "prior" in estimate.classes
    seen = np.array([kind in ("alone", "combination") for kind in estimate.classes])
    truth = estimate.base.matrix @ robot.nominal.ravel()
    assert np.abs((estimate.values - truth)[seen] / estimate.std[seen]).max() < 4.5


def test_a_recording_that_is_mostly_touched_is_not_rejected():
    matrix, target, times = arrays(np.random.default_rng(7))
    target[:400] += 50.0 * np.sign(np.sin(np.arange(400) / 9.0))[:, None]
    estimate = fit(Regression.from_arrays(matrix, target, times=times), "huber")
    assert estimate.details.rejected_share <= 0.5


def test_wrong_constants_are_refused():
    regression = Regression.from_arrays(*arrays(np.random.default_rng(0))[:2])
    with pytest.raises(InputError, match="huber constant = 0"):
        fit(regression, Huber(constant=0.0))
    with pytest.raises(InputError, match="student nu = -1"):
        fit(regression, Student(nu=-1.0))


def test_huber_keeps_95_percent_with_the_classical_constant():
    assert HuberLoss(2 * norm.sf(1.345)).efficiency(1) == pytest.approx(0.95, abs=5e-4)
    rng = np.random.default_rng(8)
    for n, rare in ((6, 0.05), (24, 0.2)):
        loss = HuberLoss(rare)
        z = rng.normal(size=(200_000, n))
        q, free = np.sum(z**2, axis=1), np.full(200_000, float(n))
        w = loss.weights(q, free)
        slope, spread = np.mean(w + 2 * q * loss.slopes(q, free) / n), np.mean(w[:, None] ** 2 * z**2)
        assert loss.efficiency(n) == pytest.approx(slope**2 / spread, abs=3e-3)
        assert loss.variance(4.0 * q, free) == pytest.approx(4.0, rel=0.01)
    assert HuberLoss(0.0).efficiency(6) == 1.0


@pytest.mark.parametrize("loss", [HuberLoss(0.3), StudentLoss(3.0)])
def test_slopes_are_derivatives(loss):
    n = np.full(60, 5.0)
    q = np.linspace(0.5, 30.0, 60)
    q = q[np.abs(q - chi2.isf(0.3, 5)) > 1e-3]
    n = n[: len(q)]
    numeric = (loss.weights(q + 1e-6, n) - loss.weights(q - 1e-6, n)) / 2e-6
    np.testing.assert_allclose(loss.slopes(q, n), numeric, atol=1e-8)


def test_student_learns_what_maximises_the_likelihood():
    rng = np.random.default_rng(10)
    x = rng.normal(size=(300, 8)) * np.sqrt(4.0 / rng.chisquare(4, size=300))[:, None]
    q, n = np.sum(x**2, axis=1), np.full(300, 8.0)
    best = minimize_scalar(
        lambda t: -multivariate_t(df=np.exp(t), shape=np.eye(8)).logpdf(x).sum(), bounds=(-1.0, 5.0), method="bounded",
        options={"xatol": 1e-9},
    )  # fmt: skip
    learned = StudentLoss(1.0, True).fitted(q, n)
    assert learned.nu == pytest.approx(np.exp(best.x), rel=1e-4)
    best = minimize_scalar(
        lambda t: -multivariate_t(df=4.0, shape=np.exp(t) * np.eye(8)).logpdf(x).sum(), bounds=(-3.0, 3.0), method="bounded",
        options={"xatol": 1e-9},
    )  # fmt: skip
    assert StudentLoss(4.0).variance(q, n) == pytest.approx(np.exp(best.x), rel=1e-4)


def test_degrees_of_freedom_of_coloured_segments():
    """A quadratic form x'Ax of normal numbers has mean tr(A C) and variance 2 tr(A C A C)."""
    innovation = np.array([[1.0, 0.3], [0.3, 2.0]])
    model = NoiseModel(np.array([[1.0, -0.8], [1.0, 0.4]]), innovation)
    metric = Metric.of(model, 6)
    a = [0.8, -0.4]
    zero = np.array([[innovation[i, j] / (1 - a[i] * a[j]) for j in range(2)] for i in range(2)])
    for m in (1, 2, 6):
        full = np.zeros((2 * m, 2 * m))
        for s in range(m):
            for t in range(m):
                for i in range(2):
                    for j in range(2):
                        lag = s - t
                        full[2 * s + i, 2 * t + j] = zero[i, j] * (a[i] ** lag if lag >= 0 else a[j] ** -lag)
        form = np.kron(np.eye(m), np.linalg.inv(zero)) @ full
        assert metric.freedom()[m] == pytest.approx(np.trace(form) ** 2 / np.trace(form @ form), rel=1e-9)
    np.testing.assert_allclose(metric.covariance[0], zero, rtol=1e-12)


def test_windows_grow_over_unusual_neighbours_and_stop_at_gaps():
    rows = np.zeros((40, 1, 2))
    times = np.append(np.arange(20), 100 + np.arange(20)) * 0.05
    parts = [Block(rows[:20], times[:20], 0, True), Block(rows[20:], times[20:], 0, True)]
    left = residuals(parts, np.zeros(1))
    assert left.count == 10 and left.run[20] == 1
    n = np.full(10, 4.0)
    q = np.array([4.0, 4, 20, 90, 16, 30, 4, 4, 4, 4])  # segments 2 to 4 in the first run, 5 in the second
    good = accepted(left, q, n, q > 80)
    assert list(np.flatnonzero(~good)) == list(range(7, 20))  # one row of margin, none over the gap
    assert accepted(left, q, n, np.zeros(10, bool)).all()


@pytest.fixture(scope="module")
def study():
    return outliers.study()


@pytest.mark.slow
@pytest.mark.parametrize("name", outliers.ARMS)
def test_study_robust_errors_and_coverage(study, name):
    fits = study["arms"][name]["fits"]
    low, high = study["arms"][name]["band"]
    for method in outliers.ROBUST:
        assert fits[f"disturbed, {method}"]["error_over_clean"] < 1.5
        for key in (f"clean, {method}", f"disturbed, {method}"):
            assert low <= min(fits[key]["coverage"]) and max(fits[key]["coverage"]) <= high, key
    assert fits["disturbed, ols"]["error_over_clean"] > 5


@pytest.mark.slow
def test_the_page_shows_this_study(study):
    shown = json.loads((outliers.STUDIES / "outliers" / "results.json").read_text(encoding="utf-8"))
    for name, arm in study["arms"].items():
        for key, result in arm["fits"].items():
            assert shown["arms"][name]["fits"][key]["error"] == pytest.approx(result["error"], rel=0.05), key
            np.testing.assert_allclose(result["coverage"], shown["arms"][name]["fits"][key]["coverage"], atol=0.02)


def test_page_is_written(tmp_path):
    results = outliers.run("puma", 2, 1, processes=1)
    arms = {name: outliers.summarise(results) for name in outliers.ARMS}
    outliers.write({"seed": 1, "level": 0.95, "arms": arms}, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"README.md", "results.json"}


@pytest.mark.parametrize("method", ["huber", "student"])
def test_a_stated_noise_sets_the_intervals(method):
    """As in every other estimator; the residuals, a third as large, set them."""
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(1000, 2, 3))
    target = matrix @ np.ones(3) + 0.1 * rng.normal(size=(1000, 2))
    regression = Regression.from_arrays(matrix, target, noise_std=[0.3, 0.3])
    with pytest.warns(bayesid.BayesidWarning, match="times the stated noise_std, so intervals are too long"):
        robust, plain = fit(regression, method), fit(regression, "wls")
    np.testing.assert_allclose(robust.std, plain.std, rtol=0.03)
