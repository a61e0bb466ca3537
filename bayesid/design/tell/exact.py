"""The closed form checked: rivals fitted exactly to the recordings and to what one of them predicts of a planned motion.

The closed form takes readings for linear in what is not known. A hose, say, whose ends and stiffness are free is not: on the new
motion another one may do that is far from the one that explained the old. So the readings that rival i predicts of the motion are
made, without noise, and rival j is fitted to old and new recordings together, from its estimate and from where a search for it
would start. By how much more chi2 than so far it then lacks is ``lambda'`` in place of ``lambda_ij``: the predictions are as far
apart as ``sqrt(lambda' / lambda_ij)`` of what the closed form says. Where it lacks less than so far, its fit so far was poor,
and its evidence counts for more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.design.tell.evidence import Contest, Rival
from bayesid.design.tell.motions import Planned
from bayesid.design.tell.planned_rows import Bench
from bayesid.design.tell.predicted import predicted
from bayesid.design.tell.rivals import Case
from bayesid.diagnosis.candidates import make_library
from bayesid.diagnosis.fit import advance, begin, fit
from bayesid.diagnosis.projector import NuisanceProjector, make_projector

#: Rivals less probable than this are not tried as the true one.
_PROBABLE = 0.05
#: Steps of each start, how many starts go on, and steps of those.
_RACE, _KEPT, _STEPS = 3, 2, 9


def checked(contest: Contest, case: Case, bench: Bench, motion: Planned) -> Contest:
    """A contest with the distances between predictions that exact fits leave.

    Parameters
    ----------
    contest
        The closed form for the motion.
    case, bench, motion
        What it was made of.
    """
    first = case.rivals[0].fit
    data, segment = first.projector.data, bench.segment(motion, first)
    projector = make_projector(replace(data, segments=(*data.segments, segment)), first.terms)
    count = len(case.rivals)
    shares, lost = np.ones((count, count)), np.zeros((count, count))
    for i in np.flatnonzero(case.weights >= _PROBABLE):
        true = case.rivals[i]
        read = predicted(data, segment, true.fit.links, true.fit.offset, true.fit.terms)
        there = replace(projector, data=replace(data, segments=(*data.segments, read)))
        for j, other in enumerate(case.rivals):
            if i != j:
                more = (_imitated(there, true, other) - other.fit.chi2) / other.dispersion
                shares[i, j] = np.sqrt(np.clip(more / max(contest.noncentrality[i, j], 1e-12), 0.0, 1.0))
                lost[i, j] = 0.5 * max(-more, 0.0)
    return replace(contest, shares=shares, lost=lost)


def _imitated(projector: NuisanceProjector, true: Rival, other: Rival) -> float:
    """The smallest chi2 that a rival reaches where another one is true."""
    effects = {t.effect for t in true.fit.terms}
    apart = [t for t in other.fit.terms if t.effect not in effects]
    races = [advance(begin(projector, other.fit.terms, other.fit), _RACE)]
    if len(apart) == 1 and apart[0].effect.shape:
        held = tuple(t for t in other.fit.terms if t.effect in effects)
        without = fit(projector, held, other.fit, _RACE)
        library = make_library(projector, without, effects=[apart[0].effect])
        starts = [start for p in library.propose(without) for start in (p.term, *p.others)]
        races += [advance(begin(projector, (*held, start), without), _RACE) for start in starts]
    best = sorted((r for r in races if np.isfinite(r.chi2)), key=lambda r: r.chi2)[:_KEPT]
    return min((advance(r, _STEPS).chi2 for r in best), default=np.inf)
