"""What the user chooses about a fit, the same for every verb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bayesid.signals.filters import LowPass

#: Refusal of a verb, to be named, that was given a regression and choices that were made when its rows were.
NOT_FOR_REGRESSIONS = (
    "{}: channel, low_pass, motions, effects, static and bandwidth belong to an experiment; leave them out with a Regression"
)


@dataclass(frozen=True)
class FitOptions:
    """Which readings, motions and effects are fitted, and how readings become rows.

    Attributes
    ----------
    channel
        ``wrench``, ``torque`` or ``both``; None: the wrench where there is a sensor, else the torques.
    low_pass
        The two low-pass filters of [Liu1998]_, for rows without accelerations; None: rows from the smoothed trajectory.
    motions
        Which motions to fit; None: those with role ``identification``.
    effects
        Replaces ``[model] effects``; None: those.
    static
        What to do with a stop-and-go run of the same positions: ``motion`` subtracts it (equation 21 of
        [Liu1998]_), ``joint`` fits it along as static poses.
    bandwidth
        Of the joint motion [Hz]; None: chosen from the positions.
    """

    channel: str | None = None
    low_pass: LowPass | None = None
    motions: Sequence[str] | None = None
    effects: Sequence[str] | None = None
    static: str = "motion"
    bandwidth: float | None = None
