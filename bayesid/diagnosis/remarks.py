"""What the reader of a diagnosis should know, one sentence or two each, and what to record next."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import chi2

from bayesid.arguments import argument
from bayesid.diagnosis.data import WHITE
from bayesid.diagnosis.in_part import InPart
from bayesid.diagnosis.noise_models import SOURCES
from bayesid.diagnosis.rivals import explained
from bayesid.diagnosis.search import Found, Search
from bayesid.diagnosis.stability import Stability
from bayesid.diagnosis.validation import Gap
from bayesid.diagnosis.verdict import Reason, Verdict
from bayesid.effects import Term
from bayesid.estimators.prior_check import CONFLICT

#: Share of a direction's prior variance that the data must explain for it to count.
_CLEAR = 0.01
#: From here on the slope of a drift is lost in its size at the start [s]: a day.
_LATE = 1e5


def by_kind(terms: Iterable[Term]) -> list[str]:
    """``name@place`` of each effect; of a kind at several joints ``name@joint1+joint4``, places in order."""
    places: dict[str, list[str]] = {}
    for t in terms:
        places.setdefault(t.effect.name, []).append(t.effect.where)
    return [f"{name}@{'+'.join(sorted(where))}" for name, where in places.items()]


def remarks(
    search: Search,
    gap: Gap | None,
    verdict: Verdict,
    reason: Reason,
    stability: Sequence[Stability | None],
    part: InPart | None = None,
    worse: bool = False,
) -> tuple[str, ...]:
    """Everything worth knowing beside the verdict: why it is unknown first, then the noise, the model, validation, moments.

    ``gap`` is that of the model that is handed on. ``part`` holds effects that held-out recordings prove, where that was asked,
    and ``worse`` says whether they make the validation motions worse once they are fitted to all others.
    """
    data = search.projector.data
    out = _unknown(search, reason) if verdict == "unknown" else []
    if verdict == "unknown" and part is not None:
        out.append(
            f"On recordings held out in turn {', '.join(by_kind(f.term for f in part.search.found))} would close "
            f"{100 * (1.0 - part.remainder):.3g} % of the gap. "
            + (
                "Fitted to all fitted motions they predict the validation motions no better"
                if worse
                else "What imitates an effect that the library lacks closes as much"
            )
            + ": not named."
        )
    if verdict == "named_in_part" and part is not None and part.groups:
        each = "; ".join(f"{', '.join(g.channels)}: {100 * g.closed:.3g} % by {', '.join(g.effects)}" for g in part.groups)
        out.append(f"Much of the gap stays, but most of it is closed in the channels that these effects act in. {each}.")
    if data.floor_source != WHITE:  # the usual one needs no word
        out.append(SOURCES[data.floor_source])
    found = () if verdict == "unknown" else search.found
    out += _of_the_model(search, found, gap)
    out += _of_the_validation(search, found, gap)
    if data.experiment.inertia_rel_std is None:
        out.append(
            "The prior relative standard deviation of the nominal inertias is not stated (inertia_rel_std): every rigid "
            "parameter is free, and a payload or a wrong inertia cannot be told from the nominal model being wrong."
        )
    if verdict == "nothing_missing":
        out += _of_the_links(search)
    if found or reason == "moment":
        out += [moment_sentence(x, data.settings.accept) for x in stability if x is not None and x.rests_on is not None]
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


def _of_the_model(search: Search, found: Sequence[Found], gap: Gap | None) -> list[str]:
    """On the effects in and beside the model, and how the readings are taken."""
    data, out = search.projector.data, []
    tried = ", ".join(by_kind(f.term for f in found))
    if found and search.dropped:
        out.append(
            f"{tried} explain {100 * explained(search.base, search.best):.3g} % of what stands out of the noise. What is left "
            f"would fit {', '.join(by_kind(search.dropped))}, but is no more than these models may be inexact by: not named."
        )
    parts = {t.effect.name for t in data.terms}
    if idle := [spec for spec in data.experiment.effects if spec.split("@")[0] not in parts]:
        out.append(
            f"{', '.join(idle)} of the model cannot be seen in what is compared ({argument('channel', data.channel)}), "
            "and took no part."
        )
    if (start := max(abs(x.times[0]) for x in data.segments)) > _LATE:
        out.append(
            f"Times start at {start:.3g} s. A drift and a drive's warming count from time zero, so that they look constant "
            "here; subtract the start."
        )
    if data.instants:
        out.append(
            "Dry friction fits better with readings as values at their times than as means over a sample's time, so they are "
            "taken for that."
        )
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


def _of_the_links(search: Search) -> list[str]:
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
    return [
        f"The links lie further from the nominal ones than inertia_rel_std = {data.experiment.inertia_rel_std:g} allows: squared "
        f"distance {distance:.3g} where about {clear.sum()} is expected (probability {chance:.1g}). Of the masses it is most in "
        f"that of {data.robot.body_names[k]}, {search.best.links[10 * k]:.3g} kg, nominally {data.prior.mean[10 * k]:.3g}. A "
        "body that hangs there, a wrong URDF or too much trust: too little to name one of them, for a link has ten numbers."
    ]


def _of_the_validation(search: Search, found: Sequence[Found], gap: Gap | None) -> list[str]:
    """On the held-out motions."""
    data, settings, out = search.projector.data, search.projector.data.settings, []
    if gap is not None and gap.floor**2 > 2.0:
        out.append(
            "The unseen motions say little: a complete model would be off there by far more than the noise, for the fitted "
            "motions leave its parameters that uncertain."
        )
    if data.skipped:
        out.append(
            f"Not compared: {', '.join(data.skipped)}; a validation motion needs the same readings and a segment of "
            f"{settings.shortest_segment:g} s without a gap."
        )
    if found and gap is None:
        out.append(
            "No validation motion was compared: the effect is named on the fitted motions alone, and held-out validation is "
            "missing."
        )
    return out


def moment_sentence(stability: Stability, needed: float) -> str:
    """That an effect rests on one moment, where it needs so much log evidence."""
    at = stability.rests_on
    if at is None:
        return ""
    text = f"{stability.spec} rests on one moment, {at.start:.1f} to {at.end:.1f} s of ‘{at.motion}’: without it "
    least = f"{stability.least:.0f}" if abs(stability.least) >= 100.0 else f"{stability.least:.3g}"
    least = least.replace("-", "−")
    if stability.least < needed:
        text += f"the log evidence is {least}, too little to name it."
    else:
        text += f"only {least} of the log evidence is left."
    return f"{text} See what happened there, or record it again."


def next_experiment(verdict: Verdict, found: Sequence[Found]) -> str:
    """What to record next, in a sentence."""
    if verdict == "ambiguous":
        pairs = [(f.term.effect.spec, ", ".join(t.effect.spec for t, _ in f.rivals)) for f in found if f.rivals]
        names = "; ".join(f"{a} from {b}" for a, b in pairs)
        return (
            f"To tell {names}: move other joints and repeat the motion at half and at full speed; effects that look alike "
            "on one motion differ in how they grow with speed and change with posture."
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
