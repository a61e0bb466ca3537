"""The figures of results, as matplotlib figures; matplotlib is imported when one is drawn."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from bayesid.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesid.validation.prediction import Prediction


@functools.singledispatch
def figures_of(result: object) -> Mapping[str, Callable[..., Any]]:
    """Functions that draw a result's figures, by what they show; each verb registers its own, as for `files_of`.

    Raises
    ------
    TypeError
        No verb has registered this type of result.
    """
    raise TypeError(f"{type(result).__name__} has no figures: no verb in bayesid.workflows registers them")


class PlotsPredictions:
    """Figures of the predictions in ``fitted`` and ``validation``."""

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """Those of motions that were not fitted, then those of the fitted ones."""
        raise NotImplementedError(f"{type(self).__name__} does not say which predictions it has")

    def plot_predictions(self, motion: str | None = None) -> Figure:
        """Readings of a motion, measured and predicted, channel by channel.

        Parameters
        ----------
        motion
            Its name; default the first that was not fitted, or the first fitted one where there is none.

        Raises
        ------
        InputError
            There is no such motion.
        """
        return figures_of(self)["predictions"](self._predicted(motion))

    def plot_residuals(self, motion: str | None = None) -> Figure:
        """What was measured less what was predicted, in time and as a spectrum beside the noise; as `plot_predictions`."""
        return figures_of(self)["residuals"](self._predicted(motion))

    def _predicted(self, motion: str | None) -> Prediction:
        known = {p.motion: p for p in self.predictions}
        if motion is None:
            return next(iter(known.values()))
        if motion not in known:
            raise InputError(f"motion '{motion}' was not predicted; choose one of {', '.join(known)}")
        return known[motion]
