"""The posterior over base parameters and the links behind them: density, samplers, diagnostics, results."""

from __future__ import annotations

from bayesid.posterior.diagnostics import Convergence, ConvergenceError
from bayesid.posterior.likelihood import DofPrior, Likelihood, ScalePrior
from bayesid.posterior.model import PosteriorModel
from bayesid.posterior.result import Posterior
from bayesid.posterior.run import Chains, Engine, choose_engine, run

__all__ = [
    "Chains",
    "Convergence",
    "ConvergenceError",
    "DofPrior",
    "Engine",
    "Likelihood",
    "Posterior",
    "PosteriorModel",
    "ScalePrior",
    "choose_engine",
    "run",
]
