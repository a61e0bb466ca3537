"""The verb ``payload``: what hangs at the flange."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arguments import argument, call
from bayesid.design.payload.body import BodyKnowledge, Quantity
from bayesid.design.payload.knowledge import (
    carrying_joint,
    from_nominal,
    from_reference,
    from_sensor,
    in_frame,
    named_payload,
    of_any_motion,
    weighed_alone,
)
from bayesid.design.payload.poses import NextPoses, next_poses
from bayesid.diagnosis.settings import Settings
from bayesid.effects import Effect
from bayesid.effects.bodies import body_of
from bayesid.errors import InputError
from bayesid.recordings.complaints import listed
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, some_options
from bayesid.regression.readings import default_channel
from bayesid.results.payload import NEXT_POSES, EffectBeside, PayloadEstimate
from bayesid.robot.inertia import PARAMETERS
from bayesid.robot.urdf_file import FARTHEST
from bayesid.rounding import channel_text, number, percent, with_half
from bayesid.workflows.diagnose import diagnose
from bayesid.workflows.explained import Explained, explain, joined, offset_of
from bayesid.workflows.progress import SHOWN, Clock, Progress, shows_progress
from bayesid.workflows.warnings import contradictions, impossible_signs, of_recordings

#: Effects that are another body on a link: on the one that carries the payload they are the payload.
_BODIES = ("payload", "inertia_error")
#: An error of the stated origin of the sensor: readings do not tell it from another centre of mass.
_ORIGIN = ("sensor_translation",)
_SHIFTED = "it cannot be told from another centre of mass, which is from the stated origin of the sensor."
#: A body's farthest part is assumed to be this many times as far from its centre of mass as that is from the flange, and at
#: least so far [m].
_EXTENT, _SMALLEST_EXTENT = 2.0, 0.1
_COMMON_GAIN = (
    "A sensor whose axes all read too much by one share looks like a heavier payload: the mass is as right as the sensor's gain; "
    "a known mass hung on tells."
)
_ZERO = (
    "A zero of the sensor that moved along gravity between the two recordings reads like another payload, {kg} kg for every "
    "newton: do not zero it in between, and record both soon after each other."
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
    target: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class _Found:
    """What one source says of the payload, in the frame of the body that carries it."""

    body: int
    known: BodyKnowledge
    plain: BodyKnowledge
    any_motion: BodyKnowledge  # what the richest motion would show of it
    rivals: tuple[BodyKnowledge, ...] = ()
    effects: tuple[EffectBeside, ...] = ()
    verdict: str | None = None
    offset: tuple[Quantity, ...] = ()
    evidence: float | None = None
    share: float | None = None
    more: NextPoses | None = None
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
    target: tuple[float, float] | None = None,
    diagnosis: bool = True,
    seed: int = 0,
    settings: Settings | None = None,
    progress: Progress | None = SHOWN,
) -> PayloadEstimate:
    """Mass, centre of mass and inertia of what the last link carries, each with its interval and whether the readings show it.

    A force/torque sensor in the wrist weighs it alone: poses at rest suffice for mass and centre of mass. Joint torques, or a
    sensor under the base, tell it from the arm by a recording without it, or by a nominal model of stated accuracy. A
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
        URDF link in whose frame it is given; default the flange, where the URDF has one, else the link that carries it.
    extent
        No part of the payload is farther from its centre of mass [m]: bounds an inertia that the readings do not show.
    target
        Half 95 % intervals that are wanted of the mass [kg] and the centre of mass along any axis [m]: for a sensor that carries
        the payload alone, the poses that reach them are proposed.
    diagnosis
        Whether to look for what else is in the readings; with a reference, whether what else changed is in the model.
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
        Bad input, or nothing tells the payload from the arm: neither a sensor that carries it alone, nor a reference, nor
        the prior of the nominal model.
    """
    chosen = some_options("payload", options, channel=channel, motions=motions, effects=effects)
    if extent is not None and not 0.0 < extent <= FARTHEST:
        raise InputError(f"{argument('extent', extent)}: give a length in metres, above 0 and at most {FARTHEST:g}")
    clock = Clock(progress)
    clock("reading")
    experiment = as_experiment(experiment)
    read = chosen.channel or default_channel(experiment)
    if chosen.effects is not None:
        experiment = replace(experiment, effects=tuple(chosen.effects))
    asked = _Asked(experiment, FitOptions(channel=read, motions=chosen.motions), diagnosis, seed, settings, clock, target)
    carried = weighed_alone(experiment, read)
    sensor = experiment.sensor
    if reference is not None:
        before = as_experiment(reference)
        if chosen.effects is not None:
            before = replace(before, effects=tuple(chosen.effects))
        source, detail = "reference", before.name
        found = _since(asked, before, joint)
    elif carried is not None:
        assert sensor is not None
        at = int(experiment.robot.body_joint[carried])
        if joint is not None and carrying_joint(experiment.robot, joint) != at:
            raise InputError(
                f"{argument('joint', joint)}: the sensor in '{sensor.joint}' weighs what {experiment.robot.joint_names[at]} "
                "carries; leave it out"
            )
        source, detail = "sensor", str(sensor.joint)
        found = _weighed(asked, carried)
    else:
        rel_std = experiment.inertia_rel_std
        if rel_std is None:
            raise InputError(
                "a payload looks like a heavier last link: name a recording without it "
                f"({argument('reference')}), or state in experiment.toml how far the URDF's inertias are trusted ([robot] "
                "inertia_rel_std = 0.1)"
            )
        source, detail = "nominal", percent(rel_std, 2)
        found = _beside_nominal(asked, joint, rel_std)
    clock("result")
    own, name = in_frame(found.known, experiment, found.body, frame)
    known = own.possible
    plain, _ = in_frame(found.plain.possible, experiment, found.body, frame)
    others = [in_frame(k.possible, experiment, found.body, frame)[0] for k in found.rivals]
    any_motion, _ = in_frame(found.any_motion, experiment, found.body, name)
    mass = known.mass.joined(tuple(k.mass for k in others))
    centre = joined(known.centre, [k.centre for k in others])
    first_moment = joined(known.first_moment, [k.first_moment for k in others])
    moments = joined(known.inertia, [k.inertia for k in others])
    reach = [abs(q.value) for q in centre if q.shown]
    assumed = max(_EXTENT * float(np.linalg.norm(reach)), _SMALLEST_EXTENT)
    urdf = experiment.robot.description
    carrier = experiment.robot.body_names[found.body]
    result = PayloadEstimate(
        name=experiment.name, channel=read, source=source, source_detail=detail, carrier=carrier, frame=name, body=own,
        mass=mass, centre=centre, inertia=moments, first_moment=first_moment, never_shown=~any_motion.shown,
        extent=assumed if extent is None else float(extent),
        extent_assumed=extent is None,
        plain=(plain.mass, *plain.centre), effects=found.effects, verdict=found.verdict, offset=found.offset,
        sensor_frame=urdf.joints[detail].child if source == "sensor" else None,
        centre_in_sensor=_in_sensor(found, experiment) if source == "sensor" else None,
        sensor_mounted=experiment.sensor.mounted if source == "sensor" and experiment.sensor is not None else None,
        world=urdf.root_link,
        gravity=experiment.robot.gravity, evidence=found.evidence, nominal_share=found.share, more=found.more,
        sentences=found.sentences,
        warnings=of_recordings(experiment, found.warnings, [e.name for e in found.effects]), seconds=clock.stop(),
    )  # fmt: skip
    return replace(result, sentences=(*_not_shown(result), *result.sentences, *_without(result)))


def _weighed(asked: _Asked, body: int) -> _Found:
    """Find it by a sensor that carries it alone."""
    # What it carries is free: its nominal values are mostly placeholders, and an error of theirs is no fault.
    found = _explained(asked, replace(asked.experiment, inertia_rel_std=None), body)
    plain, known, *others = (from_sensor(f.problem, f.estimate, body) for f in (found.first, found.best, *found.rivals))
    last = found.best
    offset = offset_of(last)
    sentences = [_offset_sentence(offset)] if offset else []
    more = None
    if asked.target is not None:
        asked.clock("poses to record next")
        more = next_poses(last.problem, last.estimate, body, asked.target, asked.seed)
        sentences = [_next_sentence(more), *sentences]
    return _Found(
        body, known, plain, of_any_motion(last.problem, body), tuple(others), found.effects, found.verdict, offset, more=more,
        sentences=(*sentences, *_beside(found.effects), _COMMON_GAIN),
        warnings=(
            *impossible_signs(last.estimate, last.problem), *_notes(found, plain, known), *contradictions(found.first.agreements)
        ),
    )  # fmt: skip


def _beside_nominal(asked: _Asked, joint: str | None, rel_std: float) -> _Found:
    """Find it beside a nominal model of this relative standard deviation."""
    body = body_of(asked.experiment.robot, carrying_joint(asked.experiment.robot, joint))
    found = _explained(asked, asked.experiment, body)
    fits = (found.first, found.best, *found.rivals)
    plain, known, *others = (from_nominal(f.problem, f.estimate, body, rel_std)[0] for f in fits)
    share = from_nominal(found.best.problem, found.best.estimate, body, rel_std)[1]
    says = []
    if share is not None and share > 0.5:
        says = [
            f"The answer depends on the nominal model: {percent(share, 2)} of the mass's variance is its. "
            f"A recording without the payload ({argument('reference')}) does without it."
        ]
    elif share is not None:
        says = [f"The nominal model contributes {percent(share, 2)} of the mass's variance."]
    return _Found(
        body, known, plain, of_any_motion(found.best.problem, body), tuple(others), found.effects, found.verdict, share=share,
        sentences=(*says, *_beside(found.effects)),
        warnings=(*_notes(found, plain, known), *contradictions(found.first.agreements)),
    )  # fmt: skip


def _explained(asked: _Asked, experiment: Experiment, body: int) -> Explained:
    """Fits without and with what else is in the readings."""
    here = f"joint{int(experiment.robot.body_joint[body]) + 1}"

    def is_payload(effect: Effect) -> bool:
        return effect.name in _BODIES and effect.where == here

    return explain(
        experiment, asked.options, is_payload, lambda e: e.name in _ORIGIN, asked.diagnosis, asked.seed, asked.settings,
        asked.clock,
    )  # fmt: skip


def _notes(found: Explained, plain: BodyKnowledge, known: BodyKnowledge) -> list[str]:
    """What to know of the effects beside the payload."""
    out = list(found.warnings)
    if shifted := [e.spec for e in found.effects if e.name in _ORIGIN]:
        out.append(f"The readings also hold {', '.join(shifted)}: {_SHIFTED}")
    if plain.mass.shown and not known.mass.shown:
        names = ", ".join(e.spec for e in found.effects if e.in_model)
        out.append(f"With {names} in the model these recordings do not show the mass: take it away, or record more poses.")
    return out


def _since(asked: _Asked, before: Experiment, joint: str | None) -> _Found:
    """What changed since a recording without it."""
    asked.clock("what changed since the reference")
    experiment = asked.experiment
    changes = diagnose(
        experiment, options=asked.options, reference=before, seed=asked.seed, settings=asked.settings, progress=None
    )
    found = changes.comparison
    at = carrying_joint(experiment.robot, joint)
    plain, evidence = from_reference(found, at, alone=True)
    known = from_reference(found, at)[0] if asked.diagnosis else plain
    here = f"joint{at + 1}"
    stands_for = named_payload(found, at)
    named = stands_for is not None
    others = tuple(
        EffectBeside(
            c.change.name, c.change.where, {v.name: (v.value, v.std, v.unit) for v in c.values},
            tuple(f"{h.name}@{h.where}" for h, _ in c.found.rivals), in_model=asked.diagnosis,
        )
        for c in found.changes
        if stands_for is None or c.found is not stands_for[0]
    )  # fmt: skip
    warnings = []
    if not named:
        what = f"what changed is {', '.join(e.spec for e in others)}" if others else "nothing that changed is named"
        what += "".join(f"; if that is the payload: {argument('joint', e.where)}" for e in others if e.name == "payload")
        needed = number(found.settings.accept, 3)
        why = f"needed {needed}" if evidence < found.settings.accept else "but parts held out in turn deny it"
        warnings.append(
            f"The comparison does not name a payload at {here} (log evidence {number(evidence, 3)}, {why}): {what}. "
            "The intervals tell which payload these recordings would not show."
        )
    if stands_for is not None:
        accepted, form, _ = stands_for
        rivals = [h.spec for h in (accepted.change, *(h for h, _ in accepted.rivals)) if h is not form]
        if rivals:
            warnings.append(
                f"These recordings do not tell the payload at {here} from {', '.join(rivals)}; the values hold if it is there."
            )
    came = f"something was taken away from {here}" if known.negative else f"a payload at {here} came"
    said = [f"Since {before.name} {came}: log evidence {number(evidence, 3)}."] if named else []
    beside = ", ".join(e.spec for e in others)
    if named and others and asked.diagnosis:
        said += [f"Beside it changed: {beside}. It is in the model."]
        if plain.possible.mass.shown and not known.mass.shown:
            warnings.append(f"With {beside} in the model these recordings do not show the mass: move the robot in more ways.")
    elif named and others:
        warnings.append(f"Beside it changed {beside}, which is not in the model, as asked; the intervals do not count it.")
    sensor, effects = experiment.sensor, found.reference.effects
    weight = float(np.linalg.norm(experiment.robot.gravity))
    # In the wrist a sensor turns against gravity, and its offset does not.
    if sensor is not None and sensor.joint is None and weight and any(e.name == "sensor_offset" for e in effects):
        said.append(_ZERO.format(kg=number(1.0 / weight, 2)))
    if changes.verdict in ("unknown", "named_in_part"):
        warnings.append("More changed since the reference than is named; the intervals do not count it.")
    body = body_of(found.reference.robot, at)
    return _Found(
        body, known, plain, of_any_motion(found.reference.problem, body), effects=others,
        verdict=changes.verdict, evidence=evidence, sentences=tuple(said),
        warnings=tuple(warnings),
    )  # fmt: skip


def _in_sensor(found: _Found, experiment: Experiment) -> np.ndarray | None:
    """Centre of mass in the sensor's frame (3,)."""
    sensor = experiment.sensor
    if sensor is None or not all(q.shown for q in found.known.centre):
        return None
    return sensor.rotation.T @ (np.array([q.value for q in found.known.centre]) - sensor.translation)


def _next_sentence(more: NextPoses) -> str:
    mass, centre = (number(x, 2) for x in (more.expected[0], 1e3 * more.expected[1]))
    wanted = f"{number(more.wanted[0], 2)} kg and {number(1e3 * more.wanted[1], 2)} mm"
    if not len(more.positions):
        return f"The accuracy asked for, {wanted}, is reached."
    if not more.reached:
        return f"{len(more.positions)} more poses would bring ± {mass} kg and ± {centre} mm, not the {wanted} asked for."
    return (
        f"{len(more.positions)} more poses ({NEXT_POSES}) are expected to bring ± {mass} kg and ± {centre} mm. They keep to the "
        f"joints' limits{' and the robot off itself' if more.apart else ''}; check them for collisions with "
        f"{'the tool, its cable and the surroundings' if more.apart else 'all else: the URDF has no collision geometry'}."
    )


def _offset_sentence(offset: Sequence[Quantity]) -> str:
    values = [f"{q.name} {' ± '.join(with_half(q.value, q.high - q.value)) if q.shown else 'not shown'}" for q in offset]
    return f"Sensor offset: {', '.join(values[:3])} N; {', '.join(values[3:])} N m."


def _beside(effects: Sequence[EffectBeside]) -> list[str]:
    """What else is in the readings and in the model."""
    effects = [e for e in effects if e.in_model]
    return [f"Beside the payload the readings hold {'; '.join(map(str, effects))}. It is in the model."] if effects else []


def _without(result: PayloadEstimate) -> list[str]:
    """Mass and centre of mass if nothing else were in the readings."""
    names = [e.spec for e in result.effects if e.in_model]
    mass, *centre = result.plain
    if not names or not mass.shown:
        return []
    where = ", ".join(number(1e3 * q.value, 3) for q in centre)
    return [f"Without {listed(names, 4)} in the model: {number(mass.value, 4)} kg, centre of mass ({where}) mm."]


def _not_shown(result: PayloadEstimate) -> list[str]:
    """What the recordings do not show, and what helps."""
    body = result.body
    if body.negative:
        why = f"sign, axes or order of the readings are not as they are taken; `{call('check')}` looks for that."
        if result.source == "reference":
            why = "the reference carries more than this recording. The one with the payload is named first, the reference second."
        return [f"The mass comes out negative, {number(float(body.mean[0]), 3)} kg: {why}"]
    never = {q.name: bool(hidden) for q, hidden in zip(result.quantities, result.never_shown, strict=True)}
    if not result.mass.shown:
        told = [q.name for q in result.first_moment if q.shown]
        known = f" The first moments {', '.join(told)}, mass times centre of mass, are known as well as their intervals say."
        moments = known if told else ""
        if not never["m"]:
            if (result.nominal_share or 0.0) > 0.5:
                return [f"The recordings do not show the mass beside what is not known of the nominal links.{moments}"]
            return [f"The recordings do not show the mass: tilt the payload in more ways, or record longer.{moments}"]
        return [
            f"No motion of this robot shows the mass of a payload on {result.carrier} in the {channel_text(result.channel)}: "
            f"weigh it.{moments}"
        ]
    out = []
    lost = [q.name for q in result.centre if not q.shown]
    if unseen := [k for k in lost if never[k]]:
        out.append(f"No motion of this robot shows the centre of mass along {', '.join(unseen)}.")
    if still := [k for k in lost if not never[k]]:
        out.append(f"The recordings do not show the centre of mass along {', '.join(still)}: add poses that turn gravity there.")
    hidden = [q.name for q in result.inertia if not q.shown]
    if hidden:
        which = "Inertia" if len(hidden) == 6 else ", ".join(hidden)
        says = "assumed" if result.extent_assumed else "as stated"
        unseen = [k for k in PARAMETERS[4:] if never[k]]
        why = f"of which no motion of this robot shows {', '.join(unseen)}" if unseen else "which turn the payload too slowly"
        out.append(
            f"{which} not shown by these recordings, {why}: at most "
            f"{number(result.inertia_bound, 2)} kg m² about any axis if no part of it is farther than "
            f"{number(result.extent, 2)} m from its centre of mass ({says})."
        )
    return out
