"""The posterior's density: against dense formulas, finite differences and quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bayesid
from bayesid.errors import InputError
from bayesid.estimators import fit
from bayesid.estimators.factor import whitened
from bayesid.estimators.weights import learn_weights
from bayesid.posterior.likelihood import DofPrior, Likelihood, ScalePrior
from bayesid.posterior.model import (
    LOG_CHOLESKY,
    PosteriorModel,
    entries_map,
    from_log_cholesky,
    matrices,
    normaliser,
    to_log_cholesky,
)
from bayesid.posterior.predictive import log_likelihood_terms
from bayesid.posterior.result import Posterior
from bayesid.posterior.run import Chains, Convergence, choose_engine
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from tests.posterior_cases import BODY, one_body, regression, unrestricted


def bare(model):
    """A result without draws: for its density."""
    none = np.zeros((2, 0, len(model.names)))
    return Posterior(model, Chains(none, "hmc", 1, Convergence((), np.zeros(0), np.zeros(0), np.zeros(0))))


def numerical_gradient(f, x, step=1e-6):
    """Central differences."""
    eye = step * np.eye(len(x))
    return np.array([(f(x + e) - f(x - e)) / (2 * step) for e in eye])


@pytest.mark.parametrize("noise", ["gaussian", "student"])
def test_log_likelihood_is_that_of_every_row(noise):
    data = regression(1)
    model = PosteriorModel.of(data, noise=noise)
    weights = learn_weights(data)
    ((_, white),) = whitened(data.rows.blocks(), weights.noise)
    # About the fit b, where rows are known as well as its covariance says; without that they would be `white`.
    white = white @ model.likelihood.adjust
    flat = white.reshape(-1, 5)
    efficient = bayesid.fit(data, "gls")
    assert_allclose(np.linalg.inv(flat[:, :4].T @ flat[:, :4]), efficient.full_covariance, rtol=1e-6)
    assert_allclose(np.linalg.lstsq(flat[:, :4], flat[:, 4])[0], efficient.solution, rtol=1e-6)
    rng = np.random.default_rng(2)
    for _ in range(3):
        beta, scales, nu = rng.normal(size=4), np.exp(0.3 * rng.normal(size=2)), 5.0
        residual = (white[:, :, -1] - white[:, :, :-1] @ beta) / scales
        if noise == "gaussian":
            expected = stats.norm.logpdf(residual).sum() - len(white) * np.log(scales).sum()
        else:
            law = stats.multivariate_t(df=nu, shape=np.diag(scales**2))
            expected = law.logpdf(residual * scales).sum()
        assert_allclose(model.log_likelihood(beta, scales, np.array(nu)), expected, rtol=1e-9)


def test_noise_that_is_not_learned_from_residuals_weighs_an_incomplete_model_too():
    """Of a mount that rings rows weighted by channel ask for no ringing: 5.6 Hz and no damping were drawn for 5.04 and 0.05."""
    data = regression(1)
    weights = replace(learn_weights(data), complete=False, by_noise=True)
    own = Likelihood.of(data, weights).factors[0]
    ((_, white),) = whitened(data.rows.blocks(), weights.noise)
    flat = white.reshape(-1, 5)
    assert_allclose(np.linalg.solve(own[:-1, :-1], own[:-1, -1]), np.linalg.lstsq(flat[:, :4], flat[:, 4])[0], rtol=1e-6)
    wider = weights.efficient.factor
    assert_allclose(wider * own[:-1, :-1].T @ own[:-1, :-1], flat[:, :4].T @ flat[:, :4], rtol=1e-6, atol=1e-6)


@pytest.fixture(scope="module")
def incomplete():
    """Rows of a model that lacks something in one channel and one half of the recording."""
    rng = np.random.default_rng(4)
    matrix = rng.normal(size=(2000, 2, 4))
    target = matrix @ np.arange(1.0, 5.0) + rng.normal(size=(2000, 2))
    target[1000:, 0] += 2.0 * matrix[1000:, 0, 1]
    return Regression.from_arrays(matrix, target)


@pytest.mark.parametrize("engine", ["hmc", "emcee"])
def test_posterior_of_an_incomplete_model_is_a_student_t_about_the_fit(incomplete, engine):
    """Draws against ``wls`` and its covariance, learned from eight parts: seven degrees of freedom."""
    estimate, model = fit(incomplete, "wls"), PosteriorModel.of(incomplete)
    assert not estimate.details.model_complete and model.scale_names == ("estimate",)
    chosen = choose_engine(model, engine)
    draws = chosen.advance(chosen.start(np.random.default_rng(5)), 4000 // chosen.walkers, 3)[..., :4].reshape(-1, 4)
    standard = (draws - estimate.values) / estimate.std
    law = stats.t(7)
    for level in (0.025, 0.25, 0.5, 0.75, 0.975):
        assert_allclose(np.quantile(standard, level, axis=0), law.ppf(level), atol=0.25)


def test_terms_of_an_incomplete_model_add_up_to_its_likelihood(incomplete):
    """As many instants together as scatter together, so that leaving one out counts the parameters, not the rows."""
    posterior = bayesid.sample(incomplete, draws=1600, noise="gaussian")
    terms = log_likelihood_terms(posterior, incomplete.rows.blocks()).astype(float)
    whole = posterior.model.log_likelihood(*posterior.model.split(posterior.chains.draws))
    summed = terms.sum(axis=2)
    assert_allclose(summed - summed.mean(), whole - whole.mean(), atol=0.05)
    together = posterior.model.likelihood.adjust[-1, -1] ** -2.0
    assert 10.0 < together and terms.shape[2] == pytest.approx(2 * 2000 / together, abs=3)
    effective = terms.reshape(-1, terms.shape[2]).var(axis=0, ddof=1).sum()  # [Vehtari2017], equation 12
    assert effective < 8.0


def test_joint_density_is_likelihood_times_priors():
    model = one_body(effects=1, scale_prior=ScalePrior(3.0, 2.0))
    rng = np.random.default_rng(0)
    values, expected = [], []
    for _ in range(4):
        linear = np.append(BODY * (1 + 0.1 * rng.normal(size=10)), rng.uniform(0.1, 1))
        scales = np.exp(0.2 * rng.normal(size=2))
        gap = linear[:10] - BODY
        prior = -0.5 * gap @ model.prior.precision @ gap
        # of log s: IG of s^2 times the Jacobian 2 s^2
        prior += sum(stats.invgamma(3.0, scale=2.0).logpdf(s**2) + np.log(2 * s**2) for s in scales)
        values.append(model.log_joint(linear, scales, np.array(np.inf)))
        expected.append(model.log_likelihood(linear, scales, np.array(np.inf)) + prior)
    assert_allclose(np.diff(values), np.diff(expected), rtol=1e-8, atol=1e-8)


def test_log_cholesky_jacobian_is_that_of_finite_differences():
    rng = np.random.default_rng(0)
    for _ in range(5):
        theta = 0.5 * rng.normal(size=10)
        entries, log_jacobian = from_log_cholesky(theta)
        numerical = numerical_gradient(lambda t: from_log_cholesky(t)[0], theta)
        assert_allclose(np.linalg.slogdet(numerical)[1], log_jacobian, atol=1e-6)
        assert np.linalg.eigvalsh(matrices(entries))[0] > 0
        assert_allclose(to_log_cholesky(entries), theta, atol=1e-10)


def test_entries_are_those_of_the_normalised_pseudo_inertia():
    n = normaliser(BODY)
    rng = np.random.default_rng(0)
    other = BODY + 0.1 * rng.normal(size=10)
    expected = n @ inertia.pseudo_inertia(other) @ n.T
    assert_allclose(matrices(entries_map(BODY) @ other), expected, atol=1e-12)
    assert_allclose(n @ inertia.pseudo_inertia(BODY) @ n.T, np.eye(4), atol=1e-9)
    placeholder = normaliser(np.zeros(10))
    assert np.isfinite(placeholder).all() and np.linalg.cond(placeholder) < 1e4


@pytest.mark.parametrize("noise", ["gaussian", "student"])
def test_unconstrained_density_has_the_whole_jacobian(noise):
    """log p(theta) - log p(phi, a, s, nu) is the log determinant of the map, by finite differences."""
    model = one_body(effects=2, noise=noise, keep=True, scale_prior=ScalePrior(3.0, 2.0))
    posterior = bare(model)
    rng = np.random.default_rng(3)
    theta = 0.3 * rng.normal(size=len(posterior.theta_names))
    density, linear, scales, dof = model._density(theta)

    def outcome(t):
        _, lin, sc, nu = model._density(t)
        # The density is with respect to log s and nu itself.
        return np.concatenate([lin, np.log(sc), [nu] if model.dof_free else []])

    jacobian = np.linalg.slogdet(numerical_gradient(outcome, theta, 1e-5))[1]
    assert_allclose(density - jacobian, model.log_joint(linear, scales, dof), atol=1e-4)
    draws = np.concatenate([linear, scales, [dof] if model.dof_free else []])
    assert_allclose(posterior.to_theta(draws), theta, atol=1e-9)


@pytest.mark.parametrize("known", [False, True])
def test_gradient_is_that_of_finite_differences(known):
    for model in (one_body(effects=1, scale_prior=ScalePrior(2.0, 1.0, known)), PosteriorModel.of(regression(4))):
        posterior = bare(model)
        theta = 0.1 * np.random.default_rng(1).normal(size=(3, len(posterior.theta_names)))
        density, gradient = posterior.log_density_gradient(theta)
        for t, d, g in zip(theta, density, gradient, strict=True):
            assert_allclose(d, posterior.log_density(t), rtol=1e-12)
            numerical = numerical_gradient(lambda x, p=posterior: float(p.log_density(x)), t)
            assert_allclose(g, numerical, rtol=1e-5, atol=1e-6 * np.abs(g).max())


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("fixed", [None, 3.0])
def test_gradient_of_student_noise_is_that_of_finite_differences(known, fixed):
    options = {"noise": "student", "scale_prior": ScalePrior(2.0, 1.0, known), "dof_prior": DofPrior(fixed=fixed)}
    for model in (one_body(effects=1, keep=True, **options), PosteriorModel.of(regression(4), **options)):
        posterior = bare(model)
        theta = 0.1 * np.random.default_rng(1).normal(size=(2, 2, len(posterior.theta_names)))
        theta[0, 0, -1] += 1.0
        density, gradient = posterior.log_density_gradient(theta)
        for at in np.ndindex(2, 2):
            assert_allclose(density[at], posterior.log_density(theta[at]), rtol=1e-12)
            numerical = numerical_gradient(lambda x, p=posterior: float(p.log_density(x)), theta[at])
            assert_allclose(gradient[at], numerical, rtol=1e-5, atol=1e-6 * np.abs(gradient[at]).max())


def test_quadratic_terms_are_the_normal_equations():
    model = one_body(effects=1)
    mean, covariance = unrestricted(model)
    q = model.quadratic
    assert_allclose(q.centre, mean, rtol=1e-8)
    assert_allclose(q.root @ q.root.T, covariance, rtol=1e-7, atol=1e-12)
    assert_allclose(q.gram.sum(axis=0), np.eye(11), atol=1e-10)
    weights = np.array([0.5, 3.0])
    z, lower = q.gaussian(weights)
    assert_allclose(lower @ lower.T, 0.5 * q.gram[0] + 3.0 * q.gram[1] + q.gram[2], atol=1e-12)
    assert_allclose((lower @ lower.T) @ z, 0.5 * q.linear[0] + 3.0 * q.linear[1] + q.linear[2], atol=1e-10)


def test_names_and_bounds():
    model = one_body(effects=1, noise="student", keep=True)
    assert model.names[:2] == ("body.m", "body.mcx") and model.names[-4:] == ("e0", "scale y1", "scale y2", "nu")
    inside = np.append(BODY, 0.1)
    assert model.inside(inside) and not model.inside(-inside) and not model.inside(np.append(BODY, -0.1))
    flat_body = inside.copy()
    flat_body[4] = 0.0
    assert not model.inside(flat_body)


def test_what_a_flat_prior_leaves_open_is_refused():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(50, 2, 3))
    data = Regression.from_arrays(np.concatenate([rows, 0 * rows[:, :, :1]], axis=2), rows[:, :, 0])
    PosteriorModel.of(data)  # a column of zeros is no base parameter
    with pytest.raises(InputError, match="noise 'cauchy': choose one of"):
        PosteriorModel.of(data, noise="cauchy")
    with pytest.raises(InputError, match="prior has 10 parameters"):
        PosteriorModel.of(data, one_body().prior)
    lost = one_body(effects=1)
    factors = lost.likelihood.factors.copy()
    factors[:, :, lost.base.rank] = 0.0
    with pytest.raises(InputError, match="say nothing about e0"):
        replace(lost, likelihood=replace(lost.likelihood, factors=factors)).require_proper()
    blind = replace(lost, prior=None, effect_std=np.ones(1), likelihood=replace(lost.likelihood, factors=0 * factors))
    with pytest.raises(InputError, match="say nothing about"):
        blind.require_proper()


def test_conditions_of_the_fit_are_passed_on():
    data = regression(0)
    model = PosteriorModel.of(data, dof_prior=DofPrior(fixed=4.0), noise="student")
    assert model.likelihood.complete and not model.dof_free
    assert_allclose(model.likelihood.counts, 300)
    gls = fit(data, "gls")
    assert_allclose(model.quadratic.centre, gls.values, rtol=1e-9)


def test_a_channel_that_parameters_can_fit_exactly_keeps_a_scale():
    """Jeffreys' law alone has no finite mass there; where all are fitted exactly, nothing tells the noise."""
    few = PosteriorModel.of(regression(samples=4, p=4))
    assert (np.broadcast_to(few.scale_prior.rate, 2) > 0).all()
    assert PosteriorModel.of(regression(samples=5, p=4)).scale_prior == ScalePrior()
    posterior = bayesid.sample(regression(samples=3, p=4), 200, keep_going=True, sampler=bayesid.Sampler(engine="hmc"))
    assert posterior.std.min() > 1e-3
    with pytest.raises(InputError, match="8 numbers show 8 parameters, so no residual is left"):
        bayesid.sample(regression(samples=4, p=8))


@pytest.mark.parametrize("seed", [-1, 0.5, None])
def test_what_is_no_seed_is_refused(seed):
    with pytest.raises(InputError, match=f"seed = {seed}: give a whole number of at least 0"):
        bayesid.sample(regression(), seed=seed)


def test_coordinates_are_named_in_the_order_in_which_they_are():
    """A body behind another column: its log-Cholesky parameters come first all the same."""
    rng, mean = np.random.default_rng(0), np.array([0.3, *BODY, -0.2])
    matrix = rng.normal(size=(60, 2, 12))
    names = ["friction", *[f"body.{n}" for n in inertia.PARAMETERS], "offset"]
    rows = Regression.from_arrays(matrix, matrix @ mean + 0.1 * rng.normal(size=(60, 2)), parameter_names=names)
    own = Prior.nominal(BODY, 0.3)
    precision = np.eye(12)
    precision[1:11, 1:11] = own.precision
    model = PosteriorModel.of(rows, Prior(mean, precision, (tuple(range(1, 11)),)))
    called = model.theta_names
    assert called[:10] == tuple(f"body.{n}" for n in LOG_CHOLESKY) and called[10:12] == ("friction", "offset")
    theta = model.to_theta(np.concatenate([mean, np.ones(2)]))
    assert_allclose([theta[called.index(n)] for n in ("friction", "offset")], [0.3, -0.2])
    loose = Prior(mean, np.diag([0.0, *np.ones(11)]), (tuple(range(1, 11)),))
    with pytest.raises(InputError, match="its precision is singular"):
        PosteriorModel.of(rows, loose)
    with pytest.raises(InputError, match="prior_std=0.1 is given with a Prior, which states its own"):
        bayesid.sample(rows, prior=own, prior_std=0.1)


@pytest.mark.parametrize(
    "given", [{"draws": 400.5}, {"draws": "400"}, {"chains": 2.5}, {"sampler": bayesid.Sampler(longest=1.5)}]
)
def test_counts_are_whole_numbers(given):
    with pytest.raises(InputError, match="give a whole number"):
        bayesid.sample(regression(), **given)
