"""What results around one estimate share, just made or read from a file: base parameters, and figures of predicted motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bayesid.drawing import Plots, figures_of
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.estimators import Estimate
from bayesid.estimators.parameters import HasParameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesid.validation.prediction import Prediction


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


class HasPredictions(Protocol):
    """A result with predictions of motions."""

    @property
    def fitted(self) -> tuple[Prediction, ...]:
        """Predictions of the fitted motions."""
        ...

    @property
    def validation(self) -> tuple[Prediction, ...]:
        """Predictions of the motions that were not fitted."""
        ...


class PlotsPredictions(Plots):
    """Figures of the predictions in ``fitted`` and ``validation``."""

    def plot_predictions(
        self: HasPredictions, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None
    ) -> Figure:
        """Draw the readings of a motion, measured and predicted, channel by channel.

        Parameters
        ----------
        motion
            Its name; default the first that was not fitted, or the first fitted one where there is none.
        channels
            Which readings, such as ``["fx", "mz"]``; default all.
        ax
            matplotlib's Axes to draw into, one for each channel; default a figure of its own.

        Raises
        ------
        InputError
            There is no such motion or channel, or there are fewer or more axes than channels.
        """
        return figures_of(self)["predictions"](_predicted(self, motion), channels, ax)

    def plot(
        self: HasPredictions, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None
    ) -> Figure:
        """Draw measured and predicted readings; as `plot_predictions`."""
        return figures_of(self)["predictions"](_predicted(self, motion), channels, ax)

    def plot_residuals(
        self: HasPredictions, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None
    ) -> Figure:
        """Draw what was measured less what was predicted, in time and as a spectrum beside the noise; as `plot_predictions`.

        With one axis a channel, in time alone; with two, row by row, the spectrum stands in the second.
        """
        return figures_of(self)["residuals"](_predicted(self, motion), channels, ax)


def _predicted(result: HasPredictions, motion: str | None) -> Prediction:
    known = {p.motion: p for p in result.validation}
    if not known or motion not in (None, *known):  # fitted motions may have to be predicted first
        known |= {p.motion: p for p in result.fitted}
    if motion is None:
        return next(iter(known.values()))
    if motion not in known:
        raise InputError(f"motion '{motion}' was not predicted; choose one of {', '.join(known)}")
    return known[motion]
