"""A fit beside one with what a diagnosis names in the readings: what the verbs `payload` and `calibrate` begin with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesid.design.payload.body import Quantity
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect, Term
from bayesid.errors import BayesidError
from bayesid.recordings.experiment import WRENCH_COLUMNS, Experiment
from bayesid.regression.options import FitOptions
from bayesid.results.diagnosis import Diagnosis
from bayesid.results.fitted_model import fitted_model
from bayesid.results.identification import Identification
from bayesid.results.payload import EffectBeside
from bayesid.workflows.diagnose import missing
from bayesid.workflows.identify import identify
from bayesid.workflows.progress import Clock, quiet

#: What tells more where poses are all that was recorded.
_POSES = "Take cables off, and come back to the first pose every few poses: what differs there is the sensor's drift."


@dataclass(frozen=True, eq=False)
class Explained:
    """Fits without and with what a diagnosis names."""

    first: Identification  # of the user's model
    best: Identification  # with the effects found; the same where there are none
    rivals: tuple[Identification, ...] = ()  # with effects in their place that explain the readings as well
    effects: tuple[EffectBeside, ...] = ()  # what was found
    diagnosis: Diagnosis | None = None  # all of it; None where it was left out or refused
    warnings: tuple[str, ...] = ()  # what the user should know

    @property
    def verdict(self) -> str | None:
        """The diagnosis' verdict; None without a diagnosis."""
        return None if self.diagnosis is None else self.diagnosis.verdict


def explain(
    experiment: Experiment, options: FitOptions, part_of_it: Callable[[Effect], bool], not_modelled: Callable[[Effect], bool],
    wanted: bool, seed: int, settings: Settings | None, clock: Clock,
) -> Explained:  # fmt: skip
    """Fit, diagnose if ``wanted``, and fit again with what was named.

    ``part_of_it`` says whether an effect is what was asked for under another name, ``not_modelled`` whether one is reported but
    kept out of the model.
    """
    clock("fit")
    first = identify(experiment, options=options, progress=None)
    if not wanted:
        return Explained(first, first)
    clock("what else is in the readings")
    try:
        found = missing(experiment, options, None, seed, settings, quiet)
    except BayesidError as error:
        return Explained(first, first, warnings=(f"The readings were not searched for anything else: {error}",))
    notes: tuple[str, ...] = ()
    if found.verdict in ("unknown", "named_in_part"):
        still = all(s.still for s in found.data.segments)
        advice = _POSES if still else found.next_experiment
        notes = (f"Something in the readings stays unexplained: the intervals do not count it. {advice}",)

    def known(effect: Effect) -> bool:  # or estimated anyway
        return part_of_it(effect) or not {effect.spec, effect.name}.isdisjoint(first.problem.effects)

    beside = [f for f in found.found if not known(f.term.effect)]
    terms = [f.term for f in beside if not not_modelled(f.term.effect)]
    effects = tuple(
        replace(_effect(f.term, f.std, [t for t, _ in f.rivals]), in_model=not not_modelled(f.term.effect)) for f in beside
    )
    if not terms:
        return Explained(first, first, (), effects, found, notes)
    clock("fit with it")
    best = _refit(found, options, terms)
    if best is None:
        names = ", ".join(e.spec for e in effects)
        notes = (*notes, f"The readings also hold {names}. A fit with it does not converge: the values are without it.")
        return Explained(first, first, (), tuple(replace(e, in_model=False) for e in effects), found, notes)
    effects = tuple(_as_fitted(e, best) for e in effects)
    rivals = []
    for f in beside:
        for rival, _ in f.rivals if f.term in terms else ():
            if not not_modelled(rival.effect):
                others = [rival if t is f.term else t for t in terms]
                rivals.append(_refit(found, options, [t for t in others if not known(t.effect)]))
    return Explained(first, best, tuple(r for r in rivals if r is not None), effects, found, notes)


def offset_of(fit: Identification) -> tuple[Quantity, ...]:
    """Constant reading of the sensor, ``fx`` … ``mz``, with intervals (6,); empty without one."""
    if fit.offset is None:
        return ()
    units = ("N",) * 3 + ("N m",) * 3
    return tuple(Quantity.of(*given) for given in zip(WRENCH_COLUMNS, units, *fit.offset, strict=True))


def joined(own: Sequence[Quantity], others: Sequence[Sequence[Quantity]]) -> tuple[Quantity, ...]:
    """Quantities with intervals that hold what other fits of the same readings say of each, too."""
    return tuple(q.joined(tuple(o[k] for o in others)) for k, q in enumerate(own))


def _refit(found: Diagnosis, options: FitOptions, terms: Sequence[Term]) -> Identification | None:
    """A fit with some effects from their values on; None where it fails."""
    experiment = found.data.experiment
    known = found.terms[: len(found.terms) - len(found.found)]
    effects, values = fitted_model(experiment, [*experiment.effects, *(t.effect.spec for t in terms)], [*known, *terms])
    try:
        return identify(replace(experiment, effects=effects, effect_values=values), options=options, progress=None)
    except BayesidError:
        return None


def _as_fitted(effect: EffectBeside, fit: Identification) -> EffectBeside:
    """An effect with the values that a fit with it in the model gives, as `calibrate` tells them."""
    for found in fit.effects():
        if (found["name"], found["where"]) == (effect.name, effect.where):
            stds = {k: np.nan if p["std"] is None else p["std"] for k, p in found["parameters"].items()}
            values = {k: (p["value"], stds[k], p["unit"]) for k, p in found["parameters"].items()}
            return replace(effect, values=values)
    return effect


def _effect(term: Term, std: np.ndarray, rivals: Sequence[Term]) -> EffectBeside:
    e = term.effect
    values = {name: (value, s, unit) for name, value, s, unit in term.with_std(std)}
    return EffectBeside(e.name, e.where, values, tuple(t.effect.spec for t in rivals))
