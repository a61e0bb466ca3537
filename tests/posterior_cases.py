"""Small posteriors for tests, with independent ways to the same numbers."""

from __future__ import annotations

import numpy as np

from bayesid.dynamics.base_parameters import regroup
from bayesid.posterior.likelihood import Likelihood
from bayesid.posterior.model import PosteriorModel
from bayesid.regression.regression import Regression
from bayesid.robot import inertia
from bayesid.robot.prior import Prior
from bayesid.signals.noise import NoiseModel

BODY = inertia.from_mass_com_inertia(2.0, np.array([0.05, -0.02, 0.1]), np.diag([0.02, 0.025, 0.015]))


def regression(seed=0, samples=300, p=4, channels=2, noise=(1.0, 0.2), heavy=None):
    """Rows with known parameters 1 ... p."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(samples, channels, p))
    error = rng.normal(size=(samples, channels)) if heavy is None else rng.standard_t(heavy, size=(samples, channels))
    target = matrix @ np.arange(1.0, p + 1) + error * np.resize(noise, channels)
    return Regression.from_arrays(matrix, target)


def white_likelihood(rows: np.ndarray, *, keep: bool = False) -> Likelihood:
    """Of rows [X y] in units of the noise (n, channels, p + 1)."""
    channels, size = rows.shape[1], rows.shape[2]
    factors = [np.linalg.qr(np.concatenate([rows[:, c], np.zeros((size, size))]), mode="r") for c in range(channels)]
    return Likelihood(
        np.array(factors), np.full(channels, len(rows)), tuple(f"y{c + 1}" for c in range(channels)),
        white=(rows,) if keep else (), noise={"trajectory": NoiseModel(np.ones((channels, 1)), np.eye(channels))},
    )  # fmt: skip


def one_body(seed=0, rel_std=0.8, samples=12, effects=0, keep=False, std=0.6, **options):
    """One body, partly seen, beside its cone's wall: rows of six of its ten parameters; effects are bounded below."""
    rng = np.random.default_rng(seed)
    names, units = [f"body.{n}" for n in inertia.PARAMETERS], list(inertia.UNITS)
    seen = np.zeros((40, 10))
    seen[:, [0, 1, 2, 4, 6, 9]] = rng.normal(size=(40, 6))
    base = regroup(seen, names, units)
    prior = Prior.nominal(BODY, rel_std)
    rows = rng.normal(size=(samples, 2, base.rank + effects + 1)) / std
    size = np.array([2.0, 0.1, 0.1, 0.04, 0.04, 0.04])
    rows[:, :, : base.rank] /= size
    # A truth outside the cone: the middle of the posterior before it is cut lies beyond the wall.
    outside = BODY.copy()
    outside[4] *= 0.1
    truth = np.concatenate([base.matrix @ outside, np.full(effects, 0.2)])
    rows[:, :, -1] = rows[:, :, :-1] @ truth + rng.normal(size=(samples, 2))
    return PosteriorModel(
        base, tuple(f"e{k}" for k in range(effects)), ("1",) * effects, np.ones(effects, bool), white_likelihood(rows, keep=keep),
        prior, effect_std=np.full(effects, np.inf), **options,
    )  # fmt: skip


def unrestricted(model: PosteriorModel) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance at unit scales before the cut, by textbook normal equations."""
    precision = np.zeros((len(model.linear_names),) * 2)
    right = np.zeros(len(model.linear_names))
    if model.prior is not None:
        n = len(model.prior.mean)
        precision[:n, :n] = model.prior.precision
        right[:n] = model.prior.precision @ model.prior.mean
    for factor in model.likelihood.factors:
        x, y = factor[:, :-1] @ model.to_columns, factor[:, -1]
        precision += x.T @ x
        right += x.T @ y
    size = 1.0 / np.sqrt(np.diag(precision))
    covariance = np.linalg.inv(precision * np.outer(size, size)) * np.outer(size, size)
    return covariance @ right, covariance


def rejection(model: PosteriorModel, count: int, seed: int = 0) -> np.ndarray:
    """Draws at unit scales by rejection: normal draws of which those are kept whose bodies can exist."""
    rng = np.random.default_rng(seed)
    mean, covariance = unrestricted(model)
    size = np.sqrt(np.diag(covariance))
    root = size[:, None] * np.linalg.cholesky(covariance / np.outer(size, size))
    out: list[np.ndarray] = []
    while sum(map(len, out)) < count:
        draws = mean + rng.normal(size=(200_000, len(mean))) @ root.T
        bounded = len(mean) - len(model.effect_names)
        draws = draws[np.all(draws[:, bounded:][:, model.effect_non_negative] > 0, axis=1)]
        links = draws[:, : model.link_count].reshape(len(draws), -1, 10)
        out.append(draws[np.all(np.linalg.eigvalsh(inertia.pseudo_inertia(links))[..., 0] > 0, axis=1)])
    return np.concatenate(out)[:count]


def interrupted_in(round: int):
    """What a run tells its progress to, and is interrupted by in one of its rounds, as by a user."""
    told = []

    def tell(text: str) -> None:
        told.append(text)
        if len(told) == round:
            raise KeyboardInterrupt

    return tell
