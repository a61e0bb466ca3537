"""Warnings that the verbs share: what the predictions of unfitted motions say about a result."""

from __future__ import annotations

from collections.abc import Iterable

from bayesid.validation.headline import judged
from bayesid.validation.prediction import BAND, Prediction, band_error


def repeated_motion(prediction: Prediction) -> str:
    """That a motion repeats a fitted one, and so proves little."""
    own, other = prediction.motion, prediction.repeats
    return f"Motion '{own}' repeats the fitted motion '{other}': its error says little about others; validate on another."


def unpredicted(prediction: Prediction) -> list[str]:
    """That a motion is not predicted as well as a complete model would."""
    judgement = judged(prediction)
    if judgement.mood == "good":
        return []
    return [
        f"Motion '{prediction.motion}' is predicted with an error of {100 * band_error(prediction):.3g} % of the signal below "
        f"{BAND:.2g} Hz: {judgement.text}. `bayesid diagnose` looks for what is missing."
    ]


def incomplete(dispersion: float | None) -> str:
    """That the model lacks something, and what intervals do about it."""
    factor = (dispersion or 1.0) ** 0.5
    wider = f" ({factor:.2g} times as wide as noise alone makes them)" if factor > 1.0 else ""
    return (
        "Something is missing in the model: the fit scatters more between stretches of the recording, or between weightings, "
        f"than noise explains. Intervals count the scatter{wider}; for motions unlike the fitted ones they do not hold. "
        "`bayesid diagnose` looks for the missing effect."
    )


def listed(names: Iterable[str], shown: int) -> str:
    """The first of some names, and how many more there are."""
    every = list(names)
    return ", ".join(every[:shown]) + (f" and {len(every) - shown} more" if len(every) > shown else "")
