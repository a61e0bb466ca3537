"""The figures of results, as matplotlib figures; matplotlib is imported when one is drawn."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

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


class HasPredictions(Protocol):
    """A result with predictions of motions."""

    @property
    def fitted(self) -> tuple[Prediction, ...]:
        """Those of the fitted motions."""
        ...

    @property
    def validation(self) -> tuple[Prediction, ...]:
        """Those of the others."""
        ...


class PlotsPredictions:
    """Figures of the predictions in ``fitted`` and ``validation``."""

    def plot_predictions(self: HasPredictions, motion: str | None = None) -> Figure:
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
        return figures_of(self)["predictions"](_predicted(self, motion))

    def plot_residuals(self: HasPredictions, motion: str | None = None) -> Figure:
        """What was measured less what was predicted, in time and as a spectrum beside the noise; as `plot_predictions`."""
        return figures_of(self)["residuals"](_predicted(self, motion))


def _predicted(result: HasPredictions, motion: str | None) -> Prediction:
    known = {p.motion: p for p in result.validation}
    if not known or motion not in (None, *known):  # fitted motions may have to be predicted first
        known |= {p.motion: p for p in result.fitted}
    if motion is None:
        return next(iter(known.values()))
    if motion not in known:
        raise InputError(f"motion '{motion}' was not predicted; choose one of {', '.join(known)}")
    return known[motion]
