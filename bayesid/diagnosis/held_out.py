"""Fits that leave recordings out in turn, from inner products alone.

Where a robot never comes down to its sensors' noise, whitening gives too much weight to frequencies with little noise. Here
every channel is divided by the root mean square that the best attempt leaves of it, at all frequencies alike. About that attempt
the readings are linear,

    y = A u + J p + e,    u ~ N(0, 1),    e ~ N(0, r),

with the links' columns A over their prior, the effects' columns J, and r rows that count as one, for what a model lacks
follows the motion (`bayesid.estimators.dispersion`). Whitened amplitudes become courses in time as in
`bayesid.diagnosis.stability`. Gram matrices of blocks of time then give, for any effects in the model and any recordings left
out, the fit to the rest and the squared error of its prediction.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import idct
from scipy.linalg import solve_triangular

from bayesid.diagnosis.data import DiagnosisData, model_rows, residual_rows, term_rows
from bayesid.diagnosis.fit import Fit
from bayesid.diagnosis.spectra import Segment
from bayesid.diagnosis.validation import residual_spectra, without_offset
from bayesid.effects import Term
from bayesid.estimators.dispersion import STRETCHES, Rows, dispersions

#: Curvature of directions that nothing determines, in units of a column's own.
_FLAT = 1e-9
#: Share of a column that must be left beside the others to count as a direction of its own.
_SEEN = 1e-7


@dataclass(frozen=True, eq=False)
class HeldOutSums:
    """Inner products of all columns, by block of time: links, effects' parameters, effects' traces, residual.

    An effect's trace is what the best attempt's prediction loses without it. Effects that may come in have no trace.
    """

    blocks: np.ndarray  # (b, p, p), every channel in units of what the best attempt leaves of it: for fits and their evidence
    #: (b, p, p), every channel in units of what the user's model leaves of it: for shares, in which all channels count alike.
    shown: np.ndarray
    groups: np.ndarray  # which blocks are left out together (b,): a motion, or a stretch of the only one fitted
    counts: np.ndarray  # rows of each block (b,)
    unseen: np.ndarray  # whether a block is of a validation motion (b,)
    links: int  # number of the links' columns
    owners: np.ndarray  # effect of each column of parameters (k,)
    traces: int  # how many effects, the first ones, have a trace
    start: np.ndarray  # coordinates of the links at the best attempt (links,)
    correlation: float = 1.0  # how many rows count as one

    @cached_property
    def whole(self) -> np.ndarray:
        """Over everything (p, p)."""
        return np.asarray(self.blocks.sum(axis=0))

    @cached_property
    def _rest(self) -> np.ndarray:
        """Over everything but each group (g, p, p)."""
        return np.stack([self.whole - self.blocks[self.groups == g].sum(axis=0) for g in range(self.groups.max() + 1)])

    def fitted(self, gram: np.ndarray, effects: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Combination of columns that a fit of these effects leaves (p,), and its amplitudes of all effects' columns (k,).

        Of several Gram matrices (g, p, p) at once: (g, p) and (g, k).
        """
        own = np.flatnonzero(np.isin(self.owners, list(effects)))
        active = np.concatenate([np.arange(self.links), self.links + own])
        traces = [k for k in range(self.traces) if k not in effects]
        wanted = np.array([*(self.links + len(self.owners) + k for k in traces), gram.shape[-1] - 1])
        left = np.zeros(gram.shape[:-1])
        left[..., wanted] = 1.0
        square, right = (gram[..., active[:, None], at] / self.correlation for at in (active, wanted))
        right = right.sum(axis=-1)
        square[..., : self.links, : self.links] += np.eye(self.links)
        right[..., : self.links] -= self.start
        scale = np.sqrt(np.maximum(np.diagonal(square, axis1=-2, axis2=-1), np.diag(self.whole)[active] / self.correlation))
        scale = np.maximum(scale, 1e-150)
        scaled = square / (scale[..., :, None] * scale[..., None, :]) + _FLAT * np.eye(len(active))
        step = np.linalg.solve(scaled, (right / scale)[..., None])[..., 0] / scale
        left[..., active] -= step
        amplitudes = np.zeros((*gram.shape[:-2], len(self.owners)))
        amplitudes[..., own] = step[..., self.links :]
        return left, amplitudes

    def squares(self, effects: Sequence[int]) -> np.ndarray:
        """Squared prediction errors of every block with these effects, its group left out of the fit (b,)."""
        left, _ = self.fitted(self._rest, effects)
        at = np.flatnonzero(left.any(axis=0))  # most columns are of effects that are not in the model
        mine = left[self.groups][:, at]
        return np.einsum("bi,bij,bj->b", mine, self.shown[:, at[:, None], at], mine, optimize=True)

    def cost(self, effects: Sequence[int]) -> float:
        """Twice the negative log density of all recordings and the links' prior at the fit of these effects."""
        left, _ = self.fitted(self.whole, effects)
        links = self.start - left[: self.links]
        return float(left @ self.whole @ left) / self.correlation + float(links @ links)

    @cached_property
    def prices(self) -> np.ndarray:
        """Log evidence that each effect's parameters cost: half the logarithm of the number of rows for each [Schwarz1978]_."""
        return 0.5 * self._parameters * float(np.log(max(self.counts.sum() / self.correlation, 2.0)))

    @cached_property
    def _parameters(self) -> np.ndarray:
        """Number of columns of each effect, up to the last that has any."""
        return np.bincount(self.owners, minlength=self.traces)

    def evidence(self, effects: Sequence[int], others: Sequence[int]) -> np.ndarray:
        """Log evidence that each of other effects would add to a fit of these (len(others),)."""
        left, _ = self.fitted(self.whole, effects)
        gram, links = self.whole / self.correlation, self.links
        active = np.concatenate([np.arange(links), links + np.flatnonzero(np.isin(self.owners, list(effects)))])
        square = gram[np.ix_(active, active)]
        square[:links, :links] += np.eye(links)
        scale = np.maximum(np.sqrt(np.diag(square)), 1e-150)
        half = np.linalg.cholesky(square / np.outer(scale, scale) + _FLAT * np.eye(len(active)))
        columns = slice(links, links + len(self.owners))
        length = np.maximum(np.sqrt(np.diag(gram)[columns]), 1e-150)
        inside = solve_triangular(half, gram[active, columns] / np.outer(scale, length), lower=True, check_finite=False)
        target = gram[columns] @ left / length
        # Along the directions that the rest leaves free, of all effects with as many columns at once.
        asked, out = np.array(others, int), np.zeros(len(others))
        counts, first = self._parameters[asked], np.searchsorted(self.owners, asked)
        for count in np.unique(counts[counts > 0]):
            alike = np.flatnonzero(counts == count)
            own = first[alike, None] + np.arange(count)
            square = gram[links + own[:, :, None], links + own[:, None, :]] / (length[own][:, :, None] * length[own][:, None, :])
            part = inside.T[own]
            values, vectors = np.linalg.eigh(square - part @ part.transpose(0, 2, 1))
            along = np.einsum("eij,ei->ej", vectors, target[own])
            seen = values > _SEEN
            out[alike] = 0.5 * np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1)
        return out - self.prices[asked]


def left_by(data: DiagnosisData, model: Fit) -> np.ndarray:
    """Mean square of what a model leaves of every channel on the fitted motions (c,)."""
    white = residual_spectra(data, data.segments, model)
    plain = [np.linalg.solve(s.whitener, w[:, :, None])[:, :, 0] for s, w in zip(data.segments, white, strict=True)]
    square = sum(np.sum(p**2, axis=0) for p in plain) / sum(len(p) for p in plain)
    return np.maximum(square, 1e-18 * np.max(square, initial=1e-200))


def scaled(data: DiagnosisData, square: np.ndarray) -> DiagnosisData:
    """The data with white noise of these mean squares (c,) in all channels."""

    def alike(segments: Sequence[Segment]) -> tuple[Segment, ...]:
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
        for stretch, part, count in _by_blocks(data, mine, _columns(data, mine, root, best, candidates)):
            blocks.append(_squared(part))
            shown.append(_squared(part * weight[:, None]))
            names.append((motion, stretch))
            counts.append(count)
    order, fitted = list(dict.fromkeys(names)), {s.motion for s in data.segments}
    owners = [i for i, t in enumerate(best.terms) if not data.fixed(t) for _ in t.values]
    owners += [len(best.terms) + i for i, t in enumerate(candidates) for _ in t.values]
    links = root.shape[1]
    sums = HeldOutSums(
        np.array(blocks), np.array(shown), np.array([order.index(n) for n in names]), np.array(counts),
        np.array([n[0] not in fitted for n in names]), links, np.array(owners, int), len(best.terms),
        best.coordinates[:links],
    )  # fmt: skip
    groups = [g for g, n in enumerate(order) if n[0] in fitted]
    return replace(sums, correlation=_correlation(sums, groups, len(best.terms)))


def _columns(
    data: DiagnosisData, segments: Sequence[Segment], root: np.ndarray, best: Fit, candidates: Sequence[Term]
) -> np.ndarray:
    """All columns of some segments (rows, p)."""
    residual = residual_rows(data, segments, best.links, best.offset, best.terms)
    parts = [np.zeros((len(residual), 0))]
    if root.shape[1]:
        parts.append(np.vstack([s.white(data.link_columns(s, best.terms)) @ root for s in segments]))
    parts.append(model_rows(data, segments, best.links, best.terms))
    for t in candidates:
        # Beside the user's effects alone: an effect may come in for one of those found, so its columns must not hold that one's.
        parts.append(term_rows(data, segments, best.links, data.terms, t))
    for one in best.terms:
        without = residual_rows(data, segments, best.links, best.offset, tuple(t for t in best.terms if t is not one))
        parts.append((without - residual)[:, None])
    return without_offset(data, segments, np.hstack([*parts, residual[:, None]]))


def _by_blocks(data: DiagnosisData, segments: Sequence[Segment], columns: np.ndarray) -> Iterator[tuple[int, np.ndarray, float]]:
    """Stretch, course in time (k, c, p) and number of rows of every block of time."""
    alone = {s.motion for s in data.segments} == {segments[0].motion}
    row = 0
    for s in segments:
        size = s.shape[0] * s.shape[1]
        course = np.asarray(idct(columns[row : row + size].reshape(*s.shape, -1), axis=0, norm="ortho"))
        row += size
        count = int(np.clip((s.times[-1] - s.times[0]) / data.settings.window, 1, len(course)))
        for k, part in enumerate(np.array_split(course, count)):
            yield k * STRETCHES // count if alone and not s.still else 0, part, float(len(part) * s.alive.sum())


def _squared(part: np.ndarray) -> np.ndarray:
    flat = part.reshape(-1, part.shape[2])
    return flat.T @ flat


def _correlation(sums: HeldOutSums, groups: Sequence[int], effects: int) -> float:
    """How many rows count as one: dispersion of the best attempt between the parts of the fitted motions."""
    parts = [sums.blocks[sums.groups == g].sum(axis=0) for g in groups]
    left, _ = sums.fitted(np.sum(parts, axis=0), range(effects))
    own = np.flatnonzero(sums.owners < effects)
    active = np.concatenate([np.arange(sums.links), sums.links + own])
    pick = np.zeros((len(sums.whole), len(active) + 1))
    pick[active, np.arange(len(active))] = 1.0
    pick[:, -1] = left  # about its own fit, so that the solution is zero
    (found,) = dispersions(Rows([pick.T @ part @ pick for part in parts]), np.zeros(len(active)))
    return max(found.found, 1.0)
