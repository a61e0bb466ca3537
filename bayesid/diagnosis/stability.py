"""Whether what was found rests on the whole recording or on one moment: every estimate and its evidence without each part.

Whitened rows are amplitudes by frequency. Their inverse cosine transform is orthogonal, so it turns rows and columns
into courses in time, K moments for K frequencies, and keeps all inner products: with blocks of time b,

    J'J = sum_b J_b'J_b + P'P,      J'e = sum_b J_b'e_b + P'e_P

where P are the rows of the links' prior. Without block b one Gauss-Newton step from the estimate on all data gives

    dp = (J'J - J_b'J_b)^-1 (J'e - J_b'e_b)

with links and offset among the unknowns, by the orthonormal factor Q of the `NuisanceProjector`. The evidence is that of the
block's complement: what the remaining rows lose without the effect, once everything else has made up for it as well as it can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import idct

from bayesid.diagnosis.data import residual_rows
from bayesid.diagnosis.fit import ALIVE, Fit
from bayesid.diagnosis.projector import NuisanceProjector
from bayesid.diagnosis.rivals import Found

#: A parameter is not determined without a block if its variance grows by more than this.
_LOST = 1e6
#: Curvature of directions that the data do not determine, in units of a column's own.
_FLAT = 1e-9


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


@dataclass(frozen=True, eq=False)
class _Sums:
    """Inner products of all columns: links, effects' parameters, effects' traces, residual."""

    #: Over everything (p, p) and over each block (b, p, p).
    whole: np.ndarray
    blocks: np.ndarray
    #: How many columns of the first two kinds.
    links: int
    parameters: int

    def solved(self, gram: np.ndarray, without: Sequence[int] = (), trace: int | None = None) -> tuple[np.ndarray, float]:
        """Best coefficients (links + parameters,) for inner products, and the squared residual that they leave.

        Parameters in ``without`` are held, and the trace of effect ``trace`` is added to the residual.
        """
        held = {self.links + k for k in without}
        unknown = [k for k in range(self.links + self.parameters) if k not in held]
        target = np.zeros(len(gram))
        target[-1] = 1.0
        if trace is not None:
            target[self.links + self.parameters + trace] = 1.0
        reduced = gram @ target
        scale = np.sqrt(np.maximum(np.diag(self.whole)[unknown], 1e-300))
        square = gram[np.ix_(unknown, unknown)] / np.outer(scale, scale) + _FLAT * np.eye(len(unknown))
        step = np.linalg.solve(square, reduced[unknown] / scale) / scale
        out = np.zeros(self.links + self.parameters)
        out[unknown] = step
        return out, float(target @ reduced - step @ reduced[unknown])

    def variances(self, gram: np.ndarray) -> np.ndarray:
        """Of the parameters (k,), in units of the noise."""
        count = self.links + self.parameters
        scale = np.sqrt(np.maximum(np.diag(self.whole)[:count], 1e-300))
        square = gram[:count, :count] / np.outer(scale, scale) + _FLAT * np.eye(count)
        with np.errstate(over="ignore"):  # infinite for a parameter that nothing shows, as a tether's length while it is slack
            return np.diag(np.linalg.inv(square))[self.links :] / scale[self.links :] ** 2


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
    sums, moments = _sums(projector, best, known)
    less = sums.whole - sums.blocks
    # A fit that stopped a little before its minimum would take the rest of the way in every block: that is none of theirs.
    stopped = sums.solved(sums.whole)[0]
    steps = np.array([(sums.solved(gram)[0] - stopped)[sums.links :] for gram in less])
    lost = np.array([sums.variances(gram) for gram in less]) > _LOST * sums.variances(sums.whole)
    out: list[Stability | None] = []
    for k, f in enumerate(found):
        index = known + k
        at = [column for column, (owner, _) in enumerate(best.free) if owner == index]
        if f.term.effect.once or not at:
            out.append(None)
            continue
        gains = np.array([_gain(sums, gram, at, k) for gram in (sums.whole, *less)])
        price = 0.5 * len(at) * np.log(projector.rows) / dispersion
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


def _gain(sums: _Sums, gram: np.ndarray, at: Sequence[int], effect: int) -> float:
    """How much larger chi2 would be without an effect, all else fitted anew."""
    return max(sums.solved(gram, without=at, trace=effect)[1] - sums.solved(gram)[1], 0.0)


def _ranges(found: Found, steps: np.ndarray, lost: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Smallest and largest estimates (k pairs) inside what is possible, from steps (b, k)."""
    effect = found.term.effect
    values = np.clip(np.array(found.term.values) + steps, effect.lower, effect.upper)
    low = np.where(lost, -np.inf, values).min(axis=0)
    high = np.where(lost, np.inf, values).max(axis=0)
    return tuple((float(a), float(b)) for a, b in zip(low, high, strict=True))


def _sums(projector: NuisanceProjector, best: Fit, known: int) -> tuple[_Sums, list[Moment]]:
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
    columns = np.hstack([kept, rest, np.concatenate([best.residual, -prior_residual])[:, None]])
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
            part = course[a:b].reshape(-1, course.shape[2])
            blocks.append(part.T @ part)
            start, end = (float(s.times[0] + length * x / len(course)) for x in (a, b))
            moments.append(Moment(start, end, s.motion))
    stacked = np.array(blocks)
    return _Sums(stacked.sum(axis=0) + prior.T @ prior, stacked, projector.size, kept.shape[1]), moments
