"""The posterior as a result: draws by name, summaries, and its density for samplers of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.drawing import Plots, figures_of
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.estimators.parameters import HasParameters, Parameters, tails
from bayesid.estimators.prior_check import PriorCheck, conflicts
from bayesid.posterior.convert import Groups, as_dataset, to_arviz
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.run import Chains, Convergence
from bayesid.rounding import LEVEL
from bayesid.section import as_html

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

#: A parameter whose standard deviation stays above this share of the prior's is driven by the prior.
PRIOR_DRIVEN = 0.9
_PRIOR_DRAWS = 4000


@dataclass(frozen=True, eq=False)
class Posterior(Plots, HasParameters):
    """Draws from the posterior of a `PosteriorModel`.

    Attributes
    ----------
    model
        What was sampled.
    chains
        Draws, and the engine that made them.
    seed
        Of the run.
    extra
        Further groups for ArviZ, such as the posterior predictive.
    prior_check
        How far the data are from the prior; None with a flat one.
    """

    report = "posterior"
    model: PosteriorModel
    chains: Chains
    seed: int = 0
    extra: Groups = field(default_factory=Groups, repr=False)
    prior_check: PriorCheck | None = None

    # ---- draws ------------------------------------------------------------------------------------------------

    @property
    def linear(self) -> np.ndarray:
        """Draws of link (or base) and effect parameters (chains, draws, d)."""
        return self.model.split(self.chains.draws)[0]

    @property
    def scales(self) -> np.ndarray:
        """Draws of the scales (chains, draws, k).

        Of each channel's noise, in units of the noise that the rows were whitened with. Of an incomplete model
        there is one, of the estimate's standard deviations.
        """
        return self.model.split(self.chains.draws)[1]

    @property
    def noise_scales(self) -> np.ndarray:
        """Draws of the scales of each channel's noise, those that were held at one included (chains, draws, channels)."""
        likelihood = self.model.likelihood
        if not likelihood.estimate_only:
            return self.scales
        assert likelihood.noise is not None
        return np.ones((*self.chains.draws.shape[:2], sum(len(n.std) for n in likelihood.noise.values())))

    @property
    def dof(self) -> np.ndarray | None:
        """Draws of Student's degrees of freedom (chains, draws); None where they are not sampled."""
        return self.model.split(self.chains.draws)[2] if self.model.dof_free else None

    @cached_property
    def columns(self) -> np.ndarray:
        """Draws of base parameters, then effect parameters (chains, draws, p)."""
        return self.linear @ self.model.to_columns.T

    @property
    def base_draws(self) -> np.ndarray:
        """Draws of the base parameters (chains, draws, r)."""
        return self.columns[..., : self.base.rank]

    @property
    def effect_draws(self) -> np.ndarray:
        """Draws of the effect parameters (chains, draws, e)."""
        return self.columns[..., self.base.rank :]

    @property
    def link_draws(self) -> np.ndarray | None:
        """Draws of the link parameters (chains, draws, P); None with a flat prior, which is on base parameters."""
        return None if self.model.prior is None else self.linear[..., : self.model.link_count]

    # ---- summaries of the base parameters ---------------------------------------------------------------------

    @property
    def base(self) -> BaseParameters:
        """What the base parameters are combinations of."""
        return self.model.base

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.base.names

    @property
    def values(self) -> np.ndarray:
        """Posterior means of the base parameters (r,)."""
        return self.base_draws.mean(axis=(0, 1))

    @property
    def std(self) -> np.ndarray:
        """Posterior standard deviations of the base parameters (r,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def covariance(self) -> np.ndarray:
        """Posterior covariance of the base parameters (r, r)."""
        return moments(self.base_draws)[2]

    @property
    def low(self) -> np.ndarray:
        """Lower ends of the central 95 % intervals of the base parameters (r,)."""
        return np.quantile(self.base_draws, tails()[0], axis=(0, 1))

    @property
    def high(self) -> np.ndarray:
        """Upper ends of the central 95 % intervals of the base parameters (r,)."""
        return np.quantile(self.base_draws, tails()[1], axis=(0, 1))

    @cached_property
    def prior_std(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations under the prior, its bounds included, of base (r,) and link parameters (P,).

        Infinite with a flat prior.
        """
        draws = self.model.prior_draws(_PRIOR_DRAWS, np.random.default_rng(self.seed))
        if draws is None:
            return np.full(self.base.rank, np.inf), np.zeros(0)
        return (draws @ self.base.matrix.T).std(axis=0), draws.std(axis=0)

    @property
    def prior_share(self) -> np.ndarray:
        """Posterior over prior standard deviation of the base parameters (r,); 0 with a flat prior."""
        return self.std / self.prior_std[0]

    @property
    def link_prior_share(self) -> np.ndarray:
        """Posterior over prior standard deviation of the link parameters (P,); empty with a flat prior."""
        links = self.link_draws
        return np.zeros(0) if links is None else links.std(axis=(0, 1)) / self.prior_std[1]

    @property
    def classes(self) -> tuple[str, ...]:
        """``alone``, ``combination`` or, where the prior decides, ``prior`` for each base parameter."""
        several = np.count_nonzero(self.base.matrix, axis=1) > 1
        return tuple(
            "prior" if share > PRIOR_DRIVEN else "combination" if many else "alone"
            for share, many in zip(self.prior_share, several, strict=True)
        )

    @property
    def diagnosis(self) -> Convergence:
        """Convergence of everything sampled and of the base parameters."""
        return self.chains.diagnosis

    # ---- the density, for other samplers ----------------------------------------------------------------------

    @property
    def theta_names(self) -> tuple[str, ...]:
        """Names of the unconstrained coordinates, see `log_density` (q,)."""
        return self.model.theta_names

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Logarithm of the posterior density of unconstrained coordinates, up to a constant: bring your own sampler.

        See `bayesid.posterior.model` for what ``theta`` (..., q) holds.
        """
        return self.model.log_density(theta)

    def log_density_gradient(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`log_density` and its gradient in ``theta``, (...,) and (..., q)."""
        return self.model.log_density_gradient(theta)

    def to_theta(self, draws: np.ndarray | None = None) -> np.ndarray:
        """Unconstrained coordinates (..., q) of draws as in ``model.names``; default: this posterior's."""
        return self.model.to_theta(self.chains.draws if draws is None else np.asarray(draws, float))

    # ---- results as data -----------------------------------------------------------------------------------------

    def to_arviz(self) -> Any:
        """InferenceData (ArviZ 0.x) or DataTree (1.x) with coordinates named after the parameters.

        Base parameters go by `BaseParameters.short_names`; the attribute ``base_parameters`` of the posterior has them in full.
        """
        model = self.model
        posterior = {"base": self.base_draws}
        coords: dict[str, Any] = {"base_parameter": self.base.short_names}
        dims = {"base": ["base_parameter"]}
        if self.link_draws is not None:
            posterior["link"] = self.link_draws
            coords["link_parameter"], dims["link"] = list(self.base.parameter_names), ["link_parameter"]
        if model.effect_names:
            posterior["effect"] = self.effect_draws
            coords["effect_parameter"], dims["effect"] = list(model.effect_names), ["effect_parameter"]
        if model.scale_names:
            posterior["scale"] = self.scales
            coords["scale_channel"], dims["scale"] = list(model.scale_names), ["scale_channel"]
        if self.dof is not None:
            posterior["nu"] = self.dof
        log_density = model.log_joint(*model.split(self.chains.draws))
        groups = {"posterior": posterior, "sample_stats": {"lp": log_density}, **self.extra.arrays}
        return to_arviz(groups, {**coords, **self.extra.coordinates}, {**dims, **self.extra.dimensions}, self._attributes())

    def to_xarray(self) -> Dataset:
        """The draws as an xarray Dataset: ``base`` (chain, draw, base_parameter) and what else was sampled; as in `to_arviz`."""
        return as_dataset(self.to_arviz()["posterior"])

    def _attributes(self) -> dict[str, Any]:
        model = self.model
        prior = "flat on base parameters" if model.prior is None else "normal about nominal links"
        attributes: dict[str, Any] = {
            "prior": prior + (", bodies that can exist only" if model.physical else ""),
            "noise": model.noise,
            "engine": self.chains.engine,
            "steps_between_draws": self.chains.thin,
            "seed": self.seed,
            "model_complete": int(model.likelihood.complete),
            "base_parameters": list(self.names),
        }
        if model.prior is not None:
            attributes["prior_mean_of_links"] = model.prior.mean
            attributes["prior_std_of_links"] = self.prior_std[1]
        return attributes

    def to_dict(self) -> dict[str, Any]:
        """The posterior's part of ``posterior.json``."""
        model, covariance = self.model, self.covariance
        parameters = self.parameters().to_list()
        base, effects = parameters[: self.base.rank], parameters[self.base.rank :]
        for entry, share in zip(base, self.prior_share, strict=True):
            entry |= {"prior_share": float(share), "prior_driven": bool(share > PRIOR_DRIVEN)}
        links = self.link_draws
        d = self.diagnosis
        return {
            "prior_against_data": None if self.prior_check is None else self.prior_check.to_dict(),
            "prior": self._attributes()["prior"],
            "noise": model.noise,
            "model_complete": model.likelihood.complete,
            "dispersion": model.likelihood.dispersion,
            "base_parameters": base,
            "interval": "credible",
            "covariance": covariance.tolist(),
            "base_map": self.base.matrix.tolist(),
            "link_parameter_names": list(self.base.parameter_names),
            "link_parameters": None if links is None else _summaries(self.base.parameter_names, links, self.link_prior_share),
            "effect_parameters": effects,
            "scales": _summaries(model.scale_names, self.scales) if model.scale_names else [],
            "degrees_of_freedom": None if self.dof is None else _summaries(("nu",), self.dof[..., None])[0],
            "sampler": {
                "engine": self.chains.engine,
                "chains": self.chains.draws.shape[0],
                "draws": int(np.prod(self.chains.draws.shape[:2])),
                "draws_per_chain": self.chains.draws.shape[1],
                "steps_between_draws": self.chains.thin,
                "seed": self.seed,
                "converged": d.passed,
                "judged_by_draws": d.draws,
                "largest_r_hat": float(d.r_hat.max()),
                "smallest_ess_bulk": float(d.ess_bulk.min()),
                "smallest_ess_tail": float(d.ess_tail.min()),
            },
        }

    def plot_marginals(self, *, ax: Any = None) -> Figure:
        """Draw posterior, prior and nominal value of every base parameter.

        Parameters
        ----------
        ax
            matplotlib's Axes to draw into, one for each base parameter; default a figure of its own.
        """
        return figures_of(self)["marginals"](ax=ax)

    def plot_predictive(self, rows: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
        """Draw rows as measured over the central 95 % of the readings that the posterior predicts, noise included.

        Parameters
        ----------
        rows
            ``validation`` (of motions that were not fitted; the default where there are any) or ``fitted``.
        channels
            Which readings; default all.
        ax
            matplotlib's Axes to draw into, one for each channel; default a figure of its own.

        Raises
        ------
        InputError
            There are no such rows or channels, or there are fewer or more axes than channels.
        """
        known = self.extra.arrays.get("posterior_predictive", {})
        rows = predicted_rows(rows, list(known))
        names, measured = self.extra.coordinates["channel"], self.extra.arrays["observed_data"][rows]
        return figures_of(self)["predictive"](names, known[rows], measured, channels, ax)

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the marginals; as `plot_marginals`."""
        return self.plot_marginals(ax=ax)

    def parameters(self, level: float = LEVEL) -> Parameters:
        """Base parameters, then effect parameters, by their draws, with central intervals of a probability."""
        names, draws = list(self.model.effect_names), self.columns
        low, high = np.quantile(draws, tails(level), axis=(0, 1))
        mean, std = draws.mean(axis=(0, 1)), draws.reshape(-1, draws.shape[-1]).std(axis=0, ddof=1)
        return Parameters(
            [*self.names, *names], [*self.base.labels, *names], mean, std, low, high,
            [*self.base.units, *self.model.effect_units], [*self.classes, *["effect"] * len(names)],
        )  # fmt: skip

    def __repr__(self) -> str:
        chains, draws = self.chains.draws.shape[:2]
        return f"<{type(self).__name__}: {self.base.rank} base parameters, {chains} chains of {draws} draws>"

    def __str__(self) -> str:
        """Table of the base and effect parameters."""
        d = self.diagnosis
        chains, draws = self.chains.draws.shape[:2]
        made = f" of {d.draws} made" * (d.draws > chains * draws)
        head = (
            f"posterior: {self.base.rank} base parameters, {chains} chains of {draws} draws ({self.chains.engine}), "
            f"largest R-hat {d.r_hat.max():.4f}, smallest ESS {d.ess.min():.0f}{made}"
        )
        warned = [f"warning: {text}" for text in conflicts(self.prior_check)]
        return "\n".join([*warned, head, *self.parameters().table().text()])

    def _repr_html_(self) -> str:
        """The same as an HTML table for notebooks."""
        return as_html([*conflicts(self.prior_check), self.parameters().table("posterior")])


def moments(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws (chains, draws, k) one below the other (n, k), their mean (k,) and covariance (k, k)."""
    flat = draws.reshape(-1, draws.shape[-1])
    return flat, flat.mean(axis=0), np.atleast_2d(np.cov(flat.T))


def predicted_rows(rows: str | None, known: Sequence[str]) -> str:
    """Which of the predicted rows are meant: those given, else of motions that were not fitted; an `InputError` where unknown."""
    rows = rows or ("validation" if "validation" in known else "fitted")
    if rows not in known:
        raise InputError(f"rows '{rows}' were not predicted; choose one of {', '.join(known) or 'none: sample makes them'}")
    return rows


def _summaries(names, draws: np.ndarray, share: np.ndarray | None = None) -> list[dict[str, Any]]:
    """Mean, standard deviation and central 95 % interval by name."""
    low, high = np.quantile(draws, tails(), axis=(0, 1)) if len(names) else (np.zeros(0), np.zeros(0))
    out = []
    for k, name in enumerate(names):
        entry = {"name": name, "value": float(draws[..., k].mean()), "std": float(draws[..., k].std()),
                 "low": float(low[k]), "high": float(high[k])}  # fmt: skip
        if share is not None:
            entry |= {"prior_share": float(share[k]), "prior_driven": bool(share[k] > PRIOR_DRIVEN)}
        out.append(entry)
    return out
