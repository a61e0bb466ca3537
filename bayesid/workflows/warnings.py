"""Warnings that the verbs share: what the predictions of unfitted motions say about a result."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bayesid.arguments import argument, call
from bayesid.effects import Effect, with_places
from bayesid.effects.segment import late_start
from bayesid.estimators import Estimate
from bayesid.estimators.nonlinear import ran_away
from bayesid.estimators.prior_check import PriorCheck, conflicts
from bayesid.recordings.complaints import in_words, listed
from bayesid.recordings.experiment import Experiment
from bayesid.regression.problem import Problem
from bayesid.regression.readings import has_readings
from bayesid.section import powers
from bayesid.validation.agreement import Agreement
from bayesid.validation.mistakes.candidates import Mistake
from bayesid.validation.own_fit import fit_and_predict
from bayesid.validation.prediction import Prediction, judged, leaves_more, left_by_uncertain_parameters, of_signal, useless

_CERTAIN = 3.0  # standard deviations below zero


def of_fit(
    problem: Problem, estimate: Estimate, check: PriorCheck | None, wrong: Sequence[str], validation: Sequence[Prediction]
) -> list[str]:
    """What any fit to these recordings should be read with, most important first; ``wrong``: what is wrong with it or them."""
    out = [
        *unseen_effects(problem),
        *without_static_run(problem),
        *too_late(problem),
        *conflicts(check),
        *not_settled(problem, estimate),
        *wrong,
        *repeated_motions(validation),
        *unpredicted(validation),
    ]
    if not validation:
        what = "posterior" if estimate.method == "posterior" else "estimate"
        out.append(
            f"No validation motion: nothing shows that the {what} holds for another motion. "
            'Add a motion with role = "validation".'
        )
    return out


def of_recordings(experiment: Experiment, notes: Iterable[str], named: Iterable[str] = ()) -> tuple[str, ...]:
    """What a verb has to say, after what is certainly wrong with the recordings, or most likely, and before what is doubtful.

    For verbs that show no fit as `bayesid.identify` does; ``named`` as in `mistakes`.
    """
    return experiment.with_findings([*mistakes(experiment, named), *notes], validated=False)


def mistakes(experiment: Experiment, named: Iterable[str] = ()) -> list[str]:
    """What is most likely wrong with the recordings: nothing that a verb finds holds of readings with another sign or unit.

    ``named`` are the effects that it found: what these explain is no mistake as well, nor is what nothing explains.
    """
    wrong = [m.text for m in _unexplained(experiment, named) if m.name != "not_explained"]
    if wrong:
        wrong[-1] += ". Undo that first: the values here are of data with a mistake."
    return wrong


def _unexplained(experiment: Experiment, named: Iterable[str]) -> list[Mistake]:
    """What may be wrong with the recordings and is not what effects of these names make."""
    from bayesid.validation.mistakes.search import find_mistakes

    explained, classes = set(named), experiment.library.classes
    # Where a mount or a joint gives, readings lag behind the encoders as if the clocks did.
    late = {"sensor_delay", *(name for name, c in classes.items() if c.amplifies_encoder_errors)}
    explained |= {"wrench_delay", "torque_delay"} if explained & late else set()
    # Forces at a sensor that is turned are as on a base that is tilted.
    explained |= {"base_tilt"} if "sensor_rotation" in explained else set()
    return [m for m in find_mistakes(experiment) if m.name not in explained]


def of_reference(reference: Experiment, said: Iterable[str] = ()) -> tuple[str, ...]:
    """The same of recordings that others are compared with, without what was ``said`` of those already."""
    return tuple(f"In the reference: {text}" for text in of_recordings(reference, ()) if text not in said)


def lacking_reference(problem: Problem) -> list[str]:
    """That a reference's own fit leaves more than noise: what its model lacks has to be allowed for in what friction wanders."""
    left = [p for p in fit_and_predict(problem)[1] if p.fitted and leaves_more(p)]
    if not left:
        return []
    worst = max(left, key=lambda p: p.whitened_rms)
    return [
        f"In the reference: its model leaves {worst.whitened_rms:.3g} times the measurement noise of motion '{worst.motion}'. "
        f"What it lacks hides changes: find it with `{call('diagnose')}` on the reference alone, and write what that names, its "
        "model.toml, into the reference's experiment.toml."
    ]


def unseen_effects(problem: Problem) -> list[str]:
    """Which of the effects that were asked for these readings do not show, in one line."""
    if not problem.unseen:
        return []
    them = "it" if len(problem.unseen) == 1 else "them"
    other = {"wrench": "torque", "torque": "wrench"}.get(problem.channel)
    remedy = f"; those of {argument('channel', other)} may" if _recorded(problem, other) else ""
    left_out = "so it is left out" if len(problem.unseen) == 1 else "so they are left out"
    return [
        f"{argument('effects', problem.unseen)}: the readings that are fitted ({problem.channel}) do not show {them}, "
        f"{left_out}{remedy}."
    ]


def without_static_run(problem: Problem) -> list[str]:
    """Which motions for validation are left out, because the fit subtracts a static run and they have none, in one line."""
    if problem.static != "motion":
        return []
    names = [m.name for m in problem.experiment.validation if m.name not in problem.segments and has_readings(m.table, "wrench")]
    if not names:
        return []
    has = "has" if len(names) == 1 else "have"
    return [
        f"{quoted(names)} {has} no static run, and gravity and the sensor's offset, which one takes from the fitted motions, are "
        f"not known: left out of the validation. Fit the run along ({argument('static', 'joint')}), or record one there, too."
    ]


def too_late(problem: Problem) -> list[str]:
    """That times start too late for effects of the model that grow from time zero on."""
    if not any(e.since_zero for e in problem.row_model.effects):
        return []
    return late_start(max(abs(float(problem.experiment[name].table.times[0])) for name in problem.fitted))


def _recorded(problem: Problem, channel: str | None) -> bool:
    """Whether the fitted motions have the readings of a channel."""
    if channel is None or (channel == "wrench" and problem.experiment.sensor is None):
        return False
    return all(has_readings(problem.experiment[name].table, channel) for name in problem.fitted)


def repeated_motions(predictions: Sequence[Prediction]) -> list[str]:
    """That motions repeat fitted ones, and so say little of others, in one line."""
    again = [p for p in predictions if p.repeats]
    if not again:
        return []
    own, other = (quoted(dict.fromkeys(names)) for names in ((p.motion for p in again), (str(p.repeats) for p in again)))
    if len(again) == 1:
        return [f"Motion {own} repeats the fitted motion {other}: its error says little about others; validate on another."]
    return [f"Motions {own} repeat motions that are fitted ({other}): their errors say little about others; validate on another."]


def unpredicted(predictions: Sequence[Prediction]) -> list[str]:
    """That motions are not predicted as well as a complete model would, in one line with the worst of them."""
    off = [p for p in predictions if judged(p).mood != "good"]
    if not off:
        return []
    worst = max(off, key=lambda p: p.relative_error)
    if len(off) == 1:
        said = f"an error of {100 * worst.relative_error:.3g} % of {of_signal(worst)}"
        first = f"Motion '{worst.motion}' is predicted with {said}: "
    else:
        best = min(p.relative_error for p in off)
        first = (
            f"{len(off)} of {len(predictions)} motions that were not fitted are predicted with errors of {100 * best:.3g} to "
            f"{100 * worst.relative_error:.3g} % of {of_signal(worst)}. '{worst.motion}' has the largest: "
        )
    remedy = f"`{call('diagnose')}` looks for what is missing."
    if worst.beyond:
        remedy = "Fit a motion for them."
    elif left_by_uncertain_parameters(worst):
        remedy = "Fit a motion like it, too."
    return [f"{first}{judged(worst).text}. {remedy}"]


def left_of_fit(estimate: Estimate, fitted: Sequence[Prediction], alone: bool) -> list[str]:
    """That the model lacks something, by the motions that it was fitted to; ``alone``: no others tell."""
    if estimate.details.model_complete is False:
        return [incomplete(estimate.details.dispersion, estimate.details.dispersion_by_channel)]
    off = [p for p in fitted if alone and leaves_more(p)]
    if not off:
        return []
    worst = max(off, key=lambda p: p.relative_error)
    said = f"Motion '{worst.motion}' is fitted with an error of {100 * worst.relative_error:.3g} % of {of_signal(worst)}"
    return [f"{said}: {judged(worst).text}. `{call('diagnose')}` looks for what is missing."]


def beyond_poses(predictions: Sequence[Prediction]) -> list[str]:
    """That motions move where poses at rest are all that is fitted, so that no error of theirs judges a model."""
    moving = [p.motion for p in predictions if p.beyond]
    if not moving:
        return []
    what = f"motion {quoted(moving)}, which moves" if len(moving) == 1 else f"motions {quoted(moving)}, which move"
    return [
        "Poses at rest are all that is fitted, and show nothing of inertias: errors on "
        f"{what}, are those of gravity alone, the nominal model's, too. Fit a motion, or validate on poses."
    ]


def unusable(
    problem: Problem, predictions: Sequence[Prediction], mistakes: Sequence[str], takes_effects: bool = True
) -> list[str]:
    """That a fit is of no use, by predictions of unfitted motions and what `mistaken` found, and what to try first.

    ``takes_effects``: whether the verb has the argument ``effects``.
    """
    if not useless(predictions):
        return []
    errors = sorted(p.relative_error for p in predictions)
    size = f"{100 * errors[0]:.3g}" + (f" to {100 * errors[-1]:.3g}" if len(errors) > 1 else "")
    if mistakes:
        remedy = "Undo the mistake that is named below, then fit again"
    elif lacks_drives(problem):
        drive = ["viscous_friction", "coulomb_friction", "rotor_inertia"]
        given = (
            f"{argument('effects', drive)}, or the same in [model] effects,"
            if takes_effects
            else f"[model] effects = {json.dumps(drive)}"
        )
        remedy = f"The model has no effect of a drive: {given} adds them; `{call('diagnose')}` finds which kinds each joint has"
    else:
        remedy = f"`{call('check')}` looks for wrong signs, units and joint order, `{call('diagnose')}` for what is missing"
    said = f"motions that were not fitted are predicted with an error of {size} % of the signal"
    return [f"This is no usable model: {said}. {remedy}."]


def lacks_drives(problem: Problem) -> bool:
    """Whether torques are fitted by a model that has no effect of a drive, which every drive has."""
    return problem.channel != "wrench" and not any(e.channels == ("torque",) for e in problem.row_model.effects)


def contradictions(agreements: Sequence[Agreement]) -> list[str]:
    """That estimates from different data contradict each other: a line for each kind of data, with the worst of them."""
    kinds: dict[str, list[Agreement]] = {}
    for a in agreements:
        if a.contradiction:
            kinds.setdefault(a.first.split()[0], []).append(a)
    out = []
    for kind, members in kinds.items():
        a = max(members, key=lambda a: a.rms)
        names = listed((x.first.split(maxsplit=1)[-1] for x in members), 6)
        more = "" if len(members) == 1 else f" (the worst of {len(members)} {kind}s that contradict others: {names})"
        out.append(
            f"{a.first[0].upper()}{a.first[1:]} and {a.second} contradict each other{more}: {a.rms:.3g} sigma rms over "
            f"{a.compared} numbers; most in {a.worst}. Noise alone does not set them so far apart: what the model lacks does, "
            "and so do friction and gains that are others from one recording to the next. Do not average them, but fit them "
            f"apart; `{call('diagnose')}` looks for what is missing, and with {argument('reference')} for what changed by more "
            "than friction and gains usually do."
        )
    return out


def incomplete(dispersion: float | None, channels: Mapping[str, float] | None = None) -> str:
    """That the model lacks something, in which channels most, and what intervals do about it."""
    factor = (dispersion or 1.0) ** 0.5
    known = channels or {}
    most = sorted(known, key=lambda c: -known[c])[:2] if len(known) > 2 else []
    size = f"{factor:.2g}"
    wider = "hardly wider than" if size == "1" else f"{size} times as wide as"
    where = f", most in {' and '.join(most)}" if most else ""
    return (
        "Something is missing in the model: the fit scatters more between parts of the recording, or between weightings, "
        f"than noise explains. Intervals count the scatter ({wider} noise alone makes them{where}); for motions unlike the "
        f"fitted ones they do not hold. `{call('diagnose')}` looks for the missing effect."
    )


def mistaken(problem: Problem, validation: Sequence[Prediction], impossible: bool) -> list[str]:
    """Which mistake in the data would explain a bad fit.

    The search takes a part of a second; it is made where a sign is wrong or no body is possible (``impossible``), where a
    held-out motion is not predicted well, and where the URDF has no masses to compare with.
    """
    masses = problem.experiment.robot.nominal[:, 0]
    if not impossible and masses.any() and all(judged(p).mood == "good" for p in validation):
        return []
    return [m.text for m in _unexplained(problem.experiment, [e.name for e in problem.row_model.effects])]


def impossible_signs(estimate: Estimate, problem: Problem) -> list[str]:
    """That masses or friction have a sign that nothing has."""
    base, rank = estimate.base, estimate.base.rank
    negative = estimate.solution < -_CERTAIN * estimate.full_std
    alone = [
        name.endswith(".m") and np.count_nonzero(np.abs(row) > 1e-9) == 1
        for name, row in zip(base.names, base.matrix, strict=True)
    ]
    never = np.array([*alone, *problem.regression.knowledge.effect_non_negative], dtype=bool) & negative
    if not never.any():
        return []
    names = [*base.names, *estimate.effect_names]
    units = [*base.units, *estimate.effect_units]

    def shown(which: np.ndarray) -> str:
        each = (f"{names[k]} = {estimate.solution[k]:.3g} +- {estimate.full_std[k]:.2g} {powers(units[k])}" for k in which)
        return listed(each, 4)

    owners = problem.row_model.of_free(e for e in problem.row_model.effects for _ in e.parameters)
    denied = np.append(np.zeros(rank, bool), _signs_right(owners, estimate.solution[rank:])) & never
    out, blamed = [], np.flatnonzero(never & ~denied)
    if len(blamed):
        kind = "Mass" if blamed[0] < rank else "Friction"
        out.append(
            f"{kind} that cannot be negative is: {shown(blamed)}. Check signs, joint order and units of the readings, or whether "
            "the motions show it at all."
        )
    if denied.any():
        friction = any(owners[k - rank].urdf_dynamics is not None for k in np.flatnonzero(denied))
        falls = (
            "friction may fall with speed (Stribeck) or follow the load, the drive may take its own friction compensation out of "
            "the readings, or "
        ) if friction else ""  # fmt: skip
        out.append(
            f"What cannot be negative is, beside friction of the same joint that is positive: {shown(np.flatnonzero(denied))}. "
            f"So the torques' sign is not to blame: {falls}this bandwidth and these speeds do not tell it from other parameters. "
            f"`{call('diagnose')}` looks for what is missing; compare with another {argument('bandwidth')}."
        )
    return out


def _signs_right(owners: Sequence[Effect], values: np.ndarray) -> np.ndarray:
    """Whether other friction of the joint that an effect's parameter acts at is positive, so that its torque's sign is right."""
    friction = [(e, value) for e, value in zip(owners, values, strict=True) if e.urdf_dynamics is not None]
    return np.array([any(e is not o and e.joint == o.joint and value > 0.0 for e, value in friction) for o in owners], bool)


def not_settled(problem: Problem, estimate: Estimate) -> list[str]:
    """Which effects ended at values that are not plausible, or where they are not linearised.

    What readings are not linear in is estimated in steps that stay within what is plausible. Where an estimate points far away
    still, it has run away along what these motions do not tell from other parameters, so those are not to be relied on, either.
    So has one whose standard deviation is wider than all that is plausible.
    """
    point = problem.row_model.point
    if point is None:
        return []
    values, stds = point.values.copy(), np.full(len(point.values), np.inf)
    values[point.free], stds[point.free] = estimate.solution[estimate.base.rank :], estimate.full_std[estimate.base.rank :]
    out, away = [], ran_away(problem, estimate)
    held = np.zeros(len(away), bool) if point.unsettled is None else point.unsettled
    low, high = (np.array([v for e in problem.row_model.effects for v in getattr(e, side)]) for side in ("lower", "upper"))
    for effect, part in with_places(problem.row_model.effects):
        wide = np.isfinite(stds[part]) & (stds[part] > np.subtract(effect.upper, effect.lower))
        if not effect.shape or not (held[part] | away[part] | wide).any():
            continue
        each = zip(effect.parameters, values[part], effect.units, strict=True)
        shown = [f"{key} = {v:.3g} {powers(unit)}" for key, v, unit in each]
        kept = [key for key, own in zip(effect.parameters, held[part], strict=True) if own]
        at_end = (held & ((values == low) | (values == high)))[part].any()
        where = "at the end of what is plausible" if at_end else "where the fit stopped"
        why = "The data ask for what lies beyond" if at_end else "These motions do not tell it from other parameters"
        classes = problem.experiment.library.classes
        plain = [name for name in effect.confusable_with if at_end and name in classes and not classes[name].shape]
        instead = f", try {' or '.join(plain)} in its place" if plain else ""
        out.append(
            f"{effect.spec} did not settle: {listed(shown, 3)}{f', with {in_words(kept)} kept {where}' if kept else ''}. {why}; "
            f"other values are then not to be relied on, either. State what is known of it in [model.values], leave it "
            f"out{instead}, or add motions that show it."
        )
    return out


def quoted(names: Iterable[str]) -> str:
    """Names in quotation marks."""
    return listed((f"'{name}'" for name in names), 6)
