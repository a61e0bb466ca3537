"""What results around one estimate share, just made or read from a file: base parameters, and figures of predicted motions."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.drawing import Plots, figures_of
from bayesid.dynamics.base_parameters import BaseParameters
from bayesid.errors import InputError
from bayesid.estimators.parameters import HasParameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesid.validation.prediction import Prediction


def forwarded(path: str, text: str) -> Any:
    """A property that is documented by a text: what stands at a path of attributes below the result."""
    return property(attrgetter(path), doc=text)


class HasEstimate(HasParameters):
    """Base parameters of the estimate in ``estimate``, with their intervals."""

    names: tuple[str, ...] = forwarded("estimate.names", "Names of the base parameters (r,).")
    values: np.ndarray = forwarded("estimate.values", "Base parameters (r,).")
    std: np.ndarray = forwarded("estimate.std", "Standard deviations of the base parameters (r,).")
    low: np.ndarray = forwarded("estimate.low", "Lower ends of the base parameters' 95 % intervals (r,).")
    high: np.ndarray = forwarded("estimate.high", "Upper ends of the base parameters' 95 % intervals (r,).")
    covariance: np.ndarray | None = forwarded("estimate.covariance", "Covariance of the base parameters (r, r).")
    base: BaseParameters = forwarded("estimate.base", "What the base parameters are combinations of.")

    def plot_intervals(self, *, ax: Any = None) -> Figure:
        """Draw the base parameters against the nominal model, with their 95 % intervals.

        Parameters
        ----------
        ax
            matplotlib's Axes to draw into: one, or two where the second shows how sure each is; default a figure of its own.
        """
        return figures_of(self)["intervals"](ax=ax)


class PlotsPredictions(Plots):
    """Figures of the predictions in ``fitted`` and ``validation``: of the fitted motions, and of those that were not."""

    fitted: tuple[Prediction, ...]
    validation: tuple[Prediction, ...]

    def plot_predictions(
        self, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None
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

    plot = plot_predictions

    def plot_residuals(self, motion: str | None = None, *, channels: Sequence[str] | str | None = None, ax: Any = None) -> Figure:
        """Draw what was measured less what was predicted, in time and as a spectrum beside the noise; as `plot_predictions`.

        With one axis a channel, in time alone; with two, row by row, the spectrum stands in the second.
        """
        return figures_of(self)["residuals"](_predicted(self, motion), channels, ax)


def _predicted(result: PlotsPredictions, motion: str | None) -> Prediction:
    known = {p.motion: p for p in result.validation}
    if not known or motion not in (None, *known):  # fitted motions may have to be predicted first
        known |= {p.motion: p for p in result.fitted}
    if motion is None:
        return next(iter(known.values()))
    if motion not in known:
        raise InputError(f"motion '{motion}' was not predicted; choose one of {', '.join(known)}")
    return known[motion]
