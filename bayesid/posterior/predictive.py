"""What the posterior says of rows: replicated readings, and how likely the measured ones are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.linalg import cholesky
from scipy.signal import lfilter

from bayesid.posterior.convert import Groups
from bayesid.posterior.pointwise import log_likelihood_terms
from bayesid.posterior.result import Posterior
from bayesid.regression.blocks import Block
from bayesid.signals.noise import NoiseModel

#: Draws that readings are replicated for, rows that are kept of them, and rows looked at before thinning.
DRAWS, ROWS, CONSIDERED = 200, 400, 4096
#: Rows after which the noise has forgotten how it started.
_RUN_IN = 200


def predictive_groups(
    posterior: Posterior, rows: Iterable[Block], fitted: Iterable[Block], validation: Iterable[Block], channels: tuple[str, ...]
) -> Groups:
    """Groups ``posterior_predictive``, ``log_likelihood`` (of the fitted rows) and ``observed_data``.

    Parameters
    ----------
    posterior
        What to predict with.
    rows
        All that were fitted.
    fitted, validation
        Rows that were fitted, and rows that were not; at most 4096 of each are looked at and about 400 kept.
    channels
        Names of the channels.
    """
    rng = np.random.default_rng([posterior.seed, 1])
    groups: dict[str, dict[str, np.ndarray]] = {"posterior_predictive": {}, "log_likelihood": {}, "observed_data": {}}
    coordinates: dict[str, Any] = {"channel": list(channels)}
    dimensions: dict[str, list[str]] = {}
    for name, blocks in (("fitted", _first_rows(fitted)), ("validation", _first_rows(validation))):
        if not blocks:
            continue
        keep = _evenly_spaced(blocks)
        groups["posterior_predictive"][name] = np.concatenate(
            [_replicated(posterior, b, rng)[:, :, k].astype(np.float32) for b, k in zip(blocks, keep, strict=True)], axis=2
        )
        groups["observed_data"][name] = np.concatenate([b.target[k] for b, k in zip(blocks, keep, strict=True)])
        coordinates[f"{name}_row"] = list(range(sum(map(len, keep))))
        dimensions[name] = [f"{name}_row", "channel"]
    groups["log_likelihood"]["rows"] = log_likelihood_terms(posterior, rows)
    coordinates["term"] = list(range(groups["log_likelihood"]["rows"].shape[2]))
    dimensions["rows"] = ["term"]
    return Groups({name: arrays for name, arrays in groups.items() if arrays}, coordinates, dimensions)


def _first_rows(blocks: Iterable[Block]) -> list[Block]:
    out, total = [], 0
    for block in blocks:
        if total >= CONSIDERED:
            break
        count = min(len(block.rows), CONSIDERED - total)
        out.append(Block(block.rows[:count], block.times[:count], block.motion, block.start, block.group))
        total += count
    return out


def _evenly_spaced(blocks: list[Block]) -> list[np.ndarray]:
    """Evenly spaced rows of every block, about `ROWS` in all."""
    step = max(-(-sum(len(b.rows) for b in blocks) // ROWS), 1)
    return [np.arange(0, len(b.rows), step) for b in blocks]


def _noise(posterior: Posterior, group: str) -> tuple[NoiseModel, slice]:
    """Noise of a group of rows and its scales; of a group that was not fitted, another's without its colour."""
    likelihood = posterior.model.likelihood
    assert likelihood.noise is not None
    known = group if group in likelihood.groups else likelihood.groups[0]
    model = likelihood.noise[known] if known == group else likelihood.noise[known].uncoloured()
    first = likelihood.groups.index(known) * len(model.std)
    return model, slice(first, first + len(model.std))


def _replicated(posterior: Posterior, block: Block, rng: np.random.Generator) -> np.ndarray:
    """Readings with fresh noise (chains, draws, rows, channels) for a few draws."""
    chains, draws = posterior.columns.shape[:2]
    at = np.unique(np.linspace(0, draws - 1, max(DRAWS // chains, 1)).astype(int))
    noise, part = _noise(posterior, block.group)
    columns, scales = posterior.columns[:, at], posterior.noise_scales[:, at, part]
    mean = np.einsum("tcp,nmp->nmtc", block.matrix, columns, optimize=True)
    run_in = 0 if noise.from_zero or noise.order == 0 else _RUN_IN
    shape = (*mean.shape[:2], len(block.rows) + run_in, mean.shape[3])
    innovations = rng.normal(size=shape) * scales[:, :, None]
    dof = posterior.model.split(posterior.chains.draws)[2][:, at]
    if posterior.model.noise == "student":
        half = 0.5 * dof[:, :, None]
        innovations /= np.sqrt(rng.gamma(half, size=shape[:3]) / half)[..., None]
    innovations = innovations @ cholesky(noise.innovation, lower=True).T
    for c, polynomial in enumerate(noise.coefficients):
        mean[..., c] += np.asarray(lfilter([1.0], polynomial, innovations[..., c], axis=2))[:, :, run_in:]
    return mean
