"""Whether what was found rests on the whole recording or on one moment: every estimate and its evidence without each part.

Without a block of time one Gauss-Newton step from the estimate on all data gives the estimate of the rest
(`bayesid.diagnosis.grams`), with links and offset among the unknowns, by the orthonormal factor Q of the `NuisanceProjector`.
The evidence is that of the block's complement: what the remaining rows lose without the effect, once everything else has made up
for it as well as it can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import idct

from bayesid.diagnosis.data import residual_rows
from bayesid.diagnosis.fit import ALIVE, Fit
from bayesid.diagnosis.grams import Grams, squared
from bayesid.diagnosis.projector import NuisanceProjector
from bayesid.diagnosis.rivals import Found

#: A parameter is not determined without a block if its variance grows by more than this.
_LOST = 1e6


@dataclass(frozen=True)
class Moment:
    """A part of a recording: its motion, start and end [s]."""

    start: float
    end: float
    motion: str


@dataclass(frozen=True)
class Stability:
    """An effect without each part of the recordings."""

    spec: str  # ``name@where``
    blocks: int  # number of parts
    least: float  # its smallest log evidence without one of them
    #: The part that carries it, or None: so much of the evidence that the rest would not do to name it, and more than is even.
    rests_on: Moment | None
    #: By parameter, the smallest and largest estimate without a part; infinite where one part alone determines it.
    ranges: tuple[tuple[float, float], ...]

    def to_dict(self) -> dict:
        """The entry ``stability`` of an effect."""
        at = self.rests_on
        return {
            "blocks": self.blocks,
            "least_log_bayes_factor": self.least,
            "rests_on": None if at is None else [at.start, at.end, at.motion],
            "ranges": [[v if np.isfinite(v) else None for v in pair] for pair in self.ranges],
        }


def stability(
    projector: NuisanceProjector, best: Fit, known: int, found: Sequence[Found], dispersion: float
) -> tuple[Stability | None, ...]:
    """Every effect found without each part of the recordings; None for one that happens at one moment by its nature.

    The first ``known`` effects of the model are the user's; ``found`` follow in the model's order. ``dispersion`` is the mean
    square of what counts as noise.
    """
    if not found:
        return ()
    settings = projector.data.settings
    grams, moments = _grams(projector, best, known)
    every, parts = range(len(best.terms)), np.stack([grams.whole, *(grams.whole - grams.blocks)])
    amplitudes, variances, complete = grams.fitted(parts, every)[1], grams.variances(parts), grams.cost(every, parts)
    # A fit that stopped a little before its minimum would take the rest of the way in every block: that is none of theirs.
    steps, lost = amplitudes[1:] - amplitudes[0], variances[1:] > _LOST * variances[0]
    out: list[Stability | None] = []
    for k, f in enumerate(found):
        index = known + k
        at = [column for column, (owner, _) in enumerate(best.free) if owner == index]
        if f.term.effect.once or not at:
            out.append(None)
            continue
        gains = np.maximum(grams.cost([i for i in every if i != index], parts) - complete, 0.0)  # of chi2, all else fitted anew
        price = grams.prices[index] / dispersion
        share = np.clip(gains[1:] / max(gains[0], 1e-300), 0.0, None)
        left = (f.gain + price) * share - price
        worst = int(np.argmin(left))
        carried = 1.0 - share[worst] > settings.most
        out.append(
            Stability(
                f.term.effect.spec, len(moments), float(left[worst]), moments[worst] if carried else None,
                _ranges(f, steps[:, at], lost[:, at]),
            )
        )  # fmt: skip
    return tuple(out)


def _ranges(found: Found, steps: np.ndarray, lost: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Smallest and largest estimates (k pairs) inside what is possible, from steps (b, k)."""
    effect = found.term.effect
    values = np.clip(np.array(found.term.values) + steps, effect.lower, effect.upper)
    low = np.where(lost, -np.inf, values).min(axis=0)
    high = np.where(lost, np.inf, values).max(axis=0)
    return tuple((float(a), float(b)) for a, b in zip(low, high, strict=True))


def _grams(projector: NuisanceProjector, best: Fit, known: int) -> tuple[Grams, list[Moment]]:
    """Inner products with links and offset projected out of all columns, and when each block was."""
    data = projector.data
    kept, jacobian = projector.columns(best.jacobian), best.jacobian
    kept[:, np.linalg.norm(kept, axis=0) < ALIVE * np.linalg.norm(jacobian, axis=0)] = 0.0
    traces = [
        residual_rows(data, data.segments, best.links, best.offset, tuple(t for k, t in enumerate(best.terms) if k != i))
        - best.residual
        for i in range(known, len(best.terms))
    ]
    prior_residual = projector.prior_residual(best.coordinates)
    rest = projector.columns(np.stack(traces, axis=1))
    users = np.zeros((len(rest), known))  # the user's effects are never left out
    columns = np.hstack([kept, users, rest, np.concatenate([best.residual, -prior_residual])[:, None]])
    prior = np.hstack([projector.q[projector.length :], columns[projector.length :]])
    blocks, moments, row = [], [], 0
    total, moment = sum(s.times[-1] - s.times[0] for s in data.segments), 1.0 - data.settings.nearly_all
    for s in data.segments:
        size = s.shape[0] * s.shape[1]
        mine = np.hstack([projector.q[row : row + size], columns[row : row + size]]).reshape(*s.shape, -1)
        row += size
        course = np.asarray(idct(mine, axis=0, norm="ortho"))
        length = s.times[-1] - s.times[0]
        count = int(np.clip(round(length / (total * moment)), 1, len(course)))
        edges = np.linspace(0, len(course), count + 1).astype(int)
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            blocks.append(squared(course[a:b]))
            start, end = (float(s.times[0] + length * x / len(course)) for x in (a, b))
            moments.append(Moment(start, end, s.motion))
    owners = np.array([owner for owner, _ in best.free], int)
    return Grams(np.array(blocks), prior.T @ prior, projector.size, owners, len(best.terms), projector.rows), moments
