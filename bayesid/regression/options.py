"""What the user chooses about a fit, the same for every verb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from bayesid.argument_types import explains_types
from bayesid.arguments import argument, names, with_given
from bayesid.errors import InputError, require_one_of
from bayesid.signals.filters import LowPass

#: Refusal of a verb, to be named, that was given a regression and choices that were made when its rows were.
NOT_FOR_REGRESSIONS = (
    "{}: channel, low_pass, motions, effects, static and bandwidth belong to an experiment; leave them out with a Regression"
)

#: What may be done with a stop-and-go run.
STATIC = ("motion", "joint")


@explains_types
@dataclass(frozen=True)
class FitOptions:
    """Which readings, motions and effects are fitted, and how readings become rows: what the verbs share.

    Pass it as ``options`` to `bayesid.identify`, `bayesid.compare`, `bayesid.sample`, `bayesid.bounds` and `bayesid.accuracy`;
    other verbs take it as far as they have such options. What is given one by one beside it stands in its place.

    Attributes
    ----------
    channel
        ``wrench``, ``torque`` or ``both``; None: the wrench where there is a sensor, else the torques.
    low_pass
        The two low-pass filters of [Liu1998]_, for rows without accelerations; None: rows from the smoothed trajectory.
    motions
        Which motions to fit; None: those with role ``identification``.
    effects
        Replaces ``[model] effects``; a list, or one text with commas between the names. None: those of the experiment.
    static
        What to do with a stop-and-go run of the same positions: ``motion`` subtracts it (equation 21 of
        [Liu1998]_), ``joint`` fits it along as static poses.
    bandwidth
        Of the joint motion [Hz]; None: chosen from the positions.
    """

    channel: str | None = None
    low_pass: LowPass | None = None
    motions: str | Sequence[str] | None = None
    effects: str | Sequence[str] | None = None
    static: str = "motion"
    bandwidth: float | None = None

    def __post_init__(self) -> None:
        """Take a string for one name; an `InputError` where ``static`` is neither ``motion`` nor ``joint``."""
        object.__setattr__(self, "motions", names(self.motions))
        effects = self.effects.split(",") if isinstance(self.effects, str) else self.effects  # as on the command line
        object.__setattr__(self, "effects", names(effects))
        require_one_of(self.static, STATIC, argument("static", self.static))

    def given(self) -> dict[str, object]:
        """What differs from what is usual, by name."""
        usual = FitOptions()
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != getattr(usual, f.name)}


def fit_options(
    options: FitOptions | None,
    channel: str | None = None,
    low_pass: LowPass | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    static: str | None = None,
    bandwidth: float | None = None,
) -> FitOptions:
    """The options with what was given one by one, that is not None, in their place."""
    return with_given(
        options or FitOptions(), channel=channel, low_pass=low_pass, motions=motions, effects=effects, static=static,
        bandwidth=bandwidth,
    )  # fmt: skip


def some_options(verb: str, options: FitOptions | None, **given: object) -> FitOptions:
    """The same as `fit_options` for a verb that has only those named here; an `InputError` where another one is set."""
    others = [name for name in (options or FitOptions()).given() if name not in given]
    if others:
        raise InputError(f"{verb} takes no {' and no '.join(others)}; of FitOptions it has {', '.join(given)}")
    return with_given(options or FitOptions(), **given)
