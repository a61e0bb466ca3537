"""The verb ``payload``: what hangs at the flange."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

from bayesid.arguments import argument
from bayesid.design.payload.body import BodyKnowledge, Quantity
from bayesid.design.payload.knowledge import (
    carrying_joint,
    from_nominal,
    from_reference,
    from_sensor,
    in_frame,
    weighed_alone,
)
from bayesid.diagnosis.settings import Settings
from bayesid.drawing import Figures, figures_of
from bayesid.effects import Term
from bayesid.effects.bodies import body_of
from bayesid.errors import BayesidError, InputError
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, some_options
from bayesid.regression.readings import default_channel
from bayesid.results.diagnosis import Diagnosis
from bayesid.results.files import Files, files_of, strict
from bayesid.results.fitted_model import fitted_model
from bayesid.results.identification import Identification
from bayesid.results.payload import FoundEffect, PayloadEstimate
from bayesid.results.text import DASH, number, percent, with_half
from bayesid.robot.urdf_file import read_urdf
from bayesid.rounding import HALF
from bayesid.workflows.diagnose import diagnose
from bayesid.workflows.identify import identify
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.warnings import contradictions, impossible_signs

#: Effects that are another body on a link: on the one that carries the payload they are the payload.
_BODIES = ("payload", "inertia_error")
#: A body's farthest part is assumed to be this many times as far from its centre of mass as that is from the flange, and at
#: least so far [m].
_EXTENT, _SMALLEST_EXTENT = 2.0, 0.1
_COMMON_GAIN = (
    "A sensor whose axes all read too much by one share looks like a heavier payload: the mass is as right as the sensor's gain; "
    "a known mass hung on tells."
)


@dataclass(frozen=True, eq=False)
class _Asked:
    """What was asked for, once it is read."""

    experiment: Experiment
    options: FitOptions
    diagnosis: bool
    seed: int
    settings: Settings | None
    clock: Clock


@dataclass(frozen=True, eq=False)
class _Found:
    """What one source says of the payload, in the frame of the body that carries it."""

    body: int
    known: BodyKnowledge
    plain: BodyKnowledge
    rivals: tuple[BodyKnowledge, ...] = ()
    effects: tuple[FoundEffect, ...] = ()
    verdict: str | None = None
    offset: np.ndarray | None = None
    evidence: float | None = None
    share: float | None = None
    sentences: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@shows_progress
def payload(
    experiment: Experiment | str | Path,
    channel: str | None = None,
    *,
    reference: Experiment | str | Path | None = None,
    options: FitOptions | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    joint: str | None = None,
    frame: str | None = None,
    extent: float | None = None,
    diagnosis: bool = True,
    seed: int = 0,
    settings: Settings | None = None,
    progress: Progress | None = SHOWN,
) -> PayloadEstimate:
    """Mass, centre of mass and inertia of what the last link carries, each with its interval and whether the readings show it.

    A force/torque sensor in the wrist weighs it alone: poses at rest suffice for mass and centre of mass. Joint torques, or a
    sensor under the base, tell it from the arm by a recording without it, or by a nominal model whose trust is stated. A
    diagnosis says what else is in the readings, such as cross-talk, a tilted base or a cable, and takes it into the model.

    Parameters
    ----------
    experiment
        With the payload; loaded, or its folder.
    channel
        ``wrench``, ``torque`` or ``both``; default as for `bayesid.identify`.
    reference
        The same robot without the payload.
    options
        ``channel``, ``motions`` and ``effects`` at once; those that are given beside it stand in its place.
    motions
        Names of those to fit; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    joint
        Joint whose link carries it; default the last of the chain, or the sensor's.
    frame
        URDF link in whose frame it is told; default the flange, where the URDF has one, else the link that carries it.
    extent
        No part of the payload is farther from its centre of mass [m]: bounds an inertia that the readings do not show.
    diagnosis
        Whether to look for what else is in the readings.
    seed
        Of everything random in the diagnosis.
    settings
        Thresholds of the diagnosis other than the usual ones.
    progress
        Called with the name of every stage; default: shown where it takes over two seconds; None: never.

    Returns
    -------
    payload
        With `PayloadEstimate.export` for controllers.

    Raises
    ------
    InputError
        Bad input, or nothing tells the payload from the arm: neither a sensor that carries it alone, nor a reference, nor a
        trust in the nominal model.
    """
    chosen = some_options("payload", options, channel=channel, motions=motions, effects=effects)
    if extent is not None and not (np.isfinite(extent) and extent > 0.0):
        raise InputError(f"{argument('extent', extent)}: give a length in metres above 0")
    clock = Clock(progress)
    clock("reading")
    experiment = as_experiment(experiment)
    read = chosen.channel or default_channel(experiment)
    if chosen.effects is not None:
        experiment = replace(experiment, effects=tuple(chosen.effects))
    asked = _Asked(experiment, FitOptions(channel=read, motions=chosen.motions), diagnosis, seed, settings, clock)
    carried = weighed_alone(experiment, read)
    sensor = experiment.sensor
    if reference is not None:
        before = as_experiment(reference)
        source, detail = "reference", before.name
        found = _since(asked, before, joint)
    elif carried is not None:
        assert sensor is not None
        source, detail = "sensor", str(sensor.joint)
        found = _weighed(asked, carried)
    else:
        trust = experiment.inertia_rel_std
        if trust is None:
            raise InputError(
                "a payload looks like a heavier last link: name a recording without it "
                f"({argument('reference')}), or state in experiment.toml how far the URDF's inertias are trusted ([robot] "
                "inertia_rel_std = 0.1)"
            )
        source, detail = "nominal", percent(trust, 2)
        found = _beside_nominal(asked, joint, trust)
    clock("result")
    known, name = in_frame(found.known.possible, experiment, found.body, frame)
    plain, _ = in_frame(found.plain.possible, experiment, found.body, frame)
    others = [in_frame(k.possible, experiment, found.body, frame)[0] for k in found.rivals]
    mass = known.mass.joined(tuple(k.mass for k in others))
    centre = _joined(known.centre, [k.centre for k in others])
    moments = _joined(known.inertia, [k.inertia for k in others])
    reach = [abs(q.value) for q in centre if q.shown]
    assumed = max(_EXTENT * float(np.linalg.norm(reach)), _SMALLEST_EXTENT)
    urdf = read_urdf(experiment.robot.urdf)
    carrier = experiment.robot.body_names[found.body]
    result = PayloadEstimate(
        name=experiment.name, channel=read, source=source, source_detail=detail, carrier=carrier, frame=name, body=known,
        mass=mass, centre=centre, inertia=moments, extent=assumed if extent is None else float(extent),
        extent_assumed=extent is None,
        plain=(plain.mass, *plain.centre), effects=found.effects, verdict=found.verdict, offset=found.offset,
        sensor_frame=urdf.joints[detail].child if source == "sensor" else None,
        centre_in_sensor=_in_sensor(found, experiment) if source == "sensor" else None,
        world=next(link for link in _links(urdf.root) if link not in {j.child for j in urdf.joints.values()}),
        gravity=experiment.robot.gravity, evidence=found.evidence, nominal_share=found.share, sentences=found.sentences,
        warnings=found.warnings, seconds=clock.stop(),
    )  # fmt: skip
    return replace(result, sentences=(*_not_shown(result), *result.sentences))


@figures_of.register
def _(result: PayloadEstimate) -> Figures:
    from bayesid.report.payload import payload_figure

    return {"payload": partial(payload_figure, result)}


@files_of.register
def _(result: PayloadEstimate) -> Files:
    """``payload.json``, a file for every controller, and the report."""
    from bayesid.report.payload import payload_report

    others = {name: partial(_write, text) for name, text in result.exports().items()}
    return Files({"payload.json": strict(result.to_dict())}, others, payload_report(result))


def _write(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")


def _weighed(asked: _Asked, body: int) -> _Found:
    """By a sensor that carries it alone."""
    first, plain, found = _fitted(asked, body, lambda fit: from_sensor(fit.problem, fit.estimate, body))
    last = found.fit
    offset = None if last.offset is None else np.array(last.offset)
    sentences = [] if offset is None else [_offset_sentence(offset)]
    return _Found(
        body, found.known, plain, found.rivals, found.effects, found.verdict, offset,
        sentences=(*sentences, *_beside(found.effects, plain), _COMMON_GAIN),
        warnings=(*impossible_signs(last.estimate, last.problem), *found.warnings, *contradictions(first.agreements)),
    )  # fmt: skip


def _beside_nominal(asked: _Asked, joint: str | None, trust: float) -> _Found:
    """Beside a nominal model that is trusted so far."""
    body = body_of(asked.experiment.robot, carrying_joint(asked.experiment.robot, joint))
    first, plain, found = _fitted(asked, body, lambda fit: from_nominal(fit.problem, fit.estimate, body, trust)[0])
    share = from_nominal(found.fit.problem, found.fit.estimate, body, trust)[1]
    says = (
        f"The answer depends on the nominal model: {percent(share, 2)} of the mass's variance is its. A recording without the "
        f"payload ({argument('reference')}) does without it."
        if share > 0.5
        else f"The nominal model contributes {percent(share, 2)} of the mass's variance."
    )
    return _Found(
        body, found.known, plain, found.rivals, found.effects, found.verdict, share=share,
        sentences=(says, *_beside(found.effects, plain)), warnings=(*found.warnings, *contradictions(first.agreements)),
    )  # fmt: skip


def _since(asked: _Asked, before: Experiment, joint: str | None) -> _Found:
    """What changed since a recording without it."""
    asked.clock("what changed since the reference")
    experiment = asked.experiment
    changes = diagnose(
        experiment, options=asked.options, reference=before, seed=asked.seed, settings=asked.settings, progress=None
    )
    found = changes.comparison
    at = carrying_joint(experiment.robot, joint)
    known, evidence = from_reference(found, at)
    here = f"joint{at + 1}"
    named = any(c.change.name == "payload" and c.change.where == here for c in found.changes)
    others = tuple(
        FoundEffect(
            c.change.name, c.change.where, {v.name: (v.value, v.std, v.unit) for v in c.values},
            tuple(f"{h.name}@{h.where}" for h, _ in c.found.rivals),
        )
        for c in found.changes
        if (c.change.name, c.change.where) != ("payload", here)
    )  # fmt: skip
    warnings = []
    if not named:
        what = f"what changed is {', '.join(e.spec for e in others)}" if others else "nothing that changed is named"
        warnings.append(
            f"The comparison does not name a payload at {here} (log evidence {number(evidence, 3)}, needed "
            f"{number(found.settings.accept, 3)}): {what}. The intervals tell which payload these recordings would not show."
        )
    rivals = [f"{h.name}@{h.where}" for c in found.changes if c.change.where == here for h, _ in c.found.rivals]
    if named and rivals:
        warnings.append(f"These recordings do not tell the payload from {', '.join(rivals)}.")
    said = [f"Since {before.name} a payload at {here} came: log evidence {number(evidence, 3)}."] if named else []
    if named and others:
        said.append(f"Beside it changed: {', '.join(e.spec for e in others)}.")
    if changes.verdict in ("unknown", "named_in_part"):
        warnings.append("More changed since the reference than is named; the intervals do not count it.")
    body = body_of(found.reference.robot, at)
    return _Found(
        body, known, known, effects=others, verdict=changes.verdict, evidence=evidence, sentences=tuple(said),
        warnings=tuple(warnings),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Explained:
    """The best fit with what a diagnosis names beside the payload, what it says, and what those say that do as well."""

    fit: Identification
    known: BodyKnowledge
    rivals: tuple[BodyKnowledge, ...] = ()
    effects: tuple[FoundEffect, ...] = ()
    verdict: str | None = None
    warnings: tuple[str, ...] = ()


def _fitted(
    asked: _Asked, body: int, read: Callable[[Identification], BodyKnowledge]
) -> tuple[Identification, BodyKnowledge, _Explained]:
    """A fit of the user's model, what it says of the payload, and the same with what a diagnosis names beside it."""
    asked.clock("fit")
    first = identify(asked.experiment, options=asked.options, progress=None)
    plain = read(first)
    if not asked.diagnosis:
        return first, plain, _Explained(first, plain)
    asked.clock("what else is in the readings")
    experiment, options = asked.experiment, asked.options
    # What a sensor carries alone is free: its nominal values are mostly placeholders, and an error of theirs is no fault.
    alone = weighed_alone(experiment, str(options.channel)) is not None
    free = replace(experiment, inertia_rel_std=None) if alone else experiment
    try:
        found = diagnose(free, options=options, seed=asked.seed, settings=asked.settings, progress=None)
    except BayesidError as error:
        warning = f"The readings were not searched for anything beside the payload: {error}"
        return first, plain, _Explained(first, plain, warnings=(warning,))
    told: tuple[str, ...] = ()
    if found.verdict in ("unknown", "named_in_part"):
        told = (f"Something in the readings stays unexplained: the intervals do not count it. {found.next_experiment}",)
    here = f"joint{int(experiment.robot.body_joint[body]) + 1}"

    def is_payload(term: Term) -> bool:  # or what is estimated anyway
        e = term.effect
        return (e.name in _BODIES and e.where == here) or not {e.spec, e.name}.isdisjoint(first.problem.effects)

    beside = [f for f in found.found if not is_payload(f.term)]
    if not beside:
        return first, plain, _Explained(first, plain, verdict=found.verdict, warnings=told)
    asked.clock("fit with it")
    terms = [f.term for f in beside]
    effects = tuple(_effect(f.term, f.std, [t for t, _ in f.rivals]) for f in beside)
    last = _refit(found, options, terms)
    known = None if last is None else read(last)
    if last is None or known is None or _hides(known, plain):
        names = ", ".join(e.spec for e in effects)
        why = "does not converge" if last is None else "leaves the payload open"
        told = (*told, f"The readings also hold {names}. A fit with it {why}: the values are without it.")
        effects = tuple(replace(e, in_model=False) for e in effects)
        return first, plain, _Explained(first, plain, effects=effects, verdict=found.verdict, warnings=told)
    rivals = []
    for k, f in enumerate(beside):
        for rival, _ in f.rivals:
            other = first if is_payload(rival) else _refit(found, options, [*terms[:k], rival, *terms[k + 1 :]])
            if other is not None and not _hides(said := read(other), plain):
                rivals.append(said)
    return first, plain, _Explained(last, known, tuple(rivals), effects, found.verdict, told)


def _hides(known: BodyKnowledge, plain: BodyKnowledge) -> bool:
    """Whether mass or centre of mass are not shown that another model shows."""
    pairs = zip((known.mass, *known.centre), (plain.mass, *plain.centre), strict=True)
    return any(other.shown and not q.shown for q, other in pairs)


def _refit(found: Diagnosis, options: FitOptions, terms: Sequence[Term]) -> Identification | None:
    """A fit with some effects from their values on; None where it fails."""
    experiment = found.data.experiment
    known = found.terms[: len(found.terms) - len(found.found)]
    effects, values = fitted_model(experiment, [*experiment.effects, *(t.effect.spec for t in terms)], [*known, *terms])
    try:
        return identify(replace(experiment, effects=effects, effect_values=values), options=options, progress=None)
    except BayesidError:
        return None


def _effect(term: Term, std: np.ndarray, rivals: Sequence[Term]) -> FoundEffect:
    e = term.effect
    values = {n: (v, float(s), u) for n, v, s, u in zip(e.parameters, term.values, std, e.units, strict=True)}
    return FoundEffect(e.name, e.where, values, tuple(t.effect.spec for t in rivals))


def _joined(own: Sequence[Quantity], others: Sequence[Sequence[Quantity]]) -> tuple[Quantity, ...]:
    return tuple(q.joined(tuple(o[k] for o in others)) for k, q in enumerate(own))


def _in_sensor(found: _Found, experiment: Experiment) -> np.ndarray | None:
    """Centre of mass in the sensor's frame (3,)."""
    sensor = experiment.sensor
    if sensor is None or not all(q.shown for q in found.known.centre):
        return None
    rotation = pin.rpy.rpyToMatrix(*map(float, sensor.rpy))
    return rotation.T @ (np.array([q.value for q in found.known.centre]) - sensor.translation)


def _links(root) -> list[str]:
    return [str(link.get("name")) for link in root.findall("link")]


def _offset_sentence(offset: np.ndarray) -> str:
    told = [" ± ".join(with_half(v, HALF * s)) for v, s in offset.T]
    return f"Sensor offset: fx {told[0]}, fy {told[1]}, fz {told[2]} N; mx {told[3]}, my {told[4]}, mz {told[5]} N m."


def _beside(effects: Sequence[FoundEffect], plain: BodyKnowledge) -> list[str]:
    """What else is in the readings and in the model, and what the values would be without it."""
    effects = [e for e in effects if e.in_model]
    if not effects:
        return []
    parts = []
    for e in effects:
        values = ", ".join(_value(k, *given) for k, given in e.values.items())
        rivals = f", or {' or '.join(e.ambiguous_with)}: these recordings do not tell" if e.ambiguous_with else ""
        parts.append(f"{e.spec} ({values}){rivals}")
    out = [f"Beside the payload the readings hold {'; '.join(parts)}. It is in the model."]
    if plain.mass.shown:
        centre = ", ".join(number(1e3 * q.value, 3) for q in plain.centre)
        out.append(f"Without it: {number(plain.mass.value, 4)} kg, centre of mass ({centre}) mm in the carrying link's frame.")
    return out


def _value(name: str, value: float, std: float, unit: str) -> str:
    text, half = with_half(value, HALF * std)
    return f"{name} {text}{'' if half == DASH else f' ± {half}'} {'' if unit == '1' else unit}".rstrip()


def _not_shown(result: PayloadEstimate) -> list[str]:
    """What the recordings do not show, and what helps."""
    if not result.mass.shown:
        return ["The recordings do not show the mass: tilt the payload in more ways, or record longer."]
    out = []
    lost = [q.name for q in result.centre if not q.shown]
    if lost:
        out.append(f"The recordings do not show the centre of mass along {', '.join(lost)}: add poses that turn gravity there.")
    hidden = [q.name for q in result.inertia if not q.shown]
    if hidden:
        which = "Inertia" if len(hidden) == 6 else ", ".join(hidden)
        says = "assumed" if result.extent_assumed else "as stated"
        out.append(
            f"{which} not shown by these recordings, which turn the payload too slowly: at most "
            f"{number(result.inertia_bound, 2)} kg m² about any axis if no part of it is farther than "
            f"{number(result.extent, 2)} m from its centre of mass ({says})."
        )
    return out
