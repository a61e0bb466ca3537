"""Prior against data: the check beside a few lines of NumPy, its calibration, and that a conflict is the first thing said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2, kstest, multivariate_normal

import bayesid
from bayesid.estimators.conic.physical import against_prior
from bayesid.estimators.prior_check import CONFLICT
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from tests.simulated import Motion, experiment, fourier, puma2, recording

BODIES = np.array(
    [
        inertia.from_mass_com_inertia(4.7, np.array([0.05, -0.02, 0.1]), np.diag([0.05, 0.06, 0.03])),
        inertia.from_mass_com_inertia(1.2, np.array([0.0, 0.03, 0.2]), np.diag([0.01, 0.008, 0.004])),
    ]
)


def rows(truth: np.ndarray, rng: np.random.Generator, std: float = 0.3) -> tuple[Regression, np.ndarray]:
    """Sixty readings of two channels that show 14 combinations of two bodies' parameters, and their matrix."""
    matrix = rng.normal(size=(60, 2, 14)) @ rng.normal(size=(14, 20))
    target = matrix @ truth + std * rng.normal(size=(60, 2))
    bodies = [range(10), range(10, 20)]
    names = [f"link{k}.{p}" for k in (1, 2) for p in inertia.PARAMETERS]
    return Regression.from_arrays(matrix, target, parameter_names=names, bodies=bodies, noise_std=[std, std]), matrix / std


def drawn(prior: Prior, rng: np.random.Generator) -> np.ndarray:
    return rng.multivariate_normal(prior.mean, prior.covariance)


@pytest.mark.parametrize("off", [1.0, 0.5])
def test_the_distance_is_what_the_prior_adds_to_the_smallest_misfit(off):
    """min over phi of data's and prior's squares, less the data's alone: another way to d' (V + K C K')^-1 d."""
    rng, std = np.random.default_rng(3), 0.3
    prior = Prior.nominal(BODIES, 0.1)
    truth = drawn(prior, rng) * np.repeat([off, 1.0], 10)
    regression, matrix = rows(truth, rng, std)
    x = matrix.reshape(-1, 20)
    y = np.concatenate([b.target for b in regression.rows.blocks()]).ravel() / std
    root = np.linalg.cholesky(prior.precision).T
    both = np.linalg.lstsq(np.vstack([x, root]), np.concatenate([y, root @ prior.mean]), rcond=None)
    alone = y - x @ np.linalg.lstsq(x, y, rcond=1e-10)[0]
    expected = float(both[1][0] - alone @ alone)
    check = against_prior(regression, prior, 0.1)
    assert check is not None
    assert check.base_parameters == 14
    assert check.distance**2 == pytest.approx(expected, rel=1e-6)
    assert check.probability == pytest.approx(chi2.sf(expected, 14), rel=1e-4)
    assert check.conflict == (off < 1.0)


def test_one_mass_is_named_with_both_values():
    """A mass seen alone, off by many prior standard deviations, in the prior's and the data's own numbers."""
    rng, prior = np.random.default_rng(0), Prior.nominal(BODIES, 0.1)
    matrix = np.zeros((400, 1, 20))
    matrix[:, 0, 0], matrix[:, 0, 11] = rng.normal(size=(2, 400))
    truth = prior.mean.copy()
    truth[0] = 0.88
    target = matrix @ truth + 2.0 * rng.normal(size=(400, 1))
    names = [f"link{k}.{p}" for k in (1, 2) for p in inertia.PARAMETERS]
    regression = Regression.from_arrays(
        matrix, target, parameter_names=names, parameter_units=inertia.UNITS * 2, bodies=[range(10), range(10, 20)],
        noise_std=[2.0],
    )  # fmt: skip
    check = against_prior(regression, prior, 0.1)
    assert check is not None and check.conflict
    one = check.largest
    assert one.label == "mass of link1"
    assert (one.prior, one.prior_std) == pytest.approx((4.7, 0.47), rel=1e-6)
    fit = np.linalg.lstsq(matrix[:, 0, [0, 11]], target[:, 0], rcond=None)[0]
    cov = 4.0 * np.linalg.inv(matrix[:, 0, [0, 11]].T @ matrix[:, 0, [0, 11]])
    assert (one.data, one.data_std) == pytest.approx((fit[0], np.sqrt(cov[0, 0])), rel=1e-6)
    assert one.prior_sigmas == pytest.approx((4.7 - fit[0]) / 0.47, rel=1e-6)
    assert f"mass of link1 is 4.7 +- 0.47 kg by the prior and {fit[0]:.3g} +- 0.1 kg by the data" in check.text()


def test_probabilities_are_uniform_where_the_truth_is_from_the_prior():
    rng, prior = np.random.default_rng(1), Prior.nominal(BODIES, 0.15)
    found = []
    for _ in range(120):
        check = against_prior(rows(drawn(prior, rng), rng, std=0.5)[0], prior, 0.15)
        assert check is not None
        found.append(check.probability)
    assert kstest(found, "uniform").pvalue > 0.01
    assert min(found) > CONFLICT / 10


def puma(folder: Path, factor: float):
    """The paper's robot with a second link of another mass than the URDF states to 10 %."""
    robot = puma2(folder)
    phi = robot.nominal.copy()
    phi[1] *= factor
    tables = [recording(robot, None, fourier(robot, k), torque_std=0.1, seed=k, phi=phi.ravel()) for k in range(2)]
    motions = [Motion("a", "identification", tables[0]), Motion("b", "validation", tables[1])]
    return experiment(robot, motions, inertia_rel_std=0.1)


@pytest.mark.parametrize("method", ["wls", "sdp"])
def test_identify_says_a_conflict_first(tmp_path, method):
    result = bayesid.identify(puma(tmp_path, 0.3), method=method)
    assert result.prior_check is not None and result.prior_check.conflict
    said = result.prior_check.text()
    # Links of half the stated mass are of no use, which alone comes before it.
    useless, conflict = bayesid.summary(result).splitlines()[:2]
    assert "no usable result" in useless and conflict == f"warning: {said}"
    assert bayesid.summary(result).count("Prior and data contradict") == 1
    assert result.warnings[1] == said
    report = Path(result.write(tmp_path / "out")).read_text(encoding="utf-8")
    assert report.index("Prior and data contradict") < report.index('class="lead"')
    saved = json.loads((tmp_path / "out" / "estimate.json").read_text(encoding="utf-8"))
    assert saved["prior_against_data"]["conflict"] is True
    assert saved["prior_against_data"]["probability"] < CONFLICT
    assert list(saved).index("prior_against_data") < list(saved).index("base_parameters")


def test_a_conflict_has_one_size_whoever_tells_it(tmp_path):
    """One stated share is one standard deviation of the prior, in numbers that a few lines of NumPy give."""
    wrong = puma(tmp_path, 0.3)
    told = [bayesid.identify(wrong, method=m) for m in ("wls", "sdp")]
    told.append(bayesid.sample(wrong, draws=400, keep_going=True, sampler=bayesid.Sampler(longest=1)))
    checks = [result.prior_check for result in told]
    base, links = told[0].base, wrong.robot.nominal
    assert all(check is not None and check.conflict for check in checks)
    expected = np.sqrt(np.diag(base.matrix @ Prior.warped(links, 0.1).covariance @ base.matrix.T))
    for check in checks:
        at = int(np.argmin(np.abs(base.matrix @ links.ravel() - check.largest.prior)))
        assert check.largest.label == checks[0].largest.label
        assert check.largest.prior_std == pytest.approx(expected[at], rel=1e-6)
    # The data's side is that of the weights, so it differs a little between wls and the two others.
    assert checks[1].distance == pytest.approx(checks[2].distance, rel=1e-9)
    assert checks[0].distance == pytest.approx(checks[2].distance, rel=0.2)


@pytest.mark.parametrize("method", ["wls", "sdp", "ridge"])
def test_a_right_prior_raises_no_alarm(tmp_path, method):
    result = bayesid.identify(puma(tmp_path, 1.0), method=method)
    assert result.prior_check is not None and not result.prior_check.conflict
    assert "contradict" not in bayesid.summary(result)


def test_sample_says_a_conflict_first(tmp_path):
    options = dict(draws=400, keep_going=True, sampler=bayesid.Sampler(longest=1))
    wrong, right = (bayesid.sample(puma(tmp_path, factor), **options) for factor in (0.3, 1.0))
    assert wrong.prior_check is not None and right.prior_check is not None
    assert str(wrong).splitlines()[0] == f"warning: {wrong.prior_check.text()}"
    assert wrong.warnings[0] == wrong.prior_check.text()
    assert list(wrong.to_dict())[2] == "prior_against_data" and wrong.to_dict()["prior_against_data"]["conflict"] is True
    assert not right.prior_check.conflict and "contradict" not in str(right)


def test_a_prior_is_widened_by_what_makes_the_data_most_probable():
    """Against a scan of the normal density over the factor; links are drawn four times as far off as is stated."""
    rng, prior = np.random.default_rng(8), Prior.nominal(BODIES, 0.05)
    truth = prior.mean + 4.0 * (drawn(prior, rng) - prior.mean)
    regression, matrix = rows(truth, rng, std=0.05)
    check = against_prior(regression, prior, 0.05)
    assert check is not None and check.conflict
    x = matrix.reshape(-1, 20)
    u, s, vt = np.linalg.svd(x, full_matrices=False)
    keep = s > 1e-10 * s[0]
    y = u[:, keep].T @ (np.concatenate([b.target for b in regression.rows.blocks()]).ravel() / 0.05 - x @ prior.mean)
    spread = (s[keep, None] * vt[keep]) @ prior.covariance @ (s[keep, None] * vt[keep]).T
    factors = np.linspace(1.0, 12.0, 1101)
    found = [multivariate_normal(cov=np.eye(len(y)) + k**2 * spread).logpdf(y) for k in factors]
    assert check.widening == pytest.approx(factors[int(np.argmax(found))], abs=0.02)
    assert f"A prior {check.widening:.2g} times as wide makes the data most probable" in check.text()


def test_no_conflict_widens_nothing():
    rng, prior = np.random.default_rng(1), Prior.nominal(BODIES, 0.15)
    check = against_prior(rows(drawn(prior, rng), rng, std=0.5)[0], prior, 0.15)
    assert check is not None and not check.conflict and check.widening == 1.0


def test_what_contradicts_the_prior_widens_the_posterior(tmp_path):
    """A link of a third of the stated mass: the mean is the data's, and its interval holds the truth."""
    recorded = puma(tmp_path, 0.3)
    posterior = bayesid.sample(recorded, draws=800)
    alone = bayesid.identify(recorded, method="gls")
    assert posterior.prior_check.widening > 1.5
    assert np.all(np.abs(posterior.values - alone.values) < 3.0 * alone.std)
    truth = recorded.robot.nominal.copy()
    truth[1] *= 0.3
    held = (posterior.low <= posterior.base.matrix @ truth.ravel()) & (posterior.base.matrix @ truth.ravel() <= posterior.high)
    assert held.mean() > 0.8
