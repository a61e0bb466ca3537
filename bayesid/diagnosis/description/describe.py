"""The unknown, described: a draft effect of a few terms, if motions that it was not chosen on prove it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesid.diagnosis.candidates import Library
from bayesid.diagnosis.data import DiagnosisData
from bayesid.diagnosis.description.candidates import CandidateTerm, candidates
from bayesid.diagnosis.description.choose import Chosen, choose
from bayesid.diagnosis.description.columns import halves, parts_of, ranges_of
from bayesid.diagnosis.description.shapes import Kind, Shape, unit_of_variable
from bayesid.diagnosis.fit import Fit, differs_from_zero, fit, squared_distance
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.validation import Gap, validate
from bayesid.effects import Effect, Term

NAME = "draft"


def draft_table(candidates: Sequence[CandidateTerm], names: Sequence[str], sliding: Collection[int] = ()) -> dict[str, Any]:
    """Formulas by the channels' names and the amplitudes to be estimated, ``c1`` ..., in the order of `amplitudes`.

    ``sliding`` are the indices of the joints that slide, for the units.
    """
    sums: dict[str, list[str]] = {}
    parameters: dict[str, dict[str, Any]] = {}
    for candidate in candidates:
        for channel in candidate.channels:
            for text in candidate.shape.texts:
                key = f"c{len(parameters) + 1}"
                sums.setdefault(names[channel], []).append(f"{key} * {text}")
                parameters[key] = {"unit": unit_of(names[channel], candidate.shape, sliding)}
    texts = {reading: " + ".join(parts) for reading, parts in sums.items()}
    return {"summary": "what no effect of the library explains, described", **texts, "parameters": parameters}


def unit_of(reading: str, shape: Shape, sliding: Collection[int]) -> str:
    """Unit of the amplitude of a shape in a reading, with the indices of the joints that slide."""
    own = unit_of_variable(reading, sliding)
    return " per ".join([own, *(u for f in shape.products[0] if (u := f.unit(sliding)))])


def draft_effect(data: DiagnosisData, table: dict[str, Any]) -> Effect:
    """The draft as an effect beside those that there are."""
    library = data.experiment.library
    name = next(n for k in range(1, 1000) if (n := NAME if k == 1 else f"{NAME}{k}") not in library.classes)
    made = library.with_expressions({name: table}, data.robot.n, "draft")
    (effect,) = made.places(name, data.robot.joint_names, data.channels.names, data.experiment.gear_ratio)
    return effect


@dataclass(frozen=True)
class Reading:
    """A term as the rules below look at it: its sorts of functions, how many joints, whether of a torque, of its own state."""

    kinds: frozenset[Kind]
    joints: int
    torque: bool
    own: bool


#: What a form suggests, and when; all that hold are said, the first ones first.
_RULES: tuple[tuple[Callable[[Reading], bool], str], ...] = (
    (lambda r: "oscillation" in r.kinds, "a vibration from outside: a motor, a pump or a fan nearby, the mains or a loose base"),
    (lambda r: "memory" in r.kinds and r.torque and r.own, "friction with presliding, or the hysteresis of a harmonic drive"),
    (lambda r: "memory" in r.kinds and not r.own, "a hose or cable that drags after another joint"),
    (lambda r: "memory" in r.kinds and not r.torque and r.own, "hysteresis of the sensor or of what it is mounted on"),
    (lambda r: "time" in r.kinds and r.kinds & {"speed", "direction"} != set(), "friction that changes as the drive warms up"),
    (lambda r: "time" in r.kinds and not r.torque, "a sensor that warms up or was not zeroed, or a mount that creeps"),
    (lambda r: "time" in r.kinds and r.torque, "a drive or its current sensor that warms up"),
    (lambda r: "limit" in r.kinds, "a reading that is clipped, an amplifier that saturates, or a stop that is touched"),
    (lambda r: "load" in r.kinds and "direction" in r.kinds, "friction that grows with the load of the gear"),
    (lambda r: "load" in r.kinds and r.joints > 0 and not r.own, "cross-talk between axes that depends on the posture"),
    (lambda r: r.kinds == {"load"} and not r.torque, "a sensor that is not linear: calibration, overload, a bent flexure"),
    (lambda r: r.kinds == {"load"} and r.torque, "a motor constant that saturates, or gears that are less efficient at load"),
    (lambda r: "load" in r.kinds and r.joints > 0 and r.own, "a gain that depends on posture or speed"),
    (lambda r: {"ripple", "direction"} <= r.kinds, "friction that varies over a turn: a bent shaft, a bearing, a seal"),
    (lambda r: r.torque and r.kinds & {"ripple", "direction"} == {"ripple"}, "cogging of the motor, gears out of true"),
    (lambda r: "ripple" in r.kinds and not r.torque, "an encoder or gear that runs out of true"),
    (lambda r: r.joints > 1, "a coupling of joints: a cable or hose between links, or transmissions that turn one another"),
    (lambda r: r.kinds & {"speed", "direction"} != set() and "position" in r.kinds, "friction that depends on posture"),
    (lambda r: r.kinds == {"position"} and r.own, "a spring, a gravity compensator, a tether or a cable that is bent"),
    (lambda r: r.kinds == {"position"} and not r.own, "a tether, hose or cable that pulls with the posture"),
    (lambda r: r.kinds <= {"speed", "direction"} and r.own, "friction of another curve than the library's: seals, grease"),
    (lambda r: r.kinds <= {"speed", "direction"} and not r.own, "drag, or a force that follows another joint's motion"),
    (lambda r: "acceleration" in r.kinds, "inertia that is not in the links, or readings and positions at different times"),
)
_MOST = 2


def may_be(candidate: CandidateTerm, names: Sequence[str]) -> tuple[str, ...]:
    """Physical causes that have the form of a term in channels of these names, at most two."""
    shape = candidate.shape
    mine = {names[c] for c in candidate.channels}
    joints = {v.lstrip("qvadirtu") for v in shape.variables if v != "t" and v[-1].isdigit()}
    torque = all(name.startswith("tau") for name in mine)
    own = joints <= {name[3:] for name in mine} if torque else not joints
    seen = Reading(shape.kinds, len(joints), torque, own)
    found = tuple(text for holds, text in _RULES if holds(seen))[:_MOST]
    return found or ("none of the usual causes has such a form",)


#: A joint that turns less [rad or m] tells nothing of what goes with it.
_MOVES = 1e-2


@dataclass(frozen=True, eq=False)
class Description:
    """A draft effect for what no effect of the library explains: a description, not a name."""

    term: Term  # the draft with its amplitudes
    std: np.ndarray  # their standard deviations
    table: dict[str, Any]  # its formulas, as in ``[model.expressions]``
    terms: tuple[Chosen, ...]  # what was chosen, one after the other
    causes: tuple[tuple[str, ...], ...]  # what each may be physically
    start: Fit  # the model that it is beside
    fit: Fit  # that model with the draft
    gap: Gap | None  # on motions that were never fitted, without and with the draft; None where there are none
    candidates: int  # how many were tried


def stands_alone(description: Description | None) -> bool:
    """Whether it closes nearly all of what effects that were found leave, and beside it none of these differs from zero."""
    if description is None or description.gap is None:
        return False
    fitted, data = description.fit, description.fit.projector.data
    found = range(len(data.terms), len(description.start.terms))
    closes = description.gap.closed > data.settings.nearly_all
    return closes and not any(differs_from_zero(fitted, k, _dispersion(fitted)) for k in found)


def describe(base: Fit, starts: Sequence[Fit], library: Library | None, seed: int = 0) -> Description | None:
    """The best draft beside one of several models; None where no other half, or no unseen motion, confirms one.

    Candidates (`bayesid.diagnosis.description.candidates`) are whitened like readings, what links and effects found explain is
    projected out, and they are chosen greedily by log evidence on half of the motions (of a single motion: on intervals of
    time). With amplitudes of that half each must close a part of what is left on the other half, and the whole draft, fitted
    exactly to all, a part of the gap on validation motions: lower ends of bootstrap intervals above nothing.

    The draft must improve the user's model ``base`` as well. Of several ``starts``, a later one must leave clearly less to be
    preferred; ``library`` says which effects the draft cannot be told from.
    """
    data = base.projector.data
    moving = [s for s in data.segments if not s.still]
    ranges = ranges_of(parts_of(data, moving, base))
    joints = [j for j in range(data.robot.n) if ranges(f"q{j + 1}").span > _MOVES]
    pool = candidates(data.channels.names, joints, ranges, max(float(s.frequencies[-1]) for s in moving))
    best: Description | None = None
    for start in starts:
        if best is not None and best.gap is not None and best.gap.closed > data.settings.nearly_all:
            break  # nothing worth describing is left
        found = _beside(base, start, pool, library, seed)
        if found is not None and (best is None or _left(found) < 0.8 * _left(best)):
            best = found
    return best


def _left(description: Description) -> float:
    """Mean square that a description leaves: on unseen motions, or for want of any on the fitted ones."""
    d = description
    return d.fit.chi2 / d.fit.projector.rows if d.gap is None else float(d.gap.after) ** 2


def _beside(base: Fit, start: Fit, pool: Sequence[CandidateTerm], library: Library | None, seed: int) -> Description | None:
    """A draft beside one model."""
    data: DiagnosisData = start.projector.data
    settings = data.settings
    both = halves(start)
    if any(half.count == 0 for half in both):
        return None
    known = library if library is not None and library.projector is start.projector else None
    # Without unseen motions the other half is the only witness.
    least = 0.0 if data.unseen else 1.0 - settings.nearly_all
    # Something may show in one half only; then the other cannot confirm it, but terms chosen there may hold here.
    for first, second in (both, both[::-1]):
        chosen = choose(first, second, pool, settings, known, seed, least)
        while chosen:
            found = _drafted(start, chosen, len(pool), seed)
            seen = _seen(found, settings)
            if seen and all(_worthwhile(gap, settings) for gap in (found.gap, _gap(base, found.fit, seed))):
                return found
            chosen = chosen[:-1]
    return None


def _drafted(start: Fit, chosen: tuple[Chosen, ...], tried: int, seed: int) -> Description:
    """The draft fitted exactly, and what it does on unseen motions."""
    projector, data = start.projector, start.projector.data
    terms = [c.candidate for c in chosen]
    table = draft_table(terms, data.channels.names, np.flatnonzero(data.robot.prismatic).tolist())
    effect = draft_effect(data, table)
    fitted = fit(projector, (*start.terms, Term(effect, (0.0,) * len(effect.parameters))), start)
    known = len(start.terms)
    own = [k for k, (i, _) in enumerate(fitted.free) if i == known]
    std = np.sqrt(_dispersion(fitted) * np.diag(fitted.covariance)[own])
    return Description(
        term=fitted.terms[known], std=std, table=table, terms=chosen,
        causes=tuple(may_be(c, data.channels.names) for c in terms), start=start, fit=fitted,
        gap=_gap(start, fitted, seed), candidates=tried,
    )  # fmt: skip


def _seen(found: Description, settings: Settings) -> bool:
    """Whether the amplitudes of every term stand out of their covariance: links that are not known may stand in for one."""
    known, at = len(found.start.terms), 0
    own = [k for k, (i, _) in enumerate(found.fit.free) if i == known]
    for chosen in found.terms:
        mine = slice(at, at := at + len(chosen.candidate.channels) * len(chosen.candidate.shape.texts))
        covariance = found.fit.covariance[np.ix_(own[mine], own[mine])] * _dispersion(found.fit)
        if squared_distance(np.array(found.term.values)[mine], covariance) < settings.detected**2:
            return False
    return True


def _gap(before: Fit, after: Fit, seed: int) -> Gap | None:
    """The gap on unseen motions, with one model and with another; None where there are none."""
    return validate(after.projector, before, after, _dispersion(after), seed)


def _dispersion(fitted: Fit) -> float:
    """Mean square of what a model leaves on the fitted motions, at least 1."""
    return max(fitted.chi2 / fitted.projector.rows, 1.0)


def _worthwhile(gap: Gap | None, settings: Settings) -> bool:
    """Whether unseen motions, if there are any, say that a part of the gap is closed."""
    return gap is None or (gap.closed_low > 0.0 and gap.closed >= 1.0 - settings.nearly_all)
