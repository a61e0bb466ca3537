"""Gauss-Newton steps with step control, for any model that can be linearised where it stands.

A step is tried, and tried again more cautiously while it makes the cost larger or not a number (the trial diverged); when
no caution helps, the fit stops where it is. What caution means is the model's: a share of the step [Deuflhard2011]_, or
damping [Levenberg1944]_, [Marquardt1963]_.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

State = TypeVar("State")


@dataclass(frozen=True)
class Linearised(Generic[State]):
    """A model linearised at a state.

    Attributes
    ----------
    cost
        What is minimised, at the state.
    trial
        From the caution: the state after a step, and its cost. States are new objects: a refused one leaves no trace.
    """

    cost: float
    trial: Callable[[float], tuple[State, float]]


@dataclass(frozen=True)
class StepControl:
    """How steps are accepted, and how cautious the next one is.

    Attributes
    ----------
    steps, trials
        At most so many steps, and trials of each.
    first
        Caution of the first trial.
    refused, accepted
        From the caution of a trial that was refused, or accepted: that of the next.
    tolerance
        From the cost at the state: a trial may be larger by this.
    settled
        Stop after an accepted step that gains less than this.
    """

    steps: int
    trials: int
    first: float
    refused: Callable[[float], float]
    accepted: Callable[[float], float]
    tolerance: Callable[[float], float]
    settled: float = float("-inf")


def minimise(state: State, linearise: Callable[[State], Linearised[State] | None], control: StepControl) -> State:
    """Step until nothing is gained any more.

    Parameters
    ----------
    state
        Where to start.
    linearise
        The model at a state; None where no step is worth taking: it has settled, or cannot be linearised.
    control
        Step control.
    """
    caution = control.first
    for _ in range(control.steps):
        model = linearise(state)
        if model is None:
            break
        limit = model.cost + control.tolerance(model.cost)
        for _ in range(control.trials):
            trial, cost = model.trial(caution)
            if cost <= limit:
                break
            caution = control.refused(caution)
        else:
            break
        state, caution = trial, control.accepted(caution)
        if model.cost - cost < control.settled:
            break
    return state
