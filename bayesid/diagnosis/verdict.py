"""The verdict as a pure function of a few numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bayesid.diagnosis.data import FAR
from bayesid.diagnosis.forward import unrelated
from bayesid.diagnosis.in_part import InPart
from bayesid.diagnosis.rivals import explained
from bayesid.diagnosis.search import Search
from bayesid.diagnosis.settings import Settings
from bayesid.diagnosis.stability import Stability
from bayesid.diagnosis.validation import Gap

#: ``named_in_part`` is decided on held-out recordings (`bayesid.diagnosis.in_part`) where this module says ``unknown``.
Verdict = Literal["named", "named_in_part", "ambiguous", "unknown", "nothing_missing"]
#: Why a verdict is ``unknown``: a residual that nothing explains, held-out motions that deny what was found, an effect
#: of the whole recording that one moment of it speaks for, or so many effects that they stand in for one that the library lacks.
Reason = Literal["", "residual", "denied", "moment", "surrogates"]


@dataclass(frozen=True)
class Evidence:
    """What a verdict rests on."""

    residual: float  # mean square of whitened residuals that the best model leaves on the fitted motions; 1 is noise
    explained: float  # share of what stood out of the noise there that it explains
    effects: int  # how many effects were found
    unrelated: int = 0  # how many of them are unrelated: one kind at most joints counts once
    dropped: bool = False  # whether others, that the data demanded too, were left out for their small share
    rivals: bool = False  # whether another effect explains as much as one of those found
    #: Whether held-out motions cannot deny the effects found: a contact does not come again, and of a changed link the same
    #: motion is predicted as well by many links that are a little off.
    unconfirmable: bool = False
    far: bool = False  # whether the richest model leaves so much more than the measured noise that it stands in for that
    momentary: bool = False  # whether an effect would not be named without one moment of the recordings
    #: Root mean squares on the held-out motions, without and with the effects and of a complete model; None without such
    #: motions.
    before: float | None = None
    after: float | None = None
    floor: float | None = None
    #: Share of the gap on them that is closed, and the lower end of its interval; nan where there was no gap.
    closed: float = float("nan")
    closed_low: float = float("nan")
    difference: float = float("inf")  # sum of squares of what the effects change on them, in units of the noise


def evidence_of(search: Search, gap: Gap | None, stability: Sequence[Stability | None] = ()) -> Evidence:
    """The numbers that a verdict rests on; ``gap`` is None without held-out motions, ``stability`` of each effect found."""
    least = search.projector.data.settings.accept
    terms = [f.term for f in search.found]
    numbers = ("before", "after", "floor", "closed", "closed_low", "difference")
    given = {} if gap is None else {k: float(getattr(gap, k)) for k in numbers}
    return Evidence(
        residual=search.best.chi2 / search.projector.rows,
        explained=explained(search.base, search.best),
        effects=len(terms),
        far=search.projector.data.floor_source == FAR,
        unrelated=unrelated(search.best, len(search.base.terms)),
        dropped=bool(search.dropped),
        rivals=any(f.rivals for f in search.found),
        # Poses are few, and each was chosen for what it shows.
        momentary=not all(s.apart for s in search.projector.data.segments)
        and any(x is not None and x.rests_on is not None and x.least < least for x in stability),
        unconfirmable=all(t.effect.once or t.effect.changes_link for t in terms),
        **given,
    )


def nearly_complete(e: Evidence, s: Settings) -> bool:
    """Whether the model closes nearly all of the gap, so that what it leaves is its own inexactness."""
    if e.after is None or e.floor is None:
        return False
    return e.closed > s.nearly_all and e.after**2 <= s.unexplained * e.floor**2 and e.explained > s.nearly_all


def denied(e: Evidence, s: Settings) -> bool:
    """Whether held-out motions deny the effects: worse, or no better where there was a gap."""
    if e.before is None or e.after is None:
        return False
    # Where the effects change too little to stand out of the noise, that nothing is better denies nothing.
    return e.difference >= s.detected**2 and (e.after > e.before or e.closed_low <= 0.0)


def verdict(evidence: Evidence, settings: Settings) -> tuple[Verdict, Reason]:
    """The verdict, and why if it is ``unknown``."""
    e, s = evidence, settings
    nearly = nearly_complete(e, s)
    # What is left is the model's own inexactness only if held-out motions are predicted to about the noise itself: a floor that
    # is high because the effects are uncertain vouches for nothing.
    inexact = e.effects > 0 and nearly and e.after is not None and e.after**2 <= s.unexplained
    left = 0.0 if inexact else e.residual
    # What is left of a gap on livelier motions than the fitted ones is no unmodelled effect if it is a small share of the gap.
    forgiven = bool(e.effects) and e.closed > s.nearly_all
    unseen = 0.0 if e.after is None or e.floor is None or forgiven else (e.after / e.floor) ** 2
    if e.far or max(left, unseen) > s.unexplained:
        return "unknown", "residual"
    if not e.effects:
        return "nothing_missing", ""
    if not e.unconfirmable and denied(e, s):
        return "unknown", "denied"
    if e.momentary:
        return "unknown", "moment"
    if e.unrelated > s.likely_effects or (e.dropped and not nearly):
        return "unknown", "surrogates"
    return ("ambiguous" if e.rivals else "named"), ""


def named_in_part(part: InPart, settings: Settings) -> bool:
    """Whether effects that are proven on held-out recordings may be named although something stays.

    What imitates an effect that the library lacks is proven, too, for some of the gap: the names must close most of it, or
    most of it in the channels that they act in.
    """
    least = settings.most
    return part.remainder <= 1.0 - least or (bool(part.groups) and all(g.closed >= least for g in part.groups))
