"""All that is said about the identifiability of a robot's parameters on some motions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesid.design.advice import Advice
from bayesid.design.identifiability import SetReport
from bayesid.design.separability import Separation


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiabilityFindings:
    """What motions can and cannot determine, for each sensor set.

    Attributes
    ----------
    name
        Of the experiment, robot or regression.
    source
        ``recorded``, ``planned``, or ``regression`` for rows of one's own.
    motions
        Their names and what they last [s]; 0 for poses.
    still
        Names of joints that stand still in all of them.
    sensor_sets
        One report each, in the order of `bayesid.design.sensor_sets.SENSOR_SETS`.
    main
        The one whose readings an estimate would use by default.
    advice
        What would make a difference, most important first.
    separations
        How well effects are told apart, by the name of the sensor set; empty where nobody asked.
    warnings
        What the user should know, most important first.
    seconds
        Run time by stage.
    """

    name: str
    source: str
    motions: Mapping[str, float]
    still: tuple[str, ...]
    sensor_sets: tuple[SetReport, ...]
    main: SetReport
    advice: tuple[Advice, ...] = ()
    separations: Mapping[str, tuple[Separation, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
