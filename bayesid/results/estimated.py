"""What results around one estimate share, whether it was just made or read from its file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bayesid.drawing import figures_of
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.estimators import Estimate
from bayesid.estimators.parameters import HasParameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class _WithEstimate(Protocol):
    @property
    def estimate(self) -> Estimate: ...


class HasEstimate(HasParameters):
    """Base parameters of the estimate in ``estimate``, with their intervals."""

    @property
    def names(self: _WithEstimate) -> tuple[str, ...]:
        """Names of the base parameters (r,)."""
        return self.estimate.names

    @property
    def values(self: _WithEstimate) -> np.ndarray:
        """Base parameters (r,)."""
        return self.estimate.values

    @property
    def std(self: _WithEstimate) -> np.ndarray:
        """Standard deviations of the base parameters (r,)."""
        return self.estimate.std

    @property
    def low(self: _WithEstimate) -> np.ndarray:
        """Lower ends of the base parameters' 95 % intervals (r,)."""
        return self.estimate.low

    @property
    def high(self: _WithEstimate) -> np.ndarray:
        """Upper ends of the base parameters' 95 % intervals (r,)."""
        return self.estimate.high

    @property
    def covariance(self: _WithEstimate) -> np.ndarray | None:
        """Covariance of the base parameters (r, r)."""
        return self.estimate.covariance

    @property
    def base(self: _WithEstimate) -> BaseParameters:
        """What the base parameters are combinations of."""
        return self.estimate.base

    def plot_intervals(self, *, ax: Any = None) -> Figure:
        """Draw the base parameters against the nominal model, with their 95 % intervals.

        Parameters
        ----------
        ax
            matplotlib's Axes to draw into: one, or two where the second shows how sure each is; default a figure of its own.
        """
        return figures_of(self)["intervals"](ax=ax)
