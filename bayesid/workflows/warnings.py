"""Warnings that the verbs share: what the predictions of unfitted motions say about a result."""

from __future__ import annotations

from collections.abc import Iterable

from bayesid.validation.prediction import Prediction


def repeated_motion(prediction: Prediction) -> str:
    """That a motion repeats a fitted one, and so proves little."""
    own, other = prediction.motion, prediction.repeats
    return f"Motion '{own}' repeats the fitted motion '{other}': its error says little about other motions."


def listed(names: Iterable[str], shown: int) -> str:
    """The first of some names, and how many more there are."""
    every = list(names)
    return ", ".join(every[:shown]) + (f" and {len(every) - shown} more" if len(every) > shown else "")
