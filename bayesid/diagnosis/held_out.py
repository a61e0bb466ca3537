"""Fits that leave recordings out in turn, from inner products alone.

Where a robot never comes down to its sensors' noise, whitening gives too much weight to frequencies with little noise. Here
every channel is divided by the root mean square that the best attempt leaves of it, at all frequencies alike. About that attempt
the readings are linear,

    y = A u + J p + e,    u ~ N(0, 1),    e ~ N(0, r),

with the links' columns A over their prior, the effects' columns J, and r rows that count as one, for what a model lacks
follows the motion (`bayesid.estimators.dispersion`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.fft import idct

from bayesid.diagnosis.data import DiagnosisData, model_rows, residual_rows, term_rows
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.gap import lower_end
from bayesid.diagnosis.grams import Grams, squared
from bayesid.diagnosis.spectra import SpectralSegment
from bayesid.diagnosis.validation import residual_spectra, without_offset
from bayesid.effects import Term
from bayesid.estimators.dispersion import PARTS, Rows, dispersions


@dataclass(frozen=True, eq=False)
class HeldOutSums(Grams):
    """Every channel in units of what the best attempt leaves of it, for fits and their evidence; the links are always in."""

    #: (b, p, p), every channel in units of what the user's model leaves of it: for shares, in which all channels count alike.
    shown: np.ndarray = field(kw_only=True)
    groups: np.ndarray = field(kw_only=True)  # which blocks are left out together (b,): a motion, or a part of the only one
    counts: np.ndarray = field(kw_only=True)  # rows of each block (b,)
    unseen: np.ndarray = field(kw_only=True)  # whether a block is of a validation motion (b,)

    @cached_property
    def _rest(self) -> np.ndarray:
        """Over everything but each group (g, p, p)."""
        return np.stack([self.whole - self.blocks[self.groups == g].sum(axis=0) for g in range(self.groups.max() + 1)])

    @cached_property
    def _squares(self) -> dict[frozenset[int], np.ndarray]:
        """What `squares` has found, by effects: the same are asked for again and again while effects are chosen."""
        return {}

    def squares(self, effects: Sequence[int]) -> np.ndarray:
        """Squared prediction errors of every block with these effects, its group left out of the fit (b,)."""
        key = frozenset(effects)
        if key not in self._squares:
            self._squares[key] = self._left_out(effects)
        return self._squares[key]

    def _left_out(self, effects: Sequence[int]) -> np.ndarray:
        left, _ = self.fitted(self._rest, effects)
        at = np.flatnonzero(left.any(axis=0))  # most columns are of effects that are not in the model
        mine = left[self.groups][:, at]
        return np.einsum("bi,bij,bj->b", mine, self.shown[:, at[:, None], at], mine, optimize=True)


def left_by(data: DiagnosisData, model: Fit) -> np.ndarray:
    """Mean square of what a model leaves of every channel on the fitted motions (c,)."""
    white = residual_spectra(data, data.segments, model)
    plain = [np.linalg.solve(s.whitener, w[:, :, None])[:, :, 0] for s, w in zip(data.segments, white, strict=True)]
    square = sum(np.sum(p**2, axis=0) for p in plain) / sum(len(p) for p in plain)
    return np.maximum(square, 1e-18 * np.max(square, initial=1e-200))


def scaled(data: DiagnosisData, square: np.ndarray) -> DiagnosisData:
    """The data with white noise of these mean squares (c,) in all channels."""

    def alike(segments: Sequence[SpectralSegment]) -> tuple[SpectralSegment, ...]:
        return tuple(s.with_noise(np.tile(np.diag(square), (len(s.covariance), 1, 1))) for s in segments)

    return replace(data, segments=alike(data.segments), unseen=alike(data.unseen))


def held_out_sums(
    data: DiagnosisData, root: np.ndarray, best: Fit, candidates: Sequence[Term], weight: np.ndarray
) -> HeldOutSums:
    """Reduce all recordings, as `scaled` gives them, the validation motions among them.

    ``root`` is that of the links' prior (`NuisanceProjector`). Candidates' columns are taken at their values. ``weight`` is
    what the best attempt leaves of each channel over what the user's model leaves of it, root mean squares (c,).
    """
    segments = (*data.segments, *data.unseen)
    blocks, shown, names, counts = [], [], [], []
    for motion in dict.fromkeys(s.motion for s in segments):  # the columns of one motion at a time
        mine = [s for s in segments if s.motion == motion]
        for part, course, count in _by_blocks(data, mine, _columns(data, mine, root, best, candidates)):
            blocks.append(squared(course))
            shown.append(squared(course * weight[:, None]))
            names.append((motion, part))
            counts.append(count)
    order, fitted = list(dict.fromkeys(names)), {s.motion for s in data.segments}
    owners = [i for i, t in enumerate(best.terms) if not data.fixed(t) for _ in t.values]
    owners += [len(best.terms) + i for i, t in enumerate(candidates) for _ in t.values]
    links, stacked = root.shape[1], np.array(blocks)
    prior = np.zeros((links, stacked.shape[2]))
    prior[:, :links], prior[:, -1] = np.eye(links), -best.coordinates[:links]
    sums = HeldOutSums(
        stacked, prior.T @ prior, links, np.array(owners, int), len(best.terms), float(sum(counts)), shown=np.array(shown),
        groups=np.array([order.index(n) for n in names]), counts=np.array(counts),
        unseen=np.array([n[0] not in fitted for n in names]),
    )  # fmt: skip
    groups = [g for g, n in enumerate(order) if n[0] in fitted]
    return replace(sums, correlation=_correlation(sums, groups, len(best.terms)))


def predicts_better(other: Fit, one: Fit, users: Fit, seed: int) -> bool:
    """Whether recordings held out in turn are for certain predicted better by one model than by another.

    Of each the links and amplitudes are fitted to the rest; every channel counts in units of what the user's model leaves of it.
    Motions that were never fitted have to be predicted better, too. The seed is that of the bootstrap.
    """
    projector = users.projector
    data = scaled(projector.data, left_by(projector.data, users))
    alike = np.ones(len(data.channels.names))
    sums = [held_out_sums(data, projector.root, model, [], alike) for model in (one, other)]
    worse, better = (x.squares(range(len(model.terms))) for x, model in zip(sums, (one, other), strict=True))
    gained, unseen = worse - better, sums[0].unseen
    low = lower_end(gained[:, None], lambda drawn: drawn[:, 0], data.settings, seed)
    return bool(low > 0.0 and (not unseen.any() or gained[unseen].sum() > 0.0))


def _columns(
    data: DiagnosisData, segments: Sequence[SpectralSegment], root: np.ndarray, best: Fit, candidates: Sequence[Term]
) -> np.ndarray:
    """All columns of some segments (rows, p)."""
    residual = residual_rows(data, segments, best.links, best.offset, best.terms)
    parts = [np.zeros((len(residual), 0))]
    if root.shape[1]:
        parts.append(np.vstack([s.white(data.link_columns(s, best.terms)) @ root for s in segments]))
    parts.append(model_rows(data, segments, best.links, best.terms))
    for t in candidates:
        # Beside the user's effects alone: an effect may come in for one of those found, so its columns must not hold that one's.
        parts.append(term_rows(data, segments, best.links, data.terms, t, again=True))
    for one in best.terms:
        without = residual_rows(data, segments, best.links, best.offset, tuple(t for t in best.terms if t is not one))
        parts.append((without - residual)[:, None])
    return without_offset(data, segments, np.hstack([*parts, residual[:, None]]))


def _by_blocks(
    data: DiagnosisData, segments: Sequence[SpectralSegment], columns: np.ndarray
) -> Iterator[tuple[int, np.ndarray, float]]:
    """Part of the motion, course in time (k, c, p) and number of rows of every block of time."""
    alone = {s.motion for s in data.segments} == {segments[0].motion}
    row = 0
    for s in segments:
        size = s.shape[0] * s.shape[1]
        course = np.asarray(idct(columns[row : row + size].reshape(*s.shape, -1), axis=0, norm="ortho"))
        row += size
        count = int(np.clip((s.times[-1] - s.times[0]) / data.settings.window, 1, len(course)))
        for k, part in enumerate(np.array_split(course, count)):
            yield k * PARTS // count if alone and not s.still else 0, part, float(len(part) * s.alive.sum())


def _correlation(sums: HeldOutSums, groups: Sequence[int], effects: int) -> float:
    """How many rows count as one: dispersion of the best attempt between the parts of the fitted motions."""
    parts = [sums.blocks[sums.groups == g].sum(axis=0) for g in groups]
    left, _ = sums.fitted(np.sum(parts, axis=0), range(effects))
    active = np.concatenate([np.arange(sums.always), sums.always + np.flatnonzero(sums.owners < effects)])
    pick = np.zeros((len(sums.whole), len(active) + 1))
    pick[active, np.arange(len(active))] = 1.0
    pick[:, -1] = left  # about its own fit, so that the solution is zero
    (found,) = dispersions(Rows([pick.T @ part @ pick for part in parts]), np.zeros(len(active)))
    return found.factor
