"""The verb ``diagnose``: which effect a model misses, in phases.

With a reference it finds what changed since a recording of the robot in its known state.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TypedDict, Unpack, overload

from bayesid.arguments import argument, names
from bayesid.design.tell.choose import tell_effects, tell_search
from bayesid.design.tell.rivals import parse_effects
from bayesid.diagnosis.changes.findings import compare_with_reference
from bayesid.diagnosis.data import WHITE, DiagnosisData
from bayesid.diagnosis.description.describe import describe, stands_alone
from bayesid.diagnosis.fit import Fit, fit
from bayesid.diagnosis.held_out import predicts_better
from bayesid.diagnosis.in_part import InPart, proven_effects
from bayesid.diagnosis.locate import Disagreement, locate
from bayesid.diagnosis.prepare import known_terms, prepare_data
from bayesid.diagnosis.projector import make_projector
from bayesid.diagnosis.push import Push, find_push, less_push, measured_push, without_push
from bayesid.diagnosis.remarks import Refusal, by_kind, next_experiment, remarks
from bayesid.diagnosis.search import Found, Search, certain, holds_below, leaves_noise, search, search_from, with_data
from bayesid.diagnosis.settings import DEFAULT, Settings
from bayesid.diagnosis.stability import Stability, stability
from bayesid.diagnosis.turns import between_turns
from bayesid.diagnosis.validation import Gap, residual_spectra, validate
from bayesid.diagnosis.verdict import Reason, Verdict, denied, evidence_of, named_in_part, verdict
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, as_experiment
from bayesid.regression.options import FitOptions, some_options
from bayesid.regression.parallel import one_blas_thread
from bayesid.regression.readings import default_channel
from bayesid.results.changes import Changes
from bayesid.results.diagnosis import Diagnosis
from bayesid.results.excitation import telling_sentence
from bayesid.results.fitted_model import fitted_model
from bayesid.validation.own_fit import before_and_after, chosen_bandwidth, predicted_worse
from bayesid.workflows.progress import SHOWN, Progress, quiet, shows_progress
from bayesid.workflows.warnings import lacking_reference, mistakes, of_recordings, of_reference


class DiagnoseChoices(TypedDict, total=False):
    """The keywords of `diagnose` without and with a reference, for its two signatures; explained there."""

    options: FitOptions | None
    motions: str | Sequence[str] | None
    effects: str | Sequence[str] | None
    tell: str | Sequence[str] | None
    seed: int
    settings: Settings | None
    progress: Progress | None


@overload
def diagnose(
    experiment: Experiment | str | Path, channel: str | None = ..., *, reference: None = ..., **choices: Unpack[DiagnoseChoices]
) -> Diagnosis: ...


@overload
def diagnose(
    experiment: Experiment | str | Path, channel: str | None = ..., *, reference: Experiment | str | Path,
    **choices: Unpack[DiagnoseChoices],
) -> Changes: ...  # fmt: skip


@shows_progress
def diagnose(
    experiment: Experiment | str | Path,
    channel: str | None = None,
    *,
    reference: Experiment | str | Path | None = None,
    options: FitOptions | None = None,
    motions: str | Sequence[str] | None = None,
    effects: str | Sequence[str] | None = None,
    tell: str | Sequence[str] | None = None,
    seed: int = 0,
    settings: Settings | None = None,
    progress: Progress | None = SHOWN,
) -> Diagnosis | Changes:
    """Find where model and data disagree, name the missing effect, add it and show on held-out motions that the gap shrank.

    The phases: noise of sensors and encoders; forward selection of effects; refit under the noise as the new model passes it on;
    pruning; rivals; held-out validation; verdict; where that is unknown, effects that held-out recordings confirm although
    something stays; remarks; where it is ambiguous, the motion that would settle it, and where something stays that no effect
    explains, a draft of that. Where something stays beside friction that the model states, all of it once more without that.

    Parameters
    ----------
    experiment
        Loaded, or its folder.
    channel
        ``wrench``, ``torque`` or ``both``; default as for `bayesid.identify`.
    reference
        The same robot in its known state. Then its posterior is the prior, its ``[model]`` the model, and what is named is what
        changed since; of the URDF only the geometry counts.
    options
        ``channel``, ``motions`` and ``effects`` at once; those that are given beside it stand in its place.
    motions
        Names of those to fit; default those with role ``identification``.
    effects
        Replaces ``[model] effects``.
    tell
        Two or more effects, ``name@where`` or ``name`` where there is one place: whatever the verdict, the next motion is then
        the one that tells these apart, as `bayesid.tell` finds it.
    seed
        Of everything random: the encoders' repeated rounding and the bootstrap over the held-out motions.
    settings
        Thresholds other than the usual ones, a `bayesid.diagnosis.settings.Settings` such as ``Settings(band=20.0)``.
    progress
        Called with a few words, such as ``rivals``, whenever a phase begins, from the thread of the caller; what it returns is
        ignored, what it raises ends the diagnosis.

    Returns
    -------
    diagnosis
        What is missing in the model; with ``reference`` instead the `bayesid.Changes` since it. Both have ``verdict``,
        ``to_dict`` and ``write``.

    Raises
    ------
    InputError
        Bad input; the message says what to do.
    """
    chosen = some_options("diagnose", options, channel=channel, motions=motions, effects=effects)
    channel, motions, effects = chosen.channel, chosen.motions, chosen.effects
    settings, progress = settings or DEFAULT, progress or quiet
    since = time.perf_counter()
    with one_blas_thread():
        if reference is not None:
            if tell is not None:
                raise InputError(f"{argument('tell')} and {argument('reference')} are both given; leave one of them out")
            progress("reading")
            experiment, before = as_experiment(experiment), as_experiment(reference)
            progress("what changed since the reference")
            found = compare_with_reference(
                before, experiment, channel, effects=effects, motions=motions, seed=seed, settings=settings
            )
            progress("signs, frames and units")
            said = of_recordings(experiment, (), [x.change.name for x in found.changes])
            said = (*said, *lacking_reference(found.reference.problem), *of_reference(before, said))
            return Changes(found, time.perf_counter() - since, said)
        recorded = as_experiment(experiment)
        recorded = recorded if effects is None else replace(recorded, effects=tuple(effects))
        diagnosis = missing(recorded, chosen, tell, seed, settings, progress, keep_friction=False)
        progress("signs, frames and units")
        following = diagnosis.next_experiment
        if wrong := mistakes(recorded, [f.term.effect.name for f in diagnosis.found]):  # no new recording mends that
            following = "Undo the mistake that the notes name, and diagnose again."
        said = recorded.with_findings([*wrong, *diagnosis.remarks], validated=False)
    return replace(diagnosis, remarks=said, next_experiment=following, seconds=time.perf_counter() - since)


def missing(
    experiment: Experiment, chosen: FitOptions, tell: str | Sequence[str] | None, seed: int, settings: Settings | None,
    progress: Progress, keep_friction: bool = True,
) -> Diagnosis:  # fmt: skip
    """What `diagnose` finds without a reference, and without what is wrong with the recordings themselves.

    ``keep_friction`` says whether friction of the model stays in it where something stays unexplained beside it.
    """
    channel, motions, effects, settings = chosen.channel, chosen.motions, chosen.effects, settings or DEFAULT
    with one_blas_thread():
        if effects is not None:
            experiment = replace(experiment, effects=tuple(effects))
        progress("noise of sensors and encoders")
        channel = channel or default_channel(experiment)
        terms, held = known_terms(experiment, channel, effects)

        def prepared(below: float = inf) -> DiagnosisData:
            return prepare_data(experiment, channel, terms, motions, seed, held, settings, below)

        def checked(found: Search) -> _Decided:
            progress("validation on unseen motions")
            return _decided(found, seed)

        def searched(data: DiagnosisData) -> _Decided:
            return checked(search(make_projector(data, data.terms), data.terms, seed, progress))

        whole, push = prepared(), None
        rivals = names(tell)
        if rivals is not None:  # what cannot be is refused before the long work
            parse_effects(whole, rivals)
            if all(segment.still for segment in whole.segments):
                raise InputError(f"{argument('tell')}: only poses at rest are fitted, which say nothing of a motion's noise")
        suspected = find_push(fit(make_projector(whole, whole.terms), whole.terms)) if channel == "wrench" else None
        result = searched(whole)
        # What pushed with a constant force may have wavered: so much that it is worth a course? A floor that repeats or the
        # library leave may hold the push.
        hidden = result.verdict == "nothing_missing" and result.search.projector.data.floor_source != WHITE
        if suspected and (hidden or result.verdict == "unknown" or any(f.term.effect.once for f in result.sure.found)):
            push = find_push(result.search.base, result.search.best)
        if push is not None:
            progress("without the time of a push")
            result = searched(without_push(whole, push, seed))
        named = result.verdict != "unknown"
        closed = named and result.gap is not None and result.gap.closed > settings.nearly_all
        if push is None and not closed and (below := holds_below(result.search, named)) < inf:
            again = searched(prepared(below))
            result = result if again.verdict == "unknown" else again
        between = between_turns(whole, result.search, seed) if result.verdict == "unknown" else None
        if between is not None:
            progress("between the times at which joints turn")
            result = searched(between)
        tried = None
        if result.verdict == "unknown" and not keep_friction:
            other = _without_friction(result.search, chosen, tell, seed, progress)
            if other is not None:
                return other
        if result.verdict == "unknown":
            progress("effects that held-out recordings confirm")
            tried = proven_effects(result.search, seed)
            if push is None and between is None:
                tried = _where_it_predicts(result.search, tried, prepared, seed, progress)
            if tried is not None and leaves_noise(tried.search):
                again = checked(search_from(result.search, tried.search.best.terms, seed, progress))
                result, tried = (result, tried) if again.verdict == "unknown" else (again, None)

        def concluded(refused: Refusal | None) -> Diagnosis:
            out = _with_errors(_concluded(result, tried, refused, seed), push, motions, progress)
            if push is not None:
                out = _with_push(out, push, whole)
            return _with_description(_with_next_motion(out, rivals, seed, progress), seed, progress)

        diagnosis = concluded(None)
        worse = diagnosis.part is not None and predicted_worse(diagnosis.errors)
        if diagnosis.part is not None and (worse or stands_alone(diagnosis.description)):
            other = concluded("worse" if worse else "imitates")
            diagnosis = other if worse or stands_alone(other.description) else diagnosis
    return diagnosis


def _without_friction(
    s: Search, chosen: FitOptions, tell: str | Sequence[str] | None, seed: int, progress: Progress
) -> Diagnosis | None:
    """The diagnosis with the user's friction left out, if its model predicts recordings held out in turn better than the user's.

    Friction that a model states hides of which kind a joint's is: beside Coulomb friction no bristle is sought, and what little
    other friction closes of the gap that stays is too little to be named.
    """
    data, experiment = s.projector.data, s.projector.data.experiment
    friction = [t for t in s.base.terms if t.effect.wanders]
    names = {t.effect.name for t in friction} - {t.effect.name for t in friction if data.fixed(t)}
    if not names:
        return None
    progress("friction of the model left out")
    rest = replace(
        experiment, effects=tuple(spec for spec in experiment.effects if spec.split("@")[0] not in names),
        effect_values={spec: values for spec, values in experiment.effect_values.items() if spec.split("@")[0] not in names},
    )  # fmt: skip
    found = missing(rest, replace(chosen, effects=None), tell, seed, data.settings, progress)
    if found.verdict == "unknown" or not predicts_better(found.search.best, s.base, s.base, seed):
        return None
    stated = {t.effect for t in friction}
    new = [f.term for f in found.found if f.term.effect not in stated]
    gone = [t for t in friction if t.effect.name in names and t.effect not in {f.term.effect for f in found.found}]
    told = (
        f"Beside the model's {', '.join(sorted(names))} something stays that no effect explains, so this was left out and "
        "sought anew: what is named now predicts recordings held out in turn better. Shares of the gap are those of the model "
        "without it."
        + (f" The model did not state {', '.join(by_kind(new))}." if new else "")
        + (f" Of what it stated, {', '.join(by_kind(gone))} {'is' if len(gone) == 1 else 'are'} not found." if gone else "")
    )
    found = replace(found, remarks=(told, *found.remarks), left_out=tuple(sorted(names)))
    return _with_errors(found, None, chosen.motions, progress, experiment)


def _where_it_predicts(
    s: Search, tried: InPart | None, prepared: Callable[[float], DiagnosisData], seed: int, progress: Progress
) -> InPart | None:
    """What is proven up to the bandwidth at which `bayesid.identify` predicts best, if that lies within what was compared.

    Joints vibrate as no rigid model does, and where they do all effects are small. What is found below has to predict recordings
    held out in turn better there than what was found before, None where that is nothing.
    """
    data = s.projector.data
    if data.poses:
        return tried
    model = (tried.search if tried else s).best
    effects, values = fitted_model(data.experiment, [t.effect.spec for t in model.terms], model.terms)
    motions = tuple(dict.fromkeys(x.motion for x in data.segments))
    stated = replace(data.experiment, effects=effects, effect_values=values)
    below = chosen_bandwidth(stated, FitOptions(data.channel, motions=motions))
    if below >= max(x.frequencies[-1] for x in data.segments):
        return tried
    progress("effects below the frequencies at which joints vibrate")
    lower = with_data(s, prepared(below))
    found = proven_effects(lower, seed)
    if found is None or (tried is not None and not predicts_better(found.search.best, tried.search.best, lower.base, seed)):
        return tried
    return replace(found, below=below)


@dataclass(frozen=True, eq=False)
class _Decided:
    """What a search found, and the verdict on it."""

    #: All that it found, and without what does not differ from zero.
    search: Search
    sure: Search
    gap: Gap | None  # of the latter on motions that were not fitted
    stability: tuple[Stability | None, ...]  # of its effects
    #: And why, if that is ``unknown``.
    verdict: Verdict
    reason: Reason


def _decided(s: Search, seed: int) -> _Decided:
    sure = certain(s, seed)
    gap = validate(s.projector, s.base, sure.best, s.dispersion, seed)
    parts = _stability(sure, sure.found)
    return _Decided(s, sure, gap, parts, *verdict(evidence_of(sure, gap, parts), s.projector.data.settings))


def _stability(s: Search, named: Sequence[Found]) -> tuple[Stability | None, ...]:
    return stability(s.projector, s.best, len(s.base.terms), named, s.dispersion)


def _concluded(found: _Decided, tried: InPart | None, refused: Refusal | None, seed: int) -> Diagnosis:
    """The verdict on what was found, and everything that goes with it.

    ``tried`` are effects that are proven although something stays; they are not named where something else ``refused`` them.
    """
    s, gap, decided, reason = found.search, found.gap, found.verdict, found.reason
    data: DiagnosisData = s.projector.data
    part, stays, why = None, (), reason
    if decided != "unknown":
        s = found.sure
    else:  # the best attempt is shown as it is
        gap = validate(s.projector, s.base, s.best, s.dispersion, seed, complete=False)
    if tried is not None and refused is None and named_in_part(tried, data.settings):
        closer = validate(tried.search.projector, tried.search.base, tried.search.best, s.dispersion, seed, complete=False)
        if denied(evidence_of(tried.search, closer), data.settings):
            refused = "denied"
        else:
            decided, part, s, gap = "named_in_part", tried, tried.search, closer
            data = s.projector.data
            stays = _places(s, s.best)
    named = () if decided == "unknown" else s.found
    parts = found.stability if part is None else _stability(s, named)
    if part is not None:  # what speaks against naming them without reserve
        why = verdict(evidence_of(s, gap, parts), data.settings)[1]
    return Diagnosis(
        data=data,
        verdict=decided,
        search=s,
        found=named,
        where=_places(s, s.base),
        gap=gap,
        remarks=remarks(s, gap, decided, why, parts, tried, refused or "imitates"),
        next_experiment=next_experiment(decided, named, poses=data.poses, floor_known=data.floor_known),
        stability=parts if named else (),
        part=part,
        reason=why,
        remainder=stays,
    )


def _with_errors(
    result: Diagnosis, push: Push | None, motions: Sequence[str] | None, progress: Progress, stated: Experiment | None = None
) -> Diagnosis:
    """The diagnosis with what `bayesid.identify` finds without and with the effects named, of recordings less a push.

    Without: with the model diagnosed, or with the one ``stated``.
    """
    progress("errors without and with what is named" if result.found else "errors")
    experiment, (effects, values) = stated or result.data.experiment, result.model
    if push is not None:
        experiment = less_push(experiment, push, result.search.base.terms)
    after = replace(experiment, effects=effects, effect_values=values) if result.found else None
    both = before_and_after(experiment, after, FitOptions(result.data.channel, motions=motions))
    shifts = both.shifts if result.data.prior is not None else ()  # of nominal links that are exact nothing moves
    remarks = (*result.remarks, *([both.refused] if both.refused else []))
    return replace(result, errors=both.errors, shifts=shifts, remarks=remarks)


def _with_push(rest: Diagnosis, push: Push, data: DiagnosisData) -> Diagnosis:
    """The diagnosis of what a push leaves, with the push: it is named whatever else is missing."""
    s = rest.search if rest.found else replace(rest.search, best=rest.search.base, found=())
    own = measured_push(push, data, s.best)
    found = (*rest.found, Found(own, own.evidence, own.std))
    decided = {"nothing_missing": "named", "unknown": "named_in_part"}.get(rest.verdict, rest.verdict)
    return replace(rest, search=s, found=found, verdict=decided)


def _places(s: Search, model: Fit) -> tuple[Disagreement, ...]:
    """Find where a model and the data disagree."""
    data: DiagnosisData = s.projector.data
    white = residual_spectra(data, data.segments, model)
    return locate(data, data.segments, white, s.noise_level)


def _with_next_motion(result: Diagnosis, rivals: Sequence[str] | None, seed: int, progress: Progress) -> Diagnosis:
    """The diagnosis with the motion that tells ``rivals`` apart, or else that would settle it, where it is ambiguous."""
    if rivals is None and result.verdict != "ambiguous":
        return result
    progress("the motion that tells them apart")
    try:
        telling = tell_search(result.search, seed=seed) if rivals is None else tell_effects(result.data, rivals, seed=seed)
    except InputError as error:  # a robot whose limits leave no room; the diagnosis stands
        return replace(result, next_experiment=f"{result.next_experiment} No motion was planned: {error}.")
    if telling is None:
        return result
    return replace(result, telling=telling, next_experiment=telling_sentence(telling))


def _with_description(result: Diagnosis, seed: int, progress: Progress) -> Diagnosis:
    """The diagnosis with a draft of what stays, where no effect explains it."""
    at_rest = all(s.still for s in result.data.segments)  # a draft is made of courses in time
    if result.verdict not in ("unknown", "named_in_part") or at_rest:
        return result
    progress("describing what no effect explains")
    s = result.search
    starts = [s.best] if result.found else [s.base, *([s.best] if len(s.best.terms) > len(s.base.terms) else [])]
    return replace(result, description=describe(s.base, starts, s.library, seed))
