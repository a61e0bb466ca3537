"""What the two numbers of a held-out motion say together: the relative error, and the residual over the sensor's own noise.

Neither says enough alone. A residual at the noise is perfect only where the readings hold more than noise; a relative error
of one per cent may be a model that lacks something, seen by a quiet sensor, and still serve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arguments import call
from bayesid.validation.noise_floor import RESIDUALS
from bayesid.validation.prediction import TOLERATED, Prediction

#: Relative errors below which a prediction is close, and above which it predicts little.
CLOSE, POOR = 0.1, 0.3
#: A share of the error that a flexible model removes is worth looking for above this.
WORTH = 0.05
#: A channel that is wrong by more than this share of its signal is named.
_NAMED = 0.5


@dataclass(frozen=True)
class Judgement:
    """A verdict in words."""

    mood: str  # ``good``, ``fair`` or ``bad``
    text: str  # a clause that goes on after what was predicted


def judged(prediction: Prediction) -> Judgement:
    """The verdict on one motion that was not fitted."""
    error, white = prediction.relative_error, prediction.whitened_rms
    worst = int(np.argmax(prediction.nrmse))
    share = float(prediction.nrmse[worst])
    wrong = f"; {prediction.channel_names[worst]} is wrong by {100 * share:.0f} % of its signal" if share > _NAMED else ""
    if prediction.noise_source == RESIDUALS:
        # The only noise at hand is what the fit left over: it cannot tell model error from noise.
        mood = "fair" if error <= CLOSE else "bad"
        return Judgement(
            mood, f"the sensor's own noise is not known here, so nothing says how much of that is missing in the model{wrong}"
        )
    if white <= TOLERATED * prediction.expected_rms:
        if error > _NAMED:
            return Judgement("fair", "that is the sensor's noise: the readings of this motion hold little else, and prove little")
        if worse_than_nothing(share):
            name = prediction.channel_names[worst]
            text = (
                f"what is left is the sensor's noise ({white:.3g} times) in all channels together, but {name} is predicted "
                f"worse than by nothing at all: the error is {100 * share:.0f} % of its signal"
            )
            return Judgement("fair", text)
        where = f", though {prediction.channel_names[worst]} holds little but noise" if share > _NAMED else ""
        return Judgement("good", f"what is left is the sensor's noise ({white:.3g} times){where}")
    times = f"{white:.3g} times the sensor's noise"
    if error <= CLOSE:
        small = "" if wrong else ", small beside the readings"
        return Judgement("fair", f"what is left is {times}: something is missing in the model{small}{wrong}")
    if error <= POOR:
        return Judgement("fair" if not wrong else "bad", f"what is left is {times}: something is missing in the model{wrong}")
    return Judgement("bad", f"what is left is {times}: the model predicts this motion poorly{wrong}")


def worse_than_nothing(share: float) -> bool:
    """Whether a prediction adds error to a channel, so that zero would be a better one, to the digits that are printed.

    No noise excuses that: what is in the readings as noise is in their size, too.
    """
    return round(100 * share) > 100


def useless(predictions: Sequence[Prediction]) -> bool:
    """Whether no motion is predicted so well that a model is of use."""
    return bool(predictions) and all(p.relative_error > POOR and judged(p).mood == "bad" for p in predictions)


def still_predictable(prediction: Prediction) -> str:
    """What a flexible model of the joints' motion would still remove of the error, a sentence; empty where nothing tells."""
    gap = prediction.flexible
    if gap is None:
        return ""
    if not gap.certain and gap.removed > WORTH:
        share = f"{100 * gap.removed:.2g} +- {100 * gap.std:.1g} % of this error"
        return f"A flexible model of position, speed and acceleration would remove {share}, which is within chance."
    if not gap.certain:
        return "A flexible model of position, speed and acceleration finds nothing more that depends smoothly on them."
    missing = f"something predictable is missing (see `{call('diagnose')}`)"
    lack = missing if gap.removed > WORTH else "little predictable is missing"
    share = f"{100 * gap.removed:.2g} % of this error"
    return f"A flexible model of position, speed and acceleration would still remove {share}: {lack}."


def over_noise(prediction: Prediction) -> str:
    """The residual over the noise, and which noise that is."""
    if prediction.noise_source == RESIDUALS:
        return "not compared with the sensor's own noise, which is not known"
    return f"{prediction.whitened_rms:.3g} times the sensor's noise"
