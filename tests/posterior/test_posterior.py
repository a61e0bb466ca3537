"""The samplers: against conjugate answers, rejection sampling and the prior; convergence, resuming, seeds."""

import numpy as np
import pytest
from numpy.random import mtrand
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import ks_2samp

from bayesid.errors import InputError
from bayesid.estimators import fit
from bayesid.posterior.checkpoint import load_checkpoint, save_checkpoint
from bayesid.posterior.likelihood import DofPrior, ScalePrior
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.result import Posterior
from bayesid.posterior.run import choose_engine, convergence, run
from bayesid.posterior.trajectory import feasible, travel
from bayesid.robot import inertia
from tests.posterior_cases import interrupted_in, one_body, regression, rejection, unrestricted

KNOWN = ScalePrior(known=True)
#: Monte Carlo errors above this are wrong: one in 16,000 by chance.
FAR = 4.0


def sampled(model, engine=None, moves="laplace", **options):
    chains = run(model, choose_engine(model, engine, moves), **{"draws": 4000, "seed": 1, **options})
    return Posterior(model, chains, 1)


def within_monte_carlo_error(draws, mean, std):
    """Means and standard deviations of (chains, n, d) draws, by their effective sizes."""
    size = np.maximum(convergence(draws, tuple(map(str, range(draws.shape[2])))).ess_bulk, 1)
    flat = draws.reshape(-1, draws.shape[2])
    z = (flat.mean(axis=0) - mean) / (std / np.sqrt(size))
    ratio = (flat.std(axis=0) / std - 1.0) * np.sqrt(2 * size)
    return np.abs(z).max() < FAR and np.abs(ratio).max() < FAR


@pytest.mark.parametrize("engine", ["emcee", "hmc"])
def test_flat_prior_at_known_scales_is_generalised_least_squares(engine):
    data = regression(3, samples=200)
    posterior = sampled(PosteriorModel.of(data, scale_prior=KNOWN), engine)
    gls = fit(data, "gls")
    assert posterior.diagnosis.passed
    assert within_monte_carlo_error(posterior.base_draws, gls.values, gls.std)
    correlation = np.corrcoef(posterior.base_draws.reshape(-1, 4).T)
    assert_allclose(correlation, gls.covariance / np.outer(gls.std, gls.std), atol=4 / np.sqrt(2000))


@pytest.mark.parametrize("engine", ["emcee", "hmc"])
def test_one_channel_is_the_conjugate_answer(engine):
    """Jeffreys' prior, one unknown scale: the parameters follow Student's t with n - p degrees of freedom."""
    data = regression(5, samples=30, channels=1)
    model = PosteriorModel.of(data)
    posterior = sampled(model, engine)
    r = model.likelihood.factors[0]
    x, y, free = r[:-1, :-1], r[:-1, -1], 26
    variance = r[-1, -1] ** 2 / free
    mean = np.linalg.solve(x, y)
    std = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * variance * free / (free - 2))
    assert within_monte_carlo_error(posterior.base_draws, mean, std)
    # 1 / s^2 ~ Gamma((n - p) / 2, RSS / 2)
    precision = posterior.scales**-2
    assert within_monte_carlo_error(precision, np.array([1 / variance]), np.array([np.sqrt(2 / free) / variance]))


def test_normal_prior_without_a_cone_is_the_conjugate_answer():
    from dataclasses import replace

    model = one_body(scale_prior=KNOWN)
    model = replace(model, prior=replace(model.prior, physical=False))
    mean, covariance = unrestricted(model)
    for engine in ("emcee", "hmc"):
        posterior = sampled(model, engine)
        assert within_monte_carlo_error(posterior.linear, mean, np.sqrt(np.diag(covariance)))
        assert_allclose(posterior.prior_std[1], np.sqrt(np.diag(model.prior.covariance)), rtol=0.05)


@pytest.fixture(scope="module")
def walled():
    """A posterior whose middle lies outside the cone, and draws from it by rejection."""
    model = one_body(effects=1, scale_prior=KNOWN)
    assert not model.inside(unrestricted(model)[0])
    return model, rejection(model, 4000)


@pytest.mark.parametrize("engine", ["emcee", "hmc"])
def test_the_cone_is_that_of_rejection_sampling(walled, engine):
    model, reference = walled
    posterior = sampled(model, engine)
    assert posterior.diagnosis.passed
    size = posterior.diagnosis.ess_bulk[: len(model.linear_names)]
    flat = posterior.linear.reshape(-1, reference.shape[1])
    std = reference.std(axis=0)
    z = (flat.mean(axis=0) - reference.mean(axis=0)) / std / np.sqrt(1 / size + 1 / len(reference))
    ratio = (flat.std(axis=0) / std - 1) / np.sqrt(0.5 / size + 0.5 / len(reference))
    assert np.abs(z).max() < FAR and np.abs(ratio).max() < FAR
    smallest = [np.linalg.eigvalsh(inertia.pseudo_inertia(x[:, :10]))[:, 0] for x in (flat, reference)]
    thin = max(int(len(flat) / size.min()), 1)
    assert ks_2samp(smallest[0][::thin], smallest[1]).pvalue > 1e-4
    assert smallest[0].min() > 0


def test_a_deep_wall_loses_no_trajectory(walled):
    """Many bounces, and every draw is a body that can exist."""
    model = one_body(effects=1, samples=200, std=0.1)
    engine = choose_engine(model)
    state = engine.start(np.random.default_rng(0))
    draws = engine.advance(state, 300, 1)
    assert state.bounces > 300 and state.lost == 0
    assert model.inside(draws[:, 0, :11]).all()


def test_linear_walls_alone_are_those_of_a_truncated_normal():
    """Two coordinates that cannot be negative, by the exact moments of rejection."""
    rng = np.random.default_rng(0)
    mean, root = np.array([-0.5, 0.3]), np.array([[1.0, 0.0], [0.6, 0.8]])
    x, draws = np.ones(2), np.empty((6000, 2))
    for d in draws:
        assert travel(x, root @ rng.normal(size=2), mean, root, 0, np.array([0, 1])) >= 0
        d[:] = x
    brute = mean + rng.normal(size=(400_000, 2)) @ root.T
    brute = brute[(brute > 0).all(axis=1)]
    z = (draws.mean(axis=0) - brute.mean(axis=0)) / brute.std(axis=0) * np.sqrt(3000)
    assert np.abs(z).max() < FAR
    assert_allclose(np.corrcoef(draws.T)[0, 1], np.corrcoef(brute.T)[0, 1], atol=0.05)
    assert feasible(x, 0, np.array([0, 1])) and not feasible(-x, 0, np.array([0, 1]))


def test_student_noise_agrees_with_emcee_on_the_marginal_density():
    """Data augmentation against a generic sampler of the density itself, in three dimensions."""
    import emcee

    data = regression(7, samples=60, p=1, channels=2, heavy=3)
    model = PosteriorModel.of(data, noise="student")
    posterior = sampled(model, draws=2000)  # some thousand independent ones; of emcee's there are 240

    def density(x):
        return model.log_joint(x[:, :1], np.exp(x[:, 1:3]), np.exp(x[:, 3])) + x[:, 3]

    start = posterior.to_theta()[0, :12] + 0.05 * np.random.default_rng(0).normal(size=(12, 4))
    sampler = emcee.EnsembleSampler(12, 4, density, vectorize=True)
    sampler.random_state = mtrand.RandomState(0).get_state()  # emcee's own kind of generator
    sampler.run_mcmc(start, 1500)
    other = sampler.get_chain(discard=300, flat=True)
    own = posterior.to_theta().reshape(-1, 4)
    slack = other.std(axis=0) * np.sqrt(1 / posterior.diagnosis.ess_bulk[:4] + 60 / len(other))
    assert np.all(np.abs(own.mean(axis=0) - other.mean(axis=0)) < FAR * slack)
    assert_allclose(own.std(axis=0), other.std(axis=0), rtol=0.15)


def test_student_noise_resists_outliers_and_few_degrees_of_freedom_are_found():
    data = regression(8, samples=300, heavy=2)
    posterior = sampled(PosteriorModel.of(data, noise="student"), draws=1000)
    assert 1.2 < np.median(posterior.dof) < 3.5
    assert np.abs((posterior.values - np.arange(1, 5)) / posterior.std).max() < FAR
    fixed = sampled(PosteriorModel.of(data, noise="student", dof_prior=DofPrior(fixed=2.0)), draws=1000)
    assert fixed.dof is None and np.abs((fixed.values - posterior.values) / posterior.std).max() < 0.5
    gaussian = sampled(PosteriorModel.of(data), draws=1000)
    assert np.all(posterior.std < 0.8 * gaussian.std)


@pytest.mark.parametrize("engine", ["emcee", "hmc"])
def test_seeds_reproduce_and_an_interrupted_run_goes_on_to_the_same_draws(tmp_path, engine):
    model, file = PosteriorModel.of(regression(2)), tmp_path / "checkpoint.npz"
    whole = sampled(model, engine, draws=1000, chains=2).chains.draws
    assert_array_equal(sampled(model, engine, draws=1000, chains=2).chains.draws, whole)
    assert not np.array_equal(sampled(model, engine, draws=1000, chains=2, seed=2).chains.draws, whole)
    with pytest.raises(KeyboardInterrupt):
        sampled(model, engine, draws=1000, chains=2, checkpoint=file, tell=interrupted_in(round=3))
    assert_array_equal(sampled(model, engine, draws=1000, chains=2, checkpoint=file, resume=True).chains.draws, whole)
    with pytest.raises(InputError, match="belongs to another run"):
        sampled(model, engine, draws=1200, chains=2, checkpoint=file, resume=True)
    file.write_text("nothing")
    with pytest.raises(InputError, match="is damaged or was changed"):
        sampled(model, engine, draws=1000, chains=2, checkpoint=file, resume=True)


def test_effective_sizes_of_more_draws_than_are_kept_say_of_how_many():
    """ArviZ finds fewer of those that are kept."""
    model = PosteriorModel.of(regression(2))
    few, many = sampled(model, draws=400), sampled(model, draws=2000)
    assert few.diagnosis.draws == 1600 and str(few).splitlines()[0].endswith("of 1600 made")
    assert many.diagnosis.draws == 2000 and "made" not in str(many)


def test_chains_that_disagree_run_longer_and_are_called_so():
    """Stretch moves in many walls' way are slow: draws move apart, and the verdict stays honest."""
    model = one_body(scale_prior=KNOWN)
    short = sampled(model, "emcee", "stretch", draws=200, chains=2, longest=1)
    assert short.chains.thin == 1 and not short.diagnosis.passed
    assert "R-hat" in short.diagnosis.complaint()
    longer = sampled(model, "emcee", "stretch", draws=200, chains=2, longest=4)
    assert longer.chains.thin > 1 and longer.chains.draws.shape == (2, 100, 10)


def test_engines_and_numbers_out_of_range_are_refused():
    model = PosteriorModel.of(regression(0))
    wide = PosteriorModel.of(regression(0, samples=100, p=26))
    for case, match in (
        (lambda: choose_engine(model, "gibbs"), 'engine="gibbs".: choose one of hmc, emcee'),
        (lambda: choose_engine(model, "emcee", "walk"), "moves 'walk'"),
        (lambda: choose_engine(wide, "emcee", "stretch"), "do not mix in 28 dimensions"),
        (lambda: choose_engine(one_body(noise="student", keep=True), "emcee"), "Gaussian noise only"),
        (lambda: sampled(model, draws=100), "draws=100: give at least 200"),
        (lambda: sampled(model, chains=1), "chains=1"),
        (lambda: sampled(model, longest=0), "longest=0"),
    ):
        with pytest.raises(InputError, match=match):
            case()
    assert choose_engine(model).name == "emcee" and choose_engine(one_body()).name == "hmc"


def test_prior_driven_parameters_are_marked():
    """Readings that are nothing but noise leave the prior; good ones do not."""
    ignorant = sampled(one_body(rel_std=0.3, std=1e4), draws=4000)
    assert_allclose(ignorant.prior_share, 1.0, atol=0.08)
    assert_allclose(ignorant.link_prior_share, 1.0, atol=0.08)
    assert set(ignorant.classes) == {"prior"}
    posterior = sampled(one_body(rel_std=0.3, std=0.1), draws=2000)
    assert posterior.prior_share.max() < 0.9 and "prior" not in posterior.classes
    text = str(posterior)
    assert "R-hat" in text and posterior.base.labels[0] in text
    assert "<table>" in posterior._repr_html_()
    entry = posterior.to_dict()
    assert entry["sampler"]["converged"] and len(entry["link_parameters"]) == 10
    assert entry["base_parameters"][0]["low"] < entry["base_parameters"][0]["value"] < entry["base_parameters"][0]["high"]


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "no zip", "thin of zero", "missing keys"])
def test_a_damaged_checkpoint_is_refused(damage, tmp_path):
    path = tmp_path / "run.npz"
    save_checkpoint(path, "mark", {"kept": np.ones((2, 3, 1, 4)), "thin": 1, "rounds": 2, "states": []})
    assert load_checkpoint(path, "mark")["thin"] == 1
    data = path.read_bytes()
    with np.load(path) as stored:
        parts = dict(stored)
    if damage == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "flipped":
        path.write_bytes(data[:200] + bytes([data[200] ^ 255]) + data[201:])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "no zip":
        path.write_bytes(b"\x93NUMPY" + data[6:])
    elif damage == "thin of zero":
        with path.open("wb") as file:
            np.savez(file, **{**parts, "rest": str(parts["rest"]).replace('"thin": 1', '"thin": 0')})
    else:
        with path.open("wb") as file:
            np.savez(file, kept=parts["kept"])
    with pytest.raises(InputError, match="is damaged or was changed; leave out sampler=Sampler.resume=True. or delete it"):
        load_checkpoint(path, "mark")


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "run.npz"
    content = {"kept": np.ones((1, 1, 1, 1)), "thin": 1}
    save_checkpoint(path, "mark", content)
    before = path.read_bytes()

    def full(file, **_):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space"):
        save_checkpoint(path, "mark", {**content, "thin": 2})
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["run.npz"]
