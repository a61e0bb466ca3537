"""What the reader of a diagnosis should know, one sentence or two each, and what to record next."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
from scipy.stats import chi2

from bayesid.arguments import argument
from bayesid.diagnosis.data import WHITE, DiagnosisData
from bayesid.diagnosis.forward import unrelated
from bayesid.diagnosis.in_part import InPart
from bayesid.diagnosis.noise_models import SOURCES
from bayesid.diagnosis.rivals import explained
from bayesid.diagnosis.search import Found, Search
from bayesid.diagnosis.stability import Stability
from bayesid.diagnosis.validation import Gap
from bayesid.diagnosis.verdict import Reason, Verdict
from bayesid.effects import Term
from bayesid.effects.segment import late_start
from bayesid.estimators.prior_check import CONFLICT
from bayesid.section import powers

#: Why effects that held-out recordings prove are not named: they imitate what the library lacks, fitted to all other motions they
#: do not predict the validation motions, or the model with them that is handed on predicts those worse than the one without.
Refusal = Literal["imitates", "denied", "worse"]
_REFUSED: dict[Refusal, str] = {
    "imitates": "What imitates an effect that the library lacks closes as much",
    "denied": "Fitted to all fitted motions they predict the validation motions no better",
    "worse": "As `identify` fits the model with them to all fitted motions, validation motions are predicted worse than without",
}
#: Share of a direction's prior variance that the data must explain for it to count.
_CLEAR = 0.01


def by_kind(terms: Iterable[Term]) -> list[str]:
    """``name@place`` of each effect; of a kind at several joints ``name@joint1+joint4``, places in order."""
    places: dict[str, list[str]] = {}
    for t in terms:
        places.setdefault(t.effect.name, []).append(t.effect.where)
    return [f"{name}@{'+'.join(sorted(where))}" for name, where in places.items()]


def held_out_text(data: DiagnosisData, parts: int) -> str:
    """What is held out in turn where there are so many parts: whole motions, or parts of the only one to fit."""
    motions = dict.fromkeys(s.motion for s in (*data.segments, *data.unseen))
    if len(motions) == 1:
        return "parts of the recording held out in turn"
    return f"{'motions' if parts == len(motions) else 'parts of the recordings'} held out in turn"


def remarks(
    search: Search,
    gap: Gap | None,
    verdict: Verdict,
    reason: Reason,
    stability: Sequence[Stability | None],
    part: InPart | None = None,
    refused: Refusal = "imitates",
) -> tuple[str, ...]:
    """Everything worth knowing beside the verdict: why it is unknown first, then the noise, the model, validation, moments.

    ``gap`` is that of the model that is handed on, ``reason`` why its effects are not named without reserve. ``part`` holds
    effects that held-out recordings prove, where that was asked, and ``refused`` says why they are not named all the same.
    """
    data = search.projector.data
    out = _unknown(search, reason) if verdict == "unknown" else []
    if verdict == "unknown" and part is not None:
        out.append(
            f"On {held_out_text(data, part.held_out_parts)} {', '.join(by_kind(f.term for f in part.search.found))} would close "
            f"{100 * (1.0 - part.remainder):.3g} % of the gap. {_REFUSED[refused]}: not named."
        )
    if verdict == "named_in_part" and part is not None and part.groups:
        each = "; ".join(f"{', '.join(g.channels)}: {100 * g.closed:.3g} % by {', '.join(g.effects)}" for g in part.groups)
        out.append(f"Much of the gap stays, but most of it is closed in the channels that these effects act in. {each}.")
    if verdict == "named_in_part" and part is not None and not part.groups:
        out += _in_part(search, reason)
    if verdict == "named_in_part" and part is not None and part.below < np.inf:
        highest = max(x.frequencies[-1] for x in data.segments)
        out.append(
            f"What is named was found up to {highest:.2g} Hz, and shares are of that: with a bandwidth of {part.below:.2g} Hz "
            "recordings held out in turn are predicted best, and there this predicts them better than what, if anything, was "
            f"found up to {data.settings.band:g} Hz. Above, readings follow no model of rigid links."
        )
    if data.floor_source != WHITE:  # the usual one needs no word
        out.append(SOURCES[data.floor_source])
    if any(x.between_turns for x in data.segments):
        out.append(
            f"Torques within {0.5 * data.settings.moment:g} s of where their joint turns or rests are not judged, for most of "
            "what spoke for something missing came from there: friction may stick there, and holds anything. Errors of motions "
            "count them."
        )
    found = () if verdict == "unknown" else search.found
    out += _of_the_model(search, found, gap)
    out += _of_the_validation(search, found, gap, part if verdict == "named_in_part" else None)
    if data.experiment.inertia_rel_std is None:
        out.append(
            "The prior relative standard deviation of the nominal inertias is not stated (inertia_rel_std): every rigid "
            "parameter is free, and a payload or a wrong inertia cannot be told from the nominal model being wrong."
        )
    if verdict in ("nothing_missing", "unknown"):
        out += _of_the_links(search, verdict)
    if found or reason == "moment":
        known = [x for x in stability if x is not None and x.rests_on is not None]
        out += [moment_sentence(x, data.settings.accept, poses=data.poses) for x in known]
    return tuple(out)


def _unknown(search: Search, reason: Reason) -> list[str]:
    """Why nothing is named although something is missing."""
    tried = ", ".join(by_kind(f.term for f in search.found))
    if reason == "residual":
        even = f", even with the best fit of {tried}" if tried else ""
        return [f"Something is missing that no effect of the library explains: residuals stay above the noise{even}."]
    if reason == "denied":
        return [f"{tried} fits the fitted motions, but predicts the unseen ones no better: not named."]
    if reason == "moment":
        return [f"{tried} is not named: it acts throughout a recording, and the evidence is of one moment."]
    if reason == "surrogates":
        together = ", ".join(by_kind((*(f.term for f in search.found), *search.dropped)))
        return [
            f"Only {together} together explain the residual. So many unrelated effects at once are less likely than one that "
            "the library does not have and that they imitate between them: not named."
        ]
    return []


def _in_part(search: Search, reason: Reason) -> list[str]:
    """Why effects are named in part only, although they leave no more than the noise."""
    data = search.projector.data
    why = {
        "surrogates": f"there are {unrelated(search.best, len(search.base.terms))} unrelated effects, and more than "
        f"{data.settings.likely_effects} at once may imitate between them one that the library does not have",
        "denied": "the validation motions are not for certain predicted better with them",
        "": "the search by log evidence alone ended at other effects, which leave more",
    }.get(reason)
    still = ", although what stays is no more than the noise of sensor and encoders explains" if data.floor_known else ""
    return [f"Named in part{still}: {why}."] if why else []


def _of_the_model(search: Search, found: Sequence[Found], gap: Gap | None) -> list[str]:
    """Remarks on the effects in and beside the model, and how the readings are taken."""
    data, out = search.projector.data, []
    tried = ", ".join(by_kind(f.term for f in found))
    if found and search.dropped:
        out.append(
            f"{tried} explain {100 * explained(search.base, search.best):.3g} % of what stands out of the noise. What is left "
            f"would fit {', '.join(by_kind(search.dropped))}, but is no more than these models may be inexact by: not named."
        )
    if search.vague:
        counted = ", and the values and intervals of what is named are those beside it" if found else ""
        out.append(
            f"{', '.join(by_kind(search.vague))} would fit what is left, but the motions do not show how large it would be, nor "
            f"that it is not zero: not named. Something may still be missing{counted}."
        )
    parts = {t.effect.name for t in data.terms}
    if idle := [spec for spec in data.experiment.effects if spec.split("@")[0] not in parts]:
        out.append(
            f"{', '.join(idle)} of the model cannot be seen in what is compared ({argument('channel', data.channel)}), "
            "and took no part."
        )
    out += late_start(max(abs(x.times[0]) for x in data.segments))
    if data.instants:
        out.append("Readings fit better as values at their times than as means over a sample's time, so they are taken for that.")
    positions = np.vstack([s.trajectory.positions for s in data.segments])
    negative = [
        f.term for f in found
        if any(never and value < 0.0 for never, value in zip(f.term.effect.non_negative, f.term.values, strict=True))
    ]  # fmt: skip
    if negative:
        out.append(
            f"{', '.join(by_kind(negative))} {'is' if len(negative) == 1 else 'are'} negative, as no joint's friction is: the "
            "drive may take more friction compensation out of the readings than the joint has, friction may fall with speed "
            "(Stribeck), or what the library lacks acts like it on these motions. It predicts readings, and is for no simulator."
        )
    out += [sentence for f in found for sentence in (*_at_an_end(f.term), *f.term.caveats(positions))]
    hidden = gap is not None and not gap.closed_low > 0.0
    if found and hidden and all(f.term.effect.changes_link for f in found):
        count = search.projector.root.shape[1]
        far, near = (float(np.sum(f.coordinates[:count] ** 2)) for f in (search.base, search.best))
        out.append(
            f"The residual does not show {tried}, for changed links stand in for it on all motions. What speaks for it is the "
            f"links' prior: the squared distance from the nominal links, in prior standard deviations, is {far:.3g} without it "
            f"and {near:.3g} with it, for {count} parameters."
        )
    return out


def _at_an_end(term: Term) -> list[str]:
    """Which values lie at an end of the range in which they are sought, although readings may ask for others."""
    effect, out = term.effect, []
    each = zip(effect.quantities, term.values, effect.lower, effect.upper, effect.units, strict=True)
    for p, value, lower, upper, unit in each:
        for end, side, other in [(lower, "lower", "smaller"), (upper, "upper", "larger")]:
            if not p.linear and np.isclose(value, end, rtol=1e-9, atol=0.0):
                texts = (f"{value:.3g}", f"{lower:g} to {upper:g}")
                shown, bounds = (f"{text}{'' if unit == '1' else f' {powers(unit)}'}" for text in texts)
                out.append(
                    f"{effect.spec}: {p.name} {shown} is the {side} end of the range in which it is sought, {bounds}: a {other} "
                    "one may fit better, and the interval does not count that."
                )
    return out


def _of_the_links(search: Search, verdict: str) -> list[str]:
    """Links that the data put further from the nominal ones than these are trusted.

    With u ~ N(0, 1) the links over their prior and S their covariance given the data, estimates scatter by N(0, 1 - S) if data
    and prior are both right [Box1980]_.
    """
    data, count = search.projector.data, search.projector.root.shape[1]
    if data.prior is None or data.experiment.inertia_rel_std is None:
        return []
    half = np.linalg.inv(search.projector.r)
    scatter, axes = np.linalg.eigh(np.eye(count) - (half @ half.T)[:count, :count])
    clear = scatter > _CLEAR
    distance = np.sum((axes[:, clear].T @ search.best.coordinates[:count]) ** 2 / scatter[clear])
    chance = chi2.sf(distance, clear.sum())
    if not clear.any() or chance > CONFLICT:
        return []
    away = search.best.links - data.prior.mean
    masses = away[::10] / np.sqrt(np.diag(data.prior.covariance)[::10])
    k = int(np.argmax(np.abs(masses)))
    why = "A body that hangs there, a wrong URDF or too much trust: too little to name one of them, for a link has ten numbers."
    if verdict == "unknown":
        why = "A body that hangs there or was taken off, a wrong URDF, too much trust, or what is missing puts them there."
    return [
        f"The links lie further from the nominal ones than inertia_rel_std = {data.experiment.inertia_rel_std:g} allows: squared "
        f"distance {distance:.3g} where about {clear.sum()} is expected (probability {chance:.1g}). Of the masses it is most in "
        f"that of {data.robot.body_names[k]}, {search.best.links[10 * k]:.3g} kg, nominally {data.prior.mean[10 * k]:.3g}. {why}"
    ]


def _of_the_validation(search: Search, found: Sequence[Found], gap: Gap | None, part: InPart | None) -> list[str]:
    """Remarks on the held-out motions."""
    data, out = search.projector.data, []
    if gap is not None and gap.floor**2 > 2.0:
        out.append(
            "The unseen motions say little: a complete model would be off there by far more than the noise, for the fitted "
            "motions leave its parameters that uncertain."
        )
    if data.skipped:
        reasons = dict.fromkeys(why for _, why in data.skipped)
        each = [f"{', '.join(name for name, own in data.skipped if own == why)} ({why})" for why in reasons]
        out.append(f"Not compared in the search: {'; '.join(each)}.")
    if found and gap is None:
        one = len(found) == 1
        if part is None:
            what = "the effect is" if one else "the effects are"
            out.append(f"Held-out validation is missing: {what} named on the fitted motions alone.")
        else:
            what, they = ("effect", "it is") if one else ("effects", "they are")
            parts = held_out_text(data, part.held_out_parts)
            out.append(f"No other motion validates the {what}: {they} confirmed on {parts}.")
    return out


def poses_text(start: float, end: float) -> str:
    """``pose 23`` or ``poses 3 to 5`` of positions in the order of a table, which begin at zero."""
    first, last = (round(x) + 1 for x in (start, end))
    return f"pose {first}" if last <= first else f"poses {first} to {last}"


def moment_sentence(stability: Stability, needed: float, *, poses: bool = False) -> str:
    """That an effect rests on one moment, or on some ``poses`` of many, where it needs so much log evidence."""
    at = stability.rests_on
    if at is None:
        return ""
    where = poses_text(at.start, at.end) if poses else f"one moment, {at.start:.1f} to {at.end:.1f} s"
    them = "them" if poses and at.end > at.start else "it"
    text = f"{stability.spec} rests on {where} of ‘{at.motion}’: without {them} "
    least = f"{stability.least:.0f}" if abs(stability.least) >= 100.0 else f"{stability.least:.3g}"
    least = least.replace("-", "−")
    if stability.least < needed:
        text += f"the log evidence is {least}, too little to name it."
    else:
        text += f"only {least} of the log evidence is left."
    return f"{text} See what happened there, or record {them} again."


def next_experiment(verdict: Verdict, found: Sequence[Found], *, poses: bool = False, floor_known: bool = True) -> str:
    """What to record next, in a sentence; of ``poses`` at rest where these were fitted."""
    if poses:
        return _next_poses(verdict, found)
    if verdict == "nothing_missing" and not floor_known:
        return (
            "Record the robot at rest for half a minute, and one motion twice, so that the noise is known; then one joint at a "
            "time, slowly and fast, to see whether anything is missing that the library does not have."
        )
    if verdict == "ambiguous" and all(len(f.rivals) == len(f.together) for f in found):
        pairs = "; ".join(f"{f.term.effect.spec} from {' and '.join(f.together)}" for f in found if f.together)
        return f"No motion tells {pairs}. Joint torques beside a wrench may, and the gear ratio of the data sheet (gear_ratio)."
    if verdict == "ambiguous":
        return (
            f"To tell {_open_names(found)}: move other joints and repeat the motion at half and at full speed; effects that "
            "look alike on one motion differ in how they grow with speed and change with posture."
        )
    if verdict in ("unknown", "named_in_part"):
        return (
            "Record one joint at a time, slowly and fast, forth and back through the same poses: what stays with position is a "
            "spring, a cable or a calibration; what changes sign with velocity is friction or drag; what grows with acceleration "
            "is inertia or delay."
        )
    if verdict == "nothing_missing":
        return "Nothing is left to settle with these motions; faster motions of all joints would show smaller effects."
    return "Repeat the validation on a new motion with the effect in the model (model.toml), to see the smaller gap hold."


def _open_names(found: Sequence[Found]) -> str:
    """Effects and those that explain as much."""
    pairs = [(f.term.effect.spec, ", ".join(t.effect.spec for t, _ in f.rivals)) for f in found if f.rivals]
    return "; ".join(f"{a} from {b}" for a, b in pairs)


def _next_poses(verdict: Verdict, found: Sequence[Found]) -> str:
    """What to record next where poses at rest were fitted."""
    if verdict == "ambiguous":
        return (
            f"To tell {_open_names(found)}: record other poses, with the sensor turned into other directions against gravity, "
            "and the same poses with a known mass attached; effects that look alike at these poses differ in how they grow with "
            "the load and change with its direction."
        )
    if verdict in ("unknown", "named_in_part"):
        return (
            "Record more poses, of one joint at a time and with two different loads: what stays with position is a spring, a "
            "cable or a calibration; what grows with the load is a gain, a cross-talk or something that bends; what is the same "
            "in all poses is an offset."
        )
    if verdict == "nothing_missing":
        return "Nothing is left to settle with these poses; other poses and a heavier load would show smaller effects."
    return "Repeat the validation on new poses with the effect in the model (model.toml), to see the smaller gap hold."
